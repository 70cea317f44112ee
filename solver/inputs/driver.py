"""A driver who looks ahead along a path: the angle of the steering wheel as a function of the motion, sampled once per step.

Law: the preview-follower with one preview point. At the preview distance l = v T ahead of the vehicle, along its heading, the path
lies e to the left of it. The arc that reaches the path there has the curvature

    kappa = 2 e / l^2

(lateral acceleration 2 e / T^2, the optimal single-point preview of [Guo1993]; for a point on the arc, pure pursuit [Coulter1992]). The
steering wheel is turned to the angle which holds this curvature in the steady state of the single-track model ([Gillespie1992] 6.5)

    steering = ratio (wheelbase + understeer v^2) kappa

and reaches it through the hands: rate limit and critically damped lag of solver.inputs.maneuver.CommandSource.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal, NamedTuple

import numpy as np

from solver.compiled.portable import clamped_spline_slopes, piecewise_cubic
from solver.errors import SpecError
from solver.inputs.signals import smooth_step


class Gate(NamedTuple):
    """A lane between two rows of cones parallel to x: from x = begin to end, between y = right and left [m]."""

    begin: float
    end: float
    right: float
    left: float

    @property
    def middle(self) -> float:
        """y of its centre line [m]."""
        return 0.5 * (self.right + self.left)


@dataclass(frozen=True, kw_only=True)
class DoubleLaneChange:
    """The track of [ISO3888] along x, beginning at x = start with the centre line of its first lane at y = 0.

    standard: iso_3888_1 (severe double lane change, 125 m with the lane behind it) or iso_3888_2 (obstacle avoidance, 61 m).
    width: of the vehicle without mirrors [m]; it decides the width of the lanes.
    The path is the middle of each lane, joined by quintic steps that use the whole length between two lanes.
    """

    kind: Literal['double_lane_change'] = 'double_lane_change'
    standard: Literal['iso_3888_1', 'iso_3888_2'] = 'iso_3888_1'
    width: Annotated[float, 'm'] = 1.8
    start: Annotated[float, 'm'] = 50.0

    def __post_init__(self) -> None:
        if not 0.5 <= self.width <= 3.0:
            raise SpecError(f'width = {self.width:g}: must be the width of a vehicle, 0.5 to 3 m')

    @property
    def gates(self) -> tuple[Gate, ...]:
        """The lanes. Part 1: 15, 30, 25, 25, 30 m, right edges of the first two lanes 3.5 m apart. Part 2: 12, 13.5, 11, 12.5, 12 m,
        1 m between the left edge of the first lane and the right edge of the second. The third lane continues the first one's right edge.
        """
        w = self.width
        if self.standard == 'iso_3888_1':
            lengths, first, second, third = (15.0, 30.0, 25.0, 25.0, 30.0), 1.1 * w + 0.25, 1.2 * w + 0.25, 1.3 * w + 0.25
        else:
            lengths, first, second, third = (12.0, 13.5, 11.0, 12.5, 12.0), 1.1 * w + 0.25, w + 1.0, max(1.3 * w + 0.25, 3.0)
        x = self.start + np.concatenate([[0.0], np.cumsum(lengths)])
        right = -0.5 * first
        other = right + 3.5 if self.standard == 'iso_3888_1' else 0.5 * first + 1.0
        return (
            Gate(x[0], x[1], right, right + first),
            Gate(x[2], x[3], other, other + second),
            Gate(x[4], x[5], right, right + third),
        )

    def lateral(self, x: float) -> float:
        """y of the path [m] at x [m]."""
        gates = self.gates
        y = gates[0].middle
        for before, after in pairwise(gates):
            rise = smooth_step(np.array(x), before.end, after.begin - before.end)
            y += (after.middle - before.middle) * float(rise.value)
        return y


@dataclass(frozen=True, kw_only=True)
class Waypoints:
    """A path y(x) through points [[x, y], ...] [m], x increasing: cubic spline with horizontal ends, straight on beyond them."""

    kind: Literal['waypoints'] = 'waypoints'
    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        if len(self.points) < 2:
            raise SpecError(f'points: {len(self.points)} given, a path needs at least two [x, y] points')
        for k in range(1, len(self.points)):
            if not self.points[k][0] > self.points[k - 1][0]:
                raise SpecError(f'points[{k}][0] = {self.points[k][0]:g}: must be greater than the x before it')

    def lateral(self, x: float) -> float:
        """y of the path [m] at x [m]."""
        at, y = np.array(self.points).T
        return float(piecewise_cubic(at, y, clamped_spline_slopes(at, y), np.clip(x, at[0], at[-1]))[0])


class Sight(NamedTuple):
    """What the driver sees at the beginning of a step: reference frame of the chassis in the world."""

    x: float  # [m]
    y: float  # [m]
    heading: float  # of its x axis [rad]
    speed: float  # along its x axis [m/s]


@dataclass(frozen=True, kw_only=True)
class PreviewDriver:
    """Steers along a path by previewing it; see the module for the law.

    path: y(x). preview: time T [s] to the preview point. wheelbase [m]. ratio: of the steering wheel to the road wheels [-].
    understeer: gradient of the road wheels' angle over lateral acceleration [rad s^2/m]. limit: largest angle of the steering wheel.
    bandwidth [Hz] and rate_limit [rad/s] of the hands. slowest: speed below which the preview distance shrinks no further [m/s].
    """

    path: DoubleLaneChange | Waypoints
    preview: Annotated[float, 's'] = 0.8
    wheelbase: Annotated[float, 'm'] = 2.7
    ratio: float = 16.0
    understeer: Annotated[float, 'rad s^2/m'] = 0.0
    limit: Annotated[float, 'rad'] = 8.0
    bandwidth: Annotated[float, 'Hz'] = 4.0
    rate_limit: Annotated[float, 'rad/s'] = 15.0
    slowest: Annotated[float, 'm/s'] = 3.0

    def __post_init__(self) -> None:
        for name in ('preview', 'wheelbase', 'limit', 'bandwidth', 'rate_limit', 'slowest'):
            if not getattr(self, name) > 0.0:
                raise SpecError(f'{name} = {getattr(self, name):g}: must be > 0')

    def steering(self, sight: Sight) -> float:
        """Angle at the steering wheel [rad] that the driver wants."""
        v = max(sight.speed, self.slowest)
        distance = v * self.preview
        c, s = math.cos(sight.heading), math.sin(sight.heading)
        x, y = sight.x + distance * c, sight.y + distance * s
        error = (self.path.lateral(x) - y) * c
        angle = self.ratio * (self.wheelbase + self.understeer * v * v) * 2.0 * error / (distance * distance)
        return float(np.clip(angle, -self.limit, self.limit))
