"""The node with a real scene: what it recorded while driven over topics comes out of a batch run bit for bit."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
import yaml
from processes import ROOT, Process

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.commands.main import main
from solver.compiled.target import differences, target


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


def test_on_another_target_it_says_that_the_same_bits_cannot_be_expected(tmp_path, capsys):
    """The recording is made by a process whose C library takes its functions for processors without FMA (glibc's tunable)."""
    if not target()['libc'].startswith('glibc') or target()['fma'] != 'yes':
        pytest.skip('needs glibc on a processor with FMA: only there the functions can be chosen')
    settings = ('light_car_straight', '--duration', '0.2', '--set', 'record.every=1', '--out', str(tmp_path / 'run'))
    command = [sys.executable, '-m', 'mbd_sim_ros.commands.main', 'run', *settings]
    environment = {**os.environ, 'GLIBC_TUNABLES': 'glibc.cpu.hwcaps=-FMA,-AVX2', 'PYTHONPATH': str(ROOT)}
    subprocess.run(command, env=environment, check=True, capture_output=True, timeout=600)
    assert main(['replay', str(tmp_path / 'run')]) == 1
    sentence = capsys.readouterr().out.strip().splitlines()[-1]
    there = yaml.safe_load(bag.read(tmp_path / 'run').metadata['target'])
    assert there | {'elementary': ''} == target() | {'elementary': ''}
    assert sentence == (
        'the same bits cannot be expected, because the recording was made on another target: '
        f'elementary {there["elementary"]} there and {target()["elementary"]} here'
    )


def test_on_the_same_target_it_says_nothing_of_it(tmp_path, capsys):
    assert main(['run', 'slider_crank', '--duration', '0.1', '--out', str(tmp_path / 'run')]) == 0
    run = bag.read(tmp_path / 'run')
    assert yaml.safe_load(run.metadata['target']) == target()
    assert main(['replay', str(tmp_path / 'run')]) == 0
    assert 'the same bits cannot' not in capsys.readouterr().out


def test_what_only_one_of_two_targets_says_is_no_difference():
    """A recording of a version that knew fewer entries."""
    assert differences({}, target()) == []
    assert differences({'libc': 'glibc 2.35', 'numba': '1'}, {'libc': 'glibc 2.39', 'fma': 'yes', 'numba': '1'}) == [
        'libc glibc 2.35 there and glibc 2.39 here'
    ]
