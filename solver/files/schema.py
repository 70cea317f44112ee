"""The strict loader: nodes with line numbers (solver.files.yaml_tree) -> frozen dataclasses, driven by their type
hints.

Nothing is guessed from how YAML 1.1 reads a word: a scalar is interpreted by the type of the field it is meant for, so
`1e-3` is a number where a number is wanted, and `no` is a word where text is wanted. Meanings of the hints in a file:

    float int bool str Literal    a scalar; numbers are decimal and finite, truth values are true and false
    T | None                      also `null`
    tuple[T, ...]                 a list; of dataclasses with a `name`: a mapping name -> the other fields
    tuple[tuple[str, T], ...]     a mapping key -> T, or a list of pairs
    tuple[A, B, C]                a list of exactly three
    dict[str, T] Mapping[str, T]  a mapping
    a dataclass                   a mapping of its fields
    a union of dataclasses        a mapping whose `kind` chooses one (its Literal, or the class name: random_road); a
                                  scalar where a plain number is in the union
    Annotated[T, 'rad']           the unit of the field, which may also stand inside (solver.dimensions: tuple[Angle,
                                  ...]): then `<key>_deg` is accepted too (SUFFIXES); a Within beside the unit bounds
                                  the number

Every refusal is a SceneError of one sentence: file:line: dotted.path = value: what is allowed.

The file is long because every kind of hint has its reader here, and all refusals are made of the same place.
"""

from __future__ import annotations

import dataclasses
import math
import re
import types
import typing
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cache
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from solver.dimensions import BOUND_ROUNDING, Within
from solver.errors import SceneError, SpecError, suggestion
from solver.files.naming import INCLUDE, READERS, names_file, unfit
from solver.files.yaml_tree import AddedMapping, join, refuse, where
from solver.units import SUFFIXES, UNITS

NUMBER = re.compile(r'[-+]?(0|[1-9][0-9]*)?(\.[0-9]*)?([eE][-+]?[0-9]+)?')
# of a specification about its field
COMPLAINT = re.compile(r'(?:[^=]*?: )?(?P<field>\w+)(?P<rest>[\w.\[\]]*(?: = |: ).*)', re.DOTALL)
_NULL = ('', '~', 'null')

Fields = dict[str, tuple[Node, Node]]
Hook = Callable[['Builder', Any, Node, str, 'str | None'], object]


class Builder:
    """Builds values of a type from nodes. hooks: functions for types that have a form of their own in files.

    A hook is called as hook(builder, type, node, path, name) and is found by the first class of the type's MRO that has
    one. units: of the keys that were read, as they are written (path -> unit), where they have one. longest: lengths
    and coordinates of points that are larger [m] are refused.
    """

    def __init__(self, hooks: Mapping[type, Hook] | None = None) -> None:
        self.hooks = dict(hooks or {})
        self.units: dict[str, str] = {}
        self.longest = math.inf

    def build(self, hint: Any, node: Node, path: str = '', name: str | None = None) -> Any:
        """Value of type `hint` from a node; `name` is the key of a named part. Raises SceneError."""
        hint = plain(hint)
        hook = self._hook(hint)
        if hook is not None:
            try:
                return hook(self, hint, node, path, name)
            except SpecError as error:
                raise SceneError(f'{where(node)}: {path}: {error}') from None
        origin, args = get_origin(hint), get_args(hint)
        if origin is Literal:
            choices = {str(a): a for a in args}
            return choices[self.choice(node, path, choices, 'is not one of the choices')]
        if origin in (Union, types.UnionType):
            return self._union(args, node, path, name)
        if origin is tuple:
            return self._tuple(args, node, path)
        if origin in (dict, Mapping):
            return {
                key: self.build(args[1], value, join(path, key)) for key, (_, value) in self.mapping(node, path).items()
            }
        if dataclasses.is_dataclass(hint):
            return self.construct(typing.cast(type, hint), self.mapping(node, path), node, path, name=name)
        return _scalar(hint, node, path)

    def _hook(self, hint: Any) -> Hook | None:
        return next((self.hooks[c] for c in hint.__mro__ if c in self.hooks), None) if isinstance(hint, type) else None

    def choice(self, node: Node, path: str, known: Collection[str], problem: str) -> str:
        """A word out of `known`."""
        if not isinstance(node, ScalarNode) or node.value not in known:
            raise refuse(node, path, problem + suggestion(node.value if isinstance(node, ScalarNode) else '', known))
        return node.value

    def mapping(self, node: Node, path: str) -> Fields:
        """Key -> (key node, value node) of a mapping node."""
        if isinstance(node, ScalarNode) and node.style is None and node.value in _NULL:
            raise refuse(node, path, 'is empty; a mapping of keys is wanted here (write {} for one without keys)')
        if not isinstance(node, MappingNode):
            remedy = (
                '; without quotes it is that of the file' if names_file(node) else _endings(node) or _whole_name(node)
            )
            raise refuse(node, path, f'must be a mapping of keys{remedy}')
        return {key.value: (key, value) for key, value in node.value}

    def construct(
        self,
        cls: type,
        fields: Fields,
        node: Node,
        path: str,
        *,
        name: str | None = None,
        given: Mapping[str, object] | None = None,
        extra: Sequence[str] = (),
    ) -> Any:
        """A dataclass from the fields of a mapping. given: values already known; extra: keys the caller understands
        itself."""
        hints = hints_of(cls)
        wanted = {f.name: f for f in keys_of(cls)}
        values: dict[str, object] = dict(given or {})
        if name is not None and 'name' in wanted:
            values['name'] = name
        for key, (key_node, value) in fields.items():
            field, ending = _field(key, wanted, hints)
            here = join(path, key)
            if field is None:
                allowed = [k for k in {*wanted, *extra} if k != 'name' or name is None]
                raise SceneError(
                    f'{where(key_node)}: {here}: unknown key{suggestion(key, allowed, with_units(wanted, hints))}'
                )
            if field in values:
                first = next((k for k in fields if k != key and _field(k, wanted, hints)[0] == field), '')
                remedy = f'{field!r} is given twice' + (
                    f', as {first!r} and as {key!r}; keep one of them' if first else ''
                )
                if field == 'name' and name is not None:
                    remedy = 'the name is the key of the entry'
                raise SceneError(f'{where(key_node)}: {here}: {remedy}')
            built = self.build(hints[field], value, here)
            values[field] = _scaled(built, UNITS[ending][1], value, here) if ending else built
            if unit_of(hints[field]) == 'm' and _largest(values[field]) > self.longest:
                raise refuse(value, here, f'is further than {self.longest:g} m: lengths are in m')
            self.require_within(hints[field], values[field], value, here, ending)
            if unit := ending or unit_of(hints[field]):
                self.units[here] = unit
        missing = [
            k for k, f in wanted.items() if k not in values and f.default is f.default_factory is dataclasses.MISSING
        ]
        if missing:
            raise SceneError(
                f'{where(node)}: {path}{": " if path else ""}the key {missing[0]!r} is missing{_meant(node)}'
            )
        try:
            return cls(**values)
        except SpecError as error:
            at = COMPLAINT.fullmatch(str(error))
            keys = node.value if isinstance(node, MappingNode) else []
            written = {_field(key.value, wanted, hints)[0] or key.value: value for key, value in keys}
            if at is not None and at['field'] in written:
                raise SceneError(f'{where(written[at["field"]])}: {join(path, at["field"])}{at["rest"]}') from None
            raise SceneError(f'{where(node)}: {path}{": " if path else ""}{error}') from None

    def require_within(self, hint: Any, value: Any, node: Node, path: str, ending: str = '') -> None:
        """Refuse a value [unit of the hint] that its meaning does not allow, and say in which unit it may be meant.
        ending: of its key."""
        bound = next((a for a in parts_of(hint) if isinstance(a, Within)), None)
        if bound is None or _largest(value) <= bound.most * (1.0 + BOUND_ROUNDING):
            return
        suffix, factor = next(
            ((s, UNITS[u][1]) for s, u in SUFFIXES.items() if UNITS[u][0] == unit_of(hint)), ('', math.inf)
        )
        meant = not ending and _largest(value) * factor <= bound.most
        remedy = f'; if it is in {SUFFIXES[suffix]}, write {path.rpartition(".")[2]}_{suffix}' if meant else ''
        raise refuse(node, path, f'is too large in {ending or unit_of(hint)} for {bound.what}{remedy}')

    def _union(self, args: tuple, node: Node, path: str, name: str | None) -> Any:
        empty = isinstance(node, ScalarNode) and node.style is None and node.value in _NULL
        if empty and types.NoneType in args:
            return None
        rest = [plain(a) for a in args if a is not types.NoneType]
        if len(rest) == 1:
            return self.build(rest[0], node, path, name)
        kinds = {kind: a for a in rest if dataclasses.is_dataclass(a) for kind in kinds_of(typing.cast(type, a))}
        if isinstance(node, MappingNode) and kinds:
            fields = self.mapping(node, path)
            implied = next((a for a in kinds.values() if getattr(a, 'implied', False)), None)
            if 'kind' not in fields and implied is not None:
                return self.build(implied, node, path, name)
            if 'kind' not in fields:
                raise SceneError(
                    f"{where(node)}: {path}: the key 'kind' is missing{_meant(node)}; one of: {', '.join(kinds)}"
                )
            chosen = typing.cast(type, kinds[self.choice(fields['kind'][1], join(path, 'kind'), kinds, 'unknown kind')])
            if any(f.name == 'kind' for f in dataclasses.fields(chosen)):
                return self.build(chosen, node, path, name)
            return self.build(
                chosen,
                MappingNode(node.tag, [e for e in node.value if e[0].value != 'kind'], node.start_mark),
                path,
                name,
            )
        fitting = [a for a in rest if self._hook(a) or fits(a, node)]
        if not fitting:
            raise refuse(
                node, path, 'must be ' + ' or '.join(dict.fromkeys(described(a) for a in rest)) + _endings(node)
            )
        return self.build(fitting[0], node, path, name)

    def _tuple(self, args: tuple, node: Node, path: str) -> tuple:
        repeated = len(args) == 2 and args[1] is Ellipsis
        if repeated and isinstance(node, MappingNode):
            item = plain(args[0])
            members = [plain(a) for a in get_args(item)] if get_origin(item) in (Union, types.UnionType) else [item]
            if all(
                dataclasses.is_dataclass(m) and any(f.name == 'name' for f in dataclasses.fields(m)) for m in members
            ):
                return tuple(
                    self.build(args[0], value, join(path, key), key)
                    for key, (_, value) in self.mapping(node, path).items()
                )
            if get_origin(item) is tuple and get_args(item)[0] is str and len(get_args(item)) == 2:
                entries = self.mapping(node, path).items()
                return tuple(
                    (key, self.build(get_args(item)[1], value, join(path, key))) for key, (_, value) in entries
                )
        if not isinstance(node, SequenceNode) or (not repeated and len(node.value) != len(args)):
            raise refuse(node, path, 'must be a list' + ('' if repeated else f' of {len(args)} values'))
        kinds = [args[0]] * len(node.value) if repeated else args
        return tuple(
            self.build(hint, item, f'{path}[{k}]') for k, (hint, item) in enumerate(zip(kinds, node.value, strict=True))
        )


def keys_of(cls: type) -> list[dataclasses.Field[Any]]:
    """The fields of a dataclass that files have keys for."""
    return [f for f in dataclasses.fields(cls) if f.init and f.metadata.get('key', True)]


@cache
def hints_of(cls: type) -> dict[str, Any]:
    """The type hints of a dataclass, with their units."""
    return typing.get_type_hints(cls, include_extras=True)


def plain(hint: Any) -> Any:
    """The type without its Annotated wrapping."""
    return get_args(hint)[0] if get_origin(hint) is Annotated else hint


def unit_of(hint: Any) -> str:
    """The unit of a hint: of Annotated[float, 'm'], and of what is in Length | None or tuple[Length, ...]; '' for none
    or several."""
    if get_origin(hint) is Annotated:
        return next((a for a in get_args(hint)[1:] if isinstance(a, str)), '')
    if get_origin(hint) not in (tuple, Union, types.UnionType):
        return ''
    units = {unit_of(a) for a in get_args(hint) if a not in (Ellipsis, types.NoneType)}
    return units.pop() if len(units) == 1 else ''


def parts_of(hint: Any) -> tuple[Any, ...]:
    """Entries beside the type in Annotated, also within Length | None or tuple[Length, ...]."""
    if get_origin(hint) is Annotated:
        return get_args(hint)[1:]
    if get_origin(hint) not in (tuple, Union, types.UnionType):
        return ()
    return tuple(part for a in get_args(hint) for part in parts_of(a))


def kinds_of(cls: type) -> tuple[str, ...]:
    """Names by which `kind` chooses a member of a union: the Literal of its field `kind`, or its class name in lower
    case."""
    hint = plain(hints_of(cls).get('kind'))
    if get_origin(hint) is Literal:
        return tuple(map(str, get_args(hint)))
    return (re.sub(r'(?<=[a-z0-9])(?=[A-Z])', '_', cls.__name__.removesuffix('Spec')).lower(),)


def fits(hint: Any, node: Node) -> bool:
    """True where the form of a node (scalar, list, mapping) is the one of a type; a scalar must also be a number for a
    number."""
    kind = get_origin(hint) or hint
    if isinstance(node, ScalarNode):
        number = node.style is None and is_number(node.value)
        return (kind in (float, int) and number) or kind in (str, bool, Literal)
    return (
        kind is tuple if isinstance(node, SequenceNode) else kind in (dict, Mapping) or dataclasses.is_dataclass(kind)
    )


def described(hint: Any) -> str:
    """A type in words."""
    kind = get_origin(hint) or hint
    words = {
        float: 'a number',
        int: 'a whole number',
        str: 'text',
        bool: 'true or false',
        tuple: 'a list',
        Literal: 'a choice',
    }
    return words.get(kind, 'a mapping')


def is_number(text: str) -> bool:
    """True where the text is a decimal number (YAML 1.2 core schema, without the special values)."""
    return bool(NUMBER.fullmatch(text)) and any(c.isdigit() for c in text.lower().partition('e')[0])


def _field(key: str, wanted: Mapping[str, object], hints: Mapping[str, Any]) -> tuple[str | None, str]:
    """The field that a key means, None for none, and the unit that the key ends in, '' where its value is in that of
    the field."""
    if key in wanted:
        return key, ''
    stem, _, suffix = key.rpartition('_')
    if stem in wanted and suffix in SUFFIXES and unit_of(hints[stem]) == UNITS[SUFFIXES[suffix]][0]:
        return stem, SUFFIXES[suffix]
    return None, ''


def with_units(wanted: Collection[str], hints: Mapping[str, Any]) -> list[str]:
    """The keys that the fields have with another unit: speed_kmh."""
    return [
        f'{key}_{suffix}'
        for key in wanted
        for suffix, unit in SUFFIXES.items()
        if unit_of(hints[key]) == UNITS[unit][0]
    ]


def _endings(node: Node) -> str:
    """Which files can be included, and how, where another one is named."""
    if how := unfit(node):
        return how
    named = (
        isinstance(node, ScalarNode) and node.style is None and INCLUDE.fullmatch(node.value) and not names_file(node)
    )
    return (
        f'; files that can stand for their content end in .yaml, {", ".join(READERS)}'
        if named and not is_number(node.value)
        else ''
    )


def _whole_name(node: Node) -> str:
    """Remark on the name of a file, where a word stands in its place."""
    word = (
        isinstance(node, ScalarNode)
        and node.style is None
        and re.fullmatch(r'[\w/-]+', node.value)
        and not is_number(node.value)
    )
    return f'; a file is named with its ending, as {node.value}.yaml' if word else ''


def _meant(node: Node) -> str:
    """Guess at the key that was meant where an override has added a mapping."""
    near = node.near if isinstance(node, AddedMapping) else ''
    return f' in what is new there; did you mean {near!r}?' if near else ''


def _scaled(value: Any, factor: float, node: Node, path: str) -> Any:
    """Numbers, None, and lists of them. Nobody knows which numbers have that unit in anything else that the field may
    hold."""
    if isinstance(value, tuple):
        return tuple(_scaled(v, factor, node, path) for v in value)
    if value is not None and not isinstance(value, float):
        raise refuse(node, path, 'must be a number, or a list of numbers, under a key that ends in its unit')
    return None if value is None else value * factor


def _largest(value: Any) -> float:
    """The largest magnitude of a number, or among those of nested lists of numbers; 0 for anything else."""
    if isinstance(value, tuple):
        return max(map(_largest, value), default=0.0)
    return abs(value) if isinstance(value, float | int) else 0.0


def _scalar(hint: Any, node: Node, path: str) -> Any:
    if hint not in (float, int, bool, str):
        raise TypeError(f'{path}: the loader does not know the type {hint!r}')
    if not isinstance(node, ScalarNode):
        raise refuse(node, path, f'must be {described(hint)}')
    text = node.value
    if hint is str:
        if node.style is None and text in _NULL:
            raise refuse(node, path, 'is empty; text is wanted here')
        return text
    if node.style is not None:
        raise refuse(node, path, f'is quoted text; must be {described(hint)} (remove the quotes)')
    if hint is bool:
        if text not in ('true', 'false'):
            raise refuse(node, path, 'must be true or false')
        return text == 'true'
    if text.lstrip('+-').lower() in ('.inf', '.nan', 'inf', 'nan'):
        raise refuse(node, path, 'must be finite')
    if not is_number(text):
        raise refuse(node, path, f'must be {described(hint)}, in decimal digits and without a unit')
    number = float(text)
    if not math.isfinite(number):
        raise refuse(node, path, 'must be finite')
    if hint is int:
        if not number.is_integer():
            raise refuse(node, path, 'must be a whole number')
        return int(number) if 'e' in text.lower() or '.' in text else int(text)
    return number
