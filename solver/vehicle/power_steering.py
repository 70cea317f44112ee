"""Electric power steering: a motor on rack or pitman arm that follows the torque at the torsion bar, and dry friction
in the gear.

Torsion bar, mesh and motor are one servo (solver.elements.servo): it pushes the rack by a map over the torque of
torsion bar and mesh, which is that of the hand, and the speed of the car. Its place (column, pinion, rack) makes no
difference here, because between torsion bar and rack nothing gives way; the inertia of its rotor is not modelled.

Friction is a force against the motion, regularised: up to SLOW it rises with the speed of sliding by a cubic, without
overshoot, so a rack at rest carries none of it and creeps to where the other forces balance.
"""

from __future__ import annotations

from dataclasses import dataclass

from solver.dimensions import Speed, Time, Torque
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.laws import Law
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.servo import ServoSpec, require_map
from solver.validate import finite
from solver.vehicle.hardpoints import marker_at
from solver.vehicle.parts import Parts

FRICTION = 'steering_friction'  # the name of what acts in the gear
SLOW = 2e-3  # m/s; of the rack, from which friction is dry


@dataclass(frozen=True, kw_only=True)
class PowerSteering:
    """Electric power steering. speeds: of the car [m/s] and torques: at the torsion bar [N m], both rising; forces: on
    the rack [N], or torques on the pitman arm [N m], for each speed those at the torques, to the other side the same.
    limit: the largest one of the motor; lag: its time constant [s], shorter than damping over stiffness of the steering
    (solver.elements.servo has why)."""

    speeds: tuple[Speed, ...]
    torques: tuple[Torque, ...]
    forces: tuple[tuple[float, ...], ...]
    limit: float
    lag: Time = 0.003

    def __post_init__(self) -> None:
        require_map('assist', self.speeds, self.torques, self.forces)
        for field in ('limit', 'lag'):
            finite('assist', field, getattr(self, field), low=0.0, strict=True)


def assisted_mesh(
    data: PowerSteering,
    name: str,
    terms: tuple[tuple[str, float], ...],
    stiffness: float,
    damping: float,
    chassis: RigidBodySpec,
) -> ServoSpec:
    """The mesh over two coordinates, of which the first is the output of the gear, with a motor there; stiffness [N
    m/rad], damping [N m s/rad]."""
    return ServoSpec(
        name=name,
        terms=terms,
        stiffness=stiffness,
        damping=damping,
        marker=marker_at(chassis, (0.0, 0.0, 0.0)),
        speeds=data.speeds,
        torques=data.torques,
        forces=data.forces,
        limit=data.limit,
        lag=data.lag,
    )


def friction(coordinate: str, force: float, slow: float) -> Parts:
    """Dry friction `steering_friction` [N or N m] on a coordinate, at its full size from the rate `slow` on; nothing
    without one."""
    if force == 0.0:
        return Parts()
    law = Law.table([(-2.0 * slow, -force), (-slow, -force), (0.0, 0.0), (slow, force), (2.0 * slow, force)])
    return Parts(coordinate_forces=(CoordinateForceSpec(name=FRICTION, terms=((coordinate, 1.0),), damper=law),))
