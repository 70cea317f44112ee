"""Report of a study: text, tables, pictures and checks, written as it grows."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mbd_sim_ros.analysis.plots import STYLE

COLOURS = ('#1b6ca8', '#d95f02', '#2a9d5c', '#8e44ad', '#222222', '#8c8c8c', '#b8860b', '#16a0a0', '#e377c2', '#c0392b')
DPI = 100


class Report:
    """report.md in the directory `out`, in the order of the calls. text(), table(), figure() and check() add to it; write() closes it."""

    def __init__(self, out: Path, title: str) -> None:
        self.out = out
        self.checks: list[dict[str, Any]] = []
        self._parts = [f'# {title}']

    def text(self, *paragraphs: str) -> None:
        """Paragraphs, or headings, of Markdown."""
        self._parts += paragraphs

    def table(self, name: str, rows: Sequence[Mapping[str, Any]], *, shown: bool = True) -> None:
        """Rows with the same keys: all digits into <name>.csv and, if shown, four of them into the report."""
        with (self.out / f'{name}.csv').open('w', newline='', encoding='utf-8') as file:
            writer = csv.DictWriter(file, list(rows[0]), lineterminator='\n')
            writer.writeheader()
            writer.writerows(rows)
        if shown:
            self._parts.append(markdown(rows))

    def figure(self, name: str, figure: Figure, caption: str) -> None:
        """Save a picture as <name>.png and show it."""
        with mpl.rc_context(STYLE):
            figure.savefig(self.out / f'{name}.png', dpi=DPI)
        self._parts.append(f'![{caption}]({name}.png)\n\n*{caption}*')

    def check(self, name: str, value: float, limit: float, *, least: bool = False) -> dict[str, Any]:
        """Judge a figure: at most the limit, or with `least` at least. A value that is not a number is not good enough."""
        met = bool(value >= limit) if least else bool(value <= limit)
        entry = {'name': name, 'value': float(value), 'limit': float(limit), 'met': met}
        self.checks.append(entry)
        return entry

    def write(self) -> None:
        """Write report.md, with all checks at its end."""
        if self.checks:
            rows = [{**entry, 'met': 'yes' if entry['met'] else 'NO'} for entry in self.checks]
            self._parts += ['## Checks', markdown(rows)]
        (self.out / 'report.md').write_text('\n\n'.join(self._parts) + '\n', encoding='utf-8')


def figure(width: float, height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Figure, Any]:
    """(figure, axes (rows, columns)) in the common style, size in inches, drawn without a display."""
    with mpl.rc_context(STYLE):
        new = Figure(figsize=(width, height), layout='constrained')
        FigureCanvasAgg(new)
        return new, new.subplots(rows, columns, squeeze=False, **options)


def markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows with the same keys as a table."""
    lines = [' | '.join(rows[0]), '|'.join('---' for _ in rows[0])]
    lines += [' | '.join(cell(value) for value in row.values()) for row in rows]
    return '\n'.join(f'| {line} |' for line in lines)


def cell(value: Any) -> str:
    """A value for people: four digits, a dash where there is none."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return '-'
    return f'{value:.4g}' if isinstance(value, float) else str(value)
