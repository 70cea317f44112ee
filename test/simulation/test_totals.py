"""What a run reports of itself does not depend on whether it was saved and taken up on its way."""

from __future__ import annotations

import io
import pickle
import re

import numpy as np
import pytest

from mbd_sim_ros.batch import simulate
from solver import simulation_of
from solver.analysis.verdict import findings
from solver.errors import SpecError
from solver.files.scene import load_scene
from solver.model.state import FORMAT
from solver.simulation import Simulation

TOLERANCE = 'integrator.mode=tolerance'
ADAPTIVE = ('integrator.augmentation=plain', 'integrator.penalty=100', 'integrator.penalty_policy=adaptive')
RUNS = {
    'error': (
        'double_pendulum',
        TOLERANCE,
        'integrator.step_policy=error',
        'integrator.h=0.02',
        'integrator.error_tolerance=1e-4',
    ),
    'penalties': ('slider_crank', TOLERANCE, *ADAPTIVE),
    'constant': ('slider_crank', 'integrator.step_policy=constant'),
    'rescue': ('slider_crank',),
}


def of(name: str) -> Simulation:
    scene, *overrides = RUNS[name]
    return Simulation(load_scene(scene, overrides))


def changed(saved: bytes, **arrays: np.ndarray | None) -> bytes:
    """A saved state with other arrays; None: without that one."""
    file = io.BytesIO()
    with np.load(io.BytesIO(saved)) as own:
        content = {**{name: own[name] for name in own.files}, **arrays}
    np.savez(file, **{name: array for name, array in content.items() if array is not None})  # type: ignore[arg-type]
    return file.getvalue()


@pytest.mark.parametrize('name', ['error', 'penalties', 'constant'])
def test_a_run_that_was_resumed_reports_what_one_without_a_stop_does(name: str) -> None:
    """From its state in a new simulation and in the one that went on, and from its pickle, from where it has adapted
    already."""
    s = of(name)
    s.advance(40)
    saved, pickled, before = s.save(), pickle.dumps(s), s.totals()
    assert name == 'constant' or before['events'] > 0, 'nothing adapted, nothing is shown'
    s.advance(40)
    totals, found = s.totals(), [str(f) for f in findings(s)]
    assert totals['substeps'] >= 80
    other = of(name)
    other.advance(7)
    other.restore(saved)
    s.restore(saved)
    for again in (other, pickle.loads(pickled), s):
        assert again.totals() == before
        again.advance(40)
        assert again.totals() == totals
        assert [str(f) for f in findings(again)] == found
    s.reset()
    s.advance(80)
    assert s.totals() == totals


def test_counts_are_whole_numbers_after_a_restart_too() -> None:
    s, other = of('error'), of('error')
    s.advance(10)
    other.restore(s.save())
    assert {name: type(value) for name, value in other.totals().items()} == {
        name: type(value) for name, value in s.totals().items()
    }


def test_steps_of_a_run_with_constant_steps_are_counted_by_one_that_may_divide_them() -> None:
    constant, rescuing = of('constant'), of('rescue')
    constant.advance(30)
    rescuing.restore(constant.save())
    assert rescuing.totals() == constant.totals()
    rescuing.advance(10)
    assert rescuing.totals()['substeps'] == 40


SAVE_ANEW = 'save it anew with this version, or go on with the version that saved it'
FORMATS = {
    'of 0.1': (
        None,
        f'restore: the saved state has format 1, and this version of mbd_sim_ros reads format {FORMAT}: {SAVE_ANEW}',
    ),
    'older': (
        FORMAT - 1,
        f'has format {FORMAT - 1}, and this version of mbd_sim_ros reads format {FORMAT}: {SAVE_ANEW}',
    ),
    'newer': (
        FORMAT + 1,
        f'has format {FORMAT + 1}, and this version of mbd_sim_ros reads format {FORMAT}: update mbd_sim_ros',
    ),
    'several numbers': ([FORMAT, 1], 'restore: format has shape (2,)'),
    'text': ('2', 'restore: format has'),
}


@pytest.mark.parametrize('name', FORMATS)
def test_a_state_of_another_format_is_refused_and_changes_nothing(name: str) -> None:
    number, says = FORMATS[name]
    s = of('constant')
    s.advance(5)
    before = s.save()
    with pytest.raises(SpecError, match=re.escape(says)):
        s.restore(changed(before, format=None if number is None else np.array(number)))
    assert s.save() == before


@pytest.mark.parametrize('name', ['totals', 'switches'])
def test_a_state_with_a_damaged_past_is_refused_and_changes_nothing(name: str) -> None:
    s = of('constant')
    s.advance(5)
    before = s.save()
    with pytest.raises(SpecError, match=f'restore: {name} has shape'):
        s.restore(changed(before, **{name: np.zeros(3)}))
    assert s.save() == before


def test_a_batch_that_goes_on_from_a_state_counts_its_own_steps() -> None:
    """One iteration, factorization and evaluation more, of outputs, in each step of it, whatever was made before."""
    s = Simulation(load_scene('slider_crank', ['integrator.step_policy=constant', 'integrator.iterations=1']))
    whole = simulate(s, 100)
    s.reset()
    s.advance(60)
    saved = s.save()
    figures = simulate(s, 100, state=saved)
    assert figures['steps'] == 100
    for name in ('iterations_per_step', 'factorizations_per_step', 'evaluations_per_step'):
        assert figures[name] == pytest.approx(whole[name], rel=0.1)


def test_a_single_track_keeps_its_counters() -> None:
    s = simulation_of(load_scene('car_step_steer', ['fidelity=single_track']))
    s.advance(30)
    saved, totals = s.save(), s.totals()
    s.reset()
    assert s.totals() != totals
    s.restore(saved)
    assert s.totals() == totals
