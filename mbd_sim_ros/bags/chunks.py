"""Chunks of an MCAP file, each written as one block of bytes with a table of its messages.

The writer of the mcap package makes objects of every message and of its place: 2.5 us each, ten times what their bytes
take. It has no door for a whole chunk, so its chunk in progress and its statistics are reached here, and nowhere else
(test/bags/test_chunks.py reads such a file by the package itself).
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Sequence
from typing import Any, NamedTuple

from mcap.opcode import Opcode
from mcap.writer import Writer

HEAD = struct.Struct('<BQHIQQ')  # of a message: opcode, bytes behind it, channel, sequence, log and publish time [ns]
BEHIND = HEAD.size - 9  # bytes of the head that count in the length of its record

Message = tuple[int, int, int, bytes]  # channel, time of recording [ns], time of publishing [ns], encoded message


class _Places(NamedTuple):
    """Index of the messages of a channel in a chunk, as mcap.records.MessageIndex writes it."""

    channel_id: int
    pairs: array[int]  # time of recording [ns] and place in the chunk, by turns

    def write(self, stream: Any) -> None:
        stream.start_record(Opcode.MESSAGE_INDEX)
        stream.write2(self.channel_id)
        stream.write4(len(self.pairs) * self.pairs.itemsize)
        stream.write(self.pairs.tobytes())
        stream.finish_record()


def write_chunk(writer: Writer, messages: Sequence[Message], counts: dict[int, int]) -> None:
    """Write messages, in this order, as one chunk. counts: messages of every channel so far, which numbers them. Raises
    OSError."""
    if not messages:
        return
    chunk, statistics = writer._Writer__chunk_builder, writer._Writer__statistics  # type: ignore[attr-defined]
    pack, parts, at = HEAD.pack, list[bytes](), chunk.count
    indices: dict[int, _Places] = chunk.message_indices
    for channel, time, published, data in messages:
        number = counts.get(channel, 0)
        counts[channel] = number + 1
        parts += (pack(Opcode.MESSAGE, BEHIND + len(data), channel, number, time, published), data)
        if channel not in indices:
            indices[channel] = _Places(channel, array('Q'))
        indices[channel].pairs.extend((time, at))
        at += HEAD.size + len(data)
    chunk.record_writer.write(b''.join(parts))
    times = [message[1] for message in messages]
    chunk.message_start_time, chunk.message_end_time, chunk.num_messages = min(times), max(times), len(messages)
    first, last = chunk.message_start_time, chunk.message_end_time
    statistics.message_start_time = min(first, statistics.message_start_time) if statistics.message_count else first
    statistics.message_end_time = max(last, statistics.message_end_time)
    statistics.message_count += len(messages)
    for channel, places in indices.items():
        statistics.channel_message_counts[channel] += len(places.pairs) // 2
    writer.flush()
