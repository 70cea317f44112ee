"""Recordings as a fit takes them: signals by name, stretches that drive the vehicle, windows of them, and what is left
out and why."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mbd_sim_ros.analysis import mapping, runs
from mbd_sim_ros.bags.patterns import nearest
from mbd_sim_ros.fitting.file import Drive, Recording, Windows
from solver.errors import BagError

GAP = 0.25  # s without a sample of an input that ends a stretch; of ten times as much the car would go on blindly
STUCK = 2.0  # s for which a signal that otherwise changes keeps its value; ten times as much passes a sensor that froze
POSE = ('x', 'y', 'yaw')  # of a motion capture: their rates are signals too
# s, of a passenger car: half width of the quadratic fits that differentiate a pose; ten times as much loses the motion
SMOOTH = 0.08
# s: longest time for which a signal is taken to be held between samples of its own, as a command that comes ten times a
# second in rows of a hundred; of ten times as much steps that are meant become ramps
HELD = 0.25
LEAST_CHANGES = 10  # of a signal, from which it tells how long it is held; of one any step would
AT_ONCE = 1_000_000  # samples of such fits at once; ten times as many take 400 MB


@dataclass(frozen=True)
class Track:
    """A signal at its own instants: t [s] from the first stamp of the recording, y in SI units. held: whether it was
    repeated between them."""

    t: np.ndarray
    y: np.ndarray
    held: bool = False


@dataclass
class Data:
    """A recording: its signals by name, and sentences on what was left out of it."""

    name: str
    use: str
    tracks: dict[str, Track]
    told: list[str] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        """Time from the first to the last sample of any signal."""
        return max(float(track.t[-1]) for track in self.tracks.values())


@dataclass(frozen=True)
class Window:
    """A window of a recording: it is driven from `begin` on and compared from `first` to `last` [s]."""

    recording: str
    use: str
    begin: float
    first: float
    last: float


def load(
    name: str, given: Recording, file: Path, map_file: Path | None, needed: Sequence[str], time: float = 1.0
) -> Data:
    """Read a recording. needed: its signals, under our names. time: of the vehicle beside a passenger car. Raises
    BagError and SceneError."""
    channels = mapping.load_mapping(map_file) if map_file is not None else None
    sources = dict(channels.channels) if channels is not None else {}
    axes = channels.axes if channels is not None else ()
    wanted = [*needed, *(mapping.literal(one.channel) for one in sources.values())]
    wanted += [c for turn in axes for c in turn.channels]
    plain = [n for n in needed if n.partition('/')[0] != 'pose']
    run = runs.read(
        file, [*wanted, *POSE, 'pose/*'], beside=[one.channel for one in sources.values()],
        time=channels.time if channels is not None else None, databases=(),
    )  # fmt: skip
    if sources or axes or run.stated:
        run, _ = mapping.apply(run, sources, axes, runs.units(run))
    origin = min((int(one.time_ns[0]) for one in run.series.values() if one.time_ns.size), default=0)
    tracks: dict[str, Track] = {}
    told = list(run.told)
    for one in run.series.values():
        t = (one.time_ns - origin) * 1e-9
        for column, values in one.columns.items():
            keep = np.isfinite(values) & (t >= given.start) & (t <= (np.inf if given.end is None else given.end))
            if keep.sum() < keep.size and not np.isfinite(values).all():
                lost = int(np.sum(~np.isfinite(values)))
                if column in needed:
                    told.append(f'{name}: {column}: {lost} of {values.size} samples are no number')
            if keep.sum() >= 2:
                tracks[column] = Track(t[keep], np.asarray(values, float)[keep])
    tracks |= _rates(tracks, SMOOTH * time)
    for column in needed:
        if column not in tracks:
            where = nearest(column, [*run.names, *tracks])
            raise BagError(f'{file}: recording {name!r} has no signal {column!r}{where}')
    del plain
    for column in needed:
        if float(np.ptp(tracks[column].y)) == 0.0:
            value = tracks[column].y[0]
            raise BagError(
                f'{file}: recording {name!r}: {column} has the same value {value:g} all the time, so it tells nothing; '
                'name another column, or remove it'
            )
    return Data(name, given.use, {column: own_samples(tracks[column]) for column in needed}, told)


def own_samples(track: Track) -> Track:
    """A signal without the samples that repeat the last one until the next comes: it has no more than its own.

    It is held where it changes at every third sample at most, at times within HELD, and by its own clock: after one
    or more of its periods, to a quarter. Where it stays as it is, samples of its own had the same value.
    """
    changes = np.flatnonzero(np.diff(track.y) != 0.0) + 1
    if changes.size < LEAST_CHANGES:
        return track
    times, samples = np.diff(track.t[changes]), np.diff(changes)
    often = float(np.quantile(samples, 0.1))
    period = float(np.median(times[samples <= 1.5 * often]))
    part = times / period - np.round(times / period)
    if often < 3.0 or period > HELD or float(np.mean(np.abs(part) < 0.25)) < 0.9:
        return track
    keep = []
    for a, b in itertools.pairwise([0, *changes, track.t.size - 1]):
        count = max(round(float(track.t[b] - track.t[a]) / period), 1)
        keep.append(np.searchsorted(track.t, np.linspace(track.t[a], track.t[b], count, endpoint=False) - 1e-9))
    own = np.unique(np.concatenate(keep))
    return Track(track.t[own], track.y[own], held=True)


def _rates(tracks: dict[str, Track], half: float) -> dict[str, Track]:
    """Velocities in the body and yaw rate of a pose x, y, yaw, by quadratics over 2 `half` [s]."""
    named = {name: next((c for c in (f'pose/{name}', f'odom/pose/{name}', name) if c in tracks), None) for name in POSE}
    if None in named.values():
        return {}
    x, y, yaw = (tracks[c] for c in named.values() if c is not None)
    if not (np.array_equal(x.t, y.t) and np.array_equal(x.t, yaw.t)):
        return {}
    new = np.concatenate([[True], np.diff(x.t) > 1e-6])
    t = x.t[new]
    heading = np.unwrap(yaw.y[new])
    dx, dy, r = (_slopes(t, v, half) for v in (x.y[new], y.y[new], heading))
    c, s = np.cos(heading), np.sin(heading)
    vx, vy = c * dx + s * dy, -s * dx + c * dy
    return {
        'pose/yaw_rate': Track(t, r), 'pose/vx': Track(t, vx), 'pose/vy': Track(t, vy),
    }  # fmt: skip


def _slopes(t: np.ndarray, y: np.ndarray, half: float) -> np.ndarray:
    """Slopes of quadratics through the samples within `half` [s] around each one: of fewer than four, between
    neighbours.

    Every quadratic has its own sums, of times from its own instant: differences of sums over a whole drive lose all
    digits of the fourth powers within a minute.
    """
    low, high = np.searchsorted(t, t - half), np.searchsorted(t, t + half, side='right')
    at = np.clip(np.arange(t.size), 1, t.size - 2)
    result = (y[at + 1] - y[at - 1]) / (t[at + 1] - t[at - 1])
    for some in np.array_split(np.flatnonzero(high - low >= 4), max(1, int((high - low).sum() / AT_ONCE))):
        if not some.size:
            continue
        columns = low[some, None] + np.arange(int((high - low)[some].max()))
        there = columns < high[some, None]
        columns = np.minimum(columns, t.size - 1)
        u = (t[columns] - t[some, None]) / half
        powers = np.where(there[:, :, None], u[:, :, None] ** np.arange(3), 0.0)
        normal = np.einsum('nki,nkj->nij', powers, powers)
        moments = np.einsum('nki,nk->ni', powers, y[columns] - y[some, None])
        result[some] = np.linalg.solve(normal, moments[:, :, None])[:, 1, 0] / half
    return result


def windows(data: Data, drive: Drive, given: Windows, slowest: float) -> list[Window]:
    """Windows of a recording, one behind the other in its stretches; what is left out is added to data.told."""
    inputs = [data.tracks[name] for name in drive.channels]
    begin, end = max(float(one.t[0]) for one in inputs), min(float(one.t[-1]) for one in inputs)
    doubtful: list[tuple[float, float, str]] = []
    for name, one in zip(drive.channels, inputs, strict=True):
        usual = float(np.median(np.diff(one.t)))
        far = max(GAP, 5.0 * usual)
        for k in np.flatnonzero(np.diff(one.t) > far):
            doubtful.append((float(one.t[k]), float(one.t[k + 1]), f'no sample of {name}'))
    speed = data.tracks[drive.speed]
    doubtful += [(a, b, f'slower than {slowest:.3g} m/s') for a, b in _runs(speed.t, speed.y < slowest, 0.0)]
    for name, one in data.tracks.items():
        if name not in drive.channels:
            still = np.concatenate([np.diff(one.y) == 0.0, [False]])
            # a signal that is held between its own samples is still for less; commands may be still
            doubtful += [(a, b, f'{name} is frozen') for a, b in _runs(one.t, still, STUCK)]
    doubtful.sort()
    edges = [begin]
    for a, b, why in doubtful:
        if b > begin and a < end:
            data.told.append(f'{data.name}: {max(a, begin):.2f} to {min(b, end):.2f} s are left out: {why}')
    merged: list[list[float]] = []
    for a, b, _ in doubtful:
        if merged and a <= merged[-1][1]:
            merged[-1][1] = max(merged[-1][1], b)
        else:
            merged.append([a, b])
    stretches = []
    at = edges[0]
    for a, b in merged:
        if a > at:
            stretches.append((at, min(a, end)))
        at = max(at, b)
    if at < end:
        stretches.append((at, end))
    found = []
    for a, b in stretches:
        first = a + given.run_in
        while first + 0.5 * given.length <= b:
            last = min(first + given.length, b)
            if b - last < 0.5 * given.length and b - first <= 1.5 * given.length:
                last = b
            found.append(Window(data.name, data.use, first - given.run_in, first, last))
            first = last
    return found


def _runs(t: np.ndarray, flags: np.ndarray, least: float) -> list[tuple[float, float]]:
    """(first, last) [s] of the runs of true flags that last for more than `least`."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    last = t.size - 1
    return [
        (float(t[a]), float(t[min(b, last)]))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
        if t[min(b, last)] - t[a] > least or least == 0.0
    ]
