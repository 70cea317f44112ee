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
from real_node import simulator

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.commands.main import main

pytestmark = pytest.mark.realtime

__all__ = ['client', 'simulator', 'start']  # fixtures

STEPS = 150

# Answers every state it gets, repeated ones too; its answers depend on the state. argv: steps before which it naps
# until states have been repeated.
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
        subprocess.Popen([sys.executable, '-c', 'import time\nend = time.time() + 120\nwhile time.time() < end: pass'])
        for _ in range(2)
    ]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_controller_that_naps_on_a_busy_machine_gives_the_same_run_twice(start, tmp_path: Path) -> None:
    """The machine is busy from when the simulator waits for its first command: until then it only takes longer to get
    there."""
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
        # repeated states were answered more than once, and that was seen
        assert 'lockstep_cmd answers t = ' in process.output
        runs.append(bag.read(tmp_path / name))
    run = runs[0]
    np.testing.assert_array_equal(run['cmd_applied/step'], np.arange(STEPS + 1.0))
    drive = run['cmd_applied/drive_torque']
    np.testing.assert_array_equal(drive[1:], 100.0 * np.sin(np.arange(STEPS)))
    np.testing.assert_array_equal(
        run['cmd_applied/brake_torque'][1:], 2.0 * np.arange(STEPS) + 0.5 * np.abs(drive[:-1])
    )
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


def test_an_answer_makes_so_many_steps_and_the_states_between_are_not_waited_for(start, client, tmp_path: Path) -> None:
    """Every tenth state is answered, from what it says; cmd_applied shows these alone, and joint_states all."""
    from sensor_msgs.msg import JointState

    joints: list[int] = []
    client.node.create_subscription(
        JointState, 'joint_states', lambda m: joints.append(m.header.stamp.sec * 10**9 + m.header.stamp.nanosec), 1000
    )
    process = start({'mode': 'lockstep', 'lockstep_every': 10, 'duration': STEPS * 0.002, 'record': True, 'out': 'run'})
    client.until(lambda: client.applied and joints)
    controller = Process(tmp_path, [sys.executable, '-c', CONTROLLER])
    try:
        # the last may be lost
        client.until(lambda: client.applied[-1]['step'] >= STEPS - 10 and len(set(joints)) > STEPS - 20, 30.0)
        assert process.end() == 0, process.output + controller.output
    finally:
        controller.kill()
    assert {applied['step'] for applied in client.applied} | {STEPS} == set(range(0, STEPS + 1, 10))
    np.testing.assert_array_equal(np.diff(sorted(set(joints))), 2_000_000)
    run = bag.read(tmp_path / 'run')
    np.testing.assert_array_equal(run['cmd_applied/step'], np.arange(STEPS + 1.0))
    answered = np.arange(STEPS) // 10 * 10
    drive = 100.0 * np.sin(answered)
    np.testing.assert_array_equal(run['cmd_applied/drive_torque'][1:], drive)
    before = np.where(answered > 0, 100.0 * np.sin(answered - 10), 0.0)
    np.testing.assert_array_equal(run['cmd_applied/brake_torque'][1:], 2.0 * answered + 0.5 * np.abs(before))


@pytest.mark.slow
def test_a_controller_at_100_hz_drives_a_car_at_1_khz_the_same_way_every_time_and_it_can_be_replayed(
    simulator, tmp_path: Path
) -> None:
    """It ends at 0.287 s, in the middle of an answer; inputs of all steps are recorded, those of the states between
    too."""
    runs = []
    for name in ('first', 'again'):
        record = {'duration': 0.287, 'record': True, 'out': name}
        process = simulator(
            scene='light_car_straight', overrides=['integrator.h=0.001'], mode='lockstep', lockstep_every=10, **record
        )
        process.wait_for('running light_car_straight')
        controller = Process(tmp_path, [sys.executable, '-c', CONTROLLER])
        try:
            assert process.end(60.0) == 0, process.output + controller.output
        finally:
            controller.kill()
        runs.append(bag.read(tmp_path / name))
        assert main(['replay', str(tmp_path / name), '--json']) == 0
    np.testing.assert_array_equal(runs[0]['cmd_applied/step'], np.arange(288.0))
    np.testing.assert_array_equal(runs[0]['cmd_applied/drive_torque'][1:], 100.0 * np.sin(np.arange(287) // 10 * 10))
    for column, values in runs[0].columns.items():
        np.testing.assert_array_equal(values, runs[1][column], err_msg=column)
