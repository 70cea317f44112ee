"""Step and penalties that follow the iteration and the local error; every change is an Event.

The grid of inputs and outputs is fixed, k h; inside an interval of it the step is chosen freely, so time stays an integer.

*Penalties* (`penalty_policy: adaptive`; the formulation leaves the rules open, these are ours). An iteration that stagnates with
constraints open is repeated from the start of the step with larger penalties of the slowest constraints: those with the largest
violation, weighed by the masses behind them. Where it would be accepted as it is, a raise that does not help is taken back; where the
step would fail, all penalties are raised. After easy steps all return towards the setting.

*Step* (`step_policy`). `rescue`: a step that fails is halved and taken again from its start; after easy steps it doubles. `error`: two
steps of h/2 are compared with one of h from the same start; a third of the difference is the local error of the two (second order,
[Hairer1993] II.4), and a PI controller [Gustafsson1991] holds its rate at the tolerance, so that the error of a run is proportional to it.

*History.* The algorithm's acceleration a_n belongs to t_n + (am - af) h, the rates of internal states to t_n + (am1 - af) h, and the
velocity satisfies A v + phi_t = -h^2 A e (solver.start.newton). When the next step is of another size all three are moved to where
that step expects them, or each change would cost an order. What was moved is put back if the step is not accepted.
"""

from __future__ import annotations

import math
from typing import NamedTuple, cast

import numpy as np

from solver.compiled.by_reference import Ref
from solver.inputs.maneuver import ACCELERATION, RATE, is_motion
from solver.model.state import State, copy_state, new_state
from solver.model.tables import Model
from solver.output.energy import note_residuals, update_energy
from solver.output.snapshot import NO_STEPS
from solver.step.augmented_lagrangian import LARGEST_STAGNATION, step
from solver.step.settings import IntegratorSettings
from solver.step.work import BAD_INPUT, INACCURATE, NOT_CONVERGED, OK, StepResult

RAISE = 10.0  # of a penalty at a time
SLOW = 0.1  # constraints with at least this part of the largest violation are the slowest
HELPS = 0.5  # a raise that leaves more of the residual is taken back
EASY_ITERATIONS = 4
EASY_STEPS = 10  # in a row before penalties and step relax; twice as many after every new trouble
LONGEST_PATIENCE = 640
ORDER = 2.0  # of the error per unit of time
SAFETY = 0.9
INTEGRAL, PROPORTIONAL = 0.7 / ORDER, 0.4 / ORDER
SMALLEST_FACTOR, LARGEST_FACTOR = 0.2, 2.0
WORTHWHILE = 1.2  # growth below it is not taken: a step that stays costs no history
ROUNDING = 1e-16  # m or rad; over a step it is a velocity that the iteration cannot resolve
SMALLEST_TOLERANCE = 1e-13
REMAINDER = 0.1  # of the tolerable error that the iteration may leave


class Event(NamedTuple):
    """A change of the step or of the penalty of a constraint row; kind 'error': the error that had to be accepted."""

    t: float  # start of the step that caused it [s]
    kind: str  # 'step' | 'penalty' | 'error'
    name: str  # of the row, else empty
    old: float  # s, or dimensionless
    new: float
    cause: str  # 'failure' | 'error' | 'stagnation' | 'no help' | 'easy' | 'undetermined'


class History(NamedTuple):
    """What a state needs beside itself when the next step is of another size."""

    h: float  # of the step that led to it [s]
    between: float  # from the stage before the last to the last [s]
    offset: np.ndarray  # (nb + 1, 6) its velocity minus the projected one
    z_rate: np.ndarray  # (nz,) rate of zd


class Attempt(NamedTuple):
    """One step, or two with an estimate of the rate of their local error [1/s]."""

    result: StepResult
    error: float
    history: History


Span = tuple[float, float]  # begin and end as fractions of the interval
Inputs = tuple[np.ndarray, np.ndarray]  # of the interval before and of this one


def is_stuck(result: StepResult) -> bool:
    """Whether the iteration ended before the tolerance."""
    return result.status == NOT_CONVERGED or (result.status == OK and result.counters.stagnated > 0)


def is_undetermined(tried: list[tuple[float, float]], allowed: float) -> bool:
    """Whether the last of some steps (h, rate of its error) is hardly more accurate than the one before, and its error is allowed.

    Next to a singular position the motion is determined only so far, and a jump of the forces has an error of rate one however
    small the step: the step with the smallest error is then the one to take. Truncation errors fall with the square.
    """
    if len(tried) < 2:
        return False
    (h_before, before), (h, error) = tried[-2:]
    return error > before * math.sqrt(h / h_before) and min(h * error for h, error in tried[-2:]) <= allowed


class Adaptation:
    """Advances a model over the output grid with steps and penalties of its own choice."""

    def __init__(self, model: Model, settings: IntegratorSettings, coefficients: Ref, work: Ref, outputs: np.ndarray) -> None:
        self.model, self.settings, self.scheme, self.work = model, settings, coefficients, work
        self.grid = settings.h_ns * 1e-9
        self.base = coefficients.penalty.copy()
        self.events: list[Event] = []
        self.by_error = settings.step_policy == 'error'
        self.group = 2 if self.by_error else 1  # steps that are taken together
        self.usual_cause = 'error' if self.by_error else 'easy'  # of a change of the step when nothing went wrong
        self._full, self._half = (Ref(new_state(model)) for _ in range(2))
        self._begin = new_state(model)
        self._kin, self._outputs = Ref(work.kin_end), outputs
        self._constraints = Ref(model.tables.constraints)
        names = model.spec.inputs
        motions = [n for n in names if is_motion(n, names)]
        self._motion = np.array([[names.index(n + end) for n in motions] for end in ('', RATE, ACCELERATION)], int).reshape(3, -1)

    # -- state ---------------------------------------------------------------------------------------------------------

    def start(self, state: State) -> None:
        """Begin at a state made for a step of the grid; the projected velocity is in the work of the step."""
        self.history = History(self.grid, self.grid, state.v - self.work.v_out, np.zeros(self.model.n_internal))
        self.wanted, self.taken = self.grid, self.grid / self.group
        self.last_error = self.settings.error_tolerance
        self.easy, self.patience = 0, EASY_STEPS
        self.substeps = self.rejected = 0
        self.scheme.penalty[:] = self.base
        self.events.clear()

    def memory(self) -> dict[str, np.ndarray]:
        """Everything the future depends on, as arrays."""
        h = self.history
        numbers = (h.h, h.between, self.wanted, self.taken, self.last_error, self.easy, self.patience)
        return {
            'adaptation': np.array(numbers),
            'offset': h.offset.copy(),
            'z_rate': h.z_rate.copy(),
            'penalty': self.scheme.penalty.copy(),
        }

    def recall(self, memory: dict[str, np.ndarray], t: float) -> None:
        """Inverse of memory(), at time t [s]; events from then on are forgotten."""
        h, between, self.wanted, self.taken, self.last_error, easy, patience = (float(x) for x in memory['adaptation'])
        self.easy, self.patience = int(easy), int(patience)
        self.history = History(h, between, memory['offset'].copy(), memory['z_rate'].copy())
        self.scheme.penalty[:] = memory['penalty']
        self.events[:] = [event for event in self.events if event.t < t]

    # -- the output grid -----------------------------------------------------------------------------------------------

    def advance(self, states: list[Ref], before: np.ndarray, inputs: np.ndarray, k: int, audit: bool) -> tuple[StepResult, int]:
        """Advance by one grid interval per row of inputs (n, nu), from index k on; states[0] is the newest state afterwards.

        before (nu,): inputs of the interval before. Returns (summed counters, intervals done); after a failure the state is that
        at the start of the interval.
        """
        self._sum = NO_STEPS
        if not np.isfinite(inputs).all():
            return StepResult(BAD_INPUT, int(np.argwhere(~np.isfinite(inputs))[0, 1]), self._sum), 0
        for n, row in enumerate(inputs):
            t = (k + n) * self.settings.h_ns * 1e-9
            result = self._interval(states, before, row, t, audit, n == len(inputs) - 1)
            if result.status != OK:
                return StepResult(result.status, result.where, self._sum), n
            before = row
        return StepResult(OK, 0, self._sum), len(inputs)

    def _interval(self, states: list[Ref], before: np.ndarray, now: np.ndarray, t: float, audit: bool, outputs: bool) -> StepResult:
        copy_state(cast(State, states[0].value), self._begin)
        kept = (self.history, self.wanted, self.taken, self.last_error, self.easy, self.patience)
        penalty, energy = self.scheme.penalty.copy(), self.work.energy.copy()
        done, cause = 0.0, self.usual_cause
        inaccurate: list[tuple[float, float]] = []  # step and error of the attempts at the next step so far
        undetermined = False
        while done < 1.0:
            count = max(1, math.ceil((1.0 - done) * self.grid / self.wanted - 1e-9))
            part = (1.0 - done) / count
            end = 1.0 if count == 1 else done + part
            here = t + done * self.grid
            h = self._note_step(here, part * self.grid / self.group, cause)
            before_attempt = self.work.energy.copy()
            attempt = self._pair if self.by_error else self._single
            result, error, history = attempt(states, h, (done, end), (before, now), here, (audit, audit or (outputs and count == 1)))
            accurate = not error > self.settings.error_tolerance
            if result.status == OK and (accurate or undetermined):
                states.reverse()
                self.history = history
                self.substeps += self.group
                self._after_success(here, result, error)
                cause = self.usual_cause
                if not accurate:
                    self.events.append(Event(here, 'error', '', self.settings.error_tolerance, error, 'undetermined'))
                    self.wanted, self.last_error = min(self.grid, self.group * LARGEST_FACTOR * h), self.settings.error_tolerance
                done, undetermined = end, False
                inaccurate.clear()
                continue
            self.rejected += 1
            self.work.energy[:] = before_attempt
            smallest = h <= self.settings.h_min * (1.0 + 1e-9)
            cause, factor = 'failure', 0.5
            if result.status == OK:
                cause, factor = 'error', SAFETY * (self.settings.error_tolerance / error) ** (1.0 / ORDER)
                inaccurate.append((h, error))
            undetermined = result.status == OK and is_undetermined(inaccurate, self.settings.error_tolerance * self.grid)
            if smallest and not undetermined:
                copy_state(self._begin, cast(State, states[0].value))
                self.work.energy[:] = energy
                self.scheme.penalty[:] = penalty
                self.history, self.wanted, self.taken, self.last_error, self.easy, self.patience = kept
                return result if result.status != OK else result._replace(status=INACCURATE)
            smaller = max(h * min(SAFETY, max(SMALLEST_FACTOR, factor)), self.settings.h_min)
            self.wanted = self.group * (min(inaccurate, key=lambda tried: tried[1])[0] if undetermined else smaller)
            self.easy, self.patience = 0, min(2 * self.patience, LONGEST_PATIENCE)
        return result

    def _note_step(self, t: float, h: float, cause: str) -> float:
        if abs(h - self.history.h) < 1e-12 * h:
            h = self.history.h  # the same but for rounding
        if abs(h - self.taken) > 1e-9 * h:
            self.events.append(Event(t, 'step', '', self.taken, h, cause))
            self.taken = h
        return h

    def _after_success(self, t: float, result: StepResult, error: float) -> None:
        """Relax penalties and choose the next step."""
        if self.by_error:
            ratio = max(error / self.settings.error_tolerance, 1e-6)
            last = max(self.last_error / self.settings.error_tolerance, 1e-6)
            factor = min(LARGEST_FACTOR, max(SMALLEST_FACTOR, SAFETY * ratio**-INTEGRAL * last**PROPORTIONAL))
            if factor < 1.0 or factor >= WORTHWHILE:
                self.wanted = min(self.grid, self.group * max(self.taken * factor, self.settings.h_min))
            self.last_error = error
        easy = not is_stuck(result) and result.counters.iterations <= EASY_ITERATIONS
        self.easy = self.easy + 1 if easy else 0
        if self.easy < self.patience:
            return
        self.easy = 0
        penalty = self.scheme.penalty
        raised = bool((penalty > self.base).any())
        self._set_penalties(t, np.maximum(self.base, penalty / RAISE), 'easy')
        if not self.by_error and self.wanted < self.grid:
            self.wanted = min(self.grid, 2.0 * self.wanted)
        elif not raised:
            self.patience = max(EASY_STEPS, self.patience // 2)

    # -- attempts ------------------------------------------------------------------------------------------------------

    def _single(self, states: list[Ref], h: float, span: Span, u: Inputs, t: float, outputs: tuple[bool, bool]) -> Attempt:
        """One step from states[0] to states[1]; no error is known."""
        result, history = self._step(states[0], self.history, states[1], h, self._inputs(*u, span[1]), t, outputs[1])
        self._keep_audit(outputs[0], result, h, states[1])
        return Attempt(result, 0.0, history)

    def _pair(self, states: list[Ref], h: float, span: Span, u: Inputs, t: float, outputs: tuple[bool, bool]) -> Attempt:
        """Two steps of h from states[0] to states[1], and the rate of the local error by comparison with one of 2 h."""
        middle, end = (self._inputs(*u, x) for x in (0.5 * (span[0] + span[1]), span[1]))
        full, history = self._step(states[0], self.history, self._full, 2.0 * h, end, t, False)
        if full.status != OK:
            return Attempt(full, 0.0, history)
        v_full = self.work.v_out.copy()
        first, history = self._step(states[0], self.history, self._half, h, middle, t, outputs[0])
        if first.status != OK:
            return Attempt(first, 0.0, history)
        self._keep_audit(outputs[0], first, h, self._half)
        second, history = self._step(self._half, history, states[1], h, end, t + h, outputs[1])
        if second.status != OK:
            return Attempt(second, 0.0, history)
        self._keep_audit(outputs[0], second, h, states[1])
        error = self._difference(cast(State, self._full.value), v_full, cast(State, states[1].value)) / 3.0
        for result in (first, second):
            if is_stuck(result):
                error = max(error, result.counters.residual)
        worse = max(first.counters.iterations, second.counters.iterations)
        stagnated = first.counters.stagnated + second.counters.stagnated
        counters = second.counters._replace(iterations=worse, stagnated=stagnated)
        return Attempt(second._replace(counters=counters), error / (2.0 * h), history)

    def _keep_audit(self, wanted: bool, result: StepResult, h: float, after: Ref) -> None:
        if wanted and result.status == OK:
            w, n, s = self.work, result.counters, cast(State, after.value)
            update_energy(self.model.tables, self._kin, self._outputs, w.lam_out, w.phi_t, h, w.energy)
            constraints, drifts = self._constraints, (n.position_drift, n.velocity_drift)
            note_residuals(constraints, n.residual, *drifts, w.phi_end, w.rate, s.a_stage, s.a_stage_before, w.energy)

    def _difference(self, a: State, v_a: np.ndarray, b: State) -> float:
        """Largest difference of positions [m], turns [rad], internal states, and velocities.

        Velocities count relative to the largest now or, at this acceleration, an interval later, and at least 1 m/s or rad/s.
        """
        v_b = self.work.v_out
        speed = max(1.0, np.abs(v_b).max(), self.grid * np.abs(b.a_stage).max())
        turn = 2.0 * np.minimum(np.abs(a.q[:, 3:] - b.q[:, 3:]).max(axis=1), np.abs(a.q[:, 3:] + b.q[:, 3:]).max(axis=1))
        parts = (np.abs(a.q[:, :3] - b.q[:, :3]).max(), turn.max(), np.abs(a.z - b.z).max(initial=0.0))
        return max(*map(float, parts), float(np.abs(v_a - v_b).max() / speed))

    def _inputs(self, before: np.ndarray, now: np.ndarray, x: float) -> np.ndarray:
        """Inputs at the fraction x of an interval: motions by the quintic through both ends, all others as they are now."""
        if x == 1.0 or not self._motion.size:
            return now
        value, rate, acceleration = self._motion
        T = self.grid
        p0, v0, a0 = before[value], T * before[rate], T * T * before[acceleration]
        p1, v1, a1 = now[value], T * now[rate], T * T * now[acceleration]
        d, dv, da = p1 - p0 - v0 - 0.5 * a0, v1 - v0 - a0, a1 - a0
        c3, c4, c5 = 10.0 * d - 4.0 * dv + 0.5 * da, -15.0 * d + 7.0 * dv - da, 6.0 * d - 3.0 * dv + 0.5 * da
        u = now.copy()
        u[value] = p0 + x * (v0 + x * (0.5 * a0 + x * (c3 + x * (c4 + x * c5))))
        u[rate] = (v0 + x * (a0 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5)))) / T
        u[acceleration] = (a0 + x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5))) / (T * T)
        return u

    def _step(
        self, source: Ref, history: History, target: Ref, h: float, u: np.ndarray, t: float, outputs: bool
    ) -> tuple[StepResult, History]:
        """One step of size h, with penalties raised if need be; source is left as it was."""
        s, new, c = cast(State, source.value), cast(State, target.value), self.scheme
        between = (1.0 - c.af) * h + c.af * history.h
        tolerance = self.settings.tolerance
        if self.by_error:
            tolerance = min(tolerance, max(REMAINDER * self.settings.error_tolerance * h, ROUNDING / h, SMALLEST_TOLERANCE))
        now = {'h': h, 'ahead': c.af if h == history.h else c.af * h / between, 'tolerance': tolerance}
        if any(getattr(c.value, name) != number for name, number in now.items()):
            c.assign(**now)
        moved = h != history.h
        if moved:
            kept = [array.copy() for array in (s.v, s.a, s.zd)]
            s.v[:] += ((h / history.h) ** 2 - 1.0) * history.offset
            s.a[:] += (c.am - c.af) * (h - history.h) / history.between * (s.a_stage - s.a_stage_before)
            s.zd[:] += (c.am1 - c.af) * (h - history.h) * history.z_rate
        result = self._converge(source, target, h, u, t, outputs)
        z_rate = (new.zd - s.zd) / h
        if moved:
            for array, old in zip((s.v, s.a, s.zd), kept, strict=True):
                array[:] = old
        return result, History(h, between, new.v - self.work.v_out, z_rate)

    def _converge(self, source: Ref, target: Ref, h: float, u: np.ndarray, t: float, outputs: bool) -> StepResult:
        """Take the step; while it is stuck with constraints open, again with their penalties raised."""

        def take() -> StepResult:
            result = step(self.model.tables, self.scheme, source, target, u, outputs, self.work)
            self._sum = self._sum.followed_by(result.counters)
            return result

        c, speed = self.scheme, float(np.abs(cast(State, source.value).v).max(initial=1.0))
        result = take()
        if self.settings.penalty_policy == 'constant' or self._left(result, speed) <= c.tolerance:
            return result
        first, before = self._left(result, speed), c.penalty.copy()
        acceptable = first <= (self.settings.error_tolerance * h if self.by_error else LARGEST_STAGNATION)
        while self._left(result, speed) > c.tolerance:
            rows = (self._slowest(speed) if acceptable else True) & (c.penalty < self.settings.penalty_cap)
            if not rows.any():
                break
            self._set_penalties(t, np.where(rows, np.minimum(self.settings.penalty_cap, RAISE * c.penalty), c.penalty), 'stagnation')
            self.easy, self.patience = 0, min(2 * self.patience, LONGEST_PATIENCE)
            result = take()
        if acceptable and not self._left(result, speed) < max(c.tolerance, HELPS * first):
            self._set_penalties(t, before, 'no help')
            return take()
        return result

    def _left(self, result: StepResult, speed: float) -> float:
        """What the iteration left open, relative as its tolerance is; infinite when it failed."""
        if result.status != OK:
            return math.inf if result.status == NOT_CONVERGED else 0.0
        return max(result.counters.position_drift / (self.scheme.h * speed), result.counters.residual if result.counters.stagnated else 0.0)

    def _slowest(self, speed: float) -> np.ndarray:
        """(nc,) rows that are open and have the largest violation in the metric of what their penalties multiply.

        A row that is not holonomic is open by a velocity; over a step it counts as the displacement that this makes.
        """
        c = self.scheme
        phi = np.abs(self.work.phi_end) * np.where(self.model.tables.constraints.holonomic == 1, 1.0, c.h)
        violation = phi * np.sqrt(self.work.saddle.W / c.penalty)
        is_open = phi > c.tolerance * speed * c.h
        return is_open & (violation >= SLOW * violation.max(where=is_open, initial=0.0))

    def _set_penalties(self, t: float, values: np.ndarray, cause: str) -> None:
        penalty = self.scheme.penalty
        for row in np.flatnonzero(values != penalty):
            self.events.append(Event(t, 'penalty', self.model.row_names[row], float(penalty[row]), float(values[row]), cause))
        penalty[:] = values
