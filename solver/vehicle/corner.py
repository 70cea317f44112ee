"""Corners of a car with one degree of freedom of suspension: a knuckle on a MacPherson strut (front) or on a trailing
arm (rear).

Data are given for the left side, in the design frame of solver.vehicle.hardpoints; the right side is mirrored. Names
end in the corner: `front_left`. Beside the coordinates of its joints a corner has those of solver.vehicle.wheel_end.

Springs are free at a length the template finds by virtual work, so that the design position is the static equilibrium
of the stated wheel load: per unit of wheel travel at rest

    load * z'(contact) - sum of weights * z'(centres of mass) = F * L'(spring)           F tension, L length

where ' is the derivative by the travel with the suspension's own kinematics. Neglected: the small lateral force of a
cambered tire at rest, and that the loaded radius of the tire differs from the height given for the wheel centre by the
fit of its data.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.portable import inverse, norm, product
from solver.dimensions import Point, Stiffness
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.spring_damper import SpringDamperSpec
from solver.elements.tire_pacejka import TireData
from solver.model.frames import frame_of_axis
from solver.validate import Vector, finite, require
from solver.vehicle.end_stops import Linkage
from solver.vehicle.hardpoints import SIDES, ahead, distance, marker_at, on_side
from solver.vehicle.parts import Part, Parts, joined, require_positive, require_resisting, vector_of
from solver.vehicle.wheel_end import Brake, Wheel, require_fitting, wheel_end


@dataclass(frozen=True, kw_only=True)
class Spring:
    """Coil spring between a point of the chassis and one of the knuckle [m]; rate [N/m]."""

    chassis: Point
    knuckle: Point
    rate: Stiffness

    def __post_init__(self) -> None:
        require_positive('spring', self, 'rate')


@dataclass(frozen=True, kw_only=True)
class Damper:
    """Damper between a point of the chassis and one of the knuckle [m]; law: force [N] over rate of length [m/s],
    rebound positive."""

    chassis: Point
    knuckle: Point
    law: Law

    def __post_init__(self) -> None:
        require_resisting('damper', 'law', self.law)


@dataclass(frozen=True, kw_only=True)
class Axle:
    """Data that both kinds of axle have. knuckle: everything that moves with the suspension and does not turn with the
    wheel.

    stops: force [N] over wheel travel [m], positive in bump, zero in the design position. anti_roll_bar: force at each
    wheel per left-right difference of wheel travel [N/m]. turn_slip: whether it acts at the tires; null: against
    parking alone.
    """

    wheel: Wheel
    knuckle: Part
    spring: Spring
    damper: Damper
    tire: TireData
    turn_slip: bool | None = None
    stops: Law | None = None
    anti_roll_bar: Stiffness = 0.0

    def __post_init__(self) -> None:
        require_fitting('axle', self.wheel, self.tire)
        require_resisting('axle', 'stops', self.stops)
        finite('axle', 'anti_roll_bar', self.anti_roll_bar, low=0.0)


@dataclass(frozen=True, kw_only=True)
class StrutAxle(Axle):
    """MacPherson struts, steered by tie rods from a rack. The knuckle carries the tube of the strut, whose axis passes
    through the top mount; arm and tie rod have no mass.

    top_mount: on the chassis [m]; strut: another point of the axis of the strut, on the knuckle [m]; ball_joint: of the
    lower arm, on the knuckle [m]; arm_pivots: two points of the axis of the lower arm, on the chassis [m];
    tie_rod_rack, tie_rod_knuckle: ends of the tie rod [m]. The wheel turns about the line through ball joint and top
    mount.
    """

    top_mount: Point
    strut: Point
    ball_joint: Point
    arm_pivots: tuple[Point, Point]
    tie_rod_rack: Point
    tie_rod_knuckle: Point

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ('strut', 'ball_joint'):
            least = min(0.05, 0.2 * self.wheel.center[2])  # m; of the wheels of a model less
            high = self.top_mount[2] > getattr(self, name)[2] + least
            require(high, 'strut axle', 'top_mount', self.top_mount, f'must lie above {name} by at least {least:.3g} m')

    def rods(self) -> tuple[tuple[Vector, Vector], ...]:
        """The massless rods that hold the knuckle, each from its inner to its outer end: both legs of the arm, the tie
        rod."""
        front, rear = self.arm_pivots
        return (front, self.ball_joint), (rear, self.ball_joint), (self.tie_rod_rack, self.tie_rod_knuckle)

    def steered(self) -> Linkage:
        """By the tie rod; see Suspension.steered."""
        return Linkage(self.ball_joint, self.top_mount, self.tie_rod_rack, self.tie_rod_knuckle)

    def steering_arm(self) -> float:
        """Distance of the tie rod from the steering axis along x [m], negative behind it; see
        Suspension.steering_arm."""
        linkage = self.steered()
        return ahead(linkage.low, linkage.high, linkage.outer)


@dataclass(frozen=True, kw_only=True)
class ArmAxle(Axle):
    """Knuckles on trailing or semi-trailing arms. pivot_inner, pivot_outer: two points of the axis of the arm [m]."""

    pivot_inner: Point
    pivot_outer: Point


class TravelVelocity(NamedTuple):
    """Velocity field of a rigid part per unit of wheel travel: velocity of a point [-] and rotation [rad/m]."""

    point: np.ndarray
    velocity: np.ndarray
    rotation: np.ndarray

    def at(self, point: Vector) -> np.ndarray:
        """(3,) velocity of a point of the part per unit of wheel travel."""
        return self.velocity + np.cross(self.rotation, np.subtract(point, self.point))


def corner_bodies(axle: Axle, corner: str, side: str) -> tuple[RigidBodySpec, RigidBodySpec]:
    """Knuckle and wheel of a corner, in the design position."""
    return axle.knuckle.body(f'knuckle_{corner}', axle.wheel.center, side), axle.wheel.body(f'wheel_{corner}', side)


def suspension_motion(axle: Axle) -> TravelVelocity:
    """Motion of the left knuckle in the design position with the rack held, scaled to unit vertical velocity of the
    wheel centre."""
    if isinstance(axle, StrutAxle):
        return strut_motion(axle)
    assert isinstance(axle, ArmAxle)
    motion = TravelVelocity(np.array(axle.pivot_inner), np.zeros(3), np.subtract(axle.pivot_outer, axle.pivot_inner))
    scale = 1.0 / motion.at(axle.wheel.center)[2]
    return TravelVelocity(motion.point, scale * motion.velocity, scale * motion.rotation)


def strut_motion(axle: StrutAxle) -> TravelVelocity:
    """The same of a strut: no rod changes its length, and the material point of the axis in the top mount moves along
    the axis."""
    center = np.array(axle.wheel.center)

    def row(direction: np.ndarray, point: Vector) -> np.ndarray:
        # direction . velocity of the point, of the velocity of the wheel centre and the rotation
        return np.concatenate([direction, np.cross(np.subtract(point, center), direction)])

    across = frame_of_axis(vector_of(np.subtract(axle.top_mount, axle.strut)))[:, :2].T
    rows = [row(np.subtract(outer, inner), outer) for inner, outer in axle.rods()]
    rows += [row(direction, axle.top_mount) for direction in across]
    try:
        twist = inverse(np.array([row(np.array([0.0, 0.0, 1.0]), axle.wheel.center), *rows]))[:, 0]
    except ZeroDivisionError:
        require(
            False,
            'strut axle',
            'arm_pivots',
            axle.arm_pivots,
            'do not lead the wheel up and down, with strut and tie rod as they are',
        )
    return TravelVelocity(center, twist[:3], twist[3:])


def length_rate(element: Spring | Damper, motion: TravelVelocity) -> float:
    """Derivative of the length of a spring or damper by the wheel travel [-]."""
    line = np.subtract(element.knuckle, element.chassis)
    return float(product(line, motion.at(element.knuckle)) / norm(line))


def free_length(axle: Axle, load: float, gravity: float) -> float:
    """Free length [m] of the spring with which the design position is in equilibrium; load: static load of the tire
    [N]."""
    motion = suspension_motion(axle)
    x, y, _ = axle.wheel.center
    force = load * motion.at((x, y, 0.0))[2]
    force -= gravity * (
        axle.knuckle.mass * motion.at(axle.knuckle.com)[2] + axle.wheel.mass * motion.at(axle.wheel.center)[2]
    )
    tension = force / length_rate(axle.spring, motion)
    return distance(axle.spring.chassis, axle.spring.knuckle) - tension / axle.spring.rate


def corner(
    axle: Axle,
    name: str,
    side: str,
    *,
    chassis: RigidBodySpec,
    knuckle: RigidBodySpec,
    wheel: RigidBodySpec,
    rack: RigidBodySpec | None,
    brake: Brake,
    free: float,
) -> Parts:
    """Joints and forces of a corner, without its bodies.

    free: free length of the spring [m]; rack: what the tie rod of a strut is attached to.
    """
    if isinstance(axle, StrutAxle):
        assert rack is not None
        suspension = strut_joints(axle, name, side, chassis, knuckle, rack)
    else:
        assert isinstance(axle, ArmAxle)
        suspension = arm_joints(axle, name, side, chassis, knuckle)

    def ends(element: Spring | Damper) -> tuple[Marker, Marker]:
        return marker_at(chassis, on_side(side, element.chassis)), marker_at(knuckle, on_side(side, element.knuckle))

    (spring_i, spring_j), (damper_i, damper_j) = ends(axle.spring), ends(axle.damper)
    own = Parts(
        joints=suspension,
        spring_dampers=(
            SpringDamperSpec(
                name=f'spring_{name}', i=spring_i, j=spring_j, free_length=free, spring=Law.linear(axle.spring.rate)
            ),
            SpringDamperSpec(name=f'damper_{name}', i=damper_i, j=damper_j, free_length=0.0, damper=axle.damper.law),
        ),
        coordinate_forces=(
            (CoordinateForceSpec(name=f'stop_{name}', terms=((f'travel_{name}', 1.0),), spring=axle.stops),)
            if axle.stops
            else ()
        ),
    )
    end = wheel_end(name, side, wheel, knuckle, chassis, tire=axle.tire, turn_slip=axle.turn_slip, brake=brake)
    return joined((own, end))


def strut_joints(
    axle: StrutAxle, name: str, side: str, chassis: RigidBodySpec, knuckle: RigidBodySpec, rack: RigidBodySpec
) -> tuple[JointSpec, ...]:
    """The strut slides and turns in the top mount, both legs of the arm lead the ball joint, the tie rod holds the
    angle of steering."""
    axis = on_side(side, vector_of(np.subtract(axle.top_mount, axle.strut)))
    top = on_side(side, axle.top_mount)
    rods = [
        JointSpec(
            name=f'{rod}_{name}',
            kind='distance',
            i=marker_at(base, on_side(side, inner)),
            j=marker_at(knuckle, on_side(side, outer)),
            length=distance(inner, outer),
        )
        for (rod, base), (inner, outer) in zip(
            (('arm_front', chassis), ('arm_rear', chassis), ('tie_rod', rack)), axle.rods(), strict=True
        )
    ]
    strut = JointSpec(
        name=f'strut_{name}', kind='point_on_line', i=marker_at(knuckle, top, axis), j=marker_at(chassis, top)
    )
    return (strut, *rods)


def arm_joints(
    axle: ArmAxle, name: str, side: str, chassis: RigidBodySpec, knuckle: RigidBodySpec
) -> tuple[JointSpec, ...]:
    """The arm turns about its pivots; its angle is positive in bump on both sides."""
    at = on_side(side, axle.pivot_inner)
    # a mirrored rotation is that about the mirrored axis in the opposite sense
    axis = tuple(SIDES[side] * c for c in on_side(side, tuple(np.subtract(axle.pivot_outer, axle.pivot_inner))))
    return (
        JointSpec(name=f'arm_{name}', kind='revolute', i=marker_at(chassis, at, axis), j=marker_at(knuckle, at, axis)),
    )
