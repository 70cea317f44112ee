"""Sensors: the accuracy that the topics odom and imu state as covariances, and noise of that accuracy.

The noise is white: every number gets a normal deviate of its own, independent from step to step; an orientation is
turned by a small rotation vector of such deviates. The noise is a pure function of seed and step (Philox, a
counter-based generator: Salmon et al., Parallel random numbers: as easy as 1, 2, 3, SC11). So a run has the same bits
in however many calls it is advanced, and a replay has them again.
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
    """Standard deviations of each component of odom: position, orientation, velocity, and rate, the angular
    velocity."""

    position: Length = 0.0
    orientation: Angle = 0.0
    velocity: Speed = 0.0
    rate: Rate = 0.0

    def __post_init__(self) -> None:
        _not_negative('sensors.odom', self)


@dataclass(frozen=True, kw_only=True)
class ImuSensor:
    """Standard deviations of each component of imu: orientation, rate (angular velocity), acceleration (specific
    force)."""

    orientation: Angle = 0.0
    rate: Rate = 0.0
    acceleration: Acceleration = 0.0

    def __post_init__(self) -> None:
        _not_negative('sensors.imu', self)


@dataclass(frozen=True, kw_only=True)
class Sensors:
    """Accuracy of the topics odom and imu.

    odom, imu: standard deviations, whose squares are the diagonals of the covariance matrices in the messages; 0 if not
    given. noise: whether the numbers in these two topics scatter by these deviations; the motion itself stays exact.
    seed: of the noise; required with it.
    """

    odom: OdomSensor = field(default_factory=OdomSensor)
    imu: ImuSensor = field(default_factory=ImuSensor)
    noise: bool = False
    seed: int | None = None

    def __post_init__(self) -> None:
        require(
            not self.noise or self.seed is not None, 'sensors', 'noise', self.noise, 'needs a seed: give sensors.seed'
        )
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
        """Add the noise of step k to the numbers of both topics, in place.

        odom: (13,) position, quaternion xyzw, velocity, angular velocity. imu: (10,) quaternion xyzw, angular velocity,
        specific force.
        """
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
    """Turn a quaternion xyzw, in place, by a small rotation vector [rad] in its own axes, and normalise it."""
    x, y, z, w = q.tolist()
    a, b, c = (0.5 * by).tolist()
    q += (w * a + y * c - z * b, w * b + z * a - x * c, w * c + x * b - y * a, -(x * a + y * b + z * c))
    q /= norm(q)


def _not_negative(where: str, sensor: object) -> None:
    """Raise SpecError for a standard deviation that is negative or not finite."""
    for name, value in vars(sensor).items():
        finite(where, name, value, low=0.0)
