"""A row is kept for as long as nothing changes that its case depends on, in its text or beside it."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from mbd_sim_ros.batch import simulate
from mbd_sim_ros.sweep.case import SweepCase, row_of
from mbd_sim_ros.sweep.design import SweepFigure
from solver import load_scene, simulation_of
from solver.levels import auto

FIGURES = {'turned': SweepFigure(quantity='joint_states/steering_wheel/position', take='final')}


def row(place: Path, *overrides: str) -> dict[str, Any]:
    rows = place / 'rows'
    rows.mkdir(exist_ok=True)
    text = load_scene('light_car_step_steer', ['duration=0.02', 'integrator.h=0.002', *overrides]).resolved
    return row_of(SweepCase(number=0, text=text, name='step', values={}, figures=FIGURES, rows=str(rows)))


def test_a_recording_that_is_made_anew_under_its_name_makes_a_row_anew(tmp_path: Path) -> None:
    """The steering wheel ends where it stood in the recording that is there."""
    bag, found = tmp_path / 'drive', {}
    for angle in (0.1, -0.2):
        shutil.rmtree(bag, ignore_errors=True)
        scene = load_scene(
            'light_car_step_steer', ['duration=0.02', 'integrator.h=0.002', f'maneuver={{steering: {angle}}}']
        )
        simulate(simulation_of(scene), scene.steps, directory=bag, progress=False)
        found[angle] = [row(tmp_path, f"maneuver={{bag: '{bag}'}}") for _ in range(2)]
    for angle, rows in found.items():
        assert rows[0] == rows[1]
        assert rows[0]['turned'] == pytest.approx(angle, abs=1e-6)
    assert len(list((tmp_path / 'rows').iterdir())) == 2


def test_another_plan_makes_a_row_of_fidelity_auto_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a plan it is refused, and with one it is not."""
    monkeypatch.setattr(auto, 'location', lambda: tmp_path)
    asked = 'require={yaw_rate: {rms: 2 %}}', 'fidelity=auto'
    settings = {'switches': {}, 'integrator': {'h': 4e-3, 'rho_inf': 0.8, 'mode': 'fixed', 'iterations': 2}}
    plan = {'status': 'ok', 'hash': 'abc', 'fidelity': 'full', 'settings': settings, 'envelope': [], 'findings': []}
    assert 'there is no plan' in row(tmp_path, *asked)['message']
    scene = load_scene('light_car_step_steer', ['duration=0.02', 'integrator.h=0.002', *asked])
    auto.keep(scene, plan)
    assert row(tmp_path, *asked)['status'] == 'ok'
    limit = {'quantity': 'longitudinal_velocity', 'unit': 'm/s', 'low': 0.0, 'high': 1.0}
    auto.keep(scene, plan | {'envelope': [limit]})
    assert row(tmp_path, *asked)['status'] == 'suspect'
