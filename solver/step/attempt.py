"""One attempt at a part of an interval: a step with its history, or two steps of half the size with an estimate of
their local error.

*History.* The algorithm's acceleration a_n belongs to t_n + (am - af) h, the rates of internal states to t_n + (am1 -
af) h, and the velocity satisfies A v + phi_t = -h^2 A e (solver.start.newton). When the next step is of another size
all three are moved to where that step expects them, or each change would cost an order. Everything that was moved is
put back, because the step may not be accepted.

*Error.* Two steps of h/2 are compared with one of h from the same start; a third of the difference is the local error
of the two (second order, [Hairer1993] II.4). With `order: 4` the state that goes on is the one extrapolated from both
(solver.step.extrapolation).
"""

from __future__ import annotations

from typing import NamedTuple

from solver.compiled.by_reference import assign
from solver.compiled.kernel import NO, invoke, kernel
from solver.output.energy import power_from_outside, power_now, refine_work
from solver.output.snapshot import Counters
from solver.step.augmented_lagrangian import keep_account
from solver.step.control import copy_table, copy_vector
from solver.step.interpolation import inputs_inside
from solver.step.penalties import converge
from solver.step.work import NOT_CONVERGED, OK, added, last_result

REMAINDER = 0.1  # part of the tolerable error that the iteration may leave; ten times as much would use up all of it
ROUNDING = 1e-16  # lengths of the model; over a step it is a velocity that the iteration cannot resolve
SMALLEST_TOLERANCE = 1e-13  # relative velocity increment: no iteration is asked for less, which would be rounding


class Attempt(NamedTuple):
    """Result of an attempt."""

    status: int  # of the step that ended it
    where: int
    iterations: int  # of the step that took most
    stuck: bool  # an iteration ended before the tolerance
    error: float  # rate of the local error of two steps [1/s], 0 where nothing asks for it
    counters: Counters  # of all steps


@kernel(inner=True)
def _judged(result, counters, error):
    """The attempt that a step ended."""
    stuck = result.status == NOT_CONVERGED or (result.status == OK and result.counters.stagnated > 0)
    return Attempt(result.status, result.where, result.counters.iterations, stuck, error, counters)


@kernel(inner=True)
def _move_history(c, kept, s, history, h):
    """Move what the state s keeps of its last step to where a step of size h expects it; how it was goes to `kept`."""
    copy_table(s.v, kept.v)
    copy_table(s.a, kept.a)
    copy_vector(s.zd, kept.zd)
    size, between = history.size[0], history.size[1]
    grown = (h / size) ** 2 - 1.0
    later = (c.am - c.af) * (h - size) / between
    for b in range(s.v.shape[0]):
        for i in range(6):
            s.v[b, i] += grown * history.offset[b, i]
            s.a[b, i] += later * (s.a_stage[b, i] - s.a_stage_before[b, i])
    later = (c.am1 - c.af) * (h - size)
    for i in range(s.zd.shape[0]):
        s.zd[i] += later * history.z_rate[i]


@kernel(inner=True)
def take(tables, c, control, source, before, target, after, h, u, t, outputs, audit, follow, work):
    """One step of size h from source, with the history `before`, to target, with the history `after` (or the same)
    where it succeeds; source is left as it was.

    follow: fraction of the interval by which inputs are extrapolated to the end of the step (keep_account). Returns the
    counters; the result is in work.
    """
    size = before.size[0]
    between = (1.0 - c.af) * h + c.af * size
    moved = h != size
    tolerance = control.tolerance
    if control.by_error == 1:
        rounding = ROUNDING * work.length / (h * work.slow[0])
        tolerance = min(tolerance, max(REMAINDER * control.error_tolerance * h, rounding, SMALLEST_TOLERANCE))
    assign(c, 'h', h)
    assign(c, 'ahead', c.af * h / between if moved else c.af)
    assign(c, 'tolerance', tolerance)
    if moved:
        _move_history(c, control.kept, source, before, h)
    counters = converge(tables, c, control, source, target, h, tolerance, u, t, outputs, work)
    result = last_result(work)
    if result.status == OK:
        after.size[0] = h
        after.size[1] = between
        for i in range(source.zd.shape[0]):
            after.z_rate[i] = (target.zd[i] - source.zd[i]) / h
        for b in range(target.v.shape[0]):
            for i in range(6):
                after.offset[b, i] = target.v[b, i] - work.v_out[b, i]
    if moved:
        kept = control.kept
        copy_table(kept.v, source.v)
        copy_table(kept.a, source.a)
        copy_vector(kept.zd, source.zd)
    if audit and result.status == OK:
        keep_account(tables, c, h, 1, follow, source, target, u, result.counters, work)
    return counters


@kernel(inner=True)
def single(tables, c, control, old, new, h, end, now, t, outputs, audit, work):
    """One step of size h, to the fraction `end` of the interval with the inputs `now`."""
    u = now
    if end != 1.0:
        inputs_inside(control.motion, control.grid, work.u_before, now, end, control.u_end)
        u = control.u_end
    follow = control.hold - (1.0 - end)
    history = control.history
    counters = take(tables, c, control, old, history, new, history, h, u, t, outputs, audit, follow, work)
    return _judged(last_result(work), counters, 0.0)


@kernel(inner=True)
def pair(tables, c, control, old, new, h, begin, end, now, t, outputs, last, audit, work):
    """Two steps of size h from the fraction `begin` of the interval to `end`, compared with one of 2 h. last: a call
    ends there."""
    middle = 0.5 * (begin + end)
    fourth = control.fourth != 0
    u = now
    if end != 1.0:
        inputs_inside(control.motion, control.grid, work.u_before, now, end, control.u_end)
        u = control.u_end
    inputs_inside(control.motion, control.grid, work.u_before, now, middle, control.u_middle)
    history, first, second = control.history, control.middle, control.next
    hold = control.hold
    total = take(tables, c, control, old, history, control.full, second, 2.0 * h, u, t, NO, NO, 0.0, work)
    result = last_result(work)
    if result.status != OK:
        return _judged(result, total, 0.0)
    copy_table(work.v_out, control.kept.v_full)
    half, follow, kept = control.half, hold - (1.0 - middle), audit and not fourth
    total = added(
        total, take(tables, c, control, old, history, half, first, h, control.u_middle, t, audit, kept, follow, work)
    )
    one = last_result(work)
    if one.status != OK:
        return _judged(one, total, 0.0)
    power, fed = 0.0, 0.0
    if fourth and audit:
        power = power_now(tables, work.outputs, work.lam_out, work.phi_t)
        fed = power_from_outside(tables, work.outputs, work.lam_out, work.phi_t)
    follow = hold - (1.0 - end)
    shown = outputs and not fourth
    total = added(total, take(tables, c, control, half, first, new, second, h, u, t + h, shown, kept, follow, work))
    two = last_result(work)
    if two.status != OK:
        return _judged(two, total, 0.0)
    error = 0.0
    if control.by_error == 1:
        error = _difference(control, control.full, new, work) / 3.0
        if one.counters.stagnated > 0:
            error = max(error, one.counters.residual)
        if two.counters.stagnated > 0:
            error = max(error, two.counters.residual)
    both = added(one.counters, two.counters)
    most = max(one.counters.iterations, two.counters.iterations)
    if fourth:
        invoke(control.fourth, (tables, control.masses, control.full, new, u, outputs, last, work))
        end_state = last_result(work)
        total = added(total, end_state.counters)
        if end_state.status != OK:
            return _judged(end_state, total, 0.0)
        _carry_offset_on(history, first, second, h, new, work)
        if audit:
            account = work.account
            before, worst, at = account.power[0], account.worst[0], account.worst_at[0]
            n, fed_before = added(both, end_state.counters), account.flow[0] if account.flow.shape[0] > 0 else 0.0
            keep_account(tables, c, 2.0 * h, 2, follow, half, new, u, n, work)
            refine_work(account, 2.0 * h, before, power, (fed_before, fed), worst, at)
    return Attempt(OK, 0, most, both.stagnated > 0, error / (2.0 * h), total)


@kernel(inner=True)
def _carry_offset_on(begin, middle, end, h, new, work):
    """Give the state `new`, with the projected velocity work.v_out, the smooth part of what velocities violate for
    steps of h; they alternate about it. begin, middle, end: histories before, between and after two steps of h; that of
    the end becomes the state's.
    """
    grown = (h / begin.size[0]) ** 2
    for b in range(new.v.shape[0]):
        for i in range(6):
            smooth = 0.25 * (grown * begin.offset[b, i] + 2.0 * middle.offset[b, i] + end.offset[b, i])
            end.offset[b, i] = smooth
            new.v[b, i] = work.v_out[b, i] + smooth


@kernel(inner=True)
def _difference(control, a, b, work):
    """Largest difference of positions [m], turns [rad], internal states, and velocities of the states a (kept.v_full)
    and b (work.v_out).

    Places count relative to the length of the model, velocities to the largest now or, at this acceleration, an
    interval later, and at least to the slow one of the model; internal states to their size.
    """
    v_a, v_b, length = control.kept.v_full, work.v_out, work.length
    speed, fastest, place, turn = work.slow[0], 0.0, 0.0, 0.0
    for k in range(v_b.shape[0]):
        same, opposite = 0.0, 0.0
        for i in range(3):
            place = max(place, abs(a.q[k, i] - b.q[k, i]))
        for i in range(3, 7):
            same = max(same, abs(a.q[k, i] - b.q[k, i]))
            opposite = max(opposite, abs(a.q[k, i] + b.q[k, i]))
        turn = max(turn, 2.0 * min(same, opposite))
        for i in range(6):
            one = 1.0 if i < 3 else length
            speed = max(speed, one * abs(v_b[k, i]), one * (control.grid * abs(b.a_stage[k, i])))
            fastest = max(fastest, one * abs(v_a[k, i] - v_b[k, i]))
    largest = max(place / length, turn)
    for i in range(a.z.shape[0]):
        largest = max(largest, abs(a.z[i] - b.z[i]) / control.internal_size[i])
    return max(largest, fastest / speed)
