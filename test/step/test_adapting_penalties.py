"""Penalties that adapt: they rescue a run whose own are too small, and leave alone what needs no change."""

from __future__ import annotations

import pytest
from ensemble import neighbours

from solver.errors import StepError
from solver.files.scene import load_scene
from solver.simulation import Simulation

CONSTANT = 'step_policy=constant'
PLAIN = ('augmentation=plain',)  # combined augmentations leave penalties nothing to rescue


def simulation(name: str, *settings: str) -> Simulation:
    return Simulation(load_scene(name, ['integrator.mode=tolerance', *(f'integrator.{s}' for s in settings)]))


@pytest.mark.slow
@pytest.mark.parametrize('penalty', [1.0, 10.0, 100.0])
def test_adaptive_penalties_rescue_a_run_that_fails_with_constant_small_ones(penalty):
    """The slider-crank through five singular positions, 2 s at 1 ms; energy as with a good penalty (1e-3 J, the damped
    setting), from every neighbour of the start; what the events are like is judged in the last run.
    """
    with pytest.raises(StepError, match='no convergence in 20 iterations'):
        simulation('slider_crank', *PLAIN, CONSTANT, f'penalty={penalty}').advance(2000)
    placed = Simulation(load_scene('slider_crank')).snapshot().joint_position[:2]
    settings = [
        'integrator.mode=tolerance',
        f'integrator.penalty={penalty}',
        'integrator.penalty_policy=adaptive',
        'integrator.augmentation=plain',
        'integrator.step_policy=constant',
    ]
    for scene in neighbours(load_scene('slider_crank', settings)):
        sim = Simulation(scene)
        sim.advance(2000)
        assert sim.totals()['energy_error_max'] < 1e-3
        turn = sim.snapshot().joint_position[:2] - placed
        assert abs(2 * turn[0] + turn[1]) < 1e-2, 'left its branch'
    raised = [e for e in sim.events if e.new > e.old]
    assert raised
    assert {e.kind for e in sim.events} == {'penalty'}
    assert {e.name for e in sim.events} <= set(sim.model.row_names)
    assert all(
        penalty <= min(e.old, e.new) and max(e.old, e.new) <= sim.scene.integrator.penalty_cap for e in sim.events
    )
    assert all(0.0 <= e.t < 2.0 for e in sim.events)
    # what the events say is what the penalties are
    now = dict.fromkeys(sim.model.row_names, penalty)
    for e in sim.events:
        assert now[e.name] == e.old
        now[e.name] = e.new
    assert now == dict(zip(sim.model.row_names, sim.scheme.penalty, strict=True))


def test_a_smaller_step_does_not_help_a_penalty_that_is_too_small():
    """The error factor of an augmentation, 1 / (1 + xi s_min), does not contain the step: halving ends at the smallest
    one."""
    sim = simulation('slider_crank', *PLAIN, 'penalty=10', 'step_policy=rescue', 'h_min=1e-6')
    with pytest.raises(StepError, match=r'not even with the smallest step integrator\.h_min = 1e-06'):
        sim.advance(2000)
    steps = [e.new for e in sim.events if e.kind == 'step']
    assert min(steps) <= 1e-6
    assert all(e.cause == 'failure' for e in sim.events)


def test_a_velocity_row_without_trouble_keeps_its_penalty():
    """A sleigh that glides beside the slider-crank: its slip [m/s] is judged by the displacement it makes in a step,
    not as one."""
    sleigh = [
        'mechanism.bodies.sleigh={mass: 2, inertia: [0.1, 0.1, 0.1], com: [0.1, 0, 0], velocity: [1, 0, 0], '
        'angular_velocity: [0, 0, 2]}',
        'mechanism.contacts={blade: {kind: knife_edge, i: world, j: sleigh}}',
    ]
    settings = [
        'integrator.mode=tolerance',
        'integrator.penalty=1e3',
        'integrator.penalty_policy=adaptive',
        'integrator.augmentation=plain',
    ]
    sim = Simulation(load_scene('slider_crank', [*settings, *sleigh]))
    sim.advance(2000)
    assert 'blade/y' in sim.model.row_names
    assert sim.events
    assert 'blade/y' not in {e.name for e in sim.events}


def test_penalties_relax_after_easy_steps_but_not_below_the_setting():
    sim = simulation('slider_crank', *PLAIN, 'penalty=1e3', 'penalty_policy=adaptive')
    sim.advance(2000)
    relaxed = [e for e in sim.events if e.cause == 'easy']
    assert relaxed
    assert all(1e3 <= e.new < e.old for e in relaxed)


def test_penalties_that_need_no_change_change_no_bit():
    one, other = (
        simulation('double_pendulum', CONSTANT),
        simulation('double_pendulum', 'penalty_policy=adaptive', 'step_policy=rescue'),
    )
    a, b = one.advance(200), other.advance(200)
    assert other.events == []
    assert a.numbers.tobytes() == b.numbers.tobytes()
    assert one.last_step.account.numbers.tobytes() == other.last_step.account.numbers.tobytes()
    assert one.totals() == other.totals()


@pytest.mark.parametrize('mode', ['fixed', 'tolerance'])
@pytest.mark.parametrize('name', ['slider_crank', 'flyball_governor', 'bricard', 'light_car_step_steer'])
def test_the_default_has_the_bits_of_constant_steps_while_nothing_fails(name, mode):
    """Outputs, state and energy account: wheels, springs, prescribed motions and forces that follow inputs are among
    them."""
    ways = [CONSTANT, 'step_policy=rescue', 'step_policy=auto']
    sims = [Simulation(load_scene(name, [f'integrator.mode={mode}', f'integrator.{way}'])) for way in ways]
    for steps, audit in ((1, True), (70, True), (29, False)):
        first, *others = (sim.advance(steps, audit=audit) for sim in sims)
        for other, sim in zip(others, sims[1:], strict=True):
            assert other.numbers.tobytes() == first.numbers.tobytes()
            assert other.counters == first.counters
            assert sim.last_step.account.numbers.tobytes() == sims[0].last_step.account.numbers.tobytes()
            assert all(a.tobytes() == b.tobytes() for a, b in zip(sim.state, sims[0].state, strict=True))
    assert sims[2].totals() == sims[0].totals()
    assert sims[2].events == []
