"""What a mechanism file means, and that mistakes in it are refused with their place."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from solver.elements.laws import Law
from solver.elements.marker import Marker
from solver.errors import SceneError
from solver.files.mechanism import MechanismReader
from solver.files.yaml_tree import parse
from solver.model.frames import frame_of_axis, frame_of_rpy, matrix
from solver.model.spec import ModelSpec


def model(text: str) -> ModelSpec:
    return MechanismReader().builder().build(ModelSpec, parse(text, 'file.yaml'))


TWO_BODIES = """
bodies:
  a: {mass: 1, inertia: [1, 1, 1], position: [1, 2, 3], rpy_deg: [0, 0, 90]}
  b: {mass: 1, inertia: [1, 1, 1, 0.1, 0, 0], position: [0, 1, 0], rpy: [0.3, -0.2, 0.5]}
"""


TURNING = 'coordinates:\n  x: {kind: rotation, i: a, j: b}\n'
CONVERTER = 'speed_ratios: [0, 1], torque_ratios: [2, 1], capacities: [0.01, 0]'
CLUTCH = 'ratios: [3], capacity: 100, stiffness: 100, input: pedal, gear: gear'


def placed(spec: ModelSpec, marker: Marker) -> tuple[np.ndarray, np.ndarray]:
    body = next(b for b in spec.bodies if b.name == marker.body)
    R = matrix(body.orientation)
    return np.array(body.position) + R @ marker.position, R @ matrix(marker.orientation)


def test_markers_given_in_the_world_coincide_there() -> None:
    spec = model(
        TWO_BODIES
        + 'joints:\n  j: {kind: revolute, i: a, j: b, at: [0.5, 0.6, 0.7], axis: [1, 2, 2], x_axis: [0, 0, 1]}'
    )
    for marker in (spec.joints[0].i, spec.joints[0].j):
        p, R = placed(spec, marker)
        np.testing.assert_allclose(p, [0.5, 0.6, 0.7], atol=1e-15)
        np.testing.assert_allclose(R[:, 2], np.array([1, 2, 2]) / 3.0, atol=1e-15)
        # as near to z as it can be
        np.testing.assert_allclose(R[:, 0] @ [0, 0, 1], math.sqrt(1.0 - 4.0 / 9.0), atol=1e-15)
    p, R = placed(
        spec,
        model(TWO_BODIES + 'joints:\n  j: {kind: fixed, i: {body: a, at: [4, 5, 6], rpy_deg: [90, 0, 0]}, j: b}')
        .joints[0]
        .i,
    )
    np.testing.assert_allclose(p, [4, 5, 6], atol=1e-15)
    np.testing.assert_allclose(R, frame_of_rpy([math.pi / 2, 0, 0]), atol=1e-15)


def test_local_and_bare_markers_are_taken_as_they_stand() -> None:
    joint = model(
        TWO_BODIES + 'joints:\n  j: {kind: fixed, i: a, j: {body: b, position: [1, 0, 0], axis: [0, 0, 2]}}'
    ).joints[0]
    assert joint.i == Marker(body='a')
    assert joint.j == Marker(body='b', position=(1.0, 0.0, 0.0))


@pytest.mark.parametrize('axis', [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, 1, 0), (1, 1, 1), (-3, 0.1, 0), (1e-9, 0, 5)])
def test_frame_of_axis_is_a_rotation_with_its_z_along_the_axis(axis) -> None:
    R = frame_of_axis(axis)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R[:, 2], np.array(axis) / np.linalg.norm(axis), atol=1e-15)


def test_axis_z_changes_nothing() -> None:
    assert np.array_equal(frame_of_axis((0, 0, 1)), np.eye(3))


def test_rpy_turns_about_x_then_y_then_z_of_the_world() -> None:
    turn = (
        frame_of_rpy([0.0, 0.0, math.pi / 2])
        @ frame_of_rpy([0.0, math.pi / 2, 0.0])
        @ frame_of_rpy([math.pi / 2, 0.0, 0.0])
    )
    np.testing.assert_allclose(frame_of_rpy([math.pi / 2] * 3), turn, atol=1e-15)
    np.testing.assert_allclose(frame_of_rpy([math.pi / 2, 0, 0]) @ [0, 1, 0], [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(frame_of_rpy([0, 0, math.pi / 2]) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(frame_of_rpy([0, math.pi / 2, 0]) @ [1, 0, 0], [0, 0, -1], atol=1e-15)


def test_distance_joint_takes_the_placed_distance() -> None:
    spec = model(
        TWO_BODIES
        + 'joints:\n  j: {kind: distance, i: {body: a, at: [1, 0, 0]}, j: {body: world, position: [1, 3, 4]}}'
    )
    assert spec.joints[0].length == pytest.approx(5.0, rel=1e-15)


def test_laws_are_a_rate_or_a_table() -> None:
    text = (
        TWO_BODIES
        + 'spring_dampers:\n  s: {i: a, j: b, free_length: 1, spring: 1e3, damper: [[-1, -500], [0, 0], [1, 900]]}'
    )
    spring = model(text).spring_dampers[0]
    assert spring.spring == Law.linear(1000.0)
    assert spring.damper == Law.table([[-1, -500], [0, 0], [1, 900]])


def test_inputs_are_those_that_elements_name_and_drivers_bring_their_derivatives() -> None:
    text = (
        TWO_BODIES
        + 'joints:\n  j: {kind: revolute, i: a, j: b, at: [0, 0, 0]}\ncouplers:\n  c: {terms: {j: 1}, input: motor}'
    )
    assert model(text).inputs == ('motor', 'motor_rate', 'motor_acceleration')
    assert model(text + '\ninputs: [motor, motor_rate, motor_acceleration, spare]').inputs[-1] == 'spare'


@pytest.mark.parametrize(
    ('text', 'says'),
    [
        ('joints:\n  j: {kind: fixed, i: a, j: c}', 'file.yaml:6: joints.j.j = c: no such body; allowed: a, b, world'),
        ('joints:\n  j: {kind: hinge, i: a, j: b}', "file.yaml:6: joints.j.kind = 'hinge': unknown kind of joint"),
        ('joints:\n  j: {kind: fixed, i: a, j: a}', 'must differ from i.body'),
        (
            'spring_dampers:\n  s: {i: a, j: {body: a, position: [1, 0, 0]}, free_length: 1, spring: 1}',
            "is on the body 'a' as i is",
        ),
        (
            'applied_forces:\n  f: {marker: world, force: [1, 0, 0]}',
            'file.yaml:6: applied_forces.f.marker = world: nothing moves the world',
        ),
        (
            'coordinates:\n  x: {kind: rotation, i: world, j: world}',
            "file.yaml:6: coordinates.x.j = world: is on the body 'world' as i is",
        ),
        (
            'applied_forces:\n  f: {marker: a, reaction: a, force: [1, 0, 0]}',
            "file.yaml:6: applied_forces.f.reaction = a: is on the body 'a'",
        ),
        (
            TURNING + 'couplers:\n  c: {terms: [[x, 1], [x, -1]]}',
            "couplers.c.terms = [[x, 1], [x, -1]]: the coordinate 'x' is named twice",
        ),
        (
            TURNING + f'converters:\n  c: {{pump: x, turbine: x, {CONVERTER}}}',
            "converters.c.turbine = x: the coordinate 'x' is named twice",
        ),
        (
            TURNING + f'clutches:\n  c: {{shaft: x, outputs: {{x: 1}}, {CLUTCH}}}',
            "clutches.c.outputs = {x: 1}: the coordinate 'x' is named twice",
        ),
        (
            'rods:\n  r: {i: a, j: b, length: 1, law: -1e9}',
            'file.yaml:6: rods.r.law = -1e9: a negative rate pushes apart what it should hold together',
        ),
        (
            'spring_dampers:\n  s: {i: a, j: b, free_length: 1, damper: -5}',
            'give 5, or, where that is intended, points: [[-1, 5]',
        ),
        (
            'joints:\n  j: {kind: fixed, i: a, j: b, axis: [1, 0, 0]}',
            "file.yaml:6: joints.j.axis: needs the key 'at' beside it",
        ),
        (
            'joints:\n  j: {kind: fixed, i: a, j: b, at: [0, 0, 0], axis: [0, 0, 0]}',
            'joints.j.axis = [0, 0, 0]: the axis must not be zero',
        ),
        (
            'joints:\n  j: {kind: fixed, i: a, j: b, at: [0, 0, 0], axis: [1, 0, 0], x_axis: [2, 0, 0]}',
            'must not be parallel',
        ),
        ('joints:\n  j: {kind: fixed, i: a, j: b, at: [0, 0, 0], x_axis: [2, 0, 0]}', "needs the key 'axis'"),
        ('joints:\n  j: {kind: fixed, i: a, j: b, at: [0, 0, 0], axis: [1, 0, 0], rpy: [0, 0, 0]}', 'keep one of them'),
        ('joints:\n  j: {kind: fixed, i: {body: a, at: [0, 0, 0], position: [0, 0, 0]}, j: b}', "either 'at'"),
        (
            'joints:\n  j: {kind: revolute, i: {body: a}, j: {body: b}, at: [0, 0, 0], axis: [1, 0, 0]}',
            'file.yaml:6: joints.j.at: has no effect, since every marker has a place of its own; give one marker as '
            'the bare ',
        ),
        ('applied_forces:\n  f: {marker: {body: a}, input: u, at: [0, 0, 0]}', 'applied_forces.f.at: has no effect'),
        ('joints:\n  j: {kind: fixed, i: {body: a, at: [0, 0, 0], foo: 1}, j: b}', 'joints.j.i.foo: unknown key'),
        ('joints:\n  j: {kind: fixed, i: {body: a, positon: [0, 0, 0]}, j: b}', "did you mean 'position'"),
        ('spring_dampers:\n  s: {i: a, j: b, free_length: 1, spring: [[0, 0], [0, 1]]}', 'spring_dampers.s.spring'),
        (
            'spring_dampers:\n  s: {i: a, j: b, free_length: -1}',
            'file.yaml:6: spring_dampers.s.free_length = -1.0: must be >= 0',
        ),
        ('bushing: {}', "file.yaml:5: bushing: unknown key; did you mean 'bushings'?"),
        ('chassis: c', "chassis = 'c': no such body; allowed: a, b"),
        ('gravity: [0, 0]', 'file.yaml:5: gravity = [0, 0]: must be a list of 3 values'),
    ],
)
def test_a_mistake_in_a_mechanism_is_refused_with_its_place(text: str, says: str) -> None:
    with pytest.raises(SceneError, match=re.escape(says)):
        model(TWO_BODIES.lstrip('\n') + '\n' + text)
