"""Vehicle files: data of a template, chosen by the key `kind` -> ModelSpec.

    kind: light_car
    chassis: {mass: 1250, ...}

The other keys are the fields of the template's data class; a further template is one entry in TEMPLATES. The key
`elements` adds bodies, coordinates and elements to what the template makes, in the sections of a mechanism file
(docs/vehicle.md).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from solver.errors import SceneError, SpecError, suggestion
from solver.files.mechanism import MechanismReader
from solver.files.schema import Builder, Node, hints_of, join, where
from solver.files.yaml_tree import refuse
from solver.model.frames import Placement, matrix
from solver.model.spec import SECTIONS, ModelSpec, used_inputs
from solver.vehicle.car import Car, car_model
from solver.vehicle.full_car import FullCar, full_car_model
from solver.vehicle.light_car import LightCar, light_car_model

TEMPLATES: dict[str, tuple[type, Callable[[Any], ModelSpec]]] = {
    'car': (Car, car_model),
    'full_car': (FullCar, full_car_model),
    'light_car': (LightCar, light_car_model),
}

ELEMENTS = 'elements'  # key of a vehicle with what it carries besides its template
FARTHEST = 30.0  # m: the longest road trains have 25 m


def build_vehicle(builder: Builder, node: Node, path: str) -> ModelSpec:
    """The model of a vehicle from its node. Raises SceneError."""
    fields = builder.mapping(node, path)
    if 'kind' not in fields:
        scene = (
            '; this is a scene: give what stands under its key vehicle'
            if fields.keys() & {'vehicle', 'mechanism'}
            else ''
        )
        raise SceneError(f"{where(node)}: {path}: the key 'kind' is missing; one of: {', '.join(TEMPLATES)}{scene}")
    kind = builder.choice(fields.pop('kind')[1], join(path, 'kind'), TEMPLATES, 'unknown kind of vehicle')
    data, template = TEMPLATES[kind]
    more = fields.pop(ELEMENTS, None)
    builder.longest = FARTHEST
    try:
        model = template(builder.construct(data, fields, node, path, extra=('kind', ELEMENTS)))
    except SpecError as error:
        raise SceneError(f'{where(node)}: {path}: {error}') from None
    finally:
        builder.longest = math.inf
    return model if more is None else _with_elements(builder, model, more[1], join(path, ELEMENTS))


def _with_elements(builder: Builder, model: ModelSpec, node: Node, path: str) -> ModelSpec:
    """The model of a vehicle with what its file adds; places are in the design frame, in which the bodies of the
    vehicle are placed."""
    reader = MechanismReader()
    reader.bodies.update(
        {body.name: Placement(np.array(body.position), matrix(body.orientation)) for body in model.bodies}
    )
    inner = reader.builder()
    inner.units, inner.longest = builder.units, FARTHEST
    hints, fields = hints_of(ModelSpec), inner.mapping(node, path)
    for key, (key_node, _) in fields.items():
        if key not in SECTIONS:
            raise refuse(key_node, join(path, key), f'unknown key{suggestion(key, SECTIONS)}')
    own = model.sections()
    # bodies first, so that the others may be placed on them
    added = {key: inner.build(hints[key], fields[key][1], join(path, key)) for key in SECTIONS if key in fields}
    names = tuple((key, spec.name) for key, specs in added.items() for spec in specs)
    merged: dict[str, Any] = {key: (*own[key], *specs) for key, specs in added.items()}
    try:
        whole = dataclasses.replace(model, **merged, added=names)
    except SpecError as error:
        raise SceneError(f'{where(node)}: {path}: {error}') from None
    return dataclasses.replace(whole, inputs=used_inputs(whole))
