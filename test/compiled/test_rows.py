"""Matrices as rows (SIMD vectors of float64, tuples of complex numbers) and what is done with them, against numpy."""

from __future__ import annotations

import numba
import numpy as np
import pytest

from solver.compiled.rows import (
    add_block,
    add_rows,
    combine2,
    combine3,
    cross_rows,
    less,
    mul_rows,
    plus,
    row,
    rows,
    sub_block,
    sub_rows,
)

EPS = np.finfo(float).eps
KINDS = ('real', 'complex')


# Rows cannot leave compiled code: results are looked at in the block that they are added to.


@numba.njit
def put(m, x, blocks, s, r):
    add_block(blocks, s, r, rows(m), rows(x))


@numba.njit
def take(m, x, blocks, s, r):
    sub_block(blocks, s, r, rows(m), rows(x))


@numba.njit
def products(m, x, blocks):
    add_block(blocks, 0, 0, mul_rows(m, rows(x)), mul_rows(x, rows(m)))


@numba.njit
def sums(m, x, blocks):
    add_block(blocks, 0, 0, add_rows(rows(m), rows(x)), sub_rows(rows(m), rows(x)))


@numba.njit
def crossed(a, x, blocks):
    add_block(blocks, 0, 0, cross_rows(a, rows(x)), rows(x))


@numba.njit
def single(m, a, blocks):
    x, y, z = rows(m)
    add_block(
        blocks, 0, 0,
        (combine2(a[0], x, a[1], y), combine3(a[0], x, a[1], y, a[2], z), row(a[0], a[1], a[2])),
        (plus(x, y), less(x, y), z),
    )  # fmt: skip


def numbers(rng, kind: str, *shape: int) -> np.ndarray:
    found = rng.normal(size=shape)
    return found + 1j * rng.normal(size=shape) if kind == 'complex' else found


def flat(array: np.ndarray) -> tuple:
    return tuple(array.ravel().tolist())


def skew(a: np.ndarray) -> np.ndarray:
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def assert_rounded(found: np.ndarray, expected: np.ndarray, terms: np.ndarray) -> None:
    """Equal up to the rounding of a sum of at most three products, whose terms add up to `terms` in absolute value."""
    assert np.all(np.abs(found - expected) <= 8 * EPS * terms)


@pytest.mark.parametrize('kind', KINDS)
def test_products_of_matrices(rng, kind):
    m, x = numbers(rng, kind, 3, 3), numbers(rng, kind, 3, 3)
    blocks = np.zeros((1, 6, 6), m.dtype)
    products(flat(m), flat(x), blocks)
    assert_rounded(blocks[0, :3, :3], m @ x, np.abs(m) @ np.abs(x))
    assert_rounded(blocks[0, :3, 3:], x @ m, np.abs(x) @ np.abs(m))
    assert not blocks[0, 3:].any()


@pytest.mark.parametrize('kind', KINDS)
def test_products_with_the_matrix_of_a_vector(rng, kind):
    a, x = numbers(rng, kind, 3), numbers(rng, kind, 3, 3)
    blocks = np.zeros((1, 6, 6), x.dtype)
    crossed(flat(a), flat(x), blocks)
    assert_rounded(blocks[0, :3, :3], skew(a) @ x, np.abs(skew(a)) @ np.abs(x))
    np.testing.assert_array_equal(blocks[0, :3, 3:], x)


@pytest.mark.parametrize('kind', KINDS)
def test_sums_and_differences(rng, kind):
    m, x = numbers(rng, kind, 3, 3), numbers(rng, kind, 3, 3)
    blocks = np.zeros((1, 6, 6), m.dtype)
    sums(flat(m), flat(x), blocks)
    np.testing.assert_array_equal(blocks[0, :3], np.hstack((m + x, m - x)))


@pytest.mark.parametrize('kind', KINDS)
def test_combinations_of_rows(rng, kind):
    m, a = numbers(rng, kind, 3, 3), numbers(rng, kind, 3)
    blocks = np.zeros((1, 6, 6), m.dtype)
    single(flat(m), flat(a), blocks)
    terms = np.abs(a) @ np.abs(m)
    assert_rounded(blocks[0, 0, :3], a[:2] @ m[:2], terms)
    assert_rounded(blocks[0, 1, :3], a @ m, terms)
    np.testing.assert_array_equal(blocks[0, 2, :3], a)
    np.testing.assert_array_equal(blocks[0, :3, 3:], [m[0] + m[1], m[0] - m[1], m[2]])


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('s', [0, 1, 3])
@pytest.mark.parametrize('r', [0, 3])
def test_half_of_a_block_changes_and_nothing_else(rng, kind, s, r):
    """Also where the memory of the blocks begins at an odd multiple of eight bytes."""
    m, x = numbers(rng, kind, 3, 3), numbers(rng, kind, 3, 3)
    before = numbers(rng, kind, 4, 6, 6)
    memory = np.zeros(before.size + 1, before.dtype)
    for kernel, sign in ((put, 1), (take, -1)):
        for offset in (0, 1):
            blocks = memory[offset : offset + before.size].reshape(before.shape)
            blocks[:] = before
            kernel(flat(m), flat(x), blocks, s, r)
            expected = before.copy()
            expected[s, r : r + 3] += sign * np.hstack((m, x))
            np.testing.assert_array_equal(blocks, expected)


def test_a_complex_step_through_the_tuples_is_the_derivative_of_the_vectors(rng):
    """d(m x) = dm x + m dx, where the real parts are those of the vectors."""
    m, x, dm, dx = (rng.normal(size=(3, 3)) for _ in range(4))
    real, moved = np.zeros((1, 6, 6)), np.zeros((1, 6, 6), complex)
    products(flat(m), flat(x), real)
    products(flat(m + 1e-40j * dm), flat(x + 1e-40j * dx), moved)
    terms = np.abs(m) @ np.abs(x)
    assert_rounded(moved[0, :3, :3].real, real[0, :3, :3], terms)
    assert_rounded(moved[0, :3, :3].imag / 1e-40, dm @ x + m @ dx, np.abs(dm) @ np.abs(x) + np.abs(m) @ np.abs(dx))
