"""The end of a suspension: a wheel with tire and brake on its bearing in an upright (or knuckle).

Coordinates of a corner:

    travel_<corner>   wheel centre relative to the chassis along z of the chassis [m], 0 in the design position,
                      positive in bump
    wheel_<corner>    rotation of the wheel on the upright [rad], positive when rolling forward
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

from solver.dimensions import Camber, Inertia, Mass, Point, Toe, TurnDamping, TurnStiffness
from solver.elements.brake import BrakeSpec
from solver.elements.coordinate import CoordinateSpec
from solver.elements.joint import JointSpec
from solver.elements.marker import Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.tire_pacejka import LOWEST_SPEED, TireData, TireSpec
from solver.elements.upright_law import small_tire
from solver.model.frames import frame_of_rpy, matrix, quaternion
from solver.model.spec import ModelSpec
from solver.validate import Vector, finite, require
from solver.vehicle.end_stops import Linkage
from solver.vehicle.hardpoints import SIDES, ahead, marker_at, on_side
from solver.vehicle.parts import UP, Corner, Part, Parts, Structure, require_positive
from solver.vehicle.size import CORNERS


@dataclass(frozen=True, kw_only=True)
class Wheel:
    """A wheel with everything that turns with it. center: in the design position [m]; spin_inertia about its axis,
    inertia about a diameter [kg m^2]; toe (positive: toe-in) and camber (negative: top inwards) in the design
    position."""

    center: Point
    mass: Mass
    spin_inertia: Inertia
    inertia: Inertia
    toe: Toe = 0.0
    camber: Camber = 0.0

    def __post_init__(self) -> None:
        require_positive('wheel', self, 'spin_inertia', 'inertia')
        self.body('wheel', 'left')  # which checks that such a body exists
        require(
            self.center[1] > 0.0, 'wheel', 'center[1]', self.center[1], 'must be > 0: data are those of the left side'
        )
        require(self.center[2] > 0.0, 'wheel', 'center[2]', self.center[2], 'must be > 0, above the ground')

    def body(self, name: str, side: str) -> RigidBodySpec:
        """The body, its y axis along the spin axis to the left."""
        s = SIDES[side]
        orientation = quaternion(frame_of_rpy((-s * self.camber, 0.0, -s * self.toe)))
        inertia = (self.inertia, self.spin_inertia, self.inertia, 0.0, 0.0, 0.0)
        return RigidBodySpec(
            name=name, mass=self.mass, inertia=inertia, position=on_side(side, self.center), orientation=orientation
        )


@dataclass(frozen=True, kw_only=True)
class Brake:
    """Brakes of one axle. share of each wheel in the total brake torque [-]; stiffness [N m/rad] and damping [N m
    s/rad] when stuck."""

    share: float
    stiffness: TurnStiffness
    damping: TurnDamping

    def __post_init__(self) -> None:
        require_positive('brake', self, 'stiffness')
        finite('brake', 'share', self.share, low=0.0)
        finite('brake', 'damping', self.damping, low=0.0)


def spin_axis(wheel: RigidBodySpec) -> Vector:
    """Direction of the axis of a wheel in the design frame, to the left."""
    x, y, z = (float(c) for c in matrix(wheel.orientation)[:, 1])
    return (x, y, z)


def wheel_end(
    corner: str,
    side: str,
    wheel: RigidBodySpec,
    upright: RigidBodySpec,
    chassis: RigidBodySpec,
    *,
    tire: TireData,
    turn_slip: bool | None,
    brake: Brake,
) -> Parts:
    """Bearing, tire and brake of a wheel, without the two bodies."""
    mirrored = tire.side not in (side, 'symmetric')
    center, spin, name = wheel.position, spin_axis(wheel), f'wheel_{corner}'
    # times and speeds of standstill, which a small car has smaller
    slower = math.sqrt(small_tire(tire.values['UNLOADED_RADIUS']))
    return Parts(
        joints=(
            JointSpec(name=name, kind='revolute', i=marker_at(upright, center, spin), j=marker_at(wheel, center, spin)),
        ),
        coordinates=(
            CoordinateSpec(
                name=f'travel_{corner}',
                kind='translation',
                i=marker_at(chassis, center, UP),
                j=marker_at(upright, center, UP),
            ),
        ),
        brakes=(
            BrakeSpec(
                name=f'brake_{corner}',
                coordinate=name,
                input='brake_torque',
                gain=brake.share,
                stiffness=brake.stiffness,
                damping=brake.damping,
            ),
        ),
        tires=(
            TireSpec(
                name=corner,
                marker=Marker(body=wheel.name),
                data=tire,
                mirrored=mirrored,
                turn_slip=turn_slip,
                low_speed=max(slower * TireSpec.low_speed, LOWEST_SPEED),
                standstill_damping=slower * TireSpec.standstill_damping,
            ),
        ),
    )


# height of a wheel centre over UNLOADED_RADIUS [-]: hanging in the air, or with the rim (0.64) on the road
HIGHEST, LOWEST = 1.25, 0.6
# of these, where a tire stands on the road, pressed in by at most a quarter (3 to 10 % in cars at rest)
USUAL = (0.75, 1.0)


def height_over_radius(height: float, radius: float) -> str:
    """Sentence on a tire of an unloaded radius [m] that stands oddly on the road in the design position, its wheel
    centre at a height [m]; '' if as usual."""
    if USUAL[0] <= height / radius <= USUAL[1]:
        return ''
    way = 'hangs over' if height > radius else 'is pressed into'
    return f'the tire {way} the road by {abs(height - radius):.3g} m in the design position'


def require_fitting(where: str, wheel: Wheel, tire: TireData) -> None:
    """Raise SpecError for a tire that is none for the wheel, by its radius and the height of the wheel centre over the
    road."""
    height, radius = wheel.center[2], tire['UNLOADED_RADIUS']
    remedy = (
        f'{height_over_radius(height, radius)}, with wheel.center[2] = {height:g}: mend the radius of '
        f'{tire.source or tire.name}'
    )
    fits = LOWEST <= height / radius <= HIGHEST
    require(fits, where, 'tire.UNLOADED_RADIUS', radius, f'{remedy}, or the height of the wheel centre (both in m)')


def told_of_fit(spec: ModelSpec) -> list[str]:
    """Wheels of a vehicle whose tires stand on the road otherwise than tires do, in the design position, as
    sentences."""
    if not set(CORNERS) <= {tire.name for tire in spec.tires}:
        return []
    heights = {body.name: body.position[2] for body in spec.bodies}
    said = []
    for tire in spec.tires:
        height, radius = heights[tire.marker.body], tire.data['UNLOADED_RADIUS']
        if odd := height_over_radius(height, radius):
            numbers = (
                f'UNLOADED_RADIUS = {radius:g} of {tire.data.source or tire.data.name}, wheel.center[2] = {height:g}'
            )
            said.append(f'{tire.name}: {odd} ({numbers})')
    return said


@dataclass(frozen=True, kw_only=True)
class Suspension(ABC):
    """Data that every suspension has of its left wheel. turn_slip: whether it acts at the tire; null: against parking
    alone."""

    kind: str
    wheel: Wheel
    tire: TireData
    turn_slip: bool | None = None
    brake: Brake

    def __post_init__(self) -> None:
        require_fitting('suspension', self.wheel, self.tire)

    def hub(self, name: str, side: str, chassis: RigidBodySpec, upright: RigidBodySpec) -> tuple[Parts, RigidBodySpec]:
        """(wheel of corner `name` with bearing on the upright, tire and brake; body of the wheel)."""
        wheel = self.wheel.body(f'wheel_{name}', side)
        parts = wheel_end(
            name, side, wheel, upright, chassis, tire=self.tire, turn_slip=self.turn_slip, brake=self.brake
        )
        return parts.replace(bodies=(wheel,)), wheel

    def steered(self) -> Linkage | None:
        """Linkage that steers it. None: the suspension has no rod to a rack or another part that could move it, and
        cannot be steered."""
        return None

    def steering_arm(self) -> float | None:
        """Distance of the rod to the rack, or to what else moves it, from the steering axis along x [m]: positive in
        front of the axis, where a rack moves to the left in a left turn. None: as of steered()."""
        linkage = self.steered()
        return None if linkage is None else ahead(linkage.low, linkage.high, linkage.outer)

    @abstractmethod
    def corners(
        self, axle: str, structures: Mapping[str, Structure], right: Suspension | None = None
    ) -> dict[str, Corner]:
        """Both suspensions of an axle by side. right: data of the right one, as its mirror image; None: those of the
        left."""


@dataclass(frozen=True, kw_only=True)
class IndependentSuspension(Suspension):
    """Data that every independent suspension of a left wheel has."""

    upright: Part

    def wheel_end(self, name: str, side: str, chassis: RigidBodySpec) -> tuple[Parts, RigidBodySpec, RigidBodySpec]:
        """(upright and wheel of corner `name` with bearing, tire and brake; body of the upright; body of the wheel)."""
        upright = self.upright.body(f'upright_{name}', self.wheel.center, side)
        parts, wheel = self.hub(name, side, chassis, upright)
        return parts.replace(bodies=(upright, wheel)), upright, wheel

    @abstractmethod
    def corner(self, name: str, side: str, structure: Structure) -> Corner:
        """The suspension of corner `name` on a side."""

    def corners(
        self, axle: str, structures: Mapping[str, Structure], right: Suspension | None = None
    ) -> dict[str, Corner]:
        """Both suspensions of an axle by side; see Suspension."""
        data = {'left': self, 'right': right or self}
        found = {}
        for side, own in data.items():
            assert isinstance(own, IndependentSuspension)
            found[side] = own.corner(f'{axle}_{side}', side, structures[side])
        return found
