"""Signals of an evaluation from topics of different rates."""

from __future__ import annotations

import numpy as np
import pytest
from drives import EPOCH, even
from scipy.spatial.transform import Rotation

from mbd_sim_ros.analysis.evaluation.signals import signals
from mbd_sim_ros.bags.reader import Run, Series
from solver.errors import BagError

G = 9.80665


def pose(t: np.ndarray, heading: np.ndarray, roll: float, speed: float) -> dict[str, np.ndarray]:
    q = Rotation.from_euler('ZYX', np.column_stack([heading, np.zeros_like(t), np.full_like(t, roll)])).as_quat()
    body = {f'odom/pose/{n}': v for n, v in zip(('x', 'y', 'z'), (speed * t, 0.0 * t, 0.0 * t))}
    body |= {f'odom/pose/q{n}': v for n, v in zip('xyzw', q.T)}
    return body


def test_signals_come_from_topics_of_different_rates_on_uneven_stamps(rng: np.random.Generator) -> None:
    """A body that rolls by 0.05 rad and turns; the specific force holds what gravity adds, the lateral acceleration
    does not."""
    t1 = np.sort(np.concatenate([[0.0, 10.0], rng.uniform(0.0, 10.0, 4000)]))
    t2 = even(10.0, 100.0) + 0.001 * np.sin(np.arange(1001))
    t2[[0, -1]] = 0.0, 10.0
    roll, r, v, a = 0.05, 0.8, 20.0, 3.0
    body = pose(t1, r * t1, roll, v)
    signs = np.where(t1 > 5.0, -1.0, 1.0)  # a quaternion and its negative are one orientation
    for n in 'xyzw':
        body[f'odom/pose/q{n}'] = body[f'odom/pose/q{n}'] * signs
    w = np.array([0.0, np.sin(roll) * r, np.cos(roll) * r])  # in the body
    force = np.array([0.0, a * np.cos(roll) + G * np.sin(roll), -a * np.sin(roll) + G * np.cos(roll)])
    body |= {
        f'odom/twist/{n}': np.full_like(t1, x) for n, x in zip(('vx', 'vy', 'vz', 'wx', 'wy', 'wz'), (v, 0.0, 0.0, *w))
    }
    stamps = [EPOCH + np.round(t * 1e9).astype(np.int64) for t in (t1, t2)]
    run = Run(
        {
            'odom': Series(stamps[0], body),
            'imu': Series(stamps[1], {f'imu/{n}': np.full_like(t2, x) for n, x in zip(('ax', 'ay', 'az'), force)}),
            'cmd_applied': Series(
                stamps[1],
                {'cmd_applied/steering': 0.1 * t2, 'cmd_applied/brake_torque': np.where(t2 < 5.0, 0.0, 100.0)},
            ),
        }
    )
    s = signals(run, 'bag', ('speed', 'yaw_rate', 'lateral_acceleration', 'roll', 'steering', 'brake', 'heading'))
    assert s.t[0] == 0.0
    assert s['speed'] == pytest.approx(v)
    assert s['yaw_rate'] == pytest.approx(r, abs=1e-6)
    assert s['lateral_acceleration'] == pytest.approx(a, abs=1e-3)  # gravity of the scene is 9.81
    assert s['roll'] == pytest.approx(roll, abs=1e-6)
    assert s['heading'] == pytest.approx(r * s.t, abs=1e-5)
    assert s['steering'] == pytest.approx(0.1 * s.t, abs=1e-9)
    assert set(np.unique(s['brake'])) == {0.0, 100.0}  # held, nothing between
    assert np.ptp(np.diff(s.t)) < 1e-9
    assert s.every('heading') == pytest.approx(s.t[1]) and s.every('heading', 'steering') == pytest.approx(
        0.01, abs=1e-4
    )
    with pytest.raises(
        BagError, match='has no hand torque: the channel steering_torque or cmd_applied/steering_torque is needed'
    ):
        signals(run, 'bag', ('steering_torque',))
    del run.series['odom']
    again = signals(run, 'bag', ('lateral_acceleration',))
    assert again['lateral_acceleration'] == pytest.approx(force[1])
    assert 'no orientation' in again.notes[0]


def test_a_heading_that_jumps_by_a_turn_does_not_where_nothing_is_interpolated_either() -> None:
    """From 3.0 to 3.4 rad, of which a sensor gives 3.4 - 2 pi."""
    t = even(10.0, 100.0)
    heading = 3.0 + 0.04 * t
    wrapped = np.where(heading > np.pi, heading - 2.0 * np.pi, heading)
    stamps = np.round(t * 1e9).astype(np.int64)
    alone = signals(Run({'car': Series(stamps, {'heading': wrapped})}), 'bag', ('heading',))
    assert alone['heading'] == pytest.approx(heading, abs=1e-9)


def test_a_channel_without_any_number_is_as_one_that_is_not_there() -> None:
    """The angle of the steering wheel comes from the joint then, and roll, which is not needed, from nowhere."""
    t = even(10.0, 100.0)
    stamps, none = np.round(t * 1e9).astype(np.int64), np.full(t.size, np.nan)
    columns = {'cmd_applied/steering': none, 'joint_states/steering_wheel/position': t, 'roll': none}
    run = Run({'car': Series(stamps, columns)})
    found = signals(run, 'bag', ('steering',), ('roll',))
    assert found['steering'] == pytest.approx(t)
    assert 'roll' not in found
    with pytest.raises(BagError, match='the channel roll holds no number; map another with --map'):
        signals(run, 'bag', ('steering', 'roll'))


def test_gaps_are_told() -> None:
    t = even(10.0, 100.0)
    keep = (t < 4.0) | (t > 4.5)
    run = Run({'imu': Series(np.round(t[keep] * 1e9).astype(np.int64), {'imu/wz': t[keep]})})
    s = signals(run, 'bag', ('yaw_rate',))
    assert '0.51 s without samples' in s.notes[0] or '0.52 s without samples' in s.notes[0]
    with pytest.raises(BagError, match='ten samples'):
        signals(Run({'imu': Series(np.arange(5), {'imu/wz': np.zeros(5)})}), 'bag', ('yaw_rate',))


def test_how_many_gaps_there_are_is_told() -> None:
    t = even(10.0, 100.0)
    keep = ((t < 2.0) | (t > 2.3)) & ((t < 4.0) | (t > 4.5)) & ((t < 7.0) | (t > 7.1))
    run = Run({'imu': Series(np.round(t[keep] * 1e9).astype(np.int64), {'imu/wz': t[keep]})})
    (note,) = signals(run, 'bag', ('yaw_rate',)).notes
    assert note == '0.52 s without samples behind t = 3.99 s, the longest of 2 such times'


@pytest.mark.parametrize(
    ('begin', 'end', 'told'),
    [
        (0.0, 10.0, ''),
        (0.2, 9.8, ''),  # sensors start one after the other
        (0.0, 4.0, 'judged from t = 0 to 4 s alone, of 0 to 10 s: imu/wz ends then'),
        (3.0, 9.5, 'judged from t = 3 to 9.5 s alone, of 0 to 10 s: imu/wz begins then'),
    ],
)
def test_a_topic_that_is_not_there_for_the_whole_time_is_told(begin: float, end: float, told: str) -> None:
    """A sensor that ended after 4 of 10 s left an evaluation of 4 s without a word."""
    t = even(10.0, 100.0)
    part = (t >= begin) & (t <= end)
    stamps = np.round(t * 1e9).astype(np.int64)
    run = Run({'odom': Series(stamps, {'odom/twist/vx': 20.0 - t}), 'imu': Series(stamps[part], {'imu/wz': t[part]})})
    assert signals(run, 'bag', ('speed', 'yaw_rate')).notes == [told] * bool(told)


def test_the_hand_torque_is_that_which_turns_the_steering_wheel() -> None:
    """Of a steering wheel that a torque turns the effort is what all together do: the hand, and the damper of the
    steering."""
    stamps = np.arange(1001, dtype=np.int64) * 10**7
    effort = Series(stamps, {'joint_states/steering_wheel/effort': np.full(1001, 9.0)})
    assert set(signals(Run({'joint_states': effort}), 'bag', ('steering_torque',))['steering_torque']) == {9.0}
    hand = Series(stamps, {'cmd_applied/steering_torque': np.full(1001, 2.0)})
    run = Run({'joint_states': effort, 'cmd_applied': hand})
    assert set(signals(run, 'bag', ('steering_torque',))['steering_torque']) == {2.0}


def test_commands_that_are_sent_when_they_change_hold_to_the_end() -> None:
    """A brake that is told twice, at 0 and 4 s, is no gap and does not end the recording, and one that is told first at
    4 s begins it."""
    t = even(10.0, 100.0)
    stamps = np.round(t * 1e9).astype(np.int64)
    for first, values in ((0, [0.0, 3000.0]), (1, [3000.0])):
        told = Series(np.array([0, 4 * 10**9])[first:], {'cmd_applied/brake_torque': np.array(values)})
        s = signals(
            Run({'odom': Series(stamps, {'odom/twist/vx': 20.0 - t}), 'cmd_applied': told}), 'bag', ('speed', 'brake')
        )
        assert (s.t[0], s.t[-1], s.notes) == (4.0 * first, 10.0, [])
        assert s['brake'] == pytest.approx(np.where(s.t >= 4.0, 3000.0, 0.0))


def test_what_is_recorded_finer_than_the_grid_does_not_come_back_as_a_slow_motion() -> None:
    """1003 Hz at 5 kHz, of which samples at 1 kHz would make 3 Hz; 20 Hz stay as they are, also on stamps that
    scatter."""
    t = even(4.0, 5000.0)
    jitter = 2e-5 * np.sin(np.arange(t.size))
    for stamps in (t, np.concatenate([t[:1], t[1:-1] + jitter[1:-1], t[-1:]])):
        slow = np.sin(2.0 * np.pi * 20.0 * stamps)
        series = Series(np.round(stamps * 1e9).astype(np.int64), {'az': slow + np.sin(2.0 * np.pi * 1003.0 * stamps)})
        s = signals(Run({'': series}), 'bag', ('az',))
        assert s.rate == pytest.approx(1000.0)
        inside = s.between(0.1, 3.9)
        assert s['az'][inside] == pytest.approx(
            np.sin(2.0 * np.pi * 20.0 * s.t[inside]), abs=1e-3 if stamps is t else 0.08
        )


def test_an_orientation_of_zeros_is_none() -> None:
    """Who knows no orientation sends zeros, not that the car heads along x; the lateral acceleration is that of its
    sensor, and told."""
    t = even(10.0, 100.0)
    stamps = np.round(t * 1e9).astype(np.int64)
    body = pose(t, 0.1 * t, 0.0, 20.0)
    body |= {f'odom/twist/{n}': 0.0 * t for n in ('vx', 'vy', 'vz', 'wx', 'wy', 'wz')}
    nothing = body | {f'odom/pose/q{n}': 0.0 * t for n in 'xyzw'}
    force = Series(stamps, {f'imu/{n}': 0.0 * t + 1.0 for n in ('ax', 'ay', 'az')})
    s = signals(Run({'odom': Series(stamps, nothing), 'imu': force}), 'bag', ('lateral_acceleration',), ('roll',))
    assert 'no orientation' in s.notes[0] and 'roll' not in s
    with pytest.raises(BagError, match='the channel odom/pose/qx holds no number'):
        signals(Run({'odom': Series(stamps, nothing)}), 'bag', ('heading',))
    late = {n: np.where(t < 1.0, nothing[n], body[n]) for n in body}  # the sensor finds its orientation after a second
    again = signals(Run({'odom': Series(stamps, late)}), 'bag', ('heading',))
    assert again.t[0] == 1.0
    assert again['heading'] == pytest.approx(0.1 * again.t, abs=1e-9)


def test_a_quaternion_that_changes_its_sign_in_a_gap_is_the_same_orientation() -> None:
    t = even(10.0, 100.0)
    body = pose(t, 0.1 * t, 0.0, 20.0)
    for n in 'xyzw':
        q = body[f'odom/pose/q{n}']
        body[f'odom/pose/q{n}'] = np.where((t > 4.0) & (t < 4.1), np.nan, np.where(t > 4.05, -q, q))
    s = signals(Run({'odom': Series(np.round(t * 1e9).astype(np.int64), body)}), 'bag', ('heading',))
    assert s['heading'] == pytest.approx(0.1 * s.t, abs=1e-6)


def test_why_a_topic_is_not_read_is_told() -> None:
    t = even(10.0, 100.0)
    stamps = np.round(t * 1e9).astype(np.int64)
    run = Run({'imu': Series(stamps, {'imu/wz': 0.0 * t})}, left_out={'odom': 'its times go back by 7 s'})
    with pytest.raises(BagError, match='has no speed along the vehicle: odom is not read: its times go back by 7 s'):
        signals(run, 'bag', ('speed',))
    assert signals(run, 'bag', ('yaw_rate',), ('roll', 'sideslip_angle')).notes == [
        'odom is not read: its times go back by 7 s'
    ]
    assert signals(run, 'bag', ('yaw_rate',)).notes == []


@pytest.mark.parametrize(('slow', 'spacing'), [((1.5, 4.2), 0.2), ((1.5, 1.9), None), ((1.5, 1.5), None)])
def test_a_rate_that_changes_counts_as_the_slower_one(slow: tuple[float, float], spacing: float | None) -> None:
    """100 Hz, and 5 Hz for a third of the time: by the usual interval response times were known to 5 ms."""
    fine = even(7.0, 100.0)
    keep = (fine < slow[0]) | (fine > slow[1] - 1e-9)
    t = np.sort(np.concatenate([fine[keep], np.arange(slow[0], slow[1] - 1e-9, 0.2)]))
    grids = {'yaw_rate': t, 'speed': fine}
    run = Run({name: Series(np.round(g * 1e9).astype(np.int64), {name: np.ones(g.size)}) for name, g in grids.items()})
    assert signals(run, 'bag', ('yaw_rate', 'speed')).spacing.get('yaw_rate') == (spacing and pytest.approx(spacing))


@pytest.mark.parametrize(
    ('name', 'told'),
    [('yaw_rate', 'the channel yaw_rate or imu/wz is needed'), ('road_angle', 'the channel road_angle is needed')],
)
def test_the_channel_of_a_signal_that_is_missing_is_named(name: str, told: str) -> None:
    t = np.arange(1000) * 10_000_000
    run = Run(series={'speed': Series(t, {'speed': np.ones(t.size)})})
    with pytest.raises(BagError, match=told):
        signals(run, 'here', ('speed', name))
