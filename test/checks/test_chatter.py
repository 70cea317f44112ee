"""Tires that chatter from step to step are told; what roads, cleats, brakes and stops do to their forces is not
chatter."""

from __future__ import annotations

import pytest

from solver import load_scene, simulation_of
from solver.analysis.verdict import findings
from solver.checks.chatter import CHATTER, LARGEST_SHAKE
from solver.files.scene import load_scene_text
from solver.simulation import Simulation


def shaken(s: Simulation, duration: float) -> float:
    """Largest chatter in a run of that duration [s], over the load; it is told where it is beyond the limit."""
    s.advance(round(duration / s.h))
    value = float(s.last_step.account.shake[0])
    assert (CHATTER.name in {finding.quantity for finding in findings(s)}) == (value > LARGEST_SHAKE)
    return value


@pytest.mark.parametrize('scene', ['light_car_straight', 'light_car_lane_change'])
@pytest.mark.parametrize('h', [0.006, 0.008, 0.01])
def test_one_iteration_of_long_steps_chatters_and_two_do_not(scene: str, h: float) -> None:
    """It left +-17 to +-47 N about 206 N of a front wheel, straight ahead, and was ok."""
    assert shaken(simulation_of(load_scene(scene, [f'integrator.h={h}', 'require={}'])), 2.0) > 1.5 * LARGEST_SHAKE
    assert (
        shaken(simulation_of(load_scene(scene, [f'integrator.h={h}', 'integrator.iterations=2', 'require={}'])), 2.0)
        < 0.1 * LARGEST_SHAKE
    )


@pytest.mark.parametrize(
    ('scene', 'h', 'duration'),
    [
        ('light_car_lane_change', 0.004, 4.0),
        ('light_car_brake', 0.005, 7.0),  # to its stop, where it sticks and slips
        pytest.param('car_rough_road', 0.005, 3.0, marks=pytest.mark.slow),
        pytest.param('car_cleat', 0.002, 1.5, marks=pytest.mark.slow),
    ],
)
def test_what_shows_in_loads_or_takes_many_steps_does_not_chatter(scene: str, h: float, duration: float) -> None:
    assert shaken(simulation_of(load_scene(scene, [f'integrator.h={h}', 'require={}'])), duration) < 0.2 * LARGEST_SHAKE


@pytest.mark.parametrize('frequency', [5.0, 10.0])
def test_brakes_that_pump_do_not_chatter(frequency: float) -> None:
    """Brake torques between none and 2400 N m up to ten times a second, as an anti-lock brake has them, in steps of 4
    ms."""
    scene = (
        'vehicle: vehicles/light_car.yaml\nstart: {kind: equilibrium, speed: 25}\nintegrator: {h: 0.004, iterations: '
        '2}\nduration: 3\n'
        f'maneuver: {{brake_torque: {{kind: sine, amplitude: 1200, offset: 1200, frequency: {frequency}}}}}\n'
    )
    s = simulation_of(load_scene_text(scene))
    assert shaken(s, 2.0) < 0.5 * LARGEST_SHAKE
