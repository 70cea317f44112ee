"""The messages of one topic as a table: a row for each instant, a column for each named number.

The columns of our own topics are

    joint_states/<joint>/position|velocity|effort
    odom/pose/x|y|z|qx|qy|qz|qw, odom/twist/vx|...|wz
    tire/<wheel>/force/fx|fy|fz|mx|my|mz
    imu/ax|...|wz|qx|...
    <topic>/<name>                        of topics of named scalars, a JointState with positions only:
                                          tire_states/<wheel>/kappa, cmd_applied/<input>
    element_states/<element>/<output>     of all topics element_states/<kind> together

and those of other message types are in named.py.

The messages of a topic of ours differ in their numbers only. So a block of messages is a table of bytes, and a column
is a strided part of it: no message is decoded by itself. The same holds for messages of others that are alike but for
their numbers. Such a set of messages is a *variant*: one publisher, one set of names. Only where texts change all the
time is each message decoded by itself.

Nothing is lost in silence: an `Account` (accounts.py) says how many messages a topic had and what became of them.

The file is long because a Collector is one thing: all its steps, from the first message to the series, work on the same
growing table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Schema

from mbd_sim_ros.bags.accounts import (
    CLOCKS,
    HEADER,
    LOG,
    NAMES,
    PUBLISH,
    SET_BACK,
    Account,
    Clock,
    alike,
    shuffled,
    went_back,
)
from mbd_sim_ros.bags.named import COLUMNS_MAX, TEXT, Pick, is_plain, named
from mbd_sim_ros.bags.records import Messages, instants
from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.topics import JOINT_STATE
from solver.errors import BagError

BLOCK_BYTES = 1 << 19  # bytes of messages that are decoded at once: they stay in the cache of the processor
VARIANTS_MOST = 32  # variants of a topic; with more of them its texts change from message to message
# Memory [bytes] that is reserved for tables before their messages are read: a constant, and a factor on the size of the
# file.
TABLE_MOST = (1 << 26, 256)
STAMP = ('header.stamp.sec', 'header.stamp.nanosec')  # fields of a time stamp
STAMP_KINDS = ('int32', 'uint32')  # types that these fields may have


@dataclass(frozen=True)
class Series:
    """Numbers of one topic: its instants [ns], and column name -> float64 values (SI units) at these instants."""

    time_ns: np.ndarray  # (n,) int64, ascending
    columns: dict[str, np.ndarray]  # (n,) each

    def on(self, time_ns: np.ndarray) -> dict[str, np.ndarray]:
        """The columns at other instants time_ns (m,), which contain all instants of this series; NaN at the additional
        ones."""
        if self.time_ns is time_ns or np.array_equal(self.time_ns, time_ns):
            return self.columns
        rows = np.searchsorted(time_ns, self.time_ns)
        result = {name: np.full(time_ns.size, np.nan) for name in self.columns}
        for name, values in self.columns.items():
            result[name][rows] = values
        return result

    def joined(self, other: Series) -> Series:
        """The columns of two series at the instants of both, NaN where one has no message."""
        same = np.array_equal(self.time_ns, other.time_ns)
        time_ns = self.time_ns if same else np.union1d(self.time_ns, other.time_ns)
        return Series(time_ns, self.on(time_ns) | other.on(time_ns))


class Room:
    """Memory that may still be reserved for announced messages: a damaged file may announce too many. size: of the file
    [bytes]."""

    def __init__(self, size: int) -> None:
        self._left = TABLE_MOST[0] + TABLE_MOST[1] * size

    def take(self, rows: int, width: int) -> int:
        """Number of rows to reserve: `rows`, if that many rows of `width` bytes are left, else 0."""
        if rows * width > self._left:
            return 0
        self._left -= rows * width
        return rows


class _Changing(BagError):
    """The messages of a topic differ in more than their numbers."""


class _Variant(NamedTuple):
    """Messages that differ in their numbers only."""

    model: np.ndarray  # bytes of one of them
    fixed: list[tuple[int, int]]  # (first, behind the last) byte of each part that is the same in all of them
    places: dict[str, cdr.Place]  # field path -> its bytes
    # field path, indices of its numbers, their rows of the table
    picks: list[tuple[str, slice | list[int], slice | list[int]]]
    names: int  # number of their set of columns (Collector._sets)

    def of(self, table: np.ndarray) -> np.ndarray | None:
        """(n,) True for the messages, rows of bytes in `table`, that are of this variant; None: all are."""
        if not any(np.any(table[:, a:b] != self.model[a:b]) for a, b in self.fixed):
            return None
        return np.all([np.all(table[:, a:b] == self.model[a:b], axis=1) for a, b in self.fixed], axis=0)


class Collector:
    """Collects the messages of one topic and keeps the columns that are wanted.

    topic: as published. name: as in column names. wanted: column name -> whether it is kept. asked: whether columns
    that the first message does not have may be wanted. expected: number of messages by the summary of the file, 0 where
    that is not known. problem: why the topic cannot be read, '' while it can.
    """

    def __init__(
        self, topic: str, name: str, schema: Schema, wanted: Callable[[str], bool], room: Room, asked: bool = True
    ) -> None:
        self.topic, self.name, self.type = topic, name, schema.name
        self.expected = 0
        self._room = room
        self.problem = ''
        try:
            self.schema = schema.data.decode()
        except UnicodeDecodeError:
            self.schema, self.problem = '', 'its definition is not UTF-8 text'
        self.columns: list[str] = []
        self._rows: dict[str, int] = {}  # column -> row of the table, -1 where it is not wanted
        self._wanted, self._asked = wanted, asked
        self._times: list[bytes] = []
        self._data: list[bytes] = []
        self._bytes = 0
        self._count = 0
        self._begun = self._complete = False  # _complete: no later message can have other names than the first one
        self._channels: set[int] = set()  # of several publishers; the messages of each lie together in a chunk
        self._variants: list[_Variant] = []
        self._sets: dict[tuple[int, ...], int] = {}  # set of rows of the table that a message fills -> its number
        self._sizes: dict[str, int] = {}  # list without names -> its size, which must stay the same
        self._plain: bool | None = None  # see named()
        self._in_words = False  # whether some numbers are written as text
        self._origin = cdr.BEHIND_IT  # byte of a message from which the alignment of its fields counts
        self._certain = True  # whether the origin is beyond doubt
        self._table = np.empty((0, 0))  # (columns, messages)
        self._stamps = np.empty((4, 0), np.int64)  # (times by each of CLOCKS, then the number of the set; messages)

    @property
    def idle(self) -> bool:
        """True where further messages would change nothing."""
        return bool(self.problem) or (self._complete and not self.columns)

    @property
    def known(self) -> list[str]:
        """All columns, also those that are not wanted."""
        return [*self._rows]

    @property
    def stamps(self) -> np.ndarray:
        """(3, n) times [ns] of the messages by each of CLOCKS, negative where a message has none."""
        self._decode()
        return self._stamps[:NAMES, : self._count]

    def add(self, messages: Messages) -> None:
        """Take messages of one chunk."""
        if not self._begun:
            self._begun = True
            self._begin(messages.data[0])
        if self.idle:
            return
        self._channels.add(messages.channel)
        self._times += messages.times
        self._data += messages.data
        self._bytes += len(messages.data) * len(messages.data[0])
        if self._bytes >= BLOCK_BYTES:
            self._decode()

    def series(self, clock: Clock) -> tuple[Series, Account] | None:
        """(series, account) of all messages, at their times by a clock.

        None where there is no message, and where the time goes back by much: two parts of the recording would be mixed.
        """
        self._decode()
        if not self._certain and not self.problem:
            self.problem = (
                'its messages are longer than its schema: it cannot be decided whether their fields are aligned from '
                'the start of the buffer, against the CDR standard, or zeros follow their data'
            )
        if self.problem or not self._count:
            return None
        stamps, table = self._stamps[:, : self._count], self._table[: len(self.columns), : self._count]
        times, log_times = stamps[CLOCKS.index(clock)], stamps[LOG]
        mixed = len(self._channels) > 1 or shuffled(log_times)
        came = times[np.argsort(log_times, kind='stable')] if mixed else times
        latest = np.maximum.accumulate(came)
        back = int(np.max(latest - came))
        if back > SET_BACK:
            self.problem = went_back(came, clock, np.sort(log_times) if mixed else log_times)
            return None
        disordered = int(np.count_nonzero(latest > came))
        order = np.argsort(times, kind='stable') if disordered or mixed else np.arange(times.size)
        last = np.diff(times[order], append=np.iinfo(np.int64).max) != 0  # the last message of those at one time
        nearer = stamps[CLOCKS.index(clock) + 1 : NAMES]  # times by clocks that may differ where this clock does not
        if len(self._sets) > 1:
            found, table, equal, twice, carried = self._by_names(
                times[order], nearer[:, order], stamps[NAMES, order], table[:, order]
            )
        else:
            keep = order[last]
            equal, carried = times.size - keep.size, {}
            left = np.flatnonzero(~last)
            a, b = order[left], keep[np.cumsum(last)[left]]
            twice = alike(table[:, a], table[:, b], nearer[:, a], nearer[:, b]) if equal else 0
            if keep.size < times.size or disordered or mixed:
                found, table = times[keep], table[:, keep]
            else:
                found = times
        columns = dict(zip(self.columns, table))
        account = Account(
            messages=times.size,
            rows=found.size,
            equal=equal,
            twice=twice,
            beside=times.size - equal - found.size,
            disordered=disordered,
            holes=_holes(table, columns, carried),
            clock=clock,
            misaligned=self._origin != cdr.BEHIND_IT,
            span=(int(found[0]), int(found[-1])),
            log=(int(log_times.min()), int(log_times.max())),
        )
        return Series(found, columns), account

    def _by_names(
        self, times: np.ndarray, nearer: np.ndarray, sets: np.ndarray, table: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, int, int, dict[str, int]]:
        """Messages with different sets of columns, in order of their times, merged into one row for each instant.

        Returns (instants, table, number of messages that another one at the same time replaces, number of these with
        the same values as the one that stays, column -> number of rows that have it).
        """
        found, row = np.unique(times, return_inverse=True)
        result = np.full((table.shape[0], found.size), np.nan)
        stamps = np.zeros((len(nearer), found.size), np.int64)
        equal, twice, filled = 0, 0, np.zeros(result.shape, bool)
        for columns, number in self._sets.items():
            rows = np.flatnonzero(sets == number)
            last = np.diff(row[rows], append=found.size) != 0
            keep, left = rows[last], np.flatnonzero(~last)
            which = np.array(columns, int)[:, None]
            a, b = rows[left], keep[np.cumsum(last)[left]]
            twice += alike(table[which, a], table[which, b], nearer[:, a], nearer[:, b])
            there = filled[which, row[keep]]
            over = np.flatnonzero(np.any(there, axis=0))
            a, b = row[keep[over]], keep[over]
            after = table[which, b]
            twice += alike(np.where(there[:, over], result[which, a], after), after, stamps[:, a], nearer[:, b])
            equal += left.size + over.size
            result[which, row[keep]] = table[which, keep]
            filled[which, row[keep]] = True
            stamps[:, row[keep]] = nearer[:, keep]
        return found, result, equal, twice, dict(zip(self.columns, filled.sum(axis=1).tolist()))

    def _begin(self, data: bytes) -> None:
        """Find the columns in the first message."""
        try:
            value, places, self._origin = cdr.decode_first(self.type, self.schema, data)
            chosen = self._named(value, places)
        except BagError as error:
            self.problem = str(error)
            return
        self._certain = self._origin == cdr.BEHIND_IT
        self._complete = not (self._asked and _has_list(value))
        if self.idle:
            return
        self._variants = [] if self._in_words else [_variant(data, places, *chosen)]
        rows = self._room.take(self.expected, 8 * len(self.columns) + 32)
        self._table = np.empty((len(self.columns), rows))
        self._stamps = np.empty((4, rows), np.int64)

    def _named(self, value: dict[str, Any], places: dict[str, cdr.Place]) -> tuple[list[int], list[Pick], int]:
        """(rows of the table that a decoded message fills, the pick for each row, number of this set of columns)."""
        found = named(self.topic, self.type, value, places, self._plain)
        for shown, size in found.sizes.items():
            if self._sizes.setdefault(shown, size) != size:
                raise _Changing('its messages change their names or sizes during the recording')
        if self._plain is None and self.type == JOINT_STATE and found.columns:
            self._plain = is_plain(self.topic, places)
        full = {f'{self.name}/{name}': pick for name, pick in found.columns.items()}
        fresh = [name for name in full if name not in self._rows]
        if len(self._rows) + len(fresh) > COLUMNS_MAX:
            raise _Changing(f'its messages have more than {COLUMNS_MAX} different names')
        for name in fresh:
            self._rows[name] = len(self.columns) if self._wanted(name) else -1
            self.columns += [name] if self._rows[name] >= 0 else []
        wanted = [(at, pick) for name, pick in full.items() if (at := self._rows[name]) >= 0]
        self._in_words |= any(pick.place == TEXT for _, pick in wanted)
        rows = [at for at, _ in wanted]
        return rows, [pick for _, pick in wanted], self._sets.setdefault(tuple(sorted(rows)), len(self._sets))

    def _decode(self) -> None:
        """Put the messages that wait into the table."""
        data, begin, end = self._data, self._count, self._count + len(self._data)
        if not data or self.problem:
            return
        if end > self._table.shape[1]:
            capacity = max(end, 2 * self._table.shape[1])
            self._table = _wider(self._table, self._table.shape[0], capacity, begin)
            self._stamps = _wider(self._stamps, 4, capacity, begin)
        self._stamps[: PUBLISH + 1, begin:end] = instants(self._times).T
        self._certain = self._certain or not all(cdr.may_have_zeros_behind(self.type, self.schema, one) for one in data)
        try:
            left = np.arange(len(data))
            for variant in self._variants:
                left = self._take(variant, data, left, begin)
            while left.size:
                if self._in_words or len(self._variants) == VARIANTS_MOST:
                    self._one(data[left[0]], begin + int(left[0]))
                    left = left[1:]
                else:
                    value, places = cdr.decode(self.type, self.schema, data[left[0]], self._origin)
                    self._variants.append(_variant(data[left[0]], places, *self._named(value, places)))
                    left = left if self._in_words else self._take(self._variants[-1], data, left, begin)
        except BagError as error:
            self.problem = (
                str(error) if isinstance(error, _Changing) else f'one of its messages cannot be read: {error}'
            )
        self._count = end
        self._data, self._times, self._bytes = [], [], 0

    def _take(self, variant: _Variant, data: list[bytes], left: np.ndarray, begin: int) -> np.ndarray:
        """Put the waiting messages of one variant into the table.

        data: all waiting messages; the first one has the place `begin` in the table. left: indices of those that are
        not in the table yet. Returns the indices of those that are of another variant.
        """
        if not left.size:
            return left
        size = len(variant.model)
        if left.size == len(data) and set(map(len, data)) == {size}:
            chosen, table = left, np.frombuffer(b''.join(data), np.uint8).reshape(-1, size)
        else:
            chosen = left[[len(data[i]) == size for i in left]]
            table = np.frombuffer(b''.join(data[i] for i in chosen), np.uint8).reshape(-1, size)
        ours = variant.of(table)
        if ours is not None:
            chosen, table = chosen[ours], table[ours]
        if chosen.size == len(data):
            rows: slice | np.ndarray = slice(begin, begin + len(data))
        else:
            rows = begin + chosen
        self._room_for_names()
        if len(self._sets) > 1:
            self._table[:, rows] = np.nan
        for path, which, at in variant.picks:
            place = (np.array(at)[:, None] if isinstance(at, list) and isinstance(rows, np.ndarray) else at), rows
            self._table[place] = _gather(table, variant.places[path])[:, which].T
        self._stamps[NAMES, rows] = variant.names
        stamps = [variant.places.get(path) for path in STAMP]
        if all(place is not None and place.kind in STAMP_KINDS and place.size == 1 for place in stamps):
            sec, nanosec = (_gather(table, place)[:, 0] for place in stamps if place is not None)
            self._stamps[HEADER, rows] = sec.astype(np.int64) * 1_000_000_000 + nanosec
        else:
            self._stamps[HEADER, rows] = -1
        return left[:0] if chosen.size == left.size else np.setdiff1d(left, chosen, assume_unique=True)

    def _one(self, data: bytes, row: int) -> None:
        """Decode one message by itself and put it into the table, at the place `row` of the messages."""
        value, places = cdr.decode(self.type, self.schema, data, self._origin)
        rows, picks, number = self._named(value, places)
        self._room_for_names()
        self._table[:, row] = np.nan
        for at, pick in zip(rows, picks):
            if pick.place == TEXT:
                self._table[at, row] = _number(value, pick.path)
            else:
                place = places[pick.path]
                self._table[at, row] = np.frombuffer(data, cdr.dtype(place), place.size, place.offset)[pick.place]
        self._stamps[NAMES, row] = number
        stamps = [places.get(path) for path in STAMP]
        self._stamps[HEADER, row] = -1
        if all(place is not None and place.kind in STAMP_KINDS and place.size == 1 for place in stamps):
            sec, nanosec = (int(np.frombuffer(data, cdr.dtype(p), 1, p.offset)[0]) for p in stamps if p is not None)
            self._stamps[HEADER, row] = sec * 1_000_000_000 + nanosec

    def _room_for_names(self) -> None:
        """Make the table as large as the present number of columns; new columns are NaN so far."""
        rows = self._table.shape[0]
        if len(self.columns) > rows:
            self._table = _wider(self._table, len(self.columns), self._table.shape[1], self._table.shape[1])
            self._table[rows:] = np.nan


def _variant(data: bytes, places: dict[str, cdr.Place], rows: list[int], picks: list[Pick], number: int) -> _Variant:
    """The variant that a message stands for. rows, picks, number: from Collector._named()."""
    variable = np.zeros(len(data) + 1, bool)
    for place in places.values():
        variable[place.offset : place.offset + place.size * cdr.dtype(place).itemsize] = True
    variable[-1] = True
    edges = np.flatnonzero(np.diff(variable, prepend=True))
    parts: dict[str, tuple[list[int], list[int]]] = {}
    for at, pick in zip(rows, picks):
        which, into = parts.setdefault(pick.path, ([], []))
        which.append(pick.place)
        into.append(at)
    chosen = [(path, _slice(which), _slice(into)) for path, (which, into) in parts.items() if which != [TEXT]]
    return _Variant(
        np.frombuffer(data, np.uint8), list(zip(edges[::2].tolist(), edges[1::2].tolist())), places, chosen, number
    )


def _slice(numbers: list[int]) -> slice | list[int]:
    """Indices as a slice where they follow each other, which is faster."""
    return slice(numbers[0], numbers[-1] + 1) if numbers == [*range(numbers[0], numbers[-1] + 1)] else numbers


def _wider(table: np.ndarray, rows: int, capacity: int, filled: int) -> np.ndarray:
    """A larger table (rows, capacity) with the first `filled` messages of this one."""
    result = np.empty((rows, capacity), table.dtype)
    result[: table.shape[0], :filled] = table[:, :filled]
    return result


def _gather(table: np.ndarray, place: cdr.Place) -> np.ndarray:
    """(n, count) numbers of one field of n messages, the rows of bytes in `table`."""
    dtype = cdr.dtype(place)
    part = np.ascontiguousarray(table[:, place.offset : place.offset + place.size * dtype.itemsize])
    return part.view(dtype) if place.size else np.zeros((len(table), 0), dtype)


def _has_list(value: Any) -> bool:
    """True where a decoded message has a list of texts or of messages: the next one may have other names in it."""
    return isinstance(value, list) or (isinstance(value, dict) and any(map(_has_list, value.values())))


def _number(value: Any, path: str) -> float:
    """The text at a field path of a decoded message as a number, NaN where it is none."""
    for part in path.replace('[', '.').replace(']', '').split('.'):
        value = value[int(part)] if isinstance(value, list) else value[part]
    try:
        return float(value)
    except ValueError:
        return np.nan


def _holes(table: np.ndarray, columns: dict[str, np.ndarray], carried: dict[str, int]) -> dict[str, int]:
    """Column -> number of values that are not finite, where there are some. carried: column -> rows that have it, if
    not all."""
    with np.errstate(over='ignore', invalid='ignore'):
        if np.isfinite(np.add.reduce(table, axis=None)):
            return {}
    found = {
        name: carried.get(name, values.size) - int(np.count_nonzero(np.isfinite(values)))
        for name, values in columns.items()
    }
    return {name: count for name, count in found.items() if count > 0}
