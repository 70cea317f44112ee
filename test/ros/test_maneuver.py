"""The executable `maneuver` against the simulator, as two processes over real topics."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import yaml
from processes import Process, start

from mbd_sim_ros import bag
from solver.scene import load_maneuver

__all__ = ['start']  # a fixture

MANEUVER = {
    'name': 'mixed',
    'steering': {'kind': 'step', 'value': 0.5, 'start': 0.1, 'rise': 0.2},
    'drive_torque': {'kind': 'sine', 'amplitude': 200.0, 'frequency': 2.0},
    'brake_torque': {'kind': 'ramp', 'slope': 100.0, 'start': 0.2},
}


@pytest.fixture
def maneuver(tmp_path):
    path = tmp_path / 'mixed.yaml'
    path.write_text(yaml.safe_dump(MANEUVER))
    return path


def play(tmp_path, *parameters: str) -> Process:
    arguments = [text for parameter in parameters for text in ('-p', parameter)]
    return Process(tmp_path, [sys.executable, '-m', 'mbd_sim_ros.maneuver_player', '--ros-args', *arguments])


def test_in_lockstep_every_command_is_that_of_its_instant_and_runs_repeat_bit_for_bit(start, tmp_path, maneuver):
    runs = []
    for name in ('first', 'again'):
        player = play(tmp_path, f'maneuver:={maneuver}', 'rate:=0.0')
        process = start({'mode': 'lockstep', 'duration': 0.5, 'record': True, 'out': name})
        try:
            assert process.end(60.0) == 0, process.output + player.output
            assert player.end(30.0) == 0, player.output
        finally:
            player.kill()
        assert 'the simulator has ended' in player.output
        runs.append(bag.read(tmp_path / name))
    run = runs[0]
    np.testing.assert_array_equal(run['cmd_applied/step'], np.arange(251.0))
    expected = np.array([load_maneuver(maneuver).commands(t) for t in run.time[:-1]])
    np.testing.assert_array_equal(run['cmd_applied/drive_torque'][1:], expected[:, 1])
    np.testing.assert_array_equal(run['cmd_applied/brake_torque'][1:], expected[:, 2])
    assert run['cmd_applied/steering'][-1] == pytest.approx(0.5, abs=0.01)  # behind the filter, 0.2 s after the step has ended
    for name, values in run.columns.items():
        np.testing.assert_array_equal(values, runs[1][name], err_msg=name)


def test_in_real_time_commands_follow_within_a_few_steps(start, tmp_path, maneuver):
    process = start({'duration': 1.5, 'record': True, 'out': 'run'})
    player = play(tmp_path, f'maneuver:={maneuver}')
    try:
        assert process.end(60.0) == 0, process.output
        assert player.end(30.0) == 0, player.output
    finally:
        player.kill()
    run = bag.read(tmp_path / 'run')
    late = run.time > 1.4
    expected = np.array([load_maneuver(maneuver).commands(t)[2] for t in run.time[late]])
    assert np.all(np.abs(run['cmd_applied/brake_torque'][late] - expected) < 100.0 * 0.1)  # at most 0.1 s late on its ramp


def test_without_a_simulator_it_says_so(tmp_path, maneuver):
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    player = play(tmp_path, f'maneuver:={maneuver}', 'timeout:=1.0')
    assert player.end() == 6
    assert "the simulator 'simulator' is not there" in player.output
    assert 'Traceback' not in player.output


def test_a_maneuver_that_is_not_there_is_named(tmp_path):
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    player = play(tmp_path, 'maneuver:=step_stear')
    assert player.end() == 2
    assert "did you mean 'step_steer'" in player.output
    assert 'Traceback' not in player.output
