"""Ensembles: a run and its neighbours, whose starts are units in the last place apart.

What happens at a singular position may hang on the last bit: which of two nearly equal directions is found first,
whether one step of thousands stagnates. A verdict there is one over an ensemble, with a stated rule: limits of physics
hold for every member, counts of what rounding may cause are judged by their median.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from solver.scene import Scene

MEMBERS = 9
EPS = float(np.finfo(float).eps)


def neighbours(scene: Scene, members: int = MEMBERS) -> list[Scene]:
    """The scene and those whose start velocities, and gravity for what starts at rest, are 1, 2, ... units in the last
    place off."""
    return [_scaled(scene, 1.0 + k * EPS) for k in offsets(members)]


def offsets(members: int = MEMBERS) -> range:
    """Units in the last place: as many below as above none."""
    return range(-(members // 2), members - members // 2)


def median(values: Sequence[float]) -> float:
    """Of an odd number the one in the middle."""
    return float(np.median(values))


def _scaled(scene: Scene, factor: float) -> Scene:
    def all_of(vector: Sequence[float]) -> tuple[float, ...]:
        return tuple(factor * x for x in vector)

    bodies = tuple(
        b.replace(velocity=all_of(b.velocity), angular_velocity=all_of(b.angular_velocity)) for b in scene.model.bodies
    )
    model = dataclasses.replace(scene.model, bodies=bodies, gravity=all_of(scene.model.gravity))
    rates = {n: dataclasses.replace(c, rate=c.rate and factor * c.rate) for n, c in scene.start.coordinates.items()}
    start = dataclasses.replace(scene.start, speed=factor * scene.start.speed, coordinates=rates)
    return dataclasses.replace(scene, model=model, start=start)
