"""The map of a steering: the mean angle of the front road wheels over the angle of the steering wheel, measured on the
bench.

The bench (solver.analysis.kinematics_and_compliance) holds the chassis in its design position and turns the steering
wheel; every point is a static equilibrium without loads at the tires. So the map has what linkage and gear do to the
ratio, and not the twist that forces at the wheels cause. NODES points lie like the zeros of a Chebyshev polynomial; the
polynomial through them is the map (solver.inputs.signals.Mapped).
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from solver.analysis.kinematics_and_compliance import CORNERS, Rig
from solver.disk import derived
from solver.elements.road import RoadSpec
from solver.errors import ConsistencyError, SceneError, SpecError
from solver.inputs.signals import Constant, Jet, Mapped, signal
from solver.model.spec import ModelSpec
from solver.scene import Scene
from solver.vehicle.actuation import IN_DEGREES
from solver.vehicle.trailer import without_trailer

# Angles of the steering wheel to either side [rad] up to which the map is measured: the first that the bench reaches,
# at most the end stops.
RANGES = (8.0, 6.0, 4.0, 2.0)
NODES = 33  # points of the map; the ratio varies twice a turn, by the universal joints of the steering column
LOOKS = 2000  # instants of a maneuver at which its angle is compared with the range of the map


def steering_map(model: ModelSpec) -> Mapped:
    """Angle of the steering wheel [rad] over the mean angle of the front road wheels [rad]; measured once, then kept.

    Raises SpecError where the bench cannot steer the vehicle.
    """
    car = dataclasses.replace(without_trailer(model), road=RoadSpec())
    points = derived('road_wheel', repr(car), lambda: _measured(car))
    return Mapped(of=0.0, points=tuple((float(x), float(y)) for x, y in points))


def steering_wheel_at(road_map: Mapped, road_wheel: float) -> float:
    """Angle of the steering wheel [rad] at an angle of the road wheels [rad], which is kept within the map."""
    low, high = road_map.points[0][0], road_map.points[-1][0]
    zero = np.zeros(1)
    return float(road_map.of_jet(Jet(np.clip(np.array([road_wheel]), low, high), zero, zero)).value[0])


def by_steering_wheel(scene: Scene) -> Scene:
    """A scene whose maneuver steers by road_wheel, as one that steers by the angle of the steering wheel. Raises
    SceneError."""
    try:
        found = steering_map(scene.model)
    except SpecError as error:
        raise SceneError(f'scene {scene.name!r}: maneuver.road_wheel: {error}') from None
    wanted = signal(scene.maneuver.road_wheel)
    angles = wanted.jet(np.linspace(0.0, scene.duration, LOOKS)).value
    worst = float(angles[np.argmax(np.abs(angles))])
    low, high = found.points[0][0], found.points[-1][0]
    if not low <= worst <= high:
        beyond = f'{worst:g} rad is beyond the steering, which turns the road wheels by {low:.3g} to {high:.3g} rad'
        raise SceneError(f'scene {scene.name!r}: maneuver.road_wheel: {beyond}; {IN_DEGREES}')
    mapped = dataclasses.replace(found, of=wanted)
    return dataclasses.replace(
        scene, maneuver=dataclasses.replace(scene.maneuver, road_wheel=Constant(), steering=mapped)
    )


def _measured(model: ModelSpec) -> list[tuple[float, float]]:
    if {tire.name for tire in model.tires} != set(CORNERS) or 'steering' not in model.inputs:
        raise SpecError(f'the bench needs a vehicle with the input steering and the wheels {", ".join(CORNERS)}')
    lock = math.inf if model.lock is None else model.lock
    for largest in dict.fromkeys(min(each, lock) for each in RANGES):
        angles = [-largest * math.cos(math.pi * (k + 0.5) / NODES) for k in range(NODES)]
        try:
            curves = Rig(model).steering(angles)
        except ConsistencyError:
            continue
        road = 0.5 * (curves['front_left']['steer'] + curves['front_right']['steer'])
        if np.all(np.diff(road) > 0.0):
            return [(float(x), s) for x, s in zip(road, angles, strict=True)]
    raise SpecError(f'the bench cannot turn the steering wheel by {RANGES[-1]:g} rad to either side')
