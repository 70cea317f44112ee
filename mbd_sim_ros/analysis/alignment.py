"""Signals of different recordings at common instants, and the time offset between two recordings.

Kinds of signal, by which they are brought to other instants: 'linear' interpolates, 'hold' takes the last value given
(commands), 'angle' interpolates what np.unwrap gives, 'orientation' interpolates quaternions (x, y, z, w) along the
shortest rotation (slerp).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from solver.errors import BagError

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

Kind = Literal['linear', 'hold', 'angle', 'orientation']
GAP_NS = 250_000_000  # a longer time without samples is none that a recording has
EVEN = 3, 1.1  # intervals at least, none more than so many times the usual one: a signal that is sampled
TURN = 2.0 * np.pi
COARSE_POINTS = 200_000  # of the grid on which an offset is sought first
LEAST_OVERLAP = 0.5  # of the shorter recording, where an offset is sought
LEAST_CORRELATION = 0.5
SMOOTHING = 2.0  # standard deviation of the smoothing before an offset is sought, in samples
NEAR = 4  # lags on either side between which the correlation is a spline
AGAIN = 0.98  # another offset that fits as well, relative to the best correlation


class Signal(NamedTuple):
    """A channel: instants [ns], ascending, and values (n,) or, of an orientation, (n, 4) unit quaternions."""

    time_ns: np.ndarray
    values: np.ndarray


class Common(NamedTuple):
    """Signals at common instants [ns]."""

    time_ns: np.ndarray
    values: tuple[np.ndarray, ...]
    interpolated: bool  # whether any had to be
    # shared time relative to the longest of the recordings, after what sampling alone may take away, less what one lost
    overlap: float


class Offset(NamedTuple):
    """A time offset [ns] to be added to the stamps of the reference, and how well the signals then agree.

    correlation: of the two signals (Pearson) at the offset, negative where they fit with one of them turned in sign.
    again: the nearest other offset [s] that fits nearly as well with the same sign, None without. opposed: the same
    with the other sign.
    """

    nanoseconds: int
    correlation: float
    again: float | None
    opposed: float | None = None

    @property
    def seconds(self) -> float:
        """The offset in seconds."""
        return self.nanoseconds * 1e-9


def common(signals: Sequence[Signal], kind: Kind = 'linear') -> Common:
    """Bring signals to the instants of the coarsest of them in the time they share.

    Nothing is interpolated if these exist in a finer one. Commands that were sent on change hold to the end, and
    between their messages the instants of the others count too: what these did meanwhile would not be seen.
    Raises BagError when the signals share no time.
    """
    grids = [one.time_ns for one in signals]
    sampled = [kind != 'hold' or _is_even(t) for t in grids]
    ends = [int(t[-1]) for t, s in zip(grids, sampled) if s]
    first, last = max(int(t[0]) for t in grids), min(ends, default=max(int(t[-1]) for t in grids))
    spans = ' and '.join(f'{t[0] * 1e-9:g} to {t[-1] * 1e-9:g} s' for t in grids)
    if first > last:
        raise BagError(f'the runs do not overlap in time ({spans}); give --offset, or --align CHANNEL to find it')
    if all(t is grids[0] or np.array_equal(t, grids[0]) for t in grids[1:]):
        values = tuple(unwrapped(one.values) if kind == 'angle' else one.values for one in signals)
        return Common(grids[0], values, False, 1.0)
    inside = [t[np.searchsorted(t, first) : np.searchsorted(t, last, 'right')] for t in grids]
    coarse = min(inside, key=len)
    if not all(sampled):
        edges = np.unique(np.concatenate([[first], coarse, [last]]))
        held = [t[(t >= begin) & (t <= end)] for t in inside for begin, end in pairwise(edges) if end - begin > GAP_NS]
        coarse = np.unique(np.concatenate([coarse, *held]))
    if len(coarse) == 0:
        raise BagError(f'the runs have no instant in common in the time they share ({spans})')
    rows = [np.searchsorted(t, coarse) for t in grids]
    exact = [np.array_equal(t[np.minimum(r, t.size - 1)], coarse) for t, r in zip(grids, rows)]
    values = tuple(_at(one, coarse, r if e else None, kind) for one, r, e in zip(signals, rows, exact))
    longest = max(int(t[-1]) - int(t[0]) for t in grids)
    step = max(_step_ns(t) if s else min(_step_ns(t), GAP_NS) for t, s in zip(grids, sampled))
    usual = max((_step_ns(t) for t in grids if t.size > EVEN[0]), default=0)  # of fewer samples nothing is usual
    missing = max(0, longest - (last - first) - step) + (
        0 if kind == 'hold' else _lost_ns(inside, max(GAP_NS, 2 * usual))
    )
    return Common(coarse, values, not all(exact), 1.0 - missing / longest if longest else 1.0)


def _is_even(time_ns: np.ndarray) -> bool:
    """True where a signal is sampled, however seldom: a command that is sent on change has uneven intervals, or hardly
    any."""
    apart = np.diff(time_ns)
    return apart.size >= EVEN[0] and bool(np.max(apart) <= EVEN[1] * np.median(apart))


def _lost_ns(grids: Sequence[np.ndarray], least: int) -> int:
    """Time [ns] for which any of them has no instant, longer than `least`, while another has."""
    spans = []
    for k, t in enumerate(grids):
        for i in np.flatnonzero(np.diff(t) > least):
            begin, end = int(t[i]), int(t[i + 1])
            if any(np.searchsorted(o, end) > np.searchsorted(o, begin, 'right') for j, o in enumerate(grids) if j != k):
                spans.append((begin, end))
    lost, until = 0, min((begin for begin, _ in spans), default=0)
    for begin, end in sorted(spans):
        lost += max(0, end - max(begin, until))
        until = max(until, end)
    return lost


def _step_ns(time_ns: np.ndarray) -> int:
    """Half again the usual interval, so that a last sample more or less is no loss."""
    return int(1.5 * float(np.median(np.diff(time_ns)))) if time_ns.size > 1 else 0


def _at(signal: Signal, instants: np.ndarray, rows: np.ndarray | None, kind: Kind) -> np.ndarray:
    """Values of a signal at instants within its time; rows: where these are among its own."""
    values = unwrapped(signal.values) if kind == 'angle' else signal.values
    if rows is not None:
        return values[rows]
    behind = np.clip(np.searchsorted(signal.time_ns, instants, 'right'), 1, signal.time_ns.size - 1)
    if kind == 'hold':
        return values[np.searchsorted(signal.time_ns, instants, 'right') - 1]
    begin, end = signal.time_ns[behind - 1], signal.time_ns[behind]
    part = (instants - begin) / (end - begin)
    if kind == 'orientation':
        return slerp(values[behind - 1], values[behind], part)
    before = values[behind - 1]
    return np.where(part == 0.0, before, before + part * (values[behind] - before))


def unwrapped(values: np.ndarray) -> np.ndarray:
    """An angle without jumps by full turns. Only values within one turn can have been wrapped: others stay as they are.

    A signal sampled so slowly that it turns by more than half a turn in between, like a wheel, is never within one turn
    for long.
    """
    finite = values[np.isfinite(values)]
    if finite.size == 0 or np.ptp(finite) > TURN * (1.0 + 1e-6) or np.max(np.abs(finite)) > TURN * (1.0 + 1e-6):
        return values
    if np.any(np.abs(np.diff(finite)) > np.pi):
        result = values.copy()
        result[np.isfinite(values)] = np.unwrap(finite)
        return result
    return values


def is_wrapped(values: np.ndarray) -> bool:
    """True where the signal has jumps that `unwrapped` takes out."""
    return unwrapped(values) is not values


def same_turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a moved by the number of full turns that brings it nearest to b: where a count starts is arbitrary once angles
    were wrapped."""
    with np.errstate(invalid='ignore'):
        apart = a - b
    known = apart[np.isfinite(apart)]
    return a - TURN * np.round(np.median(known) / TURN) if known.size else a


def slerp(a: np.ndarray, b: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Unit quaternions (n, 4) on the shortest way from a to b. [Shoemake1985]"""
    dot = np.sum(a * b, axis=1)
    b = np.where(dot[:, None] < 0.0, -b, b)
    half = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    small = half < 1e-6  # there the chord is the arc to rounding
    sine = np.where(small, 1.0, np.sin(half))
    left = np.where(small, 1.0 - part, np.sin((1.0 - part) * half) / sine)
    right = np.where(small, part, np.sin(part * half) / sine)
    result = left[:, None] * a + right[:, None] * b
    with np.errstate(invalid='ignore'):  # beside no orientation there is none
        return result / np.linalg.norm(result, axis=1, keepdims=True)


def rotation_angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angle [rad], 0 to pi, of the rotation between the orientations a and b (n, 4), xyzw: 2 atan2(|vector|, |scalar|)
    of conj(a) b.

    NaN where one is zero, which sensors that give no orientation send.
    """
    va, wa, vb, wb = a[..., :3], a[..., 3:], b[..., :3], b[..., 3:]
    vector = wa * vb - wb * va - np.cross(va, vb)
    scalar = np.sum(a * b, axis=-1)
    given = np.any(a != 0.0, axis=-1) & np.any(b != 0.0, axis=-1)
    return np.where(given, 2.0 * np.arctan2(np.linalg.norm(vector, axis=-1), np.abs(scalar)), np.nan)


def find_offset(a: Signal, b: Signal) -> Offset:
    """The offset to be added to the times of b so that it agrees best with a, by cross-correlation.

    Both signals are brought to a grid of the interval of the coarser one, as means over that interval, and smoothed
    alike: noise above the band that both have would otherwise draw the result to or from whole intervals. The
    correlation is taken at all lags at which they share at least half of the shorter one, normalised by the means and
    variances of what they share [Lewis1995]. Between the lags it is a cubic spline, whose maximum is sought: a signal
    sampled often enough has a smooth correlation. The turned signal has the negative correlation; it is taken where it
    fits better, and not where it does hardly, as of a sine that half a period turns. Raises BagError where no offset
    fits.
    """
    a, b = _of_numbers(a), _of_numbers(b)
    if min(a.time_ns.size, b.time_ns.size) < 2:
        raise BagError('the signals are too short to find a time offset from; give it with --offset')
    spans = [int(s.time_ns[-1] - s.time_ns[0]) for s in (a, b)]
    dt = max(*(float(np.median(np.diff(s.time_ns))) for s in (a, b)), max(spans) / COARSE_POINTS)
    if min(spans) < 20 * dt:
        raise BagError('the signals are too short to find a time offset from; give it with --offset')
    x, y = (_regular(s, dt) for s in (a, b))
    correlation = _correlations(x, y)
    begin, middle = int(a.time_ns[0]) - int(b.time_ns[0]), y.size - 1
    same, turned = _peak(correlation), _peak(-correlation)
    sign, (best, lag, height), other = (-1, turned, same) if same[2] < AGAIN * turned[2] else (1, same, turned)
    moved = begin + round((lag - middle) * dt)
    if not height >= LEAST_CORRELATION:
        raise BagError(
            f'no time offset brings the signals together: the best, {moved * 1e-9:.4g} s, gives a correlation of '
            f'{sign * height:.2f}; choose a channel that moves more, or give --offset'
        )
    again = _again(sign * correlation, best)
    opposed = (begin + (other[1] - middle) * dt) * 1e-9 if other[2] >= AGAIN * height else None
    return Offset(moved, sign * height, None if again is None else (moved + (again - lag) * dt) * 1e-9, opposed)


def _peak(correlation: np.ndarray) -> tuple[int, float, float]:
    """The largest correlation: the lag of the grid, the lag between those of the grid, and its height there."""
    from scipy.interpolate import CubicSpline

    usable = np.isfinite(correlation)
    best = int(np.argmax(np.where(usable, correlation, -2.0)))
    near = np.arange(max(0, best - NEAR), min(correlation.size, best + NEAR + 1))
    near = near[usable[near]]
    lag, height = float(best), float(correlation[best]) if usable[best] else 0.0
    if near.size > 3:
        curve = CubicSpline(near, correlation[near])
        turning = [float(r) for r in curve.derivative().roots(extrapolate=False) if abs(r - best) <= 1.0]
        lag = max([*turning, lag], key=lambda at: float(curve(at)))
        height = float(curve(lag))
    return best, lag, height


def _of_numbers(signal: Signal) -> Signal:
    """A signal without the samples that hold no number, between which it goes on straight."""
    good = np.isfinite(signal.values)
    return signal if good.all() else Signal(signal.time_ns[good], signal.values[good])


def _regular(signal: Signal, dt: float) -> np.ndarray:
    """Means over intervals dt [ns] around the points of a grid from the first instant on, smoothed, without their
    mean."""
    from scipy.ndimage import gaussian_filter1d

    relative = (signal.time_ns - signal.time_ns[0]).astype(float)
    values = signal.values - np.mean(signal.values)
    integral = _integral(relative, values)
    grid = np.arange(int(relative[-1] // dt) + 1) * dt
    begin, end = np.maximum(grid - 0.5 * dt, 0.0), np.minimum(grid + 0.5 * dt, relative[-1])
    means = (integral(end) - integral(begin)) / (end - begin)
    smooth = gaussian_filter1d(means, SMOOTHING, mode='nearest')
    return smooth - smooth.mean()


def _integral(time: np.ndarray, values: np.ndarray) -> PPoly:
    """The integral of the straight lines between the samples."""
    from scipy.interpolate import PPoly

    step = np.diff(time)
    slope = np.diff(values) / step
    return PPoly(np.stack([slope, values[:-1]]), time).antiderivative()


def _correlations(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Pearson correlation of x[i + lag] and y[i] for the lags from -(len(y) - 1) on; NaN where too little is shared."""
    from scipy.fft import irfft, next_fast_len, rfft

    n = next_fast_len(x.size + y.size)
    products = irfft(rfft(x, n) * np.conj(rfft(y, n)), n)
    lags = np.arange(-(y.size - 1), x.size)
    products = products[lags % n]
    first, last = np.maximum(0, lags), np.minimum(x.size, y.size + lags)  # what is shared, in x
    count = (last - first).astype(float)

    def sums(values: np.ndarray, shift: np.ndarray | int) -> tuple[np.ndarray, np.ndarray]:
        total = np.concatenate([[0.0], np.cumsum(values)])
        squares = np.concatenate([[0.0], np.cumsum(values**2)])
        return total[last - shift] - total[first - shift], squares[last - shift] - squares[first - shift]

    sx, sxx = sums(x, 0)
    sy, syy = sums(y, lags)
    vx, vy = sxx - sx**2 / count, syy - sy**2 / count
    least = (
        1e-6 * max(float(np.sum(x * x)) / x.size, np.finfo(float).tiny),
        1e-6 * max(float(np.sum(y * y)) / y.size, np.finfo(float).tiny),
    )
    usable = (count >= LEAST_OVERLAP * min(x.size, y.size)) & (vx > least[0] * count) & (vy > least[1] * count)
    with np.errstate(invalid='ignore', divide='ignore'):
        return np.where(usable, (products - sx * sy / count) / np.sqrt(vx * vy), np.nan)


def _again(correlation: np.ndarray, best: int) -> int | None:
    """Another peak that is nearly as high as the best one, as periodic signals have."""
    values = np.nan_to_num(correlation, nan=-1.0)
    peaks = np.flatnonzero((values[1:-1] >= values[:-2]) & (values[1:-1] > values[2:])) + 1
    low = np.flatnonzero(values < 0.5 * values[best])
    left, right = np.max(low[low < best], initial=-1), np.min(low[low > best], initial=values.size)
    others = peaks[((peaks < left) | (peaks > right)) & (values[peaks] >= AGAIN * values[best])]
    return int(others[np.argmin(np.abs(others - best))]) if others.size else None
