"""States that no vehicle can be in, lean of its chassis and loads of its tires, as the library follows them.

watch.inc reads it and looks at the numbers of the snapshots that solver.analysis.envelope looks at. The places, limits
and names are taken from what would follow a run in Python, so that both follow the same.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.analysis.envelope import WINDOW, Envelope
from solver.checks.check import Check
from solver.checks.vehicle import (
    ARTICULATION,
    CROSSED,
    LEANING,
    ROLLOVER,
    STEERING_END,
    SUSPENSION,
    TIRE_LOAD,
    UNDER_ROAD,
    WHEEL_AXIS,
)
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.simulation import Simulation

# In the order of `enum check` of verdict.inc.
FOLLOWED = (STEERING_END, ARTICULATION, UNDER_ROAD, SUSPENSION, WHEEL_AXIS, CROSSED, ROLLOVER, TIRE_LOAD)
POSE = 7  # numbers of a pose
MEMORY_OF_LOADS = 7  # of `struct carried` in watch.inc


class Watch(NamedTuple):
    """parts: `struct watching` of watch.inc and the lists behind it. memory: what is followed so far, in its order.
    names: check -> names of the things it looks at; a check that looks at nothing is left out."""

    parts: bytes
    memory: np.ndarray
    names: dict[Check, list[str]]


def watch_of(simulation: Simulation) -> Watch:
    """Watches of the envelope of a simulation besides the ranges of a level."""
    envelope = Envelope(simulation)
    impossible = envelope.impossible[0] if envelope.impossible else None
    joints, limits = (impossible.joints, impossible.watches) if impossible else ([], [])
    wheels = impossible.wheels if impossible else None
    names: dict[Check, list[str]] = {}
    for one in limits:
        names.setdefault(one.check, []).append(one.where)
    of_joints = [
        (place, (STEERING_END, ARTICULATION).index(one.check), one.limit)
        for (place, _), one in zip(joints, limits, strict=False)
    ]
    of_wheels, pairs, whole = [], [], False
    if wheels is not None:
        whole, pairs = wheels.whole, wheels.pairs
        # of its own body, of the place of its contact, of the body that carries it
        pose = wheels.pose.start + POSE * np.array([wheels.own, wheels.carrier if whole else wheels.own])
        tire, radii = (
            wheels.tire.start + len(TIRE_COLUMNS) * wheels.rows + TIRE_COLUMNS.index('px'),
            [0.0] * len(wheels.names),
        )
        design = wheels.design if whole else np.zeros_like(wheels.centre)
        if whole:
            radii = [one.limit for one in limits if one.check is SUSPENSION]
        for k in range(len(wheels.names)):
            vectors = (*wheels.centre[k], *wheels.axis[k], *design[k], radii[k])
            of_wheels.append((int(pose[0, k]), int(tire[k]), int(pose[1, k]), *map(float, vectors)))
    leans = [(lean.place.start, *map(float, lean.normal)) for lean in envelope.leans]
    loads = [
        (int(place), float(end))
        for carried in envelope.carried
        for place, end in zip(carried.places, carried.ends, strict=True)
    ]
    names |= {ROLLOVER: [lean.name for lean in envelope.leans]} if leans else {}
    names |= {TIRE_LOAD: envelope.carried[0].names} if loads else {}
    watches = len(of_joints) + len(of_wheels) * (3 if whole else 1) + len(pairs)
    sums = np.zeros(len(loads) + MEMORY_OF_LOADS + len(of_wheels))
    memory = np.concatenate([[0.0, np.inf] * watches, [1.0, 0.0] * len(leans), sums])
    every = envelope.every(simulation.h_ns) if watches or leans or loads else 0
    head = (every, len(of_joints), len(of_wheels), int(whole), len(pairs), len(leans), len(loads), WINDOW, LEANING)
    return Watch(_words([head, *of_joints, *of_wheels, *pairs, *leans, *loads]), memory, names)


def _words(rows: list[tuple[int | float, ...]]) -> bytes:
    """Words of 64 bits: whole numbers and floats as they are."""
    kinds = {float: np.float64, int: np.int64}
    return b''.join(np.array(one, kinds[type(one)]).tobytes() for row in rows for one in row)
