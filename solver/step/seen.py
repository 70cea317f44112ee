"""Steps of which every so many are seen, in one call: what is shown behind each of them becomes a row of a table.

A piece of steps up to the next row is what a call of its own would be, so no bit depends on how many are made at once.
"""

from __future__ import annotations

from solver.compiled.kernel import kernel
from solver.output.snapshot import Counters
from solver.step.augmented_lagrangian import advance
from solver.step.control import OPEN
from solver.step.interval import advance_adapting
from solver.step.work import OK, PAUSED, StepResult, added


@kernel(borrow=True)
def take_row(numbers, rows, at):
    """Row `at` of rows (n, m) becomes numbers (m,)."""
    for i in range(numbers.shape[0]):
        rows[at, i] = numbers[i]


@kernel(borrow=True)
def advance_seen(tables, c, s0, s1, inputs, first, count, k, audit, every, numbers, rows, work):
    """As advance(), from step k of the grid on; numbers (m,), which work.arrays are views of, become a row of rows (n,
    m) behind each step that `every` divides.

    Returns (StepResult, steps done, rows taken).
    """
    total = Counters(0, 0, 0, 0, 0.0, 0.0, 0.0)
    old, new = s0, s1
    done = taken = 0
    while done < count:
        piece = min(every - (k + done) % every, count - done)
        result, steps = advance(tables, c, old, new, inputs, first + done, piece, audit, work)
        total = added(total, result.counters)
        done += steps
        if steps % 2 == 1:
            old, new = new, old
        if result.status != OK:
            return StepResult(result.status, result.where, total), done, taken
        if (k + done) % every == 0:
            take_row(numbers, rows, taken)
            taken += 1
    return StepResult(OK, 0, total), done, taken


@kernel(borrow=True)
def advance_adapting_seen(tables, c, control, s0, s1, inputs, first, count, k, audit, every, numbers, rows, work):
    """As advance_adapting(), with rows as advance_seen() takes them.

    Returns (StepResult, intervals done, whether the newest state is in s1, rows taken).
    """
    total = Counters(0, 0, 0, 0, 0.0, 0.0, 0.0)
    old, new, swapped = s0, s1, False
    done = taken = 0
    while done < count:
        piece = min(every - (k + done) % every, count - done)
        result, steps, turned = advance_adapting(
            tables, c, control, old, new, inputs, first + done, piece, k + done, audit, work
        )
        total = added(total, result.counters)
        done += steps
        if turned:
            old, new = new, old
            swapped = not swapped
        shown = result.status == OK or (result.status == PAUSED and control.progress[OPEN] == 0.0)
        if shown and steps > 0 and (k + done) % every == 0:
            take_row(numbers, rows, taken)
            taken += 1
        if result.status != OK:
            return StepResult(result.status, result.where, total), done, swapped, taken
    return StepResult(OK, 0, total), done, swapped, taken
