"""Point-to-point spring-damper: a force along the line between two points, from a law of length and a law of rate.

If the points coincide, the line is that of their relative velocity, on which they leave each other; without any the
damper has no force, and the spring none either if its free length is zero. Its stiffness there is the same in all
directions. A spring with a force at length zero has no direction to pull in: a start there is refused
(solver.start.placement).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.vec import dot, scale
from solver.dimensions import Force, Length
from solver.elements.instant import sums
from solver.elements.kind import ForceKind
from solver.elements.laws import Law, evaluate_law
from solver.elements.marker import Context, Marker, Spec, compile_pairs
from solver.elements.point_pair import add_tension, add_tension_tangent, between
from solver.validate import finite

OUTPUTS = {'energy': 'J', 'dissipation': 'W', 'length': 'm', 'rate': 'm/s', 'force': 'N'}


@dataclass(frozen=True, kw_only=True)
class SpringDamperSpec(Spec):
    """Spring-damper between the origins of two markers.

    force = spring(length - free_length) + damper(rate) + preload [N], tension positive. Laws are in N over m and N over
    m/s; None means absent.
    """

    counted_as = 'spring_dampers'
    i: Marker
    j: Marker
    free_length: Length
    spring: Law | None = None
    damper: Law | None = None
    preload: Force = 0.0

    def __post_init__(self) -> None:
        self.set('free_length', finite(self.where, 'free_length', self.free_length, low=0.0))
        self.set('preload', finite(self.where, 'preload', self.preload))


class SpringDamperTable(NamedTuple):
    """Columns of all spring-dampers; see SpringDamperSpec for units."""

    body: np.ndarray  # (n, 2)
    r_i: np.ndarray  # (n, 3) point on i from its centre of mass, in B_i [m]
    r_j: np.ndarray  # (n, 3)
    law: np.ndarray  # (n, 2) spring, damper
    free_length: np.ndarray  # (n,)
    preload: np.ndarray  # (n,)
    slot: np.ndarray  # (n, 4) blocks ii ij ji jj


def compile_spring_dampers(specs: Sequence[SpringDamperSpec], context: Context) -> SpringDamperTable:
    """Resolve names and laws into a table."""
    pairs = compile_pairs(specs, context)
    return SpringDamperTable(
        body=pairs.body,
        r_i=pairs.r_i,
        r_j=pairs.r_j,
        law=np.array([(context.law(s.spring), context.law(s.damper)) for s in specs], np.int64).reshape(len(specs), 2),
        free_length=np.array([s.free_length for s in specs], float),
        preload=np.array([s.preload for s in specs], float),
        slot=pairs.slot,
    )


@kernel(borrow=True)
def spring_damper_forces(table, now, effects, out):
    """Accumulate forces and tangents of all spring-dampers (contract: solver/elements/__init__.py)."""
    f, Kq, Kv = sums(effects)
    kin = now.kin
    for e in range(table.free_length.shape[0]):
        at = between(table, e, kin)
        length = np.sqrt(dot(at.d, at.d))
        apart = length.real > 0.0
        along = length if apart else np.sqrt(dot(at.v, at.v))
        n = scale(1.0 / along, at.d if apart else at.v) if along.real > 0.0 else scale(0.0, at.d)
        rate = dot(n, at.v)
        x = length - table.free_length[e]
        spring, stiffness, energy = evaluate_law(now.laws, table.law[e, 0], x)
        damper, damping, _ = evaluate_law(now.laws, table.law[e, 1], rate)
        force = spring + damper + table.preload[e]
        F = add_tension(kin, at, n, force, f)
        if now.tangents:
            across = force / length if apart else stiffness
            twist = -damping / length if apart else 0.0 * length
            add_tension_tangent(kin, at, n, rate, F, stiffness, damping, across, twist, table.slot, e, Kq, Kv)
        out[e, 0] = energy + table.preload[e] * x
        out[e, 1] = damper * rate
        out[e, 2] = length
        out[e, 3] = rate
        out[e, 4] = force


SPRING_DAMPERS = ForceKind(
    name='spring_dampers',
    spec=SpringDamperSpec,
    compile=compile_spring_dampers,
    kernel=spring_damper_forces,
    outputs=OUTPUTS,
)
