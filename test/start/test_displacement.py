"""A vehicle that is placed elsewhere goes on as it would have, turned and moved: a symmetry of the equations on a flat road."""

from __future__ import annotations

import math

import numpy as np
import pytest

import solver
from solver.errors import SpecError
from solver.files.scene import load_scene
from solver.start.displacement import sight

THERE = (120.0, -40.0, 2.2)


def turned(numbers: np.ndarray, by: float) -> np.ndarray:
    """Vectors (n, 3) turned about the vertical."""
    c, s = math.cos(by), math.sin(by)
    return numbers @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T


def test_a_driver_sees_the_reference_frame_and_not_the_centre_of_mass():
    """Turned by 90 degrees to the left, centre of mass at (0.5, 0.2, 0.3) in the body: (-0.2, 0.5) from the frame in the world. Its x axis
    is y of the world: 2 m/s, and 0.02 more because the frame turns about the centre of mass: -(0.2 0.3 - 0.4 0.2)."""
    q = np.array([10.0, 20.0, 1.0, 0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)])
    seen = sight(q, np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.4]), (0.5, 0.2, 0.3))
    assert seen == pytest.approx((10.2, 19.5, 0.5 * math.pi, 2.02), rel=1e-14)


@pytest.mark.parametrize('overrides', [[], ['fidelity=single_track']], ids=['whole', 'single_track'])
def test_the_motion_goes_on_in_its_own_axes(overrides):
    sims = [solver.simulation_of(load_scene('light_car_step_steer', overrides)) for _ in range(2)]
    for sim in sims:
        sim.advance(1300)  # it turns
    before = sims[0].snapshot()
    chassis = sims[0].channels.chassis
    x, y, *_ = before.pose[chassis]
    qx, qy, qz, qw = before.pose[chassis, 3:]
    heading = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
    sims[1].place(*THERE)
    placed = sims[1].snapshot()
    np.testing.assert_allclose(placed.pose[chassis, :2], THERE[:2], atol=1e-12)
    one, other = (sim.advance(400) for sim in sims)
    by = THERE[2] - heading
    expected = turned(one.pose[:, :3] - (x, y, 0.0), by) + (THERE[0], THERE[1], 0.0)
    # rounding of places of 100 m, and its growth in 0.4 s
    np.testing.assert_allclose(other.pose[:, :3], expected, atol=1e-9)
    np.testing.assert_allclose(other.twist, one.twist, atol=1e-8)
    np.testing.assert_allclose(other.tire[:, :6], one.tire[:, :6], atol=1e-3)
    np.testing.assert_allclose(other.imu, one.imu, atol=1e-6)


def test_a_road_that_is_not_the_same_everywhere_is_refused():
    sim = solver.simulation_of(load_scene('light_car_straight', ['road={patches: [{center: [15, 0], size: [10, 4], factor: 0.5}]}']))
    with pytest.raises(SpecError, match='on a flat road only'):
        sim.place(0.0, 0.0, 0.0)


def test_a_reset_leads_back_to_the_start():
    sim = solver.simulation_of(load_scene('light_car_straight'))
    expected = sim.advance(20).numbers
    sim.place(*THERE)
    sim.reset()
    assert not sim.displaced
    assert sim.advance(20).numbers.tobytes() == expected.tobytes()
