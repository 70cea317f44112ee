"""GMRES [Saad1986]: a linear system of which only products with vectors are known.

That of scipy would do, but its modules take 0.28 s to import, a fifth of a warm start.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def gmres(product: Callable[[np.ndarray], np.ndarray], right: np.ndarray, tolerance: float, limit: int) -> np.ndarray:
    """x (n,) for which |product(x) - right| is least among the combinations of right, product(right), ... , at most `limit` of them.

    Ends when that norm is `tolerance` times the one of right.
    """
    size = np.linalg.norm(right)
    if size == 0.0:
        return np.zeros_like(right)
    basis = np.zeros((limit + 1, len(right)))
    H = np.zeros((limit + 1, limit))  # product(basis[k]) = sum over i of H[i, k] basis[i]
    basis[0] = right / size
    for k in range(limit):
        image = product(basis[k])
        for _ in range(2):  # rounding leaves the first result not quite orthogonal
            along = basis[: k + 1] @ image
            image = image - along @ basis[: k + 1]
            H[: k + 1, k] += along
        H[k + 1, k] = np.linalg.norm(image)
        wanted = np.zeros(k + 2)
        wanted[0] = size
        y = np.linalg.lstsq(H[: k + 2, : k + 1], wanted, rcond=None)[0]
        if np.linalg.norm(H[: k + 2, : k + 1] @ y - wanted) <= tolerance * size or H[k + 1, k] == 0.0:
            break
        basis[k + 1] = image / H[k + 1, k]
    return y @ basis[: len(y)]
