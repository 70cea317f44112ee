"""The node with a real scene: what it recorded while driven over topics comes out of a batch run bit for bit."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from processes import Process

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.commands.main import main


@pytest.mark.slow
def test_a_recorded_run_replays_to_the_same_bits(tmp_path, capsys):
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    parameters = {
        'scene': 'slider_crank',
        'overrides': "['integrator.h=0.002']",
        'mode': 'fast',
        'duration': 1.0,
        'record': True,
        'out': 'run',
    }
    arguments = [text for name, value in parameters.items() for text in ('-p', f'{name}:={value}')]
    process = Process(tmp_path, [sys.executable, '-m', 'mbd_sim_ros.node.main', '--ros-args', *arguments])
    try:
        assert process.end(1200.0) == 0, process.output  # the kernels may have to be compiled
    finally:
        process.kill()
    run = bag.read(tmp_path / 'run')
    np.testing.assert_array_equal(run['cmd_applied/step'], np.arange(501.0))
    assert 'h: 0.002' in run.metadata['resolved_scene']
    assert np.ptp(run['joint_states/slide/position']) > 1.0  # it moves
    assert main(['replay', str(tmp_path / 'run'), '--json']) == 0, capsys.readouterr()
