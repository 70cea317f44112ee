"""The node `adapter` by itself: what it answers to states that come twice or anew, whose car it drives, what parameters
it takes."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from processes import DOMAIN

pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')

CAR = {'scene': 'light_car_straight', 'steering_ratio': 16.0}


@pytest.fixture
def adapter():
    """Make an adapter whose simulator listens: adapter(**parameters); what it sends is in `sent`."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from mbd_sim_ros.node.adapter import PARAMETERS
    from mbd_sim_ros.node.adapter_node import Adapter

    made: list[Any] = []

    def make(**parameters):
        arguments = [text for name, value in parameters.items() for text in ('-p', f'{name}:={value}')]
        rclpy.init(
            args=['--ros-args', *arguments], domain_id=int(DOMAIN), signal_handler_options=SignalHandlerOptions.NO
        )
        node: Any = Adapter(PARAMETERS)
        made.append(node)
        node.sent = []
        node._commands = SimpleNamespace(publish=node.sent.append, get_subscription_count=lambda: 1)
        return node

    yield make
    for node in made:
        node.destroy_node()
    rclpy.shutdown()


def look(node) -> bool:
    """Whether the simulator is found, of what has come."""
    return node.look(SimpleNamespace(spin_once=lambda timeout_sec: None))


def odom(node, t: float, speed: float = 0.0) -> None:
    """A state comes."""
    from nav_msgs.msg import Odometry

    message = Odometry()
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(round(t * 1e9), 1_000_000_000)
    message.twist.twist.linear.x = speed
    node._answer(message)


def wanted(node, speed: float) -> None:
    """A demand comes on cmd_vel."""
    from geometry_msgs.msg import Twist

    from mbd_sim_ros.node.demand_messages import HEARD

    message = Twist()
    message.linear.x = speed
    node._hearing(next(row for row in HEARD if row.topic == 'cmd_vel'))(message)


def torques(node) -> list[float]:
    """Drive and brake torque of the newest command."""
    return [node.sent[-1].position[node.sent[-1].name.index(name)] for name in ('drive_torque', 'brake_torque')]


def test_a_state_that_comes_again_is_answered_again_by_the_same_command_once_nothing_newer_came(adapter, monkeypatch):
    node = adapter(**CAR)
    look(node)
    wanted(node, 5.0)
    odom(node, 0.0)
    odom(node, 0.01)
    kept = node._loop._kept
    odom(node, 0.01)
    look(node)
    assert len(node.sent) == 2  # the first answer may be under way
    monkeypatch.setattr('mbd_sim_ros.node.adapter_node.LOST', 0.0)
    look(node)
    assert node.sent[2] is node.sent[1] and node._loop._kept == kept
    look(node)
    assert len(node.sent) == 3


def test_a_demand_of_before_a_reset_counts_no_more_but_one_since_the_last_state_does(adapter):
    node = adapter(**CAR)
    look(node)
    wanted(node, 40.0)
    odom(node, 0.0)
    assert torques(node) == [2000.0, 0.0]
    odom(node, 8.0)
    assert torques(node)[1] == 6000.0
    odom(node, 0.0)
    assert torques(node) == [0.0, 6000.0]
    odom(node, 1.0)
    wanted(node, 40.0)
    odom(node, 0.0)
    assert torques(node) == [2000.0, 0.0]


def test_a_speed_below_zero_goes_backwards_until_a_gear_is_commanded(adapter):
    node = adapter(**CAR)
    look(node)
    wanted(node, -5.0)
    odom(node, 0.0)
    assert torques(node) == [-2000.0, 0.0]
    node._gear = 'drive'
    wanted(node, -5.0)
    odom(node, 0.01)
    assert torques(node) == [0.0, 6000.0]


def test_a_simulator_without_odom_is_not_found(adapter):
    node = adapter(**CAR)
    assert not look(node)
    assert node.missing() == 'is there but sends no odom (is it in another namespace?)'
    odom(node, 0.0)
    assert look(node)


def runs(node, scene: str, *overrides: str) -> None:
    """Have the simulator tell that it runs a scene from now on."""
    from std_msgs.msg import String

    from solver.files.scene import load_scene

    node._tell(String(data=load_scene(scene, overrides).resolved))


def test_the_car_is_that_of_the_scene_that_the_simulator_tells(adapter):
    node = adapter(steering_ratio=16.0)
    assert not look(node) and node.missing() == 'does not say what it simulates'
    runs(node, 'light_car_straight', 'vehicle.chassis.mass=2000')
    look(node)
    assert node._driven.name == 'light_car_straight' and node._gearbox is None
    assert node._driven.model.bodies[0].mass == 2000.0


def test_another_scene_that_is_loaded_changes_the_car_and_nothing_is_answered_until_it_is_known(adapter):
    node = adapter(steering_ratio=16.0)
    runs(node, 'light_car_straight')
    look(node)
    wanted(node, 40.0)
    odom(node, 0.0)
    inertia = node._loop.car.inertia
    runs(node, 'light_car_straight', 'vehicle.chassis.mass=2000')
    odom(node, 0.0)
    assert len(node.sent) == 1
    assert look(node)
    odom(node, 0.0)
    assert node._loop.car.inertia > 1.2 * inertia
    assert torques(node) == [0.0, 6000.0]  # the demand was of the run before
    driven = node._loop
    runs(node, 'light_car_straight', 'vehicle.chassis.mass=2000')
    look(node)
    assert node._loop is driven  # the same scene again


def test_a_car_that_is_commanded_by_its_road_wheels_gets_their_angle(adapter):
    """It has no command `steering`, and a message that names one is refused whole."""
    from nav_msgs.msg import Odometry

    from mbd_sim_ros.node.speed_control import Demand
    from solver.inputs.command_filter import commands_of

    node = adapter(steering_ratio=16.0)
    runs(node, 'light_car_straight', 'actuation.steering=road_wheel')
    look(node)
    node._demand = Demand(speed=5.0, steering=0.1)
    node._answer(Odometry())
    assert set(node.sent[-1].name) <= set(commands_of(node._driven.model.inputs, 'road_wheel'))
    assert node.sent[-1].position[node.sent[-1].name.index('road_wheel')] == pytest.approx(0.1)


def test_a_car_whose_wheel_is_turned_by_a_torque_ends_in_one_sentence(adapter):
    from solver.errors import SpecError

    node = adapter(steering_ratio=16.0)
    runs(node, 'light_car_straight', 'actuation.steering=torque')
    with pytest.raises(
        SpecError, match=r'is steered by a torque \(actuation.steering = torque\), and an adapter commands angles'
    ):
        look(node)


def test_a_scene_that_cannot_be_read_here_ends_in_one_sentence(adapter):
    from std_msgs.msg import String

    from solver.errors import SceneError

    node = adapter(steering_ratio=16.0)
    node._tell(String(data='{mechanism: {bodies: {b: {mass: 1, inertia: [1, 1, 1]}}}, from_another_version: 1}'))
    with pytest.raises(SceneError) as error:
        look(node)
    assert str(error.value).startswith('simulator/scene:1: from_another_version: unknown key')


@pytest.mark.parametrize(
    ('name', 'value', 'range_'),
    [
        ('max_road_wheel', -0.1, 'at least 0 and below 1.5708'),
        ('max_road_wheel', math.nan, 'at least 0 and below 1.5708'),
        ('steering_ratio', -16.0, 'at least 0 and finite'),
        ('command_timeout', -1.0, 'at least 0 and finite'),
        ('max_engine_braking', -5.0, 'at least 0 and finite'),
        ('bandwidth', 0.0, 'above 0 and finite'),
    ],
)
def test_a_parameter_out_of_its_range_ends_in_one_sentence(name, value, range_, adapter):
    from solver.errors import SpecError

    with pytest.raises(SpecError) as error:
        adapter(**{name: '.nan' if math.isnan(value) else value})
    assert str(error.value) == f'parameter {name} = {value:g}: must be {range_}'
