"""Updates the running account of a run (solver.output.account) after every step.

The account has the energy balance: energy stored, dissipated, supplied, and its error; the energy that was exchanged,
as a measure for that error; and the largest residuals, with time and place. The exchanged energy is the integral of the
magnitudes of all powers, dissipated by elements or supplied by inputs, plus the ranges of kinetic and potential energy.
"""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.portable import norm
from solver.compiled.vec import dot, load3, load33, mv
from solver.model.tables import COUNT, OUTPUT, PEAK, ROTATION, WIDTH
from solver.output.account import Account, noted

# Relative error of numbers in files, which have finitely many digits; also the error of a length [m]. Ten times as much
# would hide contradictions of joints that matter.
WRITTEN = 1e-6
# Rounding error of the stored energy, relative to it: what remains of the balance of prestressed parts at rest without
# weight.
ROUNDING = 1e-12
SLOWEST = 1e-6  # velocity [m/s or rad/s] below which a motion counts as none, in quotients
SPINS = 0.005  # half the turn in a step [rad] from which on a body counts as spinning
# Last increment of an iteration, relative to the velocity, up to which it counts as settled: one digit better than the
# increment that is accepted where an iteration does not converge.
SETTLED_INCREMENT = 1e-3


@kernel(inner=True)
def exchanged_so_far(account):
    """Energy [J] that was exchanged so far, see the module."""
    kinetic, potential = account.kinetic[1] - account.kinetic[0], account.potential[1] - account.potential[0]
    return account.gross[0] + kinetic + potential


def exchanged(account: Account) -> float:
    """exchanged_so_far() for callers from Python."""
    return float(exchanged_so_far.py_func(account))


def left_open(account: Account, bodies) -> float:
    """Error of the energy [J] of bodies (solver.model.tables) by the finitely many digits of the numbers in files."""
    weight = float(np.add.reduce(bodies.mass)) * norm(bodies.gravity)
    stored = max(abs(float(account.potential[0])), abs(float(account.potential[1])))
    return WRITTEN * (weight + float(account.kinetic[1])) + ROUNDING * stored


def contradicts(account: Account, bodies) -> tuple[bool, float]:
    """(whether rows of constraints contradict each other, energy of contradicting rows [J] that is still no
    contradiction)."""
    limit = WRITTEN * exchanged(account) + left_open(account, bodies)
    return noted(account.contradiction)[0] > limit, limit


@kernel(inline=True)
def note(row, value, time, index):
    """Write (value, time, index) into a row of the account."""
    row[0], row[1], row[2] = value, time, index


@kernel(inline=True)
def widen(ends, now):
    """Widen a range (smallest, largest) so that it contains the present value."""
    ends[0] = min(ends[0], now)
    ends[1] = max(ends[1], now)


@kernel(inner=True)
def mechanical_energy(tables, kin, outputs, h, account):
    """(energy [J], its kinetic part [J], dissipated power [W], sum of the magnitudes of the powers of all elements
    [W]).

    The energy is kinetic + gravity (zero at z = 0) + stored in elements. Also notes the largest velocity, the body with
    the largest turn in the step h [s], the element with the largest rotation vector, and the peaks of elements.
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
    account.turning[0] = max(account.turning[0], turning)
    account.speed[0] = max(account.speed[0], fastest)
    if most > account.turn[0] * account.turn[0]:
        note(account.turn, most**0.5, account.time[0], most_turned)
    dissipation = 0.0
    magnitude = 0.0
    wound = account.wound[0] * account.wound[0]
    peaks, n = account.peak, 0
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
                    note(account.wound, angle**0.5, account.time[0], at)
            if peak >= 0:
                if outputs[at + peak] > peaks[n, 0]:
                    peaks[n, 0], peaks[n, 1] = outputs[at + peak], account.time[0]
                n += 1
            at += tables.forces[k, WIDTH]
    return energy, kinetic, dissipation, magnitude


@kernel(inline=True)
def _note_ranges(bodies, v, account):
    """Widen the ranges of the twists v (nb + 1, 6). Where a range becomes the widest, the phase error is scaled down
    with it."""
    twist = account.twist
    for b in range(v.shape[0] - 1):
        for i in range(6):
            low, high, now = twist[b, 0, i], twist[b, 1, i], v[b, i]
            if now < low or now > high:
                narrower, k = 0.5 * (high - low), i // 3
                low, high = min(low, now), max(high, now)
                twist[b, 0, i], twist[b, 1, i] = low, high
                swing, widest = 0.5 * (high - low), account.swing[k]
                weight = bodies.mass[b] if k == 0 else bodies.inertia[b, i - 3, i - 3]
                account.swayed[0] += 0.5 * weight * (swing * swing - narrower * narrower)
                if swing > widest:
                    account.swing[k] = swing
                    account.phase[k] *= widest / swing


@kernel(borrow=True)
def update_energy(tables, kin, outputs, lam, phi_t, h, account):
    """Advance the energy balance by a step h [s]; h = 0 starts it.

    The error is E - E_0 + integral of (dissipated - supplied power), by the trapezoidal rule. It is of second order, as
    the method, if the outputs are those of the inputs at the end of the step. lam and phi_t (nc,) give the power of
    imposed motions.
    """
    if h == 0.0:
        account.numbers[:] = 0.0
        for b in range(kin.v.shape[0] - 1):
            for i in range(6):
                account.twist[b, 0, i] = account.twist[b, 1, i] = kin.v[b, i]
    account.time[0] += h
    _note_ranges(tables.bodies, kin.v, account)
    energy, kinetic, loss, magnitude = mechanical_energy(tables, kin, outputs, h, account)
    dissipated = 0.5 * h * (magnitude + loss)  # without what is supplied, whose share of both cancels
    if dissipated > 0.0:
        forgotten = 0.5 * dissipated / max(account.swayed[0], SLOWEST)  # amplitudes go with the root of the energy
        account.phase[0] /= 1.0 + forgotten
        account.phase[1] /= 1.0 + forgotten
    for i in range(lam.shape[0]):
        loss += lam[i] * phi_t[i]
        magnitude += abs(lam[i] * phi_t[i])
    potential = energy - kinetic
    if h == 0.0:
        account.reference[0] = energy
        account.kinetic[0] = account.kinetic[1] = kinetic
        account.potential[0] = account.potential[1] = potential
    else:
        account.work[0] += 0.5 * h * (loss + account.power[0])
        account.gross[0] += 0.5 * h * (magnitude + account.gross_power[0])
        widen(account.kinetic, kinetic)
        widen(account.potential, potential)
        error = abs(energy - account.reference[0] + account.work[0])
        if error > account.worst[0]:
            account.worst[0], account.worst_at[0] = error, account.time[0]
    account.power[0] = loss
    account.gross_power[0] = magnitude
    account.energy[0] = energy


@kernel(inner=True)
def power_now(tables, outputs, lam, phi_t):
    """Dissipated minus supplied power [W] of these outputs, as in update_energy()."""
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
    """Replace the trapezoidal rule by Simpson's rule in the work of the last step, h [s].

    before, middle: power at the beginning and in the middle of the step [W]. worst, at: largest error [J] and its time
    [s] before that step.
    """
    account.work[0] += h / 6.0 * (4.0 * middle - 2.0 * (before + account.power[0]))
    error = abs(account.energy[0] - account.reference[0] + account.work[0])
    account.worst[0], account.worst_at[0] = worst, at
    if error > worst:
        account.worst[0], account.worst_at[0] = error, account.time[0]


@kernel(inline=True)
def _note_change(account, k, change, body, slowest):
    """Note the change of an acceleration in a step, times the step [m/s or rad/s]; k: 0 for translation, 1 for
    rotation."""
    if change > account.kick[k, 0]:
        note(account.kick[k], change, account.time[0], body)
    part = change / max(account.swing[k], slowest)  # (w h)^2 of the vibration that carries the motion, or less
    account.phase[k] += part * part**0.5 / 12.0


@kernel(inline=True)
def _note_gyration(J, a, w, step, h, account):
    """Note the phase error by the gyroscopic torque of a spinning body, whose angular acceleration a turns in its own
    axes.

    The midpoint rule makes the torque in Euler's equations too large by J a (c / a)^2 / 12, with c the part of `step`,
    the change of a in the step, across a. Relative to the angular momentum that is little for a disc, and may be much
    for a thin rod. The error turns the angular momentum of the body; it turns the motion of the whole model by at most
    its share of the kinetic energy.
    """
    square, torque = dot(a, a), mv(J, a)
    b = dot(torque, torque) ** 0.5
    if b > 0.0 and square > 0.0:  # of a point mass there is none
        along, momentum = dot(a, step), mv(J, w)
        change = max(dot(step, step) - along * along / square, 0.0)
        own = b * change / square / max(dot(momentum, momentum) ** 0.5, SLOWEST * b)
        of_all = h * b * change**0.5 / max(2.0 * account.swayed[0], SLOWEST)
        account.phase[1] += h * min(own, of_all) / 12.0


@kernel(borrow=True)
def note_residuals(constraints, inertia, v, h, residual, position, velocity, phi, rate, a, a_before, slowest, account):
    """Note the largest residual of the iteration, |phi|, |A v + phi_t| and changes of accelerations, with time and
    place.

    h: the step [s]. v (nb + 1, 6), phi and rate (nc,): twists and residuals after the step. a, a_before (nb + 1, 6):
    accelerations after and before it. The place of a residual is the body whose acceleration changed most. slowest:
    velocity [m/s or rad/s] below which a motion does not count.

    The change of an angular acceleration is the smaller one of its changes in the axes of the body and of the world. In
    the axes of the body, the yaw of a wheel turns with its spin, which is no vibration. In the axes of the world, a
    free disc nutates faster than the equations that a step solves. The error that such a spin makes is noted by
    _note_gyration().
    """
    account.steps[0] += 1.0
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
    if residual > SETTLED_INCREMENT:
        account.unsettled[0] += 1.0
    if residual > account.residual[0]:
        most, at = -1.0, 0
        for b in range(a.shape[0] - 1):
            for i in range(6):
                change = abs(a[b, i] - a_before[b, i])
                if change > most:
                    most, at = change, b
        note(account.residual, residual, account.time[0], at)
    if position > account.position[0]:
        most, at = -1.0, 0
        for i in range(phi.shape[0]):
            if constraints.holonomic[i] == 1 and abs(phi[i]) > most:
                most, at = abs(phi[i]), i
        note(account.position, position, account.time[0], at)
    if velocity > account.velocity[0]:
        most, at = -1.0, 0
        for i in range(rate.shape[0]):
            if abs(rate[i]) > most:
                most, at = abs(rate[i]), i
        note(account.velocity, velocity, account.time[0], at)
