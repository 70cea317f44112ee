"""MacPherson strut: an upright that carries the tube of the damper, a lower control arm and a tie rod.

    upright    ball joint to the lower arm, tie rod; the tube of the strut is a part of it
    rod        slides and turns in the tube, hangs in the top mount

The wheel turns about the line through ball joint and top mount. The spring acts along the damper.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from solver.dimensions import Mass, Point
from solver.elements.joint import JointSpec
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

RADIUS = 0.011  # of the rod [m]


@dataclass(frozen=True, kw_only=True)
class Strut:
    """The strut from `lower`, on its axis in the upright, to `upper` in the top mount [m]. rod_mass: of rod and upper
    half of the spring [kg]. mount: the top mount; without it the rod hangs in a universal joint."""

    lower: Point
    upper: Point
    rod_mass: Mass
    spring: Spring
    damper: Damper
    mount: Bushing | None = None

    def __post_init__(self) -> None:
        require_positive('strut', self, 'rod_mass')


@dataclass(frozen=True, kw_only=True)
class MacPherson(IndependentSuspension):
    """Data of the left wheel suspension; see the module. tie_rod: on the rack, or on the base of an axle that is not
    steered. drop_link_on: what the drop link of an anti-roll bar is joined to."""

    kind: Literal['macpherson'] = 'macpherson'
    lower_arm: Arm
    tie_rod: Link
    strut: Strut
    drop_link_on: Literal['strut', 'arm'] = 'strut'

    def __post_init__(self) -> None:
        super().__post_init__()
        least = min(0.05, 0.2 * self.wheel.center[2])  # m; of the wheels of a model less
        high = distance(self.strut.lower, self.strut.upper) > least and self.strut.upper[2] > self.strut.lower[2]
        require(
            high,
            'macpherson',
            'strut.upper',
            self.strut.upper,
            f'must lie above strut.lower, at least {least:.3g} m away',
        )

    def corner(self, name: str, side: str, structure: Structure) -> Corner:
        """The suspension of corner `name` on a side."""
        hub, upright, wheel = self.wheel_end(name, side, structure.chassis)
        lower = control_arm(f'lower_arm_{name}', self.lower_arm, structure.subframe, upright, side)
        tie_rod = link(f'tie_rod_{name}', self.tie_rod, structure.rack or structure.subframe, upright, side)
        data = self.strut
        a, b = on_side(side, data.lower), on_side(side, data.upper)
        axis = vector_of(np.subtract(data.upper, data.lower))
        along = on_side(side, axis)
        rod = rods(f'damper_rod_{name}', ((data.rod_mass, vector_of(0.5 * np.add(a, b)), b, RADIUS),))
        ends = marker_at(rod, b), marker_at(upright, a)
        length = distance(a, b)
        strut = Parts(
            bodies=(rod,),
            joints=(
                JointSpec(
                    name=f'damper_{name}',
                    kind='cylindrical',
                    i=marker_at(upright, a, along),
                    j=marker_at(rod, a, along),
                ),
            ),
            spring_dampers=(
                spring_of(f'spring_{name}', data.spring, *ends, length),
                damper_of(f'damper_{name}', data.damper, *ends, length),
            ),
        )
        top = mounting(
            f'damper_mount_{name}',
            structure.chassis,
            rod,
            (data.upper,),
            data.mount,
            ideal='universal',
            side=side,
            axis=axis,
        )
        arm = upright if self.drop_link_on == 'strut' else lower.bodies[0]
        return Corner(joined((hub, lower, tie_rod, strut, top)), upright, wheel, arm)

    def steered(self) -> Linkage:
        """By the tie rod; see Suspension.steered."""
        return Linkage(self.lower_arm.outer, self.strut.upper, self.tie_rod.inner, self.tie_rod.outer)
