"""Lockstep: stamped commands answer one state each, whatever comes twice, late or never."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from client import client
from processes import Process, start

from mbd_sim_ros.bags import reader as bag

pytestmark = pytest.mark.realtime

__all__ = ['client', 'start']  # fixtures

STEPS = 150

# Answers every state it gets, repeated ones too; its answers depend on the state. argv: steps before which it naps until
# states have been repeated.
CONTROLLER = """
import math, sys, time
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState
from mbd_sim_ros.node.loop import REPEAT
rclpy.init()
node = Node('controller')
answers = node.create_publisher(JointState, 'simulator/lockstep_cmd', 10)
naps = set(map(int, sys.argv[1:]))
def answer(state):
    applied = dict(zip(state.name, state.position))
    step = int(applied['step'])
    if step in naps:
        naps.discard(step)
        time.sleep(1.5 * REPEAT)
    message = JointState(name=['drive_torque', 'brake_torque', 'steering'])
    message.header.stamp = state.header.stamp
    message.position = [100.0 * math.sin(step), 2.0 * step + 0.5 * abs(applied['drive_torque']), 0.01 * step]
    answers.publish(message)
node.create_subscription(JointState, 'cmd_applied', answer, 10)
rclpy.spin(node)
"""


@contextmanager
def both_cores_busy() -> Iterator[None]:
    busy = [
        subprocess.Popen([sys.executable, '-c', 'import time\nend = time.time() + 120\nwhile time.time() < end: pass']) for _ in range(2)
    ]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_controller_that_naps_on_a_busy_machine_gives_the_same_run_twice(start, tmp_path: Path) -> None:
    """The machine is busy from when the simulator waits for its first command: until then it only takes longer to get there."""
    runs = []
    for name, naps in (('first', ('40', '90')), ('again', ('5', '120'))):
        process = start({'mode': 'lockstep', 'duration': STEPS * 0.002, 'record': True, 'out': name})
        process.wait_for('running synthetic')
        with both_cores_busy():
            controller = Process(tmp_path, [sys.executable, '-c', CONTROLLER, *naps])
            try:
                assert process.end(120.0) == 0, process.output + controller.output
            finally:
                controller.kill()
        assert 'lockstep_cmd answers t = ' in process.output  # repeated states were answered more than once, and that was seen
        runs.append(bag.read(tmp_path / name))
    run = runs[0]
    np.testing.assert_array_equal(run['cmd_applied/step'], np.arange(STEPS + 1.0))
    drive = run['cmd_applied/drive_torque']
    np.testing.assert_array_equal(drive[1:], 100.0 * np.sin(np.arange(STEPS)))
    np.testing.assert_array_equal(run['cmd_applied/brake_torque'][1:], 2.0 * np.arange(STEPS) + 0.5 * np.abs(drive[:-1]))
    assert run.columns.keys() == runs[1].columns.keys()
    for name, values in run.columns.items():
        np.testing.assert_array_equal(values, runs[1][name], err_msg=name)


def test_only_the_answer_to_the_waiting_state_makes_a_step(start, client) -> None:
    from sensor_msgs.msg import JointState

    process = start({'mode': 'lockstep', 'max_drive_torque': 50.0})
    client.ready()
    publisher = client.node.create_publisher(JointState, 'simulator/lockstep_cmd', 10)
    client.until(publisher.get_subscription_count)
    client.until(lambda: client.applied)

    def answer(t_ns: int, **values: float) -> None:
        message = JointState(name=list(values), position=[float(v) for v in values.values()])
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(t_ns, 1_000_000_000)
        publisher.publish(message)

    def settled(step: int) -> None:
        client.until(lambda: client.applied[-1]['step'] == step)

    answer(0, drive_torque=10.0)
    settled(1)
    assert client.applied[-1]['drive_torque'] == 10.0
    for _ in range(3):
        answer(0, drive_torque=20.0)  # the same state once more: too late
    answer(6_000_000, drive_torque=30.0)  # a state that is not there yet
    answer(2_000_000, drive_torque=float('nan'))
    answer(2_000_000, drive_torkue=1.0)
    values = {}

    def counted() -> bool:
        values.update({v.key: v.value for a in client.diagnostics for v in a.status[0].values})
        return values.get('lockstep answers refused') == '4' and values.get('commands refused') == '2'

    client.until(counted)
    assert client.applied[-1]['step'] == 1.0  # none of them made a step
    answer(2_000_000, brake_torque=5.0, drive_torque=400.0)
    settled(2)
    assert (client.applied[-1]['drive_torque'], client.applied[-1]['brake_torque']) == (50.0, 5.0)  # limited
    answer(4_000_000, brake_torque=6.0)  # what is not named holds
    settled(3)
    assert (client.applied[-1]['drive_torque'], client.applied[-1]['brake_torque']) == (50.0, 6.0)
    for index, value in enumerate((0.1, 7.0, 8.0)):  # the plain commands work as ever
        client.send(index, value)
    settled(4)
    assert (client.applied[-1]['drive_torque'], client.applied[-1]['brake_torque']) == (7.0, 8.0)
    assert client.call('reset').success
    client.until(lambda: client.applied[-1]['step'] == 0)
    answer(8_000_000, drive_torque=1.0)  # an answer from before
    answer(0, drive_torque=2.0)
    settled(1)
    assert client.applied[-1]['drive_torque'] == 2.0
    process.process.terminate()
    assert process.end() == 0
    assert "'drive_torkue' is no command; did you mean 'drive_torque'?" in process.output
    assert 'drive_torque: nan is not a number' in process.output
