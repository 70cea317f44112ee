"""A mechanism in the making: bodies, joints and elements by where they are in the world, as the text of a scene
file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from solver.files.scene import load_scene_text
from solver.model.frames import frame_of_axis, quaternion
from solver.scene import Scene
from solver.step.settings import IntegratorSettings
from solver.units import MODEL_GRAVITY

WORLD = 'world'
Vector = Sequence[float] | np.ndarray


@dataclass(frozen=True, kw_only=True)
class Circle:
    """Parallel cranks that turn about feet [m], by name, and what they carry along on circles without turning it.

    axis: of all feet; arm: from a foot to its pin at the start [m]; all in the world. rate: at the start [rad/s].
    """

    feet: dict[str, np.ndarray]
    axis: np.ndarray
    arm: np.ndarray
    rate: float


@dataclass(frozen=True, kw_only=True)
class Mechanism:
    """A drawn mechanism. family and seed say how to draw it again; sections are the keys `mechanism` and `maneuver` of
    its scene.

    circle: its motion, where that has one freedom and is known.
    """

    family: str
    seed: int
    sections: dict[str, Any]
    circle: Circle | None = None

    @property
    def name(self) -> str:
        """'family_seed'."""
        return f'{self.family}_{self.seed}'

    @property
    def text(self) -> str:
        """The scene as YAML, one element a line: what a report of a defect needs."""
        lines = []
        for section, entries in self.sections.items():
            lines.append(f'{section}:')
            for key, value in entries.items():
                if isinstance(value, dict):
                    lines += [f'  {key}:', *(f'    {name}: {_flow(element)}' for name, element in value.items())]
                else:
                    lines.append(f'  {key}: {_flow(value)}')
        return '\n'.join(lines) + '\n'

    @cached_property
    def scene(self) -> Scene:
        """The scene with default settings. Raises SceneError or SpecError."""
        return load_scene_text(self.text, self.name)

    def at(self, duration: float, **settings: Any) -> Scene:
        """The scene for a duration [s], with default settings but for these."""
        s = self.scene
        return replace(s, duration=duration, integrator=IntegratorSettings(**settings))


def _flow(value: Any) -> str:
    """One line of JSON, which is YAML; short keys without quotes."""
    if isinstance(value, dict):
        return '{' + ', '.join(f'{key}: {_flow(entry)}' for key, entry in value.items()) + '}'
    if isinstance(value, str):
        return value
    return json.dumps(value)


def rotation_of(rng: np.random.Generator) -> np.ndarray:
    """(3, 3) rotation, all equally likely."""
    q = rng.normal(size=4)
    x, y, z, w = q / np.linalg.norm(q)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def direction_of(rng: np.random.Generator) -> np.ndarray:
    """(3,) unit vector, all equally likely."""
    d = rng.normal(size=3)
    return d / np.linalg.norm(d)


class Draft:
    """Collects a mechanism. Points and axes are given in a frame of the draft, which lies anywhere in the world, turned
    at random.

    Gravity is along -z of the world, so its direction in that frame is random too.
    """

    def __init__(self, rng: np.random.Generator, *, gravity: float = MODEL_GRAVITY) -> None:
        self.rng = rng
        self.turn = rotation_of(rng)
        self.origin = rng.uniform(-1.0, 1.0, 3)
        self.mechanism: dict[str, Any] = {'gravity': [0.0, 0.0, -gravity], 'bodies': {}, 'joints': {}}
        self.signals: dict[str, Any] = {}
        self.circle: Circle | None = None
        self._com: dict[str, np.ndarray] = {}
        self._frame: dict[str, np.ndarray] = {}

    def log(self, low: float, high: float) -> float:
        """A number between low and high, all orders of magnitude equally likely."""
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def chance(self, share: float) -> bool:
        """True in this share of all cases."""
        return bool(self.rng.random() < share)

    def point(self, x: Vector) -> list[float]:
        """A point of the draft in the world [m]."""
        return [float(c) for c in self.origin + self.turn @ np.asarray(x, float)]

    def direction(self, x: Vector) -> list[float]:
        """A direction of the draft in the world."""
        return [float(c) for c in self.turn @ np.asarray(x, float)]

    def body(self, centre: Vector, axes: np.ndarray, mass: float, moments: Vector) -> str:
        """Add a body with its centre of mass, its principal axes (columns, (3, 3)) and moments of inertia; returns its
        name.

        Half of all bodies have frames that are neither at the centre of mass nor along the principal axes.
        """
        name = f'b{len(self._com)}'
        frame, com = self.turn @ axes, np.zeros(3)
        if self.chance(0.5):
            frame, com = rotation_of(self.rng), self.rng.uniform(-0.3, 0.3, 3)
        principal = frame.T @ self.turn @ axes
        J = principal @ np.diag(np.asarray(moments, float)) @ principal.T
        centre_in_world = np.array(self.point(centre))
        self._com[name], self._frame[name] = centre_in_world, frame
        self.mechanism['bodies'][name] = {
            'mass': float(mass),
            'inertia': [float(x) for x in (J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2])],
            'com': [float(x) for x in com],
            'position': [float(x) for x in centre_in_world - frame @ com],
            'orientation': list(quaternion(frame)),
        }
        return name

    def lump(self, centre: Vector, mass: float, size: float) -> str:
        """A body with three different moments of inertia, of about this size [m], turned at random."""
        a, b, c = (size * self.rng.uniform(0.5, 1.5, 3)) ** 2
        moments = mass / 12 * np.array([b + c, a + c, a + b])
        return self.body(centre, rotation_of(self.rng), mass, moments)

    def rod(self, a: Vector, b: Vector, mass: float, radius: float = 0.02) -> str:
        """A straight rod from a to b."""
        a, b = np.asarray(a, float), np.asarray(b, float)
        length = float(np.linalg.norm(b - a))
        across = mass * (3 * radius**2 + length**2) / 12
        along = frame_of_axis([float(c) for c in b - a])  # its z is along the rod
        return self.body((a + b) / 2, along, mass, (across, across, mass * radius**2 / 2))

    def joint(self, kind: str, i: str, j: str, at: Vector, axis: Vector = (0, 0, 1), **more: Any) -> str:
        """Add a joint at a point, z of its markers along the axis; returns its name."""
        name = f'j{len(self.mechanism["joints"])}'
        self.mechanism['joints'][name] = {
            'kind': kind,
            'i': i,
            'j': j,
            'at': self.point(at),
            'axis': self.direction(axis),
            **more,
        }
        return name

    def distance(self, i: str, a: Vector, j: str, b: Vector) -> str:
        """Add a joint that keeps the distance between the points a and b of bodies i and j."""
        name = f'j{len(self.mechanism["joints"])}'
        self.mechanism['joints'][name] = {'kind': 'distance', 'i': self.at(i, a), 'j': self.at(j, b)}
        return name

    def at(self, body: str, x: Vector) -> dict[str, Any]:
        """A marker on a body, at a point of the draft."""
        return {'body': body, 'at': self.point(x)}

    def add(self, section: str, **element: Any) -> str:
        """Add an element of any other kind; returns its name."""
        entries = self.mechanism.setdefault(section, {})
        name = f'{section[:2]}{len(entries)}'
        entries[name] = element
        return name

    def signal(self, **signal: Any) -> str:
        """Add an input with this signal; returns its name."""
        name = f'u{len(self.signals)}'
        self.signals[name] = signal
        return name

    def set_moving(self, speed: float, rate: float) -> None:
        """Give all bodies velocities [m/s] and rates of rotation [rad/s] of these sizes; the start makes them fit the
        constraints."""
        for name, body in self.mechanism['bodies'].items():
            v, w = speed * self.rng.normal(size=3), rate * self.rng.normal(size=3)
            at_origin = v - np.cross(self._frame[name] @ w, self._frame[name] @ np.array(body['com']))
            body['velocity'] = [float(c) for c in at_origin]
            body['angular_velocity'] = [float(c) for c in w]

    def set_velocity(self, name: str, v: Vector, w: Vector) -> None:
        """Give a body the velocity of its centre of mass and the angular velocity, both along the axes of the draft."""
        body, frame = self.mechanism['bodies'][name], self._frame[name]
        turning = self.turn @ np.asarray(w, float)
        at_origin = self.turn @ np.asarray(v, float) - np.cross(turning, frame @ np.array(body['com']))
        body['velocity'] = [float(c) for c in at_origin]
        body['angular_velocity'] = [float(c) for c in frame.T @ turning]

    def centre(self, name: str) -> np.ndarray:
        """(3,) centre of mass of a body, in the frame of the draft."""
        return self.turn.T @ (self._com[name] - self.origin)

    def mass(self, name: str) -> float:
        """Mass of a body [kg]."""
        return float(self.mechanism['bodies'][name]['mass'])

    def done(self, family: str, seed: int) -> Mechanism:
        """The mechanism as it is now."""
        sections: dict[str, Any] = {
            'mechanism': {key: value for key, value in self.mechanism.items() if value or key == 'gravity'}
        }
        if self.signals:
            sections['maneuver'] = {'signals': self.signals}
        return Mechanism(family=family, seed=seed, sections=sections, circle=self.circle)
