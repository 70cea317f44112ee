"""The executable `adapter` between a simulator and what others publish: standard messages, and stand-ins of other
packages."""

from __future__ import annotations

import math
import sys

import pytest
from client import client
from foreign import packages
from processes import Process, start

pytestmark = pytest.mark.realtime

__all__ = ['client', 'start']  # fixtures

RATIO = 16.0


@pytest.fixture
def adapt(tmp_path):
    """Start an adapter that answers every state: adapt(path of further packages)."""
    started = []

    def adapt(path: str = '') -> Process:
        values = {'rate': 0.0, 'scene': 'light_car_straight', 'steering_ratio': RATIO}
        arguments = [text for name, value in values.items() for text in ('-p', f'{name}:={value}')]
        started.append(
            Process(tmp_path, [sys.executable, '-m', 'mbd_sim_ros.node.adapter', '--ros-args', *arguments], path=path)
        )
        return started[-1]

    yield adapt
    for process in started:
        process.kill()


def until_steering(client, publisher, message, wanted: float) -> None:
    """Publish until the filter behind the steering command has arrived."""

    def there() -> bool:
        publisher.publish(message)
        return bool(client.applied) and client.applied[-1]['steering'] == pytest.approx(wanted, abs=1e-3)

    client.until(there)


def test_cmd_vel_drives_in_lockstep_and_silence_brakes(start, client, adapt):
    from geometry_msgs.msg import Twist

    start({'mode': 'lockstep'})
    adapter = adapt()
    publisher = client.node.create_publisher(Twist, 'cmd_vel', 1)
    client.until(publisher.get_subscription_count)
    wanted = Twist()
    wanted.linear.x, wanted.angular.z = 8.0, 0.4
    until_steering(client, publisher, wanted, RATIO * math.atan2(2.65 * 0.4, 8.0))
    step = client.applied[-1]['step']
    client.until(lambda: client.applied[-1]['step'] > step + 300)  # 0.6 s later
    assert client.applied[-1]['brake_torque'] == 6000.0
    assert client.applied[-1]['drive_torque'] == -300.0  # the engine brakes too
    assert 'ackermann_msgs is not installed: its topics are left out' in adapter.output
    assert f'steering by the ratio {RATIO:g}' in adapter.output


def test_autoware_and_ackermann_commands_drive_and_reports_tell(start, client, adapt):
    where = packages()
    sys.path.insert(0, str(where))
    from ackermann_msgs.msg import AckermannDrive, AckermannDriveStamped
    from autoware_control_msgs.msg import Control
    from autoware_vehicle_msgs.msg import ControlModeReport, GearCommand, GearReport, SteeringReport, VelocityReport
    from rclpy.qos import DurabilityPolicy, QoSProfile

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    gear = client.node.create_publisher(GearCommand, '/control/command/gear_cmd', latched)
    gear.publish(GearCommand(command=GearCommand.PARK))  # before anybody listens
    reports: dict[str, list] = {}
    kinds = {'velocity_status': VelocityReport, 'steering_status': SteeringReport, 'gear_status': GearReport}
    for name, kind in (kinds | {'control_mode': ControlModeReport}).items():
        reports[name] = []
        client.node.create_subscription(kind, f'/vehicle/status/{name}', reports[name].append, 1)
    start({'mode': 'lockstep'})
    adapter = adapt(str(where))
    control = client.node.create_publisher(Control, '/control/command/control_cmd', 1)  # volatile, as some are
    client.until(lambda: all(reports.values()), 30.0)
    # it is heard some time after the adapter began
    client.until(lambda: reports['gear_status'][-1].report == GearReport.PARK)
    client.until(lambda: client.applied[-1]['brake_torque'] == 6000.0)
    gear.publish(GearCommand(command=GearCommand.DRIVE))
    client.until(lambda: reports['gear_status'][-1].report == GearReport.DRIVE)
    message = Control()
    message.lateral.steering_tire_angle, message.longitudinal.velocity = 0.1, 6.0
    until_steering(client, control, message, 0.1 * RATIO)
    assert reports['control_mode'][-1].mode == ControlModeReport.AUTONOMOUS
    turned = [report.steering_tire_angle for report in reports['steering_status']]
    # what it does, behind the filter of the hands, and not what it was told
    assert any(0.01 < angle < 0.09 for angle in turned)
    client.until(lambda: reports['steering_status'][-1].steering_tire_angle == pytest.approx(0.1, abs=1e-4))
    assert reports['velocity_status'][-1].header.frame_id == 'base_link'
    odom = client.odom[-1]
    assert reports['velocity_status'][-1].longitudinal_velocity == pytest.approx(odom.twist.twist.linear.x, rel=0.2)
    drive = AckermannDriveStamped()
    drive.drive.speed, drive.drive.steering_angle = 3.0, -0.05
    stamped = client.node.create_publisher(AckermannDriveStamped, 'ackermann_cmd_stamped', 1)
    until_steering(client, stamped, drive, -0.05 * RATIO)
    plain = client.node.create_publisher(AckermannDrive, 'ackermann_cmd', 1)
    until_steering(client, plain, AckermannDrive(speed=1.0, steering_angle=0.2), 0.2 * RATIO)
    message.lateral.steering_tire_angle = float('nan')
    control.publish(message)
    client.until(lambda: '/control/command/control_cmd: not a number; the command before it stays' in adapter.output)
    assert 'is not installed' not in adapter.output
