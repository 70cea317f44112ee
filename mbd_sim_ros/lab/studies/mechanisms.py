"""Random mechanisms of all families with the default settings at five steps: does the default fail, or lie?"""

from __future__ import annotations

import warnings
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import LinAlgWarning

from mbd_sim_ros.lab.mechanisms.families import FAMILIES, drawn
from mbd_sim_ros.lab.mechanisms.judgement import (
    DURATION,
    RIGHT,
    SAMPLE,
    STEPS,
    TOLD,
    UNDECIDED,
    WORSE,
    WRONG,
    judge,
    refused,
)
from mbd_sim_ros.lab.studies import Progress
from mbd_sim_ros.lab.studies.cells import Cells, number
from mbd_sim_ros.lab.studies.neighbours import BEYOND, SILENT, silent
from mbd_sim_ros.lab.studies.report import COLOURS, Report, figure
from solver.errors import MbdError

SUMMARY = 'random mechanisms with the default settings at five steps, held against independent solutions'
DRAWS = True
SAMPLES, QUICK_SAMPLES = 1000, 28
RESOLVING = 1e-2  # m or rad: difference of two references up to which they resolve a motion
SHOWN = 20  # of the mechanisms that are not right


def study(out: Path, *, quick: bool, progress: Progress, n: int | None = None, seed: int = 0) -> dict:
    """Judge n mechanisms of the series of a seed; what is not right is written as a scene file into `scenes`."""
    count = n if n is not None else QUICK_SAMPLES if quick else SAMPLES
    rows = []
    cells = Cells(out / 'cells')
    with warnings.catch_warnings():
        # of references at singular positions, whose steps then fail
        warnings.filterwarnings('ignore', category=LinAlgWarning)
        for k in range(count):
            mechanism = drawn(k, seed)
            progress(f'{k} of {count}: {mechanism.family}', k / count)
            rows.append(cells.cell(mechanism.name, partial(_row, mechanism)))
            if rows[-1]['worst'] != RIGHT:
                (out / 'scenes').mkdir(exist_ok=True)
                (out / 'scenes' / f'{mechanism.name}.yaml').write_text(mechanism.text, encoding='utf-8')
    report = Report(out, 'Random mechanisms')
    runs = [run for row in rows for run in row['runs']]
    report.text(
        f'{count} mechanisms (seed {seed}) of {len(FAMILIES)} families, {DURATION:g} s each, at '
        f'{", ".join(f"{h * 1e3:g}" for h in STEPS)} ms with default settings. A run is right when its largest error, '
        f'looked at every {SAMPLE * 1e3:g} ms, is at most {WORSE:g} times what second order predicts from the other '
        f'steps (mbd_sim_ros.lab.mechanisms.judgement), told when it failed or is suspect, else silently wrong, or '
        'undecided where two references do not agree.'
    )
    table = []
    for family in FAMILIES:
        mine = [row for row in rows if row['family'] == family]
        judged = [run for row in mine for run in row['runs']]
        table.append(
            {
                'family': family,
                'mechanisms': len(mine),
                'runs': len(judged),
                **{name: sum(run['judgement'] == name for run in judged) for name in (RIGHT, TOLD, UNDECIDED, WRONG)},
                'failed': sum(run['status'] in ('error', 'refused') for run in judged),
                'largest error / allowed': max(
                    (run['error'] / run['allowed'] for run in judged if run['judgement'] == RIGHT and run['allowed']),
                    default=np.nan,
                ),
            }
        )
    report.text('## By family')
    report.table('families', table)
    report.text('## By step')
    report.table(
        'steps',
        [
            {
                'step [ms]': h * 1e3,
                **{
                    name: sum(run['judgement'] == name for run in runs if run['h'] == h)
                    for name in (RIGHT, TOLD, UNDECIDED, WRONG)
                },
                'failed': sum(run['status'] in ('error', 'refused') for run in runs if run['h'] == h),
                'median error': float(
                    np.nanmedian([number(run['error']) for run in runs if run['h'] == h and run['status'] == 'ok'])
                ),
            }
            for h in STEPS
        ],
    )
    unclear = [(row, run) for row in rows for run in row['runs'] if run['judgement'] != RIGHT]
    if unclear:
        report.text(f'## What was not right (the first {SHOWN} of {len(unclear)} runs)')
        report.table('not_right', [_line(row, run) for row, run in unclear], shown=False)
        report.text('\n'.join(f'- {_sentence(row, run)}' for row, run in unclear[:SHOWN]))
    report.figure(
        'errors', _picture(rows), 'Error of every run over what its step does not see of the motion; lines: their ratio'
    )
    failed = sum(
        run['status'] in ('error', 'refused') and number(row['spread']) < RESOLVING
        for row in rows
        for run in row['runs']
    )
    wrong, beyond = silent(rows)
    report.check(SILENT, wrong, 0)
    report.check(BEYOND, beyond, 0)
    report.check('failures where the reference resolves the motion', failed, 0)
    report.write()
    return {'n': count, 'seed': seed, 'families': table, 'checks': report.checks}


def _row(mechanism: Any) -> dict[str, Any]:
    try:
        judged = judge(mechanism)
    except MbdError as error:
        judged = refused(mechanism, str(error))
    return {'family': mechanism.family, 'worst': judged.worst, **judged.report()}


def _line(row: dict[str, Any], run: dict[str, Any]) -> dict[str, Any]:
    return {'mechanism': row['name'], 'spread': row['spread'], **run}


def _sentence(row: dict[str, Any], run: dict[str, Any]) -> str:
    error = '' if run['error'] is None else f', error {run["error"]:.2g}, allowed {number(run["allowed"]):.2g}'
    why = f': {run["text"]}' if run['text'] else ''
    return f'{row["name"]} at {run["h"] * 1e3:g} ms: {run["judgement"]} ({run["status"]}{error}){why}'


def _picture(rows: list[dict[str, Any]]) -> Any:
    new, axes = figure(9.0, 4.2, 1, 2, sharey=True)
    for ax, judgements, title in zip(
        axes[0], ((RIGHT,), (TOLD, UNDECIDED, WRONG)), ('right', 'not right, as far as they arrived'), strict=True
    ):
        for k, h in enumerate(STEPS):
            points = [
                (number(run['unseen']), number(run['error'])) for row in rows for run in row['runs']
                if run['h'] == h and run['judgement'] in judgements and run['error']
            ]  # fmt: skip
            if points:
                ax.loglog(*np.array(points).T, '.', ms=3, color=COLOURS[k], label=f'{h * 1e3:g} ms')
        ends = np.array([1e-9, 1e0])
        for ratio in (1e-3, 1.0, 1e3):
            ax.loglog(ends, ratio * ends, lw=0.7, color='#999999')
        ax.set_xlim(1e-9, 1e1)
        ax.set_ylim(1e-13, 1e1)
        ax.set_xlabel('not seen by the step [m or rad]')
        ax.set_title(title, loc='left', fontsize=9)
        if ax.get_legend_handles_labels()[0]:
            ax.legend(fontsize=7, frameon=False, loc='lower right')
    axes[0, 0].set_ylabel('largest error [m or rad]')
    return new
