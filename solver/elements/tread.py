"""The tread that gives before a wheel rolls: a wheel stands on its rolling resistance, which is dry friction.

A spring and a damper in series with a slider, as in a brake (solver.elements.brake). With the velocity W = R0 omega of
rolling and the give b of the tread [m], the part m of the rolling resistance acts:

    stick: db/dt = W, m = (b + t W)/b0, where that is below 1        slip: db/dt = (+-b0 - b)/t, m = +-1

A wheel that rolls has the whole resistance: above b0/t, some mm/s, the motion does not depend on b. A wheel that stands
takes what it needs, and comes back by at most b0 when it has stopped. A stage solution b = zp + cz db/dt has a closed
form.
"""

from __future__ import annotations

import math

import numpy as np

from solver.compiled.dual import value
from solver.compiled.kernel import kernel
from solver.elements.smooth import smooth_sign
from solver.units import MODEL_GRAVITY

GIVE = 0.01  # b0 over the radius, 3 mm of a car; with ten times as much a car comes back by 3 cm when it has stopped
SLOWEST = 0.5  # m/s: rolling of a tread that gives without end, above which it has its whole resistance
# over the load, with which t is found at least; with ten times as much good tires are damped by a third
LEAST_RESISTANCE = 1e-3


def give_of(radius: float, resistance: float) -> tuple[float, float]:
    """(b0 [m], t [s]) of a wheel with this radius [m] and rolling resistance over load: critical for m x'' = -f m g (x
    + t x')/b0."""
    way = GIVE * radius
    return way, 2.0 * math.sqrt(way / (max(resistance, LEAST_RESISTANCE) * MODEL_GRAVITY))


@kernel(inline=True)
def rolling_part(zp, cz, W, way, damping):
    """(b at this instant [m], m) of b = zp + cz db/dt; way: b0 [m], damping: t [s]. A tread that gives without end
    resists as oil does."""
    wide = cz + damping
    tried = zp + wide * value(W)
    if tried.real >= way:
        return zp + cz / wide * (way - zp), 0.0 * W + 1.0
    if tried.real <= -way:
        return zp - cz / wide * (way + zp), 0.0 * W - 1.0
    if way == np.inf:
        return 0.0 * zp, smooth_sign(W, SLOWEST)
    return zp + cz * value(W), (zp + wide * W) / way
