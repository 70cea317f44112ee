"""Where a steering ends: at its end stops, which a vehicle may say, and where it does not at a distance from its dead centres.

A rod between the gear and a steering arm turns the wheel by the part of its force that is across the arm. Where rod and arm come to lie
in one line there is none: the dead centre, beyond which the wheel turns the other way. It is the same at the gear where the rod comes to
lie across the way of its inner ball. No steering goes there: without a word about its stops it ends where either angle is MARGIN, in the
design position of the suspension.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from solver.compiled.portable import norm, product
from solver.validate import Vector

MARGIN = math.radians(20.0)  # angle of transmission that is left at the end; with a tenth of it a linkage locks by its friction
STEP = 0.05  # of the steering wheel between two looks [rad]; with ten times as much an end within half a turn may be passed over
FURTHEST = 30.0  # of the steering wheel [rad], to a side: lorries have 18; what ends beyond has no end
LOCK_ROUNDED_TO = 0.01  # of the end that is found [rad]: rounding of a processor does not show in it


class Linkage(NamedTuple):
    """What steers a wheel: two points of its steering axis, lower and upper, and the ends of the rod that turns it about that [m]."""

    low: Vector
    high: Vector
    inner: Vector
    outer: Vector

    def mirrored(self) -> Linkage:
        """That of the other side."""
        return Linkage(*((x, -y, z) for x, y, z in self))


def rotated(axis: np.ndarray, angle: float, a: np.ndarray) -> np.ndarray:
    """(3,) a vector turned about a unit vector by an angle [rad]."""
    c, s = math.cos(angle), math.sin(angle)
    return c * a + s * np.cross(axis, a) + (1.0 - c) * float(product(axis, a)) * axis


def lock_of(linkages: Iterable[Linkage], moves: Callable[[float], np.ndarray]) -> float | None:
    """Angle of the steering wheel to either side at which the first of these linkages ends [rad]; None where none of them does.

    moves: way (3,) of the inner ball [m] at an angle of the steering wheel [rad].
    """
    ends = [_end(one, lambda x, way=way: moves(way * x)) for one in linkages for way in (1.0, -1.0)]  # type: ignore[misc]
    found = min(ends, default=FURTHEST)
    return None if found >= FURTHEST or found <= STEP else round(LOCK_ROUNDED_TO * math.floor(found / LOCK_ROUNDED_TO), 2)


def _end(linkage: Linkage, moves: Callable[[float], np.ndarray]) -> float:
    """Angle of the steering wheel [rad] to one side."""
    low, high, inner, outer = (np.array(point, float) for point in linkage)
    axis = (high - low) / norm(high - low)
    arm, length = outer - low, norm(outer - inner)

    def solved(angle: float, turn: float) -> float | None:
        """Angle of the wheel at an angle of the steering wheel, from one near by; None at the end."""
        ball = inner + moves(angle)
        way = moves(angle + 1e-3) - moves(angle - 1e-3)
        for _ in range(20):
            at = rotated(axis, turn, arm)
            rod, velocity = low + at - ball, np.cross(axis, at)
            across = float(product(rod, velocity))
            least = math.sin(MARGIN) * norm(rod)
            if abs(across) < least * norm(velocity) or abs(float(product(rod, way))) < least * norm(way):
                return None
            gap = 0.5 * (float(product(rod, rod)) - length * length)
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
