"""A node that goes on behind a restore, a reset, a pause or the end of a recording has what it had: commands, inputs,
steps."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from open_node import do, opened, sent, until
from synthetic import INPUTS, scene

from mbd_sim_ros.bags.inputs import content, inputs_of
from mbd_sim_ros.messages.cdr import decode
from mbd_sim_ros.messages.definitions import schema_text
from mbd_sim_ros.messages.encode import Messages
from mbd_sim_ros.messages.topics import TF
from solver.inputs.actuation import Actuation
from solver.inputs.signals import Mapped
from solver.scene import Record

pytestmark = pytest.mark.realtime

__all__ = ['opened', 'sent']  # fixtures


def test_a_car_that_was_saved_on_its_brakes_stands_on_them(opened) -> None:
    """What drives was there while somebody sent it."""
    from mbd_sim_ros.node import services

    node = opened(mode='lockstep')
    do(node, lambda running: [running.latch.command(index, value) for index, value in enumerate((0.3, 50.0, 30.0))])
    until(lambda: node.loop.steps == 1)
    done, file = do(node, services.save_state)
    assert done
    node = opened(mode='lockstep', restore=file)
    assert node.loop.latch.newest.values == (0.3, 0.0, 30.0)
    assert do(node, services.step)[0]
    until(lambda: node.loop.steps == 1)
    np.testing.assert_array_equal(node.running.simulation.inputs[-2:], [0.0, 30.0])
    assert do(node, services.reset)[0]
    assert node.loop.latch.newest.values == (0.0, 0.0, 0.0)  # as the scene begins


def test_what_a_maneuver_holds_holds_for_the_topics_that_go_on_from_its_state(opened, monkeypatch) -> None:
    """The wheel is where it was, and turns as it did; nobody has commanded anything, so that no command stands in the
    file."""
    from mbd_sim_ros.node import services

    monkeypatch.setattr('synthetic.INPUTS', (*INPUTS, 'lock_up', 'brake_torque_rear_left'))
    node = opened(commands='maneuver', mode='lockstep')
    do(node, lambda running: running.simulation.advance(1, np.array([0.4, 0.1, 0.0, 50.0, 30.0, 1.0, 12.0])) and '')
    done, file = do(node, services.save_state)
    assert done
    node = opened(mode='lockstep', restore=file)
    assert dict(zip(node.loop.latch.commands, node.loop.latch.newest.values)) == {
        'steering': 0.4, 'drive_torque': 0.0, 'brake_torque': 30.0, 'lock_up': 1.0, 'brake_torque_rear_left': 12.0,
    }  # fmt: skip
    assert node.running.driving._source.state.tolist() == [0.4, 0.4, 0.1]


def test_an_angle_of_road_wheels_that_was_commanded_is_reached_behind_a_restore_too(opened, monkeypatch) -> None:
    """The map: 1 rad of the steering wheel is straight on, and 16 times the angle of the road wheels more. At 20 rad/s
    the reference of the filter takes 80 ms, 40 steps, for the 1.6 rad to it. Where nothing was commanded the wheel
    stays where it is."""
    from mbd_sim_ros.node import services

    plain, mapped = scene, Mapped(of=0.0, points=((-1.0, -15.0), (1.0, 17.0)))
    monkeypatch.setattr(
        'open_node.scene', lambda **values: plain(**{'actuation': Actuation(steering='road_wheel'), **values})
    )
    monkeypatch.setattr('mbd_sim_ros.node.driving.steering_map', lambda model: mapped)
    for commands, stands in (((0.1,), 2.6), ((), 0.0)):
        node = opened(mode='lockstep', step_count=1)
        do(node, lambda running, commands=commands: [running.latch.command(0, value) for value in commands])
        assert do(node, services.step)[0]
        until(lambda node=node: node.loop.steps == 1)
        done, file = do(node, services.save_state)
        assert done
        node = opened(mode='lockstep', step_count=200, restore=file)
        assert do(node, services.step)[0]
        until(lambda node=node: node.loop.steps == 200)
        assert node.running.driving._source.state[0] == pytest.approx(stands, abs=1e-12)


def test_a_motion_that_goes_on_at_another_time_keeps_its_commands(opened) -> None:
    """The steering wheel has not reached its angle yet: at 20 rad/s it takes 15 ms."""
    node = opened(mode='lockstep')
    do(node, lambda running: [running.latch.command(index, value) for index, value in enumerate((0.3, 50.0, 30.0))])
    until(lambda: node.loop.steps == 1)
    assert do(node, lambda running: running.reset(state=False))[0]
    assert node.running.simulation.k == 0
    assert node.loop.latch.newest.values == (0.3, 0.0, 30.0)  # what drives is there while it is sent only


def test_commands_given_while_lockstep_is_paused_count_in_the_steps_that_are_asked_for_and_in_no_other(opened) -> None:
    from rclpy.duration import Duration
    from std_msgs.msg import Float64

    from mbd_sim_ros.node import services

    node = opened(mode='lockstep', step_count=2)
    assert do(node, services.pause)[0]
    topics = {'steering_cmd': 0.1, 'torque_cmd': 20.0, 'brake_cmd': 30.0}
    publishers = {topic: node.create_publisher(Float64, f'simulator/{topic}', 1) for topic in topics}
    until(lambda: all(publisher.get_subscription_count() for publisher in publishers.values()))
    for topic, value in topics.items():
        publishers[topic].publish(Float64(data=value))
        assert publishers[topic].wait_for_all_acked(Duration(seconds=10))
    time.sleep(0.1)
    assert do(node, services.step)[0]
    until(lambda: node.loop.steps == 2)
    np.testing.assert_array_equal(node.running.simulation.inputs[-2:], [20.0, 30.0])
    assert do(node, services.resume)[0]
    time.sleep(0.1)
    assert node.loop.steps == 2  # no newer than at the last step


def test_all_bodies_are_shown_while_paused_whatever_the_step(opened, monkeypatch) -> None:
    """At another rate than the messages of a run: who opens RViz then would see the chassis without its wheels."""
    from mbd_sim_ros.node import services

    node = opened()
    running = node.running
    assert do(node, services.pause)[0]
    until(lambda: do(node, services.step)[0] and running.simulation.k % 10 == 3)
    time.sleep(0.1)
    shown: list[list] = []
    monkeypatch.setattr(running.audience, '_messages', Messages(running.simulation.channels, poses_every=10))
    monkeypatch.setattr(running._publication, 'publish', lambda messages, channels: shown.append(messages))
    do(node, lambda running: running.audience.repeat() or '')
    transforms = decode(TF, schema_text(TF), shown[-1][-1])[0]['transforms']
    assert {'base_link', 'subframe', 'wheel', 'imu_link'} <= {one['child_frame_id'] for one in transforms}


@pytest.mark.parametrize('action', ['stop_recording', 'reset', 'place'])
def test_a_recording_that_is_ended_holds_its_last_steps_too(opened, tmp_path: Path, monkeypatch, action: str) -> None:
    """Seven of them behind the last instant of record.every."""
    from mbd_sim_ros.node import services

    plain = scene
    monkeypatch.setattr(
        'open_node.scene',
        lambda **values: plain(**{'record': Record(every=10, poses=0.0, elements_rate=0.0), **values}),
    )
    node = opened(mode='lockstep', record=True, out='first', step_count=27)
    assert do(node, services.step)[0]
    until(lambda: node.loop.steps == 27)
    act = getattr(services, action, lambda running: running.place(1.0, 2.0, (0.0, 0.0, 0.0, 1.0)))
    assert do(node, act)[0]
    found = inputs_of(content(tmp_path / 'first'))
    assert (found.first, found.last) == (0, 27)
