"""The moments of a drive that count, and how long those are that are left out: gaps, standstill, reversing, slow."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from mbd_sim_ros.analysis.evaluation.measures import low_passed
from mbd_sim_ros.analysis.evaluation.signals import Signals

SMOOTH = 1.0  # corner of the low pass without delay [Hz], as of ISO 4138; ten times as much leaves vibration
MEMORY = 1.0  # time beside a gap that is left out [s], which the low pass smears; ten times as much empties drives
# Speed below which a car of ORDINARY wheelbase is slow [m/s]: its curvature is then of the size of the noise of its
# sensors. Grows with the root of the wheelbase. Ten times as much is the speed of a motorway.
SLOW, ORDINARY = 3.0, 2.7
STANDS = 0.05  # part of that speed below which the car stands; ten times as much would take creeping for standstill
LEAST_STANDSTILL = 2.0  # s at rest from which on the offset of the yaw rate is taken out; ten times as much is rare
AVERAGED = 0.2  # s over which the speed is averaged for that; ten times as much hides a stop
STEPS = 3  # samples of the same value, from which on a signal is held; ten times as many would miss slow sensors
LEAST_CHANGES = 20  # of a signal that is looked at; ten times as many are not in a short drive
LONGEST = 0.5  # s that a sensor keeps its value; what a driver or a command keeps for ten times as long is meant so
RARE = 0.1  # part of the changes of a held signal that may come sooner; ten times as much is all of them
CORE = ('speed', 'yaw_rate', 'lateral_acceleration', 'steering', 'road_angle', 'road_angle_left', 'road_angle_right')


@dataclass(kw_only=True)
class Moments:
    """Moments of a drive. counted: (n,) mask of those that count. slowest: speed from which on [m/s]. seconds: time by
    what it is, over the whole recording [s]. offset: of the yaw rate at rest, taken out [rad/s]; None without a
    standstill. wheelbase: [m], NaN if not known."""

    s: Signals
    counted: np.ndarray
    slowest: float
    seconds: dict[str, float]
    wheelbase: float
    offset: float | None = None
    _smooth: dict[tuple[str, float], np.ndarray] = field(default_factory=dict)

    def smooth(self, name: str, corner: float = SMOOTH) -> np.ndarray:
        """(n,) a signal, low-passed without delay; the yaw rate without its offset at rest."""
        key = (name, corner)
        if key not in self._smooth:
            values = self.s[name]
            if name == 'yaw_rate' and self.offset is not None:
                values = values - self.offset
            self._smooth[key] = low_passed(values, self.s.rate, corner, poles=4)
        return self._smooth[key]

    def among(self, *names: str) -> np.ndarray:
        """(n,) mask of the moments that count and lie in no gap of these signals."""
        return self.counted & ~_beside(self.s, names)

    def rate(self, values: np.ndarray) -> np.ndarray:
        """(n,) derivative over time of smooth values."""
        return np.gradient(values, 1.0 / self.s.rate)


def moments(s: Signals, *, wheelbase: float, slowest: float | None) -> Moments:
    """Divide the time of a drive. slowest: speed from which on moments count [m/s]; None: by the wheelbase, or a
    quarter of the usual speed where it is not known and that is less."""
    from scipy.ndimage import uniform_filter1d

    v = uniform_filter1d(
        s['speed'], max(round(AVERAGED * s.rate), 1), mode='nearest'
    )  # rings nowhere, as a filter does
    usual = float(np.quantile(np.abs(v), 0.95))
    least = SLOW * math.sqrt(wheelbase / ORDINARY) if wheelbase > 0.0 else min(SLOW, 0.25 * usual)
    slowest = least if slowest is None else slowest
    gaps = _beside(s, CORE)
    stands = ~gaps & (np.abs(v) < STANDS * least)
    back = ~gaps & ~stands & (v < 0.0)
    slow = ~gaps & ~stands & ~back & (v < slowest)
    counted = ~(gaps | stands | back | slow)
    parts = {'counted': counted, 'gaps': gaps, 'standstill': stands, 'reversing': back, 'slow': slow}
    seconds = {name: float(mask.sum()) / s.rate for name, mask in parts.items()}
    offset = None
    if 'yaw_rate' in s and seconds['standstill'] >= LEAST_STANDSTILL:
        offset = float(np.median(s['yaw_rate'][stands]))
    return Moments(s=s, counted=counted, slowest=slowest, seconds=seconds, wheelbase=wheelbase, offset=offset)


def _beside(s: Signals, names: Sequence[str]) -> np.ndarray:
    """(n,) True within the gaps of these signals, and as long beside them as the low pass remembers."""
    from scipy.ndimage import binary_dilation

    masks = [s.missing[name] for name in names if name in s.missing]
    if not masks:
        return np.zeros(s.t.size, bool)
    return binary_dilation(np.logical_or.reduce(masks), iterations=max(round(MEMORY * s.rate), 1))


def held(s: Signals, name: str) -> float:
    """Time for which a signal keeps each of its values [s], as that of a slower sensor in the rows of a faster one; 0
    where it does not. A signal in coarse steps keeps its value only while it hardly changes."""
    changes = np.flatnonzero(np.diff(s[name]))
    if changes.size < LEAST_CHANGES:
        return 0.0
    groups = np.flatnonzero(np.diff(changes, prepend=-2) > 1)  # a change between two instants of the grid is two
    if np.mean(np.diff(groups, append=changes.size) > 2) > RARE:
        return 0.0
    apart = np.diff(changes[groups])
    seconds = float(np.median(apart)) / s.rate
    return seconds if np.quantile(apart, RARE) >= STEPS and seconds <= LONGEST else 0.0
