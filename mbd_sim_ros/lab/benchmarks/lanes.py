"""Benchmark of ensembles: eight cars in the lanes of one core, beside the same cars one after the other, level by
level."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from solver.ensemble import Ensemble
from solver.errors import SpecError
from solver.files.scene import load_scene

COUNT = 8  # cars
BATCH = 256  # steps in a call
SKIPPED = 1000  # steps before the first one that is measured: the maneuver has begun
AMPLITUDES = tuple(0.3 + 0.1 * k for k in range(COUNT))  # factors of the steering angle of the scene, one of each car
LEVELS = ('single_track', 'kc')
WAYS = {'': False, '_audited': True}  # of advance()
FIGURES = {
    **{
        f'{level}_single': f'{COUNT} cars of {level} one after the other, per car and step [us]: median'
        for level in LEVELS
    },
    **{f'{level}_lanes': f'{COUNT} cars of {level} in lanes, per car and step [us]: median' for level in LEVELS},
    **{f'{level}_gain': f'single over lanes of {level}, both of the same moment: median' for level in LEVELS},
    **{f'{level}_gain_audited': f'the same of {level} with the account of energy after every step' for level in LEVELS},
}


class Lanes:
    """Measures one scene at every level. Raises SceneError, SpecError or ConsistencyError on construction."""

    def __init__(self, scene: str, overrides: Sequence[str], levels: Sequence[str] = LEVELS) -> None:
        self._levels = levels
        self._cars: dict[str, tuple[Ensemble, np.ndarray]] = {}
        self._times: dict[str, list[tuple[float, float]]] = {}  # (single, lanes) of each batch [s]
        for level in levels:
            ensemble = Ensemble([load_scene(scene, [*overrides, f'fidelity={level}'])] * COUNT)
            if not ensemble.in_lanes:
                raise SpecError(f'fidelity = {level!r}: {ensemble.why}')
            first = ensemble.simulations[0]
            steps = first.scene.steps
            inputs = np.repeat(first.source.table(0, steps)[None], COUNT, axis=0)
            steering = [name.startswith('steering') for name in first.channels.inputs]
            inputs[:, :, steering] *= np.array(AMPLITUDES)[:, None, None]
            self._cars[level] = ensemble, inputs
            ensemble.advance(SKIPPED, inputs[:, :SKIPPED])

    def round(self, steps: int) -> None:
        """Batches of every level in lanes, and the same steps again one after the other."""
        for _ in range(max(1, steps // BATCH)):
            for level, (ensemble, inputs) in self._cars.items():
                k = ensemble.simulations[0].k
                if k + BATCH > inputs.shape[1]:
                    ensemble.reset()
                    ensemble.advance(k := SKIPPED, inputs[:, :SKIPPED])
                rows = np.ascontiguousarray(inputs[:, k : k + BATCH])
                for way, audit in WAYS.items():
                    saved = [simulation.save() for simulation in ensemble.simulations]
                    begin = time.thread_time()
                    ensemble.advance(BATCH, rows, audit=audit)
                    middle = time.thread_time()
                    for simulation, state in zip(ensemble.simulations, saved, strict=True):
                        simulation.restore(state)
                        simulation.snapshot()  # outputs of a restored state are not those of its steps
                    start = time.thread_time()
                    for simulation, row in zip(ensemble.simulations, rows, strict=True):
                        simulation.advance(BATCH, row, audit=audit)
                    end = time.thread_time()
                    self._times.setdefault(level + way, []).append((end - start, middle - begin))
                    if not way:  # the same steps once more
                        for simulation, state in zip(ensemble.simulations, saved, strict=True):
                            simulation.restore(state)
                            simulation.snapshot()  # outputs of a restored state are not those of its steps

    def close(self) -> None:
        """Nothing to end."""

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case."""
        found: dict[str, float] = {}
        for level in self._levels:
            times = np.array(self._times[level])
            single, lanes = (np.median(times, axis=0) / (COUNT * BATCH) * 1e6).tolist()
            audited = np.array(self._times[f'{level}_audited'])
            found |= {f'{level}_single': single, f'{level}_lanes': lanes}
            found[f'{level}_gain'] = float(np.median(times[:, 0] / times[:, 1]))
            found[f'{level}_gain_audited'] = float(np.median(audited[:, 0] / audited[:, 1]))
        ensemble, _ = self._cars[self._levels[0]]
        return {
            'h': ensemble.simulations[0].h,
            'steps': len(self._times[self._levels[0]]) * BATCH,
            'figures': {name: found[name] for name in FIGURES if name in found},
        }
