"""Size of a model: the length that distances and turns are compared by, and the speed below which its motions count as
slow.

A mechanism has the same motion and the same verdict in metres and millimetres, kilograms and grams, seconds and hours:
what has nothing else in a run to be compared with is compared with these. A vehicle has both by its size, a passenger
car 1 m and 1 m/s (solver.vehicle.size).
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from solver.compiled.portable import norm
from solver.elements.marker import Marker
from solver.model.spec import ModelSpec
from solver.units import MODEL_GRAVITY

LENGTHS = ('length', 'free_length', 'radius')  # fields of elements
# in which what rests at its start passes its own length: slower counts as slow; with ten times as many a tenth of it
# does
STEPS = 1000.0
# lengths in a step: what is slower at the start rests there; ten times as much would take creep for rest
RESTING = 1e-6


def length_of(spec: ModelSpec) -> float:
    """Characteristic length [m] of a mechanism: the largest distance from a centre of mass to where something is
    attached, radius of gyration or length of an element; of point masses alone their distance. 1 m where there is no
    length at all."""
    com = {body.name: np.array(body.com) for body in spec.bodies}
    found = [math.sqrt(0.5 * sum(body.inertia[:3]) / body.mass) for body in spec.bodies if body.mass > 0.0]
    for name, elements in spec.sections().items():
        for element in elements if name != 'bodies' else ():
            for field in dataclasses.fields(element):
                value = getattr(element, field.name)
                if isinstance(value, Marker) and value.body in com:
                    found.append(norm(np.array(value.position) - com[value.body]))
                elif field.name in LENGTHS and isinstance(value, float | int):
                    found.append(abs(float(value)))
    length = max(found, default=0.0)
    if not length > 0.0:
        places = np.array([body.position for body in spec.bodies]).reshape(-1, 3)
        length = max((norm(place - places[0]) for place in places), default=0.0)
    return length if length > 0.0 else 1.0


def slow_speed(length: float, gravity: float, speed: float, acceleration: float, h: float) -> float:
    """Speed [m/s] below which motions of a mechanism of that length [m] count as slow.

    That of its fall under gravity [m/s^2], by Froude's number: 1 m/s of a model of 1 m under MODEL_GRAVITY. Where
    nothing weighs: its largest speed at the start, or what the acceleration at the start [m/s^2] gives it; where it
    rests there, its length in STEPS steps of h [s].
    """
    if gravity > 0.0:
        return math.sqrt(length * gravity / MODEL_GRAVITY)
    found = max(speed, math.sqrt(length * acceleration))
    return found if found > RESTING * length / h else length / (STEPS * h)
