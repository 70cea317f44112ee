"""Friction that changes along the road, beside the level `single_track`, which is identified on friction 1 and follows
it down to a limit: how far below it the axles have been, and how far the run went there.

On a road that is as slippery everywhere the limits themselves are smaller (solver.levels.single_track.on_friction). If
only a part of it is, the slips and accelerations reached there count for so many times as much. It is looked at every
LOOK of simulated time.
"""

from __future__ import annotations

import math

import numpy as np

from solver.elements.road import RoadSpec, RoadTable, road_at
from solver.levels.track_tables import (
    ALPHA,
    AXLE_COLUMNS,
    KAPPA,
    VX,
    VY,
    YAW,
    YAW_RATE,
    SingleTrackTables,
    SingleTrackWork,
    TrackAxle,
    X,
    Y,
)

LOOK = 10_000_000  # ns


def varies(road: RoadSpec) -> bool:
    """True where its friction is not the same everywhere."""
    return bool(road.patches or road.maps)


def note(t: SingleTrackTables, w: SingleTrackWork, y: np.ndarray, time: float, slippery: np.ndarray) -> None:
    """Note in w.reached (of REACHED, value and time [s]) what the state y has reached by the friction under its axles,
    and in slippery (2,) how far that is below 1 and when.
    """
    c, s = math.cos(y[YAW]), math.sin(y[YAW])
    base = min(1.0, float(t.road.friction[0]))
    front, rear = (min(1.0, _under(t.road, axle, y, c, s)) for axle in (t.front, t.rear))
    if 1.0 - min(front, rear) > slippery[0]:
        slippery[:] = 1.0 - min(front, rear), time
    across, along = abs(w.rates[VY] + y[YAW_RATE] * y[VX]), abs(w.rates[VX] - y[YAW_RATE] * y[VY])
    columns, both = len(AXLE_COLUMNS), 2.0 * base / (front + rear)
    found = (
        across * both,
        max(abs(w.told[ALPHA]) * base / front, abs(w.told[columns + ALPHA]) * base / rear),
        max(abs(w.told[KAPPA]) * base / front, abs(w.told[columns + KAPPA]) * base / rear),
        0.0,
        math.sqrt(along * across) * both,
    )
    for row, value in zip(w.reached, found, strict=True):
        if value > row[0]:
            row[:] = value, time


def _under(road: RoadTable, axle: TrackAxle, y: np.ndarray, c: float, s: float) -> float:
    """The mean friction under both wheels of an axle."""
    x, z = y[X] + axle.x * c, y[Y] + axle.x * s
    sides = (road_at(road, x - side * axle.half_track * s, z + side * axle.half_track * c)[2] for side in (1.0, -1.0))
    return 0.5 * float(sum(sides))
