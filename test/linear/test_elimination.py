"""The block elimination against dense linear algebra: same factor, same solution, same products."""

from __future__ import annotations

import numpy as np
import pytest

from solver.compiled.kernel import kernel
from solver.linear.blocks import (
    WIDTH,
    add_row_products,
    add_scaled_rows,
    add_weighted_product,
    combined_block,
    rotated_block,
    subtract_weighted_rows,
)
from solver.linear.elimination import SMALLEST_PIVOT, factorize, plan_elimination, solve


def system(n: int, extra: int, seed: int):
    """A random unsymmetric block matrix on a chain of n nodes with some more couplings, dense and in blocks."""
    rng = np.random.default_rng(seed)
    pairs = {(k, k + 1) for k in range(n - 1)} | {tuple(sorted(rng.choice(n, 2, replace=False))) for _ in range(extra)}
    pattern = [(k, k) for k in range(n)] + [pair for a, b in sorted(pairs) for pair in ((a, b), (b, a))]
    slots = {(int(r), int(c)): 1 + i for i, (r, c) in enumerate(pattern)}
    plan = plan_elimination(n, slots)
    B = np.zeros((int(plan.n_blocks[0]), 6, WIDTH))
    dense = np.zeros((6 * n, 6 * n))
    for (r, c), s in slots.items():
        # dominant diagonal: no pivoting needed
        block = rng.normal(size=(6, 6)) + (12.0 * n * np.eye(6) if r == c else 0.0)
        B[s, :, :6] = block
        dense[6 * r : 6 * r + 6, 6 * c : 6 * c + 6] = block
    return plan, B, dense, rng


@pytest.mark.parametrize(('n', 'extra'), [(1, 0), (2, 1), (9, 0), (9, 12), (40, 25)])
def test_the_solution_is_that_of_the_dense_matrix(n, extra):
    plan, B, dense, rng = system(n, extra, seed=n + extra)
    right = rng.normal(size=(n, 6))
    x = np.zeros((n, WIDTH))
    x[:, :6] = right
    T = np.zeros((6, WIDTH))
    factorize(plan, B, T)
    assert T[0, 0] == -1
    solve(plan, B, x)
    expected = np.linalg.solve(dense, right.ravel()).reshape(n, 6)
    np.testing.assert_allclose(
        x[:, :6], expected, rtol=0.0, atol=1e-13 * np.linalg.cond(dense) * np.abs(expected).max()
    )
    assert not x[:, 6:].any()


def test_a_singular_pivot_names_its_node():
    plan, B, _, _ = system(3, 0, seed=1)
    node = int(plan.node[0])
    B[plan.diagonal[0], 5] = B[plan.diagonal[0], 4]
    B[plan.diagonal[0], :, 5] = B[plan.diagonal[0], :, 4]
    T = np.zeros((6, WIDTH))
    factorize(plan, B, T)
    assert T[0, 0] == node
    assert SMALLEST_PIVOT > 0.0


@kernel
def _products(B, X, Y, W, first, x, t, T, C):
    add_weighted_product(B, 1, X, 2, Y, 0, W, first)
    subtract_weighted_rows(x, 1, X, 1, t, first)
    add_row_products(t, first, Y, 1, x, 0)
    rotated_block(C, 0, X, 1, T, 2, 1.5, X, 0.0)
    combined_block(C, 1, X, 2, T, 1, -0.5, X, 0.25)


@kernel
def _scaled_rows(f, b, sign, weights, first, count, J, e):
    add_scaled_rows(f, b, sign, weights, first, count, J, e)


@pytest.mark.parametrize(('sign', 'count'), [(1.0, 6), (-1.0, 3), (1.0, 1), (-1.0, 0)])
def test_scaled_rows_are_added_to_one_body_and_read_no_further_than_their_number(sign, count):
    rng = np.random.default_rng(4)
    f, J, weights = rng.normal(size=(3, 6)), rng.normal(size=(4, 6, 6)), rng.normal(size=2 + count)
    expected = f.copy()
    expected[1] += sign * weights[2:] @ J[2, :count]
    J[2, count:] = np.nan
    _scaled_rows(f, 1, sign, weights, 2, count, J, 2)
    np.testing.assert_allclose(f, expected, rtol=0.0, atol=1e-14)


def test_products_on_blocks_are_those_of_matrices():
    rng = np.random.default_rng(3)
    X = rng.normal(size=(3, 6, 6))
    Y, B, x = np.zeros((3, 6, WIDTH)), np.zeros((3, 6, WIDTH)), np.zeros((3, WIDTH))
    for array in (Y, B, x):
        array[..., :6] = rng.normal(size=(*array.shape[:-1], 6))
    W, t, T = rng.normal(size=20), rng.normal(size=20), rng.normal(size=(3, 3, 3))
    C = np.full((3, 6, WIDTH), np.nan)
    first = 4
    turn = lambda k: np.block([[np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), T[k]]])  # noqa: E731
    sum_ = B[1, :, :6] + X[2].T @ np.diag(W[first : first + 6]) @ Y[0, :, :6]
    difference = x[1, :6] - t[first : first + 6] @ X[1]
    products = t.copy()
    products[first : first + 6] += Y[1, :, :6] @ x[0, :6]
    rotated, combined = 1.5 * X[1] @ turn(2), -0.5 * X[2] @ turn(1) + 0.25 * X[2]
    others = B[0].copy(), B[2].copy(), x[0].copy(), x[2].copy()
    _products(B, X, Y, W, first, x, t, T, C)
    close = lambda a, b: np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-13)  # noqa: E731
    close(B[1], np.pad(sum_, ((0, 0), (0, 2))))
    close(x[1], np.pad(difference, (0, 2)))
    close(t, products)
    close(C[0], np.pad(rotated, ((0, 0), (0, 2))))
    close(C[1], np.pad(combined, ((0, 0), (0, 2))))
    assert np.isnan(C[2]).all()
    for now, before in zip((B[0], B[2], x[0], x[2]), others, strict=True):
        np.testing.assert_array_equal(now, before)


@pytest.mark.parametrize(('kind', 'size'), [('chain', 'links'), ('four_bar_n', 'loops')])
def test_elimination_grows_in_proportion_to_the_bodies(kind, size):
    """Blocks and block products per body stay the same from 10 to 1000 bodies: no fill that grows."""
    from solver.files.linkages import LINKAGES
    from solver.model.compile import compile_model

    data, make = LINKAGES[kind]
    per_body = []
    for n in (10, 100, 1000):
        model = compile_model(make(data(**{size: n})))
        for plan in (model.tables.condensed, model.tables.block):
            per_body.append((int(plan.n_blocks[0]) / model.n_bodies, len(plan.update) / model.n_bodies))
    condensed, block = np.array(per_body[::2]), np.array(per_body[1::2])
    for measured in (condensed, block):
        assert (measured[2] <= 1.02 * measured[1]).all()
        assert (measured[1] <= 1.15 * measured[0]).all()  # the ends of the chain count less
