"""What the world does to a running node: floods of commands and of what is no number, a namesake, a lost folder, a full
disk."""

from __future__ import annotations

import math
import shutil
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from client import client
from faults import UNWANTED, trials
from processes import Process, start

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.bags.recovery import recover
from solver.errors import BagError

pytestmark = pytest.mark.realtime

__all__ = ['client', 'start']  # fixtures

# argv: seconds, messages per second, values...
FLOOD = """
import sys, time
import rclpy
from std_msgs.msg import Float64
rclpy.init()
node = rclpy.create_node('flood')
publishers = [node.create_publisher(Float64, f'simulator/{name}', 1) for name in ('steering_cmd', 'torque_cmd', 'brake_cmd')]
while not all(p.get_subscription_count() for p in publishers):
    time.sleep(0.01)
values = [float(text) for text in sys.argv[3:]]
begin, sent, rate = time.monotonic(), 0, float(sys.argv[2])
while time.monotonic() - begin < float(sys.argv[1]):
    while sent < rate * (time.monotonic() - begin):
        publishers[sent % 3].publish(Float64(data=values[sent // 3 % len(values)]))
        sent += 1
    time.sleep(0.0005)
print(f'sent {sent}')
"""  # noqa: E501


def flood(tmp_path: Path, seconds: float, rate: float, *values: float) -> Process:
    return Process(tmp_path, [sys.executable, '-c', FLOOD, *map(str, (seconds, rate, *values))])


def seconds() -> float:
    """Length of a flood."""
    return max(1.0, 0.05 * len(trials(1)))


@pytest.mark.slow
def test_a_flood_of_commands_is_survived_and_the_newest_counts(start, client, tmp_path: Path) -> None:
    process = start({'record': True, 'out': 'run'})
    client.ready()
    client.until(lambda: client.applied)
    water = flood(tmp_path, seconds(), 5000.0, 0.1, 0.2, 0.3)
    try:
        assert water.end(60.0 + seconds()) == 0, water.output
    finally:
        water.kill()
    assert int(water.output.split()[-1]) > 0.9 * 5000 * seconds()
    for index, value in ((0, 0.5), (1, 33.0), (2, 44.0)):
        client.send(index, value)
    client.until(lambda: client.applied[-1]['drive_torque'] == 33.0 and client.applied[-1]['brake_torque'] == 44.0)
    process.process.send_signal(signal.SIGINT)
    assert process.end() == 0, process.output
    assert not UNWANTED.search(process.output)
    run = bag.read(tmp_path / 'run')
    np.testing.assert_array_equal(np.diff(run['cmd_applied/step']), 1.0)
    assert run['cmd_applied/step'][-1] * 0.002 > seconds()  # it kept pace


@pytest.mark.slow
def test_a_flood_of_nan_and_infinity_changes_nothing(start, client, tmp_path: Path) -> None:
    process = start({'record': True, 'out': 'run', 'command_timeout': 0.0})
    client.ready()
    client.until(lambda: client.applied)
    client.send(1, 25.0)
    client.until(lambda: client.applied[-1]['drive_torque'] == 25.0)
    water = flood(tmp_path, seconds(), 1000.0, math.nan, math.inf, -math.inf)
    try:
        assert water.end(60.0 + seconds()) == 0, water.output
    finally:
        water.kill()

    def refused() -> int:
        values = {v.key: v.value for a in client.diagnostics[-1:] for v in a.status[0].values}
        return int(values.get('commands refused', 0))

    client.until(lambda: refused() > 100)
    assert client.applied[-1]['drive_torque'] == 25.0
    process.process.send_signal(signal.SIGINT)
    assert process.end() == 0, process.output
    assert not UNWANTED.search(process.output)
    # said now and then, not for each of them
    assert process.output.count('is not a number') <= 3 * (2 + seconds() / 2.0)
    run = bag.read(tmp_path / 'run')
    assert set(np.unique(run['cmd_applied/drive_torque'])) == {0.0, 25.0}
    assert all(np.isfinite(column).all() for column in run.columns.values())


@pytest.mark.slow
def test_a_second_node_of_the_same_name_is_noticed_and_harms_no_recording(start, client, tmp_path: Path) -> None:
    first = start({'record': True, 'out': 'first'})
    client.ready()
    second = start({'record': True, 'out': 'second'})
    second.wait_for('running synthetic')
    first.wait_for('another node is called /simulator', 20.0)
    client.diagnostics.clear()
    client.until(lambda: any('another node has the same name' in a.status[0].message for a in client.diagnostics))
    for process in (second, first):
        process.process.send_signal(signal.SIGINT)
        assert process.end() == 0, process.output
        assert not UNWANTED.search(process.output)
    for name in ('first', 'second'):
        np.testing.assert_array_equal(np.diff(bag.read(tmp_path / name)['cmd_applied/step']), 1.0)


@pytest.mark.slow
@pytest.mark.parametrize('trial', trials(2, 1))
def test_a_folder_removed_while_recording_stops_the_recording_not_the_simulation(
    start, tmp_path: Path, trial: int
) -> None:
    process = start({'record': True, 'out': 'run'})
    process.wait_for('running synthetic')
    time.sleep(0.2 + 0.1 * (trial % 10))
    shutil.rmtree(tmp_path / 'run')
    time.sleep(0.5)
    assert process.process.poll() is None
    process.process.send_signal(signal.SIGINT)
    assert process.end() == BagError.exit_code, process.output
    assert not UNWANTED.search(process.output)
    assert 'stopped by SIGINT' in process.output
    assert 'recording to run/run_0.mcap failed' in process.output and 'No such file' in process.output


@pytest.mark.slow
@pytest.mark.parametrize('trial', trials(2, 1))
def test_a_disk_that_fills_up_costs_what_did_not_fit(trial: int, tmp_path: Path) -> None:
    """A limit on the size of files, which write() reports as it does a full disk; the run says so and what was written
    is recovered."""
    import resource

    from faults import Victim, mbd

    kilobytes = 200 + 150 * trial
    victim = Victim(
        tmp_path,
        ['-c', 'import resource, signal, sys\n'
         f'signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\nresource.setrlimit(resource.RLIMIT_FSIZE, '
         f'({kilobytes * 1000}, resource.RLIM_INFINITY))\nfrom mbd_sim_ros.commands.main import main\n'
         'sys.exit(main(sys.argv[1:]))',
         *mbd('run', 'light_car_lane_change', '--set', 'duration=1000', '--out', 'out')[2:]],
    )  # fmt: skip
    assert resource.RLIM_INFINITY
    try:
        ended = victim.end(time.monotonic(), 120.0)
    finally:
        victim.kill()
    assert ended.code == BagError.exit_code, ended.err
    assert len(ended.lines) == 1 and 'File too large' in ended.lines[0]
    saved = recover(tmp_path / 'out', tmp_path / 'saved')
    assert saved.messages > 100 and not saved.complete
