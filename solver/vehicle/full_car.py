"""The full car: double wishbones in front, multi-link axle behind, everything on rubber. What it consists of: docs/vehicle.md."""

from __future__ import annotations

from dataclasses import dataclass

from solver.elements.rigid_body import RigidBodySpec
from solver.model.spec import ModelSpec, used_inputs
from solver.validate import Vector, require
from solver.vehicle.antiroll import AntiRollBar, anti_roll_bar
from solver.vehicle.double_wishbone import DoubleWishbone
from solver.vehicle.hardpoints import SIDES
from solver.vehicle.light_car import Aero, aero_drag
from solver.vehicle.multilink import MultiLink
from solver.vehicle.parts import UP, Bushing, Corner, Part, Parts, Structure, joined, mounting
from solver.vehicle.powertrain import Driveline, Engine, driveline, engine
from solver.vehicle.steering import SteeringGear, steering_gear

# What an axle may be; a further kind is one more file and one more name here. A steered one needs a tie rod and `steering_arm`.
Steered = DoubleWishbone
Suspension = DoubleWishbone | MultiLink


@dataclass(frozen=True, kw_only=True)
class Subframe:
    """A subframe on mounts. mounts: groups of points with the same bushing [m]; a group becomes one element at its centre. Without a
    bushing the subframe is fixed to the chassis."""

    part: Part
    mounts: tuple[tuple[Vector, ...], ...]
    bushing: Bushing | None = None


@dataclass(frozen=True, kw_only=True)
class FullCar:
    """Data of the full car; lengths in the design frame, left side."""

    chassis: Part
    front_subframe: Subframe
    rear_subframe: Subframe
    front: Steered
    rear: Suspension
    anti_roll_front: AntiRollBar
    anti_roll_rear: AntiRollBar
    steering: SteeringGear
    engine: Engine
    driveline: Driveline
    aero: Aero | None = None
    gravity: float = 9.81

    def __post_init__(self) -> None:
        share = 2.0 * (self.front.brake.share + self.rear.brake.share)
        require(abs(share - 1.0) < 1e-9, 'full car', 'brake', share, 'the shares of the four wheels must add up to 1')
        for name, frame in (('front', self.front_subframe), ('rear', self.rear_subframe)):
            require(len(frame.mounts) >= 1, 'full car', f'{name}_subframe.mounts', frame.mounts, 'needs at least one group of points')


def full_car_model(car: FullCar) -> ModelSpec:
    """The model of a full car in its design position. Inputs: steering (imposed angle), drive_torque, brake_torque."""
    chassis = car.chassis.body('chassis', (0.0, 0.0, 0.0))
    front, front_frame = subframe('front', car.front_subframe, chassis)
    rear, rear_frame = subframe('rear', car.rear_subframe, chassis)
    steering, rack = steering_gear(car.steering, chassis, front_frame, car.front.steering_arm())
    power = engine(car.engine, chassis, front_frame)
    fronts = {side: car.front.corner(f'front_{side}', side, Structure(chassis, front_frame, rack)) for side in SIDES}
    rears = {side: car.rear.corner(f'rear_{side}', side, Structure(chassis, rear_frame)) for side in SIDES}
    shafts = driveline(car.driveline, chassis, power.bodies[0], rear_frame, {side: corner.wheel for side, corner in rears.items()}, 'rear')
    parts = joined(
        (
            Parts(bodies=(chassis,)),
            front,
            rear,
            power,
            *(corner.parts for corner in (*fronts.values(), *rears.values())),
            anti_roll_bar('front', car.anti_roll_front, front_frame, arms(fronts)),
            anti_roll_bar('rear', car.anti_roll_rear, rear_frame, arms(rears)),
            steering,
            shafts,
        )
    )
    parts = joined((parts, Parts(aero_drags=aero_drag(car.aero, chassis))))
    model = ModelSpec(**parts.sections, gravity=(0.0, 0.0, -car.gravity), chassis='chassis')
    return ModelSpec(**{**model.__dict__, 'inputs': used_inputs(model)})


def subframe(axle: str, data: Subframe, chassis: RigidBodySpec) -> tuple[Parts, RigidBodySpec]:
    """(parts, body) of a subframe on the chassis."""
    body = data.part.body(f'{axle}_subframe', data.part.com)
    groups = data.mounts if data.bushing is not None else (sum(data.mounts, ()),)
    mounts = [
        mounting(f'{axle}_subframe_mount_{k + 1}', chassis, body, points, data.bushing, ideal='fixed', axis=UP)
        for k, points in enumerate(groups)
    ]
    return joined((Parts(bodies=(body,)), *mounts)), body


def arms(corners: dict[str, Corner]) -> dict[str, RigidBodySpec]:
    """Suspension arms by side."""
    return {side: corner.arm for side, corner in corners.items()}
