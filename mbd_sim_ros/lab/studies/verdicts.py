"""Mixtures of everything at five steps, judged as `mbd run` judges them, held against a reference in maximal
coordinates.

Verdict against truth: how many ok runs are wrong, how many suspect ones right, and how far the stated error is from the
true one.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mbd_sim_ros.batch import simulate
from mbd_sim_ros.lab.mechanisms.maximal import CHANGE, LOOSE, TIGHT, Motion, difference, motion
from mbd_sim_ros.lab.mechanisms.mixture_draft import DURATION
from mbd_sim_ros.lab.mechanisms.mixtures import PARTS, Mixture, mixture
from mbd_sim_ros.lab.studies import Progress
from mbd_sim_ros.lab.studies.cells import Cells, number
from mbd_sim_ros.lab.studies.report import COLOURS, Report, figure
from solver.errors import MbdError
from solver.files.scene import load_scene_text
from solver.simulation import Simulation

SUMMARY = 'random mixtures at five steps: verdicts and stated errors against a reference that shares no code'
DRAWS = True
SAMPLES, QUICK_SAMPLES = 250, 3
STEPS = (10e-3, 5e-3, 2e-3, 1e-3, 0.5e-3)  # s
SAMPLE = 0.01  # s between two comparisons
WRONG, RIGHT = 0.05, 0.01  # of the range of motion or the turn: errors of a run that is wrong, and of one that is right
AGREED = 0.001  # of the same: a tenth of RIGHT, up to which solutions of the reference agree where there is one
CALM = 1e3  # growth of a change of the start within the run, above which a motion counts as chaotic
OTHER, OTHER_STEPS = 1e4, (5e-3, 1e-3)  # penalty and steps of the runs beside the default ones
STATED = ('position', 'orientation')  # quantities of the stated error that are compared here
KINDS = ('maximal.py', 'maximal_reader.py', 'maximal_rows.py', 'maximal_forces.py', 'mixtures.py', 'mixture_draft.py')
REFERENCE = tuple(f'mbd_sim_ros/lab/mechanisms/{name}' for name in KINDS)


def study(out: Path, *, quick: bool, progress: Progress, n: int | None = None, seed: int = 0) -> dict:
    """Judge n mixtures of the series of a seed; scenes of wrong verdicts are written into `scenes`."""
    count = n if n is not None else QUICK_SAMPLES if quick else SAMPLES
    references = Cells(out / 'references', base=REFERENCE)  # which do not depend on the solver
    cells = Cells(out / 'cells', more=('mbd_sim_ros/batch.py', 'mbd_sim_ros/lab/studies/verdicts.py'))
    rows: list[dict[str, Any]] = []
    for k in range(count):
        drawn = mixture(k, seed)
        progress(f'{k} of {count}: {drawn.name} ({", ".join(drawn.parts)}), reference', k / count)
        truth = references.cell(drawn.name, partial(reference, drawn))
        progress(f'{k} of {count}: {drawn.name}, runs', (k + 0.5) / count)
        rows.append(cells.cell(drawn.name, partial(judged, drawn, truth)))
        if any(of_run(run) for run in rows[-1]['runs']):
            (out / 'scenes').mkdir(exist_ok=True)
            (out / 'scenes' / f'{drawn.name}.yaml').write_text(drawn.text, encoding='utf-8')
    return _report(out, rows, count, seed)


def reference(drawn: Mixture) -> dict[str, Any]:
    """The motion of a mixture by the reference, as numbers."""
    found = motion(drawn.text, DURATION, SAMPLE)
    return {**vars(found), **{key: getattr(found, key).tolist() for key in ('times', 'p', 'q', 'com')}}


def judged(drawn: Mixture, truth: dict[str, Any]) -> dict[str, Any]:
    """All runs of a mixture, with the errors that they state and those that they have."""
    arrays = {key: np.array(truth[key]) for key in ('times', 'p', 'q', 'com')}
    known = Motion(**{**{key: truth[key] for key in Motion.__dataclass_fields__}, **arrays})
    spread, growth = number(truth['spread']), number(truth['growth'])
    exists = bool(spread <= AGREED and growth * CHANGE <= AGREED)
    row = {'parts': list(drawn.parts), 'reference': exists, 'calm': exists and growth <= CALM, 'text': known.text}
    runs = [run(drawn, known if exists else None, h) for h in STEPS]
    others = [run(drawn, known if exists else None, h, OTHER) for h in OTHER_STEPS]
    return {
        'name': drawn.name,
        **row,
        'spread': spread,
        'growth': growth,
        'lowest': known.lowest,
        'runs': runs,
        'others': others,
    }


def run(drawn: Mixture, known: Motion | None, h: float, penalty: float | None = None) -> dict[str, Any]:
    """A run through the public door, and once more with its motion looked at."""
    row: dict[str, Any] = {'h': h, 'error': None, 'stated': None, 'bound': False, 'findings': [], 'text': ''}
    steps, every = round(DURATION / h), round(SAMPLE / h)
    try:
        simulation = Simulation(load_scene_text(drawn.scene(h, penalty), drawn.name))
    except MbdError as error:
        return {**row, 'status': 'refused', 'text': str(error)}
    try:
        figures = simulate(simulation, steps, error=True)
    except MbdError as error:
        return {**row, 'status': 'error', 'text': str(error)}
    row |= {'status': figures['status'], 'findings': [found['quantity'] for found in figures['findings']]}
    row['explaining'] = [found['quantity'] for found in figures['explaining']]
    stated = {name: error for name, error in figures['errors'].items() if name in STATED}
    if stated:
        row |= {'stated': max(e['share'] for e in stated.values()), 'bound': any(e['bound'] for e in stated.values())}
    if known is not None:
        simulation.reset()
        shown = [simulation.snapshot().pose]
        shown += [simulation.advance(every).pose for _ in range(steps // every)]
        row['error'] = error_of(np.array(shown), known)
    return row


def error_of(pose: np.ndarray, known: Motion) -> float:
    """The largest error of a place over the range of motion, or of an orientation over the turn. pose: (times, nb,
    7)."""
    q = pose[:, :, 3:]
    arms = np.array([Rotation.from_quat(q[:, b]).apply(com) for b, com in enumerate(known.com)]).swapaxes(0, 1)
    return difference(known.p, known.q, pose[:, :, :3] + arms, q, known.range, known.turn)


def of_run(row: dict[str, Any]) -> str:
    """The fault of a verdict: '' where there is none."""
    if row['status'] == 'ok' and number(row['error']) > WRONG:
        return 'ok, but wrong'
    if row['status'] == 'suspect' and number(row['error']) < RIGHT:
        return 'suspect, but right'
    return row['status'] if row['status'] in ('error', 'refused') else ''


def line(name: Any, runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Counts of some runs, as a line of a table."""
    held = [one for one in runs if one['error'] is not None]
    ok, suspect = ([one for one in held if one['status'] == status] for status in ('ok', 'suspect'))
    return {
        'of': name,
        'runs': len(runs),
        'no reference': sum(one['error'] is None and one['status'] in ('ok', 'suspect') for one in runs),
        'failed or refused': sum(one['status'] in ('error', 'refused') for one in runs),
        'ok': len(ok),
        f'off by more than {WRONG:.0%}': sum(one['error'] > WRONG for one in ok),
        'suspect': len(suspect),
        f'within {RIGHT:.0%}': sum(one['error'] < RIGHT for one in suspect),
        'median error of ok': float(np.median([one['error'] for one in ok])) if ok else None,
    }


def _report(out: Path, rows: list[dict[str, Any]], count: int, seed: int) -> dict:
    report = Report(out, 'Verdicts against a reference')
    runs = [one for row in rows for one in row['runs']]
    exist, calm = (sum(row[key] for row in rows) for key in ('reference', 'calm'))
    report.text(
        f'{count} mixtures (series {seed}) of {len(set(PARTS))} parts, {DURATION:g} s each, at '
        f'{", ".join(f"{h * 1e3:g}" for h in STEPS)} ms with default settings, judged as `mbd run` does. The error is '
        f'the largest, of any body every {SAMPLE * 1e3:g} ms: of the place of its centre of mass, over the farthest '
        f'that one gets from where it began, or of its orientation, over the farthest that one turns from its first '
        f'orientation. A reference exists where its solutions with tolerances of {TIGHT:g} and {LOOSE:g} and one from '
        f'a start that is changed by {CHANGE:g} agree within {AGREED:g} of that: for {exist} mixtures; {calm} of them '
        f'multiply a change of the start by at most {CALM:g} within the run.'
    )
    total = line('all', runs)
    table = [line(f'{h * 1e3:g} ms', [one for one in runs if one['h'] == h]) for h in STEPS]
    report.text('## By step')
    report.table('steps', [*table, total])
    report.text('## By part')
    report.table(
        'parts',
        [line(part, [one for row in rows if part in row['parts'] for one in row['runs']]) for part in _parts()],
        shown=True,
    )
    ratios = _stated(report, rows)
    changed = _penalties(report, rows)
    told = [(row, one) for row in rows for one in row['runs'] if of_run(one)]
    if told:
        report.text('## Verdicts that are wrong, and failures')
        listed = [
            {'mixture': row['name'], 'parts': ' '.join(row['parts']), 'growth': row['growth'], **_flat(one)}
            for row, one in told
        ]
        report.table('wrong_verdicts', listed)
    report.figure(
        'errors', _picture(rows), 'True error of every run by step and verdict; stated error over the true one'
    )
    wrong, right = total[f'off by more than {WRONG:.0%}'], total[f'within {RIGHT:.0%}']
    report.check(f'part of the ok runs off by more than {WRONG:.0%}', wrong / max(total['ok'], 1), 0.005)
    report.check(f'part of the suspect runs within {RIGHT:.0%}', right / max(total['suspect'], 1), 0.05)
    if len(ratios):
        report.check(
            'part of the stated errors within half and twice the true one',
            float(np.mean(np.abs(np.log2(ratios)) <= 1)),
            0.9,
            least=True,
        )
    report.write()
    return {'n': count, 'seed': seed, 'steps': [*table, total], 'penalties': changed, 'checks': report.checks}


def _parts() -> list[str]:
    return list(dict.fromkeys(part.__name__ for part in PARTS))


def _flat(one: dict[str, Any]) -> dict[str, Any]:
    keys = ('status', 'error', 'stated')
    return {
        'h [ms]': one['h'] * 1e3,
        'fault': of_run(one),
        **{k: one[k] for k in keys},
        'findings': ' '.join(one['findings']),
        'text': one['text'],
    }


def ratios_of(rows: Sequence[dict[str, Any]]) -> np.ndarray:
    """Stated over true errors, of runs of calm motions that state one which is not a bound only."""
    return np.array(
        [
            one['stated'] / one['error']
            for row in rows if row['calm']
            for one in row['runs']
            if one['stated'] and one['error'] and not one['bound'] and one['error'] > 10.0 * row['spread']
        ]
    )  # fmt: skip


def _stated(report: Report, rows: list[dict[str, Any]]) -> np.ndarray:
    """The table of stated errors, and their ratios to the true ones."""
    ratios = ratios_of(rows)
    report.text('## Stated errors')
    if not len(ratios):
        report.text('No run stated its error.')
        return ratios
    table = []
    for h in (*STEPS, None):
        some = [{**row, 'runs': [one for one in row['runs'] if h in (None, one['h'])]} for row in rows]
        part = ratios_of(some)
        quantiles = np.quantile(part, (0.05, 0.5, 0.95)) if len(part) else np.full(3, np.nan)
        table.append(
            {
                'of': 'all' if h is None else f'{h * 1e3:g} ms',
                'runs': len(part),
                'within half and twice': float(np.mean(np.abs(np.log2(part)) <= 1.0)) if len(part) else None,
                **{
                    f'{name} of stated / true': float(q)
                    for name, q in zip(('5 %', 'median', '95 %'), quantiles, strict=True)
                },
            }
        )
    report.table('stated', table)
    return ratios


def _penalties(report: Report, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Default penalty and another one on the same mixtures."""
    table = []
    for h in OTHER_STEPS:
        pairs = [
            (next(one for one in row['runs'] if one['h'] == h), next(one for one in row['others'] if one['h'] == h))
            for row in rows
        ]
        held = [(a, b) for a, b in pairs if a['error'] and b['error'] and a['status'] == b['status'] == 'ok']
        ratios = np.array([b['error'] / a['error'] for a, b in held])
        table.append(
            {
                'h [ms]': h * 1e3,
                'runs': len(pairs),
                'other verdicts': sum(a['status'] != b['status'] for a, b in pairs),
                'both ok': len(held),
                'error changed by more than a tenth': int(np.sum(np.abs(ratios - 1.0) > 0.1)),
                'doubled': int(np.sum(ratios > 2.0)),
                'halved': int(np.sum(ratios < 0.5)),
            }
        )
    report.text(f'## Penalty {OTHER:g} instead of the default')
    report.table('penalties', table)
    return table


def _picture(rows: list[dict[str, Any]]) -> Any:
    new, axes = figure(9.0, 4.2, 1, 2)
    for k, status in enumerate(('ok', 'suspect')):
        points = [
            (one['h'] * 1e3, number(one['error']))
            for row in rows
            for one in row['runs']
            if one['status'] == status and one['error']
        ]
        if points:
            x, y = np.array(points).T
            axes[0, 0].loglog(x * (0.93 + 0.14 * k), y, '.', ms=3, color=COLOURS[k], label=status)
    for limit in (RIGHT, WRONG):
        axes[0, 0].axhline(limit, lw=0.7, color='#999999')
    axes[0, 0].set_xlabel('step [ms]')
    axes[0, 0].set_ylabel('error / range of motion or turn')
    axes[0, 0].legend(fontsize=7, frameon=False)
    points = [
        (number(one['error']), one['stated'])
        for row in rows
        if row['calm']
        for one in row['runs']
        if one['stated'] and one['error']
    ]
    if points:
        axes[0, 1].loglog(*np.array(points).T, '.', ms=3, color=COLOURS[0])
    ends = np.array([1e-9, 1e1])
    for ratio in (0.5, 1.0, 2.0):
        axes[0, 1].loglog(ends, ratio * ends, lw=0.7, color='#999999')
    axes[0, 1].set_xlabel('true error')
    axes[0, 1].set_ylabel('stated error')
    return new
