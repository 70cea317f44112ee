"""Double wishbone with an upper control arm, two lower links, tie rod and coil-over.

    upright    ball joints to: upper arm, lower link (lateral), radius link, tie rod
    coil-over  tube on the lower link, rod in the top mount, both bodies of their own

The two lower links have separate ball joints, so the wheel turns about a virtual axis through the crossing point of
their lines. The lower link carries coil-over and drop link.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from solver.dimensions import Mass, Point
from solver.elements.joint import JointSpec
from solver.elements.rigid_body import RigidBodySpec
from solver.validate import require
from solver.vehicle.end_stops import Linkage
from solver.vehicle.hardpoints import distance, marker_at, on_side
from solver.vehicle.parts import (
    Arm,
    Bushing,
    Corner,
    Damper,
    Link,
    Parts,
    Spring,
    Structure,
    control_arm,
    damper_of,
    joined,
    link,
    mounting,
    require_positive,
    rods,
    spring_of,
    vector_of,
)
from solver.vehicle.wheel_end import IndependentSuspension

TUBE = 0.6  # part of the length of a coil-over that its tube takes in the design position
RADIUS = 0.025  # of the cylinders whose inertia tube and rod have [m]


@dataclass(frozen=True, kw_only=True)
class CoilOver:
    """Damper and spring on one axis from `lower` (on the lower link) to `upper` (on the chassis) [m].

    tube_mass, rod_mass [kg]: each with its half of the spring. mount, eye: bushings on top and below; without them the
    rod hangs in a spherical and the tube in a universal joint.
    """

    lower: Point
    upper: Point
    tube_mass: Mass
    rod_mass: Mass
    spring: Spring
    damper: Damper
    mount: Bushing | None = None
    eye: Bushing | None = None

    def __post_init__(self) -> None:
        require_positive('coil-over', self, 'tube_mass', 'rod_mass')


@dataclass(frozen=True, kw_only=True)
class DoubleWishbone(IndependentSuspension):
    """Data of the left wheel suspension; see the module. tie_rod: on the rack, or on the subframe of an axle that is
    not steered."""

    kind: Literal['double_wishbone'] = 'double_wishbone'
    upper_arm: Arm
    lower_link: Link
    radius_link: Link
    tie_rod: Link
    coil_over: CoilOver

    def corner(self, name: str, side: str, structure: Structure) -> Corner:
        """The suspension of corner `name` on a side."""
        hub, upright, wheel = self.wheel_end(name, side, structure.chassis)
        upper = control_arm(f'upper_arm_{name}', self.upper_arm, structure.chassis, upright, side)
        lower = link(f'lower_link_{name}', self.lower_link, structure.subframe, upright, side)
        radius = link(f'radius_link_{name}', self.radius_link, structure.subframe, upright, side)
        tie_rod = link(f'tie_rod_{name}', self.tie_rod, structure.rack or structure.subframe, upright, side)
        arm = lower.bodies[0]
        strut = coil_over(name, self.coil_over, structure, arm, side)
        return Corner(joined((hub, upper, lower, radius, tie_rod, strut)), upright, wheel, arm)

    def steered(self) -> Linkage:
        """By the tie rod; see Suspension.steered."""
        low = vector_of(crossing(self.lower_link, self.radius_link))
        return Linkage(low, self.upper_arm.outer, self.tie_rod.inner, self.tie_rod.outer)


def crossing(a: Link, b: Link) -> np.ndarray:
    """(3,) where the lines of two links cross in plan view, at the mean height of their outer ends [m]."""
    p, q = np.array(a.outer), np.array(b.outer)
    d, e = p - a.inner, q - b.inner
    across = d[0] * e[1] - d[1] * e[0]
    require(abs(across) > 1e-6, 'double wishbone', 'lower_link', a, 'must not be parallel to radius_link in plan view')
    s = ((q[0] - p[0]) * e[1] - (q[1] - p[1]) * e[0]) / across  # p + s d lies on the line of b
    return np.array([*(p + s * d)[:2], 0.5 * (p[2] + q[2])])


def coil_over(name: str, data: CoilOver, structure: Structure, arm: RigidBodySpec, side: str) -> Parts:
    """Tube and rod of a coil-over with spring, damper and stops between their ends."""
    a, b = on_side(side, data.lower), on_side(side, data.upper)
    axis = vector_of(np.subtract(data.upper, data.lower))
    middle = vector_of(np.array(a) + TUBE * np.subtract(b, a))
    tube = rods(f'damper_tube_{name}', ((data.tube_mass, a, middle, RADIUS),))
    rod = rods(f'damper_rod_{name}', ((data.rod_mass, middle, b, RADIUS),))
    slide = on_side(side, axis)
    ends = marker_at(rod, b), marker_at(tube, a)
    length = distance(a, b)
    own = Parts(
        bodies=(tube, rod),
        joints=(
            JointSpec(
                name=f'damper_{name}',
                kind='prismatic',
                i=marker_at(tube, middle, slide),
                j=marker_at(rod, middle, slide),
            ),
        ),
        spring_dampers=(
            spring_of(f'spring_{name}', data.spring, *ends, length),
            damper_of(f'damper_{name}', data.damper, *ends, length),
        ),
    )
    return joined(
        (
            own,
            mounting(
                f'damper_mount_{name}',
                structure.chassis,
                rod,
                (data.upper,),
                data.mount,
                ideal='spherical',
                side=side,
                axis=axis,
            ),
            mounting(f'damper_eye_{name}', arm, tube, (data.lower,), data.eye, ideal='universal', side=side, axis=axis),
        )
    )
