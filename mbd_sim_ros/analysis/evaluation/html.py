"""Evaluations as one HTML page that needs nothing else, its curves drawn by the page (docs/decisions/0011-report-of-comparisons.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mbd_sim_ros.analysis.evaluation.figures import SHOWN, Chart, Figure, Result, rows, sentence
from mbd_sim_ros.analysis.pages import fill, floats, thinned

POINTS = 1500  # about so many of a curve


def write_page(
    results: Sequence[Result],
    file: Path,
    *,
    title: str,
    about: Sequence[str],
    passed: bool | None,
    together: Mapping[str, Sequence[Figure]],
) -> None:
    """Write the page. about: lines for its head. together: title -> figures of a whole series. Raises BagError where it cannot be."""
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
                'rows': rows([r])[1:],
                'notes': list(r.notes),
                'charts': [_chart(c) for c in r.charts],
            }
            for r in results
        ],
    }
    fill(file, 'mbd_sim_ros.analysis.evaluation:page.html', data)


def _row(figure: Figure) -> list[str]:
    return [figure.text, *figure.shown(), figure.limit, figure.verdict if figure.ok is not None else '']


def _amplitude(result: Result) -> str:
    """Mark that tells the runs of a series from each other."""
    found = [f for f in result.figures if f.name == 'amplitude']
    return f', {math.degrees(found[0].value):+.0f} deg' if found else ''


def _chart(chart: Chart) -> dict[str, Any]:
    x, fx = _axis(*chart.x)
    y, fy = _axis(*chart.y)
    curves = []
    for curve in chart.curves:
        keep = thinned(POINTS, curve.y)
        curves.append({'name': curve.name, 'style': curve.style, 'x': floats(fx * curve.x[keep]), 'y': floats(fy * curve.y[keep])})
    return {'title': chart.title, 'x': x, 'y': y, 'curves': curves}


def _axis(label: str, unit: str) -> tuple[str, float]:
    shown, factor = SHOWN.get(unit, (unit, 1.0))
    return (label if shown in ('', '1') else f'{label} [{shown}]'), factor
