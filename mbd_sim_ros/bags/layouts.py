"""Layouts that chunks of one recording have in common: the same messages in every step, of the same sizes.

A chunk that is like one before it, in everything but its times and data, is taken apart by one call of `struct` instead
of message by message. The heads of all its records are compared with those that are known, so nothing is assumed of it.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Collection, Sequence
from typing import NamedTuple

RECORDS_MOST = 12_000  # in a chunk that is worth a layout
LAYOUTS_MOST = 64  # that are made for one file
_HEAD = struct.Struct('<BQH')  # opcode, length, channel
_PLAIN = 9  # bytes of it that the length does not count
_FIXED = 22  # bytes of a message before its data: channel, sequence, log time, publish time
_PARTS = 3  # of a message, as it is unpacked: head, times, data


class Layout(NamedTuple):
    """The records of a chunk: their heads in order, and the channels of a step, which are the same in all its steps."""

    parts: struct.Struct
    heads: tuple[bytes, ...]
    step: tuple[int, ...]
    skipped: frozenset[int]
    counts: tuple[tuple[int, int], ...]  # channel and messages of it

    def messages(self, body: bytes) -> list[tuple[int, Sequence[bytes], Sequence[bytes]]] | None:
        """Channel, times (log and publish time as they lie in the file) and data of the messages in a chunk that are
        not passed over; None if it has another layout."""
        parts = self.parts.unpack(body)
        if parts[::_PARTS] != self.heads:
            return None
        stride = _PARTS * len(self.step)
        return [
            (channel, parts[at + 1 :: stride], parts[at + 2 :: stride])
            for at, channel in zip(range(0, stride, _PARTS), self.step)
            if channel not in self.skipped
        ]


class Layouts:
    """The layouts that were met in a file, one for every size of a chunk [bytes]."""

    def __init__(self) -> None:
        self._known: dict[int, Layout] = {}
        self._passed_over = 0
        self._left = LAYOUTS_MOST

    def find(self, size: int, skip: Collection[int]) -> Layout | None:
        """The layout that chunks of this size had. skip: channels whose data are not wanted; it may grow from call to
        call."""
        if len(skip) != self._passed_over:
            self._known.clear()
            self._passed_over = len(skip)
        return self._known.get(size)

    def learn(self, body: bytes, skip: Collection[int]) -> None:
        """Note the layout of a chunk that holds whole messages and nothing else, if its steps are alike."""
        if not self._left:
            return
        self._left -= 1
        heads: list[bytes] = []
        channels: list[int] = []
        sizes: list[int] = []
        at = 0
        while at < len(body) and len(heads) < RECORDS_MOST:
            _, length, channel = _HEAD.unpack_from(body, at)
            heads.append(body[at : at + _HEAD.size])
            channels.append(channel)
            sizes.append(length - _FIXED)
            at += _PLAIN + length
        step = next((k for k in range(1, len(channels)) if channels[k] == channels[0]), len(channels))
        if (
            at < len(body)
            or len(channels) % step
            or channels != channels[:step] * (len(channels) // step)
            or len(set(channels)) < step
        ):
            return
        skipped = frozenset(channel for channel in channels if channel in skip)
        data = [f'0s{size}x' if channel in skipped else f'{size}s' for channel, size in zip(channels, sizes)]
        parts = struct.Struct('<' + ''.join(f'{_HEAD.size}s4x16s{one}' for one in data))
        self._known[len(body)] = Layout(
            parts, tuple(heads), tuple(channels[:step]), skipped, tuple(Counter(channels).items())
        )
