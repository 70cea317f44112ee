"""Saving what a damaged recording, or one that was cut off, holds."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from mcap.records import Channel, Schema

from mbd_sim_ros.bags.reader import unreadable
from mbd_sim_ros.bags.records import Messages, Reading, find_file
from mbd_sim_ros.bags.writer import RESULT, BagWriter
from mbd_sim_ros.messages.topics import DEPTH, Topic
from solver.errors import BagError


class Recovered(NamedTuple):
    """What `recover` saved.

    damage: what was wrong with the source; empty: it was whole. lost: messages that are known to be missing. left_out: topics that cannot
    be copied, and why.
    """

    directory: Path
    messages: int
    start_ns: int
    end_ns: int
    damage: tuple[str, ...]
    lost: int
    left_out: dict[str, str]

    @property
    def complete(self) -> bool:
        """Whether the source was whole."""
        return not self.damage


def recover(source: str | Path, destination: str | Path) -> Recovered:
    """Copy every complete chunk of a damaged recording, one that was cut off (or a whole one) into a new bag directory.

    Chunks behind a damaged one are copied too; the metadata of the new bag say what is missing in it.
    Raises BagError if the source is not MCAP, nothing complete is in it, or the destination cannot be written.
    """
    path = find_file(source, unfinished=True)
    schemas: dict[int, Schema] = {}
    channels: dict[int, Topic] = {}
    texts: dict[str, str] = {}  # type -> its definition
    left_out: dict[str, str] = {}
    metadata: dict[str, Mapping[str, str]] = {}
    used: set[int] = set()
    declared: set[int] = set()
    first = Reading(path, onwards=True)
    for record in first:
        if isinstance(record, Messages):
            used.add(record.channel)
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            declared.add(record.id)
            schema = schemas.get(record.schema_id)
            problem = unreadable(record, schema) or _other(schema, texts)
            if not problem and schema is not None:
                channels.setdefault(record.id, _topic(record, schema))
                left_out.pop(record.topic, None)
            elif record.id not in channels:
                left_out[record.topic] = problem
        else:
            metadata[record.name] = record.metadata
    if not used & channels.keys():
        why = next((f': topic {topic}: {problem}' for topic, problem in left_out.items()), '') if used else ''
        raise BagError(f'{path} holds no complete chunk{" that can be copied" if why else ""}: nothing can be recovered{why}')
    left_out |= dict.fromkeys((f'channel {channel}' for channel in used - declared), 'it is not declared')
    about = {'recovered_from': path.name}
    if first.damage:
        about |= {'damage': '; '.join(first.damage), 'lost_messages': str(first.lost)}
    metadata[RESULT] = {**metadata.get(RESULT, {}), **about}
    place = {channel: i for i, channel in enumerate(channels)}
    writer = BagWriter(destination, list(channels.values()), metadata, schemas=texts)
    for record in Reading(path, onwards=True):
        if isinstance(record, Messages) and record.channel in place:
            for log_time, data in zip(record.log_times, record.data):
                writer.write(log_time, [(place[record.channel], data)])
    directory = writer.finish()
    return Recovered(directory, sum(writer.count), writer.first_ns or 0, writer.last_ns, tuple(first.damage), first.lost, left_out)


def _topic(channel: Channel, schema: Schema) -> Topic:
    """A topic with the quality of service that it was recorded with, in the words of rosbag2 or in its older numbers."""
    profile = channel.metadata.get('offered_qos_profiles', '')
    depth = re.search(r'\bdepth: *([1-9][0-9]{0,5})\b', profile)
    return Topic(
        channel.topic,
        schema.name,
        depth=int(depth[1]) if depth else DEPTH,
        reliable=not re.search(r'\breliability: *(best_effort|2)\b', profile),
        latched=bool(re.search(r'\bdurability: *(transient_local|1)\b', profile)),
    )


def _other(schema: Schema | None, texts: dict[str, str]) -> str:
    """Note the definition of a type; why it cannot be copied, where it cannot."""
    if schema is None:
        return ''
    try:
        text = schema.data.decode()
    except UnicodeDecodeError:
        return 'its definition is not UTF-8 text'
    return '' if texts.setdefault(schema.name, text) == text else f'{schema.name} is defined in two ways'
