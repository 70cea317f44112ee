"""Fourth order: two steps of half the size and one of the whole from the same start, extrapolated (Richardson;
[Hairer1993] II.9).

For rho_inf = 1 a step is the midpoint rule on the group of motions, with the impulse of the constraints along A of the
midpoint. It is its own inverse with the sign of time reversed, so the error of the velocities and places after a time T
has even powers of h alone, and (4 x_h/2 - x_h) / 3 is of fourth order; rotations are extrapolated along the geodesic
between the two. Three things make it so:

- The step maps positions on the constraints and velocities that violate them by A v + phi_t = -h^2 A e
  (solver.start.newton). Both solutions begin with what belongs to their own h. Without, the violation that one step
  reflects disturbs it by O(h^4), and the extrapolated run is of third order.
- What a velocity violates is known from the steps before: it alternates about its smooth part with what it began with,
  so the mean of three, (w_0 + 2 w_1 + w_2) / 4, is the smooth part, and nothing of it is carried on.
- Both solutions satisfy phi = 0 and differ by O(h^3), so the extrapolated one violates it by O(h^6): nothing
  accumulates, because every step ends on the constraints. Its velocity is projected, and accelerations and multipliers
  are those that belong to both.

Internal states follow the same rule. Motions that a step resolves are of fourth order; unresolved undamped ones grow,
because (4 R(h/2)^2 - R(h)) / 3 exceeds one on the imaginary axis: by y^6 / 1152 per step with y = h omega. So does what
decays within h / 26 or less, by up to 5/3 per step (R(h) goes to -1). The motion shows it, but for the wind-up of
slipping friction, whose sign would choose that of the torque: that one is refused (require_resolved_friction). Rows
that are not holonomic are of third order beside others: what a velocity violates is carried on for positions.
"""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import YES, kernel
from solver.compiled.portable import inverse, principal_moments, product
from solver.compiled.so3 import (
    log_quaternion,
    matrix_of_quaternion,
    quaternion_corrected,
    quaternion_exp,
    quaternion_product,
)
from solver.compiled.vec import load33, mv, scale, store33
from solver.errors import SpecError
from solver.model.evaluate import (
    add_constraint_forces,
    constraint_input_rates,
    constraint_rates,
    evaluate_constraints,
    evaluate_forces,
)
from solver.model.saddle import CONDENSED, assemble_tangent, effective_masses, factorize_saddle, solve_saddle
from solver.model.state import kinematics_of, placed_configuration, update_angles
from solver.model.tables import Model
from solver.step.augmentation import begin_augmentation, combine
from solver.step.augmented_lagrangian import body_not_finite, outputs_at_end, position_drift, violated_rates
from solver.step.stage import copy_rows, largest, largest_by_length
from solver.step.work import NON_FINITE, OK, SINGULAR

THIRD = 1.0 / 3.0
# Times the effective mass of a row; ten times as much gains a digit more in a pass, and has ten times the rounding.
PENALTY = 1e6
SPACING = 1e-3  # lengths of the model, or rad, between the places at which the rows of the constraints are differenced
PASSES = 10  # passes of a projection or an acceleration at most; it ends before when a pass does not halve the residual
EXACT = 1e-13  # relative residual of a projection or an acceleration at which it ends; digits beyond it are rounding
# of a step, at least what a wind-up of friction takes to relax: from less on it swings from step to step
RESOLVED = 0.5
# Phase in a step [rad] of a vibration on bushings, up to which their damping keeps it from growing under extrapolation:
# the car with bushings is right at 2.1, and its energy grows without bounds at 4.2.
SHAKEN = 2.5
# Rounds of the search for the largest frequency, which is then below the true one by 1 % at most; ten times as many
# give one more digit where two frequencies are equal to 1 %.
VECTOR_ITERATIONS = 50
# Kinds of elements with friction, and its stiffness and damping there.
FRICTION = {
    'brakes': ('stiffness', 'damping'),
    'clutches': ('stiffness', 'damping'),
    'guides': ('brake_stiffness', 'brake_damping'),
}


def require_resolved_friction(model: Model, h: float) -> None:
    """Raise SpecError if the wind-up of a brake or clutch relaxes, while it slips, in less than RESOLVED of the step h
    [s]."""
    for kind, names in FRICTION.items():
        for spec in getattr(model.spec, kind):
            stiffness, damping = (getattr(spec, name) for name in names)
            least = RESOLVED * h * stiffness
            if damping < least:
                raise SpecError(
                    f'integrator: order = 4: the wind-up of {spec.where} relaxes in {damping / stiffness:.3g} s '
                    f'(damping over stiffness), which steps of {h:g} s do not resolve: it would grow; give a damping '
                    f'of {least:.3g} N m s/rad or more, or take integrator.order: 2'
                )


def require_resolved_bushings(model: Model, h: float) -> None:
    """Raise SpecError if a body that bushings hold vibrates on what acts on it by more than SHAKEN rad in a step h
    [s]."""
    fastest, body = fastest_on_bushings(model)
    if fastest * h > SHAKEN:
        raise SpecError(
            f'integrator: order = 4: body {body!r} vibrates on its bushings with {fastest:.3g} rad/s, which grows '
            f'under extrapolation with steps of {h:g} s; it would take {SHAKEN / fastest:.2g} s, and order two is '
            f'cheaper then: take integrator.order: 2'
        )


def fastest_on_bushings(model: Model) -> tuple[float, str]:
    """(largest frequency [rad/s] with which a body that bushings hold vibrates on what acts on it, that body); 0 and
    nothing without bushings."""
    held = sorted({m.body for spec in model.spec.bushings for m in (spec.i, spec.j)} & set(model.body_names))
    if not held:
        return 0.0, ''
    nb, bodies = model.n_bodies, model.tables.bodies
    kin = kinematics_of(placed_configuration(model.spec.bodies), np.zeros((nb + 1, 6)))
    Kq, Kv = np.zeros((2, model.n_slots + 1, 6, 6))
    u, angle, z = np.zeros(len(model.spec.inputs)), np.zeros(len(model.coordinate_names)), np.zeros(model.n_internal)
    evaluate_forces(
        model.tables, kin, angle, z, 0.0, u, True, np.zeros((nb + 1, 6)), Kq, Kv, z.copy(), model.new_outputs()
    )
    fastest, body = 0.0, ''
    for name in held:
        b = model.body_names.index(name)
        if bodies.mass[b] > 0.0 and principal_moments(bodies.inertia[b])[0] > 0.0:
            frequency = _fastest(float(bodies.mass[b]), bodies.inertia[b], -Kq[bodies.slot[b]])
            if frequency > fastest:
                fastest, body = frequency, name
    return fastest, body


def _fastest(mass: float, inertia: np.ndarray, stiffness: np.ndarray) -> float:
    """The largest natural frequency [rad/s] of a free body on a stiffness (6, 6), by vector iteration; 0 where nothing
    holds it."""
    stiffness = 0.5 * (stiffness + stiffness.T)
    inverse_masses = np.zeros((6, 6))
    inverse_masses[:3, :3], inverse_masses[3:, 3:] = np.eye(3) / mass, inverse(inertia)
    # no direction is at right angles to these numbers by construction; both parts count by their mass
    x = np.array([1.0, 0.7, 0.9, 0.8, 0.6, 0.5])
    x[3:] *= (mass / principal_moments(inertia)[2]) ** 0.5
    square = 0.0
    for _ in range(VECTOR_ITERATIONS):
        force = product(stiffness, x)
        y = product(inverse_masses, force)
        kinetic = mass * float((x[:3] * x[:3]).sum()) + float((x[3:] * product(inertia, x[3:])).sum())
        square = float((x * force).sum()) / kinetic
        size = float(np.abs(y).max())
        if size == 0.0:
            return 0.0
        x = y / size
    return max(square, 0.0) ** 0.5


@kernel(inner=True)
def _combine_solutions(tables, full, s1, work):
    """s1, its velocity in work.v_out, and work.kin_end become those extrapolated from s1 and the state `full`.

    Velocities as the step has them: what they violate cancels but for O(h^3), and is projected off in the metric of the
    masses. The projection of a step, in the metric of its matrix, would leave O(h^3) along the free directions.
    """
    for b in range(tables.bodies.mass.shape[0]):
        for i in range(3):
            s1.q[b, i] += THIRD * (s1.q[b, i] - full.q[b, i])
            work.kin_end.p[b, i] = s1.q[b, i]
        two = (s1.q[b, 3], s1.q[b, 4], s1.q[b, 5], s1.q[b, 6])
        back = (-full.q[b, 3], -full.q[b, 4], -full.q[b, 5], full.q[b, 6])
        turn = quaternion_exp(scale(THIRD, log_quaternion(quaternion_product(back, two))))
        end = quaternion_corrected(quaternion_product(two, turn))
        s1.q[b, 3], s1.q[b, 4], s1.q[b, 5], s1.q[b, 6] = end
        store33(work.kin_end.R, b, matrix_of_quaternion(end))
        for i in range(6):
            work.v_out[b, i] = s1.v[b, i] + THIRD * (s1.v[b, i] - full.v[b, i])
    for i in range(s1.z.shape[0]):
        s1.z[i] += THIRD * (s1.z[i] - full.z[i])


@kernel(inner=True)
def _factorize_masses(tables, masses, work):
    """Factorize the masses with the constraints at work.J_end; returns -1 or a bad node. Masses as they are, zero where
    a body has none: another metric would leave part of what is projected off.
    """
    effective_masses(tables, work.J_end, masses.W)
    for i in range(work.rate.shape[0]):
        masses.W[i] *= PENALTY
    for e in range(1, work.J_end.shape[0]):
        for r in range(6):
            for i in range(6):
                masses.J_force[e, r, i] = work.J_end[e, r, i]
                masses.J_row[e, r, i] = work.J_end[e, r, i]
    assemble_tangent(tables, 1.0, 0.0, 0.0, work.Kq, work.Kv, work.T_end, masses.B)
    begin_augmentation(work.augmentation)
    return factorize_saddle(tables, CONDENSED, masses)


@kernel(inner=True)
def _close_velocity(tables, masses, work):
    """Project work.v_out with the factorized masses; returns the largest violation left."""
    worst, before = 0.0, np.inf
    copy_rows(work.formulation.zero, work.r)
    for k in range(PASSES):
        worst, fastest = violated_rates(tables, work), 0.0
        for b in range(tables.bodies.mass.shape[0]):
            fastest = max(fastest, largest(work.v_out, b))
        if worst <= EXACT * fastest or not worst < 0.5 * before or k == PASSES - 1:
            break
        before = worst
        solve_saddle(tables, CONDENSED, masses, work.r, work.rate, work.dw, work.dlam)
        combine(tables, CONDENSED, masses, work.augmentation, YES, EXACT, 0.0, work.rate, work.dw, work.dlam)
        for b in range(tables.bodies.mass.shape[0]):
            for i in range(6):
                work.v_out[b, i] += work.dw[b, i]
    return worst


@kernel(inner=True)
def _bias(tables, s, u, work):
    """work.g = (dA/dt) v + phi_tt, by the fourth-order central difference of A v along the motion with frozen v;
    kin_stage is scratch."""
    kin, v = work.kin_stage, work.v_out
    fastest = 0.0
    for b in range(tables.bodies.mass.shape[0]):
        fastest = max(fastest, largest_by_length(v, b, work.length))
    d = SPACING * work.length / max(fastest, work.slow[0])
    for i in range(work.g.shape[0]):
        work.g[i] = work.phi_tt[i]
    for k in range(4):
        step = (-2.0, -1.0, 1.0, 2.0)[k] * d
        weight = (1.0 / 12.0, -2.0 / 3.0, 2.0 / 3.0, -1.0 / 12.0)[k] / d
        for b in range(tables.bodies.mass.shape[0]):
            turn = quaternion_exp((step * v[b, 3], step * v[b, 4], step * v[b, 5]))
            placed = quaternion_corrected(quaternion_product((s.q[b, 3], s.q[b, 4], s.q[b, 5], s.q[b, 6]), turn))
            store33(kin.R, b, matrix_of_quaternion(placed))
            for i in range(3):
                kin.p[b, i] = s.q[b, i] + step * v[b, i]
            for i in range(6):
                kin.v[b, i] = v[b, i]
        evaluate_constraints(tables, kin, s.angle, u, YES, work.phi_stage, work.J_stage)
        constraint_rates(tables.constraints, work.J_stage, v, work.rate)
        for i in range(work.g.shape[0]):
            work.g[i] += weight * work.rate[i]


@kernel(inner=True)
def _accelerate(tables, masses, work):
    """work.a_out and work.lam_out with M a = f + A^T lam and A a = -work.g, by augmentation with the factorized masses.

    work.f holds the forces. From zero on, so that nothing is added to multipliers of redundant constraints that balance
    each other.
    """
    bodies, a, lam = tables.bodies, work.a_out, work.lam_out
    copy_rows(work.formulation.zero, a)
    for i in range(lam.shape[0]):
        lam[i] = 0.0
    for k in range(PASSES):
        for b in range(bodies.mass.shape[0]):
            turning = mv(load33(bodies.inertia, b), (a[b, 3], a[b, 4], a[b, 5]))
            for i in range(3):
                work.r[b, i] = bodies.mass[b] * a[b, i] - work.f[b, i]
                work.r[b, 3 + i] = turning[i] - work.f[b, 3 + i]
        add_constraint_forces(tables.constraints, work.J_end, lam, -1.0, work.r)
        constraint_rates(tables.constraints, work.J_end, a, work.rate)
        for i in range(work.rate.shape[0]):
            work.rate[i] += work.g[i]
        solve_saddle(tables, CONDENSED, masses, work.r, work.rate, work.dw, work.dlam)
        combine(tables, CONDENSED, masses, work.augmentation, k == 0, EXACT, 0.0, work.rate, work.dw, work.dlam)
        change, size = 0.0, 0.0
        for b in range(bodies.mass.shape[0]):
            for i in range(6):
                a[b, i] += work.dw[b, i]
                change = max(change, abs(work.dw[b, i]))
                size = max(size, abs(a[b, i]))
        for i in range(lam.shape[0]):
            lam[i] += work.dlam[i]
        if change <= EXACT * size:
            break


@kernel(inline=True)
def _largest_of(x):
    """Largest magnitude in a vector."""
    most = 0.0
    for i in range(x.shape[0]):
        most = max(most, abs(x[i]))
    return most


@kernel(inner=True)
def extrapolate(tables, masses, full, s1, u, want_outputs, last, work):
    """Make of s1, the state after two steps, and of `full`, that after one, the state of fourth order in s1 and
    work.v_out. s1.v is left as it is. masses: a Saddle of the condensed form, whose rows need no mass at every body.

    want_outputs: evaluate the forces there, for the account of energy. last: accelerations and multipliers too, because
    they are shown; without, only where the account asks what power prescribed motions take.

    For callers by address; status and counters are in work.result, as those of a step.
    """
    _combine_solutions(tables, full, s1, work)
    update_angles(tables.coordinates, work.kin_end, s1.angle)
    evaluate_constraints(tables, work.kin_end, s1.angle, u, YES, work.phi_end, work.J_end)
    constraint_input_rates(tables, u, work.phi_t, work.phi_tt)
    bad = _factorize_masses(tables, masses, work)
    position, _ = position_drift(tables, work)
    velocity = _close_velocity(tables, masses, work)
    if want_outputs:
        outputs_at_end(tables, s1, u, work)
        if last or _largest_of(work.phi_t) > 0.0:
            _bias(tables, s1, u, work)
            _accelerate(tables, masses, work)
            violated_rates(tables, work)  # of which the account notes the place
    r = work.result
    r[0], r[1] = OK, 0
    if bad >= 0:
        r[0], r[1] = SINGULAR, bad
    elif body_not_finite(work) >= 0 or not np.isfinite(velocity + position):
        r[0], r[1] = NON_FINITE, max(body_not_finite(work), 0)
    r[2], r[3], r[4], r[5], r[6] = 0, 1, 1 if want_outputs else 0, 0, 0.0
    r[7], r[8] = position, velocity
