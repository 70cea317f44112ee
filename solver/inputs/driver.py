"""Drivers: what they command as a function of the motion, sampled once per step. One looks ahead along a path, the
other keeps a speed.

Law of the one who looks ahead: the preview-follower with one preview point. At the preview distance l = v T ahead of
the vehicle, along its heading, the path lies e to the left of it. The arc that reaches the path there has the curvature

    kappa = 2 e / l^2

(lateral acceleration 2 e / T^2, the optimal single-point preview of [Guo1993]; for a point on the arc, pure pursuit
[Coulter1992]). The steering wheel is turned to the angle which holds this curvature in the steady state of the
single-track model ([Gillespie1992] 6.5)

    steering = ratio (wheelbase + understeer v^2) kappa

and reaches it through the hands: rate limit and critically damped lag of solver.inputs.command_filter.CommandSource.

Law of the one who keeps a speed: torque T = P e + I + inertia * dv_wanted/dt with e = v_wanted - v and dI/dt = P
(omega/2) e. On a car that answers with inertia * dv/dt = T - resistance, P = 2 omega inertia makes this a critically
damped loop of frequency omega. I stands still while T is beyond the torques of the engine; torques below them are left
to the brakes, if they are allowed. All of this is mirrored where the wanted speed is below 0, or is 0 and the car rolls
backwards: the engine drives backwards, the brakes slow the car down as ever.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Annotated, Literal, NamedTuple

import numpy as np

from solver.compiled.portable import clamped_spline_slopes, piecewise_cubic
from solver.dimensions import Frequency, HandRate, Length, Place, Speed, Time, Torque, Understeer, WheelTurn
from solver.errors import SpecError
from solver.inputs.signals import Signal, quintic

COARSE = 0.25  # distance of the points that a course is drawn with [m]
FAR = 1e5  # m
FURTHEST = 1e7  # m that a path may be away; grids of maps go as far
NARROWEST, WIDEST = 0.03, 3.0  # m, models of 1:50 to lorries: 0.3 would leave models out, 30 is no vehicle
TIGHTEST = 1.3  # wheelbases in the radius of a circle: road wheels at 38 deg; 13 would refuse what every car can drive
STRETCH = 64  # points of a course that are looked at together


def _near(**numbers: float) -> None:
    """Refuse places that no car reaches, and where a metre is lost in rounding."""
    for name, number in numbers.items():
        if not abs(number) <= FURTHEST:
            raise SpecError(f'{name} = {number:g}: must be within {FURTHEST:g} m')


def _numbers(points: Sequence[Place]) -> dict[str, float]:
    return {f'points[{k}][{axis}]': point[axis] for k, point in enumerate(points) for axis in (0, 1)}


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

    standard: iso_3888_1 (severe double lane change, 125 m with the lane behind it) or iso_3888_2 (obstacle avoidance,
    61 m). width: of the vehicle without mirrors [m]; it decides the width of the lanes. The path is the middle of each
    lane, joined by quintic steps that use the whole length between two lanes.
    """

    kind: Literal['double_lane_change'] = 'double_lane_change'
    standard: Literal['iso_3888_1', 'iso_3888_2'] = 'iso_3888_1'
    width: Length = 1.8
    start: Length = 50.0

    def __post_init__(self) -> None:
        if not NARROWEST <= self.width <= WIDEST:
            raise SpecError(f'width = {self.width:g}: must be the width of a vehicle, {NARROWEST:g} to {WIDEST:g} m')
        _near(start=self.start)

    @cached_property
    def gates(self) -> tuple[Gate, ...]:
        """The lanes. Part 1: 15, 30, 25, 25, 30 m, right edges of the first two lanes 3.5 m apart. Part 2: 12, 13.5,
        11, 12.5, 12 m, 1 m between the left edge of the first lane and the right edge of the second. The third lane
        continues the first one's right edge.
        """
        w = self.width
        if self.standard == 'iso_3888_1':
            lengths, first, second, third = (
                (15.0, 30.0, 25.0, 25.0, 30.0),
                1.1 * w + 0.25,
                1.2 * w + 0.25,
                1.3 * w + 0.25,
            )
        else:
            lengths, first, second, third = (
                (12.0, 13.5, 11.0, 12.5, 12.0),
                1.1 * w + 0.25,
                w + 1.0,
                max(1.3 * w + 0.25, 3.0),
            )
        x = [self.start + behind for behind in accumulate(lengths, initial=0.0)]
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
            done = (x - before.end) / (after.begin - before.end)
            y += (after.middle - before.middle) * quintic(min(max(done, 0.0), 1.0))
        return y

    def left_of(self, x: float, y: float, heading: float) -> float:
        """Distance [m] by which the path lies to the left of a point, seen along the heading [rad]."""
        return (self.lateral(x) - y) * math.cos(heading)


@dataclass(frozen=True, kw_only=True)
class Waypoints:
    """A path y(x) through points [[x, y], ...] [m], x increasing: cubic spline with horizontal ends, straight on beyond
    them."""

    kind: Literal['waypoints'] = 'waypoints'
    points: tuple[Place, ...]

    def __post_init__(self) -> None:
        if len(self.points) < 2:
            raise SpecError(f'points: {len(self.points)} given, a path needs at least two [x, y] points')
        _near(**_numbers(self.points))
        for k in range(1, len(self.points)):
            if not self.points[k][0] > self.points[k - 1][0]:
                raise SpecError(f'points[{k}][0] = {self.points[k][0]:g}: must be greater than the x before it')

    @cached_property
    def spline(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x [m], y [m] and slopes at the points, (n,) each."""
        at, y = np.array(self.points).T
        return at, y, clamped_spline_slopes(at, y)

    def lateral(self, x: float) -> float:
        """y of the path [m] at x [m]."""
        at = self.spline[0]
        return float(piecewise_cubic(*self.spline, np.clip(x, at[0], at[-1]))[0])

    def left_of(self, x: float, y: float, heading: float) -> float:
        """Distance [m] by which the path lies to the left of a point, seen along the heading [rad]."""
        return (self.lateral(x) - y) * math.cos(heading)


@dataclass(frozen=True, kw_only=True)
class Circle:
    """Round and round a circle that touches the x axis at x = start: to the left where the radius is positive, else to
    the right."""

    kind: Literal['circle'] = 'circle'
    radius: Length
    start: Length = 0.0

    def __post_init__(self) -> None:
        if not abs(self.radius) > 0.0:
            raise SpecError(f'radius = {self.radius:g}: must not be 0')
        _near(start=self.start, radius=self.radius)

    def left_of(self, x: float, y: float, heading: float) -> float:
        """Distance [m] by which the path lies to the left of a point, seen along the circle."""
        distance = math.hypot(x - self.start, y - self.radius)
        return math.copysign(1.0, self.radius) * (distance - abs(self.radius))


@dataclass(frozen=True, kw_only=True)
class Course:
    """Any way on the plane: through points [[x, y], ...] [m] in their order, back to the first one where closed;
    straight on behind the ends of an open one.

    Between the points runs the cubic of Catmull and Rom with the square roots of the distances as its parameter, which
    makes neither loops nor corners ([Yuksel2011]); its curvature jumps at the points, so that a curve wants them
    closely spaced.
    """

    kind: Literal['course'] = 'course'
    points: tuple[Place, ...]
    closed: bool = False

    def __post_init__(self) -> None:
        if len(self.points) < 2 + self.closed:
            raise SpecError(
                f'points: {len(self.points)} given, a course needs at least {2 + self.closed} [x, y] points'
            )
        _near(**_numbers(self.points))
        for k, (p, q) in enumerate(pairwise((*self.points, *self.points[: self.closed]))):
            if math.hypot(q[0] - p[0], q[1] - p[1]) < COARSE:
                raise SpecError(
                    f'points[{(k + 1) % len(self.points)}]: must be at least {COARSE:g} m from the point before it'
                )

    @cached_property
    def line(self) -> np.ndarray:
        """(n, 2) points [m] of the course, COARSE apart or closer, those of an open one with a straight way of FAR at
        both ends."""
        p = np.array(self.points)
        if self.closed:
            p = np.concatenate([p[-1:], p, p[:2]])
        else:
            p = np.concatenate([[2.0 * p[0] - p[1]], p, [2.0 * p[-1] - p[-2]]])
        parts = []
        for a, b, c, d in zip(p[:-3], p[1:-2], p[2:-1], p[3:], strict=True):
            t = np.cumsum([0.0, *(math.sqrt(math.hypot(*(v - u).tolist())) for u, v in ((a, b), (b, c), (c, d)))])
            n = math.ceil(math.hypot(*(c - b).tolist()) / COARSE)
            s = (t[1] + (t[2] - t[1]) * np.arange(n) / n)[:, None]
            A, B, C = (
                ((v - s) * x + (s - u) * y) / (v - u)
                for u, v, x, y in ((t[0], t[1], a, b), (t[1], t[2], b, c), (t[2], t[3], c, d))
            )
            D, E = ((t[2] - s) * A + (s - t[0]) * B) / (t[2] - t[0]), ((t[3] - s) * B + (s - t[1]) * C) / (t[3] - t[1])
            parts.append(((t[2] - s) * D + (s - t[1]) * E) / (t[2] - t[1]))
        way = np.concatenate([*parts, p[-2:-1]])
        if self.closed:
            return way
        first, last = (FAR * (u - v) / math.hypot(*(u - v).tolist()) for u, v in ((way[0], way[1]), (way[-1], way[-2])))
        return np.concatenate([[way[0] + first], way, [way[-1] + last]])

    @cached_property
    def stretches(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The course in pieces, so that a step need not look at all of it: their points (2, m, STRETCH + 1) [m], of
        which the last is the first of the next piece, and circles around them: centres (2, m), radii (m,) [m]."""
        m = math.ceil((len(self.line) - 1) / STRETCH)
        at = np.minimum(STRETCH * np.arange(m)[:, None] + np.arange(STRETCH + 1), len(self.line) - 1)
        points = np.ascontiguousarray(self.line.T[:, at])
        centres = 0.5 * (points.min(axis=2) + points.max(axis=2))
        away = points - centres[:, :, None]
        return points, centres, 1.001 * np.sqrt((away[0] * away[0] + away[1] * away[1]).max(axis=1))

    def left_of(self, x: float, y: float, heading: float) -> float:
        """Distance [m] by which the course lies to the left of a point, across the heading [rad]; where it does not
        cross that line, the distance of the nearest point of it, on the side where this is."""
        c, s = math.cos(heading), math.sin(heading)
        points, (middle_x, middle_y), radii = self.stretches
        near = points.take(np.flatnonzero(np.abs(c * (middle_x - x) + s * (middle_y - y)) <= radii), axis=1)
        ahead = c * (near[0] - x) + s * (near[1] - y)
        behind = ahead <= 0.0
        where = np.flatnonzero(behind[:, :-1] > behind[:, 1:])  # in the direction of the course
        if not len(where):
            dx, dy = self.line[:, 0] - x, self.line[:, 1] - y
            ahead, left = c * dx + s * dy, c * dy - s * dx
            nearest = int(np.argmin(ahead * ahead + left * left))
            return math.copysign(math.hypot(ahead[nearest], left[nearest]), left[nearest])
        across = []
        for k in where.tolist():
            i, j = divmod(k, STRETCH)
            (xa, xb), (ya, yb) = near[:, i, j : j + 2].tolist()
            a, b = c * (xa - x) + s * (ya - y), c * (xb - x) + s * (yb - y)
            p, q = c * (ya - y) - s * (xa - x), c * (yb - y) - s * (xb - x)
            across.append(p - a * (q - p) / (b - a))
        return min(across, key=abs)


class Sight(NamedTuple):
    """Sight of the driver at the beginning of a step: reference frame of the chassis in the world."""

    x: float  # [m]
    y: float  # [m]
    heading: float  # of its x axis [rad]
    speed: float  # along its x axis [m/s]


@dataclass(frozen=True, kw_only=True)
class PreviewDriver:
    """Steers along a path by previewing it; see the module for the law.

    path: where to. preview: time T [s] to the preview point. wheelbase [m]. ratio: of the steering wheel to the road
    wheels [-]. understeer: gradient of the road wheels' angle over lateral acceleration [rad s^2/m]. limit: largest
    angle of the steering wheel. bandwidth [Hz] and rate_limit [rad/s] of the hands. slowest: speed below which the
    preview distance shrinks no further [m/s]. He drives forward: a scene that starts backwards, or keeps a speed below
    0, is refused.
    """

    path: DoubleLaneChange | Waypoints | Circle | Course
    preview: Time = 0.8
    wheelbase: Length = 2.7
    ratio: float = 16.0
    understeer: Understeer = 0.0
    limit: WheelTurn = 8.0
    bandwidth: Frequency = 4.0
    rate_limit: HandRate = 15.0
    slowest: Speed = 3.0

    def __post_init__(self) -> None:
        for name in ('preview', 'wheelbase', 'limit', 'bandwidth', 'rate_limit', 'slowest'):
            if not getattr(self, name) > 0.0:
                raise SpecError(f'{name} = {getattr(self, name):g}: must be > 0')
        least = TIGHTEST * self.wheelbase
        if isinstance(self.path, Circle) and not abs(self.path.radius) >= least:
            remedy = f'{TIGHTEST:g} times its wheelbase = {self.wheelbase:g} m, or more'
            raise SpecError(
                f'path.radius = {self.path.radius:g}: must be a radius that a car can drive, {least:.4g} m: {remedy}'
            )

    def steering(self, sight: Sight) -> float:
        """Angle at the steering wheel [rad] that the driver wants."""
        v = max(sight.speed, self.slowest)
        distance = v * self.preview
        c, s = math.cos(sight.heading), math.sin(sight.heading)
        x, y = sight.x + distance * c, sight.y + distance * s
        error = self.path.left_of(x, y, sight.heading)
        angle = self.ratio * (self.wheelbase + self.understeer * v * v) * 2.0 * error / (distance * distance)
        return min(max(angle, -self.limit), self.limit)


@dataclass(frozen=True, kw_only=True)
class SpeedControl:
    """Keeps a speed with the drive torque, and with the brakes where these are allowed; see the module for the law.

    target: speed along the x axis of the chassis over time (none: that of the start of the scene). until: from then on
    no torque at all (throttle released, clutch open; it fades over `release`). inertia: torque at the differential per
    acceleration of the car, about mass times radius of the wheels. bandwidth: of the loop. first: torque at t = 0,
    below 0 backwards. most, least: torques of the engine, in the direction of the target: backwards where this is below
    0. brakes: most brake torque of all wheels together.
    """

    target: Annotated[float | Signal | None, 'm/s'] = None
    until: Time | None = None
    release: Time = 0.2
    inertia: Annotated[float, 'N m s^2/m'] = 450.0
    bandwidth: Frequency = 0.3
    first: Torque = 0.0
    most: Torque = 3000.0
    least: Torque = -300.0
    brakes: Torque = 0.0

    def __post_init__(self) -> None:
        for name in ('inertia', 'bandwidth', 'release'):
            if not getattr(self, name) > 0.0:
                raise SpecError(f'{name} = {getattr(self, name):g}: must be > 0')
        if not self.least <= 0.0 < self.most:
            raise SpecError(f'least = {self.least:g} and most = {self.most:g}: least must be <= 0 and most > 0')
        if not self.brakes >= 0.0:
            raise SpecError(f'brakes = {self.brakes:g}: must be >= 0')

    def torques(
        self, t: float, wanted: float, slope: float, speed: float, kept: float, h: float
    ) -> tuple[float, float, float]:
        """(drive torque, brake torque, I after the step) [N m] at t [s] for the wanted speed [m/s], its slope [m/s^2],
        the speed and I."""
        on = 1.0 if self.until is None else min(max(1.0 - (t - self.until) / self.release, 0.0), 1.0)
        if on == 0.0:
            return 0.0, 0.0, kept
        if wanted < 0.0 or (wanted == 0.0 and speed < 0.0):
            drive, brake, kept = self._forwards(-wanted, -slope, -speed, -kept, h)
            return 0.0 - on * drive, on * brake, -kept
        drive, brake, kept = self._forwards(wanted, slope, speed, kept, h)
        return on * drive, on * brake, kept

    def _forwards(self, wanted: float, slope: float, speed: float, kept: float, h: float) -> tuple[float, float, float]:
        omega = 2.0 * math.pi * self.bandwidth
        gain = 2.0 * omega * self.inertia
        error = wanted - speed
        torque = gain * error + kept + self.inertia * slope
        low = self.least - self.brakes
        if low < torque < self.most or (torque >= self.most and error < 0.0) or (torque <= low and error > 0.0):
            kept += h * gain * 0.5 * omega * error
        torque = min(max(torque, low), self.most)
        return max(torque, self.least), max(self.least - torque, 0.0), kept
