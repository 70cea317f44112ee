"""The g-g diagram of a drive: which accelerations it used, in which direction.

A figure is the acceleration that is exceeded for 1 % of the time; peaks of a moment are those of bumps and noise. The
envelope is the same in sectors of direction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.analysis.evaluation.drive.blocks import Estimate, not_told, quantile, stretches
from mbd_sim_ros.analysis.evaluation.drive.moments import Moments

SECTORS = 36  # of the envelope; ten times as many hold nothing each
LEAST_TIME = 0.2  # s in a sector at least; ten times as much empties most
PART = 0.99  # of the time that an acceleration is below the figure
SMALL = 0.5  # m/s^2 below which an acceleration has no direction; ten times as much is half the grip of a road


class Envelope(NamedTuple):
    """g-g diagram. ax, ay: (m,) accelerations [m/s^2]. figures: left, right, drive, brake [m/s^2]. edge: (k, 2) ax and
    ay of the envelope."""

    ax: np.ndarray
    ay: np.ndarray
    figures: dict[str, Estimate]
    edge: np.ndarray


def envelope(m: Moments) -> Envelope | None:
    """The diagram of a drive; None where it has neither lateral acceleration nor yaw rate."""
    s = m.s
    names: tuple[str, ...]
    if 'lateral_acceleration' in s:
        names, ay = ('lateral_acceleration',), m.smooth('lateral_acceleration')
    elif 'yaw_rate' in s:
        names, ay = ('yaw_rate', 'speed'), m.smooth('yaw_rate') * m.smooth('speed')
    else:
        return None
    ax = m.rate(m.smooth('speed'))  # without gravity, as an accelerometer has it on grades
    used = m.among('speed', *names)
    ax, ay = ax[used], ay[used]
    figures = {}
    stretch = stretches(int(used.sum()), s.rate)
    for name, values in (('left', ay), ('right', -ay), ('drive', ax), ('brake', -ax)):
        found = quantile(values, stretch, PART)
        small = not found.why and found.value < SMALL
        figures[name] = not_told(f'below {SMALL:g} m/s^2 for {100.0 * PART:g} % of the time') if small else found
    size, direction = np.hypot(ax, ay), np.arctan2(ax, ay)
    sector = np.floor((direction + math.pi) / (2.0 * math.pi) * SECTORS).astype(int) % SECTORS
    edge = []
    for k in range(SECTORS):
        inside = size[sector == k]
        if inside.size >= LEAST_TIME * s.rate:
            radius, angle = float(np.quantile(inside, PART)), (k + 0.5) / SECTORS * 2.0 * math.pi - math.pi
            edge.append((radius * math.sin(angle), radius * math.cos(angle)))
    return Envelope(ax, ay, figures, np.array(edge + edge[:1]).reshape(-1, 2))
