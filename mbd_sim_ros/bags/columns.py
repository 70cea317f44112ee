"""Messages of one topic as columns of numbers on their instants.

Columns: `joint_states/<joint>/position|velocity|effort`, `odom/pose/x|y|z|qx|qy|qz|qw`, `odom/twist/vx|...|wz`,
`tire/<wheel>/force/fx|fy|fz|mx|my|mz`, `imu/ax|...|wz|qx|...`, and `<topic>/<name>` for topics of named scalars (JointState with
positions only: `tire_states/<wheel>/kappa`, `cmd_applied/<input>`); those of `element_states/<kind>` are columns of one series,
`element_states/<element>/<output>`, as in recordings that have them in one topic. Other types give `<topic>/<field path>`.

The messages of one topic of our recordings differ in their numbers only, so a block of them is one table of bytes and a column is a
strided part of it. Topics whose strings or sizes change are decoded message by message.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from mcap.records import Schema

from mbd_sim_ros.bags.records import Messages
from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.topics import IMU, JOINT_STATE, ODOMETRY, WRENCH
from solver.errors import BagError

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
BLOCK_BYTES = 1 << 19  # messages of a topic that are decoded at once: they stay in the cache of the processor
COLUMNS_MAX = 4096  # of one topic; a cloud of points is no set of channels
TABLE_MOST = (1 << 26, 256)  # bytes that are reserved for a table before its messages are there: so many, and per byte of them
STAMP = ('header.stamp.sec', 'header.stamp.nanosec')
STAMP_KINDS = ('int32', 'uint32')
SET_BACK = 1_000_000_000  # ns by which messages on their way overtake each other at most: more is a clock that was set back


@dataclass(frozen=True)
class Series:
    """One topic: its instants [ns] and float64 columns on them (SI units), under their full names."""

    time_ns: np.ndarray  # (n,) int64, ascending
    columns: dict[str, np.ndarray]  # (n,) each

    def on(self, time_ns: np.ndarray) -> dict[str, np.ndarray]:
        """The columns on instants that its own are among, NaN elsewhere."""
        if self.time_ns is time_ns or np.array_equal(self.time_ns, time_ns):
            return self.columns
        rows = np.searchsorted(time_ns, self.time_ns)
        result = {name: np.full(time_ns.size, np.nan) for name in self.columns}
        for name, values in self.columns.items():
            result[name][rows] = values
        return result

    def joined(self, other: Series) -> Series:
        """The columns of both on the instants of both, NaN where one has no message."""
        same = np.array_equal(self.time_ns, other.time_ns)
        time_ns = self.time_ns if same else np.union1d(self.time_ns, other.time_ns)
        return Series(time_ns, self.on(time_ns) | other.on(time_ns))


class Room:
    """Memory that may be reserved for messages that are announced: what a file says of itself may be wrong. size: of the file [bytes]."""

    def __init__(self, size: int) -> None:
        self._left = TABLE_MOST[0] + TABLE_MOST[1] * size

    def take(self, rows: int, width: int) -> int:
        """How many of the announced rows of so many bytes are reserved: all or none."""
        if rows * width > self._left:
            return 0
        self._left -= rows * width
        return rows


class _Changing(Exception):
    """The messages of a topic are not all alike."""


class Collector:
    """Takes the messages of one topic and keeps the columns that are wanted.

    wanted: tells of a full column name whether it is. expected: how many messages will come, as the file says (0: not known).
    """

    def __init__(self, topic: str, name: str, schema: Schema, wanted: Callable[[str], bool], room: Room) -> None:
        self.topic, self.name, self.type = topic, name, schema.name
        self.expected = 0
        self._room = room
        self.problem = ''
        try:
            self.schema = schema.data.decode()
        except UnicodeDecodeError:
            self.schema, self.problem = '', 'its definition is not UTF-8 text'
        self.known: list[str] = []
        self.columns: list[str] = []
        self._wanted = wanted
        self._times: list[int] = []
        self._data: list[bytes] = []
        self._bytes = 0
        self._count = 0
        self._begun = False
        self._channels: set[int] = set()  # those of several publishers lie in a chunk one after the other
        self._first: dict[str, Any] = {}
        self._length = 0
        self._places: dict[str, cdr.Place] = {}
        self._picks: list[tuple[str, slice | list[int], int]] = []  # field, which of its numbers, how many
        self._table = np.empty((0, 0))
        self._stamps = np.empty((2, 0), np.int64)  # log times, stamps
        self._stamp: tuple[str, ...] = ()  # where the messages say their time

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
        self._channels.add(messages.channel)
        self._times += messages.log_times
        self._data += messages.data
        self._bytes += len(messages.data) * len(messages.data[0])
        if self._bytes >= BLOCK_BYTES:
            self._decode()

    def series(self) -> Series | None:
        """All that came, with header stamps as times where the type has them and they tell the messages apart; None where nothing did, or
        where time goes back: what came before and after would be mixed."""
        self._decode()
        if self.problem or not self._count:
            return None
        log_times, stamps = self._stamps[:, : self._count]
        times = log_times if stamps[0] < 0 or (self._count > 1 and np.all(stamps == stamps[0])) else stamps
        table = self._table[:, : self._count]
        came = times if len(self._channels) == 1 else times[np.argsort(log_times, kind='stable')]
        back = int(np.max(np.maximum.accumulate(came) - came))
        if back > SET_BACK:
            self.problem = (
                f'its times go back by {back * 1e-9:.6g} s, as of a clock that was set back or began anew; cut the recording there'
            )
            return None
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
        except BagError as error:
            self.problem = str(error)
            return
        self._length = len(data)
        self.known = [f'{self.name}/{name}' for name in names]
        chosen = [(full, place) for full, place in zip(self.known, names.values()) if self._wanted(full)]
        for path in dict.fromkeys(path for _, (path, _) in chosen):
            of_it = [(full, i) for full, (p, i) in chosen if p == path]
            self.columns += [full for full, _ in of_it]
            whole = len(of_it) == self._places[path].size
            self._picks.append((path, slice(None) if whole else [i for _, i in of_it], len(of_it)))
        stamps = [self._places.get(path) for path in STAMP]
        self._stamp = STAMP if all(place is not None and place.kind in STAMP_KINDS and place.size == 1 for place in stamps) else ()
        rows = self._room.take(self.expected, 8 * len(self.columns) + 16)
        self._table = np.empty((len(self.columns), rows))
        self._stamps = np.empty((2, rows), np.int64)
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
            gathered[STAMP[0]][:, 0].astype(np.int64) * 1_000_000_000 + gathered[STAMP[1]][:, 0] if self._stamp else -1
        )
        self._count = end
        self._data, self._times, self._bytes = [], [], 0

    def _needed(self) -> list[str]:
        return [*(path for path, *_ in self._picks), *self._stamp]

    def _alike(self) -> dict[str, np.ndarray] | None:
        """The numbers of messages that are like the first one but for their numbers; None if they are not."""
        if set(map(len, self._data)) != {self._length}:
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
    numbers = sum(place.size for path, place in places.items() if not path.startswith('header.'))
    if numbers > COLUMNS_MAX:
        raise BagError(f'a message of it holds {numbers} numbers, more than {COLUMNS_MAX}')
    if kind == JOINT_STATE:
        return _of_joints(topic, first.get('name'), places)
    if kind in _BLOCKS:
        paths = list(places)
        if any(start not in paths for start, _ in _BLOCKS[kind]):
            raise BagError(f'its definition is not that of {kind}')
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


def _of_joints(topic: str, names: Any, places: dict[str, cdr.Place]) -> dict[str, tuple[str, int]]:
    """Columns of a JointState; those of named scalars have positions alone."""
    parts = ('position', 'velocity', 'effort')
    if not isinstance(names, list) or any(part not in places for part in parts):
        raise BagError(f'its definition is not that of {JOINT_STATE}')
    filled = [part for part in parts if places[part].size]
    if len(set(names)) != len(names):
        raise BagError(f'it names {next(name for name in names if names.count(name) > 1)!r} twice')
    for part in filled:
        if places[part].size != len(names):
            raise BagError(f'a message of it has {len(names)} names and {places[part].size} values of {part}')
    plain = filled == ['position'] and not topic.endswith('joint_states')
    return {name if plain else f'{name}/{part}': (part, i) for part in filled for i, name in enumerate(names)}
