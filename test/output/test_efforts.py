"""The effort of a joint coordinate: a driver that prescribes a motion shows the generalized force that this takes."""

from __future__ import annotations

import numpy as np
import pytest

from solver import load_scene, simulation_of
from solver.files.scene import load_scene_text

DISC = """
mechanism:
  gravity: [0, 0, 0]
  bodies:
    disc: {mass: 3, inertia: [1, 1, 2]}
  joints:
    axle: {kind: revolute, i: world, j: disc}
  couplers:
    motor: {terms: {axle: 0.5}, offset: 0, input: turn}
  inputs: [turn, turn_rate, turn_acceleration]
maneuver: {signals: {turn: {kind: sine, amplitude: 0.3, frequency: 2, start: 0.2}}}
integrator: {h: 0.0005}
duration: 1
"""


def test_the_torque_of_a_driver_accelerates_what_it_drives():
    """0.5 x = u, so x'' = 2 u'': the torque is the moment of inertia times that."""
    simulation = simulation_of(load_scene_text(DISC))
    column = simulation.channels.inputs.index('turn_acceleration')
    shots = [simulation.advance(1) for _ in range(1000)]
    effort = np.array([s.joint_effort[0] for s in shots])
    acceleration = np.array([s.inputs[column] for s in shots])
    assert np.abs(acceleration).max() > 25.0
    within_a_step = 4.0 * np.abs(np.diff(acceleration)).max()  # the forces are in balance inside of the step
    assert within_a_step < 0.1 * 4.0 * np.abs(acceleration).max()
    np.testing.assert_allclose(effort, 2.0 * 2.0 * acceleration, rtol=0.0, atol=within_a_step)


def test_a_driver_that_works_against_a_spring_shows_what_it_takes():
    """5 N m/rad times x more than for the inertia alone, to what x changes within a step: 5e-4 s * 4 pi / tan(0.4 pi) =
    2.0e-3 of it. The spring has no effort of its own beside that of the driver."""
    spring = 'mechanism:\n  coordinate_forces:\n    spring: {terms: {axle: 1}, spring: 5}\n'
    found = [simulation_of(load_scene_text(text)).advance(600) for text in (DISC, DISC.replace('mechanism:\n', spring))]
    assert abs(found[0].joint_position[0]) > 0.05
    more = found[1].joint_effort[0] - found[0].joint_effort[0]
    assert more == pytest.approx(5.0 * found[0].joint_position[0], rel=2.1e-3)


@pytest.mark.parametrize('scene', ['light_car_circle', 'car_circle'])
def test_the_hand_torque_holds_the_wheel_against_the_tires(scene):
    """In a steady left turn the pneumatic trail and the caster pull the wheels straight: the hands push to the left."""
    simulation = simulation_of(load_scene(scene))
    wheel = simulation.channels.joints.index('steering_wheel')
    shot = simulation.advance(4000)
    assert shot.joint_position[wheel] > 0.1
    assert 0.5 < shot.joint_effort[wheel] < 40.0  # N m
