"""A vehicle on a slope: without brakes it is found where it was placed, at rest in its suspension; at speed it settles along the slope."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solver.files.scene import load_scene
from solver.simulation import Simulation

SLOPE = 0.1  # rad, uphill along x
ROAD = f'road={{normal: [{-np.sin(SLOPE)}, 0, {np.cos(SLOPE)}]}}'


@pytest.fixture(params=['light_car_straight', 'car_step_steer'])
def on_slope(request) -> Simulation:
    return Simulation(load_scene(request.param, [ROAD, 'start={kind: equilibrium}', 'maneuver={}', 'integrator={h: 1.0e-3}']))


def test_it_stays_where_it_was_placed_and_stands_on_its_tires(on_slope):
    """Centre of mass within 0.1 mm of its place along the car, which lies along the slope; no tire carries any of the slope (0.1 N)."""
    car = on_slope.model.spec.chassis
    body = next(b for b in on_slope.model.spec.bodies if b.name == car)
    index = on_slope.model.body_names.index(car)
    forward = Rotation.from_quat(on_slope.state.q[index, 3:]).apply([1, 0, 0])
    assert np.arcsin(forward[2]) == pytest.approx(SLOPE, abs=0.01)
    assert abs(forward @ (on_slope.state.q[index, :3] - np.array(body.position) - np.array(body.com))) < 1e-4
    tires = on_slope.snapshot().tire
    assert np.abs(tires[:, 0]).max() < 0.1
    weight = 9.81 * sum(b.mass for b in on_slope.model.spec.bodies)
    assert tires[:, 2].sum() == pytest.approx(weight * np.cos(SLOPE), rel=1e-3)


def test_it_rolls_away_with_its_suspension_at_rest(on_slope):
    """Half a second: backwards with g sin(slope), less up to 12 % for wheels and shafts that start to turn; pitch within 0.2 deg."""
    index = on_slope.channels.chassis
    before = on_slope.snapshot()
    after = on_slope.advance(500)
    assert -1.0 < after.twist[index, 0] / (9.81 * np.sin(SLOPE) * 0.5) < -0.88
    turn = Rotation.from_quat(before.pose[index, 3:]).inv() * Rotation.from_quat(after.pose[index, 3:])
    assert np.degrees(turn.magnitude()) < 0.2
    assert abs(after.twist[index, 2]) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize('uphill', [1.0, -1.0])
@pytest.mark.parametrize('scene', ['light_car_straight', 'car_step_steer'])
def test_one_that_starts_at_speed_settles_along_the_slope(scene: str, uphill: float) -> None:
    """While it settles it is put back every 50 ms, 1 m at this speed: level that would be 0.1 m into the road or above it. The tires carry
    the component of the weight across the slope, within 0.1 %: 4 mm between car and road would be 20 %."""
    road = f'road={{normal: [{-np.sin(uphill * SLOPE)}, 0, {np.cos(SLOPE)}]}}'
    sim = Simulation(load_scene(scene, [road, 'start={kind: equilibrium, speed: 20}', 'maneuver={}', 'integrator={h: 1.0e-3}']))
    weight = 9.81 * sum(b.mass for b in sim.model.spec.bodies) * np.cos(SLOPE)
    assert sim.snapshot().tire[:, 2].sum() == pytest.approx(weight, rel=1e-3)
    for _ in range(5):
        assert sim.advance(50).tire[:, 2].sum() == pytest.approx(weight, rel=1e-3)
