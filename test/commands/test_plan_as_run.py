"""What a plan promises of `mbd run` is measured by the function that `mbd run` calls, with the same arguments."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from mbd_sim_ros import batch
from mbd_sim_ros.analysis import plan_page
from mbd_sim_ros.commands import plan
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.commands.plan import as_run, describe
from solver import load_scene


def test_a_plan_times_its_scene_as_mbd_run_does(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    calls: list[tuple[Any, ...]] = []
    simulate = batch.simulate

    def counted(simulation: Any, steps: int, **options: Any) -> dict[str, Any]:
        recorded = options.get('directory') is not None
        calls.append((simulation.scene.name, steps, recorded, simulation.scene.record, options.get('source')))
        return simulate(simulation, steps, **options)

    monkeypatch.setattr(batch, 'simulate', counted)
    shown = as_run(load_scene('pendulum', ['duration=0.05']))
    assert main(['run', 'pendulum', '--set', 'duration=0.05', '--out', str(tmp_path / 'run')]) in (0, 1)
    assert main(['run', 'pendulum', '--set', 'duration=0.05', '--no-record']) in (0, 1)
    assert calls[:2] == calls[2:]
    assert set(shown) == {'recorded', 'unrecorded'}
    assert min(shown.values()) > 0.0


SHOWN = '145 times real time, recording included; 641 with --no-record'


def found(**more: Any) -> dict[str, Any]:
    """A plan whose scene runs at 145 times real time with its recording, at 641 without, and whose steps alone make
    2750."""
    return {
        'status': 'ok', 'fidelity': 'full', 'settings': {'integrator': {'h': 0.02}, 'switches': []}, 'cost_ratio': 0.1,
        'give': [],
        'cost': {'real_time_factor': 2750.0},
        'unseen': {'passed': 2, 'failed': 0, 'bound': None, 'largest': 0.85}, 'notes': [],
        'levels': {},
        'out': 'out', 'took': 1.0, 'errors': {}, 'units': {}, **more,
    }  # fmt: skip


def timed(data: dict[str, Any], monkeypatch: pytest.MonkeyPatch, *settings: str) -> dict[str, Any]:
    monkeypatch.setattr('solver.levels.auto.chosen', lambda scene, data: scene)
    monkeypatch.setattr(plan, 'as_run', lambda scene: {'recorded': 145.0, 'unrecorded': 641.0})
    plan._time(load_scene('pendulum', settings), data)
    return data


def test_text_and_page_name_what_mbd_run_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    data = timed(found(), monkeypatch)
    assert SHOWN in describe(data)
    assert 'steps alone 2.75e+03 times real time' in describe(data)
    assert plan_page.verdict(data).startswith(
        'ok: full with h 0.02 costs 0.1 of the full vehicle at 1 ms; mbd run shows ' + SHOWN
    )
    assert 'mbd run' not in plan_page.verdict(found(status='no'))


@pytest.mark.parametrize(
    ('least', 'status', 'sentence'), [(100.0, 'ok', ''), (400.0, 'ok', 'note'), (1000.0, 'no', 'give')]
)
def test_what_every_run_has_to_keep_is_judged_by_what_mbd_run_shows(
    least: float, status: str, sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Steps alone keep all three, and a run of the last one would be suspect whatever it records."""
    data = timed(found(), monkeypatch, f'require.real_time_factor_min={least}')
    note = (
        'require.real_time_factor_min = 400 is kept with --no-record (641 times real time), not with the recording '
        '(145)'
    )
    give = (
        'mbd run shows 145 times real time, 641 with --no-record (steps alone: 2.75e+03); '
        'require.real_time_factor_min asks for 1000'
    )
    assert data['status'] == status
    assert data['notes'] == ([note] if sentence == 'note' else [])
    assert data['give'] == ([give] if sentence == 'give' else [])


@pytest.mark.slow
@pytest.mark.parametrize('duration', ['0.001', '0.002'])
def test_a_scene_of_one_step_is_planned(duration: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = [
        '--set',
        'require={joint_states/pivot/position: {rms: 2 %}}',
        '--set',
        f'duration={duration}',
        '--unseen',
        '1',
    ]
    assert main(['plan', 'pendulum', *options, '--workers', '1', '--out', str(tmp_path)]) == 0
    out = capsys.readouterr().out
    (shown,) = [line.split(maxsplit=2)[2] for line in out.splitlines() if line.startswith('mbd run')]
    assert f'mbd run shows {shown}' in (tmp_path / 'plan.html').read_text(encoding='utf-8')
