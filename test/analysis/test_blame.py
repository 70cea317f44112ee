"""A setting of the integrator that is to blame is named instead of the body or the constraint where it shows."""

from __future__ import annotations

import pytest

from solver import load_scene, simulation_of
from solver.analysis.verdict import findings
from solver.errors import SceneError


@pytest.mark.parametrize('name', ['slider_crank', 'four_bar', 'pendulum'])
def test_a_penalty_is_named_with_one_that_works(name: str) -> None:
    def light(penalty: float) -> list[str]:
        s = simulation_of(load_scene(name, [f'integrator.penalty={penalty:g}']))
        s.advance(20)
        return [found.text for found in findings(s) if found.quantity == 'light_body']

    (text,) = light(1e13)
    assert text.startswith('The penalty 1e+13 is so large that rounding hides the inertia of bodies')
    assert "body '" not in text
    below = float(text.split('integrator.penalty to ')[1].split(' ')[0])
    assert 1e8 <= below < 1e13
    assert light(below) == []


@pytest.mark.parametrize(
    ('signal', 'remedy'),
    [
        ('steering_torque', 'with actuation: {steering: torque}'),
        ('brake_torque_front_left', 'with actuation: {wheels: true}'),
        ('drive_torque_rear_right', 'with actuation: {wheels: true}'),
        ('road_wheel', 'give it as maneuver.road_wheel'),
        ('steerin', "did you mean 'steering'"),
    ],
)
def test_a_command_that_needs_an_actuation_says_which(signal: str, remedy: str) -> None:
    with pytest.raises(SceneError, match='the model has no such input.*' + remedy):
        load_scene('car_step_steer', [f'maneuver={{signals: {{{signal}: 1}}}}'])
