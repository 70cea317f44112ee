"""The slider-crank from many starting phases with many steps: failures, branches, errors, order; which settings keep
all limits."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_sim_ros.lab.studies import Progress, crank
from mbd_sim_ros.lab.studies.crank import CONSERVING, DAMPED, LIMITS, STEPS, Passage
from mbd_sim_ros.lab.studies.report import COLOURS, Report, figure
from solver.step.settings import IntegratorSettings

SUMMARY = 'failures, branches, errors and order of the slider-crank from 200 starting phases'
PHASES, QUICK_PHASES = 200, 3
CANDIDATE_PHASES = 20
QUICK_STEPS = (0.02, 0.01, 0.005)
LOWEST_ORDER = 1.8  # of the medians, between 10 and 1 ms
JUDGED = {'default': (DAMPED, 'damped'), 'conserving': (CONSERVING, 'conserving')}
CANDIDATES = [
    {'mode': 'fixed', 'rho_inf': rho_inf, 'iterations': iterations, 'penalty': penalty}
    for rho_inf in (0.8, 0.9, 0.95)
    for iterations in (2, 3)
    for penalty in (1e4, 1e6)
]


class Row(NamedTuple):
    """Results of the runs of one setting at one step, all phases together."""

    settings: str
    h: float
    runs: int
    failed: int
    wrong_branch: int
    energy_median: float
    energy_95: float
    energy_max: float
    position_median: float
    position_95: float
    position_max: float
    iterations: float


def study(out: Path, *, quick: bool, progress: Progress) -> dict:
    """Run all phases with the default and the conserving settings, and fewer with candidates for the defaults."""
    count, steps = (QUICK_PHASES, QUICK_STEPS) if quick else (PHASES, STEPS)
    candidates = [] if quick else CANDIDATES
    total = count * len(JUDGED) + CANDIDATE_PHASES * len(candidates)
    report = Report(out, 'Slider-crank from any starting phase')
    report.text(
        f'{count} starting phases (seed {crank.SEED}), {crank.DURATION:g} s each, 26 constraints of which 3 are '
        'redundant. The slider position is compared after the whole time with the equation of motion of one '
        'coordinate, solved to 1e-12. Errors are of runs that ended on their branch; percentiles are over phases.'
    )
    theta = crank.phases(count)
    angles = crank.exact_angles(theta, crank.slider_mass(), np.array([crank.DURATION]))[:, 0]
    done = 0.0
    rows: dict[str, list[Row]] = {}
    runs: dict[tuple[str, float], list[Passage]] = {}
    for name, (settings, _) in JUDGED.items():
        for h in steps:
            progress(f'{name}, {h * 1e3:g} ms', done / total)
            runs[name, h] = [crank.passage(a, e, h, settings) for a, e in zip(theta, angles, strict=True)]
            rows.setdefault(name, []).append(_row(name, h, runs[name, h]))
            done += count / len(steps)
    for name, (settings, limits) in JUDGED.items():
        report.text(f'## {name.capitalize()} settings', f'`{_named(settings)}`')
        report.table(f'phases_{name}', [row._asdict() for row in rows[name]])
        _check(report, name, rows[name], limits)
        report.text(_conclusion(report, name, rows[name]))
    report.figure(
        'phases',
        _picture(rows, runs),
        'Errors after 10 s: dots are runs, lines are the limits (dashed: energy and position)',
    )
    figures: dict[str, Any] = {name: [row._asdict() for row in found] for name, found in rows.items()}
    if candidates:
        figures['candidates'] = _candidates(
            report, theta, angles, lambda k: progress('candidates', (done + k * CANDIDATE_PHASES) / total)
        )
    report.write()
    return {**figures, 'checks': report.checks}


def _named(settings: dict[str, Any]) -> str:
    full = IntegratorSettings(**settings)
    mode = f'{full.iterations} iterations' if full.mode == 'fixed' else f'tolerance {full.tolerance:g}'
    return f'rho_inf {full.rho_inf:g}, penalty {full.penalty:g}, {full.mode}, {mode}, {full.form}'


def _row(name: str, h: float, runs: list[Passage]) -> Row:
    ok = [run for run in runs if run.outcome == 'ok']
    quantiles = lambda values: np.quantile(values, [0.5, 0.95, 1.0]) if values else np.full(3, np.nan)  # noqa: E731
    energy, position = quantiles([run.energy_error for run in ok]), quantiles([run.position_error for run in ok])
    outcomes = [run.outcome for run in runs]
    failed, wrong = outcomes.count('failed'), outcomes.count('wrong branch')
    iterations = float(np.mean([run.iterations for run in runs]))
    (e50, e95, e100), (p50, p95, p100) = map(float, energy), map(float, position)
    return Row(name, h, len(runs), failed, wrong, e50, e95, e100, p50, p95, p100, iterations)


def _check(report: Report, name: str, rows: list[Row], limits: str) -> None:
    lost = sum(row.failed + row.wrong_branch for row in rows)
    report.check(f'{name}: failures and wrong branches', lost, 0)
    for row in rows:
        if row.h <= crank.LARGEST_JUDGED:
            allowed = LIMITS[limits]
            report.check(
                f'{name}: energy error at {row.h * 1e3:g} ms [J]', row.energy_max, crank.limit(allowed.energy, row.h)
            )
            report.check(
                f'{name}: slider position at {row.h * 1e3:g} ms [m]',
                row.position_max,
                crank.limit(allowed.position, row.h),
            )
    report.check(f'{name}: order of the position, medians', order(rows), LOWEST_ORDER, least=True)


def order(rows: list[Row]) -> float:
    """Order of the median position error over the steps that are judged, by least squares in logarithms."""
    judged = [row for row in rows if row.h <= crank.LARGEST_JUDGED]
    return float(np.polyfit(np.log([row.h for row in judged]), np.log([row.position_median for row in judged]), 1)[0])


def _conclusion(report: Report, name: str, rows: list[Row]) -> str:
    runs, lost = sum(row.runs for row in rows), sum(row.failed + row.wrong_branch for row in rows)
    missed = [check['name'] for check in report.checks if check['name'].startswith(f'{name}:') and not check['met']]
    through = (
        f'All {runs} runs end on their branch' if not lost else f'{lost} of {runs} runs fail or leave their branch'
    )
    limits = (
        'all limits are kept' if not missed else 'not kept: ' + ', '.join(m.removeprefix(f'{name}: ') for m in missed)
    )
    return f'{through}; the position error falls with order {order(rows):.2f}; {limits}.'


def _candidates(report: Report, theta: np.ndarray, angles: np.ndarray, progress: Any) -> list[dict]:
    """Which settings keep all limits of the damped setting, judged on the first phases."""
    found = []
    for k, settings in enumerate(CANDIDATES):
        progress(k)
        rows = [
            _row('', h, [crank.passage(theta[i], angles[i], h, settings) for i in range(CANDIDATE_PHASES)])
            for h in STEPS
        ]
        judged = [row for row in rows if row.h <= crank.LARGEST_JUDGED]
        share = lambda value, what, judged=judged: max(  # noqa: E731
            getattr(row, value) / crank.limit(getattr(LIMITS['damped'], what), row.h) for row in judged
        )
        found.append(
            {
                **{key: settings[key] for key in ('rho_inf', 'iterations', 'penalty')},
                'lost': sum(row.failed + row.wrong_branch for row in rows),
                'energy / limit': share('energy_max', 'energy'),
                'position / limit': share('position_max', 'position'),
                'position at 10 ms': judged[0].position_max,
                'position at 1 ms': judged[-1].position_max,
            }
        )
    kept = [
        row for row in found if row['lost'] == 0 and row['energy / limit'] <= 1.0 and row['position / limit'] <= 1.0
    ]
    named = (
        '; '.join(
            f'rho_inf {row["rho_inf"]:g}, {row["iterations"]} iterations, penalty {row["penalty"]:g}' for row in kept
        )
        or 'none'
    )
    report.text(
        '## Candidates for the defaults',
        f'The first {CANDIDATE_PHASES} phases at all steps. Errors are the largest share of the limit of the damped '
        f'setting at any step up to 10 ms. Within all limits: {named}.',
    )
    report.table('candidates', found)
    return found


def _picture(rows: dict[str, list[Row]], runs: dict[tuple[str, float], list[Passage]]) -> Any:
    new, axes = figure(9.0, 3.6, 1, 2)
    for k, name in enumerate(rows):
        steps = np.array([row.h for row in rows[name]])
        limits = LIMITS[JUDGED[name][1]]
        for ax, value, allowed in zip(axes[0], ('energy_error', 'position_error'), limits, strict=True):
            for h in steps:
                values = [getattr(run, value) for run in runs[name, h] if run.outcome == 'ok']
                ax.loglog(np.full(len(values), h * 1e3 * (0.96, 1.04)[k]), values, '.', ms=2.5, color=COLOURS[k])
            judged = steps[steps <= crank.LARGEST_JUDGED]
            ax.loglog(
                judged * 1e3,
                [crank.limit(allowed, h) for h in judged],
                '--',
                lw=1,
                color=COLOURS[k],
                label=f'limit, {name}',
            )
            ax.loglog(
                steps * 1e3,
                [np.median([getattr(r, value) for r in runs[name, h]]) for h in steps],
                lw=1,
                color=COLOURS[k],
                label=name,
            )
    axes[0, 0].set_title('largest energy error [J]', loc='left', fontsize=9)
    axes[0, 1].set_title('slider position [m]', loc='left', fontsize=9)
    for ax in axes[0]:
        ax.set_xlabel('step [ms]')
        ax.legend(fontsize=7, frameon=False)
    return new
