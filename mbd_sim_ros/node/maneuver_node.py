"""The node `maneuver`: answers the states of a simulator with the commands of a maneuver (see maneuver_player.py).

To a simulator without `lockstep_cmd` it sends the plain commands: steering and torques, and those of pedals and gear
that it has. A simulator in lockstep publishes its state again when no answer comes; that is answered only once it is
clear that the first answer was lost: two plain answers to one state would become the commands of two steps.
"""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Mapping
from typing import Any

from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Int32

from mbd_sim_ros.node.commands import NAMED, commanded
from mbd_sim_ros.node.companion import LOOK, LOST
from mbd_sim_ros.node.graph import HEARD_HERE, SAID_HERE, Watch
from mbd_sim_ros.node.parameters import declare_described
from mbd_sim_ros.node.spinning import spin_once
from solver.errors import SceneError
from solver.files.scene import load_maneuver, load_scene
from solver.inputs.command_filter import COMMANDS, STEERING

FIND = 1.5  # s after the first state in which a simulator that takes stamped commands is found out


class Player(Node):
    """Answers every `cmd_applied` with commands. answered: stamp of the newest [ns]; -1: none. what: is played. Raises
    MbdError."""

    def __init__(self, parameters: Mapping[str, tuple[Any, str]]) -> None:
        super().__init__('maneuver')
        declare_described(self, parameters)
        name, scene, simulator = self.value('maneuver'), self.value('scene'), self.value('simulator')
        if bool(name) == bool(scene):
            raise SceneError(
                'give either a maneuver or a scene: --ros-args -p maneuver:=FILE_OR_NAME, or -p scene:=FILE_OR_NAME'
            )
        self._duration = self.value('duration')
        self._steers: bool | None = True  # by the angle of the wheel; None: if the simulator takes one
        if scene:
            loaded = load_scene(scene)
            self._maneuver, self._duration = loaded.maneuver, self._duration or loaded.duration
            self._steers = loaded.actuation.steering == 'angle' or COMMANDS[0] in loaded.maneuver.channels
        else:
            self._maneuver = load_maneuver(name)
            self._steers = COMMANDS[0] in self._maneuver.channels or None
        self._maneuver.commands(0.0)  # what cannot be played is refused before anybody waits
        self.what = self._maneuver.name or name or scene
        self.answered = -1
        self._heard = math.inf  # clock reading of the first state
        self._repeated = math.inf  # clock reading when the newest state came again
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        self._plain = {
            name: (self.create_publisher(one.type, f'{simulator}/{one.topic}', newest, **SAID_HERE), one.type)
            for name in (*COMMANDS, *self._maneuver.signals)
            if (one := commanded(name)).topic not in NAMED
        }
        self._stamped = self.create_publisher(
            JointState,
            f'{simulator}/lockstep_cmd',
            QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE),
            **SAID_HERE,
        )
        self.create_subscription(JointState, 'cmd_applied', self._answer, newest, raw=True, **HEARD_HERE)
        self._watch = Watch(self)

    def value(self, name: str) -> Any:
        """Return the value of a parameter."""
        return self.get_parameter(name).value

    def look(self, executor: Executor) -> bool:
        """Take what comes; whether the simulator has been found."""
        spin_once(executor, self, LOOK)
        self._watch.look()
        if time.monotonic() - self._repeated > LOST:
            self._send()
        return self.answered >= 0

    def missing(self) -> str:
        """Reason why the simulator has not been found yet."""
        return 'is there but sends no cmd_applied (is it in another namespace?)' if self._found() else 'is not there'

    def ended(self) -> str:
        """Why there is nothing more to do; '' while there is."""
        if self.answered >= 0 and not self._found():
            return f'the simulator has ended at t = {self.answered * 1e-9:.3f} s'
        if self._duration > 0.0 and self.answered >= self._duration * 1e9:
            return f'the maneuver has ended at t = {self.answered * 1e-9:.3f} s'
        return ''

    def _found(self) -> bool:
        """True where somebody listens to a command that every car has."""
        return self._listened(COMMANDS[1])

    def _listened(self, name: str) -> bool:
        return self._plain[name][0].get_subscription_count() > 0

    def _answer(self, encoded: bytes) -> None:
        now = time.monotonic()
        self._heard = min(self._heard, now)
        if self.answered < 0 and self._stamped.get_subscription_count() == 0 and now - self._heard < FIND:
            return  # it will come again, or a newer one
        seconds, nanoseconds = struct.unpack_from('<iI', encoded, 4)  # header.stamp
        t_ns = seconds * 1_000_000_000 + nanoseconds
        if t_ns == self.answered:
            self._repeated = min(self._repeated, now)
            return
        self.answered = t_ns
        self._send()

    def _send(self) -> None:
        """Send the commands for the newest state."""
        self._repeated, t = math.inf, self.answered * 1e-9
        named = dict(zip(COMMANDS, self._maneuver.commands(t))) | self._maneuver.further_commands(t)
        if self._stamped.get_subscription_count():
            steers = self._listened(COMMANDS[0]) if self._steers is None else self._steers
            if STEERING['torque'] in named or not steers:
                del named[COMMANDS[0]]  # no angle of the wheel is a command there, and with one all would be refused
            message = JointState(name=list(named), position=list(named.values()))
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(self.answered, 1_000_000_000)
            self._stamped.publish(message)
            return
        for name, (publisher, kind) in self._plain.items():
            value = named[name]
            publisher.publish(kind(data=math.floor(value + 0.5) if kind is Int32 else value))
