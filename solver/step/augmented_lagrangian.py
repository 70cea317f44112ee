"""The augmented-Lagrangian step: three independent fields (position, velocity, momentum rate), tied over each step.

Formulation: [Natsiavas2015], [Paraskevopoulos2015], [Potosakis2020] (docs/references.md).

Scheme (docs/decisions/0002): generalized-alpha with all forces, constraint forces included, taken at the generalized
midpoint t_s = t_0 + (1 - alpha_f) h, and the position constraint imposed at the end of the step:

    M ((1 - am) a1 + am a0) = f(q_s, v_s, z_stage) + A(q_s)^T h_R
    v1 = v0 + h ((1 - gamma) a0 + gamma a1)
    q1 = q0 o exp(D),  D = h v0 + h^2 ((1/2 - beta) a0 + beta a1);   q_s = q0 o exp((1 - af) D),  v_s = (1 - af) v1 + af
                       v0
    phi(q1, t1) = 0,  A(q1) v1 = 0 for rows that are not holonomic

with am, af, beta, gamma of [Chung1993] for the spectral radius rho_inf and the increment D as in [Bruls2010]. For
rho_inf = 1 it is the midpoint rule with an impulse along A at the midpoint. First-order internal states use the
parameters of [Jansen2000] for the same rho_inf, which have the same stage. The constraint force h_R is augmented within
the step, h_R <- h_R - W_R (g_R + A dw), g = phi / (beta h^2) or A v / (gamma h), where W_R = xi_R m_R is the penalty
scaled by the effective mass (solver.model.saddle). The velocity in the output is projected onto A v + phi_t = 0
[Bayo1996]; the projection is not fed back, because that costs the multipliers an order.
"""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import NO, YES, invoke, kernel
from solver.model.evaluate import (
    constraint_input_rates,
    constraint_rates,
    evaluate_constraints,
    evaluate_driven_forces,
    evaluate_forces,
)
from solver.model.saddle import solve_saddle
from solver.model.state import turn_angles, update_angles
from solver.output.collect import collect
from solver.output.contradiction import note_contradiction
from solver.output.energy import NOISE, note_residuals, update_energy
from solver.output.shake import note_shake
from solver.output.snapshot import Counters
from solver.output.undetermined import DOUBT, note_undetermined
from solver.step.augmentation import ENOUGH, combine, grew
from solver.step.iteration import predict, speed_of
from solver.step.iteration_fixed import iterate_fixed
from solver.step.iteration_to_tolerance import iterate_to_tolerance
from solver.step.stage import AT_END, copy_rows, fastest_turn, is_row_finite, place
from solver.step.work import BAD_INPUT, NON_FINITE, OK, StepResult, added, last_result

# Turn of a body in a step [rad], up to which the value of an angle nearest to that before is the one; two bodies turn
# twice as much, and from pi on it is not.
NEAREST = 1.5


@kernel(inner=True)
def finish(tables, c, s0, s1, work):
    """Assign the rest of s1 from its acceleration, multipliers and the internal states of the stage; a_out and lam_out
    of work."""
    place(tables, c, s0, s1.a, s1.q, AT_END, work)
    for b in range(tables.bodies.mass.shape[0]):
        for i in range(6):
            s1.v[b, i] = work.kin_end.v[b, i]
            s1.a_stage_before[b, i] = s0.a_stage[b, i]
            s1.a_stage[b, i] = (1.0 - c.am) * s1.a[b, i] + c.am * s0.a[b, i]
            # continued from the stage to the end of the step, as the multipliers are
            work.a_out[b, i] = s1.a_stage[b, i] + c.ahead * (s1.a_stage[b, i] - s0.a_stage[b, i])
    for i in range(s0.z.shape[0]):
        s1.z[i] = (work.z_stage[i] - c.af * s0.z[i]) / (1.0 - c.af)
        s1.zd[i] = ((s1.z[i] - s0.z[i]) / c.h - (1.0 - c.gamma1) * s0.zd[i]) / c.gamma1
    for i in range(s0.lam.shape[0]):
        s1.lam_before[i] = s0.lam[i]
        work.lam_out[i] = s1.lam[i] + c.ahead * (s1.lam[i] - s0.lam[i])
    for i in range(s0.angle.shape[0]):
        s1.angle[i] = s0.angle[i]
    if fastest_turn(s1, tables.bodies.mass.shape[0]) * c.h > NEAREST:
        turn_angles(tables.coordinates, work.kin_end, c.h, s1.angle)
    update_angles(tables.coordinates, work.kin_end, s1.angle)


@kernel(inner=True)
def outputs_at_end(tables, s1, u, work):
    """Evaluate the forces at the end of the step, with the projected velocity."""
    for b in range(tables.bodies.mass.shape[0]):
        for i in range(6):
            work.kin_end.v[b, i] = work.v_out[b, i]
    evaluate_forces(
        tables, work.kin_end, s1.angle, s1.z, 0.0, u, NO, work.f, work.Kq, work.Kv, work.z_stage, work.outputs
    )


@kernel(inner=True)
def position_drift(tables, work):
    """(largest residual of a position constraint [m or rad], largest as a length [m])."""
    worst, longest = 0.0, 0.0
    for i in range(work.phi_end.shape[0]):
        if tables.constraints.holonomic[i] == 1:
            worst = max(worst, abs(work.phi_end[i]))
            longest = max(longest, work.row_length[i] * abs(work.phi_end[i]))
    return worst, longest


@kernel(inner=True)
def body_not_finite(work):
    """The last body whose projected twist is not finite, or -1."""
    bad = -1
    for b in range(work.r.shape[0] - 1):
        if not is_row_finite(work.v_out, b):
            bad = b
    return bad


@kernel(borrow=True)
def step(tables, c, s0, s1, u, want_outputs, work):
    """Advance s0 to s1 by one step with the inputs u; outputs and projected velocity go to work. Returns a
    StepResult."""
    cz = predict(c, s0, s1, work)
    speed = speed_of(s0, work)
    if c.fixed == 1:
        found = iterate_fixed(tables, c, s0, s1, u, cz, speed, work)
    else:
        found = iterate_to_tolerance(tables, c, s0, s1, u, cz, speed, work)
    status, where, n = found.status, found.where, found.counters
    residual, position, velocity, evaluations = n.residual, 0.0, 0.0, n.evaluations
    if status == OK:
        finish(tables, c, s0, s1, work)
        evaluate_constraints(tables, work.kin_end, s1.angle, u, YES, work.phi_end, work.J_end)
        position, longest = position_drift(tables, work)
        # a factorization with rows of the stage closes less at once
        passes = 1 if c.fixed == 1 and work.augmentation.by_stage[0] == 0 else 3
        velocity = project_velocity(tables, c, s1.v, u, passes, work)
        if want_outputs:
            outputs_at_end(tables, s1, u, work)
            evaluations += 1
        # what augmentations leave open shows in no increment
        residual = max(n.residual, longest / (c.h * speed))
        bad = body_not_finite(work)
        if bad >= 0 or not np.isfinite(velocity + position):
            status, where = NON_FINITE, max(bad, 0)
    counters = Counters(n.iterations, n.factorizations, evaluations, n.stagnated, residual, position, velocity)
    return StepResult(status, where, counters)


@kernel(inner=True)
def violated_rates(tables, work):
    """Assign work.rate = A v + phi_t of the velocity work.v_out at the end of the step; returns the largest."""
    constraint_rates(tables.constraints, work.J_end, work.v_out, work.rate)
    worst = 0.0
    for i in range(work.rate.shape[0]):
        work.rate[i] += work.phi_t[i]
        worst = max(worst, abs(work.rate[i]))
    return worst


@kernel(borrow=True)
def project_velocity(tables, c, v, u, passes, work):
    """work.v_out = v projected onto A v + phi_t = 0 with the factorization of the step; returns the largest violation
    left."""
    nb = tables.bodies.mass.shape[0]
    copy_rows(v, work.v_out)
    constraint_input_rates(tables, u, work.phi_t, work.phi_tt)
    work.r[:] = 0.0
    worst = 0.0
    for k in range(passes + 1):
        worst = violated_rates(tables, work)
        if k == passes or (k > 0 and worst < c.tolerance):
            break
        solve_saddle(tables, c.form, work.saddle, work.r, work.rate, work.dw, work.dlam)
        if work.augmentation.known[0] > 0:
            combine(
                tables,
                c.form,
                work.saddle,
                work.augmentation,
                YES,
                ENOUGH * ENOUGH,
                0.0,
                work.rate,
                work.dw,
                work.dlam,
            )
        for b in range(nb):
            T = work.T_end[b]
            for i in range(3):
                work.v_out[b, i] += work.dw[b, i]
                work.v_out[b, 3 + i] += T[i, 0] * work.dw[b, 3] + T[i, 1] * work.dw[b, 4] + T[i, 2] * work.dw[b, 5]
    return worst


@kernel(inner=True)
def perform(tables, c, s0, s1, u, want_outputs, work):
    """step() for callers by address, c.step: its result goes to work.result. So it is compiled once for all who take
    steps, and c may change between two of them.
    """
    result = step(tables, c, s0, s1, u, want_outputs, work)
    n = result.counters
    r = work.result
    r[0], r[1], r[2], r[3], r[4], r[5] = (
        result.status,
        result.where,
        n.iterations,
        n.factorizations,
        n.evaluations,
        n.stagnated,
    )
    r[6], r[7], r[8] = n.residual, n.position_drift, n.velocity_drift


@kernel(inner=True)
def continue_inputs(follow, u, work):
    """Assign work.u_end, the inputs u of the stage continued to the end of the step by a part `follow` of their change
    over an interval; whether they differ.

    Their power at the end of a step is then of second order. Outputs show what the step applied: a jump must not
    overshoot there.
    """
    differs = False
    for i in range(u.shape[0]):
        change = work.u_force[i] * (u[i] - work.u_before[i])
        work.u_end[i] = u[i] + follow * change
        differs = differs or change != 0.0
    return differs


@kernel(inner=True)
def keep_account(tables, c, h, parts, follow, s0, s1, u, counters, work):
    """Advance the account by the step of h [s] from s0 to s1, with forces that follow inputs as these are at its end.
    parts: 2 where s0 is the state in the middle of the step."""
    outputs = work.outputs
    if continue_inputs(follow, u, work):
        outputs = work.outputs_end
        for i in range(outputs.shape[0]):
            outputs[i] = work.outputs[i]
        w = work
        evaluate_driven_forces(tables, w.kin_end, s1.angle, s1.z, 0.0, w.u_end, NO, w.f, w.Kq, w.Kv, w.z_stage, outputs)
    update_energy(tables, work.kin_end, outputs, work.lam_out, work.phi_t, h, work.account)
    n, g = counters, tables.bodies.gravity
    falling, creeping = h * (g[0] * g[0] + g[1] * g[1] + g[2] * g[2]) ** 0.5, NOISE * work.length / h
    slowest = max(falling, creeping), max(falling, creeping) / work.length
    coefficient = 0.25 * (1.0 + (c.am - c.af) ** 2) - 1.0 / 6.0
    position, velocity, account = n.position_drift, n.velocity_drift, work.account
    note_residuals(
        tables.constraints, tables.bodies.inertia, h, parts, coefficient, s1.v, work.kin_end, n.residual, position,
        velocity,
        work.phi_end, work.rate, s1, s0.a_stage_before, slowest, account,
    )  # fmt: skip
    note_shake(tables, outputs, account)
    note_contradiction(tables.constraints, work.J_end, work.lam_out, work.phi_end, work.length, work.r, work.f, account)
    work.marks[-1] = 0.0
    if work.augmentation.known[0] > 0 or account.doubt[DOUBT] != 0.0 or grew(s1.lam, s0.lam):
        note_undetermined(tables, h, s0, s1, u, work)


@kernel(borrow=True)
def advance(tables, c, s0, s1, inputs, first, count, audit, work):
    """Advance count steps with rows first.. of inputs (n, nu), swapping the buffers; outputs are of the last step, in
    work.arrays too.

    A single row of inputs holds for all steps. audit: evaluate outputs after every step and keep the energy balance.

    Returns (StepResult with summed counters and largest residuals, steps done). After an odd number of steps the newest
    state is in s1, after an even number in s0.
    """
    held = inputs.shape[0] == 1
    for k in range(first, first + count):
        for i in range(inputs.shape[1]):
            if not np.isfinite(inputs[0 if held else k, i]):
                return StepResult(BAD_INPUT, i, Counters(0, 0, 0, 0, 0.0, 0.0, 0.0)), 0
    total = Counters(0, 0, 0, 0, 0.0, 0.0, 0.0)
    old, new = s0, s1
    for k in range(count):
        u = inputs[0 if held else first + k]
        invoke(c.step, (tables, c, old, new, u, np.bool_(audit or k == count - 1), work))
        result = last_result(work)
        total = added(total, result.counters)
        if result.status != OK:
            return StepResult(result.status, result.where, total), k
        if audit:
            keep_account(tables, c, c.h, 1, c.ahead, old, new, u, result.counters, work)
        for i in range(u.shape[0]):
            work.u_before[i] = u[i]
        old, new = new, old
    if count > 0:
        u = inputs[0 if held else first + count - 1]
        w = work
        if not audit:
            w.marks[-1] = 0.0
        shown = w.outputs, w.account, w.arrays
        collect(tables, w.chassis, w.kin_end, w.a_out, w.lam_out, w.marks, u, old, *shown)
    return StepResult(OK, 0, total), count
