"""`fidelity: auto` takes the plan of exactly this scene, in the way in which it was measured, and no other."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import solver
from solver.errors import SceneError
from solver.inputs import recorded
from solver.levels import auto
from solver.levels.auto import key, plan_of, resolved
from solver.scene import Scene

LIMIT = 'require={yaw_rate: {rms: 2 %}}'
INTEGRATOR = {'h': 4e-3, 'rho_inf': 0.8, 'mode': 'fixed', 'iterations': 2}
PLAN: dict[str, Any] = {
    'status': 'ok', 'hash': 'abc', 'fidelity': 'full', 'settings': {'switches': {}, 'integrator': INTEGRATOR},
    'envelope': [],
    'findings': [],
}  # fmt: skip


@pytest.fixture
def planned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Scene]:
    """Loads a scene with fidelity auto, PLAN being kept for it."""
    monkeypatch.setattr(auto, 'location', lambda: tmp_path)  # the kernels stay where they are

    def load(*overrides: str) -> Scene:
        scene = solver.load_scene('light_car_step_steer', [LIMIT, 'fidelity=auto', *overrides])
        auto.keep(scene, PLAN)
        return scene

    return load


WHEELS = 'actuation={wheels: true}'


@pytest.mark.parametrize(
    'other',
    [
        'assistance={anti_lock: {}}',
        'actuation={wheels: true, actuators: {brake_torque: {lag: 0.3}}}',
        'maneuver.steering.value=0.5',
        'vehicle.chassis.mass=1300',
        'road={friction: 0.9}',
        'start.speed=21',
        'duration=3',
        'budget.real_time_factor=5',
        'require={yaw_rate: {rms: 1 %}}',
        'integrator.form=block',
    ],
)
def test_what_a_plan_depends_on_makes_it_another_one(planned: Callable[..., Scene], other: str) -> None:
    """Anti-lock control of the same car in the same maneuver brakes otherwise."""
    scene = planned(WHEELS)
    assert plan_of(scene) == PLAN
    assert plan_of(solver.load_scene('light_car_step_steer', [LIMIT, WHEELS, other])) is None


def test_a_recording_of_the_same_name_with_other_inputs_has_another_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    value = 0.3

    def read(path: str, channels: object, log_times: bool = False) -> recorded.Recorded:
        return recorded.Recorded(path, 1_000_000, 0, {'steering': np.full(10, value)}, {}, {}, 10)

    monkeypatch.setattr(auto, 'recorded', read)
    scene = solver.load_scene('light_car_step_steer', [LIMIT, 'maneuver={bag: bags/drive}'])
    before = key(scene)
    assert key(scene) == before
    value = 0.4
    assert key(scene) != before


@pytest.mark.parametrize(('every', 'kept'), [(1, 1), (10, 2), (3, 1)])
def test_a_recording_of_longer_steps_is_no_coarser_in_time(
    planned: Callable[..., Scene], every: int, kept: int
) -> None:
    """Ten steps of 1 ms are two of 4 ms."""
    scene = planned(f'record.every={every}', 'integrator.h=0.001')
    assert resolved(scene)[0].record.every == kept
    assert resolved(dataclasses.replace(scene, resolved=''))[0].record.every == kept


@pytest.mark.parametrize('kind', ['m_alf', 'reference_bdf'])
def test_it_is_integrated_as_it_was_measured(planned: Callable[..., Scene], kind: str) -> None:
    """A plan measures the kind alf alone; what it certifies says nothing about another."""
    simulation = solver.simulation_of(planned(f'integrator.kind={kind}'))
    assert (simulation.scene.integrator.kind, simulation.h) == ('alf', 4e-3)


def test_a_maneuver_of_the_road_wheels_finds_its_plan(planned: Callable[..., Scene]) -> None:
    """The plan is one of the scene as it is written, not of the angle at the steering wheel that the map makes of
    it."""
    scene = planned('maneuver={road_wheel: {kind: step, value: 0.03, start: 0.1, rise: 0.1}}')
    simulation = solver.simulation_of(scene)
    assert simulation.h == 4e-3
    steering = simulation.channels.inputs.index('steering')
    simulation.advance(100)
    assert simulation.inputs[steering] > 0.3  # by the ratio of the steering, 15


def test_without_the_plan_it_is_refused(planned: Callable[..., Scene]) -> None:
    scene = planned()
    (auto.location() / 'plans' / f'{auto.key(scene)}.json').unlink()
    with pytest.raises(SceneError, match='there is no plan of this scene as it stands'):
        solver.simulation_of(scene)


def test_an_incomplete_plan_is_told_from_one_that_found_nothing(planned: Callable[..., Scene]) -> None:
    scene = planned()
    auto.keep(scene, {**PLAN, 'status': 'incomplete', 'give': ['the search was ended after 9 s']})
    with pytest.raises(SceneError, match=r'incomplete: the search was ended after 9 s; make it anew, or name a level'):
        solver.simulation_of(scene)
    auto.keep(scene, {**PLAN, 'status': 'no', 'give': ['kc comes closest']})
    with pytest.raises(SceneError, match='found nothing that keeps what is required'):
        solver.simulation_of(scene)


def test_a_plan_that_cannot_be_kept_is_told_from_one_that_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = solver.load_scene('light_car_step_steer', [LIMIT])
    monkeypatch.setattr(auto, 'location', lambda: tmp_path)
    assert auto.keep(scene, PLAN)
    (tmp_path / 'file').touch()
    monkeypatch.setattr(auto, 'location', lambda: tmp_path / 'file')
    assert not auto.keep(scene, PLAN)
