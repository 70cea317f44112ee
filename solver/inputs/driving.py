"""Drivers in compiled code: the laws of solver.inputs.driver and the hands of solver.inputs.command_filter, number by
number in the same order, so that a step with a driver need not come back to Python and no bit depends on that."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.kernel import kernel
from solver.inputs.driver import DoubleLaneChange, PreviewDriver, SpeedControl, Waypoints
from solver.inputs.recorded import ACCELERATION, RATE

NOBODY, LANES, SPLINE = range(3)  # who steers: nobody, one along lanes, one along a spline


class Driving(NamedTuple):
    """Drivers of a simulation. x, y, more: begins, middles and ends of lanes [m]; or points of a spline and its slopes
    there. state: reference, angle and rate of the hands [rad, rad/s], integral of the speed control [N m]. steering:
    columns of angle, rate and acceleration in the inputs; drive, brake: of torques, -1 where it has none."""

    steers: int
    x: np.ndarray
    y: np.ndarray
    more: np.ndarray
    state: np.ndarray
    steering: np.ndarray
    h: float
    preview: float
    slowest: float
    ratio: float
    wheelbase: float
    understeer: float
    limit: float
    lock: float
    omega: float
    rate_limit: float
    drive: int
    brake: int
    until: float
    release: float
    inertia: float
    bandwidth: float
    most: float
    least: float
    brakes: float


class Driven(NamedTuple):
    """Drivers of a call of many steps. wanted: (n, 2) speeds [m/s] and slopes [m/s^2] at the beginning of each."""

    driver: Ref
    wanted: np.ndarray


def driving_of(
    driver: PreviewDriver | None, speed: SpeedControl | None, names: tuple[str, ...], h: float, lock: float
) -> Ref | None:
    """The drivers by reference, at rest; None where one follows a path that only Python knows."""
    x = y = more = np.zeros(1)
    steers, steering, at = NOBODY, np.zeros(3, np.int64), {name: k for k, name in enumerate(names)}
    if driver is not None:
        if isinstance(driver.path, DoubleLaneChange):
            gates = driver.path.gates
            steers = LANES
            x, y, more = (np.array([getattr(g, of) for g in gates]) for of in ('begin', 'middle', 'end'))
        elif isinstance(driver.path, Waypoints):
            steers = SPLINE
            x, y, more = (np.array(values, float) for values in driver.path.spline)
        else:
            return None
        steering = np.array([at[name] for name in ('steering', 'steering' + RATE, 'steering' + ACCELERATION)])
    d, s = driver or _NO_DRIVER, speed or SpeedControl()
    return Ref(Driving(
        steers=steers, x=x, y=y, more=more, state=np.zeros(4), steering=steering, h=h, preview=float(d.preview),
        slowest=float(d.slowest), ratio=float(d.ratio), wheelbase=float(d.wheelbase), understeer=float(d.understeer),
        limit=float(d.limit), lock=float(lock), omega=2.0 * math.pi * d.bandwidth, rate_limit=float(d.rate_limit),
        drive=at['drive_torque'] if speed is not None else -1,
        brake=at['brake_torque'] if speed is not None and speed.brakes > 0.0 else -1,
        until=math.inf if s.until is None else float(s.until), release=float(s.release), inertia=float(s.inertia),
        bandwidth=float(s.bandwidth), most=float(s.most), least=float(s.least), brakes=float(s.brakes),
    ))  # fmt: skip


_NO_DRIVER = PreviewDriver(path=DoubleLaneChange())


@kernel(inline=True)
def larger(a, b):
    """max(a, b) of Python."""
    return b if b > a else a


@kernel(inline=True)
def smaller(a, b):
    """min(a, b) of Python."""
    return b if b < a else a


@kernel(inline=True)
def lateral(d, x):
    """y of the path [m] at x [m]."""
    if d.steers == LANES:
        y = d.y[0]
        for k in range(d.x.shape[0] - 1):
            done = smaller(larger((x - d.more[k]) / (d.x[k + 1] - d.more[k]), 0.0), 1.0)
            y += (d.y[k + 1] - d.y[k]) * (done * done * done * (10.0 + done * (6.0 * done - 15.0)))
        return y
    n = d.x.shape[0]
    at = smaller(larger(x, d.x[0]), d.x[n - 1])
    k = 0
    while k < n - 2 and d.x[k + 1] <= at:
        k += 1
    h, s = d.x[k + 1] - d.x[k], at - d.x[k]
    chord = (d.y[k + 1] - d.y[k]) / h
    c2 = (3.0 * chord - 2.0 * d.more[k] - d.more[k + 1]) / h
    c3 = (d.more[k] + d.more[k + 1] - 2.0 * chord) / (h * h)
    return d.y[k] + s * (d.more[k] + s * (c2 + s * c3))


@kernel(inline=True)
def followed(omega, x, v, r, slope, t):
    """See solver.inputs.command_filter.follow()."""
    lag = 2.0 * slope / omega
    e = x - (r - lag)
    b = v - slope + omega * e
    decay = math.exp(-omega * t)
    return r - lag + slope * t + (e + b * t) * decay, slope + (b - omega * (e + b * t)) * decay


@kernel(inline=True)
def steer(d, sight, row):
    """Advance the hands by a step; angle, rate and acceleration of the steering wheel at its end go to row."""
    place_x, place_y, heading, speed = sight
    v = larger(speed, d.slowest)
    distance = v * d.preview
    c, s = math.cos(heading), math.sin(heading)
    x, y = place_x + distance * c, place_y + distance * s
    error = (lateral(d, x) - y) * math.cos(heading)
    angle = d.ratio * (d.wheelbase + d.understeer * v * v) * 2.0 * error / (distance * distance)
    wanted = smaller(larger(smaller(larger(angle, -d.limit), d.limit), -d.lock), d.lock)
    r, x, v = d.state[0], d.state[1], d.state[2]
    gap = wanted - r
    run = smaller(abs(gap) / d.rate_limit, d.h)
    slope = d.rate_limit if gap > 0.0 else -d.rate_limit
    x, v = followed(d.omega, x, v, r, slope, run)
    r = wanted if run < d.h else r + slope * d.h
    x, v = followed(d.omega, x, v, r, 0.0, d.h - run)
    d.state[0], d.state[1], d.state[2] = r, x, v
    row[d.steering[0]], row[d.steering[1]] = x, v
    row[d.steering[2]] = d.omega * d.omega * (r - x) - 2.0 * d.omega * v


@kernel(inline=True)
def forwards(d, wanted, slope, speed, kept):
    """See solver.inputs.driver.SpeedControl: (drive torque, brake torque, integral after the step) [N m]."""
    omega = 2.0 * math.pi * d.bandwidth
    gain = 2.0 * omega * d.inertia
    error = wanted - speed
    torque = gain * error + kept + d.inertia * slope
    low = d.least - d.brakes
    if low < torque < d.most or (torque >= d.most and error < 0.0) or (torque <= low and error > 0.0):
        kept += d.h * gain * 0.5 * omega * error
    torque = smaller(larger(torque, low), d.most)
    return larger(torque, d.least), larger(d.least - torque, 0.0), kept


@kernel(inline=True)
def keep_speed(d, t, wanted, slope, speed, row):
    """Advance the speed control by a step that begins at t [s]; its torques go to row."""
    on = 1.0
    if d.until != np.inf:
        on = smaller(larger(1.0 - (t - d.until) / d.release, 0.0), 1.0)
    drive, brake = 0.0, 0.0
    if on != 0.0:
        if wanted < 0.0 or (wanted == 0.0 and speed < 0.0):
            drive, brake, kept = forwards(d, -wanted, -slope, -speed, -d.state[3])
            drive, brake, kept = 0.0 - on * drive, on * brake, -kept
        else:
            drive, brake, kept = forwards(d, wanted, slope, speed, d.state[3])
            drive, brake = on * drive, on * brake
        d.state[3] = kept
    row[d.drive] = drive
    if d.brake >= 0:
        row[d.brake] = brake


@kernel(inner=True)
def drive(d, k, wanted, slope, sight, row):
    """Inputs of step k become what the drivers do in it, all else in row (nu,) stays: once per step. sight: (x [m], y
    [m], heading [rad], speed [m/s]) at its beginning; wanted [m/s], slope [m/s^2]: of the speed then."""
    if d.steers != NOBODY:
        steer(d, sight, row)
    if d.drive >= 0:
        keep_speed(d, k * d.h, wanted, slope, sight[3], row)
