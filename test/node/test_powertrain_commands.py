"""Pedals and gear of a car whose engine turns, over real topics: limits, gears that there are, the watchdog, lockstep,
replays, players."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from client import client
from processes import ROOT, Process
from real_node import simulator

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.node.gearbox import gears_of
from solver.files.scene import load_scene
from solver.inputs.command_filter import COMMANDS, commands_of

pytestmark = pytest.mark.realtime

__all__ = ['client', 'simulator']  # fixtures

SCENE = f"""name: pedals
vehicle: {ROOT}/config/vehicles/compact_fwd.yaml
start: {{kind: equilibrium, speed: 10.0}}
maneuver: {{signals: {{gear: 2, clutch: 0.2, accelerator: 0.6}}}}
integrator: {{h: 1.0e-3}}
duration: 0.4
record: {{elements: false}}
"""
POWER = f'vehicle.engine.power={ROOT}/docs/examples/power.yaml'


@pytest.fixture
def scene(tmp_path: Path) -> str:
    path = tmp_path / 'pedals.yaml'
    path.write_text(SCENE)
    return str(path)


def said(client) -> dict[str, str]:
    """The newest diagnostics by name."""
    return {v.key: v.value for a in client.diagnostics[-1:] for v in a.status[0].values}


def test_pedals_and_gear_are_commands_of_a_car_that_has_them(scene):
    given = load_scene(scene, [POWER])
    names = (*COMMANDS, 'accelerator', 'clutch', 'gear')
    assert commands_of(given.model.inputs) == names
    assert gears_of(given.model) == (-1, 5)
    assert gears_of(load_scene(scene, [POWER, 'vehicle.engine.power.reverse=null']).model) == (0, 5)
    plain = load_scene(scene, ['maneuver.signals={}']).model
    assert (commands_of(plain.inputs), gears_of(plain)) == (COMMANDS, None)


@pytest.mark.slow
def test_pedals_and_gear_over_topics_in_lockstep(client, simulator, scene, tmp_path):
    """What is beyond a pedal is clamped, a gear that there is not is refused; before a command gear and clutch are
    those of the scene and the accelerator is zero; an old accelerator counts as zero, and gear and clutch hold."""
    from std_msgs.msg import Float64, Int32

    process = simulator(
        scene=scene,
        overrides=[POWER],
        mode='lockstep',
        lockstep_commands=['brake_torque'],
        command_timeout=0.02,
        record=True,
        out='run',
    )
    kinds = {'accelerator': Float64, 'clutch': Float64, 'gear': Int32, 'brake': Float64}
    sent = {name: client.node.create_publisher(kind, f'simulator/{name}_cmd', 1) for name, kind in kinds.items()}
    client.until(lambda: all(p.get_subscription_count() for p in sent.values()), 90.0)
    client.until(lambda: client.applied)

    def send(**values: float) -> None:
        for name, value in values.items():
            sent[name].publish(kinds[name](data=value))

    def step(**values: float) -> dict[str, float]:
        k = client.applied[-1]['step']
        send(**values, brake=0.0)
        client.until(lambda: client.applied[-1]['step'] == k + 1)
        return client.applied[-1]

    def applied(now: dict[str, float]) -> tuple[float, ...]:
        return now['accelerator'], now['clutch'], now['gear']

    assert applied(step()) == (0.0, 0.2, 2.0)
    send(accelerator=1.7, clutch=-3.0, gear=3)
    client.until(lambda: applied(step()) == (1.0, 0.0, 3.0))
    process.wait_for('accelerator_cmd: 1.7 is beyond the limit; 1 is applied\n')
    send(gear=6)
    client.until(lambda: said(client).get('commands refused') == '1')
    assert applied(step())[2] == 3.0
    for _ in range(25):
        now = step()
    assert applied(now) == (0.0, 0.0, 3.0)  # the accelerator is older than 0.02 s
    client.until(lambda: 'no accelerator_cmd for 0.02 s: the accelerator is zero until one comes' in process.output)
    client.until(lambda: 'accelerator command is too old' in client.diagnostics[-1].status[0].message)
    send(accelerator=0.5, gear=-1)
    client.until(lambda: applied(step()) == (0.5, 0.0, -1.0))
    process.process.terminate()
    assert process.end() == 0, process.output
    assert (
        'gear_cmd: 6 is no gear: there are 1 to 5, 0 is neutral, -1 is the reverse gear; the gear stays'
        in process.output
    )
    run = bag.read(tmp_path / 'run')
    assert set(run['cmd_applied/gear']) == {2.0, 3.0, -1.0}
    assert main(['replay', str(tmp_path / 'run'), '--out', str(tmp_path / 'again')]) == 0
    again = bag.read(tmp_path / 'again')
    for name in ('cmd_applied/gear', 'cmd_applied/accelerator', 'odom/twist/vx', 'joint_states/crankshaft/velocity'):
        np.testing.assert_array_equal(run[name], again[name], err_msg=name)


@pytest.mark.slow
def test_a_player_plays_pedals_and_gear(simulator, scene, tmp_path):
    process = simulator(scene=scene, overrides=[POWER], mode='lockstep', duration=0.05, record=True, out='run')
    given = ['-p', f'maneuver:={played(tmp_path)}', '-p', 'rate:=0.0']
    player = Process(tmp_path, [sys.executable, '-m', 'mbd_sim_ros.node.maneuver_player', '--ros-args', *given])
    try:
        assert process.end(90.0) == 0, process.output + player.output
        assert player.end(30.0) == 0, player.output
    finally:
        player.kill()
    run = bag.read(tmp_path / 'run')
    at = np.arange(50) * 1e-3
    np.testing.assert_allclose(run['cmd_applied/accelerator'][1:], 2.0 * at, atol=1e-12)
    np.testing.assert_array_equal(run['cmd_applied/gear'][1:], np.where(at < 0.02, 2.0, 3.0))


def played(directory: Path) -> Path:
    path = directory / 'played.yaml'
    gear = '{kind: table, interpolation: linear, points: [[0, 2], [0.0195, 2], [0.0196, 3]]}'
    accelerator = '{kind: table, interpolation: linear, points: [[0, 0], [1, 2]]}'
    path.write_text(f'name: played\nsignals: {{gear: {gear}, accelerator: {accelerator}}}\n')
    return path


@pytest.mark.slow
def test_an_element_that_the_scene_adds_has_a_topic(client, simulator, tmp_path):
    """A damper whose valve is commanded: skyhook_cmd is there, what it says is applied and recorded, and a replay has
    the same bits."""
    from std_msgs.msg import Float64

    damper = '{terms: {travel_front_left: 1}, soft: 300, firm: 3000, lag: 0.02, input: skyhook}'
    added = f'vehicle.elements={{adjustable_dampers: {{skyhook: {damper}}}}}'
    process = simulator(
        scene='light_car_straight',
        overrides=[added],
        mode='lockstep',
        lockstep_commands=['brake_torque'],
        record=True,
        out='run',
    )
    valve, brake = (client.node.create_publisher(Float64, f'simulator/{name}_cmd', 1) for name in ('skyhook', 'brake'))
    client.until(lambda: valve.get_subscription_count() and brake.get_subscription_count(), 90.0)
    client.until(lambda: client.applied)

    def step() -> float:
        k = client.applied[-1]['step']
        brake.publish(Float64(data=0.0))
        client.until(lambda: client.applied[-1]['step'] == k + 1)
        return client.applied[-1]['skyhook']

    assert step() == 0.0
    valve.publish(Float64(data=0.7))
    client.until(lambda: step() == 0.7)
    for _ in range(100):
        step()
    process.process.terminate()
    assert process.end() == 0, process.output
    run = bag.read(tmp_path / 'run')
    valves = run['element_states/skyhook/valve']
    assert valves[~np.isnan(valves)][-1] == pytest.approx(0.7, abs=0.7 * np.exp(-4.0))  # four time constants and more
    assert main(['replay', str(tmp_path / 'run'), '--out', str(tmp_path / 'again')]) == 0
    again = bag.read(tmp_path / 'again')
    for name in ('cmd_applied/skyhook', 'element_states/skyhook/force', 'odom/twist/vx'):
        np.testing.assert_array_equal(run[name], again[name], err_msg=name)


@pytest.mark.slow
def test_lockstep_cannot_wait_for_a_pedal_that_there_is_not(simulator):
    process = simulator(scene='light_car_straight', mode='lockstep', lockstep_commands=['accelerator'])
    assert process.end(90.0) == 2
    assert (
        "light_car_straight has no input 'accelerator'; its commands are steering, drive_torque, brake_torque"
        in process.output
    )
