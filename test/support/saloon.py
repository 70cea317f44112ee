"""The data of the full car, and variations of it."""

from __future__ import annotations

import dataclasses
from typing import Any

from solver.files.mechanism import MechanismReader
from solver.files.scene import config_directories, find_file
from solver.files.yaml_tree import read
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
        changes = {f.name: without_bushings(getattr(data, f.name)) for f in dataclasses.fields(data) if f.name != 'tire'}
        return dataclasses.replace(data, **changes)
    if isinstance(data, dict):
        return {key: without_bushings(value) for key, value in data.items()}
    return data


def mirrored(car: FullCar) -> FullCar:
    """The car with its steering on the other side and its propeller shaft turning the other way: all that is not symmetric."""
    s = car.steering
    points: dict[str, Any] = {name: mirror(getattr(s, name)) for name in ('pinion_foot', 'pinion_joint', 'column_joint', 'wheel_hub')}
    return dataclasses.replace(
        car, steering=dataclasses.replace(s, **points), driveline=dataclasses.replace(car.driveline, ratio=-car.driveline.ratio)
    )
