"""mbd maneuver: drives with the light car and judges; against linear single-track formulas where these hold; resumable,
refusals."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
from drives import circling
from similar import similar_car

from mbd_sim_ros.analysis.evaluation.driving import Driving
from mbd_sim_ros.analysis.evaluation.kinds import Evaluation
from mbd_sim_ros.analysis.evaluation.registry import EVALUATIONS, called
from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.commands.main import main
from solver.analysis.figures import figures, standing
from solver.errors import SpecError
from solver.files.scene import find_file, load_maneuver, load_scene

FAST, FASTER = (('--set', f'integrator.h={h}') for h in (0.002, 0.004))


def driven(capsys: pytest.CaptureFixture[str], name: str, out: Path, *more: str) -> dict:
    capsys.readouterr()
    code = main(['maneuver', name, 'light_car', '--out', str(out), '--json', '--no-error', *FASTER, *more])
    captured = capsys.readouterr()
    assert code == 0, captured.out
    assert captured.err == ''
    data = json.loads(captured.out)
    assert (out / 'report.html').stat().st_size > 10_000
    assert json.loads((out / 'report.json').read_text())['passed'] == data['passed']
    return data


def values(data: dict, evaluation: str) -> dict[str, float]:
    found = next(r for r in data['results'] if r['evaluation'] == evaluation)
    return {name: f['value'] for name, f in found['figures'].items()}


@pytest.fixture(scope='module')
def known() -> dict[str, float]:
    """The figures of `mbd info light_car_straight`."""
    return figures(standing(load_scene('light_car_straight')))


@pytest.mark.parametrize(
    ('scale', 'settings', 'said'),
    [  # km/h times sqrt(s)
        (
            0.1,
            (),
            '80 km/h are for passenger cars, on the wheelbase of similar_car that is 25.3 km/h: --set '
            'start.speed_kmh=25.3',
        ),
        (2.5, (), '80 km/h are for passenger cars, on the wheelbase of similar_car that is 126 km/h'),
        (0.1, ('start.speed_kmh=30',), '80 km/h are for passenger cars, driven here at 30 km/h, on the wheelbase'),
        (1.0, (), ''),
        (1.0, ('start.speed_kmh=30',), ''),
    ],
)
def test_the_speed_that_corresponds_is_told_of_other_sizes(
    tmp_path: Path, scale: float, settings: tuple[str, ...], said: str
) -> None:
    driving = Driving(str(similar_car(tmp_path / 'car', scale)), tmp_path / 'out', settings)
    note = driving.speed_note(called('iso7401_step')[0])
    assert note.startswith(said) and bool(note) == bool(said)


@pytest.mark.slow
def test_a_small_car_that_is_driven_at_the_speed_of_the_norm_has_a_note_that_says_so(tmp_path: Path, capsys) -> None:
    out = tmp_path / 'out'
    short = ('--set', 'duration=6', '--set', 'maneuver.steering.value=0.3')
    main(['maneuver', 'iso7401_step', str(similar_car(tmp_path / 'car', 0.1)), '--out', str(out), '--no-error', *short])
    said = (
        '80 km/h are for passenger cars, on the wheelbase of similar_car that is 25.3 km/h: --set start.speed_kmh=25.3'
    )
    assert f'note: {said}' in capsys.readouterr().out
    assert said in (out / 'report.html').read_text() and said in (out / 'report.json').read_text()


@pytest.mark.slow
def test_constant_speed_finds_the_understeer_of_the_figures(known: dict[str, float], tmp_path: Path, capsys) -> None:
    """Straight lines between 0.5 and 3.5 m/s^2 at 22 m/s. The ramp of the figures is four times as fast (1 %) and
    counts from where it begins to turn (1.5 %)."""
    more = ('--set', 'start.speed=22', '--with', 'low=0.5', '--with', 'high=3.5')
    found = values(driven(capsys, 'iso4138_constant_speed', tmp_path / 'out', *more), 'iso4138_constant_speed')
    assert found['understeer_gradient'] == pytest.approx(known['understeer_gradient'], rel=0.04)
    assert found['roll_gradient'] == pytest.approx(known['roll_gradient'], rel=0.03)
    assert found['steering_torque_gradient'] > 0.0
    assert found['spread'] < 0.01


@pytest.mark.slow
def test_the_three_methods_of_iso_4138_agree(tmp_path: Path, capsys) -> None:
    """Understeer and roll do not depend on the method as long as the car is nearly linear: understeer within 2 % of the
    steering that a bend of 100 m takes at 2.5 m/s^2, where the ratio is no more that of the middle to all digits."""
    data = driven(capsys, 'iso4138', tmp_path / 'out', '--with', 'high=2.5')
    found = {r['evaluation'].removeprefix('iso4138_'): values(data, r['evaluation']) for r in data['results']}
    assert list(found) == ['constant_radius', 'constant_steering', 'constant_speed']
    gradients = [f['understeer_gradient'] for f in found.values()]
    assert max(gradients) - min(gradients) < 0.02 * (2.65 / 100.0 / 2.5 + max(gradients))
    rolls = [f['roll_gradient'] for f in found.values()]
    assert max(rolls) / min(rolls) < 1.05
    assert found['constant_radius']['mean'] == pytest.approx(100.0, rel=0.01)
    assert found['constant_radius']['spread'] < 0.01
    assert found['constant_steering']['spread'] < 1e-6
    assert data['driven'] == 4  # and the ramp before one of them


@pytest.fixture(scope='module')
def slow_understeer(tmp_path_factory: pytest.TempPathFactory) -> float:
    """The understeer gradient [rad s^2/m] about 1 m/s^2, a tenth less than up to 3.5 m/s^2."""
    out = tmp_path_factory.mktemp('slow') / 'out'
    more = ('--with', 'low=0.3', '--with', 'high=1.5')
    assert (
        main(
            [
                'maneuver',
                'iso4138_constant_speed',
                'light_car',
                '--out',
                str(out),
                '--json',
                '--no-error',
                *FASTER,
                *more,
            ]
        )
        == 0
    )
    return values(json.loads((out / 'report.json').read_text()), 'iso4138_constant_speed')['understeer_gradient']


@pytest.mark.slow
def test_gains_of_a_small_step_are_those_of_the_linear_single_track(
    known: dict[str, float], slow_understeer: float, tmp_path: Path, capsys
) -> None:
    """Yaw rate per steering wheel v/(i (L + U v^2)), lateral acceleration v times that, at about 1 m/s^2 with the
    understeer there."""
    data = driven(capsys, 'iso7401_step', tmp_path / 'out', '--set', 'maneuver.steering.value=0.12')
    found = values(data, 'iso7401_step')
    v = found['speed']
    gain = v / (known['steering_ratio'] * (known['wheelbase'] + slow_understeer * v * v))
    assert found['yaw_rate_gain'] == pytest.approx(gain, rel=0.03)
    assert found['lateral_acceleration_gain'] == pytest.approx(v * gain, rel=0.03)
    assert 0.0 < found['yaw_rate_response_time'] < found['yaw_rate_peak_time'] < 1.0
    assert found['yaw_rate_response_time'] < found['lateral_acceleration_response_time']  # the yaw rate leads
    assert data['found'] == {'iso7401_step': {}}
    assert data['driven'] == 1


@pytest.mark.slow
def test_an_amplitude_is_found_that_gives_the_lateral_acceleration(
    known: dict[str, float], tmp_path: Path, capsys
) -> None:
    """4 m/s^2, to the curvature of what a straight line takes for the lag of the ramp; the response time of the
    figures, but for the other form and length of the rise. Driven again it is all there."""
    data = driven(capsys, 'iso7401_step', tmp_path / 'out', '--set', 'start.speed_kmh=80')
    found = values(data, 'iso7401_step')
    assert found['lateral_acceleration_response_time'] == pytest.approx(known['response_time'], abs=0.03)
    assert found['lateral_acceleration_steady'] == pytest.approx(4.0, rel=0.03)
    assert found['steering'] == pytest.approx(data['found']['iso7401_step']['amplitude'], rel=1e-6)
    assert (data['driven'], data['kept']) == (2, 0)
    again = driven(capsys, 'iso7401_step', tmp_path / 'out', '--set', 'start.speed_kmh=80')
    assert (again['driven'], again['kept']) == (0, 2)
    assert again['results'] == data['results']
    place = Path(data['results'][0]['source'])
    os.truncate(next(place.glob('*.mcap')), 10_000)  # an interrupted run is driven anew, the other one is not
    third = driven(capsys, 'iso7401_step', tmp_path / 'out', '--set', 'start.speed_kmh=80')
    assert (third['driven'], third['kept']) == (1, 1)
    assert third['results'] == data['results']
    assert main(['evaluate', str(place), '--errors', '--json']) == 0  # the recording says what it is
    alone = json.loads(capsys.readouterr().out)
    errors = {
        name: f.pop('numerical_error') for name, f in alone['results'][0]['figures'].items() if 'numerical_error' in f
    }
    assert alone['results'] == data['results']
    assert main(['replay', str(place), '--set', 'integrator.h=0.0005', '--out', str(tmp_path / 'fine'), '--json']) == 0
    capsys.readouterr()
    stated = [word for name, value in data['results'][0]['parameters'].items() for word in ('--set', f'{name}={value}')]
    assert main(['evaluate', str(tmp_path / 'fine'), '--as', 'iso7401_step', *stated, '--json']) == 0
    fine = values(json.loads(capsys.readouterr().out), 'iso7401_step')
    for name in ('lateral_acceleration_response_time', 'lateral_acceleration_steady', 'roll_response_time'):  # of 4 ms
        assert 0.0 < abs(found[name] - fine[name]) < 3.0 * errors[name] + 1e-5


@pytest.mark.slow
def test_sine_with_dwell_knows_its_reference_angle(tmp_path: Path, capsys) -> None:
    """Two amplitudes of the series to both sides: A is that of 0.3 g, the car is symmetric, and small amplitudes are
    stable."""
    from mbd_sim_ros.analysis.evaluation import sine_with_dwell

    short = sine_with_dwell.SINE_WITH_DWELL.drive
    object.__setattr__(short, 'series', lambda a: sine_with_dwell.series(a)[:8:7])
    try:
        data = driven(capsys, 'fmvss126', tmp_path / 'out')
    finally:
        object.__setattr__(short, 'series', sine_with_dwell.series)
    reference = data['found']['fmvss126']['reference']
    assert math.degrees(reference) == pytest.approx(round(math.degrees(reference), 1), abs=1e-9)
    runs = [values({'results': [r]}, 'fmvss126') for r in data['results']]
    assert [round(r['over_reference'], 1) for r in runs] == pytest.approx([1.5, 5.0, 1.5, 5.0], abs=0.11)
    assert [np.sign(r['amplitude']) for r in runs] == [1.0, 1.0, -1.0, -1.0]
    for left, right in ((runs[0], runs[2]), (runs[1], runs[3])):
        assert left['displacement'] == pytest.approx(right['displacement'], rel=1e-3)
        assert left['yaw_rate_ratio_100'] == pytest.approx(right['yaw_rate_ratio_100'], abs=1e-3)
    assert runs[0]['yaw_rate_ratio_100'] < 0.1
    verdicts = [r['figures']['displacement']['verdict'] for r in data['results']]
    assert verdicts[0] == 'not judged'  # below 5 A
    assert all(abs(r['speed'] - 80.0 / 3.6) < 2.0 / 3.6 for r in runs)


@pytest.mark.slow
@pytest.mark.parametrize('name', ['iso3888', 'iso21994', 'iso14512', 'iso13674', 'iso2631'])
def test_the_other_maneuvers_are_driven_and_judged(name: str, tmp_path: Path, capsys) -> None:
    data = driven(capsys, name, tmp_path / 'out')
    found = {key: f['value'] for r in data['results'] for key, f in r['figures'].items()}
    if name == 'iso3888':
        assert data['passed'] is True
        assert len(data['results']) == 2
        assert found['entry_speed'] < 51.0 / 3.6
    if name == 'iso21994':
        assert found['initial_speed'] == pytest.approx(100.0 / 3.6, abs=0.5)
        assert found['mfdd'] == pytest.approx(found['mean_deceleration'], rel=0.15)
        assert 3.0 < found['mfdd'] < 11.0
    if name == 'iso14512':
        assert found['yaw_rate_largest'] > 0.01  # towards the side with grip
    if name == 'iso13674':
        assert found['lateral_acceleration'] == pytest.approx(2.0, rel=0.1)
        assert found['frequency'] == pytest.approx(0.2, rel=0.01)
        assert 0.0 < found['yaw_rate_delay'] < found['lateral_acceleration_delay'] < 0.3
    if name == 'iso2631':
        assert 0.1 < found['z_wk_rms'] < 2.0
        assert found['z_wk_rms'] > found['y_wd_rms']


@pytest.mark.slow
@pytest.mark.parametrize(
    'name',
    ['iso13674_weave', *(pytest.param(n, marks=pytest.mark.long) for n in ('iso21994', 'iso14512', 'iso3888_2'))],
)
def test_a_formula_car_is_driven_by_what_suits_it(name: str, tmp_path: Path, capsys) -> None:
    """A steering eight times as sensitive as that of a saloon: the ramp before is slow enough to find the angle for 2
    m/s^2, the brakes are those for its mass, and the hardest with which its wheels just roll, the driver finds his way
    through the cones."""
    assert (
        main(['maneuver', name, 'formula_student', '--out', str(tmp_path / name), '--json', '--no-error', *FAST]) == 0
    )
    found = values(json.loads(capsys.readouterr().out), name)
    if name == 'iso13674_weave':
        assert found['lateral_acceleration'] == pytest.approx(2.0, rel=0.05)
    elif name == 'iso21994':
        assert found['mfdd'] > 13.0
    elif name == 'iso14512':
        assert found['mean_deceleration'] == pytest.approx(2.85, rel=0.2) and found['yaw_angle_largest'] < math.radians(
            5.0
        )
    else:
        assert min(value for key, value in found.items() if key.startswith('clearance')) >= 0.0


@pytest.mark.slow
def test_a_sine_with_dwell_too_fast_for_a_steering_is_refused_before_it_is_driven(tmp_path: Path, capsys) -> None:
    assert main(['maneuver', 'fmvss126', 'formula_student', '--out', str(tmp_path / 'dwell'), *FAST]) == 2
    assert 'fmvss126 is no maneuver for so direct a steering' in capsys.readouterr().err


@pytest.mark.slow
def test_frequency_response_is_that_of_the_linear_single_track_when_slow(
    known: dict[str, float], slow_understeer: float, tmp_path: Path, capsys
) -> None:
    found = values(driven(capsys, 'iso7401_frequency', tmp_path / 'out'), 'iso7401_frequency')
    v = found['speed']
    gain = v / (known['steering_ratio'] * (known['wheelbase'] + slow_understeer * v * v))
    assert found['yaw_rate_static_gain'] == pytest.approx(gain, rel=0.05)
    assert found['lateral_acceleration_static_gain'] == pytest.approx(v * gain, rel=0.05)
    assert found['yaw_rate_least_coherence'] > 0.95
    assert found['lateral_acceleration_phase_1hz'] < found['yaw_rate_phase_1hz'] < 0.0


def test_without_a_name_the_maneuvers_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['maneuver']) == 0
    text = capsys.readouterr().out
    assert all(e.name in text for e in EVALUATIONS if e.drive)


@pytest.mark.parametrize(
    ('arguments', 'sentence'),
    [
        (['iso4183', 'light_car'], "did you mean 'iso4138'"),
        (['iso4138'], 'the VEHICLE is missing'),
        (['iso4138', 'light_cart'], "did you mean 'light_car'"),
        (['iso4138', 'light_car', '--with', 'lowest=1'], "no parameter 'lowest'"),
    ],
)
def test_refusals_are_one_sentence(
    arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(['maneuver', *arguments, '--out', str(tmp_path / 'out')]) != 0
    captured = capsys.readouterr()
    assert captured.out == ''
    assert captured.err.count('\n') == 1
    assert sentence in captured.err
    assert not (tmp_path / 'out').exists()


@pytest.mark.parametrize('refused', [['iso4138_constant_radius'], ['iso4138_constant_speed']])
def test_a_method_that_is_refused_leaves_the_report_of_the_others(
    refused: list[str], tmp_path: Path, monkeypatch, capsys
) -> None:
    """On a slippery road a car may turn on a circle and not reach the acceleration at the speed of another method."""

    def drive(self: Driving, evaluation: Evaluation) -> tuple[list[Path], dict[str, float]]:
        if evaluation.name in refused:
            raise SpecError('the car does not reach it')
        s = circling(evaluation.name.removeprefix('iso4138_'))
        place = tmp_path / f'{evaluation.name}.csv'
        columns = np.column_stack([s.t, *s.values.values()])
        np.savetxt(place, columns, delimiter=',', header=','.join(['time [s]', *s.values]), comments='')
        return [place], {}

    monkeypatch.setattr(Driving, 'drive', drive)
    out = tmp_path / 'out'
    command = ['maneuver', 'iso4138', 'light_car', '--out', str(out), '--with', 'wheelbase=2.7', '--with', 'ratio=16']
    assert main(command) == SpecError.exit_code
    text = capsys.readouterr().out
    assert f'{refused[0]}: REFUSED: the car does not reach it' in text
    assert text.splitlines()[-2] == f'not judged: the norm has no limits; refused, see above: {refused[0]}'
    assert 'REFUSED: the car does not reach it' in (out / 'report.html').read_text()
    data = json.loads((out / 'report.json').read_text())
    assert (data['status'], data['refused']) == ('error', dict.fromkeys(refused, 'the car does not reach it'))
    assert len(data['results']) == 2
    refused[:] = [e.name for e in called('iso4138')]
    assert main([*command, '--json']) == SpecError.exit_code
    assert json.loads(capsys.readouterr().out) == {'status': 'error', 'error': 'the car does not reach it'}


def test_every_maneuver_states_its_evaluation() -> None:
    for e in EVALUATIONS:
        if e.drive is None:
            continue
        maneuver = load_maneuver(
            find_file(e.drive.maneuver, 'maneuvers'), ['driver.wheelbase=2.7'] if e.drive.driver else []
        )
        assert called(maneuver.evaluation) == (e,)
        assert maneuver.speed is not None


@pytest.mark.slow
def test_a_car_that_cannot_reach_the_acceleration_is_told(tmp_path: Path) -> None:
    driving = Driving('light_car', tmp_path, ['road.friction=0.3', 'integrator.h=0.004'])
    with pytest.raises(
        SpecError, match=r'does not reach a lateral acceleration of 4 m/s\^2 at this speed on a road of friction 0\.3'
    ):
        driving.drive(called('iso7401_step')[0])
    runs = list(tmp_path.iterdir())
    assert len(runs) == 3  # ramps of growing length, until the car does no more
    assert all(bag.read(run).metadata['status'] in ('ok', 'suspect') for run in runs)
