"""A simulation is a function of its scene: the same bits, whoever asks and however often."""

from __future__ import annotations

import numpy as np
import pytest

from solver.errors import SpecError, StepError
from solver.files.scene import load_scene
from solver.simulation import Simulation

SCENES = ('double_pendulum', 'four_bar', 'slider_crank')


def bits(snapshot) -> bytes:
    """All numbers of a snapshot."""
    names = ('joint_position', 'joint_velocity', 'pose', 'twist', 'imu', 'inputs', 'elements', 'reactions')
    return np.concatenate([getattr(snapshot, name).ravel() for name in names]).tobytes()


@pytest.mark.parametrize('name', SCENES)
def test_the_same_scene_gives_the_same_bits(name):
    """Two simulations side by side, one advanced step by step, the other in one call."""
    one, other = (Simulation(load_scene(name, ['integrator.mode=fixed'])) for _ in range(2))
    for _ in range(50):
        last = one.advance()
    assert bits(last) == bits(other.advance(50))


@pytest.mark.parametrize('name', SCENES)
def test_restoring_a_saved_state_repeats_the_future_bit_by_bit(name):
    """In the same simulation, and in a new one; after an odd and an even number of steps."""
    simulation = Simulation(load_scene(name))
    for steps in (7, 20):
        simulation.advance(steps)
        saved = simulation.save()
        future, audit = bits(simulation.advance(30)), simulation.last_step.account.numbers.tobytes()
        simulation.restore(saved)
        assert bits(simulation.advance(30)) == future
        assert simulation.last_step.account.numbers.tobytes() == audit
        fresh = Simulation(load_scene(name))
        fresh.restore(saved)
        assert bits(fresh.advance(30)) == future


@pytest.mark.parametrize('name', SCENES)
def test_reset_repeats_the_run_bit_by_bit(name):
    simulation = Simulation(load_scene(name))
    start = bits(simulation.snapshot())
    run = bits(simulation.advance(33))
    simulation.reset()
    assert (simulation.k, simulation.totals()['iterations']) == (0, 0)
    assert bits(simulation.snapshot()) == start
    assert bits(simulation.advance(33)) == run


def test_a_state_of_another_model_is_refused():
    with pytest.raises(SpecError, match='the saved state is of another model'):
        Simulation(load_scene('pendulum')).restore(Simulation(load_scene('four_bar')).save())


@pytest.mark.parametrize('settings', [(), ('integrator.mode=tolerance', 'integrator.step_policy=rescue')])
def test_an_input_that_is_not_finite_is_refused_and_nothing_moves(settings):
    """By name, whatever its row; the simulation goes on as if it had not been asked."""
    simulation, other = (Simulation(load_scene('light_car_step_steer', settings)) for _ in range(2))
    inputs = simulation.source.table(0, 8)
    wrong = inputs.copy()
    wrong[5, 3] = np.nan
    with pytest.raises(StepError, match=f"input '{simulation.channels.inputs[3]}' is not finite; nothing was advanced"):
        simulation.advance(8, wrong)
    assert bits(simulation.advance(8, inputs)) == bits(other.advance(8, inputs))
