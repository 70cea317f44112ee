"""The end stops of a steering: hands that go on turning there hold the steering wheel against them.

A maneuver that asks for the angle x gets y(x), which is x up to `lock` and ends GIVE lock beyond it. With the way r
that is asked for beyond the stop, over GIVE lock, the slope falls from 1 at r = 0 to 0 at r = 2 by a polynomial of the
fifth degree. So angle, rate and acceleration belong together, and what does not reach the stop keeps every bit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from solver.inputs.recorded import ACCELERATION, RATE
from solver.inputs.signals import Signal

GIVE = 0.02  # of the angle: how far the stops give way; with ten times as much a steering could pass its dead centre
AT_ONCE = 4096  # steps


def hold(u: np.ndarray, names: Sequence[str], lock: float | None) -> None:
    """Change inputs u (n, nu) so that the angle of the steering wheel stays at its end stops, where they ask for
    more."""
    if lock is None or 'steering' not in names:
        return
    at = names.index('steering')
    n = np.flatnonzero(np.abs(u[:, at]) > lock)
    if not len(n):
        return
    angle, width = u[n, at], GIVE * lock
    t = np.minimum(0.5 * (np.abs(angle) - lock) / width, 1.0)
    slope = 1.0 - t * t * t * (10.0 - t * (15.0 - 6.0 * t))
    u[n, at] = np.sign(angle) * (lock + width * 2.0 * (t - t * t * t * t * (2.5 - t * (3.0 - t))))
    if steering_moves(names):
        rate, acceleration = names.index('steering' + RATE), names.index('steering' + ACCELERATION)
        bend = -np.sign(angle) * 15.0 * (t * (1.0 - t)) ** 2 / width
        u[n, acceleration] = slope * u[n, acceleration] + bend * u[n, rate] ** 2
        u[n, rate] *= slope


def steering_moves(names: Sequence[str]) -> bool:
    """True where the angle of the steering wheel is a motion, with rate and acceleration."""
    return 'steering' + RATE in names and 'steering' + ACCELERATION in names


class BeyondEnd:
    """Follows what a signal asks for beyond the end stops, at the ends of steps of h [s]. largest: angle [rad]; first:
    time [s]."""

    def __init__(self, signal: Signal, lock: float, h: float) -> None:
        self.signal, self.lock, self._h = signal, lock, h
        self._begin()

    def _begin(self) -> None:
        self._k, self.largest, self.first = 0, 0.0, np.inf

    def look(self, k: int) -> None:
        """At what there is up to step k since the look before; where k is less than there it begins anew."""
        if k < self._k:
            self._begin()
        while self._k < k:
            n = min(k - self._k, AT_ONCE)
            t = np.arange(self._k + 1, self._k + n + 1) * self._h
            asked = np.abs(self.signal.jet(t).value)
            beyond = np.flatnonzero(asked > self.lock)
            if len(beyond):
                self.first = min(self.first, float(t[beyond[0]]))
                self.largest = max(self.largest, float(asked.max()))
            self._k += n
