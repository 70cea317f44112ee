"""YAML text as a tree of nodes that know their file and line: includes, overrides and the way back to text.

A node is one of PyYAML's (mapping, sequence or scalar). No scalar is interpreted here; solver.files.schema does that by
type. The size of a file is bounded (see Extent): a short text with aliases or includes can stand for more than any
memory holds.
"""

from __future__ import annotations

import dataclasses
import difflib
import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from solver.elements.tire_data import DEFAULTS
from solver.errors import SceneError, suggestion
from solver.files.naming import READERS, find, listing, names_file, one_folder_down, unfit
from solver.files.tir import Given, read_tir
from solver.units import SUFFIXES

TAGS = tuple(f'tag:yaml.org,2002:{kind}' for kind in ('map', 'seq', 'str', 'int', 'float', 'bool', 'null', 'timestamp', 'merge', 'value'))
MERGE = 'tag:yaml.org,2002:merge'  # the key <<
MOST_CHARACTERS = 1 << 20  # of all files together: about five seconds of reading
MOST_KEPT = 1 << 16  # characters of a text whose nodes are kept
MOST_VALUES = 100_000  # with every alias and include expanded
MOST_FILES = 1000
MOST_DEPTH = 64  # of values in each other
MOST_INCLUDED = 16  # files in each other
SHOWN = 60  # characters of a value in an error sentence


class AddedMapping(MappingNode):
    """A mapping that an override has added. near: a name beside it that may have been meant, or ''."""

    near = ''


def where(node: Node) -> str:
    """file:line of a node."""
    mark = node.start_mark
    return f'{mark.name}:{mark.line + 1}' if mark.line >= 0 else str(mark.name)


def shown(node: Node) -> str:
    """A short rendering of a node's value for error sentences."""
    text = _short(_flow(node))
    if len(text) > SHOWN and isinstance(node, MappingNode):
        text = '{' + _short(f'{_short(_flow(key))}: ..., ' for key, _ in node.value).removesuffix(', ') + '}'
    return text if len(text) <= SHOWN else text[: SHOWN - 3] + '...'


def _short(pieces: Iterable[str]) -> str:
    """The pieces together, as far as they are shown: a value may be endless through an alias."""
    text = ''
    for piece in pieces:
        text += piece
        if len(text) > SHOWN:
            break
    return text


def _flow(node: Node) -> Iterator[str]:
    """A value in one line, piece by piece."""
    if isinstance(node, ScalarNode):
        yield node.value if node.style is None else repr(node.value[: SHOWN + 1])
        return
    yield '[' if isinstance(node, SequenceNode) else '{'
    for k, item in enumerate(node.value):
        yield ', ' if k else ''
        key, value = (None, item) if isinstance(node, SequenceNode) else item
        if key is not None:
            yield from _flow(key)
            yield ': '
        yield from _flow(value)
    yield ']' if isinstance(node, SequenceNode) else '}'


def refuse(node: Node, path: str, remedy: str) -> SceneError:
    """The error sentence about a value."""
    return SceneError(f'{where(node)}: {path}{" = " if path else ""}{shown(node)}: {remedy}')


class Extent:
    """Amount that has been read for one file with all that it includes. Each method raises SceneError for too much."""

    def __init__(self) -> None:
        self._values = self._characters = self._files = 0

    def text(self, text: str, name: str) -> None:
        """A text is read."""
        self._characters += len(text)
        self._files += 1
        if self._characters > MOST_CHARACTERS:
            raise SceneError(f'{name}: too long: with what includes it, {self._characters} characters; at most {MOST_CHARACTERS} are read')
        if self._files > MOST_FILES:
            raise SceneError(f'{name}: more than {MOST_FILES} files are included')

    def value(self, node: Node) -> None:
        """A value is looked at."""
        self._values += 1
        if self._values > MOST_VALUES:
            raise SceneError(f'{where(node)}: with every alias and include in place there are more than {MOST_VALUES} values')


def parse(text: str, name: str, extent: Extent | None = None) -> Node:
    """Compose one YAML document and check what no type needs to be known for: tags, duplicate keys, endless aliases, its extent.

    name: what error sentences call the text (a file name). extent: of the file that includes it. Raises SceneError.
    """
    (extent or Extent()).text(text, name)
    return _copy(_composed(text, name), {}) if len(text) <= MOST_KEPT else _composed.__wrapped__(text, name)


@lru_cache(maxsize=32)
def _composed(text: str, name: str) -> Node:
    """The node of a text, checked; the same again for the same text: who drives or compares many scenes reads few files."""
    try:
        node = yaml.compose(text, Loader=_loader(name))
    except RecursionError:
        raise SceneError(f'{name}: more than {MOST_DEPTH} values in each other') from None
    except yaml.YAMLError as error:
        mark = getattr(error, 'problem_mark', None)
        line = f':{mark.line + 1}' if mark is not None else ''
        problem = getattr(error, 'problem', None) or getattr(error, 'reason', None) or str(error)
        raise SceneError(f'{name}{line}: not readable as YAML: {" ".join(str(problem).split())}') from None
    if node is None:
        raise SceneError(f'{name}: the file is empty')
    _check(node, '', (), Extent())
    return node


def _copy(node: Node, known: dict[int, Node]) -> Node:
    """A node to be changed, with all below it; what aliases share stays shared."""
    found = known.get(id(node))
    if found is not None:
        return found
    new: Node
    if isinstance(node, ScalarNode):
        new = ScalarNode(node.tag, node.value, node.start_mark, node.end_mark, style=node.style)
    elif isinstance(node, SequenceNode):
        items = [_copy(item, known) for item in node.value]
        new = SequenceNode(node.tag, items, node.start_mark, node.end_mark, flow_style=node.flow_style)
    else:
        assert isinstance(node, MappingNode)
        entries = [(_copy(key, known), _copy(value, known)) for key, value in node.value]
        new = MappingNode(node.tag, entries, node.start_mark, node.end_mark, flow_style=node.flow_style)
    known[id(node)] = new
    return new


def _loader(name: str):
    class Named(yaml.SafeLoader):
        def __init__(self, stream):
            super().__init__(stream)
            self.name = name

    return Named


def _check(node: Node, path: str, above: tuple[int, ...], extent: Extent) -> None:
    if id(node) in above:
        raise SceneError(f'{where(node)}: {path[:SHOWN]} contains itself through an alias')
    if len(above) > MOST_DEPTH:
        raise SceneError(f'{where(node)}: more than {MOST_DEPTH} values in each other')
    extent.value(node)
    if node.tag not in TAGS:
        raise refuse(node, path, f'the tag {node.tag} is not allowed; write plain values')
    above = (*above, id(node))
    if isinstance(node, SequenceNode):
        for k, item in enumerate(node.value):
            _check(item, f'{path}[{k}]', above, extent)
    if isinstance(node, MappingNode):
        first: dict[str, Node] = {}
        for key, value in node.value:
            if not isinstance(key, ScalarNode):
                raise refuse(key, path, 'a key must be a word')
            here = join(path, key.value)
            if key.value == '<<' and key.style is not None:
                raise SceneError(f"{where(key)}: {here}: the key '<<' is in quotes: write it, and the name of its file, without them")
            if key.tag == MERGE and not (names_file(value) and value.style is None):
                what = 'must be the name of a file, without quotes: the mapping is that, changed by the keys beside it'
                raise refuse(value, here, what + unfit(value))
            if key.value in first:
                raise SceneError(f'{where(key)}: {here}: the key is given twice (first in line {first[key.value].start_mark.line + 1})')
            first[key.value] = key
            _check(value, here, above, extent)


def join(path: str, key: str) -> str:
    """Dotted path of a key."""
    return f'{path}.{key}' if path else key


def read(
    file: Path,
    roots: Sequence[Path],
    above: tuple[Path, ...] = (),
    extent: Extent | None = None,
    given: Mapping[str, Given] | None = None,
) -> Node:
    """Read a YAML file with everything it refers to.

    A value that is a file name (without quotes) ending in .yaml, or in one of READERS, is replaced by the content of that file, looked up
    beside the file, one directory above it, and in roots. Raises SceneError for files that are missing, unreadable or that
    include themselves, and for too much of all. extent: of the file that includes this one. given: coefficients beside a tire file.
    """
    extent = extent or Extent()
    if '\0' in str(file):
        raise SceneError(f'{str(file)!r}: no file has a NUL in its name')
    name = displayed(file)
    if len(above) >= MOST_INCLUDED:
        raise SceneError(f'{name}: more than {MOST_INCLUDED} files include each other')
    reader = READERS.get(file.suffix)
    if reader is not None:
        text = read_text(file, errors='replace') if reader is read_tir else ''
        extent.text(text, name)
        content = read_tir(name, given) if reader is read_tir else reader(Path(name))
        node = node_of(content, yaml.Mark(name, 0, -1, 0, None, 0))
        if not text:  # of what is no text counts what stands for it in the resolved text
            extent.text(text_of(node), name)
        return node
    directories = [file.parent, file.parent.parent, *roots]
    return include(parse(read_text(file), name, extent), directories, (*above, file.resolve()), extent=extent)


def displayed(file: Path) -> str:
    """Name of a file in error sentences: relative to the current directory where it lies below it."""
    path = file.resolve()
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)


def read_text(file: Path, errors: str = 'strict') -> str:
    """Content of a text file; SceneError when it cannot be read, or is too long."""
    try:
        size = file.stat().st_size
        if size > 4 * MOST_CHARACTERS:
            raise SceneError(f'{file}: too long: {size} bytes; at most {MOST_CHARACTERS} characters are read')
        return file.read_text(encoding='utf-8', errors=errors)
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f'{file}: cannot be read: {getattr(error, "strerror", None) or "is not UTF-8 text"}') from None


def include(
    node: Node,
    directories: Sequence[Path],
    above: tuple[Path, ...] = (),
    path: str = '',
    extent: Extent | None = None,
    given: Mapping[str, Given] | None = None,
) -> Node:
    """Replace references to files by their content (see read); returns the node, changed in place. given: beside a tire file."""
    extent = extent or Extent()
    extent.value(node)
    if isinstance(node, SequenceNode):
        node.value = [include(item, directories, above, f'{path}[{k}]', extent) for k, item in enumerate(node.value)]
    elif isinstance(node, MappingNode):
        beside = _coefficients(node)
        entries = [
            (key, include(value, directories, above, join(path, key.value), extent, beside if key.tag == MERGE else None))
            for key, value in node.value
        ]
        node.value = [entry for entry in entries if entry[0].tag != MERGE]
        for base in [value for key, value in entries if key.tag == MERGE]:
            if not isinstance(base, MappingNode):
                raise refuse(base, join(path, '<<'), 'must be a file of keys and values')
            node.value = _changed(base, node).value
    elif isinstance(node, ScalarNode) and node.style is None and names_file(node):
        file = find(node.value, directories)
        if file is None:
            if (deeper := one_folder_down(node.value, directories)) is not None:
                raise refuse(node, path, f'no such file; did you mean {deeper!r}?')
            known = sorted({name for d in directories for name in listing(d, Path(node.value))})
            raise refuse(node, path, 'no such file' + suggestion(node.value, known))
        if file.resolve() in above:
            raise refuse(node, path, 'the file includes itself')
        return read(file, directories, above, extent, given)
    return node


def _coefficients(node: MappingNode) -> dict[str, Given]:
    """The coefficients under `values` beside the file of a tire, which completes it where it is read."""
    base = next((value for key, value in node.value if key.tag == MERGE), None)
    values = next((value for key, value in node.value if key.value == 'values'), None)
    if not (isinstance(base, ScalarNode) and base.value.endswith('.tir') and isinstance(values, MappingNode)):
        return {}
    given = {}
    for key, value in values.value:
        if key.value not in DEFAULTS:
            raise refuse(value, f'values.{key.value}', 'is not a coefficient of this model' + suggestion(key.value, DEFAULTS))
        if not (isinstance(value, ScalarNode) and value.tag.endswith((':float', ':int'))):
            raise refuse(value, f'values.{key.value}', 'must be a number')
        given[key.value] = Given(float(yaml.safe_load(value.value)), where(value))
    return given


def _is_whole(node: Node) -> bool:
    """True where a mapping is the content of a file that is no YAML: another tire has nothing of the one before it."""
    return node.start_mark.line < 0 and Path(str(node.start_mark.name)).suffix in READERS


def _changed(base: MappingNode, changes: MappingNode) -> MappingNode:
    """A mapping with the values of another: mappings in it are changed likewise, unless they become another `kind` or tire; all else is
    replaced, also where it has another unit there (see override)."""
    result = MappingNode(base.tag, list(base.value), base.start_mark, base.end_mark, flow_style=base.flow_style)
    for key, value in changes.value:
        at = _place(result, key.value, not isinstance(value, MappingNode))
        if at is None:
            result.value.append((key, value))
            continue
        old = result.value[at][1]
        same = isinstance(old, MappingNode) and isinstance(value, MappingNode) and _kind(value) in ('', _kind(old))
        if same and not _is_whole(value):
            value = _changed(old, value)
        result.value[at] = (key, value)
    return result


def _kind(node: MappingNode) -> str:
    """Text under the key `kind`, or ''."""
    return next((str(value.value) for key, value in node.value if key.value == 'kind'), '')


def node_of(value: Any, mark: Any) -> Node:
    """The node that stands for a value: dataclasses and mappings as mappings, floats with all their digits, text in quotes."""
    if dataclasses.is_dataclass(value):
        value = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return MappingNode(TAGS[0], [(ScalarNode(TAGS[2], k, mark, mark), node_of(v, mark)) for k, v in value.items()], mark, mark)
    if isinstance(value, tuple | list):
        return SequenceNode(TAGS[1], [node_of(v, mark) for v in value], mark, mark, flow_style=True)
    if isinstance(value, str):
        return ScalarNode(TAGS[2], value, mark, mark, style="'")
    text = 'null' if value is None else str(value).lower() if isinstance(value, bool) else repr(value)
    return ScalarNode(yaml.resolver.Resolver().resolve(ScalarNode, text, (True, False)), text, mark, mark)


def text_of(node: Node) -> str:
    """YAML text of a node; parse() of it gives the same values again, with every include expanded."""
    return yaml.serialize(node, width=140, allow_unicode=True)


def keys_of(path: str) -> tuple[str, ...]:
    """The keys of the path of an override: a.b[0] and a.b.0 are the same."""
    return tuple(key for key in re.split(r'[.\[\]]+', path.strip()) if key)


def overtaken(assignments: Sequence[str]) -> tuple[str, str] | None:
    """An override without effect and the one behind it that replaces all around it; None where there is none."""
    paths = [keys_of(assignment.partition('=')[0]) for assignment in assignments]
    pairs = itertools.combinations(zip(paths, assignments, strict=True), 2)
    return next(((a, b) for (part, a), (whole, b) in pairs if whole and len(whole) < len(part) and part[: len(whole)] == whole), None)


def override(root: Node, assignment: str, directories: Sequence[Path]) -> None:
    """Apply 'a.b.c=value' (value in YAML; list items as a.b.0 or a.b[0]) to a node tree in place; missing mappings are
    created. A value under the same key with another unit (a.b.c_mm) is replaced. Other places that stand for the same
    part by an alias stay as they are."""
    path, equals, text = assignment.partition('=')
    keys = keys_of(path)
    name = f'--set {path.strip()}'
    if not equals or not keys:
        raise SceneError(f'--set {assignment!r}: write it as path.to.key=value')
    value = parse(text.strip() or "''", name)
    _set_line(value, name)
    value = include(value, directories)
    node = root
    for depth, key in enumerate(keys):
        last = depth == len(keys) - 1
        if isinstance(node, SequenceNode):
            if not (key.isdigit() and int(key) < len(node.value)):
                raise SceneError(f'{name}: {".".join(keys[:depth])} is a list of {len(node.value)}; {key!r} is not one of its indices')
            node.value[int(key)] = value if last else _alone(node.value[int(key)])
            node = node.value[int(key)]
            continue
        if not isinstance(node, MappingNode):
            raise SceneError(f'{name}: {".".join(keys[:depth])} = {shown(node)} is a plain value and has no {key!r} in it')
        at = _place(node, key, last)
        child = value if last else (_added(node, key, value) if at is None else _alone(node.value[at][1]))
        if at is None:
            node.value.append((ScalarNode(TAGS[2], key, value.start_mark, value.end_mark), child))
        else:
            entry = node.value[at][0]
            node.value[at] = (entry if entry.value == key else ScalarNode(TAGS[2], key, value.start_mark, value.end_mark), child)
        node = child


def _alone(node: Node) -> Node:
    """A node with entries of its own, as what is changed must have: an alias stands for it in other places too."""
    if not isinstance(node, MappingNode | SequenceNode):
        return node
    return type(node)(node.tag, list(node.value), node.start_mark, node.end_mark, flow_style=node.flow_style)


def _added(parent: MappingNode, key: str, value: Node) -> AddedMapping:
    node = AddedMapping(TAGS[0], [], value.start_mark, value.end_mark)
    node.near = next(iter(difflib.get_close_matches(key, [entry.value for entry, _ in parent.value], n=1)), '')
    return node


def _place(node: MappingNode, key: str, last: bool) -> int | None:
    """Place of a key in a mapping; the last key of a path is also found where a number, or a list, has it with another
    unit."""
    words = [entry.value for entry, _ in node.value]
    if key in words or not last:
        return words.index(key) if key in words else None
    plain = (not isinstance(value, MappingNode) and bare(word) == bare(key) for word, (_, value) in zip(words, node.value, strict=True))
    return next((k for k, same in enumerate(plain) if same), None)


def bare(key: str) -> str:
    """A key without the unit it ends in."""
    stem, _, suffix = key.rpartition('_')
    return stem if stem and suffix in SUFFIXES else key


def _set_line(node: Node, name: str) -> None:
    if node.start_mark.name == name:
        node.start_mark = yaml.Mark(name, 0, -1, 0, None, 0)
    for child in node.value if not isinstance(node, ScalarNode) else ():
        for part in child if isinstance(child, tuple) else (child,):
            _set_line(part, name)
