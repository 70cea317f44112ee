"""An equilibrium is one that the model stays in: on all its wheels, and no pendulum stands on its head."""

from __future__ import annotations

import numpy as np
import pytest

from solver import simulation_of
from solver.errors import ConsistencyError
from solver.files.scene import load_scene, load_scene_text

PENDULUM = """
mechanism:
  bodies: {{bob: {{mass: 1, inertia: [0.01, 0.01, 0.01], com: [0, 0, {com}]}}}}
  joints: {{pivot: {{kind: revolute, i: world, j: bob, at: [0, 0, 0], axis: [0, 1, 0]}}}}
start: {{kind: equilibrium}}
"""


def test_a_pendulum_on_its_head_is_refused_and_hanging_it_is_not() -> None:
    """It would fall with exp(sqrt(m g l / (J + m l^2)) t) = exp(3.12 t)."""
    with pytest.raises(ConsistencyError, match=r"unstable: body 'bob' falls away from it with exp\(3\.12 t\)"):
        simulation_of(load_scene_text(PENDULUM.format(com=1)))
    simulation_of(load_scene_text(PENDULUM.format(com=-1)))


@pytest.mark.parametrize('slope', [0.18, 0.25, 0.4])
def test_a_braked_car_stands_on_a_slope_as_it_does_when_its_brakes_are_applied_there(slope: float) -> None:
    """Loads of all tires within 1 % of the mean of those of the same car, held until its brakes close; before, it stood
    on its nose.

    How the wheels share the slope depends on how they came to hold it, so loads agree and longitudinal forces need not.
    """
    a = np.arctan(slope)
    road = f'road={{normal: [{-np.sin(a)}, 0, {np.cos(a)}]}}'
    common = [road, 'start={kind: equilibrium}', 'integrator={h: 1.0e-3}']
    standing = simulation_of(load_scene('light_car_straight', [*common, 'maneuver={brake_torque: 6000}']))
    stopping = ['maneuver={brake_torque: {kind: step, value: 6000, start: 0, rise: 0.2}}']
    rolled = simulation_of(load_scene('light_car_straight', [*common, *stopping])).advance(3000)
    loads, exact = standing.snapshot().tire[:, 2], rolled.tire[:, 2]
    np.testing.assert_allclose(loads, exact, rtol=0, atol=0.01 * exact.mean())
    later = standing.advance(1000)
    assert np.abs(later.twist).max() < 0.01


def test_a_car_stands_on_a_steep_grid_as_on_a_steep_plane() -> None:
    """Braked, on one that falls by 40 % ahead: from a level placement over it one was found on its front wheels
    only."""
    heights = [[round(16.0 - 3.2 * k, 1)] * 2 for k in range(11)]
    roads = (
        '{normal: [0.4, 0, 1]}',
        f'{{grids: [{{kind: height_grid, origin: [-40, -10], step: [8, 20], height: {heights}}}]}}',
    )
    common = ['start={kind: equilibrium}', 'maneuver={brake_torque: 6000}']
    plane, grid = (
        simulation_of(load_scene('light_car_straight', [f'road={road}', *common])).snapshot().tire[:, 2]
        for road in roads
    )
    np.testing.assert_allclose(grid, plane, rtol=0.01)
