"""What a setting costs: CPU time of one core per simulated second, and the counters that explain it.

Counters are exact; times are measured, one setting at a time while nothing else runs here. For choosing, the cost of a setting is

    (steps per second) (a + b evaluations per step)

with a and b measured once for a model (level and switches) and kept, so that a choice does not flip with the noise of the clock.
"""

from __future__ import annotations

import dataclasses
import time
from typing import NamedTuple

import numpy as np

from solver import simulation_of
from solver.levels.derived import FINE
from solver.scene import Scene
from solver.trade.setting import Setting

PIECE = 0.1  # s of simulated time that one sample of the cost is of
ROUNDS = 3
PROBE = 150  # steps of one timing of a model
PROBES = (1, 3)  # iterations
PROBED = 1.25 * FINE  # s, the step of such a timing: every level makes the iterations that it is told


class Cost(NamedTuple):
    """CPU seconds of one core per simulated second: median and 99th percentile over pieces of PIECE simulated seconds."""

    median: float
    p99: float


class PerStep(NamedTuple):
    """CPU time of a step [s]: fixed + evaluation * evaluations. Evaluations in a step with one and with three iterations."""

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
    """The cost of a setting over the scene's first `seconds` of simulated time, the best of several rounds piece by piece.

    Raises MbdError when the run fails.
    """
    simulation = simulation_of(setting.of(scene))
    each = max(1, round(PIECE / simulation.h))
    pieces = max(1, round(min(seconds, scene.duration) / (each * simulation.h)))
    found = np.empty((rounds, pieces))
    simulation.advance(1, audit=False)
    for row in found:
        simulation.reset()
        for k in range(pieces):
            begin = time.thread_time()
            simulation.advance(each, audit=False)
            row[k] = (time.thread_time() - begin) / (each * simulation.h)
    best = found.min(axis=0)
    return Cost(float(np.median(best)), float(np.percentile(found, 99)))


def size(scene: Scene, setting: Setting) -> tuple[int, ...]:
    """What a step of a model works on: bodies, rows, internal states, columns of its elements, height grids. Raises MbdError.

    Models of one size cost the same; what the clock sees between them is noise.
    """
    s = simulation_of(setting.of(scene))
    return s.model.n_bodies, s.model.n_rows, int(s.state.z.size), len(s.channels.elements), len(s.model.spec.road.grids)


def per_step(scene: Scene, setting: Setting) -> PerStep:
    """Time of a step and of an evaluation of a model, by timing it with one and with three iterations. Raises MbdError."""
    times, evaluations = [], []
    for iterations in PROBES:
        simulation = simulation_of(dataclasses.replace(setting, h=PROBED, iterations=iterations).of(scene))
        simulation.advance(PROBE // 3, audit=False)
        saved, best = simulation.save(), np.inf
        for _ in range(ROUNDS):
            simulation.restore(saved)
            before = simulation.totals()['evaluations']
            begin = time.thread_time()
            simulation.advance(PROBE, audit=False)
            best = min(best, (time.thread_time() - begin) / PROBE)
            count = (simulation.totals()['evaluations'] - before) / PROBE
        times.append(best)
        evaluations.append(count)
    counted = evaluations[1] - evaluations[0]
    slope = (times[1] - times[0]) / counted if counted > 0.5 else 0.0
    if not slope > 0.0:  # a model without iterations, or so small that the clock sees no difference
        return PerStep(float(max(times)), 0.0, *map(float, evaluations))
    return PerStep(float(max(times[0] - slope * evaluations[0], 0.0)), float(slope), *map(float, evaluations))
