"""The difference of a run from its references in one channel: its figures, its curves, and whether it is within
tolerance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mbd_sim_ros.analysis.alignment import Common, Kind, rotation_angle
from mbd_sim_ros.analysis.pairing import Item
from mbd_sim_ros.analysis.rating import Rating, rate
from mbd_sim_ros.analysis.tolerances import Tolerance

CONFIDENCE = 0.95


@dataclass(frozen=True, kw_only=True)
class Band:
    """Place of the run between repeats of a test.

    repeats: their number. width: largest half width of the confidence
    band. inside: part of the instants at which the run is in it. within: part of the instants at which the run is
    between the smallest and the largest of the repeats.
    """

    repeats: int
    width: float
    inside: float
    within: float


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Difference run - reference of one channel.

    max, rms: of the difference; time [s]: where it is largest. scale: largest |reference|, or the floor under it
    (Tolerances). peak: values of largest size of run and reference; peak_time: where these are [s]. overlap: part of
    the longer recording's time that both have. first: time of the first difference [s], of an exact comparison.
    reasons: why it is not within tolerance. limit: of the largest difference. badness: the largest ratio of a figure to
    its limit.
    """

    channel: str
    unit: str
    max: float
    rms: float
    time: float
    scale: float
    peak: tuple[float, float]
    peak_time: tuple[float, float]
    overlap: float
    instants: int
    interpolated: bool
    limit: float
    badness: float
    rating: Rating | None = None
    band: Band | None = None
    first: float | None = None
    reasons: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """True where the channel is within its tolerance."""
        return not self.reasons

    @property
    def normalised(self) -> float:
        """Largest difference relative to the scale."""
        return _ratio(self.max, self.scale)

    @property
    def rms_normalised(self) -> float:
        """RMS difference relative to the scale."""
        return _ratio(self.rms, self.scale)

    @property
    def peak_difference(self) -> float:
        """Difference of the sizes of the peaks, run - reference."""
        return abs(self.peak[0]) - abs(self.peak[1])


@dataclass(frozen=True, kw_only=True)
class Curves:
    """Signals of one channel at common instants, for pictures; half: half width of the confidence band, None without
    repeats."""

    time: np.ndarray  # (n,) [s]
    run: np.ndarray
    reference: np.ndarray  # the mean of repeats
    difference: np.ndarray
    half: np.ndarray | None
    repeats: tuple[np.ndarray, ...] = ()


def curves_of(kind: Kind, at: Common) -> Curves:
    """The run, the reference and their difference; of orientations the angles from the first one of the reference."""
    run, *references = at.values
    time = at.time_ns * 1e-9
    n = len(references)
    factor = _student(n) / np.sqrt(n) if n > 1 else 0.0
    if kind == 'orientation':
        same = [r * np.where(np.sum(r * references[0], axis=1) < 0.0, -1.0, 1.0)[:, None] for r in references]
        mean = np.sum(same, axis=0)
        with np.errstate(invalid='ignore'):  # of no orientation
            mean /= np.linalg.norm(mean, axis=1, keepdims=True)
        start = np.broadcast_to(mean[0], mean.shape)
        known = [np.any(q != 0.0, axis=1) & ~np.any(np.isnan(q), axis=1) for q in (run, mean)]
        gap = np.where(known[0] & known[1], rotation_angle(run, mean), np.where(known[0] == known[1], 0.0, np.inf))
        half: np.ndarray | None = None
        curves: tuple[np.ndarray, ...] = ()
        if n > 1:
            half = factor * np.sqrt(np.sum([rotation_angle(r, mean) ** 2 for r in references], axis=0) / (n - 1))
            curves = tuple(rotation_angle(r, start) for r in references)
        return Curves(
            time=time,
            run=rotation_angle(run, start),
            reference=rotation_angle(mean, start),
            difference=gap,
            half=half,
            repeats=curves,
        )
    if n == 1:
        with np.errstate(invalid='ignore'):
            return Curves(time=time, run=run, reference=references[0], difference=run - references[0], half=None)
    mean, half = np.mean(references, axis=0), factor * np.std(references, axis=0, ddof=1)
    return Curves(time=time, run=run, reference=mean, difference=run - mean, half=half, repeats=tuple(references))


def difference_of(
    item: Item,
    at: Common,
    limits: Tolerance,
    least_scale: float,
    overlap: float,
    rated: bool,
    unit_of: Callable[[str], str],
) -> Difference:
    """Judge one channel. least_scale: of its values. overlap: part of the time that must be shared. rated: also after
    ISO/TS 18571."""
    c = curves_of(item.kind, at)
    gap = gaps(c.run, c.reference, c.difference)
    half = None if c.half is None else np.where(np.isnan(c.half), 0.0, c.half)  # no band beside no number
    beyond = gap if half is None else np.maximum(gap - half, 0.0)
    worst, rms = int(np.argmax(gap)), float(np.sqrt(np.mean(gap * gap)))
    peaks = [peak_of(values) for values in (c.run, c.reference)]
    scale = max(abs(peaks[1][0]), least_scale)
    limit = limits.atol + limits.rtol * scale
    most = float(np.max(beyond))
    score = None
    if rated:
        alike = most == 0.0 and gap[worst] == 0.0
        one = dict.fromkeys(('corridor', 'phase', 'magnitude', 'slope'), 1.0)
        score = Rating(**one, shift=0.0) if alike else rate(c.time - c.time[0], c.run, c.reference)
    peak = abs(abs(peaks[0][0]) - abs(peaks[1][0]))
    ratios = {
        f'differs by {most:.3g}, allowed {limit:.3g}' if c.half is None else f'is {most:.3g} outside the band': _ratio(
            most, limit
        )
    }
    if limits.rms is not None:
        ratios[f'RMS {_ratio(rms, scale):.3g} of the scale'] = _ratio(rms, limits.rms * scale)
    if limits.peak is not None:
        ratios[f'peak differs by {_ratio(peak, scale):.3g} of the scale'] = _ratio(peak, limits.peak * scale)
    if limits.shift is not None:
        shift = abs(score.shift) if score is not None else np.inf
        ratios[f'shifted by {shift:.3g} s' if score is not None else 'cannot be rated'] = _ratio(shift, limits.shift)
    if limits.rating is not None:
        rating = score.overall if score is not None else 0.0
        ratios[f'rated {rating:.3g}' if score is not None else 'cannot be rated'] = _ratio(
            1.0 - rating, 1.0 - limits.rating
        )
    reasons = [text for text, ratio in ratios.items() if not ratio <= 1.0]
    if at.overlap < overlap:
        reasons.append(f'only {100.0 * at.overlap:.4g} % of the time is in both')
    band = None
    if half is not None:
        low, high = np.min(c.repeats, axis=0), np.max(c.repeats, axis=0)
        within = float(np.mean((c.run >= low) & (c.run <= high)))
        band = Band(
            repeats=len(c.repeats), width=float(np.max(half)), inside=float(np.mean(beyond == 0.0)), within=within
        )
    return Difference(
        channel=item.name,
        unit='rad' if item.kind == 'orientation' else unit_of(item.name),
        max=float(gap[worst]),
        rms=rms,
        time=float(c.time[worst]),
        scale=scale,
        peak=(peaks[0][0], peaks[1][0]),
        peak_time=(float(c.time[peaks[0][1]]), float(c.time[peaks[1][1]])),
        overlap=at.overlap,
        instants=len(c.time),
        interpolated=at.interpolated,
        limit=limit,
        badness=max(*ratios.values(), np.inf if at.overlap < overlap else 0.0),
        rating=score,
        band=band,
        reasons=tuple(reasons),
    )


def gaps(a: np.ndarray, b: np.ndarray, difference: np.ndarray) -> np.ndarray:
    """Size of the difference: NaN agrees with NaN only, an infinity with itself only."""
    gap = np.abs(difference)
    bad = np.isnan(gap)
    if np.any(bad):
        gap[bad] = np.where((np.isnan(a) & np.isnan(b) | (a == b))[bad], 0.0, np.inf)
    return gap


def peak_of(values: np.ndarray) -> tuple[float, int]:
    """The value of largest size and its index; 0 where none is finite."""
    size = np.where(np.isfinite(values), np.abs(values), -1.0)
    at = int(np.argmax(size))
    return (float(values[at]) if size[at] >= 0.0 else 0.0), at


def _student(n: int) -> float:
    """Student's t of the confidence band of n repeats."""
    from scipy.special import stdtrit

    return float(stdtrit(n - 1, 0.5 + 0.5 * CONFIDENCE))


def _ratio(value: float, limit: float) -> float:
    return value / limit if limit > 0.0 else np.inf if value > 0.0 else 0.0
