"""What `mbd bench` measures beside the step: idle loops, threads, growth, the rig, starts, the node. No time is
asserted."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import subprocess
import sys
import time
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbd_sim_ros.commands.main import main
from mbd_sim_ros.lab.benchmarks import endurance, growth, idle, lanes, rigs, single, start, threads, verdicts
from mbd_sim_ros.lab.benchmarks.suite import MEASURES
from mbd_sim_ros.lab.peers.exudyn import PYTHON
from mbd_sim_ros.lab.peers.rig import RUNOUT, SPIN, TIRE, car_on_rig, plain
from solver.errors import SceneError, SpecError
from solver.files.scene import load_scene
from solver.simulation import Simulation

SUITE = """
cases:
  alone: {measure: single, scene: slider_crank}
  pair: {measure: threads, scene: slider_crank}
  chain_3: {measure: growth, scene: chain, set: [mechanism.links=3]}
  chain_6: {measure: growth, scene: chain, set: [mechanism.links=6]}
  rig: {measure: peers, scene: car_swept_steer, targets: {time_ratio: 0.2}}
"""


@pytest.fixture(scope='module')
def run(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """One quick run of a suite without Exudyn: the cases by name, the whole report, and the document it was written
    into."""
    directory = tmp_path_factory.mktemp('measures')
    (directory / 'others.yaml').write_text(SUITE)
    file = directory / 'performance.md'
    file.write_text('# Mine\n\n<!-- begin bench -->\nthe usual part\n<!-- end -->\n')
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(io.StringIO()) as printed:
        patch.setenv(PYTHON, str(directory / 'nobody'))
        command = ['bench', '--suite', str(directory / 'others.yaml'), '--quick', '--json', '--out', str(file)]
        assert main(command) == 0
    data = json.loads(printed.getvalue())
    return {'data': data, 'cases': {c['name']: c for c in data['cases']}, 'file': file}


@pytest.mark.slow
def test_every_figure_is_there(run: dict[str, Any]) -> None:
    cases = run['cases']
    for name, figures in (('alone', single.FIGURES), ('pair', threads.FIGURES), ('chain_3', growth.FIGURES)):
        assert cases[name]['status'] == 'ok', cases[name]['reason']
        assert list(cases[name]['figures']) == list(figures)
        assert all(value >= 0.0 for value in cases[name]['figures'].values())
    assert cases['alone']['steps'] == 1000
    assert cases['alone']['simulated'] == pytest.approx(1.0)
    assert cases['pair']['figures']['speedup'] > 0.0


def test_what_is_measured_is_shown() -> None:
    """A measure without a table would be run and told to nobody."""
    assert {*verdicts.TITLES, 'steps', 'record', 'publish'} == {*MEASURES}


@pytest.mark.slow
def test_cars_in_lanes_make_the_steps_that_they_make_alone() -> None:
    """Of each round those in lanes are taken back, and made one after the other."""
    case = lanes.Lanes('light_car_step_steer', [], ['single_track'])
    case.round(lanes.BATCH)
    ensemble, rows = case._cars['single_track']
    alone = ensemble.simulations[3].twin(10.0)
    alone.advance(lanes.SKIPPED, rows[3, : lanes.SKIPPED])
    alone.advance(lanes.BATCH, rows[3, lanes.SKIPPED : lanes.SKIPPED + lanes.BATCH])
    assert alone.snapshot().numbers.tobytes() == ensemble.simulations[3].snapshot().numbers.tobytes()
    found = case.figures()
    assert (
        list(found['figures']) == [name for name in lanes.FIGURES if name.startswith('single_track')]
        and found['steps'] == lanes.BATCH
    )
    assert all(value > 0.0 for value in found['figures'].values())


def test_the_idle_loop_is_as_long_as_the_step_and_late_steps_are_counted_beyond_late_loops() -> None:
    one = single.Single('slider_crank', [])
    one.round(50)
    figures = one.figures()['figures']
    assert 1 / 3 < figures['idle_p50'] / figures['step_p50'] < 3
    one._steps, one._idle = [10_000, 1_100_000, 2_000_000], [10_000, 20_000, 1_500_000]  # ns
    figures = one.figures()['figures']
    assert (figures['step_late'], figures['idle_late'], figures['late_more']) == (2, 1, 1)
    assert (figures['step_max'], figures['idle_max']) == (2000.0, 1500.0)


def test_simulations_in_threads_make_the_steps_that_they_make_alone() -> None:
    case = threads.Threads('slider_crank', [])
    case.round(2 * threads.BATCH)
    alone = Simulation(load_scene('slider_crank'))
    alone.advance(2 * threads.BATCH, audit=False)
    assert [simulation.k for simulation in case.simulations] == [alone.k] * threads.COUNT
    assert all((simulation.state.q == alone.state.q).all() for simulation in case.simulations)


def test_exponents_are_those_of_the_sizes() -> None:
    sizes = (10, 30, 100)
    cases = [{'scene': 'a', 'bodies': n, 'figures': {'step': 2.0 * n**1.3, 'memory': 5.0 * n}} for n in sizes]
    (row,) = growth.exponents([cases[1], cases[0], cases[2], {**cases[0], 'scene': 'alone'}])
    assert (row['scene'], row['smallest'], row['largest'], row['met']) == ('a', 10, 100, False)
    assert (row['step'], row['step_at_last'], row['memory']) == pytest.approx((1.3, 1.3, 1.0), rel=1e-12)
    for case in cases:
        case['figures']['step'] = case['bodies'] ** 1.05
    assert growth.exponents(cases)[0]['met']


@pytest.mark.slow
def test_growth_is_in_the_report(run: dict[str, Any]) -> None:
    (row,) = run['data']['growth']
    assert (row['scene'], row['smallest'], row['largest']) == ('chain', 3, 6)
    small, large = (run['cases'][name] for name in ('chain_3', 'chain_6'))
    assert row['memory'] == pytest.approx(np.log2(large['figures']['memory'] / small['figures']['memory']))
    assert '| chain | 3 to 6 |' in run['file'].read_text()


@pytest.mark.slow
def test_a_peer_that_is_not_installed_leaves_a_line(run: dict[str, Any]) -> None:
    case = run['cases']['rig']
    assert case['status'] == 'unavailable'
    assert 'Exudyn is left out' in case['reason'] and PYTHON in case['reason']
    assert case['targets'][0]['met'] is None
    assert 'rig/time_ratio' in run['data']['missed']


@pytest.mark.slow
def test_a_suite_has_a_part_of_its_own_in_a_document(run: dict[str, Any]) -> None:
    text = run['file'].read_text()
    before = '# Mine\n\n<!-- begin bench -->\nthe usual part\n<!-- end -->\n'
    assert text.startswith(f'{before}\n<!-- begin bench others -->\nMade by `mbd bench --quick --suite ')
    assert '\n### Growth with the number of bodies\n' in text
    verdicts.write(run['data'], run['file'], 'mbd again', 'others')
    again = run['file'].read_text()
    assert again.startswith(f'{before}\n<!-- begin bench others -->\nMade by `mbd again`')
    assert again.count('begin bench') == 2


def test_the_car_on_the_rig_has_the_counts_of_the_car_and_its_wheels_turn() -> None:
    scene = car_on_rig('car_swept_steer', duration=0.1)
    spec, full = scene.model, load_scene('car_swept_steer').model
    assert (len(spec.bodies), len(spec.joints), len(spec.spring_dampers)) == (53, 49, 9)
    assert len(spec.bushings) == len(full.bushings) + 4 == 33
    simulation = Simulation(scene)
    assert simulation.describe()['dof'] == 134
    state, wheels = (
        simulation.state,
        [k for k, name in enumerate(simulation.model.body_names) if name.startswith('wheel_')],
    )
    np.testing.assert_allclose(state.v[wheels, 4], SPIN, rtol=1e-3)
    # the springs at the ground carry the weight: their deflection is that of the wheel less the runout, which is below
    # it
    places = np.array([full.bodies[k].position[2] for k in wheels])
    deflection = places - (state.q[wheels, 2] - RUNOUT)
    weight = 9.81 * sum(body.mass for body in spec.bodies)
    assert TIRE[2] * deflection.sum() == pytest.approx(weight, rel=1e-4)


def test_errors_on_the_rig_are_of_second_order() -> None:
    scene = car_on_rig('car_swept_steer', duration=0.1)

    def positions(finer: int) -> np.ndarray:
        settings = dataclasses.replace(scene.integrator, h=scene.integrator.h / finer)
        simulation = Simulation(dataclasses.replace(scene, integrator=settings))
        simulation.advance(100 * finer, np.zeros((100 * finer, 0)), audit=False)
        return simulation.state.q[:-1, :3].copy()

    exact = positions(16)
    coarse, fine = (np.abs(positions(n) - exact).max() for n in (1, 2))
    assert 1e-7 < coarse < 1e-5  # m, of 10 mm motions
    assert coarse / fine == pytest.approx((1 - 1 / 256) / (1 / 4 - 1 / 256), rel=0.1)


def test_exudyn_finds_the_same_motion() -> None:
    try:
        case = rigs.Peers('car_swept_steer', [], 100)
    except SpecError as error:
        assert 'Exudyn is left out' in str(error)
        pytest.skip(str(error))
    case.round(100)
    found = case.figures()
    assert list(found['figures']) == list(rigs.FIGURES)
    # the models differ in how a bushing measures large rotations, the motion is 10 mm
    assert found['figures']['apart'] < 20.0  # um
    assert [run['settings'] for run in found['runs']] == [*rigs.OURS, *rigs.EXUDYN]
    assert all(0.0 < run['error'] < 50.0 for run in found['runs'])


def test_points_of_the_exported_rig_are_taken_from_the_centres_of_mass() -> None:
    """Joints are closed and springs at their length in the exported numbers alone."""
    simulation = Simulation(car_on_rig('car_swept_steer', duration=0.1))
    model = plain(simulation)

    def place(frame: list[Any]) -> tuple[np.ndarray, np.ndarray]:
        body, point, axes = frame
        if body < 0:
            return np.array(point), np.array(axes)
        R = np.array(model['bodies'][body]['R'])
        return np.array(model['bodies'][body]['p']) + R @ point, R @ np.array(axes)

    for constrained, i, j in model['joints']:
        (p, F), (q, G) = place(i), place(j)
        np.testing.assert_allclose((F.T @ (q - p))[np.array(constrained[:3], bool)], 0.0, atol=1e-10)
        if constrained[3:5] == [1, 1]:
            np.testing.assert_allclose(F[:, :2].T @ G[:, 2], 0.0, atol=1e-10)
    lengths = simulation.model.outputs('spring_dampers', simulation.outputs)[:, 2]
    found = [float(np.linalg.norm(place(j)[0] - place(i)[0])) for i, j, *_ in model['springs']]
    np.testing.assert_allclose(found, lengths, rtol=1e-12)


@pytest.mark.slow
def test_a_start_is_timed_in_a_process_of_its_own() -> None:
    with pytest.raises(SceneError):
        start.StartUp('no_such_scene', [])
    elapsed, cpu = start.StartUp('pendulum', ['duration=1'])._first_step({**os.environ})
    assert elapsed > 0.0 and cpu > 0.0
    broken = start.StartUp('pendulum', [])
    broken._overrides = ['integrator.h=0']
    with pytest.raises(SpecError, match=r'the start failed: .*must be'):
        broken._first_step({**os.environ})


@pytest.mark.long
@pytest.mark.slow
def test_the_node_at_work_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip('rclpy')
    monkeypatch.setattr(endurance, 'DOMAIN', str(60 + os.getpid() % 40))
    monkeypatch.setenv('ROS_LOG_DIR', str(tmp_path))
    case = endurance.Endurance('light_car_step_steer', ['integrator.h=0.002'], 3.0, with_reader=True)
    case.round(1)
    found = case.figures()
    assert list(found['figures']) == list(endurance.FIGURES)
    assert found['steps'] == 1500
    assert 0.0 <= found['figures']['idle_before'] <= 100.0 and 0.0 <= found['figures']['idle_after'] <= 100.0
    assert 50.0 < found['figures']['memory'] < 1000.0
    assert found['commands'] > 10
    assert 0.0 < found['figures']['latency_p50'] <= found['figures']['latency_p99'] <= found['figures']['latency_max']
    assert 0.0 < found['figures']['real_time_factor'] < 1.01
    assert found['figures']['recorded'] > 0.1
    assert found['figures']['missed'] == 0


def test_the_node_runs_as_long_as_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'suite.yaml'
    file.write_text('cases: {a: {measure: node, scene: pendulum, duration: 30}}')
    seen: list[float] = []

    def refuse(scene: str, overrides: tuple[str, ...], seconds: float, *, with_reader: bool) -> None:
        seen.append(seconds)
        raise SpecError('only asked')

    monkeypatch.setattr(endurance, 'Endurance', refuse)
    for more in ([], ['--duration', '7'], ['--quick'], ['--quick', '--duration', '3']):
        assert main(['bench', '--suite', str(file), '--json', *more]) == 1  # nothing was measured
    assert seen == [30.0, 7.0, 10.0, 3.0]
    assert main(['bench', '--suite', str(file), '--duration', '-1']) == 2
    assert 'duration = -1.0: must be > 0' in capsys.readouterr().err


def test_an_idle_loop_a_busy_one_and_memory_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    assert 0.0 <= idle.late_when_idle(0.002, 0.2) <= 100.0
    assert idle.late_when_idle(1e-7, 1e-4) > 90.0  # nobody wakes within 0.1 us
    assert 0.0 <= idle.late_when_busy(0.002, 0.2) <= 100.0
    monkeypatch.setattr(idle, 'COUNTED', 3.0)
    assert idle.late_when_busy(0.002, 0.1) > 90.0  # more than there is time for
    process = subprocess.Popen([sys.executable, '-c', 'import time; x = bytearray(50_000_000); time.sleep(30)'])
    memory = idle.Memory(process.pid)
    time.sleep(2.7)
    process.kill()
    process.wait()
    largest, growth = memory.figures()
    assert largest > 50.0 and abs(growth) < 60.0
