"""Overrides: `path.to.key=value`, as --set gives them, applied to a tree of YAML nodes (solver.files.yaml_tree)."""

from __future__ import annotations

import difflib
import itertools
import re
from collections.abc import Sequence
from pathlib import Path

import yaml
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from solver.errors import SceneError
from solver.files.yaml_tree import TAGS, AddedMapping, include, parse, place_of, shown


def keys_of(path: str) -> tuple[str, ...]:
    """Keys in the path of an override: ('a', 'b', '0') of a.b[0] as well as of a.b.0."""
    return tuple(key for key in re.split(r'[.\[\]]+', path.strip()) if key)


def overtaken(assignments: Sequence[str]) -> tuple[str, str] | None:
    """(an override without effect, the later one that replaces the whole part it changes), or None where all have
    effect."""
    paths = [keys_of(assignment.partition('=')[0]) for assignment in assignments]
    pairs = itertools.combinations(zip(paths, assignments, strict=True), 2)
    return next(
        ((a, b) for (part, a), (whole, b) in pairs if whole and len(whole) < len(part) and part[: len(whole)] == whole),
        None,
    )


def override(root: Node, assignment: str, directories: Sequence[Path]) -> None:
    """Apply one override 'a.b.c=value' to a tree, in place. The value is YAML; an item of a list is a.b.0 or a.b[0].

    directories: where a file that the value names is looked up. Missing mappings are created. A value that stands under
    the same key with another unit (a.b.c_mm) is replaced. Where an alias shows the same part in another place, that
    place stays as it is. Raises SceneError for a path that leads nowhere, and for a value that cannot be read.
    """
    path, equals, text = assignment.partition('=')
    keys = keys_of(path)
    name = f'--set {path.strip()}'
    if not equals or not keys:
        raise SceneError(f'--set {assignment!r}: write it as path.to.key=value')
    value = parse(text.strip() or "''", name)
    _set_line(value, name)
    value = include(value, directories)
    node = root
    for depth, key in enumerate(keys):
        last = depth == len(keys) - 1
        if isinstance(node, SequenceNode):
            if not (key.isdigit() and int(key) < len(node.value)):
                above, size = '.'.join(keys[:depth]), len(node.value)
                raise SceneError(f'{name}: {above} is a list of {size}; {key!r} is not one of its indices')
            node.value[int(key)] = value if last else _alone(node.value[int(key)])
            node = node.value[int(key)]
            continue
        if not isinstance(node, MappingNode):
            raise SceneError(
                f'{name}: {".".join(keys[:depth])} = {shown(node)} is a plain value and has no {key!r} in it'
            )
        at = place_of(node, key, last)
        child = value if last else (_added(node, key, value) if at is None else _alone(node.value[at][1]))
        if at is None:
            node.value.append((ScalarNode(TAGS[2], key, value.start_mark, value.end_mark), child))
        else:
            entry = node.value[at][0]
            node.value[at] = (
                entry if entry.value == key else ScalarNode(TAGS[2], key, value.start_mark, value.end_mark),
                child,
            )
        node = child


def _alone(node: Node) -> Node:
    """A copy of a mapping or list with entries of its own: it is about to change, and an alias may show it elsewhere
    too."""
    if not isinstance(node, MappingNode | SequenceNode):
        return node
    return type(node)(node.tag, list(node.value), node.start_mark, node.end_mark, flow_style=node.flow_style)


def _added(parent: MappingNode, key: str, value: Node) -> AddedMapping:
    """A new empty mapping under `key`, which knows the key of its parent that may have been meant."""
    node = AddedMapping(TAGS[0], [], value.start_mark, value.end_mark)
    node.near = next(iter(difflib.get_close_matches(key, [entry.value for entry, _ in parent.value], n=1)), '')
    return node


def _set_line(node: Node, name: str) -> None:
    """Take away the line number from all nodes of the text `name`: an override has no lines."""
    if node.start_mark.name == name:
        node.start_mark = yaml.Mark(name, 0, -1, 0, None, 0)
    for child in node.value if not isinstance(node, ScalarNode) else ():
        for part in child if isinstance(child, tuple) else (child,):
            _set_line(part, name)
