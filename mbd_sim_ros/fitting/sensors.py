"""Sensors: what is measured of a motion, where, and with which delay, gain and offset."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from solver.errors import SpecError, suggestion


class Kind(NamedTuple):
    """A measured quantity. unit. noise: between samples, of usual sensors. offset: sd of it. of: from (motion (n,
    COLUMNS), place from the centre of mass and from the origin of the chassis [m], step [s]) to (n,) values."""

    unit: str
    noise: float
    offset: float
    of: Callable[[np.ndarray, np.ndarray, np.ndarray, float], np.ndarray]


def _rate(axis: int) -> Any:
    return lambda rows, arm, place, dt: rows[:, 3 + axis]


def _force(axis: int) -> Any:
    """Specific force: f + dw x arm + w x (w x arm)."""
    return lambda rows, arm, place, dt: _specific_force(rows, arm, dt)[:, axis]


def _specific_force(rows: np.ndarray, arm: np.ndarray, dt: float) -> np.ndarray:
    if not arm.any():
        return rows[:, :3]
    w = rows[:, 3:6]
    return np.asarray(rows[:, :3] + np.cross(np.gradient(w, dt, axis=0), arm) + np.cross(w, np.cross(w, arm)))


def _horizontal(axis: int) -> Any:
    """Acceleration along the intermediate axes of [ISO8855], which are horizontal: the specific force without the part
    of the weight that roll and pitch add to it."""

    def of(rows: np.ndarray, arm: np.ndarray, place: np.ndarray, dt: float) -> np.ndarray:
        turned = Rotation.from_quat(rows[:, 15:19])
        force = turned.apply(np.array(_specific_force(rows, arm, dt)))  # a copy: motions that are kept are read-only
        ahead = turned.apply([1.0, 0.0, 0.0])
        size = np.hypot(ahead[:, 0], ahead[:, 1])
        along, left = (ahead[:, 0], ahead[:, 1]) if axis == 0 else (-ahead[:, 1], ahead[:, 0])
        return np.asarray((along * force[:, 0] + left * force[:, 1]) / size)

    return of


def _velocity(axis: int) -> Any:
    def of(rows: np.ndarray, arm: np.ndarray, place: np.ndarray, dt: float) -> np.ndarray:
        moved = rows[:, 6:9] + np.cross(rows[:, 9:12], place)
        return np.asarray(moved[:, axis])

    return of


def _sideslip(rows: np.ndarray, arm: np.ndarray, place: np.ndarray, dt: float) -> np.ndarray:
    moved = rows[:, 6:9] + np.cross(rows[:, 9:12], place)
    return np.arctan2(moved[:, 1], moved[:, 0])


def _angle(name: str) -> Any:
    def of(rows: np.ndarray, arm: np.ndarray, place: np.ndarray, dt: float) -> np.ndarray:
        x, y, z, w = rows[:, 15:19].T
        if name == 'roll':
            return np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
        return np.asarray(np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0)))

    return of


def _wheel(k: int) -> Any:
    return lambda rows, arm, place, dt: rows[:, 19 + k]


CORNERS = ('front_left', 'front_right', 'rear_left', 'rear_right')
KINDS = {
    'yaw_rate': Kind('rad/s', 0.002, 0.005, _rate(2)),
    'roll_rate': Kind('rad/s', 0.01, 0.005, _rate(0)),
    'pitch_rate': Kind('rad/s', 0.01, 0.005, _rate(1)),
    'longitudinal_acceleration': Kind('m/s^2', 0.1, 0.2, _force(0)),
    'lateral_acceleration': Kind('m/s^2', 0.1, 0.2, _force(1)),
    'vertical_acceleration': Kind('m/s^2', 0.2, 0.3, _force(2)),
    'longitudinal_velocity': Kind('m/s', 0.05, 0.05, _velocity(0)),
    'lateral_velocity': Kind('m/s', 0.05, 0.05, _velocity(1)),
    'sideslip': Kind('rad', 0.003, 0.005, _sideslip),
    'roll': Kind('rad', 0.003, 0.01, _angle('roll')),
    'pitch': Kind('rad', 0.003, 0.01, _angle('pitch')),
    **{f'wheel_speed_{corner}': Kind('rad/s', 0.3, 0.1, _wheel(k)) for k, corner in enumerate(CORNERS)},
}
AROUND = ('longitudinal_velocity', 'vertical_acceleration', *(f'wheel_speed_{corner}' for corner in CORNERS))
OF = {name: kind.of for name, kind in KINDS.items()}
HORIZONTAL = {'longitudinal_acceleration': _horizontal(0), 'lateral_acceleration': _horizontal(1)}
# sd of the delay [s] and gain of a usual sensor; ten times as much would be a fault
DELAY, GAIN = 0.02, 0.01
# s to either side in which a delay is sought, of a passenger car; in ten times as much another bend of the road fits
LOOK = 0.6


@dataclass(frozen=True)
class Sensor:
    """A measured channel with its nuisances at some values. place: in the design frame [m]; com: of the chassis.
    horizontal: of an acceleration, whether it is one in the plane of the road, as inertial navigation gives it."""

    kind: str
    place: tuple[float, float, float]
    com: tuple[float, float, float]
    yaw: float
    delay: float = 0.0
    gain: float = 1.0
    offset: float = 0.0
    lever_x: float = 0.0
    lever_y: float = 0.0
    mounting: float = 0.0
    horizontal: bool = False

    def at(self, rows: np.ndarray, dt: float, t: np.ndarray, spread: np.ndarray | float = 0.0) -> np.ndarray:
        """The signal at times t [s] from the first of the rows, as means over times with a variance `spread` [s^2]
        around them."""
        return self.shown([rows], dt, [t], [spread])[0]

    def shown(
        self, motions: Sequence[np.ndarray], dt: float, t: Sequence[np.ndarray], spread: Sequence[np.ndarray | float]
    ) -> list[np.ndarray]:
        """The same of many motions: cubic splines through all of one length are made at once."""
        values = [self._values(rows, dt) for rows in motions]
        found = [np.zeros(0)] * len(values)
        for size in {one.size for one in values}:
            own = [k for k, one in enumerate(values) if one.size == size]
            curves = CubicSpline(dt * np.arange(size), np.column_stack([values[k] for k in own])).c
            for j, k in enumerate(own):
                at = np.clip(t[k] - self.delay, 0.0, dt * (size - 1))
                piece = np.minimum((at / dt).astype(int), size - 2)
                x = at - dt * piece
                c3, c2, c1, c0 = curves[:, piece, j]
                mean = ((c3 * x + c2) * x + c1) * x + c0 + spread[k] * (3.0 * c3 * x + c2)
                found[k] = np.asarray(self.gain * mean + self.offset)
        return found

    def _values(self, rows: np.ndarray, dt: float) -> np.ndarray:
        place = np.array(self.place) + [self.lever_x, self.lever_y, 0.0]
        arm = place - np.array(self.com)
        turn = self.yaw + self.mounting
        of = OF | (HORIZONTAL if self.horizontal else {})
        values = of[self.kind](rows, arm, place, dt)
        pair = PAIRS.get(self.kind)
        if pair is not None and turn:
            other = of[pair[0]](rows, arm, place, dt)
            values = np.cos(turn) * values + pair[1] * np.sin(turn) * other
        elif self.kind == 'sideslip':
            values = values - turn
        return np.asarray(values)


PAIRS = {  # the other component of a vector in the plane, and the sign of its part where the sensor turns left
    'longitudinal_acceleration': ('lateral_acceleration', 1.0),
    'lateral_acceleration': ('longitudinal_acceleration', -1.0),
    'longitudinal_velocity': ('lateral_velocity', 1.0),
    'lateral_velocity': ('longitudinal_velocity', -1.0),
}


def require_kind(name: str, *, horizontal: bool = False) -> str:
    """The kind of a channel by its name, behind which there may be more ('yaw_rate.imu'). Raises SpecError."""
    kind = name.partition('.')[0]
    if kind not in KINDS:
        raise SpecError(f'channels: {name!r} is no quantity that can be compared{suggestion(kind, KINDS)}')
    if horizontal and kind not in HORIZONTAL:
        raise SpecError(f'channels: {name}: horizontal is for {" and ".join(HORIZONTAL)}; take it away')
    return kind
