"""Rigid bodies: mass, inertia, placement; gravity and gyroscopic forces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.portable import principal_moments
from solver.compiled.vec import add3, cross, cross_m, load33, msub, mv, put33, scale, skew
from solver.dimensions import Inertia, Mass, Point, Rate, Speed
from solver.elements.marker import IDENTITY, WORLD, Spec
from solver.elements.point_pair import angular_velocity
from solver.validate import Quaternion, Vector, finite, require, unit_quaternion, vector


@dataclass(frozen=True, kw_only=True)
class RigidBodySpec(Spec):
    """A rigid body.

    mass [kg] >= 0; inertia (Ixx, Iyy, Izz, Ixy, Ixz, Iyz) [kg m^2] about the centre of mass along the reference axes
    (products of inertia are the entries of the matrix: Ixy = -integral xy dm); com [m] in the reference frame; position
    and orientation of the reference frame in W; velocity of its origin in W [m/s]; angular_velocity in B [rad/s].
    """

    mass: Mass
    inertia: tuple[Inertia, Inertia, Inertia, Inertia, Inertia, Inertia]
    com: Point = (0.0, 0.0, 0.0)
    position: Point = (0.0, 0.0, 0.0)
    orientation: Quaternion = IDENTITY
    velocity: tuple[Speed, Speed, Speed] = (0.0, 0.0, 0.0)
    angular_velocity: tuple[Rate, Rate, Rate] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        where = self.where
        require(self.name != WORLD, where, 'name', self.name, f'{WORLD!r} is reserved for the fixed frame')
        self.set('mass', finite(where, 'mass', self.mass, low=0.0))
        self.set('inertia', vector(where, 'inertia', self.inertia, 6))
        for field in ('com', 'position', 'velocity', 'angular_velocity'):
            self.set(field, vector(where, field, getattr(self, field)))
        self.set('orientation', unit_quaternion(where, 'orientation', self.orientation))
        moments = principal_moments(self.inertia_matrix())
        scale_ = max(float(moments[2]), 1e-300)
        require(moments[0] >= -1e-9 * scale_, where, 'inertia', self.inertia, 'must be positive semidefinite')
        require(
            moments[2] <= (moments[0] + moments[1]) * (1 + 1e-6) + 1e-300,
            where,
            'inertia',
            self.inertia,
            f'no body has these principal moments {[float(f"{m:.4g}") for m in moments]}: the largest exceeds the sum '
            'of the others',
        )

    def inertia_matrix(self) -> np.ndarray:
        """(3, 3) inertia [kg m^2]."""
        xx, yy, zz, xy, xz, yz = self.inertia
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


class BodyTable(NamedTuple):
    """Columns of all bodies (without the world)."""

    mass: np.ndarray  # (nb,)
    inertia: np.ndarray  # (nb, 3, 3) about the centre of mass in B
    com: np.ndarray  # (nb, 3) of the centre of mass in the reference frame
    gravity: np.ndarray  # (3,) [m/s^2] in W
    slot: np.ndarray  # (nb,) diagonal block


def compile_bodies(specs: Sequence[RigidBodySpec], gravity: Vector, slots: Sequence[int]) -> BodyTable:
    """Collect the bodies into a table."""
    n = len(specs)
    return BodyTable(
        mass=np.array([s.mass for s in specs], float),
        inertia=np.array([s.inertia_matrix() for s in specs], float).reshape(n, 3, 3),
        com=np.array([s.com for s in specs], float).reshape(n, 3),
        gravity=np.array(gravity, float),
        slot=np.array(slots, np.int64),
    )


@kernel(borrow=True)
def body_forces(table, kin, tangents, f, Kv):
    """Accumulate gravity and the gyroscopic torque -w x J w, and its tangent."""
    for b in range(table.mass.shape[0]):
        w = angular_velocity(kin, b)
        J = load33(table.inertia, b)
        h = mv(J, w)
        add3(
            f,
            b,
            0,
            (table.mass[b] * table.gravity[0], table.mass[b] * table.gravity[1], table.mass[b] * table.gravity[2]),
        )
        add3(f, b, 3, scale(-1.0, cross(w, h)))
        if tangents:
            put33(Kv, table.slot[b], 3, 3, msub(skew(h), cross_m(w, J)))
