"""The recording process: takes steps from its standard input and writes them into a bag (see Recorder, which starts it).

Every delivery is the size of a marshalled value and of what follows it, the value, and that. Values are the start (directory, topics,
metadata), then lists of steps, each its time and the sizes of its messages (-1: none), which follow, then the result, a dict. It
answers on its standard output with one JSON string per line: empty when the bag was begun and when it was finished, otherwise the
sentence of what went wrong, after which it ends. When its input ends without a result the simulating process has died: the bag is
finished with what came.
"""

from __future__ import annotations

import json
import marshal
import os
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from io import FileIO, RawIOBase
from typing import Any

from mbd_sim_ros.bags.recorder import PIECE, SIZES
from mbd_sim_ros.bags.writer import BagWriter
from mbd_sim_ros.messages.topics import Topic
from solver.errors import BagError

FLUSH_SECONDS = 0.25  # what a killed recording process may lose
ORPHANED = {'end': 'the simulating process died'}


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


def _steps(heads: list[tuple[int, list[int]]], data: bytearray) -> Iterator[tuple[int, list[tuple[int, bytes]]]]:
    """(time [ns], (place, message) of each) of steps, given their times with the sizes of their messages, which stand in data."""
    begin = 0
    for t_ns, sizes in heads:
        messages = []
        for place, size in enumerate(sizes):
            if size >= 0:
                messages.append((place, bytes(data[begin : begin + size])))
                begin += size
        yield t_ns, messages


def record(stream: RawIOBase) -> None:
    """Write one bag from what comes in. Raises BagError when the file system refuses."""
    incoming = deliveries(stream)
    start = next(incoming, None)
    if start is None:
        return
    directory, topics, metadata = start[0]
    bag = BagWriter(directory, [Topic(*topic) for topic in topics], metadata)
    answer('')
    result = ORPHANED
    flushed = time.monotonic()
    try:
        for delivery, data in incoming:
            if isinstance(delivery, dict):
                result = delivery
                break
            for t_ns, messages in _steps(delivery, data):
                bag.write(t_ns, messages)
            if time.monotonic() - flushed >= FLUSH_SECONDS:
                bag.flush()
                flushed = time.monotonic()
    except BagError:
        bag.abandon()
        raise
    bag.finish(result)
    answer('')


def answer(sentence: str) -> None:
    """Tell the simulating process, if it is still there."""
    with suppress(OSError):
        os.write(sys.stdout.fileno(), json.dumps(sentence).encode() + b'\n')


def main() -> int:
    """Record until told to stop; returns the exit code."""
    with suppress(AttributeError, OSError):  # begun by a real-time thread it would have its priority
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the simulating process decides when the recording ends
    try:
        record(FileIO(sys.stdin.fileno(), closefd=False))
    except BagError as error:
        answer(str(error))
        return error.exit_code
    return 0


if __name__ == '__main__':
    sys.exit(main())
