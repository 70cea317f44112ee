"""A lane keeper that is designed on a linear model (python-control, extra `control`) drives the full car in lockstep.

    python docs/examples/lqr_lane_keeping.py

or over topics, with the simulator beside it:

    simulator --ros-args -p scene:=car_step_steer -p mode:=lockstep -p "overrides:=['maneuver={}', 'start.speed=25']"
    python docs/examples/lqr_lane_keeping.py --node

1. Lateral velocity and yaw rate at 25 m/s are fitted by two states: the whole car is steered by a small sweep to the
   one side and to the other, and half of the difference is its linear answer. (solver.linear_model() is of an instant
   where wheels roll, since its coordinates turn with them; it serves about equilibria: docs/control.md.)
2. control.lqr() finds the gains of offset, heading, lateral velocity and yaw rate.
3. The whole car is steered by these gains, a step at a time, through the filter of commands of the node, or by the node
   itself in mode lockstep. It starts beside its lane. The linear model in the same loop says what offset to expect.
"""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

import numpy as np

try:
    import control
except ModuleNotFoundError:
    sys.exit("this example needs python-control: pip install 'mbd_sim_ros[control]'")

import solver
from solver.inputs.command_filter import BANDWIDTH, CommandSource, commands_of

SCENE, SPEED = 'car_step_steer', 25.0  # m/s
SETTINGS = ('maneuver={}', 'start.speed=25')
SWEEP = 0.05  # rad of the steering wheel; ten times as much reaches where tires bend
FAST = 2.0  # Hz at the end of the sweep; ten times as fast is the filter of commands and no driver
# m, rad, rad that cost as much as each other; ten times as large an ANGLE steers ten times as much for the same offset
OFFSET, HEADING, ANGLE = 0.5, 0.2, 0.5
PATIENCE = 60.0  # s for the first state, in which kernels may compile; ten times as much looks as if it hung
ASIDE = 0.2  # m beside the lane at the start; ten times as much is a lane change, and not linear


class Design(NamedTuple):
    """a (2, 2), b (2, 1): d/dt (lateral velocity [m/s], yaw rate [rad/s]) = a (...) + b (angle of the steering wheel
    [rad]); fit: what they leave of the answer, relative to it; gains (4,) of offset, heading and these two."""

    a: np.ndarray
    b: np.ndarray
    fit: float
    gains: np.ndarray


def answers(car: solver.Simulation, duration: float = 6.0) -> tuple[np.ndarray, np.ndarray]:
    """((n,) steering angles [rad], (n, 2) linear answers: lateral velocity [m/s] and yaw rate [rad/s])."""
    n = round(duration / car.h)
    t = car.h * np.arange(1, n + 1)
    phase = math.pi * FAST / duration * t * t
    rate = 2.0 * math.pi * FAST / duration * t
    rows = np.repeat(car.inputs[None, :], n, axis=0)
    first = car.channels.inputs.index('steering')
    sides = []
    for side in (SWEEP, -SWEEP):
        rows[:, first] = side * np.sin(phase)
        rows[:, first + 1] = side * rate * np.cos(phase)
        rows[:, first + 2] = side * (rate[0] / t[0] * np.cos(phase) - rate * rate * np.sin(phase))
        car.reset()
        seen = car.seen(1, n)
        car.advance(n, rows, seen=seen)
        twist = seen.numbers[:, car.snapshot().layout['twist'][0]].reshape(n, -1, 6)[:, car.channels.chassis or 0]
        sides.append(twist[:, [1, 5]])
    car.reset()
    return SWEEP * np.sin(phase), 0.5 * (sides[0] - sides[1])


def design(car: solver.Simulation) -> Design:
    """The controller; see the module."""
    angle, answer = answers(car)
    # x(t) = a integral of x + b integral of the angle: nothing is differentiated
    known = np.cumsum(np.column_stack([answer, angle]), axis=0) * car.h
    found, *_ = np.linalg.lstsq(known, answer, rcond=None)
    fit = float((np.linalg.norm(known @ found - answer, axis=0) / np.linalg.norm(answer, axis=0)).max())
    a, b = found[:2].T, found[2:].T
    A, B = np.zeros((4, 4)), np.concatenate([np.zeros((2, 1)), b])
    A[0, 1], A[0, 2], A[1, 3], A[2:, 2:] = SPEED, 1.0, 1.0, a
    gains, _, _ = control.lqr(A, B, np.diag([OFFSET**-2, HEADING**-2, 0.0, 0.0]), np.array([[ANGLE**-2]]))
    return Design(a, b, fit, np.asarray(gains)[0])


def expected(made: Design, duration: float, h: float) -> np.ndarray:
    """(n,) offsets [m] of the linear model in the loop, at every step from the start on."""
    A, w = np.zeros((6, 6)), 2.0 * math.pi * BANDWIDTH  # offset, heading, both states, angle and rate of the wheel
    A[0, 1], A[0, 2], A[1, 3], A[2:4, 2:4], A[2:4, 4:5], A[4, 5] = SPEED, 1.0, 1.0, made.a, made.b, 1.0
    A[5, :4], A[5, 4], A[5, 5] = -w * w * made.gains, -w * w, -2.0 * w  # the filter of commands
    loop = control.ss(A, np.zeros((6, 1)), np.eye(1, 6), np.zeros((1, 1)))
    time = h * np.arange(round(duration / h) + 1)
    return np.asarray(control.initial_response(loop, time, ASIDE * np.eye(6)[0]).outputs).ravel()


def drive(car: solver.Simulation, gains: np.ndarray, duration: float) -> np.ndarray:
    """(n,) offsets [m] of the car from its lane, the x axis, at every step from the start on."""
    car.reset()
    car.place(0.0, ASIDE, 0.0)
    hands = CommandSource(car.channels.inputs, car.h_ns, commands=commands_of(car.channels.inputs))
    shot, chassis, offsets = car.snapshot(), car.channels.chassis or 0, [ASIDE]
    torque = float(car.inputs[car.channels.inputs.index('drive_torque')])
    for _ in range(round(duration / car.h)):
        _, y, _, qx, qy, qz, qw = shot.pose[chassis]
        heading = math.atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz))
        wanted = -gains @ (y, heading, shot.twist[chassis, 1], shot.twist[chassis, 5])
        shot = car.advance(1, hands.advance(float(wanted), torque, 0.0))
        offsets.append(float(shot.pose[chassis, 1]))
    return np.array(offsets)


def over_topics(gains: np.ndarray, torque: float, steps: int) -> np.ndarray:
    """As drive(), of the car that a node simulates in mode lockstep; the lane lies ASIDE to the right of its start."""
    import rclpy
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import JointState

    rclpy.init()
    node = rclpy.create_node('lane_keeper')
    answers_to = node.create_publisher(JointState, 'simulator/lockstep_cmd', 10)
    offsets: dict[tuple[int, int], float] = {}  # by the stamps of states

    def answer(odom: Odometry) -> None:
        stamp, at, turn, twist = (
            odom.header.stamp,
            odom.pose.pose.position,
            odom.pose.pose.orientation,
            odom.twist.twist,
        )
        if (stamp.sec, stamp.nanosec) in offsets:
            return  # said again while the answer is under way
        y = offsets[stamp.sec, stamp.nanosec] = at.y + ASIDE
        heading = math.atan2(2.0 * (turn.w * turn.z + turn.x * turn.y), 1.0 - 2.0 * (turn.y * turn.y + turn.z * turn.z))
        wanted = -gains @ (y, heading, twist.linear.y, twist.angular.z)
        command = JointState(name=['steering', 'drive_torque'], position=[float(wanted), torque])
        command.header.stamp = stamp
        answers_to.publish(command)

    node.create_subscription(Odometry, 'odom', answer, 10)
    while len(offsets) <= steps:
        known = len(offsets)
        rclpy.spin_once(node, timeout_sec=PATIENCE)
        if len(offsets) == known == 0:
            sys.exit(
                f'no state on the topic odom within {PATIENCE:g} s: start the simulator as the head of this file says'
            )
    rclpy.shutdown()
    return np.array([*offsets.values()])


if __name__ == '__main__':
    whole = solver.simulation_of(solver.load_scene(SCENE, SETTINGS))
    made = design(whole)
    print('gains of offset, heading, lateral velocity, yaw rate:', made.gains.round(3).tolist())
    print(f'two states leave {100 * made.fit:.1f} % of the answer of the whole car')
    duration = 3.0
    if '--node' in sys.argv:
        torque = float(whole.inputs[whole.channels.inputs.index('drive_torque')])
        driven = over_topics(made.gains, torque, round(duration / whole.h))
    else:
        driven = drive(whole, made.gains, duration)
    n = min(len(driven), round(duration / whole.h) + 1)
    off = 1e3 * np.abs(driven[:n] - expected(made, duration, whole.h)[:n]).max()
    print(f'from {ASIDE:.2f} m to {driven[-1]:+.4f} m beside the lane; the linear model is off by {off:.1f} mm at most')
