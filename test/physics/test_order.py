"""The integrator is of second order in positions, velocities and multipliers, for every rho_inf and in both modes."""

from __future__ import annotations

import numpy as np
import pytest
from closed_forms import (
    driven_four_bar,
    falling_four_bar,
    heavy_body,
    pendulum,
    spring_mass,
    steady_top,
    torque_free_top,
)
from convergence import FIELDS, orders

TIMES = 0.08 * np.arange(1, 11)
MODES = {'tolerance': {'mode': 'tolerance', 'tolerance': 1e-12}, 'fixed': {'mode': 'fixed', 'iterations': 2}}
COARSE, FINE = (8e-3, 4e-3, 2e-3), (4e-3, 2e-3, 1e-3)

# problem, step sizes, fields that are neither trivial nor prescribed
PROBLEMS = {
    'pendulum': (pendulum(), FINE, FIELDS),
    'spring and damper': (spring_mass(), COARSE, FIELDS),
    'torque-free top': (torque_free_top(), COARSE, ('position', 'velocity')),
    'top in steady precession': (steady_top(), (2e-3, 1e-3, 5e-4), FIELDS),
    'heavy asymmetric body': (heavy_body(TIMES[-1]), FINE, FIELDS),
    'falling four-bar': (falling_four_bar(TIMES[-1]), FINE, FIELDS),
    'four-bar at constant crank speed': (driven_four_bar(6.0), FINE, ('multipliers',)),
}


@pytest.mark.parametrize('mode', MODES)
@pytest.mark.parametrize('rho_inf', [1.0, 0.8, 0.0])
@pytest.mark.parametrize('name', PROBLEMS)
def test_errors_fall_with_the_square_of_the_step(name, rho_inf, mode):
    """Slope 2.0 +- 0.15 of the largest error over 0.8 s, against closed forms (closed_forms.py) and three step
    sizes."""
    problem, steps, fields = PROBLEMS[name]
    slopes, table = orders(problem, steps, TIMES, rho_inf=rho_inf, **MODES[mode])
    judged = [FIELDS.index(f) for f in fields]
    assert table[-1][judged].max() < 0.1, f'errors {table} are no small errors'
    np.testing.assert_allclose(slopes[judged], 2.0, rtol=0, atol=0.15, err_msg=f'errors {FIELDS} at {steps}:\n{table}')
