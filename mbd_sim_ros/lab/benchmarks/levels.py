"""The levels of detail of a scene side by side: what a step costs, as a share of the full vehicle."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_sim_ros.batch import warm_up
from solver import simulation_of
from solver.files.scene import load_scene
from solver.simulation import Simulation

LEVELS = ('full', 'condensed', 'kc', 'single_track')
WAYS = {'': False, '_audited': True}  # of advance()
BATCH = 200  # steps per call
FIGURES = {
    **{level: f'advance({BATCH}, audit=False) of {level}, per step [us]: median' for level in LEVELS},
    **{f'{level}_share': f'{level} over full, both of the same moment: median' for level in LEVELS[1:]},
    **{f'{level}_audited': f'the same with the account of energy after every step, of {level}' for level in LEVELS[1:]},
}


class Levels:
    """Measures one case. Raises SceneError, SpecError or ConsistencyError on construction, StepError from round()."""

    def __init__(self, scene: str, overrides: Sequence[str]) -> None:
        self.simulations = {
            level: simulation_of(load_scene(scene, [*overrides, f'fidelity={level}'])) for level in LEVELS
        }
        for simulation in self.simulations.values():
            warm_up(simulation)
            for audit in WAYS.values():
                simulation.advance(1, audit=audit)
        self._times: dict[str, list[list[float]]] = {way: [] for way in WAYS}

    def round(self, steps: int) -> None:
        """The same steps at every level, in turns, call by call."""
        for _ in range(max(1, steps // BATCH)):
            for way, audit in WAYS.items():
                row = []
                for simulation in self.simulations.values():
                    row.append(1e6 * per_step(simulation, audit=audit))
                self._times[way].append(row)

    def close(self) -> None:
        """Nothing to end."""

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case."""
        plain, audited = (np.array(self._times[way]) for way in WAYS)
        found = dict(zip(LEVELS, np.median(plain, axis=0).tolist(), strict=True))
        for name, times in (('share', plain), ('audited', audited)):
            shares = np.median(times[:, 1:] / times[:, :1], axis=0).tolist()
            found |= {f'{level}_{name}': share for level, share in zip(LEVELS[1:], shares, strict=True)}
        return {
            'h': self.simulations['full'].h,
            'steps': len(plain) * BATCH,
            'figures': {name: found[name] for name in FIGURES},
        }


def per_step(simulation: Simulation, *, audit: bool) -> float:
    """CPU time of one of the next BATCH steps, made in one call [s]; from the start again where the scene has no
    more."""
    if simulation.k + BATCH > simulation.scene.steps:
        simulation.reset()
    driven = simulation.sources.step_by_step  # what a driver takes belongs to the step
    inputs = None if driven else simulation.source.table(simulation.k, BATCH)
    begin = time.thread_time()
    simulation.advance(BATCH, inputs, audit=audit)
    return (time.thread_time() - begin) / BATCH
