"""The light car: eleven bodies, fourteen degrees of freedom.

    chassis, two front knuckles on MacPherson struts steered by a rack, two rear knuckles on arms, four wheels, rack,
    steering wheel

Steering wheel angle, torque at the differential and total brake torque are the inputs. Both side shafts turn at the
wheel relative to the chassis like shafts with ideal constant-velocity joints: the drive torque reacts on the chassis,
where the differential is mounted, the brake torque on the knuckles. Names of coordinates and elements:
solver.vehicle.corner.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Literal

import numpy as np

from solver.dimensions import Acceleration, Damping, Length, Point, Rate, WheelTurn
from solver.elements.coordinate import CoordinateSpec
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.coupler import CouplerSpec
from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.rigid_body import RigidBodySpec
from solver.model.spec import ModelSpec
from solver.units import MODEL_GRAVITY
from solver.validate import Vector, finite, require
from solver.vehicle.aero import Aero, aero_drag
from solver.vehicle.corner import ArmAxle, Axle, StrutAxle, corner, corner_bodies, free_length
from solver.vehicle.drives import wheel_shaft
from solver.vehicle.end_stops import lock_of
from solver.vehicle.hardpoints import marker_at
from solver.vehicle.parts import LEFTWARDS, Part, Parts, joined, require_positive
from solver.vehicle.trailer import Trailer, require_behind, towed
from solver.vehicle.wheel_end import Brake

INPUTS = ('steering', 'steering_rate', 'steering_acceleration', 'drive_torque', 'brake_torque')


@dataclass(frozen=True, kw_only=True)
class Steering:
    """Rack and steering wheel. column_axis: axis of rotation, from the rack to the driver. rack_per_turn: travel of the
    rack per turn of the steering wheel [m]; turning the wheel to the left (positive) steers to the left wherever the
    tie rods are. rack_damping: of the gear [N s/m], which a steering wheel that nobody holds comes to rest by. lock:
    angle of the steering wheel at its end stops, to either side [rad]; None: as far as the linkage goes
    (solver.vehicle.end_stops)."""

    rack: Part
    wheel: Part
    column_axis: Vector
    rack_per_turn: Length
    rack_damping: Damping = 0.0
    lock: WheelTurn | None = None

    def __post_init__(self) -> None:
        require_positive('steering', self, 'rack_per_turn', 'lock')
        finite('steering', 'rack_damping', self.rack_damping, low=0.0)


@dataclass(frozen=True, kw_only=True)
class Driveline:
    """Open differential. driven: its axle. ratio: torque at the differential per unit of the input drive_torque [-].
    top_speed: mean speed of the wheels at which the engine's limiter ends the drive torque [rad/s]; None: it never
    does."""

    driven: Literal['front', 'rear'] = 'front'
    ratio: float = 1.0
    top_speed: Rate | None = None

    def __post_init__(self) -> None:
        require_positive('driveline', self, 'ratio', 'top_speed')


@dataclass(frozen=True, kw_only=True)
class Brakes:
    """Brakes of both axles."""

    front: Brake
    rear: Brake


@dataclass(frozen=True, kw_only=True)
class LightCar:
    """Data of the light car; lengths in the design frame, for the left side. hitch: centre of the ball that a trailer
    hangs on [m]."""

    chassis: Part
    front: StrutAxle
    rear: ArmAxle
    steering: Steering
    driveline: Driveline = Driveline()
    brakes: Brakes
    aero: Aero | None = None
    hitch: Point | None = None
    trailer: Trailer | None = None
    gravity: Acceleration = MODEL_GRAVITY

    def __post_init__(self) -> None:
        for name, part in (
            ('chassis', self.chassis),
            ('steering.rack', self.steering.rack),
            ('steering.wheel', self.steering.wheel),
        ):
            centred = abs(part.com[1]) < 1e-9
            require(
                centred, 'light car', f'{name}.com', part.com, 'must lie in the plane y = 0: the two sides are mirrored'
            )
        front, rear = self.front.wheel.center[0], self.rear.wheel.center[0]
        require(
            front > rear,
            'light car',
            'front.wheel.center',
            front,
            f'its x must lie ahead of the rear wheels, x = {rear:g} m',
        )
        share = 2.0 * (self.brakes.front.share + self.brakes.rear.share)
        require(abs(share - 1.0) < 1e-9, 'light car', 'brakes', share, 'the shares of the four wheels must add up to 1')
        require_behind(self.trailer, self.hitch, rear)


def static_loads(bodies: Sequence[RigidBodySpec], x_front: float, x_rear: float, gravity: float) -> tuple[float, float]:
    """Static load [N] of one front and one rear tire of a symmetric car: balance of forces and moments in the design
    position."""
    mass = sum(b.mass for b in bodies)
    require(mass > 0.0, 'light car', 'mass', mass, 'must be positive')
    x = sum(b.mass * (b.position[0] + b.com[0]) for b in bodies) / mass
    front = 0.5 * mass * gravity * (x - x_rear) / (x_front - x_rear)
    return front, 0.5 * mass * gravity - front


def light_car_model(car: LightCar) -> ModelSpec:
    """The model of a light car in its design position."""
    chassis = car.chassis.body('chassis', (0.0, 0.0, 0.0))
    rack = car.steering.rack.body('rack', car.steering.rack.com)
    column = car.steering.wheel.body('steering_wheel', car.steering.wheel.com)
    axles: dict[str, Axle] = {'front': car.front, 'rear': car.rear}
    brakes = {'front': car.brakes.front, 'rear': car.brakes.rear}
    unsprung = {
        (end, side): corner_bodies(axles[end], f'{end}_{side}', side) for end in axles for side in ('left', 'right')
    }
    bodies = (chassis, *chain(*unsprung.values()), rack, column)
    loads = dict(
        zip(axles, static_loads(bodies, car.front.wheel.center[0], car.rear.wheel.center[0], car.gravity), strict=True)
    )
    free = {end: free_length(axle, loads[end], car.gravity) for end, axle in axles.items()}
    corners = [
        corner(
            axles[end],
            f'{end}_{side}',
            side,
            chassis=chassis,
            knuckle=knuckle,
            wheel=wheel,
            rack=rack if end == 'front' else None,
            brake=brakes[end],
            free=free[end],
        )
        for (end, side), (knuckle, wheel) in unsprung.items()
    ]
    steering_joints, steering_couplers, damper = steering(car, chassis, rack, column)
    shafts, drive = driveline(car, chassis, [unsprung[car.driveline.driven, side][1] for side in ('left', 'right')])
    parts = joined(corners)
    own = Parts(
        bodies=bodies,
        joints=parts.joints + steering_joints,
        coordinates=parts.coordinates + shafts,
        couplers=steering_couplers,
        spring_dampers=parts.spring_dampers,
        coordinate_forces=parts.coordinate_forces + anti_roll_bars(axles) + damper + drive,
        brakes=parts.brakes,
        aero_drags=aero_drag(car.aero, chassis),
        tires=parts.tires,
    )
    every = joined((own, towed(car.trailer, car.hitch, chassis)))
    return ModelSpec(
        **every.sections,
        gravity=(0.0, 0.0, -car.gravity),
        inputs=INPUTS,
        chassis='chassis',
        category='compact',
        lock=lock(car),
    )


def travel_by_angle(car: LightCar) -> float:
    """Travel of the rack over the angle of the steering wheel [m/rad]: with the tie rods behind the axis of steering,
    it moves to the right in a left turn."""
    return float(np.copysign(car.steering.rack_per_turn / (2.0 * np.pi), car.front.steering_arm()))


def lock(car: LightCar) -> float | None:
    """Angle of the steering wheel at its end stops [rad]."""
    linkage, ratio = car.front.steered(), travel_by_angle(car)
    ends = lock_of((linkage, linkage.mirrored()), lambda angle: (0.0, ratio * angle, 0.0))
    return ends if car.steering.lock is None else car.steering.lock


def steering(
    car: LightCar, chassis: RigidBodySpec, rack: RigidBodySpec, column: RigidBodySpec
) -> tuple[tuple[JointSpec, ...], tuple[CouplerSpec, ...], tuple[CoordinateForceSpec, ...]]:
    """Rack on the chassis (positive to the left), steering wheel on the chassis, their ratio, the imposed angle, and
    the damper."""
    at, axis, y = car.steering.wheel.com, car.steering.column_axis, LEFTWARDS
    joints = (
        JointSpec(
            name='rack', kind='prismatic', i=marker_at(chassis, rack.position, y), j=marker_at(rack, rack.position, y)
        ),
        JointSpec(
            name='steering_wheel', kind='revolute', i=marker_at(chassis, at, axis), j=marker_at(column, at, axis)
        ),
    )
    ratio = travel_by_angle(car)
    couplers = (
        CouplerSpec(name='rack_and_pinion', terms=(('rack', 1.0), ('steering_wheel', -ratio)), offset=0.0),
        CouplerSpec(name='driver', terms=(('steering_wheel', 1.0),), offset=0.0, input='steering'),
    )
    damping = car.steering.rack_damping * ratio**2
    damper = CoordinateForceSpec(name='steering_damper', terms=(('steering_wheel', 1.0),), damper=Law.linear(damping))
    return joints, couplers, (damper,) if damping > 0.0 else ()


def driveline(
    car: LightCar, chassis: RigidBodySpec, wheels: Sequence[RigidBodySpec]
) -> tuple[tuple[CoordinateSpec, ...], tuple[CoordinateForceSpec, ...]]:
    """Side shafts (rotation of the driven wheels relative to the chassis) and the torque an open differential halves
    between them."""
    shafts = tuple(wheel_shaft(wheel.name.removeprefix('wheel_'), chassis, wheel) for wheel in wheels)
    terms = tuple((shaft.name, 0.5) for shaft in shafts)
    drive = CoordinateForceSpec(
        name='differential',
        terms=terms,
        input='drive_torque',
        input_gain=car.driveline.ratio,
        top_rate=car.driveline.top_speed,
    )
    return shafts, (drive,)


def anti_roll_bars(axles: dict[str, Axle]) -> tuple[CoordinateForceSpec, ...]:
    """Springs over the left-right difference of wheel travel."""
    return tuple(
        CoordinateForceSpec(
            name=f'anti_roll_bar_{end}',
            terms=((f'travel_{end}_left', 1.0), (f'travel_{end}_right', -1.0)),
            spring=Law.linear(axle.anti_roll_bar),
        )
        for end, axle in axles.items()
        if axle.anti_roll_bar > 0.0
    )
