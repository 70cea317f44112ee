"""Error against CPU time and against counters, for our step, for the reference integrators and for Exudyn, on four problems."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_sim_ros.lab.peers import exudyn as peers
from mbd_sim_ros.lab.studies import Progress, crank, precision_report
from mbd_sim_ros.lab.studies.crank_history import START
from mbd_sim_ros.lab.studies.report import Report
from solver import simulation_of
from solver.errors import MbdError, SpecError
from solver.files.scene import load_scene
from solver.scene import Scene
from solver.step.work import scheme_parameters

SUMMARY = 'error against CPU time and counters: ALF, M-ALF, BDF, Radau, IDA and Exudyn on four problems'
BUDGET, QUICK_BUDGET = 10.0, 2.0  # s of CPU for one run of a reference integrator; what takes longer is left out
REPEATS = 3  # of our runs and those of Exudyn; the shortest counts
TIGHT, TIGHTER = 1e-10, 1e-12  # tolerances of the reference solution; their difference is its error estimate
EXUDYN = 'Exudyn'


class Problem(NamedTuple):
    """One problem: the scene, the coordinate that is looked at, and when; steps are intervals / divisions."""

    name: str
    scene: str
    joint: str
    unit: str
    duration: float  # s
    intervals: int
    divisions: tuple[int, ...]


PROBLEMS = (
    Problem('regular slider-crank', 'slider_crank_regular', 'slide', 'm', 5.0, 20, (5, 10, 25, 50, 100, 250, 500, 1000)),
    Problem('singular slider-crank', 'slider_crank', 'slide', 'm', 5.0, 20, (20, 25, 50, 100, 250, 500, 1000)),
    Problem('pendulum', 'pendulum', 'pivot', 'rad', 10.0, 20, (10, 20, 50, 100, 250, 500, 1000, 2000)),
    Problem("Andrews' squeezer", 'andrews', 'O', 'rad', 0.03, 10, (30, 60, 120, 300, 600, 1200, 3000)),
)
OURS: dict[str, dict[str, Any]] = {
    'ALF': crank.DAMPED,
    'ALF, conserving': crank.CONSERVING,
    'ALF, one iteration': {'iterations': 1},
}
M_ALF = 'M-ALF'
REFERENCES = {'BDF': 'reference_bdf', 'Radau': 'reference_radau', 'IDA': 'reference_ida'}
TOLERANCES, QUICK_TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6), (1e-4,)


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


def study(out: Path, *, quick: bool, progress: Progress) -> dict:
    """Run every method on every problem and judge who is on the front."""
    first = PROBLEMS[0]
    problems = (first._replace(duration=first.duration / 5, intervals=first.intervals // 5),) if quick else PROBLEMS
    report = Report(out, 'Work and precision')
    report.text(*precision_report.INTRODUCTION)
    points: list[Point] = []
    notes: list[str] = []
    references = []
    for k, problem in enumerate(problems):
        share = lambda part, k=k: (k + part) / len(problems)  # noqa: E731
        progress(f'{problem.name}: reference', share(0.0))
        # the start of the scene has the slider's own energy beside the chapter's; the reference has the chapter's
        scene = crank.scene_at(START, crank.STEPS[-1], {}) if problem.scene == 'slider_crank' else load_scene(problem.scene)
        instants = problem.duration * np.arange(1, problem.intervals + 1) / problem.intervals
        exact, estimate = _reference(problem, scene, instants)
        references.append({'problem': problem.name, 'reference': _reference_name(problem), 'error estimate': estimate})
        divisions = problem.divisions[1:4:2] if quick else problem.divisions
        for done, (method, setting, chosen) in enumerate(_ours(problem, scene, divisions)):
            progress(f'{problem.name}: {method}', share(0.1 + 0.02 * done))
            points.append(_run(problem, method, setting, chosen, exact, 1 if quick else REPEATS, math.inf))
        for method, kind in REFERENCES.items():
            for tolerance in QUICK_TOLERANCES if quick else TOLERANCES:
                progress(f'{problem.name}: {method} {tolerance:g}', share(0.6))
                chosen = _with(scene, kind=kind, tolerance=tolerance, h=problem.duration / problem.intervals)
                try:
                    point = _run(problem, method, f'tolerance {tolerance:g}', chosen, exact, 1, QUICK_BUDGET if quick else BUDGET)
                except SpecError as error:  # the package is not there
                    notes.append(f'{method} is left out: {error}.')
                    break
                points.append(point)
                if point.outcome == 'over the budget':
                    break
        progress(f'{problem.name}: {EXUDYN}', share(0.9))
        try:
            points += _exudyn(problem, scene, instants, exact, divisions, 1 if quick else REPEATS)
        except SpecError as error:
            notes.append(f'{error}.')
    report.table('references', references)
    report.text(*dict.fromkeys(notes))
    report.table('points', [point._asdict() for point in points], shown=False)
    fronts = precision_report.judge(report, points, [p.name for p in problems], references)
    for problem in problems:
        precision_report.picture(report, problem.name, problem.unit, points)
    report.write()
    return {
        'references': references,
        'points': [point._asdict() for point in points],
        'fronts': fronts,
        'notes': list(dict.fromkeys(notes)),
        'checks': report.checks,
    }


def _with(scene: Scene, **settings: Any) -> Scene:
    return dataclasses.replace(scene, integrator=type(scene.integrator)(**settings))


def _reference_name(problem: Problem) -> str:
    if problem.scene == 'slider_crank':
        return 'equation of motion of one coordinate, DOP853 to 1e-12'
    return f'dense KKT, DOP853 to {TIGHTER:g}; estimate from {TIGHT:g}'


def _reference(problem: Problem, scene: Scene, instants: np.ndarray) -> tuple[np.ndarray, float]:
    """(change of the coordinate since t = 0 at the instants, estimate of its error)."""
    if problem.scene == 'slider_crank':
        x = 2 * np.cos(crank.exact_angles(np.array([START]), crank.slider_mass(), instants)[0])
        coarse = 2 * np.cos(crank.exact_angles(np.array([START]), crank.slider_mass(), instants, tolerance=1e-10)[0])
        return x - 2 * np.cos(START), float(np.abs(x - coarse).max())
    found = []
    for tolerance in (TIGHT, TIGHTER):
        values, _, _ = _values(problem, _with(scene, kind='reference_kkt', tolerance=tolerance, h=problem.duration / problem.intervals))
        found.append(values)
    return found[1], float(np.abs(found[1] - found[0]).max())


def _ours(problem: Problem, scene: Scene, divisions: tuple[int, ...]) -> Iterator[tuple[str, str, Scene]]:
    """(method, setting, scene) of all our runs."""
    rho = 0.8
    masses = [c.m for c in simulation_of(_with(scene)).constraint_coefficients().values()]
    mass = float(np.exp(np.log(masses).mean()))
    for n in divisions:
        h = round(problem.duration / problem.intervals / n * 1e9) * 1e-9
        for method, settings in OURS.items():
            yield method, f'h {h * 1e3:g} ms', _with(scene, h=h, **settings)
        fair = min(1e15, 1e6 * mass / (scheme_parameters(h, rho)['beta'] * h * h))  # what the default penalty is, on average
        yield M_ALF, f'h {h * 1e3:g} ms', _with(scene, h=h, kind='m_alf', rho_inf=rho, penalty=fair)


def _values(problem: Problem, scene: Scene, budget: float = math.inf) -> tuple[np.ndarray, float, dict[str, float]]:
    """(change of the coordinate at the instants, CPU time [s], audit) of one run. Raises MbdError; TimeoutError above the budget."""
    simulation = simulation_of(scene)
    column = simulation.channels.joints.index(problem.joint)
    start = simulation.snapshot().joint_position[column]
    each = round(problem.duration / problem.intervals / simulation.h)
    values = []
    begin = time.process_time()
    for _ in range(problem.intervals):
        values.append(simulation.advance(each, audit=False).joint_position[column] - start)
        if time.process_time() - begin > budget:
            raise TimeoutError
    return np.array(values), time.process_time() - begin, simulation.totals()


def _run(problem: Problem, method: str, setting: str, scene: Scene, exact: np.ndarray, repeats: int, budget: float) -> Point:
    cpu = math.inf
    try:
        for _ in range(repeats):
            values, taken, audit = _values(problem, scene, budget)
            cpu = min(cpu, taken)
    except SpecError:
        raise
    except MbdError as failure:
        return Point(problem.name, method, setting, math.nan, math.nan, 0, 0, f'{failure}')
    except TimeoutError:
        return Point(problem.name, method, setting, math.nan, math.nan, 0, 0, 'over the budget')
    error = float(np.abs(values - exact).max())
    return Point(problem.name, method, setting, error, cpu, int(audit['factorizations']), int(audit['evaluations']), 'ok')


def _exudyn(
    problem: Problem, scene: Scene, instants: np.ndarray, exact: np.ndarray, divisions: tuple[int, ...], repeats: int
) -> list[Point]:
    model = peers.planar(simulation_of(_with(scene)), instants, problem.joint)
    steps = [problem.duration / problem.intervals / n for n in divisions]
    common = {'rho': 0.9, 'solver': 'EXUdense', 'every_step': False}
    wanted = [{'h': h, 'tolerance': tolerance, **common} for h in steps for tolerance in (1e-8, 1e-4)]
    rounds = [peers.exudyn(model, wanted) for _ in range(repeats)]
    points = []
    for settings, *found in zip(wanted, *(results for _, results in rounds), strict=True):
        method = EXUDYN if settings['tolerance'] < 1e-6 else f'{EXUDYN}, loose'
        setting = f'h {settings["h"] * 1e3:g} ms'
        failed = next((f['error'] for f in found if 'error' in f), None)
        if failed is not None:
            points.append(Point(problem.name, method, setting, math.nan, math.nan, 0, 0, failed))
            continue
        error = float(np.abs(np.array(found[0]['values'])[:, 0] - exact).max())
        cpu = min(f['cpu'] for f in found)
        points.append(
            Point(problem.name, method, setting, error, cpu, found[0]['factorizations'], found[0]['evaluations'], f'ok, {rounds[0][0]}')
        )
    return points
