"""Starting a simulator with a real scene."""

from __future__ import annotations

import json
import sys

import pytest
from processes import Process


@pytest.fixture
def simulator(tmp_path):
    """Start a simulator: simulator(parameter=value, ...), path: of further packages."""
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    started = []

    def simulator(path: str = '', **parameters: object) -> Process:
        arguments = [text for name, value in parameters.items() for text in ('-p', f'{name}:={json.dumps(value)}')]
        started.append(
            Process(tmp_path, [sys.executable, '-m', 'mbd_sim_ros.node.main', '--ros-args', *arguments], path=path)
        )
        return started[-1]

    yield simulator
    for process in started:
        process.kill()
