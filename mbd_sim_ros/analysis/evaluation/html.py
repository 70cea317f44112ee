"""Page of evaluations: figures and curves of every recording, and variants side by side."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.analysis import pages
from mbd_sim_ros.analysis.evaluation import variants as beside
from mbd_sim_ros.analysis.evaluation.figures import SHOWN, Chart, Figure, Result, rows, sentence
from mbd_sim_ros.analysis.evaluation.variants import Variant
from mbd_sim_ros.analysis.pages import Block, Page, thinned

OPEN = 4  # results whose figures are unfolded; ten times as many are a page of minutes


def write_page(
    of: Sequence[Variant],
    file: Path,
    *,
    title: str,
    about: Sequence[str] = (),
    facts: Sequence[tuple[str, str]] = (),
    passed: bool | None,
    together: Mapping[str, Sequence[Figure]],
) -> None:
    """Write the page `file`.

    about: lines at its head. facts: what the recordings are of. passed: overall verdict, None if nothing was judged.
    together: title -> figures of a whole series of runs. Raises BagError if the file cannot be written.
    """
    named = [(f'{variant.name}: ' if len(of) > 1 else '', r) for variant in of for r in variant.results]
    results = [r for _, r in named]
    overlaid: dict[str, tuple[list[Variant], tuple[Chart, ...]]] = {}
    for name in dict.fromkeys(r.evaluation for r in results):
        having = [variant for variant in of if variant.of(name)]
        if len(having) > 1:
            overlaid[name] = having, beside.overlaid(having, name)
    drawn = [chart for r in results for chart in r.charts] + [c for _, found in overlaid.values() for c in found]
    points = pages.points_for(sum(len(chart.curves) for chart in drawn))
    blocks: list[Block] = []
    for name, (having, found) in overlaid.items():
        first = having[0].of(name)[0]
        blocks += [pages.heading(f'{first.title}: variants side by side'), pages.table(beside.rows(having, name))]
        note = f'Differences are those from {having[0].name}, in percent of its value.'
        blocks.append(pages.text(note, soft=True))
        blocks.append(pages.charts([_chart(one, points, f'beside {name}') for one in found]))
    for name, figures in together.items():
        head = ('figure', 'value', 'unit', 'limit', 'verdict')
        blocks += [pages.heading(name), pages.table([head, *(_row(f) for f in figures)])]
    blocks.append(pages.heading('Recordings'))
    for k, (whose, r) in enumerate(named):
        verdict = {True: ': pass', False: ': FAIL', None: ''}[r.passed]
        parameters = ', '.join(f'{key} {value:g}' for key, value in r.parameters.items() if value is not None)
        part = [
            pages.text(r.source, f'After {r.norm}', *([f'Parameters: {parameters}'] if parameters else []), soft=True)
        ]
        part.append(pages.table(rows([r])))
        part += [pages.text(*(f'Note: {note}' for note in r.notes))] if r.notes else []
        part.append(pages.charts([_chart(one, points, str(k)) for one in r.charts]))
        is_open = len(results) <= OPEN and not overlaid
        blocks.append(pages.part(f'{whose}{r.title}{_amplitude(r)}{verdict}', part, is_open=is_open))
    Page(title=title, verdict=sentence(results), ok=passed, about=about, facts=facts, blocks=blocks).write(file)


def _row(figure: Figure) -> list[str]:
    """Cells of the table row of a figure."""
    return [figure.text, *figure.shown(), figure.limit, figure.verdict if figure.ok is not None else '']


def _amplitude(result: Result) -> str:
    """Ending of the title of a run in a series of amplitudes, ', +90 deg' say; '' where it has none."""
    found = [f for f in result.figures if f.name == 'amplitude']
    return f', {math.degrees(found[0].value):+.0f} deg' if found else ''


def _chart(chart: Chart, points: int, of: str) -> Block:
    """A chart as data for the script of the page, in the units that are shown. Curves of variants have the colour of
    their variant, and a dash by their order in it."""
    x, fx = _axis(*chart.x)
    y, fy = _axis(*chart.y)
    groups = list(dict.fromkeys(curve.group for curve in chart.curves))
    order: dict[str, int] = {}
    curves = []
    # stamps are counted from the first, for they have 32 bits
    start = min((float(one.x[0]) for one in chart.curves if one.x.size), default=0.0) if chart.x[1] == 's' else 0.0
    for one in chart.curves:
        # of a cloud any samples do, of a curve its extremes
        even = np.arange(0, one.y.size, max(1, -(-one.y.size // points)))
        keep = even if one.style == 'cloud' else thinned(points, one.y)
        more: dict[str, Any] = {'start': fx * start} if start else {}
        if one.group:
            more |= {'colour': groups.index(one.group), 'dash': order.get(one.group, 0)}
            order[one.group] = more['dash'] + (one.style != 'limit')
        curves.append(
            pages.curve(
                one.name, fx * (one.x[keep] - start), fy * one.y[keep], style=one.style, group=one.group, **more
            )
        )
    linked = f'{of}: {x}' if chart.x[1] == 's' else None
    return pages.chart(chart.title, x, y, curves, linked=linked)


def _axis(label: str, unit: str) -> tuple[str, float]:
    """(label with the unit that is shown, factor from SI to that unit)."""
    shown, factor = SHOWN.get(unit, (unit, 1.0))
    return (label if shown in ('', '1') else f'{label} [{shown}]'), factor
