"""Rows of what a simulation shows: its numbers behind every so many steps of one call (Simulation.advance)."""

from __future__ import annotations

import numpy as np


class Seen:
    """Table of the numbers of Snapshots, at steps of the grid that `every` divides; a call of advance() fills it anew.

    most: rows that there is room for; a call makes no more steps than that takes. size: numbers in a row. What is to be
    kept beyond the next call has to be copied. Raises ValueError for `every` below 1.
    """

    def __init__(self, every: int, most: int, size: int) -> None:
        if every < 1:
            raise ValueError(f'seen: every = {every}: must be 1 at least')
        self.every, self.most = every, most
        self._rows, self._steps = np.zeros((most, size)), np.zeros(most, np.int64)
        self._count = 0

    @property
    def steps(self) -> np.ndarray:
        """(n,) steps of the rows, ascending."""
        return self._steps[: self._count]

    @property
    def numbers(self) -> np.ndarray:
        """(n, size) rows, each as Snapshot.numbers."""
        return self._rows[: self._count]

    @property
    def free(self) -> np.ndarray:
        """Rows that are still to be filled."""
        return self._rows[self._count :]

    def fits(self, k: int, n: int) -> bool:
        """True where there is room for the rows of n steps from step k on."""
        return (k + n) // self.every - k // self.every <= self.most

    def clear(self) -> None:
        """Forget all rows."""
        self._count = 0

    def took(self, k: int, count: int) -> None:
        """So many rows have been filled from step k on."""
        first = k - k % self.every + self.every
        self._steps[self._count : self._count + count] = first + self.every * np.arange(count)
        self._count += count

    def look(self, k: int, numbers: np.ndarray) -> None:
        """Take the numbers shown after step k, where it is the turn of a row."""
        if k % self.every == 0:
            self._rows[self._count], self._steps[self._count] = numbers, k
            self._count += 1
