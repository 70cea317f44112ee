"""Recordings of a fit: stretches, windows, what is left out and refused; sensors by laws; vehicles by similarity."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from mbd_sim_ros.fitting import driving, recordings
from mbd_sim_ros.fitting import tracks as linear
from mbd_sim_ros.fitting.car import Car
from mbd_sim_ros.fitting.driving import Inputs, Steering, _lagged, drive
from mbd_sim_ros.fitting.file import Drive, Known, Like, Recording, Windows, load_file, number_of, sd_of
from mbd_sim_ros.fitting.recordings import Data, Track, Window
from mbd_sim_ros.fitting.sensors import Sensor, require_kind
from mbd_sim_ros.fitting.similar import total_mass, vehicle_like, yaml_of
from mbd_sim_ros.fitting.tracks import LinearTrack
from solver.errors import BagError, MbdError, SceneError, SpecError
from solver.files.scene import load_scene_text

DRIVE = Drive(steering_wheel='s', speed='v')


def made(seconds: float = 60.0, rate: float = 50.0) -> dict[str, Track]:
    t = np.arange(round(seconds * rate)) / rate
    wave = np.sin(t) + 0.01 * np.cos(31.0 * t)
    return {'s': Track(t, wave), 'v': Track(t, 20.0 + 0.5 * wave), 'r': Track(t, 0.1 * wave)}


def without(track: Track, first: float, last: float) -> Track:
    keep = (track.t < first) | (track.t > last)
    return Track(track.t[keep], track.y[keep])


def windows(tracks: dict[str, Track]) -> tuple[list[recordings.Window], list[str]]:
    data = Data('drive', 'fit', tracks)
    return recordings.windows(data, DRIVE, Windows(), 3.0), data.told


def test_windows_fill_a_drive() -> None:
    """Windows of 10 s behind a run-in of 2 s; the rest goes to the last one."""
    found, told = windows(made())
    assert [(w.first, w.last) for w in found[:2]] == [(2.0, 12.0), (12.0, 22.0)]
    assert found[-1].last == pytest.approx(59.98)
    assert all(w.begin == w.first - 2.0 for w in found)
    assert not told


def test_gaps_slow_and_frozen_stretches_are_left_out_and_named() -> None:
    """No window reaches into a gap of an input, a stop or a frozen sensor, and each is named with its times."""
    tracks = made()
    tracks['s'] = without(tracks['s'], 20.0, 21.0)
    slow = tracks['v']
    tracks['v'] = Track(slow.t, np.where((slow.t > 35.0) & (slow.t < 37.0), 0.5, slow.y))
    frozen = tracks['r']
    tracks['r'] = Track(frozen.t, np.where((frozen.t > 48.0) & (frozen.t < 51.0), 0.07, frozen.y))
    found, told = windows(tracks)
    for a, b in ((20.0, 21.0), (35.0, 37.0), (48.0, 51.0)):
        assert all(w.last <= a + 0.05 or w.begin >= b - 0.05 for w in found), (a, b)
    text = '\n'.join(told)
    assert 'no sample of s' in text
    assert 'slower than 3 m/s' in text
    assert 'r is frozen' in text


def test_constant_signal(tmp_path: Path) -> None:
    """A column that never changes is refused by its name."""
    file = tmp_path / 'drive.csv'
    file.write_text('time [s],s,v,r\n' + '\n'.join(f'{0.02 * k},{k % 7},{20 + k % 3},0.5' for k in range(500)))
    with pytest.raises(BagError, match=r'r has the same value 0\.5 all the time'):
        recordings.load('drive', Recording(file=str(file)), file, None, ['s', 'v', 'r'])
    with pytest.raises(BagError, match="no signal 'q'"):
        recordings.load('drive', Recording(file=str(file)), file, None, ['s', 'q'])


def test_pose_becomes_velocities(tmp_path: Path) -> None:
    """On a circle of radius 5 m at 2 m/s: yaw rate 0.4 rad/s, vx 2 m/s, vy 0, by quadratics exact to h^2/6 r^3."""
    t = np.arange(0.0, 20.0, 0.01)
    turn = 0.4 * t
    file = tmp_path / 'pose.csv'
    x, y = 5.0 * np.sin(turn), 5.0 - 5.0 * np.cos(turn)
    head = 'time [s],x [m],y [m],yaw [rad],s'
    np.savetxt(
        file,
        np.column_stack([t, x, y, np.angle(np.exp(1j * turn)), np.sin(t)]),
        delimiter=',',
        header=head,
        comments='',
    )
    needed = ['pose/yaw_rate', 'pose/vx', 'pose/vy', 's']
    tracks = recordings.load('pose', Recording(file=str(file)), file, None, needed).tracks
    inner = slice(20, -20)
    assert np.allclose(tracks['pose/yaw_rate'].y[inner], 0.4, atol=1e-6)
    assert np.allclose(tracks['pose/vx'].y[inner], 2.0, atol=2e-3)
    assert np.allclose(tracks['pose/vy'].y[inner], 0.0, atol=2e-3)


def test_velocities_of_a_long_drive() -> None:
    """Quadratics have their own slopes, to rounding, however long the drive is: in one of a second, of five minutes,
    of an hour with gaps. (Sums over the drive, instead of each fit's own, were off by 2 m/s after six minutes.)"""
    for seconds, rate in ((1.0, 100.0), (300.0, 100.0), (3600.0, 50.0)):
        t = np.arange(round(seconds * rate)) / rate
        t = t[(t % 7.0 > 0.5) | (t < 1.0)]
        t = t + 1e-3 * np.sin(31.0 * t)
        found = recordings._slopes(t, 3.0 - 2.0 * t + 0.01 * t * t, 0.08)
        assert np.abs(found - (0.02 * t - 2.0)).max() < 1e-9 * seconds


def rows_of(at: np.ndarray, values: np.ndarray, t: np.ndarray) -> Track:
    """A signal with own samples at times, in rows at other times t that repeat the last one."""
    return Track(t, values[np.clip(np.searchsorted(at, t, side='right') - 1, 0, None)])


def test_own_samples_of_a_held_signal() -> None:
    """A command that comes ten times a second in rows of a hundred has its own samples, also where it stays as it is,
    and is steered along straight lines between them; its clock may shake."""
    random, t = np.random.default_rng(2), 0.01 * np.arange(6001)
    at = 0.1 * np.arange(600) + 0.003 * random.standard_normal(600).clip(-2.0, 2.0)
    values = np.clip(np.round(np.sin(0.7 * at) + 0.5 * np.sin(2.3 * at), 2), -0.9, 0.9)
    found = recordings.own_samples(rows_of(at, values, t))
    assert found.held
    assert abs(found.t.size - at.size) <= 0.02 * at.size
    assert np.diff(found.t).max() < 0.15  # where the command is at its end for seconds too
    away = np.abs(found.t[:, None] - at[None, :]).min(axis=1)
    assert away.max() < 0.025  # the first row behind, or one beside it where nothing changes
    line = driving._straight(found, 0.02)
    assert np.abs(line.y - np.interp(line.t, at, values)).max() < 0.05 < np.abs(np.diff(values)).max()


@pytest.mark.parametrize(
    'values',
    [
        np.sin(0.01 * np.arange(6001)),  # every row has its own
        np.where(np.arange(6001) // 200 % 2 == 0, 0.1, -0.1),  # steps that are meant, every 2 s
        np.round(3.0 * np.sin(0.01 * np.arange(6001)), 1),  # an encoder of few steps: held for as long as it takes
        np.where(np.arange(6001) > 700, 0.3, 0.0),  # one step
    ],
    ids=['own', 'steps', 'encoder', 'step'],
)
def test_signals_that_are_not_held(values: np.ndarray) -> None:
    track = Track(0.01 * np.arange(6001), values)
    assert recordings.own_samples(track) is track


@pytest.mark.parametrize('time', [1.0, 0.25])
def test_velocities_of_a_pose_of_a_small_car(time: float) -> None:
    """A quadratic over 2h shows of a yaw rate that swings with the frequency w the part 3 (sin wh - wh cos wh)/(wh)^3,
    1 - (wh)^2/10 to the fourth order: h shrinks with the time of the vehicle, so that similar cars turn alike."""
    t = 0.002 * np.arange(5001)
    w = 10.0 / time
    pose = {'x': Track(t, t), 'y': Track(t, 0.0 * t), 'yaw': Track(t, np.sin(w * t) / w)}
    found = recordings._rates(pose, recordings.SMOOTH * time)['pose/yaw_rate'].y
    part = float(found[500:-500] @ np.cos(w * t[500:-500]) / np.sum(np.cos(w * t[500:-500]) ** 2))
    z = w * recordings.SMOOTH * time
    assert part == pytest.approx(3.0 * (math.sin(z) - z * math.cos(z)) / z**3, abs=0.02)  # a sample of the edge


def test_sensor_with_a_lever_arm() -> None:
    """A body that turns at w(t) about its centre of mass: at an arm (a, b) the acceleration along x is -dw/dt b -
    w^2 a, along y dw/dt a - w^2 b, the velocities -w b and w a."""
    dt, a, b = 0.01, 0.8, -0.3
    t = dt * np.arange(400)
    w, dw = 0.5 * np.sin(2.0 * t), np.cos(2.0 * t)
    rows = np.zeros((t.size, 23))
    rows[:, 5] = rows[:, 11] = w
    at = t[50:-50]
    place = {'place': (a, b, 0.2), 'com': (0.0, 0.0, 0.2), 'yaw': 0.0}
    inner = slice(50, -50)
    for kind, expected in (
        ('lateral_acceleration', dw * a - w * w * b),
        ('longitudinal_acceleration', -dw * b - w * w * a),
        ('lateral_velocity', w * a),
        ('longitudinal_velocity', -w * b),
        ('yaw_rate', w),
    ):
        assert np.allclose(Sensor(kind, **place).at(rows, dt, at), expected[inner], atol=1e-4), kind
    late = Sensor('yaw_rate', **place, delay=0.05, gain=2.0, offset=0.1).at(rows, dt, at)
    assert np.allclose(late, 2.0 * 0.5 * np.sin(2.0 * (at - 0.05)) + 0.1, atol=1e-6)


def test_mounting_angle() -> None:
    """A sensor that is turned to the left by 0.1 rad feels an acceleration a along y of the car as a cos 0.1."""
    rows = np.zeros((100, 23))
    rows[:, 0], rows[:, 1] = 3.0, 5.0
    sensor = Sensor('lateral_acceleration', (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.1)
    found = sensor.at(rows, 0.01, np.array([0.5]))
    assert found[0] == pytest.approx(5.0 * math.cos(0.1) - 3.0 * math.sin(0.1))


def test_signs_of_angles() -> None:
    """Axes of ISO 8855: roll is positive with the left side up, pitch with the nose down, sideslip to the left. The
    angles of a body that is rolled by 0.2 and then, about the pitched axis, stands at -0.1 come back apart."""
    roll, pitch = 0.2, -0.1
    rows = np.zeros((100, 23))
    rows[:, 15] = math.sin(0.5 * roll) * math.cos(0.5 * pitch)  # quaternion of pitch, then of roll: x, y, z, w
    rows[:, 16] = math.cos(0.5 * roll) * math.sin(0.5 * pitch)
    rows[:, 17] = -math.sin(0.5 * roll) * math.sin(0.5 * pitch)
    rows[:, 18] = math.cos(0.5 * roll) * math.cos(0.5 * pitch)
    rows[:, 6], rows[:, 7] = 20.0, -1.0
    place = (0.0, 0.0, 0.0)
    at = np.array([0.5])
    assert Sensor('roll', place, place, 0.0).at(rows, 0.01, at) == pytest.approx(roll)
    assert Sensor('pitch', place, place, 0.0).at(rows, 0.01, at) == pytest.approx(pitch)
    assert Sensor('sideslip', place, place, 0.0).at(rows, 0.01, at) == pytest.approx(-0.049958, abs=1e-6)


def test_a_horizontal_acceleration_is_without_the_weight() -> None:
    """A body that rolls by 0.1 to the right, pitches by 0.05 with its nose down and heads 0.7 to the left, with 2 m/s^2
    ahead and 3 to the left in the plane of the road; a sensor on it shows another part of the weight on either axis."""
    roll, pitch, yaw = 0.1, 0.05, 0.7
    turned = Rotation.from_euler('ZYX', [yaw, pitch, roll])
    ahead, left = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    rows = np.zeros((9, 23))
    rows[:, :3] = turned.inv().apply(2.0 * ahead + 3.0 * left + [0.0, 0.0, 9.81])
    rows[:, 15:19] = turned.as_quat()
    t, origin = 0.1 * np.arange(9), (0.0, 0.0, 0.0)
    rows.flags.writeable = False  # as those are that were kept
    shown = {
        (name, horizontal): Sensor(name, origin, origin, 0.0, horizontal=horizontal).at(rows, 0.1, t)[4]
        for name in ('longitudinal_acceleration', 'lateral_acceleration')
        for horizontal in (True, False)
    }
    assert shown['longitudinal_acceleration', True] == pytest.approx(2.0, abs=1e-12)
    assert shown['lateral_acceleration', True] == pytest.approx(3.0, abs=1e-12)
    # by hand: 2 cos p - 9.81 sin p, and 2 sin r sin p + 3 cos r + 9.81 sin r cos p
    assert shown['longitudinal_acceleration', False] == pytest.approx(1.9975 - 0.4903, abs=1e-4)
    assert shown['lateral_acceleration', False] == pytest.approx(0.00998 + 2.98501 + 0.97813, abs=1e-4)
    with pytest.raises(SpecError, match='yaw_rate: horizontal is for longitudinal_acceleration'):
        require_kind('yaw_rate', horizontal=True)


@pytest.mark.slow
@pytest.mark.parametrize('level', ['single_track', 'kc'])
def test_a_horizontal_acceleration_is_that_of_the_motion(level: str, tmp_path: Path) -> None:
    """v r + dvy/dt of a car that corners at 5 m/s^2, by its velocities alone; the body rolls outwards, so a sensor on
    it shows more."""
    (tmp_path / 'fit.yaml').write_text(
        f'vehicle: vehicles/light_car.yaml\nlevel: {level}\nrecordings: {{a: {{file: a, use: held_out}}}}\n'
        'drive: {steering_wheel: s, speed: v}\nchannels: {yaw_rate: {channel: r}}\nparameters: {mass: {sd: 2 %}}\n'
    )
    file = load_file(tmp_path / 'fit.yaml')
    car = Car(file, tmp_path)
    t = 0.01 * np.arange(801)
    steer = Track(t, 1.2 * np.clip((t - 2.0) / 3.0, 0.0, 1.0))
    data = Data('made', 'fit', {'s': steer, 'v': Track(t, np.full(t.size, 20.0))})
    inputs = Inputs(data, file.drive, Window('made', 'fit', 0.0, 0.0, 8.0), car)
    rows = drive(car.simulation({}), inputs, Steering())
    at = np.linspace(3.0, 7.5, 200)

    def shown(kind: str, horizontal: bool = False) -> np.ndarray:
        return Sensor(kind, car.com, car.com, 0.0, horizontal=horizontal).at(rows, inputs.dt, at)

    vy = CubicSpline(at, shown('lateral_velocity'))
    motion = shown('longitudinal_velocity') * shown('yaw_rate') + vy(at, 1)
    assert np.abs(motion).max() > 3.0
    # velocities are along axes of the body, which roll and pitch by 0.05 at most: 1 - cos, and the vertical motion
    assert np.abs(shown('lateral_acceleration', True) - motion).max() < 0.01 * np.abs(motion).max()
    assert (np.abs(shown('lateral_acceleration')) - np.abs(motion))[-50:].min() > 0.02 * np.abs(motion).max()


@pytest.mark.slow
@pytest.mark.parametrize(('length', 'mass'), [(0.1735, 1.58), (0.33, 3.5), (6.0, 9000.0)])
def test_a_car_of_any_size_follows_its_speed(length: float, mass: float, tmp_path: Path) -> None:
    """At level single_track a model car, and a truck, has the speed that it is to have, and wheels that roll at it.
    (With the wheels of a passenger car the control of one of 1:10 was fifteen times too stiff: it drove and braked at
    the limit of the tires, and spun.) A window has the same bits whichever was driven before it."""
    (tmp_path / 'fit.yaml').write_text(
        f'like: {{vehicle: vehicles/light_car.yaml, wheelbase: {length}, mass: {mass}, driven: rear}}\n'
        'level: single_track\nrecordings: {a: {file: a, use: held_out}}\n'
        'drive: {road_wheel: [s], speed: v}\nchannels: {yaw_rate: {channel: r}}\nparameters: {mass: {sd: 2 %}}\n'
    )
    file = load_file(tmp_path / 'fit.yaml')
    car = Car(file, tmp_path)
    size = car.size
    t = 0.01 * size.time * np.arange(801)
    swing = np.sin(2.0 * t / size.time)
    data = Data('made', 'fit', {'s': Track(t, 0.06 * swing), 'v': Track(t, size.speed * (9.0 + np.cos(t / size.time)))})
    inputs = Inputs(data, file.drive, Window('made', 'fit', 0.0, 0.0, float(t[-1])), car)
    simulation = car.simulation({})
    rows = drive(simulation, inputs, Steering())
    wanted, _ = inputs.speed(Steering())
    assert np.abs(rows[:, 6] - wanted).max() < 0.01 * wanted.min()
    assert np.abs(rows[:, 0]).max() < 3.0  # the slope of the speed is 1 m/s^2
    # kinematic yaw rate, of which tires take a part
    kinematic = float(np.abs(rows[:, 6] * np.tan(0.06) / length).max())
    assert 0.6 * kinematic < np.abs(rows[:, 11]).max() < 1.1 * kinematic
    radius = car.data['front']['tire']['values']['UNLOADED_RADIUS']
    assert rows[:, 19:].mean(axis=1) * radius == pytest.approx(rows[:, 6], rel=0.05)
    assert np.array_equal(drive(simulation, inputs, Steering()), rows)


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_curve_of_a_servo(sign: float, tmp_path: Path) -> None:
    """Angles between pairs, their commands back, and a sentence for a command beyond them."""
    known = Drive(road_wheel=('s',), speed='v', curve=((-1.0, -0.4 * sign), (0.0, 0.02 * sign), (1.0, 0.32 * sign)))
    commands = np.array([-1.0, -0.5, 0.0, 0.25, 1.0])
    angles = sign * np.array([-0.4, -0.19, 0.02, 0.095, 0.32])
    assert known.angle(commands) == pytest.approx(angles)
    assert known.channel(angles) == pytest.approx(commands)
    for beyond in (1.2, -30.0, math.nan):
        with pytest.raises(SpecError, match=f's reaches {beyond:g}, and the curve ends at -1 and 1'):
            known.angle(np.array([0.0, beyond, 0.5]))


@pytest.mark.parametrize(
    ('words', 'sentence'),
    [
        ('scale: 2, curve: [[0, 0], [1, 1]]', 'give this or curve'),
        ('curve: [[0, 0]]', 'at least two pairs'),
        ('curve: [[0, 0], [0, 1]]', 'at least two pairs'),
        ('curve: [[0, 0], [1, 0.1], [2, 0.1]]', 'at least two pairs'),
        ('curve: [[1, 0], [0, 1]]', 'rising channel'),
        ('curve: [0, 1]', 'curve'),
    ],
)
def test_curves_that_are_none(words: str, sentence: str, tmp_path: Path) -> None:
    """One sentence each."""
    (tmp_path / 'fit.yaml').write_text(
        'vehicle: vehicles/light_car.yaml\nrecordings: {a: {file: a}}\n'
        f'drive: {{road_wheel: [s], speed: v, {words}}}\nchannels: {{yaw_rate: {{channel: r}}}}\n'
        'parameters: {mass: {sd: 2 %}}\n'
    )
    with pytest.raises(MbdError, match=sentence):
        load_file(tmp_path / 'fit.yaml')


def test_lag_of_the_steering() -> None:
    """Behind a ramp of 2 rad/s a lag of 0.1 s stays 0.2 rad back; rate and acceleration belong to it."""
    h = 0.001
    t = h * np.arange(1, 2001)
    angle, rate, acceleration = _lagged(2.0 * t, np.full(t.size, 2.0), h, 0.1)
    assert angle[-1] == pytest.approx(2.0 * t[-1] - 0.2, abs=1e-8)
    assert np.allclose(np.gradient(angle, h)[10:-10], rate[10:-10], atol=1e-3)
    assert np.allclose(np.gradient(rate, h)[10:-10], acceleration[10:-10], atol=1e-2)


@pytest.mark.parametrize(
    ('words', 'value', 'unit', 'sd'),
    [
        ('2 %', 1500.0, 'kg', 30.0),
        ('5 %', 1.0, '1', 0.05),
        ('20 ms', 0.0, 's', 0.02),
        (0.3, 1.0, 'm', 0.3),
        ('30 kg', 1500.0, 'kg', 30.0),
        ('class', 1.0, '1', 9.0),
        ('none', 1.0, '1', 0.0),
        (None, 1.0, '1', math.inf),
        ('0.5 deg/s', 0.0, 'rad/s', math.radians(0.5)),
    ],
)
def test_priors_in_words(words: str | float | None, value: float, unit: str, sd: float) -> None:
    """What is known, in words, as a standard deviation in the unit of the number."""
    assert sd_of(Known(sd=words), 'mass', value, unit, 9.0) == pytest.approx(sd)


@pytest.mark.parametrize(
    ('words', 'sentence'),
    [
        ('2 kg', 'no such unit'),
        ('3 deg', 'is in rad'),
        ('-2 m', 'must be > 0'),
        ('clas', 'class'),
        ('2 %', 'value is 0'),
    ],
)
def test_priors_that_are_none(words: str, sentence: str) -> None:
    """One sentence each."""
    with pytest.raises(SpecError, match=sentence):
        sd_of(Known(sd=words), 'offset', 0.0, 'm', 1.0)


@pytest.mark.parametrize(('length', 'mass'), [(2.4, 982.0), (0.175, 1.58), (6.0, 9000.0)])
def test_vehicle_like_another(length: float, mass: float) -> None:
    """A vehicle of another size has the wheelbase, mass, load in front and height that are asked for, and is one."""
    data = vehicle_like(
        Like(
            vehicle='vehicles/light_car.yaml',
            wheelbase=length,
            mass=mass,
            front_share=0.45,
            height=0.2 * length,
            driven='rear',
        )
    )
    scene = load_scene_text(yaml_of({'vehicle': data, 'duration': 1.0}))
    bodies = scene.model.bodies
    total = sum(b.mass for b in bodies)
    assert total == pytest.approx(mass)
    x, z = (sum(b.mass * (b.position[k] + b.com[k]) for b in bodies) / total for k in (0, 2))
    wheels = {t.name: next(b for b in bodies if b.name == t.marker.body).position[0] for t in scene.model.tires}
    assert wheels['front_left'] - wheels['rear_left'] == pytest.approx(length)
    assert (x - wheels['rear_left']) / length == pytest.approx(0.45)
    assert z == pytest.approx(0.2 * length)
    assert total_mass('vehicles/light_car.yaml') == pytest.approx(1413.0)


@pytest.mark.parametrize(
    ('change', 'sentence'),
    [
        ('parameters: {mass: {low: 1400, high: 1300}}', 'must be below high'),
        ('drive: {speed: v}', 'give this or road_wheel'),
        ('channels: {}', 'at least one measured signal'),
        ('colour: red', 'unknown key'),
    ],
)
def test_files_that_are_refused(tmp_path: Path, change: str, sentence: str) -> None:
    """A file that cannot be is refused by place and remedy."""
    lines = {
        'vehicle': 'vehicle: vehicles/light_car.yaml', 'recordings': 'recordings: {a: {file: a.csv}}',
        'drive': 'drive: {steering_wheel: s, speed: v}', 'channels': 'channels: {yaw_rate: {channel: r}}',
        'parameters': 'parameters: {mass: {sd: 2 %}}',
    }  # fmt: skip
    lines[change.partition(':')[0]] = change
    file = tmp_path / 'fit.yaml'
    file.write_text('\n'.join(lines.values()))
    with pytest.raises((SceneError, MbdError), match=sentence):
        load_file(file)


def test_numbers_that_end_in_one() -> None:
    """A number without a unit is that number, whatever its last digit: 1 is no unit to be taken off."""
    for words in (0.1, 1.1, '0.21', 1, '1e-1', 11):
        assert sd_of(Known(sd=words), 'x', 2.0, '1', 0.3) == float(words)
        assert number_of(words, 'x', '1') == float(words)
    assert sd_of(Known(sd='1 %'), 'x', 2.0, '1', 0.3) == pytest.approx(0.02)
    assert number_of('0.1 s', 'x', 's') == 0.1
    with pytest.raises(SpecError, match=r'sd = 0\.0: must be > 0'):
        sd_of(Known(sd=0.0), 'x', 2.0, '1', 0.3)


def test_slopes_of_a_number_at_the_edge_of_what_a_vehicle_can_have(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no vehicle has a number on one side, the derivative is that of the other side; on neither, the error."""

    bounds = [0.0, 20.0]

    def derived(scene_of: object, values: dict[str, float]) -> dict[str, dict[str, float]]:
        if not bounds[0] <= values['inertia'] <= bounds[1]:
            raise SpecError('no body has these principal moments')
        return {'all': {'mass': 3.0 * values['inertia'], 'other': 1.0}}

    monkeypatch.setattr(LinearTrack, '_derived', staticmethod(derived))
    track = LinearTrack.__new__(LinearTrack)
    track.centre, track.tables = {'inertia': 10.0}, derived(None, {'inertia': 10.0})
    for ends in ((0.0, 20.0), (0.0, 10.5), (9.5, 20.0)):
        bounds[:] = ends
        assert track._slope(lambda values: None, 'inertia', 1.0) == {'all': {'mass': 3.0, 'other': 0.0}}
    bounds[:] = 9.5, 10.5
    with pytest.raises(SpecError, match='principal moments'):
        track._slope(lambda values: None, 'inertia', 1.0)


def test_slopes_of_a_far_car_are_derived_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slopes serve as long as the centre is within three widths of where they were derived, in all numbers; of curved
    tables those of the start are off by the curve, and those derived anew are right."""
    asked = list[float]()

    def derived(_: object, values: dict[str, float]) -> dict[str, dict[str, float]]:
        asked.append(values['inertia'])
        return {'all': {'force': values['inertia'] ** 2 + values['grip']}}

    monkeypatch.setattr(LinearTrack, '_derived', staticmethod(derived))
    monkeypatch.setattr(linear, 'derive', lambda scene: None)
    scene: Any = dataclasses.make_dataclass('Plain', ['fidelity'])('full')
    widths, found = {'inertia': 1.0, 'grip': 0.1}, None
    for inertia, grip, runs, slope in (
        (10.0, 1.0, 5, 20.0),  # centre and both sides of both numbers
        (12.9, 1.1, 1, 20.0),  # near: the centre alone
        (13.1, 1.1, 5, 26.2),  # too far from the first in one number
        (13.1, 1.41, 5, 26.2),  # in the other one
        (11.0, 1.41, 1, 26.2),
    ):
        asked.clear()
        found = LinearTrack(lambda values: scene, {'inertia': inertia, 'grip': grip}, widths, found)
        assert len(asked) == runs
        assert found.at({'inertia': inertia + 1.0})['all']['force'] == pytest.approx(inertia**2 + grip + slope)
