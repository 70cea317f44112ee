"""Drives that are known in closed form, as signals for evaluations."""

from __future__ import annotations

import math

import numpy as np

from mbd_sim_ros.analysis.evaluation.signals import Signals

EPOCH = 1_700_000_000 * 10**9  # ns, a stamp with the time of day
L, RATIO, U, ROLL, SLIP, TORQUE = 2.7, 16.0, 0.003, 0.008, -0.004, 1.2  # of circling()


def made(t: np.ndarray, **values: np.ndarray | float) -> Signals:
    """Signals from arrays; numbers hold all the time."""
    return Signals(
        place='bag',
        t=t,
        values={k: np.broadcast_to(np.asarray(v, float), t.shape).copy() for k, v in values.items()},
        notes=[],
    )


def even(seconds: float, rate: float = 200.0) -> np.ndarray:
    return np.arange(round(seconds * rate) + 1) / rate


def circling(method: str, side: float = 1.0) -> Signals:
    """A car whose steady state is exactly linear: d/i = L k + U a, roll, sideslip and torque in proportion to a."""
    t = even(40.0, 100.0)
    if method == 'constant_radius':
        v = 8.0 + 0.3 * t
        k = np.full_like(t, 0.01)
    elif method == 'constant_speed':
        v = np.full_like(t, 22.0)
        k = 0.00025 * t
    else:
        v = 8.0 + 0.3 * t
        k = 0.4 / RATIO / (L + U * v * v)
    a = v * v * k
    return made(
        t, speed=v, yaw_rate=side * k * v, lateral_acceleration=side * a, steering=side * RATIO * (L * k + U * a),
        roll=side * ROLL * a,
        sideslip_angle=side * (0.01 + SLIP * a), steering_torque=side * (0.5 + TORQUE * a),
    )  # fmt: skip


def second_order(t: np.ndarray, gain: float, f: float, damping: float) -> np.ndarray:
    """Response of gain w^2/(s^2 + 2 D w s + w^2) to a unit step at t = 0."""
    w = 2.0 * np.pi * f
    wd = w * np.sqrt(1.0 - damping**2)
    since = np.maximum(t, 0.0)
    return gain * (1.0 - np.exp(-damping * w * since) * (np.cos(wd * since) + damping * w / wd * np.sin(wd * since)))


def stepped(side: float = 1.0, rate: float = 500.0) -> Signals:
    t = even(7.0, rate)
    since = t - 2.0
    rise = 0.1
    d = side * 0.5 * np.clip(since / rise + 0.5, 0.0, 1.0)
    yaw, lateral = (side * second_order(since, g, f, damping) for g, f, damping in ((0.3, 1.2, 0.6), (4.0, 0.9, 0.8)))
    return made(
        t,
        steering=d + 0.01,
        speed=22.0,
        yaw_rate=yaw,
        lateral_acceleration=lateral,
        sideslip_angle=side * second_order(since, -0.02, 1.0, 0.7),
        roll=side * second_order(since, 0.05, 1.1, 0.5),
    )


def dwelling(
    amplitude: float = 1.5,
    side: float = 1.0,
    rate: float = 500.0,
    ratios: tuple[float, float] = (0.3, 0.1),
    push: float = 6.0,
) -> Signals:
    """0.7 Hz, dwell 0.5 s, from t = 2 s; the yaw rate follows the steering wheel, then falls on straight lines through
    the wanted ratios; the lateral acceleration grows as push * (t - BOS), so that the car is aside by push (1.07
    s)^3/6."""
    t = even(8.0, rate)
    f, start = 0.7, 2.0
    peak_at, again = start + 0.75 / f, start + 0.75 / f + 0.5
    cos = again + 0.25 / f
    phase = (
        2.0
        * np.pi
        * f
        * np.where(
            t < peak_at,
            np.clip(t - start, 0.0, None),
            np.where(t < again, 0.75 / f, np.clip(t - 0.5 - start, None, 1.0 / f)),
        )
    )
    d = amplitude * np.sin(phase)
    yaw = 0.6 * np.sin(phase)
    yaw = np.where(
        t < again,
        yaw,
        np.interp(
            t,
            [again, cos + 0.9, cos + 1.1, cos + 1.65, cos + 1.85, 9.0],
            [-0.6, -0.6 * ratios[0], -0.6 * ratios[0], -0.6 * ratios[1], -0.6 * ratios[1], 0.0],
        ),
    )
    bos = start + math.asin(math.radians(5.0) / amplitude) / (2.0 * np.pi * f)
    lateral = push * np.clip(t - bos, 0.0, 1.3)
    return made(
        t,
        steering=side * d + 0.003,
        speed=22.2,
        yaw_rate=side * yaw - 0.002,
        lateral_acceleration=side * lateral + 0.05,
    )


def weaving(f: float = 0.2) -> Signals:
    """Ellipses: d = D sin wt, a = A sin(wt - p), r = R sin(wt - q), m = M sin(wt + u); 6.3 periods."""
    t = even(32.0, 100.0) - 0.5
    w = 2.0 * np.pi * f
    return made(
        t, steering=0.3 * np.sin(w * t), speed=27.8, lateral_acceleration=2.0 * np.sin(w * t - 0.2),
        yaw_rate=0.07 * np.sin(w * t - 0.12),
        steering_torque=3.0 * np.sin(w * t + 0.4),
    )  # fmt: skip
