"""The benchmark of the levels of detail: every figure is there, and less detail costs less."""

from __future__ import annotations

import os
import time

import pytest

from mbd_sim_ros.lab.benchmarks import levels
from mbd_sim_ros.lab.benchmarks.suite import load_suite


@pytest.mark.long
@pytest.mark.slow
def test_levels_are_measured_side_by_side() -> None:
    measurement = levels.Levels('car_step_steer', ['duration=1'])
    measurement.round(400)
    figures = measurement.figures()['figures']
    assert list(figures) == list(levels.FIGURES)
    for end in ('share', 'audited'):
        shares = [figures[f'{level}_{end}'] for level in levels.LEVELS[1:]]
        assert 0.0 < shares[2] < shares[1] < shares[0] < 1.0


def test_the_clock_of_a_process_is_its_cpu_time() -> None:
    begin, until = levels.cpu_time(os.getpid()), time.process_time() + 0.1
    while time.process_time() < until:
        pass
    assert 0.08 <= levels.cpu_time(os.getpid()) - begin < 0.3


def test_the_suites_hold_the_levels_to_their_targets() -> None:
    (steps,) = load_suite(names=['car_levels'])
    (node,) = load_suite('node_at_work.yaml', ['car_levels_100hz'])
    assert steps.targets['condensed_share'] == steps.targets['condensed_audited'] == 0.5
    assert steps.targets['kc_share'] == steps.targets['kc_audited'] == 0.2
    assert steps.targets['single_track_share'] == 0.03
    assert node.targets == {'node_share': 0.5}
