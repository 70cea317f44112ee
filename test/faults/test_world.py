"""What else the world does to a running node: a subscriber that never reads, other programs that want every core, a
clock that is set."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from client import client
from faults import UNWANTED, Victim, simulator, trials
from processes import DOMAIN, SCRIPT, Process, start

from mbd_sim_ros.bags import reader as bag

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

__all__ = ['client', 'start']  # fixtures
H = 0.002  # s, the step of the stand-in

# Subscribes reliably to everything there is and never looks at it.
DEAF = """
import time
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu, JointState
rclpy.init()
node = rclpy.create_node('deaf')
topics = {'joint_states': JointState, 'cmd_applied': JointState, 'element_states': JointState, 'odom': Odometry, 'imu': Imu}
kept = [node.create_subscription(kind, name, print, 1) for name, kind in topics.items()]
print('DEAF', flush=True)
time.sleep(600.0)
"""  # noqa: E501
JUMPS = """
import itertools, time
real, turn = time.time, itertools.cycle((0.0, 3600.0, -86400.0, 1.0e9, -1.0e9))
time.time = lambda: real() + next(turn)
time.time_ns = lambda: round(1e9 * time.time())
"""


def seconds() -> float:
    """Length of a fault."""
    return max(1.0, 0.05 * len(trials(1)))


def stopped(process: Process, directory: Path) -> bag.Run:
    """The recording of a node that is told to stop and does."""
    process.process.send_signal(signal.SIGINT)
    assert process.end() == 0, process.output
    assert not UNWANTED.search(process.output)
    run = bag.read(directory)
    np.testing.assert_array_equal(np.diff(run['cmd_applied/step']), 1.0)
    return run


def test_a_subscriber_that_never_reads_holds_nothing_up(start, client, tmp_path: Path) -> None:
    process = start({'record': True, 'out': 'run'})
    client.ready()
    client.until(lambda: client.applied)
    deaf = Process(tmp_path, [sys.executable, '-c', DEAF])
    try:
        deaf.wait_for('DEAF')
        begin, first = time.monotonic(), client.applied[-1]['step']
        while time.monotonic() - begin < seconds():
            client.executor.spin_once(timeout_sec=0.05)
        # it keeps pace, and others hear it
        client.until(lambda: client.applied[-1]['step'] > first + 0.9 * (time.monotonic() - begin) / H)
    finally:
        deaf.kill()
    run = stopped(process, tmp_path / 'run')
    assert run['cmd_applied/step'][-1] * H > seconds()


def test_starved_of_its_cores_a_node_is_late_and_loses_nothing(start, client, tmp_path: Path) -> None:
    process = start({'record': True, 'out': 'run'})
    client.ready()
    client.until(lambda: client.applied)
    busy = [subprocess.Popen([sys.executable, '-c', 'while True: pass']) for _ in range(2 * (os.cpu_count() or 1))]
    try:
        os.setpriority(os.PRIO_PROCESS, process.process.pid, 10)  # and the others go first
        end = time.monotonic() + seconds()
        while time.monotonic() < end:
            client.executor.spin_once(timeout_sec=0.05)
        steps = client.applied[-1]['step']
    finally:
        for one in busy:
            one.kill()
            one.wait()
    client.until(lambda: client.applied[-1]['step'] > steps + 100)
    run = stopped(process, tmp_path / 'run')
    assert int(run.metadata.get('dropped_steps', '0')) == 0


def test_a_clock_that_is_set_changes_neither_pace_nor_recording(tmp_path: Path) -> None:
    """The clock of the day, as Python tells it, jumps by an hour, a day and thirty years at every look."""
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    environment = {'ROS_DOMAIN_ID': DOMAIN, 'ROS_LOG_DIR': str(tmp_path / 'log')}
    victim = Victim(
        tmp_path, simulator(JUMPS + SCRIPT, '{}', '0', record=True, out='run', commands='maneuver'), **environment
    )
    try:
        assert victim.ready('running synthetic')
        begin = time.monotonic()
        time.sleep(seconds())
        lived = time.monotonic() - begin
        ended = victim.end(victim.strike(signal.SIGINT))
    finally:
        victim.kill()
    assert ended.code == 0 and not UNWANTED.search(ended.out + ended.err), ended.err
    steps = bag.read(tmp_path / 'run')['cmd_applied/step']
    np.testing.assert_array_equal(np.diff(steps), 1.0)
    assert 0.8 * lived < steps[-1] * H < 1.2 * lived + 1.0
