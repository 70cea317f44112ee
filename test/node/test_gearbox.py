"""The adapter on a car with an engine and an automatic gearbox: torques become pedal and lever, by hand and over real
topics."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from client import client
from foreign import packages
from processes import ROOT, Process
from real_node import simulator

from mbd_sim_ros.node.gearbox import Gearbox, Worked
from mbd_sim_ros.node.speed_control import DRIVE, NEUTRAL
from solver.files.scene import load_scene_text
from solver.scene import Scene

__all__ = ['client', 'simulator']  # fixtures

POWER = f'vehicle.engine.power={ROOT}/docs/examples/power.yaml'
BOX = (
    '{pedals: [0, 0.5, 1], up_kmh: [[12, 22, 45], [25, 45, 85], [40, 70, 125], [55, 95, 165]], '
    'down_kmh: [[6, 10, 28], [16, 28, 60], [30, 48, 95], [42, 70, 135]]}'
)
TEXT = f"""name: automatic
vehicle: {ROOT}/config/vehicles/compact_fwd.yaml
start: {{kind: equilibrium}}
assistance: {{shift: {BOX}}}
integrator: {{h: 2.0e-3}}
record: {{elements: false}}
"""
FINAL, GEARS, RPM = 4.06, (3.73, 1.96, 1.32, 0.95, 0.76), 2.0 * np.pi / 60.0


def given(*changes: str) -> Scene:
    return load_scene_text(TEXT, 'automatic', [POWER, *changes])


def test_a_torque_is_a_position_of_the_pedal_by_the_map():
    """At 2000 rpm the map of the compact says -20, 80 and 200 N m at 0, 0.3 and 1: 100 N m are a sixth of the way from
    0.3 to 1."""
    box = Gearbox.of(given())
    assert box is not None
    assert box.ratios == pytest.approx([FINAL * gear for gear in GEARS])
    assert box.reverse == pytest.approx(FINAL * 3.6)
    ratio = box.ratios[1]
    speed = 2000.0 * RPM / ratio * box.radius
    assert box.pedal(100.0 * ratio, ratio, speed) == pytest.approx(0.3 + 0.7 / 6.0)
    assert [box.pedal(torque * ratio, ratio, speed) for torque in (-50.0, 0.0, 1e4)] == [0.0, 0.0, 1.0]
    assert box.idle() == pytest.approx(1000.0 * RPM)


def test_the_final_drive_behind_a_propeller_shaft_counts():
    scene = load_scene_text(TEXT.replace('compact_fwd', 'full_car'), 'full', [POWER, 'vehicle.engine.power.final=1'])
    box = Gearbox.of(scene)
    assert box is not None
    assert box.ratios == pytest.approx([3.2 * gear for gear in GEARS])


def test_a_gearbox_that_nobody_works_stays_in_neutral():
    """Then the torque acts at the differential, as in a car without an engine that turns."""
    box = Gearbox.of(given('assistance={}'))
    assert box is not None
    assert Worked(box).commands(300.0, 1.0, DRIVE, 5.0, 0.01) == {'drive_torque': 300.0, 'gear': 0.0}
    assert Gearbox.of(load_scene_text(TEXT.replace(f'assistance: {{shift: {BOX}}}\n', ''), 'plain', [])) is None


def test_it_shifts_where_the_gearbox_does():
    box = Gearbox.of(given())
    assert box is not None
    worked = Worked(box)
    first = worked.commands(500.0, 1.0, DRIVE, 2.0, 0.01)
    assert first['accelerator'] == pytest.approx(box.pedal(500.0, box.ratios[0], 2.0)) and first['gear'] == 1.0
    for _ in range(100):
        worked.commands(500.0, 1.0, DRIVE, 12.0, 0.01)  # 43 km/h with little pedal: third gear
    third = worked.commands(500.0, 1.0, DRIVE, 10.0, 0.01)
    assert third['accelerator'] == pytest.approx(box.pedal(500.0, box.ratios[2], 10.0))
    assert worked.commands(500.0, 1.0, NEUTRAL, 10.0, 0.01) == {'drive_torque': 0.0, 'accelerator': 0.0, 'gear': 0.0}
    back = worked.commands(-500.0, -1.0, DRIVE, -1.0, 0.01)
    assert back == {'drive_torque': 0.0, 'accelerator': box.pedal(500.0, box.reverse, 1.0), 'gear': -1.0}
    worked.reset()  # 72 km/h: the gearbox of a car that begins there is in its last gear
    fast = worked.commands(500.0, 1.0, DRIVE, 20.0, 0.01)
    assert fast['accelerator'] == pytest.approx(box.pedal(500.0, box.ratios[4], 20.0))


@pytest.mark.slow
@pytest.mark.realtime
def test_autoware_drives_it_forwards_and_backwards(client, simulator, tmp_path):
    """Park holds it, drive takes it to its speed by the accelerator through gears, reverse back from rest in the
    reverse gear."""
    where = packages()
    sys.path.insert(0, str(where))
    from autoware_control_msgs.msg import Control
    from autoware_vehicle_msgs.msg import GearCommand

    (tmp_path / 'automatic.yaml').write_text(TEXT)
    process = simulator(scene=str(tmp_path / 'automatic.yaml'), overrides=[POWER], mode='lockstep', command_timeout=0.0)
    gears = client.node.create_publisher(GearCommand, '/control/command/gear_cmd', 1)
    control = client.node.create_publisher(Control, '/control/command/control_cmd', 1)
    arguments = ['-p', 'rate:=0.0', '-p', 'steering_ratio:=16.0', '-p', 'command_timeout:=0.0', '-p', 'timeout:=120.0']
    adapter = Process(
        tmp_path, [sys.executable, '-m', 'mbd_sim_ros.node.adapter', '--ros-args', *arguments], path=str(where)
    )
    try:
        client.until(lambda: client.applied and client.applied[-1]['step'] > 5, 150.0)
        client.until(lambda: gears.get_subscription_count() and control.get_subscription_count())

        def drive(gear: int, speed: float, there) -> None:
            message = Control()
            message.longitudinal.velocity = speed

            def arrived() -> bool:
                gears.publish(GearCommand(command=gear))
                control.publish(message)
                return there(client.odom[-1].twist.twist.linear.x, client.applied[-1])

            client.until(arrived, 90.0)

        drive(GearCommand.PARK, 5.0, lambda v, now: now['brake_torque'] == 6000.0 and now['gear'] == 0.0)
        parked = len(client.applied) - 1
        # 25 km/h with hardly any pedal
        drive(GearCommand.DRIVE, 7.0, lambda v, now: abs(v - 7.0) < 0.1 and now['gear'] == 3.0)
        assert list(dict.fromkeys(row['gear'] for row in client.applied[parked:])) == [0.0, 1.0, 2.0, 3.0]
        assert {row['drive_torque'] for row in client.applied} <= {0.0, -300.0}  # silence before the first demand
        assert max(row['accelerator'] for row in client.applied) > 0.1
        drive(GearCommand.REVERSE, -2.0, lambda v, now: v < -1.5 and now['gear'] == -1.0 and now['accelerator'] > 0.0)
        process.process.terminate()
        assert process.end() == 0, process.output
    finally:
        adapter.kill()
