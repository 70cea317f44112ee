"""A toy suspension of the recipe in docs/contributing.md: a trailing arm, which is the upright, on two pivots of the subframe."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from solver.validate import Vector
from solver.vehicle.hardpoints import distance, marker_at, on_side
from solver.vehicle.parts import Bushing, Corner, Damper, Parts, Spring, Structure, damper_of, joined, mounting, spring_of
from solver.vehicle.wheel_end import IndependentSuspension


@dataclass(frozen=True, kw_only=True)
class TrailingArm(IndependentSuspension):
    """Data of the left wheel suspension. pivots: of the arm on the subframe; the others: ends of spring and damper [m]."""

    kind: Literal['trailing_arm'] = 'trailing_arm'
    pivots: tuple[Vector, Vector]
    bushing: Bushing | None = None
    spring: Spring
    spring_chassis: Vector
    spring_arm: Vector
    damper: Damper
    damper_chassis: Vector
    damper_arm: Vector

    def corner(self, name: str, side: str, structure: Structure) -> Corner:
        """The suspension of corner `name` on a side."""
        hub, arm, wheel = self.wheel_end(name, side, structure.chassis)
        foot = mounting(f'arm_{name}', structure.subframe, arm, self.pivots, self.bushing, ideal='revolute', side=side)
        spring_i, damper_i = (marker_at(structure.chassis, on_side(side, p)) for p in (self.spring_chassis, self.damper_chassis))
        spring_j, damper_j = (marker_at(arm, on_side(side, p)) for p in (self.spring_arm, self.damper_arm))
        elastic = Parts(
            spring_dampers=(
                spring_of(f'spring_{name}', self.spring, spring_i, spring_j, distance(self.spring_chassis, self.spring_arm)),
                damper_of(f'damper_{name}', self.damper, damper_i, damper_j, distance(self.damper_chassis, self.damper_arm)),
            )
        )
        return Corner(joined((hub, foot, elastic)), arm, wheel, arm)
