"""Inertia that turns with the wheels of the level kc: that of the wheel itself, and flywheels on the chassis for rotors
behind gears."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from solver.elements.coupler import CouplerSpec
from solver.elements.joint import JointSpec
from solver.elements.rigid_body import RigidBodySpec
from solver.vehicle.hardpoints import marker_at
from solver.vehicle.parts import LEFTWARDS, vector_of

# of the angular momentum at a unit spin: twice the energy beyond it, from which on what turns is no part of the wheel
GEARED = 0.25
NOTHING = 1e-3  # of the energy of both flywheels of a wheel: one with less is none

Part = tuple[RigidBodySpec, JointSpec, CouplerSpec]


def spin_of(wheel: RigidBodySpec, across: float, data: Mapping[str, float]) -> float:
    """The inertia about its axis [kg m^2] that the wheel has at this level; across: that about a diameter; data: 'spin'
    and 'momentum' of solver.levels.maps.measured(). All that turns with it, unless that is more than a body can have,
    or turns behind gears."""
    if data['spin'] > 2.0 * across or data['spin'] - data['momentum'] > GEARED * abs(data['momentum']):
        return min(float(wheel.inertia[1]), 2.0 * across)
    return float(data['spin'])


def flywheels(
    chassis: RigidBodySpec, corner: str, center: np.ndarray, wheel: RigidBodySpec, data: Mapping[str, float]
) -> list[Part]:
    """Inertia that turns with a wheel and is not its own, as two flywheels on the chassis, one as fast as the wheel,
    one as fast the other way.

    Together they have the energy and the angular momentum of what they stand for: J n^2 and J n of a rotor that turns n
    times as fast as the wheel. With all of the energy in one, it would load the wheels in a bend n times as much as the
    rotor does."""
    energy, momentum = (data[key] - wheel.inertia[1] for key in ('spin', 'momentum'))
    if energy <= 0.0:
        return []
    momentum = max(-energy, min(momentum, energy))
    found, at = [], vector_of(center)
    for kind, ratio in (('flywheel', 1.0), ('counter', -1.0)):
        J = 0.5 * (energy + ratio * momentum)
        if NOTHING * energy < J:
            name = f'{kind}_{corner}'
            body = RigidBodySpec(name=name, mass=0.0, inertia=(0.5 * J, J, 0.5 * J, 0.0, 0.0, 0.0), position=at)
            bearing = JointSpec(
                name=name, kind='revolute', i=marker_at(chassis, at, LEFTWARDS), j=marker_at(body, at, LEFTWARDS)
            )
            found.append(
                (body, bearing, CouplerSpec(name=name, terms=((name, 1.0), (f'wheel_{corner}', -ratio)), offset=0.0))
            )
    return found
