"""The allowance of a plan: wall time, CPU time as a multiple of the full run, and the end that somebody asks for."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from solver.trade.runs import clock

LONGEST = 170.0  # s that a plan may take
# CPU times of the full run that a plan may take; with ten times as much it pays for those alone who make hundreds of
# runs
TIMES = 10.0


@dataclass
class Allowance:
    """Limits of what a plan may take.

    longest: wall time [s]. times: CPU times of the full run, the time `startup` [s] that this process had taken before
    included: a run takes that too. ended(): says that somebody wants no more of the plan. once(): CPU time [s] that was
    spent on what is kept for all plans of the vehicle, and does not count. until: the share of the whole that may be
    taken by now. full_run: CPU time [s] of the full run as a command, from its first line to its last step, infinite
    until it is known.
    """

    longest: float = LONGEST
    times: float = math.inf
    startup: float = 0.0
    ended: Callable[[], bool] = lambda: False
    once: Callable[[], float] = lambda: 0.0
    until: float = 1.0
    full_run: float = math.inf
    begin: float = field(default_factory=clock)
    cpu_before: float = field(default_factory=time.process_time)

    def begin_again(self) -> None:
        """Count from now on."""
        self.begin, self.cpu_before = clock(), time.process_time()

    @property
    def took(self) -> float:
        """Wall time [s] since the beginning."""
        return clock() - self.begin

    @property
    def cpu(self) -> float:
        """CPU time [s] of the plan, with what this process had taken before, without what was spent once for the
        vehicle."""
        return self.startup + time.process_time() - self.cpu_before - self.once()

    @property
    def spent(self) -> float:
        """Share of the whole that is gone."""
        return self._with(0.0)

    def _with(self, ahead: float) -> float:
        """Share of the whole that is gone when another `ahead` seconds are taken."""
        return max(self._of_time(ahead), (self.cpu + ahead) / (self.times * self.full_run))

    def _of_time(self, ahead: float = 0.0) -> float:
        return (self.took + ahead) / self.longest if self.longest else math.inf

    def late(self, ahead: float = 0.0) -> bool:
        """True when no more runs may be made, or nothing that takes another `ahead` seconds."""
        return self.ended() or self._with(ahead) > self.until

    def fits(self, ahead: float) -> bool:
        """True where another `ahead` seconds do not pass the whole."""
        return not self.ended() and self._with(ahead) <= 1.0

    def why_ended(self) -> str:
        """The reason why no more runs are made, in words."""
        if self.ended():
            return f'the plan was interrupted after {self.took:.0f} s'
        if self._of_time() >= self.cpu / (self.times * self.full_run):
            return f'the time was up after {self.took:.0f} s (mbd plan --time)'
        return (
            f'it has taken {self.cpu / self.full_run:.1f} times the CPU time of the full run (mbd plan --time '
            'SECONDS allows more)'
        )
