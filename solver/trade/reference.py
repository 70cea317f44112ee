"""The converged solution of a scene: Richardson's limit of the step, its band, and a second formulation that confirms it.

Three runs of the same model with steps h, h/2 and h/4, iterated to tolerance, have errors e h^p + ...; p is 2, the order of the method, or
1 where a driver looks once per step. The limit is the extrapolation of the two finest, the band the distance to that of the two coarser
ones. The same code twice proves nothing about a mistake that both share: the second formulation solves the same equations with the
multipliers kept (form 'block'), other penalties and other damping, so that all that depends on these choices differs.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from solver import simulation_of
from solver.analysis.departures import Departure, departure
from solver.errors import StepError
from solver.quantities import Quantity, published, quantity
from solver.scene import Scene
from solver.trade.kept_runs import KeptRuns
from solver.trade.runs import Curves, Run, at, departures, run
from solver.trade.setting import Setting
from solver.trade.variations import AS_GIVEN
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
    band: dict[str, Departure]  # how far the extrapolation of the two coarser runs is; of two runs only that of the coarse one
    steps: tuple[float, ...]  # s
    runs: tuple[Run, ...]

    def errors(self, found: Run) -> dict[str, Departure]:
        """How far a run is from it."""
        return departures(found, self.time, self.curves, self.quantities, self.peaks)


def order(scene: Scene) -> int:
    """The order of the error in the step."""
    return 1 if scene.maneuver.closed_loop else 2


def extrapolated(coarse: Run, fine: Run, p: int) -> tuple[np.ndarray, Curves]:
    """(instants, curves) without the error of order h^p, at the instants of the coarser run."""
    ratio = (coarse.setting.h / fine.setting.h) ** p
    time = coarse.time if len(coarse.time) <= len(fine.time) else fine.time
    time = time[time <= min(coarse.time[-1], fine.time[-1]) + 1e-9]
    curves = {}
    for name in coarse.curves:
        a, b = (at(time, r.time, r.curves[name]) for r in (coarse, fine))
        curves[name] = b + (b - a) / (ratio - 1.0)
    return time, curves


def converged(
    scene: Scene, base: Setting, names: Sequence[str], steps: Sequence[float] = STEPS, stop: Callable[[], bool] | None = None
) -> Reference:
    """The limit of the model of `base` over the runs with these steps, coarsest first; two of them give no band of their own.

    Raises StepError when one of them fails.
    """
    runs = [run(scene, with_step(base, h), names, stop=stop) for h in steps]
    return of_runs(scene, runs)


def with_step(base: Setting, h: float) -> Setting:
    """The setting iterated to tolerance with this step."""
    return dataclasses.replace(base, h=h, iterations=None)


def of_runs(scene: Scene, runs: Sequence[Run]) -> Reference:
    """The limit of runs that differ in their step alone, coarsest first. Raises StepError."""
    for one in runs:
        if one.failure:
            raise StepError(f'{one.setting}: {one.failure}')
    p = order(scene)
    # the instants of the finest run that are those of the coarsest too; between these the finest pair alone is used
    time, best = extrapolated(runs[-2], runs[-1], p)
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


def second_formulation(
    scene: Scene,
    reference: Reference,
    stop: Callable[[], bool] | None = None,
    *,
    finest: bool = True,
    kept: KeptRuns | None = None,
) -> dict[str, Departure]:
    """How far the limit of another formulation of the same model, from the same start, is from the reference: that of its two finest steps,
    or of the two before, which is as far from it as its band says.

    (Where a vehicle settles before t = 0 depends a little on rho_inf. A setting with another one is charged with that, the equations are
    not.)
    """
    names, first = list(reference.curves), reference.runs[-1].setting
    base = dataclasses.replace(first, other=SECOND, rho_inf=SECOND_RHO)
    start = simulation_of(first.of(scene)).save()
    kept = kept or KeptRuns(None, '', names)

    def made(setting: Setting) -> Run:
        return kept.made(AS_GIVEN, setting, lambda: run(scene, setting, names, stop=stop, start=start))

    steps = reference.steps[-2:] if finest else reference.steps[-3:-1]
    other = of_runs(scene, [made(with_step(base, h)) for h in steps])
    return reference.errors(Run(base, other.time, other.curves, {}, ''))
