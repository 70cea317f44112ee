"""Measurements in MDF files and CAN logs become the columns that were written; what is dropped is counted and told."""

from __future__ import annotations

import json
import re
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.analysis import runs
from mbd_sim_ros.commands.main import main
from solver.errors import BagError

can = pytest.importorskip('can')
asammdf = pytest.importorskip('asammdf')

N = 300
T = np.arange(N) * 0.01
RATE = np.round(100.0 * np.sin(T)).astype(int)  # in 0.01 deg/s
EPOCH = 1_700_000_000
DBC = """VERSION ""
BS_:
BU_: ECU
BO_ 256 Motion: 4 ECU
 SG_ YawRate : 0|16@1- (0.01,0) [-327|327] "deg/s" ECU
 SG_ Speed : 16|16@1+ (0.01,0) [0|655] "km/h" ECU
BO_ 300 Wheels: 3 ECU
 SG_ Which M : 0|8@1+ (1,0) [0|1] "" ECU
 SG_ Left m0 : 8|16@1+ (0.1,0) [0|6000] "rpm" ECU
 SG_ Right m1 : 8|16@1+ (0.1,0) [0|6000] "rpm" ECU
"""


def message(k: int, identifier: int, data: bytes, **more: bool) -> can.Message:
    return can.Message(
        timestamp=EPOCH + T[k], arbitration_id=identifier, is_extended_id=False, data=data, channel=1, **more
    )


@pytest.fixture
def database(tmp_path: Path) -> Path:
    (tmp_path / 'car.dbc').write_text(DBC)
    return tmp_path / 'car.dbc'


def logged(file: Path) -> Path:
    """300 frames of the motion, 300 of the wheels by turns, 3 of another identifier, 2 too short ones."""
    with can.Logger(file) as log:
        for k in range(N):
            log.on_message_received(message(k, 256, struct.pack('<hH', RATE[k], 1000 + k)))
            log.on_message_received(message(k, 300, struct.pack('<BH', k % 2, 500 + k)))
            if k % 100 == 0:
                log.on_message_received(message(k, 77, b'12'))
        log.on_message_received(message(N - 1, 256, b'12'))
        log.on_message_received(message(N - 1, 256, b''))
    return file


@pytest.mark.parametrize('ending', ['blf', 'asc', 'mf4', 'log'])
def test_frames_become_signals_by_their_database(ending: str, database: Path, tmp_path: Path) -> None:
    run = runs.read(logged(tmp_path / f'drive.{ending}'), databases=[database])
    home = {name: one for one in run.series.values() for name in one.columns}
    assert set(home) == {'Motion/YawRate', 'Motion/Speed', 'Wheels/Which', 'Wheels/Left', 'Wheels/Right'}
    motion = home['Motion/YawRate']
    np.testing.assert_allclose((motion.time_ns - motion.time_ns[0]) * 1e-9, T, atol=2e-6)
    np.testing.assert_allclose(motion.columns['Motion/YawRate'], 0.01 * RATE, atol=1e-12)
    np.testing.assert_allclose(motion.columns['Motion/Speed'], 10.0 + 0.01 * np.arange(N), atol=1e-12)
    for name, first in (('Wheels/Left', 0), ('Wheels/Right', 1)):  # at their own instants
        np.testing.assert_allclose((home[name].time_ns - motion.time_ns[0]) * 1e-9, T[first::2], atol=2e-6)
        np.testing.assert_allclose(home[name].columns[name], 0.1 * (500 + np.arange(N)[first::2]), atol=1e-9)
    assert {run.stated[name] for name in ('Motion/YawRate', 'Motion/Speed', 'Wheels/Left')} == {'deg/s', 'km/h', 'rpm'}
    assert run.told == (
        '3 of 605 frames have an identifier that no database has',
        '2 of 605 frames are shorter than their message',
    )


def measured(file: Path) -> Path:
    """Two rates, a unit in another spelling, invalid and doubled samples, a name that two groups have, a text."""
    mdf = asammdf.MDF()
    invalid = np.zeros(N, bool)
    invalid[[5, 6]] = True
    signals = [
        asammdf.Signal(np.sin(T), T, name='yaw_rate', unit='°/s'),
        asammdf.Signal(np.cos(T), T, name='torque', unit='Nm', invalidation_bits=invalid),
        asammdf.Signal(np.array([b'abc'] * N), T, name='mode', encoding='utf-8'),
    ]
    mdf.append(signals, comment='fast')
    slow = np.arange(30) * 0.1
    slow[20] = slow[19]
    mdf.append(
        [
            asammdf.Signal(np.arange(30, dtype='u1'), slow, name='gear'),
            asammdf.Signal(np.arange(30.0), slow, name='torque'),
        ]
    )
    mdf.save(file, overwrite=True)
    mdf.close()
    return file


def test_groups_of_a_measurement_are_topics(tmp_path: Path) -> None:
    run = runs.read(measured(tmp_path / 'drive.mf4'))
    home = {name: one for one in run.series.values() for name in one.columns}
    assert set(home) == {'yaw_rate', 'gear', 'group_0/torque', 'group_1/torque'}
    np.testing.assert_array_equal(home['yaw_rate'].time_ns, np.round(T * 1e9))
    np.testing.assert_array_equal(run.series['group_0'].columns['yaw_rate'], np.sin(T))
    assert np.flatnonzero(np.isnan(home['group_0/torque'].columns['group_0/torque'])).tolist() == [5, 6]
    assert home['gear'].time_ns.size == 29
    assert run.stated == {'yaw_rate': 'deg/s', 'group_0/torque': 'N m'}
    assert run.left_out == {'mode': 'it holds text'}
    assert run.told == (
        'group_0/torque: 2 of 300 samples without a valid number',
        '1 of 30 samples of group_1 repeat a stamp or are out of order',
    )


def test_a_log_is_compared_with_a_table(database: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / 'ours.csv'
    rows = [f'{EPOCH + t:.2f},{0.01 * rate!r}' for t, rate in zip(T.tolist(), RATE.tolist())]
    table.write_text('\n'.join(['timestamp,imu/wz [deg/s]', *rows]))
    log = logged(tmp_path / 'drive.blf')
    code = main(
        [
            'compare',
            str(table),
            str(log),
            '--dbc',
            str(database),
            '--map',
            'Motion/YawRate=imu/wz',
            '--allow-missing',
            '--atol',
            '1e-4',
            '--json',
        ]
    )
    data = json.loads(capsys.readouterr().out)
    assert (code, list(data['channels'])) == (0, ['imu/wz'])
    assert data['doubts'] == {
        'drive.blf': [
            '3 of 605 frames have an identifier that no database has',
            '2 of 605 frames are shorter than their message',
        ]
    }
    assert main(['compare', str(log), '--dbc', str(database), '--look', '--json']) == 0
    assert json.loads(capsys.readouterr().out)['columns']['Motion/YawRate']['quantity'] == 'yaw_rate'


@pytest.mark.parametrize('ending', ['mf4', 'mdf', 'blf', 'asc'])
@pytest.mark.parametrize('content', [b'', b'MDF     4.10    ', b'LOGG' + b'\x90\0\0\0' * 9, b'\0\1\2' * 500])
def test_what_is_no_measurement_is_refused_in_one_sentence(
    content: bytes, ending: str, database: Path, tmp_path: Path
) -> None:
    file = tmp_path / f'x.{ending}'
    file.write_bytes(content)
    with pytest.raises(BagError, match=re.escape(str(file))) as caught:
        runs.read(file, databases=[database])
    assert '\n' not in str(caught.value)


def test_what_is_missing_is_named(database: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = logged(tmp_path / 'drive.asc')
    with pytest.raises(
        BagError, match='it holds frames of a CAN bus; a database says which signals are in them: --dbc FILE'
    ):
        runs.read(log)
    with pytest.raises(BagError, match=re.escape('--dbc none.dbc: no such file')):
        runs.read(log, databases=[Path('none.dbc')])
    (tmp_path / 'empty.dbc').write_text('VERSION ""\n')
    with pytest.raises(BagError, match=re.escape('empty.dbc: no message is defined in it')):
        runs.read(log, databases=[tmp_path / 'empty.dbc'])
    with pytest.raises(BagError, match='no such file'):
        runs.read(tmp_path / 'none.mf4')
    monkeypatch.setitem(sys.modules, 'asammdf', None)
    with pytest.raises(BagError, match=re.escape("pip install 'mbd_sim_ros[loggers]'")):
        runs.read(log, databases=[database])


def test_names_that_come_twice_are_all_there(tmp_path: Path) -> None:
    mdf = asammdf.MDF()
    mdf.append([asammdf.Signal(np.full(N, float(k)), T, name='a') for k in range(3)])
    mdf.save(tmp_path / 'x.mf4', overwrite=True)
    mdf.close()
    assert [values[0] for values in runs.read(tmp_path / 'x.mf4').columns.values()] == [0.0, 1.0, 2.0]
    (tmp_path / 'two.dbc').write_text(DBC + 'BO_ 77 Motion: 2 ECU\n SG_ Gear : 0|8@1+ (1,0) [0|9] "" ECU\n')
    names = runs.read(logged(tmp_path / 'x.asc'), databases=[tmp_path / 'two.dbc']).names
    assert {'Motion_100/YawRate', 'Motion_4D/Gear', 'Wheels/Left'} <= set(names)
