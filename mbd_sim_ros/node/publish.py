"""Publishing encoded messages with rclpy: bytes go out as they are, after one check that ROS reads the same numbers in
them."""

from __future__ import annotations

import math
import os
import time
from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from mbd_sim_ros.messages.cdr import decode
from mbd_sim_ros.messages.definitions import schema_text
from mbd_sim_ros.messages.topics import Topic, family
from mbd_sim_ros.node.graph import SAID_HERE
from mbd_sim_ros.node.parameters import RATES
from mbd_sim_ros.node.periods import due
from solver.errors import SpecError


def leave_sending_to_the_middleware() -> None:
    """Have Fast DDS send from a thread of its own, unless the user has chosen otherwise; before the first node is made.

    Publishing then costs the simulation thread less than half, for more CPU time in all
    (docs/decisions/0006-asynchronous-publishing.md). Other middlewares ignore it.
    """
    os.environ.setdefault('RMW_FASTRTPS_PUBLICATION_MODE', 'ASYNCHRONOUS')


def message_class(message_type: str) -> Any:
    """Return the Python class of e.g. 'sensor_msgs/msg/JointState'; ImportError if its package is not installed."""
    package, name = message_type.split('/msg/')
    return getattr(import_module(f'{package}.msg'), name)


def profile(topic: Topic) -> QoSProfile:
    """Return the quality of service of a topic."""
    return QoSProfile(
        depth=topic.depth,
        reliability=ReliabilityPolicy.RELIABLE if topic.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if topic.latched else DurabilityPolicy.VOLATILE,
    )


def assign(message: Any, value: dict[str, Any]) -> Any:
    """Set the fields of a ROS message from nested dicts (see cdr.decode) and return it."""
    for name, item in value.items():
        current = getattr(message, name)
        if isinstance(item, dict):
            assign(current, item)
        elif isinstance(item, list) and item and isinstance(item[0], dict):
            # The class of the elements is not stored in an empty sequence: it is in the message's type description.
            kind = (
                message.get_fields_and_field_types()[name]
                .removeprefix('sequence<')
                .removesuffix('>')
                .replace('/', '/msg/', 1)
            )
            setattr(message, name, [assign(message_class(kind)(), one) for one in item])
        elif isinstance(item, np.ndarray):
            setattr(message, name, np.array(item) if isinstance(current, np.ndarray) else item.tolist())
        else:
            setattr(message, name, item.item() if isinstance(item, np.generic) else item)
    return message


HEARD = 0.1  # s between looks for subscribers of a topic
ORDER = tuple(RATES)  # what matters most comes first
SHARED = ('joint_states', 'tf')  # what several nodes may publish parts of
# what is answered in lockstep: of every state that waits, or nobody could, and of no other one
ANSWERED = ('cmd_applied', 'odom')


def rated(topic: str) -> str:
    """The name that a topic has in parameters."""
    return 'tire_force' if topic.startswith('tire/') else family(topic.strip('/'))


@dataclass
class Channel:
    """A topic that is published.

    kind: class of its messages where they are not published as they are. periods: a step has a message whose number is
    a multiple of one of these. heard: somebody subscribes to it, or may later and has to get the last message all the
    same.
    """

    place: int  # among the encoded messages
    topic: Topic
    publisher: Publisher
    kind: Any
    periods: tuple[int, ...] = (1,)
    heard: bool = True

    @property
    def answered(self) -> bool:
        """True where it is one of ANSWERED."""
        return self.topic.name in ANSWERED


class Publication:
    """One publisher per topic for messages that come encoded.

    At the start every message is read back by the middleware's own decoder; a type for which that does not give the
    same numbers is published as an ordinary message instead (slower). Types that are not installed (tf2_msgs without
    ROS) are left out, as are the topics named in `silent`. Topics are published in the order of ORDER, so that what
    matters most is never dropped first: dropped counts, by topic, the messages that found no time (see publish). Raises
    SpecError for what ROS takes for no name of a topic.
    """

    def __init__(
        self, node: Node, topics: Sequence[Topic], samples: Sequence[bytes | None], *, silent: Sequence[str] = ()
    ) -> None:
        self.channels: list[Channel] = []  # in the order of ORDER
        self._looked, self._next = -math.inf, 0  # clock reading; place among the channels
        self._look_again = -math.inf  # clock reading of the next look
        self.dropped: Counter[str] = Counter()
        for i in sorted(range(len(topics)), key=lambda i: ORDER.index(rated(topics[i].name))):
            topic, sample = topics[i], samples[i]
            if rated(topic.name) in silent:
                continue
            try:
                kind = message_class(topic.type)
            except ImportError:
                node.get_logger().info(f'{topic.name} is not published: {topic.type} is not installed')
                continue
            try:
                publisher = node.create_publisher(kind, topic.name, profile(topic), **SAID_HERE)
            except InvalidTopicNameException as error:
                self.close(node)
                raise SpecError(
                    f'topic {topic.name!r}: names of topics have letters, digits and _, no digit first; rename what is '
                    'called so'
                ) from error
            assert sample is not None
            value, _ = decode(topic.type, schema_text(topic.type), sample)
            plain = deserialize_message(sample, kind) == assign(kind(), value)
            if not plain:
                node.get_logger().warning(
                    f'{topic.name}: ROS reads other numbers in the encoded message; publishing ordinary messages'
                )
            self.channels.append(Channel(i, topic, publisher, None if plain else kind))
        self._note_heard()

    def close(self, node: Node) -> None:
        """Publish no more."""
        for channel in self.channels:
            node.destroy_publisher(channel.publisher)

    def names(self) -> list[str]:
        """Full names of the topics that nobody else should publish."""
        return [channel.publisher.topic_name for channel in self.channels if rated(channel.topic.name) not in SHARED]

    def every(self, steps: Mapping[str, int], poses_every: int, of: int = 1) -> None:
        """Publish a topic only at steps whose number is a multiple of steps[its name in RATES], and of `of`.

        /tf is published also where it places all bodies.
        """
        for channel in self.channels:
            name = rated(channel.topic.name)
            also = (poses_every,) if name == 'tf' and poses_every else ()
            channel.periods = tuple([math.lcm(period, of) for period in (steps.get(name, 1), *also)])
        self._note_heard()

    def due(self, k: int, *, waits: bool | None = None) -> list[Channel]:
        """The topics of which step k has a message for somebody.

        waits: whether lockstep waits to have this step answered; None: in the other modes. A step that waits has a
        message also where nobody subscribes, as far as the last look has seen, and one of ANSWERED whatever their
        rates; one that does not has none of these. Otherwise who comes later than its last look for subscribers, HEARD
        ago at most, misses what was published since.
        """
        self._look()
        if waits is None:
            return [channel for channel in self._heard if due(k, channel.periods)]
        if waits:
            return [channel for channel in self.channels if channel.answered or due(k, channel.periods)]
        return [channel for channel in self._heard if not channel.answered and due(k, channel.periods)]

    def periods(self, *, lockstep: bool = False) -> Set[int]:
        """A step is due whose number is a multiple of one of these. lockstep: of steps that it does not wait to have
        answered."""
        self._look()
        return self._unanswered if lockstep else self._periods

    def _look(self) -> None:
        """See who subscribes to the topics in turn, to each every HEARD: to all of them at once takes half of a step of
        1 ms."""
        now = time.perf_counter()
        if now < self._look_again or not self.channels:
            return
        count = len(self.channels)
        due = max(int(min(count * (now - self._looked) / HEARD, count)), 1)
        changed = False
        for _ in range(due):
            channel = self.channels[self._next]
            heard = channel.topic.latched or channel.publisher.get_subscription_count() > 0
            changed, channel.heard = changed or heard != channel.heard, heard
            self._next = (self._next + 1) % count
        self._looked = now if due == count else self._looked + due * HEARD / count
        self._look_again = self._looked + HEARD / count
        if changed:
            self._note_heard()

    def _note_heard(self) -> None:
        """Keep for every step what changes seldom: the channels that are heard, and the periods of their messages
        [steps]."""
        self._heard = [channel for channel in self.channels if channel.heard]
        self._periods: Set[int] = {period for channel in self._heard for period in channel.periods}
        self._unanswered: Set[int] = {
            period for channel in self._heard if not channel.answered for period in channel.periods
        }

    def publish(self, messages: Sequence[bytes | None], channels: Sequence[Channel], budget: float = 0.0) -> None:
        """Publish one message for each of these topics, where there is one; what is not begun after `budget` [s] is
        dropped."""
        end, late = time.perf_counter() + budget if budget > 0.0 else math.inf, False
        for channel in channels:
            data = messages[channel.place]
            if data is None:
                continue
            if late:
                self.dropped[rated(channel.topic.name)] += 1
                continue
            if channel.kind is None:
                channel.publisher.publish(data)
            else:
                topic = channel.topic
                channel.publisher.publish(assign(channel.kind(), decode(topic.type, schema_text(topic.type), data)[0]))
            late = end < math.inf and time.perf_counter() > end
