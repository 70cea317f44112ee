"""Signals that steps do not resolve are told: what is sampled once per step may look smooth and be another signal."""

from __future__ import annotations

import json

import numpy as np
import pytest

from solver.analysis.verdict import findings
from solver.files.scene import load_scene, load_scene_text
from solver.inputs.signals import Constant, Sine, SineWithDwell, Step, Sum, Sweep, Table
from solver.inputs.unresolved import LARGEST, Unresolved
from solver.simulation import Simulation

H = 10_000_000  # ns


def told(signal: object, seconds: float = 5.0, *, each: int = 500) -> dict:
    """What is found in a signal, looked at so many steps at a time."""
    watch, steps = Unresolved({'u': signal}, H), round(seconds * 1e9 / H)
    for k in range(each, steps + 1, each):
        found = watch.look(k, seconds)
    return found


@pytest.mark.parametrize('steps_a_period', [0.25, 0.5, 1.0, 1.01, 1.5, 2.0, 3.7, 5.0])
@pytest.mark.parametrize('phase', [0.0, 1.0])
def test_sines_of_few_steps_a_period_are_told(steps_a_period: float, phase: float) -> None:
    found = told(Sine(amplitude=3.0, frequency=100.0 / steps_a_period, phase=phase))
    assert found['u'].largest > LARGEST
    assert found['u'].first <= 0.1


@pytest.mark.parametrize(
    'signal',
    [
        Constant(value=1.0),
        Sine(amplitude=3.0, frequency=10.0),
        SineWithDwell(amplitude=1.0, frequency=0.7),
        Step(value=1.0, start=0.503, rise=0.001),
        Step(value=1.0, start=0.5, rise=0.05),
        Sum(terms=tuple(Step(value=(-1.0) ** k, start=0.5 + 0.2 * k + 0.003, rise=0.002) for k in range(8))),
        Sweep(amplitude=0.5, frequency=0.2, final_frequency=5.0, duration=5.0),
        Table(points=tuple((0.1 * k, float(k % 3)) for k in range(50))),
        Table(points=tuple((0.001 * k, 0.001 * k + 0.02 * (k % 2)) for k in range(5000)), interpolation='linear'),
    ],
    ids=lambda signal: type(signal).__name__,
)
def test_ten_steps_a_period_jumps_pulses_and_some_noise_are_not(signal: object) -> None:
    assert not told(signal)


def test_of_a_sweep_it_is_told_from_where_it_is_too_fast() -> None:
    """Linear in time from 2 to 40 Hz in 5 s. With N steps a period it departs by (1 - cos(pi / N)) / 2 of its range at
    a peak, in half of the steps by sqrt(1 / 2) of that: more than the limit below 8.3 steps of 10 ms, from 12 Hz on,
    which is reached after 1.33 s."""
    found = told(Sweep(amplitude=0.5, frequency=2.0, final_frequency=40.0, start=0.0, duration=5.0))
    assert found['u'].first == pytest.approx(1.33, abs=0.15)


def test_how_often_it_is_looked_at_changes_nothing() -> None:
    signal = Sum(
        terms=(
            Sweep(amplitude=0.5, frequency=2.0, final_frequency=40.0, start=0.0, duration=5.0),
            Step(value=4.0, start=1.0, rise=1.0),
        )
    )
    assert told(signal) == told(signal, each=1) == told(signal, each=20)


def driven(frequency: float) -> Simulation:
    """1 kg on rails, pushed by a sine."""
    mechanism = {
        'gravity': [0, 0, 0],
        'bodies': {'b': {'mass': 1, 'inertia': [1, 1, 1]}},
        'joints': {'g': {'kind': 'prismatic', 'i': 'world', 'j': 'b', 'at': [0, 0, 0], 'axis': [1, 0, 0]}},
        'coordinate_forces': {'s': {'terms': [['g', 1]], 'spring': 1.0, 'input': 'push'}},
    }
    push = {'kind': 'sine', 'amplitude': 10.0, 'frequency': frequency}
    scene = {
        'mechanism': mechanism,
        'integrator': {'h': H * 1e-9},
        'duration': 2,
        'maneuver': {'signals': {'push': push}},
    }
    return Simulation(load_scene_text(json.dumps(scene)))


def test_a_push_that_swings_with_the_steps_is_no_sound_run() -> None:
    """Taken in the stage of each step it is a constant force, and the body goes to and fro by ten times what it
    should."""
    s = driven(100.0)
    s.advance(200)
    (found,) = findings(s)
    assert (found.quantity, found.where) == ('input', 'push')
    assert 'Reduce integrator.h' in found.text
    s.reset()
    s.advance(200, inputs=np.zeros(1))  # what others put in instead is not the maneuver
    assert found not in findings(s)


def test_maneuvers_of_delivered_scenes_are_resolved() -> None:
    s = Simulation(load_scene('slider_crank'))
    s.advance(100)
    assert s.source.unresolved(s.k, s.scene.duration) == {}
