"""mbd tune: the file that it writes is a vehicle with the figures that were wanted; what cannot be is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mbd_sim_ros.analysis.vehicle_figures import in_si, unit_of, vehicle_figures
from mbd_sim_ros.commands.info import scene_of
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.commands.tune import vehicle_text
from solver.analysis.typical_values import TEXTS
from solver.errors import SpecError
from solver.files.scene import find_file

DEG_PER_G = TEXTS['roll_gradient'][2]


def test_a_mass_is_found_and_one_beyond_the_bounds_is_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The light car has 163 kg beside its chassis, wherever that lies: 1400 kg need 1237, and 1600 cannot be."""
    given = ['tune', 'light_car', 'chassis.mass=1000:1400']
    assert main([*given, 'mass=1400 kg', '--tolerance', '0.01', '--out', str(tmp_path / 'a.yaml'), '--json']) == 0
    data = json.loads(capsys.readouterr().out)
    rest = 1413.0 - 1250.0
    assert data['values']['chassis.mass'] == pytest.approx(1400.0 - rest, abs=0.15)
    assert data['figures']['mass']['per_unit'] == {'chassis.mass': pytest.approx(1.0)}
    assert main([*given, 'mass=1600 kg', '--out', str(tmp_path / 'b.yaml'), '--json']) == 1
    data = json.loads(capsys.readouterr().out)
    assert (data['status'], data['held_by'], data['out']) == ('unreached', {'chassis.mass': 'high'}, None)
    assert data['figures']['mass']['found'] == pytest.approx(1400.0 + rest)
    assert (tmp_path / 'a.yaml').exists() and not (tmp_path / 'b.yaml').exists()


@pytest.mark.slow
def test_the_file_is_a_vehicle_with_the_figure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The roll gradient of the light car by its front bar: the file, read as any other, has it within the tolerance."""
    out = tmp_path / 'tuned.yaml'
    given = ['tune', 'light_car', 'front.anti_roll_bar=5000:30000', 'roll_gradient=5.5 deg/g', '--out', str(out)]
    assert main([*given, '--json']) == 0
    data = json.loads(capsys.readouterr().out)
    assert data['status'] == 'ok' and data['held_by'] == {} and data['evaluations'] < 12
    figure = vehicle_figures(scene_of(str(out), []), ['roll_gradient']).found['roll_gradient']
    assert figure * DEG_PER_G == pytest.approx(5.5, rel=0.01)
    assert figure == pytest.approx(data['figures']['roll_gradient']['found'], rel=1e-9)
    assert data['figures']['roll_gradient']['per_unit']['front.anti_roll_bar'] < 0.0  # a stiffer bar rolls less
    assert main([*given[:3], 'roll_gradient=3 deg/g', '--out', str(tmp_path / 'none.yaml')]) == 1
    told = capsys.readouterr().out
    assert 'NOT REACHED within the bounds: the best is roll_gradient' in told
    assert 'held by the bound front.anti_roll_bar=30000' in told and not (tmp_path / 'none.yaml').exists()


@pytest.mark.slow
def test_a_figure_of_a_maneuver_is_a_target(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / 'tuned.yaml'
    key, target = 'chassis.inertia[2]=1500:2300', 'iso7401_step.yaw_rate_response_time=190 ms'
    assert main(['tune', 'light_car', key, target, '--out', str(out), '--tolerance', '2', '--json']) in (0, 1)
    data = json.loads(capsys.readouterr().out)
    (figure,) = data['figures'].values()
    assert figure['target'] == 0.19 and figure['unit'] == 's'
    assert figure['per_unit']['chassis.inertia[2]'] > 0.0  # a car with more inertia answers later
    assert figure['reached'] == (abs(figure['found'] - 0.19) <= 0.02 * 0.19) == out.exists()


def test_values_in_lists_and_below_kinds_come_into_the_file() -> None:
    """A list is replaced as a whole, and the vehicle is the same as with --set; two items of one list both change."""
    file = find_file('compact_fwd', 'vehicles')
    values = {
        'axles.front.suspension.strut.spring.rate': 25000.0,
        'axles.front.suspension.wheel.center[2]': 0.3,
        'axles.front.suspension.wheel.center[0]': 1.3,
        'axles.front.suspension.lower_arm.pivots[1][2]': 0.2,
        'chassis.mass': 950.0,
    }
    text = vehicle_text(file, values, ['about it'])
    assert text.startswith('# about it\n<<: vehicles/compact_fwd.yaml\n') and len(text.splitlines()) < 30
    tuned = scene_of('compact_fwd', [f'vehicle={{{", ".join(_flow(text))}}}'])
    assert tuned.model == scene_of('compact_fwd', [f'vehicle.{name}={value}' for name, value in values.items()]).model


def _flow(text: str) -> list[str]:
    """The entries of a vehicle file in one line each, as --set takes them."""
    import yaml

    content = '\n'.join(line for line in text.splitlines() if not line.startswith(('#', '<<')))
    return ['<<: vehicles/compact_fwd.yaml', *(f'{k}: {json.dumps(v)}' for k, v in yaml.safe_load(content).items())]


@pytest.mark.parametrize(
    ('arguments', 'sentence'),
    [
        (['compact_fw', 'chassis.mass=900:1000', 'mass=1300 kg'], "did you mean 'compact_fwd'"),
        (['light_car', 'mass=1300 kg'], 'nothing may change; give a key'),
        (['light_car', 'chassis.mass=900:1000'], 'nothing is wanted; give a figure'),
        (['light_car', 'chassis.mass=1000:900', 'mass=1300 kg'], 'write chassis.mass=900:1000'),
        (['light_car', 'chassis.mass=900:900', 'mass=1300 kg'], 'a key that shall not change needs none'),
        (['light_car', 'chassis.mass=900kg:1000kg', 'mass=1300 kg'], 'two numbers, LOW:HIGH'),
        (['light_car', 'chassis.mass=900:', 'mass=1300 kg'], 'two numbers, LOW:HIGH'),
        (['light_car', 'chassis.mas=900:1000', 'mass=1300 kg'], '=900:1000: vehicle.chassis.mas: unknown key; did you'),
        (['light_car', 'chassis=900:1000', 'mass=1300 kg'], 'chassis is no number'),
        (['light_car', 'chassis.com=0:1', 'mass=1300 kg'], 'take one of its items, chassis.com[0]'),
        (['light_car', 'chassis.mass=-5:1000', 'mass=1300 kg'], 'chassis.mass=-5:1000'),
        (['light_car', 'chassis.mass=900:1000', 'mass=1300'], 'its unit is missing; write it in kg'),
        (['light_car', 'chassis.mass=900:1000', 'mass=1300 m'], "'m' is no unit of it; write it in kg"),
        (['light_car', 'chassis.mass=900:1000', 'mass=heavy'], 'must be a number with its unit, kg'),
        (['light_car', 'chassis.mass=900:1000', 'roll_gradent=5 deg/g'], "did you mean 'roll_gradient'"),
        (['light_car', 'chassis.mass=900:1000', 'iso7401.speed=5 m/s'], 'has several maneuvers; take one of'),
        (['light_car', 'chassis.mass=900:1000', 'iso7402_step.speed=5 m/s'], "did you mean 'iso7401_step'"),
        (['light_car', 'chassis.mass=900:1000', 'a.b.c=5'], 'is no figure; for a key of the vehicle give bounds'),
        (['light_car', 'chassis.mass=900:1000', 'mass=1 kg', 'mass=2 kg'], 'mass is given twice'),
        (['light_car', 'chassis.mass=900:1000', 'vehicle.chassis.mass=1:2', 'mass=1 kg'], 'is given twice'),
        (['light_car', 'chassis.mass=900:1000', 'mass'], 'write it as KEY=LOW:HIGH or FIGURE=TARGET'),
        (['light_car', 'chassis.mass=900:1000', 'mass=1300 kg', '--tolerance', '0'], 'must be > 0'),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(
    arguments: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['tune', *arguments, '--out', str(tmp_path / 'out.yaml')]) == 2
    told = capsys.readouterr().err
    assert sentence in told and told.count('\n') == 1
    assert not (tmp_path / 'out.yaml').exists()


def test_units_of_targets() -> None:
    """Unit of mbd info, of SI, or another one of the same kind; never a bare number where a unit is usual."""
    gradient = unit_of('understeer_gradient'), *TEXTS['understeer_gradient'][1:]
    assert in_si('u', '2.5 deg/g', *gradient) == pytest.approx(2.5 * 0.017453292519943295 / 9.80665)
    assert in_si('u', '2.5deg/g', *gradient) == in_si('u', '2.5 deg/g', *gradient)
    assert in_si('u', '0.004 rad s^2/m', *gradient) == 0.004
    toe = unit_of('toe_front'), *TEXTS['toe_front'][1:]
    assert in_si('t', '-0.1 deg', *toe) == pytest.approx(-0.1 * 0.017453292519943295)
    assert in_si('t', '0.001 rad', *toe) == 0.001
    sag = unit_of('sag_front'), *TEXTS['sag_front'][1:]
    assert in_si('s', '5 mm', *sag) == pytest.approx(0.005) and in_si('s', '0.5 cm', *sag) == pytest.approx(0.005)
    share = unit_of('front_share'), *TEXTS['front_share'][1:]
    assert in_si('f', '0.55', *share) == 0.55 and in_si('f', '55 %', *share) == pytest.approx(0.55)
    with pytest.raises(SpecError, match='its unit is missing'):
        in_si('a', '50', unit_of('ackermann'), *TEXTS['ackermann'][1:])
    assert all(unit_of(name) for name in TEXTS)
