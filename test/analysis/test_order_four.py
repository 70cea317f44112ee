"""Order four on trial: advice that is measured, held against runs that follow it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from solver import Simulation, load_scene, simulation_of
from solver.analysis import order_four as trial
from solver.analysis.order_four import order_four


def poses(simulation: Simulation, until: float, sample: float) -> np.ndarray:
    every = round(sample / simulation.h)
    return np.array([simulation.advance(every).pose for _ in range(round(until / sample))])


@pytest.mark.parametrize(
    ('scene', 'pays'), [('pendulum', True), ('slider_crank_regular', True), ('flyball_governor', False)]
)
def test_advice_is_true_of_runs_that_follow_it(scene: str, pays: bool) -> None:
    """Order four with four times the step against order two with the step that takes the same evaluations, both against
    an eighth of its step with order four: the governor's dampers are too stiff for it."""
    run = simulation_of(load_scene(scene, ['duration=2']))
    said = order_four(run)
    assert said.startswith('pays: ' if pays else 'does not pay: ')
    h = run.scene.integrator.h
    four = {'order': 4, 'rho_inf': 1.0, 'iterations': 3}
    ways = {'four': {'h': 4.0 * h, **four}, 'two': {'h': h}}
    made = {name: run.twin(2.0, **way) for name, way in ways.items()}
    found = {name: poses(one, 2.0, 8.0 * h) for name, one in made.items()}
    fine = poses(run.twin(2.0, h=round(h * 1e9 / 4) * 1e-9, **four), 2.0, 8.0 * h)
    error = {name: np.abs(one - fine).max() for name, one in found.items()}
    work = {name: one.totals()['evaluations'] for name, one in made.items()}
    cost = work['four'] / work['two']
    assert (error['four'] < error['two'] / cost**2) == pays
    assert f', {cost:.2g} times that of steps of ' in said


def test_what_is_known_is_said_without_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """The car with bushings, a car with a driver, settings that are no candidates."""
    monkeypatch.setattr(trial, '_tried', lambda s, steps: pytest.fail('a run was made'))
    car = simulation_of(load_scene('car_step_steer'))
    assert 'vibrates on its bushings with' in order_four(car) and 'takes steps of 0.3 ms' in order_four(car)
    driven = simulation_of(load_scene('light_car_lane_change'))
    assert order_four(driven).startswith('does not pay: a driver or an assistance looks once a step')
    scene = load_scene('pendulum')
    for more in ({'order': 4, 'rho_inf': 1.0}, {'step_policy': 'error'}):
        integrator = dataclasses.replace(scene.integrator, **more)
        assert order_four(simulation_of(dataclasses.replace(scene, integrator=integrator))) == ''
    assert order_four(simulation_of(load_scene('pendulum', ['duration=0.05']))) == ''  # too few steps to tell


@pytest.mark.slow
def test_the_light_car_without_a_driver_is_told_that_it_pays() -> None:
    assert order_four(simulation_of(load_scene('light_car_step_steer'))).startswith('pays: in 5 s steps of 4 ms')
