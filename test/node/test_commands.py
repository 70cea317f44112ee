"""Commands of a real car: torques of single wheels, road wheels, hand torque, by name and stamped; through real topics,
in lockstep."""

from __future__ import annotations

import pytest
from client import client
from real_node import simulator

from mbd_sim_ros.bags import reader as bag
from solver.files.scene import load_scene
from solver.levels.road_wheel import steering_map, steering_wheel_at

pytestmark = pytest.mark.realtime

__all__ = ['client', 'simulator']  # fixtures

SCENE = 'light_car_straight'


def named(client, topic: str):
    """A function that publishes commands by name, stamped with the newest state."""
    from sensor_msgs.msg import JointState

    publisher = client.node.create_publisher(JointState, f'simulator/{topic}', 10)
    client.until(publisher.get_subscription_count, 60.0)

    def send(t_ns: int = 0, **values: float) -> None:
        message = JointState(name=list(values), position=[float(v) for v in values.values()])
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(t_ns, 1_000_000_000)
        publisher.publish(message)

    return send


@pytest.mark.slow
def test_wheels_and_road_wheels_are_commanded_by_name(client, simulator, tmp_path):
    actuation = [
        'actuation.wheels=true',
        'actuation.steering=road_wheel',
        'actuation.actuators.brake_torque_front_left={dead_time: 0.002}',
    ]
    process = simulator(
        scene=SCENE, mode='lockstep', record=True, out='run', overrides=actuation, max_brake_torque=600.0
    )
    answer, wheel = named(client, 'lockstep_cmd'), named(client, 'wheel_cmd')
    client.until(lambda: client.applied)
    answer(0, brake_torque_front_left=500.0, drive_torque_rear_right=120.0)
    client.until(lambda: client.applied[-1]['step'] == 1)
    assert client.applied[-1]['drive_torque_rear_right'] == 120.0
    assert client.applied[-1]['brake_torque_front_left'] == 0.0  # its actuator waits for two steps
    wheel(brake_torque_rear_left=-900.0)  # beyond its limit
    wheel(steering=0.1)  # not what steers here
    values: dict[str, str] = {}

    def refused() -> bool:
        values.update({v.key: v.value for a in client.diagnostics for v in a.status[0].values})
        return values.get('commands refused') == '1'

    client.until(refused)
    step = 1
    for step in range(1, 400):
        answer(step * 1_000_000, road_wheel=0.05)
        client.until(lambda: client.applied[-1]['step'] == step + 1)  # noqa: B023
    last = client.applied[-1]
    assert (last['brake_torque_front_left'], last['brake_torque_rear_left']) == (500.0, -600.0)
    mapped = steering_wheel_at(steering_map(load_scene(SCENE).model), 0.05)
    # the filter of the hands is 63 of its time constants on
    assert last['steering'] == pytest.approx(mapped, abs=1e-3 * mapped)
    process.process.terminate()
    assert process.end() == 0, process.output
    assert "wheel_cmd: 'steering' is no command" in process.output
    assert bag.read(tmp_path / 'run')['cmd_applied/drive_torque_rear_right'][-1] == 120.0


@pytest.mark.slow
def test_a_free_steering_wheel_is_turned_by_a_torque(client, simulator, tmp_path):
    from std_msgs.msg import Float64

    overrides = ['actuation.steering=torque']
    process = simulator(scene=SCENE, duration=0.0, overrides=overrides, record=True, out='run', max_steering_torque=5.0)
    publisher = client.node.create_publisher(Float64, 'simulator/steering_torque_cmd', 1)

    def turned_for_half_a_second() -> bool:
        publisher.publish(Float64(data=9.0))
        steps = [one['step'] for one in client.applied if one['steering_torque'] == 5.0]
        return len(steps) > 1 and steps[-1] - steps[0] > 500.0

    client.until(turned_for_half_a_second, 60.0)
    process.process.terminate()
    assert process.end() == 0, process.output
    run = bag.read(tmp_path / 'run')
    torque, wheel = run['cmd_applied/steering_torque'], run['joint_states/steering_wheel/position']
    assert set(torque) == {0.0, 5.0}
    assert 0.05 < wheel[-1] < 3.0 and abs(wheel[torque == 0.0]).max() < 1e-6
    assert '9 is beyond the limit; 5 is applied (parameter max_steering_torque)' in process.output
