"""A toy suspension of the recipe in docs/contributing.md: a sliding pillar, along which the upright moves up and
down."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from solver.dimensions import Point
from solver.validate import Vector
from solver.vehicle.parts import Bushing, Corner, Sprung, Structure, joined, mounting, sprung
from solver.vehicle.wheel_end import IndependentSuspension


@dataclass(frozen=True, kw_only=True)
class SlidingPillar(Sprung, IndependentSuspension):
    """Data of the left wheel suspension. pillar: a point of it; axis: its direction; bushing: its guide, soft along z;
    the others: ends of spring and damper [m]."""

    kind: Literal['sliding_pillar'] = 'sliding_pillar'
    pillar: Point
    axis: Vector
    bushing: Bushing | None = None

    def corner(self, name: str, side: str, structure: Structure) -> Corner:
        """The suspension of corner `name` on a side."""
        hub, upright, wheel = self.wheel_end(name, side, structure.chassis)
        base = structure.subframe
        guide = mounting(
            f'pillar_{name}', base, upright, (self.pillar,), self.bushing, ideal='prismatic', side=side, axis=self.axis
        )
        return Corner(
            joined((hub, guide, sprung(name, side, structure.chassis, upright, self))), upright, wheel, upright
        )
