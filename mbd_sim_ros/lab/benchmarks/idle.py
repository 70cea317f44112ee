"""Idle loops on this machine, which do nothing or only count: steps of a clock that come late by themselves; and the
memory of a process."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

PRIORITY = 10  # SCHED_FIFO, like the node
SAMPLE = 0.5  # s between looks at the memory
COUNTED = 0.4  # of a step that a loop counts for: about what the full car, published and recorded, takes of 1 ms
TRIALS = 100  # of how long counting takes


def late_when_idle(h: float, seconds: float) -> float:
    """Share of steps of h [s] that end after their deadline [%] when nothing is done in them; paced as the node
    paces."""
    return _late(h, seconds, 0)


def late_when_busy(h: float, seconds: float) -> float:
    """The same when the processor counts for COUNTED of h in every step, measured alone, while every other core counts
    all the time.

    It is the effect of the machine on any loop of that size, among as much work: cores that share resources, or that
    others take away.
    """
    times = []
    for _ in range(TRIALS):
        begin = time.perf_counter()
        _count(1000)
        times.append(time.perf_counter() - begin)
    numbers = round(1000 * COUNTED * h / min(times))
    with ExitStack() as running:
        for _ in range(len(os.sched_getaffinity(0)) - 1):
            other = subprocess.Popen([sys.executable, '-c', 'while True: sum(range(100_000))'])
            running.callback(other.wait)
            running.callback(other.kill)
        return _late(h, seconds, numbers)


def _count(numbers: int) -> int:
    total = 0
    for i in range(numbers):
        total += i * i
    return total


def _late(h: float, seconds: float, numbers: int) -> float:
    """Share of steps [%] that come late when so many numbers are counted in each."""
    before = None
    try:
        before = os.sched_getscheduler(0), os.sched_getparam(0)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, OSError):  # not Linux, or no permission
        before = None
    steps, late = round(seconds / h), 0
    try:
        anchor = time.perf_counter()
        for k in range(steps):
            wait = anchor + k * h - time.perf_counter()
            if wait > 0.0:
                time.sleep(wait)
            _count(numbers)
            late += time.perf_counter() > anchor + (k + 1) * h
    finally:
        if before is not None:
            os.sched_setscheduler(0, *before)
    return 100.0 * late / max(steps, 1)


class Memory:
    """Follows the resident memory of a process [MB] while it lives."""

    def __init__(self, pid: int) -> None:
        self._file = Path(f'/proc/{pid}/statm')
        self._samples: list[tuple[float, float]] = []
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def _follow(self) -> None:
        page = os.sysconf('SC_PAGE_SIZE') * 1e-6
        while not self._end.wait(SAMPLE):
            try:
                self._samples.append((time.monotonic(), int(self._file.read_text().split()[1]) * page))
            except (OSError, IndexError):  # it has ended
                return

    def figures(self) -> tuple[float, float]:
        """(largest [MB], growth per minute over the second half [MB], by a line of least squares); NaN where nothing
        was seen."""
        self._end.set()
        self._thread.join()
        if len(self._samples) < 4:
            return float('nan'), float('nan')
        t, size = np.array(self._samples).T
        late = t >= 0.5 * (t[0] + t[-1])
        x, y = t[late] - t[late].mean(), size[late] - size[late].mean()
        return float(size.max()), float(60.0 * np.sum(x * y) / np.sum(x * x))
