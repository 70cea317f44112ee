"""Tables of loggers as text: any header, separator and way to write time become columns; what is dropped is counted and
told."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mbd_sim_ros.analysis.cells import Rows, decimal, plain, rows_of, spelled, unit_of
from mbd_sim_ros.analysis.stamps import Stamps, is_time, parted, rising, stamps_of, words
from mbd_sim_ros.bags.columns import Series
from solver.errors import BagError, suggestion
from solver.units import SPELLED

SUFFIXES = ('.csv', '.tsv', '.txt')
LEAST_SHARE = 0.5  # part of the rows whose times rise, and of the cells of a column that are numbers
SPARSE = 1.0 / 3.0  # part of empty cells from which on a column is sampled at other instants than the rows
NAMED = 3  # columns, or rows, that a sentence names


@dataclass(frozen=True, kw_only=True)
class TimeColumn:
    """The column that tells the time, of a mapping file. unit: of its numbers ('': as its header says)."""

    column: str
    unit: str = ''


@dataclass
class Table:
    """Content of a table: per topic its columns, units as stated, columns that are none and why, and what was dropped
    or assumed."""

    series: dict[str, Series] = field(default_factory=dict)
    stated: dict[str, str] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    told: list[str] = field(default_factory=list)

    @property
    def names(self) -> list[str]:
        """Names of all columns."""
        return [name for one in self.series.values() for name in one.columns]


def read_table(file: Path, topic: str = '', time: TimeColumn | None = None) -> Table:
    """A text as a table. topic: stands in front of the names of its columns. time: the column of time; found by its
    name without.

    Raises BagError (file, line, remedy).
    """
    found = rows_of(file)
    number = decimal if found.comma else plain
    names, units = _names(found, file)
    columns = [list(column) for column in zip(*found.rows, strict=True)]
    table = Table()
    at, stamps = _time(file, names, units, columns, number, time, table)
    unread = [*found.unread, *(found.lines[k] for k in np.flatnonzero(~stamps.known).tolist())]
    if unread:
        table.told.append(
            f'{_counted(len(unread), len(found.rows) + len(found.unread), "row")} cannot be read '
            f'({_lines(sorted(unread))})'
        )
    rows = np.flatnonzero(stamps.known)
    rows = rows[_rising(stamps.time_ns[rows], [found.lines[k] for k in rows.tolist()], file, names[at], table)]
    prefix = topic and topic + '/'
    sparse: dict[bytes, list[tuple[str, np.ndarray]]] = {}
    missing: list[str] = []
    whole: dict[str, np.ndarray] = {}
    for k, name in enumerate(names):
        if k == at:
            continue
        if not name:
            if any(columns[k]):
                table.told.append(f'column {k + 1} has no name and is left out')
            continue
        cells = columns[k] if rows.size == len(columns[k]) else [columns[k][row] for row in rows.tolist()]
        values, empty, why = _column(cells, number, [found.lines[row] for row in rows.tolist()])
        if values is None:
            table.left_out[prefix + name] = why
            continue
        if units[k]:
            table.stated[prefix + name] = SPELLED.get(units[k], units[k])
        if empty.mean() >= SPARSE and np.isfinite(values).sum() > 1:
            sparse.setdefault((~empty).tobytes(), []).append((prefix + name, values))
            continue
        lacking = int((~np.isfinite(values)).sum())
        if lacking:
            missing.append(f'{name}: {_counted(lacking, values.size, "cell")} without a number{why}')
        whole[prefix + name] = values
    if missing:
        rest = f'; and {len(missing) - NAMED} more columns' if len(missing) > NAMED else ''
        table.told.append('; '.join(missing[:NAMED]) + rest)
    time_ns = stamps.time_ns[rows]
    if whole:
        table.series[topic] = Series(time_ns, whole)
    for mask, group in sparse.items():
        there = np.frombuffer(mask, bool)
        table.series[group[0][0]] = Series(time_ns[there], {name: values[there] for name, values in group})
    if not table.series:
        raise BagError(f'{file} holds no column of numbers besides its time')
    return table


def _names(found: Rows, file: Path) -> tuple[list[str], list[str]]:
    """Names and units of the columns; '' names what has none. Raises BagError."""
    pairs = [unit_of(cell) for cell in found.names]
    names = [name for name, _ in pairs]
    twice = next((n for n in names if n and names.count(n) > 1), None)
    if twice is not None:
        raise BagError(f'{file}: the column {twice!r} is given twice')
    return names, [unit or spelled(below) for (_, unit), below in zip(pairs, found.units)]


def _time(
    file: Path,
    names: Sequence[str],
    units: Sequence[str],
    columns: Sequence[Sequence[str]],
    number: Callable[[str], float],
    given: TimeColumn | None,
    table: Table,
) -> tuple[int, Stamps]:
    """Which column tells the time, and its instants. Raises BagError."""

    def stamps(k: int, unit: str) -> Stamps:
        remedy = (
            f"say it as '{names[k]} [ms]' in the header, or as time: {{column: {names[k]!r}, unit: ms}} in a "
            'mapping file'
        )
        return stamps_of(_with_dates(names, columns, k), unit, f'{file}: the column {names[k]!r}', remedy, number)

    if given is not None:
        if given.column not in names:
            raise BagError(
                f'{file}: the mapping takes the time from {given.column!r}, which is no '
                f'column{suggestion(given.column, names)}'
            )
        k = names.index(given.column)
        return k, stamps(k, given.unit or units[k] or is_time(names[k])[1])
    sure = {k: is_time(name) for k, name in enumerate(names)}
    candidates = [k for k, (how, _) in sure.items() if how]
    if not candidates:
        raise BagError(
            f"{file}: no column is named as one of time ({', '.join(names[:NAMED])} ...); call it 'time [s]', or say "
            f'which one it is in a mapping file: time: {{column: {names[0]!r}, unit: s}}'
        )
    tried: dict[int, tuple[bool, Stamps]] = {}
    refused: list[BagError] = []
    for k in candidates:
        try:
            one = stamps(k, units[k] or sure[k][1])
        except BagError as error:
            refused.append(error)
            continue
        known = one.time_ns[one.known]
        tried[k] = (known.size > 0 and rising(known).size >= 0.9 * known.size, one)
    if not tried:
        raise refused[0]
    for k in tried:
        pair = next(
            (
                i
                for i in tried
                if i != k and words(names[i])[:-1] == words(names[k])[:-1] and sure[k][1] == 's' != sure[i][1]
            ),
            None,
        )
        both = parted(tried[k][1], tried[pair][1]) if pair is not None else None
        if both is not None:
            return k, both
    best = max(tried, key=lambda k: (tried[k][0], sure[k][0], -k))
    others = [names[k] for k in candidates if k != best and not re.search(r'\bdate\b', names[k], re.IGNORECASE)]
    if others:
        worse = [n for n in others if not tried.get(names.index(n), (True,))[0]]
        why = f' ({worse[0]!r} stands still or goes back)' if worse else ''
        table.told.append(
            f'the time is the column {names[best]!r}; {", ".join(map(repr, others[:NAMED]))} would be another{why}'
        )
    if tried[best][1].told:
        table.told.append(f'{names[best]}: {tried[best][1].told}')
    return best, tried[best][1]


def _with_dates(names: Sequence[str], columns: Sequence[Sequence[str]], k: int) -> Sequence[str]:
    """The cells of a column of time; times of day with the dates of a column of that name."""
    first = next((cell for cell in columns[k] if cell), '')
    dates = next((i for i, name in enumerate(names) if name.lower() in ('date', 'datum', 'day') and i != k), None)
    if dates is None or ':' not in first or re.match(r'\d\d?:', first) is None:
        return columns[k]
    return [f'{date} {cell}' if cell else '' for date, cell in zip(columns[dates], columns[k])]


def _rising(time_ns: np.ndarray, lines: Sequence[int], file: Path, name: str, table: Table) -> np.ndarray:
    """The rows whose times rise. Raises BagError where these are the fewer ones."""
    kept = rising(time_ns)
    lost = np.setdiff1d(np.arange(time_ns.size), kept)
    if not lost.size:
        return kept
    if kept.size < LEAST_SHARE * time_ns.size:
        raise BagError(
            f'{file}: the times in {name!r} stand still or go back in {lost.size} of {time_ns.size} rows (the first '
            f'in line {lines[int(lost[0])]}); say in a mapping file which column tells the time: time: '
            f'{{column: NAME, unit: s}}'
        )
    same = np.isin(time_ns[lost], time_ns[kept])
    parts = [
        f'{int(n)} {text}' for n, text in ((same.sum(), 'repeat a stamp'), ((~same).sum(), 'are out of order')) if n
    ]
    where = _lines([lines[k] for k in lost.tolist()])
    table.told.append(
        f'{_counted(lost.size, time_ns.size, "row")} are dropped: {" and ".join(parts)} of {name} ({where})'
    )
    return kept


def _column(
    cells: Sequence[str], number: Callable[[str], float], lines: Sequence[int]
) -> tuple[np.ndarray | None, np.ndarray, str]:
    """(values, which cells are empty, what is no number), or None and why the column holds none."""
    try:
        if number is plain and '_' not in ''.join(cells):
            return np.array(list(map(float, cells))), np.zeros(len(cells), bool), ''
    except ValueError:
        pass
    values = np.array([number(cell) for cell in cells])
    empty = np.array([not cell for cell in cells])
    bad = [
        k
        for k in np.flatnonzero(~np.isfinite(values) & ~empty).tolist()
        if cells[k].lower().lstrip('+-') not in ('nan', 'inf', 'infinity')
    ]
    if empty.all():
        return None, empty, 'it is empty'
    if len(bad) > LEAST_SHARE * (~empty).sum():
        return None, empty, f'it holds text ({cells[bad[0]][:20]!r} in line {lines[bad[0]]})'
    return values, empty, f' ({cells[bad[0]][:20]!r} in line {lines[bad[0]]})' if bad else ''


def _counted(count: int, of: int, what: str) -> str:
    return f'{count} of {of} {what}s'


def _lines(lines: Sequence[int]) -> str:
    more = f' and {len(lines) - NAMED} more' if len(lines) > NAMED else ''
    return f'line{"s" if len(lines) > 1 else ""} {", ".join(map(str, lines[:NAMED]))}{more}'
