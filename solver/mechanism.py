"""Mechanism files: the sections of a file are the fields of ModelSpec, the entries of a section are named element specs.

So a new element kind can be written in a file as soon as ModelSpec has a field for it. What a file may write more conveniently
than the specs: markers by their place in the assembled mechanism, axes instead of orientations, roll-pitch-yaw, diagonal
inertias, laws as a rate or a list of points (docs/scene.md).
"""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from solver.elements.coupler import CouplerSpec
from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.marker import WORLD, Marker, Quaternion, Spec, Vector
from solver.elements.rigid_body import RigidBodySpec
from solver.errors import SceneError, suggestion
from solver.lie.so3 import matrix_of_quaternion, quaternion_of_matrix
from solver.linkages import LINKAGES
from solver.load import Builder, Fields
from solver.maneuver import ACCELERATION, RATE
from solver.model.spec import ModelSpec
from solver.nodes import Node, ScalarNode, SequenceNode, join, refuse, where

PARALLEL = 0.9  # |cosine| above which a coordinate axis is too close to the joint axis to define its x axis
ROTATION_KEYS = ('orientation', 'rpy', 'rpy_deg', 'axis', 'x_axis')


class Placement(NamedTuple):
    """A frame in the world: origin [m] (3,), axes (3, 3)."""

    p: np.ndarray
    R: np.ndarray


def frame_of_axis(axis: Sequence[float], x_axis: Sequence[float] | None = None) -> np.ndarray:
    """(3, 3) rotation whose z column is along `axis` and whose x column is `x_axis` made perpendicular to it.

    Without x_axis the x column comes from the first coordinate axis, or from the second where the first is nearly parallel to
    the axis; so axis (0, 0, 1) gives the identity. Raises ValueError for zero or parallel axes.
    """
    length = float(np.linalg.norm(axis))
    if length < 1e-12:
        raise ValueError('the axis must not be zero')
    z = np.asarray(axis, float) / length
    if x_axis is None:
        x_axis = (1.0, 0.0, 0.0) if abs(z[0]) < PARALLEL else (0.0, 1.0, 0.0)
    x = np.asarray(x_axis, float) - np.dot(x_axis, z) * z
    size = float(np.linalg.norm(x))
    if size < 1e-6 * max(float(np.linalg.norm(x_axis)), 1e-12):
        raise ValueError('x_axis must not be parallel to axis')
    x /= size
    return np.column_stack([x, np.cross(z, x), z])


def frame_of_rpy(rpy: Sequence[float]) -> np.ndarray:
    """(3, 3) rotation Rz(yaw) Ry(pitch) Rx(roll), angles [rad]."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def quaternion(R: np.ndarray) -> Quaternion:
    """Unit quaternion xyzw of a rotation matrix."""
    x, y, z, w = quaternion_of_matrix(tuple(float(r) for r in R.ravel()))
    return (x, y, z, w)


def matrix(q: Sequence[float]) -> np.ndarray:
    """(3, 3) rotation matrix of a unit quaternion xyzw."""
    return np.array(matrix_of_quaternion(tuple(float(c) for c in q))).reshape(3, 3)


@dataclass(frozen=True)
class MechanismReader:
    """The hooks that read element specs; bodies collects the placement of each body as it is read."""

    bodies: dict[str, Placement] = dataclasses.field(default_factory=lambda: {WORLD: Placement(np.zeros(3), np.eye(3))})

    def builder(self) -> Builder:
        """A loader that understands mechanism files."""
        hooks = {ModelSpec: self.model, RigidBodySpec: self.body, Spec: self.element, Marker: self.marker, Law: self.law}
        return Builder(hooks)

    def model(self, builder: Builder, cls: type, node: Node, path: str, name: str | None) -> ModelSpec:
        """A ModelSpec, or a linkage by `kind`. Bodies first, markers may be placed in the world; inputs from their uses unless listed."""
        fields = builder.mapping(node, path)
        if 'kind' in fields:
            kind = fields.pop('kind')[1]
            if kind.value not in LINKAGES:
                raise refuse(kind, join(path, 'kind'), 'unknown kind of mechanism' + suggestion(str(kind.value), LINKAGES))
            data, linkage = LINKAGES[kind.value]
            return linkage(builder.construct(data, fields, node, path, extra=('kind',)))
        given: dict[str, object] = {}
        if 'bodies' in fields:
            given['bodies'] = builder.build(tuple[RigidBodySpec, ...], fields.pop('bodies')[1], join(path, 'bodies'))
        model = builder.construct(cls, fields, node, path, given=given)
        return model if 'inputs' in fields else dataclasses.replace(model, inputs=used_inputs(model))

    def body(self, builder: Builder, cls: type, node: Node, path: str, name: str | None) -> RigidBodySpec:
        """A body: orientation, rpy or rpy_deg; inertia with three or six numbers."""
        fields = builder.mapping(node, path)
        given: dict[str, object] = {}
        R = rotation(builder, fields, path, ('orientation', 'rpy', 'rpy_deg'))
        if R is not None:
            given['orientation'] = R
        inertia = fields.get('inertia')
        if inertia is not None and isinstance(inertia[1], SequenceNode) and len(inertia[1].value) == 3:
            given['inertia'] = (*builder.build(Vector, fields.pop('inertia')[1], join(path, 'inertia')), 0.0, 0.0, 0.0)
        body = builder.construct(cls, fields, node, path, name=name, given=given, extra=('rpy', 'rpy_deg'))
        self.bodies[body.name] = Placement(np.array(body.position), matrix(body.orientation))
        return body

    def element(self, builder: Builder, cls: type, node: Node, path: str, name: str | None) -> Any:
        """Any other element: `at`, `axis`, ... beside the markers place all markers that are given as bare body names."""
        fields = builder.mapping(node, path)
        hints = typing.get_type_hints(cls)
        markers = [f.name for f in dataclasses.fields(cls) if hints[f.name] is Marker]
        placed = [k for k in ('at', *ROTATION_KEYS) if markers and k in fields and k not in hints]
        placement = None
        if placed:
            if 'at' not in placed:
                raise SceneError(
                    f"{where(fields[placed[0]][0])}: {join(path, placed[0])}: needs the key 'at' beside it (a point in the world)"
                )
            placement = self.placement(builder, fields, path)
        given: dict[str, object] = {m: self._marker(builder, fields.pop(m)[1], join(path, m), placement) for m in markers if m in fields}
        if cls is JointSpec and 'length' not in fields and 'kind' in fields and fields['kind'][1].value == 'distance' and len(given) == 2:
            given['length'] = float(np.linalg.norm(self.point(given['j']) - self.point(given['i'])))
        extra = ('at', *(k for k in ROTATION_KEYS if k not in hints)) if markers else ()
        return builder.construct(cls, fields, node, path, name=name, given=given, extra=extra)

    def placement(self, builder: Builder, fields: Fields, path: str) -> Placement:
        """The frame given by at and axis, orientation or rpy, in the world; takes these keys out of fields."""
        at = np.array(builder.build(Vector, fields.pop('at')[1], join(path, 'at')))
        R = rotation(builder, fields, path, ROTATION_KEYS)
        return Placement(at, np.eye(3) if R is None else matrix(R))

    def marker(self, builder: Builder, cls: type, node: Node, path: str, name: str | None) -> Marker:
        """A marker outside of any placement."""
        return self._marker(builder, node, path, None)

    def _marker(self, builder: Builder, node: Node, path: str, placement: Placement | None) -> Marker:
        if not isinstance(node, ScalarNode):
            fields = builder.mapping(node, path)
            body = builder.build(str, fields['body'][1], join(path, 'body')) if 'body' in fields else None
            if 'at' in fields and body is not None:
                self._known(body, fields['body'][1], join(path, 'body'))
                if 'position' in fields:
                    raise refuse(
                        fields['position'][1], join(path, 'position'), "give either 'at' (in the world) or 'position' (in the body)"
                    )
                frame = self.placement(builder, fields, path)
                fields.pop('body')
                builder.construct(_Nothing, fields, node, path, extra=('body', 'at', *ROTATION_KEYS))
                return self.local(body, frame)
            R = rotation(builder, fields, path, ROTATION_KEYS)
            given = {} if R is None else {'orientation': R}
            if body is not None:
                self._known(body, fields['body'][1], join(path, 'body'))
            return builder.construct(Marker, fields, node, path, given=given, extra=('at', *ROTATION_KEYS))
        body = builder.build(str, node, path)
        self._known(body, node, path)
        return Marker(body=body) if placement is None else self.local(body, placement)

    def _known(self, body: str, node: Node, path: str) -> None:
        if body not in self.bodies:
            raise refuse(node, path, 'no such body' + suggestion(body, self.bodies))

    def local(self, body: str, frame: Placement) -> Marker:
        """The marker on a body that coincides with a frame in the world in the placed configuration."""
        p, R = self.bodies[body]
        x, y, z = (float(c) for c in R.T @ (frame.p - p))
        return Marker(body=body, position=(x, y, z), orientation=quaternion(R.T @ frame.R))

    def point(self, marker: object) -> np.ndarray:
        """(3,) place of a marker in the world [m]."""
        assert isinstance(marker, Marker)
        p, R = self.bodies[marker.body]
        return p + R @ np.array(marker.position)

    def law(self, builder: Builder, cls: type, node: Node, path: str, name: str | None) -> Law:
        """A number is the rate of a straight line, a list of [x, y] points a monotone cubic."""
        value = builder.build(float | tuple[tuple[float, float], ...], node, path)  # type: ignore[arg-type]
        return Law.linear(value) if isinstance(value, float) else Law.table(value)


@dataclass(frozen=True)
class _Nothing:
    """A dataclass without fields: refuses every key that is left."""


def rotation(builder: Builder, fields: Fields, path: str, allowed: Sequence[str]) -> Quaternion | None:
    """The orientation given by one of orientation, rpy, rpy_deg or axis (+ x_axis), taken out of fields; None without one."""
    used = [k for k in allowed if k in fields and k != 'x_axis']
    if len(used) > 1:
        raise SceneError(f'{where(fields[used[1]][0])}: {join(path, used[1])}: is given beside {used[0]!r}; keep one of them')
    if not used:
        if 'x_axis' in allowed and 'x_axis' in fields:
            raise SceneError(f"{where(fields['x_axis'][0])}: {join(path, 'x_axis')}: needs the key 'axis' beside it")
        return None
    key = used[0]
    node = fields.pop(key)[1]
    if key == 'orientation':
        return builder.build(Quaternion, node, join(path, key))
    if key != 'axis':
        rpy = builder.build(Vector, node, join(path, key))
        return quaternion(frame_of_rpy(np.deg2rad(rpy) if key == 'rpy_deg' else rpy))
    axis = builder.build(Vector, node, join(path, key))
    x_axis = builder.build(Vector, fields.pop('x_axis')[1], join(path, 'x_axis')) if 'x_axis' in fields else None
    try:
        return quaternion(frame_of_axis(axis, x_axis))
    except ValueError as error:
        raise refuse(node, join(path, key), str(error)) from None


def used_inputs(model: ModelSpec) -> tuple[str, ...]:
    """Input channels that the elements of a model mention, in order of first mention; drivers with their derivatives."""
    names: dict[str, None] = {}
    for field in dataclasses.fields(model):
        specs = getattr(model, field.name)
        for spec in specs if isinstance(specs, tuple) else ():
            name = getattr(spec, 'input', None)
            if isinstance(name, str):
                names[name] = None
                if isinstance(spec, CouplerSpec):
                    names[name + RATE] = names[name + ACCELERATION] = None
    return tuple(names)
