"""Reading recordings: a bag becomes a `Run`, a time grid with named columns; a broken one gives back every complete chunk.

Columns: `joint_states/<joint>/position|velocity|effort`, `odom/pose/x|y|z|qx|qy|qz|qw`, `odom/twist/vx|...|wz`,
`tire/<wheel>/force/fx|fy|fz|mx|my|mz`, `imu/ax|...|wz|qx|...`, and `<topic>/<name>` for topics of named scalars (JointState with
positions only: `tire_states/<wheel>/kappa`, `cmd_applied/<input>`). Other types give `<topic>/<field path>`.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Footer, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, StreamReader, get_chunk_data_stream

from mbd_sim_ros.bags.writer import PART, RECORD, RESULT, BagWriter
from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.encode import IMU, JOINT_STATE, ODOMETRY, WRENCH, Topic
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
_BROKEN = (McapError, CRCValidationError, ValueError, IndexError, KeyError, struct.error, EOFError, MemoryError)
_MESSAGE = struct.Struct('<HIQQ')  # channel, sequence, log time, publish time
_RECORD = struct.Struct('<BQ')  # opcode, length


@dataclass
class Run:
    """One run: a common time grid [ns] and float64 columns on it (SI units; NaN where a topic has no message at that time)."""

    time_ns: np.ndarray  # (n,) int64, ascending
    columns: dict[str, np.ndarray]  # (n,) each
    metadata: dict[str, str] = field(default_factory=dict)  # see recorder.describe

    @property
    def time(self) -> np.ndarray:
        """Time in seconds."""
        return self.time_ns * 1e-9

    @property
    def events(self) -> list[dict[str, Any]]:
        """Changes of step and penalties in the run, in order: the fields of solver.step.adaptation.Event."""
        return json.loads(self.metadata.get('event_list', '[]'))

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.columns:
            from solver.errors import suggestion

            raise BagError(f'the recording has no column {name!r}' + suggestion(name, self.columns))
        return self.columns[name]


class Recovered(NamedTuple):
    """What `recover` saved."""

    directory: Path
    messages: int
    start_ns: int
    end_ns: int
    complete: bool  # the source was whole


@dataclass
class _Series:
    """All messages of one topic."""

    topic: str
    type: str
    schema: str
    times: list[int] = field(default_factory=list)
    data: list[bytes] = field(default_factory=list)


def find_file(path: str | Path, *, unfinished: bool = False) -> Path:
    """Return the MCAP file of a bag directory (or `path` itself, if it is a file); `unfinished` admits `.part` files.

    Raises BagError if there is none.
    """
    path = Path(path)
    if path.is_file():
        return path
    if not path.is_dir():
        raise BagError(f'{path} is not there: neither a bag directory nor an .mcap file')
    found = sorted(path.glob('*.mcap'))
    parts = sorted(path.glob('*.mcap' + PART))
    if not found and parts and unfinished:
        found = parts
    if not found:
        if parts:
            raise BagError(f'{path} was not finished: the recording process died; `mbd recover {path} NEW` saves every complete chunk')
        other = ' (storage sqlite3 is not read; convert it with `ros2 bag convert`)' if list(path.glob('*.db3')) else ''
        raise BagError(f'{path} is not a recording: it holds no .mcap file{other}')
    if len(found) > 1:
        raise BagError(f'{path} holds {len(found)} .mcap files; name one of them')
    return found[0]


def _records(path: Path) -> Iterator[Any]:
    """Yield Schema, Channel, Metadata and Footer records and (channel id, log time, message) of every complete chunk.

    A record that is cut off or damaged ends the stream: whoever wants to know whether it was whole looks for the Footer.
    Raises BagError if the file is not MCAP or cannot be opened.
    """
    try:
        stream = path.open('rb')
    except OSError as error:
        raise BagError(f'cannot read {path}: {error.strerror}') from error
    with stream:
        if path.stat().st_size == 0:
            raise BagError(f'{path} is empty: nothing was recorded')
        if stream.read(8) != b'\x89MCAP0\r\n':
            raise BagError(f'{path} is not a recording: it is not an MCAP file')
        stream.seek(0)
        limit = max(path.stat().st_size, 1 << 20)
        try:
            for record in StreamReader(stream, emit_chunks=True, record_size_limit=limit).records:
                if isinstance(record, Chunk):
                    body, _ = get_chunk_data_stream(record, validate_crc=True)
                    yield from _chunk(body.read(record.uncompressed_size))
                elif isinstance(record, Message):
                    yield record.channel_id, record.log_time, record.data
                elif isinstance(record, Schema | Channel | Metadata | Footer):
                    yield record
        except _BROKEN:
            return
        except Exception as error:  # decompression errors of zstandard and lz4 have no common base
            if type(error).__module__.split('.')[0] in ('zstandard', 'zstd', 'lz4', 'builtins'):
                return
            raise


def _chunk(body: bytes) -> Iterator[Any]:
    """Yield the records of a decompressed chunk; the loop over messages is the whole cost of reading a bag."""
    at = 0
    while at + _RECORD.size <= len(body):
        opcode, length = _RECORD.unpack_from(body, at)
        at += _RECORD.size
        if opcode == 5:
            channel, _, log_time, _ = _MESSAGE.unpack_from(body, at)
            yield channel, log_time, body[at + _MESSAGE.size : at + length]
        elif opcode in (3, 4):
            from io import BytesIO

            from mcap.data_stream import ReadDataStream

            yield (Schema if opcode == 3 else Channel).read(ReadDataStream(BytesIO(body[at : at + length])))
        at += length


def _scan(path: Path) -> tuple[dict[int, _Series], dict[str, dict[str, str]], bool]:
    """Read a whole file: messages by channel, metadata records by name, and whether the file was complete."""
    schemas: dict[int, Schema] = {}
    series: dict[int, _Series] = {}
    metadata: dict[str, dict[str, str]] = {}
    complete = False
    for record in _records(path):
        if isinstance(record, tuple):
            one = series.get(record[0])
            if one is not None:
                one.times.append(record[1])
                one.data.append(record[2])
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            schema = schemas.get(record.schema_id)
            if record.id not in series and record.message_encoding == 'cdr' and schema and schema.encoding == 'ros2msg':
                series[record.id] = _Series(record.topic, schema.name, schema.data.decode())
        elif isinstance(record, Metadata):
            metadata[record.name] = record.metadata
        else:
            complete = True
    return series, metadata, complete


def read(path: str | Path) -> Run:
    """Read a bag directory or an .mcap file.

    Raises BagError if it is not a recording, is empty, or was cut off.
    """
    path = find_file(path)
    series, metadata, complete = _scan(path)
    if not complete:
        raise BagError(f'{path} is cut off or damaged; `mbd recover {path} NEW` saves every complete chunk')
    return _run(path, series, metadata)


def _run(path: Path, series: dict[int, _Series], metadata: dict[str, dict[str, str]]) -> Run:
    about = {**metadata.get(RECORD, {}), **metadata.get(RESULT, {})}
    namespace = about.get('namespace', '').strip('/')
    pieces: list[tuple[np.ndarray, dict[str, np.ndarray]]] = []
    for one in series.values():
        topic = one.topic.strip('/').removeprefix(namespace + '/' if namespace else '')
        if one.times and topic not in ('tf', 'tf_static', 'robot_description'):
            times, columns = _columns(one)
            pieces.append((times, {f'{topic}/{name}': values for name, values in columns.items()}))
    if not pieces:
        raise BagError(f'{path} holds no messages')
    grid = pieces[0][0]
    if any(not np.array_equal(times, grid) for times, _ in pieces):
        grid = np.unique(np.concatenate([times for times, _ in pieces]))
    columns = {}
    for times, named in pieces:
        if times is grid or np.array_equal(times, grid):
            columns.update(named)
            continue
        rows = np.searchsorted(grid, times)
        for name, values in named.items():
            columns[name] = np.full(grid.size, np.nan)
            columns[name][rows] = values
    return Run(grid, columns, about)


def _columns(one: _Series) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return times [ns] (header stamps where the type has them) and columns of one topic, without the topic's name."""
    first, places = cdr.decode(one.type, one.schema, one.data[0])
    names = _names(one, first, places)
    table = None
    if all(len(data) == len(one.data[0]) for data in one.data):
        table = np.frombuffer(b''.join(one.data), np.uint8).reshape(len(one.data), -1)
        fixed = np.ones(table.shape[1], bool)
        for place in places.values():
            fixed[place.offset : place.offset + place.size * cdr.dtype(place).itemsize] = False
        if np.any(table[:, fixed] != table[0, fixed]):
            table = None  # names changed (or padding is not zero): read one by one
    if table is not None:
        gathered = {path: _gather(table, place) for path, place in places.items()}
    else:
        rows = []
        for data in one.data:
            value, found = cdr.decode(one.type, one.schema, data)
            if found.keys() != places.keys() or value.get('name') != first.get('name'):
                raise BagError(f'the messages of topic {one.topic} change their names during the recording')
            rows.append({path: np.frombuffer(data, cdr.dtype(place), place.size, place.offset) for path, place in found.items()})
        gathered = {path: np.stack([row[path] for row in rows]) for path in places}
    if 'header.stamp.sec' in gathered:
        times = gathered['header.stamp.sec'][:, 0].astype(np.int64) * 1_000_000_000 + gathered['header.stamp.nanosec'][:, 0]
    else:
        times = np.asarray(one.times, np.int64)
    columns = {name: gathered[path][:, i].astype(np.float64) for name, (path, i) in names.items()}
    order = np.argsort(times, kind='stable')
    keep = order[np.flatnonzero(np.diff(times[order], append=np.iinfo(np.int64).max))]  # of equal times the last
    if keep.size == times.size and np.all(keep == np.arange(times.size)):
        return times, columns
    return times[keep], {name: values[keep] for name, values in columns.items()}


def _gather(table: np.ndarray, place: cdr.Place) -> np.ndarray:
    """Return the numbers at `place` of all messages (rows of bytes), shape (n, count)."""
    dtype = cdr.dtype(place)
    part = np.ascontiguousarray(table[:, place.offset : place.offset + place.size * dtype.itemsize])
    return part.view(dtype) if place.size else np.zeros((len(table), 0), dtype)


def _names(one: _Series, first: dict[str, Any], places: dict[str, cdr.Place]) -> dict[str, tuple[str, int]]:
    """Map column names to (field path, index in it)."""
    if one.type == JOINT_STATE:
        filled = [part for part in ('position', 'velocity', 'effort') if places[part].size]
        plain = filled == ['position'] and not one.topic.endswith('joint_states')
        return {
            name if plain else f'{name}/{part}': (part, i)
            for part in filled
            for i, name in enumerate(first['name'])
            if i < places[part].size
        }
    if one.type in _BLOCKS:
        paths = list(places)
        return {
            name: (path, 0)
            for start, names in _BLOCKS[one.type]
            for name, path in zip(names, paths[paths.index(start) : paths.index(start) + len(names)])
        }
    return {
        path.replace('.', '/') + (f'/{i}' if place.size > 1 else ''): (path, i)
        for path, place in places.items()
        if not path.startswith('header.')
        for i in range(place.size)
    }


def recover(source: str | Path, destination: str | Path) -> Recovered:
    """Copy every complete chunk of a recording that was cut off (or of a whole one) into a new bag directory.

    Raises BagError if the source is not MCAP, nothing complete is in it, or the destination cannot be written.
    """
    path = find_file(source, unfinished=True)
    series, metadata, complete = _scan(path)
    merged = sorted((t, k, i) for i, one in enumerate(series.values()) for k, t in enumerate(one.times))
    if not merged:
        raise BagError(f'{path} holds no complete chunk: nothing can be recovered')
    every = list(series.values())
    metadata.setdefault(RESULT, {})['recovered_from'] = path.name
    topics = [Topic(one.topic, one.type, depth=1 if one.topic.endswith('robot_description') else 10) for one in every]
    writer = BagWriter(destination, topics, metadata, schemas={one.type: one.schema for one in every})
    for t, k, i in merged:
        writer.write(t, [(i, every[i].data[k])])
    directory = writer.finish()
    return Recovered(directory, len(merged), merged[0][0], merged[-1][0], complete)
