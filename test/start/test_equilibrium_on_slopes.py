"""A vehicle on a slope: without brakes it is found where it was placed, at rest in its suspension; at speed it settles
along the slope."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solver.elements.road import HeightGrid, RoadSpec
from solver.files.scene import load_scene
from solver.simulation import Simulation

SLOPE = 0.1  # rad, uphill along x
ROAD = f'road={{normal: [{-np.sin(SLOPE)}, 0, {np.cos(SLOPE)}]}}'


@pytest.fixture(params=['light_car_straight', 'car_step_steer'])
def on_slope(request) -> Simulation:
    return Simulation(
        load_scene(request.param, [ROAD, 'start={kind: equilibrium}', 'maneuver={}', 'integrator={h: 1.0e-3}'])
    )


def test_it_stays_where_it_was_placed_and_stands_on_its_tires(on_slope):
    """Centre of mass within 0.1 mm of its place along the car, which lies along the slope; no tire carries any of the
    slope (0.1 N)."""
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
    """Half a second: backwards with g sin(slope), less up to 12 % for wheels and shafts that start to turn; pitch
    within 0.2 deg."""
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
    """While it settles it is put back every 50 ms, 1 m at this speed: level that would be 0.1 m into the road or above
    it. The tires carry the component of the weight across the slope, within 0.1 %: 4 mm between car and road would be
    20 %."""
    road = f'road={{normal: [{-np.sin(uphill * SLOPE)}, 0, {np.cos(SLOPE)}]}}'
    sim = Simulation(
        load_scene(scene, [road, 'start={kind: equilibrium, speed: 20}', 'maneuver={}', 'integrator={h: 1.0e-3}'])
    )
    weight = 9.81 * sum(b.mass for b in sim.model.spec.bodies) * np.cos(SLOPE)
    assert sim.snapshot().tire[:, 2].sum() == pytest.approx(weight, rel=1e-3)
    for _ in range(5):
        assert sim.advance(50).tire[:, 2].sum() == pytest.approx(weight, rel=1e-3)


def on_road(road: RoadSpec, speed: float) -> Simulation:
    """The light car on a road."""
    scene = load_scene('light_car_straight', [f'start={{kind: equilibrium, speed: {speed}}}', 'maneuver={}'])
    return Simulation(dataclasses.replace(scene, model=dataclasses.replace(scene.model, road=road)))


@pytest.mark.parametrize('slope', [0.1, -0.1])
def test_a_slope_in_a_grid_is_the_slope_of_a_plane(slope: float) -> None:
    """At 20 m/s, half way up a ramp of 200 m: loads and pitch of a car that settled on the plane, there and 0.1 s
    later."""
    rise = np.repeat(slope * np.linspace(-100.0, 100.0, 21)[:, None], 2, axis=1)
    grid = HeightGrid(origin=(-100.0, -20.0), step=(10.0, 40.0), height=tuple(map(tuple, rise.tolist())))
    n = (-slope, 0.0, 1.0)
    plane, ramp = on_road(RoadSpec(normal=n), 20.0), on_road(RoadSpec(grids=(grid,)), 20.0)
    for _ in range(2):
        one, other = plane.snapshot(), ramp.snapshot()
        np.testing.assert_allclose(other.tire[:, 2], one.tire[:, 2], rtol=1e-3)
        np.testing.assert_allclose(
            other.pose[plane.channels.chassis], one.pose[plane.channels.chassis], rtol=0, atol=1e-3
        )
        for s in (plane, ramp):
            s.advance(100)


@pytest.mark.parametrize('lifted', ['point', 'grid'])
@pytest.mark.parametrize('height', [3.0, -3.0])
def test_a_car_is_put_onto_a_road_that_lies_elsewhere(lifted: str, height: float) -> None:
    """As high above it, as straight, with the same loads as on one through the origin: gravity is the same there."""
    grid = HeightGrid(origin=(-20.0, -20.0), step=(40.0, 40.0), height=((height, height), (height, height)))
    other = on_road(RoadSpec(point=(0.0, 0.0, height)) if lifted == 'point' else RoadSpec(grids=(grid,)), 0.0)
    usual = on_road(RoadSpec(), 0.0)
    chassis = usual.channels.chassis
    np.testing.assert_allclose(
        other.state.q[chassis, :3] - (0.0, 0.0, height), usual.state.q[chassis, :3], rtol=0, atol=1e-6
    )
    np.testing.assert_allclose(other.snapshot().tire[:, 2], usual.snapshot().tire[:, 2], rtol=1e-5)
