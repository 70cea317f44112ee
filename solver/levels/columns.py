"""Steering columns without bodies: two bearings with universal joints and a telescope between them. The mesh at the far
bearing, with or without a servo, is driven by the near one through the non-uniformity of the joints
(solver.elements.transmission).

Columns are found by what their joints are, not by names.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from solver.compiled.portable import product
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.joint import JointSpec
from solver.elements.servo import ServoSpec
from solver.elements.transmission import TransmissionSpec
from solver.levels.draft import Draft, unit
from solver.levels.shafts import Bearing, add_disc, bearing_of, carried, joints_of, without_disc

SAMPLES = 360  # of a turn, for the harmonics of universal joints


class Column(NamedTuple):
    """A chain of two bearings with two universal joints and a telescope between: bodies and joints from the driven end
    on."""

    wheel: str
    near: Bearing
    upper: JointSpec
    shafts: tuple[str, str]
    slide: str
    lower: JointSpec
    pinion: str
    far: Bearing


def reduced_columns(draft: Draft) -> None:
    """Take out all steering columns."""
    for column in _all_columns(draft):
        _take_column(draft, column)


def _all_columns(draft: Draft) -> list[Column]:
    driven = {
        name
        for coupler in draft.sections['couplers'].values()
        if coupler.input is not None
        for name, _ in coupler.terms
    }
    return [column for wheel in draft.bodies if (column := _column(draft, wheel, driven)) is not None]


def straight_columns(draft: Draft, *, look: bool = False) -> bool:
    """True where there are steering columns. Unless `look`, the gears are made to turn with the steering wheels,
    without joints between."""
    columns = _all_columns(draft)
    if not look:
        for column in columns:
            _take_column(draft, column)
        for mesh in list(draft.sections['transmissions'].values()):
            draft.drop('transmissions', mesh.name)
            draft.put(
                'coordinate_forces',
                CoordinateForceSpec(name=mesh.name, terms=mesh.terms, spring=mesh.spring, damper=mesh.damper),
            )
        for servo in list(draft.sections['servos'].values()):
            draft.put('servos', servo.replace(harmonics=(0.0, 0.0, 0.0, 0.0)))
    return bool(columns)


def _column(draft: Draft, wheel: str, driven: set[str]) -> Column | None:
    near, first = bearing_of(draft, wheel, 1), joints_of(draft, wheel, ('universal',))
    if near is None or len(first) != 1 or near.joint.name not in driven:
        return None
    shaft = draft.other(first[0]).body
    slides = joints_of(draft, shaft, ('prismatic',)) if shaft in draft.bodies else []
    if len(slides) != 1 or len(draft.holds(shaft)) != 2 or draft.uses(slides[0].name):
        return None
    other = draft.other(slides[0]).body
    second = joints_of(draft, other, ('universal',))
    if len(second) != 1 or len(draft.holds(other)) != 2:
        return None
    pinion = draft.other(second[0]).body
    far = bearing_of(draft, pinion, 1) if pinion in draft.bodies else None
    if far is None:
        return None
    return Column(wheel, near, draft.spec(first[0]), (shaft, other), slides[0].name, draft.spec(second[0]), pinion, far)


def _mesh(draft: Draft, angle: str) -> CoordinateForceSpec | ServoSpec | None:
    """The elastic mesh of the rotation at a far bearing with another coordinate, if that is all that is written in
    it."""
    found = [
        f
        for section in ('coordinate_forces', 'servos')
        for f in draft.sections[section].values()
        if angle in dict(f.terms)
    ]
    if len(found) != 1 or len(found[0].terms) != 2 or draft.uses(angle) != [found[0].name]:
        return None
    (mesh,) = found
    if isinstance(mesh, ServoSpec):
        return mesh if mesh.terms[1][0] == angle and not any(mesh.harmonics) else None
    return mesh if mesh.input is None and mesh.reference == 0.0 and mesh.preload == 0.0 else None


def _take_column(draft: Draft, column: Column) -> None:
    angle, driving = column.far.joint.name, column.near.joint.name
    mesh = _mesh(draft, angle)
    if mesh is None:
        return
    harmonics, sense = _harmonics(draft, column)
    (own,) = (f for name, f in mesh.terms if name == angle)
    (other,) = (term for term in mesh.terms if term[0] != angle)
    terms = (other, (driving, own * sense))
    if isinstance(mesh, ServoSpec):
        draft.put('servos', mesh.replace(terms=terms, harmonics=harmonics))
    else:
        draft.drop('coordinate_forces', mesh.name)
        spec = TransmissionSpec(
            name=mesh.name, terms=terms, harmonics=harmonics, spring=mesh.spring, damper=mesh.damper
        )
        draft.put('transmissions', spec)
    up, low = draft.placed(column.upper.i).p, draft.placed(column.lower.i).p
    axis = column.near.frame.R[:, 2]
    turning = without_disc(draft, column.pinion, column.far.frame.R[:, 2])
    for name in (column.upper.name, column.slide, column.lower.name, angle):
        draft.drop('joints', name)
    upper, lower = column.shafts
    turning += without_disc(draft, upper, unit(up - low)) + without_disc(draft, lower, unit(up - low))
    draft.merge(lower, upper)
    carried(draft, upper, column.near.base, up, column.far.base, low, draft.chassis)
    draft.merge(column.pinion, column.far.base)
    add_disc(draft, column.wheel, axis, turning)
    draft.lose(f'motion of {column.pinion}, {upper} and {lower} against each other')


def _turned(axis: np.ndarray, angle: float, v: np.ndarray) -> np.ndarray:
    """The vector turned about a unit axis."""
    return (
        math.cos(angle) * v
        + math.sin(angle) * np.cross(axis, v)
        + (1.0 - math.cos(angle)) * float(product(axis, v)) * axis
    )


def _harmonics(draft: Draft, column: Column) -> tuple[tuple[float, float, float, float], float]:
    """(a_2, b_2, a_4, b_4 [rad] of the angle at the far bearing over that at the near one, its sense of rotation).

    A universal joint keeps the pin on its body i perpendicular to the pin on j; the shaft turns about the line of the
    joint centres.
    """
    up, low = column.upper, column.lower
    shaft = unit(draft.placed(up.i).p - draft.placed(low.i).p)
    near, far = column.near.frame.R[:, 2], column.far.frame.R[:, 2]
    # pins on: the wheel and the shaft (above), the pinion and the shaft (below)
    wheel_pin, top_pin = _pins(draft, up, column.wheel)
    pinion_pin, foot_pin = _pins(draft, low, column.pinion)
    angles, before = [], (0.0, 0.0)
    for k in range(SAMPLES):
        x = 2.0 * math.pi * k / SAMPLES
        pin = _turned(near, x, wheel_pin)
        turn = _perpendicular(shaft, top_pin, pin, before[0])
        after = _perpendicular(far, pinion_pin, _turned(shaft, turn, foot_pin), before[1])
        before = (turn, after)
        angles.append(after)
    sense = 1.0 if angles[SAMPLES // 4] > 0.0 else -1.0
    rest = [sense * angle - 2.0 * math.pi * k / SAMPLES for k, angle in enumerate(angles)]

    def part(n: int) -> tuple[float, float]:
        turns = [2.0 * math.pi * n * k / SAMPLES for k in range(SAMPLES)]
        return (
            2.0 / SAMPLES * sum(r * math.sin(t) for r, t in zip(rest, turns, strict=True)),
            2.0 / SAMPLES * sum(r * math.cos(t) for r, t in zip(rest, turns, strict=True)),
        )

    return (*part(2), *part(4)), sense


def _pins(draft: Draft, joint: JointSpec, body: str) -> tuple[np.ndarray, np.ndarray]:
    """Directions of the pins of a universal joint in the design position: on the body, on the other one (x of i, y of
    j)."""
    x, y = draft.placed(joint.i).R[:, 0], draft.placed(joint.j).R[:, 1]
    return (x, y) if joint.i.body == body else (y, x)


def _perpendicular(axis: np.ndarray, pin: np.ndarray, other: np.ndarray, near: float) -> float:
    """The angle about the axis next to `near` at which the turned pin is perpendicular to the other."""
    c, s = float(product(pin, other)), float(product(np.cross(axis, pin), other))
    along = float(product(axis, pin)) * float(product(axis, other))
    assert abs(along) < 1e-9, 'a pin of a universal joint is perpendicular to its shaft'
    angle = math.atan2(-c, s)
    return angle + math.pi * round((near - angle) / math.pi)
