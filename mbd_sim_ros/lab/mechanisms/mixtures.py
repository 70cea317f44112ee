"""Mechanisms that mix everything, drawn as text: trees and loops, redundant rows, gears, drivers, rolling, blades,
springs.

A mixture is made of one to three parts, each on the world or on a body of an earlier part. Geometry comes first and
markers are placed on it in the world, so that every loop is closed as it is drawn; closing constraints, couplers and
drivers are kept where the reference finds a freedom left. Lengths are of 1 mm to 10 m, masses of 1 mg to 1000 kg,
gravity is that of a motion within about a second.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbd_sim_ros.lab.mechanisms.maximal import Maximal
from mbd_sim_ros.lab.mechanisms.mixture_draft import DURATION, Draft

MOST = 9  # bodies
TREE_JOINTS = (
    'revolute', 'revolute', 'revolute', 'spherical', 'universal', 'prismatic', 'cylindrical', 'constant_velocity',
    'fixed',
)  # fmt: skip
CLOSING = ('distance', 'point_on_plane', 'point_on_line', 'perpendicular', 'spherical', 'distance')


@dataclass(frozen=True)
class Mixture:
    """A scene as text, without a step; parts: what was mixed."""

    name: str
    parts: tuple[str, ...]
    text: str

    def scene(self, h: float, penalty: float | None = None) -> str:
        """The text with a step [s], and a penalty."""
        more = '' if penalty is None else f', penalty: {penalty!r}'
        return f'{self.text}integrator: {{h: {h!r}{more}}}\n'


def tree(d: Draft) -> None:
    """One to four bodies, each joined to the world or to any body."""
    for _ in range(d.rng.integers(1, 5)):
        parent, centre = d.base(), d.place()
        name = d.body(centre)
        d.joint(str(d.rng.choice(TREE_JOINTS)), parent, name, centre + d.direction() * d.size * d.rng.uniform(0.1, 0.8))


def plane_loop(d: Draft) -> None:
    """Four to six bars in a plane: three redundant rows a loop. Now and then one joint slides."""
    base, n, z = d.base(), int(d.rng.integers(3, 6)), d.direction()
    x = d.across(z)
    y, origin = np.cross(z, x), d.place()
    angles = np.sort(d.rng.uniform(0, 2 * np.pi, n + 1)) + np.linspace(0, 0.5, n + 1)
    corners = [origin + d.size * d.rng.uniform(0.4, 1.2) * (np.cos(a) * x + np.sin(a) * y) for a in angles]
    before = base
    for k in range(n):
        name = d.body((corners[k] + corners[k + 1]) / 2.0 + z * d.size * d.rng.normal() * 0.1)
        d.joint('revolute', before, name, corners[k], z)
        before = name
    if d.rng.random() < 0.25:
        d.joint('prismatic', base, before, corners[n], np.cos(1.0) * x + np.sin(1.0) * y)
    else:
        d.joint('revolute', before, base, corners[n], z)


def sphere_loop(d: Draft) -> None:
    """Four or five bars whose axes meet in one point."""
    base, n, centre = d.base(), int(d.rng.integers(3, 5)), d.place()
    axes = [d.direction() for _ in range(n + 1)]
    before = base
    for k in range(n):
        name = d.body(centre + d.size * 0.7 * (axes[k] + axes[k + 1]) / 2.0)
        d.joint('revolute', before, name, centre + d.size * d.rng.uniform(0, 1) * axes[k], axes[k])
        before = name
    d.joint('revolute', before, base, centre + d.size * axes[n] * 0.5, axes[n])


def space_loop(d: Draft) -> None:
    """Crank, coupler and rocker in space: the coupler has spherical joints, or a universal one."""
    base = d.base()
    a, b, c, e = (d.place() for _ in range(4))
    crank, coupler, rocker = d.body((a + b) / 2.0), d.body((b + c) / 2.0), d.body((c + e) / 2.0)
    d.joint('revolute', base, crank, a)
    d.joint('spherical', crank, coupler, b)
    d.joint(str(d.rng.choice(['spherical', 'universal'])), coupler, rocker, c)
    d.joint(str(d.rng.choice(['revolute', 'cylindrical', 'prismatic'])), base, rocker, e)


def change_point(d: Draft) -> None:
    """Parallelogram or kite whose bars are nearly in one line, by 1e-5 to 0.5 rad."""
    base, z, origin = d.base(), d.direction(), d.place()
    x = d.across(z)
    y = np.cross(z, x)
    ground, crank = d.size * d.rng.uniform(0.6, 1.5), d.size * d.rng.uniform(0.4, 1.0)
    angle = 10.0 ** d.rng.uniform(-5, -0.3) * d.rng.choice([-1, 1]) + d.rng.choice([0.0, np.pi])
    arm = crank * (np.cos(angle) * x + np.sin(angle) * y)
    corners = [origin, origin + arm, origin + ground * x + arm, origin + ground * x]
    names = [d.body((corners[k] + corners[k + 1]) / 2.0) for k in range(3)]
    for i, j, at in zip((base, *names), (*names, base), corners, strict=True):
        d.joint('revolute', i, j, at, z)
    if d.rng.random() < 0.3:  # a third crank: always the same motion, and three more rows that say so
        middle = corners[0] + ground * x * d.rng.uniform(0.3, 0.7)
        third = d.body(middle + arm / 2.0)
        d.joint('revolute', base, third, middle, z)
        d.joint('revolute', third, names[1], middle + arm, z)


def twice(d: Draft) -> None:
    """A body in two joints on one axis, or on two parallel slides: the second one adds nothing."""
    base, centre, axis = d.base(), d.place(), d.direction()
    name, kind = d.body(centre), str(d.rng.choice(['revolute', 'prismatic', 'cylindrical']))
    d.joint(kind, base, name, centre + axis * d.size * 0.4, axis)
    away = np.zeros(3) if kind != 'prismatic' else d.across(axis) * d.size * 0.3
    d.joint(
        str(d.rng.choice([kind, 'point_on_line'])) if kind != 'prismatic' else kind,
        base,
        name,
        centre - axis * d.size * 0.3 + away,
        axis,
    )


def disc(d: Draft) -> None:
    """A disc rolls on a plane of the world; half of them carry a pendulum."""
    n, radius = d.direction(), d.size * d.rng.uniform(0.2, 0.8)
    lean = d.rng.uniform(-0.6, 0.6)
    x = d.across(n)
    axis = np.cos(lean) * np.cross(n, x) + np.sin(lean) * n
    up = n - (n @ axis) * axis
    up /= np.linalg.norm(up)
    point = d.place()
    centre = point + radius * up
    R = np.column_stack((np.cross(up, axis), up, axis))
    name = d.body(centre, R, (0.9 * radius, 0.9 * radius, 0.2 * radius))
    d.add(
        'contacts',
        {
            'kind': 'rolling',
            'i': {'body': 'world', 'at': (point + d.across(n) * d.size).tolist(), 'axis': n.tolist()},
            'j': {'body': name, 'at': centre.tolist(), 'axis': axis.tolist()},
            'radius': float(radius),
        },
    )
    if d.rng.random() < 0.5:
        hung = d.body(centre + d.direction() * radius * 0.6)
        d.joint(str(d.rng.choice(['revolute', 'spherical'])), name, hung, centre, axis)


def blade(d: Draft) -> None:
    """A sleigh on a plane: a blade, three points or one point and two directions on the plane; half of them pull a
    trailer."""
    n, centre = d.direction(), d.place()
    x = d.across(n)
    y = np.cross(n, x)
    name = d.body(centre)
    edge = centre + x * d.size * d.rng.uniform(-0.5, 0.5)
    d.add(
        'contacts',
        {
            'kind': 'knife_edge',
            'i': 'world',
            'j': {'body': name, 'at': edge.tolist(), 'axis': n.tolist(), 'x_axis': x.tolist()},
        },
    )
    d.joint('point_on_plane', 'world', name, edge, n)
    if d.rng.random() < 0.5:
        d.joint('point_on_plane', 'world', name, centre + y * d.size * 0.5, n)
        d.joint('point_on_plane', 'world', name, centre - x * d.size, n)
    else:
        for u in (x, y):
            d.data['joints'][f'upright_{len(d.data["joints"])}'] = {
                'kind': 'perpendicular',
                'i': {'body': 'world', 'at': centre.tolist(), 'axis': n.tolist()},
                'j': {'body': name, 'at': centre.tolist(), 'axis': u.tolist()},
            }
    if d.rng.random() < 0.5:
        trailer = d.body(centre - x * d.size)
        d.joint('revolute', name, trailer, centre - x * d.size * 0.4, n)
        if d.rng.random() < 0.6:
            wheel = {
                'body': trailer,
                'at': (centre - x * d.size * 1.2).tolist(),
                'axis': n.tolist(),
                'x_axis': x.tolist(),
            }
            d.add('contacts', {'kind': 'knife_edge', 'i': 'world', 'j': wheel})


def gears(d: Draft) -> None:
    """Two or three bodies that turn or slide on a base, coupled."""
    base, names = d.base(), []
    for _ in range(d.rng.integers(2, 4)):
        centre = d.place()
        name = d.body(centre)
        kind = 'prismatic' if d.rng.random() < 0.25 else 'revolute'
        names.append((d.joint(kind, base, name, centre + d.direction() * d.size * 0.2), kind == 'revolute'))
    couple(d, names)


def couple(d: Draft, names: list[tuple[str, bool]]) -> None:
    """A coupler between coordinates: factors that move angles of a radian with slides of the size of the mechanism."""
    factors = d.rng.uniform(0.4, 2.5, len(names)) * d.rng.choice([-1, 1], len(names))
    terms = {name: float(f if angle else f / d.size) for (name, angle), f in zip(names, factors, strict=True)}
    d.keep('couplers', {'terms': terms})


def floating(d: Draft) -> None:
    """A body that only a bushing holds."""
    base, name = d.base(), d.body(d.place())
    bush(d, base, name, d.places[name][0] + d.direction() * d.size * 0.3)


def bush(d: Draft, i: str, j: str, at: np.ndarray) -> None:
    """A bushing between two bodies, free of force where it is placed."""
    mass = d.data['bodies'][j]['mass']
    rate = d.rate(3.0, 0.5)
    k = mass * rate**2 * d.rng.uniform(0.3, 1.0, 3)
    turning = k * (0.4 * d.size) ** 2
    stiffness = np.concatenate((k, turning))
    damping = stiffness / rate * 2.0 * 10.0 ** d.rng.uniform(-2, -0.2)
    z = d.direction()
    place = {'at': at.tolist(), 'axis': z.tolist(), 'x_axis': d.across(z).tolist()}
    d.add('bushings', {'i': i, 'j': j, **place, 'stiffness': stiffness.tolist(), 'damping': damping.tolist()})


def spring(d: Draft) -> None:
    """A spring, with a damper half of the time, stretched so that it pulls about as hard as what it pulls weighs."""
    i, j = d.two()
    body = d.data['bodies'][j]['mass']
    ends = [
        (np.zeros(3) if b == 'world' else d.places[b][0]) + d.direction() * d.size * d.rng.uniform(0.2, 0.8)
        for b in (i, j)
    ]
    length = float(np.linalg.norm(ends[1] - ends[0]))
    if length < 0.3 * d.size:
        ends[1] = ends[0] + d.direction() * d.size * 0.8
        length = float(np.linalg.norm(ends[1] - ends[0]))
    rate = d.rate(1.0)
    stretch = np.clip(d.rng.normal() * 2.0 * d.size / (rate * d.time) ** 2, -0.3 * length, 0.3 * length)
    k = body * rate**2
    law: Any = float(k)
    if d.rng.random() < 0.2:  # one that hardens
        law = [[x * length, k * length * (x + 3.0 * x**3)] for x in (-0.6, -0.3, 0.0, 0.3, 0.6)]
    markers = [{'body': b, 'at': end.tolist()} for b, end in zip((i, j), ends, strict=True)]
    element = {'i': markers[0], 'j': markers[1], 'free_length': float(length - stretch), 'spring': law}
    if d.rng.random() < 0.5:
        element['damper'] = float(2.0 * body * rate * 10.0 ** d.rng.uniform(-2, 0.0))
    d.add('spring_dampers', element)


def close(d: Draft) -> None:
    """One more constraint between two bodies, as they stand."""
    i, j = d.two()
    at = (d.places[j][0] + (np.zeros(3) if i == 'world' else d.places[i][0])) / 2.0
    kind = str(d.rng.choice(CLOSING))
    z = d.direction()
    first = {'body': i, 'at': at.tolist(), 'axis': z.tolist(), 'x_axis': d.across(z).tolist()}
    second = {'body': j, 'at': at.tolist(), 'axis': z.tolist()}
    if kind == 'distance':
        second['at'] = (at + d.direction() * d.size * d.rng.uniform(0.3, 1.0)).tolist()
    elif kind == 'perpendicular':
        second['axis'] = d.across(z).tolist()
    d.keep('joints', {'kind': kind, 'i': first, 'j': second})


def drive(d: Draft) -> None:
    """A coordinate that follows a smooth signal from rest."""
    if not (known := d.coordinates()):
        return
    name, angle = known[d.rng.integers(len(known))]
    reach = d.rng.uniform(0.2, 1.5) if angle else 0.3 * d.size
    times = np.linspace(0.0, DURATION, 6)
    points = [[float(t), float(y)] for t, y in zip(times, (0.0, *d.rng.uniform(-reach, reach, 5)), strict=True)]
    d.keep('couplers', {'terms': {name: 1.0}, 'input': f'u{len(d.maneuver)}'}, {'kind': 'table', 'points': points})


def twist(d: Draft) -> None:
    """A spring and damper, or a constant torque, on a coordinate."""
    if not (known := d.coordinates()):
        return
    name, angle = known[d.rng.integers(len(known))]
    unit = d.mass * (d.size**2 if angle else 1.0)
    rate = d.rate(1.0, 0.2)
    element: dict[str, Any] = {'terms': {name: 1.0}, 'spring': float(unit * rate**2)}
    if d.rng.random() < 0.6:
        element['damper'] = float(unit * rate * 10.0 ** d.rng.uniform(-2, 0))
    d.add('coordinate_forces', element)


def push(d: Draft) -> None:
    """A constant force and torque on a body."""
    name = str(d.rng.choice(list(d.places)))
    force = d.direction() * d.data['bodies'][name]['mass'] * d.size / d.time**2 * d.rng.uniform(0, 2)
    torque = d.direction() * np.linalg.norm(force) * d.size * d.rng.uniform(0, 0.3)
    frame = str(d.rng.choice(['world', 'body']))
    d.add(
        'applied_forces', {'marker': {'body': name}, 'force': force.tolist(), 'torque': torque.tolist(), 'frame': frame}
    )


PARTS: tuple[Callable[[Draft], None], ...] = (
    tree, plane_loop, sphere_loop, space_loop, change_point, twice, disc, blade, gears, floating, tree,
)  # fmt: skip
MORE: tuple[tuple[Callable[[Draft], None], float, int], ...] = (  # what, how probable, how often at most
    (close, 0.35, 2), (drive, 0.25, 1), (spring, 0.4, 2), (twist, 0.25, 1), (push, 0.25, 1),
)  # fmt: skip


def mixture(index: int, seed: int = 0) -> Mixture:
    """The mechanism of this index in the series of a seed."""
    for attempt in range(100):
        d = Draft(np.random.default_rng([seed, index, attempt]))
        for part in d.rng.choice(len(PARTS), d.rng.choice([1, 2, 3], p=[0.4, 0.4, 0.2])):
            PARTS[part](d)
            d.parts.append(PARTS[part].__name__)
        for more, probability, most in MORE:
            for _ in range(most):
                if d.rng.random() < probability:
                    more(d)
        if d.rng.random() < 0.25 and len(known := d.coordinates()) > 1:
            couple(d, [known[k] for k in d.rng.choice(len(known), 2, replace=False)])
        if len(d.places) <= MOST and (d.maneuver or d.freedoms()[0]):
            start(d)
            return Mixture(f'mixture_{seed}_{index}', tuple(d.parts), d.text())
    raise RuntimeError(f'mixture {index} of series {seed}: no mechanism with a freedom in 100 attempts')


def start(d: Draft) -> None:
    """Velocities that all rows allow, of up to twice the size of the mechanism in its time; one in six begins at
    rest."""
    directions = Maximal(d.text()).free_directions()
    if len(directions) == 0 or d.rng.random() < 1 / 6:
        return
    u = (d.rng.normal(size=len(directions)) @ directions).reshape(-1, 6)
    fastest = max(np.max(np.linalg.norm(u[:, :3], axis=1)), d.size * np.max(np.linalg.norm(u[:, 3:], axis=1)))
    u *= d.rng.uniform(0.2, 2.0) * d.size / d.time / fastest
    for (name, (_, R, com)), (vx, vy, vz, *w) in zip(d.places.items(), u, strict=True):
        velocity = np.array([vx, vy, vz]) - R @ np.cross(w, com)
        d.data['bodies'][name] |= {'velocity': velocity.tolist(), 'angular_velocity': [float(x) for x in w]}
