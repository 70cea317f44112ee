"""Errors by origin: how far a run is from the converged full vehicle, how much of that is error of the model, of the
step and of the iteration, and what a scene allows.

Three differences lead from the converged full vehicle to a run. Each is measured by itself, for they may cancel:

    model      converged level without its switched-off subsystems, against the converged full vehicle
    step       the setting iterated to tolerance, against its converged level
    iteration  the setting with its iterations, against the same iterated to tolerance
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import NamedTuple

from solver.analysis.departures import FAILED, Departure
from solver.scene import Scene
from solver.trade.reference import Reference
from solver.trade.runs import Run, departures

ORIGINS = ('model', 'step', 'iteration', 'reference')  # the last one is the band of the converged full vehicle


class Error(NamedTuple):
    """Error of one quantity: the whole, against the converged full vehicle, and its parts."""

    whole: Departure
    model: Departure
    step: Departure
    iteration: Departure


def by_origin(
    truth: Reference, own: Reference, settled: Run, found: Run, names: Collection[str] | None = None
) -> dict[str, Error]:
    """The errors of the run `found` by quantity.

    truth: limit of the full vehicle. own: limit of the level of the run, `truth` itself where that is the full vehicle.
    settled: the run iterated to tolerance, `found` itself where it was. names: of the quantities that are looked at,
    None: all. By the triangle inequality the parts add up to no less than the whole whatever `own` is, also where it is
    not converged: what it lacks is then part of the model's error.
    """
    whole, step = truth.errors(found, names), own.errors(settled, names)
    none = {name: Departure(0.0, 0.0, peak, 0.0) for name, peak in truth.peaks.items()}
    model = none if own is truth else truth.errors(own.as_run, names)
    between = none
    if settled.failure:
        between = dict.fromkeys(truth.quantities, FAILED)
    elif settled is not found:
        between = departures(found, settled.time, settled.curves, truth.quantities, truth.peaks, names)
    return {name: Error(whole[name], model[name], step.get(name, FAILED), between[name]) for name in whole}


def without(truth: Reference, errors: dict[str, Error], with_all: Run, found: Run) -> dict[str, Error]:
    """The errors of the run `found` without some subsystems, from those of the run `with_all` of the same setting."""
    whole = truth.errors(found, errors)
    between = departures(found, with_all.time, with_all.curves, truth.quantities, truth.peaks, errors)
    return {
        name: Error(whole[name], added(error.model, between[name]), error.step, error.iteration)
        for name, error in errors.items()
    }


def added(a: Departure, b: Departure) -> Departure:
    """The largest that two departures one behind the other add up to."""
    return Departure(a.max + b.max, a.rms + b.rms, a.peak, abs(a.delay) + abs(b.delay))


class Requirement(NamedTuple):
    """One limit of one error."""

    quantity: str
    measure: str  # 'max', 'rms' or 'delay'
    value: float
    share: bool

    def limit(self, peak: float) -> float:
        """In SI units."""
        return self.value * peak if self.share else self.value

    def error(self, d: Departure) -> float:
        """The error that is limited. Where nothing changes that could come late there is no delay when curves lie close
        to each other."""
        if self.measure != 'delay':
            return float(getattr(d, self.measure))
        if math.isnan(d.delay):
            return 0.0 if d.rms <= 0.05 * d.peak else math.inf
        return abs(d.delay)

    def __str__(self) -> str:
        return f'{self.quantity} {self.measure}'


def requirements(scene: Scene) -> tuple[Requirement, ...]:
    """All limits of errors that a scene requires."""
    return tuple(
        Requirement(name, m, b.value, b.share)
        for name, a in scene.require.accuracy.items()
        for m, b in a.bounds.items()
    )


class Bound(NamedTuple):
    """Errors of one requirement on one maneuver by origin, and the limit there."""

    requirement: Requirement
    error: float  # the whole
    parts: tuple[float, float, float, float]  # ORIGINS
    limit: float

    @classmethod
    def of(cls, r: Requirement, error: Error, band: float, limit: float) -> Bound:
        """band: of the converged full vehicle, in the unit of the error."""
        return cls(
            r, r.error(error.whole), (r.error(error.model), r.error(error.step), r.error(error.iteration), band), limit
        )

    @property
    def used(self) -> float:
        """Share of the limit that the parts take, which may cancel in the whole."""
        return sum(self.parts) / self.limit

    @property
    def itself(self) -> float:
        """Share of the limit that the error and the band of the reference take."""
        return (self.error + self.parts[-1]) / self.limit
