"""Tire files as fitters and measurements of one direction leave them: completed, told of, or refused with all that is
missing."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from tire_bench import forces

from mbd_sim_ros.commands.main import main
from solver import simulation_of
from solver.elements.tire_data import I, pack
from solver.elements.tire_limits import oddest
from solver.errors import ConsistencyError, MbdError, SceneError
from solver.files.scene import load_scene, load_scene_text
from solver.files.tir import MOST_PASSED, read_tir
from solver.files.tire_receipt import receipt, warnings
from solver.start.initial_conditions import InitialConditions
from solver.vehicle.wheel_end import told_of_fit
from test.files.test_tir import MINIMAL, write

ROOT = Path(__file__).resolve().parents[2]
SEDAN = ROOT / 'test' / 'data' / 'chrono_245_40R18.tir'
FIT = MINIMAL.replace('UNLOADED_RADIUS = 0.3', 'UNLOADED_RADIUS =').replace('VERTICAL_STIFFNESS = 2.0D+5\n', '')
SIDE_ONLY = MINIMAL.replace('PCX1 = 1.6', 'PCX1 = 0').replace('PDX1 = 1.1', 'PDX1 = 0').replace('PKX1 = 22\n', '')
CIRCLE = '<<: scenes/light_car_straight.yaml\nvehicle: {{<<: vehicles/light_car.yaml, front: {{tire: {tire}}}}}\n'


def scene_with(tmp_path: Path, tire: str):
    path = tmp_path / 'scene.yaml'
    path.write_text(CIRCLE.format(tire=tire))
    return load_scene(str(path))


@pytest.mark.parametrize(
    ('old', 'new', 'line'),
    [
        ('measured at\n', 'the speed at which it\nwas measured\n', 11),
        ('PCX1 = 1.6\n', '---------- longitudinal\nPCX1 = 1.6\n', 23),
        ('PCX1 = 1.6\n', '[N/m] is the unit of stiffness\nPCX1 = 1.6\n', 23),
        ('[UNITS]', 'MF-Tyre file of 2019\n[UNITS]', 2),
    ],
)
def test_lines_without_data_are_passed_over_and_told(tmp_path: Path, old: str, new: str, line: int) -> None:
    assert old in MINIMAL
    plain = read_tir(write(tmp_path, MINIMAL))
    data = read_tir(write(tmp_path, MINIMAL.replace(old, new, 1)))
    assert data.values == plain.values
    assert f'a line without data passed over as a comment: {line}' in warnings(data)
    assert [e.fate for e in receipt(data) if e.key.endswith(f'/line {line}')] == ['ignored']


@pytest.mark.parametrize(
    ('old', 'new', 'line'),
    [
        ('PDX1 = 1.1', 'PDX1 1.1', 24),
        ('PDX1 = 1.1', 'PDX1: 1.1', 24),
        ('! comment', 'LONGVL = 16', 1),
        ('FITTYP = 6', 'FITTYP 6', 8),
    ],
)
def test_coefficients_written_otherwise_are_no_comments(tmp_path: Path, old: str, new: str, line: int) -> None:
    with pytest.raises(SceneError, match=rf':{line}: .*write KEY = value'):
        read_tir(write(tmp_path, MINIMAL.replace(old, new)))


def test_a_text_that_is_no_tire_file_is_named_so(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match='this is no tire file'):
        read_tir(write(tmp_path, 'some words\n' * (MOST_PASSED + 1)))


@pytest.mark.parametrize('form', ['FITTYP = 6', 'FITTYP = 52', "PROPERTY_FILE_FORMAT = 'MF_05'"])
def test_terms_of_another_version_do_nothing_and_are_told(tmp_path: Path, form: str) -> None:
    """A file of 5.2 with terms of pressure, shape and turning of 6.1 left over is that file without them."""
    rest = (
        'PPX1 = -2\nPPX3 = -1\nPPY1 = 1\nPKY4 = 1.5\nPEY5 = 3\nQSX12 = 1\nRBX3 = 9\n[CONDITIONS]\nINFLPRES = '
        '160000\nNOMPRES = 200000\n'
    )
    text = MINIMAL.replace('FITTYP = 6', form)
    plain, mixed = read_tir(write(tmp_path, text)), read_tir(write(tmp_path, text + rest))
    assert pack(mixed.values, mixed.version).tobytes() == pack(plain.values, plain.version).tobytes()
    told = [text for text in warnings(mixed) if 'not in the equations of the Magic Formula 5.2' in text]
    assert len(told) == 1 and 'PPX1' in told[0] and 'RBX3' in told[0]
    fates = {e.key.rpartition('/')[2]: e.fate for e in receipt(mixed)}
    assert {fates[line.partition(' ')[0]] for line in rest.splitlines() if '=' in line} == {'ignored'}


def test_pressure_of_pac2002_acts_and_that_of_six_does_not(tmp_path: Path) -> None:
    rest = 'PPX3 = -0.5\n[CONDITIONS]\nINFLPRES = 160000\nNOMPRES = 200000\n'
    adams = read_tir(write(tmp_path, MINIMAL.replace('FITTYP = 6', "PROPERTY_FILE_FORMAT = 'PAC2002'") + rest))
    six = read_tir(write(tmp_path, MINIMAL.replace('FITTYP = 6', 'FITTYP = 60') + rest))
    assert pack(adams.values, 52)[I.DPI] == pytest.approx(-0.2)
    assert pack(six.values, 61)[I.DPI] == 0.0
    assert any('PPX3: ignored, not in the equations of the Magic Formula 6.0' in text for text in warnings(six))


@pytest.mark.parametrize(
    ('mode', 'says'), [('2', 'Fy, Mx and Mz alone'), ('13', 'without combined slip'), ('-14', 'mirrored'), ('14', '')]
)
def test_what_use_mode_asks_for_is_told_where_it_is_not_done(tmp_path: Path, mode: str, says: str) -> None:
    told = [
        text
        for text in warnings(read_tir(write(tmp_path, MINIMAL.replace('FITTYP', f'USE_MODE = {mode}\nFITTYP'))))
        if 'USE_MODE' in text
    ]
    assert len(told) == bool(says)
    assert not says or says in told[0]


def test_all_that_is_missing_is_named_at_once_with_the_remedy(tmp_path: Path) -> None:
    with pytest.raises(SceneError) as caught:
        read_tir(write(tmp_path, FIT.replace('FITTYP = 6\n', '').replace('PKY2 = 1.8\n', '')))
    for word in ('neither FITTYP', 'VERTICAL_STIFFNESS, UNLOADED_RADIUS, PKY2 are missing', '{<<: tire.tir, values: {'):
        assert all(part in str(caught.value) for part in word.split(', '))


def test_a_vehicle_completes_a_tire(tmp_path: Path) -> None:
    """The coefficients beside the file count before relaxation lengths and limits, and the receipt says where they are
    from."""
    path = write(tmp_path, FIT.replace('PTX1 = 1.5\n', ''))
    whole = (
        MINIMAL.replace('PTX1 = 1.5\n', '')
        .replace('UNLOADED_RADIUS = 0.3', 'UNLOADED_RADIUS = 0.31')
        .replace('2.0D+5', '2.2e5')
    )
    (tmp_path / 'whole.tir').write_text(whole)
    scene = scene_with(tmp_path, f'{{<<: {path}, values: {{UNLOADED_RADIUS: 0.31, VERTICAL_STIFFNESS: 220000}}}}')
    data, other = scene.model.tires[0].data, read_tir(tmp_path / 'whole.tir')
    assert dict(data.values) == dict(other.values)
    assert {e.key: e.why for e in receipt(data)}['UNLOADED_RADIUS'] == 'given beside the file'
    changed = scene_with(tmp_path, f'{{<<: {tmp_path / "whole.tir"}, values: {{PKX1: 30.0}}}}').model.tires[0].data
    assert {e.key: e.why for e in receipt(changed)}['PKX1'] == 'given beside the file, which has 22'
    assert changed['PTX1'] == pytest.approx(other['PTX1'] * 30.0 / 22.0, rel=1e-12)


@pytest.mark.parametrize(
    ('beside', 'says'),
    [
        ('values: {UNLOADED_RADIUS: 0.31}', 'VERTICAL_STIFFNESS is missing'),
        (
            'values: {UNLOADED_RADIUS: 0.31, VERTICAL_STIFFNESS: soft}',
            'scene.yaml:2: values.VERTICAL_STIFFNESS = soft: must be a number',
        ),
        ('values: {UNLOADED_RADIUS: 0.31, VERTICAL_STIFNESS: 2e5}', "did you mean 'VERTICAL_STIFFNESS'"),
        ('values: {UNLOADED_RADIUS: -0.31, VERTICAL_STIFFNESS: 200000}', 'scene.yaml:2: TireData'),
        (
            'values: {UNLOADED_RADIUS: 0.31, VERTICAL_STIFFNESS: 200000, PPX1: 1}',
            'scene.yaml:2: PPX1 = 1: is not in the equations of',
        ),
    ],
)
def test_what_is_given_beside_a_file_is_refused_at_its_place(tmp_path: Path, beside: str, says: str) -> None:
    path = write(tmp_path, FIT)
    with pytest.raises(MbdError) as caught:
        scene_with(tmp_path, f'{{<<: {path}, {beside}}}')
    assert says in str(caught.value)


def test_another_tire_in_a_variant_has_nothing_of_the_one_before(tmp_path: Path) -> None:
    """A file of 5.2 in the place of one of 6.1: what only the latter has must not act."""
    scene = scene_with(tmp_path, str(SEDAN))
    found = {tire.name: tire.data for tire in scene.model.tires}
    assert dict(found['front_left'].values) == dict(read_tir(SEDAN).values)
    assert found['rear_left'].name == '205_55R16'
    changed = scene_with(tmp_path, '{values: {PDX1: 0.9}}').model.tires[0].data  # no file: the tire of the car, changed
    assert (changed.name, changed['PDX1'], changed['PKX1']) == ('205_55R16', 0.9, 22.0)


def test_a_tire_measured_across_alone_has_the_same_curve_along(tmp_path: Path) -> None:
    """Isotropic tread: Fx over kappa is Fy over tan(alpha) at the nominal load, and the stiffness follows the load
    alike."""
    data = read_tir(write(tmp_path, SIDE_ONLY.replace('FITTYP = 6', 'FITTYP = 61')))
    c = pack(data.values, data.version)
    for slip in (0.01, 0.05, 0.2, 1.0):
        assert forces(c, kappa=slip)['fx'] == pytest.approx(-forces(c, tan_alpha=slip)['fy'], rel=1e-9)
    stiff = [
        (forces(c, kappa=1e-6, Fz=load)['fx'], -forces(c, tan_alpha=1e-6, Fz=load)['fy']) for load in (3999.0, 4001.0)
    ]
    slopes = np.diff(np.array(stiff), axis=0)[0]
    assert slopes[0] == pytest.approx(slopes[1], rel=1e-4)  # second derivatives over 2 N of 4000 N
    assert any('no longitudinal force in the file' in text and 'PKX1' in text for text in warnings(data))


def test_a_tire_measured_along_alone_has_the_same_curve_across(tmp_path: Path) -> None:
    text = MINIMAL.replace('PCY1 = 1.3', 'PCY1 = 0').replace('PDY1 = 1.0', 'PDY1 = 0').replace('PKY1 = -16', 'PKY1 = 0')
    data = read_tir(write(tmp_path, text.replace('FITTYP = 6', 'FITTYP = 61')))
    c = pack(data.values, data.version)
    for slip in (0.01, 0.2):
        assert -forces(c, tan_alpha=slip)['fy'] == pytest.approx(forces(c, kappa=slip)['fx'], rel=1e-9)
    assert any('no side force in the file' in text for text in warnings(data))


def test_a_half_measured_direction_is_refused_by_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match='PCX1 = 0: must be positive'):
        read_tir(write(tmp_path, MINIMAL.replace('PCX1 = 1.6', 'PCX1 = 0')))


def test_a_run_tells_what_info_tells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path, SIDE_ONLY)
    words = [
        'run',
        'light_car_straight',
        '--no-record',
        '--set',
        f'vehicle.front.tire={path}',
        '--set',
        'duration=0.01',
    ]
    main([*words, '--json'])
    told = json.loads(capsys.readouterr().out)['tires']
    assert told == [f'tire.tir: {text}' for text in warnings(read_tir(path))]
    main(words)
    assert 'no longitudinal force in the file' in capsys.readouterr().out


@pytest.mark.parametrize(
    ('old', 'new', 'said'),
    [
        (
            "LENGTH = 'meter'",
            "LENGTH = 'mm'",
            "tire.tir:12: UNLOADED_RADIUS = 0.3: a tire of 0.0003 m; .*LENGTH = 'mm' in line 3",
        ),
        (
            'RADIUS = 0.3',
            'RADIUS = 300',
            "tire.tir:12: UNLOADED_RADIUS = 300: a tire of 300 m; .*LENGTH = 'meter' in line 3",
        ),
        ("LENGTH = 'meter'\n", '', None),
        ("LENGTH = 'meter'", "LENGTH = 'km'", 'tire.tir:12: UNLOADED_RADIUS = 0.3: a tire of 300 m'),
        ('RADIUS = 0.3', 'RADIUS = 30.5', 'between 0.005 and 2.5 m'),
        ('RADIUS = 0.3', 'RADIUS = 2.02', None),
        ('RADIUS = 0.3', 'RADIUS = 0.0095', None),
    ],
)
def test_a_radius_in_another_unit_is_refused_with_the_line_of_the_unit(
    tmp_path: Path, old: str, new: str, said: str | None
) -> None:
    assert old in MINIMAL
    # pressed in by 7 % at FNOMIN
    stiffness = 'VERTICAL_STIFFNESS = 6e6' if '0.0095' in new else 'VERTICAL_STIFFNESS = 2.0D+5'
    path = write(tmp_path, MINIMAL.replace(old, new).replace('VERTICAL_STIFFNESS = 2.0D+5', stiffness))
    if said is None:
        assert read_tir(path)['UNLOADED_RADIUS'] > 0.0
        return
    with pytest.raises(SceneError, match=said):
        read_tir(path)


def test_a_radius_given_beside_a_file_is_in_metres(tmp_path: Path) -> None:
    with pytest.raises(
        SceneError,
        match=r'scene.yaml:2: UNLOADED_RADIUS = 310: a tire of 310 m; .*values beside a file are in SI units',
    ):
        scene_with(tmp_path, '{<<: tires/205_55R16.tir, values: {UNLOADED_RADIUS: 310, VERTICAL_STIFFNESS: 200}}')


@pytest.mark.parametrize(
    ('radius', 'odd'), [(0.31, ''), (0.35, ''), (0.25, 'hangs over the road by 0.048 m'), (0.45, 'by 0.152 m')]
)
def test_another_radius_than_the_wheel_is_laid_out_for_is_told(tmp_path: Path, radius: float, odd: str) -> None:
    told = told_of_fit(
        scene_with(tmp_path, f'{{<<: tires/205_55R16.tir, values: {{UNLOADED_RADIUS: {radius}}}}}').model
    )
    assert [line.partition(':')[0] for line in told] == (['front_left', 'front_right'] if odd else [])
    for line in told:
        assert odd in line and f'UNLOADED_RADIUS = {radius:g} of 205_55R16.tir, wheel.center[2] = 0.298' in line


@pytest.mark.parametrize('car', ['light_car', 'full_car', 'compact_fwd', 'pickup_awd'])  # every kind of axle
@pytest.mark.parametrize(
    ('axle', 'file', 'radius', 'way'),
    [
        ('front', '16x75_10', '0.203', 'hangs over'),
        ('front', '265_70R17', '0.801', 'is pressed into'),
        ('rear', '16x75_10', '0.203', 'hangs'),
    ],
)
def test_a_tire_that_is_none_for_the_wheel_is_refused(
    tmp_path: Path, car: str, axle: str, file: str, radius: str, way: str
) -> None:
    tire = write(
        tmp_path,
        re.sub(r'(?m)^(UNLOADED_RADIUS +=) [\d.]+', rf'\1 {radius}', (ROOT / f'config/tires/{file}.tir').read_text()),
    )
    said = rf'{axle}.*tire\.UNLOADED_RADIUS = {radius}: .*{way}.* road by .*wheel\.center\[2\] = .*radius of tire\.tir'
    key = f'vehicle.axles.{axle}.suspension.tire' if car in ('compact_fwd', 'pickup_awd') else f'vehicle.{axle}.tire'
    with pytest.raises(SceneError, match=said):
        load_scene_text(f'vehicle: vehicles/{car}.yaml\n', 'scene', [f'{key}={tire}'])


@pytest.mark.parametrize(
    ('key', 'value', 'told'),
    [
        ('LMUY', 0.01, 'LMUY = 0.01: a scale factor that is far from 1'),
        ('PDY1', 0.01, 'PDY1 = 0.01: with LMUY = 1 the friction along y is 0.01'),
        ('PDX1', 0.05, 'PDX1 = 0.05: with LMUX = 1 the friction along x is 0.05'),
        ('LFZO', 8.0, 'LFZO = 8: a scale factor that is far from 1'),
    ],
)
def test_the_oddest_of_a_tire_has_its_file_line_and_key(tmp_path: Path, key: str, value: float, told: str) -> None:
    lines = [line for line in MINIMAL.splitlines() if not line.startswith(f'{key} ')]
    path = write(tmp_path, '\n'.join([*lines, f'{key} = {value}', '']))
    assert oddest(read_tir(path)) == f'{path}:{len(lines) + 1}: {told}'
    assert not oddest(read_tir(SEDAN))


def test_a_start_that_fails_on_odd_tires_names_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """LMUY = 0.01 was told as an equilibrium that is not stable, of the chassis."""
    text = MINIMAL + 'LMUY = 0.01\n'
    scene = scene_with(tmp_path, str(write(tmp_path, text)))

    def fails(self: object) -> None:
        raise ConsistencyError(
            "start: the static equilibrium that was found is unstable: body 'chassis' would leave it"
        )

    monkeypatch.setattr(InitialConditions, '_find', fails)
    monkeypatch.setattr(
        'solver.engine.bodies.start_of', lambda *given: given[-1]()
    )  # one that was found before is taken
    with pytest.raises(
        ConsistencyError,
        match=r'would leave it; the tires are unusual, which may be why: .*\.tir:\d+: LMUY = 0\.01: a scale',
    ):
        simulation_of(scene)
    with pytest.raises(ConsistencyError, match=r'would leave it$'):
        simulation_of(load_scene('light_car_straight'))
