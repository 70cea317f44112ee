"""A controller that decides when time passes: it keeps a speed and a lane, and every run of it is the same, bit for
bit.

simulator --ros-args -p scene:=light_car_straight -p mode:=lockstep -p duration:=2.0
python lockstep_controller.py

It ends after 1500 steps; the simulator then waits for the next answer, until Ctrl-C.
"""

import hashlib
import math
import sys

import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import JointState

SPEED, LANE = 24.0, 1.0  # m/s, m to the left
STEPS = int(sys.argv[1]) if len(sys.argv) > 1 else 1500


class Controller(Node):
    """Answers every state once: the stamp of its message says which one."""

    def __init__(self) -> None:
        super().__init__('controller')
        self.answers = self.create_publisher(JointState, 'simulator/lockstep_cmd', 10)
        self.seen: list[tuple[int, int]] = []
        self.digest = hashlib.sha256()
        self.create_subscription(Odometry, 'odom', self.answer, 10)

    def answer(self, odom: Odometry) -> None:
        """Steer towards a point 20 m ahead in the lane, and drive or brake towards the speed."""
        stamp = odom.header.stamp
        if (stamp.sec, stamp.nanosec) in self.seen[-1:]:
            return  # the simulator says again what is waiting; the answer is under way
        self.seen.append((stamp.sec, stamp.nanosec))
        self.digest.update(repr(odom).encode())  # every digit of every field; bytes on the wire have gaps of any value
        pose, speed = odom.pose.pose, odom.twist.twist.linear.x
        heading = 2.0 * math.atan2(pose.orientation.z, pose.orientation.w)
        command = JointState(name=['steering', 'drive_torque', 'brake_torque'])
        command.header.stamp = stamp
        error = 450.0 * (SPEED - speed)
        command.position = [
            16.0 * 2.7 * 2.0 * ((LANE - pose.position.y) / 20.0 - heading) / 20.0,
            max(error, 0.0),
            max(-error, 0.0),
        ]
        self.answers.publish(command)
        self.last = odom


def main() -> None:
    """Control for so many steps."""
    rclpy.init()
    node = Controller()
    while len(node.seen) < STEPS:
        rclpy.spin_once(node)
    at, speed = node.last.pose.pose.position, node.last.twist.twist.linear.x
    print(f'{STEPS} steps: y = {at.y:.3f} m, {speed:.3f} m/s, digest {node.digest.hexdigest()[:16]}')
    rclpy.shutdown()


if __name__ == '__main__':
    main()
