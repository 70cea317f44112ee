"""Residuals: white noise of the sensor, and what the model lacks, which is correlated in time.

A residual of a channel is noise + discrepancy, both with mean zero, with the covariance

    C(t, t') = noise^2 [t = t'] + size^2 exp(-|t - t'| / time)

in a window, none between windows. It is estimated from the residuals of a fit by their autocovariances, and the next
fit weights with it ([Kennedy2001], model discrepancy; the exponential is that of a lag driven by noise).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular


class Noise(NamedTuple):
    """The residuals of a channel: noise between samples, size of the discrepancy, its correlation time [s]."""

    noise: float
    size: float
    time: float

    def factor(self, t: np.ndarray) -> np.ndarray:
        """Lower Cholesky factor of the covariance at the times t [s]."""
        C = self.size**2 * np.exp(-np.abs(t[:, None] - t[None, :]) / self.time)
        C[np.diag_indices(t.size)] += max(self.noise, 0.03 * self.size, 1e-12) ** 2
        return np.asarray(cholesky(C, lower=True))


def whitened(L: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (n, ...) over a Cholesky factor: uncorrelated, with variance 1."""
    return np.asarray(solve_triangular(L, values, lower=True))


LEAST = (
    0.05  # part of the RMS of residuals that noise and discrepancy have at least: ten times as much hides one of them
)
LONGEST, TRIED = 1.0, 60  # longest correlation time, in windows, and how many are tried: steps of 15 %
LAGS = 0.4  # part of a window over which correlations are looked at; of longer ones few pairs are left


def estimated(pieces: Sequence[tuple[np.ndarray, np.ndarray]], floor: float) -> Noise:
    """The noise of a channel from its residuals, (times, values) by window. floor: least size of either part.

    Autocovariances c_k about zero over all windows: size^2 exp(-k step / time) for k > 0, and noise^2 more at 0. The
    time is the one of many with which that fits best.
    """
    step = float(np.median(np.concatenate([np.diff(t) for t, _ in pieces])))
    length = float(np.median([t[-1] - t[0] for t, _ in pieces]))
    most = max(3, int(LAGS * length / step))
    sums, counts = np.zeros(most + 1), np.zeros(most + 1)
    for t, r in pieces:
        at = np.round((t - t[0]) / step).astype(int)
        dense = np.zeros(at[-1] + 1)
        there = np.zeros(at[-1] + 1)
        dense[at], there[at] = r, 1.0
        for k in range(min(most, at[-1]) + 1):
            sums[k] += float(dense[: dense.size - k] @ dense[k:])
            counts[k] += float(there[: there.size - k] @ there[k:])
    c = sums / np.maximum(counts, 1.0)
    total = max(c[0], floor**2)
    lags = np.arange(1, most + 1)
    weights = counts[1:]
    best = (math.inf, 0.0, step)
    for time in np.geomspace(0.5 * step, LONGEST * length, TRIED).tolist():
        shape = np.exp(-lags * step / time)
        size2 = max(float(np.sum(weights * shape * c[1:]) / np.sum(weights * shape * shape)), 0.0)
        error = float(np.sum(weights * (c[1:] - size2 * shape) ** 2))
        if error < best[0]:
            best = (error, size2, time)
    _, size2, time = best
    size2 = min(size2, total)
    noise2 = max(total - size2, LEAST**2 * total)
    return Noise(math.sqrt(noise2), math.sqrt(max(size2, LEAST**2 * total)), time)
