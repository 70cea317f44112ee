"""Live axle: both wheels on one housing, guided by links (with a Panhard rod) or by leaf springs.

An axle on four ideal links has two degrees of freedom: two pairs of links, say, or a pair, one upper link and a Panhard
rod. A driven axle holds the differential in its housing (solver.vehicle.powertrain).

A steered axle has knuckles on kingpins at its ends, a track rod between the knuckles, and a drag link from the steering
to one of them:

    housing -revolute- upright (left and right)
    upright_left -track_rod- upright_right
    rack, pitman or relay link -drag_link- upright

The shafts of a driven and steered axle have constant-velocity joints in the kingpins. The drive torque acts between
housing and wheels; where a kingpin leans towards the shaft, a part of the torque turns the knuckle about the kingpin.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from solver.dimensions import Length, Mass, Point
from solver.elements.joint import JointSpec
from solver.elements.rigid_body import RigidBodySpec
from solver.validate import Vector, require
from solver.vehicle.end_stops import Linkage
from solver.vehicle.hardpoints import SIDES, distance, marker_at, on_side
from solver.vehicle.leaf_spring import LeafSpring, leaf_spring
from solver.vehicle.parts import (
    Corner,
    Damper,
    Link,
    Part,
    Parts,
    Spring,
    Structure,
    damper_of,
    joined,
    link,
    require_positive,
    spring_of,
    vector_of,
)
from solver.vehicle.wheel_end import Suspension


@dataclass(frozen=True, kw_only=True)
class CoilSpring:
    """A coil spring between points of the chassis and of the axle [m]."""

    spring: Spring
    chassis: Point
    axle: Point


@dataclass(frozen=True, kw_only=True)
class Kingpins:
    """Steering of an axle; data of the left side.

    lower, upper: points of the kingpin [m]. knuckle: the part that turns about the kingpin, with the brake, without the
    wheel. track_rod: ball of the track rod on the left knuckle [m]. track_rod_mass [kg] and track_rod_radius [m] of the
    rod. drag_link: inner end on the rack, pitman arm or relay link, outer end on the knuckle of the side drag_link_on;
    its points are not mirrored.
    """

    lower: Point
    upper: Point
    knuckle: Part
    track_rod: Point
    track_rod_mass: Mass
    track_rod_radius: Length = 0.015
    drag_link: Link
    drag_link_on: Literal['left', 'right'] = 'left'

    def __post_init__(self) -> None:
        require_positive('kingpins', self, 'track_rod_mass', 'track_rod_radius')
        least = min(0.02, 0.05 * abs(self.upper[2]))  # m; of a model less
        high = self.upper[2] > self.lower[2] + least
        require(high, 'kingpins', 'upper', self.upper, f'must lie above lower, {self.lower}, at least {least:.3g} m')
        apart = abs(self.track_rod[1]) > 2.5 * least
        require(
            apart,
            'kingpins',
            'track_rod',
            self.track_rod,
            'must lie beside the middle of the car: it is the ball of the left side',
        )

    def body(self, corner: str, side: str, center: Vector) -> RigidBodySpec:
        """The knuckle of a corner, its frame at the wheel centre [m]."""
        return self.knuckle.body(f'upright_{corner}', center, side)

    def joint(self, corner: str, side: str, housing: RigidBodySpec, knuckle: RigidBodySpec) -> Parts:
        """The kingpin of a corner, a revolute joint with the coordinate kingpin_<corner>, positive to the left."""
        at, axis = on_side(side, self.lower), on_side(side, vector_of(np.subtract(self.upper, self.lower)))
        pin = JointSpec(
            name=f'kingpin_{corner}', kind='revolute', i=marker_at(housing, at, axis), j=marker_at(knuckle, at, axis)
        )
        return Parts(joints=(pin,))

    def rods(self, axle: str, structure: Structure, knuckles: Mapping[str, RigidBodySpec]) -> Parts:
        """Track rod and drag link of an axle. knuckles: side -> knuckle."""
        across = Link(
            inner=on_side('right', self.track_rod),
            outer=self.track_rod,
            mass=self.track_rod_mass,
            radius=self.track_rod_radius,
        )
        steering = structure.rack or structure.subframe
        return joined(
            (
                link(f'track_rod_{axle}', across, knuckles['right'], knuckles['left'], 'left'),
                link(f'drag_link_{axle}', self.drag_link, steering, knuckles[self.drag_link_on], 'left'),
            )
        )


@dataclass(frozen=True, kw_only=True)
class LiveAxle(Suspension):
    """Data of a live axle, of its left side.

    housing: tube, differential and wheel carriers of both sides; of a steered axle without the knuckles. links: name ->
    left link of a pair, inner end on the chassis, outer end on the axle. rods: name -> single link, with points that
    are not mirrored, e.g. a Panhard rod. coil or leaf: the springs, one of the two. damper_chassis, damper_axle: ends
    of the damper [m]. kingpins: of a steered axle.
    """

    kind: Literal['live_axle'] = 'live_axle'
    housing: Part
    links: dict[str, Link] = field(default_factory=dict)
    rods: dict[str, Link] = field(default_factory=dict)
    coil: CoilSpring | None = None
    leaf: LeafSpring | None = None
    damper: Damper
    damper_chassis: Point
    damper_axle: Point
    kingpins: Kingpins | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        one = (self.coil is None) != (self.leaf is None)
        require(one, 'live axle', 'coil', 'both' if self.coil else None, 'give either coil or leaf')
        guided = self.leaf is not None or 2 * len(self.links) + len(self.rods) >= 4
        require(
            guided,
            'live axle',
            'links',
            sorted(self.links),
            'without leaf springs an axle needs four links: an entry of `links` is a pair, an entry of `rods` is one',
        )

    def corners(
        self, axle: str, structures: Mapping[str, Structure], right: Suspension | None = None
    ) -> dict[str, Corner]:
        """Side -> corner. The housing, the single rods and the steering are among the parts of the left corner."""
        require(right is None, 'live axle', 'right', 'given', 'both sides are alike: remove it')
        housing = self.housing.body(f'axle_{axle}', self.housing.com)
        base = structures['left']
        shared = [
            Parts(bodies=(housing,)),
            *(link(f'{key}_{axle}', data, base.subframe, housing, 'left') for key, data in self.rods.items()),
        ]
        pins = self.kingpins
        knuckles = {
            side: housing if pins is None else pins.body(f'{axle}_{side}', side, self.wheel.center) for side in SIDES
        }
        if pins is not None:
            shared += [
                Parts(bodies=tuple(knuckles.values())),
                *(pins.joint(f'{axle}_{side}', side, housing, knuckles[side]) for side in SIDES),
                pins.rods(axle, base, knuckles),
            ]
        found = {}
        for side, knuckle in knuckles.items():
            name = f'{axle}_{side}'
            hub, wheel = self.hub(name, side, base.chassis, knuckle)
            links = [link(f'{key}_{name}', data, base.subframe, housing, side) for key, data in self.links.items()]
            parts = [*(shared if side == 'left' else ()), hub, *links, self._sprung(name, side, base, housing)]
            found[side] = Corner(joined(parts), knuckle, wheel, housing, housing)
        return found

    def steered(self) -> Linkage | None:
        """Linkage that steers the axle, its drag link; see Suspension.steered."""
        pins = self.kingpins
        if pins is None:
            return None
        low, high = (on_side(pins.drag_link_on, point) for point in (pins.lower, pins.upper))
        return Linkage(low, high, pins.drag_link.inner, pins.drag_link.outer)

    def _sprung(self, name: str, side: str, base: Structure, housing) -> Parts:
        """Damper and spring of one side."""

        def ends(chassis: Vector, axle: Vector):
            return (
                marker_at(base.chassis, on_side(side, chassis)),
                marker_at(housing, on_side(side, axle)),
                distance(chassis, axle),
            )

        parts = [
            Parts(
                spring_dampers=(damper_of(f'damper_{name}', self.damper, *ends(self.damper_chassis, self.damper_axle)),)
            )
        ]
        if self.leaf is not None:
            parts.append(leaf_spring(name, self.leaf, base.chassis, housing, side))
        if self.coil is not None:
            coil = spring_of(f'spring_{name}', self.coil.spring, *ends(self.coil.chassis, self.coil.axle))
            parts.append(Parts(spring_dampers=(coil,)))
        return joined(parts)
