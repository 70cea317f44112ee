"""The slider-crank with equal rods passes its singular positions from any starting phase, at any step, damped and conserving.

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

from mbd_sim_ros.lab.studies import crank

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
