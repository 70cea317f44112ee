"""Random damage to texts, YAML trees, recordings and command lines; the same for the same random numbers."""

from __future__ import annotations

import copy
import re
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

TEXT = 'tag:yaml.org,2002:str'
WORDS = (
    '0', '-0', '-1', '1', '2', '1e300', '-1e300', '1e-300', '1e308', '5e-324', '1e7', '1000000', '2147483648',
    '18446744073709551616',
    '9' * 40, '9' * 5000, '0.1', '1e-3', '.nan', '.inf', '-.inf', 'nan', 'inf', 'true', 'false', 'yes', 'no', 'null',
    '~', '""', "''", '',
    'abc', 'name', 'world', 'W', 'chassis', '[]', '{}', '[1, '
        '2]', '[1, 2, 3]', '[0, 0, 0]', '[[]]', '[nan, 0, 0]', '{a: 1}', '{kind: {}}',
    '{kind: table}', '&a [*a]', '*b', '&c 1', '!!python/name:os.system', '!odd '
        '1', '1 %', '2 m', '-3 deg', '5 ms', '1 %%', 'ä\u2028b',
    '\x00', '\t', '- 1', ': 1', 'x.yaml', '../../x.yaml', '/dev/zero', '/proc/self/mem', '/etc/passwd', 'scene.yaml',
    'a.tir', 'x' * 5000,
    '0x10', '0o7', '1_000', '1:30', '2001-01-01', '%', '|', '>', '@', '`', '?', '<<: {a: '
        '1}', '[' * 200, '{a: ' * 200, '1.', '.5', '+1',
    '\ud7ff', '\U0001f600', 'step_steer', 'full', 'off', 'on', 'auto', 'kc', 'single_track', 'condensed', 'rk4',
    'radau',
)  # fmt: skip


def pick(rng: np.random.Generator, items: Sequence) -> object:
    """One of them."""
    return items[int(rng.integers(len(items)))]


def word(rng: np.random.Generator, text: str = '') -> str:
    """Something odd in the place of a value; often a number near the one that was there."""
    try:
        number = float(text)
    except ValueError:
        return str(pick(rng, WORDS))
    kind = rng.random()
    if kind < 0.4:
        return str(pick(rng, WORDS))
    if kind < 0.6:
        return repr(-number)
    return (
        repr(number * 10.0 ** float(rng.integers(-6, 7)))
        if kind < 0.8
        else repr(number * (1.0 + 0.5 * float(rng.standard_normal())))
    )


def damage_bytes(rng: np.random.Generator, data: bytes) -> bytes:
    """Some bytes flipped, put in, taken out, doubled, or the end cut off."""
    raw = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        if not raw:
            break
        at, n = int(rng.integers(len(raw))), int(rng.integers(1, 40))
        kind = int(rng.integers(6))
        if kind <= 1:
            raw[at] ^= 1 << int(rng.integers(8))
        elif kind == 2:
            raw[at : at + n] = rng.bytes(n)
        elif kind == 3:
            del raw[at : at + n]
        elif kind == 4:
            raw[at:at] = raw[at : at + n]
        else:
            del raw[at:]
    return bytes(raw)


def damage_yaml(rng: np.random.Generator, text: str) -> bytes:
    """A YAML text with one to three things in it changed: mostly well formed, sometimes not."""
    if rng.random() < 0.15:
        return damage_bytes(rng, text.encode())
    if rng.random() < 0.2:
        return _raw(rng, text)
    root = _tree(text)
    if rng.random() < 0.4:  # still well formed: only numbers are others
        numbers = [node for node in _scalars(root) if re.fullmatch(r'[-+]?[0-9.]+(e[-+]?[0-9]+)?', node.value)]
        for _ in range(int(rng.integers(1, 4))):
            node = numbers[int(rng.integers(len(numbers)))] if numbers else ScalarNode(TEXT, '1')
            power = float(rng.choice(np.array([0.1, 0.5, 3.0, 12.0])))
            sign = float(rng.choice(np.array([1.0, 1.0, -1.0, 0.0])))
            number = repr(float(node.value) * sign * 10.0 ** (power * float(rng.standard_normal())))
            if 'e' in number and '.' not in number:
                number = number.replace('e', '.0e')
            node.value, node.tag = number, _tag(number)
        return yaml.serialize(root, allow_unicode=True).encode()
    for _ in range(int(rng.integers(1, 4))):
        places: list[tuple[Node, int]] = []
        _places(root, places)
        if not places:
            break
        _change(rng, root, places)
    return yaml.serialize(root, allow_unicode=True).encode('utf-8', 'surrogatepass')


def _tree(text: str) -> Node:
    node = yaml.compose(text, Loader=yaml.SafeLoader)
    assert node is not None
    return node


def _scalars(node: Node) -> list[ScalarNode]:
    if isinstance(node, ScalarNode):
        return [node]
    children = node.value if isinstance(node, SequenceNode) else [value for _, value in node.value]
    return [scalar for child in children for scalar in _scalars(child)]


def _tag(text: str) -> str:
    """The tag with which a text is written without quotes."""
    return yaml.resolver.Resolver().resolve(ScalarNode, text, (True, False))


def _raw(rng: np.random.Generator, text: str) -> bytes:
    """A value replaced by characters as they are."""
    root = _tree(text)
    places: list[tuple[Node, int]] = []
    _places(root, places)
    node, k = places[int(rng.integers(len(places)))]
    item = node.value[k] if isinstance(node, SequenceNode) else node.value[k][int(rng.integers(2))]
    begin, end = item.start_mark.index, item.end_mark.index
    return (text[:begin] + word(rng, text[begin:end]) + text[end:]).encode('utf-8', 'surrogatepass')


def _places(node: Node, found: list[tuple[Node, int]], depth: int = 0) -> None:
    """Where the entries of all collections are."""
    if isinstance(node, ScalarNode) or depth > 40 or len(found) > 20_000:
        return
    for k, entry in enumerate(node.value):
        found.append((node, k))
        _places(entry if isinstance(node, SequenceNode) else entry[1], found, depth + 1)


def _change(rng: np.random.Generator, root: Node, places: list[tuple[Node, int]]) -> None:
    node, k = places[int(rng.integers(len(places)))]
    sequence = isinstance(node, SequenceNode)
    item = node.value[k] if sequence else node.value[k][1]

    def put(value: Node) -> None:
        node.value[k] = value if sequence else (node.value[k][0], value)

    kind = int(rng.integers(11))
    if kind <= 3:
        text = item.value if isinstance(item, ScalarNode) else ''
        style = None if rng.random() < 0.9 else "'"
        new = word(rng, text).replace('\x00', '')
        put(ScalarNode(_tag(new) if style is None else TEXT, new, style=style))
    elif kind == 4:
        del node.value[k]
    elif kind == 5:
        node.value.insert(int(rng.integers(len(node.value) + 1)), copy.deepcopy(node.value[k]))
    elif kind == 6 and not sequence:
        node.value[k] = (
            ScalarNode(TEXT, str(pick(rng, ('', 'x', 'name', 'kind', 'i', 'toe_deg', 'mass', '0', 'a.b', 'record')))),
            item,
        )
    elif kind == 7:
        other, j = places[int(rng.integers(len(places)))]
        put(copy.deepcopy(other.value[j] if isinstance(other, SequenceNode) else other.value[j][1]))
    elif kind == 8:
        put(SequenceNode('tag:yaml.org,2002:seq', [item] * int(rng.integers(4))))
    elif kind == 9:
        put(MappingNode('tag:yaml.org,2002:map', [(ScalarNode(TEXT, 'kind'), item)]))
    else:
        put(root if rng.random() < 0.1 else item)


def damage_text(rng: np.random.Generator, text: str) -> bytes:
    """A text of lines `key = value` or of cells with some changed."""
    if rng.random() < 0.3:
        return damage_bytes(rng, text.encode())
    lines = text.splitlines()
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(len(lines)))
        head, equals, value = lines[at].partition('=')
        kind = int(rng.integers(5))
        if kind <= 1 and equals:
            lines[at] = f'{head}= {word(rng, value.split("$")[0].strip())}'
        elif kind <= 1:
            cells = lines[at].split(',')
            cells[int(rng.integers(len(cells)))] = word(rng, cells[0])
            lines[at] = ','.join(cells)
        elif kind == 2:
            del lines[at]
        elif kind == 3:
            lines.insert(at, lines[int(rng.integers(len(lines)))])
        else:
            lines[at] = word(rng)
        if not lines:
            break
    return '\n'.join(lines).encode('utf-8', 'surrogatepass')


def damage_bag(rng: np.random.Generator, file: Path) -> bytes:
    """A recording with damaged bytes; or written anew, all checksums right, with damaged messages, definitions, names
    or times."""
    if rng.random() < 0.5:
        return damage_bytes(rng, file.read_bytes())
    import io

    from mcap.reader import make_reader
    from mcap.writer import Writer

    with file.open('rb') as stream:
        reader = make_reader(stream)
        records = [
            (schema, channel, message) for schema, channel, message in reader.iter_messages() if schema is not None
        ]
        metadata = [(record.name, dict(record.metadata)) for record in reader.iter_metadata()]
    out = io.BytesIO()
    writer = Writer(out)
    writer.start(profile='ros2', library='fuzz')
    what = int(rng.integers(6))
    for name, record in metadata:
        if what == 0 and record:
            key = str(pick(rng, list(record)))
            record[key] = str(
                rng.choice(np.array([word(rng), damage_bytes(rng, record[key].encode()).decode('utf-8', 'replace')]))
            )
        writer.add_metadata(name, record)
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    target = int(rng.integers(len(records)))
    for k, (schema, channel, message) in enumerate(records):
        data, times = message.data, message.log_time
        if channel.id not in channels:
            if schema.id not in schemas:
                text = damage_bytes(rng, schema.data) if what == 1 and rng.random() < 0.3 else schema.data
                schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, text)
            topic = channel.topic
            if what == 2 and rng.random() < 0.3:
                topic = damage_bytes(rng, topic.encode()).decode('utf-8', 'replace')
            channels[channel.id] = writer.register_channel(topic, channel.message_encoding, schemas[schema.id])
        if what == 3 and k == target:
            data = damage_bytes(rng, data)
        if what == 4 and rng.random() < 0.01:
            data = data[:4] + struct.pack('<I', 0xFFFFFFFF) + data[8:]
        if what == 5 and k >= target:
            times = int(pick(rng, (0, 2**63, 2**64 - 1, times, times + 2**62)))  # type: ignore[call-overload]
        writer.add_message(channels[channel.id], times, data, message.publish_time, message.sequence)
    writer.finish()
    return out.getvalue()


def numbers_of(name: str, seed: int, case: int) -> np.random.Generator:
    """The random numbers of one case."""
    return np.random.default_rng([seed, zlib.crc32(name.encode()), case])
