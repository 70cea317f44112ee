"""Study of the full car in repeated swept steering: the chapter's figures 3b and 4, a converged solution, and who
departs from it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.lab.studies.car_runs import CarRun, Converged, converged, departures, growth, orders, run
from mbd_sim_ros.lab.studies.report import COLOURS, Report, figure
from solver.elements.laws import compile_laws, evaluate_law
from solver.files.scene import load_scene
from solver.simulation import Simulation

SUMMARY = 'the full car in repeated swept steering: methods against a converged solution'
SCENE = 'car_swept_steer'
JUDGED = 20.0  # s, of the 30 s of the maneuver
FIRST_CYCLE = 4.0  # s; the sweep starts at 1 s and completes its first period 2.65 s later
LEVELS, QUICK_LEVELS = (1e-3, 5e-4, 2.5e-4, 1.25e-4), (2e-3, 1e-3, 5e-4)
QUICK_DURATION = 2.5  # s
LIMITS = {'position': 0.05, 'yaw_rate': 0.005, 'tire_force': 0.01}  # m, part of the peak, part of the peak (RMS)
SECOND = 1.8  # least observed order of a method of second order at these steps
CHAPTER_PENALTY = 1000.0  # where the chapter starts its penalties
ADAPTIVE = ('integrator.mode=tolerance', 'integrator.h=0.01', 'integrator.h_min=5e-5', 'integrator.step_policy=rescue')
GOVERNED = (
    'integrator.mode=tolerance',
    'integrator.h=0.005',
    'integrator.step_policy=error',
    'integrator.error_tolerance=1e-2',
)


def cases(quick: bool) -> dict[str, list[str]]:
    """Methods by name: the overrides of the scene."""
    adaptive = [
        *ADAPTIVE,
        'integrator.augmentation=plain',
        'integrator.penalty_policy=adaptive',
        f'integrator.penalty={CHAPTER_PENALTY}',
    ]
    found = {
        'ALF 5 ms': ['integrator.h=0.005'],
        'ALF 1 ms, to tolerance': ['integrator.mode=tolerance'],
        'ALF 5 ms, to tolerance': ['integrator.h=0.005', 'integrator.mode=tolerance'],
        'ALF 1 ms, one iteration': ['integrator.iterations=1'],
        'ALF 5 ms, one iteration': ['integrator.h=0.005', 'integrator.iterations=1'],
        'ALF, adaptive': adaptive,
        'ALF, error control': list(GOVERNED),
        'M-ALF, same penalty': [*adaptive, 'integrator.kind=m_alf'],
        'M-ALF 1 ms, fair penalty': ['integrator.kind=m_alf', f'integrator.penalty={fair_penalty(1e-3):.3g}'],
    }
    kept = ('ALF 5 ms', 'ALF 1 ms, to tolerance', 'ALF, adaptive', 'M-ALF, same penalty')
    return {name: found[name] for name in kept} if quick else found


def references(quick: bool) -> dict[str, list[str]]:
    """Independent integrators by name; the two of BDF give its error band."""
    if quick:
        return {}
    kinds = [('BDF 1e-5', 'bdf', 1e-5), ('BDF 1e-6', 'bdf', 1e-6), ('IDA 1e-5', 'ida', 1e-5)]
    return {
        name: [f'integrator.kind=reference_{kind}', f'integrator.tolerance={tol}', 'integrator.h=0.01']
        for name, kind, tol in kinds
    }


def fair_penalty(h: float) -> float:
    """Penalty of M-ALF with which its weights xi beta h^2 have the median of those of ALF, xi m_R."""
    simulation = Simulation(load_scene(SCENE, [f'integrator.h={h}']))
    simulation.advance(1)
    return float(np.median(simulation.last_step.W) / (simulation.scheme.beta * h * h))


def study(out: Path, *, quick: bool, progress: Callable[[str, float], None]) -> dict:
    """See mbd_sim_ros.lab.studies."""
    duration = QUICK_DURATION if quick else load_scene(SCENE).duration
    judged = min(JUDGED, duration)
    jobs = [(f'ALF {h * 1e3:g} ms', [f'integrator.h={h}'], duration) for h in (QUICK_LEVELS if quick else LEVELS)]
    jobs += [(name, overrides, duration) for name, overrides in cases(quick).items()]
    jobs += [(name, overrides, FIRST_CYCLE) for name, overrides in references(quick).items()]
    runs = {}
    for k, (name, overrides, length) in enumerate(jobs):
        progress(name, k / len(jobs))
        runs[name] = run(SCENE, name, overrides, length)
    progress('report', 1.0)
    levels = [runs[name] for name, *_ in jobs[: len(QUICK_LEVELS if quick else LEVELS)]]
    truth = converged(levels)
    report = Report(out, 'The full car in repeated swept steering')
    report.text(
        f'Scene `{SCENE}`, {duration:g} s. Every method solves the same compiled model from the same start. The '
        'converged solution is '
        "Richardson's extrapolation of the two finest runs; its band is the distance to the extrapolation from the "
        f'level before. Departures are judged over the first {judged:g} s: position in m, yaw rate and tire forces '
        f'(RMS, worst of twelve) in percent of their peaks. A run that failed has no departures. CPU times are of one '
        'process and compare within this table only.'
    )
    data: dict[str, Any] = {'duration': duration, 'judged': judged}
    data['methods'] = _methods(report, runs, truth, judged)
    data['band'], data['orders'] = _convergence(report, levels, truth, judged)
    data['growth'] = _growth(
        report, [*levels[:1], runs['ALF 5 ms'], *([] if quick else [runs['ALF 1 ms, one iteration']])], truth
    )
    if not quick:
        data['references'] = _references(report, runs, truth)
    _pictures(report, runs, truth)
    one = data['methods']['ALF 1 ms']
    for key, limit in LIMITS.items():
        report.check(f'{key} at 1 ms, fixed cost', one[key], limit)
    for name in ('ALF 1 ms', 'ALF 5 ms', 'ALF 1 ms, to tolerance', *([] if quick else ['ALF 5 ms, to tolerance'])):
        report.check(f'{name}: time reached [s]', runs[name].figures.get('until', 0.0), duration, least=True)
    report.write()
    return {**data, 'checks': report.checks}


def _methods(report: Report, runs: dict[str, CarRun], truth: Converged, judged: float) -> dict[str, dict[str, float]]:
    found = {}
    for name, r in runs.items():
        if r.figures:
            steps = r.figures['factorizations'] if 'BDF' in name or 'IDA' in name else r.figures['iterations']
            found[name] = departures(r, truth.run, judged) | r.figures | {'iterations': steps}
    rows = [
        {
            'method': name, 'reached [s]': f['until'], 'position '
                '[m]': f['position'], 'yaw rate [%]': 100 * f['yaw_rate'],
            'tire forces [%]': 100 * f['tire_force'], 'lateral, front left [%]': 100 * f['front_left_lateral'],
            'iterations, LU of references': f['iterations'], 'CPU per simulated second': f['cpu_per_second'],
        }
        for name, f in found.items()
    ]  # fmt: skip
    report.text('## Methods')
    report.table('methods', rows)
    ended = [f'- {name}: {r.message}' for name, r in runs.items() if r.message]
    report.text('Ended early:', '\n'.join(ended)) if ended else report.text('Every run reached its end.')
    return found


def _convergence(
    report: Report, levels: Sequence[CarRun], truth: Converged, judged: float
) -> tuple[dict[str, float], list[dict[str, float]]]:
    n = int(np.searchsorted(truth.run.t, judged + 1e-6))
    band = {
        'position': float(np.hypot(*truth.band['place'][:n].T).max()),
        'yaw_rate': float(truth.band['yaw_rate'][:n].max() / np.abs(truth.run.yaw_rate[:n]).max()),
        'tire_force': float(
            (np.sqrt((truth.band['forces'][:n] ** 2).mean(0)) / np.abs(truth.run.forces[:n]).max(0)).max()
        ),
    }
    observed = orders(levels, judged)
    report.text('## Convergence')
    report.text(
        f'Band of the converged solution over {judged:g} s: position {band["position"]:.2g} m, yaw rate '
        f'{100 * band["yaw_rate"]:.2g} %, '
        f'tire forces {100 * band["tire_force"]:.2g} %. Orders from three successive steps:'
    )
    steps = [f'{a.name[4:]}, halved twice' for a in levels]
    report.table('orders', [{'from': step, **row} for step, row in zip(steps, observed, strict=False)])
    for key, value in observed[-1].items():
        report.check(f'observed order of {key.replace("_", " ")}', value, SECOND, least=True)
    return band, observed


def _growth(report: Report, runs: Sequence[CarRun], truth: Converged) -> dict[str, dict[str, float]]:
    """Why departures grow: text computed from the fits."""
    found = {r.name: growth(r, truth.run, 1.0)._asdict() for r in runs if len(r.t) > 200}
    report.text('## Growth of the departures')
    report.table('growth', [{'method': name, **g} for name, g in found.items()])
    lines = []
    for name, g in found.items():
        better = 'a power of time' if g['power_misfit'] < g['rate_misfit'] else 'an exponential'
        law = f't^{g["power"]:.1f}' if g['power_misfit'] < g['rate_misfit'] else f'exp({g["rate"]:.2f} t)'
        lines.append(
            f'- {name}: {better} fits better, {law}. Of the position error at the end {100 * g["heading_share"]:.0f} '
            f'% is the error of the heading carried along the way, the rest the integrated error of the velocity.'
        )
    report.text(
        'Fits of |error| of the position after 1 s, running maximum, and its two causes (`car_runs.growth`):',
        '\n'.join(lines),
    )
    r = runs[0]
    n = len(r.t)
    slip = np.abs(r.yaw_rate - truth.run.yaw_rate[:n])
    half = n // 2
    ratio = [
        float(part.max() / np.abs(truth.run.yaw_rate[k : k + len(part)]).max())
        for k, part in ((0, slip[:half]), (half, slip[half:]))
    ]
    report.text(
        f'The yaw rate is no integral and forgets: relative to its peak its error is {100 * ratio[0]:.2g} % in the '
        f'first half of the run and {100 * ratio[1]:.2g} % in the second. Nothing draws a car back to a heading or a '
        f'place: these collect what each sweep leaves.'
    )
    return found


def _references(report: Report, runs: dict[str, CarRun], truth: Converged) -> dict[str, dict[str, float]]:
    """The independent integrators against the converged solution, both with their bands."""
    best, other = runs['BDF 1e-6'], runs['BDF 1e-5']
    n = min(len(best.t), len(other.t))
    found, rows = {}, []
    for label, key in (('position [m]', 'place'), ('yaw rate [rad/s]', 'yaw_rate'), ('tire forces [N]', 'forces')):
        ours, theirs, second = getattr(truth.run, key)[:n], getattr(best, key)[:n], getattr(other, key)[:n]
        difference = float(np.abs(theirs - ours).max())
        band, bar = float(truth.band[key][:n].max()), float(np.abs(second - theirs).max())
        found[key] = {'difference': difference, 'converged_band': band, 'bdf_band': bar, 'until': float(best.t[n - 1])}
        rows.append(
            {
                'quantity': label,
                'BDF 1e-6 less converged': difference,
                'band of converged': band,
                'BDF 1e-5 less 1e-6': bar,
            }
        )
        report.check(f'{key}: BDF and converged differ, over the sum of both bands', difference / (band + bar), 1.0)
    report.text('## Independent integrators')
    report.text(
        'Other equations (stabilised index 2, quaternions), other methods, other linear algebra, the same elements; '
        f'the first {best.t[n - 1]:g} s, which hold the first steering cycle. Largest differences:'
    )
    report.table('references', rows)
    return found


def _pictures(report: Report, runs: dict[str, CarRun], truth: Converged) -> None:
    spec = load_scene(SCENE).model
    picture, axes = figure(6.0, 3.4)
    v = np.linspace(-1.5, 1.5, 301)
    for k, axle in enumerate(('front', 'rear')):
        damper = next(e for e in spec.spring_dampers if e.name == f'damper_{axle}_left')
        assert damper.damper is not None
        laws = compile_laws([damper.damper])
        axes[0, 0].plot(v, [evaluate_law(laws, 0, float(x))[0] for x in v], color=COLOURS[k], label=axle)
    axes[0, 0].set(xlabel='rate of length [m/s], rebound positive', ylabel='force [N]')
    axes[0, 0].legend()
    report.figure('dampers', picture, "Forces of the dampers over the relative velocity (the chapter's figure 3b)")

    shown = [r for name, r in runs.items() if r.figures and name in SHOWN]
    everything = [truth.run, *shown]
    picture, axes = figure(9.0, 6.4, 2, 2)
    for k, r in enumerate(everything):
        style: dict[str, Any] = {
            'color': 'black' if k == 0 else COLOURS[k - 1],
            'lw': 2.2 if k == 0 else 1.0,
            'ls': '-' if k == 0 else '--',
        }
        axes[0, 0].plot(r.t, r.velocity[:, 0], label=r.name, **style)
        axes[1, 0].plot(*r.place.T, **style)
        axes[1, 1].plot(r.t, r.forces[:, 0, 1], **style)
        if k and not r.name.startswith(('BDF', 'IDA')):
            end = r.figures['until']
            axes[0, 1].step(
                [*r.steps[:, 0], end],
                [*(1e3 * r.steps[:, 1]), 1e3 * r.steps[-1, 1]],
                where='post',
                color=style['color'],
                lw=1.0,
            )
    axes[0, 0].set(xlabel='t [s]', ylabel='longitudinal velocity [m/s]')
    axes[0, 1].set(xlabel='t [s]', ylabel='step [ms]', yscale='log')
    axes[1, 0].set(xlabel='x [m]', ylabel='y [m]')
    axes[1, 1].set(xlabel='t [s]', ylabel='lateral force, front left [N]')
    axes[0, 0].legend(fontsize=7)
    report.figure(
        'maneuver',
        picture,
        "Velocity, step size, trajectory and lateral force of the front left tire (the chapter's figures 4a to 4d)",
    )

    picture, axes = figure(9.0, 3.6, 1, 2)
    judged = {name: r for name, r in runs.items() if r.figures and len(r.t) > 10}
    for k, (name, r) in enumerate(judged.items()):
        n = min(len(r.t), len(truth.run.t))
        look: dict[str, Any] = {'lw': 1.0, 'color': COLOURS[k % len(COLOURS)], 'ls': '-' if k < len(COLOURS) else ':'}
        axes[0, 0].semilogy(r.t[1:n], np.hypot(*(r.place[:n] - truth.run.place[:n]).T)[1:] + 1e-9, label=name, **look)
        axes[0, 1].semilogy(
            r.t[1:n:10], _worst(np.abs(r.forces[:n] - truth.run.forces[:n])[1:, 0, 1])[::10] + 1e-6, **look
        )
    axes[0, 0].fill_between(
        truth.run.t[1:], 1e-9, np.hypot(*truth.band['place'].T)[1:] + 1e-9, color='#dddddd', label='band'
    )
    axes[0, 0].set(xlabel='t [s]', ylabel='distance to the converged place [m]', ylim=(1e-9, 30.0))
    axes[0, 1].set(xlabel='t [s]', ylabel='error of the lateral force, front left, so far [N]', ylim=(1e-6, 1e4))
    picture.legend(loc='outside right upper', fontsize=6)
    report.figure('departures', picture, 'Departures from the converged solution; grey: its band')


SHOWN = (
    'ALF 5 ms',
    'ALF, adaptive',
    'ALF, error control',
    'M-ALF, same penalty',
    'M-ALF 1 ms, fair penalty',
    'BDF 1e-6',
    'IDA 1e-5',
)


def _worst(values: np.ndarray) -> np.ndarray:
    return np.maximum.accumulate(values)
