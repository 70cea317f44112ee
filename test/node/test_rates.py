"""What is published how often, and what is dropped when there is no time."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
import pytest
from client import client
from processes import start
from synthetic import WHEELS, Synthetic, scene

from mbd_sim_ros.messages.encode import Messages
from mbd_sim_ros.node.periods import before_next
from solver.errors import SpecError

pytestmark = pytest.mark.realtime

__all__ = ['client', 'start']  # fixtures

SUBSCRIBED = ('odom', 'cmd_applied')  # by the client


def test_topics_have_rates_of_their_own(start, client):
    start({'rate_odom': 50.0, 'rate_cmd_applied': 10.0})
    client.until(lambda: len(client.odom) > 30)
    stamps = [m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec for m in client.odom]
    np.testing.assert_array_equal(np.diff(stamps), 20_000_000)
    assert all(applied['step'] % 50 == 0 for applied in client.applied)
    ask(client, 'rate_odom', 0.0)
    seen = len(client.odom)
    client.until(lambda: len(client.odom) > seen + 60)
    stamps = [m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec for m in client.odom[-40:]]
    assert np.min(np.diff(stamps)) == 2_000_000


def test_a_rate_is_the_next_one_that_the_published_steps_have(start, client):
    """Steps of 2 ms. Of every fifth one, 100 a second, 60 are wanted: every other one is 50. Of every sixth: every
    other one, each 24 ms. Counted apart, every ninth step and every fifth are both there but 11 times a second."""
    start({'publish_every': 5, 'rate_odom': 60.0})
    for every, apart in ((5, 20_000_000), (6, 24_000_000)):
        ask(client, 'publish_every', every)
        client.odom.clear()
        client.until(lambda: len(client.odom) > 12)
        stamps = [m.header.stamp.sec * 1_000_000_000 + m.header.stamp.nanosec for m in client.odom[2:]]
        np.testing.assert_array_equal(np.diff(stamps), apart)


@pytest.mark.parametrize(
    ('rate', 'of', 'steps'),
    [(0.0, 5, 1), (1e6, 5, 5), (100.0, 1, 5), (100.0, 5, 5), (60.0, 1, 9), (60.0, 5, 10), (30.0, 5, 20)],
)
def test_messages_that_are_so_many_steps_apart_are_thinned_in_whole_numbers(rate: float, of: int, steps: int) -> None:
    """Steps of 2 ms; of: steps between the messages there are."""
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    from mbd_sim_ros.node.running import thinned

    assert thinned(rate, 0.002, of) == steps


def ask(client, name: str, value: float) -> None:
    """Set a parameter of the simulator."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    service = client.node.create_client(SetParameters, 'simulator/set_parameters')
    client.until(service.service_is_ready)
    future = service.call_async(SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()]))
    client.until(future.done)
    assert future.result().results[0].successful


def test_what_nobody_hears_is_not_published_but_in_lockstep(client, monkeypatch):
    """A topic is published from 0.1 s after somebody subscribed to it on."""
    from geometry_msgs.msg import WrenchStamped
    from rclpy.publisher import Publisher

    from mbd_sim_ros.node import publish

    simulation, sent = Synthetic(), []
    plain = Publisher.publish
    monkeypatch.setattr(
        Publisher, 'publish', lambda self, message: (sent.append(self.topic_name), plain(self, message))
    )
    messages = Messages.of(scene(), simulation)
    publication = publish.Publication(
        client.node, messages.topics, messages.encode(simulation.snapshot(), whole=True), silent=SUBSCRIBED
    )

    def step(**options: bool | None) -> None:
        snapshot = simulation.advance()
        publication.publish(messages.encode(snapshot), publication.due(snapshot.k, **options))

    def next_seen(k: int, most: int = 20) -> int:
        return k + 1 + before_next(k, most - 1, publication.periods())

    try:
        step()
        assert not sent
        step(waits=True)
        installed = {f'/{topic.name}' for topic in messages.topics if topic.name not in (*SUBSCRIBED, '/tf')}
        assert installed <= set(sent)
        everything = len(set(sent))  # /tf among it where its type is installed
        sent.clear()
        wheel = f'/tire/{WHEELS[1]}/force'
        heard = []
        client.node.create_subscription(WrenchStamped, wheel, heard.append, 10)

        def arrives() -> bool:
            step()
            return bool(heard)

        assert next_seen(simulation.k) == simulation.k + 20
        client.until(arrives)
        assert set(sent) == {wheel}
        place = [topic.name for topic in messages.topics].index(wheel.strip('/'))
        assert [channel.place for channel in publication.due(simulation.k)] == [place]  # nothing else is encoded
        assert len(publication.due(simulation.k, waits=True)) == everything
        assert next_seen(7) == 8
        publication.every({}, 0, 5)
        assert next_seen(7) == 10
        publication.every({'tire_force': 10}, 0)
        assert next_seen(7) == 10
        assert next_seen(7, 2) == 9
        publication.every({'tire_force': 10}, 0, 4)
        assert next_seen(10) == 20
    finally:
        publication.close(client.node)


def test_subscribers_are_looked_for_topic_by_topic(client, monkeypatch):
    """At all at first; then each every 0.1 s, and never at two in the same step of 1 ms."""
    from rclpy.publisher import Publisher

    from mbd_sim_ros.node import publish

    simulation, looked, now = Synthetic(), [], [100.0]
    messages = Messages.of(scene(), simulation)
    publication = publish.Publication(client.node, messages.topics, messages.encode(simulation.snapshot(), whole=True))
    count = Publisher.get_subscription_count
    monkeypatch.setattr(
        Publisher, 'get_subscription_count', lambda self: (looked.append(self.topic_name), count(self))[1]
    )
    monkeypatch.setattr(publish.time, 'perf_counter', lambda: now[0])
    try:
        publication.due(0)
        every = looked.copy()
        assert len(set(every)) == len(every) > 5
        looked.clear()
        for k in range(1, 201):
            now[0] += 1e-3
            before = len(looked)
            publication.due(k)
            assert len(looked) - before <= 1
        assert looked[: len(every)] == every
        assert 2 * len(every) - 1 <= len(looked) <= 2 * len(every)
        now[0] += 1.0  # nothing was published for a while
        looked.clear()
        publication.due(201)
        assert sorted(looked) == sorted(every)
    finally:
        publication.close(client.node)


def test_a_wheel_whose_name_is_no_name_of_a_topic_is_refused(client):
    from mbd_sim_ros.node.publish import Publication

    simulation = Synthetic()
    simulation.channels = dataclasses.replace(simulation.channels, wheels=('vorn links', *WHEELS[1:]))
    messages = Messages.of(scene(), simulation)
    before = len(list(client.node.publishers))
    with pytest.raises(SpecError, match="topic 'tire/vorn links/force': names of topics have letters, digits and _"):
        Publication(client.node, messages.topics, messages.encode(simulation.snapshot(), whole=True))
    assert len(list(client.node.publishers)) == before


def test_what_finds_no_time_is_dropped_last_things_first_and_named(start, client):
    """With no time at all only the first topic of every step is published: that with the acknowledgement of
    commands."""
    from geometry_msgs.msg import WrenchStamped

    for wheel in WHEELS:
        client.node.create_subscription(WrenchStamped, f'tire/{wheel}/force', lambda m: None, 1)
    start({'publish_budget': 1e-6})
    # subscribers are seen topic by topic: before that of cmd_applied another is the first
    client.until(lambda: len(client.applied) > 100)

    def dropped(array) -> Counter[str]:
        texts = [v.value for v in array.status[0].values if v.key == 'publishing dropped']
        return Counter(
            {topic: int(count) for topic, count in (item.rsplit(' ', 1) for text in texts for item in text.split(', '))}
        )

    def dropped_lately() -> Counter[str]:
        return dropped(client.diagnostics[-1]) - dropped(client.diagnostics[-2])

    def every_wheel_each_time() -> bool:
        lately = dropped_lately()
        # a report may come within a step
        return lately['odom'] > 50 and abs(lately['tire_force'] - 4 * lately['odom']) <= 4

    client.until(lambda: len(client.diagnostics) > 1 and every_wheel_each_time())
    heard, reports = len(client.odom), len(client.diagnostics)
    client.until(lambda: len(client.diagnostics) > reports + 1)
    assert every_wheel_each_time()
    assert 'cmd_applied' not in dropped(client.diagnostics[-1])
    assert len(client.odom) == heard
    ask(client, 'publish_budget', 0.0)
    client.until(lambda: len(client.odom) > 100)
