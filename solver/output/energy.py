"""Updates the running account of a run (solver.output.account) after every step.

The account has the energy balance: energy stored, dissipated, supplied, and its error; the energy that was exchanged,
as a measure for that error; and the largest residuals, with time and place. The exchanged energy is the integral of the
magnitudes of all powers, dissipated by elements or supplied by inputs, plus the ranges of kinetic and potential energy.

The file is long because all of the account is kept in one pass over the bodies, a kernel that others do not share.
"""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.portable import norm
from solver.compiled.vec import cross, dot, load3, load33, mv, scale, sub
from solver.model.tables import COUNT, OUTPUT, PEAK, ROTATION, WIDTH
from solver.output.account import Account, noted

# Relative error of numbers in files, which have finitely many digits; also to the length of the model. Ten times as
# much would hide contradictions of joints that matter.
WRITTEN = 1e-6
# Rounding error of the stored energy, relative to it: what remains of the balance of prestressed parts at rest without
# weight.
ROUNDING = 1e-12
# lengths of the model in a step: slower motions are rounding; ten times as much would hide creep of 1e-5 m/s
NOISE = 1e-9
SPINS = 0.005  # half the turn in a step [rad] from which on a body counts as spinning
# Part of what is known of the period of a vibration that is kept from step to step: ten steps; ten times as many would
# mix motions.
REMEMBERED = 0.9
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


def left_open(account: Account, bodies, length: float) -> float:
    """Error of the energy [J] of bodies (solver.model.tables) by the finitely many digits of the numbers in files,
    in a model of that length [m]."""
    weight = length * float(np.add.reduce(bodies.mass)) * norm(bodies.gravity)
    stored = max(abs(float(account.potential[0])), abs(float(account.potential[1])))
    return WRITTEN * (weight + float(account.kinetic[1])) + ROUNDING * stored


def contradicts(account: Account, bodies, length: float) -> tuple[bool, float]:
    """(whether rows of constraints contradict each other, energy of contradicting rows [J] that is still no
    contradiction), in a model of that length [m]."""
    limit = WRITTEN * exchanged(account) + left_open(account, bodies, length)
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

    The energy is kinetic + gravity (zero at z = 0) + stored in elements. Also notes the largest speeds, the kinetic
    energy of bodies that turn in the step h [s], the element with the largest rotation vector, and the peaks of
    elements.
    """
    bodies = tables.bodies
    energy = 0.0
    kinetic = 0.0
    turning = 0.0
    moving, spinning = 0.0, 0.0
    for b in range(bodies.mass.shape[0]):
        v, p, m, g = load3(kin.v, b), load3(kin.p, b), bodies.mass[b], bodies.gravity
        w = (kin.v[b, 3], kin.v[b, 4], kin.v[b, 5])
        moving = max(moving, abs(v[0]), abs(v[1]), abs(v[2]))
        spinning = max(spinning, abs(w[0]), abs(w[1]), abs(w[2]))
        own = m * dot(v, v) + dot(w, mv(load33(bodies.inertia, b), w))
        energy += 0.5 * own - m * (g[0] * p[0] + g[1] * p[1] + g[2] * p[2])
        kinetic += 0.5 * own
        turning += 0.5 * own * (h * h * dot(w, w))
    account.turning[0] = max(account.turning[0], turning)
    account.speed[0] = max(account.speed[0], moving)
    account.speed[1] = max(account.speed[1], spinning)
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
    supplied = power_from_outside(tables, outputs, lam, phi_t) if account.flow.shape[0] > 0 else 0.0
    dissipated = 0.5 * h * (magnitude + loss)  # without what is supplied, whose share of both cancels
    if dissipated > 0.0 and account.swayed[0] > 0.0:
        forgotten = 0.5 * dissipated / account.swayed[0]  # amplitudes go with the root of the energy
        account.phase[0] /= 1.0 + forgotten
        account.phase[1] /= 1.0 + forgotten
        account.astray[0] /= 1.0 + forgotten
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
    if account.flow.shape[0] > 0:
        account.flow[1] += 0.5 * h * (supplied + account.flow[0])
        account.flow[0], account.flow[2] = supplied, kinetic
    account.power[0] = loss
    account.gross_power[0] = magnitude
    account.energy[0] = energy


@kernel(inner=True)
def power_from_outside(tables, outputs, lam, phi_t):
    """Power [W] of elements that feed the mechanics (ForceKind.feeds), and of imposed motions."""
    power = 0.0
    for i in tables.fed:
        power -= outputs[i]
    for i in range(lam.shape[0]):
        power -= lam[i] * phi_t[i]
    return power


@kernel(inner=True)
def show_energies(account, frame):
    """Assign the energies of a frame (solver.output.snapshot.ENERGIES), where it shows any.

    Lost is what the account says is lost less supplied, and what was supplied.
    """
    if frame.energies.shape[0] > 0:
        kinetic, exchanged, shown = account.flow[2], account.flow[1], frame.energies
        shown[0] = kinetic
        shown[1] = account.energy[0] - kinetic
        shown[2] = account.work[0] + exchanged
        shown[3] = exchanged
        shown[4] = account.energy[0] - account.reference[0] + account.work[0]


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
def refine_work(account, h, before, middle, supplied, worst, at):
    """Replace the trapezoidal rule by Simpson's rule in the work of the last step, h [s].

    before, middle: power at the beginning and in the middle of the step [W]; supplied: from outside, the same two.
    worst, at: largest error [J] and its time [s] before that step.
    """
    account.work[0] += h / 6.0 * (4.0 * middle - 2.0 * (before + account.power[0]))
    if account.flow.shape[0] > 0:
        account.flow[1] += h / 6.0 * (4.0 * supplied[1] - 2.0 * (supplied[0] + account.flow[0]))
    error = abs(account.energy[0] - account.reference[0] + account.work[0])
    account.worst[0], account.worst_at[0] = worst, at
    if error > worst:
        account.worst[0], account.worst_at[0] = error, account.time[0]


@kernel(inline=True)
def _carried(square):
    """tan(x) / x by a fraction, of the square of half the turn x of a body in a step: so much of the mean of a vector
    before and after, across the spin, is the change that carries it along with the body."""
    return (105.0 - 10.0 * square) / (105.0 - 45.0 * square + square * square)


@kernel(inline=True)
def _free_share(left, held):
    """Share of a change, a square, in directions that constraints leave free: of its local error they take `held` off
    and leave `left`."""
    return left / (left + held) if held > 0.0 else 1.0


@kernel(inline=True)
def phase_lost(y, parts):
    """Phase [rad] that an oscillation loses in a step, y [rad] being the change of its phase over one of its `parts`
    (module)."""
    if parts == 1:
        return y * y * y / 12.0
    y *= 2.0
    growth = y * (320.0 / 1152.0)
    return y * y * y * y * y / 320.0 * (1.0 + growth * growth) ** 0.5


@kernel(inline=True)
def _note_change(account, k, change, free, bend, body, spacing, parts, slowest):
    """Note the largest change of an acceleration between two stages, `spacing` [s] apart: of translation (k = 0) or
    rotation (1).

    change: its square, of one body; free: the same, of what constraints leave free, of a body whose change of that has
    the square bend.
    """
    kick = parts * spacing * change**0.5
    if kick > account.kick[k, 0]:
        note(account.kick[k], kick, account.time[0], body)
    account.bend[k, 0] = REMEMBERED * account.bend[k, 0] + bend
    account.bend[k, 1] = REMEMBERED * account.bend[k, 1] + free
    width = max(account.swing[k], slowest)
    if free > 0.0 and width > 0.0:
        part = spacing * free**0.5 / width  # y^2 times the share r of the vibration in the motion, y = w spacing
        square = max(part, account.bend[k, 0] / account.bend[k, 1])
        share = part / square
        account.phase[k] += phase_lost(square**0.5, parts) * share * share


@kernel(inline=True)
def _note_gyration(J, R, a, w, across, share, body, spacing, parts, account):
    """Note by how much a step turns the axis of a body too far whose angular acceleration a turns in its own axes, as
    it does with a spin.

    across: square of the change of a, across a; share: of it that constraints leave free. Of a top with the moments of
    inertia A, and C about its spin, that turns by x in a step and precesses, the step misses (1/2 + A / C) x^2 / 12 of
    the precession (solver.checks.resolution). An axis is never further off than its path is wide: one that has missed
    so much misses no more.
    """
    square, spin, sideways, momentum = dot(a, a), dot(w, w), cross(w, a), mv(J, w)
    h, size = parts * spacing, dot(momentum, momentum)
    bent = max(parts * parts * across, h * h * dot(sideways, sideways))
    if not (bent > 0.0 and square > 0.0 and size > 0.0):
        return
    known, axis = account.axis[body], scale(1.0 / spin**0.5, mv(R, w))
    if known[0] == 0.0 and known[1] == 0.0 and known[2] == 0.0:
        known[0], known[1], known[2] = axis
    away = sub(axis, (known[0], known[1], known[2]))
    if dot(away, away) > known[3] * known[3]:
        known[3] = dot(away, away) ** 0.5
    if not account.astray[0] < known[3]:
        return
    torque, turn = mv(J, a), bent / square  # turn: x^2
    b = dot(torque, torque) ** 0.5
    own = (b / size**0.5 + 0.5 * dot(sideways, sideways) ** 0.5 / spin) * h  # turn of the axis in a step
    missed = own * share * turn / 12.0
    if account.swayed[0] > 0.0:
        missed = min(missed, h * h * b * (turn * square) ** 0.5 / (24.0 * account.swayed[0]))
    if parts == 2:
        missed *= 0.25 * turn / 12.0
    account.astray[0] += missed
    if missed > account.astray[1]:
        account.astray[1] = missed
        note(account.turn, h * spin**0.5, account.time[0], body)


@kernel(borrow=True)
def note_residuals(
    constraints, inertia, h, parts, coefficient, own, kin, residual, position, velocity, phi, rate, s1, before, slowest,
    account
):  # fmt: skip
    """Note what is largest so far: the residual of the iteration, |phi|, |A v + phi_t|, changes of accelerations, with
    time and place.

    h [s] is the step, of so many parts (2 with order four: a_stage are those of its halves); kin, phi and rate (nc,)
    are those after it, `own` (nb + 1, 6) the twists of the scheme, which violate the constraints. s1: the state after
    the step; before (nb + 1, 6): the stage before its last two. coefficient: of da/dt in the local error of a part. The
    place of a residual is the body whose acceleration changed most. slowest [m/s], [rad/s]: below it motions do not
    count.

    An angular acceleration changes by what it does in the axes of the body or of the world, whichever is less: in the
    former the yaw of a wheel turns with its spin, which is no vibration; in the latter a free disc nutates faster than
    the equations that a step solves.

    Phase is lost along free directions only: v - own is what constraints took off the local error of a step
    (solver.start.newton).
    """
    account.steps[0] += 1.0
    v, R = kin.v, kin.R
    a_now, a_before, offset = s1.a_stage, s1.a_stage_before, account.offset
    spacing = h / parts
    if account.steps[0] == 1.0:
        for b in range(offset.shape[0]):
            for i in range(6):
                offset[b, i] = own[b, i] - v[b, i]
    to_change = 12.0 / spacing
    e = 12.0 * coefficient
    moved, moved_free, bend_moved, body_moved = 0.0, 0.0, 0.0, 0
    turned, turned_free, bend_turned, body_turned = 0.0, 0.0, 0.0, 0
    for b in range(offset.shape[0]):
        now, past, older, twist, held = a_now[b], a_before[b], before[b], v[b], offset[b]
        x, y, z = now[0] - past[0], now[1] - past[1], now[2] - past[2]
        change = x * x + y * y + z * z
        if change > moved:
            moved, body_moved = change, b
        if change > moved_free:
            p, q, r = to_change * held[0], to_change * held[1], to_change * held[2]
            fx, fy, fz = e * x + p, e * y + q, e * z + r
            change *= _free_share(fx * fx + fy * fy + fz * fz, p * p + q * q + r * r)
            if change > moved_free:
                moved_free = change
                x, y, z = x - past[0] + older[0], y - past[1] + older[1], z - past[2] + older[2]
                bend_moved = x * x + y * y + z * z
        dx, dy, dz = now[3] - past[3], now[4] - past[4], now[5] - past[5]
        of_body = dx * dx + dy * dy + dz * dz
        wx, wy, wz = 0.5 * spacing * twist[3], 0.5 * spacing * twist[4], 0.5 * spacing * twist[5]
        x, y, z = now[3] + past[3], now[4] + past[4], now[5] + past[5]
        gx, gy, gz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x  # w x a over the step
        square = wx * wx + wy * wy + wz * wz
        spins = square > SPINS * SPINS
        carried = _carried(square) if spins else 1.0
        x, y, z = dx + carried * gx, dy + carried * gy, dz + carried * gz
        change = min(of_body, x * x + y * y + z * z)
        if spins or change > turned_free:
            p, q, r = to_change * held[3], to_change * held[4], to_change * held[5]
            fx, fy, fz = e * dx - gx + p, e * dy - gy + q, e * dz - gz + r
            share = _free_share(fx * fx + fy * fy + fz * fz, p * p + q * q + r * r)
            if spins:
                a, w = (now[3], now[4], now[5]), (twist[3], twist[4], twist[5])
                size, along = dot(a, a), dot(a, (dx, dy, dz))
                across = max(of_body - along * along / size, 0.0) if size > 0.0 else 0.0
                _note_gyration(load33(inertia, b), load33(R, b), a, w, across, share, b, spacing, parts, account)
            if share * change > turned_free:
                turned_free = share * change
                ox, oy, oz = past[3] - older[3], past[4] - older[4], past[5] - older[5]
                bx, by, bz = dx - ox, dy - oy, dz - oz
                ox, oy, oz = ox + carried * gx, oy + carried * gy, oz + carried * gz  # in the axes of the world
                ox, oy, oz = x - ox, y - oy, z - oz
                bend_turned = min(bx * bx + by * by + bz * bz, ox * ox + oy * oy + oz * oz)
        if change > turned:
            turned, body_turned = change, b
        for i in range(6):
            held[i] = own[b, i] - twist[i]
    _note_change(account, 0, moved, moved_free, bend_moved, body_moved, spacing, parts, slowest[0])
    _note_change(account, 1, turned, turned_free, bend_turned, body_turned, spacing, parts, slowest[1])
    if residual > SETTLED_INCREMENT:
        account.unsettled[0] += 1.0
    if residual > account.residual[0]:
        most, at = -1.0, 0
        for b in range(offset.shape[0]):
            for i in range(6):
                change = abs(a_now[b, i] - a_before[b, i])
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
