"""The step of a nonlinear single-track model with roll: two axles on a plane, a body that rolls over them, wheels that
turn.

Generalized velocities: vx, vy of the axis of roll at the centre of mass along and across the heading, yaw rate r, roll
rate p (about the axis of roll), spin of both axles. With S = (sprung mass) x (its height over the axis of roll) and J
the product of inertia of roll and yaw, the kinetic energy of the body is

    T = m (vx^2 + vy^2) / 2 + Iz r^2 / 2 + Ix p^2 / 2 - S p vy + S phi r vx - J p r

(the centre of mass stands S phi / m to the right of the axis). The equations are those of Boltzmann and Hamel for
velocities along the heading, with P = dT/dv:

    dPx/dt - r Py = Fx,  dPy/dt + r Px = Fy,  dPr/dt + vx Py - vy Px = Mz,  dPp/dt - S r vx = -k phi - c p

so the energy T + k phi^2 / 2 changes by the power of the forces alone, whatever phi is. k is what springs, bars and
gravity leave.

Forces of an axle (suffix of its wheel plane): contact deflections u, v as in solver.elements.tire_pacejka
([Pacejka2012] 7.2, 8.6),

    du/dt = -Vsx - |V| u / sigma_x      kappa = u / sigma_x        tan(alpha) = v / sigma_y

and a characteristic of combined slip in the manner of the similarity method ([Pacejka2012] 4.3.1),

    s = |(Kx kappa / Dx, Ky tan(alpha) / Dy)|     F = D f(s) s_i / s     f(s) = sin(C atan(X - E (X - atan(X)))),  X = s
                                                  / C

with f'(0) = 1; C and E go from their values along to those across with the square of the direction of slip. D is
proportional to the load of the axle and the friction of the road, Ky grows with the load. Steering turns the front
axle, and in proportion to it a rear one that follows; roll turns both (roll steer). The point of contact stands the
trail n behind the axis of steering, so the steering wheel feels n Fy; in reverse that of the tires, the part of n that
large slip takes, is in front of it. The load that goes to the rear under acceleration follows it with a lag; the body
pitches with it, with what lifts it where torque acts through the suspension otherwise than under brakes, with the same
lag, and with the square of its roll. The brake is a slider in series with a spring whose wind-up b follows Dahl's law
db/dt = w - |w| k b / T, which has no singularity at rest. Rolling resistance stands by the give of the treads
(solver.elements.tread).

Method: ROS2 [Verwer1999], two stages, second order with any matrix A, L-stable where A is the derivative: A has the
stiff parts alone, the spin, longitudinal deflection and wind-up of each axle, its lateral deflection and the lag of the
load.
"""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.select import some, where
from solver.inputs.driving import drive
from solver.levels.track_axle import axle_forces
from solver.levels.track_shown import keep_account, keep_reached, show
from solver.levels.track_tables import (
    ALPHA,
    AXLE_COLUMNS,
    DRAG,
    DRIVE,
    ENERGY,
    FRICTION_GAP,
    GROSS,
    KINETIC,
    LATERAL,
    LONG,
    LOSS,
    ROLL,
    ROLL_RATE,
    SHIFT,
    SIZE,
    SPIN,
    SUPPLIED,
    VX,
    VY,
    WHEEL_TORQUE,
    WIND,
    YAW,
    YAW_RATE,
    Steered,
    X,
    Y,
)

GAMMA = 1.0 - np.sqrt(0.5)  # of ROS2
LIMITER_FROM = 0.95  # as of a coordinate force


@kernel(inline=True)
def _limited(drive, spin, top):
    """Drive torque that the limiter leaves at a spin."""
    limits = (top != 0.0) & (drive != 0.0)
    if not some(limits):
        return drive
    forward = where(drive > 0.0, 1.0, -1.0)
    x = (forward * spin - LIMITER_FROM * top) / ((1.0 - LIMITER_FROM) * top)
    return where(limits & (x > 0.0), where(x >= 1.0, 0.0, drive * (1.0 - x * x * (3.0 - 2.0 * x))), drive)


@kernel(inner=True)
def evaluate(t, y, steering, drive, brake, rates, stiff, told):
    """Assign the rates of the state y, the stiff part of their derivative, and what evaluate() tells.

    drive, brake: torques [N m], of all wheels together.
    """
    b = t.body
    c = np.cos(y[YAW])
    s = np.sin(y[YAW])
    vx = y[VX]
    vy = y[VY]
    r = y[YAW_RATE]
    p = y[ROLL_RATE]
    phi = y[ROLL]
    told[FRICTION_GAP] = 0.0
    ahead = _limited(drive, y[SPIN], t.front.top_spin)
    behind = _limited(drive, y[SPIN + 1], t.rear.top_spin)
    fx, fy, mz, contact, braked, stored, back = axle_forces(
        b, t.front, t.road, 0, y, steering, ahead, brake, c, s, rates, stiff, told
    )
    gx, gy, nz, contact_2, braked_2, stored_2, back_2 = axle_forces(
        b, t.rear, t.road, 1, y, steering, behind, brake, c, s, rates, stiff, told
    )
    speed = np.sqrt(vx * vx + vy * vy)
    drag = b.drag * speed
    Fx = fx + gx
    Fy = fy + gy - drag * vy
    Mz = mz + nz
    rates[SHIFT] = (b.height * Fx - y[SHIFT]) / b.lag
    total = t.front.drive + t.rear.drive
    if total > 0.0:
        drive = (t.front.drive * ahead + t.rear.drive * behind) / total
    rates[DRIVE] = (drive - y[DRIVE]) / b.lag
    Fx -= drag * vx

    # M dv/dt = F - what the products of velocities take; unknown in the order vx, vy, r, p
    S = b.coupling
    Px = b.mass * vx + S * phi * r
    Py = b.mass * vy - S * p
    qx = Fx + r * Py - S * p * r
    qy = Fy - r * Px
    qr = Mz - vx * Py + vy * Px - S * p * vx
    qp = -b.roll_stiffness * phi - b.roll_damping * p + S * r * vx
    # vx and vy eliminated: m dvx = qx - S phi dr, m dvy = qy + S dp
    e = S * phi / b.mass
    g = S / b.mass
    m_rr = b.yaw_inertia - e * S * phi
    m_pp = b.roll_inertia - g * S
    m_rp = -b.product
    qr -= e * qx
    qp += g * qy
    determinant = m_rr * m_pp - m_rp * m_rp
    dr = (qr * m_pp - qp * m_rp) / determinant
    dp = (qp * m_rr - qr * m_rp) / determinant
    rates[X] = vx * c - vy * s
    rates[Y] = vx * s + vy * c
    rates[YAW] = r
    rates[ROLL] = p
    rates[VX] = (qx - S * phi * dr) / b.mass
    rates[VY] = (qy + S * dp) / b.mass
    rates[YAW_RATE] = dr
    rates[ROLL_RATE] = dp

    turned = b.steering_damping * steering.rate
    told[WHEEL_TORQUE] = b.steering_inertia * steering.acceleration + turned + back + back_2
    driving = (told[WHEEL_TORQUE] - b.steering_inertia * steering.acceleration) * steering.rate
    front_drive = t.front.drive * ahead * y[SPIN]
    rear_drive = t.rear.drive * behind * y[SPIN + 1]
    turned *= steering.rate
    rolled = b.roll_damping * p * p
    dragged = drag * speed * speed
    rates[LOSS] = (
        contact + contact_2 + braked + braked_2 + turned + rolled + dragged - driving - front_drive - rear_drive
    )
    told[SUPPLIED] = driving + front_drive + rear_drive
    rates[GROSS] = (
        abs(contact) + abs(contact_2) + abs(braked) + abs(braked_2) + turned + rolled + dragged
        + abs(driving) + abs(front_drive) + abs(rear_drive)
    )  # fmt: skip
    kinetic = 0.5 * (b.mass * (vx * vx + vy * vy) + b.yaw_inertia * r * r + b.roll_inertia * p * p)
    kinetic += S * (phi * r * vx - p * vy) - b.product * p * r
    kinetic += 0.5 * (t.front.inertia * y[SPIN] * y[SPIN] + t.rear.inertia * y[SPIN + 1] * y[SPIN + 1])
    told[KINETIC] = kinetic
    told[ENERGY] = kinetic + 0.5 * b.roll_stiffness * phi * phi + stored + stored_2
    told[DRAG] = drag * speed


@kernel(inner=True)
def _solved(stiff, lag, gh, k):
    """k <- (1 - gh A)^-1 k: each axle is an arrow of spin, longitudinal deflection and wind-up."""
    for i in range(2):
        a = stiff[i]
        u = 1.0 / (1.0 - gh * a[4])
        b = 1.0 / (1.0 - gh * a[6])
        pivot = 1.0 - gh * a[0] - gh * gh * (a[1] * u * a[3] + a[2] * b * a[5])
        spin = (k[SPIN + i] + gh * (a[1] * u * k[LONG + i] + a[2] * b * k[WIND + i])) / pivot
        k[SPIN + i] = spin
        k[LONG + i] = u * (k[LONG + i] + gh * a[3] * spin)
        k[WIND + i] = b * (k[WIND + i] + gh * a[5] * spin)
        k[LATERAL + i] /= 1.0 - gh * a[7]
    k[SHIFT] /= 1.0 + gh / lag
    k[DRIVE] /= 1.0 + gh / lag


@kernel(inline=True)
def _steering(before, after, x, h):
    """The steering wheel at the part x of a step h: cubic through angles and rates at its ends, acceleration linear."""
    if x <= 0.0:
        return before
    if x >= 1.0:
        return after
    d = after.angle - before.angle
    a = h * before.rate
    c2 = 3.0 * d - 2.0 * a - h * after.rate
    c3 = a + h * after.rate - 2.0 * d
    angle = before.angle + x * (a + x * (c2 + x * c3))
    rate = (a + x * (2.0 * c2 + 3.0 * x * c3)) / h
    return Steered(angle, rate, before.acceleration + x * (after.acceleration - before.acceleration))


@kernel(inner=True)
def step(t, y, before, after, drive, brake, h, parts, w):
    """Advance the state y by a step h in so many equal parts; returns whether all is finite (y is as it was
    otherwise)."""
    part = h / parts
    gh = GAMMA * part
    for i in range(SIZE):
        w.start[i] = y[i]
    exchanged = 0.0 * y[LOSS]
    for n in range(parts):
        here = _steering(before, after, n / parts, h)
        there = _steering(before, after, (n + 1) / parts, h)
        evaluate(t, y, here, drive, brake, w.k1, w.stiff, w.told)
        _solved(w.stiff, t.body.lag, gh, w.k1)
        for i in range(SIZE):
            w.between[i] = y[i] + part * w.k1[i]
        exchanged += 0.5 * part * w.told[SUPPLIED]
        evaluate(t, w.between, there, drive, brake, w.k2, w.stiff_2, w.told)
        exchanged += 0.5 * part * w.told[SUPPLIED]
        for i in range(SIZE):
            w.k2[i] -= 2.0 * w.k1[i]
        _solved(w.stiff, t.body.lag, gh, w.k2)
        for i in range(SIZE):
            y[i] += part * (1.5 * w.k1[i] + 0.5 * w.k2[i])
    total = 0.0
    for i in range(SIZE):
        total += y[i]
    if np.isfinite(total):
        if w.account.flow.shape[0] > 0:
            w.account.flow[1] += exchanged
        return True
    for i in range(SIZE):
        y[i] = w.start[i]
    return False


@kernel(inline=True)
def evaluate_shown(t, y, steering, drive, brake, w):
    """evaluate() for outputs: slip angles are angles, not their tangents."""
    evaluate(t, y, steering, drive, brake, w.rates, w.stiff, w.told)
    for i in range(2):
        w.told[i * len(AXLE_COLUMNS) + ALPHA] = np.arctan(w.told[i * len(AXLE_COLUMNS) + ALPHA])


@kernel(inline=True)
def wheel_of(u, index):
    """The steering wheel in the inputs u."""
    return Steered(u[index[0]], u[index[1]], u[index[2]])


@kernel(borrow=True)
def start(t, y, u, index, w, frame):
    """Fill the outputs of a state with the inputs u when no step has led to it, and begin the account."""
    steering = wheel_of(u, index)
    y[LOSS] = 0.0
    y[GROSS] = 0.0
    evaluate_shown(t, y, steering, u[index[3]], u[index[4]], w)
    keep_account(w.told, y, 0.0, w.account)
    w.reached[:] = 0.0
    w.steered[:] = 0.0
    show(t, y, w.rates, w.told, steering, u, w.account, frame)


@kernel(inline=True)
def advance_once(t, y, u_before, u, index, audit, shown, h, parts, w):
    """Advance the state y by a step h with the inputs u (nu,), which become those before; whether its result is finite.

    shown: evaluate the rates at its end, for outputs.
    """
    after = wheel_of(u, index)
    if not step(t, y, wheel_of(u_before, index), after, u[index[3]], u[index[4]], h, parts, w):
        return False
    if shown:
        evaluate_shown(t, y, after, u[index[3]], u[index[4]], w)
    if audit:
        keep_account(w.told, y, h, w.account)
        keep_reached(y, w.rates, w.told, w.account.time[0], w.reached)
        w.steered[0] += h * after.angle * after.angle
        w.steered[1] += h * after.rate * after.rate
    for i in range(u.shape[0]):
        u_before[i] = u[i]
    return True


@kernel(borrow=True)
def show_end(t, y, u, index, w, frame):
    """Fill the outputs of a state that advance_once() has led to with the inputs u."""
    show(t, y, w.rates, w.told, wheel_of(u, index), u, w.account, frame)


@kernel(borrow=True)
def advance(t, y, inputs, index, u_before, first, count, audit, h, parts, w, frame):
    """Advance the state y by count steps h with rows first.. of inputs (n, nu); a single row holds for all.

    index: columns of steering angle, rate and acceleration, drive and brake torque. u_before (nu,): inputs of the step
    before, then of the last. audit: keep the account. Returns (0, the steps done), or (1, index of an input that is not
    finite), or (2, steps done before one whose result is not finite).
    """
    held = inputs.shape[0] == 1
    for k in range(first, first + count):
        for i in range(inputs.shape[1]):
            if not np.isfinite(inputs[0 if held else k, i]):
                return 1, i
    for k in range(count):
        u = inputs[0 if held else first + k]
        if not advance_once(t, y, u_before, u, index, audit, audit or k == count - 1, h, parts, w):
            return 2, k
    if count > 0:
        show(t, y, w.rates, w.told, wheel_of(u_before, index), u_before, w.account, frame)
    return 0, count


@kernel(borrow=True)
def advance_seen(t, y, inputs, index, u_before, first, count, k, audit, h, parts, every, numbers, rows, w, frame):
    """As advance(), from step k of the grid on; numbers (m,), which frame are views of, become a row of rows (n, m)
    behind each step that `every` divides. Returns (status, steps done or index of an input, rows taken)."""
    done = taken = 0
    while done < count:
        piece = min(every - (k + done) % every, count - done)
        status, steps = advance(t, y, inputs, index, u_before, first + done, piece, audit, h, parts, w, frame)
        if status == 1:
            return status, steps, taken
        done += steps
        if status != 0:
            return status, done, taken
        if (k + done) % every == 0:
            for i in range(numbers.shape[0]):
                rows[taken, i] = numbers[i]
            taken += 1
    return 0, done, taken


@kernel(borrow=True)
def advance_driven(
    t, y, driver, wanted, inputs, index, u_before, first, count, k, audit, h, parts, every, numbers, rows, w, frame
):
    """As advance_seen(), with inputs (n, nu) to which the driver adds what he does; wanted (n, 2): speed and its slope.
    every: 0 where no row is taken."""
    taken = 0
    for i in range(first, first + count):
        side = t.mounting.axis * y[ROLL]
        sight = frame.pose[0, 0], frame.pose[0, 1], y[YAW], y[VX] - y[YAW_RATE] * side
        drive(driver, k + i - first, wanted[i, 0], wanted[i, 1], sight, inputs[i])
        status, _ = advance(t, y, inputs, index, u_before, i, 1, audit, h, parts, w, frame)
        if status != 0:
            return 2, i - first, taken
        if every > 0 and (k + i - first + 1) % every == 0:
            for j in range(numbers.shape[0]):
                rows[taken, j] = numbers[j]
            taken += 1
    return 0, count, taken
