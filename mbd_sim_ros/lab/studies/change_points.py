"""Linkages through change points with four penalties and hundreds of steps: which penalty keeps to the trend of the
step?"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mbd_sim_ros.batch import simulate
from mbd_sim_ros.lab.mechanisms.change_points import Linkage, linkages
from mbd_sim_ros.lab.studies import Progress
from mbd_sim_ros.lab.studies.cells import Cells, number
from mbd_sim_ros.lab.studies.report import COLOURS, Report, figure
from solver.errors import MbdError
from solver.files.scene import load_scene_text
from solver.simulation import Simulation

SUMMARY = 'linkages through change points at many steps and four penalties, held against exact motions'
DRAWS = True
SAMPLES, QUICK_SAMPLES = 400, 3  # steps between SHORTEST and LONGEST, in equal ratios
SHORTEST, LONGEST = 1e-3, 8e-3  # s
PENALTIES = (1e6, 1e5, 1e4, 1e3)
DEFAULT = PENALTIES[0]
# times the trend: an error that the step does not explain; of ten times as much the cause is a wrong branch
BEYOND = 10.0
OK = 'ok'


def study(out: Path, *, quick: bool, progress: Progress, n: int | None = None, seed: int = 0) -> dict:
    """n steps for every linkage and penalty. A seed other than 0 moves the steps by a part of their distance."""
    count = n if n is not None else QUICK_SAMPLES if quick else SAMPLES
    shift = np.random.default_rng(seed).uniform() if seed else 0.0
    steps = SHORTEST * (LONGEST / SHORTEST) ** ((np.arange(count) + shift) / max(count - 1 + shift, 1))
    cells = Cells(out / 'cells', more=('mbd_sim_ros/batch.py', 'mbd_sim_ros/lab/studies/change_points.py'))
    known = linkages()
    rows: list[dict[str, Any]] = []
    for k, linkage in enumerate(known):
        for j, penalty in enumerate(PENALTIES):
            for i, h in enumerate(steps):
                done = (k * len(PENALTIES) + j + i / count) / (len(known) * len(PENALTIES))
                progress(f'{linkage.name}, penalty {penalty:g}, {h * 1e3:.3g} ms', done)
                cell = f'{linkage.name} {penalty:g} {round(h * 1e9)}'
                rows.append(cells.cell(cell, partial(passage, linkage, penalty, round(h * 1e9) * 1e-9)))
    return _report(out, rows, count, seed)


def passage(linkage: Linkage, penalty: float, h: float) -> dict[str, Any]:
    """A run through the public door: its status, and the error of the tip at the end [m]."""
    steps = round(linkage.duration / h)
    row = {'linkage': linkage.name, 'penalty': penalty, 'h': h, 'error': None}
    try:
        simulation = Simulation(load_scene_text(linkage.text(h, steps, penalty), linkage.name))
        status = simulate(simulation, steps, error=True)['status']
    except MbdError as error:
        return {**row, 'status': 'failed', 'text': str(error)}
    pose = simulation.snapshot().pose[simulation.channels.bodies.index(linkage.tip[0])]
    place = pose[:3] + Rotation.from_quat(pose[3:]).apply(linkage.tip[1])
    return {**row, 'status': status, 'text': '', 'error': float(np.linalg.norm(place - linkage.at(steps * h)))}


def trend(rows: list[dict[str, Any]]) -> float:
    """Second order: the median of error / h^2 of ok runs [m/s^2]; nan where there are none."""
    ratios = [row['error'] / row['h'] ** 2 for row in rows if row['status'] == OK]
    return float(np.median(ratios)) if ratios else np.nan


def outliers(rows: list[dict[str, Any]], slope: float) -> list[dict[str, Any]]:
    """The runs with an error above BEYOND times the trend, whatever their verdict."""
    return [row for row in rows if number(row['error']) > BEYOND * slope * row['h'] ** 2]


def _report(out: Path, rows: list[dict[str, Any]], count: int, seed: int) -> dict:
    report = Report(out, 'Change points and penalties')
    report.text(
        f'{count} steps from {SHORTEST * 1e3:g} to {LONGEST * 1e3:g} ms (series {seed}) for every linkage and '
        f'penalty. The error is that of a point of the crank at the end, against the exact motion. The trend is the '
        f'median of error / h^2 of all ok runs of the linkage; a run is an outlier when its error is above {BEYOND:g} '
        f'times the trend.'
    )
    table, silent = [], dict.fromkeys(PENALTIES, 0)
    for name in dict.fromkeys(row['linkage'] for row in rows):
        mine = [row for row in rows if row['linkage'] == name]
        slope = trend(mine)
        for penalty in PENALTIES:
            runs = [row for row in mine if row['penalty'] == penalty]
            found = outliers(runs, slope)
            ok = [row for row in found if row['status'] == OK]
            silent[penalty] += len(ok)
            worst = max(found, key=lambda row: row['error'] / row['h'] ** 2, default=None)
            table.append(
                {
                    'linkage': name,
                    'penalty': f'{penalty:g}',
                    'trend at 1 ms [m]': slope * 1e-6,
                    'ok': sum(row['status'] == OK for row in runs),
                    'suspect': sum(row['status'] == 'suspect' for row in runs),
                    'failed': sum(row['status'] == 'failed' for row in runs),
                    'outliers': len(found),
                    'ok outliers': len(ok),
                    'worst / trend': None if worst is None else worst['error'] / (slope * worst['h'] ** 2),
                    'its error [m]': None if worst is None else worst['error'],
                    'its step [ms]': None if worst is None else worst['h'] * 1e3,
                }
            )
    report.table('passages', table)
    report.table('runs', rows, shown=False)
    report.figure(
        'errors', _picture(rows), 'Error at the end over the step, of ok runs; lines: the trend and ten times the trend'
    )
    for penalty in PENALTIES:
        report.check(f'ok runs above {BEYOND:g} times the trend, penalty {penalty:g}', silent[penalty], 0)
    report.write()
    return {'n': count, 'seed': seed, 'passages': table, 'checks': report.checks}


def _picture(rows: list[dict[str, Any]]) -> Any:
    names = list(dict.fromkeys(row['linkage'] for row in rows))
    new, axes = figure(9.0, 2.2 * len(names), len(names), 2, sharex=True)
    for line, name in zip(axes, names, strict=True):
        mine = [row for row in rows if row['linkage'] == name]
        slope, ends = trend(mine), np.array([SHORTEST, LONGEST])
        for ax, penalties in zip(line, (PENALTIES[:1], PENALTIES[1:]), strict=True):
            for k, penalty in enumerate(penalties):
                points = [
                    (row['h'] * 1e3, row['error'])
                    for row in mine
                    if row['penalty'] == penalty and row['status'] == OK and row['error']
                ]
                if points:
                    ax.loglog(*np.array(points).T, '.', ms=2, color=COLOURS[k], label=f'{penalty:g}')
            for factor in (1.0, BEYOND):
                ax.loglog(ends * 1e3, factor * slope * ends**2, lw=0.7, color='#999999')
            ax.set_title(name, loc='left', fontsize=9)
        line[0].set_ylabel('error [m]')
    for ax in axes[0]:
        if ax.get_legend_handles_labels()[0]:
            ax.legend(fontsize=7, frameon=False)
    for ax in axes[-1]:
        ax.set_xlabel('step [ms]')
    return new
