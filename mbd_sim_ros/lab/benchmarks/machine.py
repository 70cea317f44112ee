"""Conditions of a benchmark: the machine, versions of libraries and sources, and the load by other processes."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from solver.disk import sources


def fingerprint() -> dict[str, Any]:
    """Processor, versions, digest of the sources, load of the last minute (mean number of running processes),
    clock_cost()."""
    from llvmlite import binding

    return {
        'cpu': cpu_model(),
        'cores': os.cpu_count() or 1,
        'system': f'{platform.system()} {platform.release()} {platform.machine()}',
        'python': platform.python_version(),
        'numpy': version('numpy'),
        'numba': version('numba'),
        'llvm': '.'.join(map(str, binding.llvm_version_info)),
        'host_target': binding.get_host_cpu_name(),
        'source_hash': sources(),
        'load_average': os.getloadavg()[0],
        'clock_us': clock_cost(),
    }


def cpu_model() -> str:
    """Name, family, model and stepping of the processor as the kernel knows them."""
    try:
        lines = Path('/proc/cpuinfo').read_text(encoding='utf-8').split('\n\n')[0].splitlines()
    except OSError:
        return platform.processor() or 'unknown'
    values = {key.strip(): value.strip() for key, _, value in (line.partition(':') for line in lines)}
    detail = ', '.join(
        f'{key} {values[name]}' for key, name in (('family', 'cpu family'), ('model', 'model')) if name in values
    )
    return values.get('model name', 'unknown') + (f' ({detail})' if detail else '')


def clock_cost(n: int = 2000) -> float:
    """Time of one reading of the thread's CPU clock [us]; every figure of a single step contains about one."""
    begin = time.thread_time_ns()
    for _ in range(n):
        time.thread_time_ns()
    return (time.thread_time_ns() - begin) / n * 1e-3


@contextmanager
def on_one_core() -> Iterator[int]:
    """Bind the calling thread, and the threads that it starts, to one core; gives the number of the core (-1: not
    bound).

    The affinity is restored afterwards.
    """
    if not hasattr(os, 'sched_setaffinity'):  # not Linux
        yield -1
        return
    before = os.sched_getaffinity(0)
    core = idlest_core(before)
    os.sched_setaffinity(0, {core})
    try:
        yield core
    finally:
        os.sched_setaffinity(0, before)


@contextmanager
def on_all_cores() -> Iterator[None]:
    """Inside on_one_core: let the calling thread, and the threads and processes that it starts, use every core
    again."""
    if not hasattr(os, 'sched_setaffinity'):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, range(os.cpu_count() or 1))  # the kernel keeps to the cores that this process was given
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def core_ticks(core: int) -> list[float]:
    """Clock ticks of a core: user, nice, system, idle, iowait, irq, softirq, steal; empty without /proc/stat."""
    try:
        lines = Path('/proc/stat').read_text(encoding='utf-8').splitlines()
    except OSError:
        return []
    return next(([float(word) for word in line.split()[1:9]] for line in lines if line.startswith(f'cpu{core} ')), [])


def idlest_core(cores: Iterable[int], seconds: float = 0.3) -> int:
    """The core that is idle most during some seconds; of equal ones the last, because interrupts and daemons prefer the
    first."""

    def idle() -> dict[int, float]:
        return {core: sum(core_ticks(core)[3:5]) for core in sorted(cores)}

    before = idle()
    time.sleep(seconds)
    after = idle()
    return max(after, key=lambda core: (after[core] - before[core], core))


class Watch:
    """Measures, from its creation on, how much time other processes take from the calling thread and its core."""

    def __init__(self, core: int) -> None:
        self._core = core
        self._begin = self._now()

    def _now(self) -> tuple[float, float, float, float]:
        """(time this thread ran [ns], time it waited for a core [ns], stolen ticks of the core, all its ticks); 0 if
        unknown."""
        ticks = core_ticks(self._core)
        try:
            ran, waited, _ = Path('/proc/thread-self/schedstat').read_text(encoding='utf-8').split()
        except OSError:
            ran = waited = '0'
        return float(ran), float(waited), ticks[7] if ticks else 0.0, sum(ticks)

    def read(self) -> dict[str, float]:
        """Fractions since the creation: `waited` of the runnable time of the thread, `stolen` by the hypervisor of the
        core's time."""
        ran, waited, stolen, ticks = (b - a for a, b in zip(self._begin, self._now(), strict=True))
        return {'waited': waited / max(ran + waited, 1.0), 'stolen': stolen / max(ticks, 1.0)}
