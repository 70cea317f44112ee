"""The executable `maneuver` against the simulator, as two processes over real topics."""

from __future__ import annotations

import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from processes import DOMAIN, Process, start

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.node.maneuver_node import LOST
from solver.files.scene import load_maneuver

pytestmark = pytest.mark.realtime

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
    return Process(tmp_path, [sys.executable, '-m', 'mbd_sim_ros.node.maneuver_player', '--ros-args', *arguments])


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
    played = load_maneuver(maneuver)
    expected = np.array([played.commands(t) for t in run.time[:-1]])
    np.testing.assert_array_equal(run['cmd_applied/drive_torque'][1:], expected[:, 1])
    np.testing.assert_array_equal(run['cmd_applied/brake_torque'][1:], expected[:, 2])
    # behind the filter, 0.2 s after the step has ended
    assert run['cmd_applied/steering'][-1] == pytest.approx(0.5, abs=0.01)
    for name, values in run.columns.items():
        np.testing.assert_array_equal(values, runs[1][name], err_msg=name)


def test_in_real_time_commands_follow_within_a_few_steps(start, tmp_path, maneuver):
    player = play(tmp_path, f'maneuver:={maneuver}')  # waits for the simulator
    process = start({'duration': 4.5, 'record': True, 'out': 'run'})
    try:
        assert process.end(60.0) == 0, process.output
        assert player.end(30.0) == 0, player.output
    finally:
        player.kill()
    run = bag.read(tmp_path / 'run')
    heard = run['cmd_applied/brake_torque'] > 0.0  # from when on the player, a process too, is there
    assert heard.sum() > 500, 'the player was there for less than a second'
    played = load_maneuver(maneuver)
    expected = np.array([played.commands(t)[2] for t in run.time[heard]])
    behind = (expected - run['cmd_applied/brake_torque'][heard]) / MANEUVER['brake_torque']['slope']  # s, on its ramp
    assert np.median(behind) < 0.02
    assert np.all(behind[-50:] < 0.1)  # in the last 0.1 s


@pytest.mark.parametrize('steering', ['angle', 'torque', 'road_wheel'])
def test_no_angle_is_sent_to_a_car_that_takes_none(steering: str, tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A maneuver that does not steer has an angle of 0; where that is no command the whole message would be refused,
    brakes and all."""
    rclpy = pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    from mbd_sim_ros.node.maneuver_node import Player
    from mbd_sim_ros.node.maneuver_player import PARAMETERS

    scene = tmp_path / 'scene.yaml'
    scene.write_text(f'<<: scenes/light_car_straight.yaml\nactuation: {{steering: {steering}}}\n')
    rclpy.init(args=['--ros-args', '-p', f'scene:={scene}'], domain_id=int(DOMAIN))
    try:
        player, sent = Player(PARAMETERS), []
        monkeypatch.setattr(player, '_stamped', SimpleNamespace(get_subscription_count=lambda: 1, publish=sent.append))
        player.answered = 0
        player._send()
        player.destroy_node()
    finally:
        rclpy.try_shutdown()
    assert list(sent[0].name) == ['steering'] * (steering == 'angle') + ['drive_torque', 'brake_torque']


@pytest.mark.parametrize('steered', [False, True])
def test_a_car_without_an_angle_to_steer_is_found_and_sent_none(
    steered: bool, tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever plays a file knows no scene: the player ended with its first answer, as if the simulator had, and that
    answer was refused."""
    rclpy = pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    from std_msgs.msg import Float64

    from mbd_sim_ros.node.maneuver_node import Player
    from mbd_sim_ros.node.maneuver_player import PARAMETERS

    file = tmp_path / 'brake.yaml'
    file.write_text('name: brake\nbrake_torque: 100.0\n')
    rclpy.init(args=['--ros-args', '-p', f'maneuver:={file}'], domain_id=int(DOMAIN))
    try:
        car = rclpy.create_node('car')
        for name in ('torque_cmd', *['steering_cmd'] * steered):
            car.create_subscription(Float64, f'simulator/{name}', lambda _: None, 1)
        player, sent = Player(PARAMETERS), []
        end = time.monotonic() + 20.0
        while (
            car.count_publishers('simulator/torque_cmd') == 0
            or not player._found()
            or player._listened('steering') != steered
        ):
            assert time.monotonic() < end
            time.sleep(0.01)
        monkeypatch.setattr(player, '_stamped', SimpleNamespace(get_subscription_count=lambda: 1, publish=sent.append))
        player.answered = 0
        player._send()
        assert player.ended() == ''
        for node in (player, car):
            node.destroy_node()
    finally:
        rclpy.try_shutdown()
    assert list(sent[0].name) == ['steering'] * steered + ['drive_torque', 'brake_torque']


class Simulator:
    """Stands in for the simulator: states go out when told, brake commands come in with the clock reading of their
    arrival."""

    def __init__(self, rclpy, context):
        from rclpy.executors import SingleThreadedExecutor
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64

        self.node = rclpy.create_node('stand_in', context=context)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        self.states = self.node.create_publisher(JointState, 'cmd_applied', 1)
        self.answers: list[tuple[float, float]] = []  # (value, arrival)
        for name in ('steering_cmd', 'torque_cmd'):
            self.node.create_subscription(Float64, f'simulator/{name}', lambda _: None, 10)
        self.node.create_subscription(
            Float64, 'simulator/brake_cmd', lambda message: self.answers.append((message.data, time.monotonic())), 10
        )
        self.message = JointState

    def show(self, seconds: int) -> float:
        """Publish the state of an instant [s]; returns the clock reading before."""
        message = self.message()
        message.header.stamp.sec = seconds
        begin = time.monotonic()
        self.states.publish(message)
        return begin

    def listen(self, seconds: float, answers: int = 1 << 30) -> None:
        """Take what comes, for some time or until there are so many answers."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and len(self.answers) < answers:
            self.executor.spin_once(timeout_sec=0.02)


def test_a_repeated_state_is_answered_again_only_once_the_answer_must_be_lost(tmp_path, maneuver):
    rclpy = pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(DOMAIN))
    simulator = Simulator(rclpy, context)
    player = play(tmp_path, f'maneuver:={maneuver}', 'rate:=0.0')
    try:
        for _ in range(300):  # until both have found each other
            simulator.show(1)
            simulator.listen(0.1, 1)
            if simulator.answers:
                break
        simulator.listen(2.0 * LOST)  # what the repetitions above may have asked for
        simulator.answers.clear()
        simulator.show(2)
        simulator.listen(10.0, 1)
        assert [value for value, _ in simulator.answers] == [180.0]  # 100 N m/s from 0.2 s on
        simulator.listen(2.0 * LOST)
        assert len(simulator.answers) == 1  # nothing is answered twice by itself
        again = [simulator.show(2) for _ in range(3)]
        simulator.listen(10.0, 2)
        assert simulator.answers[1][0] == 180.0
        assert simulator.answers[1][1] - again[0] >= LOST
        simulator.listen(2.0 * LOST)
        assert len(simulator.answers) == 2  # three repetitions, one answer
        simulator.show(3)
        simulator.listen(10.0, 3)
        assert simulator.answers[2][0] == 280.0  # a newer state is answered at once
        assert player.process.poll() is None
    finally:
        player.kill()
        simulator.executor.shutdown()
        simulator.node.destroy_node()
        rclpy.shutdown(context=context)


def test_a_driver_who_sees_the_motion_is_refused_before_anybody_waits(tmp_path):
    player = play(tmp_path, 'maneuver:=iso13674_weave', 'timeout:=600.0')
    try:
        assert player.end(30.0) == 2
    finally:
        player.kill()
    assert 'its driver sees the motion; run it in the simulation' in player.output
    assert 'waiting for' not in player.output


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
