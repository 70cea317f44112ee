"""Rotations, against scipy.spatial.transform and scipy.linalg."""

from __future__ import annotations

import numpy as np
import pytest
from interpreted import interpreted
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from solver.compiled import so3
from solver.compiled.kernel import kernel
from solver.compiled.vec import cross_cross, cross_m, m_cross, mm, skew

STEP = 1e-40
ANGLES = [0.0, 1e-12, 1e-6, 1e-3, 0.0632, 0.0633, 0.099, 0.101, 0.499, 0.501, 1.0, 2.0, 3.0, 3.14]


def random_axis(rng):
    a = rng.normal(size=3)
    return a / np.linalg.norm(a)


def matrix(m):
    return np.array(m).reshape(3, 3)


def row(m):
    return tuple(np.asarray(m).ravel().tolist())


def vec(x):
    return tuple(np.asarray(x).tolist())


@pytest.mark.parametrize('angle', ANGLES)
def test_exponential_is_the_matrix_exponential(rng, angle):
    x = angle * random_axis(rng)
    np.testing.assert_allclose(matrix(so3.exp(vec(x))), expm(matrix(skew(vec(x)))), rtol=0, atol=1e-14)
    quaternion = so3.quaternion_exp(vec(x))
    np.testing.assert_allclose(quaternion, Rotation.from_rotvec(x).as_quat(), rtol=0, atol=1e-15)
    np.testing.assert_allclose(
        matrix(so3.matrix_of_quaternion(quaternion)), matrix(so3.exp(vec(x))), rtol=0, atol=1e-14
    )


@pytest.mark.parametrize('angle', ANGLES)
def test_logarithm_inverts_the_exponential(rng, angle):
    """Also of -q, which is the same rotation. Rounding grows like 1/(pi - angle) only for matrices."""
    x = angle * random_axis(rng)
    q = np.array(so3.quaternion_exp(vec(x)))
    np.testing.assert_allclose(so3.log_quaternion(vec(q)), x, rtol=0, atol=1e-14)
    np.testing.assert_allclose(so3.log_quaternion(vec(-q)), x, rtol=0, atol=1e-14)
    np.testing.assert_allclose(so3.log(so3.exp(vec(x))), x, rtol=0, atol=1e-14)


@pytest.mark.parametrize('angle', ANGLES)
def test_right_jacobian_is_the_derivative_of_the_exponential(rng, angle):
    """exp(x + dx) = exp(x) exp(T dx), by complex step; its inverse is the inverse matrix (conditioned like 1 to 2)."""
    x = angle * random_axis(rng)
    T = matrix(so3.right_jacobian(vec(x)))
    R = matrix(so3.exp(vec(x)))
    for k in range(3):
        moved = x.astype(complex)
        moved[k] += 1j * STEP
        W = R.T @ matrix(interpreted(so3.exp)(vec(moved))).imag / STEP
        np.testing.assert_allclose([W[2, 1], W[0, 2], W[1, 0]], T[:, k], rtol=0, atol=1e-13)
    np.testing.assert_allclose(matrix(so3.right_jacobian_inverse(vec(x))) @ T, np.eye(3), rtol=0, atol=1e-13)


@pytest.mark.parametrize('angle', [*ANGLES, 4.0, 6.0])
def test_inverse_jacobian_coefficients(angle):
    """e = 1/t^2 - (1 + cos t)/(2 t sin t), and de/ds is its complex-step derivative with respect to s = t^2."""
    s = angle * angle
    e, slope = so3.inverse_jacobian_coefficients(s)
    if angle >= 0.1:
        assert e == pytest.approx(1 / s - (1 + np.cos(angle)) / (2 * angle * np.sin(angle)), rel=1e-11)
    else:
        assert e == pytest.approx(1 / 12 + s / 720, rel=s * s / 2000 + 1e-15)
    moved, _ = interpreted(so3.inverse_jacobian_coefficients)(complex(s, STEP))
    assert slope == pytest.approx(moved.imag / STEP, rel=1e-11)


@pytest.mark.parametrize('angle', [*ANGLES[:-1], 3.1])
def test_logarithm_is_smooth(rng, angle):
    """The derivative of log(exp(x) exp(d)) in d is the inverse right Jacobian, through the same code in complex
    numbers."""
    for axis in [*np.eye(3), random_axis(rng)]:
        x = angle * axis
        R = matrix(so3.exp(vec(x))).astype(complex)
        expected = matrix(so3.right_jacobian_inverse(vec(x)))
        for k in range(3):
            d = np.zeros(3)
            d[k] = 1.0
            moved = R @ (np.eye(3) + 1j * STEP * matrix(skew(vec(d))))
            derivative = np.array(interpreted(so3.log)(row(moved))).imag / STEP
            np.testing.assert_allclose(derivative, expected[:, k], rtol=0, atol=1e-12)


def test_quaternion_product_is_composition(rng):
    a, b = (Rotation.random(random_state=rng) for _ in range(2))
    product = np.array(so3.quaternion_product(vec(a.as_quat()), vec(b.as_quat())))
    expected = (a * b).as_quat()
    np.testing.assert_allclose(product * np.sign(product @ expected), expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(so3.quaternion_normalized(vec(3.0 * product))), 1.0, rtol=1e-15)


def test_quaternion_of_matrix_inverts_for_every_pivot(rng):
    """Half turns about all axes (w = 0) and random rotations; w >= 0 in the result."""
    rotations = [Rotation.from_rotvec(np.pi * a) for a in np.eye(3)]
    rotations += [Rotation.from_rotvec(t * a) for t in (3.0, -3.0, 2.2) for a in np.eye(3)]
    rotations += [Rotation.random(random_state=rng) for _ in range(20)]
    for r in rotations:
        q = np.array(so3.quaternion_of_matrix(row(r.as_matrix())))
        assert q[3] >= 0.0
        np.testing.assert_allclose(matrix(so3.matrix_of_quaternion(vec(q))), r.as_matrix(), rtol=0, atol=1e-14)


def test_products_with_skew_matrices(rng):
    a, m = vec(rng.normal(size=3)), row(rng.normal(size=(3, 3)))
    np.testing.assert_allclose(cross_m(a, m), mm(skew(a), m), rtol=0, atol=1e-15)
    np.testing.assert_allclose(m_cross(m, a), mm(m, skew(a)), rtol=0, atol=1e-15)


@kernel
def _cross_cross(a, b):
    return cross_cross(a, b)


def test_two_cross_products_as_one_matrix():
    """x x (y x z) = y (x . z) - z (x . y), by hand: with x = (1, 2, 3), y = (4, 5, 6), z = (7, 8, 10) it is (-12, 9,
    -2)."""
    M = np.array(_cross_cross((1.0, 2.0, 3.0), (4.0, 5.0, 6.0))).reshape(3, 3)
    np.testing.assert_array_equal(M @ [7.0, 8.0, 10.0], [-12.0, 9.0, -2.0])


def test_a_quaternion_that_rounding_has_moved_is_corrected_to_rounding(rng):
    """1/|q| to first order: the error is 3/8 (|q|^2 - 1)^2."""
    for off in (0.0, 1e-15, -1e-12, 1e-9):
        q = rng.normal(size=4)
        q *= (1.0 + off) / np.linalg.norm(q)
        assert abs(np.linalg.norm(so3.quaternion_corrected(tuple(q))) - 1.0) <= 4e-16 + 2.0 * off**2
