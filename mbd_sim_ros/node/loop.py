"""The simulation thread of the node: pacing and requests, without ROS.

The simulation never takes its step from a clock; the clock only decides when the next step of fixed size is due.
Deadlines are absolute (`anchor + k h / rate_factor`), so errors of single sleeps do not add up.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, Protocol

import numpy as np

from mbd_sim_ros.node.latch import Latch, Timed
from mbd_sim_ros.node.priority import prefer
from solver.output.snapshot import Snapshot

LONGEST_WAIT = 0.05  # s between looks at stop flag and requests
SLIP = 0.2  # s behind schedule after which the schedule is given up and starts anew
GLANCE = 5e-4  # s between looks for commands while lockstep waits
REPEAT = 1.0  # s of waiting, in lockstep or paused, after which the state is published again, for those who came late
ENDED = 'the simulation has ended'
WINDOW = 4096  # steps over which step times are judged
AT_ONCE = 0.01  # s, of simulated time and of the clock, that may pass in one call while nobody looks
# calls by which it is judged what steps take; the quickest of them tells, for stalls are as long as they like
LATELY = 8


class Stepper(Timed, Protocol):
    """Parts of solver.simulation.Simulation that the loop needs."""

    def snapshot(self) -> Snapshot: ...
    def advance(self, n: int = 1, inputs: np.ndarray | None = None) -> Snapshot: ...


class Health(NamedTuple):
    """Figures since the last question (step times [s]) and since the start (the counters)."""

    rate: float  # simulated per elapsed time since the last question
    steps: int
    overruns: int  # steps that ended after their deadline
    slips: int  # times the schedule was given up
    step_p50: float
    step_p99: float
    step_max: float
    iterations: int  # of the last step, or the mean of the steps made in one call with it
    residual: float  # the largest of these
    command_age: float  # s of simulation time since the oldest of the newest commands; -1 if none came


class Loop:
    """Runs a simulation on a thread of its own.

    `poll()` fetches what came in since (for the latch), right before every step and while lockstep waits.
    `inputs(values)` turns latched commands into the input vector of the next step (None: the scene's own maneuver
    drives). If it returns the same array as for the step before, it does so while the commands stay. `emit(snapshot)`
    is called on the simulation thread after every step that may be seen, and once at the start. `hidden(most)` tells
    how many of the next steps, at most so many, nobody sees while nobody commands. These are made in one call with the
    one behind them, with the same bits and without what waking costs. In real time the call begins earlier by what they
    take, as the calls made lately tell, so that the step that is seen begins when it is due; none begins before it is,
    for steps take less than they last. `passed()` is called behind each call, `repeat()` from time to time while
    lockstep waits for a first or lost answer, and while paused. dropped: steps that were asked for and not made,
    because of a pause, a resumption or a reset. After the thread has ended `outcome` is a sentence and `error` the
    exception that ended it, if any.
    """

    def __init__(
        self,
        simulation: Stepper,
        latch: Latch,
        *,
        inputs: Callable[[tuple[float, ...]], np.ndarray | None],
        emit: Callable[[Snapshot], None],
        poll: Callable[[], None] = lambda: None,
        repeat: Callable[[], None] = lambda: None,
        hidden: Callable[[int], int] = lambda most: 0,
        passed: Callable[[], None] = lambda: None,
        end_ns: int | None = None,
    ) -> None:
        self.simulation, self.latch, self.pace = simulation, latch, latch.pace
        self.end_ns = end_ns
        self.paused = False
        self.steps = self.overruns = self.slips = self.dropped = 0
        self.outcome = ''
        self.error: BaseException | None = None
        self.done = threading.Event()
        self._inputs, self._emit, self._poll, self._repeat = inputs, emit, poll, repeat
        self._hidden, self._passed = hidden, passed
        self._took: deque[float] = deque(maxlen=LATELY)  # s a step, by call
        self._emitted = 0.0  # clock reading
        self._stop = threading.Event()
        self._wake = threading.Event()
        self._requests: SimpleQueue[tuple[Callable[[], Any], Future]] = SimpleQueue()
        self._pending = 0  # steps asked for
        self._anchor: tuple[float, int, float] | None = None  # clock, step and rate of the schedule in force
        self._times: deque[float] = deque(maxlen=WINDOW)
        self._iterations, self._residual = 0, 0.0
        self._judged = (time.perf_counter(), simulation.t_ns)
        self._begin = time.perf_counter()
        self._thread = threading.Thread(target=self._run, name='simulation', daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self.judge_anew()
        self._begin = self._judged[0]
        self._thread.start()

    def prefer(self, priority: int) -> bool:
        """Give this process a real-time priority, its simulation before its other threads; see
        mbd_sim_ros.node.priority."""
        return prefer(self._thread.native_id, priority)

    @property
    def wall_time(self) -> float:
        """Seconds since the start (or restart)."""
        return time.perf_counter() - self._begin

    def stop(self, outcome: str) -> None:
        """End the thread after the step it is in, and wait for it."""
        self.finish(outcome)
        if self._thread.ident is not None:
            self._thread.join()

    def ask(self, action: Callable[[], Any]) -> Future:
        """Have `action` done on the simulation thread between two steps; the future holds its result or exception."""
        future: Future = Future()
        self._requests.put((action, future))
        self._wake.set()
        if self.done.is_set():  # nobody else will answer any more
            self._answer(RuntimeError(ENDED))
        return future

    def pause(self) -> int:
        """Hold the simulation; returns how many steps that were asked for are not made (to be asked for)."""
        self.paused = True
        return self._drop()

    def resume(self) -> int:
        """Go on as the mode has it; returns how many steps that were asked for are not made for the asking (to be asked
        for)."""
        self.paused = False
        self._anchor = None
        self.judge_anew()
        return self._drop()

    def _drop(self) -> int:
        count, self._pending = self._pending, 0
        self.dropped += count
        return count

    def step(self, count: int) -> None:
        """Do `count` steps now, whether paused or waiting for commands (to be asked for); what was commanded before
        counts in them."""
        if self.pace.lockstep:  # which does not look while it is paused
            self._poll()
        self._pending += count

    @property
    def stepping(self) -> bool:
        """True where requested steps are being made, or are still to be made."""
        return self._pending > 0

    def finish(self, outcome: str) -> None:
        """End the thread after the step it is in, without waiting for it."""
        self.outcome = self.outcome or outcome
        self._stop.set()
        self._wake.set()

    def restart(self) -> None:
        """Forget commands, schedule and counters after the simulation was reset (to be asked for)."""
        self.latch.forget()
        self._drop()
        self._anchor = None
        self.steps = self.overruns = self.slips = 0
        self._times.clear()
        self.judge_anew()
        self._begin = self._judged[0]
        self._show(self.simulation.snapshot())

    def judge_anew(self) -> None:
        """The rate of what was before says nothing of what comes."""
        self._judged = (time.perf_counter(), self.simulation.t_ns)

    def health(self) -> Health:
        """Return the figures since the last call; for one thread."""
        before, begun = self._judged
        self.judge_anew()
        now, t_ns = self._judged
        elapsed, advanced = now - before, (t_ns - begun) * 1e-9
        # a quarter of what numpy takes of the interpreter lock, for which the simulation waits
        times = sorted(self._times) or [0.0]
        self._times.clear()
        p50, p99 = (times[int(part * (len(times) - 1) + 0.5)] for part in (0.5, 0.99))
        return Health(
            advanced / elapsed if elapsed > 0.0 else 0.0, self.steps, self.overruns, self.slips,
            p50, p99, times[-1], self._iterations, self._residual, self.latch.age(t_ns),
        )  # fmt: skip

    def _run(self) -> None:
        try:
            self._show(self.simulation.snapshot())
            while not self._stop.is_set():
                self._answer()
                if self.end_ns is not None and self.simulation.t_ns >= self.end_ns:
                    self.outcome = 'duration reached'
                    break
                ahead = self._steps_ahead()
                if self._due(ahead):
                    self._advance(ahead + 1)
        except BaseException as error:  # whatever it is, the main thread has to learn of it
            self.error = error
            self.outcome = str(error)
        finally:
            self.done.set()
            self._answer(RuntimeError(ENDED))

    def _answer(self, refusal: Exception | None = None) -> None:
        while not self._requests.empty():
            try:
                action, future = self._requests.get_nowait()
            except Empty:  # another thread was faster
                return
            try:
                if refusal is not None:
                    raise refusal
                future.set_result(action())
            except Exception as error:  # the asker gets it
                future.set_exception(error)

    def _steps_ahead(self) -> int:
        """Steps to be made at once before the next that may be seen."""
        if self._pending or self.paused:
            return 0
        h = self.simulation.h_ns * 1e-9
        most = AT_ONCE / h - 1.0
        if self.pace.lockstep:
            most = min(most, self.latch.ahead - 1)
        if self.pace.mode == 'realtime':
            longest = AT_ONCE / min(self._took) if self._took else 1.0
            most = min(most, AT_ONCE * self.pace.rate_factor / h - 1.0, longest - 1.0)
        if self.end_ns is not None:
            most = min(most, (self.end_ns - self.simulation.t_ns) // self.simulation.h_ns - 1)
        return 0 if most < 1.0 else self._hidden(int(most))

    def _due(self, ahead: int) -> bool:
        """Wait, at most LONGEST_WAIT, and return whether a step, with so many ahead of it, is to be done now."""
        if self._pending:
            self._anchor = None
            return True
        if self.paused:
            self._show_again()
            self._sleep(LONGEST_WAIT)
            return False
        if self.pace.mode != 'realtime':
            self._anchor = None  # who goes back to real time begins a schedule
        if self.pace.mode == 'fast':
            return True
        if self.pace.lockstep:
            if not self.latch.waits:
                return True
            self._poll()
            if self.latch.is_answered():
                return True
            self._show_again()
            self._sleep(GLANCE)
            return False
        begin = self._deadline(self.simulation.k + ahead) - (ahead * min(self._took) if ahead else 0.0)
        wait = begin - time.perf_counter()
        if wait > LONGEST_WAIT:
            self._sleep(LONGEST_WAIT)
            return False
        if wait > 0.0:
            time.sleep(wait)
        elif wait < -SLIP:
            self.slips += 1
            self._anchor = None
        return not self._stop.is_set()

    def _deadline(self, k: int) -> float:
        """Return the clock reading at which step k begins."""
        if self._anchor is None or self._anchor[2] != self.pace.rate_factor:
            self._anchor = (time.perf_counter(), self.simulation.k, self.pace.rate_factor)
        clock, k0, rate = self._anchor
        return clock + (k - k0) * self.simulation.h_ns * 1e-9 / rate

    def _sleep(self, longest: float) -> None:
        self._wake.wait(longest)
        self._wake.clear()

    def _advance(self, n: int) -> None:
        """Make n steps, of which the last may be seen, with the commands there are."""
        if not self.pace.lockstep:  # which has polled, and must not mix in what came since
            self._poll()
        self.latch.use()  # in lockstep, these are no newer than the last step, whatever made it
        begin = time.perf_counter()
        snapshot = self._make(n)
        end = time.perf_counter()
        each = (end - begin) / n
        self._times.append(each)
        self._took.append(each)
        self._iterations, self._residual = round(snapshot.counters.iterations / n), snapshot.counters.residual
        self.steps += n
        k = self.simulation.k
        if n > 1 and self._keeps_time and (early := self._deadline(k - 1) - end) > 0.0:
            time.sleep(early)  # they took less than ever lately: nothing is shown before it is due
        self._show(snapshot)
        self._pending -= self._pending > 0  # made and shown
        if self._keeps_time and self._emitted > self._deadline(k):
            self.overruns += 1

    @property
    def _keeps_time(self) -> bool:
        """True where a schedule is in force."""
        return self.pace.mode == 'realtime' and self._anchor is not None

    def _show(self, snapshot: Snapshot) -> None:
        self._emit(snapshot)
        self._emitted = time.perf_counter()

    def _show_again(self) -> None:
        """Show who came meanwhile what was shown long ago."""
        if time.perf_counter() - self._emitted > REPEAT:
            self._emitted = time.perf_counter()
            self._repeat()

    def _make(self, n: int) -> Snapshot:
        """Make n steps in one call."""
        try:
            return self.simulation.advance(n, inputs=self._next_inputs(n))
        finally:
            self._passed()

    def _next_inputs(self, n: int) -> np.ndarray | None:
        """(n, nu) inputs of the next n steps, or (nu,) that are held."""
        t_ns, h_ns = self.simulation.t_ns, self.simulation.h_ns
        values = self.latch.at(t_ns)
        row = self._inputs(values)
        if row is None or n == 1:
            return row
        stay = self.latch.at(t_ns + (n - 1) * h_ns) is values
        rows: list[np.ndarray | None] = [row]
        for i in range(1, n):
            before, row = row, self._inputs(values if stay else self.latch.at(t_ns + i * h_ns))
            if stay and row is before:  # as it does while the commands stay
                if i == 1:
                    return row
                rows += [row] * (n - i)
                break
            rows.append(row)
        return np.array(rows)
