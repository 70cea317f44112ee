"""Growth of the time and the memory of a step with the number of bodies of a scene."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbd_sim_ros.batch import warm_up
from solver import simulation_of
from solver.files.scene import load_scene

BATCH = 100  # steps per call
LIMIT = 1.1  # exponent
FIGURES = {
    'step': 'advance(100, audit=False), per step [us]: median',
    'step_per_body': 'the same per body [us]',
    'memory': 'all arrays of model, state and step [kB]',
    'memory_per_body': 'the same per body [kB]',
}


class Growth:
    """Measures one size. Raises SceneError, SpecError or ConsistencyError on construction, StepError from round()."""

    def __init__(self, scene: str, overrides: Sequence[str]) -> None:
        self.simulation = simulation_of(load_scene(scene, overrides))
        warm_up(self.simulation)
        self._times: list[int] = []

    def round(self, steps: int) -> None:
        """Some batches; back to the start when the scene ends."""
        simulation = self.simulation
        for _ in range(max(1, steps // BATCH)):
            if simulation.k + BATCH > simulation.scene.steps:
                simulation.reset()
            inputs = simulation.source.table(simulation.k, BATCH)
            begin = time.thread_time_ns()
            simulation.advance(BATCH, inputs, audit=False)
            self._times.append(time.thread_time_ns() - begin)

    def close(self) -> None:
        """Nothing to end."""

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case."""
        simulation = self.simulation
        bodies, step = simulation.model.n_bodies, float(np.median(self._times)) / BATCH * 1e-3
        memory = simulation.nbytes * 1e-3
        values = (step, step / bodies, memory, memory / bodies)
        return {
            'h': simulation.h,
            'bodies': bodies,
            'rows': simulation.model.n_rows,
            'figures': dict(zip(FIGURES, values, strict=True)),
        }


def exponents(cases: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Exponents of the number of bodies for every scene of several sizes: fitted to all sizes, and between the two
    largest."""
    found = []
    for scene in dict.fromkeys(case['scene'] for case in cases):
        sizes = sorted((case for case in cases if case['scene'] == scene), key=lambda case: case['bodies'])
        n = np.log([case['bodies'] for case in sizes])
        if len(n) < 2:
            continue
        row: dict[str, Any] = {'scene': scene, 'smallest': sizes[0]['bodies'], 'largest': sizes[-1]['bodies']}
        for figure in ('step', 'memory'):
            y = np.log([case['figures'][figure] for case in sizes])
            row[figure] = float(np.polyfit(n, y, 1)[0])
            row[f'{figure}_at_last'] = float((y[-1] - y[-2]) / (n[-1] - n[-2]))
        row['met'] = bool(row['step'] <= LIMIT and row['memory'] <= LIMIT)
        found.append(row)
    return found
