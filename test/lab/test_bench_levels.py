"""The benchmark of the levels of detail: every figure is there, and less detail costs less."""

from __future__ import annotations

import os
import sys
import time

import pytest
from client import client
from processes import Process

from mbd_sim_ros.lab.benchmarks import levels, node_levels
from mbd_sim_ros.lab.benchmarks.suite import load_suite

__all__ = ['client']  # a fixture


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
    begin, until = node_levels.cpu_time(os.getpid()), time.process_time() + 0.1
    while time.process_time() < until:
        pass
    assert 0.08 <= node_levels.cpu_time(os.getpid()) - begin < 0.3


def test_the_suites_hold_the_levels_to_their_targets() -> None:
    (steps,) = load_suite(names=['car_levels'])
    (node,) = load_suite('node_at_work.yaml', ['car_levels_100hz'])
    assert steps.targets['condensed_share'] == steps.targets['condensed_audited'] == 0.5
    assert steps.targets['kc_share'] == steps.targets['kc_audited'] == 0.2
    assert steps.targets['single_track_share'] == 0.03
    assert node.targets == {'node_share': 0.5}


@pytest.mark.realtime
def test_a_bare_node_publishes_as_often_as_asked(client, tmp_path) -> None:  # type: ignore[no-untyped-def]
    from nav_msgs.msg import Odometry

    came: list[float] = []
    client.node.create_subscription(Odometry, 'odom', lambda _: came.append(time.monotonic()), 100)
    node = Process(tmp_path, [sys.executable, '-c', node_levels.BARE, '0.01', '20'], forked=False)
    client.until(lambda: len(came) > 100)
    node.kill()
    assert 0.9 < came[100] - came[0] < 5.0


def test_the_least_share_is_that_of_steps_and_the_cheaper_bare_node(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    measurement = node_levels.NodeLevels('car_step_steer', ['duration=1'], 10.0)
    share = {'full': 20.0, 'kc': 14.0, 'ASYNCHRONOUS': 8.0, 'SYNCHRONOUS': 6.0}
    monkeypatch.setattr(
        measurement,
        '_share',
        lambda arguments, **variables: share[
            variables['RMW_FASTRTPS_PUBLICATION_MODE'] if variables else level_in(arguments)
        ],
    )
    measurement.round(1)
    figures = measurement.figures()['figures']
    assert list(figures) == list(node_levels.FIGURES)
    assert figures['node_share'] == 0.7
    assert 0.0 < figures['steps_kc'] < figures['steps_full'] < 100.0
    assert figures['least_share'] == (6.0 + figures['steps_kc']) / (6.0 + figures['steps_full'])


def level_in(arguments: list[str]) -> str:
    """The level that is asked for in the overrides of a node."""
    return next(level for level in node_levels.LEVELS if any(f'fidelity={level}' in argument for argument in arguments))
