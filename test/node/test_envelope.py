"""The node says where a run leaves what its level of detail, or the certificate of its plan, holds for, at once and in
the verdict."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from client import client
from processes import Process

from mbd_sim_ros.bags import reader as bag

pytestmark = pytest.mark.realtime

__all__ = ['client']  # fixture

# The loads of the stand-in grow by 1 kN in each of its steps of 2 ms.
SCRIPT = """
import sys
import synthetic
from mbd_sim_ros.node import main as node
from solver.findings import LevelReport, Limit
def prepare(name, overrides):
    simulation = synthetic.Synthetic()
    simulation.level = LevelReport(validity=(Limit(quantity='wheel_load', unit='N', low=0.0, high=1e5, why='certified'),))
    return synthetic.scene(name=name), simulation
node.prepare = prepare
sys.exit(node.main(sys.argv[1:]))
"""  # noqa: E501


def node(directory: Path, **parameters: object) -> Process:
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    given = [text for name, value in parameters.items() for text in ('-p', f'{name}:={json.dumps(value)}')]
    return Process(directory, [sys.executable, '-c', SCRIPT, '--ros-args', '-p', 'scene:=synthetic', *given])


def test_a_run_outside_is_suspect_and_one_inside_is_not(tmp_path):
    """The last steps count too: with 0.22 s only they are outside."""
    found = {}
    for name, duration in (('inside', 0.18), ('outside', 0.22)):
        process = node(tmp_path, mode='fast', duration=duration, record=True, out=name)
        assert process.end() == 0, process.output
        metadata = bag.read(tmp_path / name).metadata
        found[name] = metadata['status'], json.loads(metadata['findings'])
        assert ('suspect: The run leaves its envelope: wheel load is' in process.output) == (name == 'outside')
    assert found['inside'] == ('ok', [])
    status, (finding,) = found['outside']
    assert status == 'suspect'
    assert (finding['quantity'], finding['where'], finding['limit']) == ('envelope', 'wheel_load', 1e5)
    assert finding['time'] == pytest.approx(0.22)
    assert finding['value'] == pytest.approx(5e5 * finding['time'], rel=0.01)


def test_diagnostics_warn_of_a_run_outside_until_it_begins_anew(tmp_path, client):
    """It stands still behind the step that was outside."""
    process = node(tmp_path, mode='lockstep', step_count=110)
    try:
        assert client.call('step').success
        told = 'suspect: The run leaves its envelope: wheel load is'
        client.until(lambda: any(told in a.status[0].message for a in client.diagnostics))
        warned = next(a.status[0] for a in client.diagnostics if told in a.status[0].message)
        assert (
            'wheel load is valid from 0 to 1e+05 N (envelope ' in warned.message
            and 'The limits: certified. ' in warned.message
        )
        assert warned.level == b'\x01'
        assert {v.key: v.value for v in warned.values}['findings'] == '1'
        assert client.call('reset').success
        client.diagnostics.clear()
        client.until(
            lambda: any({v.key: v.value for v in a.status[0].values}['verdict'] == 'ok' for a in client.diagnostics)
        )
    finally:
        process.kill()
