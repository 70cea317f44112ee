"""GMRES [Saad1986]: a linear system of which only products with vectors are known.

That of scipy would do, but its modules take 0.28 s to import, a fifth of a warm start, and its bits depend on the processor.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from solver.compiled.portable import norm, product

ROUNDING = 1e-14
LARGEST = 1e6  # of a solution, relative to the right side


def gmres(times: Callable[[np.ndarray], np.ndarray], right: np.ndarray, tolerance: float, limit: int) -> np.ndarray:
    """x (n,) for which |times(x) - right| is least among the combinations of right, times(right), ... , at most `limit` of them.

    Ends when that norm is `tolerance` times the one of right. The solution of a singular system is no larger than
    LARGEST times right: beyond that it would be one of the rounding of its products.
    """
    size = norm(right)
    if size == 0.0:
        return np.zeros_like(right)
    basis = np.zeros((limit + 1, len(right)))
    R = np.zeros((limit, limit))  # upper triangle that Givens' rotations leave of H, times(basis[k]) = sum over i of H[i, k] basis[i]
    turns: list[tuple[float, float]] = []
    g = np.zeros(limit + 1)  # right in the turned basis; the last number is what is left of it
    g[0] = size
    basis[0] = right / size
    count, largest = 0, 0.0
    for k in range(limit):
        image = times(basis[k])
        column = np.zeros(k + 2)
        for _ in range(2):  # rounding leaves the first result not quite orthogonal
            along = product(basis[: k + 1], image)
            image = image - product(along, basis[: k + 1])
            column[: k + 1] += along
        column[k + 1] = rest = norm(image)
        for i, (c, s) in enumerate(turns):
            column[i], column[i + 1] = c * column[i] + s * column[i + 1], c * column[i + 1] - s * column[i]
        a, b = column[k], column[k + 1]
        radius = math.sqrt(a * a + b * b)
        largest = max(largest, norm(column))
        if radius <= ROUNDING * largest:
            break  # a singular system: what this direction would add is rounding
        turns.append((a / radius, b / radius))
        R[:k, k], R[k, k] = column[:k], radius
        g[k], g[k + 1] = a / radius * g[k], -b / radius * g[k]
        count = k + 1
        if abs(g[k + 1]) <= tolerance * size or rest == 0.0:
            break
        basis[k + 1] = image / rest
    y = _solved(R, g, count)
    while count > 0 and norm(y) > LARGEST * size:
        count -= 1
        y = _solved(R, g, count)
    return product(y, basis[:count])


def _solved(R: np.ndarray, g: np.ndarray, count: int) -> np.ndarray:
    y = np.zeros(count)
    for k in range(count - 1, -1, -1):
        y[k] = (g[k] - product(R[k, k + 1 : count], y[k + 1 :])) / R[k, k]
    return y
