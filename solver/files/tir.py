"""Reader of tire property files (.tir) of the Magic Formula 5.0 to 6.2.

A file has sections `[NAME]`, lines `KEY = value`, comments from `$`, `!` or `#` on, and tables of numbers, with or
without a `{heading}` line. Other lines are comments without a mark. Units of dimensional entries follow [UNITS];
coefficients are dimensionless (angles in rad). Nothing is dropped silently: what the model does not use, coefficients
of another version of the formula too, is kept in `extra`, what was made of a value is told in `notes`
(solver.files.tire_receipt). Format reference: MF-Tyre/MF-Swift manuals (TNO); the PAC2002 files of Adams and Chrono
have the coefficients of MF 5.2.

The file is long by its tables: names, units and versions that files of tires may have.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Literal, NamedTuple

from solver.elements.tire_data import DEFAULTS, OF_PRESSURE, TireData, absent
from solver.errors import SceneError, SpecError
from solver.files.tire_completion import complete, directions
from solver.units import STANDARD_GRAVITY

_DEGREE = math.pi / 180.0
UNITS: dict[str, dict[str, float]] = {
    'LENGTH': {'meter': 1.0, 'm': 1.0, 'millimeter': 1e-3, 'mm': 1e-3, 'centimeter': 1e-2, 'cm': 1e-2}
    | {'kilometer': 1e3, 'km': 1e3, 'inch': 0.0254, 'foot': 0.3048},
    'FORCE': {'newton': 1.0, 'n': 1.0, 'kilonewton': 1e3, 'kn': 1e3}
    | {'pound_force': 4.4482216152605, 'kg_force': STANDARD_GRAVITY, 'kilogram_force': STANDARD_GRAVITY},
    'ANGLE': {'radian': 1.0, 'radians': 1.0, 'rad': 1.0, 'degree': _DEGREE, 'degrees': _DEGREE, 'deg': _DEGREE},
    'MASS': {'kg': 1.0, 'kilogram': 1.0, 'gram': 1e-3, 'pound_mass': 0.45359237},
    'TIME': {'second': 1.0, 'seconds': 1.0, 'sec': 1.0, 's': 1.0, 'millisecond': 1e-3, 'minute': 60.0, 'hour': 3600.0},
    'PRESSURE': {'pascal': 1.0, 'pa': 1.0, 'kpa': 1e3, 'kilopascal': 1e3, 'bar': 1e5, 'psi': 6894.757293168},
}
# Powers of (length, force, angle, time) of the dimensional coefficients; everything else is a pure number
DIMENSIONS = {
    **dict.fromkeys(('UNLOADED_RADIUS', 'WIDTH', 'RIM_RADIUS', 'BOTTOM_OFFST'), (1, 0, 0, 0)),
    **dict.fromkeys(('FNOMIN', 'FZMAX'), (0, 1, 0, 0)),
    **dict.fromkeys(
        ('VERTICAL_STIFFNESS', 'LONGITUDINAL_STIFFNESS', 'LATERAL_STIFFNESS', 'BOTTOM_STIFF'), (-1, 1, 0, 0)
    ),
    **dict.fromkeys(('NOMPRES', 'INFLPRES'), (-2, 1, 0, 0)),
    **dict.fromkeys(('CAMMIN', 'CAMMAX'), (0, 0, 1, 0)),
    'VERTICAL_DAMPING': (-1, 1, 0, 1),
    'LONGVL': (1, 0, 0, -1),
}
# m, of tires: wheels of models to those of dump trucks (4 m across); ten times as much lets a unit of cm pass
RADII = (0.005, 2.5)
ALIASES = {
    **{'QV1': 'Q_V1', 'QV2': 'Q_V2', 'QFZ1': 'Q_FZ1', 'QFZ2': 'Q_FZ2', 'QRE0': 'Q_RE0', 'LFZ0': 'LFZO'},
    **{'IP': 'INFLPRES', 'IP_NOM': 'NOMPRES', 'QPZ1': 'PPZ1', 'QPZ2': 'PPZ2', 'QPX1': 'PPMX1'},  # PAC2002
}
TYPES: dict[str, tuple[Literal[52, 61], str]] = {  # FITTYP
    '5': (52, 'Magic Formula 5.0 or 5.1, read as 5.2: the same equations with fewer coefficients'),
    '6': (52, 'Magic Formula 5.2'),
    '21': (52, 'MF-Swift 1.x: forces of slip of the Magic Formula 5.2'),
    '51': (52, 'read as Magic Formula 5.2'),
    '52': (52, 'Magic Formula 5.2'),
    '60': (61, 'Magic Formula 6.0, read as 6.1: the same equations without pressure'),
    '61': (61, 'Magic Formula 6.1'),
    '62': (61, 'Magic Formula 6.2: forces of slip as in 6.1; its further terms of the load are not part of this model'),
}
FORMATS: dict[str, Literal[52, 61]] = {  # PROPERTY_FILE_FORMAT
    **dict.fromkeys(('MF52', 'MF_52', 'MF_05', 'MF05', 'PAC2002'), 52),
    **dict.fromkeys(('MF61', 'MF_61', 'MF60', 'MF_60', 'MF62', 'MF_62'), 61),
}
SIDES: dict[str, Literal['left', 'right', 'symmetric']] = {
    **{'LEFT': 'left', 'RIGHT': 'right', 'SYMMETRIC': 'symmetric'},
    **{'UNKNOWN': 'left', 'UNDEFINED': 'left', '': 'left'},
}
MOTORCYCLE = 'PCY2'  # a coefficient that only MF-MCTyre has, whose FITTYP 51 and 52 are those of other files of the 5.2
MOST_PASSED = 200  # lines without data; a file with wrapped comments has some, ten times as many are another file
LARGEST_FILE = 4_000_000  # [bytes]; a tire file has some 20 000
PRESSURE = ('NOMPRES', *OF_PRESSURE)
# coefficients of 6.1 that the equations of 5.2 do not have; PAC2002 has those of pressure, overturning and rolling of
# 6.1
OF_PAC2002 = (
    *(key for key in PRESSURE if key not in ('PFZ1', 'PPY5')),
    *(f'QSX{k}' for k in range(4, 12)),
    'QSY5',
    'QSY6',
    'QSY7',
)
NOT_OF_PAC2002 = (
    *('PFZ1', 'PPY5', 'LKYC', 'LKZC', 'PKY4', 'PKY5', 'PKY6', 'PKY7', 'PEY5', 'RBX3', 'RBY4', 'QDZ10', 'QDZ11'),
    *('QSX12', 'QSX13', 'QSX14'),
)
TABLES = ('SHAPE', 'DEFLECTION_LOAD_CURVE', 'BOTTOMING_CURVE')  # sections that may have a heading without braces

_KEY = re.compile(r'([A-Za-z_]\w*)\s*=\s*(.*)')
_BARE = re.compile(r'([A-Za-z_]\w*)\s*[:\s]\s*[-+.\d]')  # a key and its number without =
_SECTION = re.compile(r'\[\s*\w[\w ]*')
_ROW = re.compile(r'[-+.\d][-+.\deEdD]*([\s,;]+[-+.\d][-+.\deEdD]*)+')
_HEADING = re.compile(r'[A-Za-z_]+(\s+[A-Za-z_]+)*')


class _Entry:
    """Key of a file: its line, and the text behind it; note: remark on it."""

    def __init__(self, line: int, section: str, text: str, note: str = '') -> None:
        self.line, self.section, self.text, self.note = line, section, text, note

    @property
    def quoted(self) -> str:
        return self.text.strip('\'"').strip()


class Given(NamedTuple):
    """A coefficient [SI] that a scene gives beside the file, and the place where it stands."""

    value: float
    place: str


class _Content:
    """Entries by (section, KEY), rows of tables (line, text) by section, what is said of tables, lines without data by
    'SECTION/line N'."""

    def __init__(self) -> None:
        self.entries: dict[tuple[str, str], _Entry] = {}
        self.tables: dict[str, list[tuple[int, str]]] = {}
        self.notes: dict[str, str] = {}
        self.passed: dict[str, float | str] = {}


def _text(path: Path) -> str:
    """Content of the file without a byte-order mark."""
    try:
        size = path.stat().st_size
        if size > LARGEST_FILE:
            raise SceneError(f'{path}: {size} bytes are too many for a tire file (at most {LARGEST_FILE})')
        data = path.read_bytes()
    except OSError as error:
        raise SceneError(f'{path}: cannot be read: {error.strerror}') from None
    wide = data.startswith((b'\xff\xfe', b'\xfe\xff'))
    return data.decode('utf-16' if wide else 'utf-8-sig', errors='replace')


def _uncommented(line: str) -> str:
    """A line up to the first mark of a comment outside quotes."""
    quote = ''
    for k, c in enumerate(line):
        if quote:
            quote = '' if c == quote else quote
        elif c in '$!#':
            return line[:k].strip()
        elif c in '\'"' and line.find(c, k + 1) > 0:
            quote = c
    return line.strip()


def _content(path: Path) -> _Content:
    """Everything in the file that is not a comment."""
    content = _Content()
    section, heading, rows = '', False, False
    for number, raw in enumerate(_text(path).splitlines(), 1):
        line = _uncommented(raw)
        if not line or line.startswith(('*', '//')):
            continue
        if line.startswith('['):
            if not line.endswith(']'):
                if not _SECTION.fullmatch(line):
                    content.passed[f'{section}/line {number}'] = line[:80]
                    continue
                raise SceneError(f'{path}:{number}: section {line!r} has no closing bracket')
            section, heading, rows = line[1:-1].strip().upper(), False, False
        elif line.startswith('{'):
            heading = True
        elif (match := _KEY.match(line)) and section:
            _enter(content, number, section, match[1].upper(), match[2].strip())
        elif section and _ROW.fullmatch(line):
            if not rows and section in content.tables:
                content.notes[section] = f'given twice: the table from line {number} on counts'
            if not rows:
                content.tables[section] = []
            content.tables[section].append((number, line))
            rows = True
        elif section in TABLES and not (heading or rows) and _HEADING.fullmatch(line):
            heading = True
        else:
            _without_data(path, number, line)
            content.passed[f'{section}/line {number}'] = line[:80]
        if len(content.passed) > MOST_PASSED:
            raise SceneError(
                f'{path}:{number}: {line[:80]!r} is the {len(content.passed)}th line without data: this is no tire file'
            )
    return content


def _without_data(path: Path, number: int, line: str) -> None:
    """A line that is no data is a comment without a mark; one that gives a coefficient in another way than KEY = value
    is refused."""
    match = _BARE.match(line) or _KEY.match(line)
    key = match[1].upper() if match else ''
    if ALIASES.get(key, key) in DEFAULTS or key in ('FITTYP', 'PROPERTY_FILE_FORMAT', 'TYRESIDE'):
        remedy = 'write KEY = value, below a line [SECTION]; put a $ before it if it is a comment'
        raise SceneError(
            f'{path}:{number}: {line!r} is not a section, a comment, a row of a table or KEY = value: {remedy}'
        )


def _enter(content: _Content, number: int, section: str, written: str, text: str) -> None:
    """Add an entry; of those with the same name the last one counts, and is said to."""
    key = ALIASES.get(written, written)
    note = f'from {written}' if key != written and key.replace('_', '') != written else ''
    place = (section, key)
    if key in DEFAULTS:
        place = next((p for p in content.entries if p[1] == key), place)
    before = content.entries.get(place)
    if before is not None and before.text != text:
        note = (
            f'{note}; ' * bool(note)
            + f'given twice: line {number} counts, not {before.text or "nothing"} of line {before.line}'
        )
    content.entries[place] = _Entry(number, section, text, note)


def _number(path: Path, key: str, entry: _Entry) -> float:
    try:
        value = float(re.sub('[dD]', 'e', entry.text))
    except ValueError:
        raise SceneError(f'{path}:{entry.line}: {key} = {entry.text}: is not a number') from None
    if not math.isfinite(value):
        raise SceneError(f'{path}:{entry.line}: {key} = {entry.text}: must be finite')
    return value


def _units(path: Path, entries: dict[tuple[str, str], _Entry]) -> dict[str, float]:
    """Size in SI of each unit of the file."""
    units = dict.fromkeys(('LENGTH', 'FORCE', 'ANGLE', 'TIME'), 1.0)
    for (section, key), entry in entries.items():
        if section != 'UNITS':
            continue
        known = UNITS.get(key)
        if known is None:
            raise SceneError(f'{path}:{entry.line}: unknown quantity {key} in [UNITS]; allowed: {", ".join(UNITS)}')
        if entry.quoted.lower() not in known:
            raise SceneError(f'{path}:{entry.line}: unknown unit {entry.text} of {key}; allowed: {", ".join(known)}')
        units[key] = known[entry.quoted.lower()]
    return units


def _version(path: Path, model: dict[str, _Entry]) -> tuple[Literal[52, 61], str] | None:
    """(version of the equations, what is said of it): FITTYP decides; without it PROPERTY_FILE_FORMAT; None where there
    is neither."""
    fit, form = model.get('FITTYP'), model.get('PROPERTY_FILE_FORMAT')
    if fit is not None and fit.text:
        name = fit.quoted.upper().removesuffix('.0')
        if name not in TYPES:
            raise SceneError(f'{path}:{fit.line}: FITTYP = {fit.text} is not supported; allowed: {", ".join(TYPES)}')
        return TYPES[name]
    if form is not None and form.text:
        name = form.quoted.upper()
        if name not in FORMATS:
            raise SceneError(
                f'{path}:{form.line}: PROPERTY_FILE_FORMAT = {form.text} is not supported; allowed: '
                f'{", ".join(FORMATS)}'
            )
        return FORMATS[name], f'equations of the Magic Formula {"5.2" if FORMATS[name] == 52 else "6.1"}'
    return None


def _elsewhere(version: int, model: dict[str, _Entry]) -> dict[str, str]:
    """Coefficients that the stated version of the formula does not have, and which one that is: they do nothing."""
    form = model['PROPERTY_FILE_FORMAT'].quoted.upper() if 'PROPERTY_FILE_FORMAT' in model else ''
    if version == 52:
        names = NOT_OF_PAC2002 if form == 'PAC2002' else (*NOT_OF_PAC2002, *OF_PAC2002)
        return dict.fromkeys(names, 'PAC2002' if form == 'PAC2002' else 'the Magic Formula 5.2')
    six = 'FITTYP' in model and model['FITTYP'].quoted.removesuffix('.0') == '60'
    return dict.fromkeys(PRESSURE, 'the Magic Formula 6.0') if six else {}


def _scale(key: str, units: dict[str, float]) -> float:
    """Size in SI of the unit of a coefficient."""
    if key in ('NOMPRES', 'INFLPRES') and 'PRESSURE' in units:
        return units['PRESSURE']
    length, force, angle, time = DIMENSIONS.get(key, (0, 0, 0, 0))
    return units['LENGTH'] ** length * units['FORCE'] ** force * units['ANGLE'] ** angle * units['TIME'] ** time


def _curve(path: Path, rows: list[tuple[int, str]], units: dict[str, float]) -> list[tuple[float, float]]:
    """(deflection [m], force [N]) of the rows of a table, which must rise in the first column."""
    points: list[tuple[float, float]] = []
    for line, text in rows:
        cells = re.split(r'[\s,;]+', text)
        try:
            x, y = (float(re.sub('[dD]', 'e', cell)) for cell in cells)
        except ValueError:
            raise SceneError(f'{path}:{line}: {text!r}: must be two numbers, deflection and force') from None
        if not (math.isfinite(x) and math.isfinite(y)) or (points and x * units['LENGTH'] <= points[-1][0]):
            raise SceneError(f'{path}:{line}: {text!r}: deflections must be finite and rise from row to row')
        points.append((x * units['LENGTH'], y * units['FORCE']))
    return points


def read_tir(path: str | Path, given: Mapping[str, Given] | None = None) -> TireData:
    """Read a .tir file into SI units.

    given: coefficients that count in place of those of the file. Keys the model does not use are kept in TireData.extra
    as 'SECTION/KEY'. Raises SceneError, one sentence with file and line (or the place of what is given), for unreadable
    files, unknown formats and units, bad numbers, missing or unacceptable coefficients.
    """
    path, given = Path(path), given or {}
    content = _content(path)
    entries = content.entries
    units = _units(path, entries)
    model = {key: entry for (section, key), entry in entries.items() if section == 'MODEL'}
    found = _version(path, model)
    version, meaning = found or (61, '')
    elsewhere = _elsewhere(version, model)
    values: dict[str, float] = {}
    lines: dict[str, str] = {}
    notes = {'FITTYP' if 'FITTYP' in model else 'PROPERTY_FILE_FORMAT': meaning, **content.notes}
    extra: dict[str, float | str] = {}
    for (section, key), entry in entries.items():
        if section == 'UNITS':
            continue
        if entry.note:
            notes[key] = entry.note
        if key == MOTORCYCLE and version == 52 and entry.text and _number(path, key, entry) != 0.0:
            raise SceneError(
                f'{path}:{entry.line}: {key} = {entry.text}: is of a motorcycle tire (MF-MCTyre), which is not '
                'supported'
            )
        if key not in DEFAULTS or (key in elsewhere and key not in given):
            if key in elsewhere:
                notes[key] = f'not in the equations of {elsewhere[key]}'
            try:
                extra[f'{section}/{key}'] = float(entry.text)
            except ValueError:
                extra[f'{section}/{key}'] = entry.quoted
        elif not entry.text:
            notes[key] = f'empty in line {entry.line}'
        else:
            values[key] = _number(path, key, entry) * _scale(key, units)
            lines[key] = f'{path}:{entry.line}'
    extra |= {
        f'{name}/table': '; '.join(' '.join(text.split()) for _, text in rows) for name, rows in content.tables.items()
    }
    extra |= content.passed
    curves = {name: _curve(path, content.tables[name], units) for name in TABLES[1:] if name in content.tables}
    side = model.get('TYRESIDE')
    if side is not None and side.quoted.upper() not in SIDES:
        raise SceneError(f'{path}:{side.line}: TYRESIDE = {side.text}: must be LEFT, RIGHT, SYMMETRIC or UNKNOWN')
    if side is None or side.quoted.upper() not in ('LEFT', 'RIGHT', 'SYMMETRIC'):
        notes['TYRESIDE'] = 'not known: taken as LEFT'
    for key, (value, place) in given.items():
        if key in elsewhere:
            raise SceneError(
                f'{place}: {key} = {value:g}: is not in the equations of {elsewhere[key]}, which {path} is of: leave '
                'it out'
            )
        notes[key] = f'given beside the file, which has {values[key]:g}' if key in values else 'given beside the file'
        values[key], lines[key] = value, place
    _require_size(path, values, lines, entries, given)
    directions(values, notes)
    missing = absent(values)
    if 'DEFLECTION_LOAD_CURVE' in curves and set(missing) == {'VERTICAL_STIFFNESS'}:
        missing = []
    if missing or found is None:
        raise SceneError(_lacking(path, missing, found is None))
    try:
        complete(values, extra, notes, curves, version, units['LENGTH'], frozenset(given))
        which = SIDES[side.quoted.upper()] if side else 'left'
        return TireData(
            name=path.stem,
            version=version,
            values=values,
            side=which,
            source=path.name,
            extra=extra,
            notes=notes,
            places=lines,
        )
    except SpecError as error:
        message = str(error)
        at = next((lines[k] for k in lines if f': {k} = ' in message), str(path))
        raise SceneError(f'{at}: {message}') from None


def _require_size(
    path: Path,
    values: dict[str, float],
    lines: dict[str, str],
    entries: dict[tuple[str, str], _Entry],
    given: Mapping[str, Given],
) -> None:
    """Raise SceneError for a radius that no tire has: it is in another unit than its file, or its place, says."""
    radius = values.get('UNLOADED_RADIUS', RADII[0])
    if RADII[0] <= radius <= RADII[1] or radius <= 0.0:  # refused by TireData
        return
    written, unit = f'{radius:g}', 'values beside a file are in SI units, m'
    if 'UNLOADED_RADIUS' not in given:
        written = next(entry.text for (_, key), entry in entries.items() if key == 'UNLOADED_RADIUS')
        length = entries.get(('UNITS', 'LENGTH'))
        unit = (
            f'LENGTH = {length.text} in line {length.line}' if length else '[UNITS] gives no LENGTH, which stands for m'
        )
    remedy = f'must be between {RADII[0]:g} and {RADII[1]:g} m; check the unit of length ({unit})'
    raise SceneError(f'{lines["UNLOADED_RADIUS"]}: UNLOADED_RADIUS = {written}: a tire of {radius:g} m; {remedy}')


def _lacking(path: Path, missing: list[str], formless: bool) -> str:
    """The sentence that names all a file lacks, and the two places where it may be given."""
    says = (
        f'[MODEL] has neither FITTYP ({", ".join(TYPES)}) nor PROPERTY_FILE_FORMAT ({", ".join(FORMATS)})'
        if formless
        else ''
    )
    if missing:
        beside = ', '.join(f'{key}: ...' for key in missing)
        lacks = f'{", ".join(missing)} {"are" if len(missing) > 1 else "is"} missing, and without a default'
        remedy = f'give {"them" if len(missing) > 1 else "it"} in the file, or beside it in the vehicle [SI]'
        says = f'{says}; ' * formless + f'{lacks}: {remedy}: tire: {{<<: {path.name}, values: {{{beside}}}}}'
    return f'{path}: {says}'
