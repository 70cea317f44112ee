"""What a node is told: subscriptions to the commands, looked into by the simulation thread; limits, refusals and warnings."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from mbd_sim_ros.node.loop import Loop
from solver.errors import suggestion
from solver.inputs.maneuver import COMMANDS

WARN_SECONDS = 2.0  # a repeated warning about a command is said this often
PLAIN = ('steering_cmd', 'torque_cmd', 'brake_cmd')  # topics of the COMMANDS
LIMITS = ('max_steering', 'max_drive_torque', 'max_brake_torque')  # parameters that limit them


class Commands:
    """Subscribes to the commands on a node of their own, which no executor spins: the simulation thread takes the newest itself (`poll`).

    An executor takes about 1 ms per message for its wait set, with the interpreter lock held; looking into the three
    subscriptions takes 20 us, and the command is used in the very next step.
    refused: commands that were no numbers, or named no input. deaf: nothing is subscribed to, something else drives.
    """

    loop: Loop  # that gets the commands

    def __init__(self, node: Node, *, deaf: bool) -> None:
        self.deaf = deaf
        self.refused = 0
        self._node = node
        self._warned: dict[str, float] = {}
        self._stamps = False  # somebody publishes stamped commands
        self._inbox: list[tuple[Subscription, type, Callable[[Any], None]]] = []
        self._ears: Node | None = None
        if deaf:
            return
        self._ears = Node(
            f'{node.get_name()}_commands',
            namespace=node.get_namespace(),
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        for index, name in enumerate(PLAIN):
            receive = self._plain(index, name)
            full = node.resolve_topic_name(f'~/{name}')
            self._inbox.append((self._ears.create_subscription(Float64, full, receive, newest), Float64, receive))
        several = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)  # an old answer must not push the right one out
        full = node.resolve_topic_name('~/lockstep_cmd')
        self._answers = self._ears.create_subscription(JointState, full, self._stamped, several)

    def close(self) -> None:
        """Listen no more."""
        if self._ears is not None:
            self._ears.destroy_node()

    def look_around(self) -> None:
        """Note who publishes; once a second, from the main thread."""
        self._stamps = self._node.count_publishers(self._node.resolve_topic_name('~/lockstep_cmd')) > 0

    def poll(self) -> None:
        """Hand what is new to the loop; on the simulation thread."""
        for subscription, kind, receive in self._inbox:
            message = _take(subscription, kind)
            if message is not None:
                receive(message)
        if not self.deaf and (self._stamps or self.loop.mode == 'lockstep'):
            for _ in range(10):
                message = _take(self._answers, JointState)
                if message is None:
                    return
                self._stamped(message)

    def _plain(self, index: int, topic: str) -> Callable[[Float64], None]:
        def receive(message: Float64) -> None:
            value = self._accepted(index, topic, message.data)
            if value is not None:
                self.loop.command(index, value)

        return receive

    def _stamped(self, message: JointState) -> None:
        """Commands by the names of the inputs, that answer the state of header.stamp."""
        values: dict[int, float] = {}
        if len(message.name) != len(message.position) or not message.name:
            self._refuse('lockstep_cmd', f'lockstep_cmd: {len(message.name)} names, {len(message.position)} positions; give one for each')
            return
        for name, number in zip(message.name, message.position):
            if name not in COMMANDS:
                self._refuse('lockstep_cmd', f'lockstep_cmd: {name!r} is no command{suggestion(name, COMMANDS)}')
                return
            index = COMMANDS.index(name)
            value = self._accepted(index, f'lockstep_cmd: {name}', number)
            if value is None:
                return
            values[index] = value
        t_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        if not self.loop.answer(t_ns, values):
            now = self.loop.simulation.t_ns
            self._warn('answer', f'lockstep_cmd answers t = {t_ns * 1e-9:.6f} s, the state that is waiting is that of {now * 1e-9:.6f} s')

    def _accepted(self, index: int, what: str, number: float) -> float | None:
        """The command within its limits; None for one that is not a number."""
        if not math.isfinite(number):
            self._refuse(f'{what} not finite', f'{what}: {number} is not a number; the command before it stays')
            return None
        limit = LIMITS[index]
        high = self._node.get_parameter(limit).value
        value = min(max(number, 0.0 if COMMANDS[index] == 'brake_torque' else -high), high)
        if value != number:
            self._warn(what, f'{what}: {number:g} is beyond the limit; {value:g} is applied (parameter {limit})')
        return value

    def _refuse(self, about: str, text: str) -> None:
        self.refused += 1
        self._warn(about, text)

    def _warn(self, about: str, text: str) -> None:
        now = time.monotonic()
        if now - self._warned.get(about, -math.inf) >= WARN_SECONDS:
            self._warned[about] = now
            self._node.get_logger().warning(text)


def _take(subscription: Subscription, kind: type) -> Any:
    """The next message of a subscription that no executor spins, or None."""
    with subscription.handle:
        taken = subscription.handle.take_message(kind, False)
    return None if taken is None else taken[0]
