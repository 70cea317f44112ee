"""A car put together from axles, each with its suspension and with what else it has: a subframe, an anti-roll bar, a
drive, a rack.

    kind: car
    chassis: {...}
    axles:
      front: {suspension: {kind: macpherson, ...}, anti_roll_bar: {...}, drive: {kind: half_shafts, ...}}
      rear: {suspension: {kind: twist_beam, ...}}
    steering: {...}         # of the first axle: a rack, or a steering box
    engine: {...}           # optional

Every part is compliant with its bushings and ideal without. docs/vehicle.md lists parts and names; the full car
(solver.vehicle.full_car) is a car of this kind.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from solver.dimensions import Acceleration, Point
from solver.elements.rigid_body import RigidBodySpec
from solver.model.spec import ModelSpec, used_inputs
from solver.units import MODEL_GRAVITY
from solver.validate import finite, require
from solver.vehicle.aero import Aero, aero_drag
from solver.vehicle.axle import Axle, axle_bar, following_rack, subframe, suspensions
from solver.vehicle.live_axle import LiveAxle
from solver.vehicle.parts import Category, Corner, Part, Parts, Structure, joined
from solver.vehicle.power import Power, turning
from solver.vehicle.powertrain import Base, Engine, Propshaft, engine, require_beginning
from solver.vehicle.recirculating_ball import RecirculatingBall
from solver.vehicle.steering import SteeringGear, steering_gear
from solver.vehicle.trailer import Trailer, require_behind, towed
from solver.vehicle.transfer import Driven, Transfer, divided, shafts_at_engine, transfers

AnySteering = SteeringGear | RecirculatingBall


@dataclass(frozen=True, kw_only=True)
class Car:
    """Data of a car; lengths in the design frame, left side. category: what its figures are compared with; steering: of
    the first axle. transfer: what connects two driven axles, or a list of such. hitch: centre of the ball that a
    trailer hangs on [m]."""

    category: Category = 'saloon'
    chassis: Part
    axles: tuple[Axle, ...]
    steering: AnySteering
    engine: Engine | None = None
    transfer: Transfer | tuple[Transfer, ...] | None = None
    aero: Aero | None = None
    hitch: Point | None = None
    trailer: Trailer | None = None
    gravity: Acceleration = MODEL_GRAVITY

    def __post_init__(self) -> None:
        require(2 <= len(self.axles) <= 4, 'car', 'axles', len(self.axles), 'a car has two to four of them')
        along = [axle.suspension.wheel.center[0] for axle in self.axles]
        require(
            all(a > b for a, b in pairwise(along)),
            'car',
            'axles',
            along,
            'must stand one behind the other, from front to rear',
        )
        brakes = sum(s.brake.share for axle in self.axles for s in (axle.suspension, axle.right or axle.suspension))
        require(abs(brakes - 1.0) < 1e-9, 'car', 'brake', brakes, 'the shares of all wheels must add up to 1')
        driven = [axle.drive.share for axle in self.axles if axle.drive is not None]
        require(bool(driven), 'car', 'drive', None, 'no axle is driven: give one a drive')
        for share in driven:
            finite('car', 'share', share, low=0.0)
        require(
            abs(sum(driven) - 1.0) < 1e-9,
            'car',
            'share',
            sum(driven),
            'the shares of the driven axles must add up to 1',
        )
        first = self.axles[0]
        needs = 'it needs a double_wishbone, a macpherson, a multi_link with a tie_rod, or a live_axle with kingpins'
        steered = first.suspension.steering_arm() is not None
        require(steered, 'car', 'suspension', first.suspension.kind, f'the first axle is steered: {needs}')
        require(first.rack is None, 'car', 'rack', 'given', 'the first axle has the rack of `steering`: remove it')
        for axle in self.axles[1:]:
            follows = axle.rack is None or axle.suspension.steering_arm() is not None
            require(
                follows,
                f'axle {axle.name!r}',
                'rack',
                'given',
                f'a {axle.suspension.kind} like this one has no rod to it; {needs}',
            )
        require_behind(self.trailer, self.hitch, along[-1])


def car_model(car: Car) -> ModelSpec:
    """The model of a car in its design position. Inputs: steering (imposed angle), drive_torque, brake_torque."""
    chassis = car.chassis.body('chassis', (0.0, 0.0, 0.0))
    frames = {axle.name: subframe(axle.name, axle.subframe, chassis) for axle in car.axles}
    bases = {name: body for name, (_, body) in frames.items()}
    first = car.axles[0]
    arm = first.suspension.steering_arm()
    assert arm is not None
    steering, rack = steering_gear(car.steering, chassis, bases[first.name], arm)
    power = Parts() if car.engine is None else engine(car.engine, chassis, bases[first.name])
    racks, following = {first.name: rack}, []
    for axle in car.axles[1:]:
        if axle.rack is not None:
            parts, racks[axle.name] = following_rack(axle.name, axle.rack, bases[axle.name])
            following.append(parts)
    corners = {
        axle.name: suspensions(axle, Structure(chassis, bases[axle.name], racks.get(axle.name))) for axle in car.axles
    }
    bars = [axle_bar(axle, bases[axle.name], corners[axle.name]) for axle in car.axles]
    parts = joined(
        (
            Parts(bodies=(chassis,)),
            *(parts for parts, _ in frames.values()),
            power,
            *(corner.parts for axle in corners.values() for corner in axle.values()),
            *bars,
            steering,
            *following,
            drives(car, chassis, bases, power.bodies[0] if power.bodies else None, corners),
            Parts(aero_drags=aero_drag(car.aero, chassis)),
            towed(car.trailer, car.hitch, chassis),
        )
    )
    linkage = first.suspension.steered()
    assert linkage is not None
    both = (linkage,) if isinstance(first.suspension, LiveAxle) else (linkage, linkage.mirrored())
    lock = car.steering.ends_at(both, arm)
    model = ModelSpec(
        **parts.sections, gravity=(0.0, 0.0, -car.gravity), chassis='chassis', category=car.category, lock=lock
    )
    return ModelSpec(**{**model.__dict__, 'inputs': used_inputs(model)})


def drives(
    car: Car,
    chassis: RigidBodySpec,
    bases: dict[str, RigidBodySpec],
    engine: RigidBodySpec | None,
    corners: dict[str, dict[str, Corner]],
) -> Parts:
    """The drives of all driven axles, the engine with its gearbox in front of them, and connections between them."""
    given = {axle.name: axle.drive for axle in car.axles if axle.drive is not None}
    shafts = {name: drive for name, drive in given.items() if isinstance(drive, Propshaft)}
    require_beginning(shafts)
    power = None if car.engine is None else car.engine.power
    based = {
        name: Base(chassis, bases[name], engine, len(given) == 1, len(shafts) == 1, {}, turning(power))
        for name in given
    }
    found = {name: drive.housing(name, based[name], corners[name]) for name, drive in given.items()}
    housings = {name: housing for name, housing in found.items() if housing is not None}
    driven = {
        name: drive.parts(name, based[name]._replace(housings=housings), corners[name]) for name, drive in given.items()
    }
    between = () if car.transfer is None else (car.transfer,) if isinstance(car.transfer, Transfer) else car.transfer
    return joined(
        (
            *(one.parts for one in driven.values()),
            shafts_at_engine(engine, between, driven, powered=power is not None),
            Parts() if power is None else powered(power, driven, engine),
            transfers(between, driven),
        )
    )


def powered(data: Power, driven: dict[str, Driven], engine: RigidBodySpec | None) -> Parts:
    """Crankshaft, clutch and gearbox in front of the drives of all driven axles."""
    reached = 'a gearbox drives propeller shafts, and half shafts from its differential; choose one of these'
    for axle, one in driven.items():
        require(one.shaft is not None or one.inside, 'power', f'drive of axle {axle}', one.kind, reached)
    inside = [axle for axle, one in driven.items() if one.inside]
    require(
        len(inside) <= 1,
        'power',
        'axles',
        ', '.join(inside),
        'a gearbox has one differential: give the others propeller shafts',
    )
    alone = data.final == 1.0 or bool(inside)
    require(
        alone,
        'power',
        'final',
        data.final,
        'belongs to a differential in the gearbox: leave it out, a propeller shaft has its own ratio',
    )
    assert engine is not None
    return data.parts(engine, divided(driven.values(), data.final), across=bool(inside))
