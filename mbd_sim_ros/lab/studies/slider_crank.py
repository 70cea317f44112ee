"""The chapter's slider-crank: its two figures computed anew, and each of its claims judged by the numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.lab.studies import Progress, crank, slider_crank_claims
from mbd_sim_ros.lab.studies.crank_history import START, CrankRun, record
from mbd_sim_ros.lab.studies.report import COLOURS, Report, figure
from solver.simulation import Simulation
from solver.step.work import scheme_parameters

SUMMARY = "the chapter's figures 1 and 2 for the 26-constraint slider-crank, and a judgement of each of its claims"
H = 5e-3  # s
DURATION, QUICK_DURATION = 20.0, 3.0  # s
ANGLES, QUICK_ANGLES = 121, 13  # of a revolution
XI = 1000.0  # the chapter's first penalty
CAP = 1e8
PENALTIES, QUICK_PENALTIES = 10.0 ** np.arange(1, 13), 10.0 ** np.array([2.0, 4.0, 10.0])
ITERATIONS = 20  # a step that takes more is a failed one
# The chapter reduces its step when the iteration fails; so does 'rescue'. It does not damp.
# the chapter's iteration: what one augmentation leaves open is left to the next
COMMON: dict[str, Any] = {
    'rho_inf': 1.0, 'mode': 'tolerance', 'max_iterations': ITERATIONS, 'step_policy': 'rescue', 'h_min': 1e-5,
    'augmentation': 'plain'
}  # fmt: skip
ADAPTIVE: dict[str, Any] = {**COMMON, 'penalty': XI, 'penalty_policy': 'adaptive', 'penalty_cap': CAP}


def study(out: Path, *, quick: bool, progress: Progress) -> dict:
    """Compute both figures and judge."""
    duration, count, penalties = (
        (QUICK_DURATION, QUICK_ANGLES, QUICK_PENALTIES) if quick else (DURATION, ANGLES, PENALTIES)
    )
    report = Report(out, 'Slider-crank through singular positions')
    report.text(
        f'Four bodies, 26 constraints, three redundant; start at theta = pi/4 with {crank.ENERGY:.6g} J, {duration:g} '
        f's, first step {H * 1e3:g} ms, rho_inf {COMMON["rho_inf"]:g}. A step that does not converge in {ITERATIONS} '
        f'iterations is halved, down to {COMMON["h_min"]:g} s. The slider is compared at the end with the equation of '
        f'motion of one coordinate; its mass of {crank.slider_mass():g} kg stands for the massless one.'
    )
    progress('effective masses', 0.0)
    theta = np.linspace(0.0, 2 * np.pi, count)
    names, isolated, coupled = masses(theta)
    fair = XI * float(np.exp(np.log(isolated).mean())) / (scheme_parameters(H, COMMON['rho_inf'])['beta'] * H * H)
    wanted: dict[str, dict[str, Any]] = {
        'm': ADAPTIVE,
        'm/10': {**ADAPTIVE, 'mass_factor': 0.1},
        'm/10, constant': {**COMMON, 'penalty': XI, 'mass_factor': 0.1},
        'xi/10, constant': {**COMMON, 'penalty': XI / 10},
        **{f'xi {p:g}': {**COMMON, 'penalty': float(p)} for p in penalties},
        **{f'xi {p:g}, block': {**COMMON, 'penalty': float(p), 'form': 'block'} for p in penalties},
        'ALF, same xi': {**COMMON, 'penalty': XI},
        'M-ALF, same xi': {**COMMON, 'kind': 'm_alf', 'penalty': XI},
        'M-ALF, fair xi': {**COMMON, 'kind': 'm_alf', 'penalty': fair},
    }
    runs: dict[str, CrankRun] = {}
    for k, (label, settings) in enumerate(wanted.items()):
        progress(label, 0.1 + 0.9 * k / len(wanted))
        runs[label] = record(label, H, duration, settings)
    constant = [runs[f'xi {p:g}'] for p in penalties]
    report.text('## Figure 1: m_R, step, energy and penalties')
    report.table('effective_masses', _mass_rows(theta, names, isolated, coupled), shown=False)
    report.table('effective_mass_ranges', _ranges(names, isolated, coupled))
    trio = [runs[label] for label in ('m', 'm/10', 'm/10, constant')]
    report.figure(
        'figure_1',
        _figure_1(theta, isolated, coupled, trio),
        'Figure 1: m_R isolated and coupled; step, energy, penalties',
    )
    report.table('figure_1_runs', [run.figures() for run in trio])
    report.text('## Figure 2: constant penalties, and M-ALF')
    rival = [runs[label] for label in ('ALF, same xi', 'M-ALF, same xi', 'M-ALF, fair xi')]
    report.figure(
        'figure_2',
        _figure_2(constant, rival),
        'Figure 2: step and energy for constant penalties (above) and for M-ALF (below)',
    )
    report.table(
        'constant_penalties', [run.figures() for run in [*constant, *(runs[f'xi {p:g}, block'] for p in penalties)]]
    )
    report.text(f'The fair penalty of M-ALF is xi times the geometric mean of m_R over beta h^2, {fair:.4g} N/m.')
    report.table('m_alf', [run.figures() for run in rival])
    conditions = _conditions(penalties)
    report.text(
        'Condition numbers of the Newton matrix at theta = pi/4, in the metric of masses and of m_R, largest over '
        'smallest singular value:'
    )
    report.table('conditions', conditions)
    found = slider_crank_claims.judge(isolated, coupled, runs, conditions, duration)
    report.text('## What becomes of the claims of the chapter')
    report.table('claims', [claim.row() for claim in found])
    lost = [label for label, run in runs.items() if run.outcome != 'ok' and label in ('m', 'm/10')]
    report.check('adaptive runs that fail or leave their branch', len(lost), 0)
    report.check(
        'energy error with m, adaptive [J]', runs['m'].energy_error, crank.limit(crank.LIMITS['conserving'].energy, H)
    )
    same = float(np.abs(_common(runs['m/10, constant'], runs['xi/10, constant'])).max())
    report.check('energy of m/10 minus that of xi/10 [J]', same, 1e-9)
    report.write()
    return {
        'claims': [claim.row() for claim in found],
        'fair_penalty': fair,
        'runs': [run.figures() for run in runs.values()],
        'checks': report.checks,
    }


def masses(theta: np.ndarray) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """(row names, isolated m_R, coupled m_R), both (len(theta), 26), at crank angles on the right branch."""
    isolated, coupled = [], []
    for angle in theta:
        simulation = Simulation(crank.scene_at(float(angle), H, {}))
        isolated.append([c.m for c in simulation.constraint_coefficients().values()])
        coupled.append([c.m for c in simulation.constraint_coefficients(coupled=True).values()])
    return tuple(simulation.model.row_names), np.array(isolated), np.array(coupled)


def _conditions(penalties: np.ndarray) -> list[dict[str, float]]:
    """Condition numbers of the condensed matrix S + A^T W A and of the block matrix, S being the inertia alone."""
    A, M = crank.jacobian(START)
    B = A @ np.linalg.inv(np.linalg.cholesky(M)).T
    N = B / np.linalg.norm(B, axis=1)[:, None]  # rows times the root of m_R
    S = (1.0 - scheme_parameters(H, COMMON['rho_inf'])['am']) * np.eye(len(M))
    return [
        {
            'penalty': float(p),
            'condensed': float(np.linalg.cond(S + p * N.T @ N)),
            'block': float(np.linalg.cond(np.block([[S, -N.T], [N, np.eye(len(N)) / p]]))),
        }
        for p in penalties
    ]


def _common(a: CrankRun, b: CrankRun) -> np.ndarray:
    """Difference of the energies at the instants both have."""
    n = min(len(a.energy), len(b.energy))
    return a.energy[:n, 1] - b.energy[:n, 1]


def _mass_rows(
    theta: np.ndarray, names: tuple[str, ...], isolated: np.ndarray, coupled: np.ndarray
) -> list[dict[str, Any]]:
    return [
        {'theta': float(t), **{f'{n} isolated': float(i) for n, i in zip(names, a, strict=True)},
         **{f'{n} coupled': float(i) for n, i in zip(names, b, strict=True)}}
        for t, a, b in zip(theta, isolated, coupled, strict=True)
    ]  # fmt: skip


def _ranges(names: tuple[str, ...], isolated: np.ndarray, coupled: np.ndarray) -> list[dict[str, Any]]:
    return [
        {
            'constraint': name,
            'isolated, smallest': float(isolated[:, k].min()),
            'isolated, largest': float(isolated[:, k].max()),
            'coupled, smallest': float(coupled[:, k].min()),
            'coupled, largest': float(coupled[:, k].max()),
        }
        for k, name in enumerate(names)
    ]


def _figure_1(theta: np.ndarray, isolated: np.ndarray, coupled: np.ndarray, runs: list[CrankRun]) -> Any:
    new, axes = figure(10.0, 8.0, 3, 2)
    for ax, values, title in zip(axes[0], (isolated, coupled), ('isolated', 'coupled'), strict=True):
        for k, row in enumerate(values.T):
            ax.semilogy(np.degrees(theta), row, lw=0.9, color=COLOURS[k % len(COLOURS)])
        ax.set_title(f'(a) m_R of the 26 constraints, {title} [kg, kg m^2]', loc='left', fontsize=9)
        ax.set_xlabel('theta [deg]')
        ax.set_xticks(range(0, 361, 90))
    _steps(axes[1, 0], runs, '(b) step [ms]')
    _energies(axes[1, 1], runs, '(c) mechanical energy [J]')
    for ax, run in zip(axes[2], runs[:2], strict=True):
        _penalties(ax, run)
        ax.set_title(f'(d) penalties, {run.label}', loc='left', fontsize=9)
    return new


def _figure_2(constant: list[CrankRun], rival: list[CrankRun]) -> Any:
    new, axes = figure(10.0, 6.4, 2, 2)
    for row, runs, letters in zip(axes, (constant, rival), ('ab', 'cd'), strict=True):
        _steps(row[0], runs, f'({letters[0]}) step [ms]')
        _energies(row[1], runs, f'({letters[1]}) mechanical energy [J]')
    return new


def _steps(ax: Any, runs: list[CrankRun], title: str) -> None:
    for k, run in enumerate(runs):
        ax.step(
            run.steps[:, 0],
            run.steps[:, 1] * 1e3,
            where='post',
            lw=1.2,
            color=COLOURS[k % 10],
            ls='--' if k % 2 else '-',
            label=run.label,
        )
        if run.outcome != 'ok':
            ax.plot(run.until, run.steps[-1, 1] * 1e3, 'x', ms=6, color=COLOURS[k % 10])
    ax.set_yscale('log')
    ax.set_title(title + ', x: end of a run that is lost', loc='left', fontsize=9)
    ax.set_xlabel('time [s]')
    ax.legend(fontsize=6, frameon=False, ncols=2)


def _energies(ax: Any, runs: list[CrankRun], title: str) -> None:
    whole = [run.energy[:, 1] for run in runs if run.outcome == 'ok'] or [run.energy[:1, 1] for run in runs]
    low, high = min(e.min() for e in whole), max(e.max() for e in whole)
    for k, run in enumerate(runs):
        ax.plot(
            run.energy[:, 0],
            run.energy[:, 1],
            lw=1.0,
            color=COLOURS[k % 10],
            ls='--' if k % 2 else '-',
            label=run.label,
        )
    margin = max(0.1 * (high - low), 1e-3)
    ax.set_ylim(low - margin, high + margin)
    ax.set_title(title, loc='left', fontsize=9)
    ax.set_xlabel('time [s]')
    ax.ticklabel_format(axis='y', useOffset=False)


def _penalties(ax: Any, run: CrankRun) -> None:
    for row in range(len(run.rows)):
        mine = run.penalties[run.penalties[:, 1] == row]
        times = np.concatenate([[0.0], mine[:, 0], [run.until]])
        values = np.concatenate([[run.penalty], mine[:, 2], mine[-1:, 2] if len(mine) else [run.penalty]])
        ax.step(times, values, where='post', lw=0.9, color=COLOURS[row % len(COLOURS)])
    ax.set_yscale('log')
    ax.set_ylim(0.5 * run.penalty, 2.0 * max(run.largest_penalty, 2.0 * run.penalty))
    ax.set_xlabel('time [s]')
