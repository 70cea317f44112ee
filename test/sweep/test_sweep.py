"""Sweeps: what is asked for is run, once, whatever dies or is interrupted, and the table has the same bits."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from browser import blocks_of, data_of
from pyarrow import parquet

from mbd_sim_ros.analysis.evaluation import judging
from mbd_sim_ros.bags import reader
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.sweep import case, workers
from mbd_sim_ros.sweep.case import SweepCase, row_of
from mbd_sim_ros.sweep.design import Parameter, Sweep, SweepFigure, load_sweep
from solver import load_scene, simulation_of
from solver.analysis.figures import all_figures, standing
from solver.disk import alone
from solver.errors import SceneError
from solver.findings import LevelReport, Limit

FILE = """
scene: pendulum
set: [duration=0.3]
parameters:
  integrator.h: {values: [0.01, 0.005]}
  mechanism.gravity: {values: ['[0, -9.81, 0]', '[0, -1.62, 0]']}
figures:
  lowest: {quantity: odom/pose/y, take: min}
  fast: {quantity: odom/twist/wz, take: peak}
"""


def swept(capsys: pytest.CaptureFixture[str], file: Path, out: Path, *options: str) -> dict:
    assert main(['sweep', str(file), '--out', str(out), '--json', *options]) == 0
    return json.loads(capsys.readouterr().out)


def test_a_grid_is_every_combination_and_its_figures_are_those_of_single_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    file = tmp_path / 's.yaml'
    file.write_text(FILE)
    found = swept(capsys, file, tmp_path / 'out', '--workers', '2')
    assert (found['cases'], found['cases_ok']) == (4, 4)
    table = parquet.read_table(found['table']).to_pylist()
    assert [row['case'] for row in table] == [0, 1, 2, 3]
    assert {(row['integrator.h'], row['mechanism.gravity']) for row in table} == {
        (h, g) for h in (0.01, 0.005) for g in ('[0, -9.81, 0]', '[0, -1.62, 0]')
    }
    for row in table:
        overrides = [
            'duration=0.3',
            f'integrator.h={row["integrator.h"]}',
            f'mechanism.gravity={row["mechanism.gravity"]}',
        ]
        simulation = simulation_of(load_scene('pendulum', overrides))
        shots = [simulation.snapshot()] + [simulation.advance(1) for _ in range(simulation.scene.steps)]
        body = simulation.channels.chassis or 0
        assert row['lowest'] == min(shot.pose[body, 1] for shot in shots)
        assert row['fast'] == max(abs(shot.twist[body, 5]) for shot in shots)
    assert 'lowest' in Path(found['report']).read_text()


def test_axes_of_the_report_name_their_units_as_the_file_writes_them(tmp_path: Path):
    """From the hints of the specifications: of a number, of one that is written in km/h, of one in a list; a count has
    none."""
    values = {
        'integrator.h': 0.001,
        'start.speed_kmh': 80,
        'integrator.iterations': 2,
        'vehicle.chassis.mass': 1250,
        'vehicle.chassis.inertia[2]': 2000,
        'vehicle.front.arm_pivots[0][2]': 0.205,
    }
    parameters = {name: {'values': [value]} for name, value in values.items()}
    figures = {'fastest': {'quantity': 'yaw_rate', 'take': 'peak'}}
    file = {'scene': 'light_car_straight', 'set': ['duration=0.01'], 'parameters': parameters, 'figures': figures}
    (tmp_path / 's.yaml').write_text(json.dumps(file))
    assert main(['sweep', str(tmp_path / 's.yaml'), '--out', str(tmp_path / 'out'), '--workers', '1']) == 0
    units = ('s', 'km/h', '', 'kg', 'kg m^2', 'm')
    charts = blocks_of(data_of(tmp_path / 'out' / 'report.html'), 'charts')[0]['charts']
    labels = [f'{name} [{unit}]' if unit else name for name, unit in zip(values, units, strict=True)]
    assert [chart['x'] for chart in charts] == labels
    assert {chart['y'] for chart in charts} == {'fastest [rad/s]'}


def test_finished_cases_are_not_run_again_and_the_table_keeps_its_bits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    file = tmp_path / 's.yaml'
    file.write_text(FILE)
    first = swept(capsys, file, tmp_path / 'out', '--workers', '1')
    before = Path(first['table']).read_bytes()
    rows = sorted((tmp_path / 'out' / 'rows').glob('*.json'))
    assert len(rows) == 4
    rows[0].write_text('{"status": "ok"')  # half written
    rows[1].unlink()
    kept = {row: row.stat().st_mtime_ns for row in rows[2:]}
    again = swept(capsys, file, tmp_path / 'out', '--workers', '2')
    assert Path(again['table']).read_bytes() == before
    assert {row: row.stat().st_mtime_ns for row in rows[2:]} == kept
    assert json.loads(rows[0].read_text().partition('\n')[2])['status'] == 'ok'


def test_what_cannot_be_written_at_the_end_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file, out = tmp_path / 's.yaml', tmp_path / 'out'
    file.write_text(FILE)
    for name in ('sweep.parquet', 'report.html', 'sweep.json'):
        (out / name).mkdir(parents=True)
        assert main(['sweep', str(file), '--out', str(out), '--workers', '1', '--json']) == 5
        told = json.loads(capsys.readouterr().out)
        assert told['status'] == 'error' and f'cannot write {out / name}: ' in told['error']
        (out / name).rmdir()


def test_failures_are_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / 's.yaml'
    file.write_text(FILE.replace('[0.01, 0.005]', '[0.01, -1.0]'))
    found = swept(capsys, file, tmp_path / 'out', '--workers', '1')
    assert (found['status'], found['cases_ok'], found['cases_error']) == ('suspect', 2, 2)
    for row in parquet.read_table(found['table']).to_pylist():
        bad = row['integrator.h'] == -1
        assert (row['status'] == 'error') == bad
        assert ('integrator.h' in row['message']) == bad
        assert math.isnan(row['fast']) == bad


def test_numbers_that_are_not_finite_are_a_failure(tmp_path: Path):
    """1e200 N on 1 kg have a power beyond 1.8e308 W after the first step; the case was ok."""
    force = (
        'mechanism={bodies: {b: {mass: 1, inertia: [1, 1, 1]}}, applied_forces: {f: {marker: b, force: [0, 0, '
        '1.0e+200]}}}'
    )
    text = load_scene('pendulum', ['duration=0.02', force]).resolved
    row = row_of(dataclasses.replace(case_of(tmp_path, fast=SweepFigure(quantity='odom/twist/vz')), text=text))
    assert row['status'] == 'error' and math.isnan(row['fast'])
    assert "output 'f/dissipation' is not finite" in row['message']


def pendulums(n: int, rows: Path) -> list[SweepCase]:
    text = load_scene('pendulum', ['duration=0.2']).resolved
    figures = {'fast': SweepFigure(quantity='odom/twist/wz')}
    return [
        SweepCase(
            number=i,
            text=text,
            name='pendulum',
            values={'integrator.h': 1e-3 * (1 + i % 5)},
            figures=figures,
            rows=str(rows),
        )
        for i in range(n)
    ]


def case_of(place: Path, number: int = 0, *, bags: bool = False, **figures: SweepFigure) -> SweepCase:
    for name in ('rows', 'bags'):
        (place / name).mkdir(parents=True, exist_ok=True)
    text = load_scene('pendulum', ['duration=0.02']).resolved
    where = str(place / 'bags') if bags else ''
    return SweepCase(
        number=number, text=text, name='pendulum', values={}, figures=figures, rows=str(place / 'rows'), bags=where
    )


def test_figures_that_change_their_names_are_not_mixed_up(tmp_path: Path):
    low, high = SweepFigure(quantity='odom/pose/y', take='min'), SweepFigure(quantity='odom/pose/y', take='max')
    first = row_of(case_of(tmp_path, a=low, b=high))
    again = row_of(case_of(tmp_path, b=low, a=high))
    assert first['a'] < first['b']
    assert (again['b'], again['a']) == (first['a'], first['b'])


def test_a_case_that_is_to_be_recorded_later_gets_its_bag_and_a_new_number_one_of_its_own(tmp_path: Path):
    figure = SweepFigure(quantity='odom/pose/y')
    bare = row_of(case_of(tmp_path, f=figure))
    assert 'bag' not in bare
    rows = [row_of(case_of(tmp_path, number, bags=True, f=figure)) for number in (0, 0, 1)]
    assert rows[0] == rows[1] and [row['f'] for row in rows] == 3 * [bare['f']]
    names = sorted(place.name for place in (tmp_path / 'bags').iterdir())
    assert names == [rows[0]['bag'], rows[2]['bag']]
    for row in rows:
        assert abs(reader.read(tmp_path / 'bags' / row['bag'])['odom/pose/y']).max() == bare['f']


def test_a_case_has_the_same_figures_whether_it_is_recorded_or_not_and_how_often(tmp_path: Path):
    """A swing of 1 s is seen at every step of 5 ms, though its bag has one of twenty; and a bag has all instants that
    were asked for, though figures of steps of 0.5 ms are of every second one."""
    taken = {
        'deepest': SweepFigure(quantity='odom/pose/y', take='min'),
        'when': SweepFigure(quantity='odom/twist/wz', take='peak_time'),
    }
    rows = {}
    for h, every, steps in ((0.005, 20, 200), (0.0005, 1, 40)):
        text = load_scene('pendulum', [f'integrator.h={h}', f'duration={h * steps}', f'record.every={every}']).resolved
        for bags in ('', str(tmp_path / 'bags')):
            row = row_of(SweepCase(number=steps, text=text, name='pendulum', values={}, figures=taken, bags=bags))
            rows[steps, bool(bags)] = row
        assert {name: rows[steps, True][name] for name in taken} == {name: rows[steps, False][name] for name in taken}
        recorded = reader.read(tmp_path / 'bags' / rows[steps, True]['bag'])
        assert np.array_equal(recorded.series['odom'].time_ns, np.arange(0, steps + 1, every) * round(h * 1e9))
    assert rows[200, True]['when'] % 0.1 > 1e-6  # between two instants of the bag


def test_what_a_killed_worker_left_of_a_bag_is_in_nobodys_way(tmp_path: Path):
    """Killed while it recorded, by another of the same number, as in a container that is started anew; or between bag
    and row."""
    case_ = case_of(tmp_path, bags=True, f=SweepFigure(quantity='odom/pose/y'))
    first = row_of(case_)
    bag = tmp_path / 'bags' / first['bag']
    (kept,) = (tmp_path / 'rows').iterdir()
    kept.unlink()
    assert row_of(case_) == first
    assert list(bag.parent.iterdir()) == [bag]
    kept.unlink()
    bag.rename(bag.with_name(f'{bag.name}.0-{os.getpid()}.part'))
    assert row_of(case_) == first
    assert list(bag.parent.iterdir()) == [bag]


def test_a_real_time_factor_is_not_judged_in_a_sweep_and_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / 's.yaml'
    file.write_text(FILE.replace('[duration=0.3]', '[duration=0.3, require.real_time_factor_min=2]'))
    assert main(['sweep', str(file), '--out', str(tmp_path / 'out')]) == SceneError.exit_code
    assert (
        'require.real_time_factor_min: rows do not depend on the machine, so it is not judged in a sweep; add'
        in capsys.readouterr().err
    )


def test_a_case_that_leaves_its_envelope_is_suspect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """As a run of its own is: a bound of 2 m/s^2 where the light car reaches 6."""

    def limited(scene):
        simulation = simulation_of(scene)
        limit = Limit(quantity='lateral_acceleration', unit='m/s^2', low=-2.0, high=2.0, why='certified')
        simulation.level = LevelReport(validity=(limit,))
        return simulation

    monkeypatch.setattr(case, 'simulation_of', limited)
    for angle, status in ((0.02, 'ok'), (0.9, 'suspect')):
        text = load_scene(
            'light_car_step_steer', ['duration=1', 'maneuver.steering.start=0.2', f'maneuver.steering.value={angle}']
        ).resolved
        bags = str(tmp_path / status)
        row = row_of(
            SweepCase(
                number=0, text=text, name='step', values={}, figures={'r': SweepFigure(quantity='yaw_rate')}, bags=bags
            )
        )
        assert row['status'] == status, row
        recorded = reader.read(Path(bags) / row['bag'], ['odom/*'])  # says the same as its row
        assert (
            recorded.metadata['status'] == status
            and '; '.join(found['text'] for found in recorded.findings) in row['message']
        )
        assert bool(recorded.findings) == (status == 'suspect')
        assert row['message'].startswith('The run leaves its envelope: lateral acceleration is') == (
            status == 'suspect'
        )


def test_a_directory_is_gone_on_with_by_one_command_at_a_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / 's.yaml').write_text(FILE)
    with alone(tmp_path / 'out'):
        assert main(['sweep', str(tmp_path / 's.yaml'), '--out', str(tmp_path / 'out')]) == 5
        assert main(['maneuver', 'iso7401_step', 'light_car', '--out', str(tmp_path / 'out')]) == 5
    assert capsys.readouterr().err.count('another mbd is at work there') == 2
    with alone(tmp_path / 'out'):
        pass


@pytest.mark.slow
def test_a_worker_that_dies_costs_nothing(tmp_path: Path):
    todo = pendulums(12, tmp_path)
    expected = [
        row_of(case) for case in pendulums(12, tmp_path / 'none' if (tmp_path / 'none').mkdir() is None else tmp_path)
    ]
    found = []
    with workers.Workers(2) as crew:
        for row in crew.run(todo):
            found.append(row)
            if len(found) == 3:
                os.kill(crew.at_work[0].process.pid, signal.SIGKILL)
    assert sorted(found, key=lambda row: row['case']) == expected


@pytest.mark.slow
def test_interrupted_as_soon_as_it_has_workers_a_sweep_leaves_none_behind(tmp_path: Path):
    """They import for a second, deaf to the terminal, with the pipes of the one who asked: who reads these would wait
    for them. He who lays out the cases imports as long, and is ended where he is."""
    sampled = {
        'parameters': {'start.speed_kmh': {'low': 65, 'high': 95}},
        'design': {'kind': 'latin_hypercube', 'samples': 4},
    }
    figures = {'figures': {'peak': {'quantity': 'yaw_rate'}}}
    (tmp_path / 's.yaml').write_text(json.dumps({'scene': 'light_car_straight', **sampled, **figures}))
    command = [
        sys.executable,
        '-m',
        'mbd_sim_ros.commands.main',
        'sweep',
        str(tmp_path / 's.yaml'),
        '--out',
        str(tmp_path / 'out'),
    ]
    process = subprocess.Popen(
        [*command, '--workers', '2'], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    children = Path(f'/proc/{process.pid}/task/{process.pid}/children')

    def of(pid: str) -> str:  # nothing of one that has ended, waited for or not
        with suppress(OSError):
            return Path(f'/proc/{pid}/cmdline').read_text()
        return ''

    end = time.monotonic() + 60.0
    while len(importing := [pid for pid in children.read_text().split() if 'spawn_main' in of(pid)]) < 2:
        assert time.monotonic() < end
        time.sleep(0.005)
    time.sleep(0.1)  # both know what to import
    os.killpg(process.pid, signal.SIGINT)
    process.wait(timeout=30)
    time.sleep(0.05)
    assert [pid for pid in importing if of(pid)] == []
    said = process.communicate()[1]
    assert (process.returncode, said.strip()) == (130, 'mbd: interrupted while starting mbd sweep')


@pytest.mark.slow
def test_a_sweep_that_is_interrupted_goes_on(tmp_path: Path):
    file = tmp_path / 's.yaml'
    steps = ', '.join(f'{1e-3 + 1e-5 * i:.6g}' for i in range(6))
    file.write_text(FILE.replace('[0.01, 0.005]', f'[{steps}]').replace('duration=0.3', 'duration=1.5'))
    command = [
        sys.executable,
        '-m',
        'mbd_sim_ros.commands.main',
        'sweep',
        str(file),
        '--out',
        str(tmp_path / 'out'),
        '--workers',
        '1',
    ]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    end = time.monotonic() + 120.0
    while len(list(tmp_path.glob('out/rows/*.json'))) < 3 and time.monotonic() < end:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGINT)
    said = process.communicate(timeout=30)[1]
    assert process.returncode == 130
    assert 'Traceback' not in said
    assert 'goes on' in said
    done = len(list(tmp_path.glob('out/rows/*.json')))
    assert 3 <= done < 12
    time.sleep(0.5)
    assert len(list(tmp_path.glob('out/rows/*.json'))) == done  # no worker was left behind
    assert subprocess.run([*command, '--json'], timeout=300, check=True, capture_output=True).returncode == 0
    assert parquet.read_table(tmp_path / 'out' / 'sweep.parquet').num_rows == 12


@pytest.mark.slow
def test_a_cluster_gives_the_same_rows(tmp_path: Path):
    distributed = pytest.importorskip('distributed')
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        from mbd_sim_ros.sweep.cluster import run_there

        (tmp_path / 'there').mkdir()
        (tmp_path / 'here').mkdir()
        there = sorted(
            run_there(pendulums(4, tmp_path / 'there'), cluster.scheduler_address), key=lambda row: row['case']
        )
    assert there == [row_of(case) for case in pendulums(4, tmp_path / 'here')]


def test_workers_elsewhere_get_the_arrays_that_a_scene_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """They have neither the memory of this process nor its disk: the scene was refused there."""
    pickle = pytest.importorskip('distributed').protocol.pickle
    from mbd_sim_ros.sweep.cluster import _with_arrays
    from solver import stored

    digest = stored.keep({'height': np.arange(6.0).reshape(2, 3)})
    sent = pickle.dumps(_with_arrays(stored.named_in(f'road: {{sha256: {digest}}}')))
    monkeypatch.setattr(stored, '_known', {})
    monkeypatch.setenv('MBD_CACHE_DIR', str(tmp_path))
    assert stored.find(digest) is None
    pickle.loads(sent).setup(None)
    assert stored.find(digest)['height'].tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]


@pytest.mark.parametrize(
    ('change', 'part'),
    [
        (('scene: pendulum', 'scene: pendulem'), 'pendulem'),
        (('integrator.h:', 'integrator.hh:'), 'hh'),
        (('odom/pose/y', 'odom/pose/yy'), 'odom/pose/yy'),
        (('{values: [0.01, 0.005]}', '{low: 1}'), 'low and high'),
        (('{values: [0.01, 0.005]}', '{low: 2, high: 1}'), 'below'),
        (('take: min', 'take: least'), 'take'),
        (('  lowest:', '  integrator.h:'), 'another column of the table'),
        (('{values: [0.01, 0.005]}', '{values: [0.01], low: 0.001}'), 'give values, or low and high'),
        (('[0.01, 0.005]', '[bad]'), 's.yaml: parameters: integrator.h'),
    ],
)
def test_wrong_files_are_one_sentence(
    change: tuple[str, str], part: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    file = tmp_path / 's.yaml'
    assert change[0] in FILE
    file.write_text(FILE.replace(*change))
    assert main(['sweep', str(file), '--out', str(tmp_path / 'out')]) != 0
    said = capsys.readouterr().err
    assert part in said and said.count('\n') == 1, said
    assert not (tmp_path / 'out').exists()


def test_files_may_be_values_and_the_scene_and_are_found_beside_the_sweep(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """The example of docs/sweeps.md has `values: [maneuvers/step_steer.yaml, ...]`; these, and a scene, are names here,
    not contents."""
    work = tmp_path / 'work'
    work.mkdir()
    (work / 'mine.yaml').write_text('mechanism: mechanisms/pendulum.yaml\nduration: 0.2\n')
    (work / 'moon.yaml').write_text('[0, -1.62, 0]')
    text = FILE.replace('scene: pendulum', 'scene: mine.yaml').replace(
        "'[0, -9.81, 0]', '[0, -1.62, 0]'", 'work/moon.yaml'
    )
    (work / 's.yaml').write_text(text)
    monkeypatch.chdir(tmp_path)
    found = swept(capsys, Path('work/s.yaml'), tmp_path / 'out', '--workers', '1')
    assert (found['cases'], found['cases_ok']) == (2, 2)
    assert load_sweep('work/s.yaml').scene == 'work/mine.yaml'
    (work / 'figures.yaml').write_text('lowest: {quantity: odom/pose/y, take: min}')
    # anything else is included as everywhere
    (work / 't.yaml').write_text(text[: text.index('figures:')] + 'figures: figures.yaml\n')
    assert load_sweep('work/t.yaml').figures == {'lowest': SweepFigure(quantity='odom/pose/y', take='min')}


def test_a_file_is_found_by_name_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / 'config' / 'sweeps').mkdir(parents=True)
    (tmp_path / 'config' / 'sweeps' / 'mine.yaml').write_text(FILE)
    monkeypatch.chdir(tmp_path)
    assert load_sweep('mine').scene == 'pendulum'


def test_a_worker_is_deaf_to_the_terminal_from_its_first_instruction(tmp_path: Path):
    """Ctrl-C reaches all processes of a terminal; one that were still importing would say so with a traceback."""
    import multiprocessing

    from mbd_sim_ros.sweep.workers import Worker

    worker = Worker(multiprocessing.get_context('spawn'))
    try:
        status = Path(f'/proc/{worker.process.pid}/status').read_text()
        blocked = int(status.partition('SigBlk:')[2].split()[0], 16)
        assert blocked >> (signal.SIGINT - 1) & 1
        assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    finally:
        worker.end()


def test_numerical_errors_are_measured_in_a_sample_of_the_cases_and_decide_where_all_have_them(tmp_path) -> None:
    """A body of 10 g that vibrates by 1 mm, a hundred radians a step, on one that falls by 0.2 m: a check decides in a
    sample, and the error where all are measured."""
    text = (
        'mechanism:\n  bodies:\n    a: {mass: 1, inertia: [1, 1, 1]}\n    b: {mass: 0.01, inertia: [1, 1, 1]}\n  '
        'joints:\n    g: {kind: prismatic, i: world, j: a, at: [0, 0, 0], axis: [0, 0, 1]}\n    k: {kind: prismatic, '
        'i: a, j: b, at: [0, 0, 0], axis: [0, 0, 1]}\n  coordinate_forces: {s: {terms: [[g, 1]], spring: 100}, t: '
        '{terms: [[k, 1]], spring: 1e8}}\nstart: {coordinates: {k: {value: 0.001}}}\nduration: 2\n'
    )
    figures = {'fall': SweepFigure(quantity='odom/pose/z', take='peak')}

    def case(twin: str) -> dict:
        return row_of(
            SweepCase(number=0, text=text, name='fall', values={}, figures=figures, rows=str(tmp_path), twin=twin)
        )  # type: ignore[arg-type]

    assert case('')['status'] == 'suspect' and 'errors' not in case('')
    told = case('told')
    assert told['status'] == 'suspect' and told['errors']['figures']['fall'] < 1e-3
    assert told['errors']['text'].startswith('Numerical error (double step)')
    assert case('')['status'] == 'suspect' and 'errors' not in case('')  # the same row
    assert case('decides')['status'] == 'ok'
    assert len([*tmp_path.iterdir()]) == 2


@pytest.mark.parametrize(('count', 'sampled'), [(1, [0]), (5, [0, 1, 2, 3, 4]), (32, [0, 4, 8, 12, 16, 20, 24, 28])])
def test_the_sample_is_the_first_case_of_every_eighth(count: int, sampled: list[int]) -> None:
    from mbd_sim_ros.commands.sweep import _twin

    figures = {'x': SweepFigure(quantity='odom/pose/x')}
    sweep = Sweep(scene='pendulum', parameters={'integrator.h': Parameter(values=(1e-3,))}, figures=figures)
    assert [i for i in range(count) if _twin(sweep, i, count) == 'told'] == sampled
    assert all(_twin(dataclasses.replace(sweep, errors='all'), i, count) == 'decides' for i in range(count))
    assert not any(_twin(dataclasses.replace(sweep, errors='none'), i, count) for i in range(count))


@pytest.mark.slow
def test_figures_of_evaluations_and_of_the_vehicle_are_outputs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a case they have the bits of `mbd evaluate` of its recording and of `mbd info` of its vehicle, kept recordings
    or not; what a run does not have makes it suspect, with the reason, and a second call runs nothing."""
    file = tmp_path / 's.yaml'
    figures = {
        'gain': {'evaluation': 'iso7401_step', 'figure': 'yaw_rate_gain'},
        'same': {'figure': 'yaw_rate_gain'},
        'heave': {'info': 'bounce_frequency'},
        'peak': {'quantity': 'yaw_rate'},
    }
    what = {
        'scene': 'light_car_step_steer',
        'set': ['duration=5', 'maneuver.evaluation=iso7401_step'],
        'parameters': {'vehicle.chassis.mass': {'values': [1000, 1300]}},
        'errors': 'none',
    }
    file.write_text(json.dumps({**what, 'figures': figures, 'record': True}))
    found = swept(capsys, file, tmp_path / 'out', '--workers', '1')
    table = parquet.read_table(found['table']).to_pylist()
    assert [row['status'] for row in table] == ['ok', 'ok'] and found['without_value'] == []
    for row in table:
        run, held, scene = judging.read(tmp_path / 'out' / 'bags' / row['bag'])
        result = judging.judge(judging.called('iso7401_step')[0], run, '', {}, held=held, scene=scene)
        assert row['gain'] == row['same'] == result['yaw_rate_gain']
        assert scene is not None and row['heave'] == all_figures(standing(scene)).found['bounce_frequency']
    assert '1/s' in Path(found['report']).read_text()  # the unit of the figure comes with it

    more = {**figures, 'none': {'figure': 'yaw_rate_gian'}}
    del more['peak'], more['heave']
    file.write_text(json.dumps({**what, 'figures': more}))
    assert main(['sweep', str(file), '--out', str(tmp_path / 'other'), '--workers', '1', '--json']) == 1
    found = json.loads(capsys.readouterr().out)
    assert (found['status'], found['without_value']) == ('suspect', ['none'])
    again = parquet.read_table(found['table']).to_pylist()
    assert [row['gain'] for row in again] == [row['gain'] for row in table]
    assert "did you mean 'yaw_rate_gain'?" in again[0]['message']
    assert not list((tmp_path / 'other' / 'rows').glob('*.part'))


def test_a_vehicle_alone_is_asked_for_without_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures of the vehicle have those bits of a mass that nobody drives; a mechanism has none."""
    monkeypatch.setattr(case, 'simulation_of', None)
    text = load_scene('light_car_straight').resolved
    figures = {'mass': SweepFigure(info='mass'), 'rate': SweepFigure(info='wheel_rate_front')}
    row = row_of(SweepCase(number=0, text=text, name='x', values={'vehicle.chassis.mass': 1111.0}, figures=figures))
    base = all_figures(standing(load_scene('light_car_straight', ['vehicle.chassis.mass=1111']))).found
    assert (row['mass'], row['rate'], row['status']) == (base['mass'], base['wheel_rate_front'], 'ok')
    row = row_of(
        SweepCase(number=0, text=load_scene('pendulum').resolved, name='x', values={}, figures={'m': figures['mass']})
    )
    assert row['status'] == 'suspect' and math.isnan(row['m']) and 'is no vehicle' in row['message']


@pytest.mark.parametrize(
    ('figure', 'sentence'),
    [
        ('{}', 'give one of quantity'),
        ('{quantity: yaw_rate, info: mass}', 'give one of quantity'),
        ('{evaluation: iso7401_step}', 'needs the name of a figure'),
        ('{evaluation: iso7401_stpe, figure: speed}', "did you mean 'iso7401_step'"),
        ('{evaluation: iso4138, figure: speed}', 'is a norm of several maneuvers; take one of iso4138_constant_radius'),
        ('{info: bounce_frequnecy}', "did you mean 'bounce_frequency'"),
        ('{quantity: yaw_rat}', 'yaw_rate'),
    ],
)
def test_figures_that_cannot_be_are_refused_before_anything_runs(
    figure: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 's.yaml'
    file.write_text(
        'scene: light_car_step_steer\nparameters: {vehicle.chassis.mass: {values: [1000]}}\n'
        f'figures:\n  x: {figure}\n'
    )
    assert main(['sweep', str(file), '--out', str(tmp_path / 'out')]) == 2
    assert sentence in (told := capsys.readouterr().err) and told.count('\n') == 1
    assert not (tmp_path / 'out').exists()
