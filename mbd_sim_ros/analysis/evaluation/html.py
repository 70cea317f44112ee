"""Report of evaluations as one HTML page that needs no other files. A script in it draws the curves
(docs/decisions/0011-report-of-comparisons.md).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.analysis.evaluation.figures import SHOWN, Chart, Figure, Result, rows, sentence
from mbd_sim_ros.analysis.pages import fill, floats, thinned

POINTS = 1500  # points of a curve that are kept, about; ten times as many make a page slow


def write_page(
    results: Sequence[Result],
    file: Path,
    *,
    title: str,
    about: Sequence[str],
    passed: bool | None,
    together: Mapping[str, Sequence[Figure]],
) -> None:
    """Write the page `file`.

    about: lines at its head. passed: overall verdict, None if nothing was judged. together: title -> figures of a whole
    series of runs. Raises BagError if the file cannot be written.
    """
    data = {
        'title': title,
        'verdict': {'ok': passed, 'text': sentence(results)},
        'about': list(about),
        'together': [{'title': name, 'rows': [_row(f) for f in found]} for name, found in together.items()],
        'results': [
            {
                'title': f'{r.title}{_amplitude(r)}',
                'verdict': {True: 'pass', False: 'FAIL', None: ''}[r.passed],
                'norm': r.norm,
                'source': r.source,
                'head': rows([r])[0],
                'rows': rows([r])[1:],
                'notes': list(r.notes),
                'charts': [_chart(c) for c in r.charts],
            }
            for r in results
        ],
    }
    fill(file, 'mbd_sim_ros.analysis.evaluation:page.html', data)


def _row(figure: Figure) -> list[str]:
    """Cells of the table row of a figure."""
    return [figure.text, *figure.shown(), figure.limit, figure.verdict if figure.ok is not None else '']


def _amplitude(result: Result) -> str:
    """Ending of the title of a run in a series of amplitudes, ', +90 deg' say; '' where it has none."""
    found = [f for f in result.figures if f.name == 'amplitude']
    return f', {math.degrees(found[0].value):+.0f} deg' if found else ''


def _chart(chart: Chart) -> dict[str, Any]:
    """A chart as data for the script of the page, in the units that are shown."""
    x, fx = _axis(*chart.x)
    y, fy = _axis(*chart.y)
    curves = []
    for curve in chart.curves:
        keep = np.arange(curve.y.size) if curve.style == 'cloud' else thinned(POINTS, curve.y)
        curves.append(
            {'name': curve.name, 'style': curve.style, 'x': floats(fx * curve.x[keep]), 'y': floats(fy * curve.y[keep])}
        )
    return {'title': chart.title, 'x': x, 'y': y, 'curves': curves}


def _axis(label: str, unit: str) -> tuple[str, float]:
    """(label with the unit that is shown, factor from SI to that unit)."""
    shown, factor = SHOWN.get(unit, (unit, 1.0))
    return (label if shown in ('', '1') else f'{label} [{shown}]'), factor
