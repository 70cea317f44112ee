"""Recordings that the program makes itself, of a car whose numbers are known: for the tutorial and for what proves the
fit to itself (docs/fitting.md)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mbd_sim_ros.analysis.pages import write_text
from mbd_sim_ros.fitting.car import Car
from mbd_sim_ros.fitting.driving import Inputs, Steering, drive
from mbd_sim_ros.fitting.file import FitFile, load_file
from mbd_sim_ros.fitting.recordings import Data, Track, Window
from mbd_sim_ros.fitting.sensors import KINDS, Sensor
from solver.disk import atomic_write
from solver.units import STANDARD_GRAVITY

RATE = 100.0  # Hz of a usual logger


def course(seconds: float, seed: int, *, speed: float = 22.0, swing: float = 0.9, ratio: float = 1.0) -> np.ndarray:
    """(n, 3) times [s], angles of the steering wheel [rad] and speeds [m/s] of a drive on winding roads: sums of sines
    with random phases, and some quick turns."""
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE) + 1) / RATE
    angle = np.zeros_like(t)
    for frequency, size in ((0.06, 0.5), (0.11, 0.45), (0.23, 0.35), (0.41, 0.25), (0.7, 0.15), (1.2, 0.06)):
        angle += size * np.sin(
            2.0 * np.pi * frequency * t * (1.0 + 0.1 * random.standard_normal()) + 6.3 * random.random()
        )
    for _ in range(round(seconds / 12.0)):  # lane changes
        at, sign = seconds * random.random(), random.choice([-1.0, 1.0])
        x = (t - at) / 0.9
        angle += 0.8 * sign * np.where(np.abs(x) < 1.0, np.sin(np.pi * x) * np.cos(0.5 * np.pi * x) ** 2, 0.0)
    v = speed * (1.0 + 0.15 * np.sin(2.0 * np.pi * t / 37.0 + 6.3 * random.random()))
    v += speed * 0.07 * np.sin(2.0 * np.pi * t / 13.0 + 6.3 * random.random())
    ease = np.clip(t / 2.0, 0.0, 1.0) ** 2
    return np.column_stack([t, swing * ratio * angle * ease, v])


def recorded(
    file: FitFile,
    home: Path,
    inputs: np.ndarray,
    truth: Mapping[str, float],
    faults: Mapping[str, Mapping[str, float]],
    seed: int,
    car: Car | None = None,
) -> dict[str, np.ndarray]:
    """Columns of a recording: `t`, and every channel of the file, of its vehicle with other numbers (truth, by name).

    inputs (n, 3): as of course(), the true ones. faults: delay, gain, offset, noise of a channel, by its name or
    'steering'. Raises MbdError.
    """
    random = np.random.default_rng(seed)
    car = Car(file, home) if car is None else car
    t, angle, v = inputs.T
    name = file.drive.steering_wheel or file.drive.road_wheel[0]
    data = Data('made', 'fit', {name: Track(t, file.drive.channel(angle)), file.drive.speed: Track(t, v)})
    plain = dataclasses.replace(file.drive, drive_torque='', brake_torque='', road_wheel=file.drive.road_wheel[:1])
    window = Window('made', 'fit', 0.0, 0.0, float(t[-1]))
    driven = Inputs(data, plain, window, car)
    rows = drive(car.simulation(dict(truth)), driven, Steering())
    columns = {'t': t}
    bad = faults.get('steering', {})
    late = np.interp(t - bad.get('delay', 0.0), t, angle)
    measured = file.drive.channel(late / bad.get('gain', 1.0) - bad.get('offset', 0.0))
    columns[name] = measured + bad.get('noise', 0.0) * random.standard_normal(t.size)
    speed = Sensor('longitudinal_velocity', (0.0, 0.0, 0.0), car.com, 0.0).at(rows, driven.dt, t)
    columns[file.drive.speed] = speed + 0.02 * car.size.speed * random.standard_normal(t.size)
    for label, channel in file.channels.items():
        kind = label.partition('.')[0]
        fault = faults.get(label, {})
        place = channel.at or car.com
        sensor = Sensor(
            kind, place, car.com, channel.yaw, fault.get('delay', 0.0), fault.get('gain', 1.0),
            fault.get('offset', 0.0), horizontal=channel.horizontal,
        )  # fmt: skip
        noise = fault.get('noise', KINDS[kind].noise) * random.standard_normal(t.size)
        columns[channel.channel] = sensor.at(rows, driven.dt, t) + noise
    return columns


def write_table(place: Path, columns: Mapping[str, np.ndarray], units: Mapping[str, str]) -> None:
    """A table of columns, as loggers write them."""
    head = ','.join(f'{name} [{units[name]}]' if name in units else name for name in columns)
    rows = np.column_stack(list(columns.values()))
    with atomic_write(place) as part:
        np.savetxt(part, rows, fmt='%.9g', delimiter=',', header=head, comments='')


TRUTH = {  # of the car of the example, beside that of its file
    'mass': 1300.0, 'yaw_inertia': 2200.0, 'cornering_stiffness_front': 0.90, 'cornering_stiffness_rear': 1.08,
}  # fmt: skip
FAULTS = {  # of its sensors
    'steering': {'delay': 0.010, 'offset': 0.02},
    'yaw_rate': {'delay': 0.015, 'offset': 0.004},
    'lateral_acceleration': {'delay': 0.030, 'offset': 0.15, 'gain': 1.01},
}
MAPPING = """# Which column is what (mbd compare drive_1.csv --look proposes such a file)
channels:
  cmd_applied/steering: {channel: steering_wheel, unit: deg}
  odom/twist/vx: {channel: speed, unit: km/h}
  imu/wz: {channel: yaw_rate, unit: deg/s}
  imu/ay: {channel: lateral_acceleration, unit: g}
"""
FIT = """# Three drives of a car that is 50 kg heavier than the light car, and has other tires (docs/fitting.md)
vehicle: vehicles/light_car.yaml
mapping: mapping.yaml
recordings:
  drive_1: {file: drive_1.csv}
  drive_2: {file: drive_2.csv}
  drive_3: {file: drive_3.csv, use: held_out}
drive: {steering_wheel: cmd_applied/steering, speed: odom/twist/vx}
channels:
  yaw_rate: {channel: imu/wz}
  lateral_acceleration: {channel: imu/ay}
windows: {length: 8}
parameters:
  mass: {sd: 5 %}
  yaw_inertia: {sd: class}
  cornering_stiffness_front: {}
  cornering_stiffness_rear: {}
constants:                 # what else is uncertain of the car goes into every interval
  center_x: {sd: 0.02}
  friction_front: {sd: 5 %}
  friction_rear: {sd: 5 %}
"""


def write_example(home: Path, *, seconds: float = 35.0) -> Path:
    """Write recordings, their mapping and the file of a fit; returns that. Raises MbdError."""
    write_text(home / 'mapping.yaml', MAPPING)
    write_text(home / 'fit.yaml', FIT)
    file = load_file(home / 'fit.yaml')
    degrees = 180.0 / math.pi
    units = {
        't': ('time', 's', 1.0),
        'cmd_applied/steering': ('steering_wheel', 'deg', degrees),
        'odom/twist/vx': ('speed', 'km/h', 3.6),
        'imu/wz': ('yaw_rate', 'deg/s', degrees),
        'imu/ay': ('lateral_acceleration', 'g', 1.0 / STANDARD_GRAVITY),
    }  # fmt: skip
    car = Car(file, home)
    for k in range(3):
        made = recorded(file, home, course(seconds, k + 1), TRUTH, FAULTS, k + 11, car)
        table = {units[name][0]: values * units[name][2] for name, values in made.items()}
        write_table(home / f'drive_{k + 1}.csv', table, {name: unit for name, unit, _ in units.values()})
    return home / 'fit.yaml'
