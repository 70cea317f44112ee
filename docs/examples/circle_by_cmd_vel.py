"""Somebody who knows no torques: speed and yaw rate on cmd_vel; the executable `adapter` makes them steering, drive and
brakes.

simulator --ros-args -p scene:=light_car_straight -p "overrides:=['start={kind: equilibrium, speed: 6.0}']"
adapter
python circle_by_cmd_vel.py
"""

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry

SPEED, RADIUS = 7.0, 20.0  # m/s, m


def main() -> None:
    """Publish at 20 Hz until the car drives on the circle."""
    rclpy.init()
    node = rclpy.create_node('circle')
    publisher = node.create_publisher(Twist, 'cmd_vel', 1)
    newest: list[Odometry] = []
    node.create_subscription(Odometry, 'odom', newest.append, 1)
    wanted = Twist()
    wanted.linear.x, wanted.angular.z = SPEED, SPEED / RADIUS
    node.create_timer(0.05, lambda: publisher.publish(wanted))
    while True:
        rclpy.spin_once(node)
        if newest:
            twist = newest[-1].twist.twist
            del newest[:-1]
            if abs(twist.linear.x - SPEED) < 0.1 and abs(twist.angular.z - SPEED / RADIUS) < 0.03:
                break
    print(f'{twist.linear.x:.2f} m/s on a radius of {twist.linear.x / twist.angular.z:.1f} m')
    rclpy.shutdown()


if __name__ == '__main__':
    main()
