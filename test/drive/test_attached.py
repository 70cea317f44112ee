"""A running node, looked at and driven from a page, over real topics."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from foreign import packages
from page_client import PageClient, address_in
from processes import Process
from real_node import simulator

from mbd_sim_ros.bags import reader
from mbd_sim_ros.commands.main import main

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

__all__ = ['simulator']  # a fixture


def test_a_page_looks_at_a_node_takes_the_wheel_drives_and_lets_go(simulator, tmp_path: Path) -> None:
    where = str(packages())
    node = simulator(
        where, scene='light_car_straight', overrides=['start.speed=5.0', 'record.poses=100'], record=True, out='run',
        duration=0.0,
    )  # fmt: skip
    node.wait_for('running light_car_straight', 300.0)
    desk = Process(
        tmp_path, [sys.executable, '-m', 'mbd_sim_ros.commands.main', 'drive', '--node', '--no-browser'], path=where
    )
    desk.wait_for('Ctrl-C ends', 60.0)
    page = PageClient(address_in(desk.output))
    page.until(lambda one: one.pictures > 10)
    assert page.told['driving'] is False and page.told['taken'] is False  # it has to ask
    page.hold(gas=1.0)
    page.until(lambda one: one.pictures > 50)
    assert page.head[8] == 0.0
    page.say(do='take')
    page.until(lambda one: one.head[8] > 0.9 and one.head[4] > 1.0)  # the pedal is down, and the car accelerates
    page.say(do='pause')
    page.until(lambda one: one.told['paused'])
    page.say(do='resume')
    page.until(lambda one: not one.told['paused'])
    page.close()
    other = PageClient(address_in(desk.output))
    other.until(lambda one: one.pictures > 10 and one.head[8] == 0.0)  # nobody holds the gas any more
    assert other.told['taken'] is False
    other.say(do='take')
    other.until(lambda one: one.told['driving'])
    other.say(do='reset')
    other.until(lambda one: one.told['run'] == 2)
    node.process.terminate()
    assert node.end() == 0, node.output
    assert desk.end() == 0, desk.output
    assert 'the node has ended' in desk.output
    run = reader.read(tmp_path / 'run')
    assert run['cmd_applied/drive_torque'].max() > 500.0 and run['cmd_applied/drive_torque'][-1] == 0.0
    assert main(['replay', str(tmp_path / 'run')]) == 0


def test_a_node_that_is_not_there_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(packages()))
    from mbd_sim_ros.drive import attached

    monkeypatch.setattr(attached, 'TIMEOUT', 0.5)
    assert main(['drive', '--node', 'nobody', '--no-browser']) == 6
    said = capsys.readouterr().err
    assert (
        said.startswith('mbd: --node nobody: no node of this name tells its scene within 0.5 s')
        and said.count('\n') == 1
    )
