"""Rotor of a motor, and the gears that turn with it: a body of its own, which turns `ratio` times as fast as the wheels
that it drives.

    carrier -revolute- rotor,    angle of the rotor = ratio * mean angle of the outputs        (a coupler)

A car with it accelerates as one of the mass m + J i^2 / r^2. Its bearing gives the carrier what its angular momentum
takes: the nose of a car that accelerates rises by the more, and a rotor along the car would roll it. Its mass is part
of its carrier.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from solver.dimensions import Inertia
from solver.elements.coupler import CouplerSpec
from solver.elements.joint import JointSpec
from solver.elements.rigid_body import RigidBodySpec
from solver.model.frames import quaternion
from solver.validate import Vector, finite
from solver.vehicle.hardpoints import axes_along, marker_at
from solver.vehicle.parts import LEFTWARDS, Parts


@dataclass(frozen=True, kw_only=True)
class Rotor:
    """Rotor of a motor, with everything that turns with it. inertia: about its axis [kg m^2]; across it has half of
    that, as a ring has. ratio: its turns per turn of the wheels, below 0 where its gear turns it backwards [-]."""

    inertia: Inertia
    ratio: float = 1.0

    def __post_init__(self) -> None:
        finite('rotor', 'inertia', self.inertia, low=0.0, strict=True)
        finite('rotor', 'ratio', self.ratio)


def rotor(
    data: Rotor | None,
    name: str,
    carrier: RigidBodySpec,
    outputs: Sequence[str],
    at: Vector | None = None,
    axis: Vector = LEFTWARDS,
) -> Parts:
    """The rotor of a motor on its carrier, if there is one, which turns with the mean of the outputs. at: its place
    (None: the carrier's); axis: positive when rolling forward. Coordinate `name`."""
    if data is None:
        return Parts()
    place, half = carrier.position if at is None else at, 0.5 * data.inertia
    turned = quaternion(axes_along(f'rotor {name!r}', axis))
    body = RigidBodySpec(
        name=name, mass=0.0, inertia=(half, half, data.inertia, 0.0, 0.0, 0.0), position=place, orientation=turned
    )
    bearing = JointSpec(name=name, kind='revolute', i=marker_at(carrier, place, axis), j=marker_at(body, place, axis))
    share = -data.ratio / len(outputs)
    gear = CouplerSpec(name=name, terms=((name, 1.0), *((output, share) for output in outputs)), offset=0.0)
    return Parts(bodies=(body,), joints=(bearing,), couplers=(gear,))
