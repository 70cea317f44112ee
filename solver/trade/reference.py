"""The converged solution of a scene: Richardson's limit of the step, its band, and a second formulation that confirms
it.

Three runs of the same model with steps h, h/2 and h/4, iterated to tolerance, have errors e h^p + ...; p is 2, the
order of the method, or 1 where a driver looks once per step. The limit is the extrapolation of the two finest, the band
the distance to that of the two coarser ones. The same code twice proves nothing about a mistake that both share: the
second formulation solves the same equations with the multipliers kept (form 'block'), other penalties and other
damping, so that all that depends on these choices differs.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from solver.analysis.departures import Departure, departure
from solver.errors import StepError
from solver.quantities import Quantity, published, quantity
from solver.scene import Scene
from solver.trade.runs import Curves, Run, at, departures
from solver.trade.setting import Setting
from solver.vehicle.size import size_of

STEPS = (4e-3, 2e-3, 1e-3)  # s, of three runs
FINEST = 0.125e-3  # s
SECOND = (('form', 'block'), ('penalty', 1e8), ('augmentation', 'plain'))
SECOND_RHO = 0.6


class Reference(NamedTuple):
    """The converged solution of a scene."""

    time: np.ndarray  # (n,) [s]
    curves: Curves
    quantities: dict[str, Quantity]
    peaks: dict[str, float]
    # how far the extrapolation of the two coarser runs is; of two runs only that of the coarse one
    band: dict[str, Departure]
    steps: tuple[float, ...]  # s
    runs: tuple[Run, ...]

    @property
    def as_run(self) -> Run:
        """The solution as if it had been a run."""
        return Run(self.runs[-1].setting, self.time, self.curves, {}, '')

    def errors(self, found: Run, names: Collection[str] | None = None) -> dict[str, Departure]:
        """The errors of a run against it. names: of the quantities that are looked at, None: all."""
        return departures(found, self.time, self.curves, self.quantities, self.peaks, names)


def order(scene: Scene) -> int:
    """The order of the error in the step."""
    return 1 if scene.maneuver.closed_loop else 2


def extrapolated(coarse: Run, fine: Run, p: int) -> tuple[np.ndarray, Curves]:
    """(instants, curves) without the error of order h^p, at the instants of the finer run: a third of what a spline
    between those of the coarser one is off by is less than it would be of the whole."""
    ratio = (coarse.setting.h / fine.setting.h) ** p
    time = max(coarse.time, fine.time, key=len)
    time = time[time <= min(coarse.time[-1], fine.time[-1]) + 1e-9]
    curves = {}
    for name in coarse.curves:
        a, b = (at(time, r.time, r.curves[name]) for r in (coarse, fine))
        curves[name] = b + (b - a) / (ratio - 1.0)
    return time, curves


def with_step(base: Setting, h: float) -> Setting:
    """The setting iterated to tolerance with this step."""
    return dataclasses.replace(base, h=h, iterations=None)


def second(base: Setting) -> Setting:
    """The second formulation of a setting."""
    return dataclasses.replace(base, other=SECOND, rho_inf=SECOND_RHO)


def of_runs(scene: Scene, runs: Sequence[Run]) -> Reference:
    """The limit of runs that differ in their step alone, coarsest first; one alone is itself, and has no band. Raises
    StepError."""
    for one in runs:
        if one.failure:
            raise StepError(f'{one.setting}: {one.failure}')
    p = order(scene)
    time, best = extrapolated(runs[-2], runs[-1], p) if len(runs) > 1 else (runs[0].time, runs[0].curves)
    channels = published(scene.model)
    size = size_of(scene.model)
    quantities = {name: quantity(name, channels, size) for name in best}
    peaks = {name: q.peak(best[name]) for name, q in quantities.items()}
    if len(runs) > 2:
        before_time, before = extrapolated(runs[-3], runs[-2], p)
    else:
        before_time, before = runs[0].time, runs[0].curves
    band = {}
    for name, q in quantities.items():
        reference = at(before_time, time, best[name])
        band[name] = departure(q, before_time, before[name], reference, peaks[name])
    return Reference(time, best, quantities, peaks, band, tuple(r.setting.h for r in runs), tuple(runs))
