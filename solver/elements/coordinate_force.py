"""Coordinate force: a generalized force along a linear combination of joint coordinates.

    s = sum of factor_k x_k       Q = -spring(s - reference) - damper(ds/dt) - preload + share(ds/dt) input_gain u
    generalized force on coordinate k: factor_k Q

One term and a spring: torsional spring, or a bump stop with a tabulated law. Two terms (+1, -1): anti-roll bar. An
input: drive torque, steering force. Q > 0 pushes towards larger s. With a top_rate the input is that of a machine with
a speed limiter: share is 1 below 95 % of that rate and falls to 0 at it (a cubic, the droop of a governor), where the
input drives; where it brakes it is 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
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
from solver.elements.laws import Law, evaluate_law
from solver.elements.marker import Context, Spec, slots
from solver.validate import finite, require

OUTPUTS = {'energy': 'J', 'dissipation': 'W', 'value': 'm or rad', 'rate': 'm/s or rad/s', 'force': 'N or N m'}
MAX_TERMS = 3
LIMITER_FROM = 0.95  # share of top_rate from which the input fades


def checked_terms(where: str, terms: Sequence[Sequence[Any]]) -> tuple[tuple[str, float], ...]:
    """Up to MAX_TERMS pairs (coordinate name, factor). Raises SpecError."""
    require(1 <= len(terms) <= MAX_TERMS, where, 'terms', terms, f'needs 1 to {MAX_TERMS} [coordinate, factor] pairs')
    for k, one in enumerate(terms):
        require(len(one) == 2, where, f'terms[{k}]', one, 'must be [coordinate, factor]')
    return tuple((str(c), finite(where, f'factor of {c}', f)) for c, f in terms)


class Combination(NamedTuple):
    """Columns of linear combinations of coordinates; bodies and blocks of term t are at 2 t (body i) and 2 t + 1 (body
    j)."""

    terms: np.ndarray  # (n,) number of terms
    coordinate: np.ndarray  # (n, 3)
    factor: np.ndarray  # (n, 3)
    body: np.ndarray  # (n, 6)
    slot: np.ndarray  # (n, 6, 6) block (row body, column body); unused beyond 2 * terms


def compile_combinations(specs: Sequence[Any], context: Context) -> Combination:
    """Resolve the names in the terms of specifications."""
    n, most = len(specs), MAX_TERMS
    table = Combination(
        terms=np.array([len(s.terms) for s in specs], np.int64),
        coordinate=np.zeros((n, most), np.int64),
        factor=np.zeros((n, most)),
        body=np.full((n, 2 * most), context.n_bodies, np.int64),
        slot=np.zeros((n, 2 * most, 2 * most), np.int64),
    )
    for e, spec in enumerate(specs):
        bodies: list[int] = []
        for t, (name, factor) in enumerate(spec.terms):
            table.coordinate[e, t] = context.coordinate(spec.where, name)
            table.factor[e, t] = factor
            bodies += context.coordinate_bodies(int(table.coordinate[e, t]))
        table.body[e, : len(bodies)] = bodies
        table.slot[e, : len(bodies), : len(bodies)] = slots(bodies, context)
    return table


@dataclass(frozen=True, kw_only=True)
class CoordinateForceSpec(Spec):
    """Force along s = sum of factor * coordinate; see the module for the formula.

    terms: up to three (coordinate name, factor); spring: law over s - reference, damper: law over ds/dt (None: absent);
    reference: value of s at which the spring is free; preload is added to spring and damper; input: channel whose value
    times input_gain is added to Q, up to the rate top_rate of s (None: without limit). Units follow the coordinates: N
    and m for translations, N m and rad for rotations.
    """

    terms: tuple[tuple[str, float], ...]
    spring: Law | None = None
    damper: Law | None = None
    reference: float = 0.0
    preload: float = 0.0
    input: str | None = None
    input_gain: float = 1.0
    top_rate: float | None = None

    def __post_init__(self) -> None:
        self.set('terms', checked_terms(self.where, self.terms))
        for field in ('reference', 'preload', 'input_gain'):
            self.set(field, finite(self.where, field, getattr(self, field)))
        if self.top_rate is not None:
            self.set('top_rate', finite(self.where, 'top_rate', self.top_rate, low=0.0, strict=True))
            require(
                self.input is not None,
                self.where,
                'top_rate',
                self.top_rate,
                'limits an input: name the input or remove it',
            )


class CoordinateForceTable(NamedTuple):
    """Columns of all coordinate forces; the first five are those of Combination."""

    terms: np.ndarray  # (n,) number of terms
    coordinate: np.ndarray  # (n, 3)
    factor: np.ndarray  # (n, 3)
    body: np.ndarray  # (n, 6)
    slot: np.ndarray  # (n, 6, 6)
    law: np.ndarray  # (n, 2) spring, damper
    reference: np.ndarray  # (n,)
    preload: np.ndarray  # (n,)
    input: np.ndarray  # (n,) -1 for none
    input_gain: np.ndarray  # (n,)
    top_rate: np.ndarray  # (n,) 0 for none


def compile_coordinate_forces(specs: Sequence[CoordinateForceSpec], context: Context) -> CoordinateForceTable:
    """Resolve names and laws into a table."""
    return CoordinateForceTable(
        **compile_combinations(specs, context)._asdict(),
        law=np.array([(context.law(s.spring), context.law(s.damper)) for s in specs], np.int64).reshape(-1, 2),
        reference=np.array([s.reference for s in specs], float),
        preload=np.array([s.preload for s in specs], float),
        input=np.array([-1 if s.input is None else context.input(s.where, s.input) for s in specs], np.int64),
        input_gain=np.array([s.input_gain for s in specs], float),
        top_rate=np.array([s.top_rate or 0.0 for s in specs], float),
    )


@kernel(inner=True)
def term(table, coordinates, kin, angle, e, t):
    """Return (x, dx/dt, g_i, g_j) of term t times its factor, zeros for an absent one: value, rate and the gradients of
    the value."""
    zero = 0.0 * kin.p[0, 0]
    if t >= table.terms[e]:
        none = ((zero, zero, zero), (zero, zero, zero))
        return zero, zero, none, none
    k = table.coordinate[e, t]
    factor = table.factor[e, t]
    x, g_i, g_j = evaluate_coordinate(coordinates, kin, k, angle)
    rate = coordinate_rate(coordinates, kin, k, g_i, g_j)
    return factor * x, factor * rate, scale6(factor, g_i), scale6(factor, g_j)


@kernel(inner=True)
def rate_gradient(table, coordinates, kin, e, t, needed):
    """Gradients of the rate of term t times its factor; zeros for an absent one, and unless they are needed."""
    zero = 0.0 * kin.p[0, 0]
    if not needed or t >= table.terms[e]:
        none = ((zero, zero, zero), (zero, zero, zero))
        return none, none
    h_i, h_j = coordinate_rate_gradient(coordinates, kin, table.coordinate[e, t])
    factor = table.factor[e, t]
    return scale6(factor, h_i), scale6(factor, h_j)


@kernel(inline=True)
def limited(applied, rate, top):
    """Return (force, d force/d rate) of an input `applied` at the rate ds/dt of s under a limiter at the rate `top` (0:
    none)."""
    full = applied + 0.0 * rate
    if top == 0.0:
        return full, 0.0 * rate
    forward = 1.0 if applied > 0.0 else -1.0
    width = (1.0 - LIMITER_FROM) * top
    x = (forward * rate - LIMITER_FROM * top) / width
    if x.real <= 0.0:
        return full, 0.0 * rate
    if x.real >= 1.0:
        return 0.0 * rate, 0.0 * rate
    return applied * (1.0 - x * x * (3.0 - 2.0 * x)), -forward * applied * 6.0 * x * (1.0 - x) / width


@kernel(borrow=True)
def coordinate_forces(table, now, effects, out):
    """Accumulate forces and tangents of all coordinate forces (contract: solver/elements/__init__.py)."""
    f, Kq, Kv = sums(effects)
    coordinates, kin, angle = now.coordinates, now.kin, now.angle
    for e in range(table.terms.shape[0]):
        x0, v0, g0, g1 = term(table, coordinates, kin, angle, e, 0)
        x1, v1, g2, g3 = term(table, coordinates, kin, angle, e, 1)
        x2, v2, g4, g5 = term(table, coordinates, kin, angle, e, 2)
        g = (g0, g1, g2, g3, g4, g5)
        value = x0 + x1 + x2
        rate = v0 + v1 + v2
        x = value - table.reference[e]
        spring, stiffness, energy = evaluate_law(now.laws, table.law[e, 0], x)
        damper, damping, _ = evaluate_law(now.laws, table.law[e, 1], rate)
        given = 0.0
        if table.input[e] >= 0:
            given = table.input_gain[e] * now.u[table.input[e]]
        applied, fading = limited(given, rate, table.top_rate[e])
        damping = damping - fading
        Q = applied - spring - damper - table.preload[e]
        for a in range(2 * table.terms[e]):
            add_gradient(Q, g[a], table.body[e, a], f)
        if now.tangents:
            # a torque that is only applied, below its limiter, has neither stiffness nor damping
            damped = damping != 0.0
            h0, h1 = rate_gradient(table, coordinates, kin, e, 0, damped)
            h2, h3 = rate_gradient(table, coordinates, kin, e, 1, damped)
            h4, h5 = rate_gradient(table, coordinates, kin, e, 2, damped)
            h = (h0, h1, h2, h3, h4, h5)
            add_generalized(g, h, 2 * table.terms[e], stiffness, damping, table.slot, e, Kq, Kv)
            for t in range(table.terms[e]):
                add_coordinate_hessian(coordinates, kin, table.coordinate[e, t], table.factor[e, t] * Q, Kq)
        out[e, 0] = energy + table.preload[e] * x
        out[e, 1] = (damper - applied) * rate
        out[e, 2] = value
        out[e, 3] = rate
        out[e, 4] = Q


COORDINATE_FORCES = ForceKind(
    name='coordinate_forces',
    spec=CoordinateForceSpec,
    compile=compile_coordinate_forces,
    kernel=coordinate_forces,
    outputs=OUTPUTS,
    supplies=True,
    effort='force',
)
