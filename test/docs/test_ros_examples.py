"""docs/examples: every script runs beside a real simulator and does what it says."""

from __future__ import annotations

import re
import sys

import pytest
from processes import ROOT, Process
from real_node import simulator

pytestmark = pytest.mark.slow

__all__ = ['simulator']  # a fixture

EXAMPLES = ROOT / 'docs' / 'examples'
STANDING = ['start={kind: equilibrium, speed: 6.0}']


def example(directory, name: str, *arguments: str) -> str:
    """What an example prints."""
    process = Process(directory, [sys.executable, str(EXAMPLES / f'{name}.py'), *arguments])
    try:
        assert process.end(60.0) == 0, process.output
    finally:
        process.kill()
    return process.output


def test_a_maneuver_from_a_script(simulator, tmp_path):
    simulator(scene='light_car_straight', rate_factor=3.0)  # it looks at the time of the simulation
    found = re.search(
        r'largest yaw rate ([\d.]+) rad/s, stopped within ([\d.]+) m', example(tmp_path, 'maneuver_script')
    )
    assert found
    assert 0.1 < float(found[1]) < 0.6
    assert 20.0 < float(found[2]) < 60.0  # 25 m/s with 5 to 10 m/s^2


def test_a_lockstep_controller_gives_the_same_run_twice(simulator, tmp_path):
    said = []
    for _ in range(2):
        process = simulator(scene='light_car_straight', mode='lockstep')
        said.append(example(tmp_path, 'lockstep_controller', '200'))
        process.process.terminate()
        assert process.end() == 0
    assert said[0] == said[1]
    assert '200 steps: y = ' in said[0]


def test_a_lane_keeper_drives_the_full_car_in_lockstep(simulator, tmp_path):
    """As the linear model in the same loop says: within a twentieth of the offset at the start."""
    pytest.importorskip('control', reason='pip install .[test]')
    simulator(scene='car_step_steer', mode='lockstep', overrides=['maneuver={}', 'start.speed=25'])
    said = example(tmp_path, 'lqr_lane_keeping', '--node')
    found = re.search(r'from 0.20 m to ([+-][\d.]+) m beside the lane; the linear model is off by ([\d.]+) mm', said)
    assert found, said
    assert abs(float(found[1])) < 0.01 and float(found[2]) < 10.0


def test_two_cars_in_one_graph(simulator, tmp_path):
    said = example(tmp_path, 'two_cars')
    left, right = (
        re.search(rf'{name}: {name}/base_link in {name}/odom at x = ([\d.]+) m, y = ([+-][\d.]+) m', said)
        for name in ('car1', 'car2')
    )
    assert left and right, said
    assert float(left[2]) > 0.5 and float(right[2]) < -0.5


def test_an_adapter_makes_cmd_vel_commands_of_a_car(simulator, tmp_path):
    simulator(scene='light_car_straight', overrides=STANDING)
    adapter = Process(tmp_path, [sys.executable, '-m', 'mbd_sim_ros.node.adapter'])
    try:
        said = example(tmp_path, 'circle_by_cmd_vel')
    finally:
        adapter.kill()
    found = re.search(r'([\d.]+) m/s on a radius of ([\d.]+) m', said)
    assert found
    assert float(found[1]) == pytest.approx(7.0, abs=0.1)
    assert float(found[2]) == pytest.approx(20.0, abs=2.5)
