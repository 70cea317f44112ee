"""JSON Schemas (draft 7) of the files that the loader reads, from the same type hints (solver.files.schema): for
editors.

A schema is a net with wider meshes than the loader. It knows keys, forms, choices, units in names of keys, and bounds
of single numbers. It does not know what holds between values: names of bodies, a key given twice in two units, laws
that must ascend. `mbd info FILE` judges. The schema takes everything that the loader takes; a scalar is meant as YAML
1.2 reads it, as editors do.

A mapping with the key `<<` has what the file named there has, changed by the keys beside it, so nothing is required in
it: every definition exists once more under its name with `.changes` behind.

The file is long because every kind of hint that the loader reads has its schema here, and nowhere else.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import types
from collections.abc import Callable, Mapping
from typing import Any, Literal, Union, get_args, get_origin

from solver.dimensions import BOUND_ROUNDING, Angle, Moments, Point, Within
from solver.elements.laws import Law
from solver.elements.marker import Marker, Spec
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.road import RoadSpec
from solver.errors import SpecError, suggestion
from solver.files.linkages import LINKAGES
from solver.files.mechanism import ROTATION_KEYS
from solver.files.naming import READERS
from solver.files.requirements import Keys
from solver.files.schema import hints_of, keys_of, kinds_of, plain, unit_of
from solver.files.vehicle import ELEMENTS, TEMPLATES
from solver.inputs.maneuver import Maneuver
from solver.model.spec import SECTIONS, ModelSpec
from solver.scene import Accuracy, Bound, Require, Scene
from solver.units import SUFFIXES, UNITS
from solver.validate import Quaternion, Vector
from solver.vehicle.trailer import Trailer

Schema = dict[str, Any]
DRAFT = 'http://json-schema.org/draft-07/schema#'
ENDINGS = '|'.join(ending.removeprefix('.') for ending in ('.yaml', *READERS))
FILE: Schema = {
    'type': 'string',
    'pattern': rf'^([\w./-]+|/.*)\.({ENDINGS})$',
    'description': 'a file that stands here',
}
A_FILE: Schema = {'$ref': '#/definitions/file'}
# a word that YAML reads as a number is text where text is wanted
TEXT: Schema = {'type': ['string', 'number', 'boolean']}
EMPTY: Schema = {'type': 'null'}
# What mechanism files write that is no field of a specification (solver.files.mechanism), and its type.
PLACED: dict[str, Any] = {
    'at': Point,
    'orientation': Quaternion,
    'rpy': tuple[Angle, Angle, Angle],
    'rpy_deg': tuple[float, float, float],
    'axis': Vector,
    'x_axis': Vector,
}


def _vehicle(writer: Writer, changes: bool) -> Schema:
    """The data of a template, by `kind`, with the sections of a mechanism under `elements`."""
    hints, also = hints_of(ModelSpec), {'<<': A_FILE} if changes else {}
    sections = {**{key: writer.build(hints[key], changes) for key in SECTIONS}, **also}
    more = {ELEMENTS: _or_file({'type': 'object', 'properties': sections, 'additionalProperties': False})}
    return writer.one_of({kind: data for kind, (data, _) in TEMPLATES.items()}, changes, more=more)


def _mechanism(writer: Writer, changes: bool) -> Schema:
    return writer.build(ModelSpec, changes)


def _scene(writer: Writer, changes: bool) -> Schema:
    """The fields of Scene; the model comes from the keys that files have for it (solver.files.scene)."""
    more = {
        'name': TEXT,
        'mechanism': writer.build(ModelSpec, changes),
        'vehicle': _or_file(writer.named('vehicle', _vehicle, changes)),
        'trailer': writer.build(Trailer | None, changes),
        'road': writer.build(RoadSpec, changes),
    }
    schema = writer.mapping(Scene, changes, leave=('name', 'model', 'resolved'), more=more)
    needs = [
        {'required': [one], 'not': {'required': [other]}}
        for one, other in (('vehicle', 'mechanism'), ('mechanism', 'vehicle'))
    ]
    return schema if changes else {**schema, 'oneOf': needs}


def _maneuver(writer: Writer, changes: bool) -> Schema:
    return writer.build(Maneuver, changes)


def _road(writer: Writer, changes: bool) -> Schema:
    return writer.build(RoadSpec, changes)


def _trailer(writer: Writer, changes: bool) -> Schema:
    return writer.build(Trailer, changes)


Maker = Callable[['Writer', bool], Schema]
KINDS: dict[str, tuple[Maker, str]] = {
    'scene': (_scene, 'scenes'),
    'vehicle': (_vehicle, 'vehicles'),
    'trailer': (_trailer, 'vehicles/trailers'),
    'mechanism': (_mechanism, 'mechanisms'),
    'maneuver': (_maneuver, 'maneuvers'),
    'road': (_road, 'roads'),
}  # kind of file -> what makes its schema, and the folder of config that such files are in


def schema_of(kind: str) -> Schema:
    """The JSON Schema of a kind of file (KINDS). Raises SpecError."""
    if kind not in KINDS:
        raise SpecError(f'{kind!r}: no such kind of file{suggestion(kind, KINDS)}')
    writer = Writer()
    root = writer.named(kind, KINDS[kind][0], False)
    about = {'$schema': DRAFT, 'title': f'{kind} of mbd_sim_ros', '$comment': f'made by mbd schema {kind}'}
    return {**about, 'allOf': [root], 'definitions': dict(sorted(writer.definitions.items()))}


def files() -> dict[str, str]:
    """Name -> text of the files of config/schema: one per kind, and the definitions that they share, each in a line of
    its own."""
    definitions: dict[str, Schema] = {}
    texts = {}
    for kind in KINDS:
        schema = schema_of(kind)
        definitions |= schema.pop('definitions')
        schema['allOf'] = [{'$ref': f'definitions.json{one["$ref"]}'} for one in schema['allOf']]
        texts[f'{kind}.json'] = json.dumps(schema, indent=1) + '\n'
    lines = ',\n'.join(f'{json.dumps(name)}: {json.dumps(one)}' for name, one in sorted(definitions.items()))
    texts['definitions.json'] = f'{{"$schema": "{DRAFT}", "definitions": {{\n{lines}\n}}}}\n'
    return texts


class Writer:
    """Makes schemas of hints; those of dataclasses are definitions, referred to by name.

    Argument of every method: changes: the mapping changes one in a file, so that nothing is required in it.
    """

    def __init__(self) -> None:
        self.definitions: dict[str, Schema] = {'file': FILE}

    def named(self, name: str, make: Maker, changes: bool) -> Schema:
        """A reference to a definition, made where it is not there yet. Without `changes` it has a branch for mappings
        that have `<<`."""
        key = f'{name}.changes' if changes else name
        if key not in self.definitions:
            self.definitions[key] = {}  # what refers to itself finds it
            full = make(self, changes)
            if not changes:
                full = {'if': {'required': ['<<']}, 'then': self.named(name, make, True), 'else': full}
            self.definitions[key] = full
        return {'$ref': f'#/definitions/{key}'}

    def build(self, hint: Any, changes: bool, *, keyed: bool = False, unit: str = '', bounded: bool = True) -> Schema:
        """The schema of a type. keyed: its name is the key of the entry. unit: of the key, where that is not the unit
        of the hint. bounded: the bounds of the hint hold; in mappings of numbers the loader does not look at them.
        """
        own = _bounds(hint, unit) if bounded else {}
        hint = plain(hint)
        origin, args = get_origin(hint), get_args(hint)
        if isinstance(hint, type) and (hook := next((HOOKS[c] for c in hint.__mro__ if c in HOOKS), None)) is not None:
            return hook(self, hint, changes, keyed)
        if origin is Literal:
            return {'enum': [*args, *(str(a) for a in args if not isinstance(a, str))]}
        if origin in (Union, types.UnionType):
            return {**self._union(args, changes, keyed, unit, bounded), **({'allOf': [own]} if own else {})}
        if origin is tuple:
            return self._tuple(args, changes, unit, bounded)
        if origin in (dict, Mapping):
            return _or_file({'type': 'object', 'additionalProperties': self.build(args[1], changes, bounded=False)})
        if dataclasses.is_dataclass(hint):
            return self.reference(hint, changes, keyed)
        scalars: dict[Any, Schema] = {
            float: {'type': 'number', **own},
            int: {'type': 'integer'},
            bool: {'type': 'boolean'},
            str: TEXT,
        }
        if hint not in scalars:
            raise TypeError(f'the schema does not know the type {hint!r}')
        return scalars[hint]

    def reference(self, cls: Any, changes: bool, keyed: bool = False, **how: Any) -> Schema:
        """A dataclass as a definition, or a file in its place. how: as mapping() takes it."""
        name = _name(cls) + ('.entry' if keyed and any(f.name == 'name' for f in dataclasses.fields(cls)) else '')
        leave = (*how.pop('leave', ()), *(('name',) if keyed else ()))
        return _or_file(self.named(name, lambda writer, less: writer.mapping(cls, less, leave=leave, **how), changes))

    def mapping(
        self, cls: Any, changes: bool, *, leave: tuple[str, ...] = (), more: Mapping[str, Schema] | None = None
    ) -> Schema:
        """The mapping of the fields of a dataclass. leave: fields without a key. more: keys that are no fields, or have
        a form of their own."""
        hints, properties = hints_of(cls), dict(more or {})
        required: list[str] = []
        either: list[Schema] = []
        for field in (f for f in keys_of(cls) if f.name not in leave):
            hint = hints[field.name]
            properties.setdefault(field.name, {**self.build(hint, changes), **_about(field, unit_of(hint))})
            names = [field.name]
            for suffix, written in SUFFIXES.items():
                if unit_of(hint) == UNITS[written][0]:
                    names.append(f'{field.name}_{suffix}')
                    properties.setdefault(
                        names[-1],
                        {**self.build(hint, changes, unit=written), 'description': f'{field.name} [{written}]'},
                    )
            if field.default is field.default_factory is dataclasses.MISSING:
                required += names[:1] if len(names) == 1 else []
                either += [{'anyOf': [{'required': [one]} for one in names]}] if len(names) > 1 else []
        schema: Schema = {
            'type': 'object',
            'properties': {**properties, **({'<<': A_FILE} if changes else {})},
            'additionalProperties': False,
        }
        if text := inspect.cleandoc(cls.__doc__ or '').partition('\n\n')[0]:
            schema['description'] = ' '.join(text.split())
        if not changes and required:
            schema['required'] = required
        if not changes and either:
            schema['allOf'] = either
        return schema

    def one_of(
        self,
        members: Mapping[str, Any],
        changes: bool,
        keyed: bool = False,
        implied: Any = None,
        more: Mapping[str, Schema] | None = None,
    ) -> Schema:
        """A mapping whose `kind` chooses one of the dataclasses. implied: is meant without `kind`. more: keys that all
        have."""
        choices = []
        for kind, cls in members.items():
            word = {'kind': {'const': kind}}
            free = cls is implied or changes
            chosen = self.chosen(cls, changes, keyed, more)
            choices.append({'allOf': [chosen, {'properties': word, **({} if free else {'required': ['kind']})}]})
        return choices[0] if len(choices) == 1 else {'anyOf': choices}

    def chosen(self, cls: Any, changes: bool, keyed: bool, also: Mapping[str, Schema] | None = None) -> Schema:
        """A dataclass that `kind` has chosen: the key stands in its mapping, whether it has such a field or not."""
        leave = ('name',) if keyed else ()
        name = f'{_name(cls)}.kind' + (
            '.entry' if keyed and any(f.name == 'name' for f in dataclasses.fields(cls)) else ''
        )
        more = {'kind': {'type': 'string'}, **(also or {})}
        return self.named(name, lambda writer, less: writer.mapping(cls, less, leave=leave, more=more), changes)

    def _union(self, args: tuple, changes: bool, keyed: bool, unit: str, bounded: bool) -> Schema:
        rest = [plain(a) for a in args if a is not types.NoneType]
        found = [EMPTY] if types.NoneType in args else []
        classes: list[Any] = [a for a in rest if dataclasses.is_dataclass(a)]
        if len(rest) == 1 or not classes:
            found += [
                self.build(a, changes, keyed=keyed, unit=unit, bounded=bounded) for a in args if a is not types.NoneType
            ]
            return found[0] if len(found) == 1 else {'anyOf': found}
        hooked = [a for a in classes if any(c in HOOKS for c in a.__mro__)]
        kinds = {kind: a for a in classes for kind in kinds_of(a)}
        implied = next((a for a in classes if getattr(a, 'implied', False)), None)
        found += [
            self.build(a, changes, keyed=keyed, unit=unit, bounded=bounded)
            for a in rest
            if a not in classes or a in hooked
        ]
        return {'anyOf': [*found, self.one_of(kinds, changes, keyed, implied), A_FILE]}

    def _tuple(self, args: tuple, changes: bool, unit: str, bounded: bool) -> Schema:
        if not (len(args) == 2 and args[1] is Ellipsis):
            items = [self.build(a, changes, unit=unit, bounded=bounded) for a in args]
            count = {'minItems': len(args), 'maxItems': len(args)}
            return _or_file(
                {'type': 'array', 'items': items[0] if all(i == items[0] for i in items) else items, **count}
            )
        item = plain(args[0])
        many = _or_file({'type': 'array', 'items': self.build(args[0], changes, unit=unit, bounded=bounded)})
        members = [plain(a) for a in get_args(item)] if get_origin(item) in (Union, types.UnionType) else [item]
        if all(dataclasses.is_dataclass(m) and any(f.name == 'name' for f in dataclasses.fields(m)) for m in members):
            return {
                'anyOf': [
                    {'type': 'object', 'additionalProperties': self.build(args[0], changes, keyed=True)},
                    *many['anyOf'],
                ]
            }
        if get_origin(item) is tuple and get_args(item)[0] is str and len(get_args(item)) == 2:
            value = self.build(get_args(item)[1], changes, bounded=bounded)
            return {'anyOf': [{'type': 'object', 'additionalProperties': value}, *many['anyOf']]}
        return many


def _name(cls: Any) -> str:
    """That of a definition: classes of several modules share theirs."""
    return f'{cls.__module__.rpartition(".")[2]}.{cls.__name__}'


def _or_file(schema: Schema) -> Schema:
    """Schema that takes a file with a mapping or a list in place of it."""
    return {'anyOf': [schema, A_FILE]}


def _bounds(hint: Any, unit: str) -> Schema:
    """minimum and maximum of the numbers of a hint, in the unit of the key."""
    if get_origin(hint) is None or not hasattr(hint, '__metadata__'):
        return {}
    within = next((a for a in hint.__metadata__ if isinstance(a, Within)), None)
    if within is None:
        return {}
    most = within.most * (1.0 + 2.0 * BOUND_ROUNDING) / (UNITS[unit][1] if unit else 1.0)
    return {'minimum': -most, 'maximum': most}


def _about(field: dataclasses.Field, unit: str) -> Schema:
    """Text that an editor shows for a field: its unit and default."""
    about: Schema = {'description': f'[{unit}]'} if unit else {}
    if isinstance(field.default, str | int | float | bool) and field.default == field.default:
        about['default'] = field.default
    return about


# -- types that have a form of their own in files, as the hooks of the loader have it --------------------------------


def _model(writer: Writer, cls: Any, changes: bool, keyed: bool) -> Schema:
    """solver.files.mechanism.MechanismReader.model()."""
    linkages = writer.one_of({kind: data for kind, (data, _) in LINKAGES.items()}, changes)
    own = writer.named('ModelSpec', lambda one, less: one.mapping(ModelSpec, less), changes)
    return _or_file({'if': {'required': ['kind']}, 'then': linkages, 'else': own})


def _body(writer: Writer, cls: Any, changes: bool, keyed: bool) -> Schema:
    """MechanismReader.body()."""
    more = {key: writer.build(PLACED[key], changes) for key in ('rpy', 'rpy_deg')}
    three, six = writer.build(Moments, changes), writer.build(hints_of(RigidBodySpec)['inertia'], changes)
    return writer.reference(cls, changes, keyed, more={**more, 'inertia': {'anyOf': [three, six]}})


def _element(writer: Writer, cls: Any, changes: bool, keyed: bool) -> Schema:
    """MechanismReader.element()."""
    hints = hints_of(cls)
    markers = any(hints[f.name] is Marker for f in dataclasses.fields(cls))
    keys = [key for key in ('at', *ROTATION_KEYS) if key not in hints] if markers else []
    return writer.reference(cls, changes, keyed, more={key: writer.build(PLACED[key], changes) for key in keys})


def _marker(writer: Writer, cls: Any, changes: bool, keyed: bool) -> Schema:
    """MechanismReader._marker()."""
    more = {key: writer.build(PLACED[key], changes) for key in ('at', *ROTATION_KEYS)}
    return {'anyOf': [TEXT, writer.reference(Marker, changes, more=more)]}


def _law(writer: Writer, cls: Any, changes: bool, keyed: bool) -> Schema:
    """MechanismReader.law()."""
    pair = {'type': 'array', 'items': {'type': 'number'}, 'minItems': 2, 'maxItems': 2}
    return {
        'anyOf': [
            {'type': 'number', 'minimum': 0.0},
            _or_file({'type': 'array', 'items': _or_file(pair), 'minItems': 2}),
        ]
    }


def _bound(writer: Writer, cls: Any, changes: bool, keyed: bool) -> Schema:
    """solver.files.requirements.bound()."""
    return {'type': ['string', 'number'], 'description': 'a number with its unit, e.g. 2 % or 0.1 m'}


def _require(writer: Writer, cls: Any, changes: bool, keyed: bool) -> Schema:
    """solver.files.requirements.require(): keys that are not its own are quantities."""
    limits = writer.named('Limits', _limits, changes)
    own = writer.named(
        'Require',
        lambda one, less: {**one.mapping(Keys, less, leave=('accuracy',)), 'additionalProperties': limits},
        changes,
    )
    return _or_file(own)


def _limits(writer: Writer, changes: bool) -> Schema:
    """Limits of a quantity, or of those whose names go on so."""
    one = {**writer.mapping(Accuracy, changes), 'minProperties': 1}
    deeper = {'type': 'object', 'additionalProperties': writer.named('Limits', _limits, changes), 'minProperties': 1}
    return _or_file({'anyOf': [one, deeper]})


HOOKS: dict[type, Callable[[Writer, Any, bool, bool], Schema]] = {
    ModelSpec: _model,
    RigidBodySpec: _body,
    Spec: _element,
    Marker: _marker,
    Law: _law,
    Bound: _bound,
    Require: _require,
}
