"""Figures with 95 % intervals from samples that are correlated in time.

The moments of a drive are cut into successive stretches of equal time, up to STRETCHES. A figure is computed from all
of them and again without each one in turn, the jackknife that deletes a block [Kunsch1989]:

    se^2 = (G - 1)/G sum over g of (figure without g - figure)^2

Residuals may be correlated in any way within a stretch. Where those of neighbouring stretches are still correlated, two
are taken together, twice at most. A figure may rest on few stretches, one long bend say: with w_g, the information of a
stretch on the figure, G* = (sum w)^2 / sum w^2 stretches count [Carter2017]. The interval is that of Student's t with
G* - 1 degrees of freedom. A figure that rests on fewer than LEAST stretches is not told.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from typing import NamedTuple

import numpy as np

STRETCHES = 32  # a power of two; ten times as many are shorter than the memory of a car
SHORTEST = 1.5  # s of a stretch at least; ten times as much leaves a drive of two minutes with eight of them
MERGED = 8  # stretches at least after merging; fewer widen Student's interval more than they gain
LEAST = 3.0  # stretches at least that a figure rests on; with ten times as many hardly any drive would tell one
# Standard errors by which the correlation of neighbouring stretches is above zero, from which on they are merged.
CORRELATED = 1.5
# Largest condition number of the normal equations in columns of length one; beyond, columns are taken as dependent.
DEPENDENT = 1e9
STEP = 1e-6  # of the derivative of a figure, relative to its largest coefficient; 1e-16 is rounding, 1 is no step
LEVEL = 0.975  # quantile of Student's t: a two-sided interval of 95 %


class Estimate(NamedTuple):
    """A figure. value, low, high: with its 95 % interval, NaN where it is not told. why: the reason then, '' else."""

    value: float
    low: float = math.nan
    high: float = math.nan
    why: str = ''

    @property
    def told(self) -> bool:
        """True where there is a value with an interval."""
        return not self.why

    @property
    def half(self) -> float:
        """Half the width of the interval."""
        return 0.5 * (self.high - self.low)

    def outside(self, low: float, high: float) -> bool:
        """True where the figure is told and its whole interval is outside low to high."""
        return self.told and (self.high < low or self.low > high)

    def times(self, factor: float) -> Estimate:
        """The figure and its interval in another unit."""
        low, high = sorted((factor * self.low, factor * self.high)) if self.told else (math.nan, math.nan)
        return Estimate(factor * self.value, low, high, self.why)


def not_told(why: str) -> Estimate:
    """A figure that is not told, for this reason."""
    return Estimate(math.nan, why=why)


def stretches(count: int, rate: float) -> np.ndarray:
    """(count,) number of the stretch, below STRETCHES, of each of the samples of a figure, `rate` of them a second.

    Stretches last SHORTEST at least: a low-passed signal is correlated for as long. There are then a power of two of
    them, with numbers as far apart as whole ones are after merging.
    """
    many = count / rate / SHORTEST
    some = min(STRETCHES, 2 ** int(math.log2(many))) if many >= 1.0 else 1
    return np.arange(count) * some // max(count, 1) * (STRETCHES // some)


def estimate(value: float, without: np.ndarray, weights: np.ndarray) -> Estimate:
    """Figure with its interval. without: (G,) the figure without each stretch. weights: (G,) information of each."""
    total = float(weights.sum())
    effective = total**2 / float(weights @ weights) if total > 0.0 else 0.0
    if effective < LEAST or without.size < 2:
        return not_told(f'it rests on {effective:.1f} independent stretches, at least {LEAST:g} are needed')
    if not (math.isfinite(value) and np.isfinite(without).all()):
        return not_told('without one of its stretches the drive does not give it')
    from scipy.special import stdtrit

    spread = math.sqrt((without.size - 1) / without.size * float(np.sum((without - value) ** 2)))
    half = float(stdtrit(effective - 1.0, LEVEL)) * spread
    return Estimate(value, value - half, value + half)


class Regression:
    """Least squares with the estimates without each stretch.

    X: (m, p) columns. y: (m,). stretch: (m,) number of the stretch of each sample, as of stretches(). dependent: True
    where the columns depend on each other. theta: (p,) coefficients, NaN then.
    """

    def __init__(self, X: np.ndarray, y: np.ndarray, stretch: np.ndarray) -> None:
        self.scale = np.sqrt(np.mean(X * X, axis=0)) if X.size else np.ones(X.shape[1])
        self.scale[self.scale == 0.0] = 1.0
        Z = X / self.scale
        ends = np.searchsorted(stretch, np.arange(STRETCHES + 1))
        parts = [slice(a, b) for a, b in pairwise(ends)]
        self.A = np.stack([Z[k].T @ Z[k] for k in parts])
        self.b = np.stack([Z[k].T @ y[k] for k in parts])
        whole = self.A.sum(axis=0)
        self.dependent = X.shape[0] < 2 * X.shape[1] or not np.linalg.cond(whole) < DEPENDENT
        self.theta = np.full(X.shape[1], math.nan)
        if not self.dependent:
            self.theta = np.linalg.solve(whole, self.b.sum(axis=0)) / self.scale

    def estimate(self, of: Callable[[np.ndarray], float]) -> Estimate:
        """The figure of(coefficients) with its interval."""
        if self.dependent:
            return not_told('what it depends on does not vary independently')
        A, b = self.A, self.b
        found = self.theta * self.scale
        # to first order the figure is a sum of residuals times X @ direction
        direction = np.linalg.solve(A.sum(axis=0), self._slope(of, found))
        while A.shape[0] // 2 >= MERGED and _follow((b - A @ found) @ direction):
            A, b = A[0::2] + A[1::2], b[0::2] + b[1::2]
        weights = np.einsum('i,gij,j->g', direction, A, direction)
        there = weights > 0.0
        A, b, weights = A[there], b[there], weights[there]
        rest = A.sum(axis=0) - A
        if not np.all(np.linalg.cond(rest) < DEPENDENT):
            return not_told('what it depends on varies independently in one stretch alone')
        others = np.linalg.solve(rest, (b.sum(axis=0) - b)[..., None])[..., 0]
        return estimate(of(self.theta), np.array([of(one / self.scale) for one in others]), weights)

    def _slope(self, of: Callable[[np.ndarray], float], found: np.ndarray) -> np.ndarray:
        """(p,) derivative of a figure by the coefficients of columns of length one."""
        step = STEP * float(np.abs(found).max() or 1.0)
        moved = [found + k * step * one for one in np.eye(found.size) for k in (1.0, -1.0)]
        values = np.array([of(one / self.scale) for one in moved])
        return (values[0::2] - values[1::2]) / (2.0 * step)


def _follow(scores: np.ndarray) -> bool:
    """True where the sums of neighbouring stretches (G,) are correlated."""
    power = float(scores @ scores)
    return power > 0.0 and float(scores[1:] @ scores[:-1]) / power > CORRELATED / math.sqrt(scores.size)


def quantile(values: np.ndarray, stretch: np.ndarray, part: float) -> Estimate:
    """The quantile `part` of values (m,), with the interval by leaving out each stretch."""
    if values.size < 2 * STRETCHES:
        return not_told(f'only {values.size} samples')
    value = float(np.quantile(values, part))
    without = [float(np.quantile(values[stretch != g], part)) for g in np.unique(stretch)]
    return estimate(value, np.array(without), np.ones(len(without)))
