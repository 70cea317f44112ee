"""YAML text as a tree of nodes that know their file and line, with every include in place; and a tree as text again.

A node is one of PyYAML's (mapping, sequence or scalar). No scalar is interpreted here: solver.files.schema does that by
type. solver.files.overrides changes a tree. The size of a file is bounded (see Extent): a short text with aliases or
includes can stand for more than any memory holds.

The file is long because a tree is read, put together and written by functions that share its nodes and its bounds.
"""

from __future__ import annotations

import dataclasses
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

# The tags that a value may have.
TAGS = tuple(
    f'tag:yaml.org,2002:{kind}'
    for kind in ('map', 'seq', 'str', 'int', 'float', 'bool', 'null', 'timestamp', 'merge', 'value')
)
MERGE = 'tag:yaml.org,2002:merge'  # the key <<
MOST_CHARACTERS = 1 << 20  # characters of a file and all its includes together: about five seconds of reading
MOST_KEPT = 1 << 16  # characters of a text whose nodes are kept in memory, for the next scene that includes it
MOST_VALUES = 100_000  # values in a file, with every alias and include expanded
MOST_FILES = 1000  # files that one file includes, counted as often as they are included
MOST_DEPTH = 64  # depth of nested values; ten times as much ends in Python's RecursionError
MOST_INCLUDED = 16  # depth of files that include each other
SHOWN = 60  # characters of a value that an error sentence shows


class AddedMapping(MappingNode):
    """A mapping that an override has added. near: a key beside it that may have been meant, or ''."""

    near = ''


def where(node: Node) -> str:
    """file:line of a node."""
    mark = node.start_mark
    return f'{mark.name}:{mark.line + 1}' if mark.line >= 0 else str(mark.name)


def shown(node: Node) -> str:
    """The value of a node for error sentences, in one line of at most SHOWN characters."""
    text = _short(_flow(node))
    if len(text) > SHOWN and isinstance(node, MappingNode):
        text = '{' + _short(f'{_short(_flow(key))}: ..., ' for key, _ in node.value).removesuffix(', ') + '}'
    return text if len(text) <= SHOWN else text[: SHOWN - 3] + '...'


def _short(pieces: Iterable[str]) -> str:
    """The first pieces, joined, until they have more than SHOWN characters: through an alias the pieces may be
    endless."""
    text = ''
    for piece in pieces:
        text += piece
        if len(text) > SHOWN:
            break
    return text


def _flow(node: Node) -> Iterator[str]:
    """Pieces of the text of a value in one line."""
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
    """The error about the value at `path`: place, path, value and remedy in one sentence."""
    return SceneError(f'{where(node)}: {path}{" = " if path else ""}{shown(node)}: {remedy}')


class Extent:
    """Counts what is read for one file with all its includes. Each method raises SceneError beyond its bound."""

    def __init__(self) -> None:
        self._values = self._characters = self._files = 0

    def text(self, text: str, name: str) -> None:
        """Count a text that is read."""
        self._characters += len(text)
        self._files += 1
        if self._characters > MOST_CHARACTERS:
            size = f'{self._characters} characters with the files that include it'
            raise SceneError(f'{name}: too long: {size}; at most {MOST_CHARACTERS} are read')
        if self._files > MOST_FILES:
            raise SceneError(f'{name}: more than {MOST_FILES} files are included')

    def value(self, node: Node) -> None:
        """Count a value that is looked at."""
        self._values += 1
        if self._values > MOST_VALUES:
            raise SceneError(
                f'{where(node)}: with every alias and include in place there are more than {MOST_VALUES} values'
            )


def parse(text: str, name: str, extent: Extent | None = None) -> Node:
    """Nodes of one YAML document. Raises SceneError for bad YAML, tags, duplicate keys, endless aliases and too much
    text.

    name: of the text in error sentences, e.g. a file name. extent: of the file that includes this text.
    """
    (extent or Extent()).text(text, name)
    return _copy(_composed(text, name), {}) if len(text) <= MOST_KEPT else _composed.__wrapped__(text, name)


@lru_cache(maxsize=32)
def _composed(text: str, name: str) -> Node:
    """The checked nodes of a text, kept: sweeps and comparisons read the same few files for many scenes."""
    try:
        node = yaml.compose(text, Loader=_loader(name))
    except RecursionError:
        raise SceneError(f'{name}: values are nested more than {MOST_DEPTH} deep') from None
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
    """A copy of a node with all nodes below it; nodes that aliases share are shared in the copy too. known: id ->
    copy."""
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
    """PyYAML loader whose marks have this file name."""

    class Named(yaml.SafeLoader):
        def __init__(self, stream):
            super().__init__(stream)
            self.name = name

    return Named


def _check(node: Node, path: str, above: tuple[int, ...], extent: Extent) -> None:
    """Raise SceneError for what parse() refuses in a node at `path`. above: ids of the nodes around it."""
    if id(node) in above:
        raise SceneError(f'{where(node)}: {path[:SHOWN]} contains itself through an alias')
    if len(above) > MOST_DEPTH:
        raise SceneError(f'{where(node)}: values are nested more than {MOST_DEPTH} deep')
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
                remedy = 'write it, and the name of its file, without them'
                raise SceneError(f"{where(key)}: {here}: the key '<<' is in quotes: {remedy}")
            if key.tag == MERGE and not (names_file(value) and value.style is None):
                what = 'must be the name of a file, without quotes: its content is changed by the keys beside <<'
                raise refuse(value, here, what + unfit(value))
            if key.value in first:
                raise SceneError(
                    f'{where(key)}: {here}: the key is given twice (first in line '
                    f'{first[key.value].start_mark.line + 1})'
                )
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
    """Read a YAML file with all files that it refers to.

    A value without quotes that ends in .yaml, or in one of READERS, is a file name, and is replaced by the content of
    that file. It is looked up beside the file, one directory above it, and in `roots`. above: files that include this
    one. extent: of the outermost file. given: coefficients that replace those of a tire file. Raises SceneError for a
    file that is missing, unreadable or includes itself, and beyond the bounds of Extent.
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
        if not text:  # a binary file counts by the text that stands for it in the resolved scene
            extent.text(text_of(node), name)
        return node
    directories = [file.parent, file.parent.parent, *roots]
    return include(parse(read_text(file), name, extent), directories, (*above, file.resolve()), extent=extent)


def displayed(file: Path) -> str:
    """Name of a file in error sentences: relative to the current directory if the file is below it, else absolute."""
    path = file.resolve()
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)


def read_text(file: Path, errors: str = 'strict') -> str:
    """Content of a text file. Raises SceneError if it cannot be read or is too long."""
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
    """Replace file names by the content of the files (see read); returns the node, changed in place.

    directories: where files are looked up. above, extent, given: see read. path: of the node, for error sentences.
    """
    extent = extent or Extent()
    extent.value(node)
    if isinstance(node, SequenceNode):
        node.value = [include(item, directories, above, f'{path}[{k}]', extent) for k, item in enumerate(node.value)]
    elif isinstance(node, MappingNode):
        beside = _coefficients(node)
        entries = [
            (
                key,
                include(value, directories, above, join(path, key.value), extent, beside if key.tag == MERGE else None),
            )
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
    """Coefficients under the key `values` of a mapping whose `<<` names a tire file; they replace those of the file."""
    base = next((value for key, value in node.value if key.tag == MERGE), None)
    values = next((value for key, value in node.value if key.value == 'values'), None)
    if not (isinstance(base, ScalarNode) and base.value.endswith('.tir') and isinstance(values, MappingNode)):
        return {}
    given = {}
    for key, value in values.value:
        if key.value not in DEFAULTS:
            raise refuse(
                value, f'values.{key.value}', 'is not a coefficient of this model' + suggestion(key.value, DEFAULTS)
            )
        if not (isinstance(value, ScalarNode) and value.tag.endswith((':float', ':int'))):
            raise refuse(value, f'values.{key.value}', 'must be a number')
        given[key.value] = Given(float(yaml.safe_load(value.value)), where(value))
    return given


def _is_whole(node: Node) -> bool:
    """True where a mapping is the content of a file that is no YAML (a tire, say): it replaces another one as a
    whole."""
    return node.start_mark.line < 0 and Path(str(node.start_mark.name)).suffix in READERS


def _changed(base: MappingNode, changes: MappingNode) -> MappingNode:
    """The mapping `base` with the values of `changes`.

    A mapping in it is changed likewise, unless it becomes another `kind` or another tire. All other values are
    replaced, also those that stand there under the same key with another unit.
    """
    result = MappingNode(base.tag, list(base.value), base.start_mark, base.end_mark, flow_style=base.flow_style)
    for key, value in changes.value:
        at = place_of(result, key.value, not isinstance(value, MappingNode))
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
    """Value of the key `kind`, or ''."""
    return next((str(value.value) for key, value in node.value if key.value == 'kind'), '')


def node_of(value: Any, mark: Any) -> Node:
    """A value as nodes: dataclasses and mappings as mappings, floats with all their digits, text in quotes."""
    if dataclasses.is_dataclass(value):
        value = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return MappingNode(
            TAGS[0], [(ScalarNode(TAGS[2], k, mark, mark), node_of(v, mark)) for k, v in value.items()], mark, mark
        )
    if isinstance(value, tuple | list):
        return SequenceNode(TAGS[1], [node_of(v, mark) for v in value], mark, mark, flow_style=True)
    if isinstance(value, str):
        return ScalarNode(TAGS[2], value, mark, mark, style="'")
    text = 'null' if value is None else str(value).lower() if isinstance(value, bool) else repr(value)
    return ScalarNode(yaml.resolver.Resolver().resolve(ScalarNode, text, (True, False)), text, mark, mark)


def text_of(node: Node) -> str:
    """YAML text of a node; parse() of it gives the same values again, with every include expanded.

    The text of every entry of a mapping is kept for the next one that has it: scenes of a sweep differ in one of them.
    """
    if not isinstance(node, MappingNode) or node.flow_style or not node.value or content_of(node) is None:
        return _serialized(node)
    pieces = [_text_of_entry(_Entry(node, entry)) for entry in node.value]
    if any(piece.endswith('...\n') for piece in pieces):  # the end of a document, which none of them is
        return _serialized(node)
    return ''.join(pieces)


def _serialized(node: Node) -> str:
    text: str = yaml.serialize(node, width=140, allow_unicode=True)
    return text


class _Entry:
    """An entry of a block mapping, equal to one that has the same text."""

    def __init__(self, node: MappingNode, entry: tuple[Node, Node]) -> None:
        self.alone = MappingNode(node.tag, [entry], node.start_mark, node.end_mark, flow_style=node.flow_style)
        self._content = content_of(self.alone)

    def __hash__(self) -> int:
        return hash(self._content)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Entry) and self._content == other._content


@lru_cache(maxsize=64)
def _text_of_entry(entry: _Entry) -> str:
    return _serialized(entry.alone)


def content_of(node: Node) -> tuple | None:
    """Everything that makes the text of a node and its values, to be compared; None where aliases share nodes in it."""
    seen: set[int] = set()

    def content(node: Node) -> tuple:
        if id(node) in seen:
            raise LookupError
        seen.add(id(node))
        if isinstance(node, ScalarNode):
            return node.tag, node.value, node.style
        if isinstance(node, SequenceNode):
            return node.tag, node.flow_style, tuple([content(item) for item in node.value])
        assert isinstance(node, MappingNode)
        return node.tag, node.flow_style, tuple([(content(key), content(value)) for key, value in node.value])

    try:
        return content(node)
    except LookupError:
        return None


def place_of(node: MappingNode, key: str, last: bool) -> int | None:
    """Index of a key among the entries of a mapping, None where it is missing.

    last: whether it is the last key of a path. Then a number or a list under the same key with another unit is found
    too.
    """
    words = [entry.value for entry, _ in node.value]
    if key in words or not last:
        return words.index(key) if key in words else None
    plain = (
        not isinstance(value, MappingNode) and bare(word) == bare(key)
        for word, (_, value) in zip(words, node.value, strict=True)
    )
    return next((k for k, same in enumerate(plain) if same), None)


def bare(key: str) -> str:
    """A key without its unit: length of length_mm."""
    stem, _, suffix = key.rpartition('_')
    return stem if stem and suffix in SUFFIXES else key
