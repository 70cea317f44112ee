"""N four-bar linkages here, in Exudyn and in MuJoCo, in turns on one core, all judged against one exact solution.

All cranks stay parallel, so the linkage moves as one pendulum: with N + 1 cranks that turn and N rods that only
translate, all of length l and mass m, ((N + 1)/3 + N) l phi'' = -((N + 1)/2 + N) g cos(phi). It passes singular
positions, the horizontal ones, on the way. Here it is a model in space, with redundant constraints; in Exudyn one of
planar bodies, without; in MuJoCo a tree of hinges whose loops are closed by soft constraints: what each of them would
be used for, and what is fastest there. A program that is not installed is left out.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from mbd_sim_ros.batch import warm_up
from mbd_sim_ros.lab.peers.exudyn import exudyn, mujoco, planar
from solver.errors import MbdError, SpecError
from solver.files.scene import load_scene
from solver.simulation import Simulation

MUJOCO_PROGRAM = Path(__file__).parents[1] / 'peers' / 'mujoco_linkage.py'
EVERY = 0.1  # s between instants that are compared
STEPS = (5e-4, 1e-3, 2e-3, 5e-3, 1e-2)  # s
OURS: dict[str, dict[str, Any]] = {
    'two iterations': {'mode': 'fixed', 'iterations': 2},
    'to tolerance': {'mode': 'tolerance'},
}
# The sparse solver and a matrix in every step: otherwise it stops at singular positions or takes longer. Smaller
# tolerances cost more for the same error.
EXUDYN: dict[str, dict[str, Any]] = {
    'tolerance 1e-3': {'tolerance': 1e-3, 'rho': 0.8, 'solver': 'EigenSparse', 'every_step': True},
}
# Beside what it takes by itself: the hardest constraints it has, with the shortest time constant it takes and little
# damping, in four integrator. Newton and the sparse matrix are the fastest there.
SOFT = {'solref': (0.02, 1.0), 'solimp': (0.9, 0.95, 0.001, 0.5, 2.0)}
HARD = (0.9999, 0.9999, 0.001, 0.5, 2.0)  # solimp
MUJOCO: dict[str, tuple[str, float]] = {  # integrator and damping ratio, 0: soft constraints
    'Euler, constraints as they come': ('EULER', 0.0),
    'Euler, half damped': ('EULER', 0.5),
    'implicit, half damped': ('IMPLICIT', 0.5),
    'discrete, fifth damped': ('DISCRETE', 0.2),
    'Runge-Kutta, fifth damped': ('RK4', 0.2),
}
PROGRAMS = {'ours': 'mbd_sim_ros', 'exudyn': 'Exudyn', 'mujoco': 'MuJoCo'}
BOUNDS = {'1mm': 1e3, '01mm': 1e2}  # um
FIGURES = {
    f'{program}_{name}': (
        f'simulating a millisecond with the fastest run of {title} whose error is at most '
        f'{bound * 1e-3:g} mm [us]: median'
    )
    for name, bound in BOUNDS.items()
    for program, title in PROGRAMS.items()
}


class LinkageRun(NamedTuple):
    """Result of one run: places (instants, bodies, x y phi) of the centres of mass, and CPU time [s] of the steps."""

    places: np.ndarray
    cpu: float


class Linkage:
    """Measures one case of the scene four_bar_n over `instants` times EVERY.

    Raises SceneError, SpecError or ConsistencyError on construction. An error of a run is a result: it failed.
    """

    def __init__(self, scene: str, overrides: Sequence[str], instants: int) -> None:
        first = load_scene(scene, overrides)
        if not any(body.name == 'crank_0' for body in first.model.bodies):
            raise SpecError(
                f'scene {scene!r}: measure linkage knows the exact solution of four_bar_n alone; name that scene'
            )
        self._times = EVERY * np.arange(1, instants + 1)
        self._ours: dict[tuple[str, float], Simulation] = {}
        for name, settings in OURS.items():
            for h in STEPS:
                simulation = Simulation(
                    dataclasses.replace(first, integrator=dataclasses.replace(first.integrator, h=h, **settings))
                )
                warm_up(simulation)
                self._ours[name, h] = simulation
        self._start = next(iter(self._ours.values()))
        self._model = planar(self._start, self._times)
        self._exact = exact(self._model, self._times)
        self._found: dict[tuple[str, str, float], dict[str, Any]] = {}
        self._left_out: dict[str, str] = {}

    def round(self, _: int) -> None:
        """All runs of all programs once."""
        for (name, h), simulation in self._ours.items():
            try:
                self._note('mbd_sim_ros', name, h, self._run(simulation))
            except MbdError as error:
                self._note('mbd_sim_ros', name, h, str(error))
        for program, peer in (('Exudyn', self._exudyn), ('MuJoCo', self._mujoco)):
            if program in self._left_out:
                continue
            try:
                version, runs = peer()
                for name, h, run in runs:
                    self._note(f'{program} {version}', name, h, run)
            except SpecError as error:
                self._left_out[program] = str(error)

    def _run(self, simulation: Simulation) -> LinkageRun:
        simulation.reset()
        each = round(EVERY / simulation.h)
        places, cpu = [], 0.0
        for _ in self._times:
            begin = time.thread_time()
            simulation.advance(each, audit=False)
            cpu += time.thread_time() - begin
            q = simulation.state.q[:-1]
            places.append(np.column_stack((q[:, :2], 2.0 * np.arctan2(q[:, 5], q[:, 6]))))
        return LinkageRun(np.array(places), cpu)

    def _exudyn(self) -> tuple[str, list[tuple[str, float, LinkageRun | str]]]:
        """(version, (settings, step, result or what went wrong) of every run)."""
        wanted = [(name, h, {'h': h, **settings}) for name, settings in EXUDYN.items() for h in STEPS]
        version, found = exudyn(self._model, [settings for *_, settings in wanted])
        start = np.array([[body[key] for key in ('x', 'y', 'phi')] for body in self._model['bodies']])

        def run(result: dict[str, Any]) -> LinkageRun | str:
            return result.get('error') or LinkageRun(
                start + np.array(result['values']).reshape(-1, *start.shape), result['cpu']
            )

        return version, [(name, h, run(result)) for (name, h, _), result in zip(wanted, found, strict=True)]

    def _mujoco(self) -> tuple[str, list[tuple[str, float, LinkageRun | str]]]:
        wanted = [(name, h, soft_constraints(name, h)) for name in MUJOCO for h in STEPS]
        version, found = mujoco(self._model, [settings for *_, settings in wanted], MUJOCO_PROGRAM)
        pairs = zip(wanted, found, strict=True)
        return version, [
            (name, h, result.get('error') or LinkageRun(np.array(result['values']), result['cpu']))
            for (name, h, _), result in pairs
        ]

    def _note(self, program: str, settings: str, h: float, run: LinkageRun | str) -> None:
        found = self._found.setdefault((program, settings, h), {'us': [], 'error': None, 'gap': None, 'failed': ''})
        if isinstance(run, str):
            found['failed'] = run
            return
        found['us'].append(run.cpu / self._times[-1] * 1e3)
        found['error'] = 1e6 * float(np.linalg.norm((run.places - self._exact)[..., :2], axis=-1).max())
        found['gap'] = 1e6 * gap(self._model, run.places)

    def close(self) -> None:
        """Nothing to end."""

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case; runs: every run; left_out: a sentence for every program
        that is not there."""
        runs = [
            {
                'program': program,
                'settings': settings,
                'h': h,
                **found,
                'us': None if found['failed'] else float(np.median(found['us'])),
            }
            for (program, settings, h), found in self._found.items()
        ]
        figures = {}
        for name, bound in BOUNDS.items():
            for key, program in PROGRAMS.items():
                enough = [
                    run['us']
                    for run in runs
                    if run['program'].startswith(program) and not run['failed'] and run['error'] <= bound
                ]
                figures[f'{key}_{name}'] = min(enough, default=None)
        model = self._start.model
        return {
            'bodies': model.n_bodies,
            'rows': model.n_rows,
            'simulated': float(self._times[-1]),
            'runs': runs,
            'left_out': list(self._left_out.values()),
            'figures': figures,
        }


def soft_constraints(name: str, h: float) -> dict[str, Any]:
    """Settings of a run of MuJoCo with steps of h [s]."""
    integrator, damping = MUJOCO[name]
    return {'h': h, 'integrator': integrator} | ({'solref': (2.0 * h, damping), 'solimp': HARD} if damping else SOFT)


def exact(model: dict[str, Any], times: np.ndarray) -> np.ndarray:
    """(instants, bodies, x y phi) of all centres of mass, from the state of a planar four_bar_n (study.peers.planar) at
    t = 0."""
    bodies, crank = model['bodies'], model['bodies'][0]
    n = len(bodies) // 2  # crank_0, rod_1, crank_1, ... rod_n, crank_n
    length = 2.0 * float(np.hypot(crank['x'], crank['y']))
    rate = -model['gravity'] / length * ((n + 1) / 2 + n) / ((n + 1) / 3 + n)
    solution = solve_ivp(
        lambda t, y: (y[1], -rate * np.cos(y[0])),
        (0.0, times[-1]), (crank['phi'], crank['w']), method='DOP853', rtol=1e-12, atol=1e-12, t_eval=times,
    )  # fmt: skip
    # of a crank from its foot
    end = length * np.stack((np.cos(solution.y[0]), np.sin(solution.y[0]), np.zeros(len(times))), axis=1)
    places = np.empty((len(times), len(bodies), 3))
    for k in range(n + 1):
        places[:, 2 * k] = 0.5 * end + [k * length, 0.0, 0.0]
        places[:, 2 * k, 2] = solution.y[0]
    for k in range(n):
        places[:, 2 * k + 1] = end + [(k + 0.5) * length, 0.0, 0.0]
    return places


def gap(model: dict[str, Any], places: np.ndarray) -> float:
    """Largest distance of the two points of a revolute at any instant [m]."""

    def point(body: int, at: Sequence[float]) -> np.ndarray:
        if body < 0:
            return np.array(at)
        x, y, phi = places[:, body].T
        return np.stack(
            (x + np.cos(phi) * at[0] - np.sin(phi) * at[1], y + np.sin(phi) * at[0] + np.cos(phi) * at[1]), axis=1
        )

    return max(float(np.linalg.norm(point(a, p) - point(b, q), axis=1).max()) for a, p, b, q in model['revolutes'])
