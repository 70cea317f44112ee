"""Fills the generated parts of docs/scene.md from the dataclasses: `python docs/tools/tables.py` rewrites them, a test
compares. It writes the JSON Schemas in config/schema too, as `mbd schema --out config/schema` does.

A part stands between `<!-- begin NAME -->` and `<!-- end -->`. NAME is the dotted name of a dataclass, or `elements`
for all element kinds of ModelSpec, or `vehicles` for the data of all vehicle templates.
"""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import re
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.elements.tire_pacejka import TireData
from solver.files.json_schema import files
from solver.files.schema import keys_of, kinds_of, plain, unit_of
from solver.files.vehicle import TEMPLATES
from solver.model.spec import ModelSpec
from solver.scene import Bound
from solver.units import SUFFIXES, UNITS
from solver.vehicle.named_quantities import BY_WHEEL, NAMED

FILE = Path(__file__).parents[1] / 'scene.md'
SCHEMAS = Path(__file__).parents[2] / 'config' / 'schema'
PART = re.compile(r'<!-- begin (?P<name>[\w.]+) -->\n(?P<body>.*?)<!-- end -->', re.DOTALL)
WORDS = {
    float: 'number',
    int: 'whole number',
    str: 'text',
    bool: 'true or false',
    types.NoneType: 'null',
    Marker: 'marker',
    Law: 'law',
}
WORDS[Bound] = 'limit'
SUFFIX_OF = {UNITS[written][0]: suffix for suffix, written in SUFFIXES.items()}


def render(text: str) -> str:
    """The document with its generated parts made anew."""
    return PART.sub(lambda m: f'<!-- begin {m["name"]} -->\n{part(m["name"])}<!-- end -->', text)


def part(name: str) -> str:
    """One generated part."""
    if name == 'elements':
        hints = typing.get_type_hints(ModelSpec, include_extras=True)
        kinds = [(f.name, element(hints[f.name])) for f in keys_of(ModelSpec)]
        return '\n'.join(f'### {section}\n\n{block(cls, named=True)}' for section, cls in kinds if cls is not None)
    if name == 'vehicles':
        seen: set[type] = set()  # a class that several templates share stands with the first of them
        parts = []
        for kind, (data, _) in TEMPLATES.items():
            new = [cls for cls in nested(data) if cls not in seen]
            seen.update(new)
            parts.append(
                f'### {kind}\n\n' + '\n'.join(f'#### {cls.__name__}\n\n{block(cls, named=True)}' for cls in new)
            )
        return '\n'.join(parts)
    if name == 'quantities':
        rows = [(name, of) for name, of in NAMED.items()] + [(f'{name}.<wheel>', of) for name, of in BY_WHEEL.items()]
        lines = [f'| `{name}` | {of.text} | {of.unit} | {of.least:g} |' for name, of in rows]
        return '\n'.join(['| quantity | | unit | least peak |', '|---|---|---|---|', *lines]) + '\n'
    module, _, cls = name.rpartition('.')
    return block(getattr(importlib.import_module(module), cls))


def nested(cls: type) -> list[type]:
    """A dataclass and those in its fields, each once, in order of appearance, without those that have a place of their
    own."""
    found: dict[type, None] = {}

    def visit(hint: Any) -> None:
        for argument in get_args(hint):
            visit(argument)
        if dataclasses.is_dataclass(hint) and hint not in found and hint not in (Law, Marker, TireData):
            found[typing.cast(type, hint)] = None
            hints = typing.get_type_hints(hint, include_extras=True)
            for field in dataclasses.fields(hint):
                visit(hints[field.name])

    visit(cls)
    return list(found)


def element(hint: Any) -> type | None:
    """The spec in tuple[Spec, ...], or None."""
    args = get_args(hint)
    return (
        args[0]
        if get_origin(hint) is tuple and isinstance(args[0], type) and dataclasses.is_dataclass(args[0])
        else None
    )


def block(cls: type, *, named: bool = False) -> str:
    """Docstring and table of the keys of a dataclass. named: the name is the key of the entry."""
    hints = typing.get_type_hints(cls, include_extras=True)
    rows = ['| key | value | unit | default |', '|---|---|---|---|']
    for field in keys_of(cls):
        hint = hints[field.name]
        if (named and field.name == 'name') or not field.repr or hint is ModelSpec:
            continue
        if 'keys' in field.metadata:
            rows += [
                f'| `{key}` | {value(plain(of))} | {unit_of(of)} | none |' for key, of in field.metadata['keys'].items()
            ]
            continue
        unit = unit_of(hint)
        suffix = f' (or `{field.name}_{SUFFIX_OF[unit]}`)' if unit in SUFFIX_OF else ''
        rows.append(f'| `{field.name}`{suffix} | {value(plain(hint))} | {unit} | {default(field)} |')
    texts = [inspect.cleandoc(one.__doc__ or '') for one in (cls, *inherited(cls))]
    return '\n\n'.join([*texts, '\n'.join(rows)]) + '\n'


def inherited(cls: type) -> list[type]:
    """Classes whose keys data of a vehicle have inherited, where their docstrings say what these are."""
    bases = [
        base
        for base in cls.__mro__[1:]
        if base.__module__.startswith('solver.vehicle.') and dataclasses.is_dataclass(base)
    ]
    return [
        base for base in bases if any(f'{field.name}:' in (base.__doc__ or '') for field in dataclasses.fields(base))
    ]


def value(hint: Any) -> str:
    """Text of the values that may be written for a type."""
    hint = plain(hint)
    origin, args = get_origin(hint), get_args(hint)
    if hint in WORDS:
        return WORDS[hint]
    if origin is Literal:
        return ', '.join(f'`{a}`' for a in args)
    if origin in (Union, types.UnionType):
        members = [a for a in args if a is not types.NoneType]
        if len(members) == 1:
            return value(members[0])
        classes = [
            kind
            for a in members
            if dataclasses.is_dataclass(plain(a)) and plain(a) not in WORDS
            for kind in kinds_of(plain(a))
        ]
        words = [value(a) for a in members if not dataclasses.is_dataclass(plain(a)) or plain(a) in WORDS]
        return ' or '.join(words + ([f'mapping with `kind` {", ".join(classes)}'] if classes else []))
    if origin is tuple and len(args) == 2 and args[1] is Ellipsis:
        inner = plain(args[0])
        if (
            isinstance(inner, type)
            and dataclasses.is_dataclass(inner)
            and any(f.name == 'name' for f in dataclasses.fields(inner))
        ):
            return f'mapping name: {inner.__name__.removesuffix("Spec")}'
        if get_origin(inner) is tuple and get_args(inner)[0] is str:
            return f'mapping text: {value(get_args(inner)[1])}'
        return f'list of {value(inner)}'
    if origin is tuple:
        kinds = {value(a) for a in args}
        return (
            f'list of {len(args)} {plural(kinds.pop())}'
            if len(kinds) == 1
            else '[' + ', '.join(value(a) for a in args) + ']'
        )
    if origin in (dict, Mapping):
        return f'mapping text: {value(args[1])}'
    return f'{hint.__name__.removesuffix("Spec")}'


def plural(kind: str) -> str:
    """Several of what may be written."""
    return kind.replace('list of', 'lists of', 1) if kind.startswith('list of') else f'{kind}s'


def default(field: dataclasses.Field) -> str:
    """The default value as it would be written, '**required**' without one."""
    if field.default is dataclasses.MISSING:
        return '**required**' if field.default_factory is dataclasses.MISSING else 'empty'
    if field.default is None:
        return 'none'
    if isinstance(field.default, tuple):
        return str([*field.default]) if field.default else 'empty'
    if dataclasses.is_dataclass(field.default):
        return 'its defaults'
    if isinstance(field.default, bool):
        return str(field.default).lower()
    return (
        f'{field.default:g}'
        if isinstance(field.default, float)
        else (f'{field.default}' if field.default != '' else 'empty')
    )


if __name__ == '__main__':
    FILE.write_text(render(FILE.read_text(encoding='utf-8')), encoding='utf-8')
    for name, text in files().items():
        (SCHEMAS / name).write_text(text, encoding='utf-8')
