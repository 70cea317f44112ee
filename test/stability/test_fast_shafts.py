"""Shafts that turn far in a step: what the iterations leave must not be more than what the step loses anyway."""

from __future__ import annotations

import numpy as np
import pytest

from solver import load_scene, simulation_of

SLALOM = 'maneuver={steering: {kind: sine, amplitude: 0.1, frequency: 0.5, start: 0.1}}'


def path(h: float, iterations: int) -> np.ndarray:
    """(n, 2) places of the full car on the road every 10 ms in a second of slalom at 300 km/h; its propeller shaft
    turns by 850 rad/s."""
    start = 'start={kind: equilibrium, speed_kmh: 300}'
    settings = f'integrator={{h: {h}, iterations: {iterations}}}'
    s = simulation_of(load_scene('car_step_steer', [start, SLALOM, settings, 'require={}', 'duration=1']))
    return np.array([s.advance(round(0.01 / h)).pose[0, :2] for _ in range(100)])


@pytest.mark.parametrize('iterations', [3, 4])
def test_iterations_leave_less_than_the_step_loses(iterations: int) -> None:
    """With a row that turns with the shaft three iterations left five times as much as the step lost, across the
    road."""
    settled = path(1e-3, 8)
    lost = np.abs(settled - path(5e-4, 8)).max()
    assert np.abs(path(1e-3, iterations) - settled).max() < 0.1 * lost
