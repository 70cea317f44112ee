"""A cold start on two processors: another process compiles the kernels of the step while this one compiles those of the
elements.

Both take about as long, neither needs the other, and kernels are kept by content (solver.compiled.cache): what the
other process has compiled is read from there. It is forked with the first kernel that is not kept, so a warm start is
as it was; and ends with this one, whatever ends it.
"""

from __future__ import annotations

import ctypes
import os
import select
import signal
import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any

import numba
from numba.core import event

from solver.compiled import interruption
from solver.compiled.kernel import KERNELS

WAITING = 'mbd:ahead'  # event of numba that is told again and again while this process waits for the other one
LOOKS = 0.05  # s between two looks at the other process; ten times as long lets the last wait be half a second longer
# s of looks in a row without any CPU time, after which the other process hangs in a lock of a thread that it does not
# have, and is given up: a compiler always computes. Ten times as long lets a user wait for five minutes.
HUNG = 30.0
# Threads beside which a process is forked: that of tqdm and that of mbd_sim_ros.interrupts hold no lock that a compiler
# needs. Any other may.
HARMLESS = 'TMonitor', 'signals'
PR_SET_PDEATHSIG = 1  # of prctl(2)
DONE, KERNEL = b'.', b'k'  # what the other process says: a part is done, a kernel is compiled

elsewhere = 0  # kernels that other processes have compiled for this one


class Ahead(event.Listener):
    """Work for another process, while the block of a `with` compiles. parts: what compiles, in this order."""

    def __init__(self, *parts: Callable[[], object]) -> None:
        self._parts = parts
        self._begun = len(os.sched_getaffinity(0)) < 2 or bool(numba.config.DISABLE_JIT)
        self._listens = False
        self._child, self._pipe, self._done = 0, -1, 0
        self._owner = os.getpid()  # a process that is forked later has a copy, and no child

    def __enter__(self) -> Ahead:
        if not self._begun:
            event.register('numba:compile', self)
            self._listens = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._listens:
            event.unregister('numba:compile', self)
            self._listens = False
        if kind is not None:
            self._end()

    def on_start(self, event: Any) -> None:
        """A kernel is not kept: so those of the step are not, or are soon read."""
        main = threading.main_thread()
        others = [{type(one).__name__, one.name} for one in threading.enumerate() if one is not main]
        alone = threading.current_thread() is main and all(one.intersection(HARMLESS) for one in others)
        if self._begun or not alone or KERNELS.unkept:
            return
        self._begun = True
        self._pipe, write = os.pipe()
        with warnings.catch_warnings():
            warnings.simplefilter('ignore', DeprecationWarning)  # of forks beside any thread, from Python 3.12 on
            self._child = os.fork()
        if self._child:
            os.close(write)
        else:
            self._work(write)

    def on_end(self, event: Any) -> None:
        """Nothing to do."""

    def _work(self, write: int) -> None:
        """Compile all parts, and end. What goes wrong here goes wrong once more where it is told."""
        try:
            ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, signal.SIG_DFL)
            nowhere = os.open(os.devnull, os.O_RDWR)
            for stream in (0, 1, 2):
                os.dup2(nowhere, stream)
            event.register('numba:compile', _Count(write))
            for part in self._parts:
                part()
                if KERNELS.unkept:
                    break
                os.write(write, DONE)
        finally:
            os._exit(0)

    def ready(self, parts: int) -> None:
        """Wait until the other process has done so many parts, or has ended. Raises what interrupts the compiler."""
        global elsewhere
        if not self._child:
            return
        seen = idle = 0
        try:
            while self._child and self._done < parts:
                if select.select([self._pipe], [], [], LOOKS)[0]:
                    said = os.read(self._pipe, 4096)
                    self._done += said.count(DONE)
                    elsewhere += said.count(KERNEL)
                    if not said:
                        self._end()
                interruption.check()
                event.broadcast(event.Event(WAITING, event.EventStatus.START))
                used = _ticks(self._child)
                idle = idle + 1 if used == seen else 0  # looks, and no clock: both may have been stopped for long
                seen = used
                if idle * LOOKS > HUNG:
                    self._end()
        except BaseException:
            self._end()
            raise
        if self._done == len(self._parts):
            self._end()
        event.broadcast(event.Event(WAITING, event.EventStatus.END))

    def __del__(self) -> None:
        self._end()  # of an engine that never started

    def _end(self) -> None:
        """End the other process."""
        if self._child and self._owner == os.getpid():
            os.kill(self._child, signal.SIGKILL)
            os.waitpid(self._child, 0)
            os.close(self._pipe)
            self._child = 0


class _Count(event.Listener):
    """Says in the pipe that a kernel of this program was compiled."""

    def __init__(self, write: int) -> None:
        self._write = write

    def on_start(self, event: Any) -> None:
        """Nothing to do."""

    def on_end(self, event: Any) -> None:
        if event.data['dispatcher'].py_func.__module__.startswith('solver.'):
            os.write(self._write, KERNEL)


def _ticks(process: int) -> int:
    """CPU time of a process in ticks of the kernel; 0 when it has ended."""
    try:
        fields = Path(f'/proc/{process}/stat').read_text(encoding='utf-8').rpartition(')')[2].split()
    except OSError:
        return 0
    return int(fields[11]) + int(fields[12])
