"""Engine: the torque of a machine over its speed and the position of its pedal, on the coordinate of its shaft.

    Q = map(u, omega)        omega: rate of the coordinate, u: the input, from 0 to 1

At each position of the pedal the torque is the monotone cubic through its points over the speed (solver.elements.laws),
linear between the positions; above the last speed it goes on along its slope there, which may not rise: so the droop of
a limiter or the drag of an engine that pulls no more ends it. Below the first speed it goes on along its slope there
too, but never so that it drives an engine backwards that is turned backwards, ever faster: see `continued_below`. The
energy that it delivers is negative dissipation; it stores nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.dimensions import Rate, Torque
from solver.elements.coordinate import (
    add_coordinate_hessian,
    add_generalized,
    add_gradient,
    coordinate_rate,
    coordinate_rate_gradient,
    evaluate_coordinate,
)
from solver.elements.instant import sums
from solver.elements.kind import ForceKind, Held
from solver.elements.law_map import evaluate_map
from solver.elements.laws import Law
from solver.elements.marker import Context, Spec, slots
from solver.validate import require, require_grid, require_rising

# rad/s below the first speed over which a torque passes into what it is when the engine is turned backwards
NARROWEST = 1.0
OUTPUTS = {'energy': 'J', 'dissipation': 'W', 'rate': 'rad/s', 'torque': 'N m', 'pedal': ''}


def require_engine(
    where: str, speeds: Sequence[float], pedals: Sequence[float], torques: Sequence[Sequence[float]]
) -> None:
    """Check a map of torques over pedals (rows) and speeds (columns). Raises SpecError."""
    require_rising(where, 'speeds', speeds, 2)
    require_rising(where, 'pedals', pedals)
    require_grid(where, 'torques', torques, ('pedals', len(pedals)), ('speeds', len(speeds)))
    for k, row in enumerate(torques):
        require(
            row[-1] <= row[-2],
            where,
            f'torques[{k}]',
            row[-1],
            'must not rise towards the last speed: the curve goes on so beyond it',
        )


def continued_below(law: Law) -> Law:
    """The torque [N m] over the speed [rad/s] of one position of the pedal, as it goes on below its first speed: at
    negative speeds it must not be negative, or an engine that is turned backwards runs away.

    A torque that falls over the speed there, and is not below zero at rest, goes on along its slope. One that rises
    follows its slope down to rest, at most to zero, which it meets as a parabola does, and is constant further down. A
    drag is zero at rest and as large backwards, the other way. If the first speed leaves no room for that, it happens
    within NARROWEST below it; between its points the law stays what it was.
    """
    first, torque, slope = law.x[0], law.y[0], law.slope[0]
    at_rest = torque - slope * max(first, 0.0)
    if slope <= 0.0 and at_rest >= 0.0:
        return law
    if torque >= 0.0:
        # from further down a cubic with that slope at its end would swing below zero
        low = max(min(0.0, first - NARROWEST), first - max(NARROWEST, 2.0 * torque / slope))
        return Law((low, *law.x), (max(torque - slope * (first - low), 0.0), *law.y), (0.0, *law.slope))
    backwards = (min(-first, first - NARROWEST), -torque, min(slope, 0.0))
    knots = [backwards] if first < NARROWEST else [backwards, (0.0, 0.0, torque / first)]
    x, y, slopes = zip(*knots, strict=True)
    return Law((*x, *law.x), (*y, *law.y), (*slopes, *law.slope))


@dataclass(frozen=True, kw_only=True)
class EngineSpec(Spec):
    """The torque of an engine on a rotation coordinate; see the module. input: position of the pedal, from 0 to 1.
    speeds [rad/s] and pedals, rising; torques [N m]: for each pedal those at the speeds."""

    coordinate: str
    input: str
    speeds: tuple[Rate, ...]
    pedals: tuple[float, ...]
    torques: tuple[tuple[Torque, ...], ...]

    def __post_init__(self) -> None:
        require_engine(self.where, self.speeds, self.pedals, self.torques)


class EngineTable(NamedTuple):
    """Columns of all engines."""

    coordinate: np.ndarray  # (n,)
    body: np.ndarray  # (n, 2)
    slot: np.ndarray  # (n, 2, 2)
    input: np.ndarray  # (n,)
    start: np.ndarray  # (n + 1,) rows of the map of engine e: start[e]:start[e + 1]
    pedal: np.ndarray  # (m,)
    law: np.ndarray  # (m,)


def compile_engines(specs: Sequence[EngineSpec], context: Context) -> EngineTable:
    """Resolve names and laws into a table."""
    n = len(specs)
    laws = [
        continued_below(Law.table(list(zip(s.speeds, row, strict=True)), s.where, 'torques'))
        for s in specs
        for row in s.torques
    ]
    table = EngineTable(
        coordinate=np.array([context.coordinate(s.where, s.coordinate) for s in specs], np.int64),
        body=np.zeros((n, 2), np.int64),
        slot=np.zeros((n, 2, 2), np.int64),
        input=np.array([context.input(s.where, s.input) for s in specs], np.int64),
        start=np.cumsum([0, *(len(s.pedals) for s in specs)]).astype(np.int64),
        pedal=np.array([pedal for s in specs for pedal in s.pedals], float),
        law=np.array([context.law(law) for law in laws], np.int64),
    )
    for e in range(n):
        bodies = context.coordinate_bodies(int(table.coordinate[e]))
        table.body[e] = bodies
        table.slot[e] = slots(bodies, context)
    return table


@kernel(borrow=True)
def engine_forces(table, now, effects, out):
    """Accumulate forces and tangents of all engines (contract: solver/elements/__init__.py)."""
    f, Kq, Kv = sums(effects)
    coordinates, kin, angle = now.coordinates, now.kin, now.angle
    for e in range(table.coordinate.shape[0]):
        k = table.coordinate[e]
        _, g_i, g_j = evaluate_coordinate(coordinates, kin, k, angle)
        rate = coordinate_rate(coordinates, kin, k, g_i, g_j)
        pedal = now.u[table.input[e]]
        torque, slope, _ = evaluate_map(now.laws, table.start, table.pedal, table.law, e, rate, pedal)
        add_gradient(torque, g_i, table.body[e, 0], f)
        add_gradient(torque, g_j, table.body[e, 1], f)
        if now.tangents:
            h_i, h_j = coordinate_rate_gradient(coordinates, kin, k)
            add_generalized((g_i, g_j), (h_i, h_j), 2, 0.0, -slope, table.slot, e, Kq, Kv)
            add_coordinate_hessian(coordinates, kin, k, torque, Kq)
        out[e, 0] = 0.0
        out[e, 1] = -torque * rate
        out[e, 2] = rate
        out[e, 3] = torque
        out[e, 4] = pedal


def held_engines(table: EngineTable, u: np.ndarray) -> Held:
    """Engines are off in the search for static equilibrium."""
    return Held(table._replace(law=np.full_like(table.law, -1)), u, {})


ENGINES = ForceKind(
    name='engines',
    spec=EngineSpec,
    compile=compile_engines,
    kernel=engine_forces,
    outputs=OUTPUTS,
    supplies=True,
    effort='torque',
    held=held_engines,
)
