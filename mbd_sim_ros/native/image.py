"""Image of what a step works on: the memory of tables, state and scratch, and where addresses stand in it.

A step reads and writes arrays that lie behind Refs (solver.compiled.by_reference). An image is a copy of all of them
in two sections, one that no step writes (the tables) and one that every step does. An address in it becomes a Fixup:
whoever loads the image puts it somewhere else and writes the addresses anew. Arrays that share memory share it in the
image too.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from solver.compiled.by_reference import WORD, Ref
from solver.compiled.memory import LINE

CONSTANT, WRITTEN, KERNEL = range(3)  # sections of an image; KERNEL: the address is that of a kernel
# An integer of a table from here on must be a known address: no index and no flag is as large. Ten times as much would
# pass more addresses of a forgotten table as numbers. A known address counts wherever it lies: the memory of a program
# that is linked to a fixed place begins below.
LOWEST_ADDRESS = 1 << 32


class Fixup(NamedTuple):
    """A word of the image that holds an address: its section and offset [bytes], and the section and offset that the
    address leads to; of a kernel its index."""

    section: int
    offset: int
    target: int
    at: int


class Span(NamedTuple):
    """Memory of this process that goes into the image: address and size [bytes], and its place there."""

    address: int
    size: int
    section: int
    offset: int


class Image:
    """Memory behind Refs and arrays, as two sections and fixups.

    constant, written: the Refs and arrays (C-contiguous) of either section. tables: further Refs that integers in these
    lead to; they are constant. kernels: address -> index of every kernel that may be called.

    sections: (bytes of CONSTANT, bytes of WRITTEN). fixups: in the order of sections and offsets. place(): where a Ref
    or an array lies. Raises TypeError for an address that leads to none of these.
    """

    def __init__(
        self, constant: Sequence[Any], written: Sequence[Any], tables: Sequence[Ref], kernels: Mapping[int, int]
    ) -> None:
        parts = [(part, CONSTANT) for part in (*constant, *tables)] + [(part, WRITTEN) for part in written]
        blocks = [(a, s) for part, s in parts for a in _arrays(part)]
        self._spans, sizes = _laid_out([(_address(a), a.nbytes, s) for a, s in blocks if a.nbytes])
        self._starts = [span.address for span in self._spans]
        self.sections = tuple(np.zeros(size, np.uint8) for size in sizes)
        for array, _ in blocks:
            if array.nbytes:
                section, offset = self.place(array)
                self.sections[section][offset : offset + array.nbytes] = array.reshape(-1).view(np.uint8)
        refs = [part for part, _ in parts if isinstance(part, Ref)]
        known = {**dict.fromkeys(kernels, KERNEL), **{ref.pointer: CONSTANT for ref in refs}}
        words = {ref.pointer for ref in refs}  # those of a Ref hold other numbers too
        found: set[Fixup] = set()
        for ref in refs:
            found.update(self._of_ref(ref))
        for array, _ in blocks:
            if array.dtype == np.int64 and array.nbytes:
                found.update(self._of_integers(array, known, kernels, strict=_address(array) not in words))
        self.fixups = sorted(found)
        for fixup in self.fixups:  # what the address was in this process says nothing to anybody
            self.sections[fixup.section][fixup.offset : fixup.offset + WORD] = 0

    def place(self, part: Any) -> tuple[int, int]:
        """(section, offset [bytes]) of a Ref or an array."""
        return self._at(part.pointer if isinstance(part, Ref) else _address(part))

    def _at(self, address: int) -> tuple[int, int]:
        span = self._spans[bisect_right(self._starts, address) - 1]
        if not 0 <= address - span.address < span.size:
            raise TypeError(f'address {address:#x} is not in the image')
        return span.section, span.offset + address - span.address

    def _of_ref(self, ref: Ref) -> Iterator[Fixup]:
        """Words of a Ref that hold the address of an array. That of an empty array, which nobody follows, is 0."""
        for word, array in _descriptors(ref.value):
            section, offset = self._at(ref.pointer + WORD * word)
            if array.nbytes:
                yield Fixup(section, offset, *self.place(array))
            else:
                self.sections[section][offset : offset + WORD] = 0

    def _of_integers(
        self, array: np.ndarray, known: Mapping[int, int], kernels: Mapping[int, int], *, strict: bool
    ) -> Iterator[Fixup]:
        """Integers of an array that are addresses of kernels or of Refs; strict: no other number is as large."""
        flat = array.reshape(-1)
        large = (flat >= LOWEST_ADDRESS) | (flat <= -LOWEST_ADDRESS)
        for k in np.flatnonzero(large | np.isin(flat, list(known))).tolist():
            value = int(flat[k])
            if value in known:
                target = (KERNEL, kernels[value]) if value in kernels else self._at(value)
                yield Fixup(*self._at(_address(array) + WORD * k), *target)
            elif strict:
                raise TypeError(f'integer {value:#x} of a table is neither a kernel nor a table of this model')


def _address(array: np.ndarray) -> int:
    return int(array.ctypes.data)


def _arrays(part: Any) -> Iterator[np.ndarray]:
    """All memory behind a Ref, its words included, or an array itself."""
    if isinstance(part, np.ndarray):
        yield part
        return
    yield part.words
    for _, array in _descriptors(part.value):
        yield array


def _descriptors(value: Any, first: int = 0) -> list[tuple[int, np.ndarray]]:
    """(index of the word that holds its address, array) of all arrays in nested tuples, laid out as a Ref does."""
    return list(_walk(value, [first]))


def _walk(value: Any, next_word: list[int]) -> Iterator[tuple[int, np.ndarray]]:
    for field in value:
        if isinstance(field, tuple):
            yield from _walk(field, next_word)
        elif isinstance(field, np.ndarray):
            yield next_word[0] + 1, field
            next_word[0] += 3
        else:
            next_word[0] += 1


def _laid_out(blocks: Sequence[tuple[int, int, int]]) -> tuple[list[Span], tuple[int, int]]:
    """(spans by address, sizes of the sections [bytes]) of blocks (address, size, section); those that overlap are one
    span. Spans lie in the order of the blocks, so that the image does not depend on where memory was. Each begins with
    a line of the cache."""
    turn: dict[int, int] = {}  # address -> place of the first block there
    for k, (address, *_) in enumerate(blocks):
        turn.setdefault(address, k)
    merged: list[list[int]] = []  # address, size, section, turn
    for address, size, section in sorted(set(blocks)):
        if merged and address < merged[-1][0] + merged[-1][1]:
            if merged[-1][2] != section:
                raise TypeError('a step writes into memory of the tables')
            merged[-1][1] = max(merged[-1][1], address + size - merged[-1][0])
            merged[-1][3] = min(merged[-1][3], turn[address])
        else:
            merged.append([address, size, section, turn[address]])
    spans, ends = [], [0, 0]
    for address, size, section, _ in sorted(merged, key=lambda span: span[3]):
        spans.append(Span(address, size, section, ends[section]))
        ends[section] = -(-(ends[section] + size) // LINE) * LINE
    return sorted(spans), (ends[0], ends[1])
