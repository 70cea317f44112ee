"""The recording process: takes steps from its standard input and writes them into a bag (see Recorder, which starts
it).

It answers on its standard output with one JSON string per line: empty when the bag was begun and when it was finished,
otherwise the sentence of what went wrong, after which it ends. When its input ends without a result the simulating
process has died: the bag is finished with what came. It imports neither numpy nor the solver, for whoever records waits
until it is there.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from contextlib import suppress
from io import FileIO, RawIOBase
from itertools import accumulate

from mbd_sim_ros.bags.delivery import deliveries, steps_of
from mbd_sim_ros.bags.writer import BagWriter
from mbd_sim_ros.messages.topics import Topic
from solver.errors import BagError

FLUSH_SECONDS = 0.25  # what a killed recording process may lose
ORPHANED = {'end': 'the simulating process died'}


def record(stream: RawIOBase) -> None:
    """Write one bag from what comes in. Raises BagError when the file system refuses."""
    incoming = deliveries(stream)
    start = next(incoming, None)
    if start is None:
        return
    (directory, topics, metadata, sizes), data = start
    ends = list(accumulate(sizes.values()))
    attachments = {name: bytes(data[end - size : end]) for (name, size), end in zip(sizes.items(), ends, strict=True)}
    del start, data
    bag = BagWriter(directory, [Topic(*topic) for topic in topics], metadata, attachments=attachments)
    attachments.clear()
    answer('')
    result = ORPHANED
    flushed = time.monotonic()
    try:
        for delivery, data in incoming:
            if isinstance(delivery, dict):
                result = delivery
                break
            for t_ns, messages in steps_of(delivery, data):
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
