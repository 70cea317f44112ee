"""Joint coordinates: value, gradient, rate gradient and Hessian."""

from __future__ import annotations

import numpy as np
import pytest
from contract import STEP, ContractContext, acting, displaced, kinematics, random_kinematics
from scipy.spatial.transform import Rotation

from solver.elements.coordinate import (
    CoordinateSpec,
    add_coordinate_hessian,
    coordinate_rate,
    coordinate_rate_gradient,
    evaluate_coordinate,
)
from solver.elements.marker import Marker
from solver.elements.point_pair import Kinematics
from solver.errors import SpecError

KINDS = ('translation', 'rotation')


def random_coordinate(rng, kind, *, i='b0', j='b1'):
    def marker(body):
        return Marker(body=body, position=rng.normal(size=3), orientation=Rotation.random(random_state=rng).as_quat())

    context = ContractContext(
        com=rng.normal(size=(2, 3)), coordinates=[CoordinateSpec(name='c', kind=kind, i=marker(i), j=marker(j))]
    )
    return context.coordinate_table(), context


def gradient(table, kin, angle):
    """Value and gradient as (12,) with respect to the variations of b0 and b1 (zeros for a body that is not
    involved)."""
    x, g_i, g_j = acting(evaluate_coordinate, table)(kin, 0, angle)
    g = np.zeros((3, 6), kin.p.dtype)
    for b, h in zip(table.body[0], (g_i, g_j), strict=True):
        g[b] += np.array([*h[0], *h[1]])
    return x, g[:2].ravel()


def unit_variations():
    for k in range(12):
        e = np.zeros(12)
        e[k] = 1.0
        yield k, e.reshape(2, 6)


ANGLE = np.zeros(1)
BODIES = [('b0', 'b1'), ('world', 'b1'), ('b0', 'world')]


@pytest.mark.parametrize(('i', 'j'), BODIES)
@pytest.mark.parametrize('kind', KINDS)
def test_gradient_hessian_and_rate_gradient_are_the_complex_step_derivatives(rng, kind, i, j):
    """To rounding (1e-12 of the largest entry), for any placement of the two frames."""
    table, _ = random_coordinate(rng, kind, i=i, j=j)
    still = np.zeros((2, 6))
    for _ in range(4):
        kin = random_kinematics(rng, 2)
        _, g = gradient(table, kin, ANGLE)
        blocks = np.zeros((5, 6, 6))
        acting(add_coordinate_hessian, table)(kin, 0, 0.7, blocks)
        H = blocks[1:].reshape(2, 2, 6, 6).transpose(0, 2, 1, 3).reshape(12, 12)
        h = np.zeros((3, 6))
        for b, pair in zip(table.body[0], acting(coordinate_rate_gradient, table)(kin, 0), strict=True):
            h[b] += np.array([*pair[0], *pair[1]])
        h = h[:2].ravel()
        g_exact, h_exact, H_exact = np.zeros(12), np.zeros(12), np.zeros((12, 12))
        for k, e in unit_variations():
            moved = displaced(kin, e, still)
            x, g_moved = gradient(table, moved, ANGLE)
            rate = acting(coordinate_rate, table)(moved, 0, *acting(evaluate_coordinate, table)(moved, 0, ANGLE)[1:])
            g_exact[k] = x.imag / STEP
            H_exact[:, k] = 0.7 * g_moved.imag / STEP
            h_exact[k] = rate.imag / STEP
        for value, exact in ((g, g_exact), (h, h_exact), (H, H_exact)):
            np.testing.assert_allclose(value, exact, rtol=0, atol=1e-12 * max(1.0, np.abs(exact).max()))


@pytest.mark.parametrize('kind', KINDS)
def test_rate_is_the_time_derivative_of_the_value(rng, kind):
    table, _ = random_coordinate(rng, kind)
    kin = random_kinematics(rng, 2)
    x, g_i, g_j = acting(evaluate_coordinate, table)(displaced(kin, kin.v[:2], np.zeros((2, 6))), 0, ANGLE)
    _, g_i, g_j = acting(evaluate_coordinate, table)(kin, 0, ANGLE)
    np.testing.assert_allclose(acting(coordinate_rate, table)(kin, 0, g_i, g_j), x.imag / STEP, rtol=1e-12)


def test_translation_is_along_z_of_marker_i():
    """Marker i with z along world x; j 3 m ahead and 1 m aside, moving at 2 m/s along x: value 3, rate 2."""
    z_along_x = tuple(Rotation.from_euler('y', 90, degrees=True).as_quat())
    spec = CoordinateSpec(name='c', kind='translation', i=Marker(body='b0', orientation=z_along_x), j=Marker(body='b1'))
    table = ContractContext(coordinates=[spec]).coordinate_table()
    kin = kinematics([((0, 0, 0), (0, 0, 0)), ((3, 1, 0), (0, 0, 0))], [[0] * 6, [2, 5, 0, 0, 0, 0]])
    x, g_i, g_j = acting(evaluate_coordinate, table)(kin, 0, ANGLE)
    assert x == pytest.approx(3.0, abs=1e-14)
    assert acting(coordinate_rate, table)(kin, 0, g_i, g_j) == pytest.approx(2.0, abs=1e-14)


@pytest.mark.parametrize('turns', [-3.0, -1.3, -0.5, 0.2, 0.5, 1.7, 12.4])
def test_rotation_is_counted_past_half_a_turn(turns):
    """G turned about +z of F by an angle near the reference value gives that angle, not its remainder; +z rate is
    positive."""
    spec = CoordinateSpec(name='c', kind='rotation', i=Marker(body='b0'), j=Marker(body='b1'))
    table = ContractContext(coordinates=[spec]).coordinate_table()
    angle = 2 * np.pi * turns
    kin = kinematics([((0, 0, 0), (0, 0, 0)), ((0, 0, 0), (0, 0, angle))], [[0] * 6, [0, 0, 0, 0, 0, 4.0]])
    x, g_i, g_j = acting(evaluate_coordinate, table)(kin, 0, np.array([angle - 3.0]))
    assert x == pytest.approx(angle, abs=1e-12)
    assert acting(coordinate_rate, table)(kin, 0, g_i, g_j) == pytest.approx(4.0, abs=1e-14)


def test_rotation_is_the_twist_of_swing_and_twist(rng):
    """Turning G about z of F by theta and then tilting it about a horizontal axis leaves the coordinate at theta."""
    spec = CoordinateSpec(name='c', kind='rotation', i=Marker(body='b0'), j=Marker(body='b1'))
    table = ContractContext(coordinates=[spec]).coordinate_table()
    for theta in (-2.0, 0.3, 3.0):
        axis = rng.normal(size=2)
        swing = Rotation.from_rotvec([*(2.0 * axis / np.linalg.norm(axis)), 0.0])
        R = (swing * Rotation.from_rotvec([0, 0, theta])).as_matrix()
        kin = kinematics([((0, 0, 0), (0, 0, 0)), ((0, 0, 0), R)])
        assert acting(evaluate_coordinate, table)(kin, 0, ANGLE)[0] == pytest.approx(theta, abs=1e-12)


def test_evaluation_does_not_depend_on_the_common_motion(rng):
    """Moving both bodies rigidly changes neither value nor rate."""
    for kind in KINDS:
        table, _ = random_coordinate(rng, kind)
        kin = random_kinematics(rng, 2)
        Q = Rotation.random(random_state=rng).as_matrix()
        p, v = kin.p.copy(), kin.v.copy()
        R = kin.R.copy()
        for b in range(2):
            p[b], R[b], v[b, :3] = Q @ kin.p[b] + [1, 2, 3], Q @ kin.R[b], Q @ kin.v[b, :3]
        values = []
        for k in (kin, Kinematics(R, p, v)):
            x, g_i, g_j = acting(evaluate_coordinate, table)(k, 0, ANGLE)
            values.append((x, acting(coordinate_rate, table)(k, 0, g_i, g_j)))
        np.testing.assert_allclose(values[1], values[0], rtol=1e-12)


def test_refuses_an_unknown_kind():
    with pytest.raises(SpecError, match="Coordinate 'c': kind = 'twist': must be translation or rotation"):
        CoordinateSpec(name='c', kind='twist', i=Marker(body='b0'), j=Marker(body='b1'))
