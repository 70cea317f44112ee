"""Covariance of a fit: that of weights and what is known before, and what the scatter of the windows says of it.

Windows are blocks whose residuals do not depend on each other, whatever the weights say of those within one. The
covariance that they show (the cluster-robust one of reduced bias, CR2, [Bell2002]) is right where the weights are not,
but has a scatter of its own: that of a variance with the degrees of freedom of Satterthwaite, few where few windows
tell a number. The weights have none to speak of where they are right.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import qr
from scipy.stats import t as student

from mbd_sim_ros.fitting.problem import Problem
from mbd_sim_ros.fitting.solve import Found

# weight, in inverse squared widths, of an unknown of which nothing is known before; ten times as much is still nothing
# beside what one sample tells, and keeps the matrix invertible
FAINT = 1e-12


class Scatter(NamedTuple):
    """Variances of all unknowns by the scatter of the windows (n,), and their degrees of freedom (n,)."""

    variance: np.ndarray
    freedom: np.ndarray


def scatter_of(J: np.ndarray, r: np.ndarray, rows: np.ndarray, prior: np.ndarray) -> Scatter:
    """The scatter of windows. J (samples, n), r (samples,): whitened derivatives and residuals. rows (samples,): the
    window of each. prior (n,): weights of what is known before, an observation whose variance is known.

    Where the weights are right, residuals of a window g have the covariance I - J_g C J_g^T (C: covariance of the
    fit), less than that of the errors, which is I; they are divided by its root. The variance is the sum over windows
    of (C J_g^T r_g)^2 with these residuals, and the diagonal of C P C of what is known before (P: its weights). The
    degrees of freedom are those of a variance with the same mean and scatter.
    """
    C = np.linalg.inv(J.T @ J + np.diag(prior + FAINT))
    known = np.einsum('ij,j,ji->i', C, prior, C)
    parts, sides = [], []  # of each window: error of every unknown (n,); what its residuals do to them (n, m), and R
    for k in np.unique(rows):
        own, y = J[rows == k], r[rows == k]
        Q, R = qr(own, mode='economic')
        values, V = np.linalg.eigh(R @ C @ R.T)
        root = (V / np.sqrt(np.maximum(1.0 - values, 1e-9))) @ V.T  # on the space of the derivatives
        side = C @ R.T @ root  # (n, m): error = side Q^T r
        parts.append(side @ (Q.T @ y))
        sides.append((side, R))
    variance = np.sum(np.square(parts), axis=0) + known
    n = C.shape[0]
    trace, square = np.zeros(n), np.zeros(n)
    for j in range(n):
        own = np.array([side[j] @ R for side, R in sides])  # (windows, n): w_g^T J_g
        G = -own @ C @ own.T
        G[np.diag_indices_from(G)] += [float(side[j] @ side[j]) for side, _ in sides]
        trace[j], square[j] = np.trace(G), float(np.sum(G * G))
    return Scatter(variance, (trace + known) ** 2 / np.maximum(square, 1e-300))


def covariance_of(problem: Problem, found: Found) -> tuple[np.ndarray, np.ndarray]:
    """(covariance of the vector, half intervals of 95 % by the scatter of the windows over those of the weights).

    Correlations are those of the weights; standard deviations are half intervals over 1.96, with Student's quantile in
    them. What is known before bounds them: a few windows that tell next to nothing have a quantile without bound.
    """
    which = problem.of('fit')
    J, r, prior = problem.white(found.J, which), problem.white(found.r, which), problem.prior
    whole = np.linalg.inv(J.T @ J + np.diag(prior + FAINT))
    scatter = scatter_of(J, r, problem.rows_of(which), prior)
    half = np.sqrt(scatter.variance) * student.ppf(0.975, scatter.freedom) / 1.96
    before = 1.0 / np.sqrt(np.maximum(prior, FAINT**2))
    factor = np.minimum(half, before) / np.sqrt(np.diag(whole))
    return whole * np.outer(factor, factor), factor
