"""How far apart two recordings are where nobody says what is allowed."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scalars import write_scalars

from mbd_sim_ros.analysis import apart
from mbd_sim_ros.commands.main import main

MS = 1_000_000
T = np.arange(1001) * MS
WAVE = np.sin(2e-9 * np.pi * T)


def car(place: Path, *, yaw: float = 1.0, load: float = 1.0, other: float = 1.0, end: int = 1001) -> Path:
    """Signals of a car, with a factor on one of each kind; `other` is of a channel that has no word of its own."""
    loads = {f'{a}_{b}': {'fz': 3000.0 + 500.0 * WAVE} for a in ('front', 'rear') for b in ('left', 'right')}
    loads['rear_left'] = {'fz': load * (3000.0 + 500.0 * WAVE)}
    topics = {
        'imu': (T[:end], {'wz': yaw * 0.5 * WAVE[:end], 'ay': 8.0 * WAVE[:end]}),
        'engine': (T, {'noise': other * WAVE}),
    }
    return write_scalars(place, topics | {f'tire/{wheel}/force': (T, columns) for wheel, columns in loads.items()})


def compared(capsys: pytest.CaptureFixture[str], *argv: object) -> tuple[int, list[str]]:
    capsys.readouterr()
    code = main(['compare', *map(str, argv)])
    return code, capsys.readouterr().out.splitlines()


def test_two_different_runs_are_told_apart_by_quantity(tmp_path: Path, capsys) -> None:
    """Yaw rate 10 % too large, the load of one wheel 4 %, a channel of others 50 %: three quantities, each by the part
    of its peak."""
    reference = car(tmp_path / 'reference')
    run = car(tmp_path / 'run', yaw=1.1, load=1.04, other=1.5)
    code, lines = compared(capsys, run, reference)
    assert code == 1
    assert lines[0].split() == ['quantity', 'of', 'the', 'peak', 'most', 'unit', 'at', '[s]', 'RMS', 'channel']
    found = {line[: lines[0].index('of the peak')].strip(): line.split() for line in lines[1:5]}
    assert list(found) == ['yaw rate', 'lateral acceleration', 'wheel load', 'engine/noise']
    assert found['yaw rate'][2:4] == ['10', '%'] and found['lateral acceleration'][2:4] == ['0', '%']
    assert found['wheel load'][2:4] == ['4', '%'] and 'tire/rear_left/force/fz' in found['wheel load']
    assert found['engine/noise'][1:3] == ['50', '%']
    assert lines[-1] == 'the recordings differ: yaw rate 10 %, wheel load 4 % of their peaks at 1001 instants'
    assert '--rtol 0.05' in lines[-2] and '--exact' in lines[-2]
    assert not any('OUTSIDE' in line or 'tolerance at' in line for line in lines)


def test_who_says_what_is_allowed_is_answered_by_channels(tmp_path: Path, capsys) -> None:
    reference, run = car(tmp_path / 'reference'), car(tmp_path / 'run', yaw=1.1)
    code, lines = compared(capsys, run, reference, '--rtol', '0.05')
    assert code == 1 and lines[-1] == '1 of 7 channels outside tolerance at 1001 instants'
    assert compared(capsys, run, reference, '--rtol', '0.11')[0] == 0
    assert compared(capsys, run, reference, '--atol', '0.06')[0] == 0
    (tmp_path / 'limits.yaml').write_text('default: {rtol: 0.05}\n')
    assert compared(capsys, run, reference, '--tolerances', tmp_path / 'limits.yaml')[1][-1] == lines[-1]
    assert 'channels outside tolerance' in compared(capsys, run, reference, '--exact')[1][-1]


def test_equal_runs_agree_and_the_default_stays_tight(tmp_path: Path, capsys) -> None:
    """Exit code 0 is for what is equal to 1e-6 of the peak alone: nothing that failed passes because nobody gave a
    tolerance."""
    reference = car(tmp_path / 'reference')
    code, lines = compared(capsys, reference, reference)
    assert (code, lines) == (0, ['7 channels agree, to 1e-06 of their peaks at 1001 instants'])
    assert compared(capsys, car(tmp_path / 'near', yaw=1.0 + 5e-7), reference)[0] == 0
    code, lines = compared(capsys, car(tmp_path / 'off', yaw=1.0 + 5e-6), reference)
    assert code == 1 and lines[-1].startswith('the recordings differ: yaw rate 0.0005 % of their peaks')


def test_what_is_wrong_besides_is_told_too(tmp_path: Path, capsys) -> None:
    """A recording that ends early agrees in what both have, and that is not enough."""
    reference, run = car(tmp_path / 'reference'), car(tmp_path / 'run', end=701)
    code, lines = compared(capsys, run, reference)
    assert code == 1
    assert ' % of the time is in both' in next(line for line in lines if line.startswith('yaw rate'))
    assert lines[-1].startswith('the recordings differ: 2 quantities are not in both for the whole time at ')
    assert main(['compare', str(run), str(reference), '--json']) == 1
    data = json.loads(capsys.readouterr().out)
    assert (data['status'], data['judged'], sorted(data['outside'])) == ('different', False, ['imu/ay', 'imu/wz'])


def test_a_problem_is_no_agreement(tmp_path: Path, capsys) -> None:
    """A turned sign is a problem of its own, whatever the differences are; so are channels that one recording lacks."""
    reference = car(tmp_path / 'reference')
    less = write_scalars(tmp_path / 'less', {'imu': (T, {'wz': 0.5 * WAVE})})
    code, lines = compared(capsys, less, reference)
    assert (
        code == 1
        and lines[-1].startswith('1 channels agree')
        and lines[-1].endswith('; 6 channels are in one recording only')
    )
    assert compared(capsys, less, reference, '--allow-missing')[0] == 0


def test_a_recording_without_known_channels_has_its_own_names(tmp_path: Path, capsys) -> None:
    first = write_scalars(tmp_path / 'a', {'joint_states/crank': (T, {'position': WAVE})})
    second = write_scalars(tmp_path / 'b', {'joint_states/crank': (T, {'position': 1.02 * WAVE})})
    code, lines = compared(capsys, second, first)
    assert (
        code == 1
        and lines[-1] == 'the recordings differ: joint_states/crank/position 2 % of their peaks at 1001 instants'
    )
    assert apart.OTHERS >= 1


def moving(place: Path, **imu: np.ndarray) -> Path:
    """A car without steering: its yaw rate and lateral acceleration are what the arguments say."""
    loads = {f'tire/{a}_{b}/force': (T, {'fz': 3000.0 + WAVE}) for a in ('front', 'rear') for b in ('left', 'right')}
    return write_scalars(place, {'imu': (T, {'ax': 5.0 * WAVE, **imu}), **loads})


def test_percentages_of_next_to_nothing_are_of_the_least_that_counts(tmp_path: Path, capsys) -> None:
    """A car that drives straight ahead: rounding that differs by its own size is no 200 %, and 2e-3 m/s^2 of lateral
    acceleration are 2 % of 0.1 m/s^2 whatever their peak is. Above that the peak counts."""
    reference = moving(tmp_path / 'reference', wz=1e-14 * WAVE, ay=1e-3 * WAVE)
    run = moving(tmp_path / 'run', wz=-1e-14 * WAVE, ay=3e-3 * WAVE)
    _, lines = compared(capsys, run, reference)
    found = {line.split('  ')[0]: line for line in lines}
    lateral = found['lateral acceleration']
    assert ' 2 % ' in lateral and 'of 0.1 m/s^2; its peak is 0.001' in lateral
    assert lines[-1].startswith('the recordings differ: lateral acceleration 2 %')
    assert float(found['yaw rate'].split(' % ')[0].split()[-1]) < 1e-9
    larger = moving(tmp_path / 'larger', wz=1e-14 * WAVE, ay=2.2 * WAVE)
    _, lines = compared(capsys, larger, moving(tmp_path / 'large', wz=1e-14 * WAVE, ay=2.0 * WAVE))
    assert 'lateral acceleration 10 %' in lines[-1]


def test_what_is_small_beside_its_like_is_held_to_that(tmp_path: Path, capsys) -> None:
    """Forces of one topic: 1e-9 N beside 100 N are not 50 % off; angles of joints are each for themselves."""

    def elements(place: Path, small: float, angle: float) -> Path:
        states = {'large/force': 100.0 * WAVE, 'small/force': small * 1e-9 * WAVE}
        joints = {'wheel': 400.0 * WAVE, 'rocker': angle * 1e-2 * WAVE}
        return write_scalars(place, {'element_states': (T, states), 'joint_states': (T, joints)})

    _, lines = compared(capsys, elements(tmp_path / 'a', 1.5, 1.1), elements(tmp_path / 'b', 1.0, 1.0))
    assert lines[-1].startswith('the recordings differ: joint_states/rocker/position 10 %')
    assert not any(line.startswith('element_states/small/force') and '50 %' in line for line in lines)


@pytest.mark.parametrize('scale', [1.0, 1e-4, 1e4])
def test_a_motion_that_is_rounding_beside_its_accelerations_has_no_percentage(
    tmp_path: Path, capsys, scale: float
) -> None:
    """A mechanism of any size: a pivot that moves by rounding, a rod that swings."""

    def swinging(place: Path, pivot: float, swing: float) -> Path:
        pose = {'x': pivot * 1e-11 * scale * WAVE, 'y': swing * scale * WAVE}
        return write_scalars(place, {'imu': (T, {'ax': 39.0 * scale * WAVE}), 'odom/pose': (T, pose)})

    _, lines = compared(capsys, swinging(tmp_path / 'a', 3.0, 1.02), swinging(tmp_path / 'b', 1.0, 1.0))
    x = next(line for line in lines if line.startswith('position x'))
    assert x.split()[2] == '-' and x.endswith('rounding')
    assert 'position y 2 %' in lines[-1] and 'position x' not in lines[-1]


def test_the_table_of_a_comparison_comes_without_the_compiler(tmp_path: Path) -> None:
    """The compiler is a third of a second of the processor, and two recordings are compared without it."""
    runs = str(car(tmp_path / 'run', yaw=1.1)), str(car(tmp_path / 'reference'))
    code = (
        'import sys\nfrom mbd_sim_ros.commands.main import main\n'
        f'code = main(["compare", *{runs!r}])\nprint(code, "numba" in sys.modules)'
    )
    done = subprocess.run([sys.executable, '-c', code], check=True, capture_output=True, text=True)
    assert 'the recordings differ: yaw rate' in done.stdout
    assert done.stdout.splitlines()[-1] == '1 False'
