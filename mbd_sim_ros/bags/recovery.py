"""Saving what a damaged recording, or one that was cut off, holds, and joining the files of one that was split."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import yaml
from mcap.records import Channel, Schema

from mbd_sim_ros.bags.accounts import SET_BACK
from mbd_sim_ros.bags.files import find_files, readable
from mbd_sim_ros.bags.records import TIME_MOST, Messages, Reading, instants
from mbd_sim_ros.bags.writer import RESULT, BagWriter
from mbd_sim_ros.messages.topics import DEPTH, Topic
from solver import stored
from solver.errors import BagError


class Recovered(NamedTuple):
    """Result of `recover`.

    damage: the fault of the source; empty: it was whole. lost: messages that are known to be
    missing. left_out: topics that cannot be copied, and why.
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
        """True where the source was whole."""
        return not self.damage


@dataclass
class _Part:
    """A file of a recording, seen through once. left_out: topics that cannot be copied, and why. span: first and last
    log time [ns]."""

    reading: Reading
    channels: dict[int, Topic] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    metadata: dict[str, Mapping[str, str]] = field(default_factory=dict)
    used: set[int] = field(default_factory=set)
    span: tuple[int, int] = (TIME_MOST, -1)

    @property
    def name(self) -> str:
        return self.reading.path.name


def recover(source: str | Path, destination: str | Path) -> Recovered:
    """Copy every complete chunk of a damaged recording, one that was cut off (or a whole one) into a new bag directory.

    Chunks behind a damaged one are copied too; the metadata of the new bag say what is missing in it. The files of a
    recording that was split become one. Raises BagError if the source is not MCAP, nothing complete is in it, its files
    are not of one recording, or the destination cannot be written.
    """
    texts: dict[str, str] = {}  # type -> its definition
    parts = [_look(path, texts) for path in find_files(source, unfinished=True)]
    _require_order(Path(source), parts)
    left_out = {topic: why for part in parts for topic, why in part.left_out.items()}
    if not any(part.used & part.channels.keys() for part in parts):
        why = (
            next((f': topic {topic}: {why}' for topic, why in left_out.items()), '')
            if any(part.used for part in parts)
            else ''
        )
        what = parts[0].reading.path if len(parts) == 1 else source
        raise BagError(
            f'{what} holds no complete chunk{" that can be copied" if why else ""}: nothing can be recovered{why}'
        )
    damage = [f'{part.name}: {what}' if len(parts) > 1 else what for part in parts for what in part.reading.damage]
    damage += [f'{name} is missing' for name in _missing(Path(source))]
    lost = sum(part.reading.lost for part in parts)
    metadata = {name: record for part in parts for name, record in part.metadata.items()}
    about = {'recovered_from': ', '.join(part.name for part in parts)}
    if damage:
        about |= {'damage': '; '.join(damage), 'lost_messages': str(lost)}
    metadata[RESULT] = {**metadata.get(RESULT, {}), **about}
    topics, places = _together(parts)
    arrays = {
        name: stored.packed(name)
        for part in parts
        for name in part.reading.attachments
        if stored.find(name) is not None
    }
    writer = BagWriter(destination, topics, metadata, schemas=texts, attachments=arrays)
    for part, place in zip(parts, places, strict=True):
        for record in Reading(part.reading.path, onwards=True):
            if isinstance(record, Messages) and record.channel in place:
                times = instants(record.times)
                for log_ns, published_ns, data in zip(
                    times[:, 0].tolist(), times[:, 1].view('<u8').tolist(), record.data
                ):
                    writer.write(log_ns, [(place[record.channel], data)], published_ns)
    directory = writer.finish()
    return Recovered(directory, sum(writer.count), writer.first_ns or 0, writer.last_ns, tuple(damage), lost, left_out)


def _look(path: Path, texts: dict[str, str]) -> _Part:
    """See through a file, and note the definitions of types."""
    part = _Part(Reading(path, onwards=True))
    schemas: dict[int, Schema] = {}
    declared: set[int] = set()
    for record in part.reading:
        if isinstance(record, Messages):
            part.used.add(record.channel)
            part.span = min(part.span[0], *record.log_times), max(part.span[1], *record.log_times)
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            declared.add(record.id)
            schema = schemas.get(record.schema_id)
            schema, problem = readable(record, schema)
            problem = problem or _other(schema, texts)
            if not problem and schema is not None:
                part.channels.setdefault(record.id, _topic(record, schema))
                part.left_out.pop(record.topic, None)
            elif record.id not in part.channels:
                part.left_out[record.topic] = problem
        else:
            part.metadata[record.name] = record.metadata
    part.left_out |= dict.fromkeys((f'channel {channel}' for channel in part.used - declared), 'it is not declared')
    return part


def _require_order(source: Path, parts: Sequence[_Part]) -> None:
    """Raise BagError where files do not follow each other as the parts of a recording do, which overlap by what is on
    its way at most."""
    spans = [(part.name, *part.span) for part in parts if part.used]
    for (before, _, end), (after, begin, _) in pairwise(spans):
        if begin < end - SET_BACK:
            raise BagError(
                f'{source}: {after} begins {(end - begin) * 1e-9:.6g} s before {before} ends: '
                'these are not the parts of one recording; name one of them'
            )


def _together(parts: Sequence[_Part]) -> tuple[list[Topic], list[dict[int, int]]]:
    """The topics of all files, and for every file: channel -> place of its topic. Channels of one name in a file stay
    apart."""
    topics: dict[tuple[str, str, int], Topic] = {}
    places = []
    for part in parts:
        count: Counter[tuple[str, str]] = Counter()
        place = {}
        for channel, topic in part.channels.items():
            key = topic.name, topic.type, count[topic.name, topic.type]
            count[topic.name, topic.type] += 1
            topics.setdefault(key, topic)
            place[channel] = list(topics).index(key)
        places.append(place)
    return list(topics.values()), places


def _missing(source: Path) -> list[str]:
    """Files of which the metadata.yaml of a directory speaks and that are not there."""
    try:
        named = yaml.safe_load((source / 'metadata.yaml').read_text(encoding='utf-8'))['rosbag2_bagfile_information'][
            'relative_file_paths'
        ]
        return [name for name in named if not (source / name).is_file()]
    except (OSError, ValueError, LookupError, TypeError, yaml.YAMLError):
        # it is no directory, or has none, or a broken one
        return []


def _topic(channel: Channel, schema: Schema) -> Topic:
    """A topic with the quality of service that it was recorded with, in the words of rosbag2 or in its older
    numbers."""
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
