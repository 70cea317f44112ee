"""What in the ROS graph does not match a node is told by name, once and while it holds; who publishes best effort, or
another type that is taken, is heard. All goes over the real middleware, between two participants."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from client import client
from open_node import opened, sent
from processes import DOMAIN

pytestmark = pytest.mark.realtime

__all__ = ['client', 'opened', 'sent']  # fixtures


def best_effort() -> Any:
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    return QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)


def message(name: str) -> Any:
    """The class of a message, e.g. 'std_msgs/Float64'."""
    from mbd_sim_ros.node.publish import message_class

    return message_class(name.replace('/', '/msg/'))


class Watched:
    """A node whose diagnostics are made whenever `status` is called, and what it has said."""

    def __init__(self, node, sent, capfd) -> None:
        self.node, self._sent, self._capfd, self.log = node, sent, capfd, ''

    def status(self) -> str:
        """The message of the diagnostics as they are now."""
        self.node._diagnose()
        self.log += self._capfd.readouterr().err
        return next(one.status[0].message for topic, one in reversed(self._sent) if topic == '/diagnostics')

    def until(self, condition: Callable[[str], bool]) -> str:
        """Look again and again until the diagnostics are so; an endpoint that was made just now has not been discovered
        yet."""
        end = time.monotonic() + 10.0
        while not condition(status := self.status()):
            assert time.monotonic() < end, status
            time.sleep(0.05)
        return status

    def tells(self, sentence: str) -> None:
        """A sentence is told, in the log once."""
        self.until(lambda status: sentence in status)
        self.status()
        assert self.log.count(sentence) == 1

    def quiet(self, about: str) -> None:
        """Nothing is told of a topic, also once everybody is known."""
        for _ in range(20):
            assert about not in self.status()
            time.sleep(0.05)


@pytest.fixture
def watched(opened, sent, capfd) -> Callable[..., Watched]:
    return lambda **parameters: Watched(opened(**parameters), sent, capfd)


def test_a_second_clock_is_told_with_the_node_that_has_it_and_no_more_when_it_is_gone(watched, client) -> None:
    sentence = (
        '/client publishes /clock too: time jumps back and forth for everybody with use_sim_time; set '
        'publish_clock to false'
    )
    one = watched()
    one.quiet('/clock')
    for times in (1, 2):
        publisher = client.node.create_publisher(message('rosgraph_msgs/Clock'), '/clock', best_effort())
        one.until(lambda status: sentence in status)
        one.status()
        assert one.log.count(sentence) == times
        client.node.destroy_publisher(publisher)
        one.until(lambda status: '/clock' not in status)
    client.node.create_publisher(message('rosgraph_msgs/Clock'), '/clock', 10)
    watched(publish_clock=False).quiet('/clock')  # whoever publishes it then


def test_who_publishes_states_too_is_told_once_for_all_of_them_but_not_where_several_may(watched, client) -> None:
    for topic, kind in (
        ('odom', 'nav_msgs/Odometry'),
        ('imu', 'sensor_msgs/Imu'),
        ('joint_states', 'sensor_msgs/JointState'),
    ):
        client.node.create_publisher(message(kind), topic, 10)
    one = watched()
    one.tells('/client publishes /imu, /odom too: who listens hears both, mixed; give one of the two a namespace')
    one.quiet('joint_states')


TYPES = {  # topic, what somebody else publishes there, what is taken
    'single precision': ('simulator/torque_cmd', 'std_msgs/Float32', 'std_msgs/Float64'),
    'whole number': ('simulator/brake_cmd', 'std_msgs/Int32', 'std_msgs/Float64'),
    'stamped': ('simulator/steering_cmd', 'geometry_msgs/PointStamped', 'std_msgs/Float64'),
    'array': ('simulator/lockstep_cmd', 'std_msgs/Float64MultiArray', 'sensor_msgs/JointState'),
    'without covariance': ('initialpose', 'geometry_msgs/PoseStamped', 'geometry_msgs/PoseWithCovarianceStamped'),
}


@pytest.mark.parametrize('case', TYPES)
def test_commands_of_another_type_are_told_with_both(case: str, watched, client) -> None:
    topic, found, expected = (text.replace('/', '/msg/') if '_msgs' in text else f'/{text}' for text in TYPES[case])
    for publisher in client.commands:  # of the right type, and a participant has one for a topic
        client.node.destroy_publisher(publisher)
    client.node.create_publisher(message(TYPES[case][1]), topic, 1)
    watched().tells(
        f'{topic}: /client publishes {found}, this node subscribes to {expected}: no message passes; publish {expected}'
    )


def test_who_subscribes_to_another_type_or_publishes_one_is_told(watched, client) -> None:
    client.node.create_subscription(message('geometry_msgs/PoseStamped'), 'tire_states', lambda m: None, 1)
    client.node.create_publisher(message('geometry_msgs/Twist'), 'imu', 1)
    one = watched()
    one.tells(
        '/tire_states: /client subscribes to geometry_msgs/msg/PoseStamped, this node publishes '
        'sensor_msgs/msg/JointState: no message passes; subscribe to sensor_msgs/msg/JointState'
    )
    one.tells(
        '/imu: /client publishes geometry_msgs/msg/Twist, and this node sensor_msgs/msg/Imu; rename one of the two'
    )


def qualities() -> dict[str, tuple[str, str, Any, str]]:
    """Topic, type, quality of a subscription, what is told of it."""
    from rclpy.duration import Duration
    from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    often = QoSProfile(depth=1, deadline=Duration(seconds=0.1))
    alive = QoSProfile(
        depth=1, liveliness=LivelinessPolicy.MANUAL_BY_TOPIC, liveliness_lease_duration=Duration(seconds=1.0)
    )
    nav = 'nav_msgs/Odometry'
    return {
        'latched': (
            'odom',
            nav,
            latched,
            'volatile publisher and transient local subscription; subscribe reliable, volatile',
        ),
        'deadline': ('odom', nav, often, 'subscription has a deadline, but publisher does not; subscribe'),
        'liveliness': ('odom', nav, alive, 'subscription has a liveliness lease duration, but publisher does not'),
        'reliable clock': (
            'clock',
            'rosgraph_msgs/Clock',
            10,
            'best effort publisher and reliable subscription; subscribe best effort',
        ),
    }


@pytest.mark.parametrize('case', ['latched', 'deadline', 'liveliness', 'reliable clock'])
def test_who_asks_for_more_than_a_topic_offers_is_told_in_what(case: str, watched, client) -> None:
    topic, kind, quality, reason = qualities()[case]
    client.node.create_subscription(message(kind), f'/{topic}', lambda m: None, quality)
    one = watched()
    one.tells(f'/{topic}: no message passes where /client subscribes: {reason}')
    assert 'incompatible QoS' not in one.log  # which rclpy would say, of nobody


def test_who_asks_for_less_is_not_told(watched, client) -> None:
    """Beside the subscriptions of the client, reliable and latched ones among them."""
    client.node.create_subscription(message('sensor_msgs/Imu'), 'imu', lambda m: None, best_effort())
    client.node.create_subscription(message('std_msgs/String'), 'robot_description', lambda m: None, 1)
    client.ready = lambda: None
    one = watched()
    for about in ('no message passes', 'too:', 'rename'):
        one.quiet(about)


def test_best_effort_commands_are_heard_and_every_message_once(watched, client) -> None:
    """Beside a reliable publisher, which is heard by the same subscription: depth 1 keeps the newest, so each is waited
    for."""
    plain, stamped = message('std_msgs/Float64'), message('sensor_msgs/JointState')
    one = watched()
    joystick = client.node.create_publisher(plain, 'simulator/steering_cmd', best_effort())
    wheel = client.node.create_publisher(plain, 'simulator/steering_cmd', 1)
    answers = client.node.create_publisher(stamped, 'simulator/lockstep_cmd', best_effort())
    one.until(lambda _: joystick.get_subscription_count() == 1 and answers.get_subscription_count() == 1)
    assert (
        one.log.count(
            '/simulator/steering_cmd: std_msgs/msg/Float64, best effort, as it is published, and what is lost'
        )
        == 1
    )
    one.until(lambda _: wheel.get_subscription_count() == 1)  # the one that came before is gone
    loop = one.node.loop
    for heard, (publisher, value) in enumerate(((joystick, 0.25), (wheel, 0.5), (joystick, 0.125), (wheel, -0.5)), 1):
        publisher.publish(plain(data=value))
        one.until(lambda _: loop.latch.newest.values[0] == value)  # noqa: B023
        assert loop.latch.newest.counts[0] == heard
    answers.publish(stamped(name=['brake_torque'], position=[70.0]))
    one.until(lambda _: loop.latch.newest.values[2] == 70.0)
    for publisher in (joystick, answers):
        client.node.destroy_publisher(publisher)
    one.until(
        lambda _: one.log.count('/simulator/steering_cmd: std_msgs/msg/Float64, reliable, as it is published') == 1
    )
    assert 'hear' not in one.status()


def test_who_published_best_effort_before_another_scene_was_loaded_is_heard_behind_it(watched, client) -> None:
    plain = message('std_msgs/Float64')
    joystick = client.node.create_publisher(plain, 'simulator/torque_cmd', best_effort())
    one = watched()
    one.until(lambda _: joystick.get_subscription_count() == 1)
    assert one.node.load('another', [])
    end = time.monotonic() + 10.0
    # nobody looks at the graph meanwhile
    while one.node.loop.latch.newest.values[1] != 40.0 and time.monotonic() < end:
        joystick.publish(plain(data=40.0))
        time.sleep(0.01)
        one.node.loop.ask(one.node.running.commands.poll).result(5.0)
    assert one.node.loop.latch.newest.values[1] == 40.0


def test_a_best_effort_pose_places_the_car(watched, client) -> None:
    from rclpy.executors import SingleThreadedExecutor

    publisher = client.node.create_publisher(
        message('geometry_msgs/PoseWithCovarianceStamped'), 'initialpose', best_effort()
    )
    one = watched()
    one.until(lambda _: publisher.get_subscription_count() > 0)
    pose = message('geometry_msgs/PoseWithCovarianceStamped')()
    pose.pose.pose.position.x, pose.pose.pose.orientation.w = 3.0, 1.0
    publisher.publish(pose)
    executor = SingleThreadedExecutor()
    executor.add_node(one.node)
    end = time.monotonic() + 10.0
    while not hasattr(one.node.running.simulation, 'placed') and time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
    assert one.node.running.simulation.placed == (3.0, 0.0, 0.0)
    executor.shutdown()


def test_a_look_at_a_graph_that_stays_asks_for_one_topic(watched, client, monkeypatch) -> None:
    """Who publishes and who subscribes there; of all others only how many."""
    from rclpy.node import Node

    one = watched()
    one.until(
        lambda _: len(one.node._graph._seen) > 10 and not any(seen.again for seen in one.node._graph._seen.values())
    )
    one.quiet('nothing')
    asked: list[str] = []
    for name in ('get_publishers_info_by_topic', 'get_subscriptions_info_by_topic'):
        plain = getattr(Node, name)
        monkeypatch.setattr(Node, name, lambda self, topic, plain=plain: (asked.append(topic), plain(self, topic))[1])
    looks = len(one.node._graph._seen)
    for _ in range(looks):
        one.node._graph.look(one.node, one.node.running.commands.node)
    assert len(asked) <= 2 * looks
    assert set(asked) == set(one.node._graph._seen)  # each had its turn


@pytest.fixture
def adapter(monkeypatch):
    """An adapter that looks at the graph at every turn, and a function that gives it turns until a condition holds."""
    rclpy = pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    from mbd_sim_ros.node import graph
    from mbd_sim_ros.node.adapter import PARAMETERS
    from mbd_sim_ros.node.adapter_node import Adapter

    monkeypatch.setattr(graph, 'SECONDS', 0.0)
    arguments = ['--ros-args', '-p', 'scene:=light_car_straight', '-p', 'steering_ratio:=16.0']
    rclpy.init(args=arguments, domain_id=int(DOMAIN), signal_handler_options=SignalHandlerOptions.NO)
    node, executor = Adapter(PARAMETERS), SingleThreadedExecutor()
    executor.add_node(node)

    def until(condition: Callable[[], bool]) -> None:
        end = time.monotonic() + 10.0
        while not condition():
            assert time.monotonic() < end
            node.look(executor)

    yield SimpleNamespace(node=node, until=until)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()


def test_cmd_vel_is_taken_in_the_type_that_is_published(adapter, client, capfd) -> None:
    """As long as one of both is published it is that one, whoever came first; the other one is told."""
    plain, stamped = message('geometry_msgs/Twist'), message('geometry_msgs/TwistStamped')

    def drive(publisher, kind, speed: float) -> None:
        def there() -> bool:
            twist = kind()
            (twist.twist if kind is stamped else twist).linear.x = speed
            publisher.publish(twist)
            return adapter.node._demand is not None and adapter.node._demand.speed == speed

        adapter.until(there)

    control = client.node.create_publisher(stamped, 'cmd_vel', 1)
    drive(control, stamped, 3.0)
    assert '/cmd_vel: geometry_msgs/msg/TwistStamped, reliable, as it is published' in capfd.readouterr().err
    joystick = client.node.create_publisher(plain, 'cmd_vel_joystick', 1)  # a participant has one type for a topic
    client.node.destroy_publisher(control)
    client.node.destroy_publisher(joystick)
    joystick = client.node.create_publisher(plain, 'cmd_vel', best_effort())
    drive(joystick, plain, 4.0)
    assert (
        '/cmd_vel: geometry_msgs/msg/Twist, best effort, as it is published, and what is lost' in capfd.readouterr().err
    )
    import rclpy

    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(DOMAIN))
    other = rclpy.create_node('other', context=context)
    try:
        other.create_publisher(stamped, 'cmd_vel', 1)
        said = ''

        def told() -> bool:
            nonlocal said
            said += capfd.readouterr().err
            return (
                '/cmd_vel: /other publishes geometry_msgs/msg/TwistStamped, this node subscribes to '
                'geometry_msgs/msg/Twist: no message passes; publish geometry_msgs/msg/Twist'
            ) in said

        adapter.until(told)
        drive(joystick, plain, 5.0)
        client.node.destroy_publisher(joystick)
        control = other.create_publisher(stamped, 'cmd_vel', 1)
        drive(control, stamped, 6.0)
    finally:
        other.destroy_node()
        rclpy.shutdown(context=context)
