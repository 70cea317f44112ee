"""Success and error of the slider-crank over penalty and step, in both forms of the linear solve, and where an erratic range comes from."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.study import Progress, crank
from mbd_sim_ros.study.report import COLOURS, Report, figure
from solver.audit import dense_jacobian
from solver.integrators.augmented_lagrangian import coefficients
from solver.integrators.settings import IntegratorSettings
from solver.scene import Start
from solver.simulation import Simulation

SUMMARY = 'success and error of the slider-crank over penalty 1e1 to 1e13 and step, and the erratic middle range explained'
PENALTIES, QUICK_PENALTIES = 10.0 ** np.arange(1, 14), 10.0 ** np.array([2.0, 6.0, 12.0])
STEPS, QUICK_STEPS = crank.STEPS, (0.02, 0.01)
PHASES, QUICK_PHASES = 6, 2
FORMS = ('condensed', 'block')
SCHEMES = {
    'default': {},
    'conserving': {'rho_inf': 1.0, 'iterations': 3},
    'tolerance': {'rho_inf': 0.9, 'mode': 'tolerance'},
}
PLATEAU = 2.0  # errors within this factor of those at the default penalty are called the same
OFFSETS = np.linspace(-2.5, 2.5, 101)  # end of the step behind the singular position, in steps
MATRIX_STEP, MATRIX_RHO = 0.01, 0.9  # s, of the matrices looked at


def study(out: Path, *, quick: bool, progress: Progress) -> dict:
    """Map every scheme and form, then look at the Newton matrices beside a singular position."""
    penalties, steps, phases = (QUICK_PENALTIES, QUICK_STEPS, QUICK_PHASES) if quick else (PENALTIES, STEPS, PHASES)
    report = Report(out, 'Penalty and step')
    report.text(
        f'Slider-crank with 26 constraints, {phases} starting phases (seed {crank.SEED}), {crank.DURATION:g} s each. A run is lost when a '
        'step fails or the mechanism leaves its branch. Errors are the largest of all phases.'
    )
    theta = crank.phases(phases)
    angles = crank.exact_angles(theta, crank.slider_mass(), np.array([crank.DURATION]))[:, 0]
    rows: list[dict[str, Any]] = []
    cells = len(SCHEMES) * len(FORMS) * len(penalties)
    for scheme, settings in SCHEMES.items():
        for form in FORMS:
            for penalty in penalties:
                progress(f'{scheme}, {form}, penalty {penalty:g}', 0.95 * len(rows) / (cells * len(steps)))
                for h in steps:
                    chosen = {**settings, 'form': form, 'penalty': float(penalty)}
                    runs = [crank.passage(a, e, h, chosen) for a, e in zip(theta, angles, strict=True)]
                    ok = [run for run in runs if run.outcome == 'ok']
                    rows.append(
                        {
                            'scheme': scheme,
                            'form': form,
                            'penalty': float(penalty),
                            'h': h,
                            'lost': len(runs) - len(ok),
                            'position_error': max((run.position_error for run in ok), default=np.nan),
                            'energy_error': max((run.energy_error for run in ok), default=np.nan),
                            'iterations': float(np.mean([run.iterations for run in runs])),
                        }
                    )
    report.table('penalty_map', rows, shown=False)
    report.figure('penalty_map', _maps(rows, phases, steps, penalties), 'Slider position error after 10 s [m], base-10 logarithm; numbers: lost runs')
    default = IntegratorSettings().penalty
    _judge(report, rows, steps, default)
    progress('matrices', 0.95)
    matrices = _matrices(report, penalties)
    report.write()
    return {'rows': rows, 'matrices': matrices, 'checks': report.checks}


def _judge(report: Report, rows: list[dict[str, Any]], steps: tuple[float, ...], default: float) -> None:
    """Which penalties lose runs, over which range the error is that of the default penalty, and where the default lies in it."""
    summary = []
    for scheme in SCHEMES:
        for form in FORMS:
            mine = [row for row in rows if (row['scheme'], row['form']) == (scheme, form)]
            lost = sorted({row['penalty'] for row in mine if row['lost']})
            flat = _plateau(mine, steps, default)
            summary.append(
                {
                    'scheme': scheme,
                    'form': form,
                    'penalties with lost runs': ', '.join(f'{p:g}' for p in lost) or 'none',
                    'same error as at the default': f'{flat[0]:g} to {flat[-1]:g}' if flat else 'nowhere',
                    'lost at the default': sum(row['lost'] for row in mine if row['penalty'] == default),
                }
            )
            name = f'{scheme}, {form}'
            report.check(f'{name}: runs lost at the default penalty', summary[-1]['lost at the default'], 0)
            below = np.log10(default / flat[0]) if flat else 0.0
            report.check(f'{name}: decades of like penalties below the default', below, 1.0, least=True)
            above = np.log10(flat[-1] / default) if flat else 0.0
            report.check(f'{name}: decades of like penalties above the default', above, 1.0, least=True)
    report.text(
        '## Ranges',
        f'The default penalty is {default:g}. "Same error": at every step no run is lost and the largest position error is at most '
        f'{PLATEAU:g} times that of the default penalty, at all penalties from there to the default.',
    )
    report.table('ranges', summary)


def _plateau(rows: list[dict[str, Any]], steps: tuple[float, ...], default: float) -> list[float]:
    """Penalties joined to the default without a gap, where no run is lost and the errors are those of the default."""
    at = {(row['penalty'], row['h']): row for row in rows}
    penalties = sorted({row['penalty'] for row in rows})
    good = [
        all(at[p, h]['lost'] == 0 and at[p, h]['position_error'] <= PLATEAU * at[default, h]['position_error'] for h in steps)
        for p in penalties
    ]
    first = last = penalties.index(default)
    if not good[first]:
        return []
    while first > 0 and good[first - 1]:
        first -= 1
    while last + 1 < len(good) and good[last + 1]:
        last += 1
    return penalties[first : last + 1]


def _jacobian(theta: float) -> tuple[np.ndarray, np.ndarray]:
    """(A (nc, n), M (n, n)) at a crank angle on the right branch."""
    scene = crank.scene_at(theta, MATRIX_STEP, {})
    simulation = Simulation(dataclasses.replace(scene, start=Start()))  # at rest: at the singular position itself no rate is consistent
    bodies = simulation.model.tables.bodies
    n = simulation.model.n_bodies
    M = np.zeros((6 * n, 6 * n))
    for b in range(n):
        M[6 * b : 6 * b + 3, 6 * b : 6 * b + 3] = bodies.mass[b] * np.eye(3)
        M[6 * b + 3 : 6 * b + 6, 6 * b + 3 : 6 * b + 6] = bodies.inertia[b]
    return dense_jacobian(simulation.model, simulation.work.J), M


def _matrices(report: Report, penalties: np.ndarray) -> list[dict[str, float]]:
    """Smallest real part of the eigenvalues of the Newton matrix in the mass metric, with A of the stage or of the end on the left."""
    scheme = coefficients(MATRIX_STEP, MATRIX_RHO)
    rate = float(crank.crank_rate(np.pi / 2, crank.slider_mass()))
    found = []
    for offset in OFFSETS:
        end = np.pi / 2 + offset * MATRIX_STEP * rate
        A_e, M = _jacobian(end)
        A_s, _ = _jacobian(end - scheme['af'] * MATRIX_STEP * rate)
        inverse = np.linalg.inv(np.linalg.cholesky(M))
        B_e, B_s = A_e @ inverse.T, A_s @ inverse.T
        W = 1.0 / (B_s * B_s).sum(axis=1)
        for penalty in penalties:
            row = {'offset': float(offset), 'penalty': float(penalty)}
            for name, left in (('mixed', B_s), ('end', B_e)):
                K = (1.0 - scheme['am']) * np.eye(len(M)) + penalty * (left.T * W) @ B_e
                row[name] = float(np.linalg.eigvals(K).real.min() / (1.0 - scheme['am'])) if name == 'mixed' else float(
                    np.linalg.eigvalsh(K)[0] / (1.0 - scheme['am'])
                )
            found.append(row)
    report.table('newton_matrices', found, shown=False)
    bad = {p: [row for row in found if row['penalty'] == p and row['mixed'] <= 0.0] for p in penalties}
    wrong = [p for p in penalties if bad[p]]
    worst = min(row['end'] for row in found)
    report.check('smallest eigenvalue of the matrix in use, in units of the inertia', worst, 1.0 - 1e-3, least=True)
    span = f'from {wrong[0]:g} to {wrong[-1]:g}' if wrong else 'at no penalty'
    report.text(
        '## Where an erratic range comes from, and why it is not met',
        f'Newton matrix S + A^T W A for steps of {MATRIX_STEP * 1e3:g} ms (rho_inf {MATRIX_RHO:g}) that end within '
        f'{OFFSETS[-1]:g} steps of the singular position theta = pi/2, at the speed of the mechanism, S being the inertia alone. With A of '
        'the stage on the left and A of the end on the right, as the residuals would have it, a step that straddles the position sees '
        f'the nearly free direction with opposite signs: an eigenvalue falls below zero {span}, '
        f'in at most {max(len(b) for b in bad.values()) / len(OFFSETS):.0%} of the places. Where it passes zero the increment has no bound: '
        'whether a run meets such a place depends on its phase, and on the penalty, because a small one leaves the direction to its '
        'inertia. The matrix in use has A of the end on both sides; its '
        f'smallest eigenvalue is {worst:.6f} times the inertia at every penalty and place. The residuals are exact in both cases, so '
        'only the convergence differs (docs/decisions/0002).',
    )
    report.figure('matrices', _eigenvalues(found, penalties), 'Smallest eigenvalue of the Newton matrix beside a singular position')
    return found


def _maps(rows: list[dict[str, Any]], phases: int, steps: tuple[float, ...], penalties: np.ndarray) -> Any:
    new, axes = figure(10.0, 1.2 + 1.7 * len(SCHEMES), len(SCHEMES), len(FORMS), sharex=True, sharey=True)
    errors = np.array([row['position_error'] for row in rows])
    low, high = np.log10(np.nanmin(errors)), 0.0
    shape = (len(SCHEMES), len(FORMS), len(penalties), len(steps))
    table = np.log10(errors).reshape(shape)
    lost = np.array([row['lost'] for row in rows]).reshape(shape)
    for i, scheme in enumerate(SCHEMES):
        for j, form in enumerate(FORMS):
            ax = axes[i, j]
            ax.grid(False)
            image = ax.imshow(np.clip(table[i, j].T, low, high), vmin=low, vmax=high, cmap='viridis', aspect='auto')
            for p in range(len(penalties)):
                for s in range(len(steps)):
                    if lost[i, j, p, s]:
                        ax.text(p, s, f'{lost[i, j, p, s]}', ha='center', va='center', fontsize=7, color='#c0392b', weight='bold')
            ax.set_title(f'{scheme}, {form} (of {phases} runs)', loc='left', fontsize=9)
            ax.set_xticks(range(len(penalties)), [f'1e{round(np.log10(p))}' for p in penalties], fontsize=7)
            ax.set_yticks(range(len(steps)), [f'{h * 1e3:g} ms' for h in steps], fontsize=7)
    for ax in axes[-1]:
        ax.set_xlabel('penalty')
    new.colorbar(image, ax=axes, shrink=0.8)
    return new


def _eigenvalues(found: list[dict[str, float]], penalties: np.ndarray) -> Any:
    new, axes = figure(9.0, 3.4, 1, 2, sharey=True)
    for ax, name, title in zip(axes[0], ('mixed', 'end'), ('A of the stage and of the end', 'A of the end twice (in use)'), strict=True):
        for k, penalty in enumerate(penalties[:: max(1, len(penalties) // 6)]):
            mine = [row for row in found if row['penalty'] == penalty]
            ax.plot([row['offset'] for row in mine], [row[name] for row in mine], lw=1.2, color=COLOURS[k], label=f'penalty {penalty:g}')
        ax.set_yscale('symlog', linthresh=1.0)
        ax.set_title(title, loc='left', fontsize=9)
        ax.set_xlabel('end of the step behind the singular position [steps]')
    axes[0, 0].set_ylabel('smallest eigenvalue / inertia')
    axes[0, 1].legend(fontsize=7, frameon=False)
    return new
