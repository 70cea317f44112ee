"""Departures of a signal from its reference: largest and root mean square error, and the delay."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.quantities import Quantity, lengths

ROUNDS = 4  # of the search for the delay; it converges quadratically


class Departure(NamedTuple):
    """Errors of one quantity over the time that is compared."""

    max: float  # in the unit of the quantity
    rms: float
    peak: float  # of the reference, which percentages refer to
    # [s] by which the signal comes later; not a number where the reference hardly changes, infinite where shapes do not
    # fit
    delay: float

    def share(self, measure: str) -> float:
        """Error of a measure as part of the peak."""
        return float(getattr(self, measure)) / self.peak


FAILED = Departure(np.inf, np.inf, np.nan, np.nan)


def departure(
    quantity: Quantity, time: np.ndarray, values: np.ndarray, reference: np.ndarray, peak: float | None = None
) -> Departure:
    """Departure of values (n, components) at the instants time (n,) [s] from the reference (n, components) there.

    peak: of the reference over a longer time, where only a part of it is compared.
    """
    error = lengths(values - reference)
    if not np.all(np.isfinite(error)):
        return FAILED
    peak = quantity.peak(reference) if peak is None else peak
    return Departure(
        float(error.max()), float(np.sqrt(np.mean(error * error))), peak, delay(time, values, reference, quantity.least)
    )


def delay(time: np.ndarray, values: np.ndarray, reference: np.ndarray, least: float) -> float:
    """The d [s] with which reference(t - d) + constant fits values best, by least squares (Gauss-Newton from d = 0).

    Not a number where the reference changes by less than `least`, or along a straight line, which a constant moves as
    well. Infinite where shapes do not fit: what is left is more than half of how values or reference change.
    """
    if len(time) < 8 or np.ptp(reference, axis=0).max() < least:
        return np.nan
    slope = np.gradient(reference, time, axis=0)
    d = 0.0
    for round_ in range(ROUNDS + 1):
        used = (time - d >= time[0]) & (time - d <= time[-1])
        if used.sum() < 0.75 * len(time):
            return np.nan if _fits(_free(values), _free(reference)) else np.inf
        at = time[used] - d
        moved, rate = (
            _free(np.column_stack([np.interp(at, time, c) for c in curve.T])) for curve in (reference, slope)
        )
        x = _free(values[used])
        size = float((rate * rate).sum())
        if size == 0.0:
            return np.nan
        if round_ < ROUNDS:
            d -= float(((x - moved) * rate).sum()) / size
    return d if _fits(x, moved) else np.inf


def _fits(a: np.ndarray, b: np.ndarray) -> bool:
    """True where two curves without their means share more than half of the change of each."""
    return float(((a - b) ** 2).sum()) < 0.5 * min(float((a * a).sum()), float((b * b).sum()))


def _free(values: np.ndarray) -> np.ndarray:
    """Without the mean."""
    return values - values.mean(axis=0)
