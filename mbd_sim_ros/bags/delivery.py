"""Deliveries through the pipe between a simulation (recorder.py) and the process that writes its recording
(process.py).

Every delivery is the size of a marshalled value and of what follows it, the value, and that. Values are the start
(directory, topics, metadata), then lists of steps, each its time and the sizes of its messages (-1: none), which
follow, then the result, a dict.
"""

from __future__ import annotations

import marshal
import os
import struct
from collections.abc import Iterator, Sequence
from io import RawIOBase
from typing import Any

SIZES = struct.Struct('<QQ')  # before every delivery: bytes of its marshalled value, and of what follows that
# bytes that one call of the system writes or reads, about: while it copies, nothing else runs on that processor
PIECE = 1 << 15
BUFFERS = 1000  # that one call takes, at most

Step = tuple[int, Sequence[bytes | None]]  # time [ns], one message per topic or None


def deliver(pipe: int, content: Any, messages: Sequence[bytes] = ()) -> None:
    """Send a value and what follows it; while the pipe is full this waits, without the interpreter lock. Raises
    OSError.

    Messages go from where they are, in pieces: half a megabyte at once, or copied into one block first, is 2 ms in the
    system now and then in which the simulation cannot run.
    """
    data = marshal.dumps(content)
    waiting = [SIZES.pack(len(data), sum(map(len, messages))), data]
    size = len(data)
    for message in messages:
        if size >= PIECE or len(waiting) == BUFFERS:
            _send(pipe, waiting)
            waiting, size = [], 0
        waiting.append(message)
        size += len(message)
    _send(pipe, waiting)


def deliver_steps(pipe: int, steps: Sequence[Step]) -> None:
    """Send steps. Raises OSError."""
    sizes = [(t_ns, [-1 if data is None else len(data) for data in messages]) for t_ns, messages in steps]
    deliver(pipe, sizes, [data for _, messages in steps for data in messages if data is not None])


def _send(pipe: int, buffers: Sequence[bytes]) -> None:
    """Write at most BUFFERS buffers, whole."""
    written = os.writev(pipe, buffers)
    rest = memoryview(b''.join(buffers) if written < sum(map(len, buffers)) else b'')[written:]
    while rest:
        rest = rest[os.write(pipe, rest) :]


def deliveries(stream: RawIOBase) -> Iterator[tuple[Any, bytearray]]:
    """The values that come in, with what follows them, until the stream ends, be it in the middle of one."""
    while True:
        head = _read(stream, SIZES.size)
        if head is None:
            return
        size, more = SIZES.unpack(head)
        data, follows = _read(stream, size), _read(stream, more)
        if data is None or follows is None:
            return
        yield marshal.loads(data), follows


def _read(stream: RawIOBase, size: int) -> bytearray | None:
    """So many bytes, or None where the stream ends before, in pieces for the reason that they are written in pieces."""
    data = bytearray(size)
    view, begin = memoryview(data), 0
    while begin < size:
        read = stream.readinto(view[begin : begin + PIECE])
        if not read:
            return None
        begin += read
    return data


def steps_of(heads: list[tuple[int, list[int]]], data: bytearray) -> Iterator[tuple[int, list[tuple[int, bytes]]]]:
    """(time [ns], (place, message) of each) of steps, given their times with the sizes of their messages, which stand
    in data."""
    begin = 0
    for t_ns, sizes in heads:
        messages = []
        for place, size in enumerate(sizes):
            if size >= 0:
                messages.append((place, bytes(data[begin : begin + size])))
                begin += size
        yield t_ns, messages
