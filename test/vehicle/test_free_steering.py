"""A steering wheel that nobody holds: what a pulse of torque begins dies out."""

from __future__ import annotations

import numpy as np
import pytest

import solver
from solver.files.scene import load_scene


@pytest.mark.parametrize(
    ('scene', 'speed'), [('light_car_straight', 90), ('car_step_steer', 80), ('car_step_steer', 120)]
)
def test_a_released_steering_wheel_comes_to_rest(scene: str, speed: float) -> None:
    """The swing of three to five seconds after a pulse of 1 N m is at most half of that of the first two."""
    pulse = '{kind: step, value: 1.0, start: 0.1, rise: 0.05}'
    back = '{kind: step, value: -1.0, start: 0.3, rise: 0.05}'
    maneuver = f'maneuver={{signals: {{steering_torque: {{kind: sum, terms: [{pulse}, {back}]}}}}}}'
    s = solver.simulation_of(load_scene(scene, ['actuation.steering=torque', maneuver, f'start.speed_kmh={speed}']))
    k = s.channels.joints.index('steering_wheel')
    angle = np.array([s.advance(round(0.02 / s.h)).joint_velocity[k] for _ in range(250)])
    assert np.abs(angle).max() > 0.1
    assert np.abs(angle[150:]).max() < 0.5 * np.abs(angle[:100]).max()
