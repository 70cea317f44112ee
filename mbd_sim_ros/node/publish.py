"""Publishing encoded messages with rclpy: bytes go out as they are, after one check that ROS reads the same numbers in them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from mbd_sim_ros.messages.cdr import decode, schema_text
from mbd_sim_ros.messages.encode import Topic


def leave_sending_to_the_middleware() -> None:
    """Have Fast DDS send from a thread of its own, unless the user has chosen otherwise; before the first node is made.

    Publishing then costs the simulation thread less than half, for more CPU time in all (docs/decisions/0006-asynchronous-publishing.md).
    Other middlewares ignore it.
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
            kind = message.get_fields_and_field_types()[name].removeprefix('sequence<').removesuffix('>').replace('/', '/msg/', 1)
            setattr(message, name, [assign(message_class(kind)(), one) for one in item])
        elif isinstance(item, np.ndarray):
            setattr(message, name, np.array(item) if isinstance(current, np.ndarray) else item.tolist())
        else:
            setattr(message, name, item.item() if isinstance(item, np.generic) else item)
    return message


class Publication:
    """One publisher per topic for messages that come encoded.

    At the start every message is read back by the middleware's own decoder; a type for which that does not give the same
    numbers is published as an ordinary message instead (slower). Types that are not installed (tf2_msgs without ROS) are left out,
    as are the topics named in `silent`.
    """

    def __init__(self, node: Node, topics: Sequence[Topic], samples: Sequence[bytes | None], *, silent: Sequence[str] = ()) -> None:
        self._publishers: list[tuple[int, Publisher]] = []
        self._ordinary: list[tuple[int, Publisher, Topic, Any]] = []
        for i, (topic, sample) in enumerate(zip(topics, samples)):
            if topic.name in silent:
                continue
            try:
                kind = message_class(topic.type)
            except ImportError:
                node.get_logger().info(f'{topic.name} is not published: {topic.type} is not installed')
                continue
            publisher = node.create_publisher(kind, topic.name, profile(topic))
            assert sample is not None
            value, _ = decode(topic.type, schema_text(topic.type), sample)
            if deserialize_message(sample, kind) == assign(kind(), value):
                self._publishers.append((i, publisher))
            else:
                node.get_logger().warning(f'{topic.name}: ROS reads other numbers in the encoded message; publishing ordinary messages')
                self._ordinary.append((i, publisher, topic, kind))

    def publish(self, messages: Sequence[bytes | None]) -> None:
        """Publish one message per topic, where there is one."""
        for i, publisher in self._publishers:
            if messages[i] is not None:
                publisher.publish(messages[i])
        for i, publisher, topic, kind in self._ordinary:
            data = messages[i]
            if data is not None:
                publisher.publish(assign(kind(), decode(topic.type, schema_text(topic.type), data)[0]))
