"""Steps whose inputs a driver gives who sees the motion, in one call."""

from __future__ import annotations

import math

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.so3 import matrix_of_quaternion
from solver.inputs.driving import drive
from solver.output.snapshot import Counters
from solver.step.augmented_lagrangian import advance
from solver.step.control import OPEN
from solver.step.interval import advance_adapting
from solver.step.seen import take_row
from solver.step.work import OK, PAUSED, StepResult, added


@kernel(inner=True)
def seen_by_driver(tables, s, chassis):
    """Sight of the driver: see solver.start.displacement.sight()."""
    a, b, c, d, e, f, g, _, _ = matrix_of_quaternion(
        (s.q[chassis, 3], s.q[chassis, 4], s.q[chassis, 5], s.q[chassis, 6])
    )
    cx, cy, cz = tables.bodies.com[chassis, 0], tables.bodies.com[chassis, 1], tables.bodies.com[chassis, 2]
    vx, vy, vz = s.v[chassis, 0], s.v[chassis, 1], s.v[chassis, 2]
    wy, wz = s.v[chassis, 4], s.v[chassis, 5]
    speed = a * vx + d * vy + g * vz - (wy * cz - wz * cy)
    x, y = s.q[chassis, 0] - (a * cx + b * cy + c * cz), s.q[chassis, 1] - (d * cx + e * cy + f * cz)
    return x, y, math.atan2(d, a), speed


@kernel(borrow=True)
def advance_driven(tables, c, s0, s1, driver, wanted, inputs, count, k, audit, every, numbers, rows, work):
    """Advance count steps from step k of the grid on. inputs (count, nu): what depends on time alone, to which the
    driver adds what he does; wanted (count, 2): speed [m/s] and its slope [m/s^2] at the beginning of each step.

    numbers (m,) become a row of rows (n, m) behind each step that `every` divides, of none where it is 0. Returns
    (StepResult, steps done, rows taken); the state as advance().
    """
    total = Counters(0, 0, 0, 0, 0.0, 0.0, 0.0)
    old, new = s0, s1
    taken = 0
    for i in range(count):
        drive(driver, k + i, wanted[i, 0], wanted[i, 1], seen_by_driver(tables, old, work.chassis), inputs[i])
        result, _ = advance(tables, c, old, new, inputs, i, 1, audit, work)
        total = added(total, result.counters)
        if result.status != OK:
            return StepResult(result.status, result.where, total), i, taken
        old, new = new, old
        if every > 0 and (k + i + 1) % every == 0:
            take_row(numbers, rows, taken)
            taken += 1
    return StepResult(OK, 0, total), count, taken


@kernel(borrow=True)
def advance_driven_adapting(
    tables, c, control, s0, s1, driver, wanted, inputs, first, count, k, ready, audit, every, numbers, rows, work
):
    """As advance_driven(), with steps that adapt; from row `first` of inputs and wanted on, which is step k. ready:
    whether the driver has given the inputs of the first row already.

    Returns (StepResult, intervals done, whether the newest state is in s1, rows taken, whether the inputs of the next
    row are given).
    """
    total = Counters(0, 0, 0, 0, 0.0, 0.0, 0.0)
    old, new, swapped = s0, s1, False
    taken = done = 0
    while done < count:
        i = first + done
        if not ready:
            drive(driver, k + done, wanted[i, 0], wanted[i, 1], seen_by_driver(tables, old, work.chassis), inputs[i])
        result, steps, turned = advance_adapting(tables, c, control, old, new, inputs, i, 1, k + done, audit, work)
        ready = steps == 0
        total = added(total, result.counters)
        done += steps
        if turned:
            old, new = new, old
            swapped = not swapped
        shown = result.status == OK or (result.status == PAUSED and control.progress[OPEN] == 0.0)
        if every > 0 and shown and steps > 0 and (k + done) % every == 0:
            take_row(numbers, rows, taken)
            taken += 1
        if result.status != OK:
            return StepResult(result.status, result.where, total), done, swapped, taken, np.bool_(ready)
    return StepResult(OK, 0, total), done, swapped, taken, np.bool_(ready)
