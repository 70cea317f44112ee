"""Vehicle files: data of a template, chosen by the key `kind` -> ModelSpec.

    kind: light_car
    chassis: {mass: 1250, ...}

The other keys are the fields of the template's data class; a further template is one entry in TEMPLATES.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from solver.errors import SceneError, SpecError
from solver.files.schema import Builder, Node, join, where
from solver.model.spec import ModelSpec
from solver.vehicle.car import Car, car_model
from solver.vehicle.full_car import FullCar, full_car_model
from solver.vehicle.light_car import LightCar, light_car_model

TEMPLATES: dict[str, tuple[type, Callable[[Any], ModelSpec]]] = {
    'car': (Car, car_model),
    'full_car': (FullCar, full_car_model),
    'light_car': (LightCar, light_car_model),
}

FARTHEST = 30.0  # m: the longest road trains have 25 m


def build_vehicle(builder: Builder, node: Node, path: str) -> ModelSpec:
    """The model of a vehicle from its node. Raises SceneError."""
    fields = builder.mapping(node, path)
    if 'kind' not in fields:
        scene = '; this is a scene: give what stands under its key vehicle' if fields.keys() & {'vehicle', 'mechanism'} else ''
        raise SceneError(f"{where(node)}: {path}: the key 'kind' is missing; one of: {', '.join(TEMPLATES)}{scene}")
    kind = builder.choice(fields.pop('kind')[1], join(path, 'kind'), TEMPLATES, 'unknown kind of vehicle')
    data, model = TEMPLATES[kind]
    builder.longest = FARTHEST
    try:
        return model(builder.construct(data, fields, node, path, extra=('kind',)))
    except SpecError as error:
        raise SceneError(f'{where(node)}: {path}: {error}') from None
    finally:
        builder.longest = math.inf
