"""Roads from ASAM OpenCRG files (.crg): sections, references to other files, and the table of numbers.

Format: [ASAM2020], chapter 3. The meaning of the numbers for the surface: crg_surface.py. Virtual channels (`U:`)
decide nothing (3.4.3). A file that is referred to is looked up beside the one that names it, then in the current
directory. Sections of options and modifiers are taken whole: those of the outermost file that has one, as in ASAM's
library.

The file is long because it refuses every damage of a file by place and remedy, next to what reads the part.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from solver.errors import SceneError, suggestion
from solver.files.raster import content_of

# width, per line; or type
FORMS = {'LRFI': (10, 8, ''), 'LDFI': (20, 4, ''), 'KRBI': (0, 0, '>f4'), 'KDBI': (0, 0, '>f8')}
DEFAULT_FORM = 'KRBI'
LARGEST_FILE = 1 << 30  # [bytes]: 100 million numbers in text
LARGEST_TABLE = 64_000_000  # numbers
LARGEST_NUMBER = 1e9
MOST_NESTED = 8  # files that name each other
MOST_LINES = 1 << 17  # before the numbers
_ENTRY = re.compile(r'([A-Za-z_]\w*)[\s.]*=\s*(\S*)')
_POSITION = re.compile(r'long section\s+at v\s*=\s*(\S+)', re.IGNORECASE)
_NUMBER = re.compile(r'long section\s+(\d+)', re.IGNORECASE)
_SWAPPED = re.compile(r'^([-+]?[\d.]+)([-+])[eE](?=\d+$)')
_NAMES_FILE = re.compile(r'\$\w+[/\\.]')  # names of sections are words
_VARIABLE = re.compile(r'\$(\w+)')

_LINE = ('u', 'x', 'y', 'z', 'phi', 's', 'b')
ROAD = (
    *(f'reference_line_{end}_{what}' for end in ('start', 'end') for what in _LINE), 'reference_line_increment',
    *(f'long_section_v_{what}' for what in ('right', 'left', 'increment')),
)  # fmt: skip
# informative
GEODETIC = tuple(f'reference_line_{end}_{what}' for end in ('start', 'end') for what in ('lon', 'lat', 'alt'))
GLOBAL = tuple(f'reference_line_offset_{what}' for what in ('x', 'y', 'z', 'phi'))  # of the map, not of the road
OPTIONS = (
    'border_mode_u', 'border_mode_v', 'border_offset_u', 'border_offset_v', 'border_smooth_ubeg', 'border_smooth_uend',
    'refline_continuation',
)  # fmt: skip
# options of how a program looks for places, and what it tells
NO_HEIGHTS = ('refline_search_', 'warn_', 'log_', 'check_')
MODIFIERS = (
    *(f'scale_{what}' for what in ('z_grid', 'slope', 'banking', 'length', 'width', 'curvature')), 'grid_nan_mode',
    'grid_nan_offset',
    *(f'refline_{what}' for what in ('rotcenter_x', 'rotcenter_y', 'offset_phi', 'offset_x', 'offset_y', 'offset_z')),
    *(f'refpoint_{what}' for what in ('u', 'u_fraction', 'u_offset', 'v', 'v_fraction', 'v_offset', 'x', 'y', 'z',
    'phi')),
)  # fmt: skip
CHOICES = {'border_mode_u': 5, 'border_mode_v': 5, 'refline_continuation': 2, 'grid_nan_mode': 3}  # whole numbers below


@dataclass(kw_only=True)
class Crg:
    """Content of a file, with those that it refers to. Entries by lower-case name: numbers of the road, options and
    modifiers (None: there is no such section); where: file and line of each. channels: of the table, in order. notes:
    entries without effect."""

    path: Path
    road: dict[str, float] = field(default_factory=dict)
    options: dict[str, float] | None = None
    modifiers: dict[str, float] | None = None
    where: dict[str, str] = field(default_factory=dict)
    channels: list[str] = field(default_factory=list)
    form: str = DEFAULT_FORM
    notes: list[str] = field(default_factory=list)
    data: bytes | None = None
    first_line: int = 0  # of the numbers
    source: Path | None = None  # the file with the numbers

    def refusal(self, key: str, remedy: str) -> SceneError:
        """The error sentence about an entry."""
        value = next(
            (
                f'{entries[key]:.12g}'
                for entries in (self.road, self.options, self.modifiers)
                if entries and key in entries
            ),
            '?',
        )
        return SceneError(f'{self.where.get(key, self.path)}: {key} = {value}: {remedy}')


def parsed(path: Path) -> Crg:
    """Content of a file and those that it refers to. Raises SceneError."""
    crg = Crg(path=path)
    _sections(path, crg, ())
    if crg.data is None:
        raise SceneError(f'{path}: not readable as OpenCRG: it has no data (a line that begins with $$$$)')
    if not crg.road.get('reference_line_increment', 0.0) > 0.0:
        if 'reference_line_increment' in crg.road:
            raise crg.refusal('reference_line_increment', 'the increment of the reference line must be positive')
        remedy = 'the section $ROAD_CRG must give it (a virtual channel, U:, decides nothing)'
        raise SceneError(f'{crg.source}: reference_line_increment is missing: {remedy}')
    return crg


def _sections(path: Path, crg: Crg, above: tuple[Path, ...]) -> None:
    """Read the sections of one file into what has been read before it."""
    data = content_of(path, LARGEST_FILE)
    # of an outer file, whose sections replace those of the inner ones
    own = {'ROAD_CRG_OPTS': crg.options is None, 'ROAD_CRG_MODS': crg.modifiers is None}
    begun: dict[str, int] = {}  # line of each of these
    named: list[tuple[str, str]] = []  # lines of $ROAD_CRG_FILE
    section, at, number = '', 0, 0
    while at < len(data):
        end = data.find(b'\n', at)
        end = len(data) if end < 0 else end
        line = data[at:end].decode('latin-1').rstrip('\r')
        at, number = end + 1, number + 1
        if number > MOST_LINES:
            raise SceneError(
                f'{path}: not readable as OpenCRG: it has no data (a line that begins with $$$$) in {MOST_LINES} lines'
            )
        if line.startswith('$') and not (section == 'ROAD_CRG_FILE' and _NAMES_FILE.match(line)):
            if section == 'ROAD_CRG_FILE':
                _include(path, named, crg, above)
                named = []
            if line.startswith('$$$$'):
                if crg.data is None or data[at:].strip():  # behind a reference the numbers are those of the other file
                    crg.data, crg.first_line, crg.source = data[at:], number + 1, path
                return
            words = line[1:].split('!')[0].split()
            section = words[0].upper() if words else ''
            if own.get(section):
                if begun.setdefault(section, number) != number:
                    crg.notes.append(
                        f'{path.name}:{number}: the section ${section} is given twice: that of line {begun[section]} '
                        'is dropped'
                    )
                    begun[section] = number
                if section == 'ROAD_CRG_OPTS':
                    crg.options = {}
                else:
                    crg.modifiers = {}
            continue
        bare = line.split('!')[0].strip()
        if not bare or line.startswith('*') or section == 'CT':
            continue
        place = f'{path}:{number}'
        if section == 'ROAD_CRG_FILE':
            named.append((place, bare))
        elif section == 'KD_DEFINITION':
            _definition(place, bare, crg)
        elif section == 'ROAD_CRG':
            _entry(place, bare, crg.road, ROAD, crg)
        elif own.get(section):
            opts = section == 'ROAD_CRG_OPTS'
            entries = crg.options if opts else crg.modifiers
            assert entries is not None
            _entry(place, bare, entries, OPTIONS if opts else MODIFIERS, crg)
    if section == 'ROAD_CRG_FILE' and named:
        _include(path, named, crg, above)


def _entry(place: str, line: str, entries: dict[str, float], known: tuple[str, ...], crg: Crg) -> None:
    """A line `KEY = value`."""
    match = _ENTRY.match(line)
    if match is None:
        raise SceneError(f'{place}: {line[:40]!r}: must be KEY = value')
    key, text = match[1].lower(), match[2]
    if key in GEODETIC or (known is OPTIONS and key.startswith(NO_HEIGHTS)):
        return
    if key not in known and not (known is ROAD and key in GLOBAL):
        raise SceneError(
            f'{place}: {match[1]} = {text}: is no key of this section of OpenCRG 1.2{suggestion(key, known)}'
        )
    value = _number(place, match[1], text)
    if key in CHOICES and value not in range(CHOICES[key]):
        raise SceneError(f'{place}: {match[1]} = {text}: must be one of {", ".join(map(str, range(CHOICES[key])))}')
    if key in GLOBAL:
        if value != 0.0:
            crg.notes.append(f'{key} = {value:.12g} is of the map and moves nothing here, as in the library of ASAM')
        return
    if key in entries:
        crg.notes.append(
            f'{match[1]} is given twice: {value:.12g} of {place} counts, not {entries[key]:.12g} of {crg.where[key]}'
        )
    entries[key] = value
    crg.where[key] = place


def _definition(place: str, line: str, crg: Crg) -> None:
    """A line of $KD_DEFINITION."""
    kind, rest = line[:2].upper(), line[2:].strip()
    if kind == '#:':
        if '#:' in crg.where:
            crg.notes.append(
                f'the form of the numbers is given twice: {rest} of {place} counts, not {crg.form} of {crg.where["#:"]}'
            )
        crg.form, crg.where['#:'] = rest.upper()[:4], place
        if crg.form not in FORMS:
            raise SceneError(
                f'{place}: data of the form {rest or "none"} are not supported; allowed: {", ".join(FORMS)}'
            )
    elif kind == 'D:':
        crg.channels.append(rest.split(',')[0].strip().lower())
        crg.where[f'D:{len(crg.channels)}'] = place
    elif kind != 'U:':
        raise SceneError(f'{place}: {line[:40]!r}: must begin with #:, D: or U:')


def _number(place: str, key: str, text: str) -> float:
    plain = re.sub('[dD]', 'e', text)
    plain = _SWAPPED.sub(r'\1e\2', plain)  # 2.0+e00, as a sample of the standard has it
    try:
        value = float(plain) if '_' not in text else float('nan')
    except ValueError:
        value = float('nan')
    if not abs(value) <= LARGEST_NUMBER:
        raise SceneError(f'{place}: {key} = {text}: must be a finite number below {LARGEST_NUMBER:g}')
    return value


def _include(path: Path, named: list[tuple[str, str]], crg: Crg, above: tuple[Path, ...]) -> None:
    """Read what a section $ROAD_CRG_FILE names: one file whose name may stand in several lines, or one file a line."""
    if not named:
        raise SceneError(
            f'{path}: the section $ROAD_CRG_FILE names no file (a word behind a $ in the first column begins a section)'
        )
    names = [_VARIABLE.sub(partial(_environment, place), text) for place, text in named]
    whole = [(named[0][0], ''.join(names))]
    each = list(zip((place for place, _ in named), names, strict=True))
    for place, name in whole if _found(path, whole[0][1]) else each:
        file = _found(path, name)
        if file is None:
            raise SceneError(f'{place}: {name}: no such file (beside {path.name}, or in the current directory)')
        if file.resolve() in above or file.resolve() == path.resolve():
            raise SceneError(f'{place}: {name}: the file refers to itself')
        if len(above) >= MOST_NESTED:
            raise SceneError(f'{place}: {name}: more than {MOST_NESTED} files refer to each other')
        _sections(file, crg, (*above, path.resolve()))


def _environment(place: str, match: re.Match[str]) -> str:
    value = os.environ.get(match[1])
    if value is None:
        raise SceneError(f'{place}: ${match[1]}: there is no such environment variable')
    return value


def _found(path: Path, name: str) -> Path | None:
    try:
        return next((file for file in (path.parent / name, Path(name)) if file.is_file()), None)
    except (OSError, ValueError):  # too long, or a NUL in it
        return None


def sections_of(crg: Crg) -> tuple[list[int], np.ndarray]:
    """The columns of the long sections and their distances v to the left [m], ascending. Raises SceneError."""
    columns = [k for k, name in enumerate(crg.channels) if name.startswith('long section')]
    if len(columns) < 2:
        raise SceneError(f'{crg.source}: has {len(columns)} long sections: must have two or more')
    at = {k: match for k in columns if (match := _POSITION.match(crg.channels[k]))}
    if len(at) == len(columns):
        v = np.array([_number(crg.where[f'D:{k + 1}'], 'v', match[1]) for k, match in at.items()])
    else:
        numbers = [match[1] for k in columns if k not in at and (match := _NUMBER.match(crg.channels[k]))]
        if numbers != [str(k + 1) for k in range(len(columns))]:
            place = crg.where[f'D:{columns[0] + 1}']
            raise SceneError(
                f'{place}: long sections must be given all by v, or all by the numbers 1, 2, ... in this order'
            )
        v = _even(crg, len(columns))
    order = np.argsort(v, kind='stable')
    if np.diff(v[order]).min() < 1e-6:
        remedy = 'must be given and differ by 1e-06 m (LONG_SECTION_V_RIGHT, LONG_SECTION_V_LEFT)'
        raise SceneError(f'{crg.source}: the distances of the long sections {remedy}')
    return [columns[k] for k in order], v[order]


def _even(crg: Crg, count: int) -> np.ndarray:
    """Distances of numbered sections, by those two of border and increment that are given; symmetric where only the
    increment is."""
    given = [crg.road.get(f'long_section_v_{what}') for what in ('right', 'left', 'increment')]
    right, left, step = given
    if step is None and right is not None and left is not None:
        step = (left - right) / (count - 1)
    if step is None or not step > 0.0:
        raise SceneError(
            f'{crg.source}: the distances of the long sections must be given: LONG_SECTION_V_RIGHT and '
            'LONG_SECTION_V_INCREMENT'
        )
    if right is None:
        if left is None:
            crg.notes.append(
                'its sections, without LONG_SECTION_V_RIGHT, lie symmetrically; the library of ASAM begins them at v = '
                '0'
            )
        right = left - step * (count - 1) if left is not None else -0.5 * step * (count - 1)
    if left is not None and abs(right + step * (count - 1) - left) > 0.5 * step:
        remedy = f'{count} sections from {right:g} m on, {step:g} m apart, end at {right + step * (count - 1):g} m'
        raise crg.refusal('long_section_v_left', remedy)
    return right + step * np.arange(count)


def table_of(crg: Crg) -> np.ndarray:
    """The numbers, one row per place along the line and one column per channel; missing ones are NaN. Raises
    SceneError."""
    assert crg.data is not None
    expected = _expected_rows(crg)
    if not crg.channels:
        raise SceneError(f'{crg.source}: has 0 long sections: must have two or more')
    found = _binary(crg, expected) if FORMS[crg.form][2] else _text(crg)
    if len(found) < expected - 1:  # the end may lie between two rows
        raise SceneError(
            f'{crg.source}: has {len(found)} rows instead of {expected}, up to reference_line_end_u: it was cut off'
        )
    if len(found) < 2:
        raise SceneError(f'{crg.source}: has {len(found)} rows of {len(crg.channels)} numbers: must have two or more')
    largest = max(
        (float(np.nanmax(np.abs(part), initial=0.0)) for part in np.array_split(found, len(found) // 100_000 + 1)),
        default=0.0,
    )
    if not largest <= 1e6:
        raise SceneError(f'{crg.source}: has numbers beyond 1e6: the file is damaged, or has another byte order')
    return found


def _expected_rows(crg: Crg) -> int:
    end = crg.road.get('reference_line_end_u')
    if end is None:
        return 0
    start = crg.road.get('reference_line_start_u', 0.0)
    rows = (end - start) / crg.road['reference_line_increment'] + 1.0
    if not 1.0 <= rows <= LARGEST_TABLE:
        raise crg.refusal(
            'reference_line_end_u',
            f'{rows:.3g} rows from reference_line_start_u = {start:g} on: must be between 2 and {LARGEST_TABLE}',
        )
    return round(rows)


def _binary(crg: Crg, expected: int) -> np.ndarray:
    assert crg.data is not None
    kind, columns = np.dtype(FORMS[crg.form][2]), len(crg.channels)
    rows = len(crg.data) // (columns * kind.itemsize)
    rows = min(rows, expected) if expected else rows
    _require_room(crg, rows * columns)
    with np.errstate(invalid='ignore'):  # NaN of any kind stands for a missing number
        found = np.frombuffer(crg.data, kind, rows * columns).astype(kind.newbyteorder('=')).reshape(rows, columns)
    if not expected:  # the last record is filled up with NaN
        while len(found) and np.isnan(found[-1]).all():
            found = found[:-1]
    return found


def _require_room(crg: Crg, numbers: int) -> None:
    if numbers > LARGEST_TABLE:
        raise SceneError(
            f'{crg.source}: {numbers} numbers are too many (at most {LARGEST_TABLE}): give a part of the road'
        )


ALLOWED = np.zeros(256, bool)
ALLOWED[list(b'0123456789+-.eEdD ')] = True


def _text(crg: Crg) -> np.ndarray:
    """Numbers in columns of fixed width; each row begins in a new line."""
    assert crg.data is not None
    width, per_line, _ = FORMS[crg.form]
    columns = len(crg.channels)
    lines_of_row = -(-columns // per_line)
    lines = [(k, line.rstrip()) for k, line in enumerate(crg.data.split(b'\n'), crg.first_line)]
    lines = [(k, line) for k, line in lines if line]
    rows = len(lines) // lines_of_row
    _require_room(crg, rows * columns)
    lengths = [min(per_line, columns - j * per_line) for j in range(lines_of_row)]  # numbers in the lines of a row
    for j, (k, line) in enumerate(lines):
        fits = width * lengths[j % lines_of_row]
        if len(line) > fits:
            remedy = (
                f'has {len(line)} characters instead of {fits}: {width} for each of {lengths[j % lines_of_row]} numbers'
            )
            raise SceneError(f'{crg.source}:{k}: {remedy}')
    if rest := len(lines) % lines_of_row:
        raise SceneError(
            f'{crg.source}:{lines[-1][0]}: the last row has {rest} lines of {lines_of_row}: it was cut off'
        )
    text = b''.join(line.ljust(width * lengths[j % lines_of_row]) for j, (_, line) in enumerate(lines))
    cells = np.frombuffer(text, np.uint8).reshape(-1, width)
    starred = (cells == ord('*')).any(axis=1)
    missing = starred | ((cells | 32) == np.frombuffer(b'nan'.rjust(width), np.uint8)).all(axis=1)
    wrong = ~missing & (~ALLOWED[cells].all(axis=1) | (cells == ord(' ')).all(axis=1))
    numbers = np.full(len(cells), np.nan)
    if np.isin(cells, list(b'dD')).any():  # exponents of Fortran
        cells = np.where(np.isin(cells, list(b'dD')) & ~missing[:, None], np.uint8(ord('e')), cells)
    words = np.ascontiguousarray(cells).view(f'S{width}').ravel()
    if not wrong.any():
        try:
            numbers[~missing] = words[~missing].astype(float)
        except ValueError:
            wrong = ~missing & ~np.array([_readable(word) for word in words])
    if wrong.any():
        cell = int(np.flatnonzero(wrong)[0])
        at = lines[cell // columns * lines_of_row + cell % columns // per_line][0]
        shown = bytes(words[cell]).decode('latin-1').strip() or 'nothing'
        raise SceneError(
            f'{crg.source}:{at}: column {cell % columns + 1} ({crg.channels[cell % columns]}) = {shown}: must be a '
            'number'
        )
    return numbers.reshape(rows, columns)


def _readable(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
