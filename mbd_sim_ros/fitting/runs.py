"""Runs of a fit: what is driven, in which processes, and what was driven already."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, wait
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_sim_ros import interrupts
from mbd_sim_ros.fitting.driving import COLUMNS, Steering
from solver.disk import Store, digest
from solver.errors import MbdError

LOOK = 0.2  # s between looks for a signal while runs are waited for; ten times as much makes Ctrl-C slow
ORPHAN = 0.5  # s between looks of a process for the one that began it, which it outlives by as much


class Job(NamedTuple):
    """Windows to be driven. car, steering: numbers. centre: of a level that is linear in them."""

    car: dict[str, float]
    steering: Steering
    which: tuple[int, ...]
    centre: str

    @property
    def key(self) -> str:
        """All that the motions depend on, beside recordings and sources."""
        return repr((sorted(self.car.items()), self.steering, self.which, self.centre))


class Memory:
    """Motions that were driven already, on disk: a fit that was killed goes on with them."""

    def __init__(self, directory: Path, identity: str) -> None:
        self._store, self._identity = Store(directory), identity

    def read(self, key: str) -> np.ndarray | None:
        """The motions of a job, None where there are none."""
        name = digest(key).hex()
        content = self._store.read(name, self._identity, key)
        return None if content is None else np.frombuffer(content).reshape(-1, COLUMNS)

    def write(self, key: str, rows: np.ndarray) -> None:
        """Keep the motions of a job; on a full disk they are not kept."""
        with suppress(OSError):
            self._store.write(digest(key).hex(), np.ascontiguousarray(rows).tobytes(), self._identity, key)


Driven = np.ndarray | MbdError
Drive = Callable[[Job], Driven]


class Workers:
    """Processes that drive jobs. They begin with the first jobs, and end with close().

    made: makes what drives in a process, of the arguments given."""

    def __init__(self, count: int, made: Callable[..., Drive], given: Sequence[Any]) -> None:
        self._count, self._made, self._given = count, made, given
        self._pool: ProcessPoolExecutor | None = None

    def drive(self, jobs: Sequence[Job]) -> Iterator[Driven]:
        """The motions of the jobs, in their order, or why there are none."""
        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                self._count,
                multiprocessing.get_context('spawn'),
                initializer=_begin,
                initargs=(self._made, *self._given),
            )
        for one in [self._pool.submit(_there, job) for job in jobs]:
            while not wait([one], timeout=LOOK).done:
                interrupts.check()
            yield one.result()

    def close(self) -> None:
        """End the processes."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
            self._pool = None


_drive: Drive | None = None  # what drives in this process


def _begin(made: Callable[..., Drive], *given: Any) -> None:
    """Begin a process: Ctrl-C is for the one that asked, and it ends with that one."""
    global _drive
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(ORPHAN)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    _drive = made(*given)


def _there(job: Job) -> Driven:
    assert _drive is not None
    return _drive(job)
