"""The full car: double wishbones in front, multi-link axle behind, everything on rubber. Its parts: docs/vehicle.md.

A car of solver.vehicle.car with the keys of two axles at the top of its file.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from solver.dimensions import Acceleration, Point
from solver.model.spec import ModelSpec
from solver.units import MODEL_GRAVITY
from solver.validate import require
from solver.vehicle.aero import Aero
from solver.vehicle.antiroll import AntiRollBar
from solver.vehicle.axle import AnySuspension, Axle, Subframe
from solver.vehicle.car import AnySteering, Car, car_model
from solver.vehicle.drives import PropshaftDrive
from solver.vehicle.parts import Part
from solver.vehicle.powertrain import Driveline, Engine
from solver.vehicle.trailer import Trailer


@dataclass(frozen=True, kw_only=True)
class FullCar:
    """Data of the full car; lengths in the design frame, left side. hitch: centre of the ball that a trailer hangs on
    [m]."""

    chassis: Part
    front_subframe: Subframe
    rear_subframe: Subframe
    front: AnySuspension
    rear: AnySuspension
    anti_roll_front: AntiRollBar
    anti_roll_rear: AntiRollBar
    steering: AnySteering
    engine: Engine
    driveline: Driveline
    aero: Aero | None = None
    hitch: Point | None = None
    trailer: Trailer | None = None
    gravity: Acceleration = MODEL_GRAVITY

    def __post_init__(self) -> None:
        share = 2.0 * (self.front.brake.share + self.rear.brake.share)
        require(abs(share - 1.0) < 1e-9, 'full car', 'brake', share, 'the shares of the four wheels must add up to 1')

    def car(self) -> Car:
        """The same car by its axles."""
        drive = PropshaftDrive(**{f.name: getattr(self.driveline, f.name) for f in fields(Driveline)})
        front = Axle(
            name='front', suspension=self.front, subframe=self.front_subframe, anti_roll_bar=self.anti_roll_front
        )
        rear = Axle(
            name='rear',
            suspension=self.rear,
            subframe=self.rear_subframe,
            anti_roll_bar=self.anti_roll_rear,
            drive=drive,
        )
        return Car(
            chassis=self.chassis, axles=(front, rear), steering=self.steering, engine=self.engine, aero=self.aero,
            hitch=self.hitch,
            trailer=self.trailer, gravity=self.gravity,
        )  # fmt: skip


def full_car_model(car: FullCar) -> ModelSpec:
    """The model of a full car in its design position; inputs as of solver.vehicle.car."""
    return car_model(car.car())
