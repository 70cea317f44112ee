"""Real-time priority of a process whose threads share one interpreter."""

from __future__ import annotations

import os


def prefer(first: int | None, priority: int) -> bool:
    """Give every thread of this process a real-time priority (SCHED_FIFO, 1 to 99), or ordinary scheduling for 0.

    All of them, because whichever holds the interpreter lock is the one the `first` (native id) waits for; that one
    above the others, or it waits for those of the middleware when they have all cores. Beside other busy processes this
    decides between steps that begin 20 us and steps that begin 5 ms late. Returns whether the system permits it.
    """
    try:
        policy = os.SCHED_FIFO if priority else os.SCHED_OTHER
        others = max(priority - 1, 1) if priority else 0
        for thread in map(int, os.listdir('/proc/self/task')):
            os.sched_setscheduler(thread, policy, os.sched_param(priority if thread == first else others))
    except (AttributeError, OSError):  # not Linux, or no permission
        return False
    return True
