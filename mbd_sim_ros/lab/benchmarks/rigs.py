"""The car on the rig (rig.py) here and in Exudyn, in turns on one core, each judged against a converged solution of its
own.

MuJoCo is not among them: its closed loops are soft constraints with a time constant of their own, so no converged
solution of it is one of this model.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.batch import warm_up
from mbd_sim_ros.lab.peers.exudyn import exudyn
from mbd_sim_ros.lab.peers.rig import car_on_rig, plain
from solver.errors import SpecError
from solver.scene import Scene
from solver.simulation import Simulation

PROGRAM = Path(__file__).parents[1] / 'peers' / 'exudyn_rig.py'
COUNTERS = ('iterations', 'factorizations')
EVERY = 10  # steps between compared positions
OURS_FINER, EXUDYN_FINER = 16, 8  # how much smaller the step of the converged solution is: its error is 1/256 and 1/64
TIGHT = '1e-8'
OURS: dict[str, tuple[int, dict[str, Any]]] = {  # how much smaller the step is, and other settings
    'as the scene': (1, {}),
    'one iteration': (1, {'mode': 'fixed', 'iterations': 1}),
    'tolerance 1e-8': (1, {'mode': 'tolerance', 'tolerance': 1e-8}),
    'one iteration, half the step': (2, {'mode': 'fixed', 'iterations': 1}),
}
# the fastest of its solvers and Newton methods for this model
SPARSE = {'solver': 'EigenSparse', 'modified': True, 'every_step': False}
EXUDYN: dict[str, dict[str, Any]] = {
    f'tolerance {TIGHT}, Euler parameters': {'tolerance': 1e-8, 'rotations': 'euler', **SPARSE},
    f'tolerance {TIGHT}, rotation vectors': {'tolerance': 1e-8, 'rotations': 'lie', **SPARSE},
    'tolerance 1e-3, Euler parameters': {'tolerance': 1e-3, 'rotations': 'euler', **SPARSE},
}
FIGURES = {
    'ours': 'simulating a millisecond with the fastest of our runs that is accurate enough, or else the most accurate '
    '[us]: median',
    'exudyn': f'the same with the fastest of the runs of Exudyn with tolerance {TIGHT} [us]: median',
    'time_ratio': 'ours over exudyn',
    'our_error': 'largest distance of a centre of mass from our converged solution in that run of ours [um]',
    'exudyn_error': f"the same in the most accurate of Exudyn's runs with tolerance {TIGHT}, from its converged "
    'solution [um]',
    'error_ratio': 'our_error over exudyn_error: a run of ours with at most 1 is accurate enough',
    'apart': 'largest distance of the two converged solutions [um]: how alike the models are',
}


class Peers:
    """Measures one case. steps: of the run that every round repeats.

    Raises SceneError, SpecError or ConsistencyError on construction, SpecError when Exudyn is not installed, StepError
    from round().
    """

    def __init__(self, scene: str, overrides: Sequence[str], steps: int) -> None:
        first = car_on_rig(scene, overrides, duration=1.0)
        self._h = first.integrator.h
        self._scene = dataclasses.replace(first, duration=steps * self._h)
        self._steps = steps
        self._ours = {
            name: Simulation(_with(self._scene, h=self._h / finer, **more)) for name, (finer, more) in OURS.items()
        }
        for simulation in self._ours.values():
            warm_up(simulation)
        self._model = plain(next(iter(self._ours.values()))) | {'every': EVERY * self._h}
        fine = {'h': self._h / EXUDYN_FINER, **next(iter(EXUDYN.values()))}
        self.version, converged = self._exudyn([fine])
        self._exact = np.array(converged[0]['positions'])
        our_fine = Simulation(_with(self._scene, h=self._h / OURS_FINER, mode='tolerance', tolerance=1e-10))
        self._our_exact, _ = self._run(our_fine, OURS_FINER)
        self._runs: dict[tuple[str, str], dict[str, Any]] = {}

    def _exudyn(self, runs: Sequence[dict[str, Any]]) -> tuple[str, list[dict[str, Any]]]:
        common = {'h': self._h, 'duration': self._scene.duration, 'rho': self._scene.integrator.rho_inf}
        version, found = exudyn(self._model, [common | run for run in runs], PROGRAM)
        for result in found:
            if 'error' in result:
                raise SpecError(f'Exudyn: {result["error"]}')
        return version, found

    def _run(self, simulation: Simulation, finer: int = 1) -> tuple[np.ndarray, float]:
        """(positions (instants, bodies, 3), CPU seconds of the steps) of a run from the start."""
        simulation.reset()
        positions, cpu = [simulation.state.q[:-1, :3].copy()], 0.0
        inputs = np.zeros((EVERY * finer, 0))
        for _ in range(self._steps // EVERY):
            begin = time.thread_time()
            simulation.advance(len(inputs), inputs, audit=False)
            cpu += time.thread_time() - begin
            positions.append(simulation.state.q[:-1, :3].copy())
        return np.array(positions), cpu

    def round(self, _: int) -> None:
        """All runs of all programs once."""
        for name, simulation in self._ours.items():
            finer = OURS[name][0]
            positions, cpu = self._run(simulation, finer)
            audit = simulation.totals()
            counters = {key: audit[key] / (finer * self._steps) for key in COUNTERS}
            self._note('mbd_sim_ros', name, simulation.h, cpu, _distance(positions, self._our_exact), counters)
        for name, found in zip(EXUDYN, self._exudyn(list(EXUDYN.values()))[1], strict=True):
            error = _distance(np.array(found['positions']), self._exact)
            self._note(
                f'Exudyn {self.version}', name, self._h, found['cpu'], error, {key: found[key] for key in COUNTERS}
            )

    def _note(
        self, program: str, settings: str, h: float, cpu: float, error: float, counters: dict[str, float]
    ) -> None:
        run = self._runs.setdefault((program, settings), {'h': h, 'us': [], 'error': error * 1e6, **counters})
        run['us'].append(cpu / self._scene.duration * 1e3)

    def close(self) -> None:
        """Nothing to end."""

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case; runs: every run."""
        runs = [
            {'program': program, 'settings': settings, **run, 'us': float(np.median(run['us']))}
            for (program, settings), run in self._runs.items()
        ]
        tight = [run for run in runs if run['program'] != 'mbd_sim_ros' and TIGHT in run['settings']]
        fastest, accurate = min(tight, key=lambda run: run['us']), min(tight, key=lambda run: run['error'])
        mine = [run for run in runs if run['program'] == 'mbd_sim_ros']
        enough = [run for run in mine if run['error'] <= accurate['error']]
        ours = min(enough, key=lambda run: run['us']) if enough else min(mine, key=lambda run: run['error'])
        values = (
            ours['us'], fastest['us'], ours['us'] / fastest['us'], ours['error'], accurate['error'],
            ours['error'] / accurate['error'],
            _distance(self._our_exact, self._exact) * 1e6,
        )  # fmt: skip
        return {'h': self._h, 'steps': self._steps, 'runs': runs, 'figures': dict(zip(FIGURES, values, strict=True))}


def _with(scene: Scene, **settings: Any) -> Scene:
    return dataclasses.replace(scene, integrator=dataclasses.replace(scene.integrator, **settings))


def _distance(a: np.ndarray, b: np.ndarray) -> float:
    """Largest distance of a body between two runs [m]."""
    return float(np.linalg.norm(a - b, axis=2).max())
