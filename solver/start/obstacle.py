"""Kerbs and steps of the road under or before the wheels of a vehicle whose start fails: a contact at a point cannot
roll over them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.portable import norm
from solver.elements.footprint import footprint
from solver.elements.road import envelops, nodes_at, surface_at
from solver.elements.road_grids import RandomRoad
from solver.elements.tire_data import DEFAULT_WIDTH
from solver.elements.tire_pacejka import TIRES, TireSpec
from solver.model.frames import matrix
from solver.model.tables import Model

# places in a radius of a wheel at which the road is looked at; ten times as many would find the same edges more slowly
LOOKS = 60.0
# of the steepest slope of an edge, from which on the road belongs to it; 1 would leave nothing of its height
EDGE = 0.1
LEAST = 0.05  # of the radius of a wheel: a lower edge is no reason why a start fails


class _Edge(NamedTuple):
    """height [m] of an edge, negative downwards; distance [m] of its middle from the centre of the wheel, positive
    ahead or to the left."""

    height: float
    distance: float
    wheel: str
    along: bool


def edge_at_wheels(model: Model, q: np.ndarray, chassis: int, ahead: float) -> str:
    """The sentence about the highest edge of the road at the wheels, or nothing where there is none that they touch at
    a point.

    q (nb + 1, 7): the placement of the bodies. chassis: its index. ahead [m]: how far the wheels roll while the start
    is sought. An edge is a hollow that is rounder than the wheel, under it or within its radius of where it rolls.
    """
    road = model.spec.road
    if not model.spec.tires:
        return ''
    base = footprint([tire.data for tire in model.spec.tires])
    assert base is not None
    touched = [
        g
        for g, enveloped in zip(road.grids, envelops(road, base), strict=True)
        if not enveloped and not isinstance(g, RandomRoad)
    ]
    if not touched:
        return ''
    table = Ref(model.elements[TIRES.name].value.road)
    forward = matrix(tuple(q[chassis, 3:]))[:2, 0]
    forward = forward / norm(forward)
    found: list[_Edge] = []
    for tire in model.spec.tires:
        place = q[model.body_names.index(tire.marker.body), :2]
        own, half = float(tire.data['UNLOADED_RADIUS']), 0.5 * _width(tire)
        left = np.array([-forward[1], forward[0]])
        for direction, low, high in ((forward, -own, own + ahead), (left, -half, half)):
            s = np.arange(low, high + own / LOOKS, own / LOOKS)
            x, y = (place[:, None] + s * direction[:, None]).tolist()
            z = np.array([surface_at(table, a, b)[0] for a, b in zip(x, y, strict=True)])
            one = _highest(s, z, np.sum([nodes_at(grid, np.array(x), np.array(y)) for grid in touched], axis=0), own)
            if one is not None:
                found.append(_Edge(*one, tire.name, direction is forward))
    if not found:
        return ''
    edge = max(found, key=lambda e: (round(abs(e.height), 3), -abs(e.distance)))
    what = 'kerb' if edge.height > 0.0 or not edge.along else 'step down'
    side = (
        ('before' if edge.distance > 0.0 else 'behind')
        if edge.along
        else ('left of' if edge.distance > 0.0 else 'right of')
    )
    where = f'{abs(edge.distance):.2f} m {side} the centre of' if abs(edge.distance) >= 0.01 else 'under'
    rolls = f', and the wheels roll {ahead:.2g} m ahead while the car settles at its speed' if ahead > 0.0 else ''
    return (
        f'a {what} of {1e3 * abs(edge.height):.3g} mm is {where} wheel {edge.wheel!r}{rolls}; the tires touch it at a '
        'point (road.contact: '
        'point), which cannot roll over an edge: set road.contact: enveloping, or start further away from it'
    )


def _width(tire: TireSpec) -> float:
    """Width of a tire [m]."""
    return float(tire.data['WIDTH']) or DEFAULT_WIDTH * float(tire.data['UNLOADED_RADIUS'])


def _highest(s: np.ndarray, z: np.ndarray, nodes: np.ndarray, radius: float) -> tuple[float, float] | None:
    """(height [m], place of the middle [m]) of the steepest edge in a profile z (n,) over s (n,) [m], where there is
    one that is rounder than a wheel of this radius [m]. nodes (n,): the profile between straight lines, without what a
    spline swings beyond an edge."""
    slope = np.diff(z) / np.diff(s)
    if not len(slope) > 1 or np.abs(np.diff(slope)).max() / (s[1] - s[0]) <= 1.0 / radius:
        return None
    k = int(np.argmax(np.abs(slope)))
    steep = slope * np.sign(slope[k]) > EDGE * abs(slope[k])
    first = k - int(np.argmin(np.append(steep[k::-1], False))) + 1
    last = k + int(np.argmin(np.append(steep[k:], False))) - 1
    height = float(nodes[last + 1] - nodes[first])
    return (height, 0.5 * float(s[first] + s[last + 1])) if abs(height) > LEAST * radius else None
