"""Live axle: both wheels on one housing, guided by links (with a Panhard rod) or by leaf springs.

An ideal axle on links has two degrees of freedom with four of them, e.g. two pairs, or a pair, one upper link and a Panhard rod. A driven
one holds the differential in its housing (solver.vehicle.powertrain).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from solver.validate import Vector, require
from solver.vehicle.hardpoints import SIDES, distance, marker_at, on_side
from solver.vehicle.leaf_spring import LeafSpring, leaf_spring
from solver.vehicle.parts import Corner, Damper, Link, Part, Parts, Spring, Structure, damper_of, joined, link, spring_of
from solver.vehicle.wheel_end import Suspension


@dataclass(frozen=True, kw_only=True)
class CoilSpring:
    """A coil spring between points of the chassis and of the axle [m]."""

    spring: Spring
    chassis: Vector
    axle: Vector


@dataclass(frozen=True, kw_only=True)
class LiveAxle(Suspension):
    """Data of the left side.

    housing: tube, differential and wheel carriers of both sides. links: by name, in pairs, inner end on the chassis, outer end on the
    axle; rods: the same, single and as given, e.g. a Panhard rod. coil, leaf: springs, one of the two. damper_chassis, damper_axle: ends
    of the damper [m].
    """

    kind: Literal['live_axle'] = 'live_axle'
    housing: Part
    links: dict[str, Link] = field(default_factory=dict)
    rods: dict[str, Link] = field(default_factory=dict)
    coil: CoilSpring | None = None
    leaf: LeafSpring | None = None
    damper: Damper
    damper_chassis: Vector
    damper_axle: Vector

    def __post_init__(self) -> None:
        one = (self.coil is None) != (self.leaf is None)
        require(one, 'live axle', 'coil', 'both' if self.coil else None, 'give either coil or leaf')
        guided = self.leaf is not None or 2 * len(self.links) + len(self.rods) >= 4
        require(
            guided,
            'live axle',
            'links',
            sorted(self.links),
            'a pair in links counts two, one of rods one; four are needed without leaf springs',
        )

    def corners(self, axle: str, structures: Mapping[str, Structure], right: Suspension | None = None) -> dict[str, Corner]:
        """Both sides; the housing and the single rods are parts of the left one."""
        require(right is None, 'live axle', 'right', 'given', 'both sides are alike: remove it')
        housing = self.housing.body(f'axle_{axle}', self.housing.com)
        base = structures['left']
        shared = [
            Parts(bodies=(housing,)),
            *(link(f'{key}_{axle}', data, base.subframe, housing, 'left') for key, data in self.rods.items()),
        ]
        found = {}
        for side in SIDES:
            name = f'{axle}_{side}'
            hub, wheel = self.hub(name, side, base.chassis, housing)
            links = [link(f'{key}_{name}', data, base.subframe, housing, side) for key, data in self.links.items()]
            parts = [*(shared if side == 'left' else ()), hub, *links, self._sprung(name, side, base, housing)]
            found[side] = Corner(joined(parts), housing, wheel, housing)
        return found

    def _sprung(self, name: str, side: str, base: Structure, housing) -> Parts:
        def ends(chassis: Vector, axle: Vector):
            return marker_at(base.chassis, on_side(side, chassis)), marker_at(housing, on_side(side, axle)), distance(chassis, axle)

        parts = [Parts(spring_dampers=(damper_of(f'damper_{name}', self.damper, *ends(self.damper_chassis, self.damper_axle)),))]
        if self.leaf is not None:
            parts.append(leaf_spring(name, self.leaf, base.chassis, housing, side))
        if self.coil is not None:
            coil = spring_of(f'spring_{name}', self.coil.spring, *ends(self.coil.chassis, self.coil.axle))
            parts.append(Parts(spring_dampers=(coil,)))
        return joined(parts)
