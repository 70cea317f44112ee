"""Drive torque at the level kc where it acts between wheels and what carries them: motors in the hubs, the differential of a live axle."""

from __future__ import annotations

import numpy as np
import pytest

from solver import simulation_of
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.files.scene import load_scene_text
from solver.levels import derive
from solver.levels.reactions import reaction
from solver.scene import Scene

HUBS = tuple(f'vehicle.axles.{axle}.drive.on=upright' for axle in ('front', 'rear'))


def scene(*changes: str, vehicle: str, drive: float) -> Scene:
    text = (
        f'vehicle: vehicles/{vehicle}.yaml\nstart: {{kind: equilibrium, speed: 15}}\nintegrator: {{h: 0.002}}\n'
        f'maneuver: {{drive_torque: {{kind: step, value: {drive}, start: 0.1, rise: 0.3}}}}\n'
    )
    return load_scene_text(text, 'drive', changes)


def test_a_motor_in_a_hub_acts_against_its_carrier() -> None:
    """The carrier turns by 0.3 rad/m with the own travel and by 0.1 with the other one: of 1 N m on the wheel -0.3 and -0.1 N."""
    motor = CoordinateForceSpec(name='motor', terms=(('wheel_rear_left', 1.0),), input='drive_torque')
    assert reaction(motor, {'rear_left': (0.3, 0.1)}) == pytest.approx({'travel_rear_left': -0.3, 'travel_rear_right': -0.1})
    assert reaction(motor.replace(terms=(('shaft_rear_left', 1.0),)), {}) == {}


def test_what_a_differential_does_to_the_housing_of_a_live_axle_is_said() -> None:
    """The pickup has one behind; in front its half shafts come from the chassis."""
    (said,) = [text for text in derive(scene('fidelity=kc', vehicle='pickup_awd', drive=0.0)).report.lost if 'housing' in text]
    assert said.startswith('what the drive torque of the rear axle does to its housing')


@pytest.mark.slow
def test_it_lifts_and_squats_as_the_whole_vehicle() -> None:
    """What front and rear travels change within 1.4 s, within 3 % of the larger one; against the chassis it would be 15 %."""
    moved = []
    for level in ('full', 'kc'):
        simulation = simulation_of(scene(f'fidelity={level}', *HUBS, vehicle='electric_4wd', drive=1500.0))
        at = [simulation.channels.joints.index(f'travel_{axle}_left') for axle in ('front', 'rear')]
        before = simulation.snapshot().joint_position[at]
        moved.append(simulation.advance(700).joint_position[at] - before)
    full, kc = moved
    assert np.abs(kc - full).max() < 0.03 * np.abs(full).max()


@pytest.mark.slow
def test_energy_closes_with_second_order() -> None:
    errors = []
    for h in (2e-3, 1e-3):
        simulation = simulation_of(scene('fidelity=kc', f'integrator.h={h}', *HUBS, vehicle='electric_4wd', drive=3000.0))
        simulation.advance(round(1.0 / h))
        errors.append(simulation.totals()['energy_error_max'])
    assert errors[0] / errors[1] > 3.0
