"""Commands with a vehicle at a level of detail: run, replay, compare, info, and the node."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from processes import Process

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.commands.main import main

SCENE, LEVEL = 'light_car_lane_change', ('--set', 'fidelity=single_track')


def document(capsys: pytest.CaptureFixture[str], *argv: object) -> tuple[int, dict]:
    capsys.readouterr()
    code = main([*map(str, argv), '--json'])
    return code, json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_a_single_track_is_recorded_replayed_and_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """With a driver, bit for bit; beside the whole vehicle by the names that both have."""
    code, _ = document(capsys, 'run', SCENE, *LEVEL, '--duration', 2, '--out', tmp_path / 'level')
    assert code == 0
    code, again = document(capsys, 'replay', tmp_path / 'level')
    assert (code, again['status']) == (0, 'identical')
    recorded = bag.read(tmp_path / 'level')
    assert not [
        name for name in recorded.columns if name.startswith(('tire', 'joint_states/travel', 'joint_states/rack'))
    ]
    code, _ = document(capsys, 'run', SCENE, '--duration', 2, '--out', tmp_path / 'whole')
    assert code == 0
    _, found = document(capsys, 'compare', tmp_path / 'level', tmp_path / 'whole')
    shared = {
        'odom/twist/wz',
        'odom/twist/vy',
        'imu/ay',
        'joint_states/steering_wheel/position',
        'joint_states/wheel_rear_left/velocity',
    }
    assert shared <= set(found['channels'])


@pytest.mark.slow
def test_info_shows_limits_and_errors(capsys: pytest.CaptureFixture[str]) -> None:
    code, found = document(capsys, 'info', SCENE, *LEVEL)
    assert code == 0
    assert {limit['quantity'] for limit in found['level']['validity']} >= {
        'lateral acceleration',
        'frequency',
        'road height',
    }
    figures = {(e['maneuver'], e['quantity']): e['rms'] for e in found['level']['errors']}
    assert figures['step steer 0.4 g', 'yaw_rate'] < 0.05
    code, brief = document(capsys, 'info', SCENE, *LEVEL, '--brief')
    assert brief['level']['errors'] is None


@pytest.mark.slow
def test_info_shows_errors_of_the_full_vehicle_without_its_bars(capsys: pytest.CaptureFixture[str]) -> None:
    """It rolls by more than a tenth more; straight on bars do nothing. Where all switches are on there is nothing to
    measure."""
    code, found = document(capsys, 'info', SCENE, '--set', 'switches.anti_roll_bars=off')
    assert code == 0
    figures = {(e['maneuver'], e['quantity']): e['rms'] for e in found['level']['errors']}
    assert figures['step steer 0.4 g', 'roll'] > 0.1
    assert figures['braking 0.5 g', 'wheel_load'] < 1e-6
    _, found = document(capsys, 'info', SCENE, '--set', 'switches.anti_roll_bars=on')
    assert 'level' not in found


@pytest.mark.slow
def test_info_shows_a_level_of_a_vehicle_that_a_torque_steers(capsys: pytest.CaptureFixture[str]) -> None:
    """Its error sheet imposes angles: there is none, and that is said. The whole receipt was refused, for a scene 'slow
    ramp'."""
    free = ('--set', 'fidelity=condensed', '--set', 'actuation.steering=torque')
    code, found = document(capsys, 'info', 'light_car_straight', *free)
    assert (code, found['level']['errors']) == (0, None)
    assert main(['info', 'light_car_straight', *free]) == 0
    assert 'no error sheet: its maneuvers impose the angle of the steering wheel' in capsys.readouterr().out


@pytest.mark.slow
def test_what_a_level_cannot_tell_is_refused_with_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    code = main(['run', SCENE, *LEVEL, '--duration', '0.1', '--no-record', '--balance'])
    assert code != 0
    assert 'take another level' in capsys.readouterr().err


@pytest.mark.slow
def test_a_node_drives_a_single_track(tmp_path: Path) -> None:
    pytest.importorskip('rclpy')
    changes = ['fidelity=single_track', 'record.every=1']
    out = str(tmp_path / 'bag')
    values = {
        'scene': SCENE,
        'overrides': changes,
        'mode': 'fast',
        'commands': 'maneuver',
        'duration': 0.5,
        'record': True,
        'out': out,
    }
    arguments = [text for name, value in values.items() for text in ('-p', f'{name}:={json.dumps(value)}')]
    process = Process(tmp_path, [sys.executable, '-m', 'mbd_sim_ros.node.main', '--ros-args', *arguments])
    assert process.end(120.0) == 0, process.output
    assert len(bag.read(tmp_path / 'bag').time_ns) == 501
