"""What a search says of settings: those that were tried, those that were checked, and what leaving a subsystem out does."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from solver.trade.requirements import Bound
from solver.trade.setting import Setting
from solver.trade.variations import Variation


class Verdict(NamedTuple):
    """A setting that was tried: the largest share of a limit that its bounds use so far, its cost, why it was dropped ('': it passes)."""

    setting: Setting
    used: float
    cost: float  # expected CPU seconds per simulated second
    worst: str
    dropped: str
    bounds: dict[str, Bound]  # the worst over maneuvers by requirement
    error: float = 0.0  # largest share of a limit that its errors themselves use, as far as they were looked at
    part: float = 1.0  # of the scene's own maneuver that it was held against
    broken: str = ''  # the finding on its run for which it was dropped although it keeps the limits


def nearest(tried: Iterable[Verdict]) -> Verdict | None:
    """Of settings that were tried the one nearest to the limits: errors grow, so those count that kept them longest. None of none."""
    finite = (t for t in tried if math.isfinite(t.used))
    return min(finite, key=lambda t: (-t.part, t.used, t.cost), default=None)


class Check(NamedTuple):
    """The error itself on a maneuver that had no part in the choice."""

    variation: Variation
    used: float
    worst: str
    failure: str

    @property
    def passed(self) -> bool:
        return not self.failure and self.used <= 1.0


class Influence(NamedTuple):
    """What leaving one subsystem out does: errors as shares of the peak by quantity (RMS), and the cost of a step relative to before."""

    subsystem: str
    activity: float  # J
    errors: dict[str, float]
    cost: float
    failure: str
