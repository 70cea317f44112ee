"""Leaf spring as three links: both ends of the leaf are rigid and turn on elastic hinges at the clamped middle, which
is the axle.

    chassis -eye- front half ~hinge~ axle ~hinge~ rear half -ball- shackle -pin- chassis

A leaf of uniform strength bends to a circle: with the curvature c its end of length L moves by z = c L^2/2 and comes in
by c^2 L^3/6 = 2 z^2/(3 L), as on an arc of the radius 3 L/4. So each hinge stands a quarter of the half length from the
axle, and its rate about the axis across is (3 L/4)^2 times the rate of that half. The two halves share rate and load
such that a vertical deflection does not turn the axle. Friction between leaves is not modelled: `loss` is viscous.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.dimensions import Force, Mass, Point, Stiffness, Time, TurnStiffness
from solver.elements.bushing import BushingSpec
from solver.elements.joint import JointSpec
from solver.elements.rigid_body import RigidBodySpec
from solver.validate import finite, require
from solver.vehicle.hardpoints import distance, marker_at, on_side
from solver.vehicle.parts import LEFTWARDS, Bushing, Parts, joined, mounting, rods, vector_of

HINGE = 0.25  # distance of a hinge from the seat, of the half length: see the module
RADIUS = 0.02  # of the cylinders whose inertia the halves and the shackle have [m]


@dataclass(frozen=True, kw_only=True)
class LeafSpring:
    """Data of the left spring in the design position.

    front_eye, rear_eye: its ends, seat: its middle on the axle, shackle: upper pin of the shackle [m]. rate at the seat
    [N/m], load there [N]; mass of the leaves [kg], shackle_mass [kg]. radial, lateral [N/m], twist (about the leaf) and
    bend (about the vertical) [N m/rad]: rates of each hinge. loss: damping over stiffness [s]. eye: bushing of the
    front eye, pin: of the shackle on the chassis; without them these are revolute joints.
    """

    front_eye: Point
    rear_eye: Point
    seat: Point
    shackle: Point
    rate: Stiffness
    load: Force
    mass: Mass
    shackle_mass: Mass = 1.0
    radial: Stiffness = 1.0e7
    lateral: Stiffness = 1.0e6
    twist: TurnStiffness = 1000.0
    bend: TurnStiffness = 40000.0
    loss: Time = 0.003
    eye: Bushing | None = None
    pin: Bushing | None = None

    def __post_init__(self) -> None:
        for field in ('rate', 'mass', 'shackle_mass', 'radial', 'lateral'):
            finite('leaf spring', field, getattr(self, field), low=0.0, strict=True)
        for field in ('twist', 'bend', 'loss'):
            finite('leaf spring', field, getattr(self, field), low=0.0)
        order = self.front_eye[0] > self.seat[0] > self.rear_eye[0]
        require(order, 'leaf spring', 'seat', self.seat, 'must lie between front_eye and rear_eye along x')


def leaf_spring(name: str, data: LeafSpring, chassis: RigidBodySpec, axle: RigidBodySpec, side: str) -> Parts:
    """The spring of corner `name` between chassis and axle."""
    seat = on_side(side, data.seat)
    eyes = {'front': on_side(side, data.front_eye), 'rear': on_side(side, data.rear_eye)}
    hinges = {end: vector_of((1.0 - HINGE) * np.array(seat) + HINGE * np.array(eye)) for end, eye in eyes.items()}
    arms = {end: distance(eyes[end], hinges[end]) for end in eyes}
    total = distance(eyes['front'], seat) + distance(eyes['rear'], seat)
    halves, parts = {}, []
    for end, other in (('front', 'rear'), ('rear', 'front')):
        # of rate and load, so that the moments of both hinges balance
        share = arms[other] / (arms['front'] + arms['rear'])
        mass = data.mass * distance(eyes[end], seat) / total
        body = rods(f'leaf_{end}_{name}', ((mass, eyes[end], hinges[end], RADIUS),))
        halves[end] = body
        turning = share * data.rate * arms[end] ** 2
        stiffness = (data.radial, data.lateral, data.radial, data.twist, turning, data.bend)
        # the load turns the front half up (about -y) against the axle, the rear one about +y
        moment = share * data.load * arms[end] * (1.0 if end == 'front' else -1.0)
        parts.append(
            Parts(
                bodies=(body,),
                bushings=(
                    BushingSpec(
                        name=f'leaf_{end}_hinge_{name}', i=marker_at(axle, hinges[end]), j=marker_at(body, hinges[end]),
                        stiffness=stiffness, damping=tuple(data.loss * k for k in stiffness),  # type: ignore[arg-type]
                        preload=(0.0, 0.0, 0.0, 0.0, moment, 0.0),
                    ),
                ),
            )
        )  # fmt: skip
    pin, low = on_side(side, data.shackle), eyes['rear']
    shackle = rods(f'shackle_{name}', ((data.shackle_mass, pin, low, RADIUS),))
    ball = JointSpec(
        name=f'shackle_outer_{name}', kind='spherical', i=marker_at(shackle, low), j=marker_at(halves['rear'], low)
    )
    return joined(
        (
            *parts,
            mounting(
                f'leaf_eye_{name}',
                chassis,
                halves['front'],
                (data.front_eye,),
                data.eye,
                ideal='revolute',
                side=side,
                axis=LEFTWARDS,
            ),
            Parts(bodies=(shackle,), joints=(ball,)),
            mounting(
                f'shackle_pin_{name}',
                chassis,
                shackle,
                (data.shackle,),
                data.pin,
                ideal='revolute',
                side=side,
                axis=LEFTWARDS,
            ),
        )
    )
