"""Tables survive the way out and back bit for bit."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from mbd_sim_ros.analysis import load, runs
from mbd_sim_ros.analysis.comparison import compare
from mbd_sim_ros.bags.reader import Run, Series, read
from mbd_sim_ros.batch import simulate
from solver import load_scene, simulation_of
from solver.errors import BagError


def wild(rng: np.random.Generator, start_ns: int = 0) -> Run:
    """Numbers of all sizes, three topics, one of them at other instants and with gaps."""
    n = 50
    time_ns = start_ns + np.cumsum(rng.integers(1, 10**7, n))
    joints = {
        f'joint_states/{j}/{p}': rng.standard_normal(n) * 10.0 ** rng.integers(-300, 300, n)
        for j in ('a', 'b/angle')
        for p in ('position', 'velocity')
    }
    series = {
        'joint_states': Series(time_ns, joints),
        'tire/front_left/force': Series(time_ns, {'tire/front_left/force/fx': rng.standard_normal(n)}),
        'cmd_applied': Series(time_ns[::3] + 1, {'cmd_applied/steering': np.where(rng.random(17) < 0.5, np.nan, 1.0)}),
    }
    return Run(series, {'joint_kinds': '{"a": "rotation", "b/angle": "translation"}'})


@pytest.mark.parametrize('start_ns', [0, 1_700_000_000_123_456_789])
def test_export_and_back_is_the_same_bits(start_ns: int, rng: np.random.Generator, tmp_path: Path) -> None:
    before = wild(rng, start_ns)
    files = runs.export(before, tmp_path)
    assert sorted(f.name for f in files) == ['cmd_applied.csv', 'joint_states.csv', 'tire.front_left.force.csv']
    after = runs.read(tmp_path)
    assert compare(after, before, exact=True).ok
    assert set(after.columns) == set(before.columns)
    assert set(runs.read(tmp_path, ['tire/*']).columns) == {'tire/front_left/force/fx'}


def test_header_names_quantity_and_unit(rng: np.random.Generator, tmp_path: Path) -> None:
    runs.export(wild(rng), tmp_path)
    header = (tmp_path / 'joint_states.csv').read_text().splitlines()[0]
    assert header == 'time [s],a/position [rad],a/velocity [rad/s],b/angle/position [m],b/angle/velocity [m/s]'
    assert (tmp_path / 'tire.front_left.force.csv').read_text().splitlines()[0] == 'time [s],fx [N]'


def test_brackets_inside_of_names_are_part_of_them(tmp_path: Path) -> None:
    columns = {f'o/items[{k}]/v': np.array([1.0, 2.0]) + k for k in range(2)}
    before = Run({'o': Series(np.array([0, 10**9]), columns)})
    runs.export(before, tmp_path)
    assert compare(runs.read(tmp_path), before, exact=True).ok


def test_comments_and_blank_lines_in_a_table_are_skipped(tmp_path: Path) -> None:
    file = tmp_path / 'x.csv'
    file.write_text('# source: measured\ntime [s],angle [rad]\n0,1\n\n0.5,2\n')
    read = runs.read(file)
    assert read.time_ns.tolist() == [0, 500_000_000]
    assert read['angle'].tolist() == [1.0, 2.0]


def test_a_table_that_says_its_units_is_brought_to_si(tmp_path: Path) -> None:
    """180 deg/s are pi rad/s, under names of ours and of others; a unit that is not known is left to what has no name
    of ours."""
    header = 'time [s],imu/wz [deg/s],odom/twist/vx [km/h],imu/ay [m/s2],tank [kN],oil [degC],yaw [°]'
    (tmp_path / 'imu.csv').write_text(f'{header}\n0,180,36,1,5,80,180\n0.1,90,72,2,5,81,90\n')
    found = load(tmp_path / 'imu.csv')['']
    assert found['imu/wz'].to_numpy() == pytest.approx([np.pi, np.pi / 2])
    assert found['odom/twist/vx'].to_numpy() == pytest.approx([10.0, 20.0])
    assert (found['imu/ay'].tolist(), found['tank'].tolist(), found['oil'].tolist()) == (
        [1.0, 2.0],
        [5000.0, 5000.0],
        [80.0, 81.0],
    )
    assert found['yaw'].to_numpy() == pytest.approx([np.pi, np.pi / 2])
    units = found.attrs['units']
    assert [units[name] for name in ('imu/wz', 'imu/ay', 'tank', 'oil', 'yaw')] == [
        'rad/s',
        'm/s^2',
        'N',
        'degC',
        'rad',
    ]


@pytest.mark.parametrize(
    ('unit', 'says'),
    [
        ('km/h', "imu/wz: it is in rad/s, which 'km/h' does not measure"),
        ('m/s', "imu/wz: it is in rad/s, which 'm/s' does not measure"),
        (
            'deg/sek',
            "imu/wz: it is in rad/s, and 'deg/sek' is no unit that is known here; did you mean 'deg/s'?; correct the "
            'header',
        ),
    ],
)
def test_a_table_in_a_unit_that_cannot_be_is_refused(unit: str, says: str, tmp_path: Path) -> None:
    (tmp_path / 'imu.csv').write_text(f'time [s],imu/wz [{unit}]\n0,180\n0.1,90\n')
    with pytest.raises(BagError, match=re.escape(says)):
        load(tmp_path / 'imu.csv')


def test_every_element_joint_and_reaction_of_the_full_car_has_its_units(tmp_path: Path) -> None:
    """The bars and the gears of the axles act on angles; a rack is a length, which its ratio brings to the angle of the
    pinion; the driver of the steering wheel holds an angle by a torque, a row of axes gives a torque, one of points a
    force.
    """
    simulation = simulation_of(load_scene('car_step_steer', ('record.elements=true', 'record.reactions=true')))
    simulate(simulation, 2, directory=tmp_path / 'car')
    run = read(tmp_path / 'car')
    unit = runs.units(run)
    assert [name for name in run.names if not unit(name)] == []
    assert {f'{e}/{o}': unit(f'element_states/{e}/{o}') for e,
    o in (('rack_and_pinion', 'value'), ('differential', 'force'))} == {
        'rack_and_pinion/value': 'rad', 'differential/force': 'N m',
    }  # fmt: skip
    rows = ('wheel_front_left/x', 'wheel_front_left/xz', 'driver')
    assert [unit(f'reactions/{row}') for row in rows] == ['N', 'N m', 'N m']


def test_units_of_elements_are_those_of_their_kind() -> None:
    """A rate is m/s of a spring and rad/s of a brake; which of the two an element is, its outputs tell."""
    spring = ('energy', 'dissipation', 'length', 'rate', 'force')
    brake = ('energy', 'dissipation', 'windup', 'rate', 'torque', 'capacity')
    along = ('energy', 'dissipation', 'value', 'rate', 'force')
    known = [
        f'element_states/{name}/{o}' for name, outputs in (('s', spring), ('b', brake), ('c', along)) for o in outputs
    ]
    run = Run({}, {'joint_kinds': '{"a": "rotation", "b": "translation"}'}, known={'element_states': tuple(known)})
    unit = runs.units(run)
    found = {
        c: unit(f'element_states/{c}')
        for c in ('s/rate', 's/force', 'b/rate', 'b/windup', 'b/torque', 'c/energy', 'c/rate', 'c/value')
    }
    assert found == {
        's/rate': 'm/s', 's/force': 'N', 'b/rate': 'rad/s', 'b/windup': 'rad', 'b/torque': 'N m', 'c/energy': 'J',
        'c/rate': '', 'c/value': '',
    }  # fmt: skip
    assert [unit(f'joint_states/{c}') for c in ('a/position', 'a/effort', 'b/velocity', 'x/position')] == [
        'rad',
        'N m',
        'm/s',
        '',
    ]
    assert [unit(c) for c in ('imu/ay', 'odom/pose/qw', 'tire/f/force/mz', 'tire_states/f/kappa',
    'cmd_applied/steering', 'what')] == [
        'm/s^2', '1', 'N m', '1', 'rad', '',
    ]  # fmt: skip
    turned = Run({}, run.metadata | {'element_kinds': '{"c": "rotation"}'}, known=run.known)
    assert [runs.units(turned)(f'element_states/c/{o}') for o in along] == ['J', 'W', 'rad', 'rad/s', 'N m']
    bare = runs.units(Run({}))
    # nothing tells which kind it is
    assert (bare('element_states/x/rate'), bare('element_states/x/energy')) == ('', 'J')


def test_a_name_that_ends_in_brackets_is_no_unit(tmp_path: Path) -> None:
    columns = {f'car/slip[{k}]': np.full(3, float(k)) for k in (0, 1)}
    runs.export(Run({'car': Series(np.arange(3), columns)}), tmp_path)
    again = runs.read(tmp_path)
    assert {name: values[0] for name, values in again.columns.items()} == {'car/slip[0]': 0.0, 'car/slip[1]': 1.0}


def test_a_table_is_written_whole_or_not_at_all(
    rng: np.random.Generator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was interrupted left the first rows under the name of the table, in place of what was there."""
    before = runs.export(wild(rng), tmp_path)
    texts = [file.read_text() for file in before]
    instants = iter(range(70))  # ends in the second table

    def interrupted(_: int) -> str:
        if next(instants, None) is None:
            raise KeyboardInterrupt
        return '0.0'

    monkeypatch.setattr(runs, 'seconds_of', interrupted)
    with pytest.raises(KeyboardInterrupt):
        runs.export(wild(rng), tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(before)
    assert [file.read_text() == text for file, text in zip(before, texts, strict=True)] == [False, True, True]
