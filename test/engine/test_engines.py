"""What every engine owes a Simulation, and what becomes of a question that one cannot answer."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from single_tracks import simulation as single_track

from solver import simulation_of
from solver.engine.bodies import Bodies
from solver.engine.stepping import Stepping
from solver.errors import SpecError, StepError
from solver.files.scene import load_scene
from solver.inputs.maneuver import Maneuver
from solver.levels.single_track_engine import SingleTrack
from solver.reference.engine import Following
from solver.simulation import Simulation

REFERENCE = ['integrator.kind=reference_kkt', 'integrator.tolerance=1e-9', 'integrator.h=0.01']
MADE: dict[str, Callable[[], Simulation]] = {
    'stepping': lambda: simulation_of(load_scene('pendulum')),
    'following': lambda: simulation_of(load_scene('pendulum', REFERENCE)),
    'single_track': lambda: single_track(Maneuver(steering=0.3)),
}
ENGINES = {'stepping': Stepping, 'following': Following, 'single_track': SingleTrack}
GOES_ON = {
    'stepping': 0.0,
    'following': 1e-6,
    'single_track': 0.0,
}  # of a restored run: nothing, or its tolerance


@pytest.mark.parametrize('name', MADE)
def test_time_reset_and_saved_states_are_the_same_whatever_the_engine(name: str) -> None:
    s = MADE[name]()
    assert type(s.engine) is ENGINES[name]
    assert isinstance(s.engine.shown, Bodies) == s.of_bodies == (name != 'single_track')
    first = s.snapshot().numbers
    there = s.advance(20)
    assert (there.k, there.t_ns) == (20, 20 * s.h_ns)
    saved = s.save()
    ahead = s.advance(10).numbers
    s.restore(saved)
    np.testing.assert_array_equal(
        s.snapshot().numbers[s.snapshot().layout['pose'][0]], there.numbers[there.layout['pose'][0]]
    )
    np.testing.assert_allclose(
        s.advance(10).numbers, ahead, rtol=0.0, atol=GOES_ON[name] * max(1.0, float(np.abs(ahead).max()))
    )
    again = pickle.loads(pickle.dumps(s))
    assert again.k == s.k and type(again.engine) is type(s.engine)
    s.reset()
    assert s.k == s.totals()['substeps'] == 0
    np.testing.assert_array_equal(s.snapshot().numbers, first)


def test_a_failure_leaves_the_last_good_step() -> None:
    s = MADE['single_track']()
    s.advance(5)
    with pytest.raises(StepError, match=r'step 5: input .* is not finite; nothing was advanced'):
        s.advance(3, np.full(len(s.inputs), np.nan))
    assert s.k == 5


ASKED: dict[str, Callable[[Simulation], Any]] = {
    'state': lambda s: s.state,
    'kinematics': lambda s: s.kinematics,
    'scheme': lambda s: s.scheme,
    'outputs': lambda s: s.outputs,
    'feel': lambda s: s.feel(),
}


@pytest.mark.parametrize('what', ASKED)
def test_what_needs_bodies_is_refused_by_one_sentence_where_there_are_none(what: str) -> None:
    with pytest.raises(SpecError, match='looks at the bodies of a model, and the level has none; take another level'):
        ASKED[what](MADE['single_track']())
    if what != 'feel':  # which needs assisted wheels
        assert ASKED[what](MADE['stepping']()) is not None


def test_a_reference_takes_no_inputs_and_goes_on_at_another_time_where_it_is_renumbered() -> None:
    """A pendulum does not know the time: the next second after step 100 is that after step 0."""
    s = MADE['following']()
    with pytest.raises(SpecError, match='takes no other inputs'):
        s.advance(1, np.zeros(0))
    ahead = s.advance(10).numbers
    s.reset()
    s.renumber(100)
    later = s.advance(10)
    assert later.k == 110
    np.testing.assert_allclose(later.numbers, ahead, rtol=0.0, atol=1e-6 * float(np.abs(ahead).max()))


@pytest.mark.parametrize('name', MADE)
def test_a_state_of_another_engine_is_refused(name: str) -> None:
    other = MADE['single_track' if name != 'single_track' else 'stepping']()
    with pytest.raises(SpecError, match='restore: '):
        MADE[name]().restore(other.save())


def test_an_engine_refuses_a_kind_that_is_not_its_own() -> None:
    with pytest.raises(SpecError, match="kind = 'reference_kkt': this engine knows alf, m_alf"):
        Simulation(load_scene('pendulum', REFERENCE))
    with pytest.raises(SpecError, match="kind = 'alf': this engine knows reference_kkt"):
        Simulation(load_scene('pendulum'), Following)
