"""Dense arithmetic in a fixed order against LAPACK and scipy, to a few units in the last place of what conditions
them."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import solve_banded

from solver.compiled import elementary
from solver.compiled.portable import (
    clamped_spline_slopes,
    inverse,
    norm,
    norms,
    piecewise_cubic,
    principal_moments,
    product,
    solve_tridiagonal,
)

EPS = np.finfo(float).eps


@pytest.mark.parametrize(
    ('left', 'right'), [((3, 3), (3, 3)), ((3, 3), (3,)), ((4,), (4, 2)), ((5,), (5,)), ((2, 7), (7, 3))]
)
def test_product_is_that_of_every_kind_of_operands(left, right, rng):
    A, B = rng.normal(size=left), rng.normal(size=right)
    np.testing.assert_allclose(product(A, B), A @ B, rtol=0, atol=8 * EPS * (np.abs(A) @ np.abs(B)).max())
    transposed = np.asfortranarray(A)
    assert np.array_equal(product(transposed, B), product(A, B))  # the same bits, however the matrix lies in memory


def test_a_short_product_is_rounded_after_every_multiplication_and_addition(rng):
    """In order, without fused operations: what any processor gives."""

    def rounded(x: Fraction) -> Fraction:
        return Fraction(float(x))

    for _ in range(50):
        a, b = rng.normal(size=3), rng.normal(size=3)
        total = Fraction(0)
        for x, y in zip(a.tolist(), b.tolist(), strict=True):
            total = rounded(total + rounded(Fraction(x) * Fraction(y)))
        assert product(a, b) == float(total)
        assert product(a[None, :], b[:, None])[0, 0] == float(total)


def test_norms_of_pythagorean_numbers_are_exact():
    assert norm((2.0, 3.0, 6.0)) == 7.0
    assert norm(np.array([[1.0, 2.0], [4.0, 10.0]])) == 11.0
    assert norms(np.array([[3.0, 4.0], [5.0, 12.0]])).tolist() == [5.0, 13.0]


def test_inverse_needs_its_pivots_and_refuses_a_singular_matrix(rng):
    A = rng.normal(size=(20, 3, 3))
    A[0] = [[0.0, 1.0, 0.0], [1e-300, 0.0, 1.0], [2.0, 0.0, 0.0]]
    for a, found in zip(A, inverse(A), strict=True):
        np.testing.assert_allclose(found @ a, np.eye(3), rtol=0, atol=20 * EPS * np.linalg.cond(a))
    assert inverse(np.diag([1e-200, 2.0, 4.0])).tolist() == np.diag([1e200, 0.5, 0.25]).tolist()
    with pytest.raises(ZeroDivisionError):
        inverse(np.array([[1.0, 2.0], [2.0, 4.0]]))


def test_principal_moments_are_those_of_lapack_also_where_they_are_equal_or_zero(rng):
    wanted = np.array(
        [[1.0, 2.0, 3.0], [2.0, 2.0, 5.0], [0.0, 1.0, 1.0], [1e-12, 1e-6, 1.0], [0.0, 0.0, 0.0], [7.0, 7.0, 7.0]]
    )
    for moments in wanted:
        for _ in range(20):
            Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
            A = (Q * moments) @ Q.T
            A = 0.5 * (A + A.T)
            np.testing.assert_allclose(
                principal_moments(A), np.linalg.eigvalsh(A), rtol=0, atol=10 * EPS * max(moments)
            )
    assert principal_moments(np.stack([np.diag([3.0, 1.0, 2.0])] * 2)).tolist() == [[1.0, 2.0, 3.0]] * 2


def test_a_tridiagonal_system_is_solved(rng):
    below, above, right = rng.normal(size=(9,)), rng.normal(size=9), rng.normal(size=(9, 4))
    diagonal = 3.0 + np.abs(below) + np.abs(above)
    bands = np.array([[0.0, *above[:-1]], diagonal, [*below[1:], 0.0]])
    found = solve_tridiagonal(below, diagonal, above, right)
    np.testing.assert_allclose(found, solve_banded((1, 1), bands, right), rtol=0, atol=20 * EPS)


@pytest.mark.parametrize('n', [2, 3, 4, 30])
def test_the_clamped_spline_is_that_of_scipy(n, rng):
    x, y = np.cumsum(rng.uniform(0.1, 1.0, n)), rng.normal(size=n)
    spline = CubicSpline(x, y, bc_type='clamped')
    at = np.concatenate([x, rng.uniform(x[0], x[-1], 100)])
    size = np.abs(spline(at)).max()
    for order, values in enumerate(piecewise_cubic(x, y, clamped_spline_slopes(x, y), at)):
        np.testing.assert_allclose(values, spline(at, order), rtol=0, atol=1e3 * EPS * size / np.diff(x).min() ** order)


@pytest.mark.parametrize('name', ['sin', 'cos', 'exp'])
def test_elementary_functions_keep_the_shape_and_are_within_an_ulp_of_numpy(name, rng):
    x = rng.uniform(-3.0, 3.0, (4, 5))
    found, other = getattr(elementary, name)(x.T), getattr(np, name)(x.T)
    assert found.shape == (5, 4)
    np.testing.assert_array_max_ulp(found, other, 4)
