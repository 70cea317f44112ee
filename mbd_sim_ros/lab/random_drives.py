"""Drives as people drive them, made by a seed: bends and straights at several speeds, with the steering never at rest.
Recordings of them are sensors with noise, delays and offsets. Their truth is known.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from mbd_sim_ros.bags.reader import Run, Series
from solver.files.naming import included
from solver.files.scene import find_file

STEP = 0.1  # s between two points of the steering; ten times as much holds no frequency above 0.5 Hz
SLEW = 0.8  # m/s^2, change of the speed; ten times as much is full braking
BEND = (3.0, 9.0)  # s, shortest and longest bend; ten times as long is a circle
LEVEL = (8.0, 25.0)  # s at about one speed; ten times as long is a drive at one speed
STRAIGHT = 0.3  # part of the bends that are straights; 1 is a drive without a bend


@dataclass(frozen=True, kw_only=True)
class RandomDrive:
    """A drive by its seed. duration [s]. speeds: least and largest [m/s]. corner: largest lateral acceleration of a
    bend [m/s^2]. busy: standard deviation of the lateral acceleration of the steering that is never at rest [m/s^2].
    length: i L [m] and stability: K/L [s^2/m^2] by which the steering angle for an acceleration is chosen; they need
    not be exact."""

    seed: int
    duration: float = 300.0
    speeds: tuple[float, float] = (10.0, 30.0)
    corner: float = 3.5
    busy: float = 0.3
    length: float = 40.0
    stability: float = 8e-4

    def points(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(t [s], speed [m/s], angle of the steering wheel [rad]), straight for the first two seconds."""
        rng = np.random.default_rng(self.seed)
        t = np.arange(0.0, self.duration + STEP, STEP)
        v = _limited(_levels(rng, t, LEVEL, lambda: rng.uniform(*self.speeds)), SLEW * STEP)
        bends = _levels(rng, t, BEND, lambda: rng.uniform(-1.0, 1.0) if rng.random() > STRAIGHT else 0.0)
        a = _smooth(self.corner * bends, 1.0) + self.busy * rng.standard_normal(t.size)
        a *= np.clip((t - 2.0) / 1.0, 0.0, 1.0)
        return t, v, self.length * (1.0 + self.stability * v * v) * a / (v * v)

    def scene(self, vehicle: str, level: str) -> str:
        """Text of a scene that drives it."""
        t, v, angle = self.points()
        rough = slice(None, None, round(1.0 / STEP))
        target = ', '.join(f'[{a:.6g}, {b:.6g}]' for a, b in zip(t[rough], v[rough]))
        steering = ', '.join(f'[{a:.6g}, {b:.6g}]' for a, b in zip(t, angle))
        return '\n'.join((
            f'name: random_drive_{self.seed}',
            f'vehicle: {included(find_file(vehicle, "vehicles"))}',
            f'start: {{kind: equilibrium, speed: {v[0]:.6g}}}',
            'maneuver:',
            '  name: random_drive',
            f'  steering: {{kind: table, points: [{steering}]}}',
            f'  speed: {{target: {{kind: table, points: [{target}]}}, bandwidth: 0.5, most: 5000}}',
            f'fidelity: {level}',
            'integrator: {h: 1.0e-3, iterations: 2}',
            f'duration: {self.duration:g}',
            'record: {every: 20, elements: false}',
        ))  # fmt: skip


def _levels(
    rng: np.random.Generator, t: np.ndarray, spans: tuple[float, float], draw: Callable[[], float]
) -> np.ndarray:
    """Values that hold for a time drawn from `spans` [s] each."""
    result, at = np.empty(t.size), 0.0
    while at <= t[-1]:
        end = at + rng.uniform(*spans)
        result[(t >= at) & (t < end)] = draw()
        at = end
    return result


def _limited(values: np.ndarray, most: float) -> np.ndarray:
    """Values that change by `most` from one to the next at most."""
    result = values.copy()
    for k in range(1, result.size):
        result[k] = result[k - 1] + min(max(values[k] - result[k - 1], -most), most)
    return result


def _smooth(values: np.ndarray, seconds: float) -> np.ndarray:
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(values, 0.5 * seconds / STEP)


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """Sensors of a recording. noise: standard deviation of white noise, by signal; offset, delay [s] and factor
    likewise."""

    noise: Mapping[str, float] = field(default_factory=dict)
    offset: Mapping[str, float] = field(default_factory=dict)
    delay: Mapping[str, float] = field(default_factory=dict)
    factor: Mapping[str, float] = field(default_factory=dict)

    def recorded(self, t: np.ndarray, signals: Mapping[str, np.ndarray], seed: int) -> Run:
        """A recording of true signals by these sensors, each a topic of its own."""
        rng = np.random.default_rng(seed)
        series = {}
        for name, values in signals.items():
            late = np.interp(t - self.delay.get(name, 0.0), t, values)
            read = self.factor.get(name, 1.0) * late + self.offset.get(name, 0.0)
            read = read + self.noise.get(name, 0.0) * rng.standard_normal(t.size)
            series[name] = Series(np.round(t * 1e9).astype(np.int64), {name: read})
        return Run(series=series)


ORDINARY = Sensors(
    noise={
        'steering': 0.002, 'speed': 0.05, 'yaw_rate': 0.004, 'lateral_acceleration': 0.15, 'roll': 0.003,
        'heading': 0.002, 'sideslip_angle': 0.004,
    },
    offset={'steering': 0.03, 'yaw_rate': 0.003, 'lateral_acceleration': 0.08},
    delay={'yaw_rate': 0.02, 'lateral_acceleration': 0.03, 'speed': 0.02},
)  # fmt: skip


def shifted(sensors: Sensors, **changes: Mapping[str, float]) -> Sensors:
    """The sensors with other noise, offset, delay or factor of some signals."""
    return dataclasses.replace(
        sensors, **{what: {**getattr(sensors, what), **values} for what, values in changes.items()}
    )


def linear(
    drive: RandomDrive, *, wheelbase: float, ratio: float, understeer: float, rate: float = 50.0, lag: float = 0.1
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """(t, signals) of a car in closed form: the steering angle d, behind a lag of first order [s] whose equivalent
    delay is that lag, is i (atan(L k) + K v^2 k) of the curvature k = r/v; understeer: K [rad s^2/m]. Its roll angle is
    0.01 rad s^2/m of the lateral acceleration v r, its sideslip angle 0."""
    t, v, angle = drive.points()
    at = np.arange(0.0, t[-1], 1.0 / rate)
    v, angle = np.interp(at, t, v), np.interp(at, t, angle)
    decay, late = math.exp(-1.0 / (rate * lag)), np.zeros(at.size)
    for k in range(1, at.size):
        late[k] = decay * late[k - 1] + (1.0 - decay) * 0.5 * (angle[k - 1] + angle[k])
    curvature = late / (ratio * (wheelbase + understeer * v * v))
    for _ in range(6):  # Newton; the equation is nearly linear
        over = np.arctan(wheelbase * curvature) + understeer * v * v * curvature - late / ratio
        curvature -= over / (wheelbase / (1.0 + (wheelbase * curvature) ** 2) + understeer * v * v)
    r = v * curvature
    heading = np.concatenate([[0.0], np.cumsum(0.5 * (r[1:] + r[:-1]) / rate)])
    signals = {
        'steering': angle, 'speed': v, 'yaw_rate': r, 'lateral_acceleration': v * r, 'roll': 0.01 * v * r,
        'heading': heading,
    }  # fmt: skip
    return at, signals
