"""Sensors: what the topics odom and imu say of their accuracy, and noise that fits it.

Noise is a pure function of the seed and the step (a counter-based generator, Philox: Salmon et al., Parallel random numbers: as easy as
1, 2, 3, SC11), so a run has the same bits however it is cut, and a replay has them again. Every number gets a normal one of its own,
independent from step to step; an orientation is turned by a small rotation with that vector.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from solver.compiled.portable import norm
from solver.dimensions import Acceleration, Angle, Length, Rate, Speed
from solver.validate import finite, require


@dataclass(frozen=True, kw_only=True)
class OdomSensor:
    """Standard deviations of odom, of each component: position and orientation of the pose, velocity and angular velocity of the twist."""

    position: Length = 0.0
    orientation: Angle = 0.0
    velocity: Speed = 0.0
    rate: Rate = 0.0

    def __post_init__(self) -> None:
        _not_negative('sensors.odom', self)


@dataclass(frozen=True, kw_only=True)
class ImuSensor:
    """Standard deviations of imu, of each component: orientation, angular velocity, specific force."""

    orientation: Angle = 0.0
    rate: Rate = 0.0
    acceleration: Acceleration = 0.0

    def __post_init__(self) -> None:
        _not_negative('sensors.imu', self)


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """Accuracy that odom and imu state: covariances with these standard deviations on their diagonals, 0 where none is
    given.

    noise: numbers that scatter so, instead of the exact ones; only of these two topics, and nothing of it gets back into the motion.
    seed: of the noise, and must be given with it.
    """

    odom: OdomSensor = field(default_factory=OdomSensor)
    imu: ImuSensor = field(default_factory=ImuSensor)
    noise: bool = False
    seed: int | None = None

    def __post_init__(self) -> None:
        require(not self.noise or self.seed is not None, 'sensors', 'noise', self.noise, 'needs a seed: give sensors.seed')
        if self.seed is not None:
            require(0 <= self.seed < 2**63, 'sensors', 'seed', self.seed, 'must be a whole number, 0 or more')

    @property
    def covariances(self) -> dict[str, dict[str, Any]]:
        """Topic -> fields of its message with covariance matrices, row by row."""

        def matrix(*deviations: float) -> np.ndarray:
            return np.diag(np.repeat(np.square(deviations), 3)).ravel()

        odom, imu = self.odom, self.imu
        return {
            'odom': {
                'pose': {'covariance': matrix(odom.position, odom.orientation)},
                'twist': {'covariance': matrix(odom.velocity, odom.rate)},
            },
            'imu': {
                'orientation_covariance': matrix(imu.orientation),
                'angular_velocity_covariance': matrix(imu.rate),
                'linear_acceleration_covariance': matrix(imu.acceleration),
            },
        }

    def scatter(self, k: int, odom: np.ndarray, imu: np.ndarray) -> None:
        """Add the noise of step k to odom (13,): position, quaternion xyzw, velocity, angular velocity; and to imu (10,): quaternion,
        angular velocity, specific force."""
        assert self.seed is not None
        z = np.random.Generator(np.random.Philox(key=self.seed, counter=[0, 0, 0, k])).standard_normal(21)
        o, i = self.odom, self.imu
        odom[:3] += o.position * z[:3]
        _turn(odom[3:7], o.orientation * z[3:6])
        odom[7:10] += o.velocity * z[6:9]
        odom[10:] += o.rate * z[9:12]
        _turn(imu[:4], i.orientation * z[12:15])
        imu[4:7] += i.rate * z[15:18]
        imu[7:] += i.acceleration * z[18:]


def _turn(q: np.ndarray, by: np.ndarray) -> None:
    """Turn a quaternion xyzw by a small rotation vector [rad] in its own axes; it keeps its length 1."""
    x, y, z, w = q.tolist()
    a, b, c = (0.5 * by).tolist()
    q += (w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a, -(x * a + y * b + z * c))
    q /= norm(q)


def _not_negative(where: str, sensor: object) -> None:
    for name, value in vars(sensor).items():
        finite(where, name, value, low=0.0)
