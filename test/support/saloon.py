"""The data of the full car, and variations of it."""

from __future__ import annotations

import dataclasses
from typing import Any

from solver.files.mechanism import MechanismReader
from solver.files.scene import config_directories, find_file
from solver.files.yaml_tree import read
from solver.vehicle.double_wishbone import DoubleWishbone
from solver.vehicle.full_car import FullCar
from solver.vehicle.hardpoints import mirror
from solver.vehicle.parts import Bushing


def full_car() -> FullCar:
    """The data of config/vehicles/full_car.yaml."""
    root = read(find_file('full_car', 'vehicles'), config_directories())
    builder = MechanismReader().builder()
    fields = builder.mapping(root, '')
    fields.pop('kind')
    return builder.construct(FullCar, fields, root, '')


def without_bushings(data):
    """A copy of vehicle data in which every connection is an ideal joint."""
    if isinstance(data, Bushing):
        return None
    if dataclasses.is_dataclass(data) and not isinstance(data, type):
        changes = {
            f.name: without_bushings(getattr(data, f.name)) for f in dataclasses.fields(data) if f.name != 'tire'
        }
        return dataclasses.replace(data, **changes)
    if isinstance(data, dict):
        return {key: without_bushings(value) for key, value in data.items()}
    if type(data) is tuple:
        return tuple(map(without_bushings, data))
    return data


def mirrored(car: FullCar) -> FullCar:
    """The car with its steering on the other side and its propeller shaft turning the other way: all that is not
    symmetric."""
    s = car.steering
    points: dict[str, Any] = {
        name: mirror(getattr(s, name)) for name in ('pinion_foot', 'pinion_joint', 'column_joint', 'wheel_hub')
    }
    return dataclasses.replace(
        car,
        steering=dataclasses.replace(s, **points),
        driveline=dataclasses.replace(car.driveline, ratio=-car.driveline.ratio),
    )


def double_wishbones() -> FullCar:
    """Another car: double wishbones behind too, the front ones turned around, with the toe link on the subframe; a
    longer wheelbase, upper arms that are less inclined, stiffer springs, a lighter body with its centre of mass further
    forward.
    """
    car = full_car()
    front, back = car.front, 0.06
    assert isinstance(front, DoubleWishbone)

    def turned(point: tuple[float, ...]) -> tuple[float, float, float]:
        return (-point[0] - back, point[1], point[2])

    def link(data, *, ends=('outer', 'inner')):
        return dataclasses.replace(data, **{name: turned(getattr(data, name)) for name in ends})

    def raised(pivots, by: float):
        return tuple((x, y, z + by) for x, y, z in pivots)

    arm = front.upper_arm
    upper = dataclasses.replace(arm, outer=turned(arm.outer), pivots=raised(map(turned, arm.pivots), 0.012))
    coil = front.coil_over
    rear = dataclasses.replace(
        front,
        wheel=dataclasses.replace(car.rear.wheel, center=turned(front.wheel.center)),
        brake=car.rear.brake,
        upright=dataclasses.replace(front.upright, com=turned(front.upright.com)),
        upper_arm=upper,
        lower_link=link(front.lower_link),
        radius_link=link(front.radius_link),
        tie_rod=link(front.tie_rod),
        coil_over=dataclasses.replace(
            coil,
            lower=turned(coil.lower),
            upper=turned(coil.upper),
            spring=dataclasses.replace(coil.spring, rate=50e3, load=4900.0),
        ),
    )
    ahead = dataclasses.replace(
        front,
        upper_arm=dataclasses.replace(arm, pivots=raised(arm.pivots, 0.01)),
        coil_over=dataclasses.replace(coil, spring=dataclasses.replace(coil.spring, rate=52e3, load=5200.0)),
    )
    body = dataclasses.replace(car.chassis, mass=980.0, com=(-0.05, 0.0, 0.6), inertia=(380.0, 1500.0, 1600.0))
    return dataclasses.replace(car, chassis=body, front=ahead, rear=rear)
