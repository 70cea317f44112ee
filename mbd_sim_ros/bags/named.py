"""Names of the numbers in a message: what is a column, and where in the message its number lies.

A set of named values is columns by name, whatever the order of the names: of JointState
`<joint>/position|velocity|effort`, of others `<field>/<name>` (`interface_values` of DynamicJointState, `values` of
DiagnosticStatus), or `<name>` alone where a message has no other field with numbers. Names are those of a list beside
the values (`joint_names`) or of a field of each value (`key`, `child_frame_id`). Other numbers are `<field path>`,
with an index in lists.
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
# Per type: first field of a run of float64, and the column names of that run.
_BLOCKS = {
    ODOMETRY: (
        ('pose.pose.position.x', [f'pose/{name}' for name in _XYZ + _QUATERNION]),
        ('twist.twist.linear.x', [f'twist/{name}' for name in _TWIST]),
    ),
    IMU: (('orientation.x', _QUATERNION), ('angular_velocity.x', _TWIST[3:]), ('linear_acceleration.x', ('ax', 'ay', 'az'))),
    WRENCH: (('wrench.force.x', ('fx', 'fy', 'fz', 'mx', 'my', 'mz')),),
}
COLUMNS_MAX = 4096  # of one topic; a cloud of points is no set of channels
LISTS = ('name', 'names', 'joint_names', 'interface_names', 'keys', 'labels', 'interface_groups')  # fields that name the items of others
ITEMS = ('name', 'key', 'joint_name', 'child_frame_id', 'label', 'id')  # fields of an item that name it
PARTS = ('position', 'velocity', 'effort')  # of a JointState
TEXT = -1  # place of a number that is written as text


class Pick(NamedTuple):
    """Place of the number of a column: the field, and which of its numbers (TEXT: its text is the number)."""

    path: str
    place: int


class Named(NamedTuple):
    """The columns of a message by their names in the topic, and the sizes of its lists that nobody names, by what is shown of them."""

    columns: dict[str, Pick]
    sizes: dict[str, int]


def named(topic: str, kind: str, value: dict[str, Any], places: Mapping[str, cdr.Place], plain: bool | None = None) -> Named:
    """The columns of a decoded message. plain: whether positions of a JointState are called by their joint alone (None: where the message
    has nothing else and the topic is not called joint_states). Raises BagError for a message that is no set of
    channels."""
    numbers = sum(place.size for path, place in places.items() if not path.startswith('header.'))
    if numbers > COLUMNS_MAX:
        raise BagError(f'a message of it holds {numbers} numbers, more than {COLUMNS_MAX}')
    if kind == JOINT_STATE:
        return Named(_of_joints(topic, value.get('name'), places, plain), {})
    if kind in _BLOCKS:
        paths = list(places)
        if any(start not in paths for start, _ in _BLOCKS[kind]):
            raise BagError(f'its definition is not that of {kind}')
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
    """Columns of a JointState; those of named scalars have positions alone."""
    if not isinstance(names, list) or any(part not in places for part in PARTS):
        raise BagError(f'its definition is not that of {JOINT_STATE}')
    filled = [part for part in PARTS if places[part].size]
    if len(set(names)) != len(names):
        raise BagError(f'it names {next(name for name in names if names.count(name) > 1)!r} twice')
    for part in filled:
        if places[part].size != len(names):
            raise BagError(f'a message of it has {len(names)} names and {places[part].size} values of {part}')
    alone = plain if plain is not None else is_plain(topic, places)
    return {name if alone and part == PARTS[0] else f'{name}/{part}': Pick(part, i) for part in filled for i, name in enumerate(names)}


def is_plain(topic: str, places: Mapping[str, cdr.Place]) -> bool:
    """True where a JointState is a set of named scalars."""
    return [part for part in PARTS if places[part].size] == [PARTS[0]] and not topic.endswith('joint_states')


def _message(node: Mapping[str, Any], path: str, shown: str, names: Sequence[str], found: Named) -> None:
    """Add the columns of a message. path: of it in the encoded one. shown: of it in column names. names: of a list around it."""
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
    """Add the columns of the items of a list. labels: their names, where they have some."""
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
    """Names of the items of a list; empty where they have none."""
    if len(field) == len(names):
        return names
    if isinstance(field, np.ndarray) or not field:
        return ()
    key = next((key for key in ITEMS if all(isinstance(item, dict) and isinstance(item.get(key), str) and item[key] for item in field)), '')
    return _distinct([item[key] for item in field]) if key else ()


def _texts(field: Any) -> bool:
    """True where a field is a list of texts (an empty list may be one of anything)."""
    return isinstance(field, list) and bool(field) and isinstance(field[0], str)


def _distinct(names: Sequence[str]) -> list[str]:
    """Names that are all different and not empty: the second of one name is name#2."""
    seen: Counter[str] = Counter()
    result = []
    for name in names:
        seen[name] += 1
        result.append((name or '_') + (f'#{seen[name]}' if seen[name] > 1 else ''))
    return result


def _add(found: Named, name: str, pick: Pick) -> None:
    if name in found.columns:
        raise BagError(f'two numbers of a message of it are called {name!r}')
    found.columns[name] = pick
