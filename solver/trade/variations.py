"""Maneuvers beside the one that a scene has: another amplitude, speed, friction, direction, and another road of the
same class.

The ranges are part of a certificate: what was found holds within them. Their corners serve to choose, points inside to
check. What a scene does not have is not varied (the path of a driver has no amplitude, a lane change no other side),
and a maneuver that is driven twice counts once: `effective` says what of a variation changes anything.

A mechanism has no steering and no road. The amplitude is that of its inputs, as far as they begin at zero (others would
place it anew), the speed that of its start; one that begins at rest and has no inputs falls as much faster, under
gravity times the square of that.
"""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from solver.elements.road import RandomRoad, RoadSpec
from solver.inputs.command_filter import BY_WHEEL, COMMANDS, STEERING
from solver.inputs.driver import Circle, Course, Waypoints
from solver.inputs.maneuver import Maneuver
from solver.inputs.signals import Constant, Mapped, Signal, Sum, signal
from solver.scene import Scene

RANGES = {'amplitude': (0.8, 1.05), 'speed': (0.9, 1.05), 'friction': (0.9, 1.0)}
BASES = {'amplitude': 2, 'speed': 3, 'friction': 5, 'direction': 7}  # of the Halton sequence
TORQUE = STEERING['torque']
# fields of signals that scale with them
SIZES = ('value', 'initial', 'final', 'slope', 'amplitude', 'final_amplitude', 'offset')


class Variation(NamedTuple):
    """Factors on the amplitude of the steering, angle or torque (of drive and brakes where nothing is steered, of the
    inputs of a mechanism), on the speed and the friction; direction -1: to the other side; road: added to the seed of
    random roads."""

    amplitude: float = 1.0
    speed: float = 1.0
    friction: float = 1.0
    direction: int = 1
    road: int = 0

    def __str__(self) -> str:
        side = ', mirrored' if self.direction < 0 else ''
        road = f', road {self.road}' if self.road else ''
        return f'amplitude {self.amplitude:.3g}, speed {self.speed:.3g}, friction {self.friction:.3g}{side}{road}'


AS_GIVEN = Variation()
CORNERS = (
    Variation(RANGES['amplitude'][1], RANGES['speed'][1], RANGES['friction'][0], 1, 1),
    Variation(RANGES['amplitude'][0], RANGES['speed'][0], RANGES['friction'][1], -1, 2),
)


def inside(k: int) -> Variation:
    """Point k = 0, 1, ... of a sequence that fills the ranges evenly (Halton's)."""

    def halton(base: int) -> float:
        found, share, n = 0.0, 1.0, k + 1
        while n:
            share /= base
            n, digit = divmod(n, base)
            found += share * digit
        return found

    def within(name: str) -> float:
        low, high = RANGES[name]
        return low + (high - low) * halton(BASES[name])

    direction = 1 if halton(BASES['direction']) < 0.5 else -1
    return Variation(within('amplitude'), within('speed'), within('friction'), direction, 3 + k)


def varied(scene: Scene, v: Variation) -> Scene:
    """The scene with another maneuver. A path that cannot be mirrored stays; so does a road of given heights."""
    if not scene.model.tires:
        return _of_mechanism(scene, v)
    maneuver, mirrorable = _maneuver(scene.maneuver, v)
    kept = maneuver.speed
    if kept is not None and kept.target is not None:
        maneuver = dataclasses.replace(
            maneuver, speed=dataclasses.replace(kept, target=scaled(signal(kept.target), v.speed))
        )
    mirrored = v.direction < 0 and mirrorable
    model = dataclasses.replace(scene.model, road=_road(scene.model.road, v.friction, mirrored, v.road))
    start = dataclasses.replace(scene.start, speed=scene.start.speed * v.speed)
    return dataclasses.replace(scene, model=model, start=start, maneuver=maneuver, resolved='')


def effective(scene: Scene, v: Variation) -> Variation:
    """The variation without what changes nothing in the scene, so that two that lead to the same maneuver are equal."""
    for name, given in AS_GIVEN._asdict().items():
        without = v._replace(**{name: given})
        if without != v and _driven(varied(scene, without)) == _driven(varied(scene, v)):
            v = without
    return v


def ranges_of(scene: Scene) -> dict[str, tuple[float, float]]:
    """Those of RANGES that change something in the scene."""
    corners = [effective(scene, v) for v in CORNERS]
    return {
        name: ends for name, ends in RANGES.items() if any(getattr(v, name) != getattr(AS_GIVEN, name) for v in corners)
    }


def _driven(scene: Scene) -> tuple[Any, ...]:
    """Everything that a variation changes, in one form."""
    maneuver = scene.maneuver
    kept = maneuver.speed
    target = None if kept is None or kept.target is None else signal(kept.target)
    model = scene.model
    moving = [(body.velocity, body.angular_velocity) for body in model.bodies]
    return (
        scene.start,
        model.road,
        model.gravity,
        moving,
        maneuver.channels,
        signal(maneuver.road_wheel),
        maneuver.driver,
        target,
    )


def _of_mechanism(scene: Scene, v: Variation) -> Scene:
    inputs = {name: signal(one) for name, one in scene.maneuver.signals.items()}
    changed = {name: scaled(one, v.amplitude) for name, one in inputs.items() if not one.jet(np.zeros(1)).value.any()}
    wanted = scene.start.coordinates
    faster = {name: dataclasses.replace(c, rate=c.rate * v.speed) for name, c in wanted.items() if c.rate}
    model = scene.model
    if faster or scene.start.speed or any(any((*body.velocity, *body.angular_velocity)) for body in model.bodies):
        bodies = tuple(
            dataclasses.replace(
                body,
                velocity=_times(v.speed, body.velocity),
                angular_velocity=_times(v.speed, body.angular_velocity),
            )
            for body in model.bodies
        )
        model = dataclasses.replace(model, bodies=bodies)
    elif not inputs and not scene.maneuver.bag:
        model = dataclasses.replace(model, gravity=_times(v.speed**2, model.gravity))
    start = dataclasses.replace(scene.start, speed=scene.start.speed * v.speed, coordinates={**wanted, **faster})
    maneuver = (
        scene.maneuver if scene.maneuver.bag else dataclasses.replace(scene.maneuver, signals={**inputs, **changed})
    )
    return dataclasses.replace(scene, model=model, start=start, maneuver=maneuver, resolved='')


def _maneuver(maneuver: Maneuver, v: Variation) -> tuple[Maneuver, bool]:
    """(the maneuver, whether it can be mirrored)."""
    if maneuver.bag:
        return maneuver, False
    driver = maneuver.driver
    if driver is not None:
        if isinstance(driver.path, Waypoints | Course) and v.direction < 0:
            path = dataclasses.replace(driver.path, points=tuple((x, -y) for x, y in driver.path.points))
            return dataclasses.replace(maneuver, driver=dataclasses.replace(driver, path=path)), True
        if isinstance(driver.path, Circle) and v.direction < 0:
            circle = dataclasses.replace(driver.path, radius=-driver.path.radius)
            return dataclasses.replace(maneuver, driver=dataclasses.replace(driver, path=circle)), True
        return maneuver, False
    if maneuver.by_road_wheel:
        return dataclasses.replace(
            maneuver, road_wheel=scaled(signal(maneuver.road_wheel), v.amplitude * v.direction)
        ), True
    steering = signal(maneuver.steering)
    if steering != Constant():
        return dataclasses.replace(maneuver, steering=scaled(steering, v.amplitude * v.direction)), True
    given: dict[str, Any] = {name: signal(one) for name, one in maneuver.signals.items()}
    if TORQUE in maneuver.channels:
        given[TORQUE] = scaled(given[TORQUE], v.amplitude * v.direction)
        return dataclasses.replace(maneuver, signals=given), True
    given = {name: scaled(one, v.amplitude) if name.startswith(BY_WHEEL) else one for name, one in given.items()}
    torques: dict[str, Any] = {name: scaled(signal(getattr(maneuver, name)), v.amplitude) for name in COMMANDS[1:]}
    return dataclasses.replace(maneuver, signals=given, **torques), True


def _times(factor: float, vector: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = vector
    return factor * x, factor * y, factor * z


def scaled(given: Signal, factor: float) -> Signal:
    """The signal times a factor."""
    if isinstance(given, Mapped):
        return dataclasses.replace(given, points=tuple((x, factor * y) for x, y in given.points))
    if isinstance(given, Sum):
        return Sum(terms=tuple(scaled(signal(term), factor) for term in given.terms))
    changes: dict[str, Any] = {}
    for field in dataclasses.fields(given):
        value = getattr(given, field.name)
        if field.name in SIZES and value is not None:
            changes[field.name] = factor * value
        elif field.name == 'points':
            changes[field.name] = tuple((t, factor * y) for t, y in value)
    return dataclasses.replace(given, **changes)


def _road(road: RoadSpec, friction: float, mirrored: bool, seed: int) -> RoadSpec:
    patches = road.patches
    if mirrored:
        patches = tuple(dataclasses.replace(p, center=(p.center[0], -p.center[1]), yaw=-p.yaw) for p in patches)
    grids = tuple(dataclasses.replace(g, seed=g.seed + seed) if isinstance(g, RandomRoad) else g for g in road.grids)
    return dataclasses.replace(road, friction=road.friction * friction, patches=patches, grids=grids)
