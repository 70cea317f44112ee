"""What `ros2 bag record` made of our node is viewed and replayed: by stamps, whatever the recorder's clock, and bit for
bit."""

from __future__ import annotations

import json
import threading
import time

import numpy as np
import pytest
from foreign_bags import DAY, Message, joints, text, write
from node_bags import node_bag, node_messages

from mbd_sim_ros.analysis.view.motion import curves_of, read_motion
from mbd_sim_ros.bags.inputs import content, inputs_of
from mbd_sim_ros.bags.poses import read_poses
from mbd_sim_ros.commands.main import main
from solver.errors import BagError

BAR, CAR = 'four_bar', 'light_car_lane_change'


def document(capsys: pytest.CaptureFixture[str], *argv: object) -> tuple[int, dict]:
    capsys.readouterr()
    code = main([*map(str, argv), '--json'])
    captured = capsys.readouterr()
    return code, json.loads(captured.out)


def refused(capsys: pytest.CaptureFixture[str], *argv: object) -> str:
    """The one sentence with which a command ends."""
    capsys.readouterr()
    assert main([*map(str, argv)]) != 0
    said = capsys.readouterr().err.strip()
    assert said and '\n' not in said
    return said


@pytest.mark.slow
@pytest.mark.parametrize('kind', ['mcap', 'mcap zstd', 'db3', 'db3 file'])
def test_a_bag_of_all_topics_describes_itself_and_replays_bit_for_bit(kind, tmp_path, capsys):
    """Rates differ by topic, the state at the start came three times, and another node publishes transforms and joints
    of its own."""
    every = {'odom': 3, 'joint_states': 7, '/tf': 10}
    messages = node_messages(BAR, ['record.every=4'], steps=120, every=every, repeats=3)
    messages += [
        joints('/joint_states', DAY + 10**9, DAY, 50_000_000, {'gripper': 0.1}),
        text('/planner/scene', DAY, DAY, 'a crossing'),
    ]
    bag = write(tmp_path / 'bag', messages, kind)
    code, data = document(capsys, 'replay', bag)
    assert (code, data['status'], data['steps'], data['first_step'], data['outside']) == (0, 'identical', 120, 0, [])
    assert data['same_code'] and data['target_differences'] == []
    ours = len(messages) - 3  # scene, gripper, the scene of another node
    assert data['messages'] == ours
    assert data['told'] == ['topic joint_states: 1 messages of another publisher are not compared']
    motion = read_motion(bag)
    np.testing.assert_array_equal(motion.time, np.unique(motion.time))
    assert motion.time[0] == 0.0 and motion.time[-1] <= 120 * 1e-3 + 1e-12


@pytest.mark.slow
def test_a_car_with_namespace_and_prefix_replays_and_is_drawn_where_it_was(tmp_path, capsys):
    bag = node_bag(tmp_path / 'bag', CAR, ['record.poses=50'], steps=200, namespace='left/car', prefix='left/')
    code, data = document(capsys, 'replay', bag, '--out', tmp_path / 'again')
    assert (code, data['status'], data['told']) == (0, 'identical', [])
    assert document(capsys, 'replay', tmp_path / 'again')[1]['status'] == 'identical'
    motion, own = read_motion(bag), read_motion(tmp_path / 'again')
    np.testing.assert_array_equal(motion.time, own.time)
    np.testing.assert_array_equal(motion.pose, own.pose)
    np.testing.assert_array_equal(motion.force, own.force)
    assert curves_of(motion) == curves_of(own)
    assert main(['view', str(bag), '--out', str(tmp_path / 'x.html')]) == 0
    assert (tmp_path / 'x.html').stat().st_size > 10_000
    code, data = document(capsys, 'replay', bag, '--set', 'integrator.iterations=4')
    assert code == 0 and data['channels']['odom/twist/vx']['max'] < 1e-3


@pytest.mark.slow
def test_one_bit_of_one_message_is_found(tmp_path, capsys):
    messages = node_messages(BAR, steps=60)
    at = max(i for i, one in enumerate(messages) if one.topic == '/joint_states')
    data = bytearray(messages[at].data)
    data[-8] ^= 1  # the last bit of an effort
    messages[at] = messages[at]._replace(data=bytes(data))
    bag = write(tmp_path / 'bag', messages)
    code, found = document(capsys, 'replay', bag)
    assert (code, found['status'], found['outside']) == (1, 'different', ['joint_states'])
    main(['replay', str(bag)])
    assert 'topic joint_states: 1 of 61 messages differ, the first at 0.06 s' in capsys.readouterr().out


@pytest.mark.slow
def test_without_the_scene_it_is_named_and_another_one_is_not_taken_for_it(tmp_path, capsys):
    bag = node_bag(tmp_path / 'bag', BAR, steps=60, told=False)
    for command in (['replay', bag], ['view', bag, '--out', tmp_path / 'x.html']):
        assert '--scene' in refused(capsys, *command) and '~/scene' in refused(capsys, *command)
    code, data = document(capsys, 'replay', bag, '--scene', BAR)
    assert (code, data['status'], data['outside']) == (0, 'identical', [])
    assert len(read_motion(bag, (), BAR).time) > 2
    assert "did you mean 'four_bar'" in refused(capsys, 'replay', bag, '--scene', 'four_bra')
    assert 'has the inputs' in refused(capsys, 'replay', bag, '--scene', 'light_car_straight')
    assert 'or slider_crank is not its scene' in refused(
        capsys, 'view', bag, '--scene', 'slider_crank', '--out', tmp_path / 'x.html'
    )
    other = write(
        tmp_path / 'other',
        [text('/simulator/scene', DAY, DAY, '# mbd_sim_ros {"a": '), *node_messages(BAR, steps=5, told=False)],
    )
    assert 'first line of its topic ~/scene is no JSON' in refused(capsys, 'replay', other)
    told = node_bag(tmp_path / 'told', BAR, steps=20)
    for command in (['replay', told], ['view', told, '--out', tmp_path / 'x.html']):
        assert 'leave it out' in refused(capsys, *command, '--scene', BAR)


@pytest.mark.slow
def test_what_is_missing_for_the_same_bits_is_said(tmp_path, capsys):
    thin = node_bag(tmp_path / 'thin', BAR, steps=60, every={'cmd_applied': 10})
    said = refused(capsys, 'replay', thin)
    assert 'every 10th step' in said and 'rate_cmd_applied' in said
    messages = node_messages(BAR, steps=60)
    commands = [one for one in messages if one.topic == '/cmd_applied']
    lost = write(tmp_path / 'lost', [one for one in messages if one not in commands[20:23]])
    said = refused(capsys, 'replay', lost)
    assert 'inputs of step 20 (3 steps are missing)' in said and 'lost on the way' in said
    none = write(tmp_path / 'none', [one for one in messages if one not in commands])
    assert 'cmd_applied' in refused(capsys, 'replay', none)
    middle = node_bag(tmp_path / 'middle', BAR, steps=60, begin=31)
    said = refused(capsys, 'replay', middle)
    assert 'begins with step 31' in said and 'paused at its start' in said
    assert read_motion(middle).time[0] >= 0.031  # it can be seen
    # the first state was lost: its inputs are those of no step
    late = node_bag(tmp_path / 'late', BAR, steps=60, begin=1)
    assert document(capsys, 'replay', late)[1]['status'] == 'identical'


@pytest.mark.slow
def test_a_node_that_began_with_a_restored_state_tells_it(tmp_path, capsys):
    def restored(simulation):
        simulation.advance(40)
        simulation.restore(simulation.save())

    bag = node_bag(tmp_path / 'bag', BAR, steps=90, drive=restored)
    code, data = document(capsys, 'replay', bag)
    assert (code, data['status'], data['first_step'], data['steps']) == (0, 'identical', 40, 50)


@pytest.mark.slow
def test_two_runs_two_scenes_or_two_cars_in_one_bag_are_told_apart_by_name(tmp_path, capsys):
    once = node_messages(BAR, steps=40)
    other = node_messages(BAR, ['integrator.h=0.002'], steps=40)

    def behind(messages: list[Message]) -> list[Message]:
        return [one._replace(log=one.log + 10**9, publish=one.publish + 10**9) for one in messages]

    bag = write(tmp_path / 'scenes', once + behind(other))
    assert '2 scenes' in refused(capsys, 'replay', bag)
    driven = list(once)
    at = max(i for i, one in enumerate(once) if one.topic == '/cmd_applied')
    data = bytearray(once[at].data)
    data[-24] ^= 1  # the last bit of the input before `step`, which two empty lists follow
    driven[at] = once[at]._replace(data=bytes(data))
    middle = node_messages(BAR, steps=40, begin=20, told=False)
    for name, messages in {'driven': [*once, *behind(driven)], 'middle': [*middle, *behind(once)]}.items():
        bag = write(tmp_path / name, messages)
        said = refused(capsys, 'replay', bag)
        assert 'goes back ' + {'driven': 'to 0.04 s', 'middle': 'from step 40 to step 0'}[name] in said
        assert 'go back from 0.04 to 0 s (a reset' in refused(capsys, 'view', bag, '--out', tmp_path / 'x.html')
    # the same once more: a reset of a run that nobody disturbed
    again = write(tmp_path / 'again', [*once, *behind(once)])
    assert document(capsys, 'replay', again)[1]['status'] == 'identical'
    bag = write(tmp_path / 'cars', once + node_messages(BAR, steps=5, namespace='b'))
    assert '2 simulators' in refused(capsys, 'replay', bag)


@pytest.mark.slow
def test_a_maneuver_takes_the_inputs_of_such_a_bag(tmp_path, capsys):
    bag = node_bag(tmp_path / 'bag', BAR, steps=50)
    found = inputs_of(content(bag))
    assert (found.first, found.last, found.h_ns, found.from_start) == (0, 50, 1_000_000, True)
    code, _ = document(
        capsys, 'run', BAR, '--set', f"maneuver={{bag: '{bag}'}}", '--duration', '0.05', '--out', tmp_path / 'run'
    )
    assert code == 0
    assert content(bag).topics['joint_states'] == content(tmp_path / 'run').topics['joint_states']


def test_stamps_of_poses_that_go_back_are_refused_and_the_last_of_an_instant_counts(tmp_path):
    messages = node_messages(BAR, ['record.poses=100'], steps=30)
    tf = [one for one in messages if one.topic == '/tf']
    longest = [one for one in tf if len(one.data) == max(len(other.data) for other in tf)]
    bag = write(tmp_path / 'twice', [*longest, longest[-1]._replace(log=DAY + 10**10)])
    assert read_poses(bag).time_ns.tolist() == [0, 10_000_000, 20_000_000, 30_000_000]
    bag = write(tmp_path / 'back', [*longest, longest[0]._replace(log=DAY + 10**10)])
    with pytest.raises(BagError, match=r'go back from 0\.03 to 0 s'):
        read_poses(bag)


@pytest.mark.realtime
def test_what_the_node_itself_publishes_is_such_a_bag(tmp_path, monkeypatch, capsys):
    """The bytes of a real node with a driver, from its pause at the start on, with the time of day as the recorder has
    it."""
    rclpy = pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    from open_node import do, until
    from processes import DOMAIN
    from rclpy.publisher import Publisher
    from rclpy.serialization import serialize_message

    from mbd_sim_ros.node.main import prepare
    from mbd_sim_ros.node.publish import message_class
    from mbd_sim_ros.node.simulator import Simulator

    sent: list[tuple[str, int, bytes]] = []
    lock, plain = threading.Lock(), Publisher.publish

    def noted(self, message) -> None:
        data = message if isinstance(message, bytes) else serialize_message(message)
        with lock:
            sent.append((self.topic_name, time.time_ns(), bytes(data)))
        plain(self, message)

    monkeypatch.setattr(Publisher, 'publish', noted)
    monkeypatch.chdir(tmp_path)
    given = ['-p', 'commands:=maneuver', '-p', 'realtime_priority:=0', '-p', 'rate_factor:=0.5', '-p', f'scene:={CAR}']
    rclpy.init(args=['--ros-args', *given], domain_id=int(DOMAIN))
    node = Simulator(prepare)
    listener = rclpy.create_node('recorder')
    try:
        node.open(*prepare(CAR, ['record.poses=50']))
        assert do(node, lambda running: running.loop.pause() or '')[0]
        types = {topic: kinds[0] for topic, kinds in node.get_publisher_names_and_types_by_node('simulator', '/')}
        ears = [
            listener.create_subscription(message_class(kind), topic, lambda _: None, 100, raw=True)
            for topic, kind in types.items()
        ]
        assert do(node, lambda running: running.reset() or '')[0]
        time.sleep(2.5)  # the paused state is published again, and the listener is seen
        latched = [one for one in sent if one[0] in ('/simulator/scene', '/robot_description')]
        with lock:
            sent.clear()
        time.sleep(1.2)
        assert do(node, lambda running: running.loop.resume() or '')[0]
        until(lambda: node.running.simulation.k > 400)
        assert do(node, lambda running: running.loop.pause() or '')[0]
        time.sleep(1.2)
        recorded = latched + sent
        assert len(ears) == len(types)
    finally:
        node.close('stopped')
        node.destroy_node()
        listener.destroy_node()
        rclpy.try_shutdown()
    messages = [Message(topic, types[topic], t, t, data) for topic, t, data in recorded if topic in types]
    bag = write(tmp_path / 'bag', messages)
    code, data = document(capsys, 'replay', bag)
    assert (code, data['status'], data['first_step']) == (0, 'identical', 0), data
    assert data['steps'] >= 400 and data['told'] == []
    assert {'joint_states', 'odom', 'imu', 'tire_states', 'cmd_applied'} <= content(bag).topics.keys()
    if '/tf' in types:  # needs tf2_msgs
        motion = read_motion(bag)
        assert motion.time[0] == 0.0 and np.all(np.diff(motion.time) > 0.0)
