"""The cells of a text that holds a table: its encoding, separator, header, units and rows, as loggers write them.

The data are the rows of the most usual width that are mostly numbers; the header is the row of that width before them,
which a row of units may follow. Whatever stands before that (names of tests, versions) and comments (#, %) are passed
over.
"""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from solver.errors import BagError
from solver.units import SPELLED, UNITS

UNIT = re.compile(r'\[([^\[\]]*)\]\s*$')  # at the end of a name; names of the fields of messages may hold brackets too
ROUND = re.compile(r'[({<]([^(){}<>]*)[)}>]\s*$')  # other brackets are those of a unit where such a unit is known
NUMBER = re.compile(r'[-+]?(\d+[.,]?\d*|[.,]\d+)([eEdD][-+]?\d+)?')
COMMENTS = ('#', '%', '//')
SAMPLE = 400  # rows by which the separator is found
UNITS_SHARE = 0.6  # part of the cells of a row of units that are known ones
# units that nothing here is in
MORE = {'sec', 'seconds', 'min', 'bar', 'kpa', 'pa', 'mpa', 'psi', 'degc', 'hz', 'kg', 'mv'}
# the same, but in round brackets they are wheels, axes and numbers of sensors
LETTERS = {'v', 'a', 'c', 'k', 'l', '1', '-'}
_KNOWN = {unit.lower() for unit in (*UNITS, *SPELLED)} | MORE
LEAST_SHARE = 0.5  # part of the cells that are numbers in a row of data


@dataclass(frozen=True)
class Rows:
    """The cells of a text: the header, the units in a row of their own, the rows of data and the lines they are
    from."""

    names: list[str]
    units: list[str]
    rows: list[list[str]]
    lines: list[int]
    unread: list[int]  # lines of another width
    comma: bool  # numbers have decimal commas


def text_of(file: Path) -> str:
    """The text of a file in whatever way loggers write it. Raises BagError."""
    try:
        raw = file.read_bytes()
    except OSError as error:
        raise BagError(f'cannot read {file}: {error.strerror}') from None
    wide = raw[:2] in (b'\xff\xfe', b'\xfe\xff')
    for encoding in ('utf-16',) if wide else ('utf-8-sig', 'cp1252'):
        try:
            text = raw.decode(encoding)
        except UnicodeDecodeError:
            continue
        if '\0' not in text:
            return text
    raise BagError(f'cannot read {file}: it is not a CSV text')


def _split(lines: Sequence[tuple[int, str]], mark: str) -> list[tuple[int, list[str]]]:
    """(line, cells) of lines, a mark of ' ' stands for any white space. Raises csv.Error."""
    if mark == ' ':
        return [(number, line.split()) for number, line in lines]
    reader = csv.reader((line for _, line in lines), delimiter=mark, skipinitialspace=True)
    return [(lines[min(reader.line_num, len(lines)) - 1][0], _stripped(row)) for row in reader if row]


def _stripped(row: list[str]) -> list[str]:
    return [cell.strip() for cell in row] if ' ' in ''.join(row) else row


def _share(row: Sequence[str]) -> float:
    """Part of the cells that are numbers, or times, among those that are not empty."""
    filled = [cell for cell in row if cell]
    likes = sum(
        NUMBER.fullmatch(c) is not None or c.lower().lstrip('+-') in ('nan', 'inf') or (c[0].isdigit() and ':' in c)
        for c in filled
    )
    return likes / len(filled) if filled else 0.0


def rows_of(file: Path) -> Rows:
    """The table in a file. Raises BagError (file, line, remedy)."""
    text = text_of(file)
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    body = [one for one in lines if not one[1].lstrip().startswith(COMMENTS)]
    sample = body[-SAMPLE:]
    best: tuple[float, int, str] = (0.0, 0, '')
    for mark in (',', ';', '\t', '|', ' '):
        try:
            pieces = [row for _, row in _split(sample, mark)]
        except csv.Error:
            continue
        data = [row for row in pieces if len(row) > 1 and _share(row) >= LEAST_SHARE]
        if data:
            width = Counter(map(len, data)).most_common(1)[0][0]
            share = sum(_share(row) for row in data if len(row) == width) / len(pieces)
            best = max(best, (round(share, 3), width, mark), key=lambda one: one[:2])
    _, width, mark = best
    if not mark:
        raise BagError(f'{file} holds no data: a header line and rows of at least two numbers are needed')
    try:
        split = _split(lines, mark)
    except csv.Error as error:
        raise BagError(f'cannot read {file}: it is not a CSV text ({error})') from None
    comment = [row[0].startswith(COMMENTS) for _, row in split]
    fits = (
        k for k, (_, row) in enumerate(split) if _fits(row, width) and not comment[k] and _share(row) >= LEAST_SHARE
    )
    start = next(fits, len(split))
    ends = [row[width - 1] for _, row in split[start:] if len(row) == width]
    before = split[:start]
    if mark == ' ':  # a name of several words stands apart by several spaces
        texts = dict(lines)
        before = [(k, row if len(row) == width else re.split(r'\s{2,}|\t', texts[k].strip())) for k, row in before]
    names, units = _header(file, before, width, open_end=not any(ends))
    rows, numbers, unread = [], [], []
    for (number, row), is_comment in zip(split[start:], comment[start:]):
        if is_comment:
            continue
        if _fits(row, width):
            rows.append(row if len(row) == width else row[:width])
            numbers.append(number)
        else:
            unread.append(number)
    if not rows:
        raise BagError(f'{file} holds no data: a header line and rows of at least two numbers are needed')
    if len(unread) > len(rows):
        raise BagError(
            f'{file}: line {unread[0]} has not the {width} columns of most others, nor have {len(unread) - 1} more '
            'lines'
        )
    return Rows(names, units, rows, numbers, unread, _has_comma(file, rows, numbers, mark))


def _fits(row: Sequence[str], width: int) -> bool:
    """True where a row has so many cells, but for separators at its end."""
    return len(row) == width or (len(row) > width and not any(row[width:]))


def _header(
    file: Path, before: list[tuple[int, list[str]]], width: int, *, open_end: bool
) -> tuple[list[str], list[str]]:
    """Names and, of a row of their own, units. open_end: rows of data end with a separator, which the header may lack.
    Raises BagError."""
    found: list[list[str]] = []
    other: tuple[int, list[str]] | None = None
    for number, row in reversed(before):
        is_comment = row[0].startswith(COMMENTS)
        cells = [row[0].lstrip('#%/ '), *row[1:]]
        if not cells[0] and len(cells) > width:
            cells = cells[1:]
        if open_end and len(cells) == width - 1:
            cells = [*cells, '']
        if _fits(cells, width):
            found.append(cells[:width])
            if len(found) > 1:
                break
        elif not is_comment:
            other = (number, row)
            break
    if not found:
        if other is not None:
            raise BagError(f'{file}: its header, line {other[0]}, has {len(other[1])} names for {width} columns')
        raise BagError(f'{file} has no header line: name its columns in the first one, as time [s], yaw_rate [deg/s]')
    last = found[0]
    told = [unit_of(f'x {cell}' if cell[:1] in '[({<' else f'x [{cell}]')[1] for cell in last]
    filled = [unit for cell, unit in zip(last, told) if cell]
    if len(found) > 1 and filled and sum(u.lower() in _KNOWN | LETTERS for u in filled) >= UNITS_SHARE * len(filled):
        return found[1], told
    return last, [''] * width


def unit_of(cell: str) -> tuple[str, str]:
    """(name, unit) of a cell of a header: 'speed [km/h]', 'speed (km/h)'; round brackets hold a unit only where it is
    known."""
    for pattern, sure in ((UNIT, True), (ROUND, False)):
        found = pattern.search(cell)
        if found is None:
            continue
        unit = spelled(found[1].strip())
        if sure or not unit or unit.lower() in _KNOWN - LETTERS:
            return pattern.sub('', cell).strip(), unit
    return cell.strip(), ''


def spelled(unit: str) -> str:
    """A unit as files write it in the way it is spelled here, where it is one that is known."""
    unit = unit.replace('°', 'deg').replace('º', 'deg').strip()
    if unit in UNITS or unit in SPELLED:
        return SPELLED.get(unit, unit)
    # KN: knots or kilonewtons
    alike = {SPELLED.get(name, name) for name in (*SPELLED, *UNITS) if name.lower() == unit.lower()}
    return alike.pop() if len(alike) == 1 else unit


def _has_comma(file: Path, rows: Sequence[Sequence[str]], lines: Sequence[int], mark: str) -> bool:
    """True where numbers have decimal commas. Raises BagError where some have points and some commas."""
    commas, points = [], []
    for line, row in zip(lines[:SAMPLE], rows[:SAMPLE]):
        for cell in row:
            if NUMBER.fullmatch(cell):
                commas += [(line, cell)] if ',' in cell else []
                points += [(line, cell)] if '.' in cell else []
    if commas and points:
        raise BagError(
            f'{file}: numbers have points (line {points[0][0]}: {points[0][1]!r}) and commas (line {commas[0][0]}: '
            f'{commas[0][1]!r}); write all of them with points'
        )
    if mark == ',' and commas and all(re.fullmatch(r'[-+]?\d{1,3},\d{3}', cell) for _, cell in commas):
        raise BagError(
            f'{file}: line {commas[0][0]}: {commas[0][1]!r} may be a decimal comma or one between thousands; write '
            'points, or nothing'
        )
    return bool(commas)


def plain(cell: str) -> float:
    """A cell as a number, NaN where it is none."""
    try:
        return float(cell) if '_' not in cell else math.nan
    except ValueError:
        return math.nan


def decimal(cell: str) -> float:
    """A cell with a decimal comma as a number, NaN where it is none."""
    return math.nan if '.' in cell else plain(cell.replace(',', '.'))
