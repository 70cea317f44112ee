"""Benchmark mechanisms with published figures: the IFToMM library, the IVP test set, the heavy top, a kinematic tree of
Exudyn [Gerstmayr2024].

The library of computational benchmark problems [Gonzalez2006] gives its reference solutions as curves; the figures here
are vertices of those curves, six digits each, as they stand in the vector graphics help/images/*MBS_*lot*.pdf of
github.com/RehabEngGroup/MBSbenchmarksInOpenSim beside that project's own results.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mbd_sim_ros.lab.studies.published import Look, PublishedProblem, Quantity, read
from solver.files.scene import load_scene, load_scene_text
from solver.scene import Scene
from solver.simulation import Simulation

IFTOMM = (
    'IFToMM library [Gonzalez2006], reference curve in github.com/RehabEngGroup/MBSbenchmarksInOpenSim, help/images'
)
LINKS, LENGTH, WIDTH, DENSITY = 5, 2.0, 0.1, 1000.0  # of the kinematic tree: m, m, kg/m^3
# coordinates in the order of the test set: beta, Theta, gamma, Phi, delta, Omega, epsilon
SQUEEZER = ('O', 'K', 'B', 'E', 'A5', 'F', 'A7')
# The rods of that solution have no moment of inertia about themselves, nearly none here; those of our file have 1e-4 kg
# m^2
ACROSS, ALONG = 1 / 12, 1e-7  # kg m^2
IFTOMM_RODS = tuple(
    f'mechanism.bodies.rod{k}.inertia={[ALONG if axis == along else ACROSS for axis in "xyz"]}'
    for k, along in enumerate('xyzxy', start=1)
)
# the library starts at this beta; the test set at the one of our file
IFTOMM_SQUEEZER = 'start.coordinates={O: {value: -0.0620}}'
SQUEEZER_START = (
    -0.06171389001427650, 0.0, 0.45527981916307038, 0.22266839016588588, 0.48736497954384255, -0.22266839016588588,
    1.23054744454982119,
)  # fmt: skip


def _of_config(name: str, duration: float, h: float, overrides: Sequence[str] = ()) -> Scene:
    """A scene of config/scenes with the default integrator, a step [s] and a duration [s]."""
    scene = load_scene(name, overrides)
    return dataclasses.replace(scene, integrator=type(scene.integrator)(h=h), duration=duration)


def _point(body: str, position: tuple[float, float, float], axes: int = 3) -> Look:
    """Place of a point of a body, given in its frame: the first `axes` coordinates."""

    def look(s: Simulation) -> np.ndarray:
        pose = s.snapshot().pose[s.channels.bodies.index(body)]
        return (pose[:3] + Rotation.from_quat(pose[3:]).apply(position))[:axes]

    return look


def _heavy_top(h: float) -> Scene:
    """The top of [Bruls2012]: 15 kg at 1 m from the fixed point, lying along y, spinning with 150 rad/s about
    itself."""
    spin = [0.0, 150.0, -4.61538]
    top: dict[str, Any] = {
        'mass': 15,
        'inertia': [0.234375, 0.46875, 0.234375],
        'com': [0, 1, 0],
        'angular_velocity': spin,
    }
    mechanism = {'bodies': {'top': top}, 'joints': {'tip': {'kind': 'spherical', 'i': 'world', 'j': 'top'}}}
    return load_scene_text(
        json.dumps({'title': 'Heavy top', 'mechanism': mechanism, 'integrator': {'h': h}, 'duration': 2}), 'heavy_top'
    )


def _tree_frames() -> list[tuple[np.ndarray, Rotation]]:
    """Places and axes of the joints of the tree, all angles zero; every joint turns about z of its frame, links lie
    along x."""
    place, turn, found = np.zeros(3), Rotation.identity(), []
    for k in range(LINKS):
        place = place + turn.apply([LENGTH if k else 0.0, 0.0, 0.0])
        if k % 3:
            turn = turn * Rotation.from_euler('XY', [np.pi / 2, np.pi / 4])
        elif k % 2:
            turn = turn * Rotation.from_euler('Y', np.pi / 4)
        found.append((place, turn))
    return found


def _kinematic_tree(h: float) -> Scene:
    """Five bars of 2 m in a chain of revolute joints whose axes are turned against each other, from rest, 10 m/s^2
    along -y."""
    mass = DENSITY * LENGTH * WIDTH**2
    across, along = mass / 12 * (LENGTH**2 + WIDTH**2), mass / 6 * WIDTH**2
    bodies: dict[str, Any] = {}
    joints: dict[str, Any] = {}
    for k, (place, turn) in enumerate(_tree_frames()):
        bodies[f'link_{k}'] = {
            'mass': mass, 'inertia': [along, across, across], 'com': [LENGTH / 2, 0, 0],
            'position': place.tolist(), 'orientation': turn.as_quat().tolist(),
        }  # fmt: skip
        before = f'link_{k - 1}' if k else 'world'
        joints[f'q{k}'] = {
            'kind': 'revolute',
            'i': before,
            'j': f'link_{k}',
            'at': place.tolist(),
            'orientation': turn.as_quat().tolist(),
        }
    mechanism = {'gravity': [0, -10, 0], 'bodies': bodies, 'joints': joints}
    return load_scene_text(
        json.dumps({'title': 'Tree', 'mechanism': mechanism, 'integrator': {'h': h}, 'duration': 1}), 'kinematic_tree'
    )


def _squeezer_angles(s: Simulation) -> np.ndarray:
    """The seven angles, counted as in the test set: its values at the start and the turns of our joints since."""
    where = [s.channels.joints.index(name) for name in SQUEEZER]
    start = Simulation(s.scene).snapshot().joint_position[where] if s.k else s.snapshot().joint_position[where]
    return np.array(SQUEEZER_START) + s.snapshot().joint_position[where] - start


def _height_of_slider(s: Simulation) -> np.ndarray:
    return _point('slider', (0, 0, 0))(s)[2]


def _tip_moved(s: Simulation) -> np.ndarray:
    """Displacement of the centre of mass of the top."""
    return _point('top', (0, 1, 0))(s) - (0.0, 1.0, 0.0)


def _scalar_first(s: Simulation) -> np.ndarray:
    return np.roll(s.snapshot().pose[0, 3:], 1)


def _sum_of_angles(s: Simulation) -> np.ndarray:
    return s.snapshot().joint_position.sum()


def cases() -> list[PublishedProblem]:
    """All of them."""
    figures = read('mechanisms')

    def iftomm(
        name: str, text: str, scene: str, duration: float, h: float, seen: Quantity, *overrides: str
    ) -> PublishedProblem:
        quantity, made = figures[name][0].quantity, functools.partial(_of_config, scene, duration, overrides=overrides)
        return PublishedProblem(name, text, IFTOMM, made, h, {quantity: seen}, figures[name])

    def metres(limit: float, look: Look) -> Quantity:
        return Quantity('m', look, limit)

    return [
        iftomm('A01', 'simple pendulum', 'pendulum', 10.0, 1e-3, metres(1e-6, _point('bob', (-1, 0, 0), 2))),
        iftomm('A02', 'forty four-bar linkages, point B0', 'four_bar_n', 10.0, 1e-3,
        metres(3e-6, _point('crank_0', (1, 0, 0), 2))),
        iftomm('A03', "Andrews' squeezer, point F", 'andrews', 0.05, 2e-5, metres(2e-8, _point('k1', (0.007, 0, 0), 2)),
        IFTOMM_SQUEEZER),
        iftomm('A04', "Bricard's mechanism, point P3", 'bricard', 10.0, 2e-3, metres(3e-6, _point('rod3', (0, 0, 0))),
        *IFTOMM_RODS),
        iftomm('A05', 'stiff flyball governor, slider', 'flyball_governor', 3.0, 1e-3, metres(3e-6, _height_of_slider)),
        PublishedProblem(
            'squeezer', "Andrews' squeezer, seven angles", 'IVP test set [Mazzia2008], reference solution',
            functools.partial(_of_config, 'andrews', 0.03), 1e-5, {'angles': Quantity('rad', _squeezer_angles, 1e-6)},
            figures['squeezer'],
        ),
        PublishedProblem(
            'heavy_top', 'heavy top of [Bruls2012]',
            'github.com/kynema/kynema, tests/regression_tests/regression/verification/dynamic_heavy_top.cpp: '
            'generalized-alpha, 2 us',
            _heavy_top, 2e-4,
            {'displacement': Quantity('m', _tip_moved, 2e-6),
            'orientation': Quantity('1', _scalar_first, 2e-6, either_sign=True)},
            figures['heavy_top'],
        ),
        PublishedProblem(
            'kinematic_tree', 'kinematic tree of five bars',
            'github.com/jgerstmayr/EXUDYN, main/pythonDev/TestModels/kinematicTreeTest.py: RK4, 5 ms',
            _kinematic_tree, 5e-3, {'sum of angles': Quantity('rad', _sum_of_angles, 1e-7)}, figures['kinematic_tree'],
        ),
    ]  # fmt: skip
