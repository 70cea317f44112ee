"""Scalar laws y(x): linear or tabulated, once continuously differentiable, with slope and integral.

Tables are interpolated by a monotone cubic and continued linearly with the end slopes, so a law has no overshoot
between its points and no kink for the Newton iteration to trip over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.kernel import kernel
from solver.validate import finite, require


@dataclass(frozen=True)
class Law:
    """Knots of a scalar law: abscissae x, values y, slopes dy/dx. One knot is a straight line."""

    x: tuple[float, ...]
    y: tuple[float, ...]
    slope: tuple[float, ...]

    @staticmethod
    def linear(rate: float, where: str = 'law', field: str = 'rate') -> Law:
        """y = rate * x."""
        return Law((0.0,), (0.0,), (finite(where, field, rate),))

    @staticmethod
    def table(points: Sequence[Sequence[float]], where: str = 'law', field: str = 'points') -> Law:
        """Monotone cubic through [[x, y], ...] with x strictly increasing (at least two points).

        Raises SpecError for fewer than two points, non-finite numbers or non-increasing x.
        """
        require(len(points) >= 2, where, field, points, 'a table needs at least two [x, y] points')
        for k, point in enumerate(points):
            require(len(point) == 2, where, f'{field}[{k}]', point, 'must be [x, y]')
        x = tuple(finite(where, f'{field}[{k}][0]', p[0]) for k, p in enumerate(points))
        y = tuple(finite(where, f'{field}[{k}][1]', p[1]) for k, p in enumerate(points))
        for k in range(1, len(x)):
            require(
                x[k] > x[k - 1], where, f'{field}[{k}][0]', x[k], f'must be greater than the x before it ({x[k - 1]:g})'
            )
        return Law(x, y, tuple(monotone_slopes(np.array(x), np.array(y)).tolist()))


def monotone_slopes(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Slopes of the monotone cubic through (x, y): inside the harmonic mean of [Fritsch1984], weighted by the
    intervals; at an end that of the parabola through three points, limited so that the curve stays monotone (Moler,
    Numerical Computing, 3.6).
    """
    h = np.diff(x)
    m = np.diff(y) / h
    if len(m) == 1:
        return np.array([m[0], m[0]])
    before, after = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
    with np.errstate(divide='ignore', invalid='ignore'):  # at a horizontal piece, where the slope is zero
        mean = (before + after) / (before / m[:-1] + after / m[1:])
    inside = np.where(m[:-1] * m[1:] > 0.0, mean, 0.0)
    return np.concatenate([[_end_slope(h[0], h[1], m[0], m[1])], inside, [_end_slope(h[-1], h[-2], m[-1], m[-2])]])


def _end_slope(h0: float, h1: float, m0: float, m1: float) -> float:
    slope = ((2.0 * h0 + h1) * m0 - h0 * m1) / (h0 + h1)
    if slope * m0 <= 0.0:
        return 0.0
    return 3.0 * m0 if m0 * m1 <= 0.0 and abs(slope) > 3.0 * abs(m0) else slope


def geared(law: Law, factor: float) -> Law:
    """factor law(factor x): a law as the coordinate x feels it whose own goes by `factor` (not 0) per unit of x."""
    knots = sorted(
        zip(
            (x / factor for x in law.x),
            (factor * y for y in law.y),
            (factor * factor * s for s in law.slope),
            strict=True,
        )
    )
    x, y, slope = zip(*knots, strict=True)
    return Law(x, y, slope)


def sum_of(laws: Sequence[Law]) -> Law:
    """The sum of laws, exactly: on the knots of all of them, since between these it is a cubic."""
    if len(laws) == 1:
        return laws[0]
    table = Ref(compile_laws(laws))
    x = sorted({knot for law in laws for knot in law.x})
    values = [[evaluate_law(table, k, knot) for k in range(len(laws))] for knot in x]
    y, slope = ([sum(value[part] for value in row) for row in values] for part in range(2))
    return Law(tuple(x), tuple(map(float, y)), tuple(map(float, slope)))


class LawTable(NamedTuple):
    """All laws of a model: knots of law k are start[k]:start[k+1]. `area` is the integral of y from the first knot."""

    start: np.ndarray
    x: np.ndarray
    y: np.ndarray
    slope: np.ndarray
    area: np.ndarray
    area_at_zero: np.ndarray


def compile_laws(laws: Sequence[Law]) -> LawTable:
    """Concatenate laws into one table."""
    start = np.zeros(len(laws) + 1, np.int64)
    start[1:] = np.cumsum([len(law.x) for law in laws])
    x = np.array([v for law in laws for v in law.x], float)
    y = np.array([v for law in laws for v in law.y], float)
    slope = np.array([v for law in laws for v in law.slope], float)
    area = np.zeros_like(x)
    for k in range(len(laws)):
        for i in range(start[k] + 1, start[k + 1]):
            h = x[i] - x[i - 1]
            area[i] = area[i - 1] + 0.5 * h * (y[i] + y[i - 1]) + h * h / 12.0 * (slope[i - 1] - slope[i])
    table = LawTable(start, x, y, slope, area, np.zeros(len(laws)))
    for k in range(len(laws)):
        table.area_at_zero[k] = evaluate_law(Ref(table), k, 0.0)[2]  # by reference, as the elements do: one compilation
    return table


@kernel(borrow=True)
def evaluate_law(laws, k, x):
    """Return (y, dy/dx, integral of y from 0 to x) of law k at x; zeros for k = -1."""
    if k < 0:
        return 0.0 * x, 0.0 * x, 0.0 * x
    a = laws.start[k]
    b = laws.start[k + 1] - 1
    if x.real <= laws.x[a]:
        d = x - laws.x[a]
        return (
            laws.y[a] + laws.slope[a] * d,
            laws.slope[a] + 0.0 * d,
            d * (laws.y[a] + 0.5 * laws.slope[a] * d) + laws.area[a] - laws.area_at_zero[k],
        )
    if x.real >= laws.x[b]:
        d = x - laws.x[b]
        return (
            laws.y[b] + laws.slope[b] * d,
            laws.slope[b] + 0.0 * d,
            d * (laws.y[b] + 0.5 * laws.slope[b] * d) + laws.area[b] - laws.area_at_zero[k],
        )
    while b - a > 1:
        m = (a + b) // 2
        if x.real < laws.x[m]:
            b = m
        else:
            a = m
    h = laws.x[b] - laws.x[a]
    t = (x - laws.x[a]) / h
    c0 = laws.y[a]
    c1 = laws.slope[a] * h
    e = laws.y[b] - laws.y[a]
    g = laws.slope[b] * h
    c2 = 3.0 * e - 2.0 * c1 - g
    c3 = c1 + g - 2.0 * e
    value = c0 + t * (c1 + t * (c2 + t * c3))
    rate = (c1 + t * (2.0 * c2 + 3.0 * t * c3)) / h
    integral = laws.area[a] + h * t * (c0 + t * (c1 / 2.0 + t * (c2 / 3.0 + t * c3 / 4.0)))
    return value, rate, integral - laws.area_at_zero[k]
