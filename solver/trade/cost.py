"""The cost of a setting: CPU time of one core per simulated second, and the counters that explain it.

Counters are exact; times are measured, one setting at a time while nothing else runs here. For choosing, the cost of a
setting is

    (steps per second) (a + b evaluations per step)

with a and b measured once for a model (level and switches) and kept, so that a choice does not flip with the noise of
the clock.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from solver import simulation_of
from solver.errors import StepError
from solver.levels.derived import FINE
from solver.scene import Scene
from solver.simulation import Simulation
from solver.trade.setting import Setting

Make = Callable[[Setting], Simulation]
PIECE = 0.1  # s of simulated time that one sample of the cost is of
ROUNDS = 3
PROBE = 150  # steps of one timing of a model
PROBES = (1, 3)  # iterations
PROBED = 1.25 * FINE  # s, the step of such a timing: every level makes the iterations that it is told
SHORTER = 5  # times that it is halved: as far as steps of a reference go


class Cost(NamedTuple):
    """CPU seconds of one core per simulated second: median and 99th percentile over pieces of PIECE simulated
    seconds."""

    median: float
    p99: float


class PerStep(NamedTuple):
    """CPU time of a step [s]: fixed + evaluation * evaluations. Evaluations in a step with one and with three
    iterations."""

    fixed: float
    evaluation: float
    least: float
    most: float

    def of(self, h: float, evaluations: float) -> float:
        """CPU seconds per simulated second."""
        return (self.fixed + self.evaluation * evaluations) / h

    def expected(self, iterations: int) -> float:
        """Evaluations in a step with so many iterations, where they contract."""
        return self.least + (self.most - self.least) * (iterations - PROBES[0]) / (PROBES[1] - PROBES[0])


def measured(scene: Scene, setting: Setting, *, seconds: float = 2.0, rounds: int = ROUNDS) -> Cost:
    """The cost of a setting over the scene's first `seconds` of simulated time, the best of several rounds piece by
    piece.

    Raises MbdError when the run fails.
    """
    return compared(scene, (setting,), seconds=seconds, rounds=rounds)[0]


def compared(
    scene: Scene, settings: Sequence[Setting], *, seconds: float = 2.0, rounds: int = ROUNDS, make: Make | None = None
) -> list[Cost]:
    """The costs of settings as of measured(), their rounds in turn: a time in which the machine is slow is one of all
    of them.

    make: the simulation of a setting, where somebody knows its start already. Raises MbdError when a run fails.
    """
    simulations = [simulation_of(setting.of(scene)) if make is None else make(setting) for setting in settings]
    pieces, found = [], []
    for s in simulations:
        there = _steps(scene, s.h)  # a recording whose inputs are applied ends there
        each = min(max(1, round(PIECE / s.h)), there)
        pieces.append(each)
        found.append(np.empty((rounds, max(1, min(round(seconds / (each * s.h)), there // each)))))
        s.advance(1, audit=False)
    for i in range(rounds):
        for s, each, table in zip(simulations, pieces, found, strict=True):
            s.reset()
            for k in range(table.shape[1]):
                begin = time.thread_time()
                s.advance(each, audit=False)
                table[i, k] = (time.thread_time() - begin) / (each * s.h)
    return [Cost(float(np.median(table.min(axis=0))), float(np.percentile(table, 99))) for table in found]


def _steps(scene: Scene, h: float) -> int:
    """Steps of this size that a scene has room for, one at least."""
    return max(1, math.floor(scene.duration / h + 1e-6))


def size(s: Simulation) -> tuple[int, ...]:
    """The size of a model, that is what a step works on: bodies, rows, internal states, height grids.

    Models of one size cost the same; what the clock sees between them is noise.
    """
    return s.model.n_bodies, s.model.n_rows, int(s.state.z.size), len(s.model.spec.road.grids)


def per_step(scene: Scene, setting: Setting, h: float = PROBED, *, make: Make | None = None) -> PerStep:
    """Time of a step and of an evaluation of a model, by timing steps of h [s] with one and with three iterations.
    Steps are no longer than the scene. Where such a run fails they are shorter, up to SHORTER times. make: as
    compared() takes it. Raises MbdError."""
    h = min(h, scene.duration)
    for k in range(SHORTER):
        try:
            return _timed(scene, setting, h / 2**k, make)
        except StepError:
            continue
    return _timed(scene, setting, h / 2**SHORTER, make)


def _timed(scene: Scene, setting: Setting, h: float, make: Make | None) -> PerStep:
    times, evaluations = [], []
    there = _steps(scene, h)
    before_it = min(PROBE // 3, there // 4)
    probe = max(1, min(PROBE, there - before_it))
    for iterations in PROBES:
        way = dataclasses.replace(setting, h=h, iterations=iterations)
        simulation = simulation_of(way.of(scene)) if make is None else make(way)
        simulation.advance(before_it, audit=False)
        saved, best = simulation.save(), np.inf
        for _ in range(ROUNDS * -(-PROBE // probe)):
            simulation.restore(saved)
            before = simulation.totals()['evaluations']
            begin = time.thread_time()
            simulation.advance(probe, audit=False)
            best = min(best, (time.thread_time() - begin) / probe)
            count = (simulation.totals()['evaluations'] - before) / probe
        times.append(best)
        evaluations.append(count)
    counted = evaluations[1] - evaluations[0]
    slope = (times[1] - times[0]) / counted if counted > 0.5 else 0.0
    if not slope > 0.0:  # a model without iterations, or so small that the clock sees no difference
        return PerStep(float(max(times)), 0.0, *map(float, evaluations))
    return PerStep(float(max(times[0] - slope * evaluations[0], 0.0)), float(slope), *map(float, evaluations))
