"""GMRES against direct solutions."""

from __future__ import annotations

import numpy as np
import pytest

from solver.linear.gmres import gmres

RANDOM = np.random.default_rng(3)


def test_solves_a_system_to_the_tolerance_asked_for():
    A, x = RANDOM.normal(size=(30, 30)) + 12.0 * np.eye(30), RANDOM.normal(size=30)
    for tolerance in (1e-4, 1e-12):
        left = A @ gmres(lambda y: A @ y, A @ x, tolerance, 30) - A @ x
        assert np.linalg.norm(left) <= 1.01 * tolerance * np.linalg.norm(A @ x)


def test_needs_a_vector_for_each_different_eigenvalue():
    """1, 0.5 and 1e-3, each many times: three products, although the last alone would take a thousand steps of simple
    iteration."""
    values = np.repeat([1.0, 0.5, 1e-3], 20)
    products = []
    Q, _ = np.linalg.qr(RANDOM.normal(size=(60, 60)))
    A = (Q * values) @ Q.T
    x = RANDOM.normal(size=60)
    found = gmres(lambda y: products.append(1) or A @ y, A @ x, 1e-10, 40)
    assert len(products) == 3
    np.testing.assert_allclose(found, x, rtol=0, atol=1e-8)


def test_leaves_the_null_space_alone():
    """A consistent singular system: the solution has no part that the matrix maps to zero."""
    Q, _ = np.linalg.qr(RANDOM.normal(size=(20, 20)))
    A = (Q * np.array([0.0] * 5 + [1.0] * 10 + [0.1] * 5)) @ Q.T
    right = A @ RANDOM.normal(size=20)
    found = gmres(lambda y: A @ y, right, 1e-12, 20)
    np.testing.assert_allclose(A @ found, right, rtol=0, atol=1e-11)
    np.testing.assert_allclose(Q[:, :5].T @ found, 0.0, atol=1e-12)


def test_what_no_combination_reaches_is_left():
    """An inconsistent system ends at its limit, with the least norm left: the part of the right side outside of the
    range."""
    A = np.diag([1.0, 0.5, 0.0])
    left = A @ gmres(lambda y: A @ y, np.array([1.0, 1.0, 0.1]), 1e-12, 3) - [1.0, 1.0, 0.1]
    assert np.linalg.norm(left) == pytest.approx(0.1, rel=1e-6)


def test_rounding_of_a_singular_system_makes_no_solution():
    """Products with rounding of 1e-14 have an inverse where the exact ones have none; what it gives is a million times
    too large."""
    Q, _ = np.linalg.qr(RANDOM.normal(size=(20, 20)))
    A = (Q * np.array([0.0] * 5 + [1.0] * 5 + [0.7] * 5 + [0.4] * 5)) @ Q.T + 1e-14 * RANDOM.normal(size=(20, 20))
    exact = Q[:, 5:] @ RANDOM.normal(size=15)
    found = gmres(lambda y: A @ y, A @ exact + 1e-6 * Q[:, :5] @ RANDOM.normal(size=5), 1e-8, 20)
    np.testing.assert_allclose(Q[:, 5:].T @ (found - exact), 0.0, atol=1e-4)
    assert np.linalg.norm(found) < 1e6 * np.linalg.norm(exact)
