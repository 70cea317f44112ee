"""The running account of a run: energy that is stored, dissipated, supplied and missing, how much of it was exchanged at all, and the
largest residuals with the instant and the place of each.

What is exchanged is the integral of the magnitude of every element's dissipated and every input's supplied power, and the ranges of
kinetic and of potential energy. Kept in one flat array, so that it is saved, restored and taken back as one.
"""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.portable import norm
from solver.compiled.vec import dot, load3, load33, mv
from solver.model.tables import COUNT, OUTPUT, PEAK, ROTATION, WIDTH

REFERENCE, POWER, WORK, WORST, ENERGY = range(5)  # entries of the running account; all energies [J]
WORST_AT = 5  # when the error was largest [s]
TIME = 6  # since the account began [s]
GROSS, GROSS_POWER = 7, 8  # integral of all magnitudes of power, and that sum now [W]
KINETIC_LOW, KINETIC_HIGH, POTENTIAL_LOW, POTENTIAL_HIGH = range(9, 13)
TURNING = 13  # largest sum over bodies of kinetic energy * (turn in a step)^2
SPEED = 14  # largest |component| of a twist [m/s or rad/s]
NOTED = 15  # from here on rows of (value, time, index) of what was largest
RESIDUAL, POSITION, VELOCITY, TURN = (NOTED + 3 * k for k in range(4))  # index of a body, rows of constraints, a body
STEPS, UNSETTLED = NOTED + 12, NOTED + 13  # steps noted, and those of them with a residual above SETTLED
SWING = NOTED + 14  # half the widest range of a component of a velocity of a centre of mass [m/s], and of an angular velocity [rad/s]
KICK = NOTED + 16  # two rows, of the same: (largest change of an acceleration in a step, times the step; time; body)
PHASE = KICK + 6  # of the same: phase that steps have cost the motion, less what it has forgotten [rad]
WOUND = PHASE + 2  # such a row: what an element is turned by that acts on a rotation vector [rad]; the index is the place of its outputs
SWAYED = WOUND + 3  # kinetic energy of all those ranges, each as the amplitude of a vibration [J]
CONTRADICTION = WOUND + 4  # such a row: energy of rows that contradict each other [J] (solver.output.contradiction), the index is a row
LENGTH = WOUND + 7  # of what is there without bodies; behind it the twists of n bodies, (n, 2, 6): smallest and largest of every component,
# and of elements that have a peak (largest value; time [s])


def account_length(bodies: int, peaks: int) -> int:
    """Numbers in the account of a model with so many bodies, and elements that have a peak."""
    return LENGTH + 12 * bodies + 2 * peaks


WRITTEN = 1e-6  # relative, and m: what numbers written with finitely many digits leave open
ROUNDING = 1e-12  # of stored energy: what its own numbers leave open, beside prestressed parts at rest where nothing has weight
SLOWEST = 1e-6  # m/s or rad/s
SPINS = 0.005  # rad: half the turn in a step, below which a body has no spin to speak of
SETTLED = 1e-3  # relative velocity increment: a digit better than what is accepted where an iteration does not converge


@kernel(borrow=True)
def exchanged_so_far(account):
    """Energy [J] that was exchanged: supplied and dissipated, and the ranges of kinetic and potential energy."""
    kinetic, potential = account[KINETIC_HIGH] - account[KINETIC_LOW], account[POTENTIAL_HIGH] - account[POTENTIAL_LOW]
    return account[GROSS] + kinetic + potential


def left_open(account, bodies):
    """Energy [J] that numbers leave open of bodies (solver.model.tables)."""
    weight = float(np.add.reduce(bodies.mass)) * norm(bodies.gravity)
    stored = max(abs(float(account[POTENTIAL_LOW])), abs(float(account[POTENTIAL_HIGH])))
    return WRITTEN * (weight + float(account[KINETIC_HIGH])) + ROUNDING * stored


def contradicts(account, bodies):
    """Whether rows contradict each other, and how much energy [J] of that is allowed."""
    limit = WRITTEN * float(exchanged_so_far(account)) + left_open(account, bodies)
    return bool(account[CONTRADICTION] > limit), limit


@kernel(inner=True)
def mechanical_energy(tables, kin, outputs, h, account):
    """Return (energy [J]: kinetic + gravity (zero at z = 0) + stored in elements, kinetic energy in it, dissipated power [W], sum of the
    magnitudes of the elements' dissipated or supplied power [W]). Notes the fastest and the most turned body of a step h [s], the most
    wound element, and peaks.
    """
    bodies = tables.bodies
    energy = 0.0
    kinetic = 0.0
    turning = 0.0
    fastest = 0.0
    most = 0.0
    most_turned = 0
    for b in range(bodies.mass.shape[0]):
        v, p, m, g = load3(kin.v, b), load3(kin.p, b), bodies.mass[b], bodies.gravity
        w = (kin.v[b, 3], kin.v[b, 4], kin.v[b, 5])
        fastest = max(fastest, abs(v[0]), abs(v[1]), abs(v[2]), abs(w[0]), abs(w[1]), abs(w[2]))
        own = m * dot(v, v) + dot(w, mv(load33(bodies.inertia, b), w))
        energy += 0.5 * own - m * (g[0] * p[0] + g[1] * p[1] + g[2] * p[2])
        kinetic += 0.5 * own
        turn = h * h * dot(w, w)
        turning += 0.5 * own * turn
        if turn > most:
            most = turn
            most_turned = b
    account[TURNING] = max(account[TURNING], turning)
    account[SPEED] = max(account[SPEED], fastest)
    if most > account[TURN] * account[TURN]:
        account[TURN] = most**0.5
        account[TURN + 1] = account[TIME]
        account[TURN + 2] = most_turned
    dissipation = 0.0
    magnitude = 0.0
    wound = account[WOUND] * account[WOUND]
    noted = LENGTH + 12 * bodies.mass.shape[0]
    for k in range(tables.forces.shape[0]):
        at = tables.forces[k, OUTPUT]
        rotation = tables.forces[k, ROTATION]
        peak = tables.forces[k, PEAK]
        for _ in range(tables.forces[k, COUNT]):
            energy += outputs[at]
            dissipation += outputs[at + 1]
            magnitude += abs(outputs[at + 1])
            if rotation >= 0:
                i = at + rotation
                angle = outputs[i] ** 2 + outputs[i + 1] ** 2 + outputs[i + 2] ** 2
                if angle > wound:
                    wound = angle
                    account[WOUND] = angle**0.5
                    account[WOUND + 1] = account[TIME]
                    account[WOUND + 2] = at
            if peak >= 0:
                if outputs[at + peak] > account[noted]:
                    account[noted] = outputs[at + peak]
                    account[noted + 1] = account[TIME]
                noted += 2
            at += tables.forces[k, WIDTH]
    return energy, kinetic, dissipation, magnitude


@kernel(inline=True)
def _note_ranges(bodies, v, account):
    """Widen the ranges of the twists (nb + 1, 6); of a motion that swings wider than ever the phase is so much less."""
    at = LENGTH
    for b in range(v.shape[0] - 1):
        for i in range(6):
            low, high, now = account[at + i], account[at + 6 + i], v[b, i]
            if now < low or now > high:
                narrower, k = 0.5 * (high - low), i // 3
                low, high = min(low, now), max(high, now)
                account[at + i], account[at + 6 + i] = low, high
                swing, widest = 0.5 * (high - low), account[SWING + k]
                weight = bodies.mass[b] if k == 0 else bodies.inertia[b, i - 3, i - 3]
                account[SWAYED] += 0.5 * weight * (swing * swing - narrower * narrower)
                if swing > widest:
                    account[SWING + k] = swing
                    account[PHASE + k] *= widest / swing
        at += 12


@kernel(borrow=True)
def update_energy(tables, kin, outputs, lam, phi_t, h, account):
    """Advance the energy balance by a step h [s] (h = 0 starts it): error = E - E_0 + integral of (dissipation - driver power).

    The integrals follow the trapezoidal rule, second order like the method if the outputs are those of the inputs at the end of the step.
    lam and phi_t give the power of prescribed motions.
    """
    if h == 0.0:
        account[:] = 0.0
        for b in range(kin.v.shape[0] - 1):
            for i in range(6):
                account[LENGTH + 12 * b + i] = account[LENGTH + 12 * b + 6 + i] = kin.v[b, i]
    account[TIME] += h
    _note_ranges(tables.bodies, kin.v, account)
    energy, kinetic, loss, magnitude = mechanical_energy(tables, kin, outputs, h, account)
    dissipated = 0.5 * h * (magnitude + loss)  # without what is supplied, whose share of both cancels
    if dissipated > 0.0:
        forgotten = 0.5 * dissipated / max(account[SWAYED], SLOWEST)  # amplitudes go with the root of the energy
        account[PHASE] /= 1.0 + forgotten
        account[PHASE + 1] /= 1.0 + forgotten
    for i in range(lam.shape[0]):
        loss += lam[i] * phi_t[i]
        magnitude += abs(lam[i] * phi_t[i])
    potential = energy - kinetic
    if h == 0.0:
        account[REFERENCE] = energy
        account[KINETIC_LOW] = kinetic
        account[KINETIC_HIGH] = kinetic
        account[POTENTIAL_LOW] = potential
        account[POTENTIAL_HIGH] = potential
    else:
        account[WORK] += 0.5 * h * (loss + account[POWER])
        account[GROSS] += 0.5 * h * (magnitude + account[GROSS_POWER])
        account[KINETIC_LOW] = min(account[KINETIC_LOW], kinetic)
        account[KINETIC_HIGH] = max(account[KINETIC_HIGH], kinetic)
        account[POTENTIAL_LOW] = min(account[POTENTIAL_LOW], potential)
        account[POTENTIAL_HIGH] = max(account[POTENTIAL_HIGH], potential)
        error = abs(energy - account[REFERENCE] + account[WORK])
        if error > account[WORST]:
            account[WORST] = error
            account[WORST_AT] = account[TIME]
    account[POWER] = loss
    account[GROSS_POWER] = magnitude
    account[ENERGY] = energy


@kernel(inner=True)
def power_now(tables, outputs, lam, phi_t):
    """Dissipated minus supplied power [W], as update_energy() has it."""
    loss = 0.0
    for k in range(tables.forces.shape[0]):
        at = tables.forces[k, OUTPUT]
        for _ in range(tables.forces[k, COUNT]):
            loss += outputs[at + 1]
            at += tables.forces[k, WIDTH]
    for i in range(lam.shape[0]):
        loss += lam[i] * phi_t[i]
    return loss


@kernel(inner=True)
def refine_work(account, h, before, middle, worst, at):
    """Integrate the power over the last step, h [s], by Simpson's rule instead: it was `before` and, in the middle, `middle` [W].

    worst, at: largest error [J] and its time [s] before that step.
    """
    account[WORK] += h / 6.0 * (4.0 * middle - 2.0 * (before + account[POWER]))
    error = abs(account[ENERGY] - account[REFERENCE] + account[WORK])
    account[WORST], account[WORST_AT] = worst, at
    if error > worst:
        account[WORST], account[WORST_AT] = error, account[TIME]


@kernel(inline=True)
def _note_change(account, k, change, body, slowest):
    """Note a change of velocity per step [m/s or rad/s] between two steps; k: 0 of translation, 1 of rotation."""
    if change > account[KICK + 3 * k]:
        account[KICK + 3 * k] = change
        account[KICK + 3 * k + 1] = account[TIME]
        account[KICK + 3 * k + 2] = body
    part = change / max(account[SWING + k], slowest)  # (w h)^2 of the vibration that carries the motion, or less
    account[PHASE + k] += part * part**0.5 / 12.0


@kernel(inline=True)
def _note_gyration(J, a, w, step, h, account):
    """Note what a step misses of the torque of a body whose angular acceleration a turns in its own axes, as it does with a spin.

    Euler's equations by the midpoint rule have J a (change / a)^2 / 12 too much of it, change being that of a in the step, across a: of a
    disc hardly anything beside its angular momentum, of a thin rod many times as much as it has. That turns the angular momentum of
    the body, and no more than in proportion the motion of all, whose kinetic energy has to follow.
    """
    square, torque = dot(a, a), mv(J, a)
    b = dot(torque, torque) ** 0.5
    if b > 0.0 and square > 0.0:  # of a point mass there is none
        along, momentum = dot(a, step), mv(J, w)
        change = max(dot(step, step) - along * along / square, 0.0)
        own = b * change / square / max(dot(momentum, momentum) ** 0.5, SLOWEST * b)
        of_all = h * b * change**0.5 / max(2.0 * account[SWAYED], SLOWEST)
        account[PHASE + 1] += h * min(own, of_all) / 12.0


@kernel(borrow=True)
def note_residuals(constraints, inertia, v, h, residual, position, velocity, phi, rate, a, a_before, slowest, account):
    """Note what is largest so far: the residual of the iteration, |phi|, |A v + phi_t|, changes of accelerations, with time and place.

    h [s] is the step; twists v (nb + 1, 6), phi and rate (nc,) are those after it. The place of a residual is the body whose acceleration
    (nb + 1, 6) changed most in the step. slowest [m/s or rad/s]: below it motions do not count.

    An angular acceleration changes by what it does in the axes of the body or of the world, whichever is less: in the former the yaw of a
    wheel turns with its spin, which is no vibration; in the latter a free disc nutates faster than the equations that a step solves.

    What turns with a spin costs all the same: _note_gyration().
    """
    account[STEPS] += 1.0
    moved, turned, body_moved, body_turned = 0.0, 0.0, 0, 0
    for b in range(a.shape[0] - 1):
        now, before, twist = a[b], a_before[b], v[b]
        x, y, z = now[0] - before[0], now[1] - before[1], now[2] - before[2]
        change = x * x + y * y + z * z
        if change > moved:
            moved, body_moved = change, b
        dx, dy, dz = now[3] - before[3], now[4] - before[4], now[5] - before[5]
        of_body = dx * dx + dy * dy + dz * dz
        wx, wy, wz = 0.5 * h * twist[3], 0.5 * h * twist[4], 0.5 * h * twist[5]
        x, y, z = now[3] + before[3], now[4] + before[4], now[5] + before[5]
        dx, dy, dz = dx + wy * z - wz * y, dy + wz * x - wx * z, dz + wx * y - wy * x
        if wx * wx + wy * wy + wz * wz > SPINS * SPINS:
            a_now, w = (now[3], now[4], now[5]), (twist[3], twist[4], twist[5])
            _note_gyration(load33(inertia, b), a_now, w, (now[3] - before[3], now[4] - before[4], now[5] - before[5]), h, account)
        change = min(of_body, dx * dx + dy * dy + dz * dz)
        if change > turned:
            turned, body_turned = change, b
    _note_change(account, 0, h * moved**0.5, body_moved, slowest)
    _note_change(account, 1, h * turned**0.5, body_turned, slowest)
    if residual > SETTLED:
        account[UNSETTLED] += 1.0
    if residual > account[RESIDUAL]:
        account[RESIDUAL] = residual
        account[RESIDUAL + 1] = account[TIME]
        most = -1.0
        for b in range(a.shape[0] - 1):
            for i in range(6):
                change = abs(a[b, i] - a_before[b, i])
                if change > most:
                    most = change
                    account[RESIDUAL + 2] = b
    if position > account[POSITION]:
        account[POSITION] = position
        account[POSITION + 1] = account[TIME]
        most = -1.0
        for i in range(phi.shape[0]):
            if constraints.holonomic[i] == 1 and abs(phi[i]) > most:
                most = abs(phi[i])
                account[POSITION + 2] = i
    if velocity > account[VELOCITY]:
        account[VELOCITY] = velocity
        account[VELOCITY + 1] = account[TIME]
        most = -1.0
        for i in range(rate.shape[0]):
            if abs(rate[i]) > most:
                most = abs(rate[i])
                account[VELOCITY + 2] = i
