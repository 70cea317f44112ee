"""Transmission: an elastic mesh between a joint coordinate and another one that reaches it through a shaft with
universal joints.

    s = factor_1 x_1 + factor_2 path(x_2)        path(x) = x + sum over n = 2, 4 of a_n sin(n x) + b_n (cos(n x) - 1)
    Q = -spring(s) - damper(ds/dt)               generalized force on x_1: factor_1 Q, on x_2: factor_2 path'(x_2) Q

The harmonics are the non-uniformity of universal joints, whose driven angle leads and lags twice a turn. Without them
it is a coordinate force of two terms (solver.elements.coordinate_force).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.dimensions import Angle
from solver.elements.coordinate import (
    add6,
    add_coordinate_hessian,
    add_dyad,
    add_generalized_on,
    add_gradient,
    coordinate_rate,
    coordinate_rate_gradient,
    evaluate_coordinate,
    scale6,
)
from solver.elements.coordinate_force import OUTPUTS
from solver.elements.instant import sums
from solver.elements.kind import ForceKind
from solver.elements.laws import Law, evaluate_law
from solver.elements.marker import Context, Spec, slots
from solver.validate import finite, require, vector


def require_wind_up(spec: Any) -> None:
    """Check and normalise terms and harmonics of a specification that has both. Raises SpecError."""
    require(len(spec.terms) == 2, spec.where, 'terms', spec.terms, 'needs two [coordinate, factor] pairs')
    spec.set('terms', tuple((str(c), finite(spec.where, f'factor of {c}', f)) for c, f in spec.terms))
    spec.set('harmonics', vector(spec.where, 'harmonics', spec.harmonics, 4))


@dataclass(frozen=True, kw_only=True)
class TransmissionSpec(Spec):
    """Elastic mesh over s = factor_1 x_1 + factor_2 path(x_2); see the module for the formula.

    terms: two (coordinate name, factor), the second one a rotation behind universal joints. harmonics: a_2, b_2, a_4,
    b_4 of its path [rad]. spring: law over s, damper: law over ds/dt (None: absent).
    """

    terms: tuple[tuple[str, float], ...]
    harmonics: tuple[Angle, Angle, Angle, Angle]
    spring: Law | None = None
    damper: Law | None = None

    def __post_init__(self) -> None:
        require_wind_up(self)


class TransmissionTable(NamedTuple):
    """Columns of all transmissions; bodies and blocks of term t are at 2 t (body i) and 2 t + 1 (body j)."""

    coordinate: np.ndarray  # (n,) the first, whose effort is factor Q
    term: np.ndarray  # (n, 2) both
    factor: np.ndarray  # (n, 2)
    harmonics: np.ndarray  # (n, 4)
    body: np.ndarray  # (n, 4)
    slot: np.ndarray  # (n, 4, 4) block (row body, column body)
    law: np.ndarray  # (n, 2) spring, damper


def compile_transmissions(specs: Sequence[TransmissionSpec], context: Context) -> TransmissionTable:
    """Resolve names and laws into a table."""
    n = len(specs)
    term = np.array([[context.coordinate(s.where, name) for name, _ in s.terms] for s in specs], np.int64).reshape(n, 2)
    table = TransmissionTable(
        coordinate=term[:, 0].copy(),
        term=term,
        factor=np.array([[f for _, f in s.terms] for s in specs], float).reshape(n, 2),
        harmonics=np.array([s.harmonics for s in specs], float).reshape(n, 4),
        body=np.zeros((n, 4), np.int64),
        slot=np.zeros((n, 4, 4), np.int64),
        law=np.zeros((n, 2), np.int64),
    )
    for e, spec in enumerate(specs):
        table.body[e] = [b for k in term[e] for b in context.coordinate_bodies(int(k))]
        table.slot[e] = slots(table.body[e].tolist(), context)
        table.law[e] = context.law(spec.spring), context.law(spec.damper)
    return table


@kernel(inline=True)
def path_of(table, e, x):
    """(value, slope, curvature) of the path of transmission e at x."""
    a2, b2, a4, b4 = table.harmonics[e, 0], table.harmonics[e, 1], table.harmonics[e, 2], table.harmonics[e, 3]
    s2, c2 = np.sin(2.0 * x), np.cos(2.0 * x)
    s4, c4 = 2.0 * s2 * c2, c2 * c2 - s2 * s2
    value = x + a2 * s2 + b2 * (c2 - 1.0) + a4 * s4 + b4 * (c4 - 1.0)
    slope = 1.0 + 2.0 * (a2 * c2 - b2 * s2) + 4.0 * (a4 * c4 - b4 * s4)
    curvature = -4.0 * (a2 * s2 + b2 * c2) - 16.0 * (a4 * s4 + b4 * c4)
    return value, slope, curvature


@kernel(inline=True)
def wind_up(table, coordinates, kin, angle, e):
    """(s, ds/dt, its gradients on the four bodies, how they change) of element e, whose table has the columns term,
    factor and harmonics; the last is (dx_1/dt, dx_2/dt, the gradients of x_2, factor_2 path', factor_2 path'')."""
    k0 = table.term[e, 0]
    k1 = table.term[e, 1]
    x0, g0, g1 = evaluate_coordinate(coordinates, kin, k0, angle)
    x1, g2, g3 = evaluate_coordinate(coordinates, kin, k1, angle)
    v0 = coordinate_rate(coordinates, kin, k0, g0, g1)
    v1 = coordinate_rate(coordinates, kin, k1, g2, g3)
    path, slope, curvature = path_of(table, e, x1)
    first = table.factor[e, 0]
    second = table.factor[e, 1] * slope
    g = (scale6(first, g0), scale6(first, g1), scale6(second, g2), scale6(second, g3))
    change = (v0, v1, (g2, g3), second, table.factor[e, 1] * curvature)
    return first * x0 + table.factor[e, 1] * path, first * v0 + second * v1, g, change


@kernel(inline=True)
def add_wind_up(table, coordinates, kin, e, rows, g, change, Q_1, Q_2, stiffness, damping, Kq, Kv):
    """Add the tangents of forces factor_1 Q_1 and factor_2 path' Q_2 on the two coordinates, which act on the gradients
    `rows` and change by -stiffness ds - damping d(ds/dt) there; g, change: of wind_up."""
    k0 = table.term[e, 0]
    k1 = table.term[e, 1]
    _, v1, own, second, bent = change
    first = table.factor[e, 0]
    h0, h1 = coordinate_rate_gradient(coordinates, kin, k0)
    h2, h3 = coordinate_rate_gradient(coordinates, kin, k1)
    h = (
        scale6(first, h0),
        scale6(first, h1),
        add6(scale6(second, h2), scale6(bent * v1, own[0])),
        add6(scale6(second, h3), scale6(bent * v1, own[1])),
    )
    add_generalized_on(rows, g, h, 4, stiffness, damping, table.slot, e, Kq, Kv)
    for b in range(2):
        for a in range(2):
            add_dyad(own[a], scale6(bent * Q_2, own[b]), table.slot[e, 2 + a, 2 + b], Kq)
    add_coordinate_hessian(coordinates, kin, k0, first * Q_1, Kq)
    add_coordinate_hessian(coordinates, kin, k1, second * Q_2, Kq)


@kernel(borrow=True)
def transmission_forces(table, now, effects, out):
    """Accumulate forces and tangents of all transmissions (contract: solver/elements/__init__.py)."""
    f, Kq, Kv = sums(effects)
    coordinates, kin, angle = now.coordinates, now.kin, now.angle
    for e in range(table.factor.shape[0]):
        value, rate, g, change = wind_up(table, coordinates, kin, angle, e)
        spring, stiffness, energy = evaluate_law(now.laws, table.law[e, 0], value)
        damper, damping, _ = evaluate_law(now.laws, table.law[e, 1], rate)
        Q = -spring - damper
        for a in range(4):
            add_gradient(Q, g[a], table.body[e, a], f)
        if now.tangents:
            add_wind_up(table, coordinates, kin, e, g, g, change, Q, Q, stiffness, damping, Kq, Kv)
        out[e, 0] = energy
        out[e, 1] = damper * rate
        out[e, 2] = value
        out[e, 3] = rate
        out[e, 4] = Q


TRANSMISSIONS = ForceKind(
    name='transmissions',
    spec=TransmissionSpec,
    compile=compile_transmissions,
    kernel=transmission_forces,
    outputs=OUTPUTS,
    effort='force',
)
