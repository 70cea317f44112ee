"""A toy force element of the recipe in docs/contributing.md: an actuator with a lag, along the line between two points.

force on j along n = (p_j - p_i)/|p_j - p_i|:  F = gain z,   lag dz/dt = u - z
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.vec import dot, load3, mscale, outer, scale, sub
from solver.dimensions import Force, Time
from solver.elements.instant import sums
from solver.elements.kind import ForceKind
from solver.elements.marker import Context, Marker, Spec, compile_pairs
from solver.elements.point_pair import add_point_force, add_point_pair_tangent, point_position, point_velocity
from solver.validate import finite

OUTPUTS = {'energy': 'J', 'dissipation': 'W', 'force': 'N', 'length': 'm'}


@dataclass(frozen=True, kw_only=True)
class PusherSpec(Spec):
    """Force gain * z [N] that pushes j away from i; z follows the input with the time constant lag [s] > 0."""

    i: Marker
    j: Marker
    input: str
    gain: Force  # for an input of 1
    lag: Time

    def __post_init__(self) -> None:
        self.set('gain', finite(self.where, 'gain', self.gain))
        self.set('lag', finite(self.where, 'lag', self.lag, low=0.0, strict=True))


class PusherTable(NamedTuple):
    """Columns of all pushers."""

    body: np.ndarray
    r_i: np.ndarray
    r_j: np.ndarray
    slot: np.ndarray
    state: np.ndarray
    input: np.ndarray
    gain: np.ndarray
    lag: np.ndarray


def compile_pushers(specs: Sequence[PusherSpec], context: Context) -> PusherTable:
    """Resolve names into a table; one internal state each."""
    pairs = compile_pairs(specs, context)
    return PusherTable(
        body=pairs.body,
        r_i=pairs.r_i,
        r_j=pairs.r_j,
        slot=pairs.slot,
        state=np.array([context.internal_states(s.where, 1) for s in specs], np.int64),
        input=np.array([context.input(s.where, s.input) for s in specs], np.int64),
        gain=np.array([s.gain for s in specs], float),
        lag=np.array([s.lag for s in specs], float),
    )


@kernel(borrow=True)
def pusher_forces(table, now, effects, out):
    """Accumulate forces and tangents of all pushers, assign their states (contract: solver/elements/__init__.py)."""
    f, Kq, Kv = sums(effects)
    kin = now.kin
    for e in range(table.gain.shape[0]):
        i, j, k = table.body[e, 0], table.body[e, 1], table.state[e]
        r_i, r_j = load3(table.r_i, e), load3(table.r_j, e)
        d = sub(point_position(kin, j, r_j), point_position(kin, i, r_i))
        w = sub(point_velocity(kin, j, r_j), point_velocity(kin, i, r_i))
        length = np.sqrt(dot(d, d))
        n = scale(1.0 / length, d)
        share = now.cz / table.lag[e]
        effects.z[k] = (now.zp[k] + share * now.u[table.input[e]]) / (1.0 + share) + 0.0 * kin.p[j, 0]
        force = table.gain[e] * effects.z[k]
        F = scale(force, n)
        add_point_force(kin, j, r_j, F, f)
        add_point_force(kin, i, r_i, scale(-1.0, F), f)
        if now.tangents:
            t = force / length
            D = mscale(-t, outer(n, n))
            D = (D[0] + t, D[1], D[2], D[3], D[4] + t, D[5], D[6], D[7], D[8] + t)
            s = table.slot
            add_point_pair_tangent(
                kin, i, j, r_i, r_j, F, D, mscale(0.0, D), s[e, 0], s[e, 1], s[e, 2], s[e, 3], Kq, Kv
            )
        out[e, 0] = 0.0
        out[e, 1] = -force * dot(n, w)
        out[e, 2] = force
        out[e, 3] = length


PUSHERS = ForceKind(
    name='pushers', spec=PusherSpec, compile=compile_pushers, kernel=pusher_forces, outputs=OUTPUTS, supplies=True
)
