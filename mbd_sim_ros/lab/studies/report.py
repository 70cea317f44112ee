"""Report of a study: text, tables, pictures and checks, in the order in which the study adds them, in Markdown for the
repository and as a page."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mbd_sim_ros.analysis import pages
from mbd_sim_ros.analysis.plots import STYLE

COLOURS = ('#1b6ca8', '#d95f02', '#2a9d5c', '#8e44ad', '#222222', '#8c8c8c', '#b8860b', '#16a0a0', '#e377c2', '#c0392b')
DPI = 100  # pixels per inch of pictures


class Report:
    """The files report.md and report.html in the directory `out`. text(), table(), figure() and check() add to them;
    write() writes them.

    checks: entries of all check() calls so far.
    """

    def __init__(self, out: Path, title: str) -> None:
        self.out = out
        self.checks: list[dict[str, Any]] = []
        self._title, self._parts = title, [f'# {title}']
        self._blocks: list[pages.Block] = []

    def text(self, *paragraphs: str) -> None:
        """Add paragraphs, or headings, in Markdown."""
        self._parts += paragraphs
        self._blocks += [block for paragraph in paragraphs for block in pages.markdown(paragraph)]

    def table(self, name: str, rows: Sequence[Mapping[str, Any]], *, shown: bool = True) -> None:
        """Add a table of rows with the same keys: to <name>.csv with all digits and, if shown, to the report with four
        digits."""
        with (self.out / f'{name}.csv').open('w', newline='', encoding='utf-8') as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator='\n')
            writer.writeheader()
            writer.writerows(rows)
        if shown:
            self._parts.append(markdown(rows))
            self._blocks.append(pages.table([list(rows[0]), *(list(row.values()) for row in rows)]))

    def figure(self, name: str, figure: Figure, caption: str) -> None:
        """Save a picture as <name>.png and show it in the report; on the page as curves to zoom into, where it is
        nothing but curves."""
        with mpl.rc_context(STYLE):
            figure.savefig(self.out / f'{name}.png', dpi=DPI)
            drawn = interactive(figure)
            shown = [pages.charts(drawn), pages.text(caption, soft=True)] if drawn else []
            self._blocks += shown or [pages.picture(name, figure, caption)]
        self._parts.append(f'![{caption}]({name}.png)\n\n*{caption}*')

    def check(self, name: str, value: float, limit: float, *, least: bool = False) -> dict[str, Any]:
        """Check that a value is at most the limit, or with `least` at least the limit, and return the entry. NaN
        fails."""
        met = bool(value >= limit) if least else bool(value <= limit)
        entry = {'name': name, 'value': float(value), 'limit': float(limit), 'met': met}
        self.checks.append(entry)
        return entry

    def write(self) -> None:
        """Write report.md and report.html, with all checks at the end. Raises BagError."""
        missed = [entry['name'] for entry in self.checks if not entry['met']]
        if self.checks:
            rows = [{**entry, 'met': 'yes' if entry['met'] else 'NO'} for entry in self.checks]
            self._parts += ['## Checks', markdown(rows)]
            table = [list(rows[0]), *(list(row.values()) for row in rows)]
            self._blocks += [pages.heading('Checks'), pages.table(table)]
        (self.out / 'report.md').write_text('\n\n'.join(self._parts) + '\n', encoding='utf-8')
        said = f'checks not met: {", ".join(missed)}' if missed else f'all {len(self.checks)} checks are met'
        pages.Page(
            title=self._title,
            verdict=said if self.checks else '',
            ok=not missed if self.checks else None,
            blocks=self._blocks,
        ).write(self.out / 'report.html')


def interactive(figure: Figure) -> list[pages.Block]:
    """Charts of a figure that is nothing but curves over a rising x, on linear axes; [] for any other."""
    found, points = [], pages.points_for(sum(len(ax.lines) for ax in figure.axes))
    for ax in figure.axes:
        linear = ax.get_xscale() == ax.get_yscale() == 'linear' and not (ax.xaxis_inverted() or ax.yaxis_inverted())
        bare = not (ax.collections or ax.patches or ax.images or ax.texts or ax.artists)
        alone = sum(other.get_position().bounds == ax.get_position().bounds for other in figure.axes) == 1
        if not (linear and bare and alone and ax.lines) or any(not _rises(line, ax) for line in ax.lines):
            return []
        colours = list(dict.fromkeys(line.get_color() for line in ax.lines))
        curves = []
        for line in ax.lines:
            name, x, y = (
                str(line.get_label()),
                *(np.asarray(data, float) for data in (line.get_xdata(), line.get_ydata())),
            )
            keep = pages.thinned(points, y)
            style = {'colour': colours.index(line.get_color()), 'dash': int(line.get_linestyle() != '-')}
            curves.append(pages.curve('' if name.startswith('_') else name, x[keep], y[keep], **style))
        found.append(pages.chart(ax.get_title(), ax.get_xlabel(), ax.get_ylabel(), curves))
    return found


def _rises(line: Line2D, ax: Axes) -> bool:
    """True for a drawn line with data in the units of its axes, whose x rises."""
    drawn = line.get_linestyle() in ('-', '--', '-.', ':') and line.get_marker() in ('', 'None', None)
    if not drawn or line.get_transform() != ax.transData:
        return False
    x, y = np.asarray(line.get_xdata(), float), np.asarray(line.get_ydata(), float)
    return len(x) > 2 and bool(np.all(np.isfinite(x)) and np.all(np.diff(x) > 0.0) and np.isfinite(y).any())


def figure(width: float, height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, Any]:
    """(figure, (rows, columns) array of axes) in the common style; width and height in inches. Needs no display."""
    with mpl.rc_context(STYLE):
        new = Figure(figsize=(width, height), layout='constrained')
        FigureCanvasAgg(new)
        return new, new.subplots(rows, columns, squeeze=False, **options)


def markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """Table in Markdown of rows with the same keys."""
    lines = [' | '.join(rows[0]), '|'.join('---' for _ in rows[0])]
    lines += [' | '.join(cell(value) for value in row.values()) for row in rows]
    return '\n'.join(f'| {line} |' for line in lines)


def cell(value: Any) -> str:
    """Text of a value: a number with four digits, a dash for None and NaN."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return '-'
    return f'{value:.4g}' if isinstance(value, float) else str(value)
