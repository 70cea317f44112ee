"""Measures that evaluations share: crossings and peaks between samples, straight lines, filters without delay."""

from __future__ import annotations

import math

import numpy as np


def crossing(t: np.ndarray, y: np.ndarray, level: float, *, after: float = -math.inf) -> float:
    """When y first reaches the level from below, on a straight line between two samples; NaN if it never does."""
    begin = int(np.searchsorted(t, after))
    at = np.flatnonzero(y[begin:] >= level)
    if at.size == 0:
        return math.nan
    k = begin + int(at[0])
    if k == 0 or y[k - 1] >= level:
        return float(t[k])
    return float(t[k - 1] + (level - y[k - 1]) / (y[k] - y[k - 1]) * (t[k] - t[k - 1]))


def applied(t: np.ndarray, y: np.ndarray, level: float) -> float:
    """When a command first reaches the level from below; NaN if it never does.

    A command holds: where it jumps by more than half of its largest value from one sample to the next, nothing was
    applied until the latter. A pedal that takes longer lies on a straight line between the two.
    """
    at = np.flatnonzero(y >= level)
    if at.size and at[0] > 0 and y[at[0]] - y[at[0] - 1] > 0.5 * float(y.max()):
        return float(t[at[0]])
    return crossing(t, y, level)


def peak(t: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """(time, value) of the largest value, on the parabola through the largest sample and its neighbours (evenly spaced
    t)."""
    k = int(np.argmax(y))
    if k in (0, y.size - 1):
        return float(t[k]), float(y[k])
    a, b, c = y[k - 1], y[k], y[k + 1]
    bend = a - 2.0 * b + c
    shift = 0.0 if bend == 0.0 else 0.5 * (a - c) / bend
    return float(t[k] + shift * (t[k + 1] - t[k])), float(b - 0.25 * (a - c) * shift)


def line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """(slope, value at x = 0) of the straight line of least squares."""
    mean = x.mean()
    d = x - mean
    slope = float(d @ (y - y.mean()) / (d @ d))
    return slope, float(y.mean() - slope * mean)


def at(t: np.ndarray, y: np.ndarray, when: float) -> float:
    """y between two samples; NaN outside."""
    return float(np.interp(when, t, y)) if t[0] <= when <= t[-1] else math.nan


def low_passed(y: np.ndarray, rate: float, corner: float, *, poles: int = 12) -> np.ndarray:
    """Butterworth filter run forward and backward: no phase, `poles` in both directions together. As it is where rate <
    2.5 corner."""
    if rate < 2.5 * corner or y.size < 10:
        return y
    from scipy import signal  # half a second, for those who need it

    sections = signal.butter(poles // 2, corner, fs=rate, output='sos')
    return signal.sosfiltfilt(sections, y, padlen=min(y.size - 1, round(3.0 * rate / corner)))


def integral(t: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Running integral from the first sample on, by the trapezoidal rule."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (y[1:] + y[:-1]) * np.diff(t))])


def fundamental(t: np.ndarray, y: np.ndarray, frequency: float) -> complex:
    """Complex amplitude c of Re(c exp(i w t)) in y, by least squares beside a constant: |c| is the amplitude, its angle
    the phase."""
    w = 2.0 * math.pi * frequency
    basis = np.column_stack([np.cos(w * t), np.sin(w * t), np.ones_like(t)])
    a, b, _ = np.linalg.lstsq(basis, y, rcond=None)[0]
    return complex(a, -b)
