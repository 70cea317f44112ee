"""GMRES [Saad1986]: the solution of A x = b for a matrix A that is known only by its products with vectors.

scipy.sparse.linalg.gmres would do. But importing it takes 0.28 s, a fifth of a warm start, and its bits depend on the
processor.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from solver.compiled.portable import norm, product

# Length of what a new product adds, relative to the longest column of H: anything shorter is rounding, and the system
# is singular. Ten times as much would call an ill-conditioned system singular.
ROUNDING = 1e-14
# Largest length of a solution, relative to that of the right side. Ten times as much would let a singular system answer
# with the rounding of its products.
LARGEST = 1e6


def gmres(apply: Callable[[np.ndarray], np.ndarray], right: np.ndarray, tolerance: float, limit: int) -> np.ndarray:
    """Solution x (n,) of A x = right with the least residual in the Krylov space of right, A right, A^2 right, ...

    apply: x (n,) -> A x (n,). right: (n,). tolerance: the residual |A x - right|, relative to |right|, at which
    the iteration ends. limit: the largest number of products. Of a singular system the solution is cut to LARGEST
    |right|.
    """
    size = norm(right)
    if size == 0.0:
        return np.zeros_like(right)
    basis = np.zeros((limit + 1, len(right)))
    # The Hessenberg matrix H has A basis[k] = sum over i of H[i, k] basis[i]. Givens rotations make it the triangle R.
    R = np.zeros((limit, limit))
    rotations: list[tuple[float, float]] = []  # (cosine, sine) of each
    g = np.zeros(limit + 1)  # the right side after the rotations; |g[k]| is the residual after k products
    g[0] = size
    basis[0] = right / size
    count, largest = 0, 0.0
    for k in range(limit):
        image = apply(basis[k])
        column = np.zeros(k + 2)
        for _ in range(2):  # Gram-Schmidt twice: after the first pass rounding leaves image not quite orthogonal
            along = product(basis[: k + 1], image)
            image = image - product(along, basis[: k + 1])
            column[: k + 1] += along
        column[k + 1] = rest = norm(image)
        for i, (c, s) in enumerate(rotations):
            column[i], column[i + 1] = c * column[i] + s * column[i + 1], c * column[i + 1] - s * column[i]
        a, b = column[k], column[k + 1]
        radius = math.sqrt(a * a + b * b)
        largest = max(largest, norm(column))
        if radius <= ROUNDING * largest:
            break  # a singular system: this direction would add rounding only
        rotations.append((a / radius, b / radius))
        R[:k, k], R[k, k] = column[:k], radius
        g[k], g[k + 1] = a / radius * g[k], -b / radius * g[k]
        count = k + 1
        if abs(g[k + 1]) <= tolerance * size or rest == 0.0:
            break
        basis[k + 1] = image / rest
    y = _back_substituted(R, g, count)
    while count > 0 and norm(y) > LARGEST * size:
        count -= 1
        y = _back_substituted(R, g, count)
    return product(y, basis[:count])


def _back_substituted(R: np.ndarray, g: np.ndarray, count: int) -> np.ndarray:
    """Solution y (count,) of R y = g with the first `count` rows and columns of the upper triangle R."""
    y = np.zeros(count)
    for k in range(count - 1, -1, -1):
        y[k] = (g[k] - product(R[k, k + 1 : count], y[k + 1 :])) / R[k, k]
    return y
