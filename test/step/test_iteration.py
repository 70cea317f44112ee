"""How many iterations steps of mode `fixed` take."""

from __future__ import annotations

import pytest

from mbd_sim_ros.lab.mechanisms.families import draw
from mbd_sim_ros.lab.mechanisms.judgement import difference, measured
from solver.files.scene import load_scene
from solver.output.energy import SPEED
from solver.simulation import Simulation
from solver.step.iteration import KEPT


def test_iterations_that_gain_slowly_go_on() -> None:
    """Three iterations left 8e-8 of the velocity in every step of this linkage, always in one direction: 1e-5 m in half a second, ten times
    as much as the step itself loses.
    """
    mechanism, duration, h = draw('plane_loop', 29), 0.5, 1e-3
    found = Simulation(mechanism.at(duration, h=h))
    converged = Simulation(mechanism.at(duration, h=h, mode='tolerance', tolerance=1e-10, max_iterations=40))
    for s in (found, converged):
        s.advance(round(duration / h))
    allowed = KEPT * max(1.0, found.last_step.energy[SPEED]) * duration**2 / 2.0
    assert difference(measured(found.state.q[None]), measured(converged.state.q[None])) < allowed
    assert 3.0 < found.totals()['iterations'] / found.k < 5.0


@pytest.mark.parametrize('scene', ['car_step_steer', 'car_lane_change', 'chain'])
def test_other_steps_take_as_many_as_they_are_given(scene: str) -> None:
    s = Simulation(load_scene(scene))
    s.advance(200)
    assert s.totals()['iterations'] == 200 * s.scene.integrator.iterations
