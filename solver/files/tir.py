"""Reader of tire property files (.tir) of the Magic Formula 5.2 and 6.1.

A file has sections `[NAME]`, lines `KEY = value $comment`, comment lines that begin with `!` or `$`, and numeric tables behind a
`{heading}` line, which are skipped. Units of dimensional entries follow [UNITS]; coefficients are dimensionless (angles in rad).
Format reference: MF-Tyre/MF-Swift manuals (TNO); the PAC2002 files of Adams and Chrono have the coefficients of MF 5.2.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Literal

from solver.elements.tire_data import DEFAULTS, TireData
from solver.errors import SceneError, SpecError

_DEGREE = math.pi / 180.0
UNITS: dict[str, dict[str, float]] = {
    'LENGTH': {'meter': 1.0, 'm': 1.0, 'millimeter': 1e-3, 'mm': 1e-3, 'centimeter': 1e-2, 'cm': 1e-2}
    | {'kilometer': 1e3, 'km': 1e3, 'inch': 0.0254, 'foot': 0.3048},
    'FORCE': {'newton': 1.0, 'n': 1.0, 'kilonewton': 1e3, 'kn': 1e3}
    | {'pound_force': 4.4482216152605, 'kg_force': 9.80665, 'kilogram_force': 9.80665},
    'ANGLE': {'radian': 1.0, 'radians': 1.0, 'rad': 1.0, 'degree': _DEGREE, 'degrees': _DEGREE, 'deg': _DEGREE},
    'MASS': {'kg': 1.0, 'kilogram': 1.0, 'gram': 1e-3, 'pound_mass': 0.45359237},
    'TIME': {'second': 1.0, 'seconds': 1.0, 'sec': 1.0, 's': 1.0, 'millisecond': 1e-3, 'minute': 60.0, 'hour': 3600.0},
    'PRESSURE': {'pascal': 1.0, 'pa': 1.0, 'kpa': 1e3, 'kilopascal': 1e3, 'bar': 1e5, 'psi': 6894.757293168},
}
# Powers of (length, force, angle, time) of the dimensional coefficients; everything else is a pure number
DIMENSIONS = {
    **dict.fromkeys(('UNLOADED_RADIUS', 'WIDTH', 'RIM_RADIUS', 'BOTTOM_OFFST'), (1, 0, 0, 0)),
    **dict.fromkeys(('FNOMIN', 'FZMAX'), (0, 1, 0, 0)),
    **dict.fromkeys(('VERTICAL_STIFFNESS', 'LONGITUDINAL_STIFFNESS', 'LATERAL_STIFFNESS', 'BOTTOM_STIFF'), (-1, 1, 0, 0)),
    **dict.fromkeys(('NOMPRES', 'INFLPRES'), (-2, 1, 0, 0)),
    **dict.fromkeys(('CAMMIN', 'CAMMAX'), (0, 0, 1, 0)),
    'VERTICAL_DAMPING': (-1, 1, 0, 1),
    'LONGVL': (1, 0, 0, -1),
}
ALIASES = {'QV1': 'Q_V1', 'QV2': 'Q_V2', 'QFZ1': 'Q_FZ1', 'QFZ2': 'Q_FZ2', 'QRE0': 'Q_RE0'}
VERSIONS: dict[str, Literal[52, 61]] = {'6': 52, '52': 52, '61': 61}  # FITTYP
FORMATS: dict[str, Literal[52, 61]] = {'MF52': 52, 'MF_52': 52, 'PAC2002': 52, 'MF61': 61, 'MF_61': 61}  # PROPERTY_FILE_FORMAT
SIDES: dict[str, Literal['left', 'right', 'symmetric']] = {'LEFT': 'left', 'RIGHT': 'right', 'SYMMETRIC': 'symmetric'}

_KEY = re.compile(r'([A-Za-z_]\w*)\s*=\s*(.*)')
_TABLE_ROW = re.compile(r'[-+.\d]')


class _Entry:
    """Where a key stands and what is behind it."""

    def __init__(self, line: int, section: str, text: str) -> None:
        self.line, self.section, self.text = line, section, text

    @property
    def quoted(self) -> str:
        return self.text.strip('\'"').strip()


def _entries(path: Path) -> dict[tuple[str, str], _Entry]:
    """All entries by (section, KEY)."""
    try:
        text = path.read_text(encoding='utf-8', errors='replace')
    except OSError as error:
        raise SceneError(f'{path}: cannot be read: {error.strerror}') from None
    entries: dict[tuple[str, str], _Entry] = {}
    section, table = '', False
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.split('$')[0].strip()
        if not line or line.startswith('!'):
            continue
        if line.startswith('['):
            if not line.endswith(']'):
                raise SceneError(f'{path}:{number}: section {line!r} has no closing bracket')
            section, table = line[1:-1].strip().upper(), False
        elif line.startswith('{'):
            table = True
        elif (match := _KEY.match(line)) and section:
            key = match[1].upper()
            key = ALIASES.get(key, key)
            before = entries.get((section, key))
            if before is not None:
                raise SceneError(f'{path}:{number}: {key} is given twice, first in line {before.line}: keep one')
            entries[section, key] = _Entry(number, section, match[2].strip())
        elif not (table and _TABLE_ROW.match(line)):
            raise SceneError(f'{path}:{number}: {line!r} is not a section, a comment or KEY = value')
    return entries


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


def _version(path: Path, model: dict[str, _Entry]) -> Literal[52, 61]:
    """FITTYP decides; without it PROPERTY_FILE_FORMAT."""
    for key, table in (('FITTYP', VERSIONS), ('PROPERTY_FILE_FORMAT', FORMATS)):
        entry = model.get(key)
        if entry is not None:
            name = entry.quoted.upper().removesuffix('.0')
            if name not in table:
                raise SceneError(f'{path}:{entry.line}: {key} = {entry.text} is not supported; allowed: {", ".join(table)}')
            return table[name]
    raise SceneError(f'{path}: [MODEL] has neither FITTYP (6, 52 or 61) nor PROPERTY_FILE_FORMAT ({", ".join(FORMATS)})')


def read_tir(path: str | Path) -> TireData:
    """Read a .tir file into SI units.

    Keys the model does not use are kept in TireData.extra as 'SECTION/KEY'. Raises SceneError, one sentence with file and line,
    for unreadable files, unknown formats and units, bad numbers, duplicated keys, missing or unacceptable coefficients.
    """
    path = Path(path)
    entries = _entries(path)
    units = _units(path, entries)
    model = {key: entry for (section, key), entry in entries.items() if section == 'MODEL'}
    version = _version(path, model)
    values: dict[str, float] = {}
    lines: dict[str, int] = {}
    extra: dict[str, float | str] = {}
    for (section, key), entry in entries.items():
        if section == 'UNITS':
            continue
        if key not in DEFAULTS:
            try:
                extra[f'{section}/{key}'] = float(entry.text)
            except ValueError:
                extra[f'{section}/{key}'] = entry.quoted
            continue
        if key in lines:
            raise SceneError(f'{path}:{entry.line}: {key} is given twice, first in line {lines[key]}: keep one')
        length, force, angle, time = DIMENSIONS.get(key, (0, 0, 0, 0))
        if key in ('NOMPRES', 'INFLPRES') and 'PRESSURE' in units:
            factor = units['PRESSURE']
        else:
            factor = units['LENGTH'] ** length * units['FORCE'] ** force * units['ANGLE'] ** angle * units['TIME'] ** time
        values[key] = _number(path, key, entry) * factor
        lines[key] = entry.line
    side = model.get('TYRESIDE')
    if side is not None and side.quoted.upper() not in SIDES:
        raise SceneError(f'{path}:{side.line}: TYRESIDE = {side.text}: must be LEFT, RIGHT or SYMMETRIC')
    try:
        which = SIDES[side.quoted.upper()] if side else 'left'
        return TireData(name=path.stem, version=version, values=values, side=which, source=path.name, extra=extra)
    except SpecError as error:
        message = str(error)
        line = next((lines[k] for k in lines if f': {k} = ' in message), None)
        raise SceneError(f'{path}:{line}: {message}' if line else f'{path}: {message}') from None
