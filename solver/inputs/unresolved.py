"""Signals that change faster than the steps that sample them.

A step takes one value of a signal. A sine with a period of one step gives it the same value for ever, and one with
nearly that period a slow beat: both look smooth, and neither shows in the motion. So signals are looked at between the
steps: where, in half of WINDOW steps, they depart from the straight line between the values at both ends of a step by
more than LARGEST of their range, a period has fewer than about eight steps. A jump or a pulse does so in a step or two,
which costs what a step costs and no more.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from solver.inputs.signals import Signal

BETWEEN = (0.0, 0.17, 0.41, 0.68, 0.89)  # of a step; no common divisor that a period could have
# of the range of a signal; N steps a period reach (1 - cos(pi / N)) / 2, 0.038 for 8, and half of them 0.7 of it
LARGEST = 0.025
WINDOW = 10  # steps
AT_ONCE = 4096  # steps
LOOKS = 200_000  # steps of a run at most, for the range of a signal; of longer runs some are left out


class Departure(NamedTuple):
    """Largest departure of a signal from straight lines between steps [of its range], and the time when it first
    departed for long [s]."""

    largest: float
    first: float


class _Watched:
    """Values seen of a signal. range: in the whole run; before: whether the last steps departed; largest [of the
    range]."""

    def __init__(self, signal: Signal, h: float, duration: float) -> None:
        self.signal, self.h = signal, h
        steps = math.ceil(duration / h)
        self.range = float(np.ptp(self._between(np.arange(0, steps + 1, math.ceil((steps + 1) / LOOKS)))))
        self.before = np.zeros(WINDOW - 1, bool)
        self.largest, self.first = 0.0, math.inf

    def _between(self, steps: np.ndarray) -> np.ndarray:
        """Values (n, BETWEEN) in the steps of these numbers."""
        return self.signal.jet(((steps[:, None] + np.array(BETWEEN)) * self.h).ravel()).value.reshape(len(steps), -1)

    def look(self, k: int, n: int) -> None:
        """At n steps from step k on."""
        values = self._between(np.arange(k, k + n + 1))
        begin, end = values[:-1, :1], values[1:, :1]
        departs = np.abs(values[:-1] - begin - np.array(BETWEEN) * (end - begin)).max(axis=1)
        beyond = np.concatenate([self.before, departs > LARGEST * self.range])
        self.before = beyond[-(WINDOW - 1) :]
        if self.range > 0.0:
            self.largest = max(self.largest, float(departs.max()) / self.range)
        many = np.flatnonzero(np.convolve(beyond, np.ones(WINDOW), 'valid') >= WINDOW / 2)
        if len(many) and self.first == math.inf:
            self.first = (k + int(many[0])) * self.h


class Unresolved:
    """Follows signals, by name, that steps of h_ns sample: look() at what there is since the look before."""

    def __init__(self, signals: Mapping[str, Signal], h_ns: int) -> None:
        self._signals, self._h = signals, h_ns * 1e-9
        self._k = 0
        self._watched: dict[str, _Watched] = {}

    def look(self, k: int, duration: float) -> dict[str, Departure]:
        """The signals that steps up to k do not resolve, by name; their ranges are those within the duration [s] of the
        run. It begins anew if k is less than at the last look."""
        if k < self._k or not self._watched:
            self._k = 0
            self._watched = (
                {name: _Watched(signal, self._h, duration) for name, signal in self._signals.items()} if k else {}
            )
        while self._k < k and self._watched:
            n = min(k - self._k, AT_ONCE)
            for watched in self._watched.values():
                watched.look(self._k, n)
            self._k += n
        return {name: Departure(w.largest, w.first) for name, w in self._watched.items() if w.first < math.inf}
