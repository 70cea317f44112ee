"""A vehicle at speed: where it starts belongs to the vehicle, not to the settings of the integrator."""

from __future__ import annotations

import numpy as np
import pytest

from solver.files.scene import load_scene
from solver.simulation import Simulation


@pytest.mark.slow
@pytest.mark.parametrize('setting', ['rho_inf=0', 'augmentation=plain', 'mode=tolerance', 'h=0.0025', 'iterations=1'])
def test_settings_of_the_integrator_do_not_move_the_start(setting: str) -> None:
    """Places to the bit, velocities as the scheme wants them at its step: methods that are compared begin in the same state."""
    usual, other = (Simulation(load_scene('car_swept_steer', list(chosen))).state for chosen in ((), (f'integrator.{setting}',)))
    np.testing.assert_array_equal(other.q, usual.q)
    np.testing.assert_array_equal(other.z, usual.z)
    np.testing.assert_allclose(other.v, usual.v, rtol=0, atol=1e-3)
