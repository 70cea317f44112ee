"""Recordings as others make them: times in bursts, of coarse clocks, backwards, twice; several publishers; every kind
of file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer
from rosbags.typesys import Stores, get_typestore

from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.definitions import schema_text
from mbd_sim_ros.messages.topics import JOINT_STATE

DAY = 1_700_000_000_000_000_000  # ns
MS = 1_000_000
FLOAT, VECTOR, STRING = 'std_msgs/msg/Float64', 'geometry_msgs/msg/Vector3Stamped', 'std_msgs/msg/String'
STORE = get_typestore(Stores.ROS2_HUMBLE)
KINDS = ('mcap', 'mcap zstd', 'mcap lz4', 'mcap plain', 'mcap packed', 'db3', 'db3 file', 'db3 message')


class Message(NamedTuple):
    """One message: its topic, type, times [ns] and bytes."""

    topic: str
    type: str
    log: int
    publish: int
    data: bytes


def definition(kind: str) -> str:
    """The definition of a type in ros2msg."""
    return schema_text(kind) if kind == JOINT_STATE else STORE.generate_msgdef(kind, ros_version=2)[0]


def stamped(t_ns: int, frame: str = 'car') -> dict:
    """A header."""
    return {'stamp': {'sec': t_ns // 10**9, 'nanosec': t_ns % 10**9}, 'frame_id': frame}


def scalar(topic: str, log: int, publish: int, value: float) -> Message:
    """A number without a header."""
    return Message(topic, FLOAT, log, publish, cdr.encode(FLOAT, definition(FLOAT), {'data': value})[0])


def vector(topic: str, log: int, publish: int, stamp: int, z: float) -> Message:
    """A vector with a header."""
    value = {'header': stamped(stamp), 'vector': {'x': 0.0, 'y': 0.0, 'z': z}}
    return Message(topic, VECTOR, log, publish, cdr.encode(VECTOR, definition(VECTOR), value)[0])


def joints(topic: str, log: int, publish: int, stamp: int, values: dict[str, float], frame: str = '') -> Message:
    """Positions by name."""
    value = {'header': stamped(stamp, frame), 'name': list(values), 'position': list(values.values())}
    return Message(topic, JOINT_STATE, log, publish, cdr.encode(JOINT_STATE, definition(JOINT_STATE), value)[0])


def text(topic: str, log: int, publish: int, words: str) -> Message:
    """A text."""
    return Message(topic, STRING, log, publish, cdr.encode(STRING, definition(STRING), {'data': words})[0])


def write(place: Path, messages: Sequence[Message], kind: str = 'mcap') -> Path:
    """A recording of these messages in this order; where it is, to be read."""
    if kind.startswith('db3'):
        return _write_db3(place, messages, kind.partition(' ')[2])
    place.mkdir()
    file = place / 'bag_0.mcap'
    compression = {'mcap zstd': CompressionType.ZSTD, 'mcap lz4': CompressionType.LZ4}.get(kind, CompressionType.NONE)
    with file.open('wb') as stream:
        writer = Writer(stream, compression=compression, use_chunking=kind != 'mcap plain', chunk_size=2000)
        writer.start(profile='ros2', library='test')
        channels: dict[tuple[str, str], int] = {}
        for k, one in enumerate(messages):
            if (one.topic, one.type) not in channels:
                schema = writer.register_schema(one.type, 'ros2msg', definition(one.type).encode())
                channels[one.topic, one.type] = writer.register_channel(one.topic, 'cdr', schema)
            writer.add_message(channels[one.topic, one.type], one.log, one.data, one.publish, k)
        writer.finish()
    if kind == 'mcap packed':
        import zstandard

        (place / 'bag_0.mcap.zstd').write_bytes(zstandard.compress(file.read_bytes()))
        file.unlink()
    return place


def _write_db3(place: Path, messages: Sequence[Message], mode: str) -> Path:
    writer = Rosbag2Writer(place, version=8, storage_plugin=StoragePlugin.SQLITE3)
    if mode:
        writer.set_compression(
            {'file': CompressionMode.FILE, 'message': CompressionMode.MESSAGE}[mode], CompressionFormat.ZSTD
        )
    with writer:
        connections = {}
        for one in messages:
            if (one.topic, one.type) not in connections:
                connections[one.topic, one.type] = writer.add_connection(one.topic, one.type, typestore=STORE)
            writer.write(connections[one.topic, one.type], one.log, one.data)
    return place


def random_messages(rng: np.random.Generator) -> list[Message]:
    """What recordings of others hold, at random: one to four topics, each with times of its own kind."""
    found: list[Message] = []
    for k in range(int(rng.integers(1, 5))):
        n = int(rng.integers(1, 60))
        true = DAY + np.arange(n) * 10 * MS
        shape = rng.choice(
            ['steady', 'bursts', 'quantised', 'reversed', 'doubled', 'overtaken', 'two clocks', 'constant', 'anew']
        )
        times = {
            'quantised': true // (40 * MS) * 40 * MS,
            'reversed': true[::-1],
            'doubled': np.repeat(true, 2)[:n],
            'overtaken': true + rng.integers(-30, 30, n) * MS,
            'two clocks': true - DAY,
            'constant': np.full(n, true[0]),
            'anew': np.where(np.arange(n) < n // 2, true + 5000 * MS, true),
        }.get(str(shape), true)
        log = -(-true // (500 * MS)) * 500 * MS if shape == 'bursts' else true if rng.random() < 0.7 else times
        publish = np.zeros(n, int) if rng.random() < 0.3 else np.maximum(times, 0)
        topic, kind = f'/topic_{k}' if rng.random() < 0.9 else '/tf', int(rng.integers(5))
        sets = [{'a': 1.0}, {'b': 2.0, 'a': 3.0}, {'c': np.nan}, {}][: int(rng.integers(1, 5))]
        for i in range(n):
            at = int(log[i]), int(publish[i])
            if kind == 0:
                found.append(scalar(topic, *at, float(i)))
            elif kind == 1:
                found.append(vector(topic, *at, int(times[i]), float(i)))
            elif kind == 2:
                found.append(joints(topic, *at, int(times[i]), sets[i % len(sets)], 'x' * int(rng.integers(3))))
            elif kind == 3:
                found.append(text(topic, *at, f'word {i}'))
            else:
                found.append(joints(topic, *at, 0, {f'j{i % 50}': float(i)}))
    return sorted(found, key=lambda one: one.log) if rng.random() < 0.7 else found
