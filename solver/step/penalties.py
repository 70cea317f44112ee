"""Penalties that follow the iteration (`penalty_policy: adaptive`; the formulation leaves the rules open, these are
ours).

An iteration that stagnates with constraints open is repeated from the start of the step with larger penalties of the
slowest constraints: those with the largest violation, weighed by the masses behind them. If the step would be accepted
as it is, a raise that does not help is taken back; if it would fail, all penalties are raised. After easy steps all
return towards the setting.
"""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import invoke, kernel
from solver.step.control import (
    EASY,
    LONGEST_PATIENCE,
    NO_HELP,
    OF_PENALTY,
    PATIENCE,
    RAISE,
    STAGNATION,
    copy_vector,
    note_event,
)
from solver.step.iteration import LARGEST_STAGNATION, speed_of
from solver.step.work import NOT_CONVERGED, OK, added, last_result

# Part of the largest violation from which on a constraint counts as slow, and is raised; at 1 one is raised at a time.
SLOW = 0.1
# Part of the residual that a raise may leave; one that leaves more is taken back, at 1 only one that lessens nothing.
HELPS = 0.5


@kernel(inner=True)
def set_penalty(c, control, t, row, value, cause):
    """Change one penalty, with an event."""
    if c.penalty[row] != value:
        note_event(control, t, OF_PENALTY, float(row), c.penalty[row], value, cause)
        c.penalty[row] = value


@kernel(inner=True)
def lose_patience(control):
    """After trouble it takes twice as many easy steps to relax."""
    control.memory[EASY] = 0.0
    control.memory[PATIENCE] = min(2.0 * control.memory[PATIENCE], LONGEST_PATIENCE)


@kernel(inner=True)
def converge(tables, c, control, source, target, h, tolerance, u, t, outputs, work):
    """Take the step of size h; while it is stuck with constraints open, again with their penalties raised. The result
    of the last attempt is in work; returns the counters of all.
    """
    invoke(c.step, (tables, c, source, target, u, outputs, work))
    total = last_result(work).counters
    if control.adaptive == 0:
        return total
    speed = speed_of(source, work)
    first = _left(h, speed, work)
    if first <= tolerance:
        return total
    before = control.kept.penalty_before
    copy_vector(c.penalty, before)
    acceptable = first <= (control.error_tolerance * h if control.by_error == 1 else LARGEST_STAGNATION)
    while _left(h, speed, work) > tolerance:
        if not _raise(tables, c, control, acceptable, tolerance * speed * h, h, t, work):
            break
        lose_patience(control)
        invoke(c.step, (tables, c, source, target, u, outputs, work))
        total = added(total, last_result(work).counters)
    if acceptable and not _left(h, speed, work) < max(tolerance, HELPS * first):
        for i in range(before.shape[0]):
            set_penalty(c, control, t, i, before[i], NO_HELP)
        invoke(c.step, (tables, c, source, target, u, outputs, work))
        total = added(total, last_result(work).counters)
    return total


@kernel(inner=True)
def _left(h, speed, work):
    """Residual of the iteration, relative as its tolerance is; infinite when it failed."""
    result = last_result(work)
    if result.status != OK:
        return np.inf if result.status == NOT_CONVERGED else 0.0
    residual = result.counters.residual if result.counters.stagnated > 0 else 0.0
    return max(result.counters.position_drift / (h * speed), residual)


@kernel(inner=True)
def _violation(tables, c, h, i, work):
    """(displacement, the same in the metric of what the penalty multiplies) by which row i is open.

    A row that is not holonomic is open by a velocity; over a step it counts as the displacement that this makes.
    """
    phi = abs(work.phi_end[i]) * (1.0 if tables.constraints.holonomic[i] == 1 else h)
    return phi, phi * np.sqrt(work.saddle.W[i] / c.penalty[i])


@kernel(inner=True)
def _raise(tables, c, control, slowest, limit, h, t, work):
    """Raise penalties that are below the cap, with `slowest` those of the slowest rows open by more than the limit;
    whether any."""
    n = c.penalty.shape[0]
    least = 0.0
    if slowest:
        for i in range(n):
            phi, weighed = _violation(tables, c, h, i, work)
            if phi > limit:
                least = max(least, SLOW * weighed)
    anything = False
    for i in range(n):
        if not c.penalty[i] < control.penalty_cap:
            continue
        if slowest:
            phi, weighed = _violation(tables, c, h, i, work)
            if not (phi > limit and weighed >= least):
                continue
        anything = True
        set_penalty(c, control, t, i, min(control.penalty_cap, RAISE * c.penalty[i]), STAGNATION)
    return anything
