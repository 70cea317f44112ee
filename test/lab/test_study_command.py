"""mbd study: quick studies write what they promise and judge it; errors are one sentence."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.commands.main import main
from mbd_sim_ros.lab.studies import STUDIES, module, work_precision
from solver.files.scene import load_scene


def run(capsys: pytest.CaptureFixture[str], *argv: str) -> tuple[int, str, str]:
    code = main(['study', *argv])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def quick(capsys: pytest.CaptureFixture[str], name: str, out: Path) -> dict:
    """A quick study as JSON, with everything in place that the contract of studies promises."""
    code, text, err = run(capsys, name, '--quick', '--json', '--out', str(out))
    assert (code, err, text.count('\n')) == (0, '', 1)
    found = json.loads(text)
    assert (found['status'], found['study'], found['quick']) == ('ok', name, True)
    assert found['missed'] == [check['name'] for check in found['checks'] if not check['met']]
    report = (out / 'report.md').read_text()
    assert report.startswith('# ')
    for check in found['checks']:
        assert set(check) == {'name', 'value', 'limit', 'met'}
        assert f'| {check["name"]} |' in report
    pictures = sorted(path.name for path in out.glob('*.png'))
    assert pictures
    assert all(f']({name})' in report for name in pictures)
    return found


def rows(file: Path) -> list[dict[str, str]]:
    with file.open(encoding='utf-8') as f:
        return list(csv.DictReader(f))


def test_help_lists_every_study_with_its_summary(capsys):
    with pytest.raises(SystemExit) as caught:
        main(['study', '--help'])
    assert caught.value.code == 0
    text = capsys.readouterr().out
    for name in STUDIES:
        assert f'{name:20} {module(name).SUMMARY}' in text


def test_an_unknown_study_is_one_sentence_and_makes_no_directory(capsys, tmp_path):
    code, out, err = run(capsys, 'slider_cank', '--out', str(tmp_path / 'new'))
    assert (code, out, err.count('\n')) == (2, '', 1)
    assert "did you mean 'slider_crank'?" in err
    assert not (tmp_path / 'new').exists()


def test_a_directory_that_cannot_be_written_is_one_sentence(capsys, tmp_path):
    (tmp_path / 'file').write_text('in the way')
    code, out, err = run(capsys, 'penalty_map', '--quick', '--out', str(tmp_path / 'file'))
    assert (code, out, err) == (5, '', f'mbd: --out {tmp_path / "file"}: File exists; choose another place\n')


@pytest.mark.slow
def test_strict_fails_when_a_check_is_not_met(capsys, tmp_path, monkeypatch):
    """The same study with and without --strict, one of its limits set where no run can meet it."""
    monkeypatch.setitem(module('slider_crank_phases').__dict__, 'LOWEST_ORDER', 100.0)
    monkeypatch.setitem(module('slider_crank_phases').__dict__, 'QUICK_PHASES', 1)
    arguments = ('slider_crank_phases', '--quick', '--out', str(tmp_path))
    code, out, _ = run(capsys, *arguments)
    assert code == 0
    assert 'NOT MET' in out
    code, out, _ = run(capsys, *arguments, '--strict')
    assert code == 1


@pytest.mark.slow
def test_slider_crank_judges_every_claim_of_the_chapter_by_its_numbers(capsys, tmp_path):
    found = quick(capsys, 'slider_crank', tmp_path)
    assert found['missed'] == []
    claims = rows(tmp_path / 'claims.csv')
    assert len(claims) == 7
    assert {claim['verdict'] for claim in claims} <= {'confirmed', 'confirmed in part', 'not reproduced'}
    masses = rows(tmp_path / 'effective_masses.csv')
    assert len(masses[0]) == 1 + 2 * 26
    # a fixed joint of two bodies at rest: 1 kg against the world
    assert float(masses[0]['base/x isolated']) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.slow
def test_slider_crank_phases_keep_all_limits_with_both_settings(capsys, tmp_path):
    found = quick(capsys, 'slider_crank_phases', tmp_path)
    assert found['missed'] == []
    for name in ('default', 'conserving'):
        assert [float(row['h']) for row in rows(tmp_path / f'phases_{name}.csv')] == [0.02, 0.01, 0.005]


@pytest.mark.long
@pytest.mark.slow
def test_penalty_map_shows_what_grows_with_the_penalty_and_that_the_settings_lose_nothing(capsys, tmp_path):
    found = quick(capsys, 'penalty_map', tmp_path)
    assert found['missed'] == []
    lost = {
        (row['scheme'], row['penalty']): row['lost']
        for row in found['rows']
        if row['h'] == 0.02 and row['form'] == 'condensed'
    }
    assert lost['conserving', 1e4] == lost['default', 1e6] == 0
    growth = {row['step [ms]']: row for row in found['growth']}
    # with the step and with the root of the penalty, once it exceeds one
    assert growth[20.0]['1e+06'] / growth[10.0]['1e+06'] == pytest.approx(2.0, rel=0.1)
    assert growth[10.0]['1e+06'] > 1.0 > growth[20.0]['10000']


@pytest.mark.long
@pytest.mark.slow
def test_drives_are_judged_against_the_truth_and_against_maneuvers(capsys, tmp_path):
    found = quick(capsys, 'drives', tmp_path)
    assert found['missed'] == []
    for row in (row for table in found['closed'].values() for row in table):
        assert row['told'] == 6
        assert row['hold the truth'] >= 4  # fewer of 6 at 95 %: once in 12000
    gradient = next(row for row in found['delivered'] if row['figure'] == 'understeer_gradient')
    assert gradient['drives'] == 1


@pytest.mark.slow
def test_validation_finds_ours_at_the_published_figures(capsys, tmp_path):
    found = quick(capsys, 'validation', tmp_path)
    assert found['missed'] == []
    assert {j['case'] for j in found['judgements']} >= {'A01', 'Cylindrical_Case03'}
    torque = next(
        j for j in found['judgements'] if (j['case'], j['quantity']) == ('Cylindrical_Case03', 'reaction torque')
    )
    assert torque['size'] > 1700.0 > 1e3 * torque['limiting']
    assert '| reaction torque [N m] | 5 | 1754.50 -129.869 129.869 |' in (tmp_path / 'report.md').read_text()


@pytest.mark.long
@pytest.mark.slow
def test_work_precision_measures_ours_and_says_what_is_left_out(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv('MBD_EXUDYN_PYTHON', str(tmp_path / 'no_such_python'))
    monkeypatch.setenv('MBD_MUJOCO_PYTHON', str(tmp_path / 'no_such_python'))
    found = quick(capsys, 'work_precision', tmp_path)
    for program in ('Exudyn', 'MuJoCo'):
        assert any(f'{program} is left out' in note and note.count('\n') == 0 for note in found['notes'])
    ours = [
        p
        for p in found['points']
        if p['method'] == 'ALF' and p['outcome'] == 'ok' and p['problem'] == 'regular slider-crank'
    ]
    errors = {p['setting']: p['error'] for p in ours}
    assert errors['h 25 ms'] / errors['h 5 ms'] > 0.5 * 5.0**2  # at least second order between these steps
    assert all(p['cpu'] > 0.0 and p['factorizations'] > 0 and p['evaluations'] > p['factorizations'] for p in ours)
    assert found['references'][0]['error estimate'] < 1e-6


@pytest.mark.slow
def test_mujoco_swings_as_the_reference_does_on_an_open_chain():
    """Its Runge-Kutta method of order four against our reference of a double pendulum: the two describe the same
    motion, angle by angle."""
    pytest.importorskip('mujoco', reason="a peer: pip install 'mbd_sim_ros[bench]'")
    problem = next(p for p in work_precision.PROBLEMS if p.name == 'double pendulum')._replace(
        duration=0.5, intervals=5
    )
    scene = load_scene(problem.scene, problem.overrides)
    instants = problem.duration * np.arange(1, problem.intervals + 1) / problem.intervals
    exact, estimate = work_precision._reference(problem, scene, instants)
    assert estimate < 1e-9
    points = work_precision._mujoco(problem, scene, instants, exact, (10, 20), 1)
    errors = {(p.method, p.setting): p.error for p in points}
    coarse, fine = (errors['MuJoCo RK4', f'h {h} ms'] for h in ('10', '5'))
    assert fine < 1e-5
    assert coarse / fine == pytest.approx(16.0, rel=0.5)
    coarse, fine = (errors['MuJoCo IMPLICIT', f'h {h} ms'] for h in ('10', '5'))
    assert coarse / fine == pytest.approx(2.0, rel=0.3)


def test_work_precision_goes_on_with_the_problem_it_was_in(tmp_path, monkeypatch):
    """Interrupted in its second problem, it does not begin the first again; what a missing peer left out is not
    kept."""
    asked: list[str] = []
    missing: list[str] = []

    def solved(problem, quick, progress):
        asked.append(problem.name)
        if len(asked) == 2:
            raise KeyboardInterrupt
        runs = [
            work_precision.Point(problem.name, 'ALF', f'h {n} ms', 1e-4 * n**2, 1.0 / n, 100 // n, 200 // n, 'ok')
            for n in (1, 2, 4)
        ]
        return {'points': [run._asdict() for run in runs], 'notes': missing, 'estimate': 1e-12}

    monkeypatch.setattr(work_precision, '_solved', solved)
    # they take longer than all the rest
    monkeypatch.setattr(work_precision.precision_report, 'picture', lambda *_: None)
    first, second = work_precision.QUICK

    def study() -> dict:
        return work_precision.study(tmp_path, quick=True, progress=lambda text, done: None)

    with pytest.raises(KeyboardInterrupt):
        study()
    found = study()
    assert asked == [first, second, second]
    assert len(found['points']) == 6
    study()
    assert asked == [first, second, second]
    missing.append('Exudyn is left out.')
    for file in (tmp_path / 'problems').iterdir():
        file.unlink()
    study()
    study()
    assert asked[3:] == [first, second] * 2


@pytest.mark.slow
@pytest.mark.long
def test_mechanisms_go_on_where_they_were_interrupted(capsys, tmp_path):
    """Five of them, then seven: of the first five only one is computed again, whose file is damaged."""
    drawn = quick_samples(capsys, tmp_path, 5)
    assert drawn['missed'] == []
    files = sorted((tmp_path / 'cells').iterdir())
    rows = [json.loads(file.read_text().partition('\n')[2]) for file in files]
    assert all([run['h'] for run in row['runs']] == [0.01, 0.005, 0.002, 0.001, 0.0005] for row in rows)
    before = {file: file.stat().st_mtime_ns for file in files[1:]}
    files[0].write_text(files[0].read_text()[:-20])
    quick_samples(capsys, tmp_path, 7)
    assert {file: file.stat().st_mtime_ns for file in files[1:]} == before
    assert json.loads(files[0].read_text().partition('\n')[2]) == rows[0]
    assert len(list((tmp_path / 'cells').iterdir())) == 7


def quick_samples(capsys, out: Path, n: int) -> dict:
    code, text, err = run(capsys, 'mechanisms', '--n', str(n), '--seed', '3', '--json', '--out', str(out))
    assert (code, err) == (0, '')
    return json.loads(text)


def test_samples_are_for_studies_that_draw_them(capsys, tmp_path):
    code, _, err = run(capsys, 'kandc', '--n', '3', '--out', str(tmp_path / 'new'))
    assert (code, err.count('\n')) == (2, 1)
    assert 'draws no samples' in err
    assert not (tmp_path / 'new').exists()
    code, _, err = run(capsys, 'mechanisms', '--n', '0', '--out', str(tmp_path / 'new'))
    assert code == 2
    assert '--n = 0: must be at least 1' in err


@pytest.mark.long
def test_stability_finds_nothing_silently_wrong(capsys, tmp_path):
    found = quick(capsys, 'stability', tmp_path)
    assert found['missed'] == []
    assert found['classes']['right'] > 0.3 * found['cells']
    assert found['classes']['silently wrong'] == 0


@pytest.mark.slow
def test_constants_find_what_one_number_does_and_go_on(capsys, tmp_path, monkeypatch):
    """Friction of the road under a start does nothing to a pendulum; a second study computes nothing again."""
    study = module('constants')
    all_of = study.constants(study.FOLDERS)
    chosen = [
        one for one in all_of if one.key in ('solver.start.initial_conditions.GRIP', 'solver.step.interval.ORDER')
    ]
    monkeypatch.setattr(study, 'constants', lambda *_: chosen)
    monkeypatch.setattr(study, 'members', lambda quick: [study.Member('pendulum', 0.05)])
    found = quick(capsys, 'constants', tmp_path)
    assert found['words'] == {'solver.start.initial_conditions.GRIP': 'nothing'}
    assert found['missed'] == []
    assert [row['changed to'] for row in found['rows']] == pytest.approx([0.1 / 3.0, 0.3])
    assert '| `ORDER` |' in (tmp_path / 'report.md').read_text()
    monkeypatch.setattr(study.Variant, 'run', lambda *_: pytest.fail('it was computed before'))
    assert quick(capsys, 'constants', tmp_path)['rows'] == found['rows']


@pytest.mark.slow
def test_verdicts_holds_runs_against_the_reference_and_goes_on_where_it_was(capsys, tmp_path, monkeypatch):
    """Two smooth mixtures: no run of 1 ms is wrong; of five steps and two penalties each run is judged once."""
    study = module('verdicts')
    monkeypatch.setattr(study, 'QUICK_SAMPLES', 2)
    found = quick(capsys, 'verdicts', tmp_path)
    assert [(row['of'], row['runs']) for row in found['steps']] == [
        *((f'{h:g} ms', 2) for h in (10, 5, 2, 1, 0.5)),
        ('all', 10),
    ]
    assert found['steps'][3]['off by more than 5%'] == found['steps'][-1]['failed or refused'] == 0
    assert found['steps'][4]['median error of ok'] < found['steps'][3]['median error of ok'] / 3.0  # second order
    for name in ('motion', 'simulate'):
        monkeypatch.setattr(study, name, lambda *_: pytest.fail('it was computed before'))
    assert quick(capsys, 'verdicts', tmp_path)['steps'] == found['steps']


def test_verdicts_counts_wrong_ok_and_right_suspect_runs():
    """Of runs that have a reference; one without and one that failed are counted beside them."""
    study = module('verdicts')
    runs = [('ok', 0.06), ('ok', 0.04), ('suspect', 0.009), ('suspect', 0.2), ('ok', None), ('error', None)]
    runs = [{'status': status, 'error': error} for status, error in runs]
    assert [study.of_run(run) for run in runs] == ['ok, but wrong', '', 'suspect, but right', '', '', 'error']
    line = study.line('all', runs)
    assert (line['ok'], line['off by more than 5%'], line['suspect'], line['within 1%']) == (2, 1, 2, 1)
    assert (line['no reference'], line['failed or refused']) == (1, 1)


@pytest.mark.slow
def test_change_points_finds_the_trend_of_the_step(capsys, tmp_path, monkeypatch):
    """Two linkages that pass fast: no run is an outlier, whatever the penalty; a run far off the trend is one."""
    study = module('change_points')
    chosen = [one for one in study.linkages() if one.name in ('rhombus', 'equal_slider_crank')]
    monkeypatch.setattr(study, 'linkages', lambda: chosen)
    found = quick(capsys, 'change_points', tmp_path)
    assert found['missed'] == []
    assert [row['linkage'] for row in found['passages']] == [one.name for one in chosen for _ in study.PENALTIES]
    assert all(row['ok'] + row['suspect'] == 3 for row in found['passages'])
    held = [{'status': 'ok', 'h': h, 'error': factor * h * h} for h, factor in ((0.01, 2.0), (0.02, 2.0), (0.04, 30.0))]
    assert study.trend(held) == 2.0
    assert study.outliers(held, 2.0) == held[2:]
