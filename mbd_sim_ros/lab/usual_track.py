"""The usual single track with seven parameters, fitted in the same way as a vehicle: what the levels are compared with.

Two axles with the magic formula F = D sin(C atan(B alpha)), D = mu F_z at the loads at rest, and a relaxation length;
no roll, no transfer of load, the speed along x as it was measured. Its parameters: yaw inertia, cornering stiffness and
friction of both axles, shape C, relaxation length. Source: [Pacejka2012] 1.3, 4.3.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from mbd_sim_ros.fitting.car import Number
from mbd_sim_ros.fitting.driving import COLUMNS, Inputs, Steering
from solver.compiled.kernel import kernel
from solver.errors import StepError
from solver.units import MODEL_GRAVITY
from solver.vehicle.size import Size


@kernel()
def follow(p, delta, speed, h, out):
    """Assign (n, 3) lateral velocity at the centre of mass, yaw rate, lateral acceleration.

    p: mass, yaw inertia, front and rear: distance, cornering stiffness, largest force; shape, relaxation length. delta,
    speed (n,): at the steps h [rad], [m/s].
    """
    m, J, a, Ca, Da, b, Cb, Db, shape, length = p
    vy = 0.0
    r = 0.0
    fa = 0.0
    fb = 0.0
    for k in range(delta.shape[0]):
        v = max(speed[k], 0.1)
        out[k, 0] = vy
        out[k, 1] = r
        out[k, 2] = (fa + fb) / m
        sa = delta[k] - np.arctan2(vy + a * r, v)
        sb = -np.arctan2(vy - b * r, v)
        ga = Da * np.sin(shape * np.arctan(Ca / (shape * Da) * np.tan(sa)))
        gb = Db * np.sin(shape * np.arctan(Cb / (shape * Db) * np.tan(sb)))
        decay = 1.0 - np.exp(-h * v / length)
        fa += decay * (ga - fa)
        fb += decay * (gb - fb)
        vy += h * ((fa + fb) / m - v * r)
        r += h * (a * fa - b * fb) / J


@dataclasses.dataclass
class UsualTrack:
    """See the module; stands where a fit has its Car. mass [kg], front, rear: distances of the axles [m]."""

    mass: float
    front: float
    rear: float
    h: float
    size: Size

    def __post_init__(self) -> None:
        g, wheelbase = MODEL_GRAVITY, self.front + self.rear
        loads = self.mass * g * self.rear / wheelbase, self.mass * g * self.front / wheelbase
        self.loads = loads
        self.numbers: dict[str, tuple[float, Number]] = {
            'mass': (self.mass, Number((), 0.03, unit='kg')),
            'yaw_inertia': (self.mass * self.front * self.rear, Number((), 0.1, unit='kg m^2')),
            'stiffness_front': (15.0 * loads[0], Number((), 0.4, unit='N/rad')),
            'stiffness_rear': (18.0 * loads[1], Number((), 0.4, unit='N/rad')),
            'friction_front': (1.0, Number((), 0.2, unit='1')),
            'friction_rear': (1.0, Number((), 0.2, unit='1')),
            'shape': (1.4, Number((), 0.2, unit='1')),
            'relaxation': (0.2 * wheelbase, Number((), 0.5, unit='m')),
        }
        self.com = self.place = (0.0, 0.0, 0.0)
        self.speed, self.road_map, self.lock, self.centre, self.text = 20.0 * self.size.speed, None, None, '', 'usual'

    def number(self, name: str) -> Number:
        """The number of a name, with the name as its key."""
        return dataclasses.replace(self.numbers[name][1], keys=(name,))

    def value(self, name: str) -> float:
        """Value with which a fit begins."""
        return self.numbers[name][0]

    def class_sd(self, name: str) -> float:
        """Scatter of the class."""
        value, number = self.numbers[name]
        return value * number.of_class

    def linearize(self, values: Mapping[str, float], widths: Mapping[str, float]) -> None:
        """Nothing is derived."""

    def driven(self, values: Mapping[str, float], inputs: Sequence[Inputs], steering: Steering) -> list[np.ndarray]:
        """Motions of windows, as of a vehicle. Raises StepError for one that spins."""
        values = {name: value for name, (value, _) in self.numbers.items()} | dict(values)
        p = np.array([
            values['mass'], values['yaw_inertia'], self.front, values['stiffness_front'],
            values['friction_front'] * self.loads[0], self.rear, values['stiffness_rear'],
            values['friction_rear'] * self.loads[1], values['shape'], values['relaxation'],
        ])  # fmt: skip
        return [self._one(p, one, steering) for one in inputs]

    def _one(self, p: np.ndarray, one: Inputs, steering: Steering) -> np.ndarray:
        delta = one.steering(steering)[:, 0]
        chunk = delta.size // one.chunks
        samples, _ = one.speed(steering)
        speed = np.interp(self.h * (np.arange(delta.size) + 1.0), one.t, samples)
        out = np.zeros((delta.size, 3))
        follow(p, delta, speed, self.h, out)
        if not (np.abs(out[:, 0]) < speed).all():  # also what is no number
            raise StepError(f'recording {one.window.recording!r}: the vehicle spins: its sideslip passes 45 deg')
        rows = np.zeros((one.chunks + 1, COLUMNS))
        rows[1:, [7, 11, 1]] = out[chunk - 1 :: chunk]
        rows[:, 5], rows[:, 6], rows[:, 18] = rows[:, 11], samples, 1.0
        return rows


def distances(wheelbase: float, front_share: float) -> tuple[float, float]:
    """Distances of the axles from the centre of mass [m]."""
    return wheelbase * (1.0 - front_share), wheelbase * front_share
