"""Column names of the numbers in a decoded message, and the place of each number in the message.

The columns of named values are called by these names, so that their order in the message does not matter:

    JointState             <joint>/position|velocity|effort
    other named values     <field>/<name>, e.g. `values` of DiagnosticStatus, `interface_values` of DynamicJointState;
                           <name> alone where no other field of the message has numbers
    numbers without names  <field path>, with an index in lists

The names stand in a list beside the values (LISTS, e.g. `joint_names`) or in a field of each value (ITEMS, e.g. `key`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_sim_ros.messages import cdr
from mbd_sim_ros.messages.topics import IMU, JOINT_STATE, ODOMETRY, WRENCH
from solver.errors import BagError

_XYZ, _QUATERNION, _TWIST = ('x', 'y', 'z'), ('qx', 'qy', 'qz', 'qw'), ('vx', 'vy', 'vz', 'wx', 'wy', 'wz')
# Message types with fixed columns: (first of several float64 fields that follow each other, column names of these
# fields).
_BLOCKS = {
    ODOMETRY: (
        ('pose.pose.position.x', [f'pose/{name}' for name in _XYZ + _QUATERNION]),
        ('twist.twist.linear.x', [f'twist/{name}' for name in _TWIST]),
    ),
    IMU: (
        ('orientation.x', _QUATERNION),
        ('angular_velocity.x', _TWIST[3:]),
        ('linear_acceleration.x', ('ax', 'ay', 'az')),
    ),
    WRENCH: (('wrench.force.x', ('fx', 'fy', 'fz', 'mx', 'my', 'mz')),),
}
# Columns of one topic at most: a message with more is an image or a point cloud. Ten times as many would keep 0.3 MB of
# every message.
COLUMNS_MAX = 4096
# Fields of a message whose texts name the items of the lists beside them.
LISTS = ('name', 'names', 'joint_names', 'interface_names', 'keys', 'labels', 'interface_groups')
# Fields of an item of a list whose text names that item.
ITEMS = ('name', 'key', 'joint_name', 'child_frame_id', 'label', 'id')
PARTS = ('position', 'velocity', 'effort')  # fields of a JointState with numbers
TEXT = -1  # Pick.place of a number that the message holds as text


class Pick(NamedTuple):
    """Place in a message of the number of one column. path: the field. place: index of the number in the field, or
    TEXT."""

    path: str
    place: int


class Named(NamedTuple):
    """Columns of a message. columns: column name within the topic -> place. sizes: name of a list without names -> its
    size."""

    columns: dict[str, Pick]
    sizes: dict[str, int]


def named(
    topic: str, kind: str, value: dict[str, Any], places: Mapping[str, cdr.Place], plain: bool | None = None
) -> Named:
    """Columns of a decoded message.

    kind: message type. value: the decoded message. places: field path -> its bytes. plain: whether a position of a
    JointState is the column <joint> instead of <joint>/position; None lets is_plain() decide. Raises BagError for a
    message that has too many numbers, or names two of them alike.
    """
    numbers = sum(place.size for path, place in places.items() if not path.startswith('header.'))
    if numbers > COLUMNS_MAX:
        raise BagError(f'a message holds {numbers} numbers, more than {COLUMNS_MAX}')
    if kind == JOINT_STATE:
        return Named(_of_joints(topic, value.get('name'), places, plain), {})
    if kind in _BLOCKS:
        paths = list(places)
        if any(start not in paths for start, _ in _BLOCKS[kind]):
            raise BagError(f'the bag defines {kind} in another way than ROS does')
        return Named(
            {
                name: Pick(path, 0)
                for start, names in _BLOCKS[kind]
                for name, path in zip(names, paths[paths.index(start) : paths.index(start) + len(names)])
            },
            {},
        )
    found = Named({}, {})
    _message({name: field for name, field in value.items() if name != 'header'}, '', '', (), found)
    return found


def _of_joints(topic: str, names: Any, places: Mapping[str, cdr.Place], plain: bool | None) -> dict[str, Pick]:
    """Columns of a JointState."""
    if not isinstance(names, list) or any(part not in places for part in PARTS):
        raise BagError(f'the bag defines {JOINT_STATE} in another way than ROS does')
    filled = [part for part in PARTS if places[part].size]
    if len(set(names)) != len(names):
        raise BagError(f'a message names {next(name for name in names if names.count(name) > 1)!r} twice')
    for part in filled:
        if places[part].size != len(names):
            raise BagError(f'a message has {len(names)} names and {places[part].size} values of {part}')
    alone = plain if plain is not None else is_plain(topic, places)
    return {
        name if alone and part == PARTS[0] else f'{name}/{part}': Pick(part, i)
        for part in filled
        for i, name in enumerate(names)
    }


def is_plain(topic: str, places: Mapping[str, cdr.Place]) -> bool:
    """True where a JointState holds named scalars: positions only, in a topic that is not called joint_states."""
    return [part for part in PARTS if places[part].size] == [PARTS[0]] and not topic.endswith('joint_states')


def _message(node: Mapping[str, Any], path: str, shown: str, names: Sequence[str], found: Named) -> None:
    """Add the columns of a message, or of one inside of it, to `found`.

    path: its field path. shown: the beginning of its column names. names: of the items of the lists around it.
    """
    names = next((_distinct(node[name]) for name in LISTS if _texts(node.get(name))), names)
    bearing = [name for name, field in node.items() if not _texts(field) and not isinstance(field, str)]
    for name, field in node.items():
        inner, called = f'{path}.{name}' if path else name, f'{shown}/{name}' if shown else name
        if isinstance(field, str):
            if name == 'value' and 'key' in node:
                _add(found, called, Pick(inner, TEXT))
        elif isinstance(field, dict):
            _message(field, inner, called, names, found)
        elif not isinstance(field, (list, np.ndarray)):
            _add(found, called, Pick(inner, 0))
        elif not _texts(field):
            labels = _labels(field, names)
            if not labels:
                found.sizes[called] = len(field)
            elif bearing == [name]:
                called = shown
            _items(field, inner, called, labels, found)


def _items(field: list | np.ndarray, path: str, shown: str, labels: Sequence[str], found: Named) -> None:
    """Add the columns of the items of a list to `found`. labels: names of the items, or () where they have none."""
    for i, item in enumerate(field):
        label = labels[i] if labels else str(i)
        if isinstance(item, dict):
            inside = f'{shown}/{label}'.lstrip('/') if labels else f'{shown}[{i}]'
            own = [name for name in item if name not in ITEMS]
            if labels and own == ['value']:  # {name, value} is one column
                text = isinstance(item['value'], str)
                if text or not isinstance(item['value'], (dict, list, np.ndarray)):
                    _add(found, inside, Pick(f'{path}[{i}].value', TEXT if text else 0))
                    continue
            _message(item, f'{path}[{i}]', inside, (), found)
        else:
            alone = not labels and len(field) == 1
            _add(found, shown if alone else f'{shown}/{label}'.lstrip('/'), Pick(path, i))


def _labels(field: list | np.ndarray, names: Sequence[str]) -> Sequence[str]:
    """Names of the items of a list, or () where they have none."""
    if len(field) == len(names):
        return names
    if isinstance(field, np.ndarray) or not field:
        return ()
    key = next(
        (
            key
            for key in ITEMS
            if all(isinstance(item, dict) and isinstance(item.get(key), str) and item[key] for item in field)
        ),
        '',
    )
    return _distinct([item[key] for item in field]) if key else ()


def _texts(field: Any) -> bool:
    """True where a field is a list of texts. False for an empty list, whose type is not known."""
    return isinstance(field, list) and bool(field) and isinstance(field[0], str)


def _distinct(names: Sequence[str]) -> list[str]:
    """The names, made different: the second `a` becomes `a#2`, an empty name `_`."""
    seen: Counter[str] = Counter()
    result = []
    for name in names:
        seen[name] += 1
        result.append((name or '_') + (f'#{seen[name]}' if seen[name] > 1 else ''))
    return result


def _add(found: Named, name: str, pick: Pick) -> None:
    if name in found.columns:
        raise BagError(f'a message has two numbers that are called {name!r}')
    found.columns[name] = pick
