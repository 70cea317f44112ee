"""Clutch and gearbox: dry friction with true stick between a shaft and outputs that turn by the ratio of a gear slower.

    slip  w = rate of the shaft - R (sum of share_k rate_k of the outputs)        R: ratio of the gear that the input
          `gear` chooses
    torque tau of the friction of solver.elements.brake over w, |tau| <= T = capacity (1 - u), u: the clutch pedal, from
    0 to 1
    on the shaft -tau, on output k  R share_k tau

In gear 0 the box is in neutral and T = 0. Below -0.5 the input chooses the reverse gear, if there is one; other values
are rounded, and held within the gears there are. The body in which shaft and outputs turn takes the difference of the
torques, as a gearbox does.

Several outputs are those of ideal planetary gears behind the gear, whose shares add up to one (half each: a
differential): from the rates the torques follow by their power, whatever the rates are. Between more than two they are
such gears one behind the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.dimensions import Torque, TurnDamping, TurnStiffness
from solver.elements.brake import damping_of, friction
from solver.elements.coordinate import (
    add_coordinate_hessian,
    add_generalized,
    add_gradient,
    coordinate_rate,
    coordinate_rate_gradient,
    evaluate_coordinate,
    scale6,
)
from solver.elements.instant import sums
from solver.elements.kind import ForceKind
from solver.elements.marker import Context, Spec, slots
from solver.validate import finite, require

OUTPUTS = {
    **{'energy': 'J', 'dissipation': 'W', 'windup': 'rad', 'rate': 'rad/s', 'torque': 'N m', 'ratio': ''},
    **dict.fromkeys(('on_shaft', 'on_first', 'on_second', 'on_third', 'on_fourth', 'on_fifth'), 'N m'),
}
FIRST = tuple(OUTPUTS).index('on_shaft')
# the shaft and five outputs: half shafts of a differential in the gearbox, and shafts to three more axles
TERMS = len(OUTPUTS) - FIRST


def require_gears(where: str, ratios: Sequence[float], reverse: float | None) -> None:
    """Check the ratios of a gearbox. Raises SpecError."""
    require(len(ratios) >= 1, where, 'ratios', ratios, 'needs at least one gear')
    for k, ratio in enumerate(ratios):
        finite(where, f'ratios[{k}]', ratio, low=0.0, strict=True)
    if reverse is not None:
        finite(where, 'reverse', reverse, low=0.0, strict=True)


@dataclass(frozen=True, kw_only=True)
class ClutchSpec(Spec):
    """A clutch with a gearbox between a shaft and one to five outputs; see the module. outputs: (coordinate, share).
    ratios: of the gears from the first one on; reverse: of the reverse gear (None: there is none), both > 0. capacity
    [N m] >= 0 of the clutch; stiffness [N m/rad] > 0 and damping [N m s/rad] >= 0 of what winds up while it sticks
    (None: as a brake has it). input: the clutch pedal, gear: the channel that chooses."""

    shaft: str
    outputs: tuple[tuple[str, float], ...]
    ratios: tuple[float, ...]
    reverse: float | None = None
    capacity: Torque
    stiffness: TurnStiffness
    damping: TurnDamping | None = None
    input: str
    gear: str

    def __post_init__(self) -> None:
        pairs = f'needs 1 to {TERMS - 1} [coordinate, share] pairs'
        require(1 <= len(self.outputs) < TERMS, self.where, 'outputs', self.outputs, pairs)
        self.set('outputs', tuple((str(c), finite(self.where, f'share of {c}', f)) for c, f in self.outputs))
        require_gears(self.where, self.ratios, self.reverse)
        finite(self.where, 'stiffness', self.stiffness, low=0.0, strict=True)
        finite(self.where, 'capacity', self.capacity, low=0.0)
        self.set('damping', damping_of(self.where, self.stiffness, self.damping))


class ClutchTable(NamedTuple):
    """Columns of all clutches; bodies of shaft and outputs are at 2 t (body i) and 2 t + 1 (body j), absent ones the
    world's."""

    terms: np.ndarray  # (n,)
    coordinate: np.ndarray  # (n, TERMS) the shaft first
    share: np.ndarray  # (n, TERMS) of the outputs, 0 for an absent one
    body: np.ndarray  # (n, 2 TERMS)
    slot: np.ndarray  # (n, 2 TERMS, 2 TERMS)
    state: np.ndarray  # (n,) internal state: wind-up [rad]
    start: np.ndarray  # (n + 1,) gears of clutch e: start[e]:start[e + 1], reverse first (0: none), then the first
    ratio: np.ndarray  # (m,)
    capacity: np.ndarray  # (n,)
    stiffness: np.ndarray  # (n,)
    damping: np.ndarray  # (n,)
    input: np.ndarray  # (n,) the pedal
    gear: np.ndarray  # (n,)


def compile_clutches(specs: Sequence[ClutchSpec], context: Context) -> ClutchTable:
    """Resolve names into a table; one internal state per clutch."""
    n = len(specs)
    table = ClutchTable(
        terms=np.array([1 + len(s.outputs) for s in specs], np.int64),
        coordinate=np.zeros((n, TERMS), np.int64),
        share=np.zeros((n, TERMS)),
        body=np.full((n, 2 * TERMS), context.n_bodies, np.int64),
        slot=np.zeros((n, 2 * TERMS, 2 * TERMS), np.int64),
        state=np.array([context.internal_states(s.where, 1) for s in specs], np.int64),
        start=np.cumsum([0, *(1 + len(s.ratios) for s in specs)]).astype(np.int64),
        ratio=np.array([ratio for s in specs for ratio in (-(s.reverse or 0.0), *s.ratios)], float),
        capacity=np.array([s.capacity for s in specs], float),
        stiffness=np.array([s.stiffness for s in specs], float),
        damping=np.array([s.damping for s in specs], float),
        input=np.array([context.input(s.where, s.input) for s in specs], np.int64),
        gear=np.array([context.input(s.where, s.gear) for s in specs], np.int64),
    )
    for e, spec in enumerate(specs):
        bodies: list[int] = []
        for t, (name, share) in enumerate(((spec.shaft, 0.0), *spec.outputs)):
            table.coordinate[e, t] = context.coordinate(spec.where, name)
            table.share[e, t] = share
            bodies += context.coordinate_bodies(int(table.coordinate[e, t]))
        table.body[e, : len(bodies)] = bodies
        table.slot[e, : len(bodies), : len(bodies)] = slots(bodies, context)
    return table


@kernel(inline=True)
def _ratio(table, e, chosen):
    """Ratio of the gear that an input chooses, 0 in neutral."""
    first = table.start[e]
    if chosen < -0.5:
        return table.ratio[first]
    # held before it is rounded: a number may be beyond all integers
    gear = int(min(chosen + 0.5, table.start[e + 1] - first - 1.0))
    if gear == 0:
        return 0.0
    return table.ratio[first + gear]


@kernel(inner=True)
def _turning(table, coordinates, kin, angle, e, t, factor, tangents):
    """(rate, g_i, g_j, h_i, h_j) of term t times a factor, zeros for an absent one."""
    zero = 0.0 * kin.p[0, 0]
    none = ((zero, zero, zero), (zero, zero, zero))
    if t >= table.terms[e]:
        return zero, none, none, none, none
    k = table.coordinate[e, t]
    _, g_i, g_j = evaluate_coordinate(coordinates, kin, k, angle)
    rate = coordinate_rate(coordinates, kin, k, g_i, g_j)
    h_i, h_j = none, none
    if tangents:
        h_i, h_j = coordinate_rate_gradient(coordinates, kin, k)
    return factor * rate, scale6(factor, g_i), scale6(factor, g_j), scale6(factor, h_i), scale6(factor, h_j)


@kernel(borrow=True)
def clutch_forces(table, now, effects, out):
    """Accumulate forces and tangents of all clutches, assign their wind-up (contract: solver/elements/__init__.py)."""
    f, Kq, Kv = sums(effects)
    coordinates, kin, angle = now.coordinates, now.kin, now.angle
    for e in range(table.terms.shape[0]):
        n = table.state[e]
        ratio = _ratio(table, e, now.u[table.gear[e]])
        v0, g0, g1, h0, h1 = _turning(table, coordinates, kin, angle, e, 0, 1.0, now.tangents)
        v1, g2, g3, h2, h3 = _turning(table, coordinates, kin, angle, e, 1, -ratio * table.share[e, 1], now.tangents)
        v2, g4, g5, h4, h5 = _turning(table, coordinates, kin, angle, e, 2, -ratio * table.share[e, 2], now.tangents)
        v3, g6, g7, h6, h7 = _turning(table, coordinates, kin, angle, e, 3, -ratio * table.share[e, 3], now.tangents)
        v4, g8, g9, h8, h9 = _turning(table, coordinates, kin, angle, e, 4, -ratio * table.share[e, 4], now.tangents)
        v5, g10, g11, h10, h11 = _turning(
            table, coordinates, kin, angle, e, 5, -ratio * table.share[e, 5], now.tangents
        )
        slip = v0 + v1 + v2 + v3 + v4 + v5
        capacity = table.capacity[e] * min(max(1.0 - now.u[table.input[e]], 0.0), 1.0)
        if ratio == 0.0:
            capacity = 0.0
        k = table.stiffness[e]
        wound, torque, damping, dissipation = friction(now.zp[n], now.cz, slip, capacity, k, table.damping[e])
        g = (g0, g1, g2, g3, g4, g5, g6, g7, g8, g9, g10, g11)
        h = (h0, h1, h2, h3, h4, h5, h6, h7, h8, h9, h10, h11)
        for a in range(2 * table.terms[e]):
            add_gradient(-torque, g[a], table.body[e, a], f)
        if now.tangents:
            if damping > 0.0:
                add_generalized(g, h, 2 * table.terms[e], 0.0, damping, table.slot, e, Kq, Kv)
            add_coordinate_hessian(coordinates, kin, table.coordinate[e, 0], -torque, Kq)
            for t in range(1, table.terms[e]):
                add_coordinate_hessian(coordinates, kin, table.coordinate[e, t], ratio * table.share[e, t] * torque, Kq)
        effects.z[n] = wound
        out[e, 0] = 0.5 * k * wound * wound
        out[e, 1] = dissipation
        out[e, 2] = wound
        out[e, 3] = slip
        out[e, 4] = torque
        out[e, 5] = ratio
        out[e, FIRST] = -torque
        for t in range(1, TERMS):
            out[e, FIRST + t] = ratio * table.share[e, t] * torque


CLUTCHES = ForceKind(
    name='clutches',
    spec=ClutchSpec,
    compile=compile_clutches,
    kernel=clutch_forces,
    outputs=OUTPUTS,
    effort=tuple(OUTPUTS)[FIRST:],
)
