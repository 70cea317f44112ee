"""Reading recordings: a bag becomes a `Run`, per topic its instants and named columns (columns.py).

What is not whole is not read: `mbd recover` (recovery.py) makes a whole one of what there is.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, Schema

from mbd_sim_ros.bags.columns import Collector, Room, Series
from mbd_sim_ros.bags.patterns import fits_any
from mbd_sim_ros.bags.records import Messages, Reading, find_file, message_counts
from mbd_sim_ros.bags.writer import RECORD, RESULT
from mbd_sim_ros.messages.topics import ELEMENTS, INPUTS, family
from solver.errors import BagError, suggestion

NOT_SIGNALS = ('tf', 'tf_static', 'robot_description', INPUTS.name)  # topics that are no columns


@dataclass
class Run:
    """One run: a series per topic, each at its own instants.

    `time_ns` and `columns` are all of them on one common grid, NaN where a topic has no message.
    left_out: topic -> why its messages could not be read. known: topic -> its channels, also those that were not asked for. stated: column
    -> the unit that the header of a table gives its numbers in; mapping.py brings them to SI. told: what reading dropped or assumed, a
    sentence each.
    """

    series: dict[str, Series]
    metadata: dict[str, str] = field(default_factory=dict)  # see recorder.describe
    left_out: dict[str, str] = field(default_factory=dict)
    known: dict[str, tuple[str, ...]] = field(default_factory=dict)
    stated: dict[str, str] = field(default_factory=dict)
    told: tuple[str, ...] = ()

    @cached_property
    def time_ns(self) -> np.ndarray:
        """All instants [ns], ascending."""
        grids = [one.time_ns for one in self.series.values()]
        if all(np.array_equal(grid, grids[0]) for grid in grids[1:]):
            return grids[0]
        return np.unique(np.concatenate(grids))

    @cached_property
    def columns(self) -> dict[str, np.ndarray]:
        """All columns on the common grid."""
        return {name: values for one in self.series.values() for name, values in one.on(self.time_ns).items()}

    @property
    def time(self) -> np.ndarray:
        """Time in seconds."""
        return self.time_ns * 1e-9

    @property
    def names(self) -> tuple[str, ...]:
        """All channels of the recording, also those that were not asked for."""
        known = self.known or {topic: tuple(one.columns) for topic, one in self.series.items()}
        return tuple(name for names in known.values() for name in names)

    @property
    def events(self) -> list[dict[str, Any]]:
        """Changes of step and penalties in the run, in order: the fields of solver.step.adaptation.Event. Raises BagError."""
        return self._said('event_list', list, dict)

    @property
    def findings(self) -> list[dict[str, Any]]:
        """What makes the run suspect (solver.analysis.verdict.report). Raises BagError."""
        return self._said('findings', list, dict)

    @property
    def joint_kinds(self) -> dict[str, str]:
        """Joint coordinate -> 'rotation' or 'translation', where the recording tells. Raises BagError."""
        return self._said('joint_kinds', dict, str)

    @property
    def element_kinds(self) -> dict[str, str]:
        """Element on joint coordinates -> 'rotation' or 'translation', where the recording tells. Raises BagError."""
        return self._said('element_kinds', dict, str)

    def _said(self, key: str, kind: type, item: type) -> Any:
        """An entry of the metadata in JSON: a list or dict of items of one type."""
        text = self.metadata.get(key)
        if text is None:
            return kind()
        try:
            value = json.loads(text)
        except (ValueError, RecursionError):
            value = None
        items = value.values() if isinstance(value, dict) else value
        if not isinstance(value, kind) or not all(isinstance(one, item) for one in items):
            shown = text if len(text) <= 40 else text[:37] + '...'
            raise BagError(f'the recording is damaged: its metadata say {key} = {shown!r}, which is not what this package writes')
        return value

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.columns:
            raise BagError(f'the recording has no column {name!r}' + suggestion(name, self.columns))
        return self.columns[name]


def read(path: str | Path, channels: Sequence[str] = ()) -> Run:
    """Read a bag directory or an .mcap file. channels: shell patterns of the columns to read ('odom/*'); all without any.

    Raises BagError if it is not a recording, is empty, or is not whole.
    """
    path = find_file(path)
    namespace = ''
    expected = message_counts(path)
    room = Room(path.stat().st_size)
    schemas: dict[int, Schema] = {}
    collectors: dict[tuple[str, int], Collector] = {}  # by topic and schema: several publishers are one topic
    of_channel: dict[int, Collector] = {}
    left_out: dict[str, str] = {}
    metadata: dict[str, dict[str, str]] = {}
    skip: set[int] = set()

    def wanted(name: str) -> bool:
        return not channels or fits_any(name, channels)

    reading = Reading(path, skip=skip, channels=expected)
    for record in reading:
        if isinstance(record, Messages):
            one = of_channel.get(record.channel)
            if one is None:
                if record.channel not in skip:
                    left_out[f'channel {record.channel}'] = 'it is not declared'
                    skip.add(record.channel)
                continue
            one.add(record)
            if one.idle:
                skip.add(record.channel)
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            if record.id in of_channel or record.id in skip:
                continue
            schema = schemas.get(record.schema_id)
            topic = record.topic.strip('/').removeprefix(namespace + '/' if namespace else '')
            problem = unreadable(record, schema)
            if topic in NOT_SIGNALS or problem or schema is None:
                skip.add(record.id)
                if topic not in NOT_SIGNALS:
                    left_out[topic] = problem
                continue
            fresh = Collector(record.topic, family(topic), schema, wanted, room)
            one = of_channel[record.id] = collectors.setdefault((record.topic, record.schema_id), fresh)
            one.expected += expected.get(record.id, 0)
        else:
            metadata[record.name] = record.metadata
            namespace = metadata.get(RECORD, {}).get('namespace', '').strip('/')
    reading.require_whole()
    series: dict[str, Series] = {}
    known: dict[str, tuple[str, ...]] = {}
    for one in collectors.values():
        found = one.series()
        others = known.get(one.name, ())
        apart = one.name == ELEMENTS and not set(others) & set(one.known)
        problem = one.problem or ('another topic has the same name' if others and one.known and not apart else '')
        if problem:
            left_out[one.name if one.name not in series else f'{one.name} ({one.type})'] = problem
        elif one.known:
            known[one.name] = (*others, *one.known)
            if found is not None:
                series[one.name] = series[one.name].joined(found) if one.name in series else found
    if not series and left_out:
        topic, problem = next(iter(left_out.items()))
        raise BagError(f'{path} holds nothing that can be read: topic {topic}: {problem}')
    if not known:
        raise BagError(f'{path} holds no messages')
    return Run(series, {**metadata.get(RECORD, {}), **metadata.get(RESULT, {})}, left_out, known)


def unreadable(channel: Channel, schema: Schema | None) -> str:
    """Why the messages of a channel cannot be decoded here; '' if they can."""
    if channel.message_encoding != 'cdr':
        return f'its messages are encoded as {channel.message_encoding!r}, not as cdr'
    if schema is None:
        return 'its type is not defined'
    return '' if schema.encoding == 'ros2msg' else f'its type is defined in {schema.encoding!r}, not in ros2msg'
