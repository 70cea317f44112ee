"""The recording process: takes steps from its standard input and writes them into a bag (see Recorder, which starts it).

Every delivery is its length and a marshalled value: the start (directory, topics, metadata), then lists of steps, then the
result, a dict. It answers on its standard output with one JSON string per line: empty when the bag was begun and when it was
finished, otherwise the sentence of what went wrong, after which it ends. When its input ends without a result the simulating
process has died: the bag is finished with what came.
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
from typing import Any, BinaryIO

from mbd_sim_ros.bags.recorder import LENGTH
from mbd_sim_ros.bags.writer import BagWriter
from mbd_sim_ros.messages.topics import Topic
from solver.errors import BagError

FLUSH_SECONDS = 0.25  # what a killed recording process may lose
ORPHANED = {'end': 'the simulating process died'}


def deliveries(stream: BinaryIO) -> Iterator[Any]:
    """The values that come in, until the stream ends, be it in the middle of one."""
    while True:
        head = stream.read(LENGTH.size)
        if len(head) < LENGTH.size:
            return
        (size,) = LENGTH.unpack(head)
        data = stream.read(size)
        if len(data) < size:
            return
        yield marshal.loads(data)


def record(stream: BinaryIO) -> None:
    """Write one bag from what comes in. Raises BagError when the file system refuses."""
    incoming = deliveries(stream)
    start = next(incoming, None)
    if start is None:
        return
    directory, topics, metadata = start
    bag = BagWriter(directory, [Topic(*topic) for topic in topics], metadata)
    answer('')
    result = ORPHANED
    flushed = time.monotonic()
    try:
        for delivery in incoming:
            if isinstance(delivery, dict):
                result = delivery
                break
            for t_ns, messages in delivery:
                bag.write(t_ns, ((i, data) for i, data in enumerate(messages) if data is not None))
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
        record(sys.stdin.buffer)
    except BagError as error:
        answer(str(error))
        return error.exit_code
    return 0


if __name__ == '__main__':
    sys.exit(main())
