"""Steering box with linkage, as independent front axles of pickups and trucks had it before the rack, and many have it
still.

    subframe -revolute- pitman_arm -universal- relay_link -spherical- idler_arm -revolute- subframe
    relay_link (to the tie rods)

Without an idler arm there is no relay link either, and the rods go to the pitman arm: the drag link of a steered live
axle.

The worm is the pinion of solver.vehicle.steering; through balls and nut it turns the sector on the shaft of the pitman
arm, `ratio` times slower, against the elasticity `steering_box`. Pitman arm, relay link and idler arm are a four-bar
linkage with the frame: where the arms are parallel and equally long, the relay link moves on a circle without turning.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from solver.compiled.portable import norm
from solver.dimensions import Damping, Length, Mass, Point, Torque
from solver.elements.joint import JointSpec
from solver.elements.rigid_body import RigidBodySpec
from solver.validate import Vector, finite, require
from solver.vehicle.end_stops import plus, rotated
from solver.vehicle.hardpoints import marker_at
from solver.vehicle.parts import UP, Bushing, Link, Parts, joined, link, mounting, require_positive, rods, vector_of
from solver.vehicle.power_steering import SLOW
from solver.vehicle.steering import Column, Gear, steering_damper


@dataclass(frozen=True, kw_only=True)
class Lever:
    """An arm on a shaft: pivot, ball [m]; mass [kg] of the bar between, of the given radius [m]."""

    pivot: Point
    ball: Point
    mass: Mass
    radius: Length = 0.02

    def __post_init__(self) -> None:
        require_positive('lever', self, 'mass', 'radius')

    def body(self, name: str) -> RigidBodySpec:
        """The arm."""
        return rods(name, ((self.mass, self.pivot, self.ball, self.radius),))


@dataclass(frozen=True, kw_only=True)
class RecirculatingBall(Column):
    """Data of a steering box with linkage. ratio: turns of the worm per turn of the pitman arm. pitman, idler: arms on
    shafts along `axis`; idler_bushing: of the shaft of the idler arm, z along it (None: a bearing). link_mass [kg],
    link_radius [m]: of the relay link between their balls, with the inner tie-rod balls; both None: the rods go to the
    pitman arm. link_damping: of a steering damper between the middle of the link, or the ball of the pitman arm, and
    the frame [N s/m]."""

    kind: Literal['recirculating_ball'] = 'recirculating_ball'
    ratio: float
    pitman: Lever
    idler: Lever | None = None
    idler_bushing: Bushing | None = None
    axis: Vector = UP
    link_mass: Mass | None = None
    link_radius: Length = 0.015
    link_damping: Damping = 0.0
    friction: Torque = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive('steering', self, 'ratio', 'link_mass', 'link_radius')
        finite('steering', 'link_damping', self.link_damping, low=0.0)
        both = (self.idler is None) == (self.link_mass is None)
        require(
            both,
            'steering',
            'link_mass',
            self.link_mass,
            'belongs to a relay link to an idler arm: give both or neither',
        )
        lone = self.idler is not None or self.idler_bushing is None
        require(lone, 'steering', 'idler_bushing', 'given', 'belongs to an idler arm, which is not given')
        for name, arm in (('pitman', self.pitman), ('idler', self.idler)):
            if arm is None:
                continue
            lever = self.lever(arm)
            require(
                abs(lever) > 1e-3,
                'steering',
                name,
                lever,
                'its ball must move sideways when it turns: place it in front of or behind the pivot',
            )

    def lever(self, arm: Lever) -> float:
        """Travel of its ball along y per angle [m]."""
        axis = np.array(self.axis) / np.sqrt(np.square(self.axis).sum())
        return float(np.cross(axis, np.subtract(arm.ball, arm.pivot))[1])

    def moves(self, angle: float, arm: float) -> Vector:
        """With the ball of the pitman arm, about its shaft; a relay link hardly turns."""
        along, axis = norm(np.array(self.axis)), self.axis
        lever = plus(self.pitman.ball, -1.0, self.pitman.pivot)
        turn = angle / np.copysign(self.ratio, arm * self.lever(self.pitman))
        turned = rotated((axis[0] / along, axis[1] / along, axis[2] / along), float(turn), lever)
        return plus(turned, -1.0, lever)

    def gear(self, subframe: RigidBodySpec, arm: float) -> Gear:
        """Steering box and linkage; coordinates pitman_arm and, in a bearing, idler_arm, positive about the axis."""
        pitman, at = self.pitman.body('pitman_arm'), self.pitman.pivot
        shaft = JointSpec(
            name='pitman_arm', kind='revolute', i=marker_at(subframe, at, self.axis), j=marker_at(pitman, at, self.axis)
        )
        lever = self.lever(self.pitman)
        ratio, slow = float(np.copysign(self.ratio, arm * lever)), SLOW / abs(lever)
        damped = self.link_damping > 0.0
        if self.idler is None or self.link_mass is None:
            dampers = (steering_damper(subframe, pitman, self.pitman.ball, self.link_damping),) if damped else ()
            parts = Parts(bodies=(pitman,), joints=(shaft,), spring_dampers=dampers)
            return Gear(parts, 'steering_box', 'pitman_arm', ratio, slow, pitman)
        idler = self.idler.body('idler_arm')
        other = mounting(
            'idler_arm', subframe, idler, (self.idler.pivot,), self.idler_bushing, ideal='revolute', axis=self.axis
        )
        bar = Link(inner=self.pitman.ball, outer=self.idler.ball, mass=self.link_mass, radius=self.link_radius)
        linkage = link('relay_link', bar, pitman, idler, 'left', pin=self.axis)
        relay = linkage.bodies[0]
        middle = vector_of(0.5 * np.add(self.pitman.ball, self.idler.ball))
        dampers = (steering_damper(subframe, relay, middle, self.link_damping),) if damped else ()
        parts = joined((Parts(bodies=(pitman, idler), joints=(shaft,), spring_dampers=dampers), other, linkage))
        return Gear(parts, 'steering_box', 'pitman_arm', ratio, slow, relay)
