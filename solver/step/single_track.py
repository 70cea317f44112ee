"""The step of a nonlinear single-track model with roll: two axles on a plane, a body that rolls over them, wheels that turn.

Generalized velocities: vx, vy of the axis of roll at the centre of mass along and across the heading, yaw rate r, roll rate p (about
the axis of roll), spin of both axles. With S = (sprung mass) x (its height over the axis of roll) and J the product of inertia of roll and
yaw, the kinetic energy of the body is

    T = m (vx^2 + vy^2) / 2 + Iz r^2 / 2 + Ix p^2 / 2 - S p vy + S phi r vx - J p r

(the centre of mass stands S phi / m to the right of the axis). The equations are those of Boltzmann and Hamel for velocities along the
heading, with P = dT/dv:

    dPx/dt - r Py = Fx,  dPy/dt + r Px = Fy,  dPr/dt + vx Py - vy Px = Mz,  dPp/dt - S r vx = -k phi - c p

so the energy T + k phi^2 / 2 changes by the power of the forces alone, whatever phi is. k is what springs, bars and gravity leave.

Forces of an axle (suffix of its wheel plane): contact deflections u, v as in solver.elements.tire_pacejka ([Pacejka2012] 7.2, 8.6),

    du/dt = -Vsx - |V| u / sigma_x      kappa = u / sigma_x        tan(alpha) = v / sigma_y

and a characteristic of combined slip in the manner of the similarity method ([Pacejka2012] 4.3.1),

    s = |(Kx kappa / Dx, Ky tan(alpha) / Dy)|     F = D f(s) s_i / s     f(s) = sin(C atan(X - E (X - atan(X)))),  X = s / C

with f'(0) = 1; C and E go from their values along to those across with the square of the direction of slip. D is proportional to the
load of the axle and the friction of the road. Steering turns the front axle; roll turns both (roll steer). The point of contact stands the
trail n behind the axis of steering, so the steering wheel feels n Fy. The load that goes to the rear under acceleration follows it with
a lag; the body pitches with it and with the square of its roll. The brake is a slider in series with a spring whose wind-up b follows
Dahl's law db/dt = w - |w| k b / T, which has no singularity at rest.

Method: ROS2 [Verwer1999], two stages, second order with any matrix A, L-stable where A is the derivative: A has the stiff parts alone, the
spin, longitudinal deflection and wind-up of each axle, its lateral deflection and the lag of the load.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.elements.road import RoadTable, friction_at
from solver.output import energy as account_of

GAMMA = 1.0 - np.sqrt(0.5)  # of ROS2
QUIET_SPEED, SLIP_BOUND, LOW_SLIP = 0.01, 5.0, 2.0  # as of a tire (solver.elements.tire_pacejka)
LIMITER_FROM = 0.95  # as of a coordinate force
LEAST_LOAD = 0.05  # of its load at rest is carried by an axle at least
LEAST_TORQUE = 1.0  # N m: a brake below slides like one of this capacity
SLOWEST = 0.1  # m/s below which rolling resistance fades

# State
X, Y, YAW, ROLL, TURN_F, TURN_R = range(6)
VX, VY, YAW_RATE, ROLL_RATE = range(6, 10)
SPIN, LONG, LATERAL, WIND = 10, 12, 14, 16  # of the front axle, the rear axle follows
SHIFT, LOSS, GROSS = 18, 19, 20  # load moved to the rear [N]; integrals of dissipated less supplied power and of all magnitudes [J]
SIZE = 21

# What evaluate() tells beside the rates: of each axle AXLE_COLUMNS, then these
AXLE_COLUMNS = ('fx', 'fy', 'fz', 'slip', 'slip_angle', 'brake_torque')
FX, FY, FZ, KAPPA, ALPHA, BRAKE = range(6)
WHEEL_TORQUE, ENERGY, KINETIC, FRICTION_GAP, DRAG, SATURATION = range(12, 18)
TOLD = 18

# What was largest so far: value and time of each
REACHED = ('lateral acceleration', 'slip angle', 'slip', 'friction difference')


class Axle(NamedTuple):
    """An axle: both its wheels as one."""

    x: float  # from the centre of mass [m]
    half_track: float  # [m]
    load: float  # at rest [N]
    shifted: float  # load per load moved to the rear: -1 in front, 1 behind
    stiffness_x: float  # [N]
    stiffness_y: float  # [N/rad]
    peak_x: float  # at rest, on a road of friction 1 [N]
    peak_y: float
    shape_x: float  # C
    shape_y: float
    curvature_x: float  # E
    curvature_y: float
    length_x: float  # of relaxation [m]
    length_y: float
    steered: float  # 1 or 0
    roll_steer: float  # [rad/rad]
    trail: float  # behind the axis of steering at small slip [m]
    trail_lost: float  # of it at large slip [m]
    radius: float  # lever of the longitudinal force [m]
    rolling_radius: float  # speed over spin of a wheel that rolls freely [m]
    inertia: float  # of all that turns with it [kg m^2]
    resistance: float  # rolling resistance over load [-]
    drive: float  # share of the drive torque
    brake: float  # share of the brake torque
    brake_stiffness: float  # [N m/rad]
    brake_damping: float  # [N m s/rad]


class Body(NamedTuple):
    """What the axles carry, and the whole."""

    mass: float  # [kg]
    yaw_inertia: float  # about the centre of mass [kg m^2]
    roll_inertia: float  # about the axis of roll [kg m^2]
    coupling: float  # S [kg m]
    product: float  # J [kg m^2]
    roll_stiffness: float  # net of gravity [N m/rad]
    roll_damping: float  # [N m s/rad]
    drag: float  # over the square of the speed [kg/m]
    height: float  # load moved to the rear over longitudinal force [-]
    lag: float  # of it [s]
    ratio: float  # road wheels over steering wheel, straight ahead
    ratio_3: float  # and its growth: angle = ratio s + ratio_3 s^3
    steering_inertia: float  # [kg m^2]
    steering_damping: float  # [N m s/rad]
    top_spin: float  # of the driven axle, where the drive torque ends [rad/s]; 0: never
    low_speed: float  # of the contact at rest [m/s]
    contact_time: float  # damping of the contact at rest [s]


class Mounting(NamedTuple):
    """Where the frame of the chassis and its centre of mass are, in what is shown."""

    x: float  # of the origin of the chassis from the centre of mass of all [m]
    axis: float  # height of the axis of roll over that origin [m]
    height: float  # of the origin at rest [m]
    pitch: float  # at rest [rad]
    pitch_by_shift: float  # [rad/N]
    pitch_by_roll: float  # over the square of the roll [1/rad]
    com_x: float  # centre of mass of the chassis in its frame [m]
    com_y: float
    com_z: float
    yaw: float  # at the start, where the wheels stand at zero [rad]
    gravity: float  # [m/s^2]


class SingleTrackTables(NamedTuple):
    """All parameters of a single-track model."""

    mounting: Mounting
    body: Body
    front: Axle
    rear: Axle
    road: RoadTable


class SingleTrackWork(NamedTuple):
    """Scratch of a step, and what it tells."""

    rates: np.ndarray  # (SIZE,) at the end of the last step
    start: np.ndarray  # (SIZE,) state before the step
    k1: np.ndarray
    k2: np.ndarray
    between: np.ndarray
    stiff: np.ndarray  # (2, 8) matrix A of both axles
    stiff_2: np.ndarray
    told: np.ndarray  # (TOLD,)
    reached: np.ndarray  # (len(REACHED), 2)
    steered: np.ndarray  # (2,) integrals of the squares of angle [rad^2 s] and rate [rad^2/s] of the steering wheel
    energy: np.ndarray  # (LENGTH,) running account


class Steered(NamedTuple):
    """The steering wheel at an instant [rad, rad/s, rad/s^2]."""

    angle: float
    rate: float
    acceleration: float


@kernel(inline=True)
def _friction(road, axle, x, y, c, s):
    """(mean, difference) of the friction under both wheels of an axle whose middle is at (x, y); (c, s): heading."""
    if road.patch.shape[0] == 0:
        return road.friction[0], 0.0
    left = friction_at(road, x - axle.half_track * s, y + axle.half_track * c)
    right = friction_at(road, x + axle.half_track * s, y - axle.half_track * c)
    return 0.5 * (left + right), abs(left - right)


@kernel(inner=True)
def _axle(b, axle, road, i, y, steering, drive, brake, c, s, rates, stiff, told):
    """Rates of the states of axle i; returns its forces along and across the heading and its moment (fx, fy, mz), the power it dissipates,
    the energy it stores, and the torque that its trail turns the steering wheel back with.
    """
    # kinematics
    turn = axle.roll_steer * y[ROLL]
    turning = 0.0
    gear = 0.0
    if axle.steered != 0.0:
        angle = steering.angle
        gear = b.ratio + 3.0 * b.ratio_3 * angle * angle
        turn += angle * (b.ratio + b.ratio_3 * angle * angle)
        turning = gear * steering.rate
    ct = np.cos(turn)
    st = np.sin(turn)
    across = y[VY] + axle.x * y[YAW_RATE]
    Vx = y[VX] * ct + across * st
    spin = y[SPIN + i]
    Vsx = Vx - axle.rolling_radius * spin
    mu, gap = _friction(road, axle, y[X] + axle.x * c, y[Y] + axle.x * s, c, s)
    Fz = max(axle.load + axle.shifted * y[SHIFT], LEAST_LOAD * axle.load)
    share = Fz / axle.load * mu
    Dx = axle.peak_x * share
    Dy = axle.peak_y * share
    u = y[LONG + i]
    v = y[LATERAL + i]
    tan = v / axle.length_y
    sy = axle.stiffness_y * tan / Dy
    trail = axle.trail - axle.trail_lost * (sy * sy / (1.0 + sy * sy))
    Vsy = across * ct - y[VX] * st - trail * turning

    # slips
    low = b.low_speed * b.low_speed
    slow = max(1.0 - Vx * Vx / low, 0.0)
    slow *= slow
    quiet = max(1.0 - (Vx * Vx + Vsx * Vsx + Vsy * Vsy) / low, 0.0)
    quiet *= b.contact_time * quiet
    kx = axle.stiffness_x / (LOW_SLIP * axle.peak_x)
    ky = axle.stiffness_y / (LOW_SLIP * axle.peak_y)
    bound = 1.0 / (SLIP_BOUND * SLIP_BOUND)
    wx = Vx * Vx + Vsx * Vsx * (bound + slow * kx * kx)
    wy = Vx * Vx + Vsy * Vsy * (bound + slow * ky * ky)
    rate_x = wx / (np.sqrt(wx + QUIET_SPEED * QUIET_SPEED) * axle.length_x)
    rate_y = wy / (np.sqrt(wy + QUIET_SPEED * QUIET_SPEED) * axle.length_y)
    kappa = (u - quiet * Vsx) / axle.length_x
    tan = (v - quiet * Vsy) / axle.length_y

    # characteristic
    sx = axle.stiffness_x * kappa / Dx
    sy = axle.stiffness_y * tan / Dy
    size = np.sqrt(sx * sx + sy * sy)
    share = 1.0
    if size > 1e-6:
        part = sx * sx / (size * size)
        C = axle.shape_y + part * (axle.shape_x - axle.shape_y)
        E = axle.curvature_y + part * (axle.curvature_x - axle.curvature_y)
        x = size / C
        share = np.sin(C * np.arctan(x - E * (x - np.arctan(x)))) / size
    Fx = Dx * share * sx
    Fy = Dy * share * sy

    # torques about the axis of the wheels
    capacity = max(axle.brake * brake, 0.0)
    wind = y[WIND + i]
    sliding = abs(spin) * axle.brake_stiffness / max(capacity, LEAST_TORQUE)
    winding = spin - sliding * wind
    viscous = axle.brake_damping * capacity / (capacity + abs(spin) * axle.brake_damping + 1e-9)
    stopping = axle.brake_stiffness * wind + viscous * winding
    held = 1.0
    if abs(stopping) > capacity:
        stopping = capacity if stopping > 0.0 else -capacity
        held = 0.0
    release = 0.0
    excess = abs(wind) - capacity / axle.brake_stiffness
    if excess > 0.0:  # the capacity fell
        release = axle.brake_stiffness / axle.brake_damping
        winding -= release * (excess if wind > 0.0 else -excess)
    x = spin * axle.radius / SLOWEST
    sign = 1.0 if x >= 1.0 else (-1.0 if x <= -1.0 else x * (1.5 - 0.5 * x * x))
    resisting = axle.resistance * Fz * axle.radius * sign
    torque = axle.drive * drive - stopping - resisting - Fx * axle.radius

    rates[TURN_F + i] = spin
    rates[SPIN + i] = torque / axle.inertia
    rates[LONG + i] = -Vsx - rate_x * u
    rates[LATERAL + i] = -Vsy - rate_y * v
    rates[WIND + i] = winding
    slope = axle.stiffness_x * share * axle.radius / (axle.length_x * axle.inertia)
    clockwise = 1.0 if spin > 0.0 else -1.0
    free = 1.0 - clockwise * axle.brake_stiffness * wind / max(capacity, LEAST_TORQUE)
    stiff[i, 0] = -slope * quiet * axle.rolling_radius - held * viscous * max(free, 0.0) / axle.inertia
    stiff[i, 1] = -slope
    stiff[i, 2] = -held * max(axle.brake_stiffness - viscous * sliding, 0.0) / axle.inertia
    stiff[i, 3] = axle.rolling_radius
    stiff[i, 4] = -rate_x
    stiff[i, 5] = free
    stiff[i, 6] = -sliding - release
    stiff[i, 7] = -rate_y
    at = i * len(AXLE_COLUMNS)
    told[at + FX] = Fx
    told[at + FY] = Fy
    told[at + FZ] = Fz
    told[at + KAPPA] = kappa
    told[at + ALPHA] = np.arctan(tan)
    told[at + BRAKE] = stopping
    if axle.steered != 0.0:
        told[SATURATION] = sy * sy / (1.0 + sy * sy)
    told[FRICTION_GAP] = max(told[FRICTION_GAP], gap)
    along = Fx * ct - Fy * st
    sideways = Fx * st + Fy * ct
    contact = -(Fx * Vx + Fy * Vsy) + (Fx * axle.radius + resisting) * spin
    windup = axle.brake_stiffness * wind
    braked = stopping * spin - windup * winding
    back = gear * trail * Fy
    return along, sideways, axle.x * sideways, contact, braked, 0.5 * windup * wind, back


@kernel(inline=True)
def _limited(drive, spin, top):
    """Drive torque that the limiter leaves at a spin."""
    if top == 0.0 or drive == 0.0:
        return drive
    forward = 1.0 if drive > 0.0 else -1.0
    x = (forward * spin - LIMITER_FROM * top) / ((1.0 - LIMITER_FROM) * top)
    if x <= 0.0:
        return drive
    if x >= 1.0:
        return 0.0
    return drive * (1.0 - x * x * (3.0 - 2.0 * x))


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
    driven = t.front.drive * y[SPIN] + t.rear.drive * y[SPIN + 1]
    total = t.front.drive + t.rear.drive
    drive = _limited(drive, driven / total if total > 0.0 else 0.0, b.top_spin)
    fx, fy, mz, contact, braked, stored, back = _axle(b, t.front, t.road, 0, y, steering, drive, brake, c, s, rates, stiff, told)
    gx, gy, nz, contact_2, braked_2, stored_2, back_2 = _axle(b, t.rear, t.road, 1, y, steering, drive, brake, c, s, rates, stiff, told)
    speed = np.sqrt(vx * vx + vy * vy)
    drag = b.drag * speed
    Fx = fx + gx
    Fy = fy + gy - drag * vy
    Mz = mz + nz
    rates[SHIFT] = (b.height * Fx - y[SHIFT]) / b.lag
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
    front_drive = t.front.drive * drive * y[SPIN]
    rear_drive = t.rear.drive * drive * y[SPIN + 1]
    turned *= steering.rate
    rolled = b.roll_damping * p * p
    dragged = drag * speed * speed
    rates[LOSS] = contact + contact_2 + braked + braked_2 + turned + rolled + dragged - driving - front_drive - rear_drive
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
    """Advance the state y by a step h in so many equal parts; returns whether all is finite (y is as it was otherwise)."""
    part = h / parts
    gh = GAMMA * part
    for i in range(SIZE):
        w.start[i] = y[i]
    for n in range(parts):
        here = _steering(before, after, n / parts, h)
        there = _steering(before, after, (n + 1) / parts, h)
        evaluate(t, y, here, drive, brake, w.k1, w.stiff, w.told)
        _solved(w.stiff, t.body.lag, gh, w.k1)
        for i in range(SIZE):
            w.between[i] = y[i] + part * w.k1[i]
        evaluate(t, w.between, there, drive, brake, w.k2, w.stiff_2, w.told)
        for i in range(SIZE):
            w.k2[i] -= 2.0 * w.k1[i]
        _solved(w.stiff, t.body.lag, gh, w.k2)
        for i in range(SIZE):
            y[i] += part * (1.5 * w.k1[i] + 0.5 * w.k2[i])
    total = 0.0
    for i in range(SIZE):
        total += y[i]
    if np.isfinite(total):
        return True
    for i in range(SIZE):
        y[i] = w.start[i]
    return False


@kernel(inner=True)
def keep_account(told, y, h, a):
    """Advance the running account by a step h (h = 0 starts it); the integrals are those of the state."""
    energy = told[ENERGY]
    kinetic = told[KINETIC]
    potential = energy - kinetic
    if h == 0.0:
        a[:] = 0.0
        a[account_of.REFERENCE] = energy
        a[account_of.KINETIC_LOW] = kinetic
        a[account_of.KINETIC_HIGH] = kinetic
        a[account_of.POTENTIAL_LOW] = potential
        a[account_of.POTENTIAL_HIGH] = potential
    a[account_of.TIME] += h
    a[account_of.STEPS] += 1.0
    a[account_of.WORK] = y[LOSS]
    a[account_of.GROSS] = y[GROSS]
    a[account_of.ENERGY] = energy
    a[account_of.KINETIC_LOW] = min(a[account_of.KINETIC_LOW], kinetic)
    a[account_of.KINETIC_HIGH] = max(a[account_of.KINETIC_HIGH], kinetic)
    a[account_of.POTENTIAL_LOW] = min(a[account_of.POTENTIAL_LOW], potential)
    a[account_of.POTENTIAL_HIGH] = max(a[account_of.POTENTIAL_HIGH], potential)
    a[account_of.SPEED] = max(a[account_of.SPEED], abs(y[VX]), abs(y[VY]), abs(y[SPIN]), abs(y[SPIN + 1]))
    error = abs(energy - a[account_of.REFERENCE] + y[LOSS])
    if error > a[account_of.WORST]:
        a[account_of.WORST] = error
        a[account_of.WORST_AT] = a[account_of.TIME]


@kernel(inner=True)
def note(reached, k, value, time):
    """Remember the largest value and its time."""
    if value > reached[k, 0]:
        reached[k, 0] = value
        reached[k, 1] = time


@kernel(inner=True)
def keep_reached(y, rates, told, time, reached):
    """Note how far the run went: what the limits of the model are about."""
    note(reached, 0, abs(rates[VY] + y[YAW_RATE] * y[VX]), time)
    rear = len(AXLE_COLUMNS)
    note(reached, 1, max(abs(told[ALPHA]), abs(told[rear + ALPHA])), time)
    note(reached, 2, max(abs(told[KAPPA]), abs(told[rear + KAPPA])), time)
    note(reached, 3, told[FRICTION_GAP], time)


@kernel(inner=True)
def unrolled(v, ct, st, cr, sr):
    """A vector along the heading, in the axes of the chassis that pitched (ct, st) and rolled (cr, sr)."""
    x = ct * v[0] - st * v[2]
    z = st * v[0] + ct * v[2]
    return x, cr * v[1] + sr * z, -sr * v[1] + cr * z


@kernel(inner=True)
def show(t, y, rates, told, steering, u, frame):
    """Assign the OutputArrays of a state: joints steering_wheel and the wheels in the order front left, right, rear left, right."""
    m = t.mounting
    c = np.cos(y[YAW])
    s = np.sin(y[YAW])
    phi = y[ROLL]
    theta = m.pitch + m.pitch_by_shift * y[SHIFT] + m.pitch_by_roll * phi * phi
    cr = np.cos(phi)
    sr = np.sin(phi)
    ct = np.cos(theta)
    st = np.sin(theta)
    side = m.axis * phi
    r = y[YAW_RATE]
    frame.pose[0, 0] = y[X] + c * m.x - s * side
    frame.pose[0, 1] = y[Y] + s * m.x + c * side
    frame.pose[0, 2] = m.height
    hc = np.cos(0.5 * y[YAW])
    hs = np.sin(0.5 * y[YAW])
    pc = np.cos(0.5 * theta)
    ps = np.sin(0.5 * theta)
    rc = np.cos(0.5 * phi)
    rs = np.sin(0.5 * phi)
    frame.pose[0, 3] = hc * pc * rs - hs * ps * rc
    frame.pose[0, 4] = hc * ps * rc + hs * pc * rs
    frame.pose[0, 5] = hs * pc * rc - hc * ps * rs
    frame.pose[0, 6] = hc * pc * rc + hs * ps * rs
    v = unrolled((y[VX] - r * side, y[VY] + r * m.x + m.axis * y[ROLL_RATE], 0.0), ct, st, cr, sr)
    pitching = m.pitch_by_shift * rates[SHIFT] + 2.0 * m.pitch_by_roll * phi * y[ROLL_RATE]
    w = unrolled((0.0, pitching, r), ct, st, cr, sr)
    w = (w[0] + y[ROLL_RATE], w[1], w[2])
    # centre of mass of the chassis
    arm = m.com_z - m.axis
    dx = m.x + m.com_x
    dy = m.com_y - arm * phi
    vy = -arm * y[ROLL_RATE]
    ax = rates[VX] - r * y[VY] - r * r * dx - rates[YAW_RATE] * dy - 2.0 * r * vy
    ay = rates[VY] + r * y[VX] + rates[YAW_RATE] * dx - r * r * dy - arm * rates[ROLL_RATE]
    felt = unrolled((ax, ay, m.gravity), ct, st, cr, sr)
    for i in range(3):
        frame.twist[0, i] = v[i]
        frame.twist[0, 3 + i] = w[i]
        frame.imu[i] = felt[i]
        frame.imu[3 + i] = w[i]
    frame.joint_position[0] = steering.angle
    frame.joint_velocity[0] = steering.rate
    frame.joint_effort[0] = told[WHEEL_TORQUE]
    for k in range(4):
        i = k // 2
        axle = t.front if i == 0 else t.rear
        lever = (axle.half_track if k % 2 == 0 else -axle.half_track) / axle.rolling_radius
        frame.joint_position[1 + k] = y[TURN_F + i] - lever * (y[YAW] - m.yaw)
        frame.joint_velocity[1 + k] = y[SPIN + i] - lever * r
        frame.joint_effort[1 + k] = -0.5 * told[i * len(AXLE_COLUMNS) + BRAKE]
    for i in range(2 * len(AXLE_COLUMNS)):
        frame.elements[i] = told[i]
    frame.elements[2 * len(AXLE_COLUMNS)] = told[DRAG]
    for i in range(u.shape[0]):
        frame.inputs[i] = u[i]


@kernel(inline=True)
def wheel_of(u, index):
    """The steering wheel in the inputs u."""
    return Steered(u[index[0]], u[index[1]], u[index[2]])


@kernel(borrow=True)
def start(t, y, u, index, w, frame):
    """What a state shows with the inputs u when no step has led to it; begins the account."""
    steering = wheel_of(u, index)
    y[LOSS] = 0.0
    y[GROSS] = 0.0
    evaluate(t, y, steering, u[index[3]], u[index[4]], w.rates, w.stiff, w.told)
    keep_account(w.told, y, 0.0, w.energy)
    w.reached[:] = 0.0
    w.steered[:] = 0.0
    show(t, y, w.rates, w.told, steering, u, frame)


@kernel(borrow=True)
def advance(t, y, inputs, index, u_before, first, count, audit, h, parts, w, frame):
    """Advance the state y by count steps h with rows first.. of inputs (n, nu); a single row holds for all.

    index: columns of steering angle, rate and acceleration, drive and brake torque. u_before (nu,): inputs of the step before, then
    of the last. audit: keep the account. Returns (0, the steps done), or (1, index of an input that is not finite), or (2, steps
    done before one whose result is not finite).
    """
    held = inputs.shape[0] == 1
    for k in range(first, first + count):
        for i in range(inputs.shape[1]):
            if not np.isfinite(inputs[0 if held else k, i]):
                return 1, i
    for k in range(count):
        u = inputs[0 if held else first + k]
        after = wheel_of(u, index)
        if not step(t, y, wheel_of(u_before, index), after, u[index[3]], u[index[4]], h, parts, w):
            return 2, k
        if audit or k == count - 1:
            evaluate(t, y, after, u[index[3]], u[index[4]], w.rates, w.stiff, w.told)
        if audit:
            keep_account(w.told, y, h, w.energy)
            keep_reached(y, w.rates, w.told, w.energy[account_of.TIME], w.reached)
            w.steered[0] += h * after.angle * after.angle
            w.steered[1] += h * after.rate * after.rate
        for i in range(u.shape[0]):
            u_before[i] = u[i]
    if count > 0:
        show(t, y, w.rates, w.told, wheel_of(u_before, index), u_before, frame)
    return 0, count
