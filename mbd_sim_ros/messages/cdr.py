"""ROS 2 messages as bytes without ROS: CDR encoding (XCDR1, little endian) and decoding.

A message is walked field by field in the order of its `.msg` definition. Encoding and decoding both report where every
number landed, so a message whose strings never change is encoded once and from then on only its numbers are patched
(`Template`), and a whole column of recorded messages is read with one strided view. Encoding rules: OMG DDS-XTypes 1.3,
7.4.1 (plain CDR): 4 bytes encapsulation, primitives aligned to their size counted from the byte after it, strings and
sequences with a uint32 length, strings zero-terminated.
"""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from typing import Any, NamedTuple

import numpy as np

from mbd_sim_ros.messages.definitions import FORMATS, Definitions, Field, definitions, schema_text
from solver.errors import BagError

DEPTH_MOST = 32  # types inside each other; one that contains itself has no end
FIELDS_MOST = 50_000  # in one message; an array of numbers is one
# bytes that may follow a message: some middleware fills up to 4; 30 would hide a wrong definition or alignment
PADDING = 3
ENCAPSULATION = b'\x00\x01\x00\x00'  # CDR, little endian
BEHIND_IT = len(ENCAPSULATION)  # byte from which alignment counts; 0 in messages of writers that get this wrong


class Place(NamedTuple):
    """Place of the numbers of one field in an encoded message."""

    kind: str  # primitive
    offset: int  # bytes from the start of the message
    size: int  # how many


def dtype(place: Place) -> np.dtype:
    """Return the little-endian numpy type of the numbers at a place."""
    return np.dtype('<' + FORMATS[place.kind])


class _Walk(ABC):
    """State of one pass over a message: position, and the places found."""

    def __init__(self, types: Definitions) -> None:
        self.types = types
        self.places: dict[str, Place] = {}
        self._depth = self._fields = 0

    def message(self, kind: str, value: Any, path: str) -> Any:
        if kind not in self.types:
            raise BagError(f'its definition refers to {kind!r}, which it does not define')
        if self._depth == DEPTH_MOST:
            raise BagError(f'its definition has more than {DEPTH_MOST} types inside each other: {kind!r}')
        self._depth += 1
        result = {}
        for field in self.types[kind]:
            inner = f'{path}.{field.name}' if path else field.name
            result[field.name] = self.field(field, value.get(field.name) if isinstance(value, dict) else None, inner)
        self._depth -= 1
        return result

    def field(self, field: Field, value: Any, path: str) -> Any:
        self._fields += 1
        if self._fields > FIELDS_MOST:
            raise BagError(f'a message has more than {FIELDS_MOST} fields')
        if field.size is None and field.kind not in FORMATS:
            return self.string(value) if field.kind == 'string' else self.message(field.kind, value, path)
        if field.kind in FORMATS:
            count = 1 if field.size is None else field.size or self.length(value)
            numbers = self.numbers(field.kind, count, value, path)
            return numbers[0] if field.size is None else numbers
        count = field.size or self.length(value)
        if count > FIELDS_MOST:
            raise BagError(f'a message of it claims {count} items of {path}, more than {FIELDS_MOST}')
        items = value if value is not None else [None] * count
        one = Field(field.name, field.kind, None)
        return [self.field(one, items[i] if i < len(items) else None, f'{path}[{i}]') for i in range(count)]

    @abstractmethod
    def length(self, value: Any) -> int:
        """Number of items of a sequence."""

    @abstractmethod
    def string(self, value: Any) -> str:
        """A string."""

    @abstractmethod
    def numbers(self, kind: str, count: int, value: Any, path: str) -> Any:
        """Numbers of one primitive kind; notes their place under `path`."""


class _Encode(_Walk):
    def __init__(self, types: Definitions) -> None:
        super().__init__(types)
        self.data = bytearray(ENCAPSULATION)

    def align(self, size: int) -> None:
        self.data += bytes(-(len(self.data) - BEHIND_IT) % size)

    def length(self, value: Any) -> int:
        count = 0 if value is None else len(value)
        self.align(4)
        self.data += struct.pack('<I', count)
        return count

    def string(self, value: Any) -> str:
        raw = (value or '').encode() + b'\0'
        self.length(raw)
        self.data += raw
        return value or ''

    def numbers(self, kind: str, count: int, value: Any, path: str) -> Any:
        code = '<' + FORMATS[kind]
        if count:  # an empty sequence is its length alone: no alignment follows
            self.align(struct.calcsize(code))
        self.places[path] = Place(kind, len(self.data), count)
        numbers = np.zeros(count, code) if value is None else np.broadcast_to(np.asarray(value, code), (count,))
        self.data += numbers.tobytes()
        return numbers


class _Decode(_Walk):
    def __init__(self, types: Definitions, data: bytes, origin: int) -> None:
        super().__init__(types)
        if data[:2] != ENCAPSULATION[:2]:
            raise BagError(f'message encoding {data[:2].hex()} is not plain little-endian CDR')
        self.data, self.origin = data, origin
        self.at = BEHIND_IT

    def take(self, size: int, count: int) -> int:
        """Return the offset of `count` aligned primitives of `size` bytes and move behind them."""
        before = self.at
        start = before + (-(before - self.origin) % size if count else 0)
        self.at = start + size * count
        if self.at > len(self.data):
            raise BagError(f'a message of {len(self.data)} bytes is shorter than its schema asks for')
        # an alignment that is guessed must not skip what may be numbers
        if self.origin != BEHIND_IT and any(self.data[before:start]):
            raise BagError('its padding is not zero')
        return start

    def length(self, value: Any) -> int:
        return struct.unpack_from('<I', self.data, self.take(4, 1))[0]

    def string(self, value: Any) -> str:
        count = self.length(None)
        start = self.take(1, count)
        try:
            return bytes(self.data[start : start + max(count - 1, 0)]).decode()
        except UnicodeDecodeError:
            raise BagError('a text in a message of it is not UTF-8') from None

    def numbers(self, kind: str, count: int, value: Any, path: str) -> Any:
        code = np.dtype('<' + FORMATS[kind])
        start = self.take(code.itemsize, count)
        self.places[path] = Place(kind, start, count)
        return np.frombuffer(self.data, code, count, start)


def encode(message_type: str, text: str, value: dict[str, Any]) -> tuple[bytes, dict[str, Place]]:
    """Encode nested dicts by the schema `text`; what is absent is zero or empty. Returns the message and where its
    numbers are."""
    walk = _Encode(definitions(message_type, text))
    walk.message(message_type.replace('/msg/', '/'), value, '')
    return bytes(walk.data), walk.places


def decode(
    message_type: str, text: str, data: bytes, origin: int = BEHIND_IT
) -> tuple[dict[str, Any], dict[str, Place]]:
    """Decode a message by the schema `text` into nested dicts (numbers as numpy values); the inverse of `encode`.

    origin: byte from which alignment counts. Raises BagError if the message is too short or too long or not
    little-endian CDR.
    """
    walk = _Decode(definitions(message_type, text), data, origin)
    value = walk.message(message_type.replace('/msg/', '/'), None, '')
    if (surplus := len(data) - walk.at) > PADDING:
        raise BagError(f'a message of {len(data)} bytes is {surplus} longer than its schema asks for')
    return value, walk.places


def decode_first(message_type: str, text: str, data: bytes) -> tuple[dict[str, Any], dict[str, Place], int]:
    """Decode the first message of a topic, and find the byte from which its alignment counts. Raises BagError as
    `decode`.

    That is 4, and 0 where the message fits so and does not fit otherwise. Behind the first number of 8 bytes the two
    differ by 4, which is more than PADDING, so never do both fit.
    """
    try:
        return *decode(message_type, text, data), BEHIND_IT
    except BagError:
        try:
            return *decode(message_type, text, data, 0), 0
        except BagError:
            pass
        raise


def may_have_zeros_behind(message_type: str, text: str, data: bytes) -> bool:
    """True where a message that is longer than its schema asks for may be CDR with zeros behind it, and not one that is
    aligned otherwise.

    A message that is aligned otherwise ends in numbers, not zeros; if these are zero, the last one that is not appears
    as a subnormal one.
    """
    walk = _Decode(definitions(message_type, text), data, BEHIND_IT)
    try:
        walk.message(message_type.replace('/msg/', '/'), None, '')
    except BagError:
        return False
    doubles = [np.frombuffer(data, dtype(p), p.size, p.offset) for p in walk.places.values() if p.kind == 'float64']
    numbers = np.abs(np.concatenate(doubles)) if doubles else np.zeros(0)
    return not any(data[walk.at :]) and not np.any((numbers > 0.0) & (numbers < np.finfo(float).tiny))


class Template(NamedTuple):
    """A message with fixed strings and sizes: encoded once, then only its numbers change."""

    data: bytes
    places: dict[str, Place]  # of its numbers, by path


def template(message_type: str, value: dict[str, Any]) -> Template:
    """Encode a message of a type that this package brings the definition of."""
    return Template(*encode(message_type, schema_text(message_type), value))
