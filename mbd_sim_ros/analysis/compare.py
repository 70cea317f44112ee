"""Two runs side by side: per channel the largest and the RMS difference, judged by an absolute and a relative tolerance.

Grids: where the instants of the coarser run all exist in the finer one, those are compared and nothing is interpolated;
otherwise the finer run is interpolated linearly to the instants of the coarser one in the common interval.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mbd_sim_ros.bags.reader import Run
from solver.errors import BagError, suggestion

COUNTERS = ('cmd_applied/step',)  # compared bit by bit only: another step size counts differently
QUATERNION = ('qx', 'qy', 'qz', 'qw')


@dataclass(frozen=True, kw_only=True)
class Difference:
    """Difference a - b of one channel: largest and RMS value, time [s] of the largest, largest |b|, and the verdict."""

    channel: str
    max: float
    rms: float
    time: float
    scale: float
    ok: bool


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Outcome of compare(): the instants compared and one Difference per channel, the worst (relative to its limit) first."""

    time: np.ndarray  # (n,) [s]
    interpolated: bool
    differences: tuple[Difference, ...]
    left_out: tuple[str, ...]  # channels of one run only
    a: dict[str, np.ndarray]  # channel -> (n,)
    b: dict[str, np.ndarray]

    @property
    def ok(self) -> bool:
        """Whether every channel is within its tolerance."""
        return all(d.ok for d in self.differences)


def compare(
    a: Run,
    b: Run,
    *,
    rtol: float = 1e-6,
    atol: float = 1e-9,
    exact: bool = False,
    channels: Sequence[str] = (),
    names: Mapping[str, str] | None = None,
) -> Comparison:
    """Compare run a with the reference b.

    A channel is within tolerance when max|a - b| <= atol + rtol max|b| (NaN only where both are NaN). exact: the same grid, the
    same channels and the same bits. channels: shell patterns that choose channels. names: channel of b -> channel of a it belongs to.
    Raises BagError when nothing is common to both.
    """
    b_columns = renamed(b, a, names or {})
    common = [c for c in a.columns if c in b_columns]
    left_out = sorted(set(a.columns) ^ set(b_columns))
    if channels:
        for pattern in channels:
            if not fnmatch.filter(common, pattern):
                raise BagError(f'no common channel matches {pattern!r}{suggestion(pattern, common)}')
        common = [c for c in common if any(fnmatch.fnmatchcase(c, p) for p in channels)]
        left_out = [c for c in left_out if any(fnmatch.fnmatchcase(c, p) for p in channels)]
    if not common:
        raise BagError(f'the two runs have no channel in common ({_some(a.columns)} here, {_some(b_columns)} there)')
    if exact:
        return _exact(a, Run(b.time_ns, b_columns), common, left_out)
    common = [c for c in common if c not in COUNTERS]
    time_ns, rows_a, rows_b = align(a.time_ns, b.time_ns)
    columns_a = {c: _at(a, c, time_ns, rows_a) for c in common}
    columns_b = {c: _at(Run(b.time_ns, b_columns), c, time_ns, rows_b) for c in common}
    _same_hemisphere(columns_a, columns_b)
    time = time_ns * 1e-9
    found = [(_difference(c, time, columns_a[c], columns_b[c], atol, rtol), atol) for c in common]
    order = sorted(found, key=lambda item: -_badness(item[0], atol, rtol))
    return Comparison(
        time=time,
        interpolated=rows_a is None or rows_b is None,
        differences=tuple(d for d, _ in order),
        left_out=tuple(left_out),
        a=columns_a,
        b=columns_b,
    )


def align(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    """Common instants [ns] of two grids and the rows of each at them; None for the one that must be interpolated.

    Raises BagError when the intervals do not overlap.
    """
    first, last = max(a[0], b[0]), min(a[-1], b[-1])
    if first > last:
        raise BagError(f'the runs do not overlap in time ({a[0] * 1e-9:g} to {a[-1] * 1e-9:g} s and {b[0] * 1e-9:g} to {b[-1] * 1e-9:g} s)')
    inside_a, inside_b = a[(a >= first) & (a <= last)], b[(b >= first) & (b <= last)]
    coarse, fine = (inside_a, inside_b) if len(inside_a) <= len(inside_b) else (inside_b, inside_a)
    if len(coarse) == 0:
        raise BagError('the runs have no instant in common in the time they share')
    rows_a, rows_b = np.searchsorted(a, coarse), np.searchsorted(b, coarse)
    if np.all(np.isin(coarse, fine)):
        return coarse, rows_a, rows_b
    return (coarse, rows_a, None) if coarse is inside_a else (coarse, None, rows_b)


def _at(run: Run, channel: str, time_ns: np.ndarray, rows: np.ndarray | None) -> np.ndarray:
    values = run.columns[channel]
    if rows is not None:
        return values[rows]
    return np.interp((time_ns - time_ns[0]).astype(float), (run.time_ns - time_ns[0]).astype(float), values)


def _same_hemisphere(a: dict[str, np.ndarray], b: dict[str, np.ndarray]) -> None:
    """Flip quaternions of a that are nearer to -b: both are the same orientation."""
    for first in [c for c in a if c.endswith('/' + QUATERNION[0])]:
        group = [first.removesuffix(QUATERNION[0]) + q for q in QUATERNION]
        if all(c in a for c in group):
            sign = np.where(np.sum([a[c] * b[c] for c in group], axis=0) < 0.0, -1.0, 1.0)
            for c in group:
                a[c] = sign * a[c]


def _difference(channel: str, time: np.ndarray, a: np.ndarray, b: np.ndarray, atol: float, rtol: float) -> Difference:
    both = np.isnan(a) & np.isnan(b)
    with np.errstate(invalid='ignore'):
        gap = np.where(both | (a == b), 0.0, np.abs(a - b))
    gap = np.where(np.isnan(gap), np.inf, gap)
    at = int(np.argmax(gap))
    scale = float(np.max(np.abs(b[~np.isnan(b)]), initial=0.0))
    worst = float(gap[at])
    rms = float(np.sqrt(np.mean(gap * gap)))
    return Difference(channel=channel, max=worst, rms=rms, time=float(time[at]), scale=scale, ok=worst <= atol + rtol * scale)


def _badness(d: Difference, atol: float, rtol: float) -> float:
    limit = atol + rtol * d.scale
    return d.max / limit if limit > 0.0 else np.inf if d.max > 0.0 else 0.0


def _exact(a: Run, b: Run, common: list[str], left_out: list[str]) -> Comparison:
    n = min(len(a.time_ns), len(b.time_ns))
    same_grid = len(a.time_ns) == len(b.time_ns) and bool(np.all(a.time_ns == b.time_ns))
    time = a.time_ns[:n] * 1e-9
    differences = []
    for c in common:
        x, y = a.columns[c][:n], b.columns[c][:n]
        d = _difference(c, time, x, y, 0.0, 0.0)
        same = same_grid and not left_out and bool(np.array_equal(x.view(np.int64), y.view(np.int64)))
        differences.append(Difference(channel=c, max=d.max, rms=d.rms, time=d.time, scale=d.scale, ok=same))
    differences.sort(key=lambda d: (d.ok, -d.max / (d.scale or 1.0)))
    return Comparison(
        time=time,
        interpolated=False,
        differences=tuple(differences),
        left_out=tuple(left_out),
        a={c: a.columns[c][:n] for c in common},
        b={c: b.columns[c][:n] for c in common},
    )


def renamed(b: Run, a: Run, names: Mapping[str, str]) -> dict[str, np.ndarray]:
    """Columns of b under the names of a."""
    for theirs, ours in names.items():
        b[theirs]
        a[ours]
    return {names.get(c, c): values for c, values in b.columns.items()}


def _some(columns: Mapping[str, object]) -> str:
    names = list(columns)
    return ', '.join(names[:3]) + (f' and {len(names) - 3} more' if len(names) > 3 else '')
