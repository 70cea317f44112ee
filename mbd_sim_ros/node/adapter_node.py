"""The node `adapter`: topics of others on one side, those of the simulator on the other (see adapter.py)."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from itertools import groupby
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from mbd_sim_ros.node.companion import LOOK, LOST
from mbd_sim_ros.node.demand_messages import GEAR_DRIVE, GEAR_REVERSE, HEARD, TOLD, Heard, Measured, class_of, gear
from mbd_sim_ros.node.gearbox import Gearbox, Worked
from mbd_sim_ros.node.graph import HEARD_HERE, SAID_HERE, Ear, Watch
from mbd_sim_ros.node.parameters import declare_described
from mbd_sim_ros.node.speed_control import Car, Demand, Loop
from mbd_sim_ros.node.spinning import spin_once
from solver.errors import SpecError
from solver.files.scene import load_scene, load_scene_text
from solver.inputs.command_filter import COMMANDS, STEERING
from solver.inputs.driver import SpeedControl
from solver.scene import Scene

POSITIVE = ('bandwidth', 'max_drive_torque')
LIMITS = {  # parameter -> what it must be below
    **dict.fromkeys(
        ('steering_ratio', 'command_timeout', 'max_engine_braking', 'max_brake_torque', *POSITIVE), math.inf
    ),
    'max_road_wheel': 0.5 * math.pi,
}


class Adapter(Node):
    """Keeps the newest demand and answers every odom with commands. answered: the newest stamp that was [ns]; -1: none.
    Raises MbdError."""

    def __init__(self, parameters: Mapping[str, tuple[Any, str]]) -> None:
        super().__init__('adapter')
        declare_described(self, parameters)
        self.answered = -1
        self._demand: Demand | None = None
        self._at = -1  # simulation time of the newest demand [ns]; -1: it came since the last odom
        self._gear: str | None = None  # as commanded, with its number; None: nobody did
        self._gear_number = GEAR_DRIVE
        self._loop: Loop | None = None
        self._gearbox: Worked | None = None
        self._named = COMMANDS  # what it commands, steering first
        self._wheel: float | None = None  # where the steering wheel stands [rad], once that is known
        self._heard = False  # whether an odom came
        self._command: JointState | None = None  # the newest
        self._repeated = math.inf  # clock reading when the state that it answers came again
        self._control = self._checked()
        self._simulator = self.value('simulator')
        self._driven: Scene | None = None  # whose car the loop is of
        self._scene = load_scene(self.value('scene')) if self.value('scene') else None  # to be driven
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        latched = QoSProfile(
            depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
        )
        missing, ears = set(), []
        for topic, rows in groupby(HEARD, lambda row: row.topic):
            kinds, late = {}, False
            for row in rows:
                kind, late = class_of(row.type), row.latched
                if kind is None:
                    missing.add(row.type.partition('/')[0])
                else:
                    kinds[kind] = self._hearing(row)
            if kinds:
                ears.append(Ear(self, topic, kinds, depth=1))  # whatever the durability of who publishes
            if kinds and late:  # what was said before; the same twice changes nothing
                ears.append(Ear(self, topic, kinds, depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        self._reports = []
        for told in TOLD:
            kind = class_of(told.type)
            if kind is None:
                missing.add(told.type.partition('/')[0])
            else:
                self._reports.append((self.create_publisher(kind, told.topic, newest, **SAID_HERE), kind, told.fill))
        for package in sorted(missing):
            self.get_logger().info(f'{package} is not installed: its topics are left out')
        self._commands = self.create_publisher(
            JointState,
            f'{self._simulator}/lockstep_cmd',
            QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE),
            **SAID_HERE,
        )
        ears.append(Ear(self, 'odom', {Odometry: self._answer}, depth=1))
        if self._reports:
            ears.append(Ear(self, 'cmd_applied', {JointState: self._applied}, depth=1))
        self._watch = Watch(self, ears)
        self._told = ''  # the scene that runs, not loaded yet
        if self._scene is None:
            self.create_subscription(String, f'{self._simulator}/scene', self._tell, latched, **HEARD_HERE)

    def value(self, name: str) -> Any:
        """Return the value of a parameter."""
        return self.get_parameter(name).value

    def look(self, executor: Executor) -> bool:
        """Take what comes; whether the simulator, its car and its states have been found. Raises MbdError."""
        spin_once(executor, self, LOOK)
        self._watch.look()
        if self._driven is None and self._commands.get_subscription_count() == 0:
            return False
        if self._told:
            self._scene, self._told = load_scene_text(self._told, f'{self._simulator}/scene'), ''
        if self._scene is not None and self._scene is not self._driven:
            self._drive(self._scene)
        if time.monotonic() - self._repeated > LOST:
            self._send()
        return self._driven is not None and self._heard

    def missing(self) -> str:
        """Reason why the simulator has not been found yet."""
        if self._commands.get_subscription_count() == 0:
            return 'is not there'
        if self._driven is None:
            return 'does not say what it simulates'
        return 'is there but sends no odom (is it in another namespace?)'

    def ended(self) -> str:
        """Why there is nothing more to do; '' while there is."""
        gone = self.answered >= 0 and self._commands.get_subscription_count() == 0
        return f'the simulator has ended at t = {self.answered * 1e-9:.3f} s' if gone else ''

    def _checked(self) -> SpeedControl:
        """The law of the speed loop. Raises SpecError for a parameter that is out of its range."""
        for name, most in LIMITS.items():
            value = self.value(name)
            if not (0.0 < value < most if name in POSITIVE else 0.0 <= value < most):
                least = 'above 0' if name in POSITIVE else 'at least 0'
                raise SpecError(
                    f'parameter {name} = {value:g}: must be {least} and '
                    f'{"finite" if most == math.inf else f"below {most:.4f}"}'
                )
        return SpeedControl(
            bandwidth=self.value('bandwidth'),
            most=self.value('max_drive_torque'),
            least=-self.value('max_engine_braking'),
            brakes=self.value('max_brake_torque'),
        )

    def _tell(self, message: String) -> None:
        """Note what the simulator runs from now on."""
        self._told = message.data

    def _drive(self, scene: Scene) -> None:
        """Drive the car of a scene from now on; the one that is driven already goes on. Raises SpecError for one that
        it cannot drive."""
        before, self._driven = self._driven, scene
        if before is not None and scene.hash == before.hash:
            return
        steered = scene.actuation.steering
        if steered == 'torque':
            raise SpecError(
                f'scene {scene.name!r} is steered by a torque (actuation.steering = torque), and an adapter commands '
                'angles; take actuation.steering: angle or road_wheel'
            )
        car = Car.of(scene, ratio=self.value('steering_ratio') or None)
        box = Gearbox.of(scene)
        self._loop = Loop(car, self._control, self.value('max_road_wheel'))
        self._gearbox = None if box is None else Worked(box)
        self._named, self._wheel = (STEERING[steered], *COMMANDS[1:]), None
        self._begin()
        how = (
            'by its measured map'
            if self.value('steering_ratio') == 0.0
            else f'by the ratio {self.value("steering_ratio"):g}'
        )
        how = 'by its road wheels' if steered == 'road_wheel' else how
        self.get_logger().info(f'driving {scene.name}: wheelbase {car.wheelbase:.3f} m, steering {how}')

    def _begin(self) -> None:
        """Time begins anew: what was wanted before counts no more, but what came since the last odom does."""
        assert self._loop is not None
        self._loop.reset()
        if self._gearbox is not None:
            self._gearbox.reset()
        if self._at >= 0:
            self._demand, self._at = None, -1
        self.answered, self._repeated = -1, math.inf

    def _hearing(self, row: Heard) -> Callable[[Any], None]:
        def hear(message: Any) -> None:
            heard = row.demand(message)
            if isinstance(heard, int):
                self._gear, self._gear_number = gear(heard), heard
            elif heard.is_finite:
                self._demand, self._at = heard, -1
            else:
                self.get_logger().warning(
                    f'{row.topic}: not a number; the command before it stays', throttle_duration_sec=2.0
                )

        return hear

    def _answer(self, odom: Odometry) -> None:
        stamp = odom.header.stamp
        now = stamp.sec * 1_000_000_000 + stamp.nanosec
        self._heard = True
        if self._loop is None or self._told:  # another car has been loaded
            return
        # in lockstep: no answer came, or it was lost when the simulator was reset at its start
        if now == self.answered:
            self._repeated = min(self._repeated, time.monotonic())
            return
        if now < self.answered:  # the simulator was reset
            self._begin()
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
        named = dict(zip(self._named, values))
        if STEERING['road_wheel'] in named:
            named[STEERING['road_wheel']] = self._loop.road_wheel
        if self._gearbox is not None:
            named |= self._gearbox.commands(values[1], self._loop.direction, self._gear, twist.linear.x, h)
        command = JointState(name=list(named), position=list(named.values()))
        command.header.stamp = stamp
        self.answered, self._command = now, command
        self._send()
        road_wheel = self._loop.road_wheel if self._wheel is None else self._loop.car.road_wheel(self._wheel)
        number = GEAR_REVERSE if self._gear is None and self._loop.direction < 0.0 else self._gear_number
        measured = Measured(stamp, twist.linear.x, twist.linear.y, twist.angular.z, road_wheel, number)
        for publisher, kind, fill in self._reports:
            message = kind()
            fill(message, measured)
            publisher.publish(message)

    def _applied(self, inputs: JointState) -> None:
        """Note where the steering wheel is, which follows its command."""
        if COMMANDS[0] in inputs.name:
            self._wheel = inputs.position[inputs.name.index(COMMANDS[0])]

    def _send(self) -> None:
        """Send the newest command."""
        self._repeated = math.inf
        self._commands.publish(self._command)
