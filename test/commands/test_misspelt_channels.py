"""A channel or a topic that is not in the recording: one sentence with the nearest names, whichever command is
asked."""

from __future__ import annotations

from pathlib import Path

import foreign_bags as others
import pytest
import yaml

from mbd_sim_ros.commands.main import main

DAY, MS = others.DAY, others.MS
OURS = 'bags/step_steer'
RECORDED = 'maneuver={{bag: bags/step_steer, map: {{steering: {{channel: odo/twist/vx}}}}}}'
NEAR = "did you mean 'odom/twist/vx'?"


@pytest.fixture
def theirs(tmp_path: Path) -> Path:
    """A recording of others with a topic that cannot be read, and one of texts."""
    messages = []
    for k in range(100):
        at = DAY + k * 10 * MS
        messages += [others.vector('/imu/yaw', at, at, at, 0.01 * k), others.text('/remarks', at, at, 'x' * (k % 7))]
    return others.write(tmp_path / 'theirs', messages)


@pytest.mark.parametrize(
    ('arguments', 'says'),
    [
        (['export', OURS, '--csv', '{out}', '--channel', 'odo/twist/vx'], NEAR),
        (['export', '{theirs}', '--csv', '{out}', '--channel', 'imu/yow/*'], "did you mean 'imu/yaw/*'?"),
        (['export', '{theirs}', '--csv', '{out}', '--channel', 'imu/*/vector/zz'], "did you mean 'imu/*/vector/z'?"),
        (['compare', OURS, OURS, '--channel', 'odo/twist/vx'], NEAR),
        (['compare', OURS, OURS, '--align', 'odo/twist/vx'], NEAR),
        (['compare', OURS, OURS, '--map', 'odo/twist/vx=imu/wz'], NEAR),
        (['compare', OURS, OURS, '--mapping', '{map}'], NEAR),
        (['compare', OURS, '--look', '--channel', 'odo/twist/vx'], NEAR),
        (['evaluate', OURS, '--as', 'iso7401_step', '--map', 'odo/twist/vx=speed'], NEAR),
        (['evaluate', OURS, '--as', 'iso7401_step', '--map', 'imu/wz=odo/twist/vx'], NEAR),
        (['view', OURS, '--out', '{out}.html', '--channel', 'odo/twist/vx'], NEAR),
        (['run', 'light_car_straight', '--set', RECORDED], NEAR),
    ],
)  # fmt: skip
def test_the_nearest_names_are_told_in_one_sentence(arguments, says, theirs, tmp_path, capsys):
    mapping = tmp_path / 'map.yaml'
    mapping.write_text(yaml.safe_dump({'channels': {'imu/wz': {'channel': 'odo/twist/vx'}}}))
    assert main([part.format(out=tmp_path / 'out', theirs=theirs, map=mapping) for part in arguments]) in (2, 5)
    error = capsys.readouterr().err
    assert says in error and error.count('\n') == 1


def test_a_topic_that_is_not_read_says_why_and_is_not_taken_for_a_wrong_name(theirs, tmp_path, capsys):
    """Where the name was wrong, the first topic that cannot be read was blamed instead."""
    assert main(['export', str(theirs), '--csv', str(tmp_path / 'out'), '--channel', 'remarks/*']) == 5
    said = capsys.readouterr().err
    assert 'no channel matches' in said and 'remarks' in said and 'did you mean' not in said


def test_our_side_of_a_mapping_is_checked_too(tmp_path, capsys):
    mapping = tmp_path / 'map.yaml'
    mapping.write_text(
        yaml.safe_dump({'channels': {'imu/wzz': {'channel': 'imu/wz'}, 'imu/ax': {'channel': 'imu/ax'}}})
    )
    assert main(['compare', OURS, OURS, '--mapping', str(mapping)]) == 1
    assert f"mapping: {OURS} has no channel 'imu/wzz'; did you mean 'imu/wz'?" in capsys.readouterr().out
    mapping.write_text(yaml.safe_dump({'channels': {'imu/wzz': {'channel': 'imu/wz'}}}))
    assert main(['compare', OURS, OURS, '--mapping', str(mapping)]) == 5
    assert "did you mean 'imu/wz'?" in capsys.readouterr().err
