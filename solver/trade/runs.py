"""Runs of a scene with one setting, seen through quantities of interest."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple, TypeVar

import numpy as np
from scipy.interpolate import CubicSpline

from solver import simulation_of
from solver.analysis.departures import FAILED, Departure, departure
from solver.analysis.envelope import Envelope
from solver.analysis.verdict import findings
from solver.errors import MbdError, SpecError
from solver.findings import Finding
from solver.quantities import Quantity, quantity
from solver.scene import Scene
from solver.simulation import Simulation
from solver.trade.setting import Setting
from solver.vehicle.size import size_of

SAMPLE_NS = 2_000_000  # runs are sampled at every step that is at least this long, shorter ones at every few
NOT_DETERMINED = 'a driver passes a singular position, where its effort is not determined: require no accuracy of it'
Curves = dict[str, np.ndarray]
T = TypeVar('T')
R = TypeVar('R')


class Stopped(Exception):
    """Somebody who asks for runs wants no more of them."""


class Run(NamedTuple):
    """A run as far as it came."""

    setting: Setting
    time: np.ndarray  # (n,) [s] from 0 on
    curves: Curves  # quantity -> (n, components); those that the model does not publish are not there
    counters: dict[str, float]
    failure: str  # why it ended early, or ''


def run(
    scene: Scene,
    setting: Setting,
    quantities: Sequence[str],
    *,
    stop: Callable[[], bool] | None = None,
    make: Callable[[], Simulation] | None = None,
) -> Run:
    """Run a scene this way to its end; a failure ends the run and is kept. stop(), make(): as Going takes them."""
    return Going(scene, setting, quantities, stop=stop, make=make).to(scene.duration)


class Going:
    """A run that can be looked at in between. Nothing is raised but Stopped.

    stop(): raise Stopped soon. make(): the simulation of the setting, where somebody knows its start already. audit:
    keep the account that findings() needs.
    """

    def __init__(
        self,
        scene: Scene,
        setting: Setting,
        quantities: Sequence[str],
        *,
        stop: Callable[[], bool] | None = None,
        make: Callable[[], Simulation] | None = None,
        audit: bool = False,
    ) -> None:
        self.setting, self._stop, self._audit = setting, stop, audit
        self._envelope: Envelope | None = None
        self._found: dict[str, Quantity] = {}
        self._rows: list[np.ndarray] = []
        self._t: list[int] = []
        self._failure, self._told = '', 0
        self._simulation: Simulation | None = None
        try:
            s = self._simulation = simulation_of(setting.of(scene)) if make is None else make()
        except MbdError as error:
            self._failure = str(error)
            return
        for name in quantities:
            try:
                self._found[name] = quantity(name, s.channels, size_of(s.scene.model))
            except SpecError:
                continue
        self._envelope = Envelope(s) if audit else None
        self._places = (
            np.unique(np.concatenate([q.places for q in self._found.values()])) if self._found else np.zeros(0, int)
        )
        self._every = max(1, -(-SAMPLE_NS // s.h_ns))
        self._keep(s.snapshot())

    def _keep(self, snapshot: Any) -> None:
        if self._envelope is not None:
            self._envelope.look(snapshot)
        self._t.append(snapshot.t_ns)
        self._rows.append(snapshot.numbers[self._places])

    def to(self, until: float) -> Run:
        """The run up to a time [s]."""
        if not self._failure:
            s = self._simulation
            assert s is not None  # or making it has failed
            last = round(until * 1e9)
            try:
                while (s.k + self._every) * s.h_ns <= last:
                    if self._stop is not None and self._stop():
                        raise Stopped
                    snapshot = s.advance(self._every, audit=self._audit)
                    self._keep(snapshot)
                    if not np.all(np.isfinite(self._rows[-1])):
                        what = NOT_DETERMINED if snapshot.is_finite() else 'the motion is no longer finite'
                        self._failure = f't = {s.t_ns * 1e-9:g} s: {what}'
                        break
            except MbdError as error:
                self._failure = str(error)
        return self._run()

    def new_steps(self) -> int:
        """Steps since this was last asked."""
        before, self._told = self._told, 0 if self._simulation is None else self._simulation.k
        return self._told - before

    def findings(self) -> tuple[Finding, ...]:
        """The findings that make the run so far suspect; nothing of one that failed, or was made without audit."""
        if self._failure or self._envelope is None or self._simulation is None:
            return ()
        return (*findings(self._simulation), *self._envelope.findings())

    def _run(self) -> Run:
        if self._simulation is None:
            return Run(self.setting, np.zeros(0), {}, {}, self._failure)
        rows, t = np.array(self._rows), np.array(self._t) * 1e-9
        curves = {name: q.of(rows[:, np.searchsorted(self._places, q.places)]) for name, q in self._found.items()}
        totals = self._simulation.totals()
        steps = max(self._simulation.k, 1)
        counters = {name: float(totals[name]) / steps for name in ('iterations', 'factorizations', 'evaluations')}
        return Run(self.setting, t, curves, {'steps': float(self._simulation.k), **counters}, self._failure)


def at(times: np.ndarray, found_times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values (n, components) given at found_times, at other times: exactly where they are among them, by a cubic spline
    elsewhere."""
    if times.shape == found_times.shape and np.array_equal(times, found_times):
        return values
    places = np.clip(np.searchsorted(found_times, times - 1e-12), 0, len(found_times) - 1)
    if np.all(np.abs(found_times[places] - times) < 1e-9):
        return values[places]
    return CubicSpline(found_times, values)(times)


def departures(
    found: Run,
    time: np.ndarray,
    curves: Curves,
    quantities: dict[str, Quantity],
    peaks: dict[str, float],
    names: Collection[str] | None = None,
) -> dict[str, Departure]:
    """Errors of a run against curves at the instants `time`, by quantity. What failed, or is not modelled, is
    infinitely far. names: of the quantities that are looked at, None: all."""
    result = {}
    for name, q in quantities.items():
        if names is not None and name not in names:
            continue
        if found.failure or name not in found.curves or name not in curves:
            result[name] = FAILED
            continue
        used = found.time <= time[-1] + 1e-9
        reference = at(found.time[used], time, curves[name])
        result[name] = departure(q, found.time[used], found.curves[name][used], reference, peaks[name])
    return result


def all_of(work: Callable[[T], R], items: Sequence[T], workers: int | None) -> list[R]:
    """work(item) of all items, so many at a time (None: as many as there are cores)."""
    with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        futures = [pool.submit(work, item) for item in items]
        try:
            return [future.result() for future in futures]
        finally:
            for future in futures:
                future.cancel()


def clock() -> float:
    """Seconds of wall time."""
    return time.monotonic()
