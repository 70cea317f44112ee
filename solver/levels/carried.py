"""Elements that a vehicle carries besides its template (the key `elements` of its file), on a level that has less of
the vehicle.

A level is derived from the vehicle alone. Its further elements are put onto the level as they are, where the level has
their bodies and coordinates, and refused by name where it does not: nothing that a scene adds vanishes unsaid.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

from solver.elements.marker import WORLD, Marker
from solver.errors import SpecError
from solver.model.compile import joint_coordinates
from solver.model.spec import INPUTS, SECTIONS, ModelSpec, used_inputs

Sections = dict[str, tuple[Any, ...]]


def apart(model: ModelSpec) -> tuple[ModelSpec, Sections]:
    """(the vehicle alone, what it carries by section)."""
    if not model.added:
        return model, {}
    of = {section: {name for s, name in model.added if s == section} for section, _ in model.added}
    sections = model.sections()
    more = {section: tuple(spec for spec in sections[section] if spec.name in names) for section, names in of.items()}
    alone = {
        section: tuple(spec for spec in sections[section] if spec.name not in names) for section, names in of.items()
    }
    less = dataclasses.replace(model, **alone, added=())
    used = used_inputs(less)
    own = {getattr(spec, key, None) for specs in more.values() for spec in specs for key in INPUTS}
    return dataclasses.replace(
        less, inputs=tuple(name for name in model.inputs if name in used or name not in own)
    ), more


def carrying(less: ModelSpec, more: Sections, whole: ModelSpec) -> ModelSpec:
    """The model of a level with what the whole vehicle carries. Raises SpecError for an element on what the level does
    not have."""
    if not more:
        return less
    merged: dict[str, Any] = {section: (*getattr(less, section), *specs) for section, specs in more.items()}
    model = dataclasses.replace(less, **merged, added=whole.added)
    bodies, coordinates = {WORLD, *(body.name for body in model.bodies)}, _coordinates(model)
    known = _coordinates(whole)
    for specs in more.values():
        for spec in specs:
            for body in _bodies(spec):
                if body not in bodies:
                    raise SpecError(f'{spec.where}: acts on body {body!r}, which this level does not have; use full')
            for name in _names(spec):
                if name in known and name not in coordinates:
                    raise SpecError(
                        f'{spec.where}: acts on coordinate {name!r}, which this level does not have; use full'
                    )
    names = used_inputs(model)
    return dataclasses.replace(model, inputs=tuple(name for name in whole.inputs if name in names))


def require_kept(less: ModelSpec, whole: ModelSpec) -> tuple[str, ...]:
    """Elements that the vehicle carries and a model derived from all of it does not, in words. Raises SpecError for
    what has an input."""
    there = {section: {spec.name for spec in specs} for section, specs in less.sections().items()}
    gone = [(section, name) for section, name in whole.added if name not in there[section]]
    return tuple(left_out(spec) for section, name in gone for spec in getattr(whole, section) if spec.name == name)


def left_out(spec: Any) -> str:
    """Something that a vehicle carries and a level does not have, in words. Raises SpecError where it is driven by an
    input."""
    name = next(filter(None, (getattr(spec, key, None) for key in INPUTS)), None)
    if name:
        raise SpecError(
            f'{spec.where}: its input {name!r} moves nothing that this level has; use full, or leave the element out'
        )
    return f'{spec.where}, which the vehicle carries'


def in_order(more: Sections) -> Iterator[Any]:
    """Everything that is carried."""
    return (spec for section in SECTIONS for spec in more.get(section, ()))


def _coordinates(model: ModelSpec) -> set[str]:
    return {c.name for c in (*model.coordinates, *(c for joint in model.joints for c in joint_coordinates(joint)))}


def _bodies(spec: Any) -> list[str]:
    return [value.body for value in vars(spec).values() if isinstance(value, Marker)]


def _names(spec: Any) -> Iterator[str]:
    """Names that a specification may mention: texts in its fields, but its own name and that of its input."""
    for field, value in vars(spec).items():
        if field not in ('name', *INPUTS):
            values = value if isinstance(value, tuple) else (value,)
            yield from (one for v in values for one in (v if isinstance(v, tuple) else (v,)) if isinstance(one, str))
