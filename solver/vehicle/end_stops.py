"""End of a steering: its end stops, which a vehicle may state, or else a distance from its dead centres.

A rod between the gear and a steering arm turns the wheel by the part of its force that is across the arm. There is none
if rod and arm come to lie in one line: the dead centre, beyond which the wheel turns the other way. It is the same at
the gear where the rod comes to lie across the way of its inner ball. No steering goes there: without a word about its
stops it ends where either angle is MARGIN, in the design position of the suspension.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

from solver.validate import Vector

# angle of transmission that is left at the end; with a tenth of it a linkage locks by its friction
MARGIN = math.radians(20.0)
# of the steering wheel between two looks [rad]; with ten times as much an end within half a turn may be passed over
STEP = 0.05
FURTHEST = 30.0  # of the steering wheel [rad], to a side: lorries have 18; what ends beyond has no end
LOCK_ROUNDED_TO = 0.01  # of the end that is found [rad]: rounding of a processor does not show in it


class Linkage(NamedTuple):
    """Linkage that steers a wheel: two points of its steering axis, lower and upper, and the ends of the rod that turns
    it about that [m]."""

    low: Vector
    high: Vector
    inner: Vector
    outer: Vector

    def mirrored(self) -> Linkage:
        """That of the other side."""
        return Linkage(*((x, -y, z) for x, y, z in self))


def cross(a: Vector, b: Vector) -> Vector:
    """a x b."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a: Vector, b: Vector) -> float:
    """a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def plus(a: Vector, k: float, b: Vector) -> Vector:
    """a + k b."""
    return (a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2])


def rotated(axis: Vector, angle: float, a: Vector) -> Vector:
    """A vector turned about a unit vector by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = cross(axis, a)
    return plus((c * a[0] + s * x, c * a[1] + s * y, c * a[2] + s * z), (1.0 - c) * dot(axis, a), axis)


def lock_of(linkages: Iterable[Linkage], moves: Callable[[float], Vector]) -> float | None:
    """Angle of the steering wheel to either side at which the first of these linkages ends [rad]; None where none of
    them does.

    moves: way of the inner ball [m] at an angle of the steering wheel [rad].
    """
    ends = [_end(one, lambda x, way=way: moves(way * x)) for one in linkages for way in (1.0, -1.0)]  # type: ignore[misc]
    found = min(ends, default=FURTHEST)
    return (
        None if found >= FURTHEST or found <= STEP else round(LOCK_ROUNDED_TO * math.floor(found / LOCK_ROUNDED_TO), 2)
    )


def _end(linkage: Linkage, moves: Callable[[float], Vector]) -> float:
    """Angle of the steering wheel [rad] to one side."""
    # Plain numbers: a car is looked at a thousand times when it is read, and arrays of three would take ten times as
    # long.
    low, high, inner, outer = linkage
    line, arm, rod = plus(high, -1.0, low), plus(outer, -1.0, low), plus(outer, -1.0, inner)
    axis, length = plus((0.0, 0.0, 0.0), 1.0 / math.hypot(*line), line), math.hypot(*rod)

    def solved(angle: float, turn: float) -> float | None:
        """Angle of the wheel at an angle of the steering wheel, from one near by; None at the end."""
        ball = plus(inner, 1.0, moves(angle))
        way = plus(moves(angle + 1e-3), -1.0, moves(angle - 1e-3))
        along = math.hypot(*way)
        for _ in range(20):
            at = rotated(axis, turn, arm)
            rod, velocity = plus(plus(low, 1.0, at), -1.0, ball), cross(axis, at)
            across = dot(rod, velocity)
            square = dot(rod, rod)
            least = math.sin(MARGIN) * math.sqrt(square)
            if abs(across) < least * math.hypot(*velocity) or abs(dot(rod, way)) < least * along:
                return None
            gap = 0.5 * (square - length * length)
            if abs(gap) < 1e-12 * length * length:
                return turn
            turn -= gap / across
        return None

    angle, turn, step = 0.0, 0.0, STEP
    while step > 0.01 * LOCK_ROUNDED_TO:
        found = solved(angle + step, turn) if angle < FURTHEST else turn
        if found is None:
            step *= 0.5
        else:
            angle, turn = angle + step, found
        if angle >= FURTHEST:
            return FURTHEST
    return angle
