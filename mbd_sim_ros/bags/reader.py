"""Reader of recordings: a bag becomes a `Run`, with a series of named columns for each topic (columns.py).

A damaged recording is refused; `mbd recover` (recovery.py) makes a whole recording of its undamaged part.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, Schema

from mbd_sim_ros.bags.accounts import Account, Clock
from mbd_sim_ros.bags.clocks import apart, choose
from mbd_sim_ros.bags.columns import Collector, Room, Series
from mbd_sim_ros.bags.files import open_recording, readable
from mbd_sim_ros.bags.patterns import fits_any, may_fit, nearest
from mbd_sim_ros.bags.records import Messages
from mbd_sim_ros.bags.writer import RECORD, RESULT
from mbd_sim_ros.messages.topics import ELEMENTS, INPUTS, family
from solver.errors import BagError

WITH_REACTIONS = ('reactions', 'joint_states')  # topics with reactions, and with efforts of drivers
NOT_DETERMINED = 'reactions that the motion does not determine, next to a singular position'
NOT_SIGNALS = ('tf', 'tf_static', 'robot_description', INPUTS.name)  # topics that do not become columns


@dataclass
class Run:
    """One run: topic -> series of columns, each series at its own instants.

    `time_ns` and `columns` show all series on one common time grid, with NaN where a topic has no message. metadata:
    entries that describe the run. left_out: topic -> reason why it could not be read. known: topic -> all its channels,
    including those that were not asked for. messages: topic -> number of its messages in the file, including topics
    without columns. accounts: topic -> account of its messages in `series`. Of a table (CSV, say): stated: column ->
    unit in its header, which mapping.py converts to SI; told: sentences on rows that were dropped and on assumptions.
    """

    series: dict[str, Series]
    metadata: dict[str, str] = field(default_factory=dict)  # see recorder.describe
    left_out: dict[str, str] = field(default_factory=dict)
    known: dict[str, tuple[str, ...]] = field(default_factory=dict)
    stated: dict[str, str] = field(default_factory=dict)
    told: tuple[str, ...] = ()
    messages: dict[str, int] = field(default_factory=dict)
    accounts: dict[str, Account] = field(default_factory=dict)

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
        """All channels of the recording, including those that were not asked for."""
        known = self.known or {topic: tuple(one.columns) for topic, one in self.series.items()}
        return tuple(name for names in known.values() for name in names)

    def instead_of(self, wanted: str) -> str:
        """Ending of a sentence on a channel or pattern that does not exist: why its topic is not read, or the nearest
        names."""
        asked = wanted.strip('/')
        for topic, why in self.left_out.items():
            if asked == topic or asked.startswith(f'{topic}/'):
                return f': topic {topic} is not read: {why}'
        for topic in self.messages.keys() - self.known.keys():
            if asked == topic or asked.startswith(f'{topic}/'):
                return f': topic {topic} has no columns'
        return nearest(wanted, self.names)

    @property
    def passed(self) -> dict[str, int]:
        """Topic -> number of messages in no series: the topic cannot be read, has no columns, or was not asked for."""
        left = {t: n - (self.accounts[t].messages if t in self.accounts else 0) for t, n in self.messages.items()}
        return {topic: count for topic, count in left.items() if count}

    @property
    def doubts(self) -> tuple[str, ...]:
        """Sentences on messages that were dropped or merged in reading, and on topics whose times do not overlap."""
        of_topics = [
            f'topic {topic}: {text}'
            for topic, one in self.accounts.items()
            for text in (one.doubts(NOT_DETERMINED) if self.leaves_open(topic) else one.doubts())
        ]
        return (*filter(None, [apart(self.accounts)]), *of_topics)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Sentences on messages that were dropped in reading without a loss, such as exact repetitions."""
        return tuple(f'topic {topic}: {text}' for topic, one in self.accounts.items() for text in one.remarks())

    @property
    def events(self) -> list[dict[str, Any]]:
        """Changes of step and penalties in the run, in order: the fields of solver.step.adaptation.Event. Raises
        BagError."""
        return self._said('event_list', list, dict)

    @property
    def findings(self) -> list[dict[str, Any]]:
        """Findings on the run, which make it suspect (solver.analysis.verdict.report). Raises BagError."""
        return self._said('findings', list, dict)

    @property
    def errors(self) -> dict[str, dict[str, Any]]:
        """Numerical error of the run by quantity (solver.analysis.error_bar), where it was measured. Raises
        BagError."""
        return self._said('errors', dict, dict)

    @property
    def error_text(self) -> str:
        """Sentence on the numerical error of the run."""
        return self.metadata.get('error_text', 'The numerical error was not measured: the recording says nothing of it')

    @property
    def reactions_text(self) -> str:
        """Sentence on reactions that the motion does not determine (solver.output.undetermined), or nothing."""
        return self.metadata.get('reactions_text', '')

    def leaves_open(self, topic: str) -> bool:
        """True where NaN in a topic says that the motion does not determine a reaction, or the effort of a driver."""
        return bool(self.reactions_text) and topic in WITH_REACTIONS

    @property
    def joint_kinds(self) -> dict[str, str]:
        """Joint coordinate -> 'rotation' or 'translation'; empty in old recordings. Raises BagError."""
        return self._said('joint_kinds', dict, str)

    @property
    def element_kinds(self) -> dict[str, str]:
        """Element on joint coordinates -> 'rotation' or 'translation'; empty in old recordings. Raises BagError."""
        return self._said('element_kinds', dict, str)

    def _said(self, key: str, kind: type, item: type) -> Any:
        """An entry of the metadata that is JSON: a list or dict (kind) of items of one type; empty if it is missing."""
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
            said = f'{key} = {shown!r}, which mbd_sim_ros does not write'
            raise BagError(f'the recording is damaged: its metadata say {said}')
        return value

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.columns:
            raise BagError(f'the recording has no column {name!r}' + self.instead_of(name))
        return self.columns[name]


def read(path: str | Path, channels: Sequence[str] = (), *, log_times: bool = False, namespace: str = '') -> Run:
    """Read a recording. path: a bag directory or file (files.py).

    channels: shell patterns of the columns to read ('odom/*'); without any all columns are read. log_times: take the
    times of the recorder instead of the stamps in the messages (clocks.py says which times count otherwise). namespace:
    removed from the beginning of topic names; a namespace in the recording itself takes precedence.

    Raises BagError if it is not a recording, is empty, or is not whole.
    """
    skip: set[int] = set()
    reading = open_recording(path, skip=skip)
    room = Room(reading.size)
    schemas: dict[int, Schema] = {}
    collectors: dict[tuple[str, int], Collector] = {}  # (topic, schema) -> collector; several publishers share one
    of_channel: dict[int, Collector] = {}
    aside: dict[int, str] = {}  # channel without columns -> its topic
    left_out: dict[str, str] = {}
    metadata: dict[str, dict[str, str]] = {}

    def wanted(name: str) -> bool:
        return not channels or fits_any(name, channels)

    for record in reading:
        if isinstance(record, Messages):
            one = of_channel.get(record.channel)
            if one is None:
                if record.channel not in skip:
                    aside[record.channel] = f'channel {record.channel}'
                    left_out[aside[record.channel]] = 'it is not declared'
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
            schema, problem = readable(record, schema)
            if topic in NOT_SIGNALS or schema is None:
                skip.add(record.id)
                aside[record.id] = topic
                if topic not in NOT_SIGNALS:
                    left_out[topic] = problem
                continue
            asked = not channels or may_fit(family(topic), channels)
            fresh = Collector(record.topic, family(topic), schema, wanted, room, asked)
            one = of_channel[record.id] = collectors.setdefault((record.topic, record.schema_id), fresh)
            one.expected += reading.expected.get(record.id, 0)
        else:
            metadata[record.name] = record.metadata
            namespace = metadata.get(RECORD, {}).get('namespace', namespace).strip('/')
    reading.require_whole()
    run = Run({}, {**metadata.get(RECORD, {}), **metadata.get(RESULT, {})}, left_out)
    counts = Counter(dict.fromkeys(collectors.values(), 0))
    for channel, count in reading.counts.items():
        if channel in of_channel:
            counts[of_channel[channel]] += count
        else:
            run.messages[aside.get(channel, f'channel {channel}')] = (
                run.messages.get(aside.get(channel, f'channel {channel}'), 0) + count
            )
    for one, clock in zip(collectors.values(), choose([*collectors.values()], log_times), strict=True):
        _add(run, one, clock, counts[one])
    if not run.known and left_out:
        topic, problem = next(iter(left_out.items()))
        raise BagError(f'{path} holds nothing that can be read: topic {topic}: {problem}')
    if not run.known:
        raise BagError(f'{path} holds no messages')
    return run


def _add(run: Run, one: Collector, clock: Clock, count: int) -> None:
    """Add the series of a topic to a run. count: number of its messages in the file."""
    found = one.series(clock)
    others = run.known.get(one.name, ())
    apart = one.name == ELEMENTS and not set(others) & set(one.known)
    problem = one.problem or ('another topic has the same name' if others and one.known and not apart else '')
    if problem:
        name = one.name if one.name not in run.series else f'{one.name} ({one.type})'
        run.left_out[name] = problem
        run.messages[name] = run.messages.get(name, 0) + count
        return
    run.messages[one.name] = run.messages.get(one.name, 0) + count
    if not one.known:
        return
    run.known[one.name] = (*others, *one.known)
    if found is not None:
        series, account = found
        before = run.series.get(one.name)
        if before is not None:
            series = before.joined(series)
            account = run.accounts[one.name].joined(account, series.time_ns.size)
        run.series[one.name], run.accounts[one.name] = series, account
