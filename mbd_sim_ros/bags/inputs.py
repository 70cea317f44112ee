"""Recordings as what was applied and what came of it: the inputs of every step, and the messages of every topic as they
are.

For replays (mbd replay) and for the maneuver of a scene that takes its inputs from a recording.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import yaml
from mcap.records import Channel, Metadata, Schema

from mbd_sim_ros.bags import published
from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.bags.files import open_recording
from mbd_sim_ros.bags.patterns import INDEX
from mbd_sim_ros.bags.records import Messages
from mbd_sim_ros.bags.writer import RECORD, RESULT
from mbd_sim_ros.messages.cdr import decode, dtype
from mbd_sim_ros.messages.definitions import schema_text
from mbd_sim_ros.messages.topics import ARRAY, INPUTS, JOINT_STATE, ODOMETRY, TF
from solver.errors import BagError, MbdError, SpecError
from solver.files.yaml_tree import parse
from solver.inputs.maneuver import ReplaySource
from solver.inputs.recorded import BagChannel, Recorded, Track

APPLIED = 'cmd_applied'
MOST_STEPS = 2.0**53  # a number of a step that is exact
DESCRIPTION = 'robot_description'


class Content(NamedTuple):
    """A recording: its messages by topic (without the namespace of the node), and what it says about itself."""

    path: Path
    topics: dict[str, dict[int, bytes]]  # topic -> instant [ns] -> message
    metadata: dict[str, str]
    further: Mapping[str, list[tuple[int, bytes]]] = MappingProxyType(
        {}
    )  # topic -> (instant, message) where the instant has another one before
    # a recording of topics (bags/published.py): instants are stamps, and any message may be missing
    published: bool = False

    @property
    def outputs(self) -> dict[str, dict[int, bytes]]:
        """The topics that a run produces."""
        return {name: messages for name, messages in self.topics.items() if name not in (INPUTS.name, DESCRIPTION)}

    @property
    def state(self) -> bytes | None:
        """The state it begins with, where that is not the start of its scene. Raises BagError for one of another
        version."""
        text = self.metadata.get('start_state', '')
        if not text:
            return None
        from solver.model.state import load_arrays, require_format  # brings numba, which who only reads need not have

        try:
            data = base64.b64decode(text, validate=True)
            require_format(load_arrays(data), 'its state at the beginning')
        except ValueError:
            raise BagError(f'{self.path} is damaged: its metadata hold a start_state that is not base64') from None
        except SpecError as error:
            raise BagError(f'{self.path}: cannot be replayed: {error}') from None
        return data

    @property
    def first_step(self) -> int | None:
        """The step it begins behind; None when it does not say."""
        return None if 'start_step' not in self.metadata else self.count('start_step')

    @property
    def dropped_steps(self) -> int:
        """Number of steps that a slow disk did not take."""
        return self.count('dropped_steps')

    @property
    def parameters(self) -> dict[str, Any]:
        """The parameters of the node that made it."""
        return self._mapping('parameters')

    @property
    def target(self) -> dict[str, Any]:
        """The processor it was made on (solver.compiled.target)."""
        return self._mapping('target')

    def count(self, key: str) -> int:
        """An entry of the metadata that is a number of steps; 0 without it. Raises BagError."""
        text = self.metadata.get(key, '') or '0'
        if not (text.isascii() and text.isdigit() and len(text) < 16):
            raise BagError(
                f'{self.path} is damaged: its metadata say {key} = {text[:40]!r}, which is not a number of steps'
            )
        return int(text)

    def _mapping(self, key: str) -> dict[str, Any]:
        """An entry of the metadata that is a YAML mapping; empty without it. Raises BagError."""
        text = self.metadata.get(key, '')
        try:
            parse(text or '{}', key)  # its bounds first
            value = yaml.safe_load(text or '{}')
        except (MbdError, yaml.YAMLError, ValueError):
            value = None
        if not isinstance(value, dict):
            raise BagError(f'{self.path} is damaged: its metadata say {key} = {text[:40]!r}, which is not a mapping')
        return value


class Inputs(NamedTuple):
    """The inputs of every step in a recording."""

    first: int  # index of the first step: it leads from first * h to (first + 1) * h
    last: int  # index of the last instant
    rows: dict[str, np.ndarray]  # input -> (last - first,)
    start: dict[str, float]  # input -> value at the beginning, where that is recorded
    h_ns: int
    from_start: bool  # the instant before the first step is in the recording too

    def source(self, names: Sequence[str]) -> ReplaySource:
        """Rows for a simulation that counts its steps like the recording. Raises SpecError when an input is missing."""
        return ReplaySource(tuple(names), self.rows, np.arange(self.first, self.last))


def content(path: str | Path) -> Content:
    """Read a whole recording, of this package or of the topics of the node. Raises BagError if it is none, or was cut
    off."""
    path = Path(path)
    names: dict[int, str] = {}
    kinds: dict[int, str] = {}
    schemas: dict[int, Schema] = {}
    found: dict[int, list[tuple[int, bytes]]] = {}
    metadata: dict[str, dict[str, str]] = {}
    reading = open_recording(path, skip=set())
    for record in reading:
        if isinstance(record, Messages):
            found.setdefault(record.channel, []).extend(zip(record.log_times, record.data))
        elif isinstance(record, Channel):
            names[record.id] = record.topic
            kinds[record.id] = schemas[record.schema_id].name if record.schema_id in schemas else ''
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Metadata):
            metadata[record.name] = record.metadata
    reading.require_whole()
    if missing := found.keys() - names.keys():
        raise BagError(f'{path} is damaged: it holds messages of channel {min(missing)}, which it does not declare')
    about = {**metadata.get(RECORD, {}), **metadata.get(RESULT, {})}
    said = None if RECORD in metadata else published.told(path)
    namespace = (about.get('namespace', '') if said is None else said.namespace).strip('/')
    own = {
        channel: name.strip('/').removeprefix(namespace + '/' if namespace else '') for channel, name in names.items()
    }
    topics: dict[str, dict[int, bytes]] = {}
    further: dict[str, list[tuple[int, bytes]]] = {}
    for channel, messages in found.items():
        topic, kind = own[channel], kinds[channel]
        if said is not None:
            if not published.is_ours(topic, kind):
                continue
            messages = [(published.stamp_of(path, topic, kind, data), data) for _, data in messages]
        at = topics.setdefault(topic, {})
        for t_ns, data in messages:
            if at.setdefault(t_ns, data) is not data:
                further.setdefault(topic, []).append((t_ns, data))
    if said is not None:
        return _of_topics(path, topics, further, said)
    for topic, messages in further.items():
        if other := next((t_ns for t_ns, data in messages if topics[topic][t_ns] != data), None):
            raise BagError(
                f'{path} is damaged: it holds two different messages of topic {topic} at {other * 1e-9:.9g} s'
            )
    return Content(path, topics, about)


def _of_topics(
    path: Path, topics: dict[str, dict[int, bytes]], further: dict[str, list[tuple[int, bytes]]], said: published.Told
) -> Content:
    """The content of a recording of topics. Raises BagError where the simulation goes back in it."""
    first, repeated = topics.get(APPLIED, {}), further.get(APPLIED, [])
    steps: list[int] = []
    if first:
        messages = [*first.items(), *repeated]
        steps = (
            _applied(dict(enumerate(data for _, data in messages)), path, ordered=False)[1][:, -1].astype(int).tolist()
        )
        end, last = max((t_ns, k) for (t_ns, _), k in zip(messages, steps))
        if any(t_ns * last != k * end or (k and not t_ns) for (t_ns, _), k in zip(messages, steps)):
            raise BagError(
                f'{path}: the stamps of {APPLIED} do not follow its steps, so it is not that of this simulator'
            )
        steps = steps[: len(first)]
        back = [f'from step {a} to step {b}' for a, b in pairwise(steps) if b <= a]
        back += [f'to {t_ns * 1e-9:.9g} s' for t_ns, data in repeated if first[t_ns] != data]
        if back:
            raise BagError(
                f'{path} holds more than one run: the simulation goes back {back[0]} (a reset, or another start); '
                'start `ros2 bag record` behind the reset, and record each run into a bag of its own'
            )
    frame = ''
    for topic, kind in (('odom', ODOMETRY), ('tf', TF)):
        if not frame and topics.get(topic):
            value = decode(kind, schema_text(kind), next(iter(topics[topic].values())))[0]
            heads = [value, *value.get('transforms', ())]
            frame = next((one['header']['frame_id'] for one in heads if 'header' in one), '')
    metadata = published.about(said, steps[0] if steps else None, frame)
    return Content(path, topics, metadata, further, published=True)


def inputs_of(recording: Content) -> Inputs:
    """The inputs of every step in a recording of this package.

    Raises BagError when it is not one, or when steps are missing between the first and the last.
    """
    where = recording.path
    messages = recording.topics.get(APPLIED, {})
    if not messages:
        raise BagError(f'{where} does not say what was applied: it has no messages of topic {APPLIED}')
    names, table = _applied(messages, where)
    step = table[:, -1].astype(np.int64)
    blocks = [_block(data, names, where) for data in recording.topics.get(INPUTS.name, {}).values()]
    every = np.vstack([np.column_stack([step, table[:, :-1]]), *blocks])
    _, keep = np.unique(every[:, 0], return_index=True)
    every = every[keep]
    first = recording.first_step
    if first is None:  # made before recordings said so
        first = 0 if step[0] == 0 else int(every[0, 0]) - 1
    from_start = bool(step[0] == first)
    start = dict(zip(names, table[0, :-1].tolist())) if from_start else {}
    every = every[every[:, 0] > first]
    last = int(step[-1])
    steps = every[:, 0].astype(np.int64)
    steps = steps[steps <= last]
    if steps.size != last - first:
        follows = np.flatnonzero(steps != first + 1 + np.arange(steps.size))  # steps are ascending and all different
        lacking = first + 1 + int(follows[0] if follows.size else steps.size)
        count = last - first - steps.size
        why = f': {published.gaps(steps.tolist())}' if recording.published else ''
        raise BagError(
            f'{where} cannot be replayed: it does not hold the inputs of step {lacking} ({count} steps are '
            f'missing){why}'
        )
    rows = {name: np.ascontiguousarray(every[:, 1 + i]) for i, name in enumerate(names)}
    h_ns = max(messages) // last if last else 0
    return Inputs(first, last, rows, start, h_ns, from_start)


def _applied(messages: Mapping[int, bytes], where: Path, *, ordered: bool = True) -> tuple[list[str], np.ndarray]:
    """Names of the inputs, and a table (n, nu + 1) of them and the index of the step, in the order of the steps
    (ordered) or messages."""
    data = list(messages.values())
    value, places = decode(JOINT_STATE, schema_text(JOINT_STATE), data[0])
    place = places['position']
    names = list(value['name'])
    if names[-1:] != ['step'] or place.size != len(names) or any(len(one) != len(data[0]) for one in data):
        raise BagError(
            f'{where}: the topic {APPLIED} was not recorded by this program (it needs the inputs and the step by name)'
        )
    table = np.stack([np.frombuffer(one, dtype(place), place.size, place.offset) for one in data])
    if not (
        np.isfinite(table).all()
        and np.all((table[:, -1] >= 0.0) & (table[:, -1] < MOST_STEPS) & (table[:, -1] % 1.0 == 0.0))
    ):
        raise BagError(
            f'{where} is damaged: the topic {APPLIED} holds an input that is not finite, or a step that is no whole '
            f'number from 0 to below {MOST_STEPS:.0e}'
        )
    return names[:-1], table[np.argsort(table[:, -1], kind='stable')] if ordered else table


def _block(data: bytes, names: Sequence[str], where: Path) -> np.ndarray:
    """(n, 1 + nu) the rows of one message of inputs_applied, columns step and `names`."""
    value, _ = decode(ARRAY, schema_text(ARRAY), data)
    dimensions = value['layout']['dim']
    labels = dimensions[-1]['label'].split(',') if len(dimensions) == 2 else []
    if len(labels) != len(names) + 1 or set(labels) != {'step', *names} or value['data'].size % len(labels):
        raise BagError(f'{where}: the topic {INPUTS.name} holds other inputs ({",".join(labels)}) than {APPLIED}')
    rows = value['data'].reshape(-1, len(labels))
    if not np.isfinite(rows).all():
        raise BagError(f'{where}: the topic {INPUTS.name} holds a value that is not finite')
    return rows[:, [labels.index(name) for name in ('step', *names)]]


def recorded_inputs(path: str, channels: Mapping[str, BagChannel], log_times: bool = False) -> Recorded:
    """Recorded inputs that `maneuver: {bag: path, map: channels, log_times: log_times}` stands for
    (solver.inputs.recorded.READER). Raises BagError."""
    where = f'maneuver: bag {path}'
    if not channels:
        found = inputs_of(content(path))
        if found.last == found.first:
            raise BagError(f'{where}: it holds no step')
        return Recorded(where, found.h_ns, found.first, found.rows, found.start, {}, found.last - found.first)
    run = bag.read(path, [INDEX.sub(r'[[]\1]', channel.channel) for channel in channels.values()], log_times=log_times)
    tracks = {}
    for name, channel in channels.items():
        if all(channel.channel not in one.columns for one in run.series.values()):
            raise BagError(
                f'maneuver: map: {name}: {path} has no channel {channel.channel!r}{run.instead_of(channel.channel)}'
            )
        series = next(one for one in run.series.values() if channel.channel in one.columns)
        values = series.columns[channel.channel]
        at = np.isfinite(values)
        if not at.any():
            raise BagError(f'maneuver: map: {name}: channel {channel.channel!r} of {path} holds no number')
        tracks[name] = Track(series.time_ns[at], channel.scale * values[at] + channel.offset)
    return Recorded(where, 0, 0, {}, {}, tracks, doubts=run.doubts)
