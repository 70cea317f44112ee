"""Momentum of a free system changes by external forces only."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from solver.files.scene import load_scene_text
from solver.simulation import Simulation

# two bodies on a ball joint, a third on a spring and a bushing: internal forces of every kind, no external ones
FREE_CHAIN = """
mechanism:
  gravity: [0, 0, GRAVITY]
  bodies:
    first: {mass: 2, inertia: [0.02, 0.05, 0.04], com: [0.1, 0, 0.05], velocity: [0.3, -0.2, 0.1], angular_velocity: [1, 3, -2]}
    second: {mass: 1, inertia: [0.01, 0.03, 0.03], com: [0.2, 0.1, 0], position: [0.5, 0, 0]}
    third: {mass: 0.5, inertia: [0.01, 0.01, 0.01], position: [1.2, 0, 0], angular_velocity: [0, 4, 0]}
  joints:
    ball: {kind: spherical, i: first, j: second, at: [0.5, 0, 0]}
  spring_dampers:
    spring: {i: first, j: {body: third, position: [0, 0.1, 0]}, free_length: 1, spring: 60, damper: 0.5}
  bushings:
    mount: {i: second, j: third, at: [0.9, 0, 0], stiffness: [200, 300, 400, 2, 3, 4], damping: [1, 1, 1, 0.1, 0.1, 0.1]}
"""  # noqa: E501


def simulation_of(h: float, rho_inf: float, gravity: float = 0.0) -> Simulation:
    scene = load_scene_text(FREE_CHAIN.replace('GRAVITY', str(gravity)))
    settings = dataclasses.replace(scene.integrator, h=h, rho_inf=rho_inf, mode='tolerance', tolerance=1e-12)
    return Simulation(dataclasses.replace(scene, integrator=settings))


def momentum(simulation: Simulation) -> np.ndarray:
    """(2, 3) linear [N s] and angular momentum about the origin [N m s], from the twists in the state."""
    q, v = simulation.state.q[:-1], simulation.state.v[:-1]
    bodies = simulation.model.tables.bodies
    linear = bodies.mass[:, None] * v[:, :3]
    spin = Rotation.from_quat(q[:, 3:]).apply(np.einsum('bij,bj->bi', bodies.inertia, v[:, 3:]))
    return np.array([linear.sum(0), (np.cross(q[:, :3], linear) + spin).sum(0)])


@pytest.mark.parametrize('rho_inf', [1.0, 0.8, 0.0])
def test_linear_momentum_of_a_free_system_is_conserved_to_the_tolerance(rho_inf):
    """Joint, spring and bushing forces cancel in every stage, so only the residual of the iteration remains."""
    simulation = simulation_of(2e-3, rho_inf)
    start = momentum(simulation)
    simulation.advance(2000)
    np.testing.assert_allclose(momentum(simulation)[0], start[0], rtol=0, atol=1e-9)


def test_free_fall_changes_linear_momentum_by_weight_times_time():
    simulation = simulation_of(2e-3, 0.8, gravity=-9.81)
    start = momentum(simulation)
    simulation.advance(500)
    np.testing.assert_allclose(momentum(simulation)[0] - start[0], [0, 0, -3.5 * 9.81 * 1.0], rtol=0, atol=1e-9)


@pytest.mark.parametrize('rho_inf', [1.0, 0.8, 0.0])
def test_angular_momentum_of_a_free_system_is_conserved_to_second_order(rho_inf):
    """Slope 2 or better between two steps, from an error that is small already."""
    drift = []
    for h in (4e-3, 1e-3):
        simulation = simulation_of(h, rho_inf)
        start = momentum(simulation)
        simulation.advance(round(1.0 / h))
        drift.append(np.abs(momentum(simulation)[1] - start[1]).max())
    assert drift[0] < 1e-2 * np.abs(start[1]).max()
    assert np.log(drift[0] / drift[1]) / np.log(4) > 1.85
