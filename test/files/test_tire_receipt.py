"""Every kind of tire file is read, and the receipt says what became of each key."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.commands.main import main
from solver.elements.tire_data import DEFAULTS, I, pack
from solver.files.scene import load_scene, load_scene_text
from solver.files.tir import read_tir
from solver.files.tire_receipt import Entry, receipt, turn_slip_of, warnings
from test.files.test_tir import MINIMAL, write

CAR = Path(__file__).resolve().parents[2] / 'config' / 'tires' / '205_55R16.tir'


def entries(path: Path) -> dict[str, Entry]:
    found = receipt(read_tir(path))
    assert len({e.key for e in found}) == len(found)
    return {e.key: e for e in found}


@pytest.mark.parametrize(
    ('fittyp', 'version'), [('5', 52), ('21', 52), ('51', 52), ('52', 52), ('60', 61), ('61.0', 61), ('62', 61)]
)
def test_every_fittyp_of_the_magic_formula_is_read_and_named(tmp_path: Path, fittyp: str, version: int) -> None:
    path = write(tmp_path, MINIMAL.replace('FITTYP = 6', f'FITTYP = {fittyp}'))
    assert read_tir(path).version == version
    assert entries(path)['MODEL/FITTYP'].fate == 'used'
    assert 'Magic Formula' in entries(path)['MODEL/FITTYP'].why


@pytest.mark.parametrize(
    ('old', 'new'),
    [
        ('{radial width}\n', ''),
        ('{radial width}', 'radial width'),
        ('PDX1 = 1.1', 'PDX1 = 1.1 ! an inline comment'),
        ('PDX1 = 1.1', 'PDX1 = 1.1 # another, with = in it'),
        ("COLOUR = 'black'", "COLOUR = 'not ! a comment $'"),
        ('PKX1 = 22', 'PKX1 = 22\nPKX1 = 22'),
        ('! comment', '* comment'),
    ],
)
def test_ways_of_writing_change_nothing(tmp_path: Path, old: str, new: str) -> None:
    assert old in MINIMAL
    plain = read_tir(write(tmp_path, MINIMAL)).values
    assert read_tir(write(tmp_path, MINIMAL.replace(old, new))).values == plain


@pytest.mark.parametrize('encoding', ['utf-8-sig', 'utf-16', 'latin-1'])
def test_byte_order_marks_and_encodings(tmp_path: Path, encoding: str) -> None:
    plain = read_tir(write(tmp_path, MINIMAL)).values
    path = tmp_path / 'tire.tir'
    path.write_bytes(MINIMAL.replace('comment', 'Größe').replace('\n', '\r\n').encode(encoding))
    assert read_tir(path).values == plain


def test_an_empty_value_is_a_missing_one(tmp_path: Path) -> None:
    found = entries(write(tmp_path, MINIMAL.replace('CAMMAX = 10', 'CAMMAX =')))
    assert (found['CAMMAX'].fate, found['CAMMAX'].why) == ('defaulted', '15 degrees')


def test_of_repeated_keys_the_last_counts_and_is_said_to(tmp_path: Path) -> None:
    path = write(tmp_path, MINIMAL.replace("COLOUR = 'black'", 'PKX1 = 20'))
    data = read_tir(path)
    assert data['PKX1'] == 20.0
    assert entries(path)['PKX1'].why == 'given twice: line 35 counts, not 22 of line 25'
    assert warnings(data)[0].startswith('PKX1: given twice')


def test_an_unknown_side_is_taken_as_left(tmp_path: Path) -> None:
    path = write(tmp_path, MINIMAL.replace("'RIGHT'", "'UNKNOWN'"))
    assert read_tir(path).side == 'left'
    assert entries(path)['MODEL/TYRESIDE'].why == 'not known: taken as LEFT'


@pytest.mark.parametrize('fittyp', ['6', '61'])
def test_missing_relaxation_lengths_follow_from_slip_and_carcass_stiffness(tmp_path: Path, fittyp: str) -> None:
    """At nominal load both ways give K / c: 22 * 4000 N over 1.71 * 200 kN/m, and the side stiffness over 0.49 * 200
    kN/m."""
    bare = (
        MINIMAL.replace('PTX1 = 1.5\n', '')
        .replace('PTY1 = 2\n', '')
        .replace('PTY2 = 2\n', '')
        .replace('FITTYP = 6', f'FITTYP = {fittyp}')
    )
    path = write(tmp_path, bare)
    data = read_tir(path)
    c = pack(data.values, data.version)
    side = 16.0 * 4000.0 * np.sin(2.0 * np.arctan(1.0 / 1.8))
    if fittyp == '6':
        sigma_x, sigma_y = c[I.PTX1] * 0.3, c[I.PTY1] * 0.3 * np.sin(2.0 * np.arctan(1.0 / c[I.PTY2]))
    else:
        sigma_x, sigma_y = 88e3 / c[I.LONGITUDINAL_STIFFNESS], side / c[I.LATERAL_STIFFNESS]
    assert sigma_x == pytest.approx(88e3 / (1.71 * 200e3), rel=1e-12)
    assert sigma_y == pytest.approx(side / (0.49 * 200e3), rel=1e-12)
    assert any('no relaxation length in the file' in sentence for sentence in warnings(data))


PAC2002 = (
    MINIMAL.replace('FITTYP = 6', "PROPERTY_FILE_FORMAT = 'PAC2002'")
    + """[SCALING_COEFFICIENTS]
LCZ = 0.4419
LIP = 0.9
[TIRE_CONDITIONS]
IP = 250000
IP_NOM = 200000
[ALIGNING_COEFFICIENTS]
QPZ1 = 0.3
QTZ1 = 0.2
MBELT = 5.4
[STRUCTURE]
QFCX = 0.1
QFCY = 0.2
"""
)


def test_stiffness_and_pressure_of_pac2002_act_and_the_rest_is_ignored_with_a_reason(tmp_path: Path) -> None:
    path = write(tmp_path, PAC2002)
    data, found = read_tir(path), entries(path)
    assert data['VERTICAL_STIFFNESS'] == pytest.approx(0.4419 * 2e5, rel=1e-12)
    assert pack(data.values, 52)[I.DPI] == pytest.approx((0.9 * 250e3 - 200e3) / 200e3, rel=1e-12)
    assert data['PPZ1'] == 0.3
    for key in (
        'SCALING_COEFFICIENTS/LCZ',
        'SCALING_COEFFICIENTS/LIP',
        'INFLPRES',
        'NOMPRES',
        'PPZ1',
        'VERTICAL_STIFFNESS',
    ):
        assert found[key].fate == 'used'
    assert 'times LCZ = 0.4419' in found['VERTICAL_STIFFNESS'].why
    for key in ('ALIGNING_COEFFICIENTS/QTZ1', 'ALIGNING_COEFFICIENTS/MBELT', 'STRUCTURE/QFCX', 'STRUCTURE/QFCY'):
        assert found[key].fate == 'ignored'
        assert found[key].why not in ('', 'not known to this model')
    assert 'QFCY = 0.2: ignored; the load would be 4 % smaller at Fy = FNOMIN' in warnings(data)


def test_a_scaled_spring_is_softer_at_every_load(tmp_path: Path) -> None:
    """With Q_FZ2 the stiffness at nominal load is that of a parabola: LCZ multiplies the force at every deflection."""
    rows = []
    for text in (MINIMAL, MINIMAL + '[SCALING_COEFFICIENTS]\nLCZ = 0.5\n'):
        data = read_tir(write(tmp_path, text.replace('FNOMIN = 4000', 'FNOMIN = 4000\nQ_FZ2 = 12')))
        rows.append(pack(data.values, data.version))
    x = np.linspace(0.0, 0.2, 5)
    full, half = (row[I.Q_FZ1] * x + row[I.Q_FZ2] * x * x for row in rows)
    assert half == pytest.approx(0.5 * full, rel=1e-12)


@pytest.mark.parametrize('heading', ['{pen fz}\n', ''])
def test_curves_of_the_load_become_the_spring(tmp_path: Path, heading: str) -> None:
    """A parabola is found again; 5 cm of deflection to the rim and 1 MN/m from there on."""
    q1, q2, radius, load = 12.0, 20.0, 0.3, 4000.0
    x = np.linspace(0.0, 0.05, 6)
    rows = ''.join(f'{a:.6f} {load * (q1 * a / radius + q2 * (a / radius) ** 2):.6f}\n' for a in x)
    text = MINIMAL.replace('VERTICAL_STIFFNESS = 2.0D+5\n', '').replace(
        'UNLOADED_RADIUS = 0.3', 'UNLOADED_RADIUS = 0.3\nRIM_RADIUS = 0.2'
    )
    text += f'[DEFLECTION_LOAD_CURVE]\n{heading}{rows}[BOTTOMING_CURVE]\n{heading}0 0\n0.05 0\n0.06 10000\n'
    path = write(tmp_path, text)
    data, found = read_tir(path), entries(path)
    assert (data['Q_FZ1'], data['Q_FZ2']) == (pytest.approx(q1, rel=1e-6), pytest.approx(q2, rel=1e-5))
    # slope where it carries F0
    assert data['VERTICAL_STIFFNESS'] == pytest.approx(load / radius * np.sqrt(q1 * q1 + 4.0 * q2), rel=1e-6)
    assert data['BOTTOM_STIFF'] == pytest.approx(1e6, rel=1e-9)
    assert radius - data['RIM_RADIUS'] - data['BOTTOM_OFFST'] == pytest.approx(0.05, abs=1e-12)
    assert found['DEFLECTION_LOAD_CURVE/table'].fate == found['BOTTOMING_CURVE/table'].fate == 'used'
    assert 'misses by at most' in found['Q_FZ1'].why


def test_the_receipt_is_complete(tmp_path: Path) -> None:
    """Each key of the file once, and each coefficient of the equations."""
    found = entries(write(tmp_path, PAC2002))
    written = {line.partition('=')[0].strip() for line in PAC2002.partition('[MODEL]')[2].splitlines() if '=' in line}
    told = {key.rpartition('/')[2] for key in found}
    told |= {e.why.removeprefix('from ').partition(';')[0] for e in found.values() if e.why.startswith('from ')}
    assert written <= told
    of_61 = {'LKYC', 'LKZC', 'PKY6', 'PKY7', 'PPY5', 'LONGITUDINAL_STIFFNESS', 'LATERAL_STIFFNESS'}
    of_61 |= {f'PCF{axis}{k}' for axis in 'XY' for k in (1, 2, 3)}
    twist = {
        'LMP',
        *(f'{name}{k}' for name in ('PDXP', 'PDYP', 'PHYP', 'PECP', 'QCRP', 'QDRP') for k in range(1, 5)),
        'PKYP1',
        'QDTP1',
        'QBRP1',
    }
    rim = {'BOTTOM_OFFST', 'RIM_RADIUS'}
    assert set(DEFAULTS) - found.keys() <= of_61 | twist | rim
    assert {e.fate for e in found.values()} == {'used', 'ignored', 'defaulted'}
    assert all(e.why for e in found.values() if e.fate == 'ignored')


def test_the_receipt_of_a_scene_is_kept_in_its_resolved_text(tmp_path: Path) -> None:
    tire = write(tmp_path, PAC2002)
    scene = load_scene('light_car_straight', [f'vehicle.front.tire={tire}', f'vehicle.rear.tire={tire}'])
    again = load_scene_text(scene.resolved)
    assert scene.model.tires[0].data.notes
    assert receipt(again.model.tires[0].data) == receipt(scene.model.tires[0].data) == receipt(read_tir(tire))


def test_what_of_turn_slip_acts_is_said_in_a_word(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of a tire that says nothing of it: the coefficients of the moment against turning on the spot are read, the
    others are not."""
    car, old = read_tir(CAR), read_tir(write(tmp_path, MINIMAL))
    read = {mode: {e.key for e in receipt(car, turn_slip=mode) if e.fate != 'ignored'} for mode in (None, True, False)}
    assert read[None] - read[False] == {'LMP', 'PECP1', 'PECP2', 'QCRP1', 'QDRP1', 'QDRP2'}
    assert read[None] < read[True]
    assert [turn_slip_of(car, mode) for mode in (None, True, False)] == [
        'against parking alone, below 5 m/s',
        'acts',
        'off',
    ]
    assert turn_slip_of(old, None).startswith('none: ')
    assert '6.1' in turn_slip_of(old, None)
    assert {e.key for e in receipt(old)} == {e.key for e in receipt(old, turn_slip=False)}
    assert main(['info', 'light_car_straight', '--brief', '--set', 'vehicle.rear.turn_slip=false']) == 0
    text = capsys.readouterr().out
    assert 'turn slip: against parking alone' in text
    assert 'turn slip: off' in text


def test_info_prints_the_receipt(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(write(tmp_path, PAC2002))
    assert main(['info', path]) == 0
    text = capsys.readouterr().out
    assert 'times LCZ = 0.4419' in text
    assert 'no gyroscopic moment of the belt' in text
    assert main(['info', path, '--json']) == 0
    told = {e['key']: e for e in json.loads(capsys.readouterr().out)['receipt']}
    assert told['ALIGNING_COEFFICIENTS/MBELT']['fate'] == 'ignored'
    assert told['PEY1'] == {'key': 'PEY1', 'fate': 'defaulted', 'value': 0.0, 'why': ''}


def test_a_file_that_is_no_text_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / 'large.tir'
    path.write_bytes(b'\0' * 4_000_001)
    assert main(['info', str(path)]) == 2
    assert 'too many for a tire file' in capsys.readouterr().err
