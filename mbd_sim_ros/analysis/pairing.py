"""Which channels recordings share, of what kind each is, and on what scale its differences are small."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from mbd_sim_ros.analysis.alignment import Kind, Signal
from mbd_sim_ros.bags.clocks import in_time_of_day
from mbd_sim_ros.bags.patterns import fits, fits_any, nearest
from mbd_sim_ros.bags.reader import Run, Series
from solver.errors import BagError

T = TypeVar('T')
QUATERNION = ('qx', 'qy', 'qz', 'qw')
ORIENTATION = 'orientation'
# of a pose, of a transform
FIELDS = tuple(tuple(f'{name}/{part}' for part in 'xyzw') for name in (ORIENTATION, 'rotation'))
HEADINGS = ('yaw', 'heading', 'psi', 'course')  # angles of which full turns mean nothing


@dataclass(frozen=True)
class Item:
    """A channel to compare, with its columns (four of an orientation) and how it is brought to other instants."""

    name: str
    columns: tuple[str, ...]
    kind: Kind


def shared_names(
    homes: Sequence[Mapping[str, Series]], patterns: Sequence[str], known: Sequence[str]
) -> tuple[list[str], tuple[str, ...], tuple[str, ...]]:
    """Channels that all have, those of the run alone, those that it lacks. known: of all recordings, for
    suggestions."""
    ours = list(homes[0])
    theirs = list(dict.fromkeys(name for home in homes[1:] for name in home))
    both = [name for name in ours if all(name in home for home in homes[1:])]
    if not both and not patterns:
        raise BagError(f'the two runs have no channel in common ({_some(ours)} here, {_some(theirs)} there)')
    for pattern in patterns:
        if not any(fits(name, pattern) for name in (*both, *_orientations(both))):
            raise BagError(
                f'no common channel matches {pattern!r}{nearest(pattern, list(dict.fromkeys(known)) or both)}'
            )

    def chosen(names: Sequence[str]) -> list[str]:
        return [name for name in names if not patterns or fits_any(name, patterns)]

    common_names = set(both)
    groups = _orientations(both)
    quaternions = [part for group in chosen([*groups]) for part in groups[group]]
    wanted = {*chosen(both), *(quaternions if patterns else ())}
    only = [tuple(sorted(name for name in chosen(side) if name not in common_names)) for side in (ours, theirs)]
    return [name for name in both if name in wanted], only[0], only[1]


def of_one_clock(runs: Sequence[Run]) -> tuple[list[Run], tuple[str, ...]]:
    """The recordings without topics that all of them have in the time of day beside others that count from a start, as
    the diagnostics of a node that simulates: of runs at different times of day they share no instant. And a sentence
    that names these."""
    aside = [{t: run.series[t] for t in in_time_of_day(run.accounts)} for run in runs]
    names = set.intersection(*({name for one in of_run.values() for name in one.columns} for of_run in aside))
    grids = [one.time_ns for of_run in aside for one in of_run.values()]
    if not names or max(int(t[0]) for t in grids) <= min(int(t[-1]) for t in grids):
        return list(runs), ()
    topics = sorted({t for of_run in aside for t, one in of_run.items() if names.intersection(one.columns)})

    def others(of: Mapping[str, T]) -> dict[str, T]:
        return {topic: one for topic, one in of.items() if topic not in topics}

    kept = [replace(run, series=others(run.series), accounts=others(run.accounts)) for run in runs]
    patterns = ', '.join(f"--channel '{t}/*'" for t in topics)
    return kept, (
        f'not compared, for it is in the time of day beside others in simulation time: {", ".join(topics)} ({patterns} '
        'takes it)',
    )


def with_doubts_of(run: Run, names: Collection[str]) -> Run:
    """A recording whose doubts are those of the topics that have one of these channels."""
    used = {topic for topic, one in run.series.items() if not one.columns.keys().isdisjoint(names)}
    return replace(run, accounts={topic: one for topic, one in run.accounts.items() if topic in used})


def _orientations(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Channel -> the four columns it is made of: `<head>/qx` ... of our types, `<head>/orientation/x` or `rotation` of
    others."""
    known, found = set(names), {}
    for name in names:
        for last, parts in ((parts[0], parts) for parts in (QUATERNION, *FIELDS)):
            if name.endswith('/' + last):
                head = name.removesuffix(last)
                columns = tuple(head + part for part in parts)
                if known.issuperset(columns):
                    found[head + ORIENTATION] = columns
    return found


def items_of(
    names: Sequence[str], homes: Sequence[Mapping[str, Series]], unit_of: Callable[[str], str], held: frozenset[str]
) -> list[Item]:
    """The channels to compare: quaternions become orientations where all have the four parts at the same instants."""
    result = []
    inside: set[str] = set()
    for group, parts in _orientations(names).items():
        if all(home[p] is home[parts[0]] for home in homes for p in parts):
            result.append(Item(group, parts, 'orientation'))
            inside |= set(parts)
    for name in names:
        if name in inside:
            continue
        kind: Kind = 'linear'
        if name in held or name.startswith('cmd_applied/'):
            kind = 'hold'
        elif unit_of(name) == 'rad' or name.rpartition('/')[2] in HEADINGS:
            kind = 'angle'
        result.append(Item(name, (name,), kind))
    return result


def signal_of(item: Item, home: Mapping[str, Series], shift_ns: int = 0) -> Signal:
    """The signal of a channel with its stamps moved [ns]; quaternions (n, 4) are made of unit length."""
    one = home[item.columns[0]]
    time_ns = one.time_ns + shift_ns if shift_ns else one.time_ns
    if item.kind != 'orientation':
        return Signal(time_ns, one.columns[item.columns[0]])
    values = np.stack([one.columns[c] for c in item.columns], axis=1)
    size = np.linalg.norm(values, axis=1, keepdims=True)
    return Signal(time_ns, values / np.where(size > 0.0, size, 1.0))


def least_scales(
    items: Sequence[Item], references: Sequence[Mapping[str, Series]], unit_of: Callable[[str], str], floor: float
) -> dict[str, float]:
    """Least scale of every channel: a part of the largest value among channels of the same topic (its first word) and
    unit."""
    largest: dict[tuple[str, str], float] = {}
    kinds = {}
    for item in items:
        measure = unit_of(item.columns[0]) if item.kind != 'orientation' else 'rotation'
        kind = kinds[item.name] = (item.name.partition('/')[0], measure or item.name.rpartition('/')[2])
        if item.kind != 'orientation':
            for home in references:
                largest[kind] = max(largest.get(kind, 0.0), _largest(home[item.columns[0]].columns[item.columns[0]]))
    return {item.name: floor * largest.get(kinds[item.name], 0.0) for item in items}


def _largest(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(max(finite.max(), -finite.min())) if finite.size else 0.0


def _some(names: Sequence[str]) -> str:
    return ', '.join(names[:3]) + (f' and {len(names) - 3} more' if len(names) > 3 else '')
