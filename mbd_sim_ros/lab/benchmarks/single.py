"""Single steps as the node makes them, beside an idle loop of the same length: what is late because of the step, and
what because of the machine."""

from __future__ import annotations

import gc
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_sim_ros.batch import warm_up
from solver import simulation_of
from solver.files.scene import load_scene

LATE = 1000.0  # us
CALIBRATION = 200  # steps, and loops
FIGURES = {
    'step_p50': 'advance(1), snapshot included [us]: median',
    'step_p99': '99th percentile of the same',
    'step_max': 'largest of the same',
    'step_late': f'number of steps above {LATE:g} us',
    'idle_p50': 'an empty loop of fixed length after every step [us]: median',
    'idle_p99': '99th percentile of the same',
    'idle_max': 'largest of the same',
    'idle_late': f'number of loops above {LATE:g} us',
    'late_more': 'late steps beyond as many as there are late loops',
}


class Single:
    """Measures one case. Raises SceneError, SpecError or ConsistencyError on construction, StepError from round()."""

    def __init__(self, scene: str, overrides: Sequence[str]) -> None:
        self.simulation = simulation_of(load_scene(scene, overrides))
        warm_up(self.simulation)
        self._steps: list[int] = []
        self._idle: list[int] = []
        self._length = 0  # of the empty loop

    def round(self, steps: int) -> None:
        """Step and idle in turns, from the start of the scene on where its end comes."""
        gc.collect()
        gc.freeze()  # as the node does
        try:
            if not self._length:
                self._calibrate()
            self._measure(steps)
        finally:
            gc.unfreeze()

    def _measure(self, steps: int) -> None:
        simulation, clock, length = self.simulation, time.thread_time_ns, self._length
        for _ in range(steps):
            if simulation.k >= simulation.scene.steps:
                simulation.reset()
            row = simulation.source.table(simulation.k, 1)[0]
            t0 = clock()
            simulation.advance(1, row)
            t1 = clock()
            idle(length)
            t2 = clock()
            self._steps.append(t1 - t0)
            self._idle.append(t2 - t1)

    def _calibrate(self) -> None:
        """Make the empty loop last as long as the median step."""
        self._length = 2000
        self._measure(CALIBRATION)
        self._length = max(1, round(self._length * float(np.median(self._steps) / np.median(self._idle))))
        self._steps.clear()
        self._idle.clear()
        self.simulation.reset()

    def close(self) -> None:
        """Nothing to end."""

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case."""
        found: dict[str, float] = {}
        for name, samples in (('step', self._steps), ('idle', self._idle)):
            us = np.array(samples) * 1e-3
            found |= {
                f'{name}_p50': float(np.median(us)),
                f'{name}_p99': float(np.percentile(us, 99.0)),
                f'{name}_max': float(us.max()),
            }
            found[f'{name}_late'] = int((us > LATE).sum())
        found['late_more'] = max(0, found['step_late'] - found['idle_late'])
        steps = len(self._steps)
        return {
            'h': self.simulation.h,
            'steps': steps,
            'simulated': steps * self.simulation.h,
            'figures': {n: found[n] for n in FIGURES},
        }


def idle(length: int) -> None:
    """An empty loop."""
    for _ in range(length):
        pass
