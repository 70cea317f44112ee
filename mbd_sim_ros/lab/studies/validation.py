"""Every published figure this project is held against, beside ours at two steps, with the order in which ours
converge."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mbd_sim_ros.lab.studies import Progress, published_joints, published_mechanisms
from mbd_sim_ros.lab.studies.published import Judgement, PublishedProblem, Row, compare
from mbd_sim_ros.lab.studies.report import COLOURS, Report, cell, figure
from solver.errors import MbdError

SUMMARY = 'published figures of benchmarks and other codes beside ours at two steps'
SECOND = (1.8, 2.4)  # observed orders that a method of second order shows at these steps
QUICK = ('Revolute_Case02', 'Cylindrical_Case03', 'RotSpring_Case01', 'LinActuator_Case02', 'A01', 'kinematic_tree')


def study(out: Path, *, quick: bool, progress: Progress) -> dict:
    """Run every case at three steps and judge what ours converge to."""
    chosen = [c for c in (*published_mechanisms.cases(), *published_joints.cases()) if not quick or c.name in QUICK]
    report = Report(out, 'Published figures')
    found: list[tuple[PublishedProblem, list[Row], list[Judgement]]] = []
    failures = []
    for k, case in enumerate(chosen):
        progress(case.name, k / len(chosen))
        try:
            found.append((case, *compare(case)))
        except MbdError as error:
            failures.append({'case': case.name, 'outcome': str(error)})
    judged = [j for _, _, judgements in found for j in judgements]
    _introduce(report, found, judged)
    _summarise(report, found)
    if failures:
        report.text('## Cases that did not run')
        report.table('failures', failures)
    for j in judged:
        report.check(f'{j.case}, {j.quantity}: departure for small steps [{j.unit}]', j.limiting, j.limit)
    report.check('cases that did not run', len(failures), 0)
    _picture(report, found)
    _every_figure(report, found)
    report.write()
    return {'judgements': [j._asdict() for j in judged], 'failures': failures, 'checks': report.checks}


def _introduce(
    report: Report, found: Sequence[tuple[PublishedProblem, list[Row], list[Judgement]]], judged: Sequence[Judgement]
) -> None:
    orders = [j.order for j in judged if math.isfinite(j.order)]
    inside = [o for o in orders if SECOND[0] <= o <= SECOND[1]]
    figures = sum(len(rows) for _, rows, _ in found)
    within = sum(j.limiting <= j.limit for j in judged)
    report.text(
        f'{len(found)} cases, {figures} published values and vectors. Ours are runs with the default integrator at '
        f'the step h of the case, h/2 and h/4. "Small steps" is what the last two extrapolate to (second order). It '
        'is this that a published figure is compared with, and the limit of the departure is the accuracy of what is '
        'published: its last digit, or the error of the code it comes from where that is larger. The order is that of '
        'our own three runs, log2 of |y(h) - y(h/2)| over |y(h/2) - y(h/4)|; a dash where they do not depend on the '
        'step.',
        'How accurate published figures are is seen where one motion was computed several times: the heights of the '
        'pendulum of '
        f'{_names(published_joints.SAME)} differ by up to {published_joints.spread():.2g} m in the results of Adams.',
        f'{within} of {len(judged)} quantities are within their limits. {len(inside)} of {len(orders)} observed '
        f'orders lie between {SECOND[0]} and {SECOND[1]}; the median is {np.median(orders):.2f}.',
    )


def _names(names: Sequence[str]) -> str:
    return ', '.join(names[:-1]) + f' and {names[-1]}'


def _summarise(report: Report, found: Sequence[tuple[PublishedProblem, list[Row], list[Judgement]]]) -> None:
    report.text('## Cases', '\n'.join(f'- {case.name}: {case.text}. {case.source}.' for case, _, _ in found))
    report.text(
        '## What ours converge to',
        'Largest departures from the published figures over the instants and components of each quantity.',
    )
    rows = []
    for case, _, judgements in found:
        for j in judgements:
            rows.append(
                {
                    'case': j.case, 'quantity': f'{j.quantity} '
                        f'[{j.unit}]', 'largest published': j.size, 'h [ms]': 1e3 * case.h,
                    'at h': j.differences[0], 'at h/2': j.differences[1], 'small steps': j.limiting, 'limit': j.limit,
                    'order': _order(j.order), 'within': 'yes' if j.limiting <= j.limit else 'NO',
                }
            )  # fmt: skip
    report.table('judgements', rows)


def _order(order: float) -> str:
    return f'{order:.2f}' if math.isfinite(order) else '-'


def _every_figure(report: Report, found: Sequence[tuple[PublishedProblem, list[Row], list[Judgement]]]) -> None:
    report.text('## Every figure')
    for case, rows, _ in found:
        report.text(f'### {case.name}')
        report.table(
            f'figures_{case.name}',
            [
                {
                    'quantity': f'{r.figure.quantity} [{case.quantities[r.figure.quantity].unit}]', 't [s]': r.figure.t,
                    'published': ' '.join(r.figure.text), f'ours, {cell(1e3 * case.h)} ms': _numbers(r.ours[0]),
                    f'ours, {cell(500 * case.h)} ms': _numbers(r.ours[1]),
                }
                for r in rows
            ],
        )  # fmt: skip


def _numbers(values: np.ndarray) -> str:
    """Seven digits; what is nothing but rounding as 0."""
    return ' '.join('0' if abs(x) < 1e-12 else f'{x:#.7g}' for x in values)


def _picture(report: Report, found: Sequence[tuple[PublishedProblem, list[Row], list[Judgement]]]) -> None:
    new, axes = figure(10.0, 4.6)
    ax = axes[0, 0]
    names = [case.name for case, _, _ in found]
    for k, label in enumerate(('h', 'h/2', 'h/4')):
        worst = [max(j.differences[k] / max(j.size, 1e-300) for j in judged if j.size > 0.0) for _, _, judged in found]
        ax.semilogy(range(len(names)), worst, 'o', ms=5 - k, color=COLOURS[k], label=label)
    worst = [max(j.limiting / max(j.size, 1e-300) for j in judged if j.size > 0.0) for _, _, judged in found]
    ax.semilogy(range(len(names)), worst, 'x', ms=5, color='black', label='small steps')
    limits = [max(j.limit / max(j.size, 1e-300) for j in judged if j.size > 0.0) for _, _, judged in found]
    ax.semilogy(range(len(names)), limits, '_', ms=9, color=COLOURS[4], label='limit')
    ax.set_xticks(range(len(names)), names, rotation=90, fontsize=6)
    ax.set_ylabel('departure over largest published value')
    ax.legend(fontsize=7, ncols=5)
    report.figure(
        'departures',
        new,
        'Largest departure from the published figures of each case, relative to the largest number of its quantity',
    )
