"""Page of one or more recordings: what they are of, their verdicts, the path, and all channels to pick from, over each
other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mbd_sim_ros.analysis import pages, runs
from mbd_sim_ros.analysis.pages import Block, Page, thinned
from mbd_sim_ros.analysis.provenance import facts_of_runs
from mbd_sim_ros.bags.patterns import fits
from mbd_sim_ros.bags.reader import Run
from solver.analysis.verdict import OK
from solver.errors import BagError

# Channels of a page, those that come first in ORDER; ten times as many leave no points for each. `mbd export` has all.
MOST = 160
ORDER = (
    'imu/*', 'odom/twist/*', 'odom/pose/*', 'cmd_applied/*', 'energies/*', 'joint_states/*', 'tire/*', 'tire_states/*',
    '*',
)  # fmt: skip
CHOSEN = ('odom/twist/vx', 'imu/ay', 'imu/wz', 'cmd_applied/steering', 'tire/front_left/force/fz')
FEW = 4  # channels that are shown at first where none of CHOSEN is there
MOVES = 0.5  # m: a chassis that goes less far has no path


def write_page(places: Sequence[Path], file: Path, verdict: str = '', rows: Sequence[tuple[str, str]] = ()) -> None:
    """Write the page of recordings. verdict, rows: of the first, of who has just made it. Raises BagError."""
    found = [runs.read(place) for place in places]
    names = [place.name for place in places]
    if all(not run.series for run in found):
        raise BagError(f'{places[0]} has no channels to draw')
    status = [run.metadata.get('status', '') for run in found]
    said = verdict or '; '.join(
        f'{name}: {state or "no verdict"}' if len(names) > 1 else f'verdict: {state or "none"}'
        for name, state in zip(names, status, strict=True)
    )
    about = [str(note) for run in found for note in runs.suspicion(run)]
    errors = [run.error_text for run in found]
    about += errors if len(names) == 1 else [f'{name}: {text}' for name, text in zip(names, errors, strict=True)]
    ok = all(state == OK for state in status) if any(status) else None
    facts = facts_of_runs(found, [str(place) for place in places])
    rows = [row for row in rows if row[1] not in about]  # the head has said it
    blocks: list[Block] = [pages.table([('', ''), *rows])] if rows else []
    if path := _path(found, names):
        blocks += [pages.heading('Path'), pages.charts([path])]
    blocks += [pages.heading('Channels'), *channels(found, names)]
    Page(title=', '.join(names), verdict=said, ok=ok, about=about, facts=facts, blocks=blocks).write(file)


def channels(found: Sequence[Run], names: Sequence[str]) -> list[Block]:
    """The picker of all channels, with a sentence on those that are left out."""
    known = dict.fromkeys(name for run in found for series in run.series.values() for name in series.columns)
    order = dict.fromkeys(name for pattern in ORDER for name in known if fits(name, pattern))
    kept = [*order][:MOST]
    unit = runs.units(*found)
    points = pages.points_for(len(kept) * len(found))
    first = min(float(one.time_ns[0]) * 1e-9 for run in found for one in run.series.values() if len(one.time_ns))
    origin = pages.origin_of(first)
    data = {}
    for name in kept:
        of: list[list[str | float] | None] = []
        for run in found:
            one = next((series for series in run.series.values() if name in series.columns), None)
            if one is None:
                of.append(None)
                continue
            values = np.asarray(one.columns[name], float)
            keep = thinned(points, values)
            offset = pages.offset_of(values)
            time = (one.time_ns * 1e-9 - first)[keep]  # of 32 bits, to 6e-8 of the duration
            of.append([pages.floats(time), pages.floats(values[keep] - offset), offset])
        data[name] = {'label': f'{name.rpartition("/")[2]} [{unit(name)}]' if unit(name) else name, 'runs': of}
    chosen = [name for name in CHOSEN if name in data] or kept[:FEW]
    block = {
        'kind': 'channels',
        'runs': list(names),
        'channels': data,
        'chosen': chosen,
        'origin': origin,
        'start': first - origin,
    }
    left = len(known) - len(kept)
    more = [pages.text(f'{left} more channels are in the recording: mbd export writes all of them.', soft=True)]
    return [block, *(more if left else [])]


def _path(found: Sequence[Run], names: Sequence[str]) -> Block | None:
    """The way over the ground from above; None for what does not move."""
    curves = []
    for k, (run, name) in enumerate(zip(found, names, strict=True)):
        if not {'odom/pose/x', 'odom/pose/y'} <= {*run.names}:
            continue
        series = next(one for one in run.series.values() if 'odom/pose/x' in one.columns)
        x, y = (np.asarray(series.columns[f'odom/pose/{axis}'], float) for axis in 'xy')
        if max(np.ptp(x), np.ptp(y)) < MOVES:
            continue
        keep = thinned(pages.POINTS, x, y)
        curves.append(pages.curve(name if len(names) > 1 else '', x[keep], y[keep], colour=k if len(names) > 1 else 1))
    return pages.chart('path, from above', 'x [m]', 'y [m]', curves, equal=True) if curves else None
