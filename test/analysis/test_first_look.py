"""The first look is right or silent: columns of a car that is known, renamed, scaled, turned, delayed and with
noise."""

from __future__ import annotations

import json
from pathlib import Path

import foreign_bags as others
import numpy as np
import pytest
from foreign_bags import DAY, MS
from scalars import run_of

from mbd_sim_ros.analysis import mapping, runs
from mbd_sim_ros.analysis.look.first import Look, look
from mbd_sim_ros.analysis.look.grid import Fit
from mbd_sim_ros.analysis.look.roles import role_of
from mbd_sim_ros.commands.main import main
from solver.units import UNITS

DT, N = 0.02, 3000
RADIUS, TRACK, RATIO, WHEELBASE = 0.31, 1.5, 16.0, 2.7
BAGS = Path(__file__).parents[2] / 'bags'
NAMES = {
    'speed': 'GPS Speed',
    'yaw_rate': 'gyro_z',
    'ay': 'LatAcc',
    'ax': 'LongAcc',
    'steering': 'SteeringWheelAngle',
    'yaw': 'heading',
}
CHANNELS = {
    'speed': 'odom/twist/vx',
    'yaw_rate': 'imu/wz',
    'ay': 'imu/ay',
    'ax': 'imu/ax',
    'steering': 'cmd_applied/steering',
}
IN_SI = {'speed': 'm/s', 'yaw_rate': 'rad/s', 'ay': 'm/s^2', 'ax': 'm/s^2', 'steering': 'rad', 'yaw': 'rad'}


def car() -> dict[str, np.ndarray]:
    """A single-track car that speeds up, brakes and steers to both sides for a minute, in SI units, left positive;
    nothing lags.

    So ax = dv/dt - r vy and ay = v r + dvy/dt exactly, and the wheels roll.
    """
    t = np.arange(N) * DT
    v = 16.0 + 6.0 * np.sin(0.35 * t) + 2.0 * np.sin(0.9 * t + 1.0)
    delta = 0.02 * np.sin(0.8 * t) + 0.015 * np.sin(1.7 * t + 0.5) + 0.01 * np.sin(0.23 * t)
    r = v * delta / (WHEELBASE + 0.003 * v**2)
    vy = r * (1.3 - 0.004 * v**2)
    yaw = np.cumsum(r) * DT
    columns = {'speed': v, 'yaw_rate': r, 'vy': vy, 'yaw': yaw, 'steering': RATIO * delta}
    columns |= {'ax': np.gradient(v, DT) - r * vy, 'ay': v * r + np.gradient(vy, DT)}
    columns['x'] = np.cumsum(v * np.cos(yaw) - vy * np.sin(yaw)) * DT
    columns['y'] = np.cumsum(v * np.sin(yaw) + vy * np.cos(yaw)) * DT
    for corner, side in (('FL', -1), ('FR', 1), ('RL', -1), ('RR', 1)):
        columns[corner] = (v + side * r * TRACK / 2.0) / RADIUS
    return columns


def noisy(values: np.ndarray, rng: np.random.Generator, part: float = 0.02) -> np.ndarray:
    return values + part * values.std() * rng.standard_normal(values.size)


def later(values: np.ndarray, samples: int) -> np.ndarray:
    return np.concatenate([np.full(samples, values[0]), values[: values.size - samples]])


def looked(columns: dict[str, np.ndarray], stated: dict[str, str] | None = None) -> Look:
    run = run_of(columns, np.arange(N) * round(DT * 1e9))
    run.stated.update(stated or {})
    return look(run)


def told(found: Look) -> dict[str, tuple[str, str | None, int | None]]:
    return {ours: (c.name, c.unit, c.sign) for ours, c in found.mapping.items()}


def test_si_units_without_a_word_about_them() -> None:
    found = looked({NAMES[what]: values for what, values in car().items() if what in NAMES})
    expected = {ours: (NAMES[what], IN_SI[what], 1) for what, ours in CHANNELS.items()}
    assert told(found) == expected
    assert found.side == ''  # nothing tells which side is positive
    assert {c.name: (c.unit, c.sign) for c in found.columns}['heading'] == ('rad', 1)


def test_other_units_other_signs_and_the_side_by_the_wheels() -> None:
    """What loggers with z down give: all to the right. Wheels left and right tell it."""
    truth = car()
    columns = {
        'Speed': 3.6 * truth['speed'],
        'Gierrate': -np.rad2deg(truth['yaw_rate']),
        'Querbeschleunigung': -truth['ay'] / 9.80665,
    }
    columns |= {'G Force Long': truth['ax'] / 9.80665, 'Lenkradwinkel': np.rad2deg(truth['steering'])}
    columns |= {f'WheelSpeed{corner}': truth[corner] for corner in ('FL', 'FR', 'RL', 'RR')}
    found = looked(columns)
    wheels = {
        f'joint_states/wheel_{end}_{side}/velocity': (f'WheelSpeed{end[0].upper()}{side[0].upper()}', 'rad/s', 1)
        for end in ('front', 'rear')
        for side in ('left', 'right')
    }
    assert told(found) == wheels | {
        'odom/twist/vx': ('Speed', 'km/h', 1), 'imu/wz': ('Gierrate', 'deg/s', -1),
        'imu/ay': ('Querbeschleunigung', 'g', -1),
        'imu/ax': ('G Force Long', 'g', 1), 'cmd_applied/steering': ('Lenkradwinkel', 'deg', 1),
    }  # fmt: skip
    assert found.side.startswith('in a turn WheelSpeedFL and WheelSpeedFR differ')


@pytest.mark.parametrize('seed', range(8))
def test_it_is_right_or_silent(seed: int) -> None:
    """Any units, signs, delays up to 0.2 s and noise: what is told is true, and most is told."""
    rng = np.random.default_rng(seed)
    units = {
        'speed': ('m/s', 'km/h', 'mph'),
        'yaw_rate': ('rad/s', 'deg/s'),
        'ay': ('m/s^2', 'g'),
        'ax': ('m/s^2', 'g'),
        'yaw': ('rad', 'deg'),
    }
    units['steering'] = ('rad', 'deg')
    truth = car()
    columns, right = {}, {}
    for what, possible in units.items():
        unit, sign = str(rng.choice(possible)), int(rng.choice((-1, 1))) if what != 'speed' else 1
        columns[NAMES[what]] = later(noisy(sign * truth[what] / UNITS[unit][1], rng), int(rng.integers(0, 10)))
        right[NAMES[what]] = unit, sign
    columns |= {f'wheel_speed_{corner.lower()}': truth[corner] for corner in ('FL', 'FR')}
    found = looked(columns)
    for c in found.columns:
        if c.name in right and c.unit is not None:
            assert c.unit == right[c.name][0], (c.name, c.why)
        if c.name in right and c.sign is not None:
            assert c.sign == right[c.name][1], (c.name, c.why)
    assert sum(c.told for c in found.columns) >= 4


@pytest.mark.parametrize(
    ('name', 'made'),
    [
        ('gyro_z', lambda truth: np.gradient(truth['ay'], DT)),  # a roll rate
        ('LatAcc', lambda truth: truth['ax']),
        ('GPS Speed', lambda truth: truth['ax']),
        ('SteeringWheelAngle', lambda truth: truth['steering'] / (RATIO * 0.6)),  # a share of the lock
        ('LongAcc', lambda truth: truth['speed']),
        ('heading', lambda truth: truth['yaw'] % 0.1),
        ('LatAcc', lambda truth: 0.6 * truth['ay']),  # in no unit
        ('SteeringWheelAngle', lambda truth: 100.0 * truth['steering'] / (RATIO * 0.6)),  # in percent
        ('GPS Speed', lambda truth: 0.6 * truth['speed']),
        ('gyro_z', lambda truth: 5.0 * truth['yaw_rate']),
    ],
)
def test_a_name_that_the_data_do_not_confirm_is_unknown(name: str, made) -> None:
    truth = car()
    columns = {NAMES[what]: values for what, values in truth.items() if what in NAMES}
    columns[name] = made(truth)
    found = looked(columns)
    one = next(c for c in found.columns if c.name == name)
    assert not one.told, (one.unit, one.sign, one.why)
    assert name not in {c.name for c in found.mapping.values()}
    assert one.why or one.against


def test_a_header_that_states_another_unit_is_not_believed() -> None:
    """rad/s under deg/s: whatever is told then, the yaw rate is not."""
    columns = {NAMES[what]: values for what, values in car().items() if what in ('speed', 'yaw_rate', 'ay', 'ax')}
    found = looked(columns, {'gyro_z': 'deg/s', 'GPS Speed': 'm/s', 'LatAcc': 'm/s^2'})
    assert 'imu/wz' not in found.mapping
    assert 'imu/ay' not in found.mapping
    assert any('holds in no unit' in text for c in found.columns for text in c.against)
    right = looked(columns, {'gyro_z': 'rad/s', 'GPS Speed': 'm/s'})
    assert told(right)['imu/wz'] == ('gyro_z', 'rad/s', 1)


def test_names_that_say_nothing_and_a_car_that_does_nothing_are_unknown() -> None:
    truth = car()
    assert not looked({f'ch{k}': values for k, values in enumerate(truth.values())}).mapping
    still = {NAMES[what]: np.full(N, 10.0 if what == 'speed' else 0.0) for what in NAMES}
    found = looked(still)
    assert not found.mapping
    rng = np.random.default_rng(3)
    assert not looked({name: values + 0.01 * rng.standard_normal(N) for name, values in still.items()}).mapping


def test_positions_tell_speed_and_direction() -> None:
    truth = car()
    wrapped = (truth['yaw'] + np.pi) % (2.0 * np.pi) - np.pi
    columns = {
        'pos x': truth['x'],
        'pos y': truth['y'],
        'yaw': wrapped,
        'gyro z': truth['yaw_rate'],
        'acc y': truth['ay'],
    }
    found = looked(columns)
    assert told(found) == {
        'odom/pose/x': ('pos x', 'm', 1), 'odom/pose/y': ('pos y', 'm', 1),
        'imu/wz': ('gyro z', 'rad/s', 1), 'imu/ay': ('acc y', 'm/s^2', 1),
    }  # fmt: skip


def test_speed_and_wheels_alone_leave_the_unit_open() -> None:
    """2.9 rad/s for a m/s are a wheel of a car; for a km/h that of a model."""
    truth = car()
    found = looked({'Velocity_X': truth['speed'] / 4.0, 'v_wheel_fl': 2.9 * truth['speed'] / 4.0})
    assert not found.mapping
    wheel = next(c for c in found.columns if c.name == 'v_wheel_fl')
    assert 'its unit is not told: rad/s of a wheel that rolls at 0.345 m if Velocity_X is in m/s or' in wheel.why[-1]


def test_the_delivered_measured_car_is_mapped_as_its_own_mapping_does() -> None:
    """It is our car as a measuring system would have recorded it: other names, units and axes, delays and noise
    (bags/real_car.py)."""
    found = told(look(runs.read(BAGS / 'real_car')))
    assert found == {
        'imu/wz': ('vehicle/imu/wz', 'rad/s', -1), 'imu/ay': ('vehicle/imu/ay', 'm/s^2', -1),
        'imu/az': ('vehicle/imu/az', 'm/s^2', -1),
        'odom/twist/vx': ('can/speed/data', 'km/h', 1),
        'cmd_applied/steering': ('can/steering_wheel_angle/data', 'deg', 1),
    }  # fmt: skip


def test_the_text_is_a_mapping_file_that_brings_the_columns_to_ours(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = car()
    table = {
        'time (s)': np.arange(N) * DT,
        'GPS Speed': 3.6 * truth['speed'],
        'gyro z (deg/s)': np.rad2deg(truth['yaw_rate']),
    }
    table |= {'acc y (IMU)': -truth['ay'], 'note': np.zeros(N)}
    file = tmp_path / 'lap.csv'
    np.savetxt(file, np.column_stack(list(table.values())), delimiter=',', header=','.join(table), comments='')
    assert main(['compare', str(file), '--look']) == 0
    (tmp_path / 'car.yaml').write_text(capsys.readouterr().out)
    theirs = runs.read(file)
    ours, _ = mapping.apply(theirs, mapping.load_mapping(tmp_path / 'car.yaml').channels, (), runs.units(theirs))
    np.testing.assert_allclose(ours['odom/twist/vx'], truth['speed'], rtol=1e-12)
    np.testing.assert_allclose(ours['imu/wz'], truth['yaw_rate'], rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(ours['imu/ay'], truth['ay'], rtol=1e-12, atol=1e-15)
    assert main(['compare', str(file), '--look', '--json']) == 0
    data = json.loads(capsys.readouterr().out)
    assert data['mapping']['channels']['imu/ay'] == {'channel': 'acc y (IMU)', 'unit': 'm/s^2', 'sign': -1}
    assert (data['unknown'], data['side']) == (['note'], None)
    assert all(column['evidence'] for column in data['columns'].values())


def test_what_reading_lost_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    coarse = [others.vector('/imu', DAY + k * MS, 0, k // 2 * 2 * MS, 0.1 * k) for k in range(100)]
    place = others.write(
        tmp_path / 'bag', [*coarse, *(others.scalar('/speed', DAY + k * MS, DAY + k * MS, 1.0) for k in range(100))]
    )
    left_out, apart = (
        'topic imu: 50 of 100 messages are left out',
        'its clocks do not meet: imu (header stamp) from 0 to',
    )
    assert main(['compare', str(place), '--look', '--json']) == 0
    doubts = json.loads(capsys.readouterr().out)['doubts']
    assert (
        len(doubts) == 2
        and doubts[0].startswith(apart)
        and '(--log-times)' in doubts[0]
        and doubts[1].startswith(left_out)
    )
    assert main(['compare', str(place), '--look']) == 0
    text = ' '.join(capsys.readouterr().out.replace('#', ' ').split())
    assert left_out in text and apart in text
    assert main(['compare', str(place), '--look', '--json', '--log-times']) == 0
    assert json.loads(capsys.readouterr().out)['doubts'] == []


@pytest.mark.parametrize(
    ('arguments', 'says'),
    [(['{}', 'other', '--look'], 'looks at one recording; leave other '
        'out'), (['{}'], 'the following arguments are required: REFERENCE'),
     (['none.csv', '--look'], 'cannot read none.csv'), (['{}', '--look', '--channel', 'nothing'], 'no channel '
         'matches')],
)  # fmt: skip
def test_wrong_use_is_told(arguments: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / 'x.csv'
    file.write_text('time,x\n0,1\n0.1,2\n')
    assert main(['compare', *(a.format(file) for a in arguments)]) != 0
    assert says in capsys.readouterr().err


def test_what_names_say() -> None:
    """Of loggers, research data and bags; what is another quantity of the same words is none."""
    names = {
        'yaw_rate': ('yawRate', 'Yaw_Velocity', 'W (IMU)', 'imu/wz', 'gyro_z', 'angular_velocity/z', 'Gierrate',
        'yaw_rate_deg_s'),
        'ay': ('ayCG', 'acc y (IMU)', 'Acceleration_Y', 'G Force Lat', 'linear_acceleration/y', 'Querbeschleunigung'),
        'speed': ('vx', 'Velocity_X', 'vel encoder', 'Ground Speed', 'speed_kmh', 'odom/twist/vx'),
        'wheel': ('v_wheel_fl', 'WheelSpeedFL', 'wheel_speed_front_left', 'omega_rl'),
        'steering': ('steering', 'StWhlAng', 'Lenkradwinkel', 'cmd_applied/steering', 'Steering Wheel Angle'),
        'road_angle': ('deltaFL', 'delta'), 'sideslip': ('beta_true',), 'x': ('vicon '
            'x', 'car/Rel_pos_x', 'odom/pose/x'),
        '': ('rpm', 'Engine speed', 'slip_FL', 'Fx_fl', 'Roll_Velocity', 'Velocity_Z', 'SteeringRate',
        'cmd_applied/steering_acceleration',
             'odom/pose/qx', 'joint_states/rack/velocity', 'lap '
                 'time', 'wind speed', 'target_speed', 'latitude', 'motor torque'),
    }  # fmt: skip
    assert {name: role_of(name).what for group in names.values() for name in group} == {
        n: what for what, group in names.items() for n in group
    }
    assert (role_of('speed_kmh').unit, role_of('yaw_rate_deg_s').unit, role_of('WheelSpeedFL').corner) == (
        'km/h',
        'deg/s',
        'front_left',
    )


def test_a_factor_that_cannot_be_found_is_said() -> None:
    assert Fit(float('nan'), 0.0, 0.0).text == 'too little motion, or the factor is not constant'


def test_columns_of_another_clock_are_not_compared(capsys: pytest.CaptureFixture[str]) -> None:
    """Simulation time in some topics and the time of day in another."""
    truth = car()
    run = run_of(
        {NAMES[what]: values for what, values in truth.items() if what in ('speed', 'yaw_rate', 'ay')},
        np.arange(N) * round(DT * 1e9),
    )
    apart = run_of({'clock/heading': truth['yaw']}, np.arange(N) * round(DT * 1e9) + 1_700_000_000 * 10**9)
    run.series |= {'clock': next(iter(apart.series.values()))}
    found = look(run)
    assert set(found.mapping) == {'odom/twist/vx', 'imu/wz', 'imu/ay'}
    assert 'its times meet no others' in next(c for c in found.columns if c.name == 'clock/heading').why[0]
    assert capsys.readouterr().err == ''


def test_what_only_evaluations_have_a_signal_for_stands_as_a_line_to_be_uncommented(tmp_path, capsys):
    """A table without a steering wheel: with these lines it has the angles that mbd evaluate --as drive asks for."""
    truth = car()
    t = np.arange(N) * DT
    road = truth['steering'] / RATIO
    inner = 1.0 + 0.3 * np.sign(road) * np.abs(road)  # of the wheel on the left
    columns = {
        'Time [s]': t, 'GPS Speed [m/s]': truth['speed'], 'gyro_z [rad/s]': truth['yaw_rate'],
        'LatAcc [m/s^2]': truth['ay'], 'LongAcc [m/s^2]': truth['ax'], 'deltaFL [rad]': road * inner,
        'deltaFR [rad]': road / inner,
    }  # fmt: skip
    file = tmp_path / 'lap.csv'
    np.savetxt(file, np.column_stack([*columns.values()]), delimiter=',', header=','.join(columns), comments='')
    assert main(['compare', str(file), '--look']) == 0
    text = capsys.readouterr().out
    assert '  # road_angle_left: {channel: deltaFL, unit: rad}    # for mbd evaluate\n' in text
    (tmp_path / 'car.yaml').write_text(text.replace('  # road_angle', '  road_angle'))
    command = ['evaluate', str(file), '--as', 'drive', '--mapping', str(tmp_path / 'car.yaml'), '--json']
    assert main([*command, '--set', f'wheelbase={WHEELBASE}']) == 0
    figures = json.loads(capsys.readouterr().out)['results'][0]['figures']
    # the linear car has K = 0.003 rad s^2/m, and angles instead of their tangents, 1e-3 of them
    assert figures['understeer_gradient']['value'] == pytest.approx(0.003, rel=0.02)
    assert figures['ratio_times_wheelbase']['value'] == pytest.approx(WHEELBASE, rel=0.02)
