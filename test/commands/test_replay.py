"""Replays: what was recorded comes out again bit for bit, by whomever and from wherever it was recorded; or side by
side when changed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from client import client
from mcap.reader import make_reader
from processes import ROOT, Process

from mbd_sim_ros import batch
from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.bags.inputs import content, inputs_of
from mbd_sim_ros.bags.recorder import StepRecorder
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.commands.replay import different_topics
from solver.compiled.target import differences, target
from solver.files.scene import load_scene, load_scene_text
from solver.inputs.maneuver import ManeuverSource
from solver.simulation import Simulation

__all__ = ['client']  # a fixture

CAR = 'light_car_lane_change'


def document(capsys: pytest.CaptureFixture[str], *argv: object) -> tuple[int, dict]:
    capsys.readouterr()
    code = main([*map(str, argv), '--json'])
    captured = capsys.readouterr()
    assert captured.err == ''
    return code, json.loads(captured.out)


def run(directory: Path, scene: str, *settings: str, duration: float = 0.2) -> Path:
    overrides = [word for text in settings for word in ('--set', text)]
    assert main(['run', scene, '--duration', str(duration), *overrides, '--out', str(directory), '--json']) == 0
    return directory


def node(tmp_path: Path, **parameters: object) -> Process:
    arguments = [text for name, value in parameters.items() for text in ('-p', f'{name}:={json.dumps(value)}')]
    return Process(tmp_path, [sys.executable, '-m', 'mbd_sim_ros.node.main', '--ros-args', *arguments])


@pytest.mark.slow
@pytest.mark.parametrize('every', [1, 7, 10, 1000])
def test_a_recording_holds_the_inputs_of_every_step_and_replays(every, tmp_path, capsys):
    recorded = run(tmp_path / 'r', 'four_bar', f'record.every={every}')
    assert len(bag.read(recorded).time_ns) == 1 + -(-200 // every)
    found = inputs_of(content(recorded))
    scene = load_scene('four_bar')
    expected = ManeuverSource(
        scene.maneuver, scene.model.inputs, scene.integrator.h_ns, Simulation(scene).engine.stage
    ).table(0, 200)
    for column, name in enumerate(scene.model.inputs):
        np.testing.assert_array_equal(found.rows[name], expected[:, column])
    code, data = document(capsys, 'replay', recorded, '--out', tmp_path / 'again')
    assert (code, data['status'], data['steps'], data['outside']) == (0, 'identical', 200, [])
    assert document(capsys, 'replay', tmp_path / 'again')[1]['status'] == 'identical'


@pytest.mark.slow
def test_a_driver_is_replayed_by_what_he_did(tmp_path, capsys):
    recorded = run(tmp_path / 'r', CAR, 'record.every=10', duration=1.005)  # ends between two instants of the grid
    code, data = document(capsys, 'replay', recorded)
    assert (code, data['status']) == (0, 'identical')
    applied = inputs_of(content(recorded))
    assert np.ptp(np.diff(applied.rows['steering'])) > 0.0


@pytest.mark.slow
def test_what_differs_is_found(tmp_path, capsys):
    """Inputs of one step between two recorded instants are another: the replay must see it."""
    recorded = run(tmp_path / 'r', 'four_bar', 'record.every=10')
    text = bag.read(recorded).metadata['resolved_scene']
    simulation = Simulation(load_scene_text(text))

    class Other:
        def table(self, k0: int, n: int) -> np.ndarray:
            rows = simulation.source.table(k0, n).copy()
            rows[np.arange(k0, k0 + n) == 95] *= 1.0 + 1e-9
            return rows

    batch.simulate(simulation, 200, directory=tmp_path / 'other', source=Other())
    found = different_topics(content(recorded), content(tmp_path / 'other'))
    assert 'joint_states' in found and 'cmd_applied' not in found  # the step is between two instants
    assert document(capsys, 'replay', tmp_path / 'other')[0] == 0  # by its own inputs it is right


@pytest.mark.slow
def test_steps_that_a_slow_disk_did_not_take_are_bridged(tmp_path, capsys, monkeypatch):
    write = StepRecorder.write

    def slow(self, t_ns, messages):
        if 50_000_000 < t_ns < 60_000_000:
            self.dropped += 1
            return False
        return write(self, t_ns, messages)

    monkeypatch.setattr(StepRecorder, 'write', slow)
    recorded = run(tmp_path / 'r', 'four_bar')
    monkeypatch.undo()
    assert len(bag.read(recorded).time_ns) == 201 - 9
    assert document(capsys, 'replay', recorded)[1]['status'] == 'identical'


@pytest.mark.slow
def test_what_is_recovered_of_a_recording_replays_though_its_topics_do_not_end_together(tmp_path, capsys):
    recorded = next(run(tmp_path / 'r', 'four_bar', 'record.elements=true', 'record.elements_rate=0').glob('*.mcap'))
    with recorded.open('rb') as stream:
        summary = make_reader(stream).get_summary()
    last = max(summary.chunk_indexes, key=lambda one: one.chunk_start_offset)
    (tmp_path / 'cut.mcap').write_bytes(recorded.read_bytes()[: last.chunk_start_offset])
    assert document(capsys, 'recover', tmp_path / 'cut.mcap', tmp_path / 'saved')[0] == 0
    topics = content(tmp_path / 'saved').topics
    lost = {summary.channels[channel].topic.strip('/') for channel in last.message_index_offsets}
    assert len(topics['cmd_applied']) > max(len(topics.get(name, {})) for name in lost)
    code, data = document(capsys, 'replay', tmp_path / 'saved')
    assert (code, data['status']) == (0, 'identical')


@pytest.mark.slow
def test_portions_of_calls_change_no_bits(tmp_path, monkeypatch):
    settings = ('record.every=20',)
    whole = run(tmp_path / 'whole', CAR, *settings)
    monkeypatch.setattr(batch, 'DEAF', 0.0)  # one step per call
    single = run(tmp_path / 'single', CAR, *settings)
    assert content(whole).outputs == content(single).outputs


def test_a_mechanism_without_inputs_is_replayed_with_other_settings(tmp_path, capsys):
    recorded = run(tmp_path / 'r', 'pendulum', duration=0.1)
    h = load_scene('pendulum').integrator.h
    for setting, steps in ((f'integrator.h={h / 2}', 2), ('integrator.iterations=4', 1)):
        code, data = document(capsys, 'replay', recorded, '--set', setting)
        assert (code, data['status'], data['steps']) == (0, 'compared', steps * round(0.1 / h))
    for setting in ('duration=1', 'maneuver={}', 'maneuver.steering.value=1'):
        code, data = document(capsys, 'replay', recorded, '--set', setting)
        assert code == 2 and data['error'].startswith(
            f'--set {setting}: a replay keeps the inputs and the duration of its recording'
        )


def test_a_replay_that_is_suspect_is_told(tmp_path, capsys):
    recorded = run(tmp_path / 'r', 'pendulum', duration=1.0)
    code, data = document(capsys, 'replay', recorded, '--set', 'integrator.h=0.1')
    assert (
        code == 0 and [*data['doubts']] == ['replay'] and data['doubts']['replay'][0].startswith('the run is suspect: ')
    )
    assert main(['replay', str(recorded), '--set', 'integrator.h=0.1']) == 0
    assert capsys.readouterr().out.startswith('replay: the run is suspect: ')


@pytest.mark.slow
def test_unchanged_settings_compare_without_difference_and_others_with_one(tmp_path, capsys):
    recorded = run(tmp_path / 'r', CAR, 'record.every=5', duration=0.5)
    h = load_scene(CAR).integrator.h
    code, data = document(capsys, 'replay', recorded, '--set', f'integrator.h={h}')
    assert (code, data['status'], data['interpolated']) == (0, 'compared', False)
    assert {one['max'] for one in data['channels'].values()} == {0.0}
    code, data = document(capsys, 'replay', recorded, '--set', f'integrator.h={h / 2}')
    channels = data['channels']
    assert code == 0 and 0.0 < channels['odom/pose/x']['max'] < 1e-3
    assert channels['odom/pose/x']['rms'] <= channels['odom/pose/x']['max']
    assert main(['replay', str(recorded), '--set', f'integrator.h={h / 2}']) == 0
    table = capsys.readouterr().out.splitlines()
    assert table[0].split()[:3] == ['channel', 'unit', 'max']
    assert channels['cmd_applied/steering']['max'] < 1e-12  # at the recorded instants it is what was recorded


@pytest.mark.slow
def test_another_vehicle_is_driven_by_the_same_inputs(tmp_path, capsys):
    recorded = run(tmp_path / 'r', CAR, 'record.every=5', duration=0.5)
    heavier = tmp_path / 'heavier.yaml'
    text = (Path(__file__).parents[2] / 'config' / 'vehicles' / 'light_car.yaml').read_text()
    heavier.write_text(text)
    code, data = document(capsys, 'replay', recorded, '--vehicle', heavier)
    largest = {name: one['max'] for name, one in data['channels'].items() if one['max'] > 1e-15}
    assert code == 0 and not largest  # the same settings: what is left is the rounding of interpolation
    code, data = document(capsys, 'replay', recorded, '--vehicle', 'full_car', '--set', 'integrator.h=0.001')
    assert code == 0
    assert data['channels']['cmd_applied/drive_torque']['max'] == 0.0
    assert data['channels']['odom/pose/x']['max'] > 0.0


@pytest.mark.slow
def test_a_recording_is_a_maneuver(tmp_path, capsys):
    recorded = run(tmp_path / 'r', CAR, 'record.every=5', duration=0.5)
    again = run(tmp_path / 'again', CAR, 'record.every=5', f'maneuver={{bag: {recorded}}}', duration=0.5)
    assert content(again).outputs == content(recorded).outputs
    code, data = document(
        capsys, 'run', CAR, '--no-record', '--set', f'maneuver={{bag: {recorded}}}', '--duration', '0.6'
    )
    assert code == 2 and 'ends at 0.5 s; set duration to that or less' in data['error']
    code, data = document(capsys, 'run', CAR, '--no-record', '--set', 'maneuver={bag: nowhere}')
    assert code == 5 and 'nowhere is not there' in data['error']


@pytest.mark.slow
def test_channels_of_others_are_inputs_by_a_map(tmp_path, capsys):
    recorded = run(tmp_path / 'r', CAR, 'record.every=5', duration=0.5)
    mapping = f'maneuver={{bag: {recorded}, map: {{steering: {{channel: odom/twist/vx, scale: 0.1, offset: -1}}}}}}'
    again = run(tmp_path / 'again', CAR, 'record.every=5', mapping, duration=0.3)
    before, after = bag.read(recorded), bag.read(again)
    at = np.isin(after.time_ns, before.time_ns)
    wanted = 0.1 * before['odom/twist/vx'][: at.sum()] - 1.0
    np.testing.assert_allclose(after['cmd_applied/steering'][at], wanted, rtol=0.0, atol=1e-15)
    assert not after['cmd_applied/drive_torque'].any()
    assert document(capsys, 'replay', again)[1]['status'] == 'identical'
    code, data = document(capsys, 'run', CAR, '--no-record', '--duration', '0.3', '--set', mapping.replace('vx', 'vxx'))
    assert code == 5 and "did you mean 'odom/twist/vx'" in data['error']


@pytest.mark.slow
def test_a_replay_does_not_need_the_recording_that_drove_it(tmp_path, capsys):
    first = run(tmp_path / 'first', CAR, duration=0.3)
    second = run(tmp_path / 'second', CAR, f'maneuver={{bag: {first}}}', duration=0.3)
    first.rename(tmp_path / 'gone')
    assert document(capsys, 'replay', second)[1]['status'] == 'identical'


@pytest.mark.slow
@pytest.mark.parametrize('seconds', [3, pytest.param(60, marks=pytest.mark.long)])
def test_the_full_car_driven_over_topics_replays_to_the_same_bits(seconds: int, tmp_path, capsys):
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    # paced: as fast as it can a node may be at the end before the player has found it
    process = node(
        tmp_path,
        scene='car_swept_steer',
        mode='realtime',
        duration=float(seconds),
        record=True,
        out='run',
        frame_prefix='car/',
    )
    player = Process(
        tmp_path,
        [
            sys.executable,
            '-m',
            'mbd_sim_ros.node.maneuver_player',
            '--ros-args',
            '-p',
            'scene:=car_swept_steer',
            '-p',
            'timeout:=1200.0',
        ],
    )
    try:
        assert process.end(1200.0) == 0, process.output  # the kernels may have to be compiled
    finally:
        process.kill()
        player.kill()
    recorded = bag.read(tmp_path / 'run')
    assert recorded.time_ns.size == 100 * seconds + 1  # record.every: 10
    assert np.ptp(recorded['cmd_applied/steering']) > 0.1
    code, data = document(capsys, 'replay', tmp_path / 'run')
    assert (code, data['status'], data['steps']) == (0, 'identical', 1000 * seconds)


@pytest.mark.slow
def test_recordings_begun_while_running_and_after_restore_replay_to_the_same_bits(tmp_path, capsys, client):
    process = node(tmp_path, scene='car_step_steer', commands='maneuver')
    again = None
    try:
        # in the step of the steering wheel
        client.until(lambda: client.applied and client.applied[-1]['step'] > 1050, 1200.0)
        begun = client.call('start_recording')
        assert begun.success, begun.message
        saved = client.call('save_state')
        k = client.applied[-1]['step']
        client.until(lambda: client.applied[-1]['step'] > k + 800)  # a client that lags behind has an old k
        stopped = client.call('stop_recording')
        assert stopped.success, stopped.message
        process.process.terminate()
        assert process.end() == 0, process.output
        # after the state was saved, however far behind the client is
        last = bag.read(tmp_path / stopped.message).time_ns[-1] * 1e-9
        again = node(
            tmp_path,
            scene='car_step_steer',
            commands='maneuver',
            mode='fast',
            duration=round(last + 0.5, 3),
            restore=saved.message,
            record=True,
            out='again',
        )
        assert again.end(60.0) == 0, again.output
    finally:
        process.kill()
        if again is not None:
            again.kill()
    for directory in (tmp_path / stopped.message, tmp_path / 'again'):
        assert content(directory).first_step > 1050
        code, data = document(capsys, 'replay', directory, '--out', tmp_path / f'{directory.name}-replay')
        assert (code, data['status']) == (0, 'identical'), data['outside']
        assert data['steps'] > 400
        assert document(capsys, 'replay', tmp_path / f'{directory.name}-replay')[1]['status'] == 'identical'
    code, data = document(capsys, 'replay', tmp_path / 'again', '--set', 'integrator.iterations=2')
    largest = {name: one['max'] for name, one in data['channels'].items() if one['max'] > 1e-15}
    assert code == 0 and not largest  # the same settings: what is left is the rounding of interpolation
    code, data = document(capsys, 'replay', tmp_path / 'again', '--set', 'integrator.h=0.002')
    assert code == 2 and 'a saved state, which fits a step of 0.001 s' in data['error']


def test_a_recording_that_begins_at_step_0_elsewhere_than_its_scene_is_replayed_from_there(tmp_path, capsys):
    """Placed at x = 50 m, y = -20 m before its first step. Elsewhere the same settings would be said to differ by all
    of that."""
    scene = load_scene('light_car_straight', ['record.every=10'])
    placed = Simulation(scene)
    placed.place(50.0, -20.0, 0.5)
    batch.simulate(Simulation(scene), 50, directory=tmp_path / 'r', state=placed.save())
    assert content(tmp_path / 'r').first_step == 0
    code, data = document(capsys, 'replay', tmp_path / 'r')
    assert (code, data['status'], data['steps']) == (0, 'identical', 50)
    code, data = document(
        capsys, 'replay', tmp_path / 'r', '--set', f'integrator.iterations={scene.integrator.iterations}'
    )
    assert code == 0 and max(one['max'] for one in data['channels'].values()) < 1e-15
    for setting, says in (
        ('integrator.h=0.002', 'a saved state, which fits a step of 0.001 s'),
        ('start.speed=3', 'with a saved state, so start has no effect'),
    ):
        code, data = document(capsys, 'replay', tmp_path / 'r', '--set', setting)
        assert code == 2 and says in data['error']


@pytest.mark.slow
def test_on_another_target_it_says_that_the_same_bits_cannot_be_expected(tmp_path, capsys):
    """The recording is made by a process whose C library takes its functions for processors without FMA (glibc's
    tunable)."""
    if not target()['libc'].startswith('glibc') or target()['fma'] != 'yes':
        pytest.skip('needs glibc on a processor with FMA: only there the functions can be chosen')
    settings = ('light_car_straight', '--duration', '0.2', '--set', 'record.every=1', '--out', str(tmp_path / 'run'))
    command = [sys.executable, '-m', 'mbd_sim_ros.commands.main', 'run', *settings]
    environment = {**os.environ, 'GLIBC_TUNABLES': 'glibc.cpu.hwcaps=-FMA,-AVX2', 'PYTHONPATH': str(ROOT)}
    subprocess.run(command, env=environment, check=True, capture_output=True, timeout=600)
    assert main(['replay', str(tmp_path / 'run')]) == 1
    sentence = capsys.readouterr().out.strip().splitlines()[-1]
    there = yaml.safe_load(bag.read(tmp_path / 'run').metadata['target'])
    assert there | {'elementary': ''} == target() | {'elementary': ''}
    assert sentence == (
        'the same bits cannot be expected, because the recording was made on another target: '
        f'elementary {there["elementary"]} there and {target()["elementary"]} here'
    )


@pytest.mark.slow
def test_on_the_same_target_it_says_nothing_of_it(tmp_path, capsys):
    assert main(['run', 'slider_crank', '--duration', '0.1', '--out', str(tmp_path / 'run')]) == 0
    run = bag.read(tmp_path / 'run')
    assert yaml.safe_load(run.metadata['target']) == target()
    assert main(['replay', str(tmp_path / 'run')]) == 0
    assert 'the same bits cannot' not in capsys.readouterr().out


def test_what_only_one_of_two_targets_says_is_no_difference():
    """A recording of a version that knew fewer entries."""
    assert differences({}, target()) == []
    assert differences({'libc': 'glibc 2.35', 'numba': '1'}, {'libc': 'glibc 2.39', 'fma': 'yes', 'numba': '1'}) == [
        'libc glibc 2.35 there and glibc 2.39 here'
    ]
