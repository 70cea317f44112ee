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


@pytest.mark.parametrize('scene', ['light_car_circle', 'car_circle'])
def test_the_hand_torque_holds_the_wheel_against_the_tires(scene):
    """In a steady left turn the pneumatic trail and the caster pull the wheels straight: the hands push to the left."""
    simulation = simulation_of(load_scene(scene))
    wheel = simulation.channels.joints.index('steering_wheel')
    shot = simulation.advance(4000)
    assert shot.joint_position[wheel] > 0.1
    assert 0.5 < shot.joint_effort[wheel] < 40.0  # N m
