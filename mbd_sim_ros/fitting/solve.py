"""Least squares of a fit: Gauss-Newton with a trust region by damping, within bounds, with what is known before, and
with the curvature of the signals where residuals are so large that it counts.

It ends by the statistics of the problem: where a step would gain less than GAIN in the sum of squares, whose unit is
the variance, no unknown moves by a thousandth of its standard deviation. A step to numbers that no vehicle has, or with
which it turns over, is one that was too long. Sources: [Nocedal2006], 10.3; [Dennis1981].
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.fitting.problem import Problem
from solver.errors import MbdError, StepError

GAIN = 1e-3  # of the sum of squares: no unknown is off by more than 3 % of its sd; ten times as much: 10 %
LONGEST = 3.0  # widths of a step of the vehicle: ten times as much leaves where tires hold
# of the sum of squares: below it derivatives are central; ten times as much makes them central earlier, at twice the
# runs
NEAR = 1.0
# part of what a step promises by which it may gain more or less, for its derivatives to serve again: ten times as much
# goes astray with them
TOLD = 0.3
OLDEST = 3  # steps with the same derivatives; ten times as many creep
# of the sum of squares, gained in all by so many iterations: signals with kinks, as those of commands that are held,
# have derivatives that promise more than there is; such a fit is at rest within a third of an sd. Ten times as much:
# one sd
SLOW, LAST = 0.1, 8
MOST = 40  # iterations; ten times as many would wait for what does not converge


class Found(NamedTuple):
    """A minimum: the vector, its residuals and derivatives over the windows, the sum of squares with the prior."""

    x: np.ndarray
    motions: list[np.ndarray]
    r: np.ndarray
    J: np.ndarray
    cost: float


class Curvature:
    """The part that Gauss-Newton leaves out of half the second derivatives of a sum of squares: S (n, n), residuals
    times second derivatives of the signals.

    Where a model lacks much, residuals are large, and Gauss-Newton goes on by half of the distance to the minimum, or
    less, each time. The derivatives of one point after another tell S without a run: secants with sizing, NL2SOL
    [Dennis1981]. counts: whether the last steps went as S says rather than as Gauss-Newton does.
    """

    def __init__(self, n: int) -> None:
        self.S, self.counts = np.zeros((n, n)), False
        self._before: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    def see(self, x: np.ndarray, W: np.ndarray, white: np.ndarray) -> None:
        """Take in the point x (n,), with derivatives W (samples, n) of the signals and residuals, both whitened."""
        slope = -W.T @ white
        if self._before is not None:
            s, y = x - self._before[0], slope - self._before[2]
            across = float(y @ s)
            if across > 1e-8 * float(np.linalg.norm(y) * np.linalg.norm(s)):
                wanted = (self._before[1] - W).T @ white  # S s
                size = abs(float(s @ self.S @ s))
                self.S *= min(1.0, abs(float(s @ wanted)) / size) if size else 1.0
                rest = wanted - self.S @ s
                self.S += (np.outer(rest, y) + np.outer(y, rest)) / across
                self.S -= float(s @ rest) / across**2 * np.outer(y, y)
        self._before = x.copy(), W, slope

    def added(self, G: np.ndarray, damping: np.ndarray) -> np.ndarray:
        """The matrix of Gauss-Newton with S, where it counts and has a minimum with the damping."""
        if self.counts:
            with suppress(np.linalg.LinAlgError):
                np.linalg.cholesky(G + self.S + damping)
                return np.asarray(G + self.S)
        return G

    def judge(self, G: np.ndarray, g: np.ndarray, step: np.ndarray, gained: float) -> None:
        """Compare what a step gained with what S and Gauss-Newton alone told of it: the nearer one counts."""
        plain = float(2.0 * g @ step - step @ G @ step)
        self.counts = abs(gained - plain + float(step @ self.S @ step)) < abs(gained - plain)


def descend(
    problem: Problem,
    begin: np.ndarray | Found,
    which: Sequence[int],
    free: np.ndarray,
    say: Callable[[str], None] = lambda text: None,
    gain: float = GAIN,
    *,
    rest: bool = True,
) -> Found:
    """The minimum near a vector, or near what was found with other weights, of the residuals over windows, of those
    unknowns that are free (n, bools).

    Derivatives cost a run for every unknown: they are one-sided on the way, and those of the point before serve again
    while steps gain what they promise; in the minimum they are central, and it is left if they promise more than `gain`
    there. rest: it must come to rest within MOST iterations; False: how far it comes will do, as to where other weights
    are taken from. Raises MbdError where not even the begin can be driven.
    """
    prior, (low, high) = problem.prior, problem.bounds
    columns = np.flatnonzero(free).tolist()
    of_car = np.array([problem.unknowns[j].of == 'vehicle' for j in columns])
    if isinstance(begin, Found):
        x, motions, r, J, _ = begin
        age = 0
    else:
        x = begin
        motions = problem.motions(x, which)
        r = problem.residuals(x, which, motions)
        J = problem.jacobian(x, which, motions, columns, central=False)
        age = 0

    def cost_of(x: np.ndarray, r: np.ndarray) -> float:
        white = problem.white(r, which)
        return float(white @ white + np.sum(prior * x * x))

    cost, damping, central = cost_of(x, r), 1e-3, isinstance(begin, Found)
    costs: list[float] = []
    curvature, W = Curvature(len(columns)), np.zeros(0)
    for k in range(MOST):
        costs.append(cost)
        if k >= LAST and costs[k - LAST] - cost < SLOW:
            return Found(x, motions, r, problem.jacobian(x, which, motions, columns), cost)
        say(f'iteration {k + 1}: sum of squares {cost:.6g}')
        white = problem.white(r, which)
        if not age:
            W = problem.white(J, which)[:, columns]
            curvature.see(x[columns], W, white)
        G = W.T @ W + np.diag(prior[columns])
        g = W.T @ white - prior[columns] * x[columns]
        scale = np.diag(np.diag(G) + 1e-9)
        A = curvature.added(G, damping * scale)
        gained = expected = 0.0
        for _ in range(12):
            step = within(A + damping * scale, g, low[columns] - x[columns], high[columns] - x[columns])
            step *= min(1.0, LONGEST / max(float(np.abs(step[of_car]).max(initial=0.0)), 1e-300))
            new = x.copy()
            new[columns] = np.clip(x[columns] + step, low[columns], high[columns])
            step = new[columns] - x[columns]
            expected = float(2.0 * g @ step - step @ A @ step)
            if expected < gain:
                if A is G:
                    break
                A = G  # it is at rest only where Gauss-Newton says so too
                continue
            try:
                tried = problem.motions(new, which)
                there = problem.residuals(new, which, tried)
                now = cost_of(new, there)
            except MbdError:
                damping = max(10.0 * damping, 1e-2)
                continue
            if not age and np.isfinite(now):
                curvature.judge(G, g, step, cost - now)
            if np.isfinite(now) and cost - now > 0.1 * expected:
                gained = cost - now
                damping = max(damping * (0.1 if gained > 0.7 * expected else 1.0), 1e-6)
                x, motions, r, cost = new, tried, there, now
                age += 1
                break
            if age:  # it may be the derivatives that are old
                break
            damping = max(10.0 * damping, 1e-2)
        if abs(gained - expected) < TOLD * expected and gained > gain and age < OLDEST:
            continue
        if central and not age:
            return Found(x, motions, r, J, cost)  # nothing is gained with derivatives of this very point
        central = expected < NEAR or gained < NEAR
        J = problem.jacobian(x, which, motions, columns, central=central)
        age = 0
    if not rest:
        return Found(x, motions, r, problem.jacobian(x, which, motions, columns), cost)
    raise StepError(
        f'the fit does not come to rest within {MOST} iterations; give priors to its parameters, or fewer of them'
    )


def within(A: np.ndarray, g: np.ndarray, least: np.ndarray, most: np.ndarray) -> np.ndarray:
    """The step that solves A step = g, between bounds the minimum of the parabola there.

    A step that is only cut off leaves the other unknowns where they compensate for what does not happen: where a lag
    cannot be negative, a delay then creeps. Bounded least squares: [Stark1995].
    """
    step = np.linalg.solve(A, g)
    if ((step >= least) & (step <= most)).all():
        return np.asarray(step)
    from scipy.optimize import lsq_linear

    L = np.linalg.cholesky(A)
    return np.asarray(lsq_linear(L.T, np.linalg.solve(L, g), (least, most), method='bvls').x)
