"""An axle of a single-track model: slips, forces, torques about its axis (the formulas stand in
solver.levels.track_step)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.select import some, where
from solver.elements.road import friction_at
from solver.levels.track_tables import (
    ALPHA,
    AXLE_COLUMNS,
    BRAKE,
    FRICTION_GAP,
    FX,
    FY,
    FZ,
    GIVE,
    KAPPA,
    LATERAL,
    LONG,
    ROLL,
    SATURATION,
    SHIFT,
    SPIN,
    TURN_F,
    VX,
    VY,
    WIND,
    YAW_RATE,
    X,
    Y,
)

QUIET_SPEED, SLIP_BOUND, LOW_SLIP, LEAST_GRIP = 0.01, 5.0, 2.0, 0.1  # as of a tire (solver.elements.tire_pacejka)
LEAST_LOAD = 0.05  # of its load at rest is carried by an axle at least
LEAST_TORQUE = 1.0  # N m: a brake below slides like one of this capacity
SLOWEST = 0.1  # m/s below which in reverse what turns the trail round fades


@kernel(inline=True)
def _friction(road, axle, x, y, c, s):
    """(mean, difference) of the friction under both wheels of an axle whose middle is at (x, y); (c, s): heading."""
    if road.patch.shape[0] == 0 and road.heights[0] == road.start.shape[0]:  # neither patches nor maps
        return road.friction[0], 0.0
    left = friction_at(road, x - axle.half_track * s, y + axle.half_track * c)
    right = friction_at(road, x + axle.half_track * s, y - axle.half_track * c)
    return 0.5 * (left + right), abs(left - right)


@kernel(inline=True)
def _sign(x):
    """Sign of x, smooth between -1 and 1."""
    return where(x >= 1.0, 1.0, where(x <= -1.0, -1.0, x * (1.5 - 0.5 * x * x)))


class _Contact(NamedTuple):
    """An axle on the ground: along and across its wheels, which are turned against the heading."""

    ct: float  # cosine and sine of this angle
    st: float
    Vx: float  # velocity of the contact, its sliding along, and across with what the trail turns [m/s]
    Vsx: float
    Vsy: float
    spin: float  # of the wheels [rad/s]
    mu: float
    gap: float  # of the friction between both wheels
    Fz: float  # [N]
    Ky: float  # cornering stiffness under this load [N]
    Dx: float  # largest forces [N]
    Dy: float
    trail: float  # [m]
    gear: float  # turn of the wheels over that of the steering wheel


class _Slip(NamedTuple):
    """Slips of an axle, and how they relax."""

    kappa: float
    tan: float
    rate_x: float  # of what the tire is bent by [1/s]
    rate_y: float
    quiet: float  # [s] of the velocity that counts as slip at rest


class _Stop(NamedTuple):
    """A brake and its wind-up."""

    torque: float  # [N m]
    winding: float  # rate of the wind-up [rad/s]
    sliding: float  # [1/s]
    release: float  # [1/s]
    viscous: float  # [N m s/rad]
    held: float  # 1 while the torque is below the capacity, else 0
    free: float


class _Roll(NamedTuple):
    """Rolling resistance by a tread that gives."""

    torque: float  # [N m]
    gives: float  # its slope over the spin [N m s/rad]
    rate: float  # of what the tread gives [m/s]


@kernel(inline=True)
def _contact(b, axle, road, i, y, steering, c, s):
    """The _Contact of axle i."""
    turn = axle.roll_steer * y[ROLL]
    turning = 0.0
    gear = 0.0
    if axle.steered != 0.0:
        angle = steering.angle
        gear = axle.steered * (b.ratio + 3.0 * b.ratio_3 * angle * angle)
        turn += axle.steered * (angle * (b.ratio + b.ratio_3 * angle * angle))
        turning = gear * steering.rate
    ct = np.cos(turn)
    st = np.sin(turn)
    across = y[VY] + axle.x * y[YAW_RATE]
    Vx = y[VX] * ct + across * st
    spin = y[SPIN + i]
    mu, gap = _friction(road, axle, y[X] + axle.x * c, y[Y] + axle.x * s, c, s)
    Fz = max(axle.load + axle.shifted * y[SHIFT], LEAST_LOAD * axle.load)
    share = Fz / axle.load * mu
    Ky = axle.stiffness_y * (1.0 + axle.stiffness_load * (Fz / axle.load - 1.0))
    Dy = axle.peak_y * share
    sy = Ky * (y[LATERAL + i] / axle.length_y) / Dy
    trail = axle.trail - axle.trail_lost * (sy * sy / (1.0 + sy * sy))
    if some(Vx < 0.0):  # backwards the trail of the tire, what large slip takes, is in front of the axis of steering
        trail = where(Vx < 0.0, trail - 2.0 * _sign(-Vx / SLOWEST) * axle.trail_lost / (1.0 + sy * sy), trail)
    Vsx = Vx - axle.rolling_radius * spin
    Vsy = across * ct - y[VX] * st - trail * turning
    return _Contact(ct, st, Vx, Vsx, Vsy, spin, mu, gap, Fz, Ky, axle.peak_x * share, Dy, trail, gear)


@kernel(inline=True)
def _slip(b, axle, at, u, v):
    """The _Slip of an axle whose tires are bent by u along and v across [m]."""
    low = b.low_speed * b.low_speed
    slow = max(1.0 - at.Vx * at.Vx / low, 0.0)
    slow *= slow
    quiet = max(1.0 - (at.Vx * at.Vx + at.Vsx * at.Vsx + at.Vsy * at.Vsy) / low, 0.0)
    quiet *= b.contact_time * quiet
    grip = LOW_SLIP * max(at.mu, LEAST_GRIP)
    kx = axle.stiffness_x / (axle.peak_x * grip) * at.Vsx
    ky = axle.stiffness_y / (axle.peak_y * grip) * at.Vsy
    sliding = (at.Vsx * at.Vsx + at.Vsy * at.Vsy) / (SLIP_BOUND * SLIP_BOUND)
    w = at.Vx * at.Vx + sliding + slow * (kx * kx + ky * ky)
    fading = w / np.sqrt(w + QUIET_SPEED * QUIET_SPEED)
    kappa = (u - quiet * at.Vsx) / axle.length_x
    tan = (v - quiet * at.Vsy) / axle.length_y
    return _Slip(kappa, tan, fading / axle.length_x, fading / axle.length_y, quiet)


@kernel(inline=True)
def _characteristic(axle, at, sx, sy):
    """(Fx, Fy [N], what slip makes of the force over what its slope would) at the slips over which the forces would be
    the largest."""
    size = np.sqrt(sx * sx + sy * sy)
    share = 1.0
    slides = size > 1e-6
    if some(slides):
        part = sx * sx / (size * size)
        C = axle.shape_y + part * (axle.shape_x - axle.shape_y)
        E = axle.curvature_y + part * (axle.curvature_x - axle.curvature_y)
        x = size / C
        share = where(slides, np.sin(C * np.arctan(x - E * (x - np.arctan(x)))) / size, 1.0)
    return at.Dx * share * sx, at.Dy * share * sy, share


@kernel(inline=True)
def _stop(axle, wind, spin, brake):
    """The _Stop of an axle at a wind-up [rad] under a brake torque [N m]."""
    capacity = max(axle.brake * brake, 0.0)
    sliding = abs(spin) * axle.brake_stiffness / max(capacity, LEAST_TORQUE)
    winding = spin - sliding * wind
    viscous = axle.brake_damping * capacity / (capacity + abs(spin) * axle.brake_damping + 1e-9)
    stopping = axle.brake_stiffness * wind + viscous * winding
    held = 1.0
    slides = abs(stopping) > capacity
    if some(slides):
        stopping = where(slides, where(stopping > 0.0, capacity, -capacity), stopping)
        held = where(slides, 0.0, 1.0)
    release = 0.0
    excess = abs(wind) - capacity / axle.brake_stiffness
    falls = excess > 0.0  # the capacity fell
    if some(falls):
        release = where(falls, axle.brake_stiffness / axle.brake_damping, 0.0)
        winding = where(falls, winding - release * where(wind > 0.0, excess, -excess), winding)
    clockwise = where(spin > 0.0, 1.0, -1.0)
    free = 1.0 - clockwise * axle.brake_stiffness * wind / max(capacity, LEAST_TORQUE)
    return _Stop(stopping, winding, sliding, release, viscous, held, free)


@kernel(inline=True)
def _roll(axle, tread, spin, Fz):
    """The _Roll of an axle whose treads give by `tread` [m]."""
    W = spin * axle.radius
    part = (tread + axle.give_damping * W) / axle.give
    resisting = axle.resistance * Fz * axle.radius
    gives = resisting * axle.radius * axle.give_damping / axle.give
    rate = W
    rolls = not abs(part) < 1.0
    if some(rolls):
        gives = where(rolls, 0.0, gives)
        part = where(rolls, where(part > 0.0, 1.0, -1.0), part)
        rate = where(rolls, (part * axle.give - tread) / axle.give_damping, rate)
    return _Roll(resisting * part, gives, rate)


@kernel(inner=True)
def axle_forces(b, axle, road, i, y, steering, drive, brake, c, s, rates, stiff, told):
    """Rates of the states of axle i; returns its forces along and across the heading and its moment (fx, fy, mz), the
    power it dissipates, the energy it stores, and the torque that its trail turns the steering wheel back with.
    """
    at = _contact(b, axle, road, i, y, steering, c, s)
    slip = _slip(b, axle, at, y[LONG + i], y[LATERAL + i])
    sx = axle.stiffness_x * slip.kappa / at.Dx
    sy = at.Ky * slip.tan / at.Dy
    Fx, Fy, share = _characteristic(axle, at, sx, sy)
    wind = y[WIND + i]
    stop = _stop(axle, wind, at.spin, brake)
    roll = _roll(axle, y[GIVE + i], at.spin, at.Fz)
    torque = axle.drive * drive - stop.torque - roll.torque - Fx * axle.radius

    rates[TURN_F + i] = at.spin
    rates[SPIN + i] = torque / axle.inertia
    rates[LONG + i] = -at.Vsx - slip.rate_x * y[LONG + i]
    rates[LATERAL + i] = -at.Vsy - slip.rate_y * y[LATERAL + i]
    rates[WIND + i] = stop.winding
    rates[GIVE + i] = roll.rate
    slope = axle.stiffness_x * share * axle.radius / (axle.length_x * axle.inertia)
    held = stop.held * stop.viscous * max(stop.free, 0.0)
    stiff[i, 0] = -slope * slip.quiet * axle.rolling_radius - (held + roll.gives) / axle.inertia
    stiff[i, 1] = -slope
    stiff[i, 2] = -stop.held * max(axle.brake_stiffness - stop.viscous * stop.sliding, 0.0) / axle.inertia
    stiff[i, 3] = axle.rolling_radius
    stiff[i, 4] = -slip.rate_x
    stiff[i, 5] = stop.free
    stiff[i, 6] = -stop.sliding - stop.release
    stiff[i, 7] = -slip.rate_y
    column = i * len(AXLE_COLUMNS)
    told[column + FX] = Fx
    told[column + FY] = Fy
    told[column + FZ] = at.Fz
    told[column + KAPPA] = slip.kappa
    told[column + ALPHA] = slip.tan  # its tangent; whoever shows it makes an angle of it
    told[column + BRAKE] = stop.torque
    if i == 0:
        told[SATURATION] = sy * sy / (1.0 + sy * sy)
    told[FRICTION_GAP] = max(told[FRICTION_GAP], at.gap)
    along = Fx * at.ct - Fy * at.st
    sideways = Fx * at.st + Fy * at.ct
    contact = -(Fx * at.Vx + Fy * at.Vsy) + (Fx * axle.radius + roll.torque) * at.spin
    windup = axle.brake_stiffness * wind
    braked = stop.torque * at.spin - windup * stop.winding
    return along, sideways, axle.x * sideways, contact, braked, 0.5 * windup * wind, at.gear * at.trail * Fy
