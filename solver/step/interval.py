"""Advance over the grid of inputs and outputs with steps and penalties that follow the iteration and the local error.

The grid, k h, is fixed; inside an interval of it the step is chosen freely, so time stays an integer. `step_policy`:

`rescue`: a step that fails is halved and taken again from its start; after easy steps it doubles. `error`: the rate of
the local error (solver.step.attempt) is held at the tolerance by a PI controller [Gustafsson1991], so that the error of
a run is proportional to it.

While nothing fails and penalties stay, a step does what that of solver.step.augmented_lagrangian.advance does, bit by
bit.
"""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import kernel
from solver.output.collect import collect
from solver.output.snapshot import Counters
from solver.step.attempt import pair, single
from solver.step.control import (
    ABANDON,
    CAUSE,
    DONE,
    EASY,
    EASY_GOING,
    EASY_STEPS,
    ERROR,
    ERROR_BEFORE,
    ERROR_BEST,
    ERROR_LAST,
    FAILED,
    FAILURE,
    H_BEFORE,
    H_BEST,
    H_LAST,
    LAST_ERROR,
    NOT_DETERMINED,
    OF_ERROR,
    OF_STEP,
    OPEN,
    PATIENCE,
    PENDING,
    PROGRESS,
    RAISE,
    REJECTED,
    SUBSTEPS,
    TAKEN,
    TRIED,
    UNDETERMINED,
    WANTED,
    copy_history,
    copy_vector,
    copy_whole_state,
    note_event,
)
from solver.step.penalties import lose_patience, set_penalty
from solver.step.work import BAD_INPUT, INACCURATE, OK, PAUSED, StepResult, added

EASY_ITERATIONS = 4  # iterations of a step, at most, that counts as easy; ten times as many would call hard ones easy
ORDER = 2.0  # of the error per unit of time
SAFETY = 0.9  # factor of the step that the error asks for, so that the next error stays below the tolerance
# Exponents of the error of this step and of the one before it (PI control).
INTEGRAL, PROPORTIONAL = 0.7 / ORDER, 0.4 / ORDER
SMALLEST_FACTOR, LARGEST_FACTOR = 0.2, 2.0  # by which a step changes at a time
WORTHWHILE = 1.2  # growth below it is not taken: a step that stays costs no history
ATTEMPTS = 100  # attempts in a call, then the caller may look around; ten times as many let it wait ten times as long


@kernel(borrow=True)
def is_undetermined(h_before, before, h, error, allowed):
    """True where the last of two attempts (h, rate of its error) is hardly more accurate than the one before, and its
    error is allowed.

    Next to a singular position the motion is determined only so far, and a jump of the forces has an error of rate one
    however small the step: the step with the smallest error is then the one to take. Truncation errors fall with the
    square.
    """
    return error > before * np.sqrt(h / h_before) and min(h_before * before, h * error) <= allowed


@kernel(inner=True)
def _open(c, control, work):
    """Begin an interval: remember what its first attempt may change."""
    kept, progress = control.kept, control.progress
    copy_vector(control.memory, kept.memory)
    copy_vector(work.account.numbers, kept.account)
    if control.adaptive == 1:
        copy_vector(c.penalty, kept.penalty)
    for i in range(PROGRESS):
        progress[i] = 0.0
    progress[OPEN] = 1.0
    progress[CAUSE] = ERROR if control.by_error == 1 else EASY_GOING


@kernel(inner=True)
def _give_up(c, control, old, work):
    """Back to the start of the interval; `old` is the present state."""
    kept, progress = control.kept, control.progress
    if progress[DONE] > 0.0:
        copy_whole_state(control.begin, old)
        copy_history(kept.history, control.history)
    copy_vector(kept.memory, control.memory)
    copy_vector(kept.account, work.account.numbers)
    if control.adaptive == 1:
        copy_vector(kept.penalty, c.penalty)
    progress[OPEN] = 0.0


@kernel(inner=True)
def _note_step(control, t, h):
    """The step h, or that of the history if it is the same but for rounding; an event if it is another than the
    last."""
    memory = control.memory
    if abs(h - control.history.size[0]) < 1e-12 * h:
        h = control.history.size[0]
    if abs(h - memory[TAKEN]) > 1e-9 * h:
        note_event(control, t, OF_STEP, -1.0, memory[TAKEN], h, control.progress[CAUSE])
        memory[TAKEN] = h
    return h


@kernel(inner=True)
def _relax(c, control, t, attempt):
    """Choose the next step after one that was accepted, and lower penalties after easy ones."""
    memory = control.memory
    if control.by_error == 1:
        ratio = max(attempt.error / control.error_tolerance, 1e-6)
        last = max(memory[LAST_ERROR] / control.error_tolerance, 1e-6)
        factor = min(LARGEST_FACTOR, max(SMALLEST_FACTOR, SAFETY * ratio**-INTEGRAL * last**PROPORTIONAL))
        if factor < 1.0 or factor >= WORTHWHILE:
            memory[WANTED] = min(control.grid, control.group * max(memory[TAKEN] * factor, control.h_min))
        memory[LAST_ERROR] = attempt.error
    _count_easy(c, control, t, not attempt.stuck and attempt.iterations <= EASY_ITERATIONS)


@kernel(inner=True)
def _count_easy(c, control, t, easy):
    """Lower penalties, and double the step of rescue, after enough easy steps in a row."""
    memory = control.memory
    memory[EASY] = memory[EASY] + 1.0 if easy else 0.0
    if memory[EASY] < memory[PATIENCE]:
        return
    memory[EASY] = 0.0
    raised = False
    for i in range(c.penalty.shape[0]):
        raised = raised or c.penalty[i] > control.base[i]
        set_penalty(c, control, t, i, max(control.base[i], c.penalty[i] / RAISE), EASY_GOING)
    if control.by_error == 0 and memory[WANTED] < control.grid:
        memory[WANTED] = min(control.grid, 2.0 * memory[WANTED])
    elif not raised:
        memory[PATIENCE] = max(float(EASY_STEPS), float(memory[PATIENCE] // 2.0))


@kernel(borrow=True)
def note_steps(c, control, easy, count):
    """Note that `count` steps of the whole grid were taken elsewhere; easy (n,): 1 of an easy one."""
    control.counts[SUBSTEPS] += count
    for k in range(count):
        _count_easy(c, control, 0.0, easy[k] == 1)


@kernel(inner=True)
def _remember(progress, h, error):
    """Note an attempt at the next step that was not accurate."""
    progress[H_BEFORE], progress[ERROR_BEFORE] = progress[H_LAST], progress[ERROR_LAST]
    progress[H_LAST], progress[ERROR_LAST] = h, error
    if progress[TRIED] == 0.0 or error < progress[ERROR_BEST]:
        progress[H_BEST], progress[ERROR_BEST] = h, error
    progress[TRIED] += 1.0


@kernel(inner=True)
def _go_smaller(control, h, attempt):
    """After an attempt that was not accepted choose a smaller step; whether there is one."""
    memory, progress, allowed = control.memory, control.progress, control.error_tolerance
    smallest = h <= control.h_min * (1.0 + 1e-9)
    progress[CAUSE], factor = FAILURE, 0.5
    progress[UNDETERMINED] = 0.0
    if attempt.status == OK:
        progress[CAUSE], factor = ERROR, SAFETY * (allowed / attempt.error) ** (1.0 / ORDER)
        _remember(progress, h, attempt.error)
        if progress[TRIED] > 1.0 and is_undetermined(
            progress[H_BEFORE], progress[ERROR_BEFORE], progress[H_LAST], progress[ERROR_LAST], allowed * control.grid
        ):
            progress[UNDETERMINED] = 1.0
    else:
        progress[FAILED] = 1.0
    if smallest and progress[UNDETERMINED] == 0.0:
        return False
    smaller = max(h * min(SAFETY, max(SMALLEST_FACTOR, factor)), control.h_min)
    memory[WANTED] = control.group * (progress[H_BEST] if progress[UNDETERMINED] == 1.0 else smaller)
    lose_patience(control)
    return True


@kernel(inner=True)
def _accept(c, control, here, end, h, attempt):
    """The attempt stands: its history, its counters, and what comes next."""
    memory, progress = control.memory, control.progress
    if control.group == 2:
        copy_history(control.next, control.history)
    control.counts[SUBSTEPS] += control.group
    _relax(c, control, here, attempt)
    progress[CAUSE] = ERROR if control.by_error == 1 else EASY_GOING
    if attempt.error > control.error_tolerance:
        note_event(control, here, OF_ERROR, -1.0, control.error_tolerance, attempt.error, NOT_DETERMINED)
        memory[WANTED] = min(control.grid, control.group * LARGEST_FACTOR * h)
        memory[LAST_ERROR] = control.error_tolerance
    progress[DONE], progress[UNDETERMINED], progress[TRIED] = end, 0.0, 0.0


@kernel(inner=True)
def _interval(tables, c, control, old, new, u, t, outputs, audit, left, work):
    """Advance over an interval of the grid from t [s] on, or over what is left of it, with at most `left` attempts.

    Returns (status, where, counters, attempts, whether the newest state is in `new`).
    """
    total = Counters(0, 0, 0, 0, 0.0, 0.0, 0.0)
    memory, progress, grid = control.memory, control.progress, control.grid
    swapped = False
    attempts = 0
    if progress[OPEN] == 0.0:
        _open(c, control, work)
    while progress[DONE] < 1.0:
        if progress[ABANDON] != 0.0:
            _give_up(c, control, old, work)
            return PAUSED, 0, total, attempts, swapped
        if attempts >= left or control.counts[PENDING] + control.reserve > control.events.shape[0]:
            return PAUSED, 0, total, attempts, swapped
        attempts += 1
        done = progress[DONE]
        count = max(1.0, np.ceil((1.0 - done) * grid / memory[WANTED] - 1e-9))
        part = (1.0 - done) / count
        end = 1.0 if count == 1.0 else done + part
        here = t + done * grid
        h = _note_step(control, here, part * grid / control.group)
        before = control.kept.account  # of the attempt
        if done == 0.0 and count > 1.0:
            copy_whole_state(old, control.begin)
            copy_history(control.history, control.kept.history)
        elif done > 0.0:
            before = control.kept.account_before
            copy_vector(work.account.numbers, before)
        last = np.bool_(outputs and count == 1.0)
        shown = np.bool_(audit or last)
        if control.group == 2:
            attempt = pair(tables, c, control, old, new, h, done, end, u, here, shown, last, audit, work)
        else:
            attempt = single(tables, c, control, old, new, h, end, u, here, shown, audit, work)
        total = added(total, attempt.counters)
        accurate = not attempt.error > control.error_tolerance
        if attempt.status == OK and (accurate or progress[UNDETERMINED] == 1.0):
            _accept(c, control, here, end, h, attempt)
            old, new = new, old
            swapped = not swapped
            continue
        control.counts[REJECTED] += 1
        copy_vector(before, work.account.numbers)
        if not _go_smaller(control, h, attempt):
            _give_up(c, control, old, work)
            return INACCURATE if attempt.status == OK else attempt.status, attempt.where, total, attempts, swapped
    progress[OPEN] = 0.0
    for i in range(u.shape[0]):
        work.u_before[i] = u[i]
    return OK, 0, total, attempts, swapped


@kernel(borrow=True)
def advance_adapting(tables, c, control, s0, s1, inputs, first, count, k, audit, work):
    """Advance over count intervals, from index k of the grid on, with rows first.. of inputs (n, nu); s0 is the present
    state.

    A single row of inputs holds for all. audit: evaluate outputs after every step and keep the energy balance. Outputs
    are of the last step, in work.arrays too. Returns (StepResult with summed counters and largest residuals, intervals
    done, whether the newest state is in s1). Status PAUSED: there is more to do, in further calls with the rows that
    are left; it may be in the middle of an interval (Control.progress), behind one in which a step failed, or because
    events wait to be taken away. After a failure the state is that at the start of the interval.
    """
    held = inputs.shape[0] == 1
    total = Counters(0, 0, 0, 0, 0.0, 0.0, 0.0)
    for n in range(first, first + count):
        for i in range(inputs.shape[1]):
            if not np.isfinite(inputs[0 if held else n, i]):
                return StepResult(BAD_INPUT, i, total), 0, False
    old, new = s0, s1
    swapped = False
    left = np.int64(ATTEMPTS)  # with a type: numba compiles a callee once more for a literal
    done = 0
    status, where = OK, 0
    while done < count and status == OK:
        u = inputs[0 if held else first + done]
        t = (k + done) * control.h_ns * 1e-9
        last = done == count - 1
        status, where, counters, attempts, turned = _interval(
            tables, c, control, old, new, u, t, last, audit, left, work
        )
        left -= max(0, attempts - 1)
        total = added(total, counters)
        if turned:
            old, new = new, old
            swapped = not swapped
        if status == OK:
            done += 1
            if control.progress[FAILED] != 0.0:
                control.progress[FAILED] = 0.0
                status = PAUSED
    if done > 0 and control.progress[OPEN] == 0.0 and status in (OK, PAUSED):
        u = inputs[0 if held else first + done - 1]
        w = work
        if not audit:
            w.marks[-1] = 0.0
        shown = w.outputs, w.account, w.arrays
        collect(tables, w.chassis, w.kin_end, w.a_out, w.lam_out, w.marks, u, old, *shown)
    return StepResult(status, where, total), done, swapped
