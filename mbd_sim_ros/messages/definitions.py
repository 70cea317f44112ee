"""Definitions of ROS 2 messages without ROS: their text, and the fields of each type in it.

This package brings those of the messages it writes; recordings of others bring their own. Nothing here needs numpy: the
recording process is there at once.
"""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files
from typing import NamedTuple

FORMATS = {  # primitive -> what it is to struct
    'bool': '?', 'byte': 'B', 'char': 'B', 'int8': 'b', 'uint8': 'B', 'int16': 'h', 'uint16': 'H', 'int32': 'i',
    'uint32': 'I',
    'int64': 'q', 'uint64': 'Q', 'float32': 'f', 'float64': 'd',
}  # fmt: skip

CONSTANT = re.compile(r'\s*\S+\s+\w+\s*=')  # bounds (string<=10, float64[<=3]) and default values may hold a = too


class Field(NamedTuple):
    """One line of a message definition: `size` is None for a single value, 0 for a sequence, n for a fixed array."""

    name: str
    kind: str  # primitive, 'string' or 'package/Type'
    size: int | None


Definitions = dict[str, list[Field]]


@cache
def schema_text(message_type: str) -> str:
    """Return the `ros2msg` schema of e.g. 'sensor_msgs/msg/JointState': its definition and those it refers to.

    The format is that of rosbag2: dependencies follow, depth first, each behind a line of 80 '=' and 'MSG:
    package/Type'. schemas/ holds types, names, order and default values of the fields as in ROS 2 Jazzy (rcl_interfaces
    2.0.3, common_interfaces 5.3.6, geometry2), so that recordings describe themselves where ROS is not installed.
    """
    package, name = message_type.split('/msg/')
    parts: list[str] = []
    seen: set[str] = set()
    todo = [f'{package}/{name}']
    while todo:
        current = todo.pop(0)
        if current in seen:
            continue
        seen.add(current)
        text = (
            files('mbd_sim_ros.messages')  # type: ignore[attr-defined]
            .joinpath('schemas', *current.split('/'))
            .with_suffix('.msg')
            .read_text(encoding='utf-8')
        )
        parts.append(text if not parts else '=' * 80 + f'\nMSG: {current}\n' + text)
        todo += [
            field.kind
            for field in _fields(text, current.split('/')[0])
            if field.kind not in FORMATS and field.kind != 'string'
        ]
    return '\n'.join(parts)


def _fields(text: str, package: str) -> list[Field]:
    fields = []
    for line in text.splitlines():
        bare = line.split('#')[0]
        words = bare.split()
        if len(words) < 2 or CONSTANT.match(bare):
            continue
        kind, _, brackets = words[0].partition('[')
        kind = kind.split('<=')[0]  # bounds of strings do not change the encoding
        if kind not in FORMATS and kind not in ('string', 'wstring') and '/' not in kind:
            kind = f'{package}/{kind}' if kind != 'Header' else 'std_msgs/Header'
        size = brackets.rstrip(']')
        count = int(size) if size.isdecimal() and len(size) < 10 else 0
        fields.append(Field(words[1], kind.replace('/msg/', '/'), count if brackets else None))
    return fields


@cache
def definitions(message_type: str, text: str) -> Definitions:
    """Parse the `ros2msg` schema `text` of a message type into the fields of each type in it ('package/Type')."""
    result: Definitions = {}
    name = message_type.replace('/msg/', '/')
    for part in text.replace('\r\n', '\n').split('=' * 80 + '\n'):
        if result:
            header, _, part = part.partition('\n')
            name = header.removeprefix('MSG:').strip().replace('/msg/', '/')
        result[name] = _fields(part, name.split('/')[0])
    return result
