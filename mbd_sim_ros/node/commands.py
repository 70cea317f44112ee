"""Commands to a node: subscriptions, looked into by the simulation thread; limits, refusals and warnings."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Int32

from mbd_sim_ros.node.graph import Ear, follow
from mbd_sim_ros.node.latch import Latch
from solver.errors import suggestion

WARN_SECONDS = 2.0  # a repeated warning about a command is said this often
SELDOM = 0.01  # s between looks for commands of somebody who is not known yet: he may be gone before he is


class Commanded(NamedTuple):
    """A command: its topic, what it is, the parameter that limits it ('': 1 does; None: nothing does), whether it may
    be below zero, the type of its message, and what a sentence calls it."""

    topic: str
    text: str
    limit: str | None = ''
    signed: bool = True
    type: type = Float64
    called: str = 'drive torque'


PLAIN = {
    'steering': Commanded('steering_cmd', 'steering wheel angle [rad], positive to the left', 'max_steering'),
    'steering_torque': Commanded(
        'steering_torque_cmd', 'torque at the steering wheel [N m], instead of its angle', 'max_steering_torque'
    ),
    'road_wheel': Commanded(
        'road_wheel_cmd', 'mean angle of the front road wheels [rad], instead of that of the wheel', 'max_road_wheel'
    ),
    'drive_torque': Commanded('torque_cmd', 'at the differential [N m]', 'max_drive_torque'),
    'brake_torque': Commanded('brake_cmd', 'all wheels together [N m]', 'max_brake_torque', signed=False),
    'accelerator': Commanded('accelerator_cmd', 'pedal of an engine, 0 to 1', signed=False, called='accelerator'),
    'clutch': Commanded('clutch_cmd', 'clutch pedal of an engine, 0 (closed) to 1 (open)', signed=False),
    'gear': Commanded(
        'gear_cmd', 'gear of an engine: 1, 2, ..., 0 neutral, -1 reverse; the lever of an automatic gearbox', type=Int32
    ),
    'lock_up': Commanded('lock_up_cmd', 'lock-up clutch of a torque converter, closed from 0.5 on', signed=False),
}
BY_WHEEL = {
    'drive_torque_': Commanded('wheel_cmd', 'at a wheel [N m]', 'max_drive_torque'),
    'brake_torque_': Commanded('wheel_cmd', "added to the wheel's share of the brake torque [N m]", 'max_brake_torque'),
}


NAMED = ('lockstep_cmd', 'wheel_cmd')  # topics that take several commands by their names
TOKEN = re.compile('[A-Za-z][A-Za-z0-9_]*')  # what ROS takes as the name of a topic


def commanded(name: str) -> Commanded:
    """Description of a command."""
    known = PLAIN.get(name) or next((one for start, one in BY_WHEEL.items() if name.startswith(start)), None)
    if known is not None:
        return known
    topic = f'{name}_cmd'  # of an element that the scene adds
    own = TOKEN.fullmatch(name) and topic not in (*(one.topic for one in PLAIN.values()), *NAMED)
    return Commanded(topic if own else NAMED[1], 'input of an element of the scene', limit=None, called=name)


class Commands:
    """Subscribes to the commands on a node of their own, which no executor spins: the simulation thread takes the
    newest itself (`poll`).

    An executor takes about 1 ms per message for its wait set, with the interpreter lock held; looking into the three
    subscriptions takes 20 us, and the command is used in the very next step. They are reliable, unless somebody
    publishes best effort. latch: gets the commands, which are those of the scene
    (solver.inputs.command_filter.commands_of). Those of single wheels come together, the others have a topic of their
    own. ends: what the end stops of the vehicle leave of them, least and most [rad]. gears: lowest and highest one,
    where there are any. refused: commands that were no numbers, named no input, or asked for a gear that there is not.
    deaf: nothing is subscribed to, something else drives.
    """

    def __init__(
        self,
        node: Node,
        latch: Latch,
        *,
        ends: Mapping[str, tuple[float, float]] | None = None,
        gears: tuple[int, int] | None = None,
        deaf: bool,
    ) -> None:
        self.names, self.gears, self.ends = latch.commands, gears, ends or {}
        self.deaf = deaf
        self.refused = 0
        self._node, self._latch = node, latch
        self._warned: dict[str, float] = {}
        self.commanded = not deaf  # somebody publishes commands, or may
        self._heard: set[str] = set()  # topics of named commands that somebody publishes
        self._next_look = -math.inf  # clock reading at which topics of named commands are looked into whoever publishes
        self._plain: list[Ear] = []
        self._named: list[Ear] = []  # of several commands by their names
        # what poll() needs of the plain ones
        self._boxes: list[tuple[Callable[[type, bool], Any], type, Callable[[Any], None]]] = []
        self.node: Node | None = None  # that has the subscriptions
        if deaf:
            return
        self.node = Node(
            f'{node.get_name()}_commands',
            namespace=node.get_namespace(),
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        for index, name in enumerate(self.names):
            one = commanded(name)
            if one.topic not in NAMED:
                self._plain.append(self._ear(one.topic, one.type, self._receiving(index, one.topic), depth=1))
        for topic, receive in zip(NAMED, (self._stamped, self._unstamped), strict=True):
            if topic == NAMED[0] or len(self.names) > len(self._plain):
                # an old answer must not push the right one out
                self._named.append(self._ear(topic, JointState, receive, depth=10))
        self._note_boxes()

    def _ear(self, topic: str, kind: type, receive: Callable[[Any], None], depth: int) -> Ear:
        assert self.node is not None
        return Ear(self.node, self._node.resolve_topic_name(f'~/{topic}'), {kind: receive}, depth=depth, polled=True)

    def _note_boxes(self) -> None:
        self._boxes = [
            (ear.subscription.handle.take_message, ear.kind, ear.receive) for ear in self._plain if ear.subscription
        ]

    def close(self) -> None:
        """Listen no more."""
        for ear in (*self._plain, *self._named):
            ear.close()
        if self.node is not None:
            self.node.destroy_node()

    def look_around(self) -> None:
        """Note who publishes, and listen to whom that takes; once a second, from the main thread."""
        if self.deaf:
            return
        if follow(self._node, self._plain):
            self._note_boxes()  # as a whole: the simulation thread looks into it
        follow(self._node, self._named)
        self._heard = {ear.topic for ear in self._named if self._node.count_publishers(ear.topic)}
        self.commanded = bool(self._heard) or any(self._node.count_publishers(ear.topic) for ear in self._plain)

    def poll(self) -> None:
        """Hand what is new to the latch; on the simulation thread."""
        if self.deaf:
            return
        now = time.monotonic()
        every = now >= self._next_look or self._latch.pace.lockstep
        if every:
            self._next_look = now + SELDOM
        if every or self.commanded:
            for take, kind, receive in self._boxes:
                taken = take(kind, False)
                if taken is not None:
                    self.commanded = True
                    receive(taken[0])
        for ear in self._named:
            if every or ear.topic in self._heard:
                for _ in range(10):
                    message = ear.take()
                    if message is None:
                        break
                    self.commanded = True
                    self._heard.add(ear.topic)
                    ear.receive(message)

    def _receiving(self, index: int, topic: str) -> Callable[[Any], None]:
        def receive(message: Any) -> None:
            value = self._accepted(index, topic, message.data)
            if value is not None:
                self._latch.command(index, value)

        return receive

    def _stamped(self, message: JointState) -> None:
        """Commands by their names, that answer the state of header.stamp; none of them: all hold."""
        values = self._by_name('lockstep_cmd', message)
        if values is None:
            return
        t_ns = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        if not self._latch.answer(t_ns, values):
            waiting = self._latch.waiting_ns * 1e-9
            self._warn(
                'answer',
                f'lockstep_cmd answers t = {t_ns * 1e-9:.6f} s, the state that is waiting is that of {waiting:.6f} s',
            )

    def _unstamped(self, message: JointState) -> None:
        """Commands by their names, the newest wins."""
        if not message.name and not message.position:
            self._refuse('wheel_cmd', 'wheel_cmd: names no command')
            return
        for index, value in (self._by_name('wheel_cmd', message) or {}).items():
            self._latch.command(index, value)

    def _by_name(self, topic: str, message: JointState) -> dict[int, float] | None:
        """The commands in a message by their places; None when one of them is refused."""
        values: dict[int, float] = {}
        if len(message.name) != len(message.position):
            self._refuse(
                topic, f'{topic}: {len(message.name)} names, {len(message.position)} positions; give one for each'
            )
            return None
        for name, number in zip(message.name, message.position):
            if name not in self.names:
                self._refuse(topic, f'{topic}: {name!r} is no command{suggestion(name, self.names)}')
                return None
            index = self.names.index(name)
            if index in values:
                self._refuse(topic, f'{topic}: {name!r} is named twice; name every command once')
                return None
            value = self._accepted(index, f'{topic}: {name}', number)
            if value is None:
                return None
            values[index] = value
        return values

    def _accepted(self, index: int, what: str, number: float) -> float | None:
        """The command within its limits; None for one that is not a number."""
        if not math.isfinite(number):
            self._refuse(f'{what} not finite', f'{what}: {number} is not a number; the command before it stays')
            return None
        if self.names[index] == 'gear':
            return self._gear(what, number)
        one = commanded(self.names[index])
        high = math.inf if one.limit is None else self._node.get_parameter(one.limit).value if one.limit else 1.0
        least, most = self.ends.get(self.names[index], (-math.inf, math.inf))
        value = min(max(number, -high if one.signed else 0.0, least), high, most)
        if value != number:
            whose = f' (parameter {one.limit})' if one.limit else ''
            whose = ' (end stops of the steering)' if value in (least, most) else whose
            self._warn(what, f'{what}: {number:g} is beyond the limit; {value:g} is applied{whose}')
        return value

    def _gear(self, what: str, number: float) -> float | None:
        """The gear that is asked for, rounded as the gearbox does; None for one that there is not: another one would be
        worse than none."""
        gear = math.floor(number + 0.5)
        low, high = self.gears or (gear, gear)
        if not low <= gear <= high:
            reverse = ', -1 is the reverse gear' if low < 0 else '; there is no reverse gear'
            text = f'{what}: {number:g} is no gear: there are 1 to {high}, 0 is neutral{reverse}; the gear stays'
            self._refuse(f'{what} no gear', text)
            return None
        return float(gear)

    def _refuse(self, about: str, text: str) -> None:
        self.refused += 1
        self._warn(about, text)

    def _warn(self, about: str, text: str) -> None:
        now = time.monotonic()
        if now - self._warned.get(about, -math.inf) >= WARN_SECONDS:
            self._warned[about] = now
            self._node.get_logger().warning(text)
