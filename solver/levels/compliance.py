"""Compliance of bushings at other points than their own, and in series: linear algebra of small displacements, and
laws."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.portable import inverse, product
from solver.elements.bushing import BushingSpec
from solver.elements.laws import Law, compile_laws, evaluate_law

RIGID = 1e12  # N/m or N m/rad of a direction without elasticity
FINER = 4  # pieces of a law in series for one of its parts
NEVER = 1e-9  # N/m or N m/rad of a direction without stiffness


def slope_at_rest(law: Law) -> float:
    """dy/dx of a law at x = 0."""
    return float(evaluate_law(_table(law), 0, 0.0)[1])


def rates(bushing: BushingSpec) -> np.ndarray:
    """(6,) stiffness along and about the axes of marker i at rest [N/m x3, N m/rad x3]."""
    pairs = zip(bushing.laws, bushing.stiffness, strict=True)
    return np.array([max(rate if law is None else slope_at_rest(law), NEVER) for law, rate in pairs])


def turning(bushing: BushingSpec, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(3, 3) rotational stiffness [N m/rad] and damping [N m s/rad] of a bushing whose marker i has the axes R."""
    k, c = rates(bushing)[3:], np.array(bushing.damping[3:])
    return product(product(R, np.diag(k)), R.T), product(product(R, np.diag(c)), R.T)


def cross_matrix(v: np.ndarray) -> np.ndarray:
    """[v]x, the matrix of v x ."""
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def at_arm(stiffness: np.ndarray, R: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """(3, 3) compliance [m/N] of a point at `arm` from a bushing with these rates along the axes R: displacement by a
    force there."""
    C = product(product(R, np.diag(1.0 / stiffness[:3])), R.T)
    Ct = product(product(R, np.diag(1.0 / stiffness[3:])), R.T)
    L = cross_matrix(arm)
    return C + product(product(L, Ct), L.T)


def solved(C: np.ndarray) -> np.ndarray:
    """The inverse of a symmetric matrix, symmetric to the last bit."""
    K = inverse(C)
    return 0.5 * (K + K.T)


def in_series(parts: Sequence[tuple[Law, float]]) -> Law:
    """The law of elements in series under a common force: extension = sum over parts of share * x, with law(x) = share
    * force.

    share: the component of the line of force along the axis of the part. Knots stay knots, with
    FINER - 1 more between two of them.
    """
    if all(len(law.x) == 1 for law, _ in parts):
        return Law.linear(1.0 / sum(share * share / law.slope[0] for law, share in parts))
    knots = sorted({y / share for law, share in parts if len(law.x) > 1 and abs(share) > 1e-6 for y in law.y} | {0.0})
    forces = [a + (b - a) * k / FINER for a, b in pairwise(knots) for k in range(FINER)] + knots[-1:]
    x, slope = [], []
    for force in forces:
        extension = softness = 0.0
        for law, share in parts:
            at, rate = _solve(law, share * force)
            extension += share * at
            softness += share * share / rate
        x.append(extension)
        slope.append(1.0 / softness)
    return Law(tuple(x), tuple(forces), tuple(slope))


def _table(law: Law) -> Ref:
    return Ref(compile_laws([law]))


def _solve(law: Law, y: float) -> tuple[float, float]:
    """(x, slope) where an increasing law has the value y: by bisection between its knots, linear beyond."""
    if len(law.x) == 1:
        return law.x[0] + (y - law.y[0]) / law.slope[0], law.slope[0]
    if y <= law.y[0]:
        return law.x[0] + (y - law.y[0]) / law.slope[0], law.slope[0]
    if y >= law.y[-1]:
        return law.x[-1] + (y - law.y[-1]) / law.slope[-1], law.slope[-1]
    table = _table(law)
    low, high = law.x[0], law.x[-1]
    for _ in range(80):
        middle = 0.5 * (low + high)
        if float(evaluate_law(table, 0, middle)[0]) < y:
            low = middle
        else:
            high = middle
    return low, float(evaluate_law(table, 0, low)[1])


def increasing(law: Law) -> bool:
    """True where a law has one value of x for every y."""
    return all(rate > 0.0 for rate in law.slope) and all(b > a for a, b in pairwise(law.y))
