"""How many iterations steps of mode `fixed` take, and what they leave."""

from __future__ import annotations

import numpy as np
import pytest

from mbd_sim_ros.lab.mechanisms.draft import Mechanism
from mbd_sim_ros.lab.mechanisms.families import draw
from mbd_sim_ros.lab.mechanisms.references import difference, measured
from solver.analysis.verdict import findings
from solver.files.scene import load_scene
from solver.simulation import Simulation
from solver.step.iteration import LARGEST_STAGNATION

CONVERGED = {'mode': 'tolerance', 'tolerance': 1e-10, 'max_iterations': 40}


@pytest.mark.parametrize('scene', ['car_step_steer', 'car_lane_change', 'chain'])
def test_steps_take_as_many_as_they_are_given(scene: str) -> None:
    s = Simulation(load_scene(scene))
    s.advance(200)
    assert s.totals()['iterations'] == 200 * s.scene.integrator.iterations


@pytest.mark.parametrize('iterations', [1, 2])
def test_a_step_goes_on_where_its_last_increment_would_be_called_unsettled(iterations: int) -> None:
    """1000 N m at each front wheel from the first instant on, at rest: the second increment of the first two steps is
    0.02 of 1 rad/s, and what it leaves a hundredth of that, but nobody knows before the third. Such a run was
    suspect."""
    launch = [
        'start={kind: equilibrium}',
        'maneuver={drive_torque: 4000}',
        'integrator.h=0.001',
        f'integrator.iterations={iterations}',
    ]
    s = Simulation(load_scene('light_car_straight', launch))
    s.advance(400)
    assert s.totals()['residual_max'] < LARGEST_STAGNATION
    assert findings(s) == []
    assert s.totals()['iterations'] < 2.1 * 400


def motion(mechanism: Mechanism, h: float, **settings: object) -> tuple[np.ndarray, Simulation]:
    """Places every 10 ms of half a second."""
    s = Simulation(mechanism.at(0.5, h=h, **settings))
    found = []
    for _ in range(50):
        s.advance(round(0.01 / h))
        found.append(s.state.q.copy())
    return measured(np.array(found)), s


@pytest.mark.parametrize(('family', 'number', 'h'), [('plane_loop', 29, 1e-3), ('sarrus', 65, 1e-2)])
def test_iterations_leave_no_more_than_the_step_loses(family: str, number: int, h: float) -> None:
    """Three iterations left these linkages something in every step, always in one direction: ten times what the step
    itself loses. Both are the largest of any part, so it may be some times as much.
    """
    mechanism = draw(family, number)
    converged = motion(mechanism, h, **CONVERGED)[0]
    lost = difference(converged, motion(mechanism, h / 10.0, **CONVERGED)[0])
    assert difference(motion(mechanism, h)[0], converged) < 5.0 * lost


@pytest.mark.parametrize(('family', 'number'), [('bennett', 43), ('duplicates', 30)])
def test_redundant_rows_are_not_held_where_they_are_none(family: str, number: int) -> None:
    """Beside its path a linkage sees directions that its redundant rows do not have on it. Multipliers of these grew
    from step to step, and moved it."""
    mechanism = draw(family, number)
    (coarse, s), (middle, _), (fine, _) = (motion(mechanism, h) for h in (1e-2, 5e-3, 2.5e-3))
    assert np.abs(s.state.lam).max() < 1e4
    assert 3.0 < difference(coarse, middle) / difference(middle, fine) < 5.5, 'second order'
