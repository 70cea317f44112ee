"""The page of a plan: one HTML file with pictures of what was chosen, what it rests on, and what leaving things out
saves and costs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.analysis import pages
from mbd_sim_ros.analysis.pages import Block, Page
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

PARTS = {'model': '--c1', 'step': '--c0', 'iteration': '--c2', 'reference': '--other'}  # colours of page.css
COLOURS = (1, 0, 2, 3)  # of levels
LIMIT = '% of the limit'
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
        blocks += [pages.heading('Errors by origin'), _origins(data), pages.table(error_rows(data)), pages.text(text)]
    if chosen is not None:
        blocks += [pages.heading('Curves on the maneuver of the scene'), *_curves(search, chosen)]
    if search.tried:
        blocks += [
            pages.heading('What was tried'),
            _tried(search, chosen),
            pages.text('Large dots keep everything; small ones below the line have errors that leave no margin.'),
        ]
    blocks += [pages.heading('Levels of detail'), pages.table([('level', ''), *data['levels'].items()])]
    if any(i.errors for i in search.influences):
        blocks += [
            pages.heading('Which subsystem matters for which output'),
            _influences(search),
            pages.text(
                'The change when the subsystem alone is left out of the chosen level; beside it what a step then '
                'costs. Subsystems that save nothing are not shown.'
            ),
        ]
    if data['checks']:
        ranges = ', '.join(f'{name} from {low:g} to {high:g}' for name, (low, high) in data['unseen']['ranges'].items())
        blocks += [
            pages.heading('Maneuvers that had no part in the choice'),
            _checks(data),
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


def _origins(data: dict[str, Any]) -> Block:
    """Stacked bars of the parts of each error, in % of its limit."""
    errors = [(f'{q} {m}', e) for q, measures in data['errors'].items() for m, e in measures.items()]
    series = [
        {'name': origin, 'colour': colour, 'values': [100.0 * (e[origin] or 0.0) / e['limit'] for _, e in errors]}
        for origin, colour in PARTS.items()
    ]
    texts = [dict(zip(ORIGINS, row[1:], strict=False)) for row in error_rows(data)[1:]]
    says = [
        f'{name}: {origin} {row[origin]}, {100.0 * (e[origin] or 0.0) / e["limit"]:.3g} % of the limit'
        for (name, e), row in zip(errors, texts, strict=True)
        for origin in PARTS
    ]
    names = [name for name, _ in errors]
    title = 'errors by origin'
    return {'kind': 'bars', 'title': title, 'x': LIMIT, 'names': names, 'series': series, 'says': says, 'limit': 100.0}


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


def _tried(search: Search, chosen: Verdict | None) -> Block:
    """Share of a limit over cost of all that was tried, in decades; the chosen one has a larger dot behind it."""
    points = [t for t in search.tried if np.isfinite(t.used) and t.used > 0.0 and t.cost > 0.0]
    curves = []
    if chosen is not None and chosen in points:
        curves.append(pages.curve('chosen', *_places([chosen]), style='points', points=9.0, colour=7))
    for k, level in enumerate(dict.fromkeys(t.setting.level for t in points)):
        for kept, radius in ((True, 4.5), (False, 2.2)):
            some = [t for t in points if t.setting.level == level and (not t.dropped) == kept]
            if not some:
                continue
            name = level if kept else f'{level}, dropped'
            labels = [
                f'{t.setting}: {100.0 * t.used:.3g} % of the limit, {1e3 * t.cost:.3g} ms'
                f'{f"; {t.dropped}" if t.dropped else ""}'
                for t in some
            ]
            curves.append(
                pages.curve(name, *_places(some), style='points', points=radius, colour=COLOURS[k], labels=labels)
            )
    if points:
        costs = [1e3 * t.cost for t in points]
        ends = np.array([min(costs) / 1.5, max(costs) * 1.5])  # beyond all dots, and seen where there is one
        curves.append(pages.curve('limit', ends, np.ones(2), style='limit'))
    across, up = 'expected cost [ms of CPU per simulated second]', 'largest share of a limit'
    return pages.charts([pages.chart('cost and error of what was tried', across, up, curves, log=True, tall=True)])


def _places(some: list[Verdict]) -> tuple[np.ndarray, np.ndarray]:
    return np.array([1e3 * t.cost for t in some]), np.array([t.used for t in some])


def _influences(search: Search) -> Block:
    names = search.shown
    found = [i for i in search.influences if i.errors]
    table = [[100.0 * i.errors[n] if np.isfinite(i.errors[n]) else None for n in names] for i in found]
    rows = [f'{i.subsystem}: step {100 * i.cost:.0f} %' for i in found]
    says = [
        f'without {i.subsystem}, {name}: ' + ('not known' if v is None else f'{v:.3g} % of its peak')
        for i, row in zip(found, table, strict=True)
        for name, v in zip(names, row, strict=True)
    ]
    title = 'RMS change of each output, in % of its peak'
    between = (1e-3, 100.0)
    return {
        'kind': 'cells', 'title': title, 'rows': rows, 'columns': list(names), 'values': table, 'between': between,
        'says': says,
    }  # fmt: skip


def _checks(data: dict[str, Any]) -> Block:
    """Bars of the errors on maneuvers that had no part in the choice; one without a number has a bar of twice its
    limit."""
    rows = _check_rows(data)[1:]
    used = [100.0 * c['used'] if c['used'] is not None else 200.0 for c in data['checks']]
    within = [u if u <= 100.0 else None for u in used]
    beyond = [u if u > 100.0 else None for u in used]
    says = [': '.join(filter(None, (row[1], row[2], row[3]))) for row in rows]
    series = [
        {'name': 'within the limit', 'colour': '--c1', 'values': within},
        {'name': 'beyond, or failed', 'colour': '--c0', 'values': beyond},
    ]
    return {
        'kind': 'bars', 'title': 'largest error of each maneuver', 'x': LIMIT, 'names': [row[0] for row in rows],
        'series': series, 'says': [one for one in says for _ in series], 'limit': 100.0,
    }  # fmt: skip
