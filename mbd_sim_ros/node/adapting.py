"""The node `adapter`: topics of others on one side, those of the simulator on the other (see adapter.py)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from nav_msgs.msg import Odometry
from rcl_interfaces.srv import GetParameters
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState

from mbd_sim_ros.node.accompany import LOOK
from mbd_sim_ros.node.demand import DRIVE, Car, Demand, Loop
from mbd_sim_ros.node.demands import GEAR_DRIVE, HEARD, TOLD, Heard, Measured, class_of, gear
from mbd_sim_ros.node.gearbox import Gearbox, Worked
from mbd_sim_ros.node.parameters import declare_described
from solver.errors import SpecError
from solver.files.scene import load_scene
from solver.inputs.driver import SpeedControl
from solver.inputs.hands import COMMANDS


class Adapter(Node):
    """Keeps the newest demand and answers every odom with commands. answered: the newest stamp that was [ns]; -1: none. Raises MbdError."""

    def __init__(self, parameters: Mapping[str, tuple[Any, str]]) -> None:
        super().__init__('adapter')
        declare_described(self, parameters)
        self.answered = -1
        self._demand: Demand | None = None
        self._at = -1  # simulation time of the newest demand [ns]; -1: it came since the last odom
        self._gear, self._gear_number = DRIVE, GEAR_DRIVE
        self._loop: Loop | None = None
        self._gearbox: Worked | None = None
        self._simulator = self.value('simulator')
        self._scene = load_scene(self.value('scene')) if self.value('scene') else None
        self._asked: Any = None
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        latched = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        missing = set()
        for row in HEARD:
            kind = class_of(row.type)
            if kind is None:
                missing.add(row.type.partition('/')[0])
                continue
            self.create_subscription(kind, row.topic, self._hearing(row), newest)  # whatever the durability of who publishes
            if row.latched:  # what was said before; the same twice changes nothing
                self.create_subscription(kind, row.topic, self._hearing(row), latched)
        self._reports = []
        for told in TOLD:
            kind = class_of(told.type)
            if kind is None:
                missing.add(told.type.partition('/')[0])
            else:
                self._reports.append((self.create_publisher(kind, told.topic, newest), kind, told.fill))
        for package in sorted(missing):
            self.get_logger().info(f'{package} is not installed: its topics are left out')
        self._commands = self.create_publisher(
            JointState, f'{self._simulator}/lockstep_cmd', QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
        )
        self.create_subscription(Odometry, 'odom', self._answer, newest)

    def value(self, name: str) -> Any:
        """Return the value of a parameter."""
        return self.get_parameter(name).value

    def look(self, executor: Executor) -> bool:
        """Take what comes; whether the simulator, and the car that it drives, has been found. Raises MbdError."""
        if self._loop is None:
            return self._find(executor)
        executor.spin_once(timeout_sec=LOOK)
        return True

    def missing(self) -> str:
        """What is wrong with the simulator while it has not been found."""
        return 'does not say what it simulates' if self._commands.get_subscription_count() else 'is not there'

    def ended(self) -> str:
        """Why there is nothing more to do; '' while there is."""
        gone = self.answered >= 0 and self._commands.get_subscription_count() == 0
        return f'the simulator has ended at t = {self.answered * 1e-9:.3f} s' if gone else ''

    def _find(self, executor: Executor) -> bool:
        """Look for the simulator and learn what car it drives. Raises MbdError for a scene that cannot be loaded."""
        if self._commands.get_subscription_count() == 0:
            executor.spin_once(timeout_sec=LOOK)
            return False
        scene = self._scene
        if scene is None:
            if self._asked is None:
                self._client = self.create_client(GetParameters, f'{self._simulator}/get_parameters')
                if not self._client.wait_for_service(timeout_sec=LOOK):
                    return False
                self._asked = self._client.call_async(GetParameters.Request(names=['scene', 'overrides']))
            executor.spin_once(timeout_sec=LOOK)
            if not self._asked.done():
                return False
            values = self._asked.result().values
            scene = load_scene(values[0].string_value, [text for text in values[1].string_array_value if text])
        car = Car.of(scene, ratio=self.value('steering_ratio') or None)
        control = SpeedControl(
            bandwidth=self.value('bandwidth'),
            most=self.value('max_drive_torque'),
            least=-self.value('max_engine_braking'),
            brakes=self.value('max_brake_torque'),
        )
        self._loop = Loop(car, control, self.value('max_road_wheel'))
        box = Gearbox.of(scene)
        self._gearbox = None if box is None else Worked(box)
        how = 'by its measured map' if self.value('steering_ratio') == 0.0 else f'by the ratio {self.value("steering_ratio"):g}'
        self.get_logger().info(f'driving {scene.name}: wheelbase {car.wheelbase:.3f} m, steering {how}')
        return True

    def _hearing(self, row: Heard) -> Callable[[Any], None]:
        def hear(message: Any) -> None:
            heard = row.demand(message)
            if isinstance(heard, int):
                self._gear, self._gear_number = gear(heard), heard
            elif heard.finite:
                self._demand, self._at = heard, -1
            else:
                self.get_logger().warning(f'{row.topic}: not a number; the command before it stays', throttle_duration_sec=2.0)

        return hear

    def _answer(self, odom: Odometry) -> None:
        stamp = odom.header.stamp
        now = stamp.sec * 1_000_000_000 + stamp.nanosec
        if self._loop is None or now == self.answered:
            return
        if now < self.answered:  # the simulator was reset
            self._loop.reset()
            if self._gearbox is not None:
                self._gearbox.reset()
            self._at, self.answered = -1, -1
        if self._demand is not None and self._at < 0:
            self._at = now
        timeout = self.value('command_timeout')
        old = timeout > 0.0 and self._demand is not None and now - self._at > timeout * 1e9
        h = (now - self.answered) * 1e-9 if self.answered >= 0 else 0.0
        twist = odom.twist.twist
        try:
            values = self._loop.commands(None if old else self._demand, self._gear, twist.linear.x, h)
        except SpecError as error:
            self.get_logger().error(str(error))
            return
        named = dict(zip(COMMANDS, values))
        if self._gearbox is not None:
            named |= self._gearbox.commands(values[1], self._loop.direction, self._gear, twist.linear.x, h)
        command = JointState(name=list(named), position=list(named.values()))
        command.header.stamp = stamp
        self._commands.publish(command)
        self.answered = now
        measured = Measured(stamp, twist.linear.x, twist.linear.y, twist.angular.z, self._loop.road_wheel, self._gear_number)
        for publisher, kind, fill in self._reports:
            message = kind()
            fill(message, measured)
            publisher.publish(message)
