"""A hard stop is hit within one step: a fixed number of iterations goes on until it contracts."""

from __future__ import annotations

import numpy as np
import pytest

from solver.files.scene import load_scene_text
from solver.simulation import Simulation

SCENE = """
mechanism:
  gravity: [0, 0, 0]
  bodies:
    wheel: {{mass: 40, inertia: [1, 1, 1], position: [0, 0, -1]}}
  joints:
    guide: {{kind: prismatic, i: world, j: wheel, at: [0, 0, -1], axis: [0, 0, 1]}}
  coordinate_forces:
    stop: {{terms: [[guide, 1]], spring: [[-1, 0], [0.05, 0], [0.06, 8000], [0.07, 100000]], damper: 100}}
start: {{coordinates: {{guide: {{rate: 12}}}}}}
integrator: {{h: 5.0e-3, {method}}}
"""
TO_TOLERANCE = 'mode: tolerance, tolerance: 1.0e-10'


def positions(method: str) -> tuple[np.ndarray, Simulation]:
    """Coordinate of 40 kg that run against 10 kN/mm at 12 m/s, 60 mm per step, over 30 steps."""
    simulation = Simulation(load_scene_text(SCENE.format(method=method)))
    return np.array([simulation.advance(1).joint_position[0] for _ in range(30)]), simulation


@pytest.mark.parametrize('iterations', [1, 2, 3])
def test_fixed_iterations_follow_a_hard_stop(iterations):
    """The mass comes back as fast as with iterations to tolerance, but for the 1 % that the iteration may leave.

    With tangents of the prediction alone, where nothing touches yet, its speed would be wrong by half and more.
    """
    exact, _ = positions(TO_TOLERANCE)
    found, simulation = positions(f'mode: fixed, iterations: {iterations}')
    assert exact.max() > 0.07
    assert found[-1] - found[-2] == pytest.approx(exact[-1] - exact[-2], rel=0.01)
    assert simulation.totals()['iterations'] > 30 * iterations


def test_fixed_iterations_stay_fixed_where_nothing_is_hit():
    _, simulation = positions('mode: fixed, iterations: 2')
    simulation.reset()
    simulation.advance(2)  # still before the stop
    totals = simulation.totals()
    assert (totals['iterations'], totals['factorizations']) == (4, 2)
