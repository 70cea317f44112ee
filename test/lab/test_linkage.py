"""N four-bar linkages beside other programs: the exact solution, our errors, what becomes of peers that are there, fail
or are missing."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.commands.main import main
from mbd_sim_ros.lab.benchmarks import linkage, verdicts
from mbd_sim_ros.lab.benchmarks.linkage import EXUDYN, MUJOCO, MUJOCO_PROGRAM, OURS, STEPS, Linkage, exact, gap
from mbd_sim_ros.lab.peers.exudyn import MUJOCO_PYTHON, PYTHON, exudyn, mujoco, planar
from mbd_sim_ros.lab.peers.mujoco_linkage import tree
from solver.errors import SpecError
from solver.files.scene import load_scene
from solver.simulation import Simulation

LOOPS = ['mechanism.loops=3']


def test_the_exact_solution_keeps_the_energy_of_the_rods_and_closes_every_joint() -> None:
    times = np.linspace(0.0, 2.0, 2001)[1:]
    model = planar(Simulation(load_scene('four_bar_n', LOOPS)), times)
    places = exact(model, times)
    assert gap(model, places) < 1e-12
    # central differences, error h^2/6 of the third derivative
    rates = (places[2:] - places[:-2]) / (times[2] - times[0])
    m, inertia = (np.array([body[key] for body in model['bodies']]) for key in ('m', 'I'))
    kinetic = 0.5 * (rates[..., 0] ** 2 + rates[..., 1] ** 2) @ m + 0.5 * rates[..., 2] ** 2 @ inertia
    energy = kinetic + 9.81 * places[1:-1, :, 1] @ m
    start = 0.5 * sum(
        b['m'] * (b['vx'] ** 2 + b['vy'] ** 2) + b['I'] * b['w'] ** 2 + 2 * 9.81 * b['m'] * b['y']
        for b in model['bodies']
    )
    np.testing.assert_allclose(energy, start, rtol=1e-4)
    assert np.ptp(kinetic) > 50.0  # it moves through most of its potential energy


def test_a_gap_is_what_a_joint_is_open() -> None:
    model = planar(Simulation(load_scene('four_bar_n', LOOPS)), np.array([0.1]))
    places = exact(model, np.array([0.1]))
    places[0, -1, :2] += [0.003, 0.004]  # the last crank leaves its foot and the last rod
    assert gap(model, places) == pytest.approx(0.005, rel=1e-12)


def test_a_tree_reaches_every_body_once_and_the_other_joints_close_loops() -> None:
    model = planar(Simulation(load_scene('four_bar_n', LOOPS)), np.array([0.1]))
    branches, loops = tree(model)
    assert sorted(body for body, *_ in branches) == list(range(7))
    above = {-1}
    for body, parent, (a, _, b, _) in branches:
        assert parent in above and (a, b) == (parent, body)
        above.add(body)
    assert len(loops) == 3
    assert sorted([*([a, b] for _, _, (a, _, b, _) in branches), *([a, b] for a, _, b, _ in loops)]) == sorted(
        [a, b] for a, _, b, _ in model['revolutes']
    )
    with pytest.raises(ValueError, match='hang on nothing'):
        tree({'revolutes': [[0, [0, 0], 1, [0, 0]]]})


@pytest.fixture
def nobody(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Neither Exudyn nor MuJoCo is there."""
    for variable in (PYTHON, MUJOCO_PYTHON):
        monkeypatch.setenv(variable, str(tmp_path / 'nobody'))


@pytest.mark.slow
@pytest.mark.usefixtures('nobody')
def test_without_other_programs_our_runs_are_measured_and_a_line_says_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'suite.yaml').write_text('cases: {a: {measure: linkage, scene: four_bar_n, set: [mechanism.loops=3]}}')
    command = ['bench', '--suite', str(tmp_path / 'suite.yaml'), '--quick', '--json']
    assert main([*command, '--out', str(tmp_path / 'page.md')]) == 0
    (case,) = json.loads(capsys.readouterr().out)['cases']
    assert (case['status'], case['bodies'], case['simulated']) == ('ok', 7, 2.0)
    assert [(run['settings'], run['h']) for run in case['runs']] == [(name, h) for name in OURS for h in STEPS]
    errors = {(run['settings'], run['h']): run['error'] for run in case['runs']}
    for name in OURS:  # of second order, through singular positions
        assert errors[name, 2e-3] / errors[name, 1e-3] == pytest.approx(4.0, rel=0.1)
    assert all(run['gap'] < 1.0 for run in case['runs'])  # um
    assert list(case['figures']) == list(linkage.FIGURES)
    assert {key for key, value in case['figures'].items() if value is not None} == {'ours_1mm', 'ours_01mm'}
    exudyn_line, mujoco_line = case['left_out']
    assert exudyn_line.startswith('Exudyn is left out (') and PYTHON in exudyn_line
    assert mujoco_line.startswith('MuJoCo is left out (') and MUJOCO_PYTHON in mujoco_line
    page = (tmp_path / 'page.md').read_text()
    assert f'| a | {exudyn_line} |' in page and f'| a | {mujoco_line} |' in page
    assert main([*command, '--strict']) == 1  # not everything was measured


@pytest.mark.usefixtures('nobody')
def test_answers_of_other_programs_become_times_and_errors(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A stand-in for both answers each run by its number n: with the exact places moved by n mm in n s of CPU time, the
    first failed."""
    case = Linkage('four_bar_n', LOOPS, 2)
    start = np.array([[body[key] for key in ('x', 'y', 'phi')] for body in case._model['bodies']])
    stand_in = tmp_path / 'python'
    stand_in.write_text(
        f"""#!{sys.executable}
import json, sys
import numpy as np
places = np.array({case._exact.tolist()})
if 'exudyn' in sys.argv[-1]:  # which tells changes since t = 0, one after the other
    places = (places - np.array({start.tolist()})).reshape(2, -1)
    moved = np.tile([1e-3, 0.0, 0.0], 7)
else:
    moved = np.array([1e-3, 0.0, 0.0])
runs = json.load(sys.stdin)['runs']
results = [{{'values': (places + n * moved).tolist(), 'cpu': n}} for n in range(len(runs))]
print('noise\\n' + json.dumps({{'version': '7', 'results': [{{'error': 'no convergence'}}, *results[1:]]}}))
"""
    )
    stand_in.chmod(0o755)
    for variable in (PYTHON, MUJOCO_PYTHON):
        monkeypatch.setenv(variable, str(stand_in))
    case.round(2)
    found = case.figures()
    assert found['left_out'] == []
    for program, settings in (('Exudyn 7', EXUDYN), ('MuJoCo 7', MUJOCO)):
        failed, *runs = [run for run in found['runs'] if run['program'] == program]
        assert (failed['failed'], failed['us'], failed['error']) == ('no convergence', None, None)
        assert [(run['settings'], run['h']) for run in [failed, *runs]] == [
            (name, h) for name in settings for h in STEPS
        ]
        np.testing.assert_allclose([run['error'] for run in runs], 1e3 * np.arange(1, len(runs) + 1), rtol=1e-9)
        np.testing.assert_allclose([run['us'] for run in runs], 1e3 / 0.2 * np.arange(1, len(runs) + 1), rtol=1e-9)
    # a run that is moved by 1 mm is 1 mm wrong up to rounding; nothing but ours is within 0.1 mm
    assert {found['figures'][f'{program}_01mm'] for program in ('exudyn', 'mujoco')} == {None}
    (table,) = [table for table in verdicts.tables(_report(found)) if table.title == 'Runs of the linkages']
    assert [row[-3:] for row in table.rows if 'failed' in row] == [['failed', '', '']] * 2


def _report(found: dict) -> dict:
    return {
        'cases': [{'name': 'a', 'measure': 'linkage', 'status': 'ok', 'reason': '', 'targets': [], **found}],
        'growth': [],
    }


def test_other_scenes_are_refused() -> None:
    with pytest.raises(
        SpecError, match=r"scene 'pendulum': measure linkage knows the exact solution of four_bar_n alone"
    ):
        Linkage('pendulum', [], 2)


def test_exudyn_and_mujoco_find_the_exact_motion() -> None:
    times = linkage.EVERY * np.arange(1, 11)
    model = planar(Simulation(load_scene('four_bar_n', LOOPS)), times)
    places = exact(model, times)
    start = np.array([[body[key] for key in ('x', 'y', 'phi')] for body in model['bodies']])
    seen = 0
    for ask in (
        lambda: exudyn(model, [{'h': 1e-3, **EXUDYN['tolerance 1e-3']}]),
        lambda: mujoco(model, [linkage.soft_constraints('Euler, half damped', 1e-3)], MUJOCO_PROGRAM),
    ):
        try:
            _, (result,) = ask()
        except SpecError as error:
            assert 'is left out' in str(error)
            continue
        seen += 1
        values = np.array(result['values'])
        found = values if values.ndim == 3 else start + values.reshape(-1, 7, 3)
        assert np.abs((found - places)[..., :2]).max() < 1e-4
        assert gap(model, found) < 1e-5
    if not seen:
        pytest.skip('neither Exudyn nor MuJoCo is installed')
