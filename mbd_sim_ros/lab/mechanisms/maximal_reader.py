"""A scene file as plain arrays for the reference in maximal coordinates: a reader of its own, which takes the YAML text
alone.

It reads the sections of docs/scene.md that LISTED names, in SI units and without includes, and refuses the rest. Every
constraint becomes rows of a few codes (maximal_rows.py); frames, signs and rows are those of docs/conventions.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.spatial.transform import Rotation

from mbd_sim_ros.lab.mechanisms.maximal_rows import ALONG, APART, BLADE, COUPLED, DOT, HEIGHT, SLIP, TWIST, WIDTH
from solver.units import MODEL_GRAVITY

LISTED = (
    'gravity', 'bodies', 'joints', 'contacts', 'couplers', 'spring_dampers', 'bushings', 'coordinate_forces',
    'applied_forces',
)  # fmt: skip
NO_LAW = (np.array([0.0, 1.0]), np.zeros(2), np.zeros(2))

Law = tuple[np.ndarray, np.ndarray, np.ndarray]  # x, y, slopes
Signal = Callable[[float], tuple[float, float, float]]  # value, rate, acceleration at a time


@dataclass(frozen=True)
class Marker:
    """Frame on a body: r from the centre of mass [m] and R, both along the axes of the body. The world is the body
    behind the last."""

    body: int
    r: np.ndarray
    R: np.ndarray


@dataclass
class Mechanism:
    """Arrays of a scene. com [m]: centres of mass in the frames of the file; p, q, v, w: of the centres at the start, w
    along the body."""

    names: list[str]
    mass: np.ndarray
    inertia: np.ndarray  # (nb, 3, 3)
    com: np.ndarray
    p: np.ndarray
    q: np.ndarray  # (nb, 4), xyzw
    v: np.ndarray
    w: np.ndarray
    gravity: np.ndarray
    codes: np.ndarray  # (rows, 5): code, bodies or coordinates
    numbers: np.ndarray  # (rows, WIDTH)
    coordinates: np.ndarray  # (coordinates, 3): 0 rotation or 1 translation, bodies of F and G
    frames: np.ndarray  # (coordinates, 18): x, y, z of F and x of G, each along its body, points of F and G
    names_of_coordinates: list[str]
    signals: list[Signal]
    knots: list[float]  # times at which a signal is not smooth
    springs: list[tuple[Marker, Marker, float, float, Law, Law]]
    bushings: list[tuple[Marker, Marker, np.ndarray]]  # stiffness, damping and preload in one: (18,)
    coordinate_forces: list[tuple[list[tuple[int, float]], float, float, Law, Law]]
    applied: list[tuple[Marker, bool, np.ndarray, np.ndarray]]


def read(text: str) -> Mechanism:
    """The mechanism of a scene's text. Raises ValueError where something stands in it that this reader does not
    know."""
    scene = yaml.safe_load(text)
    data = scene['mechanism']
    if unknown := set(data) - set(LISTED):
        raise ValueError(f'mechanism: {sorted(unknown)} is not read here; known are {", ".join(LISTED)}')
    if 'coordinates' in scene.get('start', {}) or scene.get('start', {}).get('kind', 'as_placed') != 'as_placed':
        raise ValueError('start: only velocities of bodies, as placed, are read here')
    return _Reader(data, scene.get('maneuver', {}).get('signals', {})).mechanism()


def law(given: Any) -> Law:
    """A law: x, y and slopes of the monotone cubic of Fritsch and Butland through the points, straight lines beyond
    them."""
    if given is None:
        return NO_LAW
    if not isinstance(given, list):
        return np.array([0.0, 1.0]), np.array([0.0, float(given)]), np.full(2, float(given))
    x, y = np.array(given, float).T
    return x, y, PchipInterpolator(x, y).derivative()(x)


def signal(given: Any) -> tuple[Signal, list[float]]:
    """A table with horizontal ends, and its knots [s]."""
    if given['kind'] != 'table' or given.get('interpolation', 'cubic') != 'cubic':
        raise ValueError(f'maneuver: a signal of kind {given["kind"]} is not read here; a cubic table is')
    t, y = np.array(given['points'], float).T
    spline = CubicSpline(t, y, bc_type='clamped')

    def value(at: float) -> tuple[float, float, float]:
        if not t[0] <= at <= t[-1]:
            return (float(y[0]) if at < t[0] else float(y[-1]), 0.0, 0.0)
        return float(spline(at)), float(spline(at, 1)), float(spline(at, 2))

    return value, t.tolist()


class _Reader:
    def __init__(self, data: Mapping[str, Any], maneuver: Mapping[str, Any]) -> None:
        self.data, self.maneuver = data, maneuver
        self.names = list(data['bodies'])
        bodies = list(data['bodies'].values())
        self.com = np.array([_vector(b.get('com')) for b in bodies])
        self.origin = np.array([_vector(b.get('position')) for b in bodies])
        self.R = np.array([_rotation(b) for b in bodies])
        self.rows: list[tuple[tuple[int, ...], Sequence[float]]] = []
        self.coordinates: dict[str, tuple[int, Marker, Marker]] = {}

    def mechanism(self) -> Mechanism:
        bodies = list(self.data['bodies'].values())
        w = np.array([_vector(b.get('angular_velocity')) for b in bodies])
        arms = np.einsum('bij,bj->bi', self.R, self.com)
        turning = np.cross(np.einsum('bij,bj->bi', self.R, w), arms)
        for joint in self.data.get('joints', {}).values():
            self._joint(joint, *self._markers(joint))
        for name, joint in self.data.get('joints', {}).items():
            self._coordinate(name, joint['kind'], *self._markers(joint))
        for contact in self.data.get('contacts', {}).values():
            self._contact(contact, *self._markers(contact))
        signals, knots = self._couplers()
        held = list(self.coordinates)
        frames = [(*F.R.T.ravel(), *G.R[:, 0], *F.r, *G.r) for _, F, G in self.coordinates.values()]
        return Mechanism(
            names=self.names,
            mass=np.array([float(b['mass']) for b in bodies]),
            inertia=np.array([_inertia(b['inertia']) for b in bodies]),
            com=self.com,
            p=self.origin + arms,
            q=Rotation.from_matrix(self.R).as_quat(),
            v=np.array([_vector(b.get('velocity')) for b in bodies]) + turning,
            w=w,
            gravity=np.array(self.data.get('gravity', (0.0, 0.0, -MODEL_GRAVITY)), float),
            codes=np.array([(*ints, *[-1] * (5 - len(ints))) for ints, _ in self.rows], np.int64).reshape(-1, 5),
            numbers=np.array([(*numbers, *[0.0] * (WIDTH - len(numbers))) for _, numbers in self.rows], float).reshape(
                -1, WIDTH
            ),
            coordinates=np.array(
                [(kind, F.body, G.body) for kind, F, G in self.coordinates.values()], np.int64
            ).reshape(-1, 3),
            frames=np.array(frames, float).reshape(-1, 18),
            names_of_coordinates=held,
            signals=signals,
            knots=knots,
            springs=[
                (
                    *self._markers(s),
                    float(s['free_length']),
                    float(s.get('preload', 0.0)),
                    law(s.get('spring')),
                    law(s.get('damper')),
                )
                for s in self.data.get('spring_dampers', {}).values()
            ],
            bushings=[
                (
                    *self._markers(b),
                    np.array([b.get(key, [0.0] * 6) for key in ('stiffness', 'damping', 'preload')], float).ravel(),
                )
                for b in self.data.get('bushings', {}).values()
            ],
            coordinate_forces=[
                (
                    [(held.index(c), float(factor)) for c, factor in f['terms'].items()],
                    float(f.get('reference', 0.0)),
                    float(f.get('preload', 0.0)),
                    law(f.get('spring')),
                    law(f.get('damper')),
                )
                for f in self.data.get('coordinate_forces', {}).values()
            ],
            applied=[self._applied(f) for f in self.data.get('applied_forces', {}).values()],
        )

    def _index(self, name: str) -> int:
        return len(self.names) if name == 'world' else self.names.index(name)

    def _markers(self, element: Mapping[str, Any]) -> tuple[Marker, Marker]:
        return self._marker(element['i'], element), self._marker(element['j'], element)

    def _marker(self, given: Any, element: Mapping[str, Any]) -> Marker:
        """A body's name stands for the placement of the element; `at` is in the world, `position` on the body."""
        if isinstance(given, str):
            given = {
                'body': given,
                **{key: element[key] for key in ('at', 'axis', 'x_axis', 'orientation') if key in element},
            }
        body = self._index(given['body'])
        there = body == len(self.names)
        R_WB, origin, com = (
            (np.eye(3), np.zeros(3), np.zeros(3)) if there else (self.R[body], self.origin[body], self.com[body])
        )
        R = _axes(given)
        if 'at' in given:
            return Marker(body, R_WB.T @ (_vector(given['at']) - origin) - com, R_WB.T @ R)
        return Marker(body, _vector(given.get('position')) - com, R)

    def _dot(self, F: Marker, a: int, G: Marker, b: int) -> None:
        self.rows.append(((DOT, F.body, G.body), (*F.R[:, a], *G.R[:, b])))

    def _along(self, u: np.ndarray, body: int, F: Marker, G: Marker) -> None:
        self.rows.append(((ALONG, body, F.body, G.body), (*u, *F.r, *G.r)))

    def _joint(self, joint: Mapping[str, Any], F: Marker, G: Marker) -> None:
        kind, world = joint['kind'], len(self.names)
        if kind in ('fixed', 'revolute', 'spherical', 'universal', 'constant_velocity'):
            for u in np.eye(3):
                self._along(u, world, F, G)
        if kind in ('prismatic', 'cylindrical', 'point_on_line'):
            for a in (0, 1):
                self._along(F.R[:, a], F.body, F, G)
        if kind in ('fixed', 'revolute', 'prismatic', 'cylindrical'):
            self._dot(F, 0, G, 2)
            self._dot(F, 1, G, 2)
        if kind in ('fixed', 'prismatic'):
            self._dot(F, 0, G, 1)
        if kind == 'universal':
            self._dot(F, 0, G, 1)
        elif kind == 'constant_velocity':
            self.rows.append(((TWIST, F.body, G.body), (*F.R[:, 0], *G.R[:, 1], *F.R[:, 1], *G.R[:, 0])))
        elif kind == 'distance':
            length = joint.get('length')
            if length is None:
                length = np.linalg.norm(self._place(G) - self._place(F))
            self.rows.append(((APART, F.body, G.body), (*F.r, *G.r, float(length))))
        elif kind == 'point_on_plane':
            self._along(F.R[:, 2], F.body, F, G)
        elif kind == 'perpendicular':
            self._dot(F, 2, G, 2)

    def _place(self, marker: Marker) -> np.ndarray:
        if marker.body == len(self.names):
            return marker.r
        return self.origin[marker.body] + self.R[marker.body] @ (self.com[marker.body] + marker.r)

    def _coordinate(self, name: str, kind: str, F: Marker, G: Marker) -> None:
        if kind == 'revolute':
            self.coordinates[name] = (0, F, G)
        elif kind == 'prismatic':
            self.coordinates[name] = (1, F, G)
        elif kind == 'cylindrical':
            self.coordinates[f'{name}/angle'] = (0, F, G)
            self.coordinates[f'{name}/slide'] = (1, F, G)

    def _contact(self, contact: Mapping[str, Any], F: Marker, G: Marker) -> None:
        """Rows of a rolling disc: normal of the plane, axis of the disc, its centre, a point of the plane, radius, x or
        y of the plane."""
        if contact['kind'] == 'knife_edge':
            self.rows.append(((BLADE, F.body, G.body), (*G.R[:, 1], *G.r)))
            return
        disc = (*F.R[:, 2], *G.R[:, 2], *G.r, *F.r, float(contact['radius']))
        self.rows.append(((HEIGHT, F.body, G.body), disc))
        self.rows += [((SLIP, F.body, G.body), (*disc, *F.R[:, a])) for a in (0, 1)]

    def _couplers(self) -> tuple[list[Signal], list[float]]:
        signals: list[Signal] = []
        knots: set[float] = set()
        names = list(self.coordinates)
        for coupler in self.data.get('couplers', {}).values():
            terms = [(names.index(c), float(factor)) for c, factor in coupler['terms'].items()]
            number = -1
            if coupler.get('input'):
                made, times = signal(self.maneuver[coupler['input']])
                number, knots = len(signals), knots | set(times)
                signals.append(made)
            indices = [index for index, _ in terms] + [-1] * (3 - len(terms))
            factors = [factor for _, factor in terms] + [0.0] * (3 - len(terms))
            offset = coupler.get('offset')
            given = (0.0, 0.0) if offset is None else (1.0, float(offset))
            self.rows.append(((COUPLED, *indices, number), (*factors, *given)))
        return signals, sorted(knots)

    def _applied(self, force: Mapping[str, Any]) -> tuple[Marker, bool, np.ndarray, np.ndarray]:
        if force.get('input') or force.get('reaction') or force.get('frame', 'world') == 'reaction':
            raise ValueError('applied_forces: constant ones along the world or the body are read here')
        marker = self._marker(force['marker'], {})
        return marker, force.get('frame') == 'body', _vector(force.get('force')), _vector(force.get('torque'))


def _vector(given: Any) -> np.ndarray:
    return np.zeros(3) if given is None else np.array([float(x) for x in given])


def _inertia(given: Sequence[Any]) -> np.ndarray:
    xx, yy, zz, xy, xz, yz = [float(x) for x in (*given, *[0.0] * (6 - len(given)))]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _rotation(given: Mapping[str, Any]) -> np.ndarray:
    if 'orientation' in given:
        return Rotation.from_quat([float(x) for x in given['orientation']]).as_matrix()
    if 'rpy' in given:
        return Rotation.from_euler('xyz', [float(x) for x in given['rpy']]).as_matrix()
    return np.eye(3)


def _axes(given: Mapping[str, Any]) -> np.ndarray:
    """Axes of a marker: z along `axis`, x along `x_axis` or the x axis (y where z is nearly along x), made
    perpendicular."""
    if 'axis' not in given:
        return _rotation(given)
    z = _vector(given['axis'])
    z = z / np.linalg.norm(z)
    x = (
        _vector(given['x_axis'])
        if 'x_axis' in given
        else np.array([0.0, 1.0, 0.0] if abs(z[0]) > 0.9 else [1.0, 0.0, 0.0])
    )
    x = x - z * (z @ x)
    x = x / np.linalg.norm(x)
    return np.column_stack((x, np.cross(z, x), z))
