"""One channel of two recordings bit by bit."""

from __future__ import annotations

import numpy as np

from mbd_sim_ros.analysis.difference import Curves, Difference, gaps, peak_of
from mbd_sim_ros.bags.reader import Series


def exact_difference(name: str, here: Series, there: Series, unit: str) -> Difference:
    """Difference between a channel of the run and that of the reference; any other bit or instant is outside
    tolerance."""
    c = exact_curves(name, here, there)
    x, y = c.run, c.reference
    n = x.size
    reasons = []
    if here.time_ns is not there.time_ns and not np.array_equal(here.time_ns, there.time_ns):
        reasons.append('the instants are not the same')
    other = np.flatnonzero(x.view(np.int64) != y.view(np.int64))
    if other.size:
        reasons.append(f'{other.size} of {n} values differ, the first at {c.time[other[0]]:.9g} s')
    gap = gaps(x, y, c.difference) if other.size else np.zeros(n)
    worst = int(np.argmax(gap))
    peaks = [peak_of(values) for values in (x, y)]
    return Difference(
        channel=name,
        unit=unit,
        max=float(gap[worst]),
        rms=float(np.sqrt(np.mean(gap * gap))),
        time=float(c.time[worst]),
        scale=abs(peaks[1][0]),
        peak=(peaks[0][0], peaks[1][0]),
        peak_time=(float(c.time[peaks[0][1]]), float(c.time[peaks[1][1]])),
        overlap=1.0,
        instants=n,
        interpolated=False,
        limit=0.0,
        badness=(np.inf if reasons else 0.0),
        first=float(c.time[other[0]]) if other.size else None,
        reasons=tuple(reasons),
    )


def exact_curves(name: str, here: Series, there: Series) -> Curves:
    """Both signals sample by sample, as far as both go."""
    n = min(here.time_ns.size, there.time_ns.size)
    x, y = here.columns[name][:n], there.columns[name][:n]
    with np.errstate(invalid='ignore'):
        return Curves(time=here.time_ns[:n] * 1e-9, run=x, reference=y, difference=x - y, half=None)
