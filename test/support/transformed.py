"""A model somewhere else, turned, mirrored or in other units: the same mechanism, whose motion must be the same.

Each function takes a specification and returns another; `there` of a Transformation says where a configuration of the
first is in the second. All of it is written from the definitions in docs/conventions.md, nothing is taken from the
solver.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from solver.elements.laws import Law
from solver.elements.marker import WORLD, Marker
from solver.model.spec import ModelSpec

S = np.diag([1.0, -1.0, 1.0])


class Transformation(NamedTuple):
    """What a model becomes, and what becomes of the configurations q (nb + 1, 7) of its motion."""

    model: Callable[[ModelSpec], ModelSpec]
    there: Callable[[np.ndarray], np.ndarray]


def matrix(quaternion: Any) -> np.ndarray:
    return Rotation.from_quat(quaternion).as_matrix()


def quaternion(R: np.ndarray) -> Any:
    return tuple(float(c) for c in Rotation.from_matrix(R).as_quat())


def numbers(x: Any) -> Any:
    return tuple(float(c) for c in x)


def _markers(spec: Any, change: Callable[[Marker], Marker]) -> dict[str, Marker]:
    fields = {f.name: getattr(spec, f.name) for f in dataclasses.fields(spec)}
    return {name: change(value) for name, value in fields.items() if isinstance(value, Marker)}


def _elements(model: ModelSpec, change: Callable[[str, Any], Any]) -> ModelSpec:
    return dataclasses.replace(
        model, **{n: tuple(change(n, s) for s in specs) for n, specs in model.sections().items()}
    )


def placed_at(R: np.ndarray, d: np.ndarray) -> Transformation:
    """Everything turned by R about the origin of the world, gravity too, and moved by d [m]."""

    def marker(m: Marker) -> Marker:
        if m.body != WORLD:
            return m
        return dataclasses.replace(
            m, position=numbers(R @ m.position + d), orientation=quaternion(R @ matrix(m.orientation))
        )

    def element(section: str, s: Any) -> Any:
        if section == 'bodies':
            return s.replace(
                position=numbers(R @ s.position + d),
                orientation=quaternion(R @ matrix(s.orientation)),
                velocity=numbers(R @ s.velocity),
            )
        s = s.replace(**_markers(s, marker))
        if section == 'applied_forces' and s.frame == 'world':
            s = s.replace(force=numbers(R @ s.force), torque=numbers(R @ s.torque))
        return s

    def model(m: ModelSpec) -> ModelSpec:
        road = dataclasses.replace(m.road, point=numbers(R @ m.road.point + d), normal=numbers(R @ m.road.normal))
        return dataclasses.replace(_elements(m, element), gravity=numbers(R @ m.gravity), road=road)

    def there(q: np.ndarray) -> np.ndarray:
        turned = np.array([quaternion(R @ matrix(x[3:])) for x in q])
        return np.hstack([q[:, :3] @ R.T + d, turned])

    return Transformation(model, there)


def mirrored() -> Transformation:
    """Everything mirrored at the plane y = 0. Frames are mirrored and their y axes turned round, so they stay
    right-handed: S R S."""

    def marker(m: Marker) -> Marker:
        return dataclasses.replace(
            m, position=numbers(S @ m.position), orientation=quaternion(S @ matrix(m.orientation) @ S)
        )

    def element(section: str, s: Any) -> Any:
        if section == 'bodies':
            xx, yy, zz, xy, xz, yz = s.inertia
            placed = {'position': numbers(S @ s.position), 'orientation': quaternion(S @ matrix(s.orientation) @ S)}
            moving = {'velocity': numbers(S @ s.velocity), 'angular_velocity': numbers(-S @ s.angular_velocity)}
            return s.replace(inertia=(xx, yy, zz, -xy, xz, -yz), com=numbers(S @ s.com), **placed, **moving)
        s = s.replace(**_markers(s, marker))
        if section == 'applied_forces':
            s = s.replace(force=numbers(S @ s.force), torque=numbers(-S @ s.torque))
        # of rotations, which are all that the drafts couple: an angle changes its sign
        if section in ('couplers', 'coordinate_forces'):
            s = s.replace(terms=tuple((name, -factor) for name, factor in s.terms))
        return s

    def there(q: np.ndarray) -> np.ndarray:
        return q * (1, -1, 1, -1, 1, -1, 1)

    return Transformation(lambda m: dataclasses.replace(_elements(m, element), gravity=numbers(S @ m.gravity)), there)


def in_units(length: float, mass: float, time: float = 1.0) -> Transformation:
    """Numbers in units of 1/length m, 1/mass kg and 1/time s: length 1000 gives millimetres. Radians stay."""
    speed, force = length / time, mass * length / time**2
    moment = force * length

    def marker(m: Marker) -> Marker:
        return dataclasses.replace(m, position=numbers(length * np.array(m.position)))

    def law(given: Law | None, x: float, y: float) -> Law | None:
        if given is None:
            return None
        scaled = {'x': x * np.array(given.x), 'y': y * np.array(given.y), 'slope': y / x * np.array(given.slope)}
        return Law(**{name: numbers(values) for name, values in scaled.items()})

    def six(values: Any, per: float) -> Any:
        return numbers(np.array(values) * ([force / length / per] * 3 + [moment / per] * 3))

    def element(section: str, s: Any) -> Any:
        if section == 'bodies':
            at = {name: numbers(length * np.array(getattr(s, name))) for name in ('com', 'position')}
            at |= {
                'velocity': numbers(speed * np.array(s.velocity)),
                'angular_velocity': numbers(np.array(s.angular_velocity) / time),
            }
            return s.replace(mass=mass * s.mass, inertia=numbers(mass * length**2 * np.array(s.inertia)), **at)
        s = s.replace(**_markers(s, marker))
        match section:
            case 'joints' if s.length is not None:
                return s.replace(length=length * s.length)
            case 'contacts' if s.radius is not None:
                return s.replace(radius=length * s.radius)
            case 'spring_dampers':
                laws = {'spring': law(s.spring, length, force), 'damper': law(s.damper, speed, force)}
                return s.replace(free_length=length * s.free_length, preload=force * s.preload, **laws)
            case 'bushings':
                return s.replace(stiffness=six(s.stiffness, 1.0), damping=six(s.damping, 1.0 / time))
            case 'coordinate_forces':  # of rotations, which are all that the drafts have
                laws = {'spring': law(s.spring, 1.0, moment), 'damper': law(s.damper, 1.0 / time, moment)}
                return s.replace(preload=moment * s.preload, input_gain=moment * s.input_gain, **laws)
            case 'applied_forces':
                return s.replace(force=numbers(force * np.array(s.force)), torque=numbers(moment * np.array(s.torque)))
        return s

    def there(q: np.ndarray) -> np.ndarray:
        return q * ([length] * 3 + [1.0] * 4)

    def model(m: ModelSpec) -> ModelSpec:
        return dataclasses.replace(_elements(m, element), gravity=numbers(length / time**2 * np.array(m.gravity)))

    return Transformation(model, there)
