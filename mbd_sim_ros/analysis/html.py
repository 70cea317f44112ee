"""A comparison as one HTML file that needs nothing else: curves to zoom into
(docs/decisions/0011-report-of-comparisons.md)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mbd_sim_ros.analysis.comparison import Comparison
from mbd_sim_ros.analysis.difference import Curves, Difference
from mbd_sim_ros.analysis.pages import fill, floats, thinned

SHOWN = 24  # curves of the channels that differ most
POINTS = 3000  # about so many of a curve; the extremes of every stretch are among them
COLUMNS = (
    'channel', 'verdict', 'unit', 'largest difference', 'at [s]', 'RMS', 'scale', 'largest / scale', 'RMS / scale',
    'rating', 'corridor', 'phase', 'magnitude', 'slope', 'shift [s]',
    'peak of run', 'peak of reference', 'peak later by [s]', 'in band', 'time in both',
)  # fmt: skip
LEGEND = (
    'The worst relative to its tolerance comes first. Scale: largest value of the reference. Rating and its parts '
    'after ISO/TS 18571, 1 is best. Shift: how much later the run comes, by the largest correlation. In band: part of '
    'the time at which the run is inside the 95 % confidence band of the mean of the repeats.'
)


def write_report(
    comparison: Comparison, file: Path, *, names: Sequence[str], about: Sequence[str], verdict: tuple[bool, str]
) -> None:
    """Write the report. names: of the run and its references. about: lines for its head. verdict: whether all is well,
    and a sentence.

    Raises BagError when the file cannot be written.
    """
    repeats = len(names) > 2
    reference = 'mean of repeats' if repeats else names[1]
    keys = [[names[0], 'run'], [reference, 'reference']]
    keys += [['95 % confidence band of the mean', 'band'], ['repeats', 'repeat']] if repeats else []
    rows = [_row(d) for d in comparison.differences]
    filled = [k for k, name in enumerate(COLUMNS) if name == 'verdict' or any(row[k] is not None for row in rows)]
    data = {
        'title': f'{names[0]} compared with {", ".join(names[1:])}',
        'verdict': {'ok': verdict[0], 'text': verdict[1]},
        'about': list(about),
        'legend': LEGEND,
        'keys': [*keys, ['difference', 'other']],
        'columns': [COLUMNS[k] for k in filled],
        'rows': [[row[k] for k in filled] for row in rows],
        'charts': [_chart(d, comparison.curves(d.channel)) for d in comparison.differences[:SHOWN]],
    }
    fill(file, 'mbd_sim_ros.analysis:report.html', data)


def _row(d: Difference) -> list[Any]:
    scores = (
        [None] * 6
        if d.rating is None
        else [getattr(d.rating, n) for n in ('overall', 'corridor', 'phase', 'magnitude', 'slope', 'shift')]
    )
    later = d.peak_time[0] - d.peak_time[1]
    figures = [d.max, d.time, d.rms, d.scale, d.normalised, d.rms_normalised, *scores, *d.peak, later]
    reasons = '; '.join(d.reasons)
    return [d.channel, reasons, d.unit, *figures, None if d.band is None else d.band.inside, d.overlap]


def _chart(d: Difference, curves: Curves) -> dict[str, Any]:
    keep = thinned(POINTS, curves.run, curves.reference, curves.difference)
    origin = float(curves.time[0])
    text = f'largest difference {d.max:.4g} at {d.time:.6g} s, RMS {d.rms:.4g}'
    text += f', rating {d.rating.overall:.3f}' if d.rating is not None else ''
    return {
        'name': d.channel,
        'label': d.channel.rpartition('/')[2],
        'unit': d.unit,
        'text': text + (f'; {"; ".join(d.reasons)}' if d.reasons else ''),
        'origin': 0.0 if abs(origin) < 1e4 else origin,  # a float of 32 bits holds no time of day
        'time': floats((curves.time - (0.0 if abs(origin) < 1e4 else origin))[keep]),
        'run': floats(curves.run[keep]),
        'reference': floats(curves.reference[keep]),
        'difference': floats(curves.difference[keep]),
        'half': None if curves.half is None else floats(curves.half[keep]),
        'repeats': [floats(r[keep]) for r in curves.repeats],
    }
