"""The joint cases that Project Chrono [Tasora2016] keeps with results of Adams: one body on one joint, spring or
actuator, 5 s.

The models are ours, after the Adams data sets (data/testing/joints/adams_models) and the unit tests
(src/tests/unit_tests/joints) of github.com/projectchrono/chrono; the figures are those of
data/testing/joints/*/<case>_ADAMS_*.txt at three instants.

Adams gives the force and the torque that act on the ground: of its marker there, about its origin, along the axes of
the world. The joints here have the ground as body i, so it is the opposite of solver.analysis.reactions.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mbd_sim_ros.lab.studies.published import PublishedProblem, Quantity, read
from solver.analysis.reactions import Reaction, joint_reaction
from solver.files.scene import load_scene_text
from solver.scene import Scene
from solver.simulation import Simulation
from solver.units import STANDARD_GRAVITY

SOURCE = 'github.com/projectchrono/chrono, data/testing/joints'
BODY = 'pendulum'
# kg m^2, of the bar of 1 kg along its x, y or z
BAR, BAR_Y, BAR_Z = (0.04, 0.1, 0.1), (0.1, 0.04, 0.1), (0.1, 0.1, 0.04)
Made = dict[str, Any]


def _turn(axis: str, degrees: float) -> Rotation:
    return Rotation.from_euler(axis, degrees, degrees=True)


def _bar(position: Any, turn: Rotation | None = None, inertia: tuple[float, ...] = BAR, **velocity: Any) -> Made:
    """The body, with its frame in the centre of mass."""
    orientation = (turn or Rotation.identity()).as_quat()
    return {
        'mass': 1,
        'inertia': [*inertia],
        'position': [*map(float, position)],
        'orientation': orientation.tolist(),
        **velocity,
    }


def _on_joint(kind: str, place: Any, turn: Rotation, **extra: Any) -> Made:
    """A bar of 4 m along x of the frame of the joint, which is at its end."""
    joint = {'kind': kind, 'i': 'world', 'j': BODY, 'at': [*map(float, place)], 'orientation': turn.as_quat().tolist()}
    return {
        'bodies': {BODY: _bar(np.array(place) + turn.apply([2.0, 0.0, 0.0]), turn)},
        'joints': {'joint': joint},
        **extra,
    }


def _universal(turn: Rotation) -> Made:
    """A bar along -z of the frame of the joint at the origin: pins are x of the ground's marker and y of the bar's."""
    joint = {'kind': 'universal', 'i': 'world', 'j': BODY, 'at': [0, 0, 0], 'orientation': turn.as_quat().tolist()}
    return {'bodies': {BODY: _bar(turn.apply([0.0, 0.0, -2.0]), turn, BAR_Z)}, 'joints': {'joint': joint}}


def _between(kind: str, ground: Any, held: Any, bar: Made, **data: Any) -> Made:
    """A distance joint or a spring from a point of the ground to one of the bar; both as placed."""
    ends = {'i': {'body': 'world', 'at': [*map(float, ground)]}, 'j': {'body': BODY, 'at': [*map(float, held)]}}
    if kind == 'distance':
        return {'bodies': {BODY: bar}, 'joints': {'joint': {'kind': kind, **ends}}}
    length = float(np.linalg.norm(np.array(held, float) - np.array(ground, float)))
    return {'bodies': {BODY: bar}, 'spring_dampers': {'spring': {**ends, 'free_length': length, **data}}}


def _revolute_spherical(ground: Any, axis: Any, held: Any, bar: Made) -> Made:
    """A massless link that turns on the ground about `axis` and carries the bar on a ball: the distance stays, in a
    plane."""
    i, j = {'body': 'world', 'at': [*ground], 'axis': [*axis]}, {'body': BODY, 'at': [*held]}
    return {
        'bodies': {BODY: bar},
        'joints': {'joint': {'kind': 'distance', 'i': i, 'j': j}, 'plane': {'kind': 'point_on_plane', 'i': i, 'j': j}},
    }


def _drop(stiffness: float, damping: float) -> Made:
    """A spring whose ends coincide at the start, as a bushing: on the vertical it is the same."""
    bushing = {'i': 'world', 'j': BODY, 'stiffness': [stiffness] * 3 + [0.0] * 3, 'damping': [damping] * 3 + [0.0] * 3}
    return {'bodies': {BODY: _bar((0, 0, 0))}, 'bushings': {'spring': bushing}}


def _actuator(turn: Rotation, speed: float) -> Made:
    """A plate on a prismatic joint that is driven at a constant speed."""
    axis = turn.apply([0.0, 0.0, 1.0])
    joint = {'kind': 'prismatic', 'i': 'world', 'j': BODY, 'at': [0, 0, 0], 'orientation': turn.as_quat().tolist()}
    return {
        'bodies': {BODY: _bar((0, 0, 0), turn, (1.0, 1.0, 1.0), velocity=(speed * axis).tolist())},
        'joints': {'joint': joint},
        'couplers': {'driver': {'terms': {'joint': 1}, 'input': 'travel'}},
    }


def _quadratic(linear: float, square: float, reach: float, points: int = 801) -> list[list[float]]:
    """The law linear x + square |x| x as points of a table, as far as `reach`."""
    return [[float(x), float(linear * x + square * abs(x) * x)] for x in np.linspace(-reach, reach, points)]


def _hinge_spring(spring: Any) -> Made:
    return {'spring': {'terms': {'joint': 1}, 'spring': spring, 'damper': 10.0}}


TILTED, Y_AXIS, Z_AXIS = _turn('x', -45), _turn('x', -90), Rotation.identity()
DIAGONAL = Rotation.from_rotvec(np.pi / 2 * np.array([1.0, -1.0, 0.0]) / np.sqrt(2))
STIFFENING = {'spring': _quadratic(50, 10, 4.0), 'damper': 5.0}
CORNER = (1, 2, 3)

MODELS: dict[str, tuple[str, Callable[[], Made]]] = {
    'Revolute_Case01': ('pendulum on a revolute joint along y', lambda: _on_joint('revolute', (0, 0, 0), Y_AXIS)),
    'Revolute_Case02': (
        'on an inclined revolute joint away from the origin',
        lambda: _on_joint('revolute', CORNER, TILTED),
    ),
    'Spherical_Case01': ('pendulum on a spherical joint', lambda: _on_joint('spherical', (0, 0, 0), Z_AXIS)),
    'Spherical_Case02': (
        'the same elsewhere, bar turned about its axis',
        lambda: _on_joint('spherical', CORNER, TILTED),
    ),
    'Universal_Case01': (
        'pendulum on a universal joint, swinging about the pin of the ground',
        lambda: _universal(_turn('x', 90)),
    ),
    'Universal_Case02': ('swinging about the pin of the bar', lambda: _universal(_turn('y', 90))),
    'Universal_Case03': ('swinging about both pins', lambda: _universal(DIAGONAL)),
    'Prismatic_Case01': ('free fall along a prismatic joint', lambda: _on_joint('prismatic', (0, 0, 0), Z_AXIS)),
    'Prismatic_Case02': ('sliding down an inclined one', lambda: _on_joint('prismatic', CORNER, TILTED)),
    'Prismatic_Case03': ('resting on a horizontal one', lambda: _on_joint('prismatic', CORNER, Y_AXIS)),
    'Cylindrical_Case01': ('free fall along a cylindrical joint', lambda: _on_joint('cylindrical', (0, 0, 0), Z_AXIS)),
    'Cylindrical_Case02': ('pendulum on a horizontal one', lambda: _on_joint('cylindrical', (0, 0, 0), Y_AXIS)),
    'Cylindrical_Case03': ('sliding and turning on an inclined one', lambda: _on_joint('cylindrical', CORNER, TILTED)),
    'Distance_Case01': (
        'rod to the centre of the bar',
        lambda: _between('distance', (0, 0, 0), (0, 2, 0), _bar((0, 2, 0))),
    ),
    'Distance_Case02': (
        'rod to the end of a bar at right angles: a whip',
        lambda: _between('distance', CORNER, (1, 4, 3), _bar((-1, 4, 3))),
    ),
    'Distance_Case03': (
        'rod in line with the bar: a double pendulum',
        lambda: _between('distance', (0, 0, 0), (0, 2, 0), _bar((0, 4, 0), _turn('z', -90))),
    ),
    'RevSpherical_Case01': (
        'massless link with a revolute and a spherical joint',
        lambda: _revolute_spherical((0, 0, 0), (0, 0, 1), (2, 0, 0), _bar((2, 2, 0), None, BAR_Y)),
    ),
    'RevSpherical_Case02': (
        'the same, inclined and away from the origin',
        lambda: _revolute_spherical(CORNER, (0, 1, 1), (3, 2, 3), _bar((3, 4, 3), None, BAR_Y)),
    ),
    'RotSpring_Case01': (
        'pendulum on a torsional spring',
        lambda: _on_joint('revolute', (0, 0, 0), Y_AXIS, coordinate_forces=_hinge_spring(200.0)),
    ),
    'RotSpring_Case02': (
        'on a stiffening one',
        lambda: _on_joint('revolute', (0, 0, 0), Y_AXIS, coordinate_forces=_hinge_spring(_quadratic(50, 10, 2.0))),
    ),
    'TranSpring_Case01': (
        'spring of no length',
        lambda: _between('spring', (0, 0, 0), (0, 0, 0), _bar((0, 0, 0)), spring=10.0, damper=0.5),
    ),
    'TranSpring_Case02': (
        'spring to the centre of the bar',
        lambda: _between('spring', (0, 0, 0), (0, 2, 0), _bar((0, 2, 0)), spring=100.0, damper=5.0),
    ),
    'TranSpringCB_Case01': ('the same as a bushing', lambda: _drop(10.0, 0.5)),
    'TranSpringCB_Case02': (
        'spring to the centre of the bar',
        lambda: _between('spring', (0, 0, 0), (0, 2, 0), _bar((0, 2, 0)), spring=100.0, damper=5.0),
    ),
    'TranSpringCB_Case03': (
        'stiffening spring to the end of a bar at right angles',
        lambda: _between('spring', CORNER, (1, 4, 3), _bar((-1, 4, 3)), **STIFFENING),
    ),
    'TranSpringCB_Case04': (
        'stiffening spring in line with the bar',
        lambda: _between('spring', (0, 0, 0), (0, 2, 0), _bar((0, 4, 0), _turn('z', -90)), **STIFFENING),
    ),
    'LinActuator_Case01': ('plate driven upwards at 1 m/s', lambda: _actuator(Z_AXIS, 1.0)),
    'LinActuator_Case02': ('plate driven along x = z at 0.5 m/s', lambda: _actuator(_turn('y', 45), 0.5)),
}
SPEEDS = {'LinActuator_Case01': 1.0, 'LinActuator_Case02': 0.5}  # m/s
# First steps [s]; a bar that whips around the end of a rod or a link needs small ones
USUAL_STEP = 0.005
STEPS = {
    'Distance_Case02': 2.5e-4,
    'Distance_Case03': 2.5e-3,
    'RevSpherical_Case01': 5e-4,
    'RevSpherical_Case02': 5e-4,
    'TranSpringCB_Case04': 2.5e-3,
}
# Accuracy of the figures, of the largest number of a quantity (or of 1 where that is smaller): digits to 5e-6, the rest
# is the error of the integration in Adams. Of four cases that is larger: see spread().
USUAL_ACCURACY = 1e-4
SAME = ('Revolute_Case01', 'Spherical_Case01', 'Universal_Case01', 'Universal_Case02', 'Cylindrical_Case02')
ACCURACY = dict.fromkeys(('Spherical_Case01', 'Universal_Case01', 'Universal_Case02', 'Universal_Case03'), 1e-3)


def scene(name: str, h: float) -> Scene:
    """The scene of a case with a step [s] and the default integrator."""
    mechanism = {'gravity': [0, 0, -STANDARD_GRAVITY], **MODELS[name][1]()}
    made: Made = {'title': name, 'mechanism': mechanism, 'integrator': {'h': h}, 'duration': 5}
    if name in SPEEDS:
        made['maneuver'] = {
            'signals': {
                'travel': {'kind': 'ramp', 'slope': SPEEDS[name], 'start': -1, 'initial': -SPEEDS[name], 'blend': 0}
            }
        }
    return load_scene_text(json.dumps(made), name)


# -- what is compared ------------------------------------------------------------------------------------------------


def _position(s: Simulation) -> np.ndarray:
    return s.snapshot().pose[0, :3]


def _orientation(s: Simulation) -> np.ndarray:
    """Scalar first, as published."""
    return np.roll(s.snapshot().pose[0, 3:], 1)


def _velocity(s: Simulation) -> np.ndarray:
    snapshot = s.snapshot()
    return Rotation.from_quat(snapshot.pose[0, 3:]).apply(snapshot.twist[0, :3])


def _angular_velocity(s: Simulation) -> np.ndarray:
    snapshot = s.snapshot()
    return Rotation.from_quat(snapshot.pose[0, 3:]).apply(snapshot.twist[0, 3:])


def _on_the_bar(s: Simulation) -> Reaction:
    """Everything that holds the bar, about the origin of the ground's marker: joints, and what acts along the joint's
    coordinate."""
    parts = [joint_reaction(s, joint.name) for joint in s.scene.model.joints]
    if not parts:
        return _of_spring(s)
    force, torque = np.sum([p.force for p in parts], axis=0), np.sum([p.torque for p in parts], axis=0)
    if s.scene.model.coordinate_forces:
        torque = torque + s.snapshot().joint_effort[0] * _axis(s)
    return Reaction(force, torque, parts[0].point)


def _of_spring(s: Simulation) -> Reaction:
    elements = dict(zip(s.channels.elements, s.snapshot().elements, strict=True))
    if s.scene.model.bushings:
        return Reaction(np.array([elements[f'spring/{f}'] for f in ('fx', 'fy', 'fz')]), np.zeros(3), np.zeros(3))
    i, j = s.scene.model.spring_dampers[0].i, s.scene.model.spring_dampers[0].j
    pose = s.snapshot().pose[0]
    along = pose[:3] + Rotation.from_quat(pose[3:]).apply(j.position) - np.array(i.position)
    return Reaction(-elements['spring/force'] * along / np.linalg.norm(along), np.zeros(3), np.array(i.position))


def _axis(s: Simulation) -> np.ndarray:
    """z of the joint's marker on the ground."""
    return Rotation.from_quat(s.scene.model.joints[0].i.orientation).apply([0.0, 0.0, 1.0])


def _place_of_ball(s: Simulation) -> np.ndarray:
    pose = s.snapshot().pose[0]
    return pose[:3] + Rotation.from_quat(pose[3:]).apply(s.scene.model.joints[0].j.position)


LOOKS: dict[str, Quantity] = {
    'position': Quantity('m', _position, 0.0),
    'orientation': Quantity('1', _orientation, 0.0, either_sign=True),
    'velocity': Quantity('m/s', _velocity, 0.0),
    'angular velocity': Quantity('rad/s', _angular_velocity, 0.0),
    'reaction force': Quantity('N', lambda s: -_on_the_bar(s).force, 0.0),
    'reaction torque': Quantity('N m', lambda s: -_on_the_bar(s).torque, 0.0),
    'reaction force on j': Quantity('N', lambda s: _on_the_bar(s).force, 0.0),
    'reaction torque on j': Quantity('N m', lambda s: _on_the_bar(s).about(_place_of_ball(s)), 0.0),
    'actuator force': Quantity('N', lambda s: s.snapshot().joint_effort[0] * _axis(s), 0.0),
}


def cases() -> list[PublishedProblem]:
    """All 28."""
    figures = read('joints')
    found = []
    for name, (text, _) in MODELS.items():
        share = ACCURACY.get(name, USUAL_ACCURACY)
        quantities = {}
        for key in dict.fromkeys(f.quantity for f in figures[name]):
            size = max(float(np.abs(f.values).max()) for f in figures[name] if f.quantity == key)
            quantities[key] = LOOKS[key]._replace(limit=share * max(1.0, size))
        source = f'{SOURCE}/*/{name}_ADAMS_*.txt'
        found.append(
            PublishedProblem(
                name,
                text,
                source,
                functools.partial(scene, name),
                STEPS.get(name, USUAL_STEP),
                quantities,
                figures[name],
            )
        )
    return found


def spread() -> float:
    """Spread [m] of the published heights of one and the same motion: a bar of 4 m that swings in a plane from the
    horizontal."""
    figures = read('joints')
    heights = [[f.values[2] for f in figures[name] if f.quantity == 'position'] for name in SAME]
    return float(np.ptp(heights, axis=0).max())
