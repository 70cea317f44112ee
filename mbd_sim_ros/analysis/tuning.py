"""Search for values of parameters, within bounds, that give figures wanted values.

Each figure is a smooth function of the parameters, evaluated by a computation that takes a second. The search is
damped Gauss-Newton [Levenberg1944] on what is missing of each figure, over its tolerance, with scipy's bounded linear
least squares; derivatives are differences over a fiftieth of the bounds, far above the noise of a figure. It begins
with the given car, and where it ends short of the target once more from both ends of the bounds: a figure need not
change in one direction only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from solver.errors import MbdError, SpecError

STEP = 0.02  # of the width of the bounds, for differences; ten times as much sees no slope but that of the bounds
TRIALS = 12  # steps of one search, an evaluation each
GAIN = 1e-2  # of the sum of squares: a step that gains less ends a search
AT_BOUND = 1e-3  # of the width of the bounds: closer to a bound is at it
DIGITS = 4  # of the width of the bounds to which found values are rounded, where that keeps the targets


class Key(NamedTuple):
    """A parameter of the vehicle. low, high, start: in the unit of its file; start: None where the file has none."""

    name: str
    low: float
    high: float
    start: float | None


class Target(NamedTuple):
    """A figure and its wanted value [SI]. tolerance: by which it may be missed [SI]."""

    name: str
    value: float
    tolerance: float


class _Reached(Exception):  # no error: the search has what it looked for
    """All targets are met."""


@dataclass(kw_only=True)
class Found:
    """The best point of a search. values: of the keys; figures: there [SI]; reached: whether all targets are within
    their tolerances. sensitivity: (targets, keys), change of each figure per unit of each key, at this point. holding:
    names of keys with the bound that keeps them, 'low' or 'high'. evaluations: made in all."""

    values: dict[str, float]
    figures: dict[str, float]
    reached: bool
    sensitivity: np.ndarray
    holding: dict[str, str] = field(default_factory=dict)
    evaluations: int = 0
    failures: tuple[str, ...] = ()


class Tuning:
    """A search. figures_at: values of the keys -> figures [SI]; raises MbdError where there are none. given: figures of
    the vehicle as it is."""

    def __init__(
        self,
        keys: Sequence[Key],
        targets: Sequence[Target],
        figures_at: Callable[[dict[str, float]], dict[str, float]],
        given: dict[str, float],
    ) -> None:
        self.keys, self.targets, self._figures_at = keys, targets, figures_at
        self._low = np.array([key.low for key in keys])
        self._width = np.array([key.high for key in keys]) - self._low
        self._known: dict[tuple[float, ...], np.ndarray | str] = {}
        self._best: tuple[float, np.ndarray] = (np.inf, self._start())
        if all(key.start is not None and key.low <= key.start <= key.high for key in keys):
            self._known[tuple(np.round(self._start(), 12))] = np.array([given[target.name] for target in targets])

    def run(self) -> Found:
        """Search. Raises MbdError where the figures cannot be found at the first point."""
        starts = [self._start(), np.zeros(len(self.keys)), np.ones(len(self.keys))]
        self._missing(starts[0])  # a wrong name is told at once
        if isinstance(why := self._known[tuple(np.round(starts[0], 12))], str):
            raise SpecError(why)
        try:
            for start in starts:
                self._search(start)
        except _Reached:
            pass
        at = self._rounded(self._best[1])
        slopes = self._slopes(at)
        missing = self._missing(at)
        reached = bool(np.max(np.abs(missing)) <= 1.0)
        gradient = self._scaled(slopes).T @ missing  # of half the sum of squares
        holding = {}
        for key, u, g in zip(self.keys, at, gradient, strict=True):
            if not reached and u <= AT_BOUND and g > 0.0:
                holding[key.name] = 'low'
            if not reached and u >= 1.0 - AT_BOUND and g < 0.0:
                holding[key.name] = 'high'
        return Found(
            values=self._values(at),
            figures=dict(zip([t.name for t in self.targets], self._of(at), strict=True)),
            reached=reached,
            sensitivity=slopes / self._width,
            holding=holding,
            evaluations=len(self._known),
            failures=tuple(dict.fromkeys(why for why in self._known.values() if isinstance(why, str))),
        )

    def _start(self) -> np.ndarray:
        """The given car as shares of the bounds, 0 to 1; the middle where a value is not within them."""
        found = []
        for key in self.keys:
            inside = key.start is not None and key.low <= key.start <= key.high
            found.append((key.start - key.low) / (key.high - key.low) if inside and key.start is not None else 0.5)
        return np.array(found)

    def _values(self, at: np.ndarray) -> dict[str, float]:
        values = self._low + self._width * at
        return {key.name: float(value) for key, value in zip(self.keys, values, strict=True)}

    def _of(self, at: np.ndarray) -> np.ndarray:
        """The figures at a point. Raises SpecError where there are none."""
        key = tuple(np.round(at, 12))
        if key not in self._known:
            try:
                found = self._figures_at(self._values(at))
                self._known[key] = np.array([found[target.name] for target in self.targets])
            except MbdError as error:
                self._known[key] = str(error)
        known = self._known[key]
        if isinstance(known, str):
            raise SpecError(known)
        return known

    def _missing(self, at: np.ndarray) -> np.ndarray:
        """Figures less their targets, over their tolerances; where there are no figures as far off as can be."""
        try:
            found = self._of(at)
        except SpecError:
            return np.full(len(self.targets), 1e6)
        wanted = np.array([target.value for target in self.targets])
        missing = (found - wanted) / np.array([target.tolerance for target in self.targets])
        size = float(missing @ missing)
        if size < self._best[0]:
            self._best = size, at.copy()
        return missing

    def _slopes(self, at: np.ndarray) -> np.ndarray:
        """(targets, keys): change of each figure over the whole width of each key, by differences inwards."""
        slopes = np.zeros((len(self.targets), len(self.keys)))
        try:
            here = self._of(at)
            for k in range(len(self.keys)):
                step = np.zeros(len(self.keys))
                step[k] = STEP if at[k] + STEP <= 1.0 else -STEP
                slopes[:, k] = (self._of(at + step) - here) / step[k]
        except SpecError:  # beyond a neighbour there are no figures: the search ends there
            return slopes
        return slopes

    def _scaled(self, slopes: np.ndarray) -> np.ndarray:
        return slopes / np.array([[target.tolerance] for target in self.targets])

    def _search(self, at: np.ndarray) -> None:
        """One search from a point: damped steps of Gauss and Newton within the bounds, whose derivatives follow what is
        found on the way [Broyden1965] until a step gains nothing; then they are measured anew. Raises _Reached as soon
        as all targets are met."""
        here, slopes, damping = self._missing(at), None, 0.0
        for _ in range(TRIALS):
            self._end_if_met(here)
            fresh = slopes is None
            if slopes is None:
                slopes = self._scaled(self._slopes(at))
            size = float(np.linalg.norm(slopes))
            rows = np.vstack([slopes, damping * size * np.eye(len(at))])
            step = lsq_linear(rows, np.concatenate([-here, np.zeros(len(at))]), bounds=(-at, 1.0 - at)).x
            new = np.clip(at + step, 0.0, 1.0)
            new = np.where(new < AT_BOUND, 0.0, np.where(new > 1.0 - AT_BOUND, 1.0, new))
            moved = new - at
            if np.linalg.norm(moved) < AT_BOUND:
                if fresh:
                    return
                slopes = None
                continue
            there = self._missing(new)
            if there @ there < here @ here:
                slopes = slopes + np.outer(there - here - slopes @ moved, moved) / (moved @ moved)
                damping = damping / 10.0 if damping > 1e-3 else 0.0
                little = there @ there > (1.0 - GAIN) * (here @ here)
                at, here = new, there
                if little and fresh:
                    self._end_if_met(here)
                    return
                slopes = None if little else slopes
            else:
                damping = max(0.1, 10.0 * damping) if fresh else damping
                slopes = slopes if fresh else None
        self._end_if_met(here)

    def _end_if_met(self, missing: np.ndarray) -> None:
        """Raise _Reached well within all tolerances, so that values which are rounded afterwards stay there."""
        if np.max(np.abs(missing)) <= 0.5:
            raise _Reached

    def _rounded(self, at: np.ndarray) -> np.ndarray:
        """A point whose values have few digits, where that is as good."""
        places = [DIGITS - 1 - int(np.floor(np.log10(width))) for width in self._width]
        values = [round(value, place) for value, place in zip(self._values(at).values(), places, strict=True)]
        near = np.clip((np.array(values) - self._low) / self._width, 0.0, 1.0)
        limit = max(1.0, float(np.max(np.abs(self._missing(at)))))
        return near if np.max(np.abs(self._missing(near))) <= limit else at
