"""Frames as matrices and quaternions: what specifications are written with, outside of compiled code."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from solver.compiled.portable import norm
from solver.compiled.so3 import matrix_of_quaternion, quaternion_of_matrix
from solver.validate import Quaternion

PARALLEL = 0.9  # |cosine| above which a coordinate axis is too close to the joint axis to define its x axis


class Placement(NamedTuple):
    """A frame in the world: origin [m] (3,), axes (3, 3)."""

    p: np.ndarray
    R: np.ndarray


def frame_of_axis(axis: Sequence[float], x_axis: Sequence[float] | None = None) -> np.ndarray:
    """(3, 3) rotation whose z column is along `axis` and whose x column is `x_axis` made perpendicular to it.

    Without x_axis the x column comes from the first coordinate axis, or from the second where the first is nearly
    parallel to the axis; so axis (0, 0, 1) gives the identity. Raises ValueError for zero or parallel axes.
    """
    length = norm(axis)
    if length < 1e-12:
        raise ValueError('the axis must not be zero')
    z = [c / length for c in axis]
    if x_axis is None:
        x_axis = (1.0, 0.0, 0.0) if abs(z[0]) < PARALLEL else (0.0, 1.0, 0.0)
    along = x_axis[0] * z[0] + x_axis[1] * z[1] + x_axis[2] * z[2]
    x = [a - along * c for a, c in zip(x_axis, z, strict=True)]
    size = norm(x)
    if size < 1e-6 * max(norm(x_axis), 1e-12):
        raise ValueError('x_axis must not be parallel to axis')
    x = [c / size for c in x]
    y = (z[1] * x[2] - z[2] * x[1], z[2] * x[0] - z[0] * x[2], z[0] * x[1] - z[1] * x[0])
    return np.array([x, y, z], float).T


def frame_of_rpy(rpy: Sequence[float]) -> np.ndarray:
    """(3, 3) rotation Rz(yaw) Ry(pitch) Rx(roll), angles [rad]."""
    (cr, cp, cy), (sr, sp, sy) = map(math.cos, rpy), map(math.sin, rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def quaternion(R: np.ndarray) -> Quaternion:
    """Unit quaternion xyzw of a rotation matrix."""
    x, y, z, w = quaternion_of_matrix(tuple(float(r) for r in R.ravel()))
    return (x, y, z, w)


def matrix(q: Sequence[float]) -> np.ndarray:
    """(3, 3) rotation matrix of a unit quaternion xyzw."""
    return np.array(matrix_of_quaternion(tuple(float(c) for c in q))).reshape(3, 3)
