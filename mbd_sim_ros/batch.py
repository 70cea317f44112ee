"""Running a simulation as fast as it goes, recorded like the node records it."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from tqdm import tqdm

from mbd_sim_ros import interrupts
from mbd_sim_ros.bags.applied import begin_of
from mbd_sim_ros.bags.recorder import StepRecorder, about, describe
from mbd_sim_ros.messages.encode import Messages, require_finite
from solver.analysis.balance import Balance
from solver.analysis.covered import weighed
from solver.analysis.envelope import Envelope
from solver.analysis.verdict import OK, SUSPECT, passes, report
from solver.errors import MbdError, StepError
from solver.files.scene import load_scene_text
from solver.findings import Finding
from solver.simulation import Simulation

UNRECORDED_CHUNK = 100  # steps per call when nobody looks between
LAST = 200  # steps before a failure that are recorded every one
LAST_STEPS = 'last_steps'  # name of their recording, in the directory of the run
DEAF = 0.1  # s that a call of many steps may take; nobody looks for signals meanwhile


class Source(Protocol):
    """Gives the inputs of n steps from step k0 on, (n, nu)."""

    def table(self, k0: int, n: int) -> np.ndarray: ...


class Portion:
    """How many steps a call may do: twice as many as the last one while that took less than DEAF seconds. Bits do not depend on it."""

    def __init__(self) -> None:
        self.most = 1

    def took(self, steps: int, seconds: float) -> None:
        """A call of so many steps took so long."""
        fitting = int(DEAF * steps / seconds) if seconds > 0.0 else 2 * steps
        self.most = max(1, min(2 * max(steps, self.most), fitting))


def record(
    simulation: Simulation, directory: Path, *, frame_prefix: str = '', parameters: Mapping[str, Any] | None = None
) -> tuple[Messages, StepRecorder]:
    """The encoder and the recorder of a simulation's scene; the recording begins with its state now.

    frame_prefix: put before every frame name. parameters: for the description. Raises BagError when the directory cannot be written.
    """
    scene, channels = simulation.scene, simulation.channels
    messages = Messages.of(scene, simulation, frame_prefix)
    metadata = describe(
        scene=scene.name,
        resolved_yaml=scene.resolved,
        seed=scene.seed,
        robot_description=simulation.urdf(),
        parameters=parameters,
    )
    metadata |= about(simulation, reactions=scene.record.reactions) | begin_of(simulation)
    return messages, StepRecorder(directory, messages.topics, channels.inputs, simulation.k, metadata)


def warm_up(simulation: Simulation) -> None:
    """Compile what a step needs, outside of any measurement; the simulation is at its start afterwards."""
    with suppress(MbdError):  # it will fail again, where it is reported
        simulation.advance(1)
    simulation.reset()


def simulate(
    simulation: Simulation,
    steps: int,
    *,
    directory: Path | None = None,
    source: Source | None = None,
    progress: bool = False,
    balance: bool = False,
    state: bytes | None = None,
    from_start: bool = True,
    frame_prefix: str = '',
    parameters: Mapping[str, Any] | None = None,
    looking_back: bool = True,
) -> dict[str, Any]:
    """Advance to step `steps`, from the start or from a saved state, and return the figures of the run.

    directory: where to record (None: not at all). source: of the inputs; None is the maneuver of the scene. progress: show a bar
    if stderr is a terminal. balance: follow energy and momentum by element kind, which takes its time. state: of Simulation.save().
    from_start: record the state at the beginning too. looking_back: a run that fails leaves in its recording another one, `last_steps`:
    the last LAST steps at least, every one, from a saved state on, so that `mbd replay` can start again from just before.
    `status` is 'ok' or 'suspect', `findings` say why, `covered` what the certificate of a plan covers (solver.analysis.covered);
    `passed` is false where the scene does not allow what was found. A recording is always closed, with the verdict or what ended the run.
    Raises StepError, BagError, and KeyboardInterrupt(sentence to show, signal number) between two steps.
    """
    every = simulation.scene.record.every if directory is not None else UNRECORDED_CHUNK
    looking_back &= directory is not None
    with tqdm(total=steps, unit='step', desc='compiling', disable=None if progress else True, leave=False) as bar:
        interrupts.now(f'preparing {simulation.scene.name}')
        warm_up(simulation)
        if state is not None:
            simulation.restore(state)
        interrupts.check()
        bar.set_description(simulation.scene.name)
        bar.unpause()
        first, until, portion = simulation.k, simulation.totals(), Portion()
        messages, recorder = (None, None)
        if directory is not None:
            messages, recorder = record(simulation, directory, frame_prefix=frame_prefix, parameters=parameters)
        with interrupts.held():
            status, cpu, begin, written = 'error', 0.0, time.perf_counter(), -1
            found: list[Finding] = []
            covered: list[Finding] = []
            failure: StepError | None = None
            number = 0
            balances = Balance(simulation) if balance else None
            envelope = Envelope(simulation)
            look = envelope.every(simulation.h_ns) or UNRECORDED_CHUNK
            before = recent = (simulation.k, b'')  # states from LAST steps ago at least, and later
            try:
                if recorder and messages and from_start:
                    recorder.record(simulation.t_ns, messages.encode(simulation.snapshot()))
                    written = simulation.k
                while simulation.k < steps and not interrupts.received():
                    n = min(every - simulation.k % every, look - simulation.k % look, steps - simulation.k, portion.most)
                    n = 1 if balances else n
                    if looking_back and simulation.k >= recent[0] + LAST:
                        before, recent = recent, (simulation.k, simulation.save())
                    inputs = None if source is None else source.table(simulation.k, n)
                    started, clock = time.thread_time(), time.perf_counter()
                    snapshot = simulation.advance(n, inputs)
                    cpu += time.thread_time() - started
                    portion.took(n, time.perf_counter() - clock)
                    if simulation.k % look == 0 or simulation.k == steps:  # whatever is recorded, and however fast the machine is
                        envelope.look(snapshot)
                    if balances:
                        balances.update()
                    if recorder and messages:
                        if simulation.applied is not None:
                            recorder.note(simulation.k, simulation.applied)
                        if simulation.k % every == 0 or simulation.k == steps or interrupts.received():
                            recorder.record(snapshot.t_ns, messages.encode(snapshot))
                            written = simulation.k
                    else:
                        require_finite(snapshot, simulation.channels)
                    bar.update(n)
                if recorder and messages and written != simulation.k:  # interrupted right behind a step
                    recorder.record(simulation.t_ns, messages.encode(simulation.snapshot()))
                number = interrupts.received() if simulation.k < steps else 0
                figures = _figures(simulation, first, until, time.perf_counter() - begin, cpu)
                found, covered = weighed(simulation, envelope, figures['real_time_factor'])
                status = 'interrupted' if number else SUSPECT if found else OK
            except StepError as error:
                failure = error
            finally:
                figures = _figures(simulation, first, until, time.perf_counter() - begin, cpu)
                if recorder:
                    events = json.dumps([event._asdict() for event in simulation.events])
                    verdict = {'status': status, 'findings': json.dumps(report(found))}
                    if covered:
                        verdict['covered'] = json.dumps(report(covered))
                    recorder.close({**verdict, **{key: f'{value!r}' for key, value in figures.items()}, 'event_list': events})
    if failure is not None:
        if looking_back and directory is not None:
            where = _last_steps(simulation, steps, directory / LAST_STEPS, source, before[1] or state, frame_prefix, parameters)
            raise StepError(f'{failure}; {where}') from failure
        raise failure
    if number:
        kept = f'; the recording in {directory} is complete up to there' if directory is not None else ''
        raise KeyboardInterrupt(f'interrupted at t = {simulation.t_ns * 1e-9:g} s (step {simulation.k}){kept}', number)
    followed = balances.report() if balances else {}
    return {
        'status': status,
        'findings': report(found),
        'covered': report(covered),
        'passed': passes(simulation, found),
        **figures,
        **followed,
        'out': None if directory is None else str(directory),
    }


def _last_steps(
    simulation: Simulation,
    steps: int,
    directory: Path,
    source: Source | None,
    state: bytes | None,
    frame_prefix: str,
    parameters: Mapping[str, Any] | None,
) -> str:
    """Record the steps from a state (None: the start) to the failure, every one; returns a phrase that says where they are."""
    scene = simulation.scene
    resolved = load_scene_text(scene.resolved, overrides=['record.every=1']).resolved if scene.resolved else ''
    each = dataclasses.replace(scene, record=dataclasses.replace(scene.record, every=1), resolved=resolved)
    simulation.scene = each
    options: dict[str, Any] = {'frame_prefix': frame_prefix, 'parameters': parameters, 'looking_back': False}
    try:
        simulate(simulation, steps, directory=directory, source=source, state=state, **options)
    except StepError:  # the same again
        pass
    finally:
        simulation.scene = scene
    return f'the steps before are in {directory}, with the state to start again from (mbd replay)'


def _figures(simulation: Simulation, first: int, until: Mapping[str, float], wall: float, cpu: float) -> dict[str, Any]:
    """Speed of the steps made since step `first`, when the totals were `until`, and accuracy of the whole run. wall, cpu: seconds spent in
    all and in the steps.
    """
    audit, n = simulation.totals(), max(simulation.k - first, 1)
    return {
        'steps': simulation.k,
        'simulated_time': simulation.t_ns * 1e-9,
        'wall_time': wall,
        'real_time_factor': (simulation.k - first) * simulation.h_ns * 1e-9 / wall,
        'cpu_per_step_us': cpu / n * 1e6,
        'iterations_per_step': (audit['iterations'] - until['iterations']) / n,
        'factorizations_per_step': (audit['factorizations'] - until['factorizations']) / n,
        'evaluations_per_step': (audit['evaluations'] - until['evaluations']) / n,
        'residual_max': audit['residual_max'],
        'energy_error_max': audit['energy_error_max'],
        'position_drift_max': audit['position_drift_max'],
        'velocity_drift_max': audit['velocity_drift_max'],
        'stagnated': audit['stagnated'],
        'substeps': audit['substeps'],
        'rejected': audit['rejected'],
        'smallest_step': audit['smallest_step'],
        'events': audit['events'],
        **_branches(simulation),
    }


def _branches(simulation: Simulation) -> dict[str, Any]:
    """Branch switches, when the scene asks for them or a rescued step made one."""
    found = simulation.switches
    if simulation.branches is None and not found:
        return {}
    return {'branch_switches': len(found), 'branch_switch_times': [event.t for event in found]}
