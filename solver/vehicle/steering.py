"""Steering: wheel, column, telescopic intermediate shaft with two universal joints, pinion, and a gear: the rack, or a
steering box with linkage (solver.vehicle.recirculating_ball).

    chassis -revolute- steering_wheel -universal- upper shaft -prismatic- lower shaft -universal- pinion -revolute-
    subframe subframe -prismatic- rack (to the tie rods)

The angle of the steering wheel is imposed by the driver row `driver`. Pinion and rack act on each other through the
elasticity of torsion bar and mesh: `rack_and_pinion` is the torque over pinion angle minus rack travel / pinion radius.
With power assistance (`assist`) it has a motor that pushes the rack; without, a torsion bar stiffer than it is, by the
ratio of the whole torque to the driver's, gives way like an assisted one, and the hand feels the whole torque.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from solver.compiled.portable import norm, product
from solver.dimensions import Damping, Force, Inertia, Length, Mass, Point, TurnDamping, TurnStiffness, WheelTurn
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.coupler import CouplerSpec
from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.spring_damper import SpringDamperSpec
from solver.validate import Vector, finite, require
from solver.vehicle.end_stops import Linkage, lock_of
from solver.vehicle.hardpoints import marker_at
from solver.vehicle.parts import LEFTWARDS, Part, Parts, joined, require_positive, rods, shaft_markers, vector_of
from solver.vehicle.power_steering import SLOW, PowerSteering, assisted_mesh, friction

SHAFT_RADIUS = 0.012  # of the shafts' cylinders [m]
DAMPER_LENGTH = 0.5  # of the steering damper, along the rack [m]


class Gear(NamedTuple):
    """Gear between the pinion and the tie rods. parts: bodies and joints, and the elements of the gear; mesh: name of
    the elasticity between pinion and output; coordinate: that of the output, which friction acts on, dry from the rate
    slow [1/s] on; ratio: of the pinion to it; output: the body that the tie rods go to."""

    parts: Parts
    mesh: str
    coordinate: str
    ratio: float
    slow: float
    output: RigidBodySpec


@dataclass(frozen=True, kw_only=True)
class Column(ABC):
    """Data of steering wheel and shafts; not mirrored.

    stiffness [N m/rad] and damping [N m s/rad] of torsion bar and mesh, at the pinion. pinion_foot: where the pinion
    shaft ends in the gear; pinion_joint, column_joint: centres of the universal joints; wheel_hub: hub of the steering
    wheel [m]; wheel_inertia: of steering wheel and column about the axis [kg m^2]. assist: electric power steering;
    friction: dry, of gear and column together, at the rack [N] or the pitman arm [N m] (solver.vehicle.power_steering).
    lock: angle of the steering wheel at its end stops, to either side [rad]; None: as far as the linkage goes
    (solver.vehicle.end_stops).
    """

    stiffness: TurnStiffness
    damping: TurnDamping
    pinion_foot: Point
    pinion_joint: Point
    column_joint: Point
    wheel_hub: Point
    pinion_mass: Mass
    shaft_mass: Mass
    wheel_mass: Mass
    wheel_inertia: Inertia
    assist: PowerSteering | None = None
    friction: float = 0.0
    lock: WheelTurn | None = None

    def __post_init__(self) -> None:
        require_positive('steering', self, 'stiffness', 'pinion_mass', 'shaft_mass', 'wheel_mass', 'wheel_inertia')
        finite('steering', 'damping', self.damping, low=0.0)
        finite('steering', 'friction', self.friction, low=0.0)
        require_positive('steering', self, 'lock')

    @abstractmethod
    def moves(self, angle: float, arm: float) -> Vector:
        """Way of the inner tie-rod balls [m] at an angle of the steering wheel [rad]. arm: as of gear()."""

    def ends_at(self, linkages: Iterable[Linkage], arm: float) -> float | None:
        """Angle of the steering wheel at the end stops [rad]: `lock`, or what follows from these linkages
        (solver.vehicle.end_stops)."""
        return lock_of(linkages, lambda angle: self.moves(angle, arm)) if self.lock is None else self.lock

    @abstractmethod
    def gear(self, subframe: RigidBodySpec, arm: float) -> Gear:
        """The gear on its subframe. arm: of the tie rods, see Suspension.steering_arm; only its sign counts."""

    def mesh(self, gear: Gear, chassis: RigidBodySpec) -> Parts:
        """The elasticity over pinion angle minus ratio times the coordinate of the output, with a motor on that if
        there is one."""
        pinion, output = ('steering_pinion', 1.0), (gear.coordinate, -gear.ratio)
        if self.assist is not None:
            return Parts(
                servos=(assisted_mesh(self.assist, gear.mesh, (output, pinion), self.stiffness, self.damping, chassis),)
            )
        spring, damper = Law.linear(self.stiffness), Law.linear(self.damping)
        return Parts(
            coordinate_forces=(
                CoordinateForceSpec(name=gear.mesh, terms=(pinion, output), spring=spring, damper=damper),
            )
        )


@dataclass(frozen=True, kw_only=True)
class SteeringGear(Column):
    """Data of a steering with rack and pinion, what a file has that names no kind. rack: with the inner tie-rod balls.
    rack_per_turn: travel per turn of the pinion [m]. rack_damping: of steering damper, assistance and guides [N
    s/m]."""

    implied: ClassVar[bool] = True  # where a file names no kind
    kind: Literal['rack_and_pinion'] = 'rack_and_pinion'
    rack: Part
    rack_per_turn: Length
    rack_damping: Damping
    friction: Force = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive('steering', self, 'rack_per_turn')
        finite('steering', 'rack_damping', self.rack_damping, low=0.0)

    def ratio(self, arm: float) -> float:
        """Angle of the pinion over the travel of the rack [rad/m]."""
        return float(np.copysign(2.0 * np.pi / self.rack_per_turn, arm))

    def moves(self, angle: float, arm: float) -> Vector:
        """Along y, with the rack."""
        return (0.0, angle / self.ratio(arm), 0.0)

    def gear(self, subframe: RigidBodySpec, arm: float) -> Gear:
        """Pinion and rack; coordinate rack, positive along y."""
        at = self.rack.com
        rack = self.rack.body('rack', at)
        slide = JointSpec(
            name='rack', kind='prismatic', i=marker_at(subframe, at, LEFTWARDS), j=marker_at(rack, at, LEFTWARDS)
        )
        damper = steering_damper(subframe, rack, at, self.rack_damping)
        parts = Parts(bodies=(rack,), joints=(slide,), spring_dampers=(damper,))
        return Gear(parts, 'rack_and_pinion', 'rack', self.ratio(arm), SLOW, rack)


def steering_gear(
    data: Column, chassis: RigidBodySpec, subframe: RigidBodySpec, arm: float
) -> tuple[Parts, RigidBodySpec]:
    """(steering, what the tie rods go to). arm: of the tie rods, see Suspension.steering_arm; only its sign counts.
    Coordinates steering_wheel, steering_pinion (positive to the left) and those of the gear."""
    foot, low, high, hub = data.pinion_foot, data.pinion_joint, data.column_joint, data.wheel_hub
    middle = vector_of(0.5 * np.add(low, high))
    # each axis points towards the driver
    pinion_axis, shaft_axis, column_axis = (
        vector_of(np.subtract(b, a)) for a, b in ((foot, low), (low, high), (high, hub))
    )
    gear = data.gear(subframe, arm)
    pinion = rods('steering_pinion', ((data.pinion_mass, foot, low, SHAFT_RADIUS),))
    lower = rods('steering_shaft_lower', ((0.5 * data.shaft_mass, low, middle, SHAFT_RADIUS),))
    upper = rods('steering_shaft_upper', ((0.5 * data.shaft_mass, middle, high, SHAFT_RADIUS),))
    wheel = steering_wheel(data, np.array(column_axis))

    def both(i: RigidBodySpec, j: RigidBodySpec, at: Vector, axis: Vector) -> tuple[Marker, Marker]:
        return marker_at(i, at, axis), marker_at(j, at, axis)

    joints = (
        ('steering_pinion', 'revolute', *both(subframe, pinion, foot, pinion_axis)),
        # the pins of the intermediate shaft lie in the planes of the two joints, so that their fluctuations nearly
        # cancel
        ('steering_joint_lower', 'universal', *shaft_markers(pinion, lower, low, pinion_axis, shaft_axis)),
        ('steering_slide', 'prismatic', *both(lower, upper, middle, shaft_axis)),
        ('steering_joint_upper', 'universal', *shaft_markers(wheel, upper, high, column_axis, shaft_axis)),
        ('steering_wheel', 'revolute', *both(chassis, wheel, hub, column_axis)),
    )
    column = Parts(
        bodies=(pinion, lower, upper, wheel),
        joints=tuple(JointSpec(name=name, kind=kind, i=i, j=j) for name, kind, i, j in joints),
        couplers=(CouplerSpec(name='driver', terms=(('steering_wheel', 1.0),), offset=0.0, input='steering'),),
    )
    return joined(
        (gear.parts, column, data.mesh(gear, chassis), friction(gear.coordinate, data.friction, gear.slow))
    ), gear.output


def steering_damper(subframe: RigidBodySpec, body: RigidBodySpec, at: Vector, damping: float) -> SpringDamperSpec:
    """The damper along y between a subframe and a body at a point [m]; damping [N s/m]."""
    left = vector_of(np.array(at) + (0.0, DAMPER_LENGTH, 0.0))
    return SpringDamperSpec(
        name='steering_damper',
        i=marker_at(subframe, left),
        j=marker_at(body, at),
        free_length=DAMPER_LENGTH,
        damper=Law.linear(damping),
    )


def steering_wheel(data: Column, axis: np.ndarray) -> RigidBodySpec:
    """Steering wheel and column as one body at the hub: a flat ring, and the column as a rod of its length."""
    require(norm(axis) > 1e-9, 'column', 'wheel_hub', data.wheel_hub, 'must not be at the other end of the column')
    n = axis / norm(axis)
    across = 0.5 * data.wheel_inertia + data.wheel_mass * float(product(axis, axis)) / 12.0
    inertia = across * np.eye(3) + (data.wheel_inertia - across) * np.outer(n, n)
    six = (inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2])
    return RigidBodySpec(
        name='steering_wheel',
        mass=data.wheel_mass,
        inertia=tuple(float(c) for c in six),  # type: ignore[arg-type]
        position=data.wheel_hub,
    )
