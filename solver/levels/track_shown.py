"""Outputs of a single-track model, the account of its energy, and its largest values so far
(solver.levels.track_step)."""

from __future__ import annotations

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.select import some, where
from solver.levels.track_tables import (
    ALPHA,
    AXLE_COLUMNS,
    BRAKE,
    DRAG,
    DRIVE,
    ENERGY,
    FRICTION_GAP,
    GROSS,
    KAPPA,
    KINETIC,
    LOSS,
    ROLL,
    ROLL_RATE,
    SHIFT,
    SPIN,
    SUPPLIED,
    TURN_F,
    VX,
    VY,
    WHEEL_TORQUE,
    YAW,
    YAW_RATE,
    X,
    Y,
)
from solver.output.energy import show_energies, widen


@kernel(inner=True)
def keep_account(told, y, h, account):
    """Advance the running account by a step h (h = 0 starts it); the integrals are those of the state."""
    energy = told[ENERGY]
    kinetic = told[KINETIC]
    potential = energy - kinetic
    if h == 0.0:
        account.numbers[:] = 0.0
        account.reference[0] = energy
        account.kinetic[0] = account.kinetic[1] = kinetic
        account.potential[0] = account.potential[1] = potential
    account.time[0] += h
    account.steps[0] += 1.0
    account.work[0] = y[LOSS]
    account.gross[0] = y[GROSS]
    account.energy[0] = energy
    if account.flow.shape[0] > 0:
        account.flow[0], account.flow[2] = told[SUPPLIED], kinetic
    widen(account.kinetic, kinetic)
    widen(account.potential, potential)
    account.speed[0] = max(account.speed[0], abs(y[VX]), abs(y[VY]))
    account.speed[1] = max(account.speed[1], abs(y[SPIN]), abs(y[SPIN + 1]))
    error = abs(energy - account.reference[0] + y[LOSS])
    worse = error > account.worst[0]
    if some(worse):
        account.worst[0] = where(worse, error, account.worst[0])
        account.worst_at[0] = where(worse, account.time[0], account.worst_at[0])


@kernel(inner=True)
def note(reached, k, value, time):
    """Remember the largest value and its time."""
    further = value > reached[k, 0]
    if some(further):
        reached[k, 0] = where(further, value, reached[k, 0])
        reached[k, 1] = where(further, time, reached[k, 1])


@kernel(inner=True)
def keep_reached(y, rates, told, time, reached):
    """Note how far the run went: what the limits of the model are about."""
    along = abs(rates[VX] - y[YAW_RATE] * y[VY])
    across = abs(rates[VY] + y[YAW_RATE] * y[VX])
    note(reached, 0, across, time)
    note(reached, 4, np.sqrt(along * across), time)
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
def show(t, y, rates, told, steering, u, account, frame):
    """Assign the OutputArrays of a state: joints steering_wheel and the wheels in the order front left, right, rear
    left, right; energies from the account."""
    m = t.mounting
    c = np.cos(y[YAW])
    s = np.sin(y[YAW])
    phi = y[ROLL]
    theta = m.pitch + m.pitch_by_shift * y[SHIFT] + m.pitch_by_drive * y[DRIVE] + m.pitch_by_roll * phi * phi
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
    pitching = (
        m.pitch_by_shift * rates[SHIFT] + m.pitch_by_drive * rates[DRIVE] + 2.0 * m.pitch_by_roll * phi * y[ROLL_RATE]
    )
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
    show_energies(account, frame)
