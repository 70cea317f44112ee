"""Accuracy that a scene requires: `yaw_rate: {rms: 2 %}` beside the other keys of `require`, limits as text with their
units."""

from __future__ import annotations

import dataclasses

from yaml.nodes import Node, ScalarNode

from solver.checks.registry import LIMITS
from solver.errors import SceneError, suggestion
from solver.files.schema import Builder
from solver.files.yaml_tree import join, refuse, where
from solver.scene import Accuracy, Bound, Require
from solver.units import measured
from solver.vehicle.named_quantities import BY_WHEEL, NAMED

MEASURES = tuple(f.name for f in dataclasses.fields(Accuracy))
# The keys of `require` but for quantities, as a dataclass: the loader reads numbers, units and refusals from its hints.
Keys = dataclasses.make_dataclass(
    'Keys',
    [*((name, hint, None) for name, hint in LIMITS.items()), ('allow_suspect', bool, False), ('accuracy', dict, None)],
    frozen=True,
)
Keys.__doc__ = Require.__doc__
KEYS = tuple(f.name for f in dataclasses.fields(Keys))


def require(builder: Builder, cls: type, node: Node, path: str, name: str | None) -> Require:
    """The hook of Require: keys that are not its own are quantities; dots in their names may also be levels of
    nesting."""
    fields = builder.mapping(node, path)
    accuracy: dict[str, Accuracy] = {}
    for key in [k for k in fields if k not in KEYS or k == 'accuracy']:
        key_node, value = fields.pop(key)
        if key != 'accuracy' and isinstance(value, ScalarNode):
            known = [*KEYS, *NAMED, *BY_WHEEL]
            if _unit(key) or '/' in key:
                raise refuse(
                    value, join(path, key), 'say which error, e.g. {rms: 2 %}; one or more of ' + ', '.join(MEASURES)
                )
            raise SceneError(f'{where(key_node)}: {join(path, key)}: unknown key{suggestion(key, known)}')
        _collect(builder, value, '' if key == 'accuracy' else key, join(path, key), accuracy)
    found = builder.construct(Keys, fields, node, path, given={'accuracy': accuracy}, extra=tuple(NAMED))
    limits = {name: limit for name in LIMITS if (limit := getattr(found, name)) is not None}
    return Require(limits=limits, allow_suspect=found.allow_suspect, accuracy=accuracy)


def _collect(builder: Builder, node: Node, name: str, path: str, found: dict[str, Accuracy]) -> None:
    fields = builder.mapping(node, path)
    nested = [key for key, (_, value) in fields.items() if not isinstance(value, ScalarNode)]
    if name and not nested:
        if name in found:
            raise refuse(node, path, 'the quantity is given twice')
        accuracy = builder.construct(Accuracy, fields, node, path)
        unit = _unit(name)
        for measure, bound_node in ((m, fields[m][1]) for m in accuracy.bounds):
            _agree(bound_node, join(path, measure), 's' if measure == 'delay' else unit)
        found[name] = accuracy
        return
    for key, (_, value) in fields.items():
        _collect(builder, value, f'{name}.{key}' if name else key, join(path, key), found)


def bound(builder: Builder, cls: type, node: Node, path: str, name: str | None) -> Bound:
    """The hook of Bound: a number with its unit."""
    text = builder.build(str, node, path)
    try:
        value, unit = measured(text)
    except ValueError as error:
        raise refuse(node, path, str(error)) from None
    return Bound(value, unit == '%', '' if unit == '%' else unit)


def _unit(name: str) -> str:
    """The unit of a named quantity, '' of a recorded number: which it is follows from the model, and so the scene looks
    at it."""
    head = name.partition('.')[0]
    known = NAMED.get(head) or BY_WHEEL.get(head)
    return known.unit if known else ''


def _agree(node: Node, path: str, unit: str) -> None:
    """Refuse a limit in another unit than that of its quantity."""
    assert isinstance(node, ScalarNode)
    _, given = measured(node.value)
    if given not in ('%', '', unit) and unit:
        raise refuse(node, path, f'is in {given}; the unit of this quantity is {unit} (or %)')
