"""Mismatches in the ROS graph around a node: types and qualities of service that let no message through, and second
publishers.

ROS delivers nothing between a publisher and a subscription of different types, and the middleware says nothing of it;
of qualities of service that do not match it says that there are some, and not whose. A subscription of this program
follows who publishes where that costs nothing (`Ear`); all else is told by `Graph`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from typing import Any, NamedTuple

from rclpy._rclpy_pybind11 import RCLError
from rclpy.duration import Duration, Infinite
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

SECONDS = 1.0  # between looks at who publishes and subscribes, for those nodes that have no timer for it
NO_NODE = 'somebody who is no node'
UNNAMED = '_NODE_NAME_UNKNOWN_'  # of a node that is not known yet, or of a participant that is no node
# What rclpy would say by itself of qualities of service, without the name of the node; and each costs the executor a
# look at every turn.
SAID_HERE: dict[str, Any] = {'event_callbacks': PublisherEventCallbacks(use_default_callbacks=False)}
HEARD_HERE: dict[str, Any] = {'event_callbacks': SubscriptionEventCallbacks(use_default_callbacks=False)}


def type_name(kind: Any) -> str:
    """Name of the class of a message as the graph has it: 'geometry_msgs/msg/Twist'."""
    return f'{kind.__module__.partition(".")[0]}/msg/{kind.__name__}'


def full_name(endpoint: TopicEndpointInfo) -> str:
    """Name of the node of an endpoint with its namespace; '' while it is unknown."""
    name, space = endpoint.node_name, endpoint.node_namespace
    return '' if not name or name == UNNAMED else f'{space.rstrip("/")}/{name}'


class Ear:
    """A subscription that follows who publishes, whenever `follow` is called.

    It takes the first of `kinds` (class of the message -> what receives it) unless all who publish have another one of
    them, and is reliable unless one of them publishes best effort: a reliable subscription is not given what they
    publish, and a best effort one is given all. It is polled (`take`) where polled is set, for which its handle is
    held, else an executor spins it.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        kinds: Mapping[Any, Callable[[Any], None]],
        *,
        depth: int,
        durability: DurabilityPolicy = DurabilityPolicy.VOLATILE,
        polled: bool = False,
    ) -> None:
        self.node, self.topic, self.kinds, self._name = node, node.resolve_topic_name(topic), kinds, topic
        self.kind, self.reliability = next(iter(kinds)), ReliabilityPolicy.RELIABLE
        self.subscription: Subscription | None = None
        self._depth, self._durability, self._polled = depth, durability, polled
        self._held, self._retired = ExitStack(), ExitStack()
        self._listen(*self._wanted())

    @property
    def receive(self) -> Callable[[Any], None]:
        """Function that is called with the messages."""
        return self.kinds[self.kind]

    def take(self) -> Any:
        """The next message of a subscription that is polled, or None."""
        assert self.subscription is not None
        taken = self.subscription.handle.take_message(self.kind, False)
        return None if taken is None else taken[0]

    def follow(self) -> bool:
        """Listen anew where who publishes wants it; whether that happened.

        The subscription before may be in use in another thread: it is kept until the next call. One of another type has
        to be gone first, for a participant has one type for a topic; where it is not, the next call tries again.
        """
        self._retired.close()
        wanted = self._wanted()
        if self.subscription is not None and wanted == (self.kind, self.reliability):
            return False
        if wanted[0] is not self.kind:
            self.subscription = None
            self._held.close()
        return self._listen(*wanted)

    def close(self) -> None:
        """Listen no more."""
        self._retired.close()
        self._held.close()

    def _listen(self, kind: Any, reliability: ReliabilityPolicy) -> bool:
        profile = QoSProfile(depth=self._depth, reliability=reliability, durability=self._durability)
        try:
            made = self.node.create_subscription(kind, self._name, self.kinds[kind], profile, **HEARD_HERE)
        except RCLError:
            return False
        self._retired = self._held.pop_all()
        if self._polled:
            self._held.enter_context(made.handle)
        self._held.callback(self.node.destroy_subscription, made)
        self.subscription, self.kind, self.reliability = made, kind, reliability
        return True

    def _wanted(self) -> tuple[Any, ReliabilityPolicy]:
        """Type and reliability by who publishes; as they are while nobody does."""
        if not self.node.count_publishers(self.topic):
            return self.kind, self.reliability
        there = self.node.get_publishers_info_by_topic(self.topic)
        names = {type_name(kind): kind for kind in self.kinds}
        found = [one for one in there if one.topic_type in names]
        if not found:
            return self.kind, self.reliability
        now = type_name(self.kind)
        kind = now if any(one.topic_type == now for one in found) else found[0].topic_type
        best = any(
            one.topic_type == kind and one.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT for one in found
        )
        return names[kind], ReliabilityPolicy.BEST_EFFORT if best else ReliabilityPolicy.RELIABLE


class _Seen(NamedTuple):
    """Findings about a topic."""

    of: tuple[Any, ...]  # another one: it is out of date
    sentences: tuple[str, ...]
    others: tuple[str, ...]  # nodes that publish what this one alone should
    unnamed: frozenset[tuple[int, ...]]  # endpoints whose node was not known yet
    again: bool  # some of them were new: who they are may be known at the next look


class Graph:
    """Tells what of the topics of some nodes of this process does not match who is on the other side; each sentence
    once, while it holds.

    alone: what follows where somebody else publishes on a topic that is published here, and what to do; '': nothing. A
    topic is looked at closely when the number of its publishers or subscriptions has changed, and else in turn: that
    takes 50 us, and the counts take 5 us.
    """

    def __init__(self, node: Node, alone: Callable[[str], str] = lambda topic: '') -> None:
        self._node, self._alone = node, alone
        self._seen: dict[str, _Seen] = {}
        self._said: set[str] = set()
        self._turn = 0

    def look(self, *nodes: Node) -> list[str]:
        """Present mismatches, one sentence each, the more important ones first; new ones are logged as warnings."""
        ours: dict[str, tuple[list[Publisher], list[Subscription]]] = {}
        for node in nodes:
            for publisher in node.publishers:
                ours.setdefault(publisher.topic_name, ([], []))[0].append(publisher)
            for subscription in node.subscriptions:
                ours.setdefault(subscription.topic_name, ([], []))[1].append(subscription)
        own = {node.get_fully_qualified_name() for node in nodes}
        self._turn += 1
        turn = list(ours)[self._turn % len(ours)] if ours else ''
        self._seen = {topic: self._looked(topic, *ends, own, anyway=topic == turn) for topic, ends in ours.items()}
        found = self._others() + [text for seen in self._seen.values() for text in seen.sentences]
        for text in found:
            if text not in self._said:
                self._node.get_logger().warning(text)
        self._said = set(found)
        return found

    def _others(self) -> list[str]:
        """Who else publishes what this node alone should."""
        topics: dict[tuple[str, str], list[str]] = {}
        for topic, seen in self._seen.items():
            for who in seen.others:
                topics.setdefault((who, self._alone(topic)), []).append(topic)
        return [
            f'{who} publishes {", ".join(sorted(names))} too: {follows}' for (who, follows), names in topics.items()
        ]

    def _looked(
        self, topic: str, publishers: list[Publisher], subscriptions: list[Subscription], own: set[str], *, anyway: bool
    ) -> _Seen:
        """Findings about a topic; those of before where nothing has changed."""
        node, before = self._node, self._seen.get(topic)
        ends: list[Publisher | Subscription] = [*publishers, *subscriptions]
        here = [(end.msg_type, end.qos_profile.reliability) for end in ends]
        of = (node.count_publishers(topic), node.count_subscribers(topic), *here)
        if before is not None and before.of == of and not before.again and not anyway:
            return before
        publishing = [one for one in node.get_publishers_info_by_topic(topic) if full_name(one) not in own]
        hearing = (
            [one for one in node.get_subscriptions_info_by_topic(topic) if full_name(one) not in own]
            if publishers
            else []
        )
        unnamed = frozenset(tuple(one.endpoint_gid) for one in (*publishing, *hearing) if not full_name(one))
        new = unnamed - (before.unnamed if before is not None else frozenset())
        publishing, hearing = (
            [one for one in side if tuple(one.endpoint_gid) not in new] for side in (publishing, hearing)
        )
        sentences, others = [], []
        for one in publishing:
            who = full_name(one) or NO_NODE
            if subscriptions:
                sentences.append(min((_unmatched(topic, who, one, end) for end in subscriptions), key=len))
            if publishers:
                kind = type_name(publishers[0].msg_type)
                if one.topic_type != kind:
                    sentences.append(
                        f'{topic}: {who} publishes {one.topic_type}, and this node {kind}; rename one of the two (-r '
                        'OLD:=NEW)'
                    )
                elif self._alone(topic):
                    others.append(who)
        for one in hearing:
            who = full_name(one) or NO_NODE
            sentences.append(min((_unmatched(topic, who, one, end) for end in publishers), key=len))
        return _Seen(
            of, tuple(dict.fromkeys(filter(None, sentences))), tuple(dict.fromkeys(others)), unnamed, bool(new)
        )


def _unmatched(topic: str, who: str, there: TopicEndpointInfo, here: Publisher | Subscription) -> str:
    """Why no message passes between an end of another node and one of this node; '' where messages pass."""
    theirs, ours, kind = there.qos_profile, here.qos_profile, type_name(here.msg_type)
    if isinstance(here, Publisher):
        does, answers, verb, to, reason = 'subscribes to', 'publishes', 'subscribe', ' to', _apart(ours, theirs)
    else:
        does, answers, verb, to, reason = 'publishes', 'subscribes to', 'publish', '', _apart(theirs, ours)
    if there.topic_type != kind:
        return (
            f'{topic}: {who} {does} {there.topic_type}, this node {answers} {kind}: no message passes; {verb}{to} '
            f'{kind}'
        )
    return f'{topic}: no message passes where {who} {verb}s: {reason}; {verb} {_quality(ours)}' if reason else ''


def _apart(publisher: QoSProfile, subscription: QoSProfile) -> str:
    """In what a publisher offers less than a subscription asks for; '' where it does not."""
    found, reason = qos_check_compatible(_finite(publisher), _finite(subscription))
    if found != QoSCompatibility.ERROR:
        return ''
    reasons = [text.removeprefix('ERROR: ') for text in reason.split(';') if text.startswith('ERROR: ')]
    return ' and '.join(text[:1].lower() + text[1:] for text in reasons)


def _finite(profile: QoSProfile) -> QoSProfile:
    """With no durations instead of infinite ones: the graph has these where none was given, and the check takes them
    for such."""
    limits = {name: getattr(profile, name) for name in ('deadline', 'liveliness_lease_duration')}
    limits = {name: Duration() if value == Infinite else value for name, value in limits.items()}
    return QoSProfile(
        depth=1, reliability=profile.reliability, durability=profile.durability, liveliness=profile.liveliness, **limits
    )


def _quality(profile: QoSProfile) -> str:
    """Quality of service that this node offers, or asks for, in the words of ROS."""
    reliable = 'best effort' if profile.reliability == ReliabilityPolicy.BEST_EFFORT else 'reliable'
    return (
        f'{reliable}, {"transient local" if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL else "volatile"}, '
        f'without deadline'
    )


class Watch:
    """Looks at the graph around a node every SECONDS of its turns, for nodes that have no timer: their ears follow, and
    `Graph` tells."""

    def __init__(self, node: Node, ears: Sequence[Ear] = ()) -> None:
        self._node, self._ears, self._graph = node, ears, Graph(node)
        self._next = time.monotonic() + SECONDS

    def look(self) -> None:
        """Look, if it is time to."""
        now = time.monotonic()
        if now < self._next:
            return
        self._next = now + SECONDS
        follow(self._node, self._ears)
        self._graph.look(self._node)


def follow(node: Node, ears: Sequence[Ear]) -> bool:
    """Have ears follow who publishes, and say so; whether one of them listens anew."""
    changed = [ear for ear in ears if ear.follow()]
    for ear in changed:
        lost = (
            ', and what is lost on the way is not sent again'
            if ear.reliability == ReliabilityPolicy.BEST_EFFORT
            else ''
        )
        way = 'best effort' if ear.reliability == ReliabilityPolicy.BEST_EFFORT else 'reliable'
        node.get_logger().info(f'{ear.topic}: {type_name(ear.kind)}, {way}, as it is published{lost}')
    return bool(changed)
