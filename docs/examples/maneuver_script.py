"""A maneuver from a script: one sine of steering, then the brakes, and what came of it.

simulator --ros-args -p scene:=light_car_straight
python maneuver_script.py
"""

import math

import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from std_msgs.msg import Float64

STEER_FROM, FREQUENCY, AMPLITUDE = 0.5, 1.0, 0.6  # s, Hz, rad at the steering wheel
BRAKE_FROM, BRAKE = 2.0, 5000.0  # s, N m


class Script(Node):
    """Looks at every odom; its stamp is the time in the simulation, whatever the pace."""

    def __init__(self) -> None:
        super().__init__('script')
        self.steering = self.create_publisher(Float64, 'simulator/steering_cmd', 1)
        self.brake = self.create_publisher(Float64, 'simulator/brake_cmd', 1)
        self.begin: float | None = None
        self.yaw_rate = 0.0  # the largest
        self.braked_at: float | None = None
        self.done = False
        self.create_subscription(Odometry, 'odom', self.look, 1)

    def look(self, odom: Odometry) -> None:
        """Steer, then brake, until the car stands."""
        now = odom.header.stamp.sec + 1e-9 * odom.header.stamp.nanosec
        self.begin = now if self.begin is None else self.begin
        t, speed = now - self.begin, odom.twist.twist.linear.x
        self.yaw_rate = max(self.yaw_rate, abs(odom.twist.twist.angular.z))
        phase = FREQUENCY * (t - STEER_FROM)
        self.steering.publish(Float64(data=AMPLITUDE * math.sin(2.0 * math.pi * phase) if 0.0 < phase < 1.0 else 0.0))
        if t > BRAKE_FROM:
            self.brake.publish(Float64(data=BRAKE))
            self.braked_at = odom.pose.pose.position.x if self.braked_at is None else self.braked_at
            if speed < 0.1:
                print(
                    f'largest yaw rate {self.yaw_rate:.2f} rad/s, stopped within '
                    f'{odom.pose.pose.position.x - self.braked_at:.1f} m'
                )
                self.done = True


def main() -> None:
    """Run the script until the car stands."""
    rclpy.init()
    node = Script()
    while not node.done:
        rclpy.spin_once(node)
    rclpy.shutdown()


if __name__ == '__main__':
    main()
