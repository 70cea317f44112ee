"""Newton's iteration of a step: prediction, residuals at an iterate, the matrix, and when enough is enough.

Equations and notation: solver.step.augmented_lagrangian.
"""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import YES, invoke, kernel
from solver.model.evaluate import add_constraint_forces, add_constraint_stiffness, evaluate_constraints, evaluate_forces
from solver.model.saddle import assemble_tangent, effective_masses, factorize_saddle, rotate_columns, solve_saddle
from solver.output.snapshot import Counters
from solver.step.augmentation import (
    CONTRACTION,
    ENOUGH,
    HELD,
    begin_augmentation,
    combine,
    grew,
    holds_more,
    is_unseen,
    opposed,
    restore,
    weighed,
    withhold,
)
from solver.step.stage import BOTH, WITH_TANGENTS, copy_blocks, copy_rows, finite, largest, largest_turn, momentum_residual, place
from solver.step.work import NON_FINITE, NOT_CONVERGED, OK, SINGULAR, StepResult

# The multipliers of redundant constraints are determined only by rounding; starting each step from a little less than the last
# values keeps that part from drifting, while the determined part is found again by the first iteration.
WARM_START = 0.9999
LARGEST_STAGNATION = 1e-2  # relative velocity increment below which an iteration that stops converging is accepted
SETTLED = 1e-3  # of the error that is left in mode fixed, from where on a step takes no more than its number of iterations
UNSEEN = 1.0 / 12.0  # of the second difference of an acceleration over a step: what a step of second order loses of a velocity
ROUNDED = 1e3 * 2.220446049250313e-16  # of a place: what penalties of 1e6 just hold is magnified by their root
NOTHING = 1e-5  # 1/s, of the velocity, that a run may always lose to its iterations
NEGLIGIBLE = 1e-7  # relative velocity increment that need not be looked at
STAGNATION = 0.5  # an iteration that gains less is stopped and its best iterate judged
LARGEST_TURN = 0.1  # rad; an iteration that wants to turn a body by more follows tangents that no longer hold: it goes only so far
DAMPED_FROM = 8  # iterations of a step in mode fixed, from where on only half of each is taken
MOST_ITERATIONS = 20  # of a step in mode fixed
GAIN = 0.1  # part of the violation that an iterate may have without the combination that would close it
CONTRACTION_TO_REUSE = 0.1  # tolerance mode keeps the factorization while an iteration gains a digit


@kernel(inner=True)
def _balanced(tables, c, speed, work):
    """Whether the residuals are below the tolerance, as velocity over a step (momentum) and as displacement (constraints)."""
    limit = c.tolerance * speed
    for i in range(work.phi_end.shape[0]):
        if not abs(work.phi_end[i]) <= (limit * c.h if tables.constraints.holonomic[i] == 1 else limit):
            return False
    for b in range(tables.bodies.mass.shape[0]):
        for i in range(3):
            if not abs(work.r[b, i]) * tables.penalty_inverse_mass[b] * c.h <= limit:
                return False
            if not abs(work.r[b, 3 + i]) * tables.penalty_inverse_inertia[b, i, i] * c.h <= limit:
                return False
    return True


@kernel(borrow=True)
def assemble(tables, c, lam, to_g, work):
    """Assign penalties, constraint rows and the force part of the step matrix in work.saddle from what was evaluated before, the
    gradients of the end in work.saddle.J_force (work.J_end with c.weigh, and when iterating to a tolerance) among it. With
    augmentation.by_stage the gradients of the stage take their place (solver.step.augmentation).
    """
    saddle = work.saddle
    T = work.T_end
    s = 1.0 - c.af
    effective_masses(tables, work.J_stage, saddle.W)
    if c.weigh != 0:
        invoke(c.weigh, (tables, c, work))
    if c.weigh != 0 or c.fixed == 0:
        copy_blocks(work.J_end, saddle.J_force)
    if work.augmentation.by_stage[0] == 1:
        copy_blocks(work.J_stage, saddle.J_force)
        T = work.T_stage
    for i in range(lam.shape[0]):
        m = 1.0 / to_g[tables.constraints.holonomic[i]] if c.m_alf == 1 else saddle.W[i]
        saddle.W[i] = c.penalty[i] * (c.factor[i] * m)
    add_constraint_stiffness(tables, work.kin_stage, lam, work.Kq, work.Kv)
    # rows of the end of the step in both places: see the module docstring of solver.model.saddle
    rotate_columns(tables.constraints, saddle.J_force, T, saddle.J_row)
    assemble_tangent(tables, 1.0 - c.am, s * c.beta * c.h * c.h, s * c.gamma * c.h, work.Kq, work.Kv, work.T_stage, saddle.B)


@kernel(inner=True)
def predict(c, s0, s1, work):
    """Assign the first iterate, s1.a and s1.lam, and work.zp; returns cz: internal states of the stage are z = zp + cz dz/dt.

    The acceleration of the stage is smooth even where a oscillates (rho_inf near one): predict with it. A single iteration is of
    second order only from a linear prediction; further iterations need none, and it would carry kicks on.
    """
    slope = 1.0 if c.fixed == 1 and c.iterations == 1 else 0.0
    share = 1.0 / (1.0 - c.am)
    for b in range(work.r.shape[0] - 1):
        for i in range(6):
            a_stage = s0.a_stage[b, i] + slope * (s0.a_stage[b, i] - s0.a_stage_before[b, i])
            s1.a[b, i] = share * (a_stage - c.am * s0.a[b, i])
    for i in range(s0.lam.shape[0]):
        s1.lam[i] = WARM_START * (s0.lam[i] + slope * (s0.lam[i] - s0.lam_before[i]))
    s = 1.0 - c.af
    cz = s * c.gamma1 * c.h / (1.0 - c.am1)
    for i in range(s0.z.shape[0]):
        work.zp[i] = s0.z[i] + s * c.h * (1.0 - c.gamma1) * s0.zd[i] - cz * c.am1 * s0.zd[i]
    return cz


@kernel(inner=True)
def evaluate_iterate(tables, c, s0, s1, u, cz, tangents, J_end, work):
    """Assign the residuals work.r and work.g at the present iterate; with `tangents` all that assemble() needs besides."""
    place(tables, c, s0, s1.a, s1.q, WITH_TANGENTS if tangents else BOTH, work)
    evaluate_forces(tables, work.kin_stage, s0.angle, work.zp, cz, u, tangents, work.f, work.Kq, work.Kv, work.z_stage, work.outputs)
    evaluate_constraints(tables, work.kin_stage, s0.angle, u, YES, work.phi_stage, work.J_stage)
    evaluate_constraints(tables, work.kin_end, s0.angle, u, tangents, work.phi_end, J_end)
    add_constraint_forces(tables.constraints, work.J_stage, s1.lam, 1.0, work.f)
    momentum_residual(tables, c, s0.a, s1.a, work.f, work.r)
    to_g = _to_g(c)
    for i in range(work.g.shape[0]):
        work.g[i] = work.phi_end[i] * to_g[tables.constraints.holonomic[i]]


@kernel(inline=True)
def _to_g(c):
    """What makes an acceleration of the residual of a velocity (0) and of a position (1) at the end of a step."""
    return 1.0 / (c.gamma * c.h), 1.0 / (c.beta * c.h * c.h)


@kernel(inner=True)
def increment_of(work):
    """(largest increment of an acceleration, largest of those that turn a body, body that is not finite or -1)."""
    increment = 0.0
    turn = 0.0
    bad = -1
    for b in range(work.r.shape[0] - 1):
        turn = max(turn, largest_turn(work.dw, b))
        increment = max(increment, largest(work.dw, b))
        if not finite(work.dw, b):
            bad = b
    return increment, turn, bad


@kernel(inner=True)
def add_increment(part, s1, work):
    """Add a part of the increment to the iterate."""
    for b in range(work.r.shape[0] - 1):
        for i in range(6):
            s1.a[b, i] += part * work.dw[b, i]
    for i in range(s1.lam.shape[0]):
        s1.lam[i] += part * work.dlam[i]


@kernel(inner=True)
def keep_best(s1, work):
    """Remember the iterate."""
    copy_rows(s1.a, work.a_best)
    for i in range(s1.lam.shape[0]):
        work.lam_best[i] = s1.lam[i]


@kernel(inner=True)
def return_to_best(s1, work):
    """Go back to the iterate that was remembered."""
    copy_rows(work.a_best, s1.a)
    for i in range(s1.lam.shape[0]):
        s1.lam[i] = work.lam_best[i]


@kernel(inner=True)
def speed_of(s):
    """Largest velocity [m/s or rad/s], at least 1: what increments and residuals are relative to."""
    speed = 1.0
    for b in range(s.v.shape[0] - 1):
        speed = max(speed, largest(s.v, b))
    return speed


@kernel(inner=True)
def _is_lost_anyway(c, s0, s1, left, speed):
    """Whether a step loses as much as `left` of a velocity [m/s or rad/s] whatever its iteration leaves: by what it does not see of a
    motion that bends, most often that of one of the first bodies; or whether that may always be lost, or is rounding of the places.
    """
    if left < NOTHING * c.h * speed:
        return True
    far = 0.0
    for b in range(s0.v.shape[0] - 1):
        for i in range(6):
            a_stage = (1.0 - c.am) * s1.a[b, i] + c.am * s0.a[b, i]
            if left < UNSEEN * c.h * abs(a_stage - 2.0 * s0.a_stage[b, i] + s0.a_stage_before[b, i]):
                return True
        for i in range(3):
            far = max(far, abs(s0.q[b, i]))
    return left < ROUNDED * far / c.h


@kernel(borrow=True)
def factorize(tables, c, lam, work):
    """Factorize the matrix of what was evaluated before; returns the row that is singular, or -1."""
    assemble(tables, c, lam, _to_g(c), work)
    begin_augmentation(work.augmentation)
    return factorize_saddle(tables, c.form, work.saddle)


@kernel(borrow=True)
def _solve_by_stage(tables, c, s0, s1, u, measure, share, smallest, work):
    """Solve once more with the rows of the stage in the matrix, for a direction that those of the end do not see; with those of the end
    after all where the stage sees it no better. Returns (directions combined, factorizations, row that is singular or -1).
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


@kernel(inner=True)
def iterate(tables, c, s0, s1, u, cz, speed, work):
    """Newton's iteration on s1.a and s1.lam. Returns a StepResult without drifts."""
    saddle = work.saddle
    # Straight to where assemble() wants the gradients, unless it needs that place for itself, or an iteration that has converged may end
    # before they are factorized: the projection must solve with the rows that the factorization has.
    J_end = saddle.J_force if c.weigh == 0 and c.fixed == 1 else work.J_end
    status = NOT_CONVERGED
    where = 0
    factorizations = 0
    iterations = 0
    evaluations = 0
    tried = 0  # 1 when the first iteration was one without its combination: it is not counted
    increment = 0.0
    residual = 0.0
    part = 1.0
    refactor: np.bool_ | bool = YES
    share = ENOUGH * ENOUGH if c.fixed == 1 else CONTRACTION * CONTRACTION
    smallest = (HELD if c.fixed == 1 else CONTRACTION * c.tolerance) * speed / (c.gamma * c.h)
    best = np.inf
    stagnated = 0
    work.augmentation.withheld[0] = 0
    work.augmentation.by_stage[0] = 0
    growing = c.combined == 1 and c.fixed == 1 and grew(s0.lam, s0.lam_before)
    unseen = False  # whether a direction was met that the end of the step does not see
    for it in range(max(c.iterations, MOST_ITERATIONS) if c.fixed == 1 else c.iterations):
        iterations += 1
        evaluations += 1
        evaluate_iterate(tables, c, s0, s1, u, cz, refactor, J_end, work)
        if work.augmentation.withheld[0] > 0 and weighed(saddle.W, work.g, work.g) > GAIN * GAIN * work.augmentation.violation[0]:
            restore(work.augmentation, part, s1.a, s1.lam)
            evaluate_iterate(tables, c, s0, s1, u, cz, refactor, J_end, work)
            evaluations += 1
        if c.fixed == 0 and it > 0 and _balanced(tables, c, speed, work):
            status = OK
            break
        if refactor:
            where = factorize(tables, c, s1.lam, work)
            factorizations += 1
            if where >= 0:
                status = SINGULAR
                break
        solve_saddle(tables, c.form, saddle, work.r, work.g, work.dw, work.dlam)
        if c.combined == 1 and (refactor or work.augmentation.known[0] > 0):
            measure = it == 0 or c.fixed == 0
            work.augmentation.withheld[0] = 0
            used = combine(tables, c.form, saddle, work.augmentation, measure, share, smallest, work.g, work.dw, work.dlam)
            if it == 0 and growing and work.augmentation.dropped[0] == 0:
                is_unseen(
                    tables, c.form, saddle, work.augmentation, work.J_stage, work.T_stage, work.g, work.dw, work.a_best, work.lam_best
                )
            if work.augmentation.dropped[0] == 1 and c.fixed == 1 and refactor and not unseen:
                unseen = True
                used, more, where = _solve_by_stage(tables, c, s0, s1, u, measure, share, smallest, work)
                factorizations += more
                if where >= 0:
                    status = SINGULAR
                    break
            if it == 0 and used > 0 and withhold(work.augmentation, used, c.penalty, c.beta * c.h * c.h, work.dw, work.dlam):
                tried = 1
        before = increment
        increment, turn, where = increment_of(work)
        if where >= 0:
            status = NON_FINITE
            break
        increment *= c.gamma * c.h / speed
        turn *= c.beta * c.h * c.h
        part = LARGEST_TURN / turn if turn > LARGEST_TURN else 1.0
        if c.fixed == 1 and part == 1.0 and before > 0.0 and increment > max(STAGNATION * before, NEGLIGIBLE):
            # Next to a singular position the constraints are closed, but not by forces along A of the stage: the impulse that closed them
            # acted along A of the end, which is as good to second order. Going on only makes it worse.
            closed = weighed(saddle.W, work.g, work.g) < SETTLED * SETTLED * work.augmentation.violation[0]
            if (before < LARGEST_STAGNATION or closed) and opposed(tables, work.J_stage, J_end, work.dlam, work.r, work.f):
                residual = increment
                status = OK
                stagnated = 1
                break
        if c.fixed == 1 and it >= max(c.iterations, DAMPED_FROM):
            part = min(part, 0.5)  # Newton's iteration may go round between the branches of a contact; half of it does not
        add_increment(part, s1, work)
        rate = increment / before if it > 0 and before > 0.0 else 1.0
        residual = increment
        remaining = increment * rate / (1.0 - rate) if rate < 1.0 else increment
        if c.fixed == 1:
            # A fixed number of iterations relies on their gain. Where they do not gain (a stop is hit, a wheel lands) the tangents of
            # the prediction are those of another place: go on with new ones until they do.
            left = remaining if part == 1.0 else increment
            last = it >= c.iterations - 1 + tried
            settled = left < (SETTLED if last else LARGEST_STAGNATION)
            # A run is judged by its last increments, of which nobody knows what the next would be: of one that is large it is made.
            settled &= increment < LARGEST_STAGNATION or not last
            # What every step leaves in one direction adds up, so it must be less than what steps lose anyway. Of a single iteration no
            # gain is known; and where one with new tangents gains nothing, another one is no better.
            enough = it == 0 or (it >= c.iterations and rate > STAGNATION)
            if last and settled and work.augmentation.withheld[0] == 0 and (enough or _is_lost_anyway(c, s0, s1, left * speed, speed)):
                status = OK
                break
            refactor = (it > 0 or c.iterations == 1) and (last or not settled)
        else:
            if min(increment, remaining) <= c.tolerance and work.augmentation.withheld[0] == 0:
                status = OK
                break
            if increment < best:
                best = increment
                keep_best(s1, work)
            if it > 1 and before > 0.0 and rate > STAGNATION and part == 1.0 and best < LARGEST_STAGNATION:
                break
            refactor = rate > CONTRACTION_TO_REUSE
            where = it
        if part < 1.0:
            increment = 0.0  # nothing to compare the next iteration with
    if status == NOT_CONVERGED and c.fixed == 1 and residual < LARGEST_STAGNATION:  # settles slowly
        status = OK
        stagnated = 1
    if status == NOT_CONVERGED and best < LARGEST_STAGNATION:
        # Next to a singular position the iteration may not settle along the direction that the constraints hardly see (the force
        # direction A at the stage and the constraint row A at the end can have opposite signs there); its best iterate is as good as any.
        return_to_best(s1, work)
        residual = best
        status = OK
        stagnated = 1
    return StepResult(status, where, Counters(iterations, factorizations, evaluations, stagnated, residual, 0.0, 0.0))
