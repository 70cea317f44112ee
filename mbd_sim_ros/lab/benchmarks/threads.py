"""Benchmark of threads: independent simulations, one after the other on one core, and in threads on several cores."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_sim_ros.batch import warm_up
from mbd_sim_ros.lab.benchmarks.machine import on_all_cores
from solver import simulation_of
from solver.files.scene import load_scene
from solver.parallel import advance_all

COUNT = 2  # number of simulations, and of threads
BATCH = 500  # steps in a call
FIGURES = {  # figure of a report -> its explanation
    'serial': f'{COUNT} simulations one after the other, per step of one [us of elapsed time]: median',
    'threads': f'the same in {COUNT} threads, per step of one: median',
    'speedup': 'serial over threads, both of the same moment: median',
}


class Threads:
    """Measures one scene. Raises SceneError, SpecError or ConsistencyError on construction, StepError from round()."""

    def __init__(self, scene: str, overrides: Sequence[str]) -> None:
        self.simulations = [simulation_of(load_scene(scene, overrides)) for _ in range(COUNT)]
        for simulation in self.simulations:
            warm_up(simulation)
        self._times: list[tuple[float, float]] = []  # (serial, in threads) of each batch [s]

    def round(self, steps: int) -> None:
        """Measure `steps` steps in batches; each batch is made one after the other, and again in threads."""
        for _ in range(max(1, steps // BATCH)):
            first = self.simulations[0]
            if first.k + BATCH > first.scene.steps:
                for simulation in self.simulations:
                    simulation.reset()
            saved = first.save()
            t0 = time.perf_counter()
            for simulation in self.simulations:
                simulation.advance(BATCH, audit=False)
            t1 = time.perf_counter()
            for simulation in self.simulations:
                simulation.restore(saved)
            with on_all_cores():
                t2 = time.perf_counter()
                advance_all(self.simulations, BATCH, audit=False, threads=COUNT)
                t3 = time.perf_counter()
            self._times.append((t1 - t0, t3 - t2))

    def close(self) -> None:
        """Nothing is to be closed; every benchmark has this method."""

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case."""
        times = np.array(self._times)
        serial, threads = np.median(times, axis=0) / (COUNT * BATCH) * 1e6
        values = (float(serial), float(threads), float(np.median(times[:, 0] / times[:, 1])))
        return {
            'h': self.simulations[0].h,
            'steps': len(times) * BATCH,
            'figures': dict(zip(FIGURES, values, strict=True)),
        }
