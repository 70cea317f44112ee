"""Trailing or semi-trailing arm: the arm is the upright, on two coaxial bushings (or a revolute joint) at its
pivots."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from solver.dimensions import Point
from solver.vehicle.parts import Bushing, Corner, Sprung, Structure, joined, mounting, sprung
from solver.vehicle.wheel_end import IndependentSuspension


@dataclass(frozen=True, kw_only=True)
class TrailingArm(Sprung, IndependentSuspension):
    """Data of the left wheel suspension. upright: the arm with the wheel carrier; pivots: two points of its axis [m];
    spring_chassis, spring_arm, damper_chassis, damper_arm: ends of spring and damper [m]."""

    kind: Literal['trailing_arm'] = 'trailing_arm'
    pivots: tuple[Point, Point]
    bushing: Bushing | None = None

    def corner(self, name: str, side: str, structure: Structure) -> Corner:
        """The suspension of corner `name` on a side."""
        hub, arm, wheel = self.wheel_end(name, side, structure.chassis)
        foot = mounting(f'arm_{name}', structure.subframe, arm, self.pivots, self.bushing, ideal='revolute', side=side)
        elastic = sprung(name, side, structure.chassis, arm, self)
        return Corner(joined((hub, foot, elastic)), arm, wheel, arm)
