"""What a scene requires of accuracy, limit by limit, and what of a limit is used by errors of different origin."""

from __future__ import annotations

import math
from typing import NamedTuple

from solver.analysis.departures import Departure
from solver.scene import Scene

ORIGINS = ('model', 'step', 'iteration', 'reference')


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
        """The error that is limited. Where nothing changes that could come late there is no delay when curves lie close to each other."""
        if self.measure != 'delay':
            return float(getattr(d, self.measure))
        if math.isnan(d.delay):
            return 0.0 if d.rms <= 0.05 * d.peak else math.inf
        return abs(d.delay)

    def __str__(self) -> str:
        return f'{self.quantity} {self.measure}'


def requirements(scene: Scene) -> list[Requirement]:
    """All limits of errors that a scene requires."""
    return [Requirement(name, m, b.value, b.share) for name, a in scene.require.accuracy.items() for m, b in a.bounds.items()]


class Bound(NamedTuple):
    """Errors of one requirement on one maneuver by origin, and the limit there."""

    requirement: Requirement
    parts: tuple[float, float, float, float]  # ORIGINS
    limit: float

    @property
    def used(self) -> float:
        """Share of the limit."""
        return sum(self.parts) / self.limit
