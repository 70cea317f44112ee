"""Processes of this machine that run cases. A worker that dies takes with it the case it was at, which is tried once more."""

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

from mbd_sim_ros.sweep.case import Case, Row, row_of
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
            self.process.start()  # Ctrl-C in the terminal is for the process that asked, also while this one imports what it needs
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self.case: Case | None = None

    def give(self, case: Case) -> None:
        """Have it run a case."""
        self.case = case
        with suppress(OSError):  # it is dead, which wait() tells
            self.pipe.send(case)

    def end(self) -> None:
        """End it now."""
        self.process.kill()
        self.process.join()
        self.pipe.close()


def run_here(cases: Sequence[Case], count: int) -> Iterator[Row]:
    """The rows of the cases, as they are done, by `count` processes. Raises BagError when what is kept cannot be written."""
    context = multiprocessing.get_context('spawn')  # a fork would share locks of threads, and signals
    waiting = deque((case, TRIES) for case in cases)
    workers: list[Worker] = []
    left: dict[int, int] = {}
    try:
        workers += [Worker(context) for _ in range(min(count, len(cases)))]
        for worker in workers:
            _next(worker, waiting, left)
        while any(worker.case for worker in workers):
            for pipe in wait([worker.pipe for worker in workers if worker.case]):
                i = next(k for k, worker in enumerate(workers) if worker.pipe is pipe)
                case = workers[i].case
                assert case is not None
                try:
                    row = workers[i].pipe.recv()
                    workers[i].case = None
                except (EOFError, OSError):
                    row = None
                if isinstance(row, MbdError):
                    raise row
                if row is not None:
                    yield row
                else:
                    workers[i].end()
                    number = workers[i].process.exitcode
                    workers[i] = Worker(context)
                    tries = left[case.number] - 1
                    if tries:
                        waiting.appendleft((case, tries))
                    else:
                        yield lost(case, f'its worker died twice (exit code {number})')
                _next(workers[i], waiting, left)
    finally:
        for worker in workers:
            worker.end()


def lost(case: Case, message: str) -> Row:
    """The row of a case that no worker brought back."""
    bag = {'bag': ''} if case.bags else {}
    return {'case': case.number, **case.values, **bag, 'status': 'error', 'message': message, **dict.fromkeys(case.figures, math.nan)}


def _next(worker: Worker, waiting: deque[tuple[Case, int]], left: dict[int, int]) -> None:
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


def _row_or_error(case: Case) -> Row | MbdError:
    """A row, or why none can be kept: the disk is full, or what was there is gone."""
    try:
        return row_of(case)
    except MbdError as error:
        return error
    except OSError as error:
        return BagError(f'{error.filename or case.rows}: {error.strerror or error}; what is done is kept, the same command goes on')
