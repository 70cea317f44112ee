"""Facts on what a page shows: scene and vehicle by name and hash, and the keys in which they differ from delivered
files and from each other."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import yaml

from mbd_sim_ros.bags.reader import Run
from solver.disk import digest
from solver.errors import MbdError
from solver.files.catalogue import files
from solver.files.scene import config_directories
from solver.files.yaml_tree import include, parse, read_text, text_of

SHOWN = 12  # changed keys that are shown; ten times as many are no list to read
LONG = 60  # characters of a value
OF_RUN = ('name', 'title')  # keys of a scene that are no settings
# Key of a tire: file and line of each coefficient, by a path from where the program was started. It is no setting.
PLACES = 'places'


def facts_of_scene(text: str, name: str) -> list[tuple[str, str]]:
    """Facts of a resolved scene: name, hash, changed keys; of its vehicle the same. A scene that is none of the
    delivered ones has no changed keys, but its vehicle may have."""
    tree = _load(text)
    if not isinstance(tree, dict):
        return []
    mark = hashlib.sha256(text.encode()).hexdigest()[:16]  # as Scene.hash, which recordings and directories bear
    facts = [('scene', f'{name}, hash {mark}')]
    base = _delivered('scenes', name) if name in files('scenes') else None
    if base is not None:
        facts.append(('changed keys', _said(_changes({**base, 'vehicle': None}, {**tree, 'vehicle': None}))))
    if isinstance(vehicle := tree.get('vehicle'), dict):
        facts += facts_of_vehicle(vehicle)
    return facts


def facts_of_vehicle(vehicle: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Name and hash of a vehicle, and its changed keys: of the delivered one that is nearest to it."""
    mark = digest(yaml.safe_dump(vehicle, sort_keys=True)).hex()[:16]
    nearest: tuple[int, str, list[tuple[str, Any, Any]]] | None = None
    for name in files('vehicles'):
        base = _delivered('vehicles', name)
        if base is None or base.get('kind') != vehicle.get('kind'):
            continue
        changes = list(_changes(base, dict(vehicle)))
        if nearest is None or len(changes) < nearest[0]:
            nearest = len(changes), name, changes
    if nearest is None:
        return [('vehicle', f'of kind {vehicle.get("kind", "?")}, hash {mark}')]
    count, name, changes = nearest
    if not count:
        return [('vehicle', f'{name}, hash {mark}')]
    if count > _size(vehicle) // 4:
        return [('vehicle', f'your own, of kind {vehicle.get("kind", "?")}, hash {mark}')]
    return [('vehicle', f'{name}, changed, hash {mark}'), ('changed keys of the vehicle', _said(iter(changes)))]


def facts_of_run(run: Run, place: str) -> list[tuple[str, str]]:
    """Facts of a recording: its scene and vehicle, and by which version and when it was made."""
    text, known = run.metadata.get('resolved_scene', ''), run.metadata
    facts = [('recording', place)]
    facts += [
        (name, known[key]) for name, key in (('recorded by', 'code_version'), ('recorded', 'created')) if key in known
    ]
    try:
        return facts + (facts_of_scene(text, known.get('scene', '?')) if text else [])
    except (MbdError, yaml.YAMLError):  # a recording of another version
        return facts


def facts_of_runs(runs: Sequence[Run], places: Sequence[str]) -> list[tuple[str, str]]:
    """Facts of recordings, and in which keys each of them differs from the first."""
    found = facts_of_run(runs[0], places[0])
    for run, place in zip(runs[1:], places[1:], strict=True):
        found += facts_of_run(run, place) + facts_of_difference(runs[0].metadata, places[0], run.metadata)
    return found


def facts_of_difference(base: Mapping[str, str], name: str, other: Mapping[str, str]) -> list[tuple[str, str]]:
    """Keys in which the scene of a recording differs from that of the one called `name`, with both values; from the
    metadata of both."""
    texts = [known.get('resolved_scene', '') for known in (base, other)]
    if not all(texts):
        return []
    try:
        return [(f'differs from {name}', _said(_changes(*map(_load, texts))))]
    except yaml.YAMLError:  # a recording of another version
        return []


def _load(text: str) -> Any:
    """Values of a text, without PLACES."""
    return _settings(yaml.load(text, Loader=getattr(yaml, 'CSafeLoader', yaml.SafeLoader)))  # both are safe loaders


def _settings(tree: Any) -> Any:
    if isinstance(tree, dict):
        return {key: _settings(value) for key, value in tree.items() if key != PLACES}
    return [_settings(value) for value in tree] if isinstance(tree, list) else tree


@cache
def _delivered(kind: str, name: str) -> dict[str, Any] | None:
    """A delivered file with all that it includes, as values; None for one that is no mapping or cannot be read."""
    file = files(kind)[name]
    try:
        directories = [file.parent, file.parent.parent, *config_directories()]
        found = _load(text_of(include(parse(read_text(file), str(file)), directories)))
    except MbdError:
        return None
    return found if isinstance(found, dict) else None


def _changes(base: Any, other: Any, path: str = '') -> Iterator[tuple[str, Any, Any]]:
    """(key, value in base, value in other) of all leaves that differ; numbers count, not how they are written."""
    if isinstance(base, dict) and isinstance(other, dict):
        for key in dict.fromkeys((*base, *other)):
            if path or key not in OF_RUN:
                yield from _changes(base.get(key), other.get(key), f'{path}.{key}' if path else str(key))
    elif isinstance(base, list) and isinstance(other, list) and len(base) == len(other):
        for k, (a, b) in enumerate(zip(base, other, strict=True)):
            yield from _changes(a, b, f'{path}[{k}]')
    elif _plain(base) != _plain(other):
        yield path, base, other


def _plain(value: Any) -> Any:
    """A leaf to be compared: YAML takes 1e6 for text, and 2 and 2.0 are one number."""
    if isinstance(value, bool) or value is None:
        return value
    try:
        return float(value)
    except (TypeError, ValueError):
        return str(value)


def _size(tree: Any) -> int:
    if isinstance(tree, dict):
        return sum(map(_size, tree.values()))
    return sum(map(_size, tree)) if isinstance(tree, list) else 1


def _said(changes: Iterator[tuple[str, Any, Any]]) -> str:
    found = [f'{key}: {_short(a)} \u2192 {_short(b)}' for key, a, b in changes]
    more = f', and {len(found) - SHOWN} more' if len(found) > SHOWN else ''
    return ', '.join(found[:SHOWN]) + more if found else 'none'


def _short(value: Any) -> str:
    text = '-' if value is None else str(value)
    return text if len(text) <= LONG else text[: LONG - 3] + '...'
