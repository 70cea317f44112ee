"""Size of a vehicle beside a passenger car: the scale of benches and test drives that are laid out for passenger cars.

Froude similarity [Buckingham1914]: gravity is the same for all, so accelerations and angles are, too, and with lengths
grow

    time   length^(1/2)     speed   length^(1/2)     force   mass     moment   mass length     stiffness   mass / length

A car that is geometrically similar to another one, with all densities the same (mass: length^3), so drives as that one
does in slow or fast motion. Whatever lies between the bounds ORDINARY is a passenger car, whose benches stay as they
are; beyond them they follow the vehicle.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from solver.compiled.portable import norm
from solver.model.frames import matrix
from solver.model.scale import length_of, slow_speed
from solver.model.spec import ModelSpec

CORNERS = ('front_left', 'front_right', 'rear_left', 'rear_right')
# m, kg, of a compact car: a vehicle ten times as long is measured over ten times the travel
WHEELBASE, MASS = 2.65, 1413.0
# m of wheelbase and kg, racing cars to vans: what counts as a passenger car
ORDINARY = {'length': (1.2, 4.5), 'mass': (200.0, 4500.0)}


class Size(NamedTuple):
    """Size of a vehicle in units of a passenger car: length and mass; the others follow."""

    length: float = 1.0
    mass: float = 1.0

    @property
    def time(self) -> float:
        """Durations and step lengths."""
        return math.sqrt(self.length)

    @property
    def speed(self) -> float:
        """Speeds: lengths over times."""
        return math.sqrt(self.length)

    @property
    def torque(self) -> float:
        """Moments, in those of a passenger car."""
        return self.mass * self.length

    @property
    def stiffness(self) -> float:
        """Forces over lengths, in those of a passenger car."""
        return self.mass / self.length

    @property
    def ordinary(self) -> bool:
        """True where it is a passenger car in length and mass."""
        return self == Size()


def size_of(spec: ModelSpec) -> Size:
    """The size of a vehicle with wheels at the four corners; that of a passenger car where there are none."""
    x = wheels_along(spec)
    if set(x) != set(CORNERS):
        return Size()
    wheelbase = 0.5 * (x['front_left'] + x['front_right'] - x['rear_left'] - x['rear_right'])
    mass = math.fsum(b.mass for b in spec.bodies)
    return Size(_relative(wheelbase, WHEELBASE, *ORDINARY['length']), _relative(mass, MASS, *ORDINARY['mass']))


def scale_of(spec: ModelSpec) -> tuple[float, float]:
    """(characteristic length [m], speed [m/s] below which motions count as slow) of a model: of what has wheels its
    size beside a passenger car, of other mechanisms their own (solver.model.scale). A speed of 0: nothing weighs, and
    only the start can tell."""
    if wheels_along(spec):
        size = size_of(spec)
        return size.length, size.speed
    length, gravity = length_of(spec), norm(np.array(spec.gravity))
    return length, slow_speed(length, gravity, 0.0, 0.0, 1.0) if gravity > 0.0 else 0.0


def _relative(value: float, reference: float, low: float, high: float) -> float:
    return 1.0 if low <= value <= high or not value > 0.0 else value / reference


def wheels_along(spec: ModelSpec) -> dict[str, float]:
    """By tire, or by bearing where a level has no tires, the x of its wheel in the design position [m]."""
    bodies = {b.name: b for b in spec.bodies}
    markers = {tire.name: tire.marker for tire in spec.tires}
    if not markers:
        markers = {c: joint.j for joint in spec.joints for c in CORNERS if joint.name == f'wheel_{c}'}
    found = {}
    for name, marker in markers.items():
        body = bodies.get(marker.body)
        if body is not None:
            found[name] = float(
                body.position[0] + np.add.reduce(matrix(body.orientation)[0] * np.array(marker.position))
            )
    return found
