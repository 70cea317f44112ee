"""Tables as loggers write them are read as what they mean; what is dropped is counted and told, what may mean two
things is refused."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.analysis import load, runs
from mbd_sim_ros.analysis.cells import unit_of
from mbd_sim_ros.analysis.mapping import load_mapping
from mbd_sim_ros.analysis.stamps import is_time, rising
from mbd_sim_ros.analysis.tables import TimeColumn
from mbd_sim_ros.commands.main import main
from solver.errors import BagError

S, MS = 10**9, 10**6
EPOCH = 1_700_000_000 * S
NOON = 1_706_702_400 * S  # 2024-01-31T12:00:00Z
MOTEC = (
    '"Format","MoTeC CSV File",,,"Workbook",""\n"Sample Rate","100.000","Hz",,\n\n"Time","Ground Speed","G Force '
    'Lat"\n"s","km/h","G"\n\n\n"0.000","36","0.5"\n"0.010","72","1"\n'
)


def written(tmp_path: Path, text: str | bytes, name: str = 'x.csv') -> Path:
    file = tmp_path / name
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return file


@pytest.mark.parametrize(
    ('text', 'columns'),
    [
        ('# time(s),yaw rate (deg/s),speed '
            '(km/h)\n0.0,180,36\n0.01,90,72\n', {'yaw rate': [np.pi, np.pi / 2], 'speed': [10.0, 20.0]}),
        ('\ufeffTime;Gierrate [°/s];v '
            '(km/h)\n0,00;180;36,0\n0,01;90,0;72,0\n', {'Gierrate': [np.pi, np.pi / 2], 'v': [10.0, 20.0]}),
        ('Zeit [s];Gierrate [°/s]\n0,00;180\n0,01;90\n'.encode('cp1252'), {'Gierrate': [np.pi, np.pi / 2]}),
        ('t\tspeed\n\tkph\n0.0\t36\n0.01\t72\n'.encode('utf-16'), {'speed': [10.0, 20.0]}),
        (MOTEC, {'Ground Speed': [10.0, 20.0], 'G Force Lat': [9.80665 / 2, 9.80665]}),
        ('Time (ms),Speed (KPH),wheel speed (L),wheel speed (R),acc (IMU)\n0,36,1,2,3\n10,72,4,5,6\n',
         {'Speed': [10.0, 20.0], 'wheel speed (L)': [1.0, 4.0], 'wheel speed '
             '(R)': [2.0, 5.0], 'acc (IMU)': [3.0, 6.0]}),
        ('time  yaw rate  speed\n0.0 1 2\n0.01 3 4\n', {'yaw rate': [1.0, 3.0], 'speed': [2.0, 4.0]}),
        (',time,x,\n0,0.0,1,\n1,0.01,2,\n', {'x': [1.0, 2.0]}),
        ('time,x\r\n0,"1.5"\r\n0.01, 2\r\n', {'x': [1.5, 2.0]}),
    ],
)  # fmt: skip
def test_headers_separators_and_units_of_loggers(
    text: str | bytes, columns: dict[str, list[float]], tmp_path: Path
) -> None:
    found = load(written(tmp_path, text))['']
    assert found.index.tolist() == pytest.approx([0.0, 0.01])
    assert list(found.columns) == list(columns)
    for name, values in columns.items():
        assert found[name].to_numpy() == pytest.approx(values, rel=1e-14)


@pytest.mark.parametrize(
    ('header', 'cells', 'time_ns'),
    [
        ('t_ms', ('0', '2.5'), (0, 2_500_000)),
        ('TimeUS', ('1000', '11000'), (MS, 11 * MS)),
        ('time_min', ('0.5', '1.0'), (30 * S, 60 * S)),
        ('Time [µs]', ('0', '100'), (0, 100_000)),
        ('timestamp', ('1700000000.123456789', '1700000000.223456789'), (EPOCH + 123456789, EPOCH + 223456789)),
        ('timestamp', ('1700000000001', '1700000000011'), (EPOCH + MS, EPOCH + 11 * MS)),
        ('timestamp', ('1700000000000001', '1700000000010001'), (EPOCH + 1000, EPOCH + 10 * MS + 1000)),
        ('%time', ('1700000000000000001', '1700000000010000001'), (EPOCH + 1, EPOCH + 10 * MS + 1)),
        ('stamp_sec,stamp_nanosec', ('1700000000,7', '1700000000,10000007'), (EPOCH + 7, EPOCH + 10 * MS + 7)),
        ('datetime', ('2024-01-31T12:00:00.5Z', '2024-01-31T13:00:00.51+01:00'), (NOON + 500 * MS, NOON + 510 * MS)),
        ('Date,Time', ('2024-01-31,12:00:00.500', '2024-01-31,12:00:00.510'), (NOON + 500 * MS, NOON + 510 * MS)),
        ('Zeit', ('31.01.2024 12:00:00', '31.01.2024 12:00:01'), (NOON, NOON + S)),
        ('Uhrzeit', ('23:59:59.990', '0:00:00.000'), (86_400 * S - 10 * MS, 86_400 * S)),
        ('elapsed', ('00:01.5', '01:00.0'), (1500 * MS, 60 * S)),
    ],
)
def test_times_as_loggers_write_them(
    header: str, cells: tuple[str, str], time_ns: tuple[int, int], tmp_path: Path
) -> None:
    run = runs.read(written(tmp_path, f'{header},x\n{cells[0]},1.5\n{cells[1]},2.5\n'))
    assert next(iter(run.series.values())).time_ns.tolist() == list(time_ns)
    assert run['x'].tolist() == [1.5, 2.5]


def test_dates_without_a_zone_and_nights_are_told(tmp_path: Path) -> None:
    assert runs.read(written(tmp_path, 'Zeit;x\n2024-01-31 12:00:00,5;1,5\n')).told == (
        'Zeit: its dates have no time zone and are taken as UTC',
    )
    assert 'pass midnight' in runs.read(written(tmp_path, 'time,x\n23:59:59,1\n00:00:00,2\n')).told[0]


@pytest.mark.parametrize(
    ('text', 'told', 'values'),
    [
        ('time,x\n0,1\n0.01,2\n0.01,3\n0.005,4\n0.02,5\n9.0,6\n0.03,7\n0.04,8\n',
         '3 of 8 rows are dropped: 1 repeat a stamp and 2 are out of order of time (lines 4, 5, '
         '7)', [1.0, 2.0, 5.0, 7.0, 8.0]),
        ('time,x\n0,1\n0.01,2\n0.02\n', '1 of 3 rows cannot be read (line 4)', [1.0, 2.0]),
        ('time,x\n0,1\n,2\n0.02,3\ntime,x\n0.03,4\n', '2 of 5 rows cannot be read (lines 3, 5)', [1.0, 3.0, 4.0]),
        ('time,x\n0,1\n0.1,2\n0.2,ERR\n0.3,4\n', "x: 1 of 4 cells without a number ('ERR' in line "
            "4)", [1.0, 2.0, np.nan, 4.0]),
        ('time,x\n0,1\n0.1,nan\n0.2,3\n0.3,4\n', 'x: 1 of 4 cells without a number', [1.0, np.nan, 3.0, 4.0]),
        ('time,x\n0,1\n0.1,1_0\n0.2,3\n0.3,4\n', "x: 1 of 4 cells without a number ('1_0' in line "
            "3)", [1.0, np.nan, 3.0, 4.0]),
        ('elapsed,x,rec time\n0,1,1700000000.1\n0,2,1700000000.2\n0.1,3,1700000000.3\n0.1,4,1700000000.4\n',
         "the time is the column 'rec time'; 'elapsed' would be another ('elapsed' stands still or goes "
         "back)", [1.0, 2.0, 3.0, 4.0]),
        (',time,x\n7,0,1\n8,0.1,2\n', 'column 1 has no name and is left out', [1.0, 2.0]),
    ],
)  # fmt: skip
def test_what_is_dropped_is_counted_and_told(text: str, told: str, values: list[float], tmp_path: Path) -> None:
    run = runs.read(written(tmp_path, text))
    assert run.told == (told,)
    np.testing.assert_array_equal(run['x'], values)
    assert runs.suspicion(run) == (told,)


def test_a_column_of_another_rate_keeps_its_own_instants(tmp_path: Path) -> None:
    run = runs.read(written(tmp_path, 'time,x,slow,gear\n0,1,5,D\n0.01,2,,D\n0.02,3,,D\n0.03,4,6,N\n'))
    assert (run.told, run.left_out) == ((), {'gear': "it holds text ('D' in line 2)"})
    assert {name: (one.time_ns / MS).tolist() for one in run.series.values() for name in one.columns} == {
        'x': [0, 10, 20, 30],
        'slow': [0, 30],
    }
    assert run.series['slow'].columns['slow'].tolist() == [5.0, 6.0]


@pytest.mark.parametrize(
    ('text', 'says'),
    [
        (
            'x,y\n1,2\n',
            "no column is named as one of time (x, y ...); call it 'time [s]', or say which one it is in a mapping "
            'file',
        ),
        ('lap time,y\n1,2\n', 'no column is named as one of time'),
        ('time [s],y\n', 'holds no data'),
        ('', 'holds no data'),
        ('time\n0\n0.1\n', 'holds no data'),
        ('0.0,1\n0.1,2\n', 'has no header line'),
        ('time,y\n0,1,3\n0.1,2,3\n', 'its header, line 1, has 2 names for 3 columns'),
        ('time,y\n0,a\n0.1,b\n', 'no column of numbers besides its time'),
        ('time,y,y\n0,1,2\n', "the column 'y' is given twice"),
        (
            'time,y\n0,1\n10,2\n20,3\n',
            "the column 'time' has no unit, and 10 from row to row may be seconds, milliseconds or else: say it",
        ),
        ('Time,y\n45292.5000001,1\n45292.5000002,2\n', 'may be seconds, milliseconds or else'),
        ('time [furlong],y\n0,1\n1,2\n', "is in 'furlong', which is no unit of time"),
        ('time [s],y\n0,1\n18446744073709551616,2\n', 'a time of 1.84467e+19 s is too large'),
        ('time [s],y\n1700000000000,1\n1700000000010,2\n', 'is too large to be one in s'),
        ('Time,y\n01/02/2024 12:00,1\n01/02/2024 12:01,2\n', "'01/02/2024 12:00' may be day/month or month/day"),
        ('time,y\nyesterday,1\ntoday,2\n', "'yesterday' is no time"),
        (
            'time,y\n0,1\n0,2\n0,3\n0,4\n0.1,5\n',
            "the times in 'time' stand still or go back in 3 of 5 rows (the first in line 3)",
        ),
        ('time;x;y\n0.0;1,5;2\n0.1;2,5;2\n', "numbers have points (line 2: '0.0') and commas (line 2: '1,5')"),
        ('time,x\n0,"1,234"\n1,"2,345"\n', "'1,234' may be a decimal comma or one between thousands"),
        (b'\x00\x01\x02,\n', 'it is not a CSV text'),
    ],
)
def test_what_may_mean_two_things_is_refused_with_its_place(text: str | bytes, says: str, tmp_path: Path) -> None:
    file = written(tmp_path, text)
    with pytest.raises(BagError, match=re.escape(says)) as caught:
        runs.read(file)
    assert str(file) in str(caught.value)


def test_a_mapping_names_the_column_of_time(tmp_path: Path) -> None:
    file = written(tmp_path, 'tick,wz [deg/s]\n0,180\n10,90\n20,0\n')
    (tmp_path / 'map.yaml').write_text('time: {column: tick, unit: ms}\nchannels:\n  imu/wz: {channel: wz}\n')
    run = runs.read(file, time=load_mapping(tmp_path / 'map.yaml').time)
    assert run.time_ns.tolist() == [0, 10 * MS, 20 * MS]
    with pytest.raises(BagError, match="takes the time from 'tock', which is no column; did you mean 'tick'"):
        runs.read(file, time=TimeColumn(column='tock'))
    ours = written(tmp_path, f'time [s],imu/wz [rad/s]\n0,{np.pi!r}\n0.01,{np.pi / 2!r}\n0.02,0\n', 'ours.csv')
    assert main(['compare', str(ours), str(file), '--mapping', str(tmp_path / 'map.yaml'), '--json']) == 0


def test_one_table_of_a_recording_is_compared_where_the_folder_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Columns of a table have no topic in front; its name has it."""
    topics = {
        'odom': 'time [s],twist/vx [m/s]\n',
        'tire.front_left.force': 'time [s],fz [N]\n',
        'imu': 'time [s],wz [deg/s]\n',
    }
    for topic, header in topics.items():
        written(tmp_path, header + ''.join(f'{0.01 * k:.2f},{k % 7}\n' for k in range(50)), f'{topic}.csv')

    def channels(*argv: str) -> dict:
        code = main(['compare', *argv, '--allow-missing', '--json'])
        data = json.loads(capsys.readouterr().out)
        assert code == 0, data
        return data['channels']

    folder = str(tmp_path)
    for topic, channel in (
        ('odom', 'odom/twist/vx'),
        ('tire.front_left.force', 'tire/front_left/force/fz'),
        ('imu', 'imu/wz'),
    ):
        table = str(tmp_path / f'{topic}.csv')
        assert list(channels(folder, table)) == list(channels(table, folder)) == [channel]
        assert list(channels(folder, table, '--channel', channel)) == [channel]
        assert list(channels(folder, table, '--map', f'{channel}={channel}')) == [channel]
    assert list(channels(table, table)) == ['wz']


def test_names_of_time() -> None:
    assert {name: is_time(name) for name in ('# time', 'Time', 't_ms', 'TimeUS', 'GPS_Timestamp', 'elapsed time '
        'sensors')} == {
        '# time': (2, ''), 'Time': (2, ''), 't_ms': (2, 'ms'), 'TimeUS': (2, 'us'), 'GPS_Timestamp': (1, ''),
        'elapsed time sensors': (1, ''),
    }  # fmt: skip
    assert [
        is_time(name)[0] for name in ('lap time', 'torque', 'x', 'time to collision', 'reaction_time', 'steering')
    ] == [0] * 6


def test_units_in_headers() -> None:
    assert [unit_of(cell) for cell in ('v [Km/h]', 'v(KPH)', 'acc '
        '{m/s²}', 'p (L)', 'p (1)', 'p ()', 'F [KN]', 'items[0]')] == [
        ('v', 'km/h'), ('v', 'km/h'), ('acc', 'm/s^2'), ('p '
            '(L)', ''), ('p (1)', ''), ('p', ''), ('F', 'KN'), ('items', '0'),
    ]  # fmt: skip


def test_rows_that_rise_are_as_many_as_can_be(rng: np.random.Generator) -> None:
    """By trying all subsets."""
    for _ in range(200):
        times = rng.integers(0, 6, rng.integers(1, 9))
        kept = rising(times)
        assert np.all(np.diff(times[kept]) > 0)
        masks = (np.flatnonzero([m >> k & 1 for k in range(times.size)]) for m in range(1 << times.size))
        assert kept.size == max(rows.size for rows in masks if np.all(np.diff(times[rows]) > 0))
