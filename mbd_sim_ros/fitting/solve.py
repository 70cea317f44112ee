"""Least squares of a fit: Gauss-Newton with a trust region by damping, within bounds, with what is known before.

It ends by the statistics of the problem: where a step would gain less than GAIN in the sum of squares, whose unit is
the variance, no unknown moves by a thousandth of its standard deviation. A step to numbers that no vehicle has, or with
which it turns over, is one that was too long. Source: [Nocedal2006], 10.3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.fitting.problem import Problem
from solver.errors import MbdError, StepError

GAIN = 1e-3  # of the sum of squares: no unknown is off by more than 3 % of its sd; ten times as much: 10 %
LONGEST = 3.0  # widths of a step of the vehicle: ten times as much leaves where tires hold
# of the sum of squares: below it derivatives are central; ten times as much makes them central earlier, at twice the
# runs
NEAR = 1.0
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
    for k in range(MOST):
        costs.append(cost)
        if k >= LAST and costs[k - LAST] - cost < SLOW:
            return Found(x, motions, r, problem.jacobian(x, which, motions, columns), cost)
        say(f'iteration {k + 1}: sum of squares {cost:.6g}')
        W = problem.white(J, which)[:, columns]
        A = W.T @ W + np.diag(prior[columns])
        g = W.T @ problem.white(r, which) - prior[columns] * x[columns]
        gained = expected = 0.0
        for _ in range(12):
            damped = A + damping * np.diag(np.diag(A) + 1e-9)
            step = within(damped, g, low[columns] - x[columns], high[columns] - x[columns])
            step *= min(1.0, LONGEST / max(float(np.abs(step[of_car]).max(initial=0.0)), 1e-300))
            new = x.copy()
            new[columns] = np.clip(x[columns] + step, low[columns], high[columns])
            step = new[columns] - x[columns]
            expected = float(2.0 * g @ step - step @ A @ step)
            if expected < gain:
                break
            try:
                tried = problem.motions(new, which)
                there = problem.residuals(new, which, tried)
                now = cost_of(new, there)
            except MbdError:
                damping = max(10.0 * damping, 1e-2)
                continue
            if np.isfinite(now) and cost - now > 0.1 * expected:
                gained = cost - now
                damping = max(damping * (0.1 if gained > 0.7 * expected else 1.0), 1e-6)
                x, motions, r, cost = new, tried, there, now
                age += 1
                break
            if age:  # it may be the derivatives that are old
                break
            damping = max(10.0 * damping, 1e-2)
        if gained > 0.3 * expected and gained > gain and age < OLDEST:
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
