"""Fits of the maps of the level kc: least squares, splines, laws through points."""

from __future__ import annotations

import numpy as np

from solver.compiled.portable import inverse, product
from solver.elements.laws import Law

REFINED = 4  # knots of an inverse law for one of the law


def least_squares(A: np.ndarray, y: np.ndarray) -> np.ndarray:
    """x with the smallest |A x - y|, by the normal equations of scaled columns."""
    scale = np.sqrt(np.add.reduce(A * A, axis=0))
    scale[scale == 0.0] = 1.0
    B = A / scale
    return (product(inverse(product(B.T, B)), product(B.T, y)).T / scale).T


def spline(values: np.ndarray) -> np.ndarray:
    """(n + 2, ...) coefficients of the cubic B-spline through values (n, ...) at equidistant nodes; at both ends the
    third derivative is continuous at the second node."""
    n = len(values)
    A = np.zeros((n + 2, n + 2))
    for i in range(n):
        A[i + 1, i : i + 3] = 1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0
    A[0, :5], A[-1, -5:] = (1, -4, 6, -4, 1), (1, -4, 6, -4, 1)
    right = np.zeros((n + 2, *values.shape[1:]))
    right[1:-1] = values
    return product(inverse(A), right.reshape(n + 2, -1)).reshape(right.shape)


def spring_law(travel: np.ndarray, force: np.ndarray) -> Law:
    """The law through force (n,) [N] over equidistant travel (n,) [m] with the slopes of a spline."""
    c = spline(force)
    slope = (c[2:] - c[:-2]) / (2.0 * (travel[1] - travel[0]))
    return Law(tuple(travel.tolist()), tuple(force.tolist()), tuple(slope.tolist()))


def inverse_law(law: Law) -> Law | None:
    """Rate over force of a damper whose force over rate is `law`; None where it does not rise."""
    if len(law.x) == 1:
        return Law(law.y, law.x, (1.0 / law.slope[0],)) if law.slope[0] > 0.0 else None
    x, y, slopes = (np.array(v) for v in (law.x, law.y, law.slope))
    h, t = np.diff(x)[:, None], np.arange(REFINED) / REFINED
    c1, e, g = slopes[:-1, None] * h, np.diff(y)[:, None], slopes[1:, None] * h
    c2, c3 = 3.0 * e - 2.0 * c1 - g, c1 + g - 2.0 * e
    at = np.append((x[:-1, None] + h * t).ravel(), x[-1])
    force = np.append((y[:-1, None] + t * (c1 + t * (c2 + t * c3))).ravel(), y[-1])
    slope = np.append(((c1 + t * (2.0 * c2 + 3.0 * t * c3)) / h).ravel(), slopes[-1])
    if not (slope > 1e-3 * slope.max()).all() or not (np.diff(force) > 0.0).all():
        return None
    return Law(tuple(force.tolist()), tuple(at.tolist()), tuple((1.0 / slope).tolist()))
