"""One even grid of time for the channels of a recording: which instants all of them share, what lies in gaps, and their
values there."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from mbd_sim_ros.analysis.evaluation.measures import low_passed
from mbd_sim_ros.bags.reader import Run, Series
from solver.errors import BagError

POSE = tuple(f'odom/pose/{name}' for name in ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw'))
ANGLES = ('heading',)  # channels that are interpolated without jumps by full turns
LARGEST_RATE = 1000.0  # Hz of the grid; ten times as much is vibration, which no norm asks for
# Part of the rate of the grid. What is recorded finer is low-passed there: it would come back below half the rate. Ten
# times as much is no low pass.
BAND = 0.4
GAP = 0.25  # s without a sample that is told; ten times as much is a maneuver
SLOWER = 3.0  # times the usual interval: what is so much longer in a second is another rate; 30 hides a slow topic
SHARED = 0.95  # part of the time of all topics that an evaluation covers without a note; above 1 there is always one
MOST_SAMPLES = 5_000_000  # of the grid: an hour and more at its largest rate; ten times as many fill the memory


def numbers(series: Series, channel: str, place: str) -> tuple[np.ndarray, np.ndarray]:
    """(instants [ns], values) of a channel where it holds a number. Raises BagError where that is nowhere."""
    values = series.columns[channel]
    good = np.isfinite(values)
    if good.all():
        return series.time_ns, values
    if not good.any():
        raise BagError(f'{place}: the channel {channel} holds no number; map another with --map')
    return series.time_ns[good], values[good]


def shared_grid(times: Mapping[str, np.ndarray], place: str, held: frozenset[str]) -> tuple[np.ndarray, int, list[str]]:
    """(n,) instants [ns] in the time that all channels share, as fine as the finest of them; what counts as zero;
    notes.

    held: channels whose last value holds, so that they neither end before the others nor have gaps.
    """
    others = [t for c, t in times.items() if c not in held] or [*times.values()]
    begin, end = max(int(t[0]) for t in times.values()), min(int(t[-1]) for t in others)
    step = min((int(np.median(np.diff(t))) for t in times.values() if t.size > 1), default=0)
    if step <= 0 or end - begin < 10 * step:
        raise BagError(f'{place}: its topics share less than ten samples; an evaluation needs a maneuver')
    step = max(step, round(1e9 / LARGEST_RATE))
    if end - begin > MOST_SAMPLES * step:
        raise BagError(
            f'{place}: from {begin * 1e-9:.6g} to {end * 1e-9:.6g} s there are more than {MOST_SAMPLES} samples at '
            f'steps of {step * 1e-9:g} s; a clock was set meanwhile, or there is a long gap: cut the recording there'
        )
    notes, origin = [], 0 if begin < 10_000_000_000_000 else begin
    for t in others:
        if t.size < 2:
            continue
        apart = np.diff(t)
        widest = int(np.argmax(apart))
        if apart[widest] > max(GAP * 1e9, 3 * step):
            count = int(np.sum(apart > max(GAP * 1e9, 3 * step)))
            more = f', the longest of {count} such times' if count > 1 else ''
            notes.append(
                f'{apart[widest] * 1e-9:.3g} s without samples behind t = {(t[widest] - origin) * 1e-9:.3g} s{more}'
            )
    notes += _outside({c: t for c, t in times.items() if c not in held} or times, origin)
    grid = np.arange(begin, end + 1, step, dtype=np.int64)
    return grid, origin, list(dict.fromkeys(notes))


def gaps(grid: np.ndarray, time_ns: np.ndarray) -> np.ndarray:
    """(n,) True for the instants of the grid within a gap of a channel: GAP without a sample, and SLOWER usual
    intervals."""
    result = np.zeros(grid.size, bool)
    apart = np.diff(time_ns)
    if apart.size:
        for k in np.flatnonzero(apart > max(GAP * 1e9, SLOWER * float(np.median(apart)))):
            result[np.searchsorted(grid, time_ns[k], 'right') : np.searchsorted(grid, time_ns[k + 1])] = True
    return result


def spacing(time_ns: np.ndarray) -> float:
    """Time between two samples [ns]: the usual one or, where the rate is lower for a tenth of the time, that in its
    seconds. Stamps may be uneven, and seconds without any sample are gaps."""
    usual = float(np.median(np.diff(time_ns)))
    _, counts = np.unique((time_ns - time_ns[0]) // 1_000_000_000, return_counts=True)
    slow = float(np.quantile(1e9 / counts[:-1], 0.9)) if counts.size > 1 else usual  # the last second is not whole
    return slow if slow > SLOWER * usual else usual


def _outside(times: Mapping[str, np.ndarray], origin: int) -> list[str]:
    """A note where the time that all channels share is not nearly all there is: what begins last, or ends first. times:
    of those that are sampled, not of commands."""
    begins, ends = ({c: int(t[k]) for c, t in times.items()} for k in (0, -1))
    first, begin, end, last = min(begins.values()), max(begins.values()), min(ends.values()), max(ends.values())
    if end - begin >= SHARED * (last - first):
        return []
    late = begin - first > last - end
    who = (
        f'{max(begins, key=begins.__getitem__)} begins then' if late else f'{min(ends, key=ends.__getitem__)} ends then'
    )
    t = [(one - origin) * 1e-9 for one in (begin, end, first, last)]
    return [f'judged from t = {t[0]:.4g} to {t[1]:.4g} s alone, of {t[2]:.4g} to {t[3]:.4g} s: {who}']


def resampled(grid: np.ndarray, time_ns: np.ndarray, values: np.ndarray, name: str, hold: bool) -> np.ndarray:
    """(n,) values of a channel on the grid. Between samples they are interpolated, or the last one holds; of a channel
    that is finer than the grid they are low-passed first."""
    if name in ANGLES:
        values = np.unwrap(values)
    if np.array_equal(grid, time_ns):
        return values
    if hold:
        return values[np.clip(np.searchsorted(time_ns, grid, 'right') - 1, 0, None)]
    at, own = (grid - grid[0]).astype(float), (time_ns - grid[0]).astype(float)
    step = float(at[1])
    finer = (
        min(math.ceil(step / max(float(np.median(np.diff(own))), 1.0) - 0.01), 2 * values.size // at.size)
        if own.size > 1
        else 1
    )
    if finer < 2:
        return np.interp(at, own, values)
    fine = np.interp(np.arange((at.size - 1) * finer + 1) * (step / finer), own, values)
    return low_passed(fine, 1e9 * finer / step, 1e9 * BAND / step)[::finer]


def normalise(columns: dict[str, np.ndarray]) -> None:
    """Quaternions of length one again, after interpolation."""
    if all(name in columns for name in POSE[3:]):
        length = np.sqrt(sum(columns[name] ** 2 for name in POSE[3:]))
        for name in POSE[3:]:
            columns[name] = columns[name] / np.where(length > 0.0, length, 1.0)


def without_jumps(run: Run) -> dict[str, Series]:
    """The series of a run, its quaternions without changes of sign, so that they may be interpolated; zeros, which who
    knows no orientation sends, are none."""
    series = dict(run.series)
    for topic, one in run.series.items():
        if all(name in one.columns for name in POSE[3:]):
            q = np.column_stack([one.columns[name] for name in POSE[3:]])
            q[~(np.isfinite(q).all(axis=1) & q.any(axis=1))] = np.nan
            given = q[np.isfinite(q[:, 0])]
            flips = np.where((given[1:] * given[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
            given[1:] *= np.cumprod(flips)[:, None]
            q[np.isfinite(q[:, 0])] = given
            series[topic] = Series(one.time_ns, one.columns | dict(zip(POSE[3:], q.T)))
    return series
