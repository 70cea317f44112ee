"""Values with names are columns by name, in whatever order a publisher names them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, Writer

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.messages import cdr

MS = 1_000_000
HEADER = """std_msgs/Header header
"""
PARTS = """
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
DYNAMIC = 'control_msgs/msg/DynamicJointState'
DYNAMIC_TEXT = (
    HEADER
    + 'string[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values\n'
    + '=' * 80
    + '\nMSG: control_msgs/InterfaceValue\nstring[] interface_names\nfloat64[] values'
    + PARTS
)
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
DIAGNOSTICS_TEXT = (
    HEADER
    + 'diagnostic_msgs/DiagnosticStatus[] status\n'
    + '=' * 80
    + (
        '\nMSG: diagnostic_msgs/DiagnosticStatus\nbyte OK=0\nbyte level\nstring name\nstring message\nstring '
        'hardware_id\n'
    )
    + 'diagnostic_msgs/KeyValue[] values\n'
    + '=' * 80
    + '\nMSG: diagnostic_msgs/KeyValue\nstring key\nstring value'
    + PARTS
)


def recorded(place: Path, topic: str, kind: str, text: str, values: list[dict[str, Any]]) -> bag.Run:
    """A recording of messages with these values, 10 ms apart, read again."""
    file = place / 'a.mcap'
    with file.open('wb') as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile='ros2', library='test')
        channel = writer.register_channel(topic, 'cdr', writer.register_schema(kind, 'ros2msg', text.encode()))
        for k, value in enumerate(values):
            t = (k + 1) * 10 * MS
            header = {'stamp': {'sec': 0, 'nanosec': t}, 'frame_id': ''}
            writer.add_message(channel, t, cdr.encode(kind, text, {'header': header, **value})[0], t, k)
        writer.finish()
    return bag.read(file)


def test_interfaces_of_a_dynamic_joint_state_are_columns_by_joint_and_interface_in_any_order(tmp_path: Path) -> None:
    def value(k: int, joints: list[str], interfaces: list[str]) -> dict[str, Any]:
        numbers = {'front': 1.0, 'rear': 2.0, 'position': 10.0, 'velocity': 20.0}
        return {
            'joint_names': joints,
            'interface_values': [
                {
                    'interface_names': interfaces,
                    'values': np.array([100.0 * k + numbers[i] + numbers[j] for i in interfaces]),
                }
                for j in joints
            ],
        }

    order = [(['front', 'rear'], ['position', 'velocity']), (['rear', 'front'], ['velocity', 'position'])]
    values = [value(k, *order[k % 2]) for k in range(6)]
    run = recorded(tmp_path, '/dynamic_joint_states', DYNAMIC, DYNAMIC_TEXT, values)
    name = 'dynamic_joint_states/{}/{}'
    for joint, of_joint in (('front', 1.0), ('rear', 2.0)):
        for interface, of_it in (('position', 10.0), ('velocity', 20.0)):
            np.testing.assert_array_equal(run[name.format(joint, interface)], 100.0 * np.arange(6) + of_joint + of_it)
    assert len(run.columns) == 4, list(run.columns)
    assert run.doubts == ()


def test_values_of_diagnostics_are_columns_by_name_and_key_in_any_order_and_words_are_told(tmp_path: Path) -> None:
    def value(k: int, turned: bool) -> dict[str, Any]:
        pairs = {'temperature': f'{20 + k}.5', 'mode': 'eco', 'load': f'{k}e-1'}
        listed = [{'key': key, 'value': value} for key, value in pairs.items()]
        motor = {'level': 0, 'name': 'motor', 'values': listed[::-1] if turned else listed}
        brake = {'level': 1, 'name': 'brake', 'values': [{'key': 'temperature', 'value': f'{80 - k}'}]}
        return {'status': [brake, motor] if turned else [motor, brake]}

    run = recorded(tmp_path, '/diagnostics', DIAGNOSTICS, DIAGNOSTICS_TEXT, [value(k, bool(k % 2)) for k in range(6)])
    numbers = np.arange(6.0)
    np.testing.assert_array_equal(run['diagnostics/motor/values/temperature'], 20.5 + numbers)
    np.testing.assert_array_equal(run['diagnostics/motor/values/load'], [float(f'{k}e-1') for k in range(6)])
    np.testing.assert_array_equal(run['diagnostics/brake/values/temperature'], 80.0 - numbers)
    np.testing.assert_array_equal(run['diagnostics/brake/level'], np.ones(6))
    assert np.isnan(run['diagnostics/motor/values/mode']).all()
    assert run.doubts == ('topic diagnostics: values that are no number: diagnostics/motor/values/mode (6)',)
