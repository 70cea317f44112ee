"""A node with a stand-in simulation in this process: what its actions do when something is in the way, and what they
publish."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from open_node import MANY, do, opened, said, sent, until
from synthetic import INPUTS

from solver.errors import BagError, SpecError

pytestmark = pytest.mark.realtime

__all__ = ['opened', 'sent']  # fixtures


def with_a_dead_recording(opened):
    """A paused node whose recording process was killed."""
    from mbd_sim_ros.node import services

    node = opened(record=True, out='first')
    assert do(node, services.pause)[0]
    recorder = node.running.recording.recorder
    os.kill(recorder.pid, signal.SIGKILL)
    until(lambda: recorder.error is not None)
    return node


def test_a_reset_is_done_whole_where_no_recording_can_begin_and_the_next_one_makes_good(opened, tmp_path: Path) -> None:
    from diagnostic_msgs.msg import DiagnosticStatus

    from mbd_sim_ros.node import services

    (tmp_path / 'bags').touch()
    node = opened(record=True, out='first')
    do(node, lambda running: running.latch.command(0, 0.7))
    assert do(node, services.pause)[0]
    done, text = do(node, services.reset)
    assert done
    assert text.startswith('back at t = 0; nothing is recorded any more: cannot record into bags/synthetic-')
    assert node.loop.latch.newest.values == (0.0, 0.0, 0.0)
    assert node.loop.steps == node.running.simulation.k == 0
    level, message = said(node)
    assert level == DiagnosticStatus.ERROR and message.startswith('cannot record into bags/')
    assert not do(node, services.start_recording)[0]
    (tmp_path / 'bags').unlink()
    assert do(node, services.start_recording)[0]
    assert said(node)[0] == DiagnosticStatus.OK
    node.load('second', [])
    assert node.close('stopped') == BagError.exit_code  # it had no recording for a while, in whichever scene


def test_a_vehicle_is_placed_whole_although_its_recording_has_died(opened) -> None:
    node = with_a_dead_recording(opened)
    done, text = do(node, lambda running: running.place(3.0, 4.0, (0.0, 0.0, 0.0, 1.0)))
    assert done
    assert text.startswith(
        'placed at x = 3.000 m, y = 4.000 m, heading 0.00 deg; what was recorded is not whole: recording to first '
        'failed'
    )
    assert node.running.recording.recorder is not None  # a new one
    assert node.running.recording.failed is None
    assert node.close('stopped') == BagError.exit_code


def test_a_recording_that_died_is_told_when_it_is_stopped(opened) -> None:
    from mbd_sim_ros.node import services

    node = with_a_dead_recording(opened)
    assert not do(node, services.stop_recording)[0]
    assert do(node, services.stop_recording) == (False, 'nothing is being recorded')
    assert node.close('stopped') == BagError.exit_code


def test_a_scene_that_is_refused_leaves_nothing_in_the_graph(opened, sent, tmp_path: Path) -> None:
    (tmp_path / 'bags').touch()
    node = opened(record=True, out='first')
    publishers, names = len(list(node.publishers)), sorted(node.get_node_names())
    descriptions = [topic for topic, _ in sent].count('/robot_description')
    with pytest.raises(BagError, match='cannot record into bags/second-'):
        node.load('second', [])
    assert len(list(node.publishers)) == publishers
    assert [topic for topic, _ in sent].count('/robot_description') == descriptions == 1
    until(lambda: sorted(node.get_node_names()) == names)  # that of the commands is gone, too
    assert node.running.scene.name == 'synthetic'


def test_lockstep_cannot_wait_for_what_there_is_not_and_nothing_has_been_published_by_then(opened, sent) -> None:
    with pytest.raises(SpecError, match="parameter lockstep_commands: synthetic has no input 'accelerator'"):
        opened(lockstep_commands=['accelerator'])
    assert '/robot_description' not in {topic for topic, _ in sent}


def test_in_lockstep_every_state_is_published_whatever_the_rates(opened, sent) -> None:
    """Who answers cmd_applied or odom gets every one; imu comes with every third step, tire_states with every 50th."""
    node = opened(mode='lockstep', publish_every=3, rate_cmd_applied=10.0, rate_odom=10.0, rate_tire_states=10.0)
    loop = node.loop
    until(lambda: any(topic == '/clock' for topic, _ in sent))  # the last of a state
    sent.clear()
    for k in range(6):
        assert loop.ask(lambda k=k: loop.latch.answer(k * 2_000_000, {})).result(10.0)
        until(lambda k=k: [topic for topic, _ in sent].count('/clock') == k + 1)
    topics = [topic for topic, _ in sent]
    assert [topics.count(f'/{name}') for name in ('cmd_applied', 'odom', 'imu', 'tire_states', 'clock')] == [
        6,
        6,
        2,
        0,
        6,
    ]


def test_a_state_that_is_repeated_in_lockstep_comes_with_the_clock(opened, sent) -> None:
    node = opened(mode='lockstep')
    until(lambda: any(topic == '/clock' for topic, _ in sent))
    sent.clear()
    until(lambda: any(topic == '/clock' for topic, _ in sent))  # a second later
    assert {'/cmd_applied', '/odom'} <= {topic for topic, _ in sent}
    assert node.running.simulation.k == 0


@pytest.mark.parametrize('mode', ['realtime', 'fast', 'lockstep'])
def test_who_comes_while_paused_is_shown_the_state_whatever_its_step_and_the_rates(opened, sent, mode: str) -> None:
    """Once a second; paused behind a step that has no tick of the clock, and no message of a thinned topic."""
    from mbd_sim_ros.node import services

    node = opened(mode=mode, rate_imu=1.0)
    assert do(node, services.pause)[0]
    until(lambda: do(node, services.step)[0] and node.running.simulation.k % 5 == 3)
    k = node.running.simulation.k
    time.sleep(0.1)
    sent.clear()
    until(lambda: any(topic == '/clock' for topic, _ in sent))
    time.sleep(0.2)
    assert node.running.simulation.k == k
    topics = [topic for topic, _ in sent]
    assert all(topics.count(f'/{name}') == 1 for name in ('cmd_applied', 'odom', 'imu', 'joint_states', 'clock'))


def test_an_answer_that_names_no_command_holds_them_all(opened) -> None:
    from sensor_msgs.msg import JointState

    node = opened(mode='lockstep')
    do(node, lambda running: running.latch.command(2, 30.0))
    do(node, lambda running: running.commands._stamped(JointState()))
    until(lambda: node.loop.steps == 1)
    np.testing.assert_array_equal(node.running.simulation.inputs[-2:], [0.0, 30.0])
    do(node, lambda running: running.commands._unstamped(JointState()))
    do(node, lambda running: running.commands._stamped(JointState(name=['brake_torque'])))
    assert (node.running.commands.refused, node.loop.steps) == (2, 1)
    twice = JointState(name=['brake_torque', 'steering', 'brake_torque'], position=[40.0, 0.1, 50.0])  # which of them?
    do(node, lambda running: running.commands._stamped(twice))
    assert (node.running.commands.refused, node.loop.steps) == (3, 1)


def test_a_command_by_name_counts_at_once_although_nobody_knows_yet_who_sends_it(opened) -> None:
    """Who publishes is looked for once a second, which this node never does: somebody who commands once may be gone by
    then. What he said would wait in the queue for the next one who commands, and count then."""
    from sensor_msgs.msg import JointState

    node = opened()
    publisher = node.create_publisher(JointState, 'simulator/lockstep_cmd', 10)
    until(lambda: publisher.get_subscription_count() > 0)
    publisher.publish(JointState(name=['brake_torque'], position=[30.0]))
    until(lambda: node.running.simulation.inputs[-1] == 30.0, 2.0)


def test_lockstep_that_begins_while_running_waits_for_commands_of_its_own(opened) -> None:
    """Those that real time has used are no newer than its last step, however many they were."""
    from rclpy.parameter import Parameter

    from mbd_sim_ros.node import services

    node = opened()
    for value in (10.0, 20.0):
        do(node, lambda running, value=value: [running.latch.command(index, value) for index in range(3)])
        until(lambda value=value: node.running.simulation.inputs[-1] == value)
    assert do(node, services.pause)[0]
    assert node.set_parameters([Parameter('mode', value='lockstep')])[0].successful
    k = node.running.simulation.k
    assert do(node, services.resume)[0]
    time.sleep(0.1)
    assert node.running.simulation.k == k
    do(node, lambda running: [running.latch.command(index, 30.0) for index in range(3)])
    until(lambda: node.running.simulation.k > k)
    time.sleep(0.05)
    assert node.running.simulation.k == k + 1 and node.running.simulation.inputs[-1] == 30.0
    assert node.loop.latch.answers.surplus == 0


def test_the_node_that_makes_time_takes_it_from_nobody(opened) -> None:
    from rclpy.parameter import Parameter

    node = opened()
    for wanted in (True, False):
        result = node.set_parameters([Parameter('use_sim_time', value=wanted)])[0]
        assert result.successful is not wanted
        assert abs(node.get_clock().now().nanoseconds * 1e-9 - time.time()) < 60.0


def test_a_pause_is_not_taken_for_a_slow_machine(opened) -> None:
    from mbd_sim_ros.node import services

    node = opened()
    assert do(node, services.pause)[0]
    node.loop.health()
    time.sleep(0.3)
    assert do(node, services.resume)[0]
    time.sleep(0.3)
    assert node.loop.health().rate > 0.7  # half of the time it was paused


def test_inputs_that_no_command_is_for_are_named(opened, capfd, monkeypatch) -> None:
    # a motion, which no topic drives
    monkeypatch.setattr('synthetic.INPUTS', (*INPUTS, 'motor', 'motor_rate', 'motor_acceleration'))
    sentence = 'no command is for motor: held as at the start; with the parameter commands = maneuver the maneuver'
    opened()
    assert sentence in capfd.readouterr().err
    opened(commands='maneuver')
    assert sentence not in capfd.readouterr().err


def test_lockstep_that_listens_to_nobody_says_so(opened, capfd) -> None:
    from rclpy.parameter import Parameter

    opened(mode='lockstep', commands='maneuver')
    assert 'only ~/step makes steps' in capfd.readouterr().err
    node = opened(commands='maneuver')
    assert 'only ~/step makes steps' not in capfd.readouterr().err
    assert node.set_parameters([Parameter('mode', value='lockstep')])[0].successful
    assert 'only ~/step makes steps' in capfd.readouterr().err


def test_an_answer_that_outlasts_what_drives_is_told(opened, capfd) -> None:
    """Steps of 2 ms: 251 of them are longer than 0.5 s."""
    from rclpy.parameter import Parameter

    def changed(**values: object) -> str:
        assert all(
            one.successful
            for one in node.set_parameters([Parameter(name, value=value) for name, value in values.items()])
        )
        return capfd.readouterr().err

    opened(mode='lockstep', lockstep_every=251)
    assert (
        'lockstep_every = 251 steps are 0.502 s, and after command_timeout = 0.5 s drive torque'
        in capfd.readouterr().err
    )
    node = opened(lockstep_every=251)
    assert 'lockstep_every' not in capfd.readouterr().err  # in real time nothing waits
    assert 'lockstep_every = 251' in changed(mode='lockstep')
    assert 'lockstep_every' not in changed(lockstep_every=250)
    assert 'lockstep_every = 1000' in changed(lockstep_every=1000)
    assert 'lockstep_every' not in changed(command_timeout=0.0)
    assert not node.set_parameters([Parameter('lockstep_every', value=0)])[0].successful


def test_a_pause_ends_the_steps_that_were_asked_for(opened) -> None:
    from mbd_sim_ros.node import services

    node = opened(step_count=MANY)
    assert do(node, services.pause)[0]
    begin = node.running.simulation.k
    assert do(node, services.step)[0]
    until(lambda: node.running.simulation.k > begin)
    done, text = do(node, services.pause)
    made = node.running.simulation.k - begin
    assert done and text.endswith(f'step {begin + made}; {MANY - made} steps that were asked for are not made')
    time.sleep(0.1)
    assert node.running.simulation.k == begin + made
    assert 'not made' not in do(node, services.pause)[1]


@pytest.mark.parametrize('action', ['pause', 'resume', 'reset'])
def test_steps_that_were_dropped_do_not_count_as_made(opened, action: str) -> None:
    """That call of simulation_interfaces ends with what it has done."""
    from mbd_sim_ros.node import services
    from mbd_sim_ros.node.interfaces import Interfaces

    node = opened()
    assert do(node, services.pause)[0] and do(node, services.reset)[0]
    interfaces = object.__new__(Interfaces)
    interfaces.host, interfaces.node = node, SimpleNamespace(executor=None)
    call = interfaces._steps(MANY, lambda made: None)
    call.send(None)
    until(lambda: node.running.simulation.k > 0)
    counted = do(node, lambda running: (getattr(services, action)(running), running.loop.dropped)[1])[1]
    with pytest.raises(StopIteration) as end:
        while True:
            call.send(None)
    assert end.value.value == (
        False,
        f'{MANY - counted} of {MANY} steps: the others were dropped by a pause, a resumption or a reset',
    )


def test_steps_one_by_one_end_where_the_simulation_goes_on_by_itself(opened) -> None:
    from mbd_sim_ros.node import services
    from mbd_sim_ros.node.interfaces import Interfaces

    node = opened()
    assert do(node, services.pause)[0]
    interfaces = object.__new__(Interfaces)
    interfaces.host, interfaces.node = node, SimpleNamespace(executor=None)
    call = interfaces._steps(MANY, lambda made: do(node, services.resume)[0] and None, one_by_one=True)
    with pytest.raises(StopIteration) as end:
        while True:
            call.send(None)
    assert end.value.value == (False, f'1 of {MANY} steps: the simulation is running again')


def test_an_override_that_another_one_replaces_is_refused() -> None:
    from mbd_sim_ros.node.main import prepare

    with pytest.raises(
        SpecError, match=r'parameter overrides: start\.speed=1 has no effect, because start=\{\} comes later'
    ):
        prepare('slider_crank', ['start.speed=1', 'start={}'])


def test_a_pose_is_taken_in_the_frames_of_the_world_only_and_shown_while_paused(opened, sent, capfd) -> None:
    from geometry_msgs.msg import PoseWithCovarianceStamped

    from mbd_sim_ros.node import services

    node = opened(frame_prefix='red/', publish_every=1000)
    until(lambda: node.running.simulation.k > 0)
    assert do(node, services.pause)[0]
    message = PoseWithCovarianceStamped()
    message.pose.pose.position.x, message.pose.pose.orientation.w = 50.0, 1.0
    message.header.frame_id = 'base_link'
    sent.clear()
    node._place(message)
    assert "initialpose refused: frame 'base_link': a pose must be given in map or red/odom" in capfd.readouterr().err
    assert not hasattr(node.running.simulation, 'placed') and not sent
    for frame in ('', 'map', 'red/odom'):
        message.header.frame_id = frame
        message.pose.pose.position.x += 1.0
        sent.clear()
        node._place(message)
        assert node.running.simulation.placed == (message.pose.pose.position.x, 0.0, 0.0)
        assert {'/odom', '/joint_states'} <= {topic for topic, _ in sent}


def test_a_recording_that_ends_with_a_placing_is_judged_by_what_was_before(opened, monkeypatch) -> None:
    """Behind it the account of the simulation is another one, which has nothing in it."""
    placed: list[bool] = []
    node = opened(record=True, out='first')
    monkeypatch.setattr(
        'mbd_sim_ros.node.recording.judged',
        lambda simulation, *_, **__: placed.append(hasattr(simulation, 'placed')) or [],
    )
    assert do(node, lambda running: running.place(1.0, 2.0, (0.0, 0.0, 0.0, 1.0)))[0]
    assert placed == [False]
