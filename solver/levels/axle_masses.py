"""Masses that move with the wheels of an axle: one of each wheel, and one that they share, on a beam between them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from solver.elements.coordinate import CoordinateSpec
from solver.elements.coupler import CouplerSpec
from solver.elements.joint import JointSpec
from solver.elements.rigid_body import RigidBodySpec
from solver.vehicle.hardpoints import SIDES, marker_at
from solver.vehicle.parts import LEFTWARDS, UP, vector_of

# of the mass that moves with a wheel: below it what moves with both wheels of an axle is no body of its own
SHARED = 0.05
FORWARDS = (1.0, 0.0, 0.0)


class AxleMasses(NamedTuple):
    """Masses [kg] of the left and the right wheel, and what is in the middle between their centres."""

    wheels: tuple[float, float]
    shared: float


class Beam(NamedTuple):
    """Beam that stands for a mass that both wheels of an axle share."""

    body: RigidBodySpec
    joints: tuple[JointSpec, ...]
    coupler: CouplerSpec
    coordinates: tuple[CoordinateSpec, ...]


def beam(name: str, mass: float, chassis: RigidBodySpec, ends: Sequence[tuple[RigidBodySpec, np.ndarray]]) -> Beam:
    """A mass [kg] in the middle of a line between the centres of both wheels, wherever these go: its weight and its
    inertia are on both of them in all directions, and the chassis, against which it does not turn about that line,
    feels no force of it.

    ends: left and right wheel with their centres [m]. The first coordinate is how far it goes up in the chassis.
    """
    at = vector_of(0.5 * (ends[0][1] + ends[1][1]))
    body = RigidBodySpec(name=name, mass=mass, inertia=(0.0,) * 6, position=at)
    line = marker_at(body, at, LEFTWARDS)
    names = [f'{name}_{side}' for side in SIDES]
    wheels = [marker_at(wheel, vector_of(center)) for wheel, center in ends]
    along = tuple(
        CoordinateSpec(name=n, kind='translation', i=line, j=wheel) for n, wheel in zip(names, wheels, strict=True)
    )
    up = marker_at(chassis, at, UP)
    return Beam(
        body,
        (
            *(JointSpec(name=n, kind='point_on_line', i=line, j=wheel) for n, wheel in zip(names, wheels, strict=True)),
            JointSpec(name=f'{name}_level', kind='perpendicular', i=up, j=marker_at(body, at, FORWARDS)),
        ),
        CouplerSpec(name=name, terms=tuple((n, 1.0) for n in names), offset=0.0),
        (CoordinateSpec(name=name, kind='translation', i=up, j=line), *along),
    )


def divided(J: np.ndarray, own: np.ndarray, other: np.ndarray, moved: np.ndarray, beside: float) -> AxleMasses:
    """The masses that have a given mass matrix over both travels.

    J (2,): inertia of a wheel about a diameter [kg m^2]. own, other (2, 4): slopes of x, y, psi, gamma of a wheel over
    its own travel s and over that of the other one, o. moved (2,), beside: the mass matrix, on its diagonal and beside
    it [kg]. On its diagonal wheels have m (1 + X_s^2 + Y_s^2 + X_o^2 + Y_o^2) + J (Psi_s^2 + Gamma_s^2 + Psi_o^2 +
    Gamma_o^2), slopes over o of the other wheel, and beside it the sum over both of m (X_s X_o + Y_s Y_o) + J (Psi_s
    Psi_o + Gamma_s Gamma_o). To that the shared mass adds, of the slopes (x, y, 1/2) of the middle over either travel,
    its part of their squares, and beside it of their product.
    """
    squares = [np.add.reduce(x * x, axis=1) for x in (own[:, :2], own[:, 2:], other[::-1, :2], other[::-1, 2:])]
    along, turned = 1.0 + squares[0] + squares[2], J * squares[1] + J[::-1] * squares[3]
    cross = np.add.reduce(own * other, axis=0)
    across = float(np.add.reduce(J * np.add.reduce(own[:, 2:] * other[:, 2:], axis=1)))
    moving = float(cross[0] + cross[1])
    middle = 0.5 * (own[:, :2] + other[::-1, :2])
    on, between = 0.25 + np.add.reduce(middle * middle, axis=1), 0.25 + float(np.add.reduce(middle[0] * middle[1]))
    # mass a + shared b = diagonal, mass moving + shared between = beside, of the mean of both wheels
    a, b = 0.5 * float(along[0] + along[1]), 0.5 * float(on[0] + on[1])
    diagonal, beside = 0.5 * float(moved[0] + moved[1] - turned[0] - turned[1]), beside - across
    shared = (a * beside - moving * diagonal) / (a * between - moving * b)
    if shared < SHARED * float(moved[0] + moved[1]):
        shared = 0.0
    left, right = ((moved - turned - shared * on) / along).tolist()
    return AxleMasses((left, right), shared)
