"""Recordings as `ros2 bag record` makes them of our node: log times of the wall clock, stamps in simulation time, no
metadata of ours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from foreign_bags import DAY, MS, STRING, Message, text, write

from mbd_sim_ros.bags.published import load_published, tell
from mbd_sim_ros.messages.encode import Messages
from solver import simulation_of

WALL = 1_300_000  # ns between steps on the wall clock, of which several topics have the same


def node_messages(
    scene: str,
    overrides: Sequence[str] = (),
    *,
    steps: int,
    begin: int = 0,
    every: dict[str, int] | None = None,
    namespace: str = '',
    prefix: str = '',
    repeats: int = 0,
    told: bool = True,
    drive: Callable[[Any], None] | None = None,
) -> list[Message]:
    """What a node that runs a scene publishes up to a step, recorded from step `begin` on, in order. every: topic ->
    steps between its messages. repeats: times that the first state is published again before the next, all bodies too,
    as a paused node does. told: the scene is recorded too. drive: called with the simulation before its first step."""
    loaded = load_published(scene, overrides)
    simulation = simulation_of(loaded)
    if drive is not None:
        drive(simulation)
    messages = Messages.of(loaded, simulation, prefix)
    found, lead = [], f'/{namespace}' if namespace else ''
    if told:
        found.append(text(f'{lead}/simulator/scene', DAY, DAY, tell(loaded, simulation)))

    def publish(data: Sequence[bytes | None], k: int) -> None:
        for topic, one in zip(messages.topics, data, strict=True):
            if one is not None and k % (every or {}).get(topic.name, 1) == 0:
                name = topic.name if topic.name.startswith('/') else f'{lead}/{topic.name}'
                now = DAY + len(found) // 3 * WALL
                found.append(Message(name, topic.type, now, now, one))

    first = simulation.k
    for k in range(first, steps + 1):
        snapshot = simulation.snapshot() if k == first else simulation.advance(1)
        if k >= begin:
            publish(messages.encode(snapshot), k)
            if k == max(begin, first):
                for _ in range(repeats):
                    publish(messages.encode(snapshot, whole=True), 0)
    return found


def node_bag(place: Path, scene: str, overrides: Sequence[str] = (), *, kind: str = 'mcap', **options: Any) -> Path:
    """A recording of node_messages()."""
    return write(place, node_messages(scene, overrides, **options), kind)


__all__ = ['DAY', 'MS', 'STRING', 'node_bag', 'node_messages']
