"""Processes of this machine that run cases. A worker that dies takes with it the case it was at, which is tried once
more."""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any

from mbd_sim_ros import interrupts
from mbd_sim_ros.sweep.case import Row, SweepCase, row_of
from solver.errors import BagError, MbdError

TRIES = 2  # of a case whose worker died


class Worker:
    """One process, and the case it is at."""

    def __init__(self, context: Any) -> None:
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_work, args=(theirs,), daemon=True)
        resource_tracker.ensure_running()  # whose start would unblock the signal
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            # Ctrl-C in the terminal is for the process that asked, also while this one imports what it needs
            self.process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        assert self.process.pid is not None
        self._pid: int = self.process.pid
        # while it imports it would not notice for a second that nobody is left to work for
        interrupts.dependents.add(self._pid)
        self.case: SweepCase | None = None

    def give(self, case: SweepCase) -> None:
        """Have it run a case."""
        self.case = case
        with suppress(OSError):  # it is dead, which wait() tells
            self.pipe.send(case)

    def end(self) -> None:
        """End it now."""
        self.process.kill()
        self.process.join()
        interrupts.dependents.discard(self._pid)
        self.pipe.close()


class Workers:
    """Processes of this machine, started at once: they import what they need while the cases are laid out. To be used
    in a `with`."""

    def __init__(self, count: int) -> None:
        self._context = multiprocessing.get_context('spawn')  # a fork would share locks of threads, and signals
        self.at_work: list[Worker] = []
        try:
            for _ in range(count):
                self.at_work.append(Worker(self._context))
        except BaseException:
            self.end()
            raise

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> None:
        """End all of them now."""
        for worker in self.at_work:
            worker.end()

    def run(self, cases: Sequence[SweepCase]) -> Iterator[Row]:
        """The rows of the cases, as they are done. Raises BagError when what is kept cannot be written."""
        waiting = deque((case, TRIES) for case in cases)
        left: dict[int, int] = {}
        for worker in self.at_work:
            _next(worker, waiting, left)
        while any(worker.case for worker in self.at_work):
            for pipe in wait([worker.pipe for worker in self.at_work if worker.case]):
                i = next(k for k, worker in enumerate(self.at_work) if worker.pipe is pipe)
                case = self.at_work[i].case
                assert case is not None
                try:
                    row = self.at_work[i].pipe.recv()
                    self.at_work[i].case = None
                except (EOFError, OSError):
                    row = None
                if isinstance(row, MbdError):
                    raise row
                if row is not None:
                    _next(self.at_work[i], waiting, left)
                    yield row
                    continue
                self.at_work[i].end()
                number = self.at_work[i].process.exitcode
                self.at_work[i] = Worker(self._context)
                tries = left[case.number] - 1
                if tries:
                    waiting.appendleft((case, tries))
                _next(self.at_work[i], waiting, left)
                if not tries:
                    yield lost(case, f'its worker died twice (exit code {number})')


def lost(case: SweepCase, message: str) -> Row:
    """The row of a case that no worker brought back."""
    bag = {'bag': ''} if case.bags else {}
    return {
        'case': case.number,
        **case.values,
        **bag,
        'status': 'error',
        'message': message,
        **dict.fromkeys(case.figures, math.nan),
    }


def _next(worker: Worker, waiting: deque[tuple[SweepCase, int]], left: dict[int, int]) -> None:
    if waiting:
        case, left_tries = waiting.popleft()
        left[case.number] = left_tries
        worker.give(case)


def _work(pipe: Connection) -> None:
    """The life of a worker: cases in, rows out, until nobody is at the other end."""
    os.environ['TQDM_DISABLE'] = '1'
    with suppress(EOFError, OSError):
        while True:
            pipe.send(_row_or_error(pipe.recv()))


def _row_or_error(case: SweepCase) -> Row | MbdError:
    """A row, or why none can be kept: the disk is full, or what was there is gone."""
    try:
        return row_of(case)
    except MbdError as error:
        return error
    except OSError as error:
        return BagError(
            f'{error.filename or case.rows}: {error.strerror or error}; what is done is kept, the same command goes on'
        )
