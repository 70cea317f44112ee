"""ISO 21994 and ISO 14512: constant decelerations."""

from __future__ import annotations

import numpy as np
import pytest
from drives import even, made

from mbd_sim_ros.analysis.evaluation import braking
from mbd_sim_ros.analysis.evaluation.signals import Signals
from solver.errors import BagError


def stopping(v0: float = 27.0, b: float = 8.0, rate: float = 200.0) -> Signals:
    """Constant deceleration from t = 1 s on, which is when the brakes are applied."""
    t = even(7.0, rate)
    v = np.clip(v0 - b * np.clip(t - 1.0, 0.0, None), 0.0, None)
    return made(
        t,
        speed=v,
        brake=np.where(t >= 1.0, 3000.0, 0.0),
        yaw_rate=np.where(t > 1.0, 0.05, 0.0),
        heading=0.05 * np.clip(t - 1.0, 0.0, None),
        x=0.0,
        y=-0.3 * np.clip(t - 1.0, 0.0, None),
    )


def test_stopping_distance() -> None:
    """v^2/2b from 27.5 m/s, corrected to 100 km/h; all decelerations are b."""
    r = braking.judge_stopping(stopping(27.5), braking.Stopping())
    sample = 27.5 / 200.0  # m travelled in a sample, within which the brakes are applied
    assert r['initial_speed'] == pytest.approx(27.5)
    assert r['distance'] == pytest.approx(27.5**2 / 16.0, abs=sample)
    assert r['corrected_distance'] == pytest.approx((100.0 / 3.6) ** 2 / 16.0, abs=sample * 1.06)
    assert r['mfdd'] == pytest.approx(8.0, rel=1e-3)
    assert r['mean_deceleration'] == pytest.approx(8.0, rel=3e-3)
    assert r['time'] == pytest.approx(27.5 / 8.0, abs=0.02)  # standing is 0.05 m/s
    assert not r.notes
    assert any('small differences' in n for n in braking.judge_stopping(stopping(20.0), braking.Stopping()).notes)


@pytest.mark.parametrize('rate', [50.0, 20.0])
def test_samples_too_far_apart_for_a_stopping_distance_are_told(rate: float) -> None:
    """27.5 m/s over 47.3 m: what is travelled between two samples is 1.2 % of it at 50 Hz, 2.9 %, 1.4 m, at 20 Hz."""
    result = braking.judge_stopping(stopping(27.5, rate=rate), braking.Stopping())
    assert abs(result['distance'] - 27.5**2 / 16.0) <= 27.5 / rate
    assert [note for note in result.notes if 'not known better than to 1.4 m' in note] == list(result.notes)
    assert len(result.notes) == (rate == 20.0)


def test_mfdd_is_of_the_developed_part() -> None:
    """8 m/s^2 above 80 % of the speed, 4 m/s^2 below: the part from 0.8 to 0.1 v_0 is what counts."""
    s = stopping(25.0)
    t = s.t
    first = 5.0 / 8.0
    s.values['speed'] = np.clip(
        np.where(t < 1.0 + first, 25.0 - 8.0 * np.clip(t - 1.0, 0.0, None), 20.0 - 4.0 * (t - 1.0 - first)), 0.0, None
    )
    assert braking.judge_stopping(s, braking.Stopping())['mfdd'] == pytest.approx(4.0, rel=1e-3)


def test_split_friction() -> None:
    r = braking.judge_split(stopping(), braking.SplitFriction())
    assert r['mean_deceleration'] == pytest.approx(8.0, rel=3e-3)
    assert r['yaw_rate_after'] == pytest.approx(0.05)
    assert r['yaw_angle_after'] == pytest.approx(0.05, abs=1e-3)
    assert r['yaw_angle_largest'] == pytest.approx(0.05 * 27.0 / 8.0, abs=2e-3)
    assert r['deviation_after'] == pytest.approx(-0.3, abs=2e-3)
    stop = 27.0 / 8.0  # s, after which the car stands
    assert r['initial_speed'] == pytest.approx(27.0)
    assert r['mfdd'] == pytest.approx(8.0, rel=1e-3)
    assert r['distance'] == pytest.approx(27.0**2 / 16.0, abs=27.0 / 200.0)
    assert r['yaw_rate_early'] == r['yaw_rate_largest'] == pytest.approx(0.05)
    assert r['yaw_angle_early'] == pytest.approx(0.05, abs=1e-3)
    assert r['deviation_early'] == pytest.approx(0.3, abs=2e-3)
    assert r['deviation_largest'] == pytest.approx(0.3 * stop, abs=6e-3)


def test_split_friction_with_counter_steering_and_sideslip() -> None:
    """Counted from what they are when the brakes are applied; sideslip counts above 3 m/s only, here up to t = 1 s +
    24/8 s."""
    s = stopping()
    since = np.clip(s.t - 1.0, 0.0, None)
    s.values['steering'] = 0.02 - 0.2 * since
    s.values['sideslip_angle'] = 0.01 * since
    r = braking.judge_split(s, braking.SplitFriction())
    sample = 1.0 / 200.0
    assert r['steering_after'] == pytest.approx(-0.2, abs=0.2 * sample)
    assert r['steering_early'] == pytest.approx(0.2, abs=0.2 * sample)
    assert r['steering_largest'] == pytest.approx(0.2 * 27.0 / 8.0, abs=0.6 * sample * 5)
    assert r['sideslip_after'] == pytest.approx(0.01, abs=0.01 * sample)
    assert r['sideslip_early'] == pytest.approx(0.01, abs=0.01 * sample)
    assert r['sideslip_largest'] == pytest.approx(0.03, abs=0.02 * sample)


def on_strip(leaves: float = 2.5, comes: float = 0.0, rear: float = 0.1) -> Signals:
    """The car of stopping() with its right wheels on friction 0.3 from `comes` to `leaves`, at the rear later; then it
    turns faster."""
    s = stopping()
    t, one = s.t, np.ones(s.t.size)
    for axle, later in (('front', 0.0), ('rear', rear)):
        s.values[f'friction_{axle}_left'] = one
        s.values[f'friction_{axle}_right'] = np.where((t >= comes + later) & (t < leaves + later), 0.3, 1.0)
    s.values['yaw_rate'] = np.where(t > 1.0, 0.05, 0.0) + 10.0 * np.clip(t - leaves, 0.0, 0.1)
    return s


def test_split_friction_is_judged_until_a_wheel_leaves_the_strip() -> None:
    """At t = 2.5 s, 1.5 s after the brakes: 27 m/s * 1.5 s - 4 m/s^2 (1.5 s)^2 = 31.5 m, 27 to 15 m/s; no MFDD, which
    ends at 2.7 m/s."""
    r = braking.judge_split(on_strip(), braking.SplitFriction())
    assert r['yaw_rate_largest'] == pytest.approx(0.05)
    assert r['distance'] == pytest.approx(31.5, abs=0.01)
    assert r['mean_deceleration'] == pytest.approx(8.0, rel=1e-3)
    assert r['yaw_angle_largest'] == pytest.approx(0.075, abs=1e-9)
    assert r['deviation_largest'] == pytest.approx(0.45, abs=1e-9)
    assert np.isnan(r['mfdd'])
    assert r.notes == (
        'judged until t = 2.5 s, 1.5 s after the brakes are applied: the front right wheel leaves the low friction '
        'then',
    )
    with pytest.raises(
        BagError, match=r'a wheel leaves the low friction 0\.8 s after the brakes are applied; 1 s are needed'
    ):
        braking.judge_split(on_strip(leaves=1.8), braking.SplitFriction())


def test_split_friction_that_holds_to_rest_is_judged_to_rest() -> None:
    r = braking.judge_split(on_strip(leaves=7.0), braking.SplitFriction())
    assert r.notes == ()
    assert r['mfdd'] == pytest.approx(8.0, rel=1e-3)
    assert r['distance'] == pytest.approx(27.0**2 / 16.0, abs=0.01)


def test_brakes_applied_before_the_strip_are_told() -> None:
    """Front wheels on it from 0.95 s, rear wheels from 1.05 s: the brakes come between them. At 5 s the car stands
    already."""
    one_axle = braking.judge_split(on_strip(leaves=7.0, comes=0.95), braking.SplitFriction()).notes
    assert one_axle == ('both rear wheels are on high friction when the brakes are applied',)
    notes = braking.judge_split(on_strip(leaves=7.0, comes=5.0), braking.SplitFriction()).notes
    assert notes == ('no split friction: all wheels are on a friction of 1 to 1 from the brakes on',)
    unknown = braking.judge_split(stopping(), braking.SplitFriction()).notes
    assert unknown == (
        'whether the wheels stay on the split friction is not known: the recording has no friction under them',
    )


def test_a_command_that_jumps_is_applied_at_the_later_sample() -> None:
    """10 Hz, 27.78 m/s, -7.5 m/s^2 from t = 1 s on: v^2/15 and not a sample of 2.8 m more. A pedal that takes 0.4 s, at
    10 Hz, reaches 2 % of its way 8 ms after it leaves zero."""
    t = even(7.0, 10.0)
    v0 = 100.0 / 3.6
    s = made(t, speed=np.clip(v0 - 7.5 * np.clip(t - 1.0, 0.0, None), 0.0, None), brake=np.where(t > 0.95, 3000.0, 0.0))
    r = braking.judge_stopping(s, braking.Stopping())
    assert r['initial_speed'] == pytest.approx(v0)
    assert r['distance'] == pytest.approx(v0 * v0 / 15.0, abs=0.01)
    s.values['brake'] = np.interp(t, [0.9, 1.3], [0.0, 3000.0])
    t0, _, _ = braking.stop(s, 0.05)
    assert t0 == pytest.approx(0.908, abs=1e-9)


def spinning() -> Signals:
    """Slides 64 m straight on at 6 m/s^2, and turns by 1 rad/s from the brakes on: after 1.57 s it is across its way,
    and its speed along itself is zero."""
    t = even(8.0)
    since = np.clip(t - 1.0, 0.0, 27.78 / 6.0)
    return made(
        t,
        speed=(27.78 - 6.0 * since) * np.cos(since),
        brake=np.where(t >= 1.0, 3000.0, 0.0),
        yaw_rate=np.where(t > 1.0, 1.0, 0.0),
    )


def test_a_car_that_slides_across_its_way_does_not_stand() -> None:
    for judge, parameters in (
        (braking.judge_stopping, braking.Stopping()),
        (braking.judge_split, braking.SplitFriction()),
    ):
        with pytest.raises(BagError, match='the car spins in the recording: its wheels lock'):
            judge(spinning(), parameters)


def test_turning_before_the_brakes_are_applied_is_none_of_braking() -> None:
    """A bend of 1.8 rad on the way to the track."""
    s = stopping()
    early = even(10.0)[:-1]
    bend = made(early, speed=27.0, brake=0.0, yaw_rate=np.where((early > 2.0) & (early <= 6.0), 0.45, 0.0))
    t = np.concatenate([early, 10.0 + s.t])
    both = made(t, **{name: np.concatenate([bend[name], s[name]]) for name in ('speed', 'brake', 'yaw_rate')})
    r = braking.judge_split(both, braking.SplitFriction())
    assert r['yaw_angle_largest'] == pytest.approx(0.05 * 27.0 / 8.0, abs=2e-3)
    assert braking.judge_stopping(both, braking.Stopping())['distance'] == pytest.approx(
        27.0**2 / 16.0, abs=27.0 / 200.0
    )


@pytest.mark.parametrize('before', [100.0, 3000.0])
def test_the_brakes_that_stop_the_car_count_and_not_those_before(before: float) -> None:
    """Touched from 1.0 to 1.3 s, at 27.4 m/s; 5 s later the stop: v^2/16, not 130 m more. Pumped brakes are applied
    once."""
    t = even(14.0)
    v = np.clip(27.4 - 8.0 * np.clip(t - 6.0, 0.0, None), 0.0, None)
    s = made(t, speed=v, brake=np.where(t >= 6.0, 3000.0, 0.0) + np.where((t >= 1.0) & (t < 1.3), before, 0.0))
    r = braking.judge_stopping(s, braking.Stopping())
    assert r['distance'] == pytest.approx(27.4**2 / 16.0, abs=27.4 / 200.0)
    assert r['initial_speed'] == pytest.approx(27.4)
    assert r.notes == ('the brakes are applied 2 times; judged from t = 6 s on, where the speed falls most',)
    s.values['brake'] = np.where((t >= 6.0) & (t % 0.5 < 0.3), 3000.0, 0.0)
    s.notes.clear()
    pumped = braking.judge_stopping(s, braking.Stopping())
    assert pumped['distance'] == pytest.approx(r['distance'])
    assert pumped.notes == ()


def test_a_sensor_that_shows_brakes_where_there_are_none_is_told() -> None:
    """3 % of the pressure from the first sample on: the distance holds the second before, 27 m more than v^2/16."""
    s = stopping()
    s.values['brake'] = np.maximum(s['brake'], 90.0)
    r = braking.judge_stopping(s, braking.Stopping())
    assert r['distance'] == pytest.approx(27.0 + 27.0**2 / 16.0, abs=27.0 / 200.0)
    assert any('the brakes are on in the first sample, at 3 % of their largest' in note for note in r.notes)
    s.values['brake'] = np.maximum(s['brake'] - 90.0, 0.0)
    s.notes.clear()
    r = braking.judge_stopping(s, braking.Stopping())
    assert r['distance'] == pytest.approx(27.0**2 / 16.0, abs=27.0 / 200.0)
    assert not [note for note in r.notes if 'first sample' in note]


def test_a_car_that_is_held_by_its_brakes_before_it_drives_off_is_judged_when_it_stops() -> None:
    s = stopping()
    wait = even(10.0)[:-1]
    off = made(
        wait, speed=np.clip(5.0 * (wait - 4.0), 0.0, 27.0), brake=np.where(wait < 3.0, 3000.0, 0.0), yaw_rate=0.0
    )
    t = np.concatenate([wait, 10.0 + s.t])
    both = made(t, **{name: np.concatenate([off[name], s[name]]) for name in ('speed', 'brake', 'yaw_rate')})
    assert braking.judge_stopping(both, braking.Stopping())['distance'] == pytest.approx(
        27.0**2 / 16.0, abs=27.0 / 200.0
    )


def test_braking_that_is_none_is_refused() -> None:
    s = stopping()
    s.values['brake'][:] = 0.0
    with pytest.raises(BagError, match='not applied'):
        braking.judge_stopping(s, braking.Stopping())
    with pytest.raises(
        BagError,
        match=r'does not come to rest in the recording: 21 m/s at its end; it lasts 7 s, record for longer .*--set '
        r'duration=',
    ):
        braking.judge_stopping(stopping(b=1.0), braking.Stopping())
