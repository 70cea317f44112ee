"""Steering: wheel, column, telescopic intermediate shaft with two universal joints, pinion and rack.

    chassis -revolute- steering_wheel -universal- upper shaft -prismatic- lower shaft -universal- pinion -revolute- subframe
    subframe -prismatic- rack (to the tie rods)

The angle of the steering wheel is imposed by the driver row `driver`. Pinion and rack act on each other through the elasticity of torsion
bar and mesh: `rack_and_pinion` is the torque over pinion angle minus rack travel / pinion radius. With power assistance (`assist`) a motor
pushes the rack beside it; without, a torsion bar stiffer than it is, by the ratio of the whole torque to the driver's, gives way like an
assisted one, and the hand feels the whole torque.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.compiled.portable import norm, product
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.coupler import CouplerSpec
from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.spring_damper import SpringDamperSpec
from solver.validate import Vector, finite
from solver.vehicle.hardpoints import marker_at
from solver.vehicle.parts import LEFTWARDS, Part, Parts, joined, rods, shaft_markers, vector_of
from solver.vehicle.power_steering import PowerSteering, friction, power_steering

SHAFT_RADIUS = 0.012  # of the shafts' cylinders [m]
DAMPER_LENGTH = 0.5  # of the steering damper, along the rack [m]


@dataclass(frozen=True, kw_only=True)
class SteeringGear:
    """Data of the steering; not mirrored.

    rack: with the inner tie-rod balls. rack_per_turn: travel per turn of the pinion [m]. rack_damping: of steering damper, assistance
    and guides [N s/m]. stiffness [N m/rad] and damping [N m s/rad] of torsion bar and mesh, at the pinion. pinion_foot: where
    the pinion shaft ends in the gear; pinion_joint, column_joint: centres of the universal joints; wheel_hub: hub of the steering
    wheel [m]; wheel_inertia: of steering wheel and column about the axis [kg m^2]. assist: electric power steering; friction: dry, of
    gear and column together, at the rack [N] (solver.vehicle.power_steering).
    """

    rack: Part
    rack_per_turn: float
    rack_damping: float
    stiffness: float
    damping: float
    pinion_foot: Vector
    pinion_joint: Vector
    column_joint: Vector
    wheel_hub: Vector
    pinion_mass: float
    shaft_mass: float
    wheel_mass: float
    wheel_inertia: float
    assist: PowerSteering | None = None
    friction: float = 0.0

    def __post_init__(self) -> None:
        for field in ('rack_per_turn', 'stiffness'):
            finite('steering', field, getattr(self, field), low=0.0, strict=True)
        finite('steering', 'friction', self.friction, low=0.0)


def steering_gear(data: SteeringGear, chassis: RigidBodySpec, subframe: RigidBodySpec, arm: float) -> tuple[Parts, RigidBodySpec]:
    """(steering, rack). arm: of the tie rods, see DoubleWishbone.steering_arm; only its sign counts. Coordinates steering_wheel,
    steering_pinion (positive to the left) and rack (positive along y)."""
    foot, low, high, hub = data.pinion_foot, data.pinion_joint, data.column_joint, data.wheel_hub
    middle = vector_of(0.5 * np.add(low, high))
    # each axis points towards the driver
    pinion_axis, shaft_axis, column_axis = (vector_of(np.subtract(b, a)) for a, b in ((foot, low), (low, high), (high, hub)))
    rack = data.rack.body('rack', data.rack.com)
    pinion = rods('steering_pinion', ((data.pinion_mass, foot, low, SHAFT_RADIUS),))
    lower = rods('steering_shaft_lower', ((0.5 * data.shaft_mass, low, middle, SHAFT_RADIUS),))
    upper = rods('steering_shaft_upper', ((0.5 * data.shaft_mass, middle, high, SHAFT_RADIUS),))
    wheel = steering_wheel(data, np.array(column_axis))

    def both(i: RigidBodySpec, j: RigidBodySpec, at: Vector, axis: Vector) -> tuple[Marker, Marker]:
        return marker_at(i, at, axis), marker_at(j, at, axis)

    joints = (
        ('rack', 'prismatic', *both(subframe, rack, data.rack.com, LEFTWARDS)),
        ('steering_pinion', 'revolute', *both(subframe, pinion, foot, pinion_axis)),
        # the pins of the intermediate shaft lie in the planes of the two joints, so that their fluctuations nearly cancel
        ('steering_joint_lower', 'universal', *shaft_markers(pinion, lower, low, pinion_axis, shaft_axis)),
        ('steering_slide', 'prismatic', *both(lower, upper, middle, shaft_axis)),
        ('steering_joint_upper', 'universal', *shaft_markers(wheel, upper, high, column_axis, shaft_axis)),
        ('steering_wheel', 'revolute', *both(chassis, wheel, hub, column_axis)),
    )
    left = vector_of(np.array(data.rack.com) + (0.0, DAMPER_LENGTH, 0.0))
    ratio = float(np.copysign(2.0 * np.pi / data.rack_per_turn, arm))
    mesh = CoordinateForceSpec(
        name='rack_and_pinion',
        terms=(('steering_pinion', 1.0), ('rack', -ratio)),
        spring=Law.linear(data.stiffness),
        damper=Law.linear(data.damping),
    )
    damper = SpringDamperSpec(
        name='steering_damper',
        i=marker_at(subframe, left),
        j=marker_at(rack, data.rack.com),
        free_length=DAMPER_LENGTH,
        damper=Law.linear(data.rack_damping),
    )
    parts = Parts(
        bodies=(rack, pinion, lower, upper, wheel),
        joints=tuple(JointSpec(name=name, kind=kind, i=i, j=j) for name, kind, i, j in joints),
        couplers=(CouplerSpec(name='driver', terms=(('steering_wheel', 1.0),), offset=0.0, input='steering'),),
        spring_dampers=(damper,),
        coordinate_forces=(mesh,),
    )
    assist = Parts() if data.assist is None else power_steering(data.assist, mesh, data.stiffness, data.damping, chassis)
    return joined((parts, assist, friction(data.friction))), rack


def steering_wheel(data: SteeringGear, axis: np.ndarray) -> RigidBodySpec:
    """Steering wheel and column as one body at the hub: a flat ring, and the column as a rod of its length."""
    n = axis / norm(axis)
    across = 0.5 * data.wheel_inertia + data.wheel_mass * float(product(axis, axis)) / 12.0
    inertia = across * np.eye(3) + (data.wheel_inertia - across) * np.outer(n, n)
    six = (inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2])
    return RigidBodySpec(name='steering_wheel', mass=data.wheel_mass, inertia=tuple(float(c) for c in six), position=data.wheel_hub)  # type: ignore[arg-type]
