"""What settings cost: measured within the scene, in turn, so that what is said of two of them holds whatever the
machine does meanwhile."""

from __future__ import annotations

import itertools
from pathlib import Path
from types import SimpleNamespace

import pytest

import solver
from mbd_sim_ros.batch import simulate
from solver.scene import Scene
from solver.trade import cost
from solver.trade.setting import Setting

LASTS = 0.16  # s: less than the timing of a step takes, and one piece and a half of what is timed


def recorded(place: Path) -> Scene:
    """A scene that applies the inputs of a short recording."""
    scene = solver.load_scene('light_car_step_steer', [f'duration={LASTS}', 'integrator.h=0.002'])
    simulate(solver.simulation_of(scene), scene.steps, directory=place / 'drive', progress=False)
    return solver.load_scene('light_car_step_steer', [f'duration={LASTS}', f"maneuver={{bag: '{place / 'drive'}'}}"])


def test_the_inputs_of_a_recording_are_not_asked_for_beyond_its_end(tmp_path: Path) -> None:
    scene = recorded(tmp_path)
    found = [
        *cost.compared(scene, (Setting(h=8e-3, iterations=1), Setting(iterations=1))),
        cost.measured(scene, Setting(h=0.02)),
    ]
    assert all(0.0 < of.median <= of.p99 for of in found)
    per_step = cost.per_step(scene, Setting())
    assert per_step.fixed + per_step.evaluation > 0.0
    assert per_step.least < per_step.most


def test_settings_are_timed_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """From the second half on the machine takes three times as long for everything: the same setting costs the same
    nevertheless."""
    scene = solver.load_scene('light_car_step_steer', [f'duration={LASTS}'])
    pieces = 2 * cost.ROUNDS  # of one setting and of the other, one a round
    took = [1.0] * (pieces // 2) + [3.0] * (pieces // 2)
    clock = itertools.accumulate(itertools.chain.from_iterable((0.0, t) for t in took))
    monkeypatch.setattr(cost, 'time', SimpleNamespace(thread_time=lambda: next(clock)))
    first, second = cost.compared(scene, (Setting(iterations=1), Setting(iterations=1)))
    assert first.median == second.median == pytest.approx(1.0 / cost.PIECE)


@pytest.mark.parametrize('duration', [5e-4, 1e-3, 2e-3, 3e-3])
def test_a_scene_that_is_shorter_than_the_step_of_the_probe_is_timed(
    duration: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A scene of one step of 1 ms was refused for a step of 2.5 ms that nobody had asked for."""
    monkeypatch.setattr(cost, 'PROBE', 15)  # more steps than any of these scenes has
    scene = solver.load_scene('spring_mass', [f'duration={duration}', f'integrator.h={min(duration, 1e-3)}'])
    found = cost.per_step(scene, Setting())
    assert found.fixed + found.evaluation > 0.0
    assert 1.0 <= found.least <= found.most
