"""mbd compare as vehicle engineers use it: recordings of others, repeats, tolerances, reports; one object, one
sentence, the right code."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scalars import write_scalars

from mbd_sim_ros.bags import reader as bag
from mbd_sim_ros.commands.main import main

MS = 1_000_000
EPOCH = 1_700_000_000 * 10**9
PLANTED = 0.137
MAPPING = """
channels:
  imu/wz: {channel: vehicle/motion/yaw_rate, unit: deg/s}
  imu/ay: {channel: vehicle/motion/lateral, unit: g, sign: -1}
  odom/twist/vx: {channel: vehicle/speed/kmh, unit: km/h}
  cmd_applied/steering: {channel: vehicle/steering/angle, unit: deg, hold: true}
  'tire/*/force/fz': {channel: 'wheels/load/*', unit: kN, offset: 50.0}
"""
LIMITS = """
tolerances:
  cmd_applied/*: {rtol: 0.05}
  imu/*: {rtol: 0.05, rms: 0.01, rating: 0.9, shift: 0.03}
  odom/*: {rtol: 0.01, rms: 0.005}
  tire/*: {rtol: 0.05, rms: 0.005}
"""


def document(capsys: pytest.CaptureFixture[str], *argv: object) -> tuple[int, dict]:
    capsys.readouterr()
    code = main(['compare', *map(str, argv), '--json'])
    captured = capsys.readouterr()
    assert captured.err == ''
    assert captured.out.count('\n') == 1
    return code, json.loads(captured.out)


@pytest.fixture(scope='module')
def driven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The light car in a step of steering, 8 s at 500 Hz."""
    directory = tmp_path_factory.mktemp('bags') / 'run'
    arguments = ['--set', 'integrator.h=0.002', '--duration', '8', '--out', str(directory), '--json']
    assert main(['run', 'light_car_step_steer', *arguments]) == 0
    return directory


def car(
    directory: Path, driven: Path, seed: int, *, load_factor: float = 1.0, offset: float = PLANTED, noise: float = 1.0
) -> Path:
    """What a measuring system would have recorded of that run: 100 Hz and 50 Hz, the time of day, other names, units
    and signs, noise.

    Its clock is ahead such that `offset` must be added to its stamps, counted from the first. load_factor: error of one
    load cell.
    """
    run = bag.read(driven)
    rng = np.random.default_rng(seed)

    def at(name: str, times: np.ndarray) -> np.ndarray:
        return np.interp(times + offset, run.time, run[name])

    def noisy(values: np.ndarray, part: float) -> np.ndarray:
        return values + noise * part * np.max(np.abs(values)) * rng.standard_normal(values.size)

    t, slow = np.arange(760) * 0.01, np.arange(380) * 0.02
    loads = {
        corner: (at(f'tire/{corner}/force/fz', t) - 50.0) / 1e3
        for corner in ('front_left', 'front_right', 'rear_left', 'rear_right')
    }
    loads['rear_left'] = (load_factor * at('tire/rear_left/force/fz', t) - 50.0) / 1e3
    held = np.searchsorted(run.time, slow + offset, 'right') - 1
    topics = {
        'vehicle/motion': (
            t,
            {
                'yaw_rate': noisy(np.rad2deg(at('imu/wz', t)), 0.004),
                'lateral': noisy(-at('imu/ay', t) / 9.80665, 0.004),
            },
        ),
        'vehicle/speed': (slow, {'kmh': noisy(3.6 * at('odom/twist/vx', slow), 0.0005)}),
        'vehicle/steering': (slow, {'angle': np.rad2deg(run['cmd_applied/steering'][held])}),
        'wheels/load': (t, {corner: noisy(values, 0.001) for corner, values in loads.items()}),
    }
    stamped = {
        topic: (EPOCH + np.round(times * 1e9).astype(np.int64), columns) for topic, (times, columns) in topics.items()
    }
    return write_scalars(directory, stamped, log_ns=3 * MS)


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, ...]:
    (tmp_path / 'car.yaml').write_text(MAPPING)
    (tmp_path / 'limits.yaml').write_text(LIMITS)
    return '--mapping', str(tmp_path / 'car.yaml'), '--tolerances', str(tmp_path / 'limits.yaml'), '--align', 'imu/wz'


@pytest.mark.slow
def test_a_recording_of_a_car_is_aligned_converted_and_rated(
    driven: Path, files: tuple[str, ...], tmp_path: Path, capsys
) -> None:
    good = car(tmp_path / 'good', driven, 1)
    code, data = document(capsys, driven, good, *files, '--overlap', '0.9', '--html', tmp_path / 'r.html')
    assert data['outside'] == [], {name: data['channels'][name] for name in data['outside']}
    assert code == 0
    assert data['offsets'][0]['seconds'] == pytest.approx(PLANTED, abs=1e-3)
    assert data['offsets'][0]['correlation'] > 0.99
    wheels = {f'tire/{a}_{b}/force/fz' for a in ('front', 'rear') for b in ('left', 'right')}
    assert data['channels'].keys() == {'imu/wz', 'imu/ay', 'odom/twist/vx', 'cmd_applied/steering'} | wheels
    for name, channel in data['channels'].items():
        assert 0.9 < channel['rating'] <= 1.0, name
        assert set(channel['scores']) == {'corridor', 'phase', 'magnitude', 'slope'}
        assert channel['unit'], name
    assert (tmp_path / 'r.html').stat().st_size > 50_000


@pytest.mark.slow
def test_an_error_of_two_percent_in_one_channel_is_named(
    driven: Path, files: tuple[str, ...], tmp_path: Path, capsys
) -> None:
    bad = car(tmp_path / 'bad', driven, 2, load_factor=1.02)
    code, data = document(capsys, driven, bad, *files, '--overlap', '0.9')
    assert code == 1
    assert data['outside'] == ['tire/rear_left/force/fz']
    channel = data['channels']['tire/rear_left/force/fz']
    assert channel['peak_difference'] / channel['scale'] == pytest.approx(-0.02 / 1.02, abs=0.005)  # noise of 0.1 %
    assert next(iter(data['channels'])) == 'tire/rear_left/force/fz'  # and comes first
    assert main(['compare', str(driven), str(bad), *files, '--overlap', '0.9']) == 1
    text = capsys.readouterr().out
    assert '0.13' in text.splitlines()[1]
    assert 'OUTSIDE' in text


@pytest.mark.slow
def test_repeats_of_a_test_with_their_own_clocks(driven: Path, files: tuple[str, ...], tmp_path: Path, capsys) -> None:
    laps = [car(tmp_path / f'lap_{k}', driven, 10 + k, offset=shift) for k, shift in enumerate((0.137, 0.02, 0.301))]
    code, data = document(capsys, driven, *laps, *files, '--overlap', '0.9')
    assert [o['seconds'] for o in data['offsets']] == pytest.approx([0.137, 0.02, 0.301], abs=1e-3)
    assert code == 0, data['outside']
    assert data['channels']['imu/wz']['band']['repeats'] == 3
    assert data['channels']['imu/wz']['band']['inside'] > 0.8  # three laps with noise: 95 % but for errors of alignment


def scalars(directory: Path, n: int = 801, *, factor: float = 1.0, extra: bool = False) -> Path:
    t = np.arange(n) * 10 * MS
    columns = {'wz': factor * np.sin(t * 1e-9), 'ay': np.cos(t * 1e-9)}
    return write_scalars(directory, {'imu': (t, columns | ({'az': columns['ay']} if extra else {}))})


def test_a_run_that_is_cut_short_or_lacks_channels_is_not_the_same(tmp_path: Path, capsys) -> None:
    whole, cut, more = (
        scalars(tmp_path / 'whole'),
        scalars(tmp_path / 'cut', 501),
        scalars(tmp_path / 'more', extra=True),
    )
    code, data = document(capsys, cut, whole)
    assert (code, data['outside']) == (1, ['imu/wz', 'imu/ay'])
    assert data['channels']['imu/wz']['overlap'] == pytest.approx(0.625, abs=0.003)
    assert document(capsys, cut, whole, '--allow-missing')[0] == 0
    assert document(capsys, cut, whole, '--overlap', '0.6')[0] == 0
    for pair, side in (((whole, more), 'only_in_reference'), ((more, whole), 'only_in_run')):
        code, data = document(capsys, *pair)
        assert (code, data['status'], data['outside'], data[side]) == (1, 'different', [], ['imu/az'])
        assert document(capsys, *pair, '--allow-missing')[0] == 0
    assert document(capsys, whole, more, '--channel', 'imu/w*')[0] == 0


def test_a_reference_of_the_other_sign_is_aligned_and_told(tmp_path: Path, capsys) -> None:
    t = np.arange(801) * 10 * MS
    step = 1.0 / (1.0 + np.exp(-(t * 1e-9 - 3.0) / 0.2))
    ours, late = write_scalars(tmp_path / 'ours', {'imu': (t, {'wz': step})}), {'imu': (t + 250 * MS, {'wz': -step})}
    theirs = write_scalars(tmp_path / 'theirs', late)
    code, data = document(capsys, ours, theirs, '--align', 'imu/wz', '--rtol', '0.01')
    offset = data['offsets'][0]
    assert (code, offset['turned'], offset['opposed']) == (1, True, None)
    assert offset['seconds'] == pytest.approx(-0.25, abs=1e-3)
    assert data['problems'][0].startswith('imu/wz of the reference fits with its sign turned (correlation -1.0000)')
    (tmp_path / 'map.yaml').write_text('channels:\n  imu/wz: {channel: imu/wz, sign: -1}\n')
    code, data = document(
        capsys, ours, theirs, '--align', 'imu/wz', '--rtol', '0.01', '--mapping', tmp_path / 'map.yaml'
    )
    assert (code, data['offsets'][0]['turned'], data['problems']) == (0, False, [])


def test_patterns_map_whole_topics(tmp_path: Path, capsys) -> None:
    t = np.arange(101) * 10 * MS
    values = {'wz': np.sin(t * 1e-9), 'ax': np.cos(t * 1e-9)}
    ours = write_scalars(tmp_path / 'ours', {'imu': (t, values)})
    theirs = write_scalars(tmp_path / 'theirs', {'vehicle/imu': (t, values)})
    code, data = document(capsys, ours, theirs, '--map', 'vehicle/imu/*=imu/*')
    assert (code, set(data['channels'])) == (0, {'imu/wz', 'imu/ax'})


def test_only_the_channels_of_a_mapping_file_are_compared_and_missed(tmp_path: Path, capsys) -> None:
    ours, theirs = scalars(tmp_path / 'ours', extra=True), scalars(tmp_path / 'theirs', extra=True)
    file = tmp_path / 'map.yaml'
    file.write_text('channels:\n  imu/wz: {channel: imu/wz}\n')
    assert set(document(capsys, ours, theirs, '--mapping', file)[1]['channels']) == {'imu/wz'}
    file.write_text('channels:\n  imu/wz: {channel: imu/wz}\n  imu/q: {channel: imu/az}\n')
    code, data = document(capsys, ours, theirs, '--mapping', file)
    assert (code, data['only_in_reference'], data['only_in_run']) == (1, ['imu/q'], [])


def test_exact_minds_channels_of_one_recording_unless_told(tmp_path: Path, capsys) -> None:
    t = np.arange(20) * MS
    both, one = {'s': (t, {'v': t * 1e-9})}, {'z': (t, {'v': t * 1e-9})}
    more, less = write_scalars(tmp_path / 'more', both | one), write_scalars(tmp_path / 'less', both)
    assert document(capsys, more, less, '--exact')[0] == 1
    code, data = document(capsys, more, less, '--exact', '--allow-missing')
    assert (code, data['status'], data['only_in_run']) == (0, 'same', ['z/v'])


def test_exact_names_channel_and_time(tmp_path: Path, capsys) -> None:
    t = np.arange(2001) * MS
    values = {f'c{k}': np.sin(k + t * 1e-9) for k in range(5)}
    first = write_scalars(tmp_path / 'first', {'s': (t, values)})
    values['c3'] = values['c3'] + 1e-9 * (np.arange(2001) == 1234)
    again = write_scalars(tmp_path / 'again', {'s': (t, values)})
    assert document(capsys, first, first, '--exact')[0] == 0
    code, data = document(capsys, again, first, '--exact')
    assert (code, data['outside']) == (1, ['s/c3'])
    assert data['channels']['s/c3']['first'] == pytest.approx(1.234)
    assert data['channels']['s/c3']['max'] == pytest.approx(1e-9, rel=1e-6)
    assert main(['compare', str(again), str(first), '--exact']) == 1
    assert '1 of 2001 values differ, the first at 1.234 s' in capsys.readouterr().out


@pytest.mark.parametrize(
    ('arguments', 'says'),
    [
        (('--mapping', 'none.yaml'), 'none.yaml'),
        (('--tolerances', 'none.yaml'), 'none.yaml'),
        (('--align', 'imu/wx'), "--align imu/wx: no such channel in both recordings; did you mean 'imu/w"),
        (('--offset', '1000'), 'do not overlap'),
        (('--offset', 'nan'), '--offset nan: must be a number of seconds below 4.61e+09'),
        (('--offset', '1e300'), '--offset 1e+300: must be a number of seconds'),
        (('--rtol', 'inf'), '--rtol inf: must be a number that is not negative'),
        (('--plot', '/dev/full'), 'cannot write the picture /dev/full: No space left'),
        (('--overlap', '2'), '--overlap 2: must be a fraction'),
        (('--exact', '--offset', '1'), 'without --offset and --align'),
        (('--map', 'imu/x=imu/y'), "the other recording has no column 'imu/x'"),
        (('--channel', 'nothing'), "no common channel matches 'nothing'"),
    ],
)
def test_what_cannot_be_compared_is_one_sentence(arguments: tuple[str, ...], says: str, tmp_path: Path, capsys) -> None:
    ours = scalars(tmp_path / 'ours')
    assert main(['compare', str(ours), str(ours), *arguments]) not in (0, 1)
    captured = capsys.readouterr()
    assert captured.out == ''
    assert captured.err.count('\n') == 1
    assert says in captured.err
    code, data = document(capsys, ours, ours, *arguments)
    assert code > 1
    assert data.keys() == {'status', 'error'}


def test_tolerances_that_judge_no_channel_are_told(tmp_path: Path, capsys) -> None:
    ours, file = scalars(tmp_path / 'ours'), tmp_path / 'limits.yaml'
    file.write_text('tolerances:\n  imu/w*: {rtol: 0.1}\n  imu/wz: {rtol: 0.2}\n  imo/ay: {rtol: 0.1}\n')
    code, data = document(capsys, ours, ours, '--tolerances', file)
    # one behind another pattern, one with an error
    assert (code, data['unused_tolerances']) == (0, ['imu/wz', 'imo/ay'])
    assert main(['compare', str(ours), str(ours), '--tolerances', str(file)]) == 0
    assert 'tolerances of imo/ay: no channel is judged by them' in capsys.readouterr().out


def test_export_of_chosen_channels_and_to_parquet(tmp_path: Path, capsys) -> None:
    pytest.importorskip('pyarrow', reason='pip install .[analysis]')
    ours = scalars(tmp_path / 'ours')
    assert (
        main(
            [
                'export',
                str(ours),
                '--parquet',
                str(tmp_path / 'p'),
                '--csv',
                str(tmp_path / 'c'),
                '--channel',
                'imu/w*',
                '--json',
            ]
        )
        == 0
    )
    data = json.loads(capsys.readouterr().out)
    assert (data['rows'], data['columns']) == (801, 1)
    assert sorted(Path(f).name for f in data['files']) == ['imu.csv', 'imu.parquet']
    assert main(['export', str(ours)]) == 5
    assert 'give --csv DIR or --parquet DIR' in capsys.readouterr().err
    assert main(['export', str(ours), '--csv', str(tmp_path / 'c'), '--channel', 'x']) == 5
    assert "no channel matches 'x'" in capsys.readouterr().err


def test_what_is_not_asked_for_is_not_loaded(tmp_path: Path) -> None:
    """numba and scipy take longer to load than small recordings to compare; only the rating and elements ask for
    them."""
    t = np.arange(20) * MS
    for name in ('a', 'b'):
        write_scalars(tmp_path / name, {'odom': (t, {'x': t * 1e-9})})
    code = (
        'import sys; from mbd_sim_ros.commands.main import main; code = main(sys.argv[1:]); print(code, '
        '*sorted(sys.modules))'
    )
    for judged in ('--exact', '--no-rating'):
        command = [sys.executable, '-c', code, 'compare', str(tmp_path / 'a'), str(tmp_path / 'b'), judged]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1].split()
        assert said[0] == '0' and 'numpy' in said
        assert not {'numba', 'scipy', 'pandas', 'matplotlib'} & set(said)


def test_tables_in_different_units_are_compared_in_si(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t = np.arange(200) * 0.01
    for name, unit, factor in (('run', 'rad/s', 1.0), ('reference', 'deg/s', 180.0 / np.pi)):
        table = np.column_stack([t, factor * np.sin(t)])
        np.savetxt(
            tmp_path / f'{name}.csv', table, delimiter=',', header=f'time [s],imu/wz [{unit}]', comments='', fmt='%.15g'
        )
    run, reference = (tmp_path / f'{name}.csv' for name in ('run', 'reference'))
    for pair in ((run, reference), (reference, run)):
        code, data = document(capsys, *pair)
        assert (code, data['channels']['imu/wz']['peak_run']) == (0, pytest.approx(1.0, abs=1e-4))
    code, data = document(capsys, run, reference, '--map', 'imu/wz=imu/wz')
    assert code == 0


def test_tables_of_others_are_compared_in_si_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A heading that passes 180 deg, wrapped and at 50 Hz, beside one in rad that counts on, at 70 Hz: the same but for
    the chords."""
    for name, unit, factor, rate in (('run', 'deg', 180.0 / np.pi, 50.0), ('reference', 'rad', 1.0, 70.0)):
        t = np.arange(round(2.0 * rate) + 1) / rate
        yaw = 3.0 + 0.2 * t
        wrapped = np.where((yaw > np.pi) & (unit == 'deg'), yaw - 2.0 * np.pi, yaw)
        table = np.column_stack([t, factor * wrapped])
        np.savetxt(
            tmp_path / f'{name}.csv',
            table,
            delimiter=',',
            header=f'time [s],ins/yaw [{unit}]',
            comments='',
            fmt='%.15g',
        )
    for pair in (('run', 'reference'), ('reference', 'run')):
        code, data = document(capsys, *(tmp_path / f'{name}.csv' for name in pair))
        assert (code, data['channels']['ins/yaw']['unit'], data['notes']) == (0, 'rad', [])
    (tmp_path / 'other.csv').write_text('time [s],ins/yaw [m]\n0,3\n2,3.4\n')
    assert main(['compare', str(tmp_path / 'run.csv'), str(tmp_path / 'other.csv')]) != 0
    assert "ins/yaw: it is in rad, which 'm' does not measure" in capsys.readouterr().err


def test_a_mapping_names_fields_with_brackets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t = np.arange(200) * 0.01
    ours = write_scalars(tmp_path / 'ours', {'odom': (np.round(t * 1e9).astype(np.int64), {'vx': t})})
    columns = {f'can.wheels[{k}].speed': (1.0 + k) * t for k in range(2)}
    table = np.column_stack([t, *columns.values()])
    np.savetxt(
        tmp_path / 'theirs.csv', table, delimiter=',', header=','.join(['time [s]', *columns]), comments='', fmt='%.15g'
    )
    file = tmp_path / 'map.yaml'
    file.write_text("channels:\n  odom/vx: {channel: 'can.wheels[0].speed'}\n")
    code, data = document(capsys, ours, tmp_path / 'theirs.csv', '--mapping', file)
    assert (code, list(data['channels'])) == (0, ['odom/vx'])
    file.write_text("channels:\n  odom/vx: {channel: 'can.wheels[1].speed'}\n")
    assert document(capsys, ours, tmp_path / 'theirs.csv', '--mapping', file)[0] == 1
