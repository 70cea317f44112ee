"""Reading recordings: a bag becomes a `Run`, per topic its instants and named columns; a broken one gives back every complete chunk.

Columns: `joint_states/<joint>/position|velocity|effort`, `odom/pose/x|y|z|qx|qy|qz|qw`, `odom/twist/vx|...|wz`,
`tire/<wheel>/force/fx|fy|fz|mx|my|mz`, `imu/ax|...|wz|qx|...`, and `<topic>/<name>` for topics of named scalars (JointState with
positions only: `tire_states/<wheel>/kappa`, `cmd_applied/<input>`). Other types give `<topic>/<field path>`.

The messages of one topic of our recordings differ in their numbers only, so a block of them is one table of bytes and a column is a
strided part of it. Topics whose strings or sizes change are decoded message by message.
"""

from __future__ import annotations

import fnmatch
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Channel, Metadata, Schema, Statistics

from mbd_sim_ros.bags.records import Messages, find_file, message_counts, records
from mbd_sim_ros.bags.writer import RECORD, RESULT, BagWriter
from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.encode import IMU, INPUTS, JOINT_STATE, ODOMETRY, WRENCH, Topic
from solver.errors import BagError, suggestion

_XYZ, _QUATERNION, _TWIST = ('x', 'y', 'z'), ('qx', 'qy', 'qz', 'qw'), ('vx', 'vy', 'vz', 'wx', 'wy', 'wz')
# Per type: first field of a run of float64, and the column names of that run.
_BLOCKS = {
    ODOMETRY: (
        ('pose.pose.position.x', [f'pose/{name}' for name in _XYZ + _QUATERNION]),
        ('twist.twist.linear.x', [f'twist/{name}' for name in _TWIST]),
    ),
    IMU: (('orientation.x', _QUATERNION), ('angular_velocity.x', _TWIST[3:]), ('linear_acceleration.x', ('ax', 'ay', 'az'))),
    WRENCH: (('wrench.force.x', ('fx', 'fy', 'fz', 'mx', 'my', 'mz')),),
}
NOT_SIGNALS = ('tf', 'tf_static', 'robot_description', INPUTS.name)  # topics that are no columns
BLOCK_BYTES = 1 << 22  # messages of a topic that are decoded at once
COLUMNS_MAX = 4096  # of one topic; a cloud of points is no set of channels
STAMP = ('header.stamp.sec', 'header.stamp.nanosec')


@dataclass(frozen=True)
class Series:
    """One topic: its instants [ns] and float64 columns on them (SI units), under their full names."""

    time_ns: np.ndarray  # (n,) int64, ascending
    columns: dict[str, np.ndarray]  # (n,) each


@dataclass
class Run:
    """One run: a series per topic, each at its own instants.

    `time_ns` and `columns` are all of them on one common grid, NaN where a topic has no message.
    left_out: topic -> why its messages could not be read. known: topic -> its channels, also those that were not asked for.
    """

    series: dict[str, Series]
    metadata: dict[str, str] = field(default_factory=dict)  # see recorder.describe
    left_out: dict[str, str] = field(default_factory=dict)
    known: dict[str, tuple[str, ...]] = field(default_factory=dict)

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
        return {name: values for one in self.series.values() for name, values in self._spread(one).items()}

    def _spread(self, one: Series) -> dict[str, np.ndarray]:
        if one.time_ns is self.time_ns or np.array_equal(one.time_ns, self.time_ns):
            return one.columns
        rows = np.searchsorted(self.time_ns, one.time_ns)
        result = {name: np.full(self.time_ns.size, np.nan) for name in one.columns}
        for name, values in one.columns.items():
            result[name][rows] = values
        return result

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
        """Changes of step and penalties in the run, in order: the fields of solver.step.adaptation.Event."""
        return json.loads(self.metadata.get('event_list', '[]'))

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.columns:
            raise BagError(f'the recording has no column {name!r}' + suggestion(name, self.columns))
        return self.columns[name]


class Recovered(NamedTuple):
    """What `recover` saved."""

    directory: Path
    messages: int
    start_ns: int
    end_ns: int
    complete: bool  # the source was whole


class _Changing(Exception):
    """The messages of a topic are not all alike."""


class _Collector:
    """Takes the messages of one topic and keeps the columns that are wanted.

    wanted: tells of a full column name whether it is. expected: how many messages will come (0: not known).
    """

    def __init__(self, topic: str, name: str, kind: str, schema: str, wanted: Callable[[str], bool]) -> None:
        self.topic, self.name, self.type, self.schema = topic, name, kind, schema
        self.expected = 0
        self.problem = ''
        self.known: list[str] = []
        self.columns: list[str] = []
        self._wanted = wanted
        self._times: list[int] = []
        self._data: list[bytes] = []
        self._bytes = 0
        self._count = 0
        self._begun = False
        self._first: dict[str, Any] = {}
        self._length = 0
        self._places: dict[str, cdr.Place] = {}
        self._picks: list[tuple[str, slice | list[int], int]] = []  # field, which of its numbers, how many
        self._table = np.empty((0, 0))
        self._stamps = np.empty((2, 0), np.int64)  # log times, stamps

    @property
    def idle(self) -> bool:
        """Whether no further message is of use."""
        return bool(self.problem) or (self._begun and not self.columns)

    def add(self, messages: Messages) -> None:
        """Take some messages."""
        if not self._begun:
            self._begun = True
            self._begin(messages.data[0])
        if self.idle:
            return
        self._times += messages.log_times
        self._data += messages.data
        self._bytes += len(messages.data) * len(messages.data[0])
        if self._bytes >= BLOCK_BYTES:
            self._decode()

    def series(self) -> Series | None:
        """All that came, with header stamps as times where the type has them and they tell the messages apart."""
        self._decode()
        if self.problem or not self._count:
            return None
        log_times, stamps = self._stamps[:, : self._count]
        times = log_times if stamps[0] < 0 or (self._count > 1 and np.all(stamps == stamps[0])) else stamps
        table = self._table[:, : self._count]
        order = np.argsort(times, kind='stable')
        keep = order[np.flatnonzero(np.diff(times[order], append=np.iinfo(np.int64).max))]  # of equal times the last
        if keep.size == times.size and np.all(keep == np.arange(times.size)):
            return Series(times, dict(zip(self.columns, table)))
        return Series(times[keep], {name: values[keep] for name, values in zip(self.columns, table)})

    def _begin(self, data: bytes) -> None:
        """Learn from the first message what the columns are."""
        try:
            self._first, self._places = cdr.decode(self.type, self.schema, data)
            names = _names(self.topic, self.type, self._first, self._places)
        except (BagError, KeyError, ValueError, UnicodeDecodeError) as error:
            self.problem = str(error) if isinstance(error, BagError) else 'its messages do not fit their definition'
            return
        if len(names) > COLUMNS_MAX:
            self.problem = f'a message of it holds {len(names)} numbers, more than {COLUMNS_MAX}'
            return
        self._length = len(data)
        self.known = [f'{self.name}/{name}' for name in names]
        chosen = [(full, place) for full, place in zip(self.known, names.values()) if self._wanted(full)]
        for path in dict.fromkeys(path for _, (path, _) in chosen):
            of_it = [(full, i) for full, (p, i) in chosen if p == path]
            self.columns += [full for full, _ in of_it]
            whole = len(of_it) == self._places[path].size
            self._picks.append((path, slice(None) if whole else [i for _, i in of_it], len(of_it)))
        self._table = np.empty((len(self.columns), self.expected))
        self._stamps = np.empty((2, self.expected), np.int64)
        variable = np.zeros(self._length + 1, bool)
        for place in self._places.values():
            variable[place.offset : place.offset + place.size * cdr.dtype(place).itemsize] = True
        variable[-1] = True
        edges = np.flatnonzero(np.diff(variable, prepend=True))
        self._fixed = list(zip(edges[::2].tolist(), edges[1::2].tolist()))
        self._model = np.frombuffer(data, np.uint8)

    def _decode(self) -> None:
        """Turn the messages at hand into rows of the table."""
        n = len(self._data)
        if n == 0 or self.problem:
            return
        try:
            gathered = self._alike() or self._one_by_one()
        except (_Changing, BagError):
            self.problem = 'its messages change their names or sizes during the recording'
            self._data, self._times, self._bytes = [], [], 0
            return
        begin, end = self._count, self._count + n
        if end > self._table.shape[1]:
            capacity = max(end, 2 * self._table.shape[1])
            self._table = _wider(self._table, capacity, begin)
            self._stamps = _wider(self._stamps, capacity, begin)
        row = 0
        for path, which, many in self._picks:
            self._table[row : row + many, begin:end] = gathered[path][:, which].T
            row += many
        self._stamps[0, begin:end] = self._times
        self._stamps[1, begin:end] = (
            gathered[STAMP[0]][:, 0].astype(np.int64) * 1_000_000_000 + gathered[STAMP[1]][:, 0] if STAMP[0] in gathered else -1
        )
        self._count = end
        self._data, self._times, self._bytes = [], [], 0

    def _needed(self) -> list[str]:
        return [path for path, *_ in self._picks] + [path for path in STAMP if path in self._places]

    def _alike(self) -> dict[str, np.ndarray] | None:
        """The numbers of messages that are like the first one but for their numbers; None if they are not."""
        if any(len(data) != self._length for data in self._data):
            return None
        table = np.frombuffer(b''.join(self._data), np.uint8).reshape(len(self._data), -1)
        if any(np.any(table[:, a:b] != self._model[a:b]) for a, b in self._fixed):
            return None  # names changed (or padding is not zero)
        return {path: _gather(table, self._places[path]) for path in self._needed()}

    def _one_by_one(self) -> dict[str, np.ndarray]:
        rows = []
        sizes = {path: place.size for path, place in self._places.items()}
        for data in self._data:
            value, found = cdr.decode(self.type, self.schema, data)
            if {path: place.size for path, place in found.items()} != sizes or value.get('name') != self._first.get('name'):
                raise _Changing
            numbers = {path: found[path] for path in self._needed()}
            rows.append({path: np.frombuffer(data, cdr.dtype(place), place.size, place.offset) for path, place in numbers.items()})
        return {path: np.stack([row[path] for row in rows]) for path in self._needed()}


def _wider(table: np.ndarray, capacity: int, filled: int) -> np.ndarray:
    result = np.empty((table.shape[0], capacity), table.dtype)
    result[:, :filled] = table[:, :filled]
    return result


def _gather(table: np.ndarray, place: cdr.Place) -> np.ndarray:
    """Return the numbers at `place` of all messages (rows of bytes), shape (n, count)."""
    dtype = cdr.dtype(place)
    part = np.ascontiguousarray(table[:, place.offset : place.offset + place.size * dtype.itemsize])
    return part.view(dtype) if place.size else np.zeros((len(table), 0), dtype)


def _names(topic: str, kind: str, first: dict[str, Any], places: dict[str, cdr.Place]) -> dict[str, tuple[str, int]]:
    """Map column names to (field path, index in it)."""
    if kind == JOINT_STATE:
        filled = [part for part in ('position', 'velocity', 'effort') if places[part].size]
        plain = filled == ['position'] and not topic.endswith('joint_states')
        return {
            name if plain else f'{name}/{part}': (part, i)
            for part in filled
            for i, name in enumerate(first['name'])
            if i < places[part].size
        }
    if kind in _BLOCKS:
        paths = list(places)
        return {
            name: (path, 0)
            for start, names in _BLOCKS[kind]
            for name, path in zip(names, paths[paths.index(start) : paths.index(start) + len(names)])
        }
    return {
        path.replace('.', '/') + (f'/{i}' if place.size > 1 else ''): (path, i)
        for path, place in places.items()
        if not path.startswith('header.')
        for i in range(place.size)
    }


def read(path: str | Path, channels: Sequence[str] = ()) -> Run:
    """Read a bag directory or an .mcap file. channels: shell patterns of the columns to read ('odom/*'); all without any.

    Raises BagError if it is not a recording, is empty, or was cut off.
    """
    path = find_file(path)
    namespace = ''
    expected: dict[int, int] = message_counts(path)
    schemas: dict[int, Schema] = {}
    collectors: dict[tuple[str, int], _Collector] = {}  # by topic and schema: several publishers are one topic
    of_channel: dict[int, _Collector] = {}
    metadata: dict[str, dict[str, str]] = {}
    skip: set[int] = set()
    complete = False

    def wanted(name: str) -> bool:
        return not channels or any(fnmatch.fnmatchcase(name, pattern) for pattern in channels)

    for record in records(path, skip=skip):
        if isinstance(record, Messages):
            one = of_channel.get(record.channel)
            if one is None:
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
            if topic in NOT_SIGNALS or record.message_encoding != 'cdr' or schema is None or schema.encoding != 'ros2msg':
                skip.add(record.id)
                continue
            fresh = _Collector(record.topic, topic, schema.name, schema.data.decode(), wanted)
            one = of_channel[record.id] = collectors.setdefault((record.topic, record.schema_id), fresh)
            one.expected += expected.get(record.id, 0)
        elif isinstance(record, Metadata):
            metadata[record.name] = record.metadata
            namespace = metadata.get(RECORD, {}).get('namespace', '').strip('/')
        elif not isinstance(record, Statistics):
            complete = True
    if not complete:
        raise BagError(f'{path} is cut off or damaged; `mbd recover {path} NEW` saves every complete chunk')
    series = {one.name: found for one in collectors.values() if (found := one.series()) is not None}
    left_out = {one.name: one.problem for one in collectors.values() if one.problem}
    known = {one.name: tuple(one.known) for one in collectors.values() if one.known}
    if not series and left_out:
        topic, problem = next(iter(left_out.items()))
        raise BagError(f'{path} holds nothing that can be read: topic {topic}: {problem}')
    if not known:
        raise BagError(f'{path} holds no messages')
    return Run(series, {**metadata.get(RECORD, {}), **metadata.get(RESULT, {})}, left_out, known)


def recover(source: str | Path, destination: str | Path) -> Recovered:
    """Copy every complete chunk of a recording that was cut off (or of a whole one) into a new bag directory.

    Raises BagError if the source is not MCAP, nothing complete is in it, or the destination cannot be written.
    """
    path = find_file(source, unfinished=True)
    schemas: dict[int, Schema] = {}
    channels: dict[int, tuple[str, Schema]] = {}
    metadata: dict[str, Mapping[str, str]] = {}
    used: set[int] = set()
    complete = False
    for record in records(path):
        if isinstance(record, Messages):
            used.add(record.channel)
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            if record.message_encoding == 'cdr' and record.schema_id in schemas and schemas[record.schema_id].encoding == 'ros2msg':
                channels.setdefault(record.id, (record.topic, schemas[record.schema_id]))
        elif isinstance(record, Metadata):
            metadata[record.name] = record.metadata
        elif not isinstance(record, Statistics):
            complete = True
    if not used & channels.keys():
        raise BagError(f'{path} holds no complete chunk: nothing can be recovered')
    metadata[RESULT] = {**metadata.get(RESULT, {}), 'recovered_from': path.name}
    place = {channel: i for i, channel in enumerate(channels)}
    topics = [Topic(topic, schema.name, depth=1 if topic.endswith('robot_description') else 10) for topic, schema in channels.values()]
    writer = BagWriter(destination, topics, metadata, schemas={schema.name: schema.data.decode() for _, schema in channels.values()})
    for record in records(path):
        if isinstance(record, Messages) and record.channel in place:
            for log_time, data in zip(record.log_times, record.data):
                writer.write(log_time, [(place[record.channel], data)])
    directory = writer.finish()
    return Recovered(directory, sum(writer.count), writer.first_ns or 0, writer.last_ns, complete)
