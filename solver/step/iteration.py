"""Newton's iteration of a step: prediction, residuals at an iterate, the matrix, increments.

When an iteration ends is another matter in each of the two modes: solver.step.iteration_fixed, iteration_to_tolerance.

Equations and notation: solver.step.augmented_lagrangian.
"""

from __future__ import annotations

from solver.compiled.kernel import YES, invoke, kernel
from solver.model.evaluate import add_constraint_forces, add_constraint_stiffness, evaluate_constraints, evaluate_forces
from solver.model.saddle import assemble_tangent, effective_masses, factorize_saddle, rotate_columns
from solver.step.augmentation import begin_augmentation, restore, weighed, withhold
from solver.step.stage import (
    BOTH,
    WITH_TANGENTS,
    copy_blocks,
    is_row_finite,
    largest_by_length,
    largest_turn,
    momentum_residual,
    place,
)

# The multipliers of redundant constraints are determined only by rounding; starting each step from a little less than
# the last values keeps that part from drifting, while the determined part is found again by the first iteration.
WARM_START = 0.9999
LARGEST_STAGNATION = 1e-2  # relative velocity increment below which an iteration that stops converging is accepted
# Rate of an iteration, increment over the one before; one with a larger rate is stopped and its best iterate judged.
STAGNATION = 0.5
# rad; an iteration that wants to turn a body by more follows tangents that no longer hold: it goes only so far
LARGEST_TURN = 0.1
GAIN = 0.1  # part of the violation that an iterate may have without the combination that would close it


@kernel(borrow=True)
def assemble(tables, c, lam, to_g, work):
    """Assign penalties, constraint rows and the force part of the step matrix in work.saddle from what was evaluated
    before, the gradients of the end in work.saddle.J_force (work.J_end with c.weigh, and when iterating to a tolerance)
    among it. With augmentation.by_stage the gradients of the stage take their place (solver.step.augmentation).
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
    assemble_tangent(
        tables, 1.0 - c.am, s * c.beta * c.h * c.h, s * c.gamma * c.h, work.Kq, work.Kv, work.T_stage, saddle.B
    )


@kernel(inner=True)
def predict(c, s0, s1, work):
    """Assign the first iterate, s1.a and s1.lam, and work.zp; returns cz: internal states of the stage are z = zp + cz
    dz/dt.

    The acceleration of the stage is smooth even where a oscillates (rho_inf near one): predict with it. A single
    iteration is of second order only from a linear prediction; further iterations need none, and it would carry kicks
    on.
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
    """Assign the residuals work.r and work.g at the present iterate; with `tangents` all that assemble() needs
    besides."""
    place(tables, c, s0, s1.a, s1.q, WITH_TANGENTS if tangents else BOTH, work)
    evaluate_forces(
        tables, work.kin_stage, s0.angle, work.zp, cz, u, tangents, work.f, work.Kq, work.Kv, work.z_stage, work.outputs
    )
    evaluate_constraints(tables, work.kin_stage, s0.angle, u, YES, work.phi_stage, work.J_stage)
    evaluate_constraints(tables, work.kin_end, s0.angle, u, tangents, work.phi_end, J_end)
    add_constraint_forces(tables.constraints, work.J_stage, s1.lam, 1.0, work.f)
    momentum_residual(tables, c, s0.a, s1.a, work.f, work.r)
    to_g = _to_g(c)
    for i in range(work.g.shape[0]):
        work.g[i] = work.phi_end[i] * to_g[tables.constraints.holonomic[i]]


@kernel(inline=True)
def _to_g(c):
    """Factors that make an acceleration of the residual of a velocity (0) and of a position (1) at the end of a
    step."""
    return 1.0 / (c.gamma * c.h), 1.0 / (c.beta * c.h * c.h)


@kernel(inner=True)
def increment_of(work):
    """(largest increment of an acceleration [m/s^2], largest of those that turn a body [rad/s^2], body that is not
    finite or -1)."""
    increment = 0.0
    turn = 0.0
    bad = -1
    for b in range(work.r.shape[0] - 1):
        turn = max(turn, largest_turn(work.dw, b))
        increment = max(increment, largest_by_length(work.dw, b, work.length))
        if not is_row_finite(work.dw, b):
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
def speed_of(s, work):
    """Largest speed [m/s], at least the slow one of the model: what increments and residuals are relative to."""
    speed = work.slow[0]
    for b in range(s.v.shape[0] - 1):
        speed = max(speed, largest_by_length(s.v, b, work.length))
    return speed


@kernel(borrow=True)
def factorize(tables, c, lam, work):
    """Factorize the matrix of what was evaluated before; returns the row that is singular, or -1."""
    assemble(tables, c, lam, _to_g(c), work)
    begin_augmentation(work.augmentation)
    return factorize_saddle(tables, c.form, work.saddle)


@kernel(inline=True)
def evaluate_tried(tables, c, s0, s1, u, cz, part, tangents, J_end, work):
    """evaluate_iterate(), and again with the combination that was withheld from the iterate, if the violation grew
    without it.

    part: of the last increment, that was added. Returns the number of evaluations.
    """
    augmentation = work.augmentation
    evaluate_iterate(tables, c, s0, s1, u, cz, tangents, J_end, work)
    if augmentation.withheld[0] == 0:
        return 1
    if not weighed(work.saddle.W, work.g, work.g) > GAIN * GAIN * augmentation.violation[0]:
        return 1
    restore(augmentation, part, s1.a, s1.lam)
    evaluate_iterate(tables, c, s0, s1, u, cz, tangents, J_end, work)
    return 2


@kernel(inline=True)
def measured_increment(c, speed, work):
    """(increment of the velocity relative to `speed`, part of it that is taken, body that is not finite or -1)."""
    increment, turn, bad = increment_of(work)
    turn *= c.beta * c.h * c.h
    return increment * (c.gamma * c.h / speed), LARGEST_TURN / turn if turn > LARGEST_TURN else 1.0, bad


@kernel(inline=True)
def remaining(increment, rate):
    """Error that remains behind an increment that is `rate` times the one before, by a geometric series."""
    return increment * rate / (1.0 - rate) if rate < 1.0 else increment


@kernel(inline=True)
def begin_iterations(work):
    """Nothing is withheld yet, and the factorization has the rows of the end."""
    work.augmentation.withheld[0] = 0
    work.augmentation.by_stage[0] = 0


@kernel(inline=True)
def may_withhold(c, used, work):
    """Withhold the combination of `used` directions from the first increment, where one of them may be none; whether it
    was."""
    return used > 0 and withhold(work.augmentation, used, c.penalty, c.beta * c.h * c.h, work.dw, work.dlam)
