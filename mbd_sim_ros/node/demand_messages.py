"""Messages of others -> Demand, and reports -> messages: one row for every interface, each with the package that has to
be there.

Names, fields and qualities of service as their users have them: ackermann_msgs; the vehicle interface of Autoware
(control_cmd and gear_cmd reliable and transient local, depth 1, and heard from volatile publishers too; status reports
reliable and volatile, depth 1, frame base_link; so do CARLA and AWSIM); cmd_vel as the Ackermann plugins of Gazebo read
it: speed and yaw rate.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

from mbd_sim_ros.node.speed_control import DRIVE, NEUTRAL, PARK, REVERSE, Demand

# of autoware_vehicle_msgs
GEAR_NEUTRAL, GEAR_DRIVE, GEAR_DRIVE_LAST, GEAR_REVERSE, GEAR_REVERSE_LAST, GEAR_PARK = 1, 2, 19, 20, 21, 22
GEAR_LOW = (23, 24)
AUTONOMOUS = 1  # of ControlModeReport


class Measured(NamedTuple):
    """Measurements in status reports. forward, left: velocity in base_link [m/s]; yaw_rate [rad/s]; road_wheel [rad];
    gear of Autoware."""

    stamp: Any  # builtin_interfaces/Time
    forward: float
    left: float
    yaw_rate: float
    road_wheel: float
    gear: int


class Heard(NamedTuple):
    """A topic of commands and a type of its messages. latched: transient local. demand: makes a Demand of a message, or
    a number of a gear.

    A topic has one type at a time: the first that is installed, unless only another one of its types is published.
    """

    topic: str
    type: str
    text: str
    demand: Callable[[Any], Demand | int]
    latched: bool = False


class Told(NamedTuple):
    """A topic of reports. fill: sets the fields of a message."""

    topic: str
    type: str
    text: str
    fill: Callable[[Any, Measured], None]


def ackermann(message: Any) -> Demand:
    """AckermannDrive; there a rate or acceleration of zero means as fast as possible."""
    return Demand(
        speed=message.speed,
        steering=message.steering_angle,
        steering_rate=message.steering_angle_velocity or None,
        ramp=message.acceleration or None,
    )


def twist(message: Any) -> Demand:
    """Twist: speed and yaw rate."""
    return Demand(speed=message.linear.x, steering=None, yaw_rate=message.angular.z)


def control(message: Any) -> Demand:
    """Autoware's Control: the acceleration leads the torque where it is defined."""
    lateral, longitudinal = message.lateral, message.longitudinal
    return Demand(
        speed=longitudinal.velocity,
        steering=lateral.steering_tire_angle,
        steering_rate=lateral.steering_tire_rotation_rate if lateral.is_defined_steering_tire_rotation_rate else None,
        acceleration=longitudinal.acceleration if longitudinal.is_defined_acceleration else None,
    )


def gear(command: int) -> str:
    """Gear of the control loop for one of Autoware; an unknown one counts as neutral."""
    if GEAR_DRIVE <= command <= GEAR_DRIVE_LAST or command in GEAR_LOW:
        return DRIVE
    return {GEAR_REVERSE: REVERSE, GEAR_REVERSE_LAST: REVERSE, GEAR_PARK: PARK}.get(command, NEUTRAL)


def _velocity(message: Any, now: Measured) -> None:
    message.header.stamp, message.header.frame_id = now.stamp, 'base_link'
    message.longitudinal_velocity, message.lateral_velocity, message.heading_rate = now.forward, now.left, now.yaw_rate


def _steering(message: Any, now: Measured) -> None:
    message.stamp, message.steering_tire_angle = now.stamp, now.road_wheel


def _gear(message: Any, now: Measured) -> None:
    message.stamp, message.report = now.stamp, now.gear


def _mode(message: Any, now: Measured) -> None:
    message.stamp, message.mode = now.stamp, AUTONOMOUS


HEARD = (
    Heard('ackermann_cmd', 'ackermann_msgs/msg/AckermannDrive', 'road wheels, speed, acceleration', ackermann),
    Heard('ackermann_cmd', 'ackermann_msgs/msg/AckermannDriveStamped', 'the same with a '
        'header', lambda m: ackermann(m.drive)),
    Heard('ackermann_cmd_stamped', 'ackermann_msgs/msg/AckermannDriveStamped', 'the same with a '
        'header', lambda m: ackermann(m.drive)),
    Heard('ackermann_cmd_stamped', 'ackermann_msgs/msg/AckermannDrive', 'road wheels, speed, acceleration', ackermann),
    Heard('cmd_vel', 'geometry_msgs/msg/Twist', 'speed and yaw rate', twist),
    Heard('cmd_vel', 'geometry_msgs/msg/TwistStamped', 'the same with a header, as ros2_control has '
        'it', lambda m: twist(m.twist)),
    Heard('/control/command/control_cmd', 'autoware_control_msgs/msg/Control', 'road wheels, speed, '
        'acceleration', control, latched=True),
    Heard(
        '/control/command/gear_cmd', 'autoware_vehicle_msgs/msg/GearCommand', 'drive, reverse, neutral, '
            'park', lambda m: m.command,
        latched=True,
    ),
)  # fmt: skip
TOLD = (
    Told(
        '/vehicle/status/velocity_status',
        'autoware_vehicle_msgs/msg/VelocityReport',
        'velocity and yaw rate in base_link',
        _velocity,
    ),
    Told(
        '/vehicle/status/steering_status',
        'autoware_vehicle_msgs/msg/SteeringReport',
        'road wheels, by the steering wheel',
        _steering,
    ),
    Told(
        '/vehicle/status/gear_status',
        'autoware_vehicle_msgs/msg/GearReport',
        'the gear as commanded, or as it goes',
        _gear,
    ),
    Told('/vehicle/status/control_mode', 'autoware_vehicle_msgs/msg/ControlModeReport', 'always autonomous', _mode),
)


def class_of(kind: str) -> Any:
    """The class of e.g. 'geometry_msgs/msg/Twist', or None where its package is not installed."""
    package, name = kind.split('/msg/')
    try:
        return getattr(import_module(f'{package}.msg'), name)
    except ImportError:
        return None
