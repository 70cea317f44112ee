"""Least squares with the same bits on every processor (docs/decisions/0008-same-bits-on-every-processor.md)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from solver.compiled.portable import inverse, product

PRIOR = 0.02  # weight of the start of a parameter against all that was measured


def each(function: Callable[..., float], *arguments: np.ndarray) -> np.ndarray:
    """A function of the C library of every number (docs/decisions/0008-same-bits-on-every-processor.md)."""
    return np.array([function(*numbers) for numbers in zip(*(a.tolist() for a in arguments), strict=True)])


def fitted(columns: list[np.ndarray], right: np.ndarray) -> np.ndarray:
    """Coefficients x of the least squares of sum columns x = right, by the normal equations of columns of unit
    length."""
    A = np.stack(columns, axis=1)
    size = np.sqrt(np.add.reduce(A * A, axis=0))
    A = A / size
    N = product(A.T.copy(), A)
    return product(inverse(N[None])[0], product(A.T.copy(), right)) / size


def least_squares(residual: Callable[[np.ndarray], np.ndarray], x: np.ndarray, *, most: int = 40) -> np.ndarray:
    """x of the smallest sum of squares of residual(x), near the start x: Levenberg-Marquardt with forward differences
    of 1e-4.

    All of x should be of order one. Source: Nocedal and Wright, Numerical Optimization, 10.3.
    """
    damping, r = 1e-3, residual(x)
    cost = float(np.add.reduce(r * r))
    for _ in range(most):
        J = np.empty((len(r), len(x)))
        for k in range(len(x)):
            moved = x.copy()
            moved[k] += 1e-4
            J[:, k] = (residual(moved) - r) / 1e-4
        N, g = product(J.T.copy(), J), product(J.T.copy(), r)
        diagonal = np.diag(N).copy()
        for _ in range(10):
            step = -product(inverse((N + damping * np.diag(diagonal + 1e-12))[None])[0], g)
            tried = residual(x + step)
            now = float(np.add.reduce(tried * tried))
            if math.isfinite(now) and now < cost:
                break
            damping *= 5.0
        else:
            return x
        gain, cost, r, x = (cost - now) / cost, now, tried, x + step
        damping = max(0.2 * damping, 1e-9)
        if gain < 1e-5:
            break
    return x
