"""How many iterations steps of mode `fixed` take."""

from __future__ import annotations

import pytest

from solver.files.scene import load_scene
from solver.simulation import Simulation


@pytest.mark.parametrize('scene', ['car_step_steer', 'car_lane_change', 'chain'])
def test_steps_take_as_many_as_they_are_given(scene: str) -> None:
    s = Simulation(load_scene(scene))
    s.advance(200)
    assert s.totals()['iterations'] == 200 * s.scene.integrator.iterations
