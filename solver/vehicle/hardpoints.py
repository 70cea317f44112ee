"""Hardpoints: markers and joints from points of the vehicle in its design position.

All points and axes are given in the vehicle's design frame: x forward, y left, z up, origin midway between the axles on
the ground, which is also where the chassis has its reference frame. The left side is given, the right side is mirrored.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver.compiled.portable import norm, product
from solver.elements.marker import Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.errors import SpecError
from solver.model.frames import frame_of_axis, matrix, quaternion
from solver.validate import Vector

SIDES = {'left': 1.0, 'right': -1.0}
"""Sign of y of the two sides of the vehicle."""


def axes_along(what: str, axis: Sequence[float], x_axis: Sequence[float] | None = None) -> np.ndarray:
    """solver.model.frames.frame_of_axis of what data lead to. Raises SpecError for zero or parallel axes."""
    try:
        return frame_of_axis(axis, x_axis)
    except ValueError as error:
        raise SpecError(f'{what}: {error}; do two of its points coincide?') from None


def marker_at(
    body: RigidBodySpec,
    point: Sequence[float],
    z_axis: Sequence[float] | None = None,
    x_axis: Sequence[float] | None = None,
) -> Marker:
    """The marker on a body at a point [m] of the design frame, in which body.position and body.orientation are given
    too.

    z_axis, x_axis: directions of its axes in the design frame, as in solver.files.mechanism.frame_of_axis. Without
    z_axis the marker is parallel to the design frame. Raises SpecError for zero or parallel axes.
    """
    R_DB = matrix(body.orientation)
    R_DM = np.eye(3) if z_axis is None else axes_along(f'what is attached to {body.name!r}', z_axis, x_axis)
    x, y, z = (float(c) for c in product(R_DB.T, np.subtract(point, body.position)))
    return Marker(body=body.name, position=(x, y, z), orientation=quaternion(product(R_DB.T, R_DM)))


def mirror(point: Sequence[float]) -> Vector:
    """A point or direction of the design frame, mirrored at its x-z plane."""
    x, y, z = point
    return (x, -y, z)


def on_side(side: str, point: Sequence[float]) -> Vector:
    """A point or direction given for the left side, on the side 'left' or 'right'."""
    x, y, z = point
    return (x, SIDES[side] * y, z)


def ahead(low: Sequence[float] | np.ndarray, high: Sequence[float] | np.ndarray, point: Sequence[float]) -> float:
    """Distance of a point from the line through `low` and `high` along x, at its height [m]. Raises SpecError for a
    level line."""
    a, b, p = (np.array(one, float) for one in (low, high, point))
    if abs(b[2] - a[2]) < 1e-3:
        raise SpecError(
            f'steering axis: its points {low} and {high} are at the same height; one must lie above the other'
        )
    return float(p[0] - (a + (b - a) * (p[2] - a[2]) / (b[2] - a[2]))[0])


def distance(a: Sequence[float], b: Sequence[float]) -> float:
    """Distance of two points [m]."""
    return norm(np.subtract(a, b))
