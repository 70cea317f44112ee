"""Recordings that `ros2 bag record` made of the node: wall clock in their log times, simulation time in their stamps.

The node tells its scene, latched, on `~/scene`. The first line of that text is a comment with JSON in it: which solver
and processor compute, and the step and, where that is not the start of the scene, the state that the node began with.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import yaml
from mcap.records import Channel, Metadata, Schema

from mbd_sim_ros.bags.applied import begin_of
from mbd_sim_ros.bags.files import open_recording
from mbd_sim_ros.bags.records import Messages
from mbd_sim_ros.bags.writer import RECORD
from mbd_sim_ros.messages.cdr import decode
from mbd_sim_ros.messages.definitions import schema_text
from mbd_sim_ros.messages.topics import ELEMENTS, IMU, JOINT_STATE, MOTIONS, ODOMETRY, STRING, TF, WRENCH, family
from solver.compiled.target import target
from solver.disk import sources
from solver.errors import BagError

if TYPE_CHECKING:
    from solver.scene import Scene

MARK = '# mbd_sim_ros '  # before the line in JSON: a comment in YAML, by which the text is known for ours
SCENE = 'scene'  # last part of the topic with the scene
SCALARS = ('joint_states', 'cmd_applied', 'tire_states', 'reactions', MOTIONS, ELEMENTS)
OF_A_HEADER = (JOINT_STATE, ODOMETRY, IMU, WRENCH)  # types that begin with one
_STAMP = struct.Struct('<iI')  # s, ns
_AFTER = {TF: 8}  # bytes of a message before its first stamp: the encapsulation, and the number of transforms
_ENCAPSULATION = 4


class Told(NamedTuple):
    """Data of a recording about the node whose topics it holds. scene: resolved text, '' where the topic is missing."""

    namespace: str
    scene: str
    head: dict[str, Any]


def tell(scene: Scene, simulation: Any) -> str:
    """The text for `~/scene`."""
    head = {'source_hash': sources(), 'target': target(), **begin_of(simulation)}
    return f'{MARK}{json.dumps(head)}\n{scene.resolved}'


def load_published(name: str | Path, overrides: Sequence[str] = ()) -> Scene:
    """A scene as the node runs it. Raises SceneError.

    Steps of a scene that leaves it open are constant: one that is divided would come late. The recorded scene holds
    that setting.
    """
    from solver.files.scene import load_scene

    scene = load_scene(name, overrides)
    return (
        load_scene(name, [*overrides, 'integrator.step_policy=constant'])
        if scene.integrator.step_policy == 'auto'
        else scene
    )


def told(path: str | Path) -> Told | None:
    """Data of a recording about its node; None for a recording of this package, whose metadata hold them. Raises
    BagError."""
    path, skip = Path(path), set[int]()
    schemas: dict[int, Schema] = {}
    topics: dict[int, str] = {}
    texts: dict[str, list[str]] = {}
    reading = open_recording(path, skip=skip)
    for record in reading:
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            topics[record.id] = record.topic
            kind = schemas[record.schema_id].name if record.schema_id in schemas else ''
            if kind != STRING or record.topic.count('/') < 2 or record.topic.rsplit('/', 1)[-1] != SCENE:
                skip.add(record.id)
        elif isinstance(record, Messages):
            if record.channel not in skip and record.channel in topics:
                said = [decode(STRING, schema_text(STRING), data)[0]['data'] for data in record.data]
                texts.setdefault(topics[record.channel], []).extend(text for text in said if text.startswith(MARK))
        elif isinstance(record, Metadata) and record.name == RECORD:
            return None
    reading.require_whole()
    namespaces = _namespaces(topics.values(), 'cmd_applied') or _namespaces(topics.values(), 'joint_states')
    namespaces = namespaces or list(dict.fromkeys(_namespace(topic) for topic, said in texts.items() if said))
    if len(namespaces) > 1:
        names = ' and '.join(f'/{name}' for name in namespaces)
        raise BagError(
            f'{path} holds the topics of {len(namespaces)} simulators ({names}); record each into a bag of its own'
        )
    namespace = namespaces[0] if namespaces else ''
    own = dict.fromkeys(text for topic, said in texts.items() if _namespace(topic) == namespace for text in said)
    scenes = dict.fromkeys(_parted(path, text)[1] for text in own)
    if len(scenes) > 1:
        raise BagError(
            f'{path} holds {len(scenes)} scenes (~/load, or another start of the node); record each into a bag of its '
            'own'
        )
    return Told(namespace, *reversed(_parted(path, next(reversed(own))))) if own else Told(namespace, '', {})


def _namespaces(topics: Iterable[str], name: str) -> list[str]:
    return list(dict.fromkeys(topic[: -len(name)].strip('/') for topic in topics if topic.rsplit('/', 1)[-1] == name))


def _namespace(topic: str) -> str:
    """That of the node which tells its scene on a topic."""
    return topic.strip('/').rpartition('/')[0].rpartition('/')[0]


def _parted(path: Path, text: str) -> tuple[dict[str, Any], str]:
    """(content of the first line of a text on `~/scene`, the scene)."""
    first, _, rest = text.partition('\n')
    try:
        head = json.loads(first.removeprefix(MARK))
    except (ValueError, RecursionError):
        head = None
    if not isinstance(head, dict):
        raise BagError(f'{path} is damaged: the first line of its topic ~/{SCENE} is no JSON')
    return head, rest


def is_ours(topic: str, kind: str) -> bool:
    """True where the node publishes a topic (without its namespace) of this type, with simulation time in its
    stamps."""
    if family(topic) in SCALARS:
        return kind == JOINT_STATE
    if topic.startswith('tire/'):
        return kind == WRENCH
    return {'odom': ODOMETRY, 'imu': IMU, 'tf': TF}.get(topic) == kind


def stamp_of(path: Path, topic: str, kind: str, data: bytes) -> int:
    """The first stamp in a message of a topic of ours [ns]. Raises BagError."""
    at = _AFTER.get(kind, _ENCAPSULATION)
    if len(data) < at + _STAMP.size or data[1] != 1:
        raise BagError(f'{path}: a message of topic {topic} is too short for a stamp, or not in little-endian CDR')
    seconds, rest = _STAMP.unpack_from(data, at)
    return seconds * 1_000_000_000 + rest


def about(said: Told, first: int | None, frame: str) -> dict[str, str]:
    """Metadata that a recording of this package would have. first: the first step that is in it. frame: of its odometry
    or transforms."""
    head = said.head
    metadata = {
        'resolved_scene': said.scene,
        'source_hash': str(head.get('source_hash', '')),
        'namespace': said.namespace,
    }
    metadata['target'] = yaml.safe_dump(head.get('target', {}))
    if prefix := frame.removesuffix('odom'):
        metadata['parameters'] = yaml.safe_dump({'frame_prefix': prefix})
    begin, state = str(head.get('start_step', '0')), str(head.get('start_state', ''))
    if first is None:
        return metadata
    if state and begin.isdecimal() and first - int(begin) in (0, 1):
        return metadata | {'start_step': begin, 'start_state': state}
    return metadata | ({'start_step': '0'} if first < 2 else {})


def gaps(steps: Sequence[int]) -> str:
    """Why inputs of steps are missing in messages of `cmd_applied` with these numbers, which ascend, and what to do."""
    apart = [b - a for a, b in pairwise(steps)]
    usual = max(set(apart), key=apart.count) if apart else 1
    cause = (
        f'cmd_applied is there at every {usual}th step only: set rate_cmd_applied to 0 and publish_every to 1'
        if usual > 1
        else (
            'they were lost on the way to the recorder: record cmd_applied in a process of its own, or with '
            '~/start_recording'
        )
    )
    return f'{cause}; the same bits take the inputs of every step'
