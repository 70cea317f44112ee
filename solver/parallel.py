"""Several independent simulations side by side, in threads of one process.

Compiled steps run without the interpreter lock (solver.compiled.kernel), and a Simulation shares nothing that changes
with another one: tables, states and scratch are its own. So threads change no bits, and they gain most with many steps
per call.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from solver.output.snapshot import Snapshot
from solver.simulation import Simulation


def advance_all(
    simulations: Sequence[Simulation],
    n: int,
    inputs: Sequence[np.ndarray | None] | None = None,
    *,
    audit: bool = True,
    threads: int | None = None,
) -> list[Snapshot]:
    """Advance every simulation n steps, `threads` of them at a time (None: as many as there are cores); the last
    Snapshot of each.

    simulations: each once. inputs: one entry for each of them; these and audit are as Simulation.advance takes them.
    Raises ValueError when a simulation is there twice, and the first StepError after all have ended: those that failed
    are at their last good step, the others n steps further. (A simulation with a driver returns to Python in every
    step; such ones gain little.)
    """
    if len({id(simulation) for simulation in simulations}) != len(simulations):
        raise ValueError('advance_all: the same simulation is there twice; make one for each')
    given = [None] * len(simulations) if inputs is None else inputs
    with ThreadPoolExecutor(threads or os.cpu_count()) as pool:
        runs = [pool.submit(s.advance, n, u, audit=audit) for s, u in zip(simulations, given, strict=True)]
    return [run.result() for run in runs]
