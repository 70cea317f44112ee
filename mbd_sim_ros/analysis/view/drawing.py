"""Drawing of a model: lines fixed on its bodies, lines between bodies, wheels. Only specifications enter; nothing is in
motion here.

A body is a star from the middle of the places where others hold it to each of them: a slider is a point, a rod a line,
an arm three lines. The body that all wheels hang on is drawn as the outline of a car instead, as long and wide as its
axles say, and a trailer behind it as the box with its inertia and a drawbar.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from solver.elements.marker import WORLD, Marker
from solver.model.frames import matrix
from solver.model.spec import ModelSpec
from solver.vehicle.trailer import HITCH, TRAILER, has_trailer

WORLD_BODY = -1  # in place of the number of a body
APART = 1e-6  # m: places that are nearer to each other are one
# The side of a saloon: x from the rear axle in wheelbases, z from the wheel centre in wheel radii, half width in half
# tracks.
SIDE = (
    (-0.30, -0.35, 0.98), (-0.34, 0.9, 1.0), (-0.32, 1.75, 0.95), (-0.10, 2.0, 0.9), (0.16, 3.2, 0.72),
    (0.52, 3.35, 0.72),
    (0.86, 2.05, 0.9), (1.24, 1.6, 0.95), (1.31, 0.8, 0.95), (1.29, -0.35, 0.95),
)  # fmt: skip


class Line(NamedTuple):
    """A line fixed on a body, between two points in its reference frame [m]."""

    body: int
    a: tuple[float, float, float]
    b: tuple[float, float, float]
    kind: str  # 'body' | 'outline'


class Between(NamedTuple):
    """A line from a point of one body to a point of another."""

    i: int
    a: tuple[float, float, float]
    j: int
    b: tuple[float, float, float]


class DrawnWheel(NamedTuple):
    """A wheel: its centre and spin axis in the reference frame of its body, radius and width [m]."""

    name: str
    body: int
    center: tuple[float, float, float]
    axis: tuple[float, float, float]
    radius: float
    width: float


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """All that is drawn of a model. bodies: their names, by number."""

    bodies: tuple[str, ...]
    lines: tuple[Line, ...]
    springs: tuple[Between, ...]
    wheels: tuple[DrawnWheel, ...]


def drawing_of(spec: ModelSpec) -> Drawing:
    """Drawing of a model."""
    number = {body.name: i for i, body in enumerate(spec.bodies)} | {WORLD: WORLD_BODY}
    wheels = []
    for tire in spec.tires:
        radius = tire.data['UNLOADED_RADIUS']
        axis = matrix(tire.marker.orientation)[:, 1]
        width = tire.data['WIDTH'] or 0.65 * radius
        wheels.append(
            DrawnWheel(tire.name, number[tire.marker.body], _point(tire.marker.position), _point(axis), radius, width)
        )
    springs = tuple(
        Between(number[s.i.body], _point(s.i.position), number[s.j.body], _point(s.j.position))
        for s in spec.spring_dampers
    )
    outlined = number[spec.chassis] if len(wheels) >= 3 and spec.chassis is not None else None
    pulled = number[TRAILER] if has_trailer(spec) else None
    turning = {wheel.body for wheel in wheels}
    lines: list[Line] = []
    held: dict[int, list[np.ndarray]] = {i: [] for i in number.values()}
    for marker in _markers(spec):
        held[number[marker.body]].append(np.array(marker.position, float))
    for body, places in held.items():
        if body == WORLD_BODY or body in turning:
            continue
        if body == outlined:
            lines += _outline(
                spec, body, [wheel for wheel in wheels if pulled is None or not wheel.name.startswith(TRAILER)]
            )
            continue
        if body == pulled:
            lines += _box(spec, body)
            continue
        own = _distinct([*places, np.array(spec.bodies[body].com, float)] if len(_distinct(places)) < 2 else places)
        if 0 < len(own) < 3:
            lines.append(Line(body, _point(own[0]), _point(own[-1]), 'body'))
        elif len(own) > 2:
            middle = _point(np.mean(own, axis=0))
            lines += [Line(body, middle, _point(place), 'body') for place in own]
    return Drawing(
        bodies=tuple(body.name for body in spec.bodies), lines=tuple(lines), springs=springs, wheels=tuple(wheels)
    )


def _markers(spec: ModelSpec) -> Iterator[Marker]:
    """The markers of everything that holds bodies."""
    for section, specs in spec.sections().items():
        if section not in ('bodies', 'tires'):
            for one in specs:
                yield from _markers_in(one)


def _markers_in(value: Any) -> Iterator[Marker]:
    if isinstance(value, Marker):
        yield value
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        for f in dataclasses.fields(value):
            yield from _markers_in(getattr(value, f.name))
    elif isinstance(value, tuple | list):
        for item in value:
            yield from _markers_in(item)


def _distinct(places: list[np.ndarray]) -> list[np.ndarray]:
    own: list[np.ndarray] = []
    for place in places:
        if all(np.linalg.norm(place - other) > APART for other in own):
            own.append(place)
    return own


def _outline(spec: ModelSpec, chassis: int, wheels: list[DrawnWheel]) -> list[Line]:
    """The outline of a car on its chassis, from where the wheels are in the design position."""
    frame = spec.bodies[chassis]
    to_world = matrix(frame.orientation)
    centers = []
    for wheel in wheels:
        body = spec.bodies[wheel.body]
        world = np.array(body.position) + matrix(body.orientation) @ np.array(wheel.center)
        centers.append(to_world.T @ (world - np.array(frame.position)))
    at = np.array(centers)
    rear, front = at[:, 0].min(), at[:, 0].max()
    half, z, radius = np.abs(at[:, 1]).max(), at[:, 2].mean(), max(wheel.radius for wheel in wheels)
    sides = []
    for sign in (1.0, -1.0):
        sides.append([_point((rear + x * (front - rear), sign * w * half, z + up * radius)) for x, up, w in SIDE])
    lines = [Line(chassis, side[k], side[(k + 1) % len(side)], 'outline') for side in sides for k in range(len(side))]
    return lines + [Line(chassis, left, right, 'outline') for left, right in zip(*sides, strict=True)]


def _box(spec: ModelSpec, body: int) -> list[Line]:
    """The box with the mass and the moments of inertia of a trailer, and its drawbar: from the lower edge in front to
    the coupling."""
    own = spec.bodies[body]
    around = np.array(own.inertia[:3])
    half = np.sqrt(np.maximum(1.5 * (around.sum() - 2.0 * around) / own.mass, 0.0))
    corners = [
        [_point(own.com + half * (x, y, z)) for y, z in ((1, -1), (1, 1), (-1, 1), (-1, -1))] for x in (1.0, -1.0)
    ]
    lines = [Line(body, face[k], face[(k + 1) % 4], 'outline') for face in corners for k in range(4)]
    lines += [Line(body, front, rear, 'outline') for front, rear in zip(*corners, strict=True)]
    ball = next(_point(joint.j.position) for joint in spec.joints if joint.name == HITCH)
    return lines + [Line(body, ball, corners[0][k], 'outline') for k in (0, 3)]


def _point(values: Any) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
