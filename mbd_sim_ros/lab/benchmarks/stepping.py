"""Costs of a step: in batches without and with outputs, one at a time, and in parts."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_sim_ros.lab.benchmarks.phases import phase_times
from solver import simulation_of
from solver.files.scene import load_scene
from solver.output.snapshot import Counters

BATCH = 1000  # steps per call
PHASE_ROUNDS = 3  # per round
RETURNS = 20  # to a state, per round
TIMED = ('batch', 'audited', 'snapshot', 'restore', 'reset', 'inputs')  # by their medians
FIGURES = {
    'batch': 'median over calls of advance(1000, audit=False), per step',
    'audited': 'median over calls of advance(1000), outputs and energy balance after every step, per step',
    'single_p50': 'advance(1) as the node calls it, snapshot included: median',
    'single_p99': '99th percentile of the same',
    'single_max': 'largest of the same',
    'snapshot': 'snapshot() alone: median',
    'restore': 'restore() of a state that was saved in this process: median',
    'reset': 'reset(): median',
    'inputs': 'sampling the maneuver for one step: median (not part of the figures above)',
}


class Stepping:
    """Measures one case, some steps of its scene per round; after the end of the scene it begins anew.

    Raises SceneError, SpecError or ConsistencyError on construction, StepError from round().
    """

    def __init__(self, scene: str, overrides: Sequence[str]) -> None:
        self.simulation = simulation_of(load_scene(scene, overrides))
        self._samples: dict[str, list[float]] = {name: [] for name in ('single', *TIMED)}
        self._counters: dict[str, list[tuple[float, ...]]] = {'batch': [], 'audited': [], 'single': []}
        self._phases: list[tuple[dict[str, float], dict[str, float]]] = []
        self._inputs(1)
        for audit in (False, True):
            self.simulation.advance(1, audit=audit)  # warm
        phase_times(self.simulation, rounds=1)
        self.simulation.reset()

    def _inputs(self, n: int) -> np.ndarray:
        """Inputs of the next n steps; back to the start first if the scene has not so many left."""
        if self.simulation.k + n > self.simulation.scene.steps:
            self.simulation.reset()
        return self.simulation.source.table(self.simulation.k, n)

    def round(self, steps: int) -> None:
        """Make the same `steps` steps in every way, then measure the phases where they end."""
        simulation = self.simulation
        batch = min(BATCH, steps, simulation.scene.steps)
        calls = max(1, steps // batch)
        start = simulation.save()
        for way, audit in (('batch', False), ('audited', True)):
            simulation.restore(start)
            for _ in range(calls):
                inputs = self._inputs(batch)
                begin = time.thread_time_ns()
                snapshot = simulation.advance(batch, inputs, audit=audit)
                self._sample(way, time.thread_time_ns() - begin, snapshot.counters, batch)
        simulation.restore(start)
        for _ in range(calls * batch):
            begin = time.thread_time_ns()
            row = simulation.source.table(simulation.k, 1)[0]
            self._samples['inputs'].append((time.thread_time_ns() - begin) * 1e-3)
            if simulation.k == simulation.scene.steps:
                row = self._inputs(1)[0]
            begin = time.thread_time_ns()
            snapshot = simulation.advance(1, row)
            self._sample('single', time.thread_time_ns() - begin, snapshot.counters, 1)
            begin = time.thread_time_ns()
            simulation.snapshot()
            self._samples['snapshot'].append((time.thread_time_ns() - begin) * 1e-3)
        self._phases.append(phase_times(simulation, PHASE_ROUNDS))
        end = simulation.save()
        for _ in range(RETURNS):
            for name, back in (('restore', lambda: simulation.restore(start)), ('reset', simulation.reset)):
                simulation.advance(1)
                begin = time.thread_time_ns()
                back()
                self._samples[name].append((time.thread_time_ns() - begin) * 1e-3)
        simulation.restore(end)

    def _sample(self, way: str, ns: int, counters: Counters, steps: int) -> None:
        self._samples[way].append(ns / steps * 1e-3)
        self._counters[way].append(
            (counters.iterations / steps, counters.factorizations / steps, counters.evaluations / steps)
        )

    def close(self) -> None:
        """Nothing to end."""

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case: sizes, times [us], counters per step, phases."""
        s, simulation = self._samples, self.simulation
        us = {name: float(np.median(s[name])) for name in TIMED}
        us |= {
            'single_p50': float(np.median(s['single'])),
            'single_p99': float(np.percentile(s['single'], 99.0)),
            'single_max': max(s['single']),
        }
        names = ('iterations', 'factorizations', 'evaluations')
        phases, elements = zip(*self._phases, strict=True)
        return {
            'h': simulation.h,
            'bodies': simulation.model.n_bodies,
            'rows': simulation.model.n_rows,
            'steps': len(s['single']),
            'real_time_factor': simulation.h * 1e6 / us['batch'],
            'figures': {name: us[name] for name in FIGURES},
            'counters': {
                way: dict(zip(names, map(float, np.mean(rows, axis=0)), strict=True))
                for way, rows in self._counters.items()
            },
            'phases': _medians(phases),
            'elements': _medians(elements),
        }


def _medians(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    return {name: float(np.median([row[name] for row in rows])) for name in rows[0]}
