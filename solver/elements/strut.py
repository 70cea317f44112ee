"""Strut: springs, stops and a damper in a row with a rubber mount, without mass: what is left of a coil-over whose
parts have no inertia.

    length from i to j = x + y       x of spring and damper, y of the mount beyond its free length
    F = spring(x - free) + stops(x - free) + damper(dx/dt) = mount(y) + mount_damping dy/dt         tension positive

The extension y of the mount is an internal state. Its rate follows from the balance of the two sides, one equation that
rises with dy/dt as long as no law falls; it is solved by Newton's method between bounds, of which the last two
iterations are free of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.vec import dot, scale
from solver.dimensions import Damping, Length
from solver.elements.instant import sums
from solver.elements.kind import ForceKind
from solver.elements.laws import Law, evaluate_law
from solver.elements.marker import Context, Marker, Spec, compile_pairs
from solver.elements.point_pair import add_tension, add_tension_tangent, between
from solver.validate import finite

OUTPUTS = {
    **{'energy': 'J', 'dissipation': 'W', 'length': 'm', 'rate': 'm/s', 'force': 'N'},  # of the damper with its stops
    **{'spring': 'N', 'mount': 'm'},
}
MOST = 60  # iterations between bounds
FARTHEST = 1e6  # m/s
SETTLED_FORCE = 1e-6  # of the force, where they end: two more iterations square that twice


@dataclass(frozen=True, kw_only=True)
class StrutSpec(Spec):
    """Springs and a damper with a mount in a row between the origins of two markers; see the module for the force.

    free_length: of the damper with its stops [m]. spring: force [N] over length less free_length, preload included;
    stops: the same, shown with the damper; damper: over its rate [m/s]; mount: over its extension [m]; tension
    positive. None means absent. mount_damping [N s/m] > 0.
    """

    i: Marker
    j: Marker
    free_length: Length
    spring: Law | None = None
    stops: Law | None = None
    damper: Law | None = None
    mount: Law
    mount_damping: Damping

    def __post_init__(self) -> None:
        self.set('free_length', finite(self.where, 'free_length', self.free_length, low=0.0))
        self.set('mount_damping', finite(self.where, 'mount_damping', self.mount_damping, low=0.0, strict=True))


class StrutTable(NamedTuple):
    """Columns of all struts; see StrutSpec for units."""

    body: np.ndarray  # (n, 2)
    r_i: np.ndarray  # (n, 3) point on i from its centre of mass, in B_i [m]
    r_j: np.ndarray  # (n, 3)
    law: np.ndarray  # (n, 4) spring, stops, damper, mount
    free_length: np.ndarray  # (n,)
    damping: np.ndarray  # (n,) of the mount
    state: np.ndarray  # (n,) extension of the mount
    slot: np.ndarray  # (n, 4) blocks ii ij ji jj


def compile_struts(specs: Sequence[StrutSpec], context: Context) -> StrutTable:
    """Resolve names and laws into a table."""
    pairs = compile_pairs(specs, context)
    laws = [[context.law(law) for law in (s.spring, s.stops, s.damper, s.mount)] for s in specs]
    return StrutTable(
        body=pairs.body,
        r_i=pairs.r_i,
        r_j=pairs.r_j,
        law=np.array(laws, np.int64).reshape(len(specs), 4),
        free_length=np.array([s.free_length for s in specs], float),
        damping=np.array([s.mount_damping for s in specs], float),
        state=np.array([context.internal_states(s.where, 1) for s in specs], np.int64),
        slot=pairs.slot,
    )


@kernel(inner=True)
def _sides(table, laws, e, length, rate, zp, cz, w):
    """(y, F of the mount, its slope in w; spring and stops, their stiffness; damper, its slope; energy) at dy/dt =
    w."""
    y = zp + cz * w
    x = length - y - table.free_length[e]
    spring, k0, e0 = evaluate_law(laws, table.law[e, 0], x)
    stops, k1, e1 = evaluate_law(laws, table.law[e, 1], x)
    damper, c, _ = evaluate_law(laws, table.law[e, 2], rate - w)
    mount, km, em = evaluate_law(laws, table.law[e, 3], y)
    return y, mount + table.damping[e] * w, km * cz + table.damping[e], spring, stops, k0 + k1, damper, c, e0 + e1 + em


@kernel(inner=True)
def _mount_rate(table, laws, e, length, rate, zp, cz):
    """dy/dt at which both sides carry the same force."""
    w = 0.0 * rate
    low, high = -FARTHEST, FARTHEST
    before = 1e300
    for _ in range(MOST):
        _, mount, slope, spring, stops, k, damper, c, _ = _sides(table, laws, e, length, rate, zp, cz, w)
        r = mount - spring - stops - damper
        if r.real > 0.0:
            high = w.real
        else:
            low = w.real
        if r.real * r.real <= SETTLED_FORCE * SETTLED_FORCE * (1.0 + mount.real * mount.real):
            break
        left = r.real * r.real
        w = w - r / (slope + k * cz + c)
        # Newton's method may go to and fro over a knee: the middle of the two is nearer then
        if w.real <= low or w.real >= high or (left > 0.25 * before and low > -FARTHEST and high < FARTHEST):
            w = 0.5 * (low + high) + 0.0 * w
        before = left
    for _ in range(2):
        _, mount, slope, spring, stops, k, damper, c, _ = _sides(table, laws, e, length, rate, zp, cz, w)
        w = w - (mount - spring - stops - damper) / (slope + k * cz + c)
    return w


@kernel(borrow=True)
def strut_forces(table, now, effects, out):
    """Accumulate forces and tangents of all struts (contract: solver/elements/__init__.py)."""
    f, Kq, Kv = sums(effects)
    kin = now.kin
    for e in range(table.free_length.shape[0]):
        at = between(table, e, kin)
        length = np.sqrt(dot(at.d, at.d))
        n = scale(1.0 / length, at.d)
        rate = dot(n, at.v)
        state = table.state[e]
        w = _mount_rate(table, now.laws, e, length, rate, now.zp[state], now.cz)
        y, force, slope, spring, stops, k, damper, c, energy = _sides(
            table, now.laws, e, length, rate, now.zp[state], now.cz, w
        )
        F = add_tension(kin, at, n, force, f)
        if now.tangents:
            # dw = (k dl + c dr) / (slope + k cz + c), and the mount's force changes by slope dw
            share = slope / (slope + k * now.cz + c)
            stiffness, damping = share * k, share * c
            turn = force / length, -damping / length
            add_tension_tangent(kin, at, n, rate, F, stiffness, damping, turn[0], turn[1], table.slot, e, Kq, Kv)
        effects.z[state] = y
        out[e, 0] = energy
        out[e, 1] = damper * (rate - w) + table.damping[e] * w * w
        out[e, 2] = length - y
        out[e, 3] = rate - w
        out[e, 4] = stops + damper
        out[e, 5] = spring
        out[e, 6] = y


STRUTS = ForceKind(name='struts', spec=StrutSpec, compile=compile_struts, kernel=strut_forces, outputs=OUTPUTS)
