"""How many steps that nobody looks at fit before the one that is due, by what steps took lately."""

from __future__ import annotations

APART = 8  # calls of several steps; in one of so many the first step is a call of its own, to show what the others take


class Room:
    """Room for steps in a time that they may take. steps: as many fit."""

    def __init__(self) -> None:
        self.steps = 0.0
        self._stalled = False  # whether those that were measured last took far more
        self._calls = 0  # of several steps

    def measured(self) -> bool:
        """Count a call of several steps; whether its first step is to be made apart, and the others measured."""
        self._calls += 1
        return self._calls % APART == 0

    def took(self, seconds: float, more: int, room: float) -> None:
        """Note what so many steps took [s] behind the first of a call, which has paid for waking: memory is slow after a sleep. They may
        take `room` [s].

        Of one that was alone (0 more) it is known that another takes no longer. While they fit one more is tried, and measured at once;
        what does not fit is made less, by half at most. A stall, which is as long as it likes, is nothing until another follows.
        """
        if seconds <= room:
            if self.steps < more + 1:
                self.steps, self._calls = more + 1.0, -1
        elif more and (seconds < 2.0 * room or self._stalled):
            self.steps = more * max(room / seconds, 0.5)
        self._stalled = more > 0 and seconds >= 2.0 * room
