"""Reactions of joints as force and torque: those that the Jacobian puts on the bodies, and those that hold a weight."""

from __future__ import annotations

import numpy as np
import pytest

from solver.analysis.reactions import joint_reaction
from solver.elements.joint import KINDS
from solver.errors import SpecError
from solver.files.scene import load_scene_text
from solver.model.evaluate import add_constraint_forces
from solver.simulation import Simulation

SCENE = """
mechanism:
  bodies:
    arm: {{mass: 2, inertia: [0.1, 0.2, 0.3], com: [0.1, 0, 0.2], position: [0.3, -0.2, 0.5], rpy: [0.3, -0.5, 0.8]}}
    tool:
      mass: 1
      inertia: [0.02, 0.03, 0.01]
      com: [0.2, 0.1, 0]
      position: [1, 0.5, 0.7]
      rpy: [-0.4, 0.2, 1.1]
      angular_velocity: [0.4, -1.0, 0.6]
  joints:
    base: {{kind: spherical, i: world, j: arm, at: [0.2, 0.1, 0.4]}}
    link: {{kind: {kind}, i: {{body: arm, at: [0.6, 0.1, 0.8], {axes}}}, j: {{body: tool, at: [0.6, 0.1, {z}], {axes}}}}}
integrator: {{h: 0.001}}
"""  # noqa: E501
WEIGHT = 9.81


@pytest.mark.parametrize('kind', KINDS)
def test_reaction_is_what_the_jacobian_puts_on_the_free_body(kind: str) -> None:
    """The joint alone: force on the tool, torque about its centre of mass and the moment of all about the origin, to
    rounding."""
    axes = 'axis: [0.2, 0.4, 1.0]' if kind != 'perpendicular' else 'rpy: [0, 0, 0]'
    text = SCENE.format(kind=kind, axes=axes, z=1.1 if kind in ('distance', 'perpendicular') else 0.8)
    if kind == 'perpendicular':
        text = text.replace(
            'body: tool, at: [0.6, 0.1, 1.1], rpy: [0, 0, 0]', 'body: tool, at: [0.6, 0.1, 1.1], axis: [1, 0, 0]'
        )
    simulation = Simulation(load_scene_text(text))
    simulation.advance(50)
    last, kin = simulation.last_step, simulation.kinematics
    names = simulation.model.row_names
    of_link = np.array([name.startswith('link/') or name == 'link' for name in names])
    assert of_link.any() and np.abs(last.lam[of_link]).max() > 1e-3
    f = np.zeros((3, 6))
    add_constraint_forces(simulation.model.tables.constraints, last.J, np.where(of_link, last.lam, 0.0), 1.0, f)
    found = joint_reaction(simulation, 'link')
    np.testing.assert_allclose(found.force, f[1, :3], rtol=0, atol=1e-12 * np.abs(f).max())
    np.testing.assert_allclose(found.about(kin.p[1]), kin.R[1] @ f[1, 3:], rtol=0, atol=1e-12 * np.abs(f).max())
    np.testing.assert_allclose(-found.force, f[0, :3], rtol=0, atol=1e-12 * np.abs(f).max())
    np.testing.assert_allclose(-found.about(kin.p[0]), kin.R[0] @ f[0, 3:], rtol=0, atol=1e-12 * np.abs(f).max())


def test_a_clamp_holds_the_weight_and_its_moment_about_marker_f() -> None:
    """3 kg at 2 m along x from the clamp: the clamp pushes it up, and about its own place it turns it by -y (z up, x to
    y is +z)."""
    simulation = Simulation(
        load_scene_text(
            'mechanism: {bodies: {beam: {mass: 3, inertia: [1, 1, 1], position: [2.5, 1, 0]}}, '
            'joints: {clamp: {kind: fixed, i: world, j: beam, at: [0.5, 1, 0]}}}'
        )
    )
    simulation.advance(5)
    found = joint_reaction(simulation, 'clamp')
    np.testing.assert_allclose(found.force, (0, 0, 3 * WEIGHT), rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.torque, (0, -2 * 3 * WEIGHT, 0), rtol=0, atol=1e-9)
    np.testing.assert_array_equal(found.point, (0.5, 1, 0))


def test_a_name_that_is_no_joint_is_one_sentence() -> None:
    simulation = Simulation(load_scene_text(SCENE.format(kind='spherical', axes='rpy: [0, 0, 0]', z=0.8)))
    with pytest.raises(SpecError, match="did you mean 'link'"):
        joint_reaction(simulation, 'lnk')
