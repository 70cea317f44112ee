"""Page of a comparison: figures of all channels, curves of those that differ most
(docs/decisions/0011-report-of-comparisons.md)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from mbd_sim_ros.analysis import pages
from mbd_sim_ros.analysis.comparison import Comparison
from mbd_sim_ros.analysis.difference import Curves, Difference
from mbd_sim_ros.analysis.pages import Block, Page, thinned

SHOWN = 24  # curves of the channels that differ most
COLUMNS = (
    'channel', 'verdict', 'unit', 'largest difference', 'at [s]', 'RMS', 'scale', 'largest / scale', 'RMS / scale',
    'rating', 'corridor', 'phase', 'magnitude', 'slope', 'shift [s]',
    'peak of run', 'peak of reference', 'peak later by [s]', 'in band', 'time in both',
)  # fmt: skip
LEGEND = (
    'The worst relative to its tolerance comes first; a click on one of the first rows leads to its curves. Scale: '
    'largest value of the reference. Rating and its parts after ISO/TS 18571, 1 is best. Shift: how much later the run '
    'comes, by the largest correlation. In band: part of the time at which the run is inside the 95 % confidence band '
    'of the mean of the repeats.'
)


def write_report(
    comparison: Comparison,
    file: Path,
    *,
    names: Sequence[str],
    about: Sequence[str],
    verdict: tuple[bool, str],
    facts: Sequence[tuple[str, str]] = (),
) -> None:
    """Write the report. names: of the run and its references. about: lines for its head. verdict: whether all is well,
    and a sentence. facts: what the recordings are of.

    Raises BagError when the file cannot be written.
    """
    shown = comparison.differences[:SHOWN]
    rows = [_row(d) for d in comparison.differences]
    filled = [k for k, name in enumerate(COLUMNS) if name == 'verdict' or any(row[k] is not None for row in rows)]
    reference = 'mean of repeats' if len(names) > 2 else names[1]
    points = pages.points_for(len(shown) * (len(names) + 2))
    drawn = [
        one for d in shown for one in _charts(d, comparison.curves(d.channel), points, names[0], reference, names[2:])
    ]
    Page(
        title=f'{names[0]} compared with {", ".join(names[1:])}',
        verdict=verdict[1],
        ok=verdict[0],
        about=about,
        facts=facts,
        blocks=[
            pages.heading('Channels'),
            pages.table(
                [[COLUMNS[k] for k in filled], *([row[k] for k in filled] for row in rows)],
                bad=[k for k, row in enumerate(rows) if row[1]],
                goes=[d.channel for d in shown],
            ),
            pages.text(LEGEND, soft=True),
            pages.heading('Curves'),
            pages.text('Drag to zoom, double click for everything, shift and wheel to zoom at the pointer.', soft=True),
            pages.charts(drawn),
        ],
    ).write(file)


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


def _charts(
    d: Difference, curves: Curves, points: int, run: str, reference: str, repeats: Sequence[str]
) -> tuple[Block, Block]:
    """Curves of a channel, and their difference, over one time."""
    keep = thinned(points, curves.run, curves.reference, curves.difference)
    first = float(curves.time[0])
    origin = pages.origin_of(first)
    time = (curves.time - first)[keep]
    curve = partial(pages.curve, start=first - origin)
    note = f'largest difference {d.max:.4g} at {d.time:.6g} s, RMS {d.rms:.4g}'
    note += f', rating {d.rating.overall:.3f}' if d.rating is not None else ''
    note += f'; {"; ".join(d.reasons)}' if d.reasons else ''
    unit = f' [{d.unit}]' if d.unit not in ('', '1') else ''
    of, difference = [], []
    if curves.half is not None:
        low, high = (curves.reference - curves.half)[keep], (curves.reference + curves.half)[keep]
        of.append(curve('95 % confidence band of the mean', time, low, high=high, style='band'))
        difference.append(curve('', time, -curves.half[keep], high=curves.half[keep], style='band'))
    of += [
        curve('repeats' if k == 0 else '', time, r[keep], style='repeat', group='repeats')
        for k, r in enumerate(curves.repeats)
    ]
    of.append(curve(reference, time, curves.reference[keep], style='reference', width=2.0))
    of.append(curve(run, time, curves.run[keep], style='run', dash=1))
    difference.append(curve('', time, curves.difference[keep], style='other'))
    more: dict[str, Any] = {'linked': 'time', 'origin': origin}
    label = d.channel.rpartition('/')[2]
    return (
        pages.chart(d.channel, 'time [s]', f'{label}{unit}', of, note=note, key=d.channel, **more),
        pages.chart(f'{d.channel}: difference', 'time [s]', f'difference{unit}', difference, zero=True, **more),
    )
