"""Quantities of interest: the numbers of snapshots become named signals, by hand-computed values and against rates of
other ones."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import solver
from solver.errors import SpecError
from solver.output.snapshot import Channels, layout_of, new_numbers, output_arrays
from solver.quantities import names, published, quantity

SPRING = ('energy', 'dissipation', 'length', 'rate', 'force')  # what a spring-damper gives
CAR = Channels(
    joints=('steering_wheel', 'travel_front_left'), joint_kinds=('rotation', 'translation'),
    bodies=('wheel', 'chassis'),
    wheels=('front_left',), inputs=('steering',), elements=tuple(f'spring/{column}' for column in SPRING), reactions=(),
    chassis=1,
)  # fmt: skip


def value(name: str, car: Channels = CAR, **fields: np.ndarray) -> float:
    """The quantity of one snapshot of the car that has these fields, everything else not a number."""
    numbers = new_numbers(layout_of(car))
    numbers[:] = np.nan
    arrays = output_arrays(numbers, layout_of(car))
    for field, given in fields.items():
        getattr(arrays, field)[...] = given
    found = quantity(name, car)
    return float(found.of(numbers[found.places][None, :])[0, 0])


def turned(yaw: float, pitch: float, roll: float) -> tuple[np.ndarray, np.ndarray]:
    """(pose of both bodies at R = Rz Ry Rx, that R)."""
    cz, sz, cy, sy, cx, sx = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    R = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]]) @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    R = R @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    w = 0.5 * np.sqrt(1.0 + np.trace(R))
    x, y, z = (R[2, 1] - R[1, 2]) / (4 * w), (R[0, 2] - R[2, 0]) / (4 * w), (R[1, 0] - R[0, 1]) / (4 * w)
    pose = np.full((2, 7), np.nan)
    pose[1] = [1.0, 2.0, 3.0, x, y, z, w]
    return pose, R


def test_angles_are_those_of_yaw_pitch_and_roll() -> None:
    pose, _ = turned(0.7, -0.2, 0.3)
    for name, angle in (('heading', 0.7), ('pitch', -0.2), ('roll', 0.3)):
        assert value(name, pose=pose, twist=0.0, imu=0.0) == pytest.approx(angle, abs=1e-14)


def test_velocities_are_along_the_horizontal_axes_of_the_heading() -> None:
    """20 m/s along the heading, 1 m/s to its left and 0.5 m/s upwards, given in a body that pitches and rolls."""
    pose, R = turned(0.7, -0.2, 0.3)
    world = 20.0 * np.array([np.cos(0.7), np.sin(0.7), 0]) + np.array([-np.sin(0.7), np.cos(0.7), 0]) + [0, 0, 0.5]
    twist = np.full((2, 6), np.nan)
    twist[1] = [*(R.T @ world), 0.0, 0.0, 0.0]
    assert value('longitudinal_velocity', pose=pose, twist=twist, imu=0.0) == pytest.approx(20.0, rel=1e-14)
    assert value('sideslip_velocity', pose=pose, twist=twist, imu=0.0) == pytest.approx(1.0, rel=1e-13)
    assert value('sideslip_angle', pose=pose, twist=twist, imu=0.0) == pytest.approx(np.arctan(1.0 / 20.0), rel=1e-13)


def test_accelerations_are_horizontal_and_free_of_gravity() -> None:
    """The specific force is acceleration less gravity: of 3 m/s^2 to the left in a tilted body gravity does not
    show."""
    pose, R = turned(0.7, -0.2, 0.3)
    left = 3.0 * np.array([-np.sin(0.7), np.cos(0.7), 0.0])
    imu = np.array([*(R.T @ (left + [0.0, 0.0, 9.81])), np.nan, np.nan, np.nan])
    assert value('lateral_acceleration', pose=pose, twist=0.0, imu=imu) == pytest.approx(3.0, rel=1e-13)
    assert value('longitudinal_acceleration', pose=pose, twist=0.0, imu=imu) == pytest.approx(0.0, abs=1e-13)


def test_numbers_of_wheels_joints_and_elements_are_found_by_name() -> None:
    tire = np.arange(100.0, 100.0 + layout_of(CAR)['tire'][1][1])[None, :]
    assert value('tire_force.front_left.y', tire=tire) == value('tire/front_left/force/fy', tire=tire) == 101.0
    assert value('wheel_load.front_left', tire=tire) == value('tire_states/front_left/fz', tire=tire) == 102.0
    assert value('suspension_travel.front_left', joint_position=np.array([0.1, 0.2])) == 0.2
    assert value('steering_torque', joint_effort=np.array([4.0, 5.0])) == 4.0
    # whose effort has the damper of the steering in it
    by_torque = dataclasses.replace(CAR, inputs=('drive_torque', 'steering_torque'))
    assert value('steering_torque', by_torque, joint_effort=np.array([4.0, 5.0]), inputs=np.array([7.0, 6.0])) == 6.0
    assert value('element_states/spring/force', elements=np.arange(3.0, 8.0)) == 7.0
    assert quantity('element_states/spring/force', CAR).unit == 'N'
    assert quantity('joint_states/travel_front_left/velocity', CAR).unit == 'm/s'


def test_what_is_not_published_is_absent_and_refused_with_a_suggestion() -> None:
    bare = dataclasses.replace(CAR, joints=(), joint_kinds=())
    assert 'steering_torque' in names(CAR)
    assert not {'steering_torque', 'suspension_travel.front_left'} & set(names(bare))
    with pytest.raises(SpecError, match=r"yaw_rat: no such quantity; did you mean 'yaw_rate'"):
        quantity('yaw_rat', CAR)
    with pytest.raises(SpecError, match='no such quantity'):
        quantity('suspension_travel.front_left', bare)


@pytest.mark.slow
@pytest.mark.parametrize('name', ['light_car_step_steer', 'car_step_steer'])
def test_every_quantity_of_a_car_exists_without_compiling_it_and_rates_belong_to_their_angles(name: str) -> None:
    """Yaw rate and velocities are the rates of heading and place, by central differences over 2 ms: (w dt)^2/6 at 5 Hz
    is 1e-3."""
    scene = solver.load_scene(name, ['maneuver.steering.start=0.1', 'integrator.iterations=3'])
    simulation = solver.simulation_of(scene)
    assert names(published(scene.model)) == names(simulation.channels)
    found = {q: quantity(q, simulation.channels) for q in names(simulation.channels)}
    numbers = np.array([simulation.advance(1, audit=False).numbers for _ in range(800)])
    curves = {q: of.of(numbers[:, of.places]) for q, of in found.items()}
    assert all(np.all(np.isfinite(curve)) for curve in curves.values())
    rate = np.gradient(curves['heading'][:, 0], simulation.h)[1:-1]
    assert np.abs(rate).max() > 0.1
    np.testing.assert_allclose(rate, curves['yaw_rate'][1:-1, 0], atol=1e-3 * np.abs(rate).max())
    speed = np.hypot(*np.gradient(curves['position'], simulation.h, axis=0).T)[1:-1]
    along, across = (curves[q][1:-1, 0] for q in ('longitudinal_velocity', 'sideslip_velocity'))
    np.testing.assert_allclose(speed, np.hypot(along, across), rtol=1e-4)
    assert 3.0 < curves['lateral_acceleration'].max() < 9.81
