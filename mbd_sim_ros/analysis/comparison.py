"""A run beside a reference: per channel the differences at common instants, judged by tolerances.

The reference may be several repeats of one test. Then the run is compared with their mean and may leave it by the confidence band of
that mean besides the tolerance: mean +- t_{0.975, n-1} s / sqrt(n) at every instant (Student's t, two-sided 95 %). The standards
[ISOValidation2016] compare a simulation with at least three measured repeats; which band they ask for is not confirmed.

Grids: where the instants of the coarsest signal all exist in the others, those are compared and nothing is interpolated; otherwise the
finer ones are interpolated, each kind of channel in its own way (alignment.py). Orientations are one channel, whose difference is the
angle of the rotation between them.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.special import stdtrit

from mbd_sim_ros.analysis.alignment import (
    EPOCH_NS,
    Common,
    Kind,
    Offset,
    Signal,
    common,
    find_offset,
    is_wrapped,
    rotation_angle,
    same_turn,
)
from mbd_sim_ros.analysis.rating import Rating, rate
from mbd_sim_ros.analysis.runs import units
from mbd_sim_ros.analysis.tolerances import Tolerance, Tolerances
from mbd_sim_ros.bags.reader import Run, Series
from solver.errors import BagError, suggestion

COUNTERS = ('cmd_applied/step',)  # compared bit by bit only: another step size counts differently
QUATERNION = ('qx', 'qy', 'qz', 'qw')
ORIENTATION = 'orientation'
HEADINGS = ('yaw', 'heading', 'psi', 'course')  # angles of which full turns mean nothing
CONFIDENCE = 0.95
OVERLAP_MOVED = 0.95  # of recordings that were not started together, least part of the time that both have


@dataclass(frozen=True, kw_only=True)
class Band:
    """Where the run lies between repeats of a test.

    repeats: how many. width: largest half width of the confidence band. inside: part of the instants at which the run is in it.
    within: part of the instants at which the run is between the smallest and the largest of the repeats.
    """

    repeats: int
    width: float
    inside: float
    within: float


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Difference run - reference of one channel.

    max, rms: of the difference; time [s]: where it is largest. scale: largest |reference|, or the floor under it (Tolerances).
    peak: values of largest size of run and reference; peak_time: where these are [s]. overlap: part of the longer recording's time that
    both have. first: time of the first difference [s], of an exact comparison. reasons: why it is not within tolerance.
    limit: of the largest difference. badness: the largest ratio of a figure to its limit.
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
        """Whether the channel is within its tolerance."""
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
    """Signals of one channel at common instants, for pictures; half: half width of the confidence band, None without repeats."""

    time: np.ndarray  # (n,) [s]
    run: np.ndarray
    reference: np.ndarray  # the mean of repeats
    difference: np.ndarray
    half: np.ndarray | None
    repeats: tuple[np.ndarray, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Outcome of compare(): one Difference per channel, the worst relative to its limits first.

    only_in_run, only_in_reference: channels that the other side lacks. offsets: per reference what was added to its stamps [s]. found:
    the offsets that were sought. origins: what the stamps of each recording count from [s], run first. problems: what else is not as it
    should be, a sentence each.
    """

    differences: tuple[Difference, ...]
    only_in_run: tuple[str, ...] = ()
    only_in_reference: tuple[str, ...] = ()
    offsets: tuple[float, ...] = ()
    found: tuple[Offset, ...] = ()
    origins: tuple[float, ...] = ()
    problems: tuple[str, ...] = ()
    exact: bool = False
    curves: Callable[[str], Curves] = field(repr=False, compare=False)

    @property
    def instants(self) -> int:
        """Largest number of instants compared of a channel."""
        return max(d.instants for d in self.differences)

    @property
    def interpolated(self) -> bool:
        """Whether any signal was interpolated."""
        return any(d.interpolated for d in self.differences)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Channels that are in one recording only."""
        return tuple(sorted((*self.only_in_run, *self.only_in_reference)))

    @property
    def ok(self) -> bool:
        """Whether every channel is within its tolerance; channels that are missing are judged by whoever asked (see left_out)."""
        return not self.problems and all(d.ok for d in self.differences)


@dataclass(frozen=True)
class _Item:
    """A channel to compare, with its columns (four of an orientation) and how it is brought to other instants."""

    name: str
    columns: tuple[str, ...]
    kind: Kind


def compare(
    run: Run,
    *references: Run,
    tolerances: Tolerances | None = None,
    exact: bool = False,
    channels: Sequence[str] = (),
    offset: float = 0.0,
    align: str | None = None,
    overlap: float | None = None,
    held: frozenset[str] = frozenset(),
    rated: bool = True,
) -> Comparison:
    """Compare a run with a reference, or with repeats of one.

    exact: the same instants, the same channels and the same bits. channels: shell patterns that choose channels. offset: added to the
    stamps of the references [s]. align: channel by which a further offset is found, of each reference. overlap: part of the longer
    recording's time that must be shared; None: all of it, OVERLAP_MOVED where the stamps are moved. held: channels besides
    cmd_applied that hold their value. rated: also after ISO/TS 18571.
    Recordings that share no time and are stamped with the time of day count from their first stamp.
    Raises BagError when nothing is common.
    """
    limits = tolerances or Tolerances()
    homes = [{name: one for one in r.series.values() for name in one.columns} for r in (run, *references)]
    names, only_in_run, only_in_reference = _names(homes, channels, [name for r in (run, *references) for name in r.names])
    if exact:
        if len(references) != 1 or offset != 0.0 or align is not None:
            raise BagError('an exact comparison is of two recordings, without offset')
        return _exact(homes[0], homes[1], names, only_in_run, only_in_reference, units(run, *references))
    names = [name for name in names if name not in COUNTERS]
    origins, shifts, found = _clocks(homes, offset, align)
    unit_of = units(run, *references)
    items = _items(names, homes, unit_of, held)
    least = overlap if overlap is not None else OVERLAP_MOVED if any(shifts) else 1.0

    def brought(item: _Item) -> Common:
        signals = [_signal(item, home, shift) for home, shift in zip(homes, shifts)]
        try:
            result = common(signals, item.kind)
        except BagError as error:
            raise BagError(f'{item.name}: {error}') from None
        if item.kind == 'angle' and (item.name.rpartition('/')[2] in HEADINGS or any(is_wrapped(s.values) for s in signals)):
            first, *others = result.values
            result = result._replace(values=(first, *(same_turn(other, first) for other in others)))
        return result

    scales = _scales(items, homes[1:], unit_of, limits.floor)
    differences = []
    for item in items:
        at = brought(item)
        differences.append(_difference(item, at, limits.of(item.name), scales[item.name], least, rated or limits.rated, unit_of))
    by_name = {item.name: item for item in items}
    return Comparison(
        differences=tuple(sorted(differences, key=lambda d: (-d.badness, -d.normalised))),
        only_in_run=only_in_run,
        only_in_reference=only_in_reference,
        offsets=tuple((shift - origin) * 1e-9 for shift, origin in zip(shifts[1:], origins[1:])),
        found=tuple(found),
        origins=tuple(-origin * 1e-9 for origin in origins),
        curves=lambda name: _curves(by_name[name].kind, brought(by_name[name])),
    )


def _names(
    homes: Sequence[Mapping[str, Series]], patterns: Sequence[str], known: Sequence[str]
) -> tuple[list[str], tuple[str, ...], tuple[str, ...]]:
    """Channels that all have, those of the run alone, those that it lacks. known: of all recordings, for suggestions."""
    ours = list(homes[0])
    theirs = list(dict.fromkeys(name for home in homes[1:] for name in home))
    both = [name for name in ours if all(name in home for home in homes[1:])]
    if not both and not patterns:
        raise BagError(f'the two runs have no channel in common ({_some(ours)} here, {_some(theirs)} there)')
    for pattern in patterns:
        if not fnmatch.filter([*both, *_orientations(both)], pattern):
            raise BagError(f'no common channel matches {pattern!r}{suggestion(pattern, known or both)}')

    def chosen(names: Sequence[str]) -> list[str]:
        return [name for name in names if not patterns or any(fnmatch.fnmatchcase(name, p) for p in patterns)]

    common_names = set(both)
    quaternions = [head + q for group in chosen(_orientations(both)) if (head := group.removesuffix(ORIENTATION)) for q in QUATERNION]
    wanted = {*chosen(both), *(quaternions if patterns else ())}
    only = [tuple(sorted(name for name in chosen(side) if name not in common_names)) for side in (ours, theirs)]
    return [name for name in both if name in wanted], only[0], only[1]


def _orientations(names: Sequence[str]) -> list[str]:
    known = set(names)
    heads = [name.removesuffix(QUATERNION[0]) for name in names if name.endswith('/' + QUATERNION[0])]
    return [head + ORIENTATION for head in heads if all(head + q in known for q in QUATERNION)]


def _items(names: Sequence[str], homes: Sequence[Mapping[str, Series]], unit_of: Callable[[str], str], held: frozenset[str]) -> list[_Item]:
    """The channels to compare: quaternions become orientations where all have the four parts at the same instants."""
    result = []
    inside: set[str] = set()
    for group in _orientations(names):
        parts = tuple(group.removesuffix(ORIENTATION) + q for q in QUATERNION)
        if all(home[p] is home[parts[0]] for home in homes for p in parts):
            result.append(_Item(group, parts, 'orientation'))
            inside |= set(parts)
    for name in names:
        if name in inside:
            continue
        kind: Kind = 'linear'
        if name in held or name.startswith('cmd_applied/'):
            kind = 'hold'
        elif unit_of(name) == 'rad' or name.rpartition('/')[2] in HEADINGS:
            kind = 'angle'
        result.append(_Item(name, (name,), kind))
    return result


def _signal(item: _Item, home: Mapping[str, Series], shift_ns: int = 0) -> Signal:
    one = home[item.columns[0]]
    time_ns = one.time_ns + shift_ns if shift_ns else one.time_ns
    if item.kind != 'orientation':
        return Signal(time_ns, one.columns[item.columns[0]])
    values = np.stack([one.columns[c] for c in item.columns], axis=1)
    size = np.linalg.norm(values, axis=1, keepdims=True)
    return Signal(time_ns, values / np.where(size > 0.0, size, 1.0))


def _clocks(homes: Sequence[Mapping[str, Series]], offset: float, align: str | None) -> tuple[list[int], list[int], list[Offset]]:
    """Per recording what is added to its stamps [ns] so that they count alike, the same with the offset, and the offsets found."""
    spans = []
    for home in homes:
        grids = [one.time_ns for one in home.values()]
        spans.append((min(int(t[0]) for t in grids), max(int(t[-1]) for t in grids)))
    share = all(max(spans[0][0], first) <= min(spans[0][1], last) for first, last in spans[1:])
    origins = [0 if share or first < EPOCH_NS else -first for first, _ in spans]
    shifts = [origins[0], *(origin + round(offset * 1e9) for origin in origins[1:])]
    found: list[Offset] = []
    if align is not None:
        for k, home in enumerate(homes[1:], 1):
            for side in (homes[0], home):
                if align not in side:
                    raise BagError(f'--align {align}: no such channel in both recordings{suggestion(align, homes[0].keys() & home.keys())}')
            item = _Item(align, (align,), 'linear')
            found.append(find_offset(_signal(item, homes[0], shifts[0]), _signal(item, home, shifts[k])))
            shifts[k] += found[-1].nanoseconds
    return origins, shifts, found


def _scales(
    items: Sequence[_Item], references: Sequence[Mapping[str, Series]], unit_of: Callable[[str], str], floor: float
) -> dict[str, float]:
    """Least scale of every channel: a part of the largest value among channels of the same topic (its first word) and unit."""
    largest: dict[tuple[str, str], float] = {}
    kinds = {}
    for item in items:
        measure = unit_of(item.columns[0]) if item.kind != 'orientation' else 'rotation'
        kind = kinds[item.name] = (item.name.partition('/')[0], measure or item.name.rpartition('/')[2])
        if item.kind != 'orientation':
            for home in references:
                largest[kind] = max(largest.get(kind, 0.0), _largest(home[item.columns[0]].columns[item.columns[0]]))
    return {item.name: floor * largest.get(kinds[item.name], 0.0) for item in items}


def _largest(values: np.ndarray) -> float:
    finite = values[np.isfinite(values)]
    return float(max(finite.max(), -finite.min())) if finite.size else 0.0


def _curves(kind: Kind, at: Common) -> Curves:
    """The run, the reference and their difference; of orientations the angles from the first one of the reference."""
    run, *references = at.values
    time = at.time_ns * 1e-9
    n = len(references)
    factor = float(stdtrit(n - 1, 0.5 + 0.5 * CONFIDENCE)) / np.sqrt(n) if n > 1 else 0.0
    if kind == 'orientation':
        same = [r * np.where(np.sum(r * references[0], axis=1) < 0.0, -1.0, 1.0)[:, None] for r in references]
        mean = np.sum(same, axis=0)
        mean /= np.linalg.norm(mean, axis=1, keepdims=True)
        spread = np.sqrt(np.sum([rotation_angle(r, mean) ** 2 for r in references], axis=0) / max(n - 1, 1))
        start = np.broadcast_to(mean[0], mean.shape)
        gap = rotation_angle(run, mean)
        curves = tuple(rotation_angle(r, start) for r in references)
        half = factor * spread if n > 1 else None
        return Curves(
            time=time, run=rotation_angle(run, start), reference=rotation_angle(mean, start), difference=gap, half=half, repeats=curves
        )
    if n == 1:
        with np.errstate(invalid='ignore'):
            return Curves(time=time, run=run, reference=references[0], difference=run - references[0], half=None)
    mean, half = np.mean(references, axis=0), factor * np.std(references, axis=0, ddof=1)
    return Curves(time=time, run=run, reference=mean, difference=run - mean, half=half, repeats=tuple(references))


def _difference(
    item: _Item, at: Common, limits: Tolerance, least_scale: float, overlap: float, rated: bool, unit_of: Callable[[str], str]
) -> Difference:
    c = _curves(item.kind, at)
    gap = _gaps(c.run, c.reference, c.difference)
    beyond = gap if c.half is None else np.maximum(gap - c.half, 0.0)
    worst, rms = int(np.argmax(gap)), float(np.sqrt(np.mean(gap * gap)))
    peaks = [_peak(values) for values in (c.run, c.reference)]
    scale = max(abs(peaks[1][0]), least_scale)
    limit = limits.atol + limits.rtol * scale
    most = float(np.max(beyond))
    score = None
    if rated:
        alike = most == 0.0 and gap[worst] == 0.0
        one = dict.fromkeys(('corridor', 'phase', 'magnitude', 'slope'), 1.0)
        score = Rating(**one, shift=0.0) if alike else rate(c.time - c.time[0], c.run, c.reference)
    peak = abs(abs(peaks[0][0]) - abs(peaks[1][0]))
    ratios = {f'differs by {most:.3g}, allowed {limit:.3g}' if c.half is None else f'is {most:.3g} outside the band': _ratio(most, limit)}
    if limits.rms is not None:
        ratios[f'RMS {_ratio(rms, scale):.3g} of the scale'] = _ratio(rms, limits.rms * scale)
    if limits.peak is not None:
        ratios[f'peak differs by {_ratio(peak, scale):.3g} of the scale'] = _ratio(peak, limits.peak * scale)
    if limits.shift is not None:
        shift = abs(score.shift) if score is not None else np.inf
        ratios[f'shifted by {shift:.3g} s' if score is not None else 'cannot be rated'] = _ratio(shift, limits.shift)
    if limits.rating is not None:
        rating = score.overall if score is not None else 0.0
        ratios[f'rated {rating:.3g}' if score is not None else 'cannot be rated'] = _ratio(1.0 - rating, 1.0 - limits.rating)
    reasons = [text for text, ratio in ratios.items() if not ratio <= 1.0]
    if at.overlap < overlap:
        reasons.append(f'only {100.0 * at.overlap:.4g} % of the time is in both')
    band = None
    if c.half is not None:
        low, high = np.min(c.repeats, axis=0), np.max(c.repeats, axis=0)
        within = float(np.mean((c.run >= low) & (c.run <= high)))
        band = Band(repeats=len(c.repeats), width=float(np.max(c.half)), inside=float(np.mean(beyond == 0.0)), within=within)
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


def _gaps(a: np.ndarray, b: np.ndarray, difference: np.ndarray) -> np.ndarray:
    """Size of the difference: NaN agrees with NaN only, an infinity with itself only."""
    gap = np.abs(difference)
    bad = np.isnan(gap)
    if np.any(bad):
        gap[bad] = np.where((np.isnan(a) & np.isnan(b) | (a == b))[bad], 0.0, np.inf)
    return gap


def _peak(values: np.ndarray) -> tuple[float, int]:
    size = np.where(np.isfinite(values), np.abs(values), -1.0)
    at = int(np.argmax(size))
    return (float(values[at]) if size[at] >= 0.0 else 0.0), at


def _ratio(value: float, limit: float) -> float:
    return value / limit if limit > 0.0 else np.inf if value > 0.0 else 0.0


def _exact(
    a: Mapping[str, Series],
    b: Mapping[str, Series],
    names: Sequence[str],
    only_in_run: tuple[str, ...],
    only_in_reference: tuple[str, ...],
    unit_of: Callable[[str], str],
) -> Comparison:
    problems = []
    differences = []
    for name in names:
        here, there = a[name], b[name]
        n = min(here.time_ns.size, there.time_ns.size)
        x, y = here.columns[name][:n], there.columns[name][:n]
        time = here.time_ns[:n] * 1e-9
        reasons = []
        if here.time_ns is not there.time_ns and not np.array_equal(here.time_ns, there.time_ns):
            reasons.append('the instants are not the same')
        other = np.flatnonzero(x.view(np.int64) != y.view(np.int64))
        if other.size:
            reasons.append(f'{other.size} of {n} values differ, the first at {time[other[0]]:.9g} s')
        with np.errstate(invalid='ignore'):
            gap = _gaps(x, y, x - y) if other.size else np.zeros(n)
        worst = int(np.argmax(gap))
        peaks = [_peak(values) for values in (x, y)]
        scale = abs(peaks[1][0])
        differences.append(
            Difference(
                channel=name,
                unit=unit_of(name),
                max=float(gap[worst]),
                rms=float(np.sqrt(np.mean(gap * gap))),
                time=float(time[worst]),
                scale=scale,
                peak=(peaks[0][0], peaks[1][0]),
                peak_time=(float(time[peaks[0][1]]), float(time[peaks[1][1]])),
                overlap=1.0,
                instants=n,
                interpolated=False,
                limit=0.0,
                badness=(np.inf if reasons else 0.0),
                first=float(time[other[0]]) if other.size else None,
                reasons=tuple(reasons),
            )
        )
    if only_in_run or only_in_reference:
        problems.append(f'{len(only_in_run) + len(only_in_reference)} channels are in one recording only')

    def curves(name: str) -> Curves:
        n = min(a[name].time_ns.size, b[name].time_ns.size)
        x, y = a[name].columns[name][:n], b[name].columns[name][:n]
        return Curves(time=a[name].time_ns[:n] * 1e-9, run=x, reference=y, difference=x - y, half=None)

    differences.sort(key=lambda d: (d.ok, -d.normalised))
    return Comparison(
        differences=tuple(differences),
        only_in_run=only_in_run,
        only_in_reference=only_in_reference,
        offsets=(0.0,),
        problems=tuple(problems),
        exact=True,
        curves=curves,
    )


def _some(names: Sequence[str]) -> str:
    return ', '.join(names[:3]) + (f' and {len(names) - 3} more' if len(names) > 3 else '')
