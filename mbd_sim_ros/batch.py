"""Running a simulation as fast as it goes, recorded like the node records it."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from tqdm import tqdm

from mbd_sim_ros.bags.recorder import Recorder, about, describe
from mbd_sim_ros.messages.encode import Messages
from solver.analysis.balance import Balance
from solver.errors import MbdError
from solver.simulation import Simulation

UNRECORDED_CHUNK = 100  # steps per call when nobody looks between


class Source(Protocol):
    """Gives the inputs of n steps from step k0 on, (n, nu)."""

    def table(self, k0: int, n: int) -> np.ndarray: ...


def record(simulation: Simulation, directory: Path) -> tuple[Messages, Recorder]:
    """The encoder and the recorder of a simulation's scene. Raises BagError when the directory cannot be written."""
    scene, channels = simulation.scene, simulation.channels
    messages = Messages(channels, element_states=scene.record.elements, reactions=scene.record.reactions)
    metadata = describe(
        scene=scene.name,
        resolved_yaml=scene.resolved,
        seed=scene.seed,
        robot_description=simulation.urdf(),
    ) | about(simulation, reactions=scene.record.reactions)
    return messages, Recorder(directory, messages.topics, metadata)


def warm_up(simulation: Simulation) -> None:
    """Compile what a step needs, outside of any measurement; the simulation is at its start afterwards."""
    with suppress(MbdError):  # it will fail again, where it is reported
        simulation.advance(1)
    simulation.reset()


@contextmanager
def signals_noted() -> Iterator[list[int]]:
    """SIGINT and SIGTERM only append their number to the list: a step and its recording are never torn apart."""
    noted: list[int] = []
    previous = {number: signal.signal(number, lambda n, _: noted.append(n)) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield noted
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def simulate(
    simulation: Simulation,
    steps: int,
    *,
    directory: Path | None = None,
    source: Source | None = None,
    progress: bool = False,
    balance: bool = False,
) -> dict[str, Any]:
    """Advance from the start by `steps` steps and return the figures of the run.

    directory: where to record (None: not at all). source: of the inputs; None is the maneuver of the scene. progress: show a bar
    if stderr is a terminal. balance: follow energy and momentum by element kind, which takes its time.
    A recording is always closed, with the reason when the run did not end well. Raises StepError,
    BagError, and KeyboardInterrupt(sentence to show, signal number) between two steps.
    """
    every = simulation.scene.record.every if directory is not None else UNRECORDED_CHUNK
    with tqdm(total=steps, unit='step', desc='compiling', disable=None if progress else True, leave=False) as bar:
        warm_up(simulation)
        bar.set_description(simulation.scene.name)
        bar.unpause()
        with signals_noted() as noted:
            messages, recorder = record(simulation, directory) if directory is not None else (None, None)
            status, cpu, begin = 'failed', 0.0, time.perf_counter()
            balances = Balance(simulation) if balance else None
            try:
                if recorder and messages:
                    recorder.write(simulation.t_ns, messages.encode(simulation.snapshot()))
                while simulation.k < steps and not noted:
                    n = min(1 if balances else every, steps - simulation.k)
                    inputs = None if source is None else source.table(simulation.k, n)
                    started = time.thread_time()
                    snapshot = simulation.advance(n, inputs)
                    cpu += time.thread_time() - started
                    if balances:
                        balances.update()
                    if recorder and messages and (simulation.k % every == 0 or simulation.k == steps):
                        recorder.write(snapshot.t_ns, messages.encode(snapshot))
                    bar.update(n)
                status = 'interrupted' if noted else 'ok'
            finally:
                figures = _figures(simulation, time.perf_counter() - begin, cpu)
                if recorder:
                    events = json.dumps([event._asdict() for event in simulation.events])
                    recorder.close({'status': status, **{key: f'{value!r}' for key, value in figures.items()}, 'event_list': events})
    if noted:
        kept = f'; the recording in {directory} is complete up to there' if directory is not None else ''
        raise KeyboardInterrupt(f'interrupted at t = {simulation.t_ns * 1e-9:g} s (step {simulation.k}){kept}', noted[0])
    followed = balances.report() if balances else {}
    return {'status': status, **figures, **followed, 'out': None if directory is None else str(directory)}


def _figures(simulation: Simulation, wall: float, cpu: float) -> dict[str, Any]:
    """Speed and accuracy of the steps made so far. wall, cpu: seconds spent in all and in the steps."""
    audit, n = simulation.totals(), max(simulation.k, 1)
    return {
        'steps': simulation.k,
        'simulated_time': simulation.t_ns * 1e-9,
        'wall_time': wall,
        'real_time_factor': simulation.t_ns * 1e-9 / wall,
        'cpu_per_step_us': cpu / n * 1e6,
        'iterations_per_step': audit['iterations'] / n,
        'factorizations_per_step': audit['factorizations'] / n,
        'evaluations_per_step': audit['evaluations'] / n,
        'residual_max': audit['residual_max'],
        'energy_error_max': audit['energy_error_max'],
        'position_drift_max': audit['position_drift_max'],
        'velocity_drift_max': audit['velocity_drift_max'],
        'stagnated': audit['stagnated'],
        'substeps': audit['substeps'],
        'rejected': audit['rejected'],
        'events': audit['events'],
        **_branches(simulation),
    }


def _branches(simulation: Simulation) -> dict[str, Any]:
    """Branch switches, when the scene asks for them."""
    if simulation.branches is None:
        return {}
    found = simulation.branches.events
    return {'branch_switches': len(found), 'branch_switch_times': [event.t for event in found]}
