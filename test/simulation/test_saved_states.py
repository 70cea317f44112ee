"""A start and a saved state are copied: nothing of them is evaluated twice, and nobody can tell by a bit."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable

import numpy as np
import pytest

from solver import simulation_of
from solver.engine.bodies import Bodies
from solver.errors import SpecError, StepError
from solver.files.scene import load_scene
from solver.model.state import Saved
from solver.simulation import Simulation

SCENES: dict[str, list[str]] = {
    'slider_crank': [],
    'light_car_lane_change': [],  # a driver
    'light_car_step_steer': [
        'integrator.mode=tolerance',
        'integrator.step_policy=error',
        'integrator.error_tolerance=1e-3',
    ],
    'four_bar': ['record.branches=true'],
    'pendulum': ['integrator.step_policy=constant'],  # nothing adapts
}


@pytest.fixture(params=SCENES)
def simulation(request: pytest.FixtureRequest) -> Simulation:
    return simulation_of(load_scene(request.param, SCENES[request.param]))


def everything(simulation: Simulation) -> list[bytes]:
    """All that is shown, and the account, bit for bit."""
    snapshot, last = simulation.snapshot(), simulation.last_step
    arrays = (snapshot.numbers, last.phi, last.J, last.phi_t, last.lam, last.account.numbers, simulation.outputs)
    kin = simulation.kinematics
    return [snapshot.k, *(array.tobytes() for array in (*arrays, kin.p, kin.R, kin.v))]  # type: ignore[list-item]


def test_a_state_taken_up_in_memory_has_the_bits_of_one_from_a_file(simulation: Simulation) -> None:
    """Looked at at once, later, twice, or never: outputs and all that follows are those of the bytes alone, which are
    evaluated each time."""
    simulation.advance(30)
    saved = simulation.save()
    assert isinstance(saved, Saved)
    ahead = simulation.advance(20).numbers.tobytes()
    account = simulation.last_step.account.numbers.tobytes()
    pattern = []
    for looks in (0, 1, 2, 0, 1):
        simulation.restore(bytes(bytearray(saved)))  # other bytes each time
        simulation._restored = None
        cold = everything(simulation)
        simulation.restore(saved)
        for _ in range(looks):
            assert everything(simulation) == cold
        assert simulation.advance(20).numbers.tobytes() == ahead
        assert simulation.last_step.account.numbers.tobytes() == account
        pattern.append(cold)
    assert all(cold == pattern[0] for cold in pattern)


def test_a_start_is_evaluated_once(simulation: Simulation, monkeypatch: pytest.MonkeyPatch) -> None:
    first = everything(simulation)
    monkeypatch.setattr(Bodies, 'show', lambda *_: pytest.fail('evaluated again'))
    for n in (1, 25):
        simulation.advance(n)
        simulation.reset()
        assert everything(simulation) == first


def test_a_saved_state_is_evaluated_once_and_only_for_somebody(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []
    show = Bodies.show

    def counted(self: Bodies, u: np.ndarray) -> None:
        calls.append(1)
        show(self, u)

    monkeypatch.setattr(Bodies, 'show', counted)
    simulation = simulation_of(load_scene('light_car_step_steer'))
    states = [simulation.advance(5) and simulation.save() for _ in range(3)]
    calls.clear()
    for state in states:
        simulation.restore(state)
        simulation.advance(3)
        simulation.totals()
    assert not calls
    for state in [*states, *states]:
        simulation.restore(state)
        simulation.snapshot()
    assert len(calls) == len(states)
    other = simulation_of(simulation.scene)  # what one has shown is not the other's
    calls.clear()
    other.restore(states[0])
    assert other.snapshot().numbers.tobytes() and len(calls) == 1


def test_a_state_from_a_file_is_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = simulation_of(load_scene('pendulum'))
    simulation.advance(5)
    one, other = bytes(simulation.save()), bytes(simulation.advance(5) and simulation.save())
    read: list[bytes] = []
    make = Saved.__new__
    monkeypatch.setattr(Saved, '__new__', lambda cls, data, *rest: (read.append(data), make(cls, data, *rest))[1])
    for data in (one, one, other, other, one):
        simulation.restore(data)
        assert simulation.k == (5 if data == one else 10)
    assert read == [one, other, one]


def test_what_was_saved_does_not_change_with_the_simulation(simulation: Simulation) -> None:
    """Nor with what its caller writes into the arrays of a simulation."""
    simulation.advance(10)
    saved = simulation.save()
    before = {name: array.tobytes() for name, array in saved.arrays.items()}
    for _ in range(2):
        simulation.restore(saved)
        simulation.inputs[:] = 0.5
        simulation.state.q[:] += 1.0
        simulation.snapshot()
        simulation.restore(saved)
        simulation.advance(7)
        assert {name: array.tobytes() for name, array in saved.arrays.items()} == before


@pytest.mark.parametrize('copied', [copy.copy, copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
def test_copies_are_bytes(copied: Callable[[bytes], bytes]) -> None:
    saved = simulation_of(load_scene('pendulum')).save()
    assert copied(saved) == saved and type(copied(saved)) is bytes
    with pytest.raises(SpecError, match='the saved state is damaged'):
        Saved(saved[:-40])


@pytest.mark.parametrize('policy', ['constant', 'rescue'])
def test_a_failure_behind_a_restored_state_shows_that_state(policy: str) -> None:
    """Outputs after a failure are those before the call, looked at or not."""
    simulation = simulation_of(load_scene('light_car_step_steer', [f'integrator.step_policy={policy}']))
    simulation.advance(20)
    saved = simulation.save()
    rows = np.tile(simulation.inputs, (6, 1))
    rows[3:, simulation.channels.inputs.index('drive_torque')] = 1e300
    shown = []
    for looks in (True, False):
        simulation.restore(saved)
        if looks:
            simulation.snapshot()
        with pytest.raises(StepError):
            simulation.advance(6, rows)
        assert simulation.k == 23
        shown.append(simulation.snapshot().numbers.tobytes())
    assert shown[0] == shown[1]
    simulation.restore(saved)
    assert simulation.snapshot().numbers.tobytes() == shown[0]
