"""The ledger of a plan: runs, steps and CPU time by what they were made for."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Lock, local
from typing import NamedTuple

FIRST, REFERENCE, SECOND, LEVELS, SEARCH, SUBSYSTEMS, UNSEEN, PRICES = PURPOSES = (
    'first answer', 'reference', 'second formulation', 'errors of '
        'levels', 'search', 'subsystems', 'unseen maneuvers', 'cost of steps',
)  # fmt: skip


class Spent(NamedTuple):
    """Runs that were made, starts that were sought, steps, and the CPU time [s] of all that."""

    runs: int = 0
    starts: int = 0
    steps: int = 0
    cpu: float = 0.0


@dataclass
class Ledger:
    """Account of what was spent for each purpose. purpose: the present one; threads that work at the same time work for
    the same one. once: CPU time [s] of that for what is kept for all plans of the vehicle."""

    purpose: str = FIRST
    spent: dict[str, Spent] = field(default_factory=dict)
    once: float = 0.0
    lock: Lock = field(default_factory=Lock)
    inside: local = field(default_factory=local)

    def add(self, *, runs: int = 0, starts: int = 0, steps: int = 0, cpu: float = 0.0, once: float = 0.0) -> None:
        """Enter what was spent for the present purpose. cpu, once [s]."""
        with self.lock:
            self.once += once
            before = self.spent.get(self.purpose, Spent())
            self.spent[self.purpose] = Spent(
                before.runs + runs, before.starts + starts, before.steps + steps, before.cpu + cpu
            )

    @contextmanager
    def timed(self, *, starts: int = 0) -> Iterator[None]:
        """Enter the CPU time that this thread spends inside, once where one of these stands inside another."""
        begin, outermost = time.thread_time(), not getattr(self.inside, 'yes', False)
        self.inside.yes = True
        try:
            yield
        finally:
            self.inside.yes = not outermost
            self.add(starts=starts, cpu=time.thread_time() - begin if outermost else 0.0)

    def table(self) -> dict[str, dict[str, float]]:
        """By purpose, in the order in which a plan goes."""
        return {purpose: self.spent[purpose]._asdict() for purpose in PURPOSES if purpose in self.spent}
