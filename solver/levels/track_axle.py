"""An axle of a single-track model: slips, forces, torques about its axis (the formulas stand in solver.levels.track_step)."""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import kernel
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
    return 1.0 if x >= 1.0 else (-1.0 if x <= -1.0 else x * (1.5 - 0.5 * x * x))


@kernel(inner=True)
def axle_forces(b, axle, road, i, y, steering, drive, brake, c, s, rates, stiff, told):
    """Rates of the states of axle i; returns its forces along and across the heading and its moment (fx, fy, mz), the power it dissipates,
    the energy it stores, and the torque that its trail turns the steering wheel back with.
    """
    # kinematics
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
    Vsx = Vx - axle.rolling_radius * spin
    mu, gap = _friction(road, axle, y[X] + axle.x * c, y[Y] + axle.x * s, c, s)
    Fz = max(axle.load + axle.shifted * y[SHIFT], LEAST_LOAD * axle.load)
    share = Fz / axle.load * mu
    Ky = axle.stiffness_y * (1.0 + axle.stiffness_load * (Fz / axle.load - 1.0))
    Dx = axle.peak_x * share
    Dy = axle.peak_y * share
    u = y[LONG + i]
    v = y[LATERAL + i]
    tan = v / axle.length_y
    sy = Ky * tan / Dy
    trail = axle.trail - axle.trail_lost * (sy * sy / (1.0 + sy * sy))
    if Vx < 0.0:  # backwards the trail of the tire, what large slip takes, is in front of the axis of steering
        trail -= 2.0 * _sign(-Vx / SLOWEST) * axle.trail_lost / (1.0 + sy * sy)
    Vsy = across * ct - y[VX] * st - trail * turning

    # slips
    low = b.low_speed * b.low_speed
    slow = max(1.0 - Vx * Vx / low, 0.0)
    slow *= slow
    quiet = max(1.0 - (Vx * Vx + Vsx * Vsx + Vsy * Vsy) / low, 0.0)
    quiet *= b.contact_time * quiet
    grip = LOW_SLIP * max(mu, LEAST_GRIP)
    kx = axle.stiffness_x / (axle.peak_x * grip) * Vsx
    ky = axle.stiffness_y / (axle.peak_y * grip) * Vsy
    w = Vx * Vx + (Vsx * Vsx + Vsy * Vsy) / (SLIP_BOUND * SLIP_BOUND) + slow * (kx * kx + ky * ky)
    fading = w / np.sqrt(w + QUIET_SPEED * QUIET_SPEED)
    rate_x = fading / axle.length_x
    rate_y = fading / axle.length_y
    kappa = (u - quiet * Vsx) / axle.length_x
    tan = (v - quiet * Vsy) / axle.length_y

    # characteristic
    sx = axle.stiffness_x * kappa / Dx
    sy = Ky * tan / Dy
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
    tread = y[GIVE + i]
    W = spin * axle.radius
    part = (tread + axle.give_damping * W) / axle.give
    resisting = axle.resistance * Fz * axle.radius
    gives = 0.0
    if abs(part) < 1.0:
        gives = resisting * axle.radius * axle.give_damping / axle.give
        rates[GIVE + i] = W
    else:
        part = 1.0 if part > 0.0 else -1.0
        rates[GIVE + i] = (part * axle.give - tread) / axle.give_damping
    resisting *= part
    torque = axle.drive * drive - stopping - resisting - Fx * axle.radius

    rates[TURN_F + i] = spin
    rates[SPIN + i] = torque / axle.inertia
    rates[LONG + i] = -Vsx - rate_x * u
    rates[LATERAL + i] = -Vsy - rate_y * v
    rates[WIND + i] = winding
    slope = axle.stiffness_x * share * axle.radius / (axle.length_x * axle.inertia)
    clockwise = 1.0 if spin > 0.0 else -1.0
    free = 1.0 - clockwise * axle.brake_stiffness * wind / max(capacity, LEAST_TORQUE)
    stiff[i, 0] = -slope * quiet * axle.rolling_radius - (held * viscous * max(free, 0.0) + gives) / axle.inertia
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
    if i == 0:
        told[SATURATION] = sy * sy / (1.0 + sy * sy)
    told[FRICTION_GAP] = max(told[FRICTION_GAP], gap)
    along = Fx * ct - Fy * st
    sideways = Fx * st + Fy * ct
    contact = -(Fx * Vx + Fy * Vsy) + (Fx * axle.radius + resisting) * spin
    windup = axle.brake_stiffness * wind
    braked = stopping * spin - windup * winding
    back = gear * trail * Fy
    return along, sideways, axle.x * sideways, contact, braked, 0.5 * windup * wind, back
