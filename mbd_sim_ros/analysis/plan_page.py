"""The page of a plan: one HTML file with pictures of what was chosen, what it rests on, and what leaving things out
saves and costs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter

from mbd_sim_ros.analysis import pages
from mbd_sim_ros.analysis.pages import Block, Page
from mbd_sim_ros.analysis.plots import FIRST, GREY, SECOND, STYLE
from mbd_sim_ros.analysis.provenance import facts_of_scene
from solver.errors import MbdError
from solver.scene import Scene
from solver.trade.bench import known, truth_of
from solver.trade.errors import ORIGINS
from solver.trade.judging import Verdict, nearest
from solver.trade.runs import Stopped
from solver.trade.search import Search
from solver.trade.variations import AS_GIVEN
from solver.units import shown

PARTS = {'model': '#1b6ca8', 'step': '#d95f02', 'iteration': '#2a9d5c', 'reference': '#7f7f7f'}
CURVES = 6


def write_page(search: Search, data: dict[str, Any], file: Path, scene: Scene) -> None:
    """Write the page. scene: as it was given, before a level was chosen. Raises BagError."""
    blocks: list[Block] = []
    chosen = search.result or nearest(search.tried)
    if data['errors']:
        text = (
            'Each is bounded by the sum of its parts, so that errors which cancel on one maneuver are not counted on.'
        )
        if data['largest_error']:
            error, free = 100.0 * data['largest_error'], 100.0 * (1.0 - data['margin'])
            text += (
                f' The errors themselves use up to {error:.0f} % of a limit; {free:.0f} % leave a margin for other '
                'maneuvers.'
            )
        parts = pages.picture('errors', _origins(data), 'Errors by origin, in % of their limits')
        blocks += [pages.heading('Errors by origin'), parts, pages.table(error_rows(data)), pages.text(text)]
    if chosen is not None:
        blocks += [pages.heading('Curves on the maneuver of the scene'), *_curves(search, chosen)]
    if search.tried:
        blocks += [
            pages.heading('What was tried'),
            pages.picture('tried', _tried(search, chosen), 'Share of the limit that the largest bound uses, and cost'),
            pages.text('Dots keep everything; crosses below the line have errors that leave no margin.'),
        ]
    blocks += [pages.heading('Levels of detail'), pages.table([('level', ''), *data['levels'].items()])]
    if any(i.errors for i in search.influences):
        blocks += [
            pages.heading('Which subsystem matters for which output'),
            pages.picture('influences', _influences(search), 'RMS change of each output, in % of its peak'),
            pages.text(
                'The change when the subsystem alone is left out of the chosen level; beside it what a step then '
                'costs. Subsystems that save nothing are not shown.'
            ),
        ]
    if data['checks']:
        ranges = ', '.join(f'{name} from {low:g} to {high:g}' for name, (low, high) in data['unseen']['ranges'].items())
        blocks += [
            pages.heading('Maneuvers that had no part in the choice'),
            pages.picture('checks', _checks(data), 'Largest error of each, in % of its limit'),
            *([pages.text(f'Within these ranges, as factors on what the scene has: {ranges}.')] if ranges else []),
            pages.table(_check_rows(data)),
        ]
    if reference := data['reference']:
        steps = ', '.join(f'{1e3 * h:g}' for h in reference['steps'])
        second = reference['second_formulation']
        table = [
            (name, f'{100 * b:.2g}', f'{100 * second[name]:.2g}' if name in second else '-')
            for name, b in reference['band'].items()
        ]
        blocks += [
            pages.heading('Reference'),
            pages.text(f'Converged full vehicle from steps of {steps} ms. RMS, in % of the peak:'),
            pages.table([('quantity', 'band', 'second formulation'), *table]),
        ]
        if reference['elsewhere']:
            judge = ' and '.join(reference['elsewhere'])
            blocks.append(
                pages.text(
                    f'On other maneuvers the reference is {judge}, whose error on this one is a small share of every '
                    'limit.'
                )
            )
    envelope = [(e['quantity'], shown(e['low'], e['unit']), shown(e['high'], e['unit'])) for e in data['envelope']]
    blocks += [pages.heading('Envelope'), pages.table([('quantity', 'from', 'to'), *envelope])]
    Page(
        title=f'Plan of {data["scene"]}',
        verdict=verdict(data),
        ok=data['status'] == 'ok',
        about=(*data['give'], *data['notes']),
        facts=[
            *facts_of_scene(scene.resolved, scene.name),
            ('certificate', f'{data["hash"]}; {data["baseline"]} costs 1'),
            ('limits', '; '.join(f'{row[0]} {row[-1]}' for row in error_rows(data)[1:])),
        ],
        blocks=blocks,
    ).write(file)


def verdict(data: dict[str, Any]) -> str:
    """One sentence."""
    if data['settings'] is None:
        return f'{data["status"]}: nothing was found'
    integrator = ', '.join(f'{name} {value}' for name, value in data['settings']['integrator'].items())
    off = ', '.join(data['settings']['switches'])
    what = f'{data["fidelity"]}{f" without {off}" if off else ""} with {integrator}'
    costs = f'costs {data["cost_ratio"]:.3g} of the full vehicle at 1 ms'
    costs += f'; mbd run shows {shows(data)}' if 'run' in data.get('cost', {}) else ''
    return f'{data["status"]}: {what} {costs}; {elsewhere(data["unseen"])}'


def elsewhere(unseen: dict[str, Any]) -> str:
    """The checks on maneuvers that had no part in the choice, in words."""
    of = unseen['passed'] + unseen['failed']
    if not of:
        return 'not checked on other maneuvers'
    text = f'{unseen["passed"]} of {of} other maneuver{"s" * (of > 1)} passed'
    text += '' if unseen['largest'] is None else f', the worst at {100.0 * unseen["largest"]:.0f} % of the limit'
    if unseen['bound'] is None:
        return text
    return f'{text}. (Statistically: with 95 % confidence at most {100.0 * unseen["bound"]:.2g} % could fail.)'


def shows(data: dict[str, Any]) -> str:
    """The speed that `mbd run` shows of the scene that was found, in words."""
    run = data['cost']['run']
    return f'{run["recorded"]:.3g} times real time, recording included; {run["unrecorded"]:.3g} with --no-record'


def new_figure(width: float, height: float, rows_: int = 1, columns: int = 1) -> tuple[Figure, Any]:
    """(figure, axes (rows, columns))."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height), layout='constrained')
        FigureCanvasAgg(figure)
        return figure, figure.subplots(rows_, columns, squeeze=False)


def error_rows(data: dict[str, Any]) -> list[tuple[str, ...]]:
    """The errors of a plan by origin, with their units, as a table whose first row is its head."""
    names = (*ORIGINS, 'sum', 'limit')
    found: list[tuple[str, ...]] = [('error', *names)]
    for quantity, measures in data['errors'].items():
        for measure, e in measures.items():
            unit = 's' if measure == 'delay' else data['units'][quantity]
            found.append(
                (f'{quantity} {measure}', *('-' if e[name] is None else shown(e[name], unit) for name in names))
            )
    return found


def _check_rows(data: dict[str, Any]) -> list[tuple[str, ...]]:
    found: list[tuple[str, ...]] = [('', 'maneuver', 'largest error', '')]
    for k, c in enumerate(data['checks'], 1):
        used = '-' if c['used'] is None else f'{100.0 * c["used"]:.3g} % of its limit'
        found.append((str(k), c['variation'], used, c['failure'] or c['worst']))
    return found


def _origins(data: dict[str, Any]) -> Figure:
    """Stacked bars of the parts of each error, in % of its limit."""
    errors = [(f'{q} {m}', e) for q, measures in data['errors'].items() for m, e in measures.items()]
    figure, axes = new_figure(9.0, 1.1 + 0.42 * len(errors))
    ax = axes[0, 0]
    left = np.zeros(len(errors))
    for origin, colour in PARTS.items():
        width = np.array([100.0 * (e[origin] or 0.0) / e['limit'] for _, e in errors])
        ax.barh(range(len(errors)), width, left=left, color=colour, label=origin)
        left += width
    ax.set_axisbelow(True)
    ax.axvline(100.0, color='black', lw=1.2)
    ax.set_yticks(range(len(errors)), [name for name, _ in errors])
    ax.invert_yaxis()
    ax.set_xlabel('% of the limit')
    ax.legend(
        fontsize=8,
        ncols=4,
        loc='upper center',
        bbox_to_anchor=(0.5, 1.0 + 0.5 / (0.5 + 0.42 * len(errors))),
        frameon=False,
    )
    return figure


def _curves(search: Search, chosen: Verdict) -> list[Block]:
    try:
        truth, found = truth_of(search.bench, AS_GIVEN), known(search.bench, AS_GIVEN, chosen.setting)
    except (MbdError, Stopped) as failure:
        return [pages.text(str(failure))]
    if found is None:
        return [pages.text('Its run did not come to the end.')]
    names = [n for n in search.shown if n in found.curves and n != 'position'][:CURVES]
    points, drawn = pages.points_for(2 * len(names)), []
    for name in names:
        unit = truth.quantities[name].unit
        exact, own = truth.curves[name][:, 0], found.curves[name][:, 0]
        keep, of_own = pages.thinned(points, exact), pages.thinned(points, own)
        curves = [
            pages.curve('converged full vehicle', truth.time[keep], exact[keep], style='reference', width=2.0),
            pages.curve(str(chosen.setting), found.time[of_own], own[of_own], style='run', dash=1),
        ]
        note = f'RMS error {100 * truth.errors(found)[name].share("rms"):.2g} % of the peak'
        drawn.append(pages.chart(name, 'time [s]', f'{name} [{unit}]', curves, note=note, linked='time'))
    return [pages.charts(drawn)] if drawn else []


def _tried(search: Search, chosen: Verdict | None) -> Figure:
    figure, axes = new_figure(8.0, 4.4)
    ax = axes[0, 0]
    levels = list(dict.fromkeys(t.setting.level for t in search.tried))
    colours = dict(zip(levels, ('#1b6ca8', '#d95f02', '#2a9d5c', '#8e44ad'), strict=False))
    for level in levels:
        points = [t for t in search.tried if t.setting.level == level and np.isfinite(t.used) and t.used > 0.0]
        for kept, marker in ((True, 'o'), (False, 'x')):
            some = [t for t in points if (not t.dropped) == kept]
            label = level if kept else None
            ax.scatter(
                [1e3 * t.cost for t in some],
                [t.used for t in some],
                marker=marker,
                color=colours[level],
                s=26,
                label=label,
            )
    if chosen is not None and np.isfinite(chosen.used):
        ax.scatter(
            [1e3 * chosen.cost], [chosen.used], s=190, facecolor='none', edgecolor='black', lw=1.5, label='chosen'
        )
    ax.axhline(1.0, color='black', lw=1.2)
    ax.set(
        xscale='log',
        yscale='log',
        xlabel='expected cost [ms of CPU per simulated second]',
        ylabel='largest share of a limit',
    )
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(StrMethodFormatter('{x:g}'))
        axis.set_minor_formatter(NullFormatter())
    ax.legend(fontsize=8)
    return figure


def _influences(search: Search) -> Figure:
    names = search.shown
    known = [i for i in search.influences if i.errors]
    table = np.array([[100.0 * i.errors[n] for n in names] for i in known])
    figure, axes = new_figure(3.2 + 0.62 * len(names), 1.9 + 0.34 * len(known))
    ax = axes[0, 0]
    ax.grid(False)
    finite = np.where(np.isfinite(table), np.maximum(table, 1e-4), np.nan)
    ax.imshow(np.log10(finite), cmap='Blues', aspect='auto', vmin=-3, vmax=2)
    for i, row in enumerate(table):
        for k, value in enumerate(row):
            text = (
                '-'
                if not np.isfinite(value)
                else '0'
                if value < 1e-6
                else f'{value:.1g}'
                if value < 10.0
                else f'{value:.0f}'
            )
            ax.text(k, i, text, ha='center', va='center', fontsize=8, color='white' if value > 3.0 else 'black')
    ax.set_xticks(range(len(names)), names, rotation=45, ha='right', fontsize=8)
    labels = [f'{i.subsystem}: step {100 * i.cost:.0f} %' for i in known]
    ax.set_yticks(range(len(known)), labels, fontsize=8)
    return figure


def _checks(data: dict[str, Any]) -> Figure:
    checks = data['checks']
    figure, axes = new_figure(9.0, 2.6)
    ax = axes[0, 0]
    used = [100.0 * c['used'] if c['used'] is not None else 200.0 for c in checks]
    ax.bar(range(1, len(used) + 1), used, color=[SECOND if u <= 100.0 else FIRST for u in used])
    ax.set_axisbelow(True)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_xlim(0.4, len(used) + 0.6)
    ax.axhline(100.0, color=GREY, lw=1.2)
    ax.set(xlabel='maneuver', ylabel='largest error, % of its limit')
    return figure
