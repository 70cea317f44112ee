"""Building blocks of suspensions, steering and driveline: parts lists, rigid parts, rods, bushings, mountings and
links.

A template function returns `Parts`, the fields of ModelSpec it contributes to; `joined` adds them up. Lengths and
directions are given for the left side, in the design frame of solver.vehicle.hardpoints; the right side is mirrored.
Every connection has two forms: with the data of a bushing it is a BushingSpec, without it is an ideal joint.

The file is long because it holds all parts that axles are composed of, each a few lines.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, Literal, NamedTuple

import numpy as np

from solver.compiled.portable import norm, product
from solver.dimensions import Force, Length, Mass, Moments, Point, Stiffness, Time
from solver.elements.bushing import BushingSpec, Six
from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.marker import Marker, Spec
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.spring_damper import SpringDamperSpec
from solver.model.spec import SECTIONS
from solver.validate import Vector, finite, require
from solver.vehicle.hardpoints import SIDES, axes_along, distance, marker_at, on_side

UP: Vector = (0.0, 0.0, 1.0)
LEFTWARDS: Vector = (0.0, 1.0, 0.0)
Category = Literal['saloon', 'compact', 'pickup', 'electric', 'formula']  # of car: what its figures are compared with
CLOSEST = 1e-3  # m between points that a direction or a length follows from
SOFTEST = 1.0  # m that a spring is compressed by its load: of a body on such springs, which would bounce at 0.5 Hz
SKEW = 0.02  # largest coupling of rotations, relative to the rotational rates, that a mounting may neglect


def vector_of(array: np.ndarray) -> Vector:
    """A vector as a tuple of floats."""
    x, y, z = (float(c) for c in array)
    return (x, y, z)


class Parts:
    """Sections of ModelSpec (bodies, joints, coordinates, any kind of element) that a part of the vehicle contributes
    to."""

    def __init__(self, **sections: tuple[Spec, ...]) -> None:
        unknown = sections.keys() - set(SECTIONS)
        if unknown:
            raise TypeError(f'Parts: {min(unknown)!r} is no section of ModelSpec')
        self.sections = sections

    def __getattr__(self, section: str) -> tuple[Any, ...]:
        if section not in SECTIONS:
            raise AttributeError(section)
        return self.sections.get(section, ())

    def replace(self, **sections: tuple[Spec, ...]) -> Parts:
        """The same parts with some sections exchanged."""
        return Parts(**{**self.sections, **sections})


def joined(parts: Iterable[Parts]) -> Parts:
    """All parts together, in order."""
    every = list(parts)
    return Parts(**{section: tuple(chain(*(getattr(part, section) for part in every))) for section in SECTIONS})


class Corner(NamedTuple):
    """One wheel suspension: its parts, and the bodies that others attach to (arm: where the drop link of an anti-roll
    bar goes; housing: of a differential between the wheels, where the axle has one)."""

    parts: Parts
    upright: RigidBodySpec
    wheel: RigidBodySpec
    arm: RigidBodySpec
    housing: RigidBodySpec | None = None


class Structure(NamedTuple):
    """Structure that a suspension is attached to; rack: the part that tie rods go to (None: not steered)."""

    chassis: RigidBodySpec
    subframe: RigidBodySpec
    rack: RigidBodySpec | None = None


def require_positive(where: str, data: object, *fields: str) -> None:
    """Check that these fields of the data are finite and above zero; those that are None are not looked at. Raises
    SpecError."""
    for field in fields:
        value = getattr(data, field)
        if value is not None:
            finite(where, field, value, low=0.0, strict=True)


def require_apart(where: str, data: object, field: str, other: str) -> None:
    """Check that two points of the data [m] differ. Raises SpecError."""
    a, b = getattr(data, field), getattr(data, other)
    require(distance(a, b) >= CLOSEST, where, field, a, f'is not {CLOSEST:g} m away from {other}, {b}')


def require_resisting(where: str, field: str, law: Law | None) -> None:
    """Check that a law resists: at every knot it is, from its value at zero, on the side to which it is pushed. Raises
    SpecError."""
    if law is None:
        return
    at_zero = float(np.interp(0.0, law.x, law.y))
    for k, (x, y) in enumerate(zip(law.x, law.y, strict=True)):
        remedy = (
            f'drives instead of resisting: at {x:g} it must not be {"below" if x > 0.0 else "above"} the '
            f'{at_zero:g} at 0'
        )
        require((y - at_zero) * x >= 0.0, where, f'{field}[{k}][1]', y, remedy)


@dataclass(frozen=True, kw_only=True)
class Part:
    """A rigid part. mass [kg]; com: centre of mass in the design frame [m]; inertia (Ixx, Iyy, Izz) and products (Ixy,
    Ixz, Iyz) [kg m^2] about it, along the axes of the design frame."""

    mass: Mass
    inertia: Moments
    com: Point
    products: Moments = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        self.body('part', self.com)  # which checks mass and inertia
        finite('part', 'com[2]', self.com[2], low=0.0, strict=True)  # above the ground

    def body(self, name: str, origin: Vector, side: str = 'left') -> RigidBodySpec:
        """The body with its reference frame at `origin` of the design frame, parallel to it; both are given for the
        left side."""
        s = SIDES[side]
        xy, xz, yz = self.products
        com = tuple(float(c) for c in np.subtract(on_side(side, self.com), on_side(side, origin)))
        inertia = (*self.inertia, s * xy, xz, s * yz)
        return RigidBodySpec(name=name, mass=self.mass, inertia=inertia, com=com, position=on_side(side, origin))  # type: ignore[arg-type]


@dataclass(frozen=True, kw_only=True)
class Bushing:
    """One rubber bushing.

    axis: its z axis [design frame] (None: along the pivots it stands on, else vertical); x is forward, or to the left
    where the axis is longitudinal. stiffness: along x y z [N/m] and about x y z [N m/rad]; law_x .. law_z: force [N]
    over displacement [m] instead of the linear rate, on the left side; the right one is its mirror image. loss: damping
    over stiffness [s], i.e. loss angle / (2 pi f) at the frequency f that matters.
    """

    stiffness: Six
    axis: Vector | None = None
    law_x: Law | None = None
    law_y: Law | None = None
    law_z: Law | None = None
    loss: Time = 0.0015

    def __post_init__(self) -> None:
        for k, rate in enumerate(self.stiffness):
            finite('bushing', f'stiffness[{k}]', rate, low=0.0)
        if self.axis is not None:
            require(norm(self.axis) > 1e-9, 'bushing', 'axis', self.axis, 'must not be zero')
        for field in ('law_x', 'law_y', 'law_z'):
            require_resisting('bushing', field, getattr(self, field))
        finite('bushing', 'loss', self.loss, low=0.0)


def own_laws(bushing: Bushing, axis: Vector, side: str) -> tuple[Law | None, ...]:
    """The laws along x y z of a bushing whose axis on this side is `axis`. Both sides have right-handed frames, so one
    axis at the right is the negative mirror image of that at the left: along it the law is turned about, -f(-x)."""
    laws = (bushing.law_x, bushing.law_y, bushing.law_z)
    here, there = axes_along('bushing', axis), axes_along('bushing', on_side(side, axis))
    columns = zip(there.T.tolist(), here.T.tolist(), strict=True)
    turned = [
        sum(a * b for a, b in zip(on_side(side, vector_of(left)), own, strict=True)) < 0.0 for left, own in columns
    ]
    return tuple(turned_about(law) if law is not None and flip else law for law, flip in zip(laws, turned, strict=True))


def turned_about(law: Law) -> Law:
    """-f(-x)."""
    return Law(
        tuple(0.0 - x for x in reversed(law.x)), tuple(0.0 - y for y in reversed(law.y)), tuple(reversed(law.slope))
    )


def mounting(
    name: str,
    i: RigidBodySpec,
    j: RigidBodySpec,
    points: Sequence[Vector],
    bushing: Bushing | None,
    *,
    ideal: str,
    side: str = 'left',
    axis: Vector | None = None,
    pin: Vector | None = None,
) -> Parts:
    """Identical bushings at `points` between bodies i and j, replaced by one six-axis element at their centre.

    Exact for small displacements: translational rates add up, rotational ones grow by rate times distance squared.
    Coupling of two rotations must be absent (points on a line along an axis of the bushing, or placed symmetrically);
    SpecError otherwise. Without a bushing: an ideal joint of kind `ideal`. axis: z of the joint, and of a bushing that
    does not give its own; the line through two points unless given. pin: x of the ideal joint, for a universal one the
    direction of its pin on body i.
    """
    placed = np.array([on_side(side, p) for p in points])
    mean = placed.mean(axis=0)
    centre = vector_of(mean)
    line = on_side(side, axis) if axis is not None else vector_of(placed[0] - placed[1]) if len(points) == 2 else UP
    if bushing is None:
        x_axis = None if pin is None else on_side(side, pin)
        i_marker, j_marker = (marker_at(body, centre, line, x_axis) for body in (i, j))
        return Parts(joints=(JointSpec(name=name, kind=ideal, i=i_marker, j=j_marker),))
    own = line if bushing.axis is None else on_side(side, bushing.axis)
    arms = product(placed - mean, axes_along(f'mounting {name!r}', own))
    n, k = len(points), np.array(bushing.stiffness)
    squares = (arms * arms).sum(axis=0)
    turning = n * k[3:] + [
        k[1] * squares[2] + k[2] * squares[1],
        k[0] * squares[2] + k[2] * squares[0],
        k[0] * squares[1] + k[1] * squares[0],
    ]
    for a, b, c in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
        coupling = abs(k[c] * (arms[:, a] * arms[:, b]).sum())
        require(
            coupling <= SKEW * np.sqrt(turning[a] * turning[b]), f'mounting {name!r}', 'points', points,
            'couple two rotations: place them on a line along an axis of the bushing, or symmetrically',
        )  # fmt: skip
    stiffness = tuple(float(x) for x in (*(n * k[:3]), *turning))
    laws = tuple(None if law is None else Law(law.x, tuple(n * y for y in law.y), tuple(n * s for s in law.slope))
                 for law in own_laws(bushing, own, side))  # fmt: skip
    return Parts(
        bushings=(
            BushingSpec(
                name=name, i=marker_at(i, centre, own), j=marker_at(j, centre, own), stiffness=stiffness,  # type: ignore[arg-type]

                damping=tuple(bushing.loss * x for x in stiffness), laws=(*laws, None, None, None),  # type: ignore[arg-type]

            ),
        )
    )  # fmt: skip


def rods(name: str, pieces: Sequence[tuple[float, Vector, Vector, float]]) -> RigidBodySpec:
    """A body made of uniform solid cylinders (mass [kg], end a, end b [m], radius [m]); its frame is at the centre of
    mass, parallel to the design frame. Ends are placed already (not mirrored)."""
    masses = np.array([m for m, *_ in pieces])
    centres = np.array([0.5 * (np.array(a) + np.array(b)) for _, a, b, _ in pieces])
    com = product(masses, centres) / masses.sum()
    inertia = np.zeros((3, 3))
    for (m, a, b, radius), centre in zip(pieces, centres, strict=True):
        length = distance(a, b)
        require(length >= CLOSEST, f'body {name!r}', 'ends', (a, b), f'are not {CLOSEST:g} m apart')
        n = np.subtract(b, a) / length
        across = m * (radius * radius / 4.0 + length * length / 12.0)
        d = centre - com
        inertia += across * np.eye(3) + (0.5 * m * radius * radius - across) * np.outer(n, n)
        inertia += m * (product(d, d) * np.eye(3) - np.outer(d, d))
    six = (inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2])
    return RigidBodySpec(
        name=name,
        mass=float(masses.sum()),
        inertia=tuple(float(c) for c in six),  # type: ignore[arg-type]
        position=vector_of(com),
    )


@dataclass(frozen=True, kw_only=True)
class Link:
    """A bar between two points [m]: ball joint at `outer`, at `inner` a bushing, or ideally a universal joint (so that
    it cannot spin).

    mass [kg], radius [m] of the cylinder whose inertia it has.
    """

    inner: Point
    outer: Point
    mass: Mass
    radius: Length = 0.015
    bushing: Bushing | None = None

    def __post_init__(self) -> None:
        require_positive('link', self, 'mass', 'radius')
        require_apart('link', self, 'inner', 'outer')


def link(
    name: str, data: Link, base: RigidBodySpec, carrier: RigidBodySpec, side: str, pin: Vector | None = None
) -> Parts:
    """The link (its body first) between base (inner end) and carrier (outer end). pin: on the base, of an ideal
    universal joint, which is singular where the link comes to lie along it: a direction about which the link turns
    most."""
    a, b = on_side(side, data.inner), on_side(side, data.outer)
    body = rods(name, ((data.mass, a, b, data.radius),))
    along = vector_of(np.subtract(data.outer, data.inner))
    ball = JointSpec(name=f'{name}_outer', kind='spherical', i=marker_at(body, b), j=marker_at(carrier, b))
    foot = mounting(
        f'{name}_inner', base, body, (data.inner,), data.bushing, ideal='universal', side=side, axis=along, pin=pin
    )
    return joined((Parts(bodies=(body,), joints=(ball,)), foot))


@dataclass(frozen=True, kw_only=True)
class Arm:
    """A control arm: two coaxial bushings (or a revolute) at `pivots`, ball joint at `outer` [m].

    mass [kg] in two bars from the pivots to the ball joint, of the given radius [m].
    """

    pivots: tuple[Point, Point]
    outer: Point
    mass: Mass
    radius: Length = 0.02
    bushing: Bushing | None = None

    def __post_init__(self) -> None:
        require_positive('arm', self, 'mass', 'radius')
        front, rear = self.pivots
        require(distance(front, rear) >= CLOSEST, 'arm', 'pivots', self.pivots, f'are not {CLOSEST:g} m apart')


def control_arm(name: str, data: Arm, base: RigidBodySpec, carrier: RigidBodySpec, side: str) -> Parts:
    """The arm (its body first) between base and carrier."""
    outer = on_side(side, data.outer)
    body = rods(name, [(0.5 * data.mass, on_side(side, p), outer, data.radius) for p in data.pivots])
    ball = JointSpec(name=f'{name}_outer', kind='spherical', i=marker_at(body, outer), j=marker_at(carrier, outer))
    return joined(
        (
            Parts(bodies=(body,), joints=(ball,)),
            mounting(f'{name}_inner', base, body, data.pivots, data.bushing, ideal='revolute', side=side),
        )
    )


@dataclass(frozen=True, kw_only=True)
class Spring:
    """Coil spring: rate [N/m], load: compression force in the design position [N]."""

    rate: Stiffness
    load: Force

    def __post_init__(self) -> None:
        require_positive('spring', self, 'rate')
        finite('spring', 'load', self.load, low=0.0)
        soft = self.load / self.rate
        require(
            soft < SOFTEST,
            'spring',
            'rate',
            self.rate,
            f'is compressed by {soft:.3g} m under its load: rates are in N/m',
        )


@dataclass(frozen=True, kw_only=True)
class Damper:
    """law: force [N] over rate of length [m/s], rebound positive. stops: force [N] over length minus design length [m],
    rebound positive: bump rubber and rebound buffer."""

    law: Law
    stops: Law | None = None

    def __post_init__(self) -> None:
        require_resisting('damper', 'law', self.law)
        require_resisting('damper', 'stops', self.stops)


def spring_of(name: str, data: Spring, i: Marker, j: Marker, length: float) -> SpringDamperSpec:
    """The spring between two markers that are `length` apart in the design position [m]."""
    return SpringDamperSpec(
        name=name, i=i, j=j, free_length=length + data.load / data.rate, spring=Law.linear(data.rate)
    )


def damper_of(name: str, data: Damper, i: Marker, j: Marker, length: float) -> SpringDamperSpec:
    """The damper, with its stops, between two markers that are `length` apart in the design position [m]."""
    return SpringDamperSpec(name=name, i=i, j=j, free_length=length, spring=data.stops, damper=data.law)


@dataclass(frozen=True, kw_only=True)
class Sprung:
    """Data of a suspension whose spring and damper stand between the chassis and one of its parts, each at two points
    [m]."""

    spring: Spring
    spring_chassis: Point
    spring_arm: Point
    damper: Damper
    damper_chassis: Point
    damper_arm: Point


def sprung(name: str, side: str, chassis: RigidBodySpec, arm: RigidBodySpec, data: Sprung) -> Parts:
    """Spring and damper of corner `name` between chassis and arm, without bodies of their own."""

    def ends(on_chassis: Vector, on_arm: Vector) -> tuple[Marker, Marker, float]:
        return (
            marker_at(chassis, on_side(side, on_chassis)),
            marker_at(arm, on_side(side, on_arm)),
            distance(on_chassis, on_arm),
        )

    return Parts(
        spring_dampers=(
            spring_of(f'spring_{name}', data.spring, *ends(data.spring_chassis, data.spring_arm)),
            damper_of(f'damper_{name}', data.damper, *ends(data.damper_chassis, data.damper_arm)),
        )
    )


def shaft_markers(
    i: RigidBodySpec, j: RigidBodySpec, point: Vector, axis_i: Sequence[float], axis_j: Sequence[float]
) -> tuple[Marker, Marker]:
    """Markers of a joint between two shafts that meet at `point`, z along each shaft, without twist between them.

    x is the normal of the plane of the two shafts (the same line for both), so a universal joint has one cross pin
    there and a constant-velocity joint is open by exactly zero. Directions are placed already (not mirrored).
    """
    normal = np.cross(axis_i, axis_j)
    if norm(normal) < 1e-9 * norm(axis_i) * norm(axis_j):
        normal = axes_along(f'a shaft of {i.name!r}', axis_i)[:, 0]
    x_axis = vector_of(normal)
    return marker_at(i, point, axis_i, x_axis), marker_at(j, point, axis_j, x_axis)
