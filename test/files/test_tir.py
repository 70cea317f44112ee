"""Reading of .tir files: values, units, and one sentence with file and line for everything that is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from solver.errors import SceneError
from solver.files.tir import read_tir

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / 'test' / 'data'

MINIMAL = """! comment
[UNITS]
LENGTH = 'meter'
FORCE  = 'newton'
ANGLE  = 'degree'
TIME   = 'second'
[MODEL]
FITTYP = 6
TYRESIDE = 'RIGHT'
LONGVL = 16.7 $ measured at
[DIMENSION]
UNLOADED_RADIUS = 0.3
[SHAPE]
{radial width}
 1.0    0.0
[VERTICAL]
FNOMIN = 4000
VERTICAL_STIFFNESS = 2.0D+5
VERTICAL_DAMPING = 100
[INCLINATION_ANGLE_RANGE]
CAMMAX = 10
[LONGITUDINAL_COEFFICIENTS]
PCX1 = 1.6
PDX1 = 1.1
PKX1 = 22
PTX1 = 1.5
[LATERAL_COEFFICIENTS]
PCY1 = 1.3
PDY1 = 1.0
PKY1 = -16
PKY2 = 1.8
PTY1 = 2
PTY2 = 2
[PRIVATE]
COLOUR = 'black'
WEIGHT = 8.5
"""


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / 'tire.tir'
    path.write_text(text)
    return path


def test_a_file_of_version_61_is_read_completely() -> None:
    data = read_tir(DATA / 'externdata_225_50R17.tir')
    assert (data.version, data.side, data.name) == (61, 'left', 'externdata_225_50R17')
    assert data['UNLOADED_RADIUS'] == 0.3135
    assert data['PHX1'] == 2.1615e-4
    assert data['Q_FZ2'] == 15.4  # spelled QFZ2 in the file
    assert data['QSY7'] == 0.9008
    assert data.extra['INERTIA/BELT_MASS'] == 7.247
    assert data.extra['MDI_HEADER/FILE_TYPE'] == 'tir'


def test_a_file_of_version_52_with_defaults_comments_and_tables(tmp_path: Path) -> None:
    data = read_tir(write(tmp_path, MINIMAL))
    assert (data.version, data.side) == (52, 'right')
    assert data['VERTICAL_STIFFNESS'] == 2e5
    assert data['LONGVL'] == 16.7
    assert data['CAMMAX'] == pytest.approx(np.deg2rad(10.0))
    assert data['LMUX'] == 1.0  # default
    assert data['PEY1'] == 0.0
    assert data.extra['PRIVATE/COLOUR'] == 'black'
    assert data.extra['PRIVATE/WEIGHT'] == 8.5


def test_units_are_converted_to_si(tmp_path: Path) -> None:
    """The same tire in mm, kN, hours and mm: stiffness 0.2 kN/mm, speed 16.7 m/s = 6.012e7 mm/h."""
    text = (
        MINIMAL.replace("LENGTH = 'meter'", "LENGTH = 'mm'")
        .replace("FORCE  = 'newton'", "FORCE  = 'kN'")
        .replace("TIME   = 'second'", "TIME   = 'hour'")
        .replace('UNLOADED_RADIUS = 0.3', 'UNLOADED_RADIUS = 300')
        .replace('FNOMIN = 4000', 'FNOMIN = 4.0')
        .replace('VERTICAL_STIFFNESS = 2.0D+5', 'VERTICAL_STIFFNESS = 0.2')
        .replace('LONGVL = 16.7', 'LONGVL = 6.012e7')
        .replace('VERTICAL_DAMPING = 100', f'VERTICAL_DAMPING = {1e-4 / 3600}')
    )
    a, b = read_tir(write(tmp_path, text)), None
    b = read_tir(write(tmp_path, MINIMAL))
    for key in b.values:
        assert a[key] == pytest.approx(b[key], rel=1e-12), key


def test_format_name_decides_without_fittyp(tmp_path: Path) -> None:
    assert read_tir(write(tmp_path, MINIMAL.replace('FITTYP = 6', "PROPERTY_FILE_FORMAT = 'PAC2002'"))).version == 52


@pytest.mark.parametrize(
    'old, new, line, words',
    [
        ('FITTYP = 6', 'FITTYP = 99', 8, 'FITTYP = 99 is not supported; allowed: 5, 6, 21, 51, 52, 60, 61, 62'),
        ('FITTYP = 6', "PROPERTY_FILE_FORMAT = 'FTIRE'", 8, 'is not supported'),
        ('FITTYP = 6', 'USE_MODE = 14', None, 'neither FITTYP'),
        ('PDX1 = 1.1', 'PDX1 = 1.1.2', 24, 'PDX1 = 1.1.2: is not a number'),
        ('PDX1 = 1.1', 'PDX1 = nan', 24, 'must be finite'),
        ('PDX1 = 1.1', 'PDX1 = -1.1', 24, 'must be positive'),
        (
            'FITTYP = 6',
            'FITTYP = 61\nNOMPRES = 2e5\nINFLPRES = 0',
            10,
            'INFLPRES = 0: must be positive: a tire without pressure',
        ),
        (
            'PDX1 = 1.1\n',
            '',
            None,
            'PDX1 is missing, and without a default: give it in the file, or beside it in the vehicle',
        ),
        ('PKY1 = -16', 'PKY1 = 16', 30, 'ISO-W'),
        ("LENGTH = 'meter'", "LENGTH = 'league'", 3, 'unknown unit'),
        ("LENGTH = 'meter'", "CURRENT = 'ampere'", 3, 'unknown quantity CURRENT'),
        ("TYRESIDE = 'RIGHT'", "TYRESIDE = 'UP'", 9, 'must be LEFT, RIGHT, SYMMETRIC or UNKNOWN'),
        ('[SHAPE]', '[SHAPE', 13, 'no closing bracket'),
        ('FNOMIN = 4000', 'FNOMIN 4000', 17, 'is not a section, a comment, a row of a table or KEY = value'),
        ('PDX1 = 1.1\nPKX1 = 22', 'PDX1 = ', None, 'PDX1, PKX1 are missing'),
        ('PCY1 = 1.3', 'PCY1 = 1.3\nPCY2 = 0.9', 29, 'motorcycle'),
        ('[PRIVATE]', '[DEFLECTION_LOAD_CURVE]\n{pen fz}\n 0 0\n 0.02 4000\n 0.01 6000', 38, 'rise from row to row'),
        ('[PRIVATE]', '[DEFLECTION_LOAD_CURVE]\n 0 0\n 0.01 100\n 0.02 8000', None, 'no parabola fits it'),
    ],
)
def test_refusals_name_file_and_line(tmp_path: Path, old: str, new: str, line: int | None, words: str) -> None:
    assert old in MINIMAL
    path = write(tmp_path, MINIMAL.replace(old, new))
    with pytest.raises(SceneError) as caught:
        read_tir(path)
    sentence = str(caught.value)
    assert words in sentence
    assert '\n' not in sentence
    assert sentence.startswith(f'{path}:{line}: ' if line else f'{path}: ')
    if line is not None:  # the line numbers above are those of the file written here
        assert new.splitlines()[-1] in path.read_text().splitlines()[line - 1]


def test_without_a_nominal_pressure_none_acts_and_none_is_asked_for(tmp_path: Path) -> None:
    assert read_tir(write(tmp_path, MINIMAL.replace('FNOMIN = 4000', 'FNOMIN = 4000\nINFLPRES = 0')))['INFLPRES'] == 0.0


def test_a_missing_file_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r'none\.tir: cannot be read'):
        read_tir(tmp_path / 'none.tir')


def test_the_tires_of_the_package_are_read() -> None:
    files = sorted((ROOT / 'config' / 'tires').glob('*.tir'))
    assert files
    for path in files:
        assert read_tir(path).version in (52, 61)
