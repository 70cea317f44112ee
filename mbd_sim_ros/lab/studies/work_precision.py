"""Error against CPU time and counters, down to 1e-8: our step, reference integrators, Exudyn, and MuJoCo on open
chains; six problems.

The results of a problem are kept in out/problems as long as neither the solver nor this file changes: an interrupted
study goes on with the problem it was in.
"""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_sim_ros import interrupts
from mbd_sim_ros.lab.peers import exudyn as peers
from mbd_sim_ros.lab.studies import Progress, crank, precision_report
from mbd_sim_ros.lab.studies.crank_history import START
from mbd_sim_ros.lab.studies.precision_report import Point
from mbd_sim_ros.lab.studies.report import Report
from solver import simulation_of
from solver.disk import Store, digest, sources
from solver.errors import MbdError, SpecError
from solver.files.scene import load_scene
from solver.scene import Scene
from solver.step.work import scheme_parameters

SUMMARY = 'error against CPU time and counters: ALF, M-ALF, BDF, Radau, IDA, Exudyn and MuJoCo on six problems'
BUDGET, QUICK_BUDGET = 8.0, 1.0  # s of CPU for one run; what takes longer is left out
# of our runs and those of Exudyn and MuJoCo, the shortest counts; what takes longer [s] is run once
REPEATS, LONG = 3, 1.0
TIGHT, TIGHTER = 1e-11, 1e-13  # tolerances of the reference solution; their difference is its error estimate
EXUDYN, MUJOCO = 'Exudyn', 'MuJoCo'
MUJOCO_PROGRAM = Path(peers.__file__).with_name('mujoco_linkage.py')
EXUDYN_STEPS = 50_000  # no run of Exudyn has more


class Problem(NamedTuple):
    """One problem: the scene, the coordinate that is looked at, and when; steps are intervals / divisions."""

    name: str
    scene: str
    joint: str
    unit: str
    duration: float  # s
    intervals: int
    divisions: tuple[int, ...]
    overrides: tuple[str, ...] = ()  # of the scene
    chain: bool = False  # an open one: no loops


FINE = (2500, 5000, 12500, 31250)  # further divisions, for what is below engineering accuracy
PROBLEMS = (
    Problem(
        'regular slider-crank',
        'slider_crank_regular',
        'slide',
        'm',
        5.0,
        20,
        (5, 10, 25, 50, 100, 250, 500, 1000, *FINE),
    ),
    Problem('singular slider-crank', 'slider_crank', 'slide', 'm', 5.0, 20, (20, 25, 50, 100, 250, 500, 1000, *FINE)),
    Problem(
        'pendulum',
        'pendulum',
        'pivot',
        'rad',
        10.0,
        20,
        (10, 20, 50, 100, 250, 500, 1000, 2000, 5000, 20000, 50000),
        chain=True,
    ),
    Problem(
        'double pendulum',
        'chain',
        'A1',
        'rad',
        2.0,
        20,
        (5, 10, 20, 50, 100, 250, 500, 1000, *FINE),
        ('mechanism.links=2',),
        True,
    ),
    Problem(
        'chain of ten rods', 'chain', 'A1', 'rad', 1.0, 20, (5, 10, 20, 50, 100, 250, 500, 1000, 2500, 5000), (), True
    ),
    Problem("Andrews' squeezer", 'andrews', 'O', 'rad', 0.03, 10, (30, 60, 120, 300, 600, 1200, 3000, 10000, 30000)),
)
OURS: dict[str, dict[str, Any]] = {
    'ALF': crank.DAMPED,
    'ALF, conserving': crank.CONSERVING,
    'ALF, one iteration': {'iterations': 1},
    'ALF, order four': {'order': 4, 'rho_inf': 1.0, 'iterations': 3},
}
# evaluations (and factorizations of its mass matrix) of a step
MUJOCO_INTEGRATORS = {'RK4': 4, 'IMPLICIT': 1, 'IMPLICITFAST': 1}
MUJOCO_FIRST = (1, 2, 4)  # divisions before those of a problem
LEAST_INERTIA = 1e-12  # kg m^2: MuJoCo takes no point masses
M_ALF = 'M-ALF'
REFERENCES = {'BDF': 'reference_bdf', 'Radau': 'reference_radau', 'IDA': 'reference_ida'}
QUICK = ('regular slider-crank', 'double pendulum')
TOLERANCES, QUICK_TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9), (1e-4,)


def study(out: Path, *, quick: bool, progress: Progress) -> dict:
    """Run every method on every problem and judge who is on the front."""
    problems = (
        [p._replace(duration=p.duration / 5, intervals=p.intervals // 5) for p in PROBLEMS if p.name in QUICK]
        if quick
        else PROBLEMS
    )
    report = Report(out, 'Work and precision')
    report.text(*precision_report.INTRODUCTION)
    kept = Store(out / 'problems')
    points: list[Point] = []
    notes: list[str] = []
    references = []
    for k, problem in enumerate(problems):
        interrupts.check()
        name = f'{digest(sources(), sources(Path(__file__)), repr((problem, quick))).hex()}.json'
        content = kept.read(name)
        if content is None:
            found = _solved(problem, quick, lambda text, part, k=k: progress(text, (k + part) / len(problems)))  # type: ignore[misc]
            if not found['notes']:  # a peer that is missing may be there the next time
                kept.write(name, json.dumps(found).encode())
        else:
            found = json.loads(content)
        points += [Point(**point) for point in found['points']]
        notes += found['notes']
        references.append(
            {'problem': problem.name, 'reference': _reference_name(problem), 'error estimate': found['estimate']}
        )
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


def _solved(problem: Problem, quick: bool, progress: Progress) -> dict[str, Any]:
    """Every method on one problem: points as dictionaries, notes and the error estimate of the reference."""
    points: list[Point] = []
    notes: list[str] = []
    progress(f'{problem.name}: reference', 0.0)
    # the start of the scene has the slider's own energy beside the chapter's; the reference has the chapter's
    crank_scene = problem.scene == 'slider_crank'
    scene = crank.scene_at(START, crank.STEPS[-1], {}) if crank_scene else load_scene(problem.scene, problem.overrides)
    instants = problem.duration * np.arange(1, problem.intervals + 1) / problem.intervals
    exact, estimate = _reference(problem, scene, instants)
    divisions = problem.divisions[1:4:2] if quick else problem.divisions
    repeats, budget = (1, QUICK_BUDGET) if quick else (REPEATS, BUDGET)
    for done, (method, setting, chosen) in enumerate(_ours(problem, scene, divisions)):
        progress(f'{problem.name}: {method}, {setting}', 0.1 + 0.4 * done / (len(divisions) * (len(OURS) + 1)))
        points.append(_run(problem, method, setting, chosen, exact, repeats, budget))
    for method, kind in REFERENCES.items():
        for tolerance in QUICK_TOLERANCES if quick else TOLERANCES:
            progress(f'{problem.name}: {method} {tolerance:g}', 0.6)
            chosen = _with(scene, kind=kind, tolerance=tolerance, h=problem.duration / problem.intervals)
            try:
                point = _run(problem, method, f'tolerance {tolerance:g}', chosen, exact, 1, budget)
            except SpecError as error:  # the package is not there
                notes.append(f'{method} is left out: {error}.')
                break
            points.append(point)
            if point.outcome == 'over the budget':
                break
    progress(f'{problem.name}: {EXUDYN} and {MUJOCO}', 0.8)
    for found in (_exudyn, *([_mujoco] if problem.chain else [])):
        try:
            points += found(problem, scene, instants, exact, divisions, repeats)
        except SpecError as error:
            notes.append(f'{error}.')
    return {'points': [point._asdict() for point in points], 'notes': notes, 'estimate': estimate}


def _with(scene: Scene, **settings: Any) -> Scene:
    return dataclasses.replace(scene, integrator=type(scene.integrator)(**settings))


def _reference_name(problem: Problem) -> str:
    if problem.scene == 'slider_crank':
        return f'equation of motion of one coordinate, DOP853 to {TIGHTER:g}'
    return f'dense KKT, DOP853 to {TIGHTER:g}; estimate from {TIGHT:g}'


def _reference(problem: Problem, scene: Scene, instants: np.ndarray) -> tuple[np.ndarray, float]:
    """(change of the coordinate since t = 0 at the instants, estimate of its error)."""
    if problem.scene == 'slider_crank':
        x = 2 * np.cos(crank.exact_angles(np.array([START]), crank.slider_mass(), instants, tolerance=TIGHTER)[0])
        coarse = 2 * np.cos(crank.exact_angles(np.array([START]), crank.slider_mass(), instants, tolerance=1e-11)[0])
        return x - 2 * np.cos(START), float(np.abs(x - coarse).max())
    found = []
    for tolerance in (TIGHT, TIGHTER):
        values, _, _ = _values(
            problem, _with(scene, kind='reference_kkt', tolerance=tolerance, h=problem.duration / problem.intervals)
        )
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
        # what the default penalty is, on average
        fair = min(1e15, 1e6 * mass / (scheme_parameters(h, rho)['beta'] * h * h))
        yield M_ALF, f'h {h * 1e3:g} ms', _with(scene, h=h, kind='m_alf', rho_inf=rho, penalty=fair)


def _values(problem: Problem, scene: Scene, budget: float = math.inf) -> tuple[np.ndarray, float, dict[str, float]]:
    """(change of the coordinate at the instants, CPU time [s], audit) of one run. Raises MbdError; TimeoutError above
    the budget."""
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


def _run(
    problem: Problem, method: str, setting: str, scene: Scene, exact: np.ndarray, repeats: int, budget: float
) -> Point:
    cpu = math.inf
    try:
        for _ in range(repeats):
            values, taken, audit = _values(problem, scene, budget)
            cpu = min(cpu, taken)
            if taken > LONG:
                break
    except SpecError:
        raise
    except MbdError as failure:
        return Point(problem.name, method, setting, math.nan, math.nan, 0, 0, f'{failure}')
    except TimeoutError:
        return Point(problem.name, method, setting, math.nan, math.nan, 0, 0, 'over the budget')
    error = float(np.abs(values - exact).max())
    return Point(
        problem.name, method, setting, error, cpu, int(audit['factorizations']), int(audit['evaluations']), 'ok'
    )


def _exudyn(
    problem: Problem, scene: Scene, instants: np.ndarray, exact: np.ndarray, divisions: tuple[int, ...], repeats: int
) -> list[Point]:
    model = peers.planar(simulation_of(_with(scene)), instants, problem.joint)
    steps = [problem.duration / problem.intervals / n for n in divisions if n * problem.intervals <= EXUDYN_STEPS]
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
            Point(
                problem.name,
                method,
                setting,
                error,
                cpu,
                found[0]['factorizations'],
                found[0]['evaluations'],
                f'ok, {rounds[0][0]}',
            )
        )
    return points


def _mujoco(
    problem: Problem, scene: Scene, instants: np.ndarray, exact: np.ndarray, divisions: tuple[int, ...], repeats: int
) -> list[Point]:
    """Its explicit and its implicit integrators on an open chain, which it describes by the angles of its hinges: no
    constraint at all."""
    model = peers.planar(simulation_of(_with(scene)), instants, problem.joint)
    body = model['observe'][0][0]
    for entry in model['bodies']:
        entry['I'] = max(entry['I'], LEAST_INERTIA)
    wanted = [
        {'h': problem.duration / problem.intervals / n, 'integrator': integrator, 'steps': n * problem.intervals}
        for integrator in MUJOCO_INTEGRATORS
        for n in (*MUJOCO_FIRST, *divisions)
    ]
    rounds = [peers.mujoco(model, wanted, MUJOCO_PROGRAM) for _ in range(repeats)]
    points = []
    for settings, *found in zip(wanted, *(results for _, results in rounds), strict=True):
        method, setting = f'{MUJOCO} {settings["integrator"]}', f'h {settings["h"] * 1e3:g} ms'
        failed = next((f['error'] for f in found if 'error' in f), None)
        if failed is not None:
            points.append(Point(problem.name, method, setting, math.nan, math.nan, 0, 0, failed))
            continue
        turned = np.array(found[0]['values'])[:, body, 2] - model['bodies'][body]['phi']
        error = float(np.abs((turned - exact + np.pi) % (2 * np.pi) - np.pi).max())  # it gives angles up to whole turns
        work = MUJOCO_INTEGRATORS[settings['integrator']] * settings['steps']
        points.append(
            Point(problem.name, method, setting, error, min(f['cpu'] for f in found), work, work, f'ok, {rounds[0][0]}')
        )
    return points
