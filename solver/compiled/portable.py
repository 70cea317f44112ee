"""Small dense matrices and splines with the same bits on every processor.

BLAS and LAPACK, which `@`, np.dot and np.linalg call, add in an order that depends on the processor. Here every product
is rounded before it is added, and sums have the order of np.add.reduce, which depends on nothing but the shape
(docs/decisions/0008-same-bits-on-every-processor.md). Numbers that enter a run are computed here; LAPACK does for
results that are only shown.
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
    """Euclidean length of a vector, or root of the sum of squares of an array; of any finite numbers, also if their
    squares are not."""
    x = np.asarray(x, float).ravel()
    largest = float(np.abs(x).max(initial=0.0))
    if 1e-150 < largest < 1e150 or not 0.0 < largest < math.inf:
        return math.sqrt(np.add.reduce(x * x))
    x = x / largest
    return largest * math.sqrt(np.add.reduce(x * x))


def norms(x: np.ndarray) -> np.ndarray:
    """(n,) Euclidean lengths of the rows of x (n, m)."""
    return np.sqrt(np.add.reduce(x * x, axis=1))


def inverse(A: np.ndarray) -> np.ndarray:
    """Inverses of the matrices A (..., n, n) by Gauss-Jordan elimination with row pivoting. Raises ZeroDivisionError
    for a singular one."""
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

    By Jacobi's rotations (Golub and Van Loan, Matrix Computations, 8.5), each of which makes one element beside the
    diagonal zero.
    """
    return np.array([_principal_moments(matrix) for matrix in inertia.reshape(-1, 3, 3).tolist()]).reshape(
        inertia.shape[:-1]
    )


def _principal_moments(a: list[list[float]]) -> list[float]:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = a
    small = 1e-17 * max(abs(xx), abs(yy), abs(zz), abs(xy), abs(xz), abs(yz))
    for _ in range(20):  # it converges quadratically: five sweeps are many
        if abs(xy) <= small and abs(xz) <= small and abs(yz) <= small:
            break
        xx, yy, xz, yz = _turned(xx, yy, xy, xz, yz)
        xx, zz, xy, yz = _turned(xx, zz, xz, 0.0, yz)
        yy, zz, xy, xz = _turned(yy, zz, yz, xy, 0.0)
        yz = 0.0
    return sorted((xx, yy, zz))


def _turned(pp: float, qq: float, pq: float, pr: float, qr: float) -> tuple[float, float, float, float]:
    """pp, qq, pr, qr after the rotation in the plane of p and q that makes pq zero."""
    if pq == 0.0:
        return pp, qq, pr, qr
    half = (qq - pp) / (2.0 * pq)
    t = math.copysign(1.0, half) / (abs(half) + math.sqrt(1.0 + half * half))
    c = 1.0 / math.sqrt(1.0 + t * t)
    s = t * c
    return pp - t * pq, qq + t * pq, c * pr - s * qr, s * pr + c * qr


def solve_tridiagonal(below: Numbers, diagonal: Numbers, above: Numbers, right: np.ndarray) -> np.ndarray:
    """x (n, m) with below[i] x[i-1] + diagonal[i] x[i] + above[i] x[i+1] = right[i], without pivoting: for dominant
    diagonals (n,)."""
    x = np.array(right, float, order='C')
    lower, pivots, upper = (np.asarray(band, float).tolist() for band in (below, diagonal, above))
    for i in range(1, len(x)):
        share = lower[i] / pivots[i - 1]
        pivots[i] -= share * upper[i - 1]
        x[i] -= share * x[i - 1]
    x[-1] /= pivots[-1]
    for i in range(len(x) - 2, -1, -1):
        x[i] = (x[i] - upper[i] * x[i + 1]) / pivots[i]
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


def piecewise_cubic(
    x: np.ndarray, y: np.ndarray, slopes: np.ndarray, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Value, first and second derivative, at the points `at` in [x[0], x[-1]], of the cubics with these values and
    slopes at x."""
    k = np.clip(np.searchsorted(x, at, 'right') - 1, 0, len(x) - 2)
    h, s = (x[1:] - x[:-1])[k], at - x[k]
    chord = (y[k + 1] - y[k]) / h
    c2 = (3.0 * chord - 2.0 * slopes[k] - slopes[k + 1]) / h
    c3 = (slopes[k] + slopes[k + 1] - 2.0 * chord) / (h * h)
    return (
        y[k] + s * (slopes[k] + s * (c2 + s * c3)),
        slopes[k] + s * (2.0 * c2 + 3.0 * s * c3),
        2.0 * c2 + 6.0 * s * c3,
    )
