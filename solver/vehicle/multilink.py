"""Multi-link suspension: a lower arm that carries spring, damper and drop link, and any number of further links.

A rigid upright has one degree of freedom left when the arm (two constraints) is joined by three links, the tie rod of a
steered one among them. Spring and damper act between the lower arm and the chassis without bodies of their own. The
axle may be driven (solver.vehicle.powertrain).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from solver.validate import require
from solver.vehicle.end_stops import Linkage
from solver.vehicle.parts import Arm, Corner, Link, Sprung, Structure, control_arm, joined, link, sprung, vector_of
from solver.vehicle.wheel_end import IndependentSuspension


@dataclass(frozen=True, kw_only=True)
class MultiLink(Sprung, IndependentSuspension):
    """Data of the left wheel suspension; see the module.

    links: by name; tie_rod: on the rack, or on the subframe of an axle that is not steered; spring_chassis, spring_arm,
    damper_chassis, damper_arm: ends of spring and damper [m].
    """

    kind: Literal['multi_link'] = 'multi_link'
    lower_arm: Arm
    links: dict[str, Link]
    tie_rod: Link | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        once = 'tie_rod' not in self.links or self.tie_rod is None
        require(once, 'multi link', 'links', 'tie_rod', 'is there twice: give it another name')

    def corner(self, name: str, side: str, structure: Structure) -> Corner:
        """The suspension of corner `name` on a side."""
        hub, upright, wheel = self.wheel_end(name, side, structure.chassis)
        lower = control_arm(f'lower_arm_{name}', self.lower_arm, structure.subframe, upright, side)
        links = [link(f'{key}_{name}', data, structure.subframe, upright, side) for key, data in self.links.items()]
        if self.tie_rod is not None:
            links.append(link(f'tie_rod_{name}', self.tie_rod, structure.rack or structure.subframe, upright, side))
        arm = lower.bodies[0]
        elastic = sprung(name, side, structure.chassis, arm, self)
        return Corner(joined((hub, lower, *links, elastic)), upright, wheel, arm)

    def steered(self) -> Linkage | None:
        """By the tie rod, about the line between the lower ball joint and the middle of the links that end above the
        wheel centre; see Suspension.steered."""
        if self.tie_rod is None:
            return None
        upper = [data.outer for data in self.links.values() if data.outer[2] > self.wheel.center[2]]
        require(
            bool(upper),
            'multi link',
            'links',
            sorted(self.links),
            'a steered wheel needs one that ends above its centre',
        )
        return Linkage(self.lower_arm.outer, vector_of(np.mean(upper, axis=0)), self.tie_rod.inner, self.tie_rod.outer)
