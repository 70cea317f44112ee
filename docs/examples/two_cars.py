"""Two cars in one graph: each simulator in a namespace of its own, its frames with a prefix, and one script that drives
both.

python two_cars.py
"""

import subprocess
import sys

import rclpy
from nav_msgs.msg import Odometry
from std_msgs.msg import Float64

SECONDS = 1.5  # of simulated time, from where both cars hear the commands
STEERING = {'car1': 0.4, 'car2': -0.4}  # rad


def simulator(name: str) -> subprocess.Popen:
    """Start one."""
    # each has a time of its own
    parameters = {'scene': 'light_car_straight', 'frame_prefix': f'{name}/', 'publish_clock': 'false'}
    arguments = [text for key, value in parameters.items() for text in ('-p', f'{key}:={value}')]
    return subprocess.Popen(
        [sys.executable, '-m', 'mbd_sim_ros.node.main', '--ros-args', '-r', f'__ns:=/{name}', *arguments]
    )


def seconds(odom: Odometry) -> float:
    """Simulated time of a message."""
    return odom.header.stamp.sec + 1e-9 * odom.header.stamp.nanosec


def main() -> None:
    """Drive both, and say where they came to."""
    cars = {name: simulator(name) for name in STEERING}
    try:
        rclpy.init()
        node = rclpy.create_node('driver')
        newest: dict[str, Odometry] = {}
        for name in cars:
            node.create_subscription(Odometry, f'/{name}/odom', lambda odom, name=name: newest.update({name: odom}), 1)
        publishers = {name: node.create_publisher(Float64, f'/{name}/simulator/steering_cmd', 1) for name in cars}
        end: dict[str, float] = {}
        while len(end) < len(cars) or any(seconds(newest[name]) < end[name] for name in cars):
            rclpy.spin_once(node, timeout_sec=0.1)
            for name, publisher in publishers.items():
                publisher.publish(Float64(data=STEERING[name]))
                if name in newest and publisher.get_subscription_count() > 0:
                    end.setdefault(name, seconds(newest[name]) + SECONDS)
            if any(car.poll() is not None for car in cars.values()):
                sys.exit('a simulator has ended')
        for name, odom in newest.items():
            at = odom.pose.pose.position
            print(f'{name}: {odom.child_frame_id} in {odom.header.frame_id} at x = {at.x:.1f} m, y = {at.y:+.1f} m')
        rclpy.shutdown()
    finally:
        for car in cars.values():
            car.terminate()
        for car in cars.values():
            car.wait()


if __name__ == '__main__':
    main()
