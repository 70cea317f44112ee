"""Bags made of given numbers: topics of named scalars at their own instants, with their own stamps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from mbd_sim_ros.bags.reader import Run, Series
from mbd_sim_ros.bags.writer import RECORD, BagWriter
from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.topics import JOINT_STATE, Topic

Scalars = Mapping[str, tuple[np.ndarray, Mapping[str, np.ndarray]]]


def write_scalars(
    directory: Path, topics: Scalars, *, frame: Callable[[int], str] = lambda _: 'car', log_ns: int = 0
) -> Path:
    """Write JointState messages with positions only. topics: name -> (instants [ns], columns). frame: frame_id of
    message k.

    log_ns: what the log times are later than the stamps.
    """
    names = list(topics)
    writer = BagWriter(directory, [Topic(name, JOINT_STATE) for name in names], {RECORD: {'scene': 'synthetic'}})
    text = cdr.schema_text(JOINT_STATE)
    order = sorted((int(t), i, k) for i, name in enumerate(names) for k, t in enumerate(topics[name][0]))
    for t, i, k in order:
        columns = topics[names[i]][1]
        header = {'stamp': {'sec': t // 10**9, 'nanosec': t % 10**9}, 'frame_id': frame(k)}
        value = {'header': header, 'name': list(columns), 'position': [v[k] for v in columns.values()]}
        writer.write(t + log_ns, [(i, cdr.encode(JOINT_STATE, text, value)[0])])
    return writer.finish()


def write_mcap(
    file: Path,
    channels: Sequence[tuple[str, str, str | bytes, Sequence[tuple[int, bytes]]]],
    metadata: Mapping[str, Mapping[str, str]] | None = None,
    **options: Any,
) -> Path:
    """Write a file with the mcap library. channels: topic, type, schema, [(log time, message)]. options: of
    mcap.writer.Writer."""
    with file.open('wb') as stream:
        writer = Writer(stream, **{'compression': CompressionType.NONE, **options})
        writer.start(profile='ros2', library='test')
        for name, record in (metadata or {}).items():
            writer.add_metadata(name, dict(record))
        for topic, kind, text, messages in channels:
            schema = writer.register_schema(kind, 'ros2msg', text.encode() if isinstance(text, str) else text)
            channel = writer.register_channel(topic, 'cdr', schema)
            for k, (t, data) in enumerate(messages):
                writer.add_message(channel, t, data, t, k)
        writer.finish()
    return file


def run_of(columns: Mapping[str, np.ndarray], time_ns: np.ndarray, metadata: dict[str, str] | None = None) -> Run:
    """A run whose columns are all at the same instants."""
    return Run(
        {'': Series(np.asarray(time_ns, np.int64), {n: np.asarray(v, float) for n, v in columns.items()})},
        metadata or {},
    )


def run(n: int = 101, h_ns: int = 10_000_000, start_ns: int = 0, **columns: Callable[[np.ndarray], np.ndarray]) -> Run:
    """A run of functions of time [s], counted from its start."""
    t = np.arange(n) * h_ns
    return run_of({name: f(t * 1e-9) for name, f in columns.items()}, start_ns + t)


def joined(*runs: Run) -> Run:
    """One run of several, each a topic of its own with its own instants."""
    return Run({str(k): one for k, r in enumerate(runs) for one in r.series.values()}, runs[0].metadata)
