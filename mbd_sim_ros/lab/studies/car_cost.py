"""Error against cost of the full car over step, iterations and rho_inf, all in one picture with the front marked."""

from __future__ import annotations

import dataclasses
import itertools
import math
import statistics
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from mbd_sim_ros.lab.studies import Progress
from mbd_sim_ros.lab.studies.car_runs import CarRun, Converged, converged, departures, follow
from mbd_sim_ros.lab.studies.report import COLOURS, Report, figure
from solver.errors import MbdError
from solver.files.scene import load_scene
from solver.scene import Scene
from solver.simulation import Simulation

SUMMARY = 'the full car in a swept steer: error against cost over step, iterations and rho_inf'
SCENE = 'car_swept_steer'
DURATION, QUICK_DURATION = 3.0, 1.5  # s; the sweep begins at 1 s
STEPS, QUICK_STEPS = (5e-4, 1e-3, 2e-3, 2.5e-3, 5e-3, 1e-2), (1e-3, 5e-3)  # s
ITERATIONS, QUICK_ITERATIONS = (1, 2, 3, 4), (1, 3)
RHOS, QUICK_RHOS = (0.0, 0.5, 0.8, 0.9, 0.95), (0.0, 0.8)
LEVELS, QUICK_LEVELS = (2.5e-4, 1.25e-4, 6.25e-5), (1e-3, 5e-4, 2.5e-4)  # s, of the reference
ROUNDS = 5  # of all settings in turn; the median of a setting counts
ERRORS = {
    'position': ('largest error of the place [mm]', 1e3),
    'tire_force': ('RMS error of a tire force, worst of twelve [% of its peak]', 1e2),
}
COSTS = {
    'cpu': 'CPU time per simulated second [ms/s]',
    'evaluations': 'evaluations of all forces per simulated second [1/s]',
}
MARKERS = {1: 'v', 2: 'o', 3: 's', 4: 'D'}
# Further curves over all steps: settings of the integrator by name
OTHERS: dict[str, dict[str, Any]] = {'to tolerance 1e-4': {'mode': 'tolerance', 'tolerance': 1e-4}}


class Setting(NamedTuple):
    """A point of the map."""

    h: float  # s
    iterations: int  # 0: as `other` says
    rho: float
    other: str = ''

    def __str__(self) -> str:
        how = self.other or f'{self.iterations} it.'
        return f'{1e3 * self.h:g} ms, {how}, rho {self.rho:g}'

    def applied(self, scene: Scene) -> Scene:
        """The scene with these settings, everything else of the integrator by default."""
        chosen = OTHERS[self.other] if self.other else {'iterations': self.iterations}
        return dataclasses.replace(scene, integrator=type(scene.integrator)(h=self.h, rho_inf=self.rho, **chosen))


class Point(NamedTuple):
    """A setting, judged."""

    setting: Setting
    position: float  # m, nan if it failed
    tire_force: float  # part of the peak
    cpu: float  # s per simulated second, of stepping alone
    evaluations: float  # per simulated second
    message: str  # why it failed, or ''


def study(out: Path, *, quick: bool, progress: Progress) -> dict:
    """Run the map, find the fronts, say where the defaults stand."""
    duration = QUICK_DURATION if quick else DURATION
    scene = dataclasses.replace(load_scene(SCENE), duration=duration)
    truth = _reference(scene, duration, QUICK_LEVELS if quick else LEVELS, progress)
    grid = itertools.product(*(QUICK_STEPS, QUICK_ITERATIONS, QUICK_RHOS) if quick else (STEPS, ITERATIONS, RHOS))
    settings = [Setting(*values) for values in grid]
    settings += [Setting(h, 0, 0.8, name) for name in OTHERS for h in (QUICK_STEPS if quick else STEPS)]
    points = _measured(scene, settings, truth, duration, 1 if quick else ROUNDS, progress)
    report = Report(out, 'Error against cost of the full car')
    peak = np.abs(truth.run.forces).max(0)
    bands = {
        'position': float(np.hypot(*truth.band['place'].T).max()),
        'tire_force': float((np.sqrt((truth.band['forces'] ** 2).mean(0)) / peak).max()),
    }
    levels = QUICK_LEVELS if quick else LEVELS
    report.text(
        f'Scene `{SCENE}`, its first {duration:g} s. The reference is extrapolated from runs at '
        f'{_list([1e3 * h for h in levels])} ms (rho_inf 0.8, 4 iterations); its band, the distance to the '
        f'extrapolation from the level before, is {1e3 * bands["position"]:.2g} mm and '
        f'{100 * bands["tire_force"]:.2g} % of a tire force. Errors are the largest distance of the place of the '
        'chassis and the RMS error of the worst of twelve tire forces. Cost is that of stepping alone: CPU time, '
        f'median of {1 if quick else ROUNDS} rounds through all settings in one process, and evaluations of all '
        f'forces. Only differences between settings mean something; the CPU time is that of one machine.'
    )
    fronts = {(e, c): front(points, e, c) for e in ERRORS for c in COSTS}
    _picture(report, points, fronts)
    _fronts(report, fronts)
    defaults = _defaults(report, scene, points, fronts)
    failed = [p for p in points if p.message]
    if failed:
        report.text('## Settings that fail')
        report.table('failed', [{'setting': str(p.setting), 'why': p.message} for p in failed])
    rows = [{**p.setting._asdict(), **dict(zip(Point._fields[1:], p[1:], strict=True))} for p in points]
    report.table('points', rows, shown=False)
    for key in ERRORS:
        smallest = min(getattr(p, key) for p in points if not p.message)
        report.check(
            f'band of the reference over the smallest error, {key.replace("_", " ")}', bands[key] / smallest, 0.3
        )
    report.write()
    return {
        'bands': bands, 'defaults': defaults, 'checks': report.checks,
        'points': rows,
        'fronts': {f'{e}, {c}': [str(p.setting) for p in found] for (e, c), found in fronts.items()},
    }  # fmt: skip


def _list(values: Sequence[float]) -> str:
    return ', '.join(f'{v:g}' for v in values)


def _reference(scene: Scene, duration: float, levels: Sequence[float], progress: Progress) -> Converged:
    runs: list[CarRun] = []
    for k, h in enumerate(levels):
        progress(f'reference, {1e3 * h:g} ms', 0.25 * k / len(levels))
        runs.append(follow(Simulation(Setting(h, 4, 0.8).applied(scene)), f'{1e3 * h:g} ms', duration))
    return converged(runs)


def _measured(
    scene: Scene, settings: Sequence[Setting], truth: Converged, duration: float, rounds: int, progress: Progress
) -> list[Point]:
    """Errors of all settings, then their CPU times, round by round."""
    found: list[tuple[Setting, Simulation | None, dict[str, float], str]] = []
    for k, setting in enumerate(settings):
        progress(str(setting), 0.25 + 0.4 * k / len(settings))
        try:
            simulation = Simulation(setting.applied(scene))
        except MbdError as error:
            found.append((setting, None, {}, str(error)))
            continue
        run = follow(simulation, str(setting), duration)
        errors = departures(run, truth.run, duration)
        evaluations = run.figures['evaluations'] / duration
        found.append(
            (setting, None if run.message else simulation, {**errors, 'evaluations': evaluations}, run.message)
        )
    times: list[list[float]] = [[] for _ in found]
    for turn in range(rounds):
        progress(f'CPU time, round {turn + 1} of {rounds}', 0.65 + 0.35 * turn / rounds)
        for (_, ready, _, _), taken in zip(found, times, strict=True):
            if ready is not None:
                ready.reset()
                begin = time.process_time()
                ready.advance(round(duration / ready.h), audit=False)
                taken.append((time.process_time() - begin) / duration)
    return [
        Point(
            setting,
            errors.get('position', math.nan),
            errors.get('tire_force', math.nan),
            statistics.median(taken) if taken else math.nan,
            errors.get('evaluations', math.nan),
            message,
        )
        for (setting, _, errors, message), taken in zip(found, times, strict=True)
    ]


def front(points: Sequence[Point], error: str, cost: str) -> list[Point]:
    """The settings for which no other is as cheap and more accurate, the cheapest first."""
    best, least = [], math.inf
    for point in sorted((p for p in points if not p.message), key=lambda p: (getattr(p, cost), getattr(p, error))):
        if getattr(point, error) < least:
            least = getattr(point, error)
            best.append(point)
    return best


def _fronts(report: Report, fronts: dict[tuple[str, str], list[Point]]) -> None:
    for (error, cost), found in fronts.items():
        title, factor = ERRORS[error]
        by = [_counted([p.setting.iterations for p in found if not p.setting.other], '{} of {:g} iterations')]
        by += [_counted([p.setting.rho for p in found], '{} with rho {:g}')]
        report.text(
            f'## Front: {error.replace("_", " ")} over {COSTS[cost].split(" per ")[0]}',
            f'{len(found)} settings: {"; ".join(by)}.',
        )
        report.table(
            f'front_{error}_{cost}',
            [
                {
                    'setting': str(p.setting),
                    COSTS['cpu']: 1e3 * p.cpu,
                    COSTS['evaluations']: p.evaluations,
                    title: factor * getattr(p, error),
                }
                for p in found
            ],
        )


def _counted(values: Sequence[float], text: str) -> str:
    return ', '.join(text.format(values.count(value), value) for value in sorted(set(values)))


def _defaults(
    report: Report, scene: Scene, points: Sequence[Point], fronts: dict[tuple[str, str], list[Point]]
) -> list[dict[str, Any]]:
    """Standing of the settings of the scene and of the default ones: the cheapest point on the front that is as
    accurate."""
    own = type(scene.integrator)()
    wanted = {
        'the scene': Setting(scene.integrator.h, scene.integrator.iterations, scene.integrator.rho_inf),
        'the default': Setting(own.h, own.iterations, own.rho_inf),
    }
    rows = []
    for name, setting in wanted.items():
        point = next((p for p in points if p.setting == setting and not p.message), None)
        if point is None:
            continue
        for (error, cost), found in fronts.items():
            rival = next(p for p in found if getattr(p, error) <= getattr(point, error))
            rows.append(
                {
                    'settings of': f'{name} ({setting})', 'error': error.replace('_', ' '),
                    'cost': COSTS[cost].split(' per ')[0],
                    'as accurate on the front': str(rival.setting), 'costs times as '
                        'much': getattr(point, cost) / getattr(rival, cost),
                }
            )  # fmt: skip
    report.text(
        '## The defaults against the front',
        'The cheapest setting that is at least as accurate, and how many times its cost ours is.',
    )
    if rows:
        report.table('defaults', rows)
    return rows


def _picture(report: Report, points: Sequence[Point], fronts: dict[tuple[str, str], list[Point]]) -> None:
    new, axes = figure(13.0, 9.5, len(ERRORS), len(COSTS), sharey='row', sharex='col')
    good = [p for p in points if not p.message]
    steps = sorted({p.setting.h for p in good})
    rhos = sorted({p.setting.rho for p in good})
    for row, (error, (title, factor)) in enumerate(ERRORS.items()):
        for column, (cost, label) in enumerate(COSTS.items()):
            ax, scale = axes[row, column], 1e3 if cost == 'cpu' else 1.0
            for p in good:
                ax.loglog(
                    scale * getattr(p, cost), factor * getattr(p, error), MARKERS.get(p.setting.iterations, '*'),
                    ms=3.0 + 1.2 * rhos.index(p.setting.rho), color=COLOURS[steps.index(p.setting.h)], alpha=0.75,
                    mew=0.4, mec='white',
                )  # fmt: skip
            best = fronts[error, cost]
            ax.loglog(
                [scale * getattr(p, cost) for p in best],
                [factor * getattr(p, error) for p in best],
                '-',
                color='black',
                lw=0.9,
                zorder=1,
            )
            last = math.inf
            for p in best:
                place = factor * getattr(p, error)
                if last / place > 1.6:  # names that would lie on each other are left to the table
                    ax.annotate(
                        str(p.setting),
                        (scale * getattr(p, cost), place),
                        xytext=(-4, -3),
                        textcoords='offset points',
                        fontsize=5.5,
                        ha='right',
                        va='top',
                    )
                    last = place
            ax.set_ylim(bottom=0.3 * factor * min(getattr(p, error) for p in good))
            left, right = ax.get_xlim()
            ax.set_xlim(0.45 * left, right)
            ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            ax.xaxis.set_major_formatter(StrMethodFormatter('{x:g}'))
            ax.xaxis.set_minor_formatter(NullFormatter())
            if row == len(ERRORS) - 1:
                ax.set_xlabel(label)
            if column == 0:
                ax.set_ylabel(title)
    handles = [axes[0, 0].plot([], [], 'o', color=COLOURS[k], label=f'{1e3 * h:g} ms')[0] for k, h in enumerate(steps)]
    handles += [
        axes[0, 0].plot([], [], m, color='#555555', label='1 iteration' if n == 1 else f'{n} iterations')[0]
        for n, m in MARKERS.items()
    ]
    handles += [axes[0, 0].plot([], [], '*', color='#555555', label=name)[0] for name in OTHERS]
    handles += [
        axes[0, 0].plot([], [], 'o', color='#555555', ms=3.0 + 1.2 * k, label=f'rho {rho:g}')[0]
        for k, rho in enumerate(rhos)
    ]
    handles += [axes[0, 0].plot([], [], '-', color='black', label='front')[0]]
    new.legend(handles=handles, loc='outside right upper', fontsize=7)
    report.figure('front', new, 'Error against cost of every setting; black: the front, its settings named')
