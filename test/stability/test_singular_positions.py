"""The slider-crank with equal rods and the constant-velocity joint pass their singular positions, each on its branch.

The slider-crank with equal rods passes its singular positions from any starting phase, at any step, damped and conserving.

Starts, exact motion and limits: mbd_sim_ros.lab.studies.crank. PHASES can be raised through the environment (MBD_PHASES=200);
`mbd study slider_crank_phases` is the full study with its report. The starts are an ensemble: uniform phases, each so many units in the
last place off as it is its turn, and the limits hold for every one. The largest error there is does not depend on the last place: of
three neighbours of each phase the slider ends within 2e-7 m, and the smallest margin is 2e-5 m.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest
from ensemble import EPS, offsets
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from mbd_sim_ros.lab.studies import crank
from solver.analysis.verdict import findings
from solver.files.scene import load_scene_text
from solver.simulation import Simulation

PHASES = int(os.environ.get('MBD_PHASES', '12'))
TOLERANCE = {'rho_inf': 0.9, 'mode': 'tolerance'}


@pytest.mark.slow
@pytest.mark.parametrize(('settings', 'limits'), [
    pytest.param(crank.CONSERVING, 'conserving', id='conserving'),
    pytest.param(crank.DAMPED, 'damped', id='damped'),
    pytest.param(TOLERANCE, 'damped', id='tolerance'),
])  # fmt: skip
@pytest.mark.parametrize('h', crank.STEPS)
def test_every_phase_passes_every_singular_position_on_its_branch(h: float, settings: dict[str, Any], limits: str) -> None:
    theta = crank.phases(PHASES) * (1.0 + EPS * np.resize(offsets(), PHASES))
    angles = crank.exact_angles(theta, crank.slider_mass(), np.array([crank.DURATION]))[:, 0]
    for start, angle in zip(theta, angles, strict=True):
        run = crank.passage(start, angle, h, settings)
        assert run.outcome == 'ok', f'{run.outcome} at {run.until} s from theta = {start:.6f}; {run.message}'
        if h > crank.LARGEST_JUDGED:
            continue
        allowed = crank.LIMITS[limits]
        assert run.position_error < crank.limit(allowed.position, h), f'slider from theta = {start:.6f}'
        assert run.energy_error < crank.limit(allowed.energy, h), f'energy from theta = {start:.6f}'


FLAIL = """
mechanism:
  bodies:
    bar: {{mass: 2.0, inertia: [0.01, 0.01, 0.004], com: [0, 0, 0.3], orientation: {q}, angular_velocity: {w}}}
  joints:
    top: {{kind: constant_velocity, i: {{body: world, axis: [0, 0, 1]}}, j: {{body: bar, axis: [0, 0, 1]}}}}
duration: 0.5
integrator: {{h: {h}}}
"""
SWING = 2.0 * 9.81 * 0.3 / (0.01 + 2.0 * 0.3**2)  # 1/s^2, its acceleration when level


@pytest.mark.parametrize('seed', range(4))
def test_a_constant_velocity_joint_folds_right_over_and_does_not_twist(seed: int) -> None:
    """Where its shafts point against each other the row that forbids a twist has no gradient, and a second branch, twisted by half a turn,
    begins. A bar that swings in a plane goes on as the pendulum that it is: its phase is off by (w h)^2 / 12 of w T, for w the largest
    rate; twice that is allowed, since the rate is not constant."""
    drawn = np.random.default_rng(seed)
    angle, rate, plane = drawn.uniform(1.0, 2.6), drawn.uniform(8.0, 15.0), drawn.uniform(0.0, 2.0 * np.pi)
    n = np.array([np.cos(plane), np.sin(plane), 0.0])
    start = Rotation.from_rotvec(angle * n)
    exact = solve_ivp(lambda t, y: [y[1], SWING * np.sin(y[0])], (0.0, 0.5), [angle, rate], rtol=1e-12, atol=1e-12).y
    assert exact[0, -1] > np.pi
    for h in (1e-2, 5e-3, 2e-3, 1e-3):
        q, w = start.as_quat().tolist(), start.inv().apply(rate * n).tolist()
        simulation = Simulation(load_scene_text(FLAIL.format(q=q, w=w, h=h), 'flail'))
        simulation.advance(simulation.scene.steps)
        error = (Rotation.from_quat(simulation.state.q[0, 3:]) * Rotation.from_rotvec(exact[0, -1] * n).inv()).magnitude()
        assert error < 2.0 * exact[1].max() ** 3 * h * h * 0.5 / 12.0, h
        assert not findings(simulation)
