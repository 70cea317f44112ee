"""Columns of a recording on one even time grid, smoothed alike, and the constant factor between two columns.

The first look (first.py) finds units and signs by such factors: between yaw rate and the derivative of yaw, say, the
factor is 1 in SI units.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.analysis.look.roles import Role
from mbd_sim_ros.bags.reader import Run

SMOOTH = 0.1  # standard deviation [s] of the Gaussian that smooths all columns; ten times as much leaves no maneuver
LAG = 0.5  # largest delay [s] between two columns that is tried; ten times as much would match one curve with the next
GAP = 0.5  # time [s] without a sample across which nothing is interpolated; ten times as much would bridge a maneuver
MOST = 40_000  # instants of the grid at most
LEAST = 100  # instants at least at which both columns have a value, for a factor between them
SAMPLES = 20  # finite values at least of a column that is looked at
# Spread of the ratio of two speeds, relative to the ratio, up to which it counts as constant. The slip of driven wheels
# and noise stay below; ten times as much would accept any ratio.
SPREAD = 0.1
MOVING = 0.2  # speed, relative to the largest speed, from which on ratios of speeds are taken


@dataclass
class Column:
    """A column of a recording, and what the first look found about it.

    role: the quantity that its name proposes. unit, sign: those that the data confirm, else None. why: the evidence, in
    sentences. against: the objections, in sentences. stated: the unit in the header of the file, '' where there is
    none.
    """

    name: str
    role: Role
    unit: str | None = None
    sign: int | None = None
    why: list[str] = field(default_factory=list)
    against: list[str] = field(default_factory=list)
    stated: str = ''

    @property
    def told(self) -> bool:
        """True where role, unit and sign are confirmed by data."""
        return self.unit is not None and self.sign is not None


class Fit(NamedTuple):
    """The relation y = factor * x + constant between two signals.

    correlation: of the two signals. lag: by how much y is later [s]. spread: None, or of a fit by ratio(): the spread
    of the ratio y / x, relative to the ratio; `correlation` is then 1 - spread.
    """

    factor: float
    correlation: float
    lag: float
    spread: float | None = None

    @property
    def text(self) -> str:
        """The relation in words."""
        late = f', {abs(self.lag):.2f} s {"later" if self.lag > 0 else "earlier"}' if abs(self.lag) >= 0.02 else ''
        if not math.isfinite(self.factor):
            return 'too little motion, or the factor is not constant'
        if self.spread is not None:
            return f'factor {self.factor:.4g} within {100.0 * self.spread:.1g} %'
        return f'factor {self.factor:.3g}, correlation {abs(self.correlation):.3f}{late}'


class Grid:
    """Columns of a recording on one even time grid.

    dt: time between two instants of the grid [s]. values: name -> (n,) values on the grid, NaN where the column has no
    samples. wraps: name of a yaw angle -> unit in which it jumps by full turns, '' where it does not jump.
    """

    def __init__(self, run: Run, columns: Sequence[Column]) -> None:
        home = {name: one for one in run.series.values() for name in one.columns}
        samples: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        for c in columns:
            values = home[c.name].columns[c.name]
            good = np.isfinite(values)
            if good.sum() >= SAMPLES:
                samples[c.name] = (home[c.name].time_ns[good] * 1.0, values[good].astype(float))
        self.dt, self.values, self.wraps = 0.01, {}, {}
        samples = _of_one_clock(samples)
        if not samples:
            return
        begin, end = min(t[0] for t, _ in samples.values()), max(t[-1] for t, _ in samples.values())
        self.dt = max(
            float(np.median([np.median(np.diff(t)) for t, _ in samples.values()])) * 1e-9,
            (end - begin) * 1e-9 / MOST,
            1e-3,
        )
        grid = np.arange(begin, end + 1.0, self.dt * 1e9)
        for c in columns:
            if c.name not in samples:
                continue
            t, values = samples[c.name]
            if c.role.what == 'yaw':
                values, self.wraps[c.name] = _unwrapped(values)
            behind = np.clip(np.searchsorted(t, grid), 1, t.size - 1)
            apart = t[behind] - t[behind - 1] > max(GAP * 1e9, 5.0 * float(np.median(np.diff(t))))
            apart |= (grid < t[0]) | (grid > t[-1])
            at = np.interp(grid, t, values)
            at[apart] = np.nan
            self.values[c.name] = at

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def changes(self, name: str) -> bool:
        """True where a column is not constant."""
        values = self.values[name][np.isfinite(self.values[name])]
        return values.size > 1 and bool(np.ptp(values) > 0.0)

    def smooth(self, values: np.ndarray, seconds: float = SMOOTH) -> np.ndarray:
        """Values (n,) smoothed by a Gaussian with a standard deviation in seconds; NaN values have no weight, and stay
        NaN."""
        from scipy.ndimage import gaussian_filter1d

        there = np.isfinite(values)
        weight = gaussian_filter1d(there.astype(float), seconds / self.dt)
        with np.errstate(invalid='ignore', divide='ignore'):
            result = gaussian_filter1d(np.where(there, values, 0.0), seconds / self.dt) / weight
        return np.where(there, result, np.nan)

    def of(self, name: str, seconds: float = SMOOTH) -> np.ndarray:
        """The column `name`, smoothed."""
        return self.smooth(self.values[name], seconds)

    def rate(self, values: np.ndarray) -> np.ndarray:
        """Derivative over time [1/s] of smooth values (n,)."""
        return np.gradient(values, self.dt)

    def fit(self, x: np.ndarray, y: np.ndarray) -> Fit:
        """Relation of two signals (n,) at the lag, up to LAG, with the largest correlation.

        Both signals have noise. The slope of the regression of y on x is too small, the ratio of the standard
        deviations is too large by as much. The factor is their geometric mean.
        """
        best = still = Fit(math.nan, 0.0, 0.0)
        most = round(LAG / self.dt)
        step = max(1, most // 25)
        for lag in sorted({*range(-most, most + 1, step), 0}, key=abs):
            a, b = (x[: x.size - lag], y[lag:]) if lag >= 0 else (x[-lag:], y[:lag])
            good = np.isfinite(a) & np.isfinite(b)
            if good.sum() < LEAST:
                continue
            a, b = a[good], b[good]
            sa, sb = float(a.std()), float(b.std())
            if not (sa > 1e-9 * (abs(a).max() + 1e-300) and sb > 1e-9 * (abs(b).max() + 1e-300)):
                continue
            c = float(np.mean((a - a.mean()) * (b - b.mean())) / (sa * sb))
            if abs(c) > abs(best.correlation) + 1e-4:
                best = Fit(math.copysign(math.sqrt(abs(c)), c) * sb / sa, c, lag * self.dt)
                still = best if lag == 0 else still
        # the largest correlation at the last lag is no maximum: there is no delay to be found
        return best if abs(best.lag) < LAG - 1.5 * step * self.dt else still

    def ratio(self, x: np.ndarray, y: np.ndarray) -> Fit:
        """Relation of two speeds (n,), which are zero at the same time: the factor is the median of y / x where x is
        large."""
        with np.errstate(invalid='ignore', divide='ignore'):
            parts = (y / x)[np.abs(x) > MOVING * np.nanmax(np.abs(x))]
        parts = parts[np.isfinite(parts)]
        if parts.size < LEAST:
            return Fit(math.nan, 0.0, 0.0)
        factor = float(np.median(parts))
        spread = float(1.4826 * np.median(np.abs(parts - factor)) / (abs(factor) + 1e-300))
        return Fit(factor, max(0.0, 1.0 - spread), 0.0, spread) if spread <= SPREAD else Fit(math.nan, 0.0, 0.0)


def _of_one_clock(samples: dict[str, tuple[np.ndarray, np.ndarray]]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """The samples of the columns whose times overlap.

    A recording may have stamps of two clocks, simulation time and time of day; the clock with more columns is taken.
    """
    groups: list[tuple[float, list[str]]] = []  # of each clock: its last instant, its columns
    for name, (t, _) in sorted(samples.items(), key=lambda one: one[1][0][0]):
        if groups and t[0] <= groups[-1][0]:
            groups[-1] = max(groups[-1][0], t[-1]), [*groups[-1][1], name]
        else:
            groups.append((t[-1], [name]))
    most = max((names for _, names in groups), key=len, default=[])
    return {name: samples[name] for name in most}


def _unwrapped(values: np.ndarray) -> tuple[np.ndarray, str]:
    """(the angle without its jumps by full turns, the unit 'rad' or 'deg' in which it jumps; '' where it does not
    jump)."""
    jumps = np.abs(np.diff(values))
    for unit, turn in (('rad', 2.0 * math.pi), ('deg', 360.0)):
        large = jumps[jumps > 0.75 * turn]
        if large.size and np.all(large < 1.1 * turn) and np.ptp(values) < 1.1 * turn:
            return np.unwrap(values, period=turn), unit
    return values, ''
