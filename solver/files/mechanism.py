"""Mechanism files: the sections of a file are the fields of ModelSpec, the entries of a section are named element
specs.

So a new element kind can be written in a file as soon as ModelSpec has a field for it. Forms in which a file may write
specs more conveniently: markers by their place in the assembled mechanism, axes instead of orientations,
roll-pitch-yaw, diagonal inertias, laws as a rate or a list of points (docs/scene.md).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver.compiled.portable import norm, product
from solver.dimensions import Angle, Moments, Point
from solver.elements.aero_drag import AeroDragSpec
from solver.elements.applied_force import AppliedForceSpec
from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.marker import WORLD, Marker, Spec
from solver.elements.rigid_body import RigidBodySpec
from solver.errors import SceneError, suggestion
from solver.files.linkages import LINKAGES
from solver.files.schema import Builder, Fields, hints_of, unit_of
from solver.files.yaml_tree import Node, ScalarNode, SequenceNode, join, refuse, where
from solver.model.frames import Placement, frame_of_axis, frame_of_rpy, matrix, quaternion
from solver.model.spec import ModelSpec, used_inputs
from solver.validate import Quaternion, Vector

ROTATION_KEYS = ('orientation', 'rpy', 'rpy_deg', 'axis', 'x_axis')


@dataclass(frozen=True)
class MechanismReader:
    """The hooks that read element specs; bodies collects the placement of each body as it is read."""

    bodies: dict[str, Placement] = dataclasses.field(default_factory=lambda: {WORLD: Placement(np.zeros(3), np.eye(3))})

    def builder(self) -> Builder:
        """A loader that understands mechanism files."""
        hooks = {
            ModelSpec: self.model,
            RigidBodySpec: self.body,
            Spec: self.element,
            Marker: self.marker,
            Law: self.law,
        }
        return Builder(hooks)

    def model(self, builder: Builder, cls: type, node: Node, path: str, name: str | None) -> ModelSpec:
        """A ModelSpec, or a linkage by `kind`. Bodies first, markers may be placed in the world; inputs from their uses
        unless listed."""
        fields = builder.mapping(node, path)
        if 'kind' in fields:
            kind = builder.choice(fields.pop('kind')[1], join(path, 'kind'), LINKAGES, 'unknown kind of mechanism')
            data, linkage = LINKAGES[kind]
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
            given['inertia'] = (
                *_built(builder, Moments, fields.pop('inertia')[1], join(path, 'inertia')),
                0.0,
                0.0,
                0.0,
            )
        body = builder.construct(cls, fields, node, path, name=name, given=given, extra=('rpy', 'rpy_deg'))
        self.bodies[body.name] = Placement(np.array(body.position), matrix(body.orientation))
        return body

    def element(self, builder: Builder, cls: type, node: Node, path: str, name: str | None) -> Any:
        """Any other element: `at`, `axis`, ... beside the markers place all markers that are given as bare body
        names."""
        fields = builder.mapping(node, path)
        hints = hints_of(cls)
        markers = [f.name for f in dataclasses.fields(cls) if hints[f.name] is Marker]
        placed = [k for k in ('at', *ROTATION_KEYS) if markers and k in fields and k not in hints]
        placement = None
        if placed:
            if 'at' not in placed:
                raise SceneError(
                    f"{where(fields[placed[0]][0])}: {join(path, placed[0])}: needs the key 'at' beside it (a point in "
                    'the world)'
                )
            if not any(isinstance(fields[m][1], ScalarNode) for m in markers if m in fields):
                raise SceneError(
                    f'{where(fields["at"][0])}: {join(path, "at")}: has no effect, since every marker has a place of '
                    'its own; give one marker as the bare name of its body, to place it here, or remove this key'
                )
            placement = self.placement(builder, fields, path)
        given: dict[str, object] = {
            m: self._marker(builder, fields.pop(m)[1], join(path, m), placement) for m in markers if m in fields
        }
        distance = cls is JointSpec and 'kind' in fields and fields['kind'][1].value == 'distance'
        if distance and not {'length', 'length_mm'} & set(fields) and len(given) == 2:
            given['length'] = norm(self.point(given['j']) - self.point(given['i']))
        extra = ('at', *(k for k in ROTATION_KEYS if k not in hints)) if markers else ()
        element = builder.construct(cls, fields, node, path, name=name, given=given, extra=extra)
        _require_two_ends(element, builder.mapping(node, path), path)
        if (
            isinstance(element, AppliedForceSpec | AeroDragSpec)
            and element.marker.body == WORLD
            and getattr(element, 'reaction', None) is None
        ):
            raise refuse(
                builder.mapping(node, path)['marker'][1], join(path, 'marker'), 'nothing moves the world; name a body'
            )
        return element

    def placement(self, builder: Builder, fields: Fields, path: str) -> Placement:
        """The frame given by at and axis, orientation or rpy, in the world; takes these keys out of fields."""
        at = np.array(_built(builder, Point, fields.pop('at')[1], join(path, 'at')))
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
                for key in ('position', 'position_mm'):
                    if key in fields:
                        raise refuse(
                            fields[key][1],
                            join(path, key),
                            "give either 'at' (in the world) or 'position' (in the body)",
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
        x, y, z = (float(c) for c in product(R.T, frame.p - p))
        return Marker(body=body, position=(x, y, z), orientation=quaternion(product(R.T, frame.R)))

    def point(self, marker: object) -> np.ndarray:
        """(3,) place of a marker in the world [m]."""
        assert isinstance(marker, Marker)
        p, R = self.bodies[marker.body]
        return p + product(R, marker.position)

    def law(self, builder: Builder, cls: type, node: Node, path: str, name: str | None) -> Law:
        """A number is the rate of a straight line, a list of [x, y] points a monotone cubic."""
        value = builder.build(float | tuple[tuple[float, float], ...], node, path)
        if isinstance(value, float) and value < 0.0:
            # a sign by mistake: what no step resolves of the motion that grows from it is damped away, and nothing
            # shows
            raise refuse(node, path, f'a negative rate pushes apart what it should hold together; give {-value:g}, '
                         f'or, where that is intended, points: '
                         f'[[-1, {-value:g}], [1, {value:g}]]')  # fmt: skip
        return Law.linear(value) if isinstance(value, float) else Law.table(value)


def _require_two_ends(element: Any, fields: Fields, path: str) -> None:
    """Refuse what acts between two bodies or coordinates and has the same one twice: it would do nothing, without a
    word."""
    for first, second in (('i', 'j'), ('marker', 'reaction')):
        if second in fields and first in fields and getattr(element, first).body == getattr(element, second).body:
            one = getattr(element, first)
            raise refuse(
                fields[second][1],
                join(path, second),
                f'is on the body {one.body!r} as {first} is, and must be on another one',
            )
    for key, others in (('terms', ()), ('outputs', ('shaft',)), ('turbine', ('pump',))):
        if key not in fields or not hasattr(element, key):
            continue
        given = getattr(element, key)
        names = [getattr(element, other) for other in others] + (
            [given] if isinstance(given, str) else [name for name, _ in given]
        )
        for k, name in enumerate(names):
            if name in names[:k]:
                raise refuse(
                    fields[key][1], join(path, key), f'the coordinate {name!r} is named twice; give different ones'
                )


def _built(builder: Builder, hint: Any, node: Node, path: str) -> Any:
    """Value of a key that is no field, with its unit told as that of a field is."""
    builder.units[path] = unit_of(hint)
    return builder.build(hint, node, path)


@dataclass(frozen=True)
class _Nothing:
    """A dataclass without fields: refuses every key that is left."""


def rotation(builder: Builder, fields: Fields, path: str, allowed: Sequence[str]) -> Quaternion | None:
    """The orientation given by one of orientation, rpy, rpy_deg or axis (+ x_axis), taken out of fields; None without
    one."""
    used = [k for k in allowed if k in fields and k != 'x_axis']
    if len(used) > 1:
        raise SceneError(
            f'{where(fields[used[1]][0])}: {join(path, used[1])}: is given beside {used[0]!r}; keep one of them'
        )
    if not used:
        if 'x_axis' in allowed and 'x_axis' in fields:
            raise SceneError(f"{where(fields['x_axis'][0])}: {join(path, 'x_axis')}: needs the key 'axis' beside it")
        return None
    key = used[0]
    node = fields.pop(key)[1]
    if key == 'orientation':
        return builder.build(Quaternion, node, join(path, key))
    if key != 'axis':
        rpy = _built(builder, tuple[Angle, Angle, Angle], node, join(path, key))
        turned = rpy if key == 'rpy' else tuple(math.radians(x) for x in rpy)
        builder.require_within(Angle, turned, node, join(path, key), '' if key == 'rpy' else 'deg')
        if key == 'rpy':
            return quaternion(frame_of_rpy(rpy))
        builder.units[join(path, key)] = 'deg'
        return quaternion(frame_of_rpy(np.deg2rad(rpy)))
    axis = builder.build(Vector, node, join(path, key))
    x_axis = builder.build(Vector, fields.pop('x_axis')[1], join(path, 'x_axis')) if 'x_axis' in fields else None
    try:
        return quaternion(frame_of_axis(axis, x_axis))
    except ValueError as error:
        raise refuse(node, join(path, key), str(error)) from None
