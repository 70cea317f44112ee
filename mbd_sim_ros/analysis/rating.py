"""Objective rating of a signal against a reference after ISO/TS 18571: corridor, phase, magnitude and slope, each 0 to
1.

R = 0.4 Z + 0.2 E_P + 0.2 E_M + 0.2 E_S.

- Corridor Z: mean over the samples of 1 inside the inner corridor (5 % of the peak of the reference), 0 outside the
  outer one (50 %) and ((outer - d) / (outer - inner))^2 in between.
- Phase E_P: the signals are moved against each other by up to 20 % of their length; the shift of m of n samples with
  the largest correlation gives 1 - m / (0.2 n). Magnitude and slope are judged after this shift. The time shift that is
  given besides is known better than to a sample: what is left of it is that of least squares.
- Magnitude E_M: dynamic time warping (squared distance, steps of weight one, a band of 10 % of the length) pairs the
  samples; e = sum |a - b| / sum |b| over the pairs gives 1 - e / 0.5, at least 0.
- Slope E_S: central differences, averaged over nine samples (fewer at the ends); e = sum |a' - b'| / sum |b'| gives 1 -
e / 2.

Source of formulas and parameters: [ISORating2024] by its public implementations, whose tests hold the results of the
annex of the standard. Beside the second of them all scores of 150 random pairs (scaled, shifted, disturbed, noisy,
unrelated; 60 to 600 samples) are the same to the nine digits that it gives. The text of the standard itself was not at
hand: not confirmed are its rules for the sampling of signals slower than those of a crash (it asks for 10 kHz) and its
names for ranges of R. Here signals are sampled at 50 Hz, finer where less than 20 s are shared (1000 samples), never
finer than they were recorded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

WEIGHTS = {'corridor': 0.4, 'phase': 0.2, 'magnitude': 0.2, 'slope': 0.2}
INNER, OUTER, CORRIDOR_EXPONENT = 0.05, 0.5, 2
SHIFT_MAX = 0.2  # of the length
BAND = 0.1  # of the length
MAGNITUDE_ERROR_MAX, SLOPE_ERROR_MAX = 0.5, 2.0
SMOOTHED = 9
LEAST = 11  # samples: after the largest shift there are nine
RATE = 50.0  # [Hz]
POINTS_LEAST, POINTS_MOST = 1000, 10_000
RANK = 1e-9  # slopes that are those of a straight line, or like the signal itself, tell no shift
SAME_SHIFT = 1e-6  # parts of a sample that are rounding
SAME_CORRELATION = 1e-9  # correlations nearer than this are the same but for rounding; then the smaller shift counts


@dataclass(frozen=True, kw_only=True)
class Rating:
    """Scores of one signal, 0 to 1, and the shift [s] by which it comes later than the reference."""

    corridor: float
    phase: float
    magnitude: float
    slope: float
    shift: float

    @property
    def overall(self) -> float:
        """The weighted mean."""
        return sum(weight * getattr(self, name) for name, weight in WEIGHTS.items())


def rate(time: np.ndarray, values: np.ndarray, reference: np.ndarray) -> Rating | None:
    """Rate a signal against its reference at the same instants [s]; None for signals of fewer than LEAST samples or
    with gaps."""
    if time.size < LEAST or not (np.all(np.isfinite(values)) and np.all(np.isfinite(reference))):
        return None
    grid = sampling(time)
    return rate_sampled(np.interp(grid, time, values), np.interp(grid, time, reference), float(grid[1] - grid[0]))


def sampling(time: np.ndarray) -> np.ndarray:
    """The instants [s] at which signals are rated."""
    span = float(time[-1] - time[0])
    points = min(max(span * RATE, POINTS_LEAST), POINTS_MOST, span / float(np.median(np.diff(time))))
    return np.linspace(time[0], time[-1], max(round(points), LEAST - 1) + 1)


def rate_sampled(values: np.ndarray, reference: np.ndarray, dt: float) -> Rating:
    """Rate a signal against its reference, both sampled at the interval dt [s], at least LEAST times."""
    from mbd_sim_ros.analysis.warping import warped  # numba is loaded where something is rated

    later = shift_of(values, reference)
    n = values.size
    moved, fixed = (values[later:], reference[: n - later]) if later >= 0 else (values[:later], reference[-later:])
    magnitude = _relative(
        *map(float, warped(np.ascontiguousarray(moved), np.ascontiguousarray(fixed), _band(moved.size)))
    )
    a, b = smooth_slope(moved), smooth_slope(fixed)
    slope = _relative(float(np.sum(np.abs(a - b))), float(np.sum(np.abs(b))))
    return Rating(
        corridor=corridor(values, reference),
        phase=max(0.0, 1.0 - abs(later) / (SHIFT_MAX * n)),
        magnitude=max(0.0, 1.0 - magnitude / MAGNITUDE_ERROR_MAX),
        slope=max(0.0, 1.0 - slope / SLOPE_ERROR_MAX),
        shift=(later + rest_of_shift(moved, fixed)) * dt,
    )


def corridor(values: np.ndarray, reference: np.ndarray) -> float:
    """The corridor score."""
    gap, peak = np.abs(values - reference), float(np.max(np.abs(reference)))
    if peak == 0.0:
        return float(np.mean(gap == 0.0))
    score = np.clip((OUTER * peak - gap) / ((OUTER - INNER) * peak), 0.0, 1.0) ** CORRIDOR_EXPONENT
    return float(np.mean(score))


def shift_of(values: np.ndarray, reference: np.ndarray) -> int:
    """By how many samples the signal comes later than the reference: the shift of largest correlation, the smaller of
    equals."""
    n = values.size
    x, y = values - values.mean(), reference - reference.mean()
    size = 1 << (2 * n - 1).bit_length()
    products = np.fft.irfft(np.fft.rfft(x, size) * np.conj(np.fft.rfft(y, size)), size)
    lags = np.arange(-int(SHIFT_MAX * n), int(SHIFT_MAX * n) + 1)
    first, last = np.maximum(0, lags), np.minimum(n, n + lags)
    count = last - first

    def moments(v: np.ndarray, begin: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        total, squares = np.concatenate([[0.0], np.cumsum(v)]), np.concatenate([[0.0], np.cumsum(v * v)])
        s = total[end] - total[begin]
        return s, squares[end] - squares[begin] - s * s / count

    sx, vx = moments(x, first, last)
    sy, vy = moments(y, first - lags, last - lags)
    least = 1e-12 * n * max(float(np.mean(x * x)), float(np.mean(y * y)))
    usable = (vx > least) & (vy > least)
    if not np.any(usable):
        return 0
    with np.errstate(invalid='ignore', divide='ignore'):
        correlation = np.where(usable, (products[lags % size] - sx * sy / count) / np.sqrt(vx * vy), -2.0)
    good = lags[correlation >= np.max(correlation) - SAME_CORRELATION]
    return int(min(good, key=abs))


def rest_of_shift(values: np.ndarray, reference: np.ndarray) -> float:
    """By what part of a sample, half of one at most, the signal still comes later: the d with which a reference(t - d)
    + c fits it best.

    By least squares of first order in d, that is with a reference - a d slope + c.
    """
    gradient = np.gradient(reference)
    v, r, g = values - values.mean(), reference - reference.mean(), gradient - gradient.mean()
    rr, gg, rg = float(r @ r), float(g @ g), float(r @ g)
    least = rr * gg - rg * rg
    if not (gg > RANK * float(gradient @ gradient) and least > RANK * rr * gg):
        return 0.0
    factor, slope = (float(v @ r) * gg - float(v @ g) * rg) / least, (float(v @ g) * rr - float(v @ r) * rg) / least
    if not factor > 0.0 or abs(slope) < SAME_SHIFT * factor:
        return 0.0
    return min(max(-slope / factor, -0.5), 0.5)


def smooth_slope(values: np.ndarray) -> np.ndarray:
    """Central differences per sample, averaged over nine of them, at the ends over seven, five, three and one."""
    slope = np.gradient(values)
    result = np.empty_like(slope)
    half = SMOOTHED // 2
    result[half : slope.size - half] = np.convolve(slope, np.full(SMOOTHED, 1.0 / SMOOTHED), 'valid')
    for k in range(half):
        result[k] = slope[: 2 * k + 1].mean()
        result[-1 - k] = slope[slope.size - 2 * k - 1 :].mean()
    return result


def _relative(error: float, size: float) -> float:
    if size == 0.0:
        return 0.0 if error == 0.0 else np.inf
    return error / size


def _band(n: int) -> int:
    return max(1, -(-n // round(1.0 / BAND)))
