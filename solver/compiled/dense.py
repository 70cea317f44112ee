"""Small dense matrices and splines with the same bits on every processor.

BLAS and LAPACK, which `@`, np.dot and np.linalg call, add in an order that depends on the processor. Here every product is rounded
before it is added, and sums have the order of np.add.reduce, which depends on nothing but the shape
(docs/decisions/0008-same-bits-on-every-processor.md). What enters a run is computed here; where results are only shown, LAPACK does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

Numbers = np.ndarray | Sequence[float]


def product(A: np.ndarray, B: Numbers) -> np.ndarray:
    """A B of two matrices, a matrix and a vector, a vector and a matrix, or two vectors (their scalar product)."""
    B = np.asarray(B, float)
    if B.ndim == 1:
        return np.add.reduce(A * B, axis=-1)
    return np.add.reduce(A[..., None] * B, axis=-2)


def norm(x: Numbers) -> float:
    """Euclidean length of a vector, or root of the sum of squares of an array."""
    x = np.asarray(x, float).ravel()
    return math.sqrt(np.add.reduce(x * x))


def norms(x: np.ndarray) -> np.ndarray:
    """(n,) Euclidean lengths of the rows of x (n, m)."""
    return np.sqrt(np.add.reduce(x * x, axis=1))


def inverse(A: np.ndarray) -> np.ndarray:
    """Inverses of the matrices A (..., n, n) by Gauss-Jordan elimination with row pivoting. Raises ZeroDivisionError for a singular one."""
    n = A.shape[-1]
    return np.array([_inverse(matrix) for matrix in A.reshape(-1, n, n).tolist()]).reshape(A.shape)


def _inverse(rows: list[list[float]]) -> list[list[float]]:
    n = len(rows)
    for i, row in enumerate(rows):
        row += [float(i == j) for j in range(n)]
    for k in range(n):
        best = max(range(k, n), key=lambda i: abs(rows[i][k]))
        rows[k], rows[best] = rows[best], rows[k]
        pivot = rows[k] = [x / rows[k][k] for x in rows[k]]
        for i, row in enumerate(rows):
            if i != k and row[k] != 0.0:
                rows[i] = [x - row[k] * y for x, y in zip(row, pivot, strict=True)]
    return [row[n:] for row in rows]


def principal_moments(inertia: np.ndarray) -> np.ndarray:
    """(..., 3) eigenvalues of the symmetric matrices inertia (..., 3, 3), ascending.

    By Jacobi's rotations (Golub and Van Loan, Matrix Computations, 8.5), each of which makes one element beside the diagonal zero.
    """
    return np.array([_principal_moments(matrix) for matrix in inertia.reshape(-1, 3, 3).tolist()]).reshape(inertia.shape[:-1])


def _principal_moments(a: list[list[float]]) -> list[float]:
    size = max(abs(x) for row in a for x in row)
    for _ in range(20):  # it converges quadratically: five sweeps are many
        if max(abs(a[0][1]), abs(a[0][2]), abs(a[1][2])) <= 1e-17 * size:
            break
        for p, q in ((0, 1), (0, 2), (1, 2)):
            if a[p][q] == 0.0:
                continue
            half = (a[q][q] - a[p][p]) / (2.0 * a[p][q])
            t = math.copysign(1.0, half) / (abs(half) + math.sqrt(1.0 + half * half))
            c = 1.0 / math.sqrt(1.0 + t * t)
            s, r = t * c, 3 - p - q
            a[p][p], a[q][q] = a[p][p] - t * a[p][q], a[q][q] + t * a[p][q]
            a[p][r], a[q][r] = c * a[p][r] - s * a[q][r], s * a[p][r] + c * a[q][r]
            a[r][p], a[r][q] = a[p][r], a[q][r]
            a[p][q] = a[q][p] = 0.0
    return sorted(a[i][i] for i in range(3))


def solve_tridiagonal(below: Numbers, diagonal: Numbers, above: Numbers, right: np.ndarray) -> np.ndarray:
    """x (n, m) with below[i] x[i-1] + diagonal[i] x[i] + above[i] x[i+1] = right[i], without pivoting: for dominant diagonals (n,)."""
    x = np.array(right, float, order='C')
    factor, pivot = [], float(diagonal[0])
    x[0] /= pivot
    for i in range(1, len(x)):
        factor.append(float(above[i - 1]) / pivot)
        pivot = float(diagonal[i]) - float(below[i]) * factor[-1]
        x[i] = (x[i] - below[i] * x[i - 1]) / pivot
    for i in range(len(x) - 2, -1, -1):
        x[i] -= factor[i] * x[i + 1]
    return x


def clamped_spline_slopes(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(n,) slopes at the points (x, y), x increasing, of the cubic spline with horizontal ends.

    Its second derivative is continuous: s[i-1] / h[i-1] + 2 s[i] (1 / h[i-1] + 1 / h[i]) + s[i+1] / h[i] =
    3 (d[i-1] / h[i-1] + d[i] / h[i]) with the intervals h and the slopes d of the chords.
    """
    slopes = np.zeros(len(x))
    if len(x) > 2:
        weight = 1.0 / np.diff(x)
        chord = 3.0 * weight * np.diff(y) * weight
        sides = (weight[:-1].copy(), 2.0 * (weight[:-1] + weight[1:]), weight[1:].copy())
        slopes[1:-1] = solve_tridiagonal(*sides, (chord[:-1] + chord[1:])[:, None])[:, 0]
    return slopes


def piecewise_cubic(x: np.ndarray, y: np.ndarray, slopes: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Value, first and second derivative, at the points `at` in [x[0], x[-1]], of the cubics with these values and slopes at x."""
    k = np.clip(np.searchsorted(x, at, 'right') - 1, 0, len(x) - 2)
    h, s = (x[1:] - x[:-1])[k], at - x[k]
    chord = (y[k + 1] - y[k]) / h
    c2 = (3.0 * chord - 2.0 * slopes[k] - slopes[k + 1]) / h
    c3 = (slopes[k] + slopes[k + 1] - 2.0 * chord) / (h * h)
    return y[k] + s * (slopes[k] + s * (c2 + s * c3)), slopes[k] + s * (2.0 * c2 + 3.0 * s * c3), 2.0 * c2 + 6.0 * s * c3
