"""Electric power steering: a motor on the rack that follows the torque at the torsion bar, and dry friction in the gear.

The motor is a servo (solver.elements.servo): it measures the torque of torsion bar and mesh, which is that of the hand, and pushes the
rack by a map over that torque and the speed of the car. Where it sits (column, pinion, rack) makes no difference here, because between
torsion bar and rack nothing gives way; the inertia of its rotor is not modelled.

Friction is a force against the motion, regularised: up to SLOW it rises with the speed of sliding by a cubic, without overshoot, so a rack
at rest carries none of it and creeps to where the other forces balance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.laws import Law
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.servo import ServoSpec, require_map
from solver.validate import finite
from solver.vehicle.hardpoints import marker_at
from solver.vehicle.parts import Parts

SLOW = 2e-3  # m/s; of the rack, from which friction is dry


@dataclass(frozen=True, kw_only=True)
class PowerSteering:
    """Electric power steering. speeds: of the car [m/s] and torques: at the torsion bar [N m], both rising; forces: on the rack [N], for
    each speed those at the torques, to the other side the same. limit: largest force of the motor [N]; lag: its time constant [s], shorter
    than damping over stiffness of the steering (solver.elements.servo has why)."""

    speeds: Annotated[tuple[float, ...], 'm/s']
    torques: tuple[float, ...]
    forces: tuple[tuple[float, ...], ...]
    limit: float
    lag: Annotated[float, 's'] = 0.003

    def __post_init__(self) -> None:
        require_map('assist', self.speeds, self.torques, self.forces)
        for field in ('limit', 'lag'):
            finite('assist', field, getattr(self, field), low=0.0, strict=True)


def power_steering(data: PowerSteering, mesh: CoordinateForceSpec, stiffness: float, damping: float, chassis: RigidBodySpec) -> Parts:
    """The servo `power_steering` on the coordinate rack, which pushes the way the torque of the mesh does, with its stiffness [N m/rad] and
    damping [N m s/rad]."""
    (factor,) = (factor for name, factor in mesh.terms if name == 'rack')
    sense = 1.0 if factor < 0.0 else -1.0  # a wind-up pulls its coordinates back: that of the rack along -factor
    servo = ServoSpec(
        name='power_steering',
        coordinate='rack',
        terms=tuple((name, sense * f) for name, f in mesh.terms),
        stiffness=stiffness,
        damping=damping,
        marker=marker_at(chassis, (0.0, 0.0, 0.0)),
        speeds=data.speeds,
        torques=data.torques,
        forces=data.forces,
        limit=data.limit,
        lag=data.lag,
    )
    return Parts(servos=(servo,))


def friction(force: float) -> Parts:
    """Dry friction `steering_friction` of this force [N] on the coordinate rack; nothing without one."""
    if force == 0.0:
        return Parts()
    law = Law.table([(-2.0 * SLOW, -force), (-SLOW, -force), (0.0, 0.0), (SLOW, force), (2.0 * SLOW, force)])
    return Parts(coordinate_forces=(CoordinateForceSpec(name='steering_friction', terms=(('rack', 1.0),), damper=law),))
