"""Steps and penalties that adapt, seen from Python: the memory that a saved state holds, and every change as an Event.

The work is compiled (solver.step.interval, attempt and penalties); the arrays that it works on are in
solver.step.control.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from solver.compiled import interruption
from solver.compiled.by_reference import Ref
from solver.inputs.driving import Driven
from solver.model.state import State
from solver.model.tables import Model
from solver.output.seen import Seen
from solver.output.snapshot import NO_STEPS
from solver.step import control as entry
from solver.step.control import CAUSES, KINDS, Control, Event, new_control
from solver.step.driven import advance_driven_adapting
from solver.step.interval import advance_adapting
from solver.step.seen import advance_adapting_seen
from solver.step.settings import IntegratorSettings
from solver.step.work import OK, PAUSED, StepResult


def is_idle(memory: dict[str, np.ndarray], h: float, penalty: np.ndarray) -> bool:
    """True where the last step was one of h [s], the next is to be one, and penalties are those given: a run with both
    constant may go on."""
    size, _, wanted = memory['adaptation'][:3]
    return size == wanted == h and np.array_equal(memory['penalty'], penalty)


class Adaptation:
    """Advances a model over the output grid with steps and penalties of its own choice."""

    def __init__(
        self, model: Model, settings: IntegratorSettings, scheme: Ref, work: Ref, hold: float, fourth: int
    ) -> None:
        self.model, self.scheme, self.work = model, scheme, work
        self.control = new_control(model, settings, hold, fourth, work.account.numbers.size)
        self.events: list[Event] = []
        self.noted = 0  # events since start(), also those of the run that saved the state this one goes on from
        self.smallest = np.inf  # step that was changed to since then [s]
        self._ready = False  # the driver has given the inputs of the interval that is open
        self.abandoned = False  # the last advance() left an interval again, because somebody asked for it
        self._progress, self._counts = self.values.progress, self.values.counts

    @property
    def values(self) -> Control:
        """The arrays that the compiled control works on."""
        value: Control = self.control.value
        return value

    @property
    def substeps(self) -> int:
        """Steps that were accepted since start()."""
        return int(self.values.counts[entry.SUBSTEPS])

    @property
    def rejected(self) -> int:
        """Attempts that were not, since start()."""
        return int(self.values.counts[entry.REJECTED])

    def start(self, state: State, taken: int = 0) -> None:
        """Begin at a state made for a step of the grid; the projected velocity is in the work of the step. taken: such
        steps before."""
        c = self.values
        c.history.size[:] = c.grid
        c.history.offset[:] = state.v - self.work.v_out
        c.history.z_rate[:] = 0.0
        c.memory[entry.WANTED], c.memory[entry.TAKEN] = c.grid, c.grid / c.group
        c.memory[entry.LAST_ERROR] = c.error_tolerance
        c.memory[entry.EASY], c.memory[entry.PATIENCE] = 0.0, entry.EASY_STEPS
        c.counts[:] = taken, 0, 0
        c.progress[:] = 0.0
        self.scheme.penalty[:] = c.base
        self.events.clear()
        self.noted, self.smallest = 0, np.inf

    def memory(self) -> dict[str, np.ndarray]:
        """Everything the future depends on, as arrays."""
        c = self.values
        return {
            'adaptation': np.concatenate([c.history.size, c.memory]),
            'offset': c.history.offset.copy(),
            'z_rate': c.history.z_rate.copy(),
            'penalty': self.scheme.penalty.copy(),
        }

    def past(self) -> dict[str, np.ndarray]:
        """Past of a run as it reports it, for recall() beside memory(). Events enter by their number alone: a long run
        has many."""
        return {'counts': np.array([self.substeps, self.rejected, self.noted, self.smallest])}

    def recall(self, memory: dict[str, np.ndarray], t: float) -> None:
        """Inverse of memory() and past(), at time t [s]; events from then on are forgotten."""
        c = self.values
        c.history.size[:], c.memory[:] = memory['adaptation'][:2], memory['adaptation'][2:]
        c.history.offset[:], c.history.z_rate[:] = memory['offset'], memory['z_rate']
        c.progress[:] = 0.0
        self.scheme.penalty[:] = memory['penalty']
        self.events[:] = [event for event in self.events if event.t < t]
        c.counts[entry.SUBSTEPS], c.counts[entry.REJECTED] = memory['counts'][:2]
        self.noted, self.smallest = int(memory['counts'][2]), float(memory['counts'][3])

    def advance(
        self,
        states: list[Ref],
        inputs: np.ndarray,
        first: int,
        count: int,
        k: int,
        audit: bool,
        look: Callable[[int], None],
        seen: Seen | None = None,
        numbers: np.ndarray | None = None,
        driven: Driven | None = None,
    ) -> tuple[StepResult, int]:
        """Advance over count intervals of the grid, from index k on, with rows first.. of inputs (n, nu); states[0] is
        the newest state afterwards.

        A single row of inputs holds for all. look(n) is called behind the n-th interval if a step failed in it. seen:
        takes rows of `numbers`, of which work.arrays are views. driven: adds what it does to the inputs. Returns
        (summed counters, intervals done); after a failure the state is that at the start of the interval. Fewer
        intervals than asked for are done without failure only when somebody asks for the run to stop
        (solver.compiled.interruption) and an interval takes long.
        """
        progress = self._progress
        self.abandoned = self._ready = False
        result, done, swapped = self._call(states, inputs, first, count, k, audit, seen, numbers, driven)
        if swapped:
            states.reverse()
        if result.status == OK and not self._counts[entry.PENDING]:
            return result, done  # as nearly always
        total = NO_STEPS
        while True:
            total = total.followed_by(result.counters)
            self._drain()
            if result.status != PAUSED:
                return StepResult(result.status, result.where, total), done
            if progress[entry.ABANDON]:
                self.abandoned, progress[entry.ABANDON] = True, 0.0
                return StepResult(OK, 0, total), done
            if progress[entry.OPEN]:
                progress[entry.ABANDON] = float(interruption.requested())
            else:
                look(k + done)
                if done == count:
                    return StepResult(OK, 0, total), done
            result, n, swapped = self._call(
                states, inputs, first + done, count - done, k + done, audit, seen, numbers, driven
            )
            done += n
            if swapped:
                states.reverse()

    def _call(
        self,
        states: list[Ref],
        inputs: np.ndarray,
        first: int,
        count: int,
        k: int,
        audit: bool,
        seen: Seen | None,
        numbers: np.ndarray | None,
        driven: Driven | None,
    ) -> tuple[StepResult, int, bool]:
        """One call of compiled code; see advance_adapting()."""
        tables, scheme, control, work = self.model.tables, self.scheme, self.control, self.work
        if driven is not None:
            assert numbers is not None
            every, rows = (0, numbers[None]) if seen is None else (seen.every, seen.free)
            result, done, swapped, taken, self._ready = advance_driven_adapting(
                tables, scheme, control, *states, driven.driver, driven.wanted, inputs, first, count, k, self._ready,
                audit, every, numbers, rows, work,
            )  # fmt: skip
            if seen is not None:
                seen.took(k, taken)
            return result, done, swapped
        if seen is None:
            found: tuple[StepResult, int, bool] = advance_adapting(
                tables, scheme, control, *states, inputs, first, count, k, audit, work
            )
            return found
        result, done, swapped, taken = advance_adapting_seen(
            tables, scheme, control, *states, inputs, first, count, k, audit, seen.every, numbers, seen.free, work
        )
        seen.took(k, taken)
        return result, done, swapped

    def _drain(self) -> None:
        """Take the events out of the buffer."""
        c = self.values
        for t, kind, row, old, new, cause in c.events[: c.counts[entry.PENDING]].tolist():
            name = self.model.row_names[int(row)] if row >= 0.0 else ''
            self.events.append(Event(t, KINDS[int(kind)], name, old, new, CAUSES[int(cause)]))
            self.noted += 1
            if kind == entry.OF_STEP:
                self.smallest = min(self.smallest, new)
        c.counts[entry.PENDING] = 0
