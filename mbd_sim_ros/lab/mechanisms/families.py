"""Families of random mechanisms. A mechanism is a function of its family and a seed; sizes are about a metre, masses
about a kilogram.

Each family has what it is named after, and a share of its members has springs, dampers, torques, drivers or duplicated
constraints on top (`adorn`). Natural frequencies that elements bring in are between 2 and 1000 rad/s, dampers from none
to ten times critical.

The file is long because it has one function for each family, which share nothing but the draft they fill.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from mbd_sim_ros.lab.mechanisms.draft import WORLD, Circle, Draft, Mechanism, direction_of, rotation_of
from solver.units import MODEL_GRAVITY

Z = np.array([0.0, 0.0, 1.0])
TREE_JOINTS = (
    'revolute',
    'revolute',
    'revolute',
    'spherical',
    'universal',
    'constant_velocity',
    'cylindrical',
    'prismatic',
)
OPEN_JOINTS = ('distance', 'point_on_line', 'point_on_plane')


def tree(d: Draft) -> None:
    """Two to seven bodies with joints of all kinds, on the ground or flying."""
    names: list[str] = []
    size = d.log(0.1, 1.0)
    places = [np.zeros(3)]
    grounded = d.chance(0.8)
    for k in range(d.rng.integers(2, 8)):
        parent = int(d.rng.integers(0, k + 1)) if grounded else int(d.rng.integers(1, k + 1)) if k else 0
        at = places[parent] + size * d.rng.uniform(0.3, 1.0) * direction_of(d.rng)
        name = d.lump(at, d.log(0.05, 20.0), size * d.rng.uniform(0.2, 0.8))
        other = WORLD if parent == 0 else names[parent - 1]
        names.append(name)
        places.append(at)
        if not grounded and k == 0:
            continue
        middle = (places[parent] + at) / 2
        if d.chance(0.85):
            d.joint(str(d.rng.choice(TREE_JOINTS)), other, name, middle, direction_of(d.rng))
        else:
            kind = str(d.rng.choice(OPEN_JOINTS))
            if kind == 'distance':
                d.distance(other, places[parent], name, at)
            else:
                d.joint(kind, other, name, at, direction_of(d.rng))
    d.set_moving(size * d.log(0.1, 3.0), d.log(0.1, 3.0))


def _polygon(d: Draft, sides: int) -> list[np.ndarray]:
    """Corners of a polygon in the plane without sides that are nearly in line, so no loop of it starts singular."""
    while True:
        angles = np.sort(d.rng.uniform(0, 2 * np.pi, sides))
        corners = [
            np.array([r * np.cos(a), r * np.sin(a), 0.0])
            for a, r in zip(angles, d.rng.uniform(0.4, 1.0, sides), strict=True)
        ]
        edges = [corners[(k + 1) % sides] - corners[k] for k in range(sides)]
        bends = [
            abs(np.cross(edges[k - 1], edges[k])[2]) / (np.linalg.norm(edges[k - 1]) * np.linalg.norm(edges[k]))
            for k in range(sides)
        ]
        if min(np.linalg.norm(e) for e in edges) > 0.25 and min(bends) > 0.2:
            return corners


def plane_loop(d: Draft) -> None:
    """A closed chain of four to seven sides in a plane: revolutes, three redundant constraints."""
    corners = _polygon(d, int(d.rng.integers(4, 8)))
    names = [WORLD, *(d.rod(a, b, d.log(0.2, 5.0)) for a, b in pairwise(corners))]
    for k, corner in enumerate(corners):
        d.joint('revolute', names[k - 1] if k else names[-1], names[k], corner, Z)
    d.set_moving(d.log(0.1, 2.0), d.log(0.1, 3.0))


def space_loop(d: Draft) -> None:
    """A closed chain in space of rods with a revolute, spherical joints, a universal joint: nothing redundant."""
    corners = [c + np.array([0.0, 0.0, d.rng.uniform(-0.4, 0.4)]) for c in _polygon(d, int(d.rng.integers(4, 7)))]
    names = [WORLD, *(d.rod(a, b, d.log(0.2, 5.0)) for a, b in pairwise(corners))]
    kinds = ['revolute', *['spherical'] * (len(corners) - 2), 'universal']
    for k, (corner, kind) in enumerate(zip(corners[1:] + corners[:1], kinds, strict=True)):
        d.joint(kind, names[k], names[(k + 1) % len(names)], corner, direction_of(d.rng))
    d.set_moving(d.log(0.1, 2.0), d.log(0.1, 2.0))


def duplicates(d: Draft) -> None:
    """A tree or a plane loop, some of whose joints are there two or three times, some beside themselves along their
    axis."""
    (tree if d.chance(0.5) else plane_loop)(d)
    joints = d.mechanism['joints']
    for _ in range(int(d.rng.integers(1, 4))):
        joint = dict(joints[str(d.rng.choice(list(joints)))])
        if joint['kind'] in ('revolute', 'prismatic', 'cylindrical') and d.chance(0.5):
            shift = d.rng.uniform(-0.5, 0.5)
            joint['at'] = [float(x + shift * a) for x, a in zip(joint['at'], joint['axis'], strict=True)]
        joints[f'j{len(joints)}'] = joint


def scissor(d: Draft) -> None:
    """Two to twelve cells of crossed bars between a hinge and a slide."""
    cells, angle = int(d.rng.integers(2, 13)), d.rng.uniform(0.4, 1.2)
    width, height = float(np.cos(angle)), float(np.sin(angle))
    mass = d.log(0.1, 10.0)
    bars: list[tuple[str, str]] = []
    for k in range(cells):
        low, high = k * height, (k + 1) * height
        left, right = d.rod((0, low, 0), (width, high, 0), mass), d.rod((width, low, 0), (0, high, 0), mass)
        d.joint('revolute', left, right, (width / 2, low + height / 2, 0), Z)
        if k:
            d.joint('revolute', bars[-1][1], left, (0, low, 0), Z)
            d.joint('revolute', bars[-1][0], right, (width, low, 0), Z)
        bars.append((left, right))
    d.joint('revolute', WORLD, bars[0][0], (0, 0, 0), Z)
    d.joint('point_on_line', WORLD, bars[0][1], (width, 0, 0), (1, 0, 0))


def rope(d: Draft) -> None:
    """Three to eight links with a body of up to 1e6 times their mass at the end, with ball joints or hinges, straight
    or bent."""
    links, mass = int(d.rng.integers(3, 9)), d.log(0.01, 10.0)
    kind = 'spherical' if d.chance(0.5) else 'revolute'
    bend = d.log(0.02, 1.0)
    at, heading = np.zeros(3), 0.0
    before = WORLD
    for _ in range(links):
        heading += bend * d.rng.uniform(-1, 1)
        end = at + 0.5 * np.array([np.cos(heading), np.sin(heading), 0.0])
        link = d.rod(at, end, mass)
        d.joint(kind, before, link, at, Z)
        before, at = link, end
    heavy = d.lump(at, mass * d.log(1.0, 1e6), d.log(0.1, 1.0))
    d.joint(kind, before, heavy, at, Z)
    if d.chance(0.5):
        d.set_moving(d.log(0.1, 2.0), d.log(0.01, 0.5))


def crank(d: Draft) -> None:
    """A slider-crank whose rod is longer than its crank by little or much, with a light slider, on its way through its
    dead centres."""
    longer, theta = d.log(1e-4, 1.0), d.rng.uniform(0, 2 * np.pi)
    rod = 1.0 + longer
    pin = np.array([np.cos(theta), np.sin(theta), 0.0])
    slope = -np.arcsin(pin[1] / rod)
    end = np.array([pin[0] + rod * np.cos(slope), 0.0, 0.0])
    first, second = d.rod((0, 0, 0), pin, d.log(0.3, 3.0)), d.rod(pin, end, d.log(0.3, 3.0))
    slider = d.lump(end, d.log(1e-3, 3.0), 0.1)
    d.joint('revolute', WORLD, first, (0, 0, 0), Z)
    d.joint('revolute', first, second, pin, Z)
    d.joint('revolute', second, slider, end, Z)
    d.joint('prismatic', WORLD, slider, end, (1, 0, 0))
    rate = d.rng.uniform(-5.0, 5.0)
    tilt = -pin[0] * rate / (rod * np.cos(slope))
    turning = rate * np.cross(Z, pin)
    d.set_velocity(first, turning / 2, rate * Z)
    d.set_velocity(second, turning + tilt * np.cross(Z, (end - pin) / 2), tilt * Z)
    d.set_velocity(slider, turning + tilt * np.cross(Z, end - pin), (0, 0, 0))


def parallelogram(d: Draft) -> None:
    """Two to five parallel cranks under one plate, or loops side by side as in four_bar_n; they may pass where all is
    in line."""
    angle, rate = d.rng.uniform(0, 2 * np.pi), d.rng.uniform(-3.0, 3.0)
    arm = d.rng.uniform(0.5, 1.0) * np.array([np.cos(angle), np.sin(angle), 0.0])
    turning = rate * np.cross(Z, arm)
    count = int(d.rng.integers(2, 6))
    in_line = d.chance(0.5)
    feet = [np.array([0.7 * k, 0.0 if in_line else d.rng.uniform(-0.4, 0.4), 0.0]) for k in range(count)]
    cranks = [d.rod(foot, foot + arm, d.log(0.3, 3.0)) for foot in feet]
    for foot, name in zip(feet, cranks, strict=True):
        d.joint('revolute', WORLD, name, foot, Z)
        d.set_velocity(name, turning / 2, rate * Z)
    d.circle = Circle(
        feet={name: np.array(d.point(foot)) for foot, name in zip(feet, cranks, strict=True)},
        axis=np.array(d.direction(Z)), arm=np.array(d.direction(arm)), rate=float(rate),
    )  # fmt: skip
    if d.chance(0.5):
        plate = d.lump(sum(feet) / count + arm, d.log(0.3, 10.0), 0.5)
        d.set_velocity(plate, turning, (0, 0, 0))
        for foot, name in zip(feet, cranks, strict=True):
            d.joint('revolute', name, plate, foot + arm, Z)
        return
    for k in range(count - 1):
        bar = d.rod(feet[k] + arm, feet[k + 1] + arm, d.log(0.3, 3.0))
        d.set_velocity(bar, turning, (0, 0, 0))
        d.joint('revolute', cranks[k], bar, feet[k] + arm, Z)
        d.joint('revolute', bar, cranks[k + 1], feet[k + 1] + arm, Z)


def bennett(d: Draft) -> None:
    """Bennett's linkage: four hinges in space that move although a count of constraints forbids it.

    Opposite links are equal, with lengths a, b and twists alpha, beta such that sin(alpha) / a = sin(beta) / b; its
    angles obey tan(theta_1 / 2) tan(theta_2 / 2) = sin((beta + alpha) / 2) / sin((beta - alpha) / 2).
    """
    a, alpha = d.rng.uniform(0.4, 0.8), d.rng.uniform(0.3, 0.7)
    b = a * d.rng.uniform(1.15, 1.4)
    beta = np.arcsin(b * np.sin(alpha) / a)
    first = d.rng.uniform(0.7, 2.4)
    ratio = np.sin((beta + alpha) / 2) / np.sin((beta - alpha) / 2)
    second = 2 * np.arctan(ratio / np.tan(first / 2))
    at, axes = np.zeros(3), np.eye(3)
    hinges = []
    for theta, length, twist in ((first, a, alpha), (second, b, beta), (-first, a, alpha), (-second, b, beta)):
        hinges.append((at, axes[:, 2]))
        axes = axes @ _about(2, theta)
        at = at + length * axes[:, 0]
        axes = axes @ _about(0, twist)
    assert np.abs(at).max() < 1e-12 and np.abs(axes - np.eye(3)).max() < 1e-12
    points = [p for p, _ in hinges]
    names = [d.rod(points[k], points[k + 1], d.log(0.3, 3.0)) for k in range(3)]
    for k, (p, axis) in enumerate(hinges):
        d.joint('revolute', WORLD if k == 0 else names[k - 1], names[k] if k < 3 else WORLD, p, axis)
    d.set_moving(d.log(0.1, 1.0), d.log(0.1, 2.0))


def _about(axis: int, angle: float) -> np.ndarray:
    """(3, 3) rotation about a coordinate axis."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[i, i], R[i, j], R[j, i], R[j, j] = c, -s, s, c
    return R


def sarrus(d: Draft) -> None:
    """Sarrus' linkage: a platform on two to four hinged legs in different planes, which can only move straight; some
    nearly folded."""
    legs = int(d.rng.integers(2, 5))
    rise = d.log(0.02, 1.0) * 0.9
    bar = 0.5
    reach = np.sqrt(bar**2 - (rise * bar) ** 2)
    platform = d.lump((0, 0, 2 * rise * bar), d.log(0.3, 10.0), 0.4)
    start = d.rng.uniform(0, 2 * np.pi)
    for k in range(legs):
        heading = start + (2 * np.pi * k / legs if legs > 2 else np.pi / 2 * k)
        out = np.array([np.cos(heading), np.sin(heading), 0.0])
        axis = np.cross(Z, out)
        foot, knee, top = 0.3 * out, (0.3 + reach) * out + rise * bar * Z, 0.3 * out + 2 * rise * bar * Z
        low, high = d.rod(foot, knee, d.log(0.3, 3.0)), d.rod(knee, top, d.log(0.3, 3.0))
        d.joint('revolute', WORLD, low, foot, axis)
        d.joint('revolute', low, high, knee, axis)
        d.joint('revolute', high, platform, top, axis)


def springs(d: Draft) -> None:
    """Bodies on springs and dampers between points, some with joints."""
    count = int(d.rng.integers(1, 6))
    places = [d.rng.uniform(-1.0, 1.0, 3) for _ in range(count)]
    names = [d.lump(p, d.log(0.1, 10.0), d.rng.uniform(0.2, 0.6)) for p in places]
    for k, name in enumerate(names):
        if d.chance(0.3):
            d.joint(
                str(d.rng.choice(TREE_JOINTS)), WORLD, name, places[k] + 0.3 * direction_of(d.rng), direction_of(d.rng)
            )
        for _ in range(int(d.rng.integers(1, 4))):
            _spring(d, name, places[k])
    d.set_moving(d.log(0.05, 1.0), d.log(0.05, 2.0))


def _spring(d: Draft, name: str, place: np.ndarray, stiffest: float = 1000.0) -> None:
    """A spring and damper from a body to the ground or to another body."""
    others = [n for n in d.mechanism['bodies'] if n != name]
    other = str(d.rng.choice(others)) if others and d.chance(0.5) else WORLD
    a = place + 0.2 * direction_of(d.rng)
    b = a + d.rng.uniform(0.4, 1.0) * direction_of(d.rng)
    light = min([d.mass(name)] + ([d.mass(other)] if other != WORLD else []))
    rate = d.log(2.0, stiffest)
    damping = 0.0 if d.chance(0.4) else d.log(0.01, 10.0)
    element = {
        'i': d.at(other, b),
        'j': d.at(name, a),
        'free_length': float(np.linalg.norm(b - a) * d.rng.uniform(0.9, 1.1)),
    }
    if d.chance(0.9):
        element['spring'] = light * rate**2
    else:  # harder with the way, both ways
        element['spring'] = [
            [x, light * rate**2 * x * (1 + abs(x) / 0.1)] for x in (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3)
        ]
    if damping:
        element['damper'] = 2 * damping * light * rate
    d.add('spring_dampers', **element)


def bushings(d: Draft) -> None:
    """One to five bodies in a row, each in a bushing on the one before."""
    before, at = WORLD, np.zeros(3)
    for _ in range(int(d.rng.integers(1, 6))):
        end = at + d.rng.uniform(0.3, 0.6) * direction_of(d.rng)
        name = d.rod(at, end, d.log(0.3, 10.0), radius=0.05)
        _bushing(d, before, name, at, d.mass(name))
        before, at = name, end
    d.set_moving(d.log(0.01, 0.5), d.log(0.01, 1.0))


def _bushing(d: Draft, i: str, j: str, at: np.ndarray, mass: float) -> None:
    rate, damping = d.log(30.0, 1000.0), 0.0 if d.chance(0.3) else d.log(0.01, 5.0)
    k = [mass * rate**2 * d.log(0.3, 3.0) for _ in range(3)] + [
        0.1 * mass * rate**2 * d.log(0.3, 3.0) for _ in range(3)
    ]
    frame = dict(at=d.point(at), axis=[float(c) for c in direction_of(d.rng)])
    d.add('bushings', i=i, j=j, **frame, stiffness=k, damping=[2 * damping * x / rate for x in k])


def drivers(d: Draft) -> None:
    """A four-bar, a rope or a train of gears whose first shaft is turned as prescribed."""
    form = int(d.rng.integers(0, 3))
    if form == 0:
        corners = [np.zeros(3), np.array([0.0, 0.3, 0.0]), np.array([1.0, 0.7, 0.0]), np.array([1.0, 0.0, 0.0])]
        names = [WORLD, *(d.rod(a, b, d.log(0.2, 5.0)) for a, b in pairwise(corners))]
        joints = [d.joint('revolute', names[k], names[(k + 1) % 4], corners[k], Z) for k in range(4)]
    elif form == 1:
        names, joints, at = [WORLD], [], np.zeros(3)
        for _ in range(int(d.rng.integers(2, 5))):
            end = at + 0.5 * direction_of(d.rng)
            names.append(d.rod(at, end, d.log(0.2, 5.0)))
            joints.append(d.joint('revolute', names[-2], names[-1], at, direction_of(d.rng)))
            at = end
    else:
        joints = []
        for k in range(int(d.rng.integers(2, 4))):
            shaft = d.lump((0.5 * k, 0, 0), d.log(0.2, 5.0), 0.3)
            joints.append(d.joint('revolute', WORLD, shaft, (0.5 * k, 0, 0), Z))
            if k:
                d.add('couplers', terms=[[joints[k - 1], 1.0], [joints[k], d.rng.uniform(-3, 3)]])
            arm = d.lump((0.5 * k, 0.4, 0.3), d.log(0.2, 5.0), 0.2)
            d.joint('spherical' if d.chance(0.5) else 'revolute', shaft, arm, (0.5 * k, 0.2, 0.1), direction_of(d.rng))
    d.add('couplers', terms=[[joints[0], 1.0]], input=d.signal(**_motion(d)))


def _motion(d: Draft) -> dict:
    """A smooth signal that begins at zero."""
    kind = str(d.rng.choice(['sine', 'step', 'ramp']))
    if kind == 'sine':
        return {
            'kind': kind,
            'amplitude': d.rng.uniform(0.1, 1.0),
            'frequency': d.log(0.3, 5.0),
            'start': d.rng.uniform(0.1, 0.2),
        }
    if kind == 'step':
        return {
            'kind': kind,
            'value': d.rng.uniform(-1.0, 1.0),
            'start': d.rng.uniform(0.0, 0.2),
            'rise': d.rng.uniform(0.1, 0.5),
        }
    return {'kind': kind, 'slope': d.rng.uniform(-10.0, 10.0), 'start': d.rng.uniform(0.06, 0.2), 'blend': 0.1}


def rolling(d: Draft) -> None:
    """A disc that rolls on a plane with a pendulum on its axle, or a sledge on a knife edge."""
    d.turn = np.eye(3)  # a plane that is level
    if d.chance(0.3):
        d.turn = rotation_of(d.rng)
    mass = d.log(0.3, 10.0)
    if d.chance(0.3):
        sledge = d.body((0, 0, 0), np.eye(3), mass, mass * np.array([0.02, 0.05, 0.06]))
        d.joint('point_on_plane', WORLD, sledge, (0.3, 0, 0), Z)
        d.joint('point_on_plane', WORLD, sledge, (-0.2, 0.2, 0), Z)
        d.joint('point_on_plane', WORLD, sledge, (-0.2, -0.2, 0), Z)
        d.add(
            'contacts',
            kind='knife_edge',
            i=WORLD,
            j=sledge,
            at=d.point((-0.2, 0, 0)),
            axis=d.direction(Z),
            x_axis=d.direction((1, 0, 0)),
        )
        d.set_moving(d.log(0.1, 3.0), d.log(0.1, 5.0))
        return
    tilt, radius = d.rng.uniform(-0.7, 0.7), d.rng.uniform(0.2, 0.5)
    spin = np.array([0.0, np.cos(tilt), np.sin(tilt)])
    centre = np.array([0.0, 0.0, radius * np.cos(tilt)])
    axes = np.column_stack([(1, 0, 0), np.cross(spin, (1, 0, 0)), spin])
    disc = d.body(centre, axes, mass, mass * radius**2 * np.array([0.25, 0.25, 0.5]))
    d.add(
        'contacts', kind='rolling', radius=radius, i={'body': WORLD, 'at': d.point((0, 0, 0)), 'axis': d.direction(Z)},
        j={'body': disc, 'at': d.point(centre), 'axis': d.direction(spin)},
    )  # fmt: skip
    if d.chance(0.5):
        bob = d.lump(centre + 0.3 * direction_of(d.rng), d.log(0.1, 3.0), 0.2)
        d.joint('spherical' if d.chance(0.5) else 'revolute', disc, bob, centre, spin)
    d.set_moving(d.log(0.1, 2.0), d.log(0.1, 5.0))


FAMILIES: dict[str, Callable[[Draft], None]] = {
    f.__name__: f
    for f in (
        tree, plane_loop, space_loop, duplicates, scissor, rope, crank, parallelogram, bennett, sarrus, springs,
        bushings, drivers, rolling,
    )
}  # fmt: skip
ADORNED = 0.4  # share of the members of a family that get elements on top


def adorn(d: Draft) -> None:
    """Springs, torsional springs and dampers, loads and torques on what is there."""
    bodies = list(d.mechanism['bodies'])
    hinges = [name for name, joint in d.mechanism['joints'].items() if joint['kind'] == 'revolute']
    for _ in range(int(d.rng.integers(1, 4))):
        form, body = int(d.rng.integers(0, 4)), str(d.rng.choice(bodies))
        if form == 0:
            _spring(d, body, d.centre(body), stiffest=100.0)
        elif form == 1 and hinges:
            stiffness = d.log(0.1, 1000.0)
            d.add(
                'coordinate_forces', terms=[[str(d.rng.choice(hinges)), 1.0]], spring=stiffness,
                damper=stiffness * d.log(1e-3, 0.1),
                reference=d.rng.uniform(-0.5, 0.5),
            )  # fmt: skip
        elif form == 2 and hinges:
            u = d.signal(kind='sine', amplitude=d.log(0.1, 20.0), frequency=d.log(0.3, 5.0))
            d.add('coordinate_forces', terms=[[str(d.rng.choice(hinges)), 1.0]], input=u)
        else:
            force = [float(x) for x in 5.0 * d.mass(body) * d.rng.normal(size=3)]
            d.add('applied_forces', marker={'body': body}, force=force, frame=str(d.rng.choice(['world', 'body'])))


def draw(family: str, seed: int) -> Mechanism:
    """The mechanism of a family and a seed, the same for ever."""
    rng = np.random.default_rng([zlib.crc32(family.encode()), seed])
    d = Draft(rng, gravity=0.0 if rng.random() < 0.1 else MODEL_GRAVITY)
    FAMILIES[family](d)
    if d.chance(ADORNED):
        adorn(d)
    return d.done(family, seed)


def drawn(number: int, seed: int) -> Mechanism:
    """Number 0, 1, ... of the series of a seed: all families in turn."""
    names = list(FAMILIES)
    return draw(names[number % len(names)], 1_000_000 * seed + number // len(names))
