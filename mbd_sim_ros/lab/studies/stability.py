"""Stability at the extremes: right, told or silently wrong, over what can be set and what a model can be, and cars in
extreme tasks."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from mbd_sim_ros.lab.mechanisms.judgement import RIGHT, TOLD, UNDECIDED, WORSE, WRONG
from mbd_sim_ros.lab.studies import Progress, stability_cars, stability_maps, stability_passages
from mbd_sim_ros.lab.studies.cells import Cells, number
from mbd_sim_ros.lab.studies.neighbours import BEYOND, SILENT, silent
from mbd_sim_ros.lab.studies.report import Report, figure
from solver.step.settings import IntegratorSettings

SUMMARY = 'right, told or silently wrong at the extremes: settings, stiffness, masses, spin, distance, long runs, cars'
GRID_STEPS = (2e-3, 10e-3)  # s, of the maps of iterations and penalty
SOURCES = tuple(f'mbd_sim_ros/lab/studies/stability_{part}.py' for part in ('maps', 'cars', 'passages'))
RECOMMENDED = (1e-3, 5e-3)  # s
LONG_STEPS, QUICK_LONG_STEPS = 10_000_000, 20_000
QUICK_CARS = ('standstill', 'to_rest', 'landing', 'fast')
# Of the palette of Okabe and Ito, which colour-blind eyes tell apart; brightness alone orders them too.
CLASSES = {
    RIGHT: ('#9bd0f0', 'right'),
    'suspect': ('#f0e442', 'told: suspect'),
    'failed': ('#d55e00', 'told: failed or refused'),
    UNDECIDED: ('#bbbbbb', 'undecided'),
    WRONG: ('#000000', 'silently wrong'),
}


def study(out: Path, *, quick: bool, progress: Progress) -> dict:
    """Compute all cells that are not there yet, then write the report."""
    report = Report(out, 'Stability')
    settings = IntegratorSettings()
    report.text(
        f'Default settings ({settings.step_policy} step, mode {settings.mode}, {settings.iterations} iterations, '
        f'rho_inf {settings.rho_inf:g}, penalty {settings.penalty:g}) unless an axis says otherwise. A run is right '
        f'when its error is at most {WORSE:g} times what second order predicts from the other steps of its line '
        '(mbd_sim_ros.lab.mechanisms.judgement), told when it fails, is refused or is suspect, else silently wrong; '
        'undecided where references do not agree.'
    )
    cells = Cells(out / 'cells', SOURCES)
    lines = _maps(report, cells, quick, lambda t, x: progress(t, 0.35 * x))
    _recommend(report, lines, quick)
    grids = _grids(report, cells, quick, lambda t, x: progress(t, 0.35 + 0.1 * x))
    counted = _counted(report, cells, quick, lambda t, x: progress(t, 0.45 + 0.2 * x))
    cars = _cars(report, cells, quick, lambda t, x: progress(t, 0.65 + 0.35 * x))
    runs = [run for row in (*lines, *grids, *cars) for run in row['runs']]
    wrong, beyond = silent((*lines, *grids, *cars))
    report.check(SILENT, wrong, 0)
    report.check(BEYOND, beyond, 0)
    report.write()
    shares = {name: sum(_class(run) == name for run in runs) for name in CLASSES}
    return {'cells': len(runs), 'classes': shares, **counted, 'checks': report.checks}


def _class(run: dict[str, Any]) -> str:
    if run['judgement'] != TOLD:
        return str(run['judgement'])
    return 'suspect' if run['status'] == 'suspect' else 'failed'


def _maps(report: Report, cells: Cells, quick: bool, progress: Progress) -> list[dict[str, Any]]:
    steps = stability_maps.QUICK_STEPS if quick else stability_maps.STEPS
    found: list[dict[str, Any]] = []
    maps = stability_maps.maps(quick)
    total = sum(len(lines) for m in maps.values() for lines in m.panels.values())
    for name, m in maps.items():
        rows: dict[str, list[dict[str, Any]]] = {}
        for panel, lines in m.panels.items():
            for line in lines:
                progress(f'{m.title}, {panel}', len(found) / total)
                key = f'{name}/{panel}/{line.ordinate:g}/{len(steps)}'
                rows.setdefault(panel, []).append(cells.cell(key, partial(stability_maps.run_line, line, steps)))
                found.append(rows[panel][-1])
        ordinates = {panel: [line.ordinate for line in lines] for panel, lines in m.panels.items()}
        report.text(f'## Step and {m.title}')
        _limits(report, name, m, rows)
        picture = _picture(
            {p: [row['runs'] for row in r] for p, r in rows.items()},
            ordinates,
            [h * 1e3 for h in steps],
            'step [ms]',
            m.ordinate,
        )
        report.figure(name, picture, f'Step and {m.title}; numbers: exponent of the largest error [m or rad]')
    return found


def _limits(report: Report, name: str, m: stability_maps.Map, rows: dict[str, list[dict[str, Any]]]) -> None:
    """The largest step of every line up to which all runs are right."""
    table = []
    for panel, lines in m.panels.items():
        for line, row in zip(lines, rows[panel], strict=True):
            runs = sorted(row['runs'], key=lambda run: run['h'])
            first = next((k for k, run in enumerate(runs) if run['judgement'] != RIGHT), len(runs))
            beyond = runs[first:]
            table.append(
                {
                    'problem': panel,
                    m.ordinate: line.ordinate,
                    'right up to [ms]': runs[first - 1]['h'] * 1e3 if first else np.nan,
                    'error there': number(runs[first - 1]['error']) if first else np.nan,
                    'beyond': ', '.join(dict.fromkeys(CLASSES[_class(run)][1] for run in beyond)) or '-',
                }
            )
    report.table(name, table)


def _recommend(report: Report, found: list[dict[str, Any]], quick: bool) -> None:
    """Which values of every ordinate are right at two steps."""
    rows = iter(found)
    table = []
    for m in stability_maps.maps(quick).values():
        for panel, lines in m.panels.items():
            judged = [(line.ordinate, {run['h']: run['judgement'] for run in next(rows)['runs']}) for line in lines]
            shown = {
                f'right at {h * 1e3:g} ms': _span([(x, runs[h] == RIGHT) for x, runs in judged]) for h in RECOMMENDED
            }
            table.append(
                {'of': m.ordinate, 'problem': panel, 'tried': f'{judged[0][0]:g} to {judged[-1][0]:g}', **shown}
            )
    report.text(
        '## Limits',
        'Values at which the default settings, but for what is varied, are right; beyond them a run says so.',
    )
    report.table('limits', table)


def _span(values: list[tuple[float, bool]]) -> str:
    """The longest run of values that are right."""
    best: list[float] = []
    now: list[float] = []
    for x, right in values:
        now = [*now, x] if right else []
        best = max(best, now, key=len)
    if len(best) == len(values):
        return 'all'
    return f'{best[0]:g} to {best[-1]:g}' if best else 'none'


def _grids(report: Report, cells: Cells, quick: bool, progress: Progress) -> list[dict[str, Any]]:
    iterations = stability_maps.ITERATIONS[::3] if quick else stability_maps.ITERATIONS
    penalties = stability_maps.PENALTIES[::3] if quick else stability_maps.PENALTIES
    problems = {
        'slider-crank': stability_maps.slider_crank,
        'double pendulum, masses 1 : 1e6': partial(stability_maps.pendulum, 1e6),
    }
    rows: dict[str, dict[str, Any]] = {}
    panels: dict[str, list[list[dict[str, Any]]]] = {}
    for name, problem in problems.items():
        for h in GRID_STEPS:
            panel = f'{name}, {h * 1e3:g} ms'
            progress(f'iterations and penalty, {panel}', len(rows) / (len(problems) * len(GRID_STEPS)))
            compute = partial(_grid, problem, h, iterations, penalties)
            rows[panel] = cells.cell(f'iterations_penalty/{panel}/{len(iterations)}', compute)
            panels[panel] = [[run for run in rows[panel]['runs'] if run['iterations'] == n] for n in iterations]
    report.text('## Iterations and penalty')
    table = []
    for panel, lines in panels.items():
        for n, line in zip(iterations, lines, strict=True):
            right = [run['penalty'] for run in line if run['judgement'] == RIGHT]
            other = sorted({CLASSES[_class(run)][1] for run in line if run['judgement'] != RIGHT})
            span = f'{min(right):g} to {max(right):g}' if right else 'none'
            holes = (
                f' ({len(right)} of {sum(min(right) <= run["penalty"] <= max(right) for run in line)})' if right else ''
            )
            table.append(
                {'problem': panel, 'iterations': n, 'right at penalties': span + holes, 'else': ', '.join(other) or '-'}
            )
    report.table('iterations_penalty', table)
    ordinates = {panel: [float(n) for n in iterations] for panel in panels}
    picture = _picture(panels, ordinates, list(penalties), 'penalty', 'iterations')
    report.figure(
        'iterations_penalty', picture, 'Iterations and penalty; numbers: exponent of the largest error [m or rad]'
    )
    return list(rows.values())


def _grid(problem: Any, h: float, iterations: Sequence[int], penalties: Sequence[float]) -> dict[str, Any]:
    return stability_maps.run_grid(problem(), h, iterations, penalties)


def _counted(report: Report, cells: Cells, quick: bool, progress: Progress) -> dict[str, Any]:
    """Singular passages, linkages of many loops, long runs."""
    p = stability_passages
    count = p.PHASES if quick else p.PASSAGES
    passages = []
    for h in p.PASSAGE_STEPS:
        progress(f'singular passages at {h * 1e3:g} ms', 0.0)
        passages.append(cells.cell(f'passages/{h}/{count}', partial(p.passages, h, count)))
    report.text(
        '## Singular passages',
        f'The slider-crank with equal rods from {p.PHASES} starting angles (seed of the series '
        f'{stability_passages.crank.SEED}), as often through its singular positions as the table says; the angle '
        'between rod and crank is -2 times that of the crank as long as it is on its branch.',
    )
    report.table(
        'passages',
        [
            {
                'step [ms]': row['h'] * 1e3,
                **{k: row[k] for k in ('passages', 'lost', 'wrong_branch', 'suspect', 'energy_error')},
            }
            for row in passages
        ],
    )
    report.check(
        'singular passages that were lost or left on a wrong branch',
        sum(r['lost'] + r['wrong_branch'] for r in passages),
        0,
    )
    report.check('singular passages', sum(r['passages'] for r in passages), len(passages) * count, least=True)
    loops = []
    for n in p.QUICK_LOOPS if quick else p.LOOPS:
        for iterations in p.LOOP_ITERATIONS:
            progress(f'{n} loops, {iterations} iterations', 0.3)
            loops.append(cells.cell(f'loops/{n}/{iterations}', partial(p.loops, n, iterations)))
    report.text(
        '## Linkages of many loops',
        f'`four_bar_n`, {p.LOOP_DURATION:g} s, {len(p.LOOP_STEPS)} steps from 1 to 20 ms in geometric progression; '
        'energy errors are over loops h^2 [J/s^2].',
    )
    rows = []
    for row in loops:
        ratios = [number(x) for x in row['ratios']]
        rows.append(
            {
                **{k: row[k] for k in ('loops', 'iterations', 'failed', 'suspect')},
                'median': float(np.nanmedian(ratios)),
                'largest': float(np.nanmax(ratios)),
            }
        )
    report.table('loops', rows)
    report.check('linkages that failed', sum(row['failed'] for row in loops), 0)
    report.check('largest energy error of a linkage over loops h^2', max(row['largest'] for row in rows), p.LOOP_LIMIT)
    worse = 0.0
    for fewer, more in ((3, 4), (3, 6), (4, 6)):
        for n in {row['loops'] for row in rows}:
            a, b = (next(r['largest'] for r in rows if (r['loops'], r['iterations']) == (n, k)) for k in (fewer, more))
            worse = max(worse, b / a)
    report.check('energy error with more iterations over that with fewer', worse, 2.0)
    long = []
    for name in p.LONG:
        steps = QUICK_LONG_STEPS if quick else LONG_STEPS
        progress(f'{steps:g} steps of {p.LONG[name]}', 0.6)
        long.append(cells.cell(f'long/{name}/{steps}', partial(p.long_run, name, steps)))
    report.text(
        '## Long runs',
        'Steps of 1 ms. Energy lost from start to end, of places and velocities; largest kinetic energy.',
    )
    table = [
        {
            **{k: row[k] for k in ('scene', 'steps', 'status')},
            'lost [J]': row['lost'],
            'kinetic [J]': row['kinetic'],
            'open [m or rad]': row['drift'],
        }
        for row in long
    ]
    report.table('long', table)
    silent = [row for row in long if row['status'] == 'ok' and abs(row['lost']) > 0.01 * row['kinetic']]
    report.check('long runs that lost more than 1 % of their energy and are ok', len(silent), 0)
    return {'passages': passages, 'loops': rows, 'long': long}


def _cars(report: Report, cells: Cells, quick: bool, progress: Progress) -> list[dict[str, Any]]:
    tasks = QUICK_CARS if quick else tuple(stability_cars.TASKS)
    cars = ('light',) if quick else tuple(stability_cars.CARS)
    found: list[dict[str, Any]] = []
    for car in cars:
        for name in tasks:
            progress(f'{car} car: {stability_cars.TASKS[name].title}', len(found) / (len(tasks) * len(cars)))
            found.append(cells.cell(f'car/{car}/{name}/{int(quick)}', partial(stability_cars.cell, car, name, quick)))
    report.text('## Cars')
    table = []
    for row in found:
        shown = {
            f'{run["h"] * 1e3:g} ms': (
                f'{CLASSES[_class(run)][1]} {"" if run["error"] is None else format(run["error"], ".1g")}'
            )
            for run in row['runs']
        }
        table.append(
            {
                'car': row['car'],
                'task': row['title'],
                **{f'{h * 1e3:g} ms': shown.get(f'{h * 1e3:g} ms', '-') for h in stability_cars.STEPS},
                'references differ by': number(row['spread']),
            }
        )
    report.table('cars', table)
    told = [
        f'- {row["car"]} car, {row["title"]}, {run["h"] * 1e3:g} ms: {run["text"]}'
        for row in found
        for run in row['runs']
        if run['text']
    ]
    if told:
        report.text('What they say:', '\n'.join(told))
    return found


def _picture(
    panels: dict[str, list[list[dict[str, Any]]]],
    ordinates: dict[str, list[float]],
    abscissae: list[float],
    abscissa: str,
    ordinate: str,
) -> Any:
    """Panels side by side: classes as colours, the exponent of the error in each cell."""
    width = 1.6 + 0.42 * len(abscissae) * len(panels) + 0.6 * len(panels)
    tallest = max(len(o) for o in ordinates.values())
    new, axes = figure(width, 1.5 + 0.27 * tallest, 1, len(panels))
    names = list(CLASSES)
    colours = ListedColormap([colour for colour, _ in CLASSES.values()])
    for ax, (title, lines) in zip(axes[0], panels.items(), strict=True):
        codes = np.array([[names.index(_class(run)) for run in line] for line in lines])
        ax.pcolormesh(codes, cmap=colours, vmin=-0.5, vmax=len(names) - 0.5, edgecolors='white', linewidth=0.8)
        for i, line in enumerate(lines):
            for k, run in enumerate(line):
                if run['error']:
                    dark = _class(run) == WRONG
                    ax.text(
                        k + 0.5,
                        i + 0.5,
                        f'{np.log10(run["error"]):.0f}',
                        ha='center',
                        va='center',
                        fontsize=6.5,
                        color='white' if dark else '#333333',
                    )
        ax.set_xticks(np.arange(len(abscissae)) + 0.5, [f'{x:g}' for x in abscissae], rotation=60, fontsize=7)
        ax.set_yticks(np.arange(len(lines)) + 0.5, [f'{y:g}' for y in ordinates[title]], fontsize=7)
        ax.grid(visible=False)
        ax.set_title(title, loc='left', fontsize=9)
        ax.set_xlabel(abscissa)
    axes[0, 0].set_ylabel(ordinate)
    new.legend(
        handles=[Patch(color=c, label=label) for c, label in CLASSES.values()],
        loc='outside lower center',
        ncols=len(CLASSES),
        fontsize=7,
        frameon=False,
    )
    return new
