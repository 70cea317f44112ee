"""Report of work-precision runs: pictures, and the methods on the front at each accuracy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_sim_ros.lab.studies.report import COLOURS, Report, figure

ACCURACIES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
ENGINEERING = 1e-5  # what ours are made for ends here; what is finer is shown, and not required
FLOOR = 100.0  # times the smallest error of a method, from where on rounding may show
COSTS = {'cpu': 'CPU time [s]', 'factorizations': 'factorizations', 'evaluations': 'evaluations'}
OURS = ('ALF', 'M-ALF')
# on open chains: what it does not have to solve no method with constraints can make up for
WITHOUT_CONSTRAINTS = 'MuJoCo'
INTRODUCTION = (
    'Error: largest deviation of one coordinate (slider position or crank angle, change since the start) at '
    'equidistant instants from the reference. CPU time: of stepping alone, start and compilation left out, on one '
    'core; the shortest of several runs for ours and Exudyn. BDF, Radau and IDA integrate the same compiled model in '
    'the stabilised index-2 form (GGL), but with dense matrices put together in Python: their CPU time is that of '
    'this coupling and says little about the methods; their counters do.',
    'Exudyn integrates a planar model without redundant constraints (its best case; ours is the spatial one with all '
    'redundancies) by generalized-alpha, rho 0.9, Newton tolerance 1e-8 and, "loose", 1e-4. Evaluations of Exudyn are '
    'its Newton iterations. M-ALF has the penalty that is, on the average of constraints, the default one of ALF.',
    'MuJoCo takes part on the open chains (pendulum, double pendulum, ten rods). It describes them by the angles of '
    'their hinges: no constraint to keep, and a mass matrix of one, two and ten rows where ours has six coordinates a '
    'body. An evaluation of it is its forward dynamics with one factorization of that matrix; RK4 makes four in a '
    'step, its implicit integrators one. Runs of more than 8 s of CPU are left out, and those of Exudyn with more '
    'than 50 000 steps.',
)


class Point(NamedTuple):
    """One run of one method."""

    problem: str
    method: str
    setting: str
    error: float  # m or rad, nan if it did not finish
    cpu: float  # s
    factorizations: int
    evaluations: int
    outcome: str


def _is_ours(method: str) -> bool:
    return method.startswith(OURS)


def cheapest(points: Sequence[Point], cost: str, accuracy: float) -> dict[str, Point]:
    """The cheapest run of every method with an error of at most `accuracy`."""
    found: dict[str, Point] = {}
    for point in points:
        if point.error <= accuracy and (
            point.method not in found or getattr(point, cost) < getattr(found[point.method], cost)
        ):
            found[point.method] = point
    return found


def order(points: Sequence[Point], method: str) -> float:
    """Power of the number of evaluations with which the error falls, down to a hundred times the smallest: rounding has
    none."""
    mine = [p for p in points if p.method == method and p.error > 0.0 and p.factorizations > 0]
    mine = [p for p in mine if p.error > FLOOR * min(q.error for q in mine)] or mine
    if len(mine) < 2:
        return math.nan
    return -float(np.polyfit(np.log([p.evaluations for p in mine]), np.log([p.error for p in mine]), 1)[0])


def judge(
    report: Report, points: Sequence[Point], problems: Sequence[str], references: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Table of the cheapest runs by accuracy; checks that ours are on the front in CPU time; the reasons where they are
    not."""
    rows, sentences = [], []
    for problem, reference in zip(problems, references, strict=True):
        mine = [p for p in points if p.problem == problem and math.isfinite(p.error)]
        for cost, title in COSTS.items():
            for accuracy in ACCURACIES:
                found = cheapest(mine, cost, accuracy)
                ours = min((p for m, p in found.items() if _is_ours(m)), key=lambda p: getattr(p, cost), default=None)
                rival = min(
                    (p for m, p in found.items() if not _is_ours(m)), key=lambda p: getattr(p, cost), default=None
                )
                if not found:
                    continue  # nobody is that accurate
                ratio = getattr(ours, cost) / getattr(rival, cost) if ours and rival else 0.0 if ours else math.inf
                rows.append(
                    {
                        'problem': problem,
                        'accuracy': accuracy,
                        'cost': title,
                        'ours': f'{ours.method}, {ours.setting}' if ours else None,
                        'our cost': float(getattr(ours, cost)) if ours else math.nan,
                        'best rival': f'{rival.method}, {rival.setting}' if rival else None,
                        'its cost': float(getattr(rival, cost)) if rival else math.nan,
                        'on the front': 'yes' if ratio <= 1.0 else 'NO',
                    }
                )
                if cost == 'cpu' and accuracy >= ENGINEERING:
                    others = [
                        p.cpu for m, p in found.items() if not _is_ours(m) and not m.startswith(WITHOUT_CONSTRAINTS)
                    ]
                    least = min(others, default=math.inf)
                    ahead = ours.cpu / least if ours else math.inf
                    report.check(
                        f'{problem}: our CPU time over that of the best rival that keeps constraints at {accuracy:g}',
                        ahead,
                        1.0,
                    )
                if ratio > 1.0:
                    sentences.append(_why(mine, problem, title, cost, accuracy, ours, rival))
        report.check(f'{problem}: error estimate of the reference', reference['error estimate'], 0.1 * ACCURACIES[-1])
    report.text('## The front', 'Cheapest run with at most this error, ours (ALF and M-ALF) and of all others.')
    report.table('fronts', rows)
    report.text('## Where ours is not on the front, and why', *(sentences or ['Nowhere.']))
    failures = [p for p in points if not math.isfinite(p.error)]
    if failures:
        report.text('## Runs that did not finish')
        report.table(
            'failures',
            [{'problem': p.problem, 'method': p.method, 'setting': p.setting, 'outcome': p.outcome} for p in failures],
        )
    return rows


def _why(
    points: Sequence[Point],
    problem: str,
    title: str,
    cost: str,
    accuracy: float,
    ours: Point | None,
    rival: Point | None,
) -> str:
    head = f'- {problem}, {accuracy:g}, {title}: '
    assert rival is not None  # or ours would be on the front
    if ours is None:
        return head + f'none of our runs is that accurate; {rival.method} is.'
    times = getattr(ours, cost) / getattr(rival, cost)
    text = head + f'{ours.method} ({ours.setting}) costs {times:.2g} times {rival.method} ({rival.setting}). '
    orders = order(points, ours.method), order(points, rival.method)
    if orders[1] > orders[0] + 0.5:
        # no figure for the rival: a few points of a method that chooses its order and its steps have no one order
        return text + (
            f'The error of {rival.method} falls faster with evaluations than ours, which falls with order '
            f'{orders[0]:.1f}.'
        )
    if rival.factorizations < ours.factorizations and cost == 'factorizations':
        return text + 'It keeps a factorization over many steps; ours makes one in each.'
    if rival.evaluations < ours.evaluations:
        return text + f'It needs {ours.evaluations / rival.evaluations:.2g} times fewer evaluations at this accuracy.'
    return text + (
        f'It makes {rival.evaluations} evaluations against {ours.evaluations}, so each of its is cheaper: '
        f'{rival.cpu / rival.evaluations * 1e6:.2g} us against {ours.cpu / ours.evaluations * 1e6:.2g} us.'
    )


def picture(report: Report, problem: str, unit: str, points: Sequence[Point]) -> None:
    """Log-log diagrams of one problem against all costs."""
    mine = [p for p in points if p.problem == problem and math.isfinite(p.error)]
    methods = list(dict.fromkeys(p.method for p in points))
    new, axes = figure(11.0, 3.8, 1, len(COSTS), sharey=True)
    for ax, (cost, title) in zip(axes[0], COSTS.items(), strict=True):
        for k, method in enumerate(methods):
            chosen = sorted((p for p in mine if p.method == method), key=lambda p: getattr(p, cost))
            if chosen:
                ax.loglog(
                    [getattr(p, cost) for p in chosen], [p.error for p in chosen], 'o-' if _is_ours(method) else 's--',
                    ms=3, lw=1.1, color=COLOURS[k % len(COLOURS)], label=method,
                )  # fmt: skip
        ax.axhspan(ENGINEERING, ACCURACIES[0], color='#f3f3f3', zorder=0)
        ax.set_xlabel(title)
    axes[0, 0].set_ylabel(f'error [{unit}]')
    lines = {
        line.get_label(): line for ax in axes[0] for line in ax.get_lines() if not line.get_label().startswith('_')
    }
    new.legend(lines.values(), lines.keys(), loc='outside lower center', ncols=7, fontsize=7, frameon=False)
    name = ''.join(c if c.isalnum() else '_' for c in problem.lower())
    report.figure(f'work_precision_{name}', new, f'{problem}: error against cost; grey: engineering accuracy')
