"""Constraints hold, for ever, and repeating them changes nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from solver.files.scene import load_scene, load_scene_text
from solver.scene import Scene
from solver.simulation import Simulation

SPATIAL = """
mechanism:
  bodies:
    arm: {mass: 2, inertia: [0.01, 0.05, 0.05], com: [0.4, 0, 0]}
    link: {mass: 1, inertia: [0.02, 0.02, 0.01], com: [0, 0, -0.3], position: [0.8, 0, 0]}
    disc: {mass: 0.5, inertia: [0.01, 0.01, 0.02], position: [0.8, 0, -0.6], angular_velocity: [0, 0, 20]}
  joints:
    shoulder: {kind: universal, i: world, j: arm}
    elbow: {kind: revolute, i: arm, j: link, at: [0.8, 0, 0], axis: [1, 1, 0]}
    spindle: {kind: cylindrical, i: link, j: disc, at: [0.8, 0, -0.6], axis: [0, 0, 1]}
  bushings:
    thrust: {i: link, j: disc, at: [0.8, 0, -0.6], stiffness: [0, 0, 500, 0, 0, 0], damping: [0, 0, 5, 0, 0, 0]}
"""


def with_settings(scene: Scene, **changes) -> Scene:
    return dataclasses.replace(scene, integrator=dataclasses.replace(scene.integrator, **changes))


@pytest.mark.parametrize('mode', ['fixed', 'tolerance'])
def test_drift_stays_at_the_tolerance_over_a_hundred_thousand_steps(mode):
    """Positions to 1e-9 m or rad and projected velocities to 1e-6 (one projection in fixed mode) or 1e-9, first and
    last alike."""
    simulation = Simulation(with_settings(load_scene_text(SPATIAL), h=1e-3, mode=mode, tolerance=1e-9))
    drifts = []
    for _ in range(10):
        counters = simulation.advance(10_000, audit=False).counters
        drifts.append((counters.position_drift, counters.velocity_drift))
    position, velocity = np.array(drifts).T
    assert position.max() < 1e-9
    assert velocity.max() < (1e-6 if mode == 'fixed' else 1e-9)
    assert position[-1] < 10 * position[0] + 1e-13


def doubled(scene: Scene) -> Scene:
    """The scene with every joint there twice."""
    joints = scene.model.joints + tuple(dataclasses.replace(j, name=f'{j.name} again') for j in scene.model.joints)
    return dataclasses.replace(scene, model=dataclasses.replace(scene.model, joints=joints))


@pytest.mark.parametrize('form', ['condensed', 'block'])
@pytest.mark.parametrize('name', ['pendulum', 'four_bar', 'double_pendulum'])
def test_repeated_constraints_change_no_motion_and_share_the_reaction(name, form):
    """Every joint twice: the same motion to 1e-8, and two halves of every reaction that is unique."""
    scene = with_settings(load_scene(name), h=2e-3, mode='tolerance', tolerance=1e-11, form='condensed')
    single = Simulation(scene)
    double = Simulation(with_settings(doubled(scene), form=form))
    assert double.describe()['dof'] == single.describe()['dof']
    a, b = single.advance(300), double.advance(300)
    np.testing.assert_allclose(b.pose, a.pose, rtol=0, atol=1e-8)
    np.testing.assert_allclose(b.twist, a.twist, rtol=0, atol=1e-7)
    rows = single.model.n_rows - len(scene.model.couplers)
    total = b.reactions[:rows] + b.reactions[rows : 2 * rows]
    in_plane = [
        k
        for k, row in enumerate(single.model.row_names[:rows])
        if row.endswith(('/x', '/z' if name != 'pendulum' else '/y'))
    ]
    np.testing.assert_allclose(
        total[in_plane], a.reactions[in_plane], rtol=0, atol=1e-5 * max(1.0, np.abs(a.reactions).max())
    )
