"""Scenes and simulations go to other processes, and runs to other threads."""

from __future__ import annotations

import pickle
import threading
from pathlib import Path

import pytest

import solver
from mbd_sim_ros.bags import reader
from mbd_sim_ros.batch import simulate


@pytest.mark.parametrize('name', ['slider_crank', 'light_car_step_steer'])
def test_a_scene_is_the_same_after_pickling(name):
    scene = solver.load_scene(name)
    again = pickle.loads(pickle.dumps(scene))
    assert again == scene
    assert (again.hash, again.resolved) == (scene.hash, scene.resolved)


@pytest.mark.parametrize(
    ('name', 'overrides'),
    [
        ('slider_crank', ['integrator.mode=tolerance', 'integrator.step_policy=error', 'integrator.h=0.01']),
        ('light_car_lane_change', []),  # a driver, who remembers
        ('pendulum', ['integrator.kind=reference_kkt']),
    ],
)
def test_a_simulation_goes_on_with_the_same_bits_after_pickling(name, overrides):
    simulation = solver.simulation_of(solver.load_scene(name, overrides))
    simulation.advance(20)
    again = pickle.loads(pickle.dumps(simulation))
    assert type(again) is type(simulation)
    assert (again.k, again.totals()) == (simulation.k, simulation.totals())
    if 'reference' not in simulation.scene.integrator.kind:  # those start anew, and agree to their tolerance
        assert again.advance(20).numbers.tobytes() == simulation.advance(20).numbers.tobytes()


def test_a_run_is_recorded_from_any_thread(tmp_path: Path):
    scene = solver.load_scene('slider_crank', ['duration=0.1'])
    found: dict[int, object] = {}

    def work(i: int) -> None:
        try:
            found[i] = simulate(solver.simulation_of(scene), scene.steps, directory=tmp_path / str(i))['status']
        except BaseException as error:  # whatever a thread ends with is the finding
            found[i] = error

    threads = [threading.Thread(target=work, args=(i,)) for i in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    assert found == {0: 'ok', 1: 'ok'}
    one, other = (reader.read(tmp_path / str(i)) for i in range(2))
    assert len(one.time) == scene.steps + 1
    for name in one.columns:
        assert (one[name] == other[name]).all(), name
