"""Running a simulation as fast as it goes, recorded like the node records it.

The file is long because a run, its recording, its error bar and its failure share one loop of steps.
"""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from tqdm import tqdm

from mbd_sim_ros import interrupts
from mbd_sim_ros.bags.applied import begin_of
from mbd_sim_ros.bags.recorder import StepRecorder, about, describe
from mbd_sim_ros.messages.encode import Messages, finite_rows, require_finite
from solver.analysis.balance import Balance
from solver.analysis.certificate_coverage import weighed
from solver.analysis.envelope import Envelope
from solver.analysis.error_bar import NOT_ASKED, ErrorBar, Twin
from solver.analysis.reactions import undetermined
from solver.analysis.verdict import ERROR, passes, report, status_of
from solver.errors import MbdError, StepError
from solver.files.scene import load_scene_text
from solver.findings import Finding
from solver.model.state import Saved
from solver.output.seen import Seen
from solver.output.snapshot import Snapshot
from solver.simulation import Simulation

UNRECORDED_CHUNK = 100  # steps between two looks when nobody asks for more
ROWS = 64  # instants that are looked at in one call, at most; ten times as many leave the caches of a processor
LAST = 200  # steps before a failure that are recorded every one
LAST_STEPS = 'last_steps'  # name of their recording, in the directory of the run
DEAF = 0.1  # s that a call of many steps may take; nobody looks for signals meanwhile


class InputSource(Protocol):
    """Gives the inputs of n steps from step k0 on, (n, nu)."""

    def table(self, k0: int, n: int) -> np.ndarray: ...


class Portion:
    """Number of steps that a call may do: twice as many as the last one while that took less than DEAF seconds. Bits do
    not depend on it."""

    def __init__(self) -> None:
        self.most = 1

    def took(self, steps: int, seconds: float) -> None:
        """A call of so many steps took so long."""
        fitting = int(DEAF * steps / seconds) if seconds > 0.0 else 2 * steps
        self.most = max(1, min(2 * max(steps, self.most), fitting))


def record(
    simulation: Simulation,
    directory: Path,
    *,
    frame_prefix: str = '',
    parameters: Mapping[str, Any] | None = None,
    wait: bool = True,
) -> tuple[Messages, StepRecorder]:
    """The encoder and the recorder of a simulation's scene; the recording begins with its state now.

    frame_prefix: put before every frame name. parameters: for the description. wait: as Recorder takes it. Raises
    BagError when the directory cannot be written.
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
    return messages, StepRecorder(directory, messages.topics, channels.inputs, simulation.k, metadata, wait=wait)


def require_finite_rows(seen: Seen, simulation: Simulation) -> None:
    """Raise StepError where something that was seen is not finite; see require_finite()."""
    bad = finite_rows(seen.numbers, simulation.channels)
    if bad < len(seen.numbers):
        require_finite(simulation.snapshot_of(int(seen.steps[bad]), seen.numbers[bad]), simulation.channels)


def warm_up(simulation: Simulation) -> None:
    """Compile what a step needs, outside of any measurement; the simulation is at its start afterwards."""
    with suppress(MbdError):  # it will fail again, where it is reported
        simulation.advance(min(2, simulation.scene.steps), seen=simulation.seen(1, 2))  # a driver is alone in one step
    simulation.reset()


class _Meter:
    """Speed of the steps of a run, of which a call does a portion."""

    def __init__(self, simulation: Simulation) -> None:
        self._simulation, self._first, self._until = simulation, simulation.k, simulation.totals()
        self._begin, self._cpu = time.perf_counter(), 0.0
        self.portion = Portion()

    def advance(self, n: int, inputs: np.ndarray | None, seen: Seen) -> StepError | None:
        """Make n steps in one call; why not all of them were made."""
        started, clock = time.thread_time(), time.perf_counter()
        try:
            self._simulation.advance(n, inputs, seen=seen)
        except StepError as failure:
            return failure
        finally:
            self._cpu += time.thread_time() - started
            self.portion.took(n, time.perf_counter() - clock)
        return None

    def figures(self) -> dict[str, Any]:
        """The figures of the run up to now."""
        return _figures(self._simulation, self._first, self._until, time.perf_counter() - self._begin, self._cpu)


class _Track:
    """The recording of a run, or none: then it only looks whether what is shown is finite."""

    def __init__(
        self, simulation: Simulation, directory: Path | None, frame_prefix: str, parameters: Mapping[str, Any] | None
    ) -> None:
        self._simulation = simulation
        self._writing = None
        self._written = -1  # step whose messages were recorded last
        self.every = UNRECORDED_CHUNK if directory is None else simulation.scene.record.every
        if directory is not None:
            self._writing = record(simulation, directory, frame_prefix=frame_prefix, parameters=parameters)

    def show(self) -> None:
        """Record the present state, unless that is done."""
        if self._writing is None:
            require_finite(self._simulation.snapshot(), self._simulation.channels)
        elif self._written != self._simulation.k:
            self._take(*self._writing, self._simulation.snapshot())

    def follow(self, first: int, seen: Seen) -> None:
        """Note the inputs of the steps behind step `first`, and record what was seen of them where it is its turn."""
        simulation, at = self._simulation, first
        if self._writing is None:
            require_finite_rows(seen, simulation)
            return
        messages, recorder = self._writing
        turn = seen.steps % self.every == 0
        steps, rows = seen.steps[turn], seen.numbers[turn]
        times = steps * simulation.h_ns
        for t_ns, k, encoded in zip(times.tolist(), steps.tolist(), messages.encode_rows(steps, times, rows)):
            self._note(recorder, first, at, k)
            at = self._written = k
            recorder.record(t_ns, encoded)
        require_finite_rows(seen, simulation)
        self._note(recorder, first, at, simulation.k)

    def _note(self, recorder: StepRecorder, first: int, begin: int, end: int) -> None:
        """Note the inputs of the steps from `begin` to `end`, of a call that began at step `first`."""
        if self._simulation.applied is not None and end > begin:
            recorder.note(end, self._simulation.applied[begin - first : end - first])

    def _take(self, messages: Messages, recorder: StepRecorder, snapshot: Snapshot) -> None:
        recorder.record(snapshot.t_ns, messages.encode(snapshot))
        self._written = snapshot.k

    def close(self, verdict: Mapping[str, str], figures: Mapping[str, Any]) -> None:
        """Finish the recording."""
        if self._writing is not None:
            events = json.dumps([event._asdict() for event in self._simulation.events])
            self._writing[1].close(
                {**verdict, **{key: f'{value!r}' for key, value in figures.items()}, 'event_list': events}
            )


class _Past:
    """A state from LAST steps ago at least; `state` is empty before there is one."""

    def __init__(self, simulation: Simulation) -> None:
        self.state: dict[str, np.ndarray] = {}
        self._simulation = simulation
        self._recent = (simulation.k, self.state)

    def follow(self) -> int:
        """Keep the present state where the last one that was kept is LAST steps old; steps until the next turn."""
        k, recent = self._recent
        if self._simulation.k >= k + LAST:
            k, self.state, self._recent = self._simulation.k, recent, (self._simulation.k, self._simulation.arrays())
        return k + LAST - self._simulation.k


@dataclass(kw_only=True)
class _Run:
    """A run while it is made: who follows its steps, and what becomes of it.

    twin: measures its error, where somebody asks for it. status, found, covered, explaining, signal, failure: how it
    ended, what makes it suspect, what of that a certificate or its error takes the place of, and the number of the
    signal or the error that ended it early.
    """

    simulation: Simulation
    steps: int
    source: InputSource | None
    track: _Track
    past: _Past | None
    meter: _Meter
    balances: Balance | None
    envelope: Envelope
    twin: Twin | None = None
    error: ErrorBar = NOT_ASKED
    status: str = ERROR
    found: Sequence[Finding] = ()
    covered: Sequence[Finding] = ()
    explaining: Sequence[Finding] = ()
    figures: dict[str, Any] = field(default_factory=dict)
    signal: int = 0
    failure: StepError | None = None

    def make(self) -> Iterator[int]:
        """Make the steps, up to `steps` or a signal; gives the number of each call."""
        simulation, steps, every = self.simulation, self.steps, self.track.every
        look = self.envelope.every(simulation.h_ns) or every
        seen = simulation.seen(math.gcd(look, every), ROWS)
        while simulation.k < steps and not interrupts.received():
            k = simulation.k
            wanted = steps if self.twin is None or self.twin.next is None else self.twin.next
            n = 1 if self.balances else min(wanted - k, self.meter.portion.most, (ROWS - 1) * seen.every)
            if self.past is not None:
                n = min(n, self.past.follow())
            failure = self.meter.advance(n, None if self.source is None else self.source.table(k, n), seen)
            looked = seen.steps % look == 0  # whatever is recorded, and however fast the machine is
            self.envelope.look_at(seen.steps[looked] * simulation.h_ns, seen.numbers[looked])
            self.track.follow(k, seen)
            if failure is not None:
                raise failure
            if self.twin is not None:
                self.twin.note(simulation.snapshot())
            if self.balances:
                self.balances.update()
            yield n
        if simulation.k == steps and steps % look:
            self.envelope.look(simulation.snapshot())

    def measure(self) -> Iterator[int]:
        """Make the steps of the twin, up to a signal; gives the number of each call."""
        portion = Portion()
        clock = time.perf_counter()
        for n in self.twin.make(lambda: portion.most) if self.twin is not None and not interrupts.received() else ():
            portion.took(n, time.perf_counter() - clock)
            yield n
            if interrupts.received():
                break
            clock = time.perf_counter()

    def judge(self) -> None:
        """Say what became of steps that did not fail."""
        ended = self.simulation.k == self.steps
        self.signal = interrupts.received() if not ended or (self.twin is not None and not self.twin.done) else 0
        if self.twin is not None and ended:
            self.error = self.twin.result()
        rate = self.figures['real_time_factor']
        self.found, self.covered, self.explaining = weighed(self.simulation, self.envelope, rate, error=self.error)
        self.status = status_of(self.found, interrupted=bool(self.signal) and not ended)

    def close(self) -> dict[str, Any]:
        """Finish the recording with the verdict; returns the figures."""
        figures = self.figures or self.meter.figures()
        verdict = {'status': self.status, 'findings': json.dumps(report(self.found)), 'error_text': self.error.text}
        if told := undetermined(self.simulation):
            verdict['reactions_text'] = told
        for name, some in (('covered', self.covered), ('explaining', self.explaining)):
            if some:
                verdict[name] = json.dumps(report(some))
        if self.error.measured:
            verdict['errors'] = json.dumps(self.error.report())
        self.track.close(verdict, figures)
        return figures


def simulate(
    simulation: Simulation,
    steps: int,
    *,
    directory: Path | None = None,
    source: InputSource | None = None,
    progress: bool = False,
    balance: bool = False,
    state: bytes | None = None,
    from_start: bool = True,
    frame_prefix: str = '',
    parameters: Mapping[str, Any] | None = None,
    looking_back: bool = True,
    error: bool = False,
) -> dict[str, Any]:
    """Advance to step `steps`, from the start or from a saved state, and return the figures of the run.

    directory: where to record; None records nothing.
    source: gives the inputs; None takes the maneuver of the scene.
    progress: show a bar if stderr is a terminal.
    balance: follow energy and momentum by element kind, which costs time.
    state: bytes of Simulation.save() to start from. from_start: record the state at the beginning too.
    frame_prefix, parameters: as record() takes them.
    looking_back: a run that fails leaves a second recording, `last_steps`. It has every step of the last LAST at least,
    and begins with a saved state, so that `mbd replay` can start just before the failure.
    error: measure the numerical error by a twin with another step (solver.analysis.error_bar). The twin costs half the
    steps again; it is made only of a run from the start by its own maneuver.

    The figures have `status` ('ok' or 'suspect'), `findings` with the reasons, `covered` with findings that the
    certificate of a plan covers (solver.analysis.certificate_coverage), `explaining` with findings in whose place the
    error decides, `errors` and `error_text`, `reactions_text` (solver.analysis.reactions.undetermined). `passed` is
    false where the scene does not allow what was found.

    A recording is always closed, with the verdict or with what ended the run. Raises StepError, BagError, and
    KeyboardInterrupt(sentence to show, signal number) between two steps.
    """
    measured = error and state is None and source is None
    with tqdm(
        total=steps + steps // 2 * measured,
        unit='step',
        desc='compiling',
        disable=None if progress else True,
        leave=False,
    ) as bar:
        interrupts.now(f'preparing {simulation.scene.name}')
        warm_up(simulation)
        if state is not None:
            simulation.restore(state)
        interrupts.check()
        bar.set_description(simulation.scene.name)
        bar.unpause()
        track = _Track(simulation, directory, frame_prefix, parameters)
        with interrupts.held():
            run = _Run(
                simulation=simulation,
                steps=steps,
                source=source,
                track=track,
                past=_Past(simulation) if looking_back and directory is not None else None,
                meter=_Meter(simulation),
                balances=Balance(simulation) if balance else None,
                envelope=Envelope(simulation),
                twin=Twin(simulation, steps) if measured else None,
            )
            try:
                if from_start:
                    track.show()
                for n in run.make():
                    bar.update(n)
                track.show()  # interrupted right behind a step
                run.figures = run.meter.figures()
                for n in run.measure():
                    bar.update(n)
                run.judge()
            except StepError as failure:
                run.failure = failure
            finally:
                figures = run.close()
    if run.failure is not None:
        if run.past is None or directory is None or simulation.scene.controllers:  # which nobody asks to fail again
            raise run.failure
        begin = Saved.of(run.past.state) if run.past.state else state
        there = directory / LAST_STEPS
        where = _last_steps(simulation, steps, there, source, begin, frame_prefix, parameters)
        raise StepError(f'{run.failure}; {where}') from run.failure
    if run.signal:
        kept = f'; the recording in {directory} is complete up to there' if directory is not None else ''
        at = f'at t = {simulation.t_ns * 1e-9:g} s (step {simulation.k})'
        if simulation.k == steps:
            at, kept = 'while the numerical error was measured', kept.replace('up to there', 'without it')
        raise KeyboardInterrupt(f'interrupted {at}{kept}', run.signal)
    return {
        'status': run.status,
        'findings': report(run.found),
        'covered': report(run.covered),
        'explaining': report(run.explaining),
        'errors': run.error.report(),
        'error_text': run.error.text,
        'reactions_text': undetermined(simulation),
        'passed': passes(simulation, run.found),
        **figures,
        **(run.balances.report() if run.balances else {}),
        'out': None if directory is None else str(directory),
    }


def _last_steps(
    simulation: Simulation,
    steps: int,
    directory: Path,
    source: InputSource | None,
    state: bytes | None,
    frame_prefix: str,
    parameters: Mapping[str, Any] | None,
) -> str:
    """Record the steps from a state (None: the start) to the failure, every one; returns a phrase that says where they
    are."""
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
    """Speed of the steps made since step `first`, when the totals were `until`, and accuracy of the whole run. wall,
    cpu: seconds spent in all and in the steps.
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
