"""Iterations of a step in mode fixed: as many as are asked for, and more where what they leave would count.

Equations and notation: solver.step.augmented_lagrangian; what both modes share: solver.step.iteration.
"""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import NO, YES, kernel
from solver.model.evaluate import evaluate_constraints
from solver.model.saddle import solve_saddle
from solver.output.snapshot import Counters
from solver.step.augmentation import ENOUGH, HELD, combine, grew, holds_more, is_unseen, opposed, weighed
from solver.step.iteration import (
    LARGEST_STAGNATION,
    STAGNATION,
    add_increment,
    begin_iterations,
    evaluate_tried,
    factorize,
    may_withhold,
    measured_increment,
    remaining,
)
from solver.step.stage import copy_blocks, copy_rows
from solver.step.work import NON_FINITE, NOT_CONVERGED, OK, SINGULAR, StepResult

# Relative velocity error that mode fixed may leave after its number of iterations; ten times as much would be
# LARGEST_STAGNATION.
SETTLED_SHARE = 1e-3
# Error of a velocity in a step of second order, over the second difference of the acceleration times the step.
UNSEEN = 1.0 / 12.0
# Relative rounding error of a position times the root of a penalty of 1e6; ten times as much would take small motions
# for rounding.
PENALIZED_ROUNDING = 1e3 * 2.220446049250313e-16
# Relative loss of velocity by iterations that a run may always have [1/s]: a factor e in 1e5 s; ten times as much: in
# 1e4 s.
NEGLIGIBLE_LOSS = 1e-5
NEGLIGIBLE = 1e-7  # relative velocity increment; a smaller one is not judged by whether it grows
# Iterations in mode fixed, from which on half of each increment is taken; beyond MOST_ITERATIONS it never is.
DAMPED_FROM = 8
MOST_ITERATIONS = 20  # iterations of a step in mode fixed; ten times as many cost ten times as much where none settles


@kernel(inner=True)
def _is_lost_anyway(c, s0, s1, left, speed, length):
    """True where a step loses as much as `left` of a velocity [m/s] whatever its iteration leaves: a motion
    that bends, most often that of one of the first bodies, has an error of second order of that size. Also true where
    `left` is negligible, or is rounding of the positions.
    """
    if left < NEGLIGIBLE_LOSS * c.h * speed:
        return True
    far = 0.0
    for b in range(s0.v.shape[0] - 1):
        for i in range(6):
            a_stage = (1.0 - c.am) * s1.a[b, i] + c.am * s0.a[b, i]
            bent = abs(a_stage - 2.0 * s0.a_stage[b, i] + s0.a_stage_before[b, i])
            if left < UNSEEN * c.h * (bent if i < 3 else length * bent):
                return True
        for i in range(3):
            far = max(far, abs(s0.q[b, i]))
    return left < PENALIZED_ROUNDING * far / c.h


@kernel(borrow=True)
def _solve_by_stage(tables, c, s0, s1, u, measure, share, smallest, work):
    """Solve once more with the rows of the stage in the matrix, for a direction that those of the end do not see; with
    those of the end after all where the stage sees it no better. Returns (directions combined, factorizations, row that
    is singular or -1).
    """
    saddle, augmentation = work.saddle, work.augmentation
    copy_rows(work.dw, work.a_best)
    evaluate_constraints(tables, work.kin_end, s0.angle, u, YES, work.phi_end, work.J_end)
    used, where, tried = 0, -1, 0
    for by_stage in (1, 0):
        augmentation.by_stage[0] = by_stage
        if by_stage == 0:
            copy_blocks(work.J_end, saddle.J_force)
        where = factorize(tables, c, s1.lam, work)
        tried += 1
        if where >= 0:
            break
        solve_saddle(tables, c.form, saddle, work.r, work.g, work.dw, work.dlam)
        used = combine(tables, c.form, saddle, augmentation, measure, share, smallest, work.g, work.dw, work.dlam)
        if by_stage == 1 and holds_more(tables, saddle, augmentation, work, work.dw, work.a_best):
            break
    return used, tried, where


@kernel(inline=True)
def _combine_fixed(tables, c, s0, s1, u, first, factorized, growing, unseen, speed, work):
    """Combine augmentations in an iteration of mode fixed; once a step by the rows of the stage, if those of the end
    miss a direction.

    first: of the step. factorized: the matrix is that of this iterate. growing: multipliers grew as before a singular
    position. unseen: a direction was met that the end of the step does not see. Returns (directions combined, unseen,
    factorizations, row that is singular or -1).
    """
    saddle, augmentation = work.saddle, work.augmentation
    share, smallest = ENOUGH * ENOUGH, HELD * speed / (c.gamma * c.h)
    augmentation.withheld[0] = 0
    used = combine(tables, c.form, saddle, augmentation, first, share, smallest, work.g, work.dw, work.dlam)
    if first and growing and augmentation.dropped[0] == 0:
        is_unseen(
            tables,
            c.form,
            saddle,
            augmentation,
            work.J_stage,
            work.T_stage,
            work.g,
            work.dw,
            work.a_best,
            work.lam_best,
        )
    if augmentation.dropped[0] == 1 and factorized and not unseen:
        used, more, where = _solve_by_stage(tables, c, s0, s1, u, first, share, smallest, work)
        return used, YES, more, where
    return used, unseen, 0, -1


@kernel(inline=True)
def _is_closed_by_the_end(tables, J_end, before, work):
    """True where an iteration that grows is next to a singular position, with constraints that are closed. before: the
    last increment.

    They are not closed by forces along A of the stage: the impulse that closed them acted along A of the end, which is
    as good to second order. Going on only makes it worse.
    """
    saddle = work.saddle
    closed = weighed(saddle.W, work.g, work.g) < SETTLED_SHARE * SETTLED_SHARE * work.augmentation.violation[0]
    return (before < LARGEST_STAGNATION or closed) and opposed(tables, work.J_stage, J_end, work.dlam, work.r, work.f)


@kernel(inner=True)
def iterate_fixed(tables, c, s0, s1, u, cz, speed, work):
    """A fixed number of iterations, c.iterations, and as many more as what they leave needs.

    A fixed number relies on the gain of each iteration. If they do not gain (a stop is hit, a wheel lands), the
    tangents of the prediction are those of another place: go on with new ones until they do.
    """
    # Straight to where assemble() wants the gradients, unless it needs that place for itself.
    J_end = work.saddle.J_force if c.weigh == 0 else work.J_end
    status, where, stagnated = NOT_CONVERGED, 0, 0
    iterations, factorizations, evaluations = 0, 0, 0
    tried = 0  # 1 when the first iteration was one without its combination: it is not counted
    increment, residual, part = 0.0, 0.0, 1.0
    refactor: np.bool_ | bool = YES
    begin_iterations(work)
    growing = c.combined == 1 and grew(s0.lam, s0.lam_before)
    unseen = NO
    for it in range(max(c.iterations, MOST_ITERATIONS)):
        iterations += 1
        evaluations += evaluate_tried(tables, c, s0, s1, u, cz, part, refactor, J_end, work)
        if refactor:
            where = factorize(tables, c, s1.lam, work)
            factorizations += 1
            if where >= 0:
                status = SINGULAR
                break
        solve_saddle(tables, c.form, work.saddle, work.r, work.g, work.dw, work.dlam)
        if c.combined == 1 and (refactor or work.augmentation.known[0] > 0):
            used, unseen, more, where = _combine_fixed(
                tables, c, s0, s1, u, it == 0, refactor, growing, unseen, speed, work
            )
            factorizations += more
            if where >= 0:
                status = SINGULAR
                break
            if it == 0 and may_withhold(c, used, work):
                tried = 1
        before = increment
        increment, part, where = measured_increment(c, speed, work)
        if where >= 0:
            status = NON_FINITE
            break
        residual = increment
        grows = part == 1.0 and before > 0.0 and increment > max(STAGNATION * before, NEGLIGIBLE)
        if grows and _is_closed_by_the_end(tables, J_end, before, work):
            status = OK
            stagnated = 1
            break
        if it >= max(c.iterations, DAMPED_FROM):
            # Newton's iteration may go round between the branches of a contact; half of it does not
            part = min(part, 0.5)
        add_increment(part, s1, work)
        rate = increment / before if before > 0.0 else 1.0
        left = remaining(increment, rate) if part == 1.0 else increment
        last = it >= c.iterations - 1 + tried
        settled = left < (SETTLED_SHARE if last else LARGEST_STAGNATION)
        # A run is judged by its last increments, of which nobody knows what the next would be: of one that is large it
        # is made.
        settled &= increment < LARGEST_STAGNATION or not last
        # What every step leaves in one direction adds up, so it must be less than what steps lose anyway. Of a single
        # iteration no gain is known; and where one with new tangents gains nothing, another one is no better.
        enough = it == 0 or (it >= c.iterations and rate > STAGNATION)
        enough = enough or (last and settled and _is_lost_anyway(c, s0, s1, left * speed, speed, work.length))
        if last and settled and work.augmentation.withheld[0] == 0 and enough:
            status = OK
            break
        refactor = bool((it > 0 or c.iterations == 1) and (last or not settled))
        if part < 1.0:
            increment = 0.0  # nothing to compare the next iteration with
    if status == NOT_CONVERGED and residual < LARGEST_STAGNATION:  # settles slowly
        status = OK
        stagnated = 1
    return StepResult(status, where, Counters(iterations, factorizations, evaluations, stagnated, residual, 0.0, 0.0))
