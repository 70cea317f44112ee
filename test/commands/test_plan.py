"""mbd plan: files, JSON and exit code; `fidelity: auto` takes the kept plan of exactly this scene."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path

import pytest
from browser import blocks_of, data_of

from mbd_sim_ros.analysis import plan_page
from mbd_sim_ros.commands.main import main
from solver import load_scene
from solver.levels.auto import keep, plan_of
from solver.trade import certificate
from solver.trade.search import Search

SCENE = ['light_car_step_steer', '--set', 'duration=1', '--set', 'maneuver.steering.start=0.2']
LIMIT = ['--set', 'require={yaw_rate: {rms: 2 %}}']


def document(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, dict]:
    code = main([*argv, '--json'])
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.long
@pytest.mark.slow
def test_a_plan_is_written_and_fidelity_auto_takes_it(capsys, tmp_path: Path) -> None:
    code, refused = document(
        capsys, 'run', *SCENE, '--set', 'require={yaw_rate: {rms: 1.9 %}}', '--set', 'fidelity=auto', '--no-record'
    )
    assert (code, refused['status']) == (2, 'error')
    assert 'make one with mbd plan' in refused['error']
    code, data = document(capsys, 'plan', *SCENE, *LIMIT, '--out', str(tmp_path), '--unseen', '2', '--workers', '1')
    assert code == 0
    assert {'status', 'fidelity', 'settings', 'cost_ratio', 'errors', 'unseen'} <= set(data)
    assert data['status'] == 'ok'
    assert (data['unseen']['passed'], data['unseen']['failed']) == (2, 0)
    assert json.loads((tmp_path / 'certificate.json').read_text())['hash'] == data['hash']
    page = data_of(tmp_path / 'plan.html')
    assert [len(b['names']) for b in blocks_of(page, 'bars')] == [1, 2]  # errors by origin, maneuvers it has not seen
    assert [len(b['charts']) > 0 for b in blocks_of(page, 'charts')] == [True, True]  # curves, and what was tried
    code, found = document(capsys, 'info', *SCENE, *LIMIT, '--set', 'fidelity=auto', '--brief')
    assert code == 0
    assert (found['fidelity'], found['h']) == ('auto', data['settings']['integrator']['h'])
    assert any(limit['quantity'] == 'lateral_acceleration' for limit in found['level']['validity'])
    code, found = document(capsys, 'run', *SCENE, *LIMIT, '--set', 'fidelity=auto', '--no-record')
    assert found['steps'] == round(1.0 / data['settings']['integrator']['h'])
    assert found['accuracy'] == {'required': ['yaw_rate'], 'certificate': data['hash']}
    code, again = document(capsys, 'run', str(tmp_path / 'scene.yaml'), '--no-record')
    assert (again['steps'], again['accuracy']) == (found['steps'], found['accuracy'])
    code, coarse = document(capsys, 'run', *SCENE, *LIMIT, '--no-record')
    assert coarse['accuracy']['certificate'] is None
    code, other = document(
        capsys, 'run', *SCENE, *LIMIT, '--set', 'start.speed=21', '--set', 'fidelity=auto', '--no-record'
    )
    assert (code, other['status']) == (2, 'error')


@pytest.mark.slow
def test_what_cannot_be_had_ends_with_a_code_and_says_what_has_to_give(capsys, tmp_path: Path) -> None:
    budget = ['--set', 'budget.real_time_factor=1e9', '--set', 'duration=0.4']
    code = main(['plan', *SCENE, *LIMIT, *budget, '--out', str(tmp_path), '--unseen', '1', '--workers', '1'])
    out = capsys.readouterr().out
    assert code == 1
    assert 'what has to give' in out
    assert 'real time; the budget asks for 1e+09' in out


def test_refusals_are_one_sentence(capsys) -> None:
    for argv, sentence in (
        (['plan', 'light_car_step_steer'], 'no accuracy is required'),
        (['plan', *SCENE, *LIMIT, '--workers', '0'], '--workers = 0: must be > 0'),
        (['plan', *SCENE, '--set', 'require.yaw_rat.rms=2 %'], "did you mean 'yaw_rate'"),
    ):
        assert main(argv) == 2
        err = capsys.readouterr().err
        assert sentence in err
        assert err.count('\n') == 1


KEYS = {'status', 'fidelity', 'settings', 'cost_ratio', 'errors', 'unseen'}
GUIDED = ['spring_mass', '--set', 'duration=0.3', '--set', 'require={joint_states/guide/position: {rms: 5 %}}']


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stores of plans, runs and knowledge for this test alone; kernels stay where they are."""
    monkeypatch.setattr('solver.disk.location', lambda: tmp_path / 'cache')
    monkeypatch.setattr('solver.levels.auto.location', lambda: tmp_path / 'cache')
    return tmp_path / 'cache'


def test_time_ends_a_plan_with_what_is_known(capsys, tmp_path: Path, own_cache: Path) -> None:
    code, data = document(capsys, 'plan', *GUIDED, '--out', str(tmp_path / 'out'), '--time', '1e-3', '--workers', '1')
    assert (code, data['status'], data['interrupted']) == (1, 'incomplete', False)
    assert set(data) >= KEYS and set(data['unseen']) >= {'passed', 'failed'}
    assert data['basis'] == 'rule of thumb' and data['settings'] == data['first'][0]['settings']
    assert any('the time was up' in note for note in data['notes'])
    assert (data['unseen']['passed'], data['errors']) == (0, {})


def test_an_interrupt_ends_a_plan_with_what_is_known(
    capsys, tmp_path: Path, own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C behind the coarse twin: its answer is told as what it is, with the code of an interrupted command, and the
    same command goes on from the runs that were made."""
    plain = Search.find_reference

    def struck(search: Search) -> bool:
        os.kill(os.getpid(), signal.SIGINT)
        while not search.allowance.ended():
            time.sleep(0.001)
        return plain(search)

    command = ['plan', *GUIDED, '--out', str(tmp_path / 'out'), '--workers', '1', '--unseen', '2']
    with monkeypatch.context() as patched:
        patched.setattr(Search, 'find_reference', struck)
        code, data = document(capsys, *command)
    assert (code, data['status'], data['interrupted']) == (130, 'incomplete', True)
    assert set(data) >= KEYS
    assert data['basis'] == 'coarse twin' and data['settings'] == data['first'][-1]['settings']
    assert data['give'][0].endswith('nothing of it is checked')
    code, data = document(capsys, *command)
    assert (code, data['status'], data['basis'], data['interrupted']) == (0, 'ok', 'certified', False)
    assert data['price']['runs_found'] >= 2  # those of the coarse twin
    assert {'cpu', 'full_run', 'full_runs', 'pays_from'} <= set(data['price'])


def test_first_answers_are_lines_before_the_end_and_the_price_stands_in_the_result(
    capsys, tmp_path: Path, own_cache: Path
) -> None:
    assert main(['plan', *GUIDED, '--out', str(tmp_path / 'out'), '--workers', '1', '--unseen', '2']) == 0
    out, err = capsys.readouterr()
    lines = [line for line in err.splitlines() if line.startswith('after ')]
    assert len(lines) == 2 and all('not checked' in line for line in lines)
    assert 'from the rule of thumb' in lines[0] and 'from the coarse twin' in lines[1]
    assert '2 of 2 other maneuvers passed, the worst at ' in out
    assert 'times the full run' in out and 'first answer' in out


def test_a_plan_that_had_no_time_leaves_a_certified_one_in_its_place(
    capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv('MBD_CACHE_DIR', str(tmp_path / 'cache'))
    scene = load_scene('pendulum', ['require={joint_states/pivot/position: {rms: 2 %}}'])
    certified = {'status': 'ok', 'hash': 'of the certified one'}
    assert keep(scene, certified)
    unseen = {'passed': 0, 'failed': 0, 'bound': None, 'largest': None}
    found = {
        'status': 'incomplete',
        'settings': None,
        'unseen': unseen,
        'give': [],
        'levels': {},
        'errors': {},
        'units': {},
        'took': 1.0,
    }
    monkeypatch.setattr(certificate, 'plan', lambda search: {**found, 'notes': []})
    monkeypatch.setattr(plan_page, 'write_page', lambda search, data, file, scene: None)
    code, data = document(
        capsys, 'plan', 'pendulum', '--set', 'require={joint_states/pivot/position: {rms: 2 %}}', '--out', str(tmp_path)
    )
    assert code == 1
    assert any('certified plan of this scene' in note for note in data['notes'])
    assert plan_of(scene) == certified
