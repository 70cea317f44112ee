"""Recordings of others under our names: units, signs, offsets and axes come out as they must, what does not fit is
refused."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from scalars import run_of

from mbd_sim_ros.analysis.mapping import Axes, ChannelSource, apply, load_mapping, pairs, resolve
from solver.errors import BagError, MbdError
from solver.units import UNITS

T = np.arange(4) * 10**7


def no_unit(_: str) -> str:
    return ''


@pytest.mark.parametrize(
    ('unit', 'value', 'si'),
    [('deg', 180.0, math.pi), ('deg/s', 90.0, math.pi / 2), ('km/h', 36.0, 10.0), ('mph', 1.0, 0.44704),
    ('g', 1.0, 9.80665),
     ('kN', 2.0, 2000.0), ('kN m', 0.5, 500.0), ('mm', 25.0, 0.025), ('rpm', 60.0, 2.0 * math.pi), ('%', 12.0, 0.12),
     ('ms', 5.0, 0.005), ('in', 1.0, 0.0254),
     ('kn', 1.0, 1852.0 / 3600.0), ('lbf', 1.0, 0.45359237 * 9.80665), ('m/s', 3.0, 3.0)],
)  # fmt: skip
def test_units(unit: str, value: float, si: float) -> None:
    base, factor = UNITS[unit]
    assert value * factor == pytest.approx(si, rel=1e-14)
    assert UNITS[base] == (base, 1.0)


def test_a_channel_is_sign_times_value_in_si_plus_offset() -> None:
    theirs = run_of({'gyro/z': [10.0, 20.0, -30.0, 0.0]}, T)
    source = ChannelSource(channel='gyro/z', unit='deg/s', sign=-1.0, offset=0.5)
    found, held = apply(theirs, {'imu/wz': source}, (), no_unit)
    np.testing.assert_allclose(found['imu/wz'], 0.5 - np.deg2rad([10.0, 20.0, -30.0, 0.0]), rtol=1e-15)
    assert not held
    assert 'gyro/z' not in found.columns


def test_patterns_stand_for_the_same_text_on_both_sides() -> None:
    known = ['vehicle/imu/wz', 'vehicle/imu/ax', 'vehicle/speed', 'wheels/fl/load', 'wheels/rr/load']
    found = resolve(pairs(['vehicle/imu/*=imu/*', 'wheels/*/load=tire/*/force/fz']), known)
    assert {ours: theirs for ours, (theirs, _) in found.items()} == {
        'imu/wz': 'vehicle/imu/wz',
        'imu/ax': 'vehicle/imu/ax',
        'tire/fl/force/fz': 'wheels/fl/load',
        'tire/rr/force/fz': 'wheels/rr/load',
    }


@pytest.mark.parametrize('texts', [['car/*=*', 'car/yr=yaw_rate'], ['car/yr=yaw_rate', 'car/*=*']])
def test_a_name_goes_before_patterns(texts: list[str]) -> None:
    found = resolve(pairs(texts), ['car/yr', 'car/speed'])
    assert {ours: theirs for ours, (theirs, _) in found.items()} == {'yaw_rate': 'car/yr', 'speed': 'car/speed'}


def test_several_of_ours_may_be_made_from_one_of_theirs() -> None:
    """One accelerometer is both the lateral acceleration of a step steer and the specific force of a ride."""
    theirs = run_of({'car/lateral': [1.0, 2.0, 3.0, 4.0], 'car/speed': np.ones(4)}, T)
    theirs.known[''] = ('car/lateral', 'car/speed')
    sources = {
        'lateral_acceleration': ChannelSource(channel='car/lateral', unit='g'),
        'ay': ChannelSource(channel='car/lateral', sign=-1.0, hold=True),
    }
    found, held = apply(theirs, sources, (), no_unit)
    assert sorted(found.columns) == ['ay', 'car/speed', 'lateral_acceleration']
    assert found['lateral_acceleration'] == pytest.approx(9.80665 * np.arange(1.0, 5.0))
    assert found['ay'].tolist() == [-1.0, -2.0, -3.0, -4.0]
    assert held == {'ay'}
    assert found.names == ('lateral_acceleration', 'ay', 'car/speed')


def test_what_is_not_mapped_keeps_its_name_unless_a_mapped_one_takes_it() -> None:
    theirs = run_of({'a': np.ones(4), 'b': np.full(4, 2.0), 'c': np.full(4, 3.0)}, T)
    found, _ = apply(theirs, pairs(['a=b']), (), no_unit)
    assert {name: values[0] for name, values in found.columns.items()} == {'b': 1.0, 'c': 3.0}


def test_axes_are_turned() -> None:
    """x forward, y right, z down becomes x forward, y left, z up; and a quarter turn about z takes their x to our y."""
    theirs = run_of({'x': [1.0, 0.0, 0.0, 1.0], 'y': [0.0, 1.0, 0.0, 2.0], 'z': [0.0, 0.0, 1.0, 3.0]}, T)
    found, _ = apply(theirs, {}, [Axes(channels=('x', 'y', 'z'), rpy=(math.pi, 0.0, 0.0))], no_unit)
    np.testing.assert_allclose([found[c] for c in 'xyz'], [[1, 0, 0, 1], [0, -1, 0, -2], [0, 0, -1, -3]], atol=1e-15)
    theirs = run_of({'x': [1.0, 0.0, 0.0, 1.0], 'y': [0.0, 1.0, 0.0, 2.0], 'z': [0.0, 0.0, 1.0, 3.0]}, T)
    found, _ = apply(theirs, {}, [Axes(channels=('x', 'y', 'z'), rpy=(0.0, 0.0, math.pi / 2))], no_unit)
    np.testing.assert_allclose([found[c] for c in 'xyz'], [[0, -1, 0, -2], [1, 0, 0, 1], [0, 0, 1, 3]], atol=1e-15)


def test_turning_axes_does_not_touch_the_recording_itself() -> None:
    theirs = run_of({'x': np.ones(4), 'y': np.ones(4), 'z': np.ones(4)}, T)
    apply(theirs, {}, [Axes(channels=('x', 'y', 'z'), rpy=(math.pi, 0.0, 0.0))], no_unit)
    assert theirs['y'].tolist() == [1.0] * 4


def test_a_mapping_file(tmp_path: Path) -> None:
    file = tmp_path / 'car.yaml'
    file.write_text(
        "channels:\n  imu/wz: {channel: gyro/z, unit: deg/s}\n  'tire/*/force/fz': {channel: 'load/*', unit: kN, hold: "
        'true}\naxes:\n  - {channels: [imu/ax, imu/ay, imu/az], rpy_deg: [180, 0, 0]}\n'
    )
    read = load_mapping(file)
    assert read.channels['imu/wz'] == ChannelSource(channel='gyro/z', unit='deg/s')
    assert read.channels['tire/*/force/fz'].hold
    assert read.axes[0].rpy == pytest.approx((math.pi, 0.0, 0.0))


@pytest.mark.parametrize(
    ('text', 'says'),
    [
        ('channels:\n  imu/wz: {channel: gyro/z, unit: degs}\n', "unit = 'degs': no such unit; did you mean 'deg"),
        ('channels:\n  imu/wz: {channel: gyro/z, sign: 2}\n', 'must be 1 or -1'),
        ('channels:\n  imu/wz: {chanel: gyro/z}\n', 'chanel'),
        ('channels:\n  imu/wz: gyro/z\n', 'must be a mapping'),
        ('channels: {}\naxes:\n  - {channels: [a, b], rpy: [0, 0, 0]}\n', 'must be three channels'),
        ('channels: [\n', 'car.yaml'),
    ],
)
def test_a_wrong_mapping_file_is_refused_in_one_sentence(text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / 'car.yaml'
    file.write_text(text)
    with pytest.raises(MbdError, match=re.escape(says)) as caught:
        load_mapping(file)
    assert '\n' not in str(caught.value)


def test_what_does_not_fit_the_recording_is_refused() -> None:
    theirs = run_of({'gyro/z': np.zeros(4), 'gyro/y': np.zeros(4)}, T)
    with pytest.raises(BagError, match="no column 'gyro/zz'; did you mean 'gyro/z'"):
        apply(theirs, pairs(['gyro/zz=imu/wz']), (), no_unit)
    with pytest.raises(BagError, match='same number of'):
        apply(theirs, pairs(['gyro/*=imu/wz']), (), no_unit)
    with pytest.raises(BagError, match='imu/wz is made from both gyro/z and gyro/y'):
        resolve(
            {'imu/w*': ChannelSource(channel='gyro/*'), 'imu/wz': ChannelSource(channel='gyro/y')}, ['gyro/z', 'gyro/y']
        )
    with pytest.raises(BagError, match=r"imu/wz: it is in rad/s, which 'km/h' does not measure"):
        apply(theirs, {'imu/wz': ChannelSource(channel='gyro/z', unit='km/h')}, (), lambda _: 'rad/s')
    with pytest.raises(BagError, match='mapping of axes: gyro/x is not in the recording'):
        apply(theirs, {}, [Axes(channels=('gyro/z', 'gyro/y', 'gyro/x'), rpy=(0.0, 0.0, 0.0))], no_unit)
