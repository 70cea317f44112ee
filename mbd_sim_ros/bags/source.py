"""The bytes of an MCAP file, one after the other, and their checksums."""

from __future__ import annotations

import struct
import zlib
from typing import BinaryIO

MESSAGE_INDEX = 7
ENTRY = 16  # bytes in an index, one for each message
_PIECE = 1 << 18
_KEPT = 1 << 21  # bytes, of a block that is reserved but never touched
_INDEX = struct.Struct('<BQHI')  # opcode, length, channel, length of its entries
_HEAD = 9  # bytes of it that the length does not count


class ChecksummedStream:
    """A file from its beginning, and the checksum of what was taken of it or skipped: once per piece, for records are
    many and small."""

    def __init__(self, stream: BinaryIO) -> None:
        keep_freed_memory()
        self._stream = stream
        self._piece = b''
        self._at = self._summed = self._checksum = 0  # _summed: up to where the checksum knows the piece

    def take(self, n: int) -> bytes:
        """The next n bytes, fewer at the end of the file."""
        if len(self._piece) - self._at < n:
            self._sum(self._at)
            rest = self._piece[self._at :]
            self._piece = rest + self._stream.read(max(n - len(rest), _PIECE))
            self._at = self._summed = 0
        begin = self._at
        self._at = min(begin + n, len(self._piece))
        return self._piece[begin : self._at]

    def skip(self, n: int) -> None:
        """Pass over the next n bytes."""
        while n > (left := len(self._piece) - self._at):
            self._at += left
            self._sum(self._at)
            self._piece = self._stream.read(_PIECE)
            self._at = self._summed = 0
            n -= left
            if not self._piece:
                return
        self._at += n

    def indexes(self) -> tuple[dict[int, int], int]:
        """Channel -> messages of it, by the indexes that come next, and the bytes that these take; as far as they were
        read already."""
        found = {}
        piece, at = self._piece, self._at
        while at + _INDEX.size <= len(piece) and piece[at] == MESSAGE_INDEX:
            _, length, channel, entries = _INDEX.unpack_from(piece, at)
            behind = at + _HEAD + length
            if behind > len(piece) or behind < at + _INDEX.size:
                break
            found[channel] = entries // ENTRY
            at = behind
        passed, self._at = at - self._at, at
        return found, passed

    def checksum(self, but: int) -> int:
        """Checksum of all bytes from the last begin() on, but the last ones taken."""
        self._sum(self._at - but)
        return self._checksum

    def begin(self) -> None:
        """Sum up from here on."""
        self._summed, self._checksum = self._at, 0

    def _sum(self, end: int) -> None:
        self._checksum = zlib.crc32(memoryview(self._piece)[self._summed : end], self._checksum)
        self._summed = end


def keep_freed_memory() -> None:
    """Have the C library keep blocks as large as a chunk when they are freed. That of GNU gives them back to the system
    until a larger one has been freed; before, the pages of every chunk are made anew, which takes as long as unpacking
    it.
    """
    bytes(_KEPT)
