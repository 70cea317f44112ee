"""Evaluations as one HTML page that needs nothing else, its curves drawn by the page (docs/decisions/0011-report-of-comparisons.md)."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.analysis.evaluation.figures import SHOWN, Chart, Figure, Result, rows
from solver.errors import BagError

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
    verdicts = {
        True: 'all limits of the norm are kept',
        False: 'limits of the norm are not kept',
        None: 'not judged: the norm has no limits',
    }
    data = {
        'title': title,
        'verdict': {'ok': passed, 'text': verdicts[passed]},
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
    text = json.dumps(data, allow_nan=False).replace('<', '\\u003c')  # no tag can end the script
    page = files('mbd_sim_ros.analysis.evaluation').joinpath('page.html').read_text(encoding='utf-8').replace('@DATA@', text)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(page, encoding='utf-8')
    except OSError as error:
        raise BagError(f'cannot write the page {file}: {error.strerror}; choose another place') from None


def _row(figure: Figure) -> list[str]:
    return [figure.text, *figure.shown(), figure.limit, figure.verdict if figure.ok is not None else '']


def _amplitude(result: Result) -> str:
    """What tells the runs of a series from each other."""
    found = [f for f in result.figures if f.name == 'amplitude']
    return f', {math.degrees(found[0].value):+.0f} deg' if found else ''


def _chart(chart: Chart) -> dict[str, Any]:
    x, fx = _axis(*chart.x)
    y, fy = _axis(*chart.y)
    curves = []
    for curve in chart.curves:
        keep = thinned(curve.y)
        curves.append({'name': curve.name, 'style': curve.style, 'x': _floats(fx * curve.x[keep]), 'y': _floats(fy * curve.y[keep])})
    return {'title': chart.title, 'x': x, 'y': y, 'curves': curves}


def _axis(label: str, unit: str) -> tuple[str, float]:
    shown, factor = SHOWN.get(unit, (unit, 1.0))
    return (label if shown in ('', '1') else f'{label} [{shown}]'), factor


def thinned(y: np.ndarray) -> np.ndarray:
    """Which samples are drawn: all of a short curve, otherwise the smallest and largest of every stretch, in order."""
    if y.size <= POINTS:
        return np.arange(y.size)
    stretch = math.ceil(y.size / (POINTS / 2))
    starts = np.arange(0, y.size, stretch)
    chosen = [np.array([0, y.size - 1])]
    for fill, best in ((np.inf, np.argmin), (-np.inf, np.argmax)):
        padded = np.full(starts.size * stretch, fill)
        padded[: y.size] = np.where(np.isfinite(y), y, fill)
        chosen.append(starts + best(padded.reshape(-1, stretch), axis=1))
    return np.unique(np.concatenate(chosen).clip(max=y.size - 1))


def _floats(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, '<f4').tobytes()).decode()
