"""A node with a stand-in simulation in this process: opened, listened to and asked."""

from __future__ import annotations

import json
import os
import time

import pytest
from processes import DOMAIN
from synthetic import Synthetic, scene

MANY = 1_000_000  # steps that no test waits for


@pytest.fixture
def opened(tmp_path, monkeypatch):
    """Open a node in an empty directory: opened(parameter=value, ...); one that was opened before is closed."""
    rclpy = pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    from mbd_sim_ros.node.simulator import Simulator

    monkeypatch.chdir(tmp_path)
    nodes: list[Simulator] = []

    def close() -> None:
        for node in nodes:
            node.close('stopped')
            node.destroy_node()
        nodes.clear()
        rclpy.try_shutdown()

    def opened(**parameters: object) -> Simulator:
        close()
        # or this process, and those that its tests start, had it ever after
        parameters = {'realtime_priority': 0, **parameters}
        given = [text for name, value in parameters.items() for text in ('-p', f'{name}:={json.dumps(value)}')]
        rclpy.init(args=['--ros-args', *given], domain_id=int(DOMAIN))
        nodes.append(Simulator(lambda name, overrides: (scene(name=name), Synthetic())))
        nodes[0].open(scene(), Synthetic())  # type: ignore[arg-type]  # stand-ins
        return nodes[0]

    yield opened
    close()
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


@pytest.fixture
def sent(monkeypatch):
    """(topic, message) of everything that is published in this process."""
    publisher = pytest.importorskip(
        'rclpy.publisher', reason='needs ROS: source Jazzy, or pip install .[ros]'
    ).Publisher
    found: list[tuple[str, object]] = []
    plain = publisher.publish

    def noted(self, message) -> None:
        found.append((self.topic_name, message))
        plain(self, message)

    monkeypatch.setattr(publisher, 'publish', noted)
    return found


def do(node, action) -> tuple[bool, str]:
    """Have an action done between two steps."""
    from mbd_sim_ros.node.services import asked

    return asked(node.running, action)


def said(node) -> tuple[int, str]:
    """Level and message of the diagnostics."""
    from mbd_sim_ros.node.diagnostics import diagnosis

    recording = node.running.recording
    status = diagnosis(node.loop, recording.recorder, recording.failed)
    return status.level, status.message


def until(condition, seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, 'timed out'
        time.sleep(0.002)
