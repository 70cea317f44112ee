"""The poses in a recording: where every body was, from the transforms in /tf."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.records import Channel, Schema

from mbd_sim_ros.bags.files import open_recording
from mbd_sim_ros.bags.records import Messages
from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.definitions import schema_text
from mbd_sim_ros.messages.topics import TF
from solver.errors import BagError

NUMBERS = 7  # x y z, qx qy qz qw: they lie side by side in a transform


@dataclass(frozen=True, kw_only=True)
class Poses:
    """Placements of frames in the frame `root`.

    time_ns: (n,) int64, ascending. frames: their names. pose: (n, frames, 7) positions [m] and quaternions xyzw.
    """

    root: str
    time_ns: np.ndarray
    frames: tuple[str, ...]
    pose: np.ndarray


def read_poses(path: str | Path) -> Poses:
    """The poses in a bag directory or .mcap file, at the instants at which most frames were placed, by the stamps of
    the transforms where these are set (clocks.py); of several poses of one instant, as a paused node publishes them,
    the last.

    Raises BagError if it is no recording, holds no transforms, or its stamps go back.
    """
    path = Path(path)
    schemas: dict[int, Schema] = {}
    channels: set[int] = set()
    skip: set[int] = set()
    found: dict[int, list[tuple[int, bytes]]] = defaultdict(list)  # by size: messages of one size place the same frames
    reading = open_recording(path, skip=skip)
    for record in reading:
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            of_it = schemas.get(record.schema_id)
            if record.topic.rsplit('/', 1)[-1] == 'tf' and of_it is not None and of_it.name == TF:
                channels.add(record.id)
            else:
                skip.add(record.id)
        elif isinstance(record, Messages) and record.channel in channels:
            for log_time, data in zip(record.log_times, record.data):
                found[len(data)].append((log_time, data))
    reading.require_whole()
    if not found:
        raise BagError(
            f'{path}: the topic /tf is missing, so nobody knows where the bodies were; record with record.poses above 0'
        )
    return _poses(path, found[max(found)])


def _poses(path: Path, messages: Sequence[tuple[int, bytes]]) -> Poses:
    """Those in messages (time, TFMessage) of one size. Every TFMessage has the fields of ours, whatever comments its
    definition has."""
    kind, schema = TF, schema_text(TF)
    value, places = cdr.decode(kind, schema, messages[0][1])
    transforms = value['transforms']
    parents = [transform['header']['frame_id'] for transform in transforms]
    if not parents:
        raise BagError(f'{path}: the messages of /tf hold no transforms')
    root = max(dict.fromkeys(parents), key=parents.count)
    picks = [i for i, parent in enumerate(parents) if parent == root]
    names = [transforms[i]['child_frame_id'] for i in picks]
    final = cdr.decode(kind, schema, messages[-1][1])[0]['transforms']
    if [transform['child_frame_id'] for transform in final] != [
        transform['child_frame_id'] for transform in transforms
    ]:
        raise BagError(f'{path}: the frames in /tf change their names during the recording')
    table = np.frombuffer(b''.join(data for _, data in messages), np.uint8).reshape(len(messages), -1)
    pose = np.empty((len(messages), len(picks), NUMBERS))
    for k, i in enumerate(picks):
        begin = places[f'transforms[{i}].transform.translation.x'].offset
        pose[:, k] = np.ascontiguousarray(table[:, begin : begin + 8 * NUMBERS]).view(np.float64)
    logged = np.array([log_time for log_time, _ in messages], np.int64)
    order = np.argsort(logged, kind='stable')
    at = places[f'transforms[{picks[0]}].header.stamp.sec'].offset
    stamps = np.ascontiguousarray(table[order, at : at + 8]).view('<i4').astype(np.int64)
    times = stamps[:, 0] * 1_000_000_000 + stamps[:, 1]
    if len(times) > 1 and np.all(times == times[0]):  # not set
        times = logged[order]
    back = np.flatnonzero(np.diff(times) < 0)
    if back.size:
        before, after = times[back[0]] * 1e-9, times[back[0] + 1] * 1e-9
        raise BagError(
            f'{path} holds more than one run: the stamps of /tf go back from {before:.9g} to {after:.9g} s (a reset, '
            'or another start)'
        )
    last = np.append(np.diff(times) > 0, True)
    return Poses(root=root, time_ns=times[last], frames=tuple(names), pose=pose[order][last])
