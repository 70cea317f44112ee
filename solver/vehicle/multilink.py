"""Multi-link suspension: a lower arm that carries spring, damper and drop link, and any number of further links.

A rigid upright has one degree of freedom left when the arm (two constraints) is joined by three links. Spring and damper act between
the lower arm and the chassis without bodies of their own. The axle may be driven (solver.vehicle.powertrain).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from solver.vehicle.parts import Arm, Corner, Link, Sprung, Structure, control_arm, joined, link, sprung
from solver.vehicle.wheel_end import IndependentSuspension


@dataclass(frozen=True, kw_only=True)
class MultiLink(Sprung, IndependentSuspension):
    """Data of the left wheel suspension; see the module.

    links: by name; spring_chassis, spring_arm, damper_chassis, damper_arm: ends of spring and damper [m].
    """

    kind: Literal['multi_link'] = 'multi_link'
    lower_arm: Arm
    links: dict[str, Link]

    def corner(self, name: str, side: str, structure: Structure) -> Corner:
        """The suspension of corner `name` on a side."""
        hub, upright, wheel = self.wheel_end(name, side, structure.chassis)
        lower = control_arm(f'lower_arm_{name}', self.lower_arm, structure.subframe, upright, side)
        links = [link(f'{key}_{name}', data, structure.subframe, upright, side) for key, data in self.links.items()]
        arm = lower.bodies[0]
        elastic = sprung(name, side, structure.chassis, arm, self)
        return Corner(joined((hub, lower, *links, elastic)), upright, wheel, arm)
