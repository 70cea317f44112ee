"""Iterations of a step in mode tolerance: until residuals or increments are small enough.

Equations and notation: solver.step.augmented_lagrangian; what both modes share: solver.step.iteration.
"""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import YES, kernel
from solver.model.saddle import solve_saddle
from solver.output.snapshot import Counters
from solver.step.augmentation import CONTRACTION, combine, opposed
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
from solver.step.iteration_fixed import NEGLIGIBLE, SETTLED_SHARE
from solver.step.stage import copy_rows
from solver.step.work import NON_FINITE, NOT_CONVERGED, OK, SINGULAR, StepResult

# Rate of an iteration up to which mode tolerance keeps its factorization; at 1 it would never make a new one.
CONTRACTION_TO_REUSE = 0.1


@kernel(inner=True)
def _closed(tables, c, limit, work):
    """True where no residual of a constraint is above limit [m/s], as velocity over a step."""
    for i in range(work.phi_end.shape[0]):
        if not work.row_length[i] * abs(work.phi_end[i]) <= (
            limit * c.h if tables.constraints.holonomic[i] == 1 else limit
        ):
            return False
    return True


@kernel(inner=True)
def _balanced(tables, c, speed, work):
    """True where the residuals are below the tolerance, as velocity over a step (momentum) and as displacement
    (constraints)."""
    limit = c.tolerance * speed
    if not _closed(tables, c, limit, work):
        return False
    for b in range(tables.bodies.mass.shape[0]):
        for i in range(3):
            if not abs(work.r[b, i]) * tables.penalty_inverse_mass[b] * c.h <= limit:
                return False
            if not work.length * abs(work.r[b, 3 + i]) * tables.penalty_inverse_inertia[b, i, i] * c.h <= limit:
                return False
    return True


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
def iterate_to_tolerance(tables, c, s0, s1, u, cz, speed, work):
    """Iterations, c.iterations at most, until residuals or increments are below c.tolerance.

    The factorization is kept while an iteration gains a digit.
    """
    # An iteration that has converged may end before its gradients are factorized: the projection must solve with the
    # rows that the factorization has, so they are evaluated beside them.
    J_end = work.J_end
    status, where, stagnated = NOT_CONVERGED, 0, 0
    iterations, factorizations, evaluations = 0, 0, 0
    increment, residual, part = 0.0, 0.0, 1.0
    refactor: np.bool_ | bool = YES
    share, smallest = CONTRACTION * CONTRACTION, CONTRACTION * c.tolerance * speed / (c.gamma * c.h)
    # Next to a singular position the first iterate that is closed by the end is held until another gains a digit on it:
    # the least increment of those that follow may be that of one thrown along the direction that is hardly seen. Closed
    # means that the increment which follows is not there to close it: with penalties below 1e3 and no combination an
    # iterate is open by a part of each increment. Ten times SETTLED_SHARE, as a part of that increment, gives the same
    # runs; a hundred times holds open iterates, and a tenth holds too few (docs/decisions/0004).
    best, held = np.inf, False
    begin_iterations(work)
    for it in range(c.iterations):
        iterations += 1
        evaluations += evaluate_tried(tables, c, s0, s1, u, cz, part, refactor, J_end, work)
        if it > 0 and _balanced(tables, c, speed, work):
            status = OK
            residual = min(residual, c.tolerance)  # the last increment was that of an iterate which is balanced now
            break
        if refactor:
            where = factorize(tables, c, s1.lam, work)
            factorizations += 1
            if where >= 0:
                status = SINGULAR
                break
        saddle, augmentation = work.saddle, work.augmentation
        solve_saddle(tables, c.form, saddle, work.r, work.g, work.dw, work.dlam)
        if c.combined == 1 and (refactor or augmentation.known[0] > 0):
            augmentation.withheld[0] = 0
            used = combine(tables, c.form, saddle, augmentation, YES, share, smallest, work.g, work.dw, work.dlam)
            if it == 0:
                may_withhold(c, used, work)
        before = increment
        increment, part, where = measured_increment(c, speed, work)
        if where >= 0:
            status = NON_FINITE
            break
        gains = part < 1.0 or before == 0.0 or increment <= max(CONTRACTION_TO_REUSE * before, NEGLIGIBLE)
        if (
            refactor
            and not (held or gains)
            and _closed(tables, c, SETTLED_SHARE * increment * speed, work)
            and opposed(tables, work.J_stage, J_end, work.dlam, work.r, work.f)
        ):
            best, held = before, True
            keep_best(s1, work)
        add_increment(part, s1, work)
        rate = increment / before if before > 0.0 else 1.0
        residual = increment
        if min(increment, remaining(increment, rate)) <= c.tolerance and augmentation.withheld[0] == 0:
            status = OK
            break
        if increment < (CONTRACTION_TO_REUSE * best if held else best):
            best, held = increment, False
            keep_best(s1, work)
        if it > 1 and before > 0.0 and rate > STAGNATION and part == 1.0 and best < LARGEST_STAGNATION:
            break
        refactor = bool(rate > CONTRACTION_TO_REUSE)
        where = it
        if part < 1.0:
            increment = 0.0  # nothing to compare the next iteration with
    if status == NOT_CONVERGED and best < LARGEST_STAGNATION:
        # Next to a singular position the iteration may not settle along the direction that the constraints hardly see
        # (the force direction A at the stage and the constraint row A at the end can have opposite signs there); its
        # best iterate is as good as any.
        return_to_best(s1, work)
        residual = best
        status = OK
        stagnated = 1
    return StepResult(status, where, Counters(iterations, factorizations, evaluations, stagnated, residual, 0.0, 0.0))
