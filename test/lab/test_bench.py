"""The benchmark: shape of its report, the counters of fixed-cost steps, what it leaves untouched. No time is
asserted."""

from __future__ import annotations

import io
import json
import os
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbd_sim_ros.bags.recorder import StepRecorder
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.lab.benchmarks import overhead, stepping, verdicts
from mbd_sim_ros.lab.benchmarks.phases import PHASES, phase_times
from mbd_sim_ros.lab.benchmarks.suite import load_suite
from solver.errors import SceneError
from solver.files.scene import load_scene
from solver.simulation import Simulation

FIXED = ['integrator.mode=fixed', 'integrator.iterations=2']
SUITE = """
cases:
  easy: {scene: slider_crank, set: [integrator.mode=fixed], targets: {batch: 1e9}}
  impossible: {scene: pendulum, measure: record, targets: {overhead_p50: 1e-9}}
  missing: {scene: slider_crnk, targets: {batch: 20}}
"""


@pytest.fixture(scope='module')
def run(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """One quick run of three cases through the command line: what it printed, its code, its files."""
    directory = tmp_path_factory.mktemp('bench')
    (directory / 'suite.yaml').write_text(SUITE)
    before = os.sched_getaffinity(0)
    with redirect_stdout(io.StringIO()) as printed:
        code = main(
            [
                'bench',
                '--suite',
                str(directory / 'suite.yaml'),
                '--quick',
                '--json',
                '--out',
                str(directory / 'out' / 'table.md'),
            ]
        )
    assert os.sched_getaffinity(0) == before
    assert printed.getvalue().count('\n') == 1
    data = json.loads(printed.getvalue())
    return {
        'code': code,
        'data': data,
        'cases': {c['name']: c for c in data['cases']},
        'table': (directory / 'out' / 'table.md').read_text(),
    }


@pytest.mark.slow
def test_the_report_is_one_object_with_machine_and_cases(run: dict[str, Any]) -> None:
    data = run['data']
    assert (run['code'], data['status'], data['quick']) == (0, 'ok', True)
    assert list(run['cases']) == ['easy', 'impossible', 'missing']
    assert {'cpu', 'cores', 'python', 'numpy', 'numba', 'llvm', 'source_hash', 'load_average', 'clock_us'} <= set(
        data['machine']
    )
    assert data['core'] in os.sched_getaffinity(0)
    assert all(0.0 <= data['disturbance'][key] <= 1.0 for key in ('waited', 'stolen'))


@pytest.mark.slow
def test_every_figure_of_a_case_is_there(run: dict[str, Any]) -> None:
    easy, recorded = run['cases']['easy'], run['cases']['impossible']
    assert list(easy['figures']) == list(stepping.FIGURES)
    assert all(value > 0.0 for value in easy['figures'].values())
    assert easy['figures']['single_p50'] <= easy['figures']['single_p99'] <= easy['figures']['single_max']
    assert (easy['h'], easy['bodies'], easy['rows'], easy['steps']) == (1e-3, 4, 26, 1000)
    assert list(recorded['figures']) == list(overhead.FIGURES)
    assert recorded['figures']['publish_p50'] == recorded['figures']['publish_p99'] == 0.0
    assert recorded['figures']['overhead_p50'] >= recorded['figures']['encode_p50'] > 0.0
    assert all(recorded['figures'][f'{piece}_p50'] <= recorded['figures'][f'{piece}_p99'] for piece in overhead.PIECES)
    assert 0.0 <= recorded['figures']['late'] <= 100.0
    assert recorded['bytes_per_step'] > 0


@pytest.mark.slow
def test_phases_make_up_the_step(run: dict[str, Any]) -> None:
    phases = run['cases']['easy']['phases']
    assert list(phases) == [*PHASES, 'whole']
    # every median is taken by itself, so the sum agrees only within the scatter of the rounds; the pieces themselves
    # are never negative
    assert phases['whole'] > 0.0
    assert all(
        phases[name] > 0.0 for name in ('placement', 'constraints', 'residual', 'assembly', 'solution', 'projection')
    )


@pytest.mark.slow
def test_counters_of_the_report_are_those_of_the_scheme(run: dict[str, Any]) -> None:
    counters = run['cases']['easy']['counters']
    assert counters['single'] == counters['audited'] == {'iterations': 3.0, 'factorizations': 1.0, 'evaluations': 4.0}
    assert counters['batch'] == pytest.approx(
        {'iterations': 3.0, 'factorizations': 1.0, 'evaluations': 3.0 + 1.0 / 500.0}, rel=1e-12
    )


@pytest.mark.slow
def test_a_case_that_cannot_be_measured_says_why(run: dict[str, Any]) -> None:
    case = run['cases']['missing']
    assert case['status'] == 'unavailable'
    assert "did you mean 'slider_crank'?" in case['reason']
    assert case['targets'] == [{'figure': 'batch', 'limit': 20.0, 'value': None, 'met': None}]
    assert 'slider_crnk' in run['table']


@pytest.mark.slow
def test_targets_are_judged_but_only_strict_fails(run: dict[str, Any], tmp_path: Path) -> None:
    assert run['cases']['easy']['targets'][0]['met'] is True
    assert run['cases']['impossible']['targets'][0]['met'] is False
    assert run['data']['missed'] == ['impossible/overhead_p50', 'missing/batch']
    assert '| impossible | overhead_p50 |' in run['table']
    (tmp_path / 'suite.yaml').write_text(SUITE)
    assert (
        main(
            ['bench', '--suite', str(tmp_path / 'suite.yaml'), '--quick', '--strict', '--cases', 'impossible', '--json']
        )
        == 1
    )
    # nothing measured
    assert main(['bench', '--suite', str(tmp_path / 'suite.yaml'), '--quick', '--cases', 'missing', '--json']) == 1


@pytest.mark.parametrize('scene', ['slider_crank', 'light_car_step_steer'])
def test_a_fixed_step_takes_two_iterations_and_one_factorization(scene: str) -> None:
    simulation = Simulation(load_scene(scene, FIXED))
    n = 50
    alone = simulation.advance(n, audit=False).counters
    # outputs after the last step only
    assert (alone.iterations, alone.factorizations, alone.evaluations) == (2 * n, n, 2 * n + 1)
    audited = simulation.advance(n).counters
    assert (audited.iterations, audited.factorizations, audited.evaluations) == (2 * n, n, 3 * n)


def test_measuring_phases_leaves_the_simulation_as_it_was() -> None:
    one, other = (Simulation(load_scene('slider_crank', FIXED)) for _ in range(2))
    for simulation in (one, other):
        simulation.advance(20)
    saved, forces = one.save(), one.model.tables.forces.copy()
    phase_times(one, rounds=1, count=3)
    assert one.save() == saved
    assert (one.model.tables.forces == forces).all()
    assert one.advance(20).pose.tobytes() == other.advance(20).pose.tobytes()
    assert one.save() == other.save()


@pytest.mark.slow
def test_a_loop_that_publishes_every_fifth_step_makes_all_steps_and_records_their_inputs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    noted: list[int] = []
    recorded: list[tuple[int, int]] = []
    note, record = StepRecorder.note, StepRecorder.record

    def spy_on_inputs(self: StepRecorder, last: int, rows: np.ndarray) -> None:
        noted.extend(range(last - len(rows) + 1, last + 1))
        note(self, last, rows)

    def spy(self: StepRecorder, t_ns: int, messages: list[bytes | None]) -> None:
        recorded.append((t_ns, sum(message is not None for message in messages)))
        record(self, t_ns, messages)

    monkeypatch.setattr(StepRecorder, 'note', spy_on_inputs)
    monkeypatch.setattr(StepRecorder, 'record', spy)
    case = overhead.Overhead('spring_mass', [], publish=False, publish_every=5)
    case.round(20)
    found = case.figures()
    assert (found['rate'], found['steps'], case.simulation.k) == (200.0, 20, 20)
    assert noted == list(range(1, 21))
    # states of elements come 100 times a second
    assert recorded == [(k * 1_000_000, found['topics'] - k % 2) for k in (5, 10, 15, 20)]
    assert found['topics'] > 1


def test_a_suite_refuses_what_it_does_not_know(tmp_path: Path) -> None:
    file = tmp_path / 'suite.yaml'
    file.write_text('cases: {a: {scene: pendulum, targets: {bach: 1}}}')
    with pytest.raises(SceneError, match=r"suite\.yaml:1: cases\.a\.targets = .*did you mean 'batch'"):
        load_suite(file)
    file.write_text('cases: {a: {scene: pendulum, measure: record, publish_every: 0}}')
    with pytest.raises(SceneError, match=r'publish_every = 0: must be >= 1'):
        load_suite(file)
    file.write_text('cases: {a: {scene: pendulum}}')
    with pytest.raises(SceneError, match='--cases b: no such case; allowed: a'):
        load_suite(file, ['b'])


@pytest.mark.slow
def test_only_the_generated_part_of_a_document_is_replaced(run: dict[str, Any], tmp_path: Path) -> None:
    file = tmp_path / 'performance.md'
    file.write_text('before\n<!-- begin bench -->\nold\n<!-- end -->\nafter\n')
    verdicts.write(run['data'], file, 'mbd bench')
    text = file.read_text()
    assert text.startswith('before\n<!-- begin bench -->\nMade by `mbd bench`.')
    assert text.endswith('<!-- end -->\nafter\n')
    assert 'old' not in text
