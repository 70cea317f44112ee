"""Tables and pictures of the study of speed against accuracy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mbd_sim_ros.lab.studies.report import COLOURS, Report, figure
from solver.analysis.departures import Departure
from solver.scene import Scene
from solver.trade.errors import ORIGINS
from solver.trade.reference import Reference
from solver.units import shown

LEVEL_COLOURS = dict(zip(('full', 'condensed', 'kc', 'single_track'), COLOURS, strict=False))
PICTURES = 4  # quantities
AGREE = 0.002  # of the peak: what the two formulations may differ by
Row = dict[str, Any]


def write(
    report: Report,
    scene: Scene,
    truth: Reference,
    second: dict[str, Departure],
    levels: dict[str, str],
    rows: list[Row],
) -> dict[str, Any]:
    """The whole report; returns what --json gives. second: how far another formulation is. levels: why one is not
    there, or ''. The cost of the first row is what others are related to."""
    names = list(truth.quantities)
    good = [row for row in rows if not row['failure']]
    steps = ', '.join(f'{1e3 * h:g}' for h in truth.steps)
    report.text(
        f'Scene `{scene.name}`, {scene.duration:g} s. Every setting is compared with the converged full vehicle, the '
        f'Richardson limit of steps of {steps} ms. Errors are RMS in % of the peak of each quantity; the parts of the '
        f'model, of the step and of the iteration are measured one by one and may cancel in the whole. Cost is CPU '
        'time of one core per simulated second, one setting at a time.'
    )
    report.text('## Reference')
    report.table(
        'reference',
        [
            {
                'quantity': name, 'peak': shown(truth.peaks[name], q.unit), 'band '
                    '[%]': 100 * truth.band[name].share('rms'),
                'second formulation [%]': 100 * second[name].share('rms'),
            }
            for name, q in truth.quantities.items()
        ],
    )  # fmt: skip
    for name in truth.quantities:
        report.check(f'{name}: both formulations agree, share of the peak', second[name].share('rms'), AGREE)
    out = {level: why for level, why in levels.items() if why}
    if out:
        report.text('Levels that are not there:', '\n'.join(f'- {level}: {why}' for level, why in out.items()))
    front = sorted((row for row in rows if row['front']), key=lambda row: row['cost_median'])
    report.text('## The front', 'No other setting is both cheaper and more accurate, by the worst of all quantities:')
    if front:
        report.table('front', [_summary(row, names, rows[0]) for row in front])
    report.text('## All settings')
    report.table('settings', [_summary(row, names, rows[0]) for row in rows])
    report.table('errors', _long(rows), shown=False)
    failed = [row for row in rows if row['failure']]
    if failed:
        report.text('Failed:', '\n'.join(f'- {row["setting"]}: {row["failure"]}' for row in failed))
    if good:
        _costs(report, names, good)
        _steps(report, names, good)
    if front:
        _origins(report, names, front)
    report.write()
    return {
        'duration': scene.duration,
        'rows': rows,
        'levels': levels,
        'front': [row['setting'] for row in front],
        'checks': report.checks,
    }


def _summary(row: Row, names: list[str], first: Row) -> dict[str, Any]:
    errors = row['errors']
    counters = row.get('counters') or {}
    found = {'setting': row['setting'], 'front': 'yes' if row['front'] else ''}
    found |= {
        f'{name} [%]': 100 * errors[name]['rms_share'] if _has(errors, name) else math.nan
        for name in names
        if name != 'position'
    }
    if 'position' in names:
        found['position, max [m]'] = errors['position']['max'] if _has(errors, 'position') else math.nan
    found['CPU, median [ms/s]'] = 1e3 * row.get('cost_median', math.nan)
    found['CPU, p99 [ms/s]'] = 1e3 * row.get('cost_p99', math.nan)
    found['of full at 1 ms'] = row.get('cost_median', math.nan) / first.get('cost_median', math.nan)
    found['evaluations per step'] = counters.get('evaluations', math.nan)
    found['factorizations per step'] = counters.get('factorizations', math.nan)
    return found


def _has(errors: dict[str, Any], name: str) -> bool:
    return name in errors and errors[name]['rms_share'] is not None


def _long(rows: list[Row]) -> list[dict[str, Any]]:
    found = [
        {'setting': row['setting'], 'quantity': name, **errors}
        for row in rows
        for name, errors in row['errors'].items()
    ]
    return found or [{'setting': '', 'quantity': ''}]


def _points(rows: list[Row], name: str) -> list[tuple[float, float]]:
    """(CPU per simulated second [ms], RMS error [% of the peak]) of rows that have both, cheapest first."""
    some = [row for row in rows if _has(row['errors'], name) and 'cost_median' in row]
    return sorted((1e3 * row['cost_median'], max(100 * row['errors'][name]['rms_share'], 1e-5)) for row in some)


def _costs(report: Report, names: list[str], rows: list[Row]) -> None:
    names = [n for n in names if any(_has(row['errors'], n) for row in rows)][:PICTURES]
    picture, axes = figure(9.6, 4.0 * math.ceil(len(names) / 2), math.ceil(len(names) / 2), 2)
    for ax, name in zip(axes.ravel(), names, strict=False):
        for level, colour in LEVEL_COLOURS.items():
            for off in (False, True):
                points = _points([r for r in rows if r['level'] == level and bool(r['off']) == off], name)
                if points:
                    label = f'{level}, a subsystem off' if off else level
                    ax.scatter(*np.array(points).T, marker='x' if off else 'o', s=22, color=colour, label=label)
        points = _points(rows, name)
        front = [(x, y) for k, (x, y) in enumerate(points) if all(y < before for _, before in points[:k])]
        ax.step(*np.array(front).T, where='post', color='black', lw=1.0, label='front')
        ax.set_axisbelow(True)
        ax.set(xscale='log', yscale='log', xlabel='CPU per simulated second [ms]', ylabel='RMS error [% of the peak]')
        ax.set_title(name, loc='left', fontsize=10)
    for ax in axes.ravel()[len(names) :]:
        ax.set_visible(False)
    handles, labels = axes[0, 0].get_legend_handles_labels()  # below all: among the points it hides some
    picture.legend(handles, labels, fontsize=7, loc='outside lower center', ncols=5, frameon=False)
    report.figure('cost', picture, 'Error against cost, every setting; the line joins those that nothing beats')


def _steps(report: Report, names: list[str], rows: list[Row]) -> None:
    """Error over the step, of the quantity that is worst at the smallest."""
    name = next((n for n in ('sideslip_velocity', *names) if n in names), names[0])
    picture, axes = figure(8.0, 4.2)
    ax = axes[0, 0]
    for level, colour in LEVEL_COLOURS.items():
        for iterations, style in ((1, ':'), (2, '--'), (3, '-')):
            some = [
                r
                for r in rows
                if r['level'] == level and not r['off'] and r['iterations'] == iterations and r['rho_inf'] == 0.8
            ]
            points = sorted(
                {(1e3 * r['h'], 100 * r['errors'][name]['rms_share']) for r in some if _has(r['errors'], name)}
            )
            if points:
                ax.plot(*np.array(points).T, style, marker='.', color=colour, label=f'{level}, {iterations}')
    ax.set(xscale='log', yscale='log', xlabel='step [ms]', ylabel=f'RMS error of {name} [% of the peak]')
    steps = sorted({1e3 * row['h'] for row in rows})
    ax.set_xticks(steps, [f'{h:g}' for h in steps])
    ax.minorticks_off()
    beside = {'loc': 'upper left', 'bbox_to_anchor': (1.01, 1.0), 'frameon': False}  # on the curves it hides their ends
    ax.legend(fontsize=7, title='level, iterations', title_fontsize=7, handlelength=3.5, **beside)
    report.figure(
        'steps',
        picture,
        'Error over the step with one, two and three iterations; it levels off at the error of the model',
    )


def _origins(report: Report, names: list[str], front: list[Row]) -> None:
    name = next((n for n in ('yaw_rate', *names) if n in names), names[0])
    some = [row for row in front if _has(row['errors'], name)]
    if not some:
        return
    picture, axes = figure(9.0, 1.2 + 0.32 * len(some))
    ax = axes[0, 0]
    heights = np.arange(len(some))
    for k, (origin, colour) in enumerate(zip(ORIGINS[:3], COLOURS, strict=False)):
        values = [max(100 * (row['errors'][name][f'{origin}_share'] or 0.0), 1e-6) for row in some]
        ax.barh(heights + 0.26 * (k - 1), values, height=0.26, color=colour, label=origin)
    ax.set_yticks(heights, [row['setting'] for row in some], fontsize=7)
    ax.margins(y=0.01)
    ax.invert_yaxis()
    ax.set_axisbelow(True)
    ax.set(xscale='log', xlabel=f'RMS error of {name} by origin [% of the peak]')
    ax.legend(fontsize=8)
    report.figure('origins', picture, 'Where the errors of the settings on the front come from')
