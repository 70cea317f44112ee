"""The other side of a simulator: commands, services and what it publishes."""

from __future__ import annotations

import time

import pytest
from processes import DOMAIN


class Client:
    """The other side: publishes commands, calls services, keeps what it hears."""

    def __init__(self, context, node) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from nav_msgs.msg import Odometry
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from rosgraph_msgs.msg import Clock
        from sensor_msgs.msg import JointState
        from std_msgs.msg import Float64, String
        from std_srvs.srv import Trigger

        self.node, self._float, self._trigger = node, Float64, Trigger
        self.commands = [
            node.create_publisher(Float64, f'simulator/{name}', 1)
            for name in ('steering_cmd', 'torque_cmd', 'brake_cmd')
        ]
        self.applied: list[dict[str, float]] = []
        self.clock: list[float] = []
        self.odom: list[Odometry] = []
        self.diagnostics: list[DiagnosticArray] = []
        self.description: list[String] = []
        self.scene: list[String] = []
        node.create_subscription(
            JointState, 'cmd_applied', lambda m: self.applied.append(dict(zip(m.name, m.position))), 1000
        )
        node.create_subscription(Odometry, 'odom', self.odom.append, 10)
        node.create_subscription(DiagnosticArray, '/diagnostics', self.diagnostics.append, 10)
        best = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        node.create_subscription(
            Clock, '/clock', lambda m: self.clock.append(m.clock.sec + 1e-9 * m.clock.nanosec), best
        )
        from rclpy.qos import DurabilityPolicy

        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(String, 'robot_description', self.description.append, latched)
        node.create_subscription(String, 'simulator/scene', self.scene.append, latched)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(node)

    def until(self, condition, seconds: float = 15.0) -> None:
        """Listen until the condition holds; one that looks at the newest message of a topic does not hold before the
        first."""
        end = time.monotonic() + seconds
        while not self._holds(condition):
            assert time.monotonic() < end, 'timed out'
            self.executor.spin_once(timeout_sec=0.05)

    def _holds(self, condition) -> bool:
        try:
            return bool(condition())
        except IndexError:
            # topics are discovered one by one: reports of an adapter can be heard before the first of the simulator
            # itself
            if all((self.applied, self.clock, self.odom, self.diagnostics)):
                raise
            return False

    def ready(self) -> None:
        self.until(lambda: all(p.get_subscription_count() for p in self.commands))

    def send(self, index: int, value: float) -> None:
        self.commands[index].publish(self._float(data=value))

    def call(self, name: str):
        client = self.node.create_client(self._trigger, f'simulator/{name}')
        self.until(client.service_is_ready)
        future = client.call_async(self._trigger.Request())
        self.until(future.done)
        return future.result()


@pytest.fixture
def client():
    rclpy = pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(DOMAIN))
    node = rclpy.create_node('client', context=context)
    yield Client(context, node)
    node.destroy_node()
    rclpy.shutdown(context=context)
