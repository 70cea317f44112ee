"""Signals at common instants: each kind comes to other instants as it must, and a planted time offset is found."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mbd_sim_ros.analysis.alignment import (
    Common,
    Signal,
    common,
    find_offset,
    rotation_angle,
    same_turn,
    slerp,
    unwrapped,
)
from solver.errors import BagError

MS = 1_000_000


def signal(n: int, h_ms: float, f, start_ms: float = 0.0) -> Signal:
    t = np.round((start_ms + np.arange(n) * h_ms) * MS).astype(np.int64)
    return Signal(t, f(t * 1e-9))


def wave(t: np.ndarray) -> np.ndarray:
    """A transient with content up to 3 Hz, like a yaw rate; never periodic."""
    return np.sin(2.0 * t + 0.3 * t**2) * np.exp(-0.5 * ((t - 6.0) / 3.0) ** 2) + 0.3 * np.sin(11.0 * t) * (t > 2.0)


def test_straight_lines_stay_straight_lines() -> None:
    a, b = signal(31, 100.0, lambda t: 2.0 * t, 37.0), signal(400, 7.0, lambda t: 2.0 * t)
    for pair in ((a, b), (b, a)):
        found = common(pair)
        assert found.interpolated
        assert found.time_ns[0] == 37 * MS  # the instants of the coarser one in the time of both
        assert found.time_ns[-1] == 2737 * MS
        np.testing.assert_allclose(found.values[0], found.values[1], rtol=0.0, atol=1e-12)


def held(found: Common, k: int) -> dict[int, float]:
    """Instants [ms] and values of one of the signals."""
    return {int(t // MS): v for t, v in zip(found.time_ns, found.values[k].tolist(), strict=True)}


def test_a_command_holds_until_the_next_one() -> None:
    steps = Signal(np.array([0, 200, 400, 600]) * MS, np.array([1.0, 5.0, 9.0, 2.0]))
    fine = Signal(np.array([0, 1, 199, 201, 399, 600]) * MS, np.zeros(6))
    # the coarse one has its own instants
    assert held(common((fine, steps), 'hold'), 1) == {0: 1.0, 200: 5.0, 400: 9.0, 600: 2.0}
    dense = Signal(np.arange(0, 601, 3) * MS, np.where(np.arange(0, 601, 3) < 300, 1.0, 5.0))
    found = common((Signal(np.array([100, 298, 301, 500]) * MS, np.zeros(4)), dense), 'hold')
    # the last one before 301 ms is of 300 ms
    assert [held(found, 1)[t] for t in (100, 298, 301, 500)] == [1.0, 1.0, 5.0, 5.0]


@pytest.mark.parametrize(('begin', 'end'), [(300, 700), (2100, 2500), (3200, 3600)])
def test_what_another_did_while_a_command_held_is_seen(begin: int, end: int) -> None:
    """Messages on change at 0, 2 and 3 s, of a command that stays zero; the other one, at 100 Hz for 4 s, was one
    meanwhile. Both were compared at the three instants alone, and the same."""
    t = np.arange(0, 4001, 10)
    dense = Signal(t * MS, ((t >= begin) & (t < end)).astype(float))
    sparse = Signal(np.array([0, 2000, 3000]) * MS, np.zeros(3))
    for pair in ((dense, sparse), (sparse, dense)):
        found = common(pair, 'hold')
        assert found.overlap == 1.0
        assert np.abs(found.values[0] - found.values[1]).sum() == (end - begin) / 10


def test_a_command_that_is_sampled_seldom_is_compared_where_it_is_sampled() -> None:
    """A ramp of 1/s at 100 Hz and every 0.5 s: between two of the latter it does not hold."""
    dense, seldom = signal(401, 10.0, lambda t: t), signal(9, 500.0, lambda t: t)
    found = common((dense, seldom), 'hold')
    assert found.time_ns.tolist() == seldom.time_ns.tolist()
    np.testing.assert_array_equal(found.values[0], found.values[1])


def test_what_a_command_was_before_its_first_message_is_not_known() -> None:
    dense, late = signal(1001, 10.0, lambda t: 0.0 * t), Signal(np.array([2500, 9000]) * MS, np.zeros(2))
    assert common((dense, late), 'hold').overlap == pytest.approx(0.75 + 0.025)  # but for 0.25 s


def test_wrapped_angles_are_interpolated_across_the_jump() -> None:
    """A heading that turns steadily, wrapped: between pi and -pi a straight line would pass through zero, off by up to
    pi."""
    a = signal(150, 400.0, lambda t: np.angle(np.exp(1.3j * t)))
    b = signal(120, 450.0, lambda t: np.angle(np.exp(1.3j * t)), 3.0)
    found = common((a, b), 'angle')
    np.testing.assert_allclose(found.values[0], same_turn(found.values[1], found.values[0]), rtol=0.0, atol=1e-9)
    plain = common((a, b))
    assert np.max(np.abs(plain.values[0] - plain.values[1])) > 1.0


def test_a_count_of_turns_is_not_taken_for_a_wrapped_angle() -> None:
    """A wheel at 100 rad/s recorded at 10 Hz turns by more than half a turn between samples."""
    wheel = 10.0 * np.arange(50)
    assert unwrapped(wheel) is wheel


def test_orientations_turn_steadily_between_samples() -> None:
    axis = np.array([0.36, 0.48, 0.8])

    def turned(t: np.ndarray) -> np.ndarray:
        return Rotation.from_rotvec(np.outer(0.7 * t, axis)).as_quat()

    exact = signal(1000, 3.0, turned)
    rough = signal(30, 100.0, turned, 1.5)
    # the same orientations
    flipped = Signal(rough.time_ns, rough.values * np.where(np.arange(30) % 2, -1.0, 1.0)[:, None])
    found = common((flipped, Signal(np.sort(exact.time_ns), exact.values)), 'orientation')
    assert np.max(rotation_angle(found.values[0], found.values[1])) < 1e-9
    back = common((Signal(exact.time_ns[::50], exact.values[::50]), flipped), 'orientation')
    assert np.max(rotation_angle(back.values[0], back.values[1])) < 1e-9


def test_slerp_goes_the_short_way_and_needs_no_distance() -> None:
    a = np.array([[0.0, 0.0, 0.0, 1.0]] * 2)
    b = np.array([[0.0, 0.0, np.sin(0.4), np.cos(0.4)], [0.0, 0.0, 1e-9, 1.0]])
    half = np.array([0.5, 0.25])
    np.testing.assert_allclose(slerp(a, -b, half)[0], [0.0, 0.0, np.sin(0.2), np.cos(0.2)], atol=1e-15)
    np.testing.assert_allclose(slerp(a, b, half)[1], [0.0, 0.0, 2.5e-10, 1.0], atol=1e-18)


@pytest.mark.parametrize('angle', [0.0, 1e-9, 0.3, 3.0, np.pi])
def test_angle_between_orientations_is_exact_near_zero_and_half_a_turn(angle: float) -> None:
    rng = np.random.default_rng(5)
    start = Rotation.random(20, random_state=rng)
    axes = rng.standard_normal((20, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    end = start * Rotation.from_rotvec(angle * axes)
    np.testing.assert_allclose(
        rotation_angle(start.as_quat(), -end.as_quat()), angle, rtol=0.0, atol=1e-15 + 4e-16 * 20
    )


def test_overlap_is_the_shared_part_of_the_longer_one_but_for_one_sample() -> None:
    whole, cut = signal(801, 10.0, np.sin), signal(501, 10.0, np.sin)
    assert common((whole, cut)).overlap == pytest.approx(5.0 / 8.0, abs=0.003)
    assert common((whole, signal(800, 10.0, np.sin))).overlap == 1.0
    assert common((whole, signal(81, 100.0, np.sin))).overlap == 1.0
    with pytest.raises(BagError, match=r'do not overlap in time .*--align'):
        common((whole, signal(10, 10.0, np.sin, 9000.0)))


@pytest.mark.parametrize(('h_a', 'h_b'), [(1.0, 10.0), (10.0, 1.0), (10.0, 10.0), (1.0, 1.0), (4.0, 9.0)])
@pytest.mark.parametrize('planted', [0.137, -1.2034, 0.0])
def test_a_planted_offset_is_found_within_a_millisecond_in_noise(h_a: float, h_b: float, planted: float, rng) -> None:
    """Reference stamped `planted` too early, both with noise of 2 % of the peak; the second has another gain and a
    bias."""
    a = signal(int(12000 / h_a), h_a, wave)
    t = (np.arange(int(11000 / h_b)) * h_b) * 1e-3
    b = Signal(np.round(t * 1e9).astype(np.int64), 1.1 * wave(t + planted) + 0.05)
    a, b = (Signal(s.time_ns, s.values + 0.02 * rng.standard_normal(s.values.size)) for s in (a, b))
    found = find_offset(a, b)
    assert found.seconds == pytest.approx(planted, abs=1e-3)
    assert found.correlation > 0.98
    assert found.again is None
    assert find_offset(b, a).seconds == pytest.approx(-planted, abs=1e-3)


def test_stamps_with_the_time_of_day_do_not_disturb_the_search() -> None:
    a = signal(12000, 1.0, wave)
    b = Signal(a.time_ns[::10] + 1_700_000_000_000_000_000 - 137 * MS, a.values[::10])
    found = find_offset(a, b)
    assert found.nanoseconds + 1_700_000_000_000_000_000 == pytest.approx(137 * MS, abs=10_000)


def test_samples_without_a_number_do_not_hide_an_offset() -> None:
    """Empty cells of a table: one here, and every second one where it was recorded half as often as its neighbour."""
    a, b = signal(1200, 10.0, wave), signal(1200, 10.0, lambda t: wave(t - 0.137))
    a.values[500], b.values[1::2] = np.nan, np.nan
    assert find_offset(a, b).seconds == pytest.approx(-0.137, abs=1e-3)
    a.values[1:] = np.nan
    with pytest.raises(BagError, match='too short to find a time offset from'):
        find_offset(a, b)


def test_a_periodic_signal_fits_again_a_period_later() -> None:
    a, b = (signal(n, 10.0, lambda t: np.sin(2.0 * np.pi * t / 1.6)) for n in (1000, 800))
    found = find_offset(a, b)
    assert found.again is not None
    assert abs(found.again - found.seconds) == pytest.approx(1.6, abs=0.02)


@pytest.mark.parametrize('factor', [-1.0, -57.3, 0.1])
def test_the_turned_sign_is_tried_too(factor: float) -> None:
    a, b = signal(1200, 10.0, wave), signal(1200, 10.0, lambda t: factor * wave(t - 0.137))
    found = find_offset(a, b)
    assert found.seconds == pytest.approx(-0.137, abs=1e-3)
    assert found.correlation * np.sign(factor) > 0.98
    assert found.opposed is None


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_a_sine_that_may_be_turned_or_late_by_half_a_period_is_told(sign: float) -> None:
    a, b = (signal(n, 10.0, lambda t: np.sin(2.0 * np.pi * t / 1.6)) for n in (1000, 800))
    found = find_offset(a, b._replace(values=sign * b.values))
    assert found.correlation > 0.98  # the sign as it is, where nothing speaks against it
    assert found.opposed is not None
    assert abs(found.opposed - found.seconds) % 1.6 == pytest.approx(0.8, abs=0.02)


def test_signals_that_have_nothing_in_common_have_no_offset(rng) -> None:
    a, b = (Signal(np.arange(500) * 10 * MS, rng.standard_normal(500)) for _ in range(2))
    with pytest.raises(BagError, match='no time offset brings the signals together'):
        find_offset(a, b)
    flat = Signal(a.time_ns, np.zeros(500))
    with pytest.raises(BagError, match='no time offset'):
        find_offset(a, flat)
    with pytest.raises(BagError, match='too short'):
        find_offset(a, Signal(a.time_ns[:1], a.values[:1]))


@pytest.mark.parametrize('nothing', [np.nan, np.inf])
def test_an_angle_without_numbers_takes_none_from_the_other(nothing: float) -> None:
    """It was moved by a number of turns that is none, and then both had none and were the same."""
    angle, none = np.linspace(0.0, 1.0, 5), np.full(5, nothing)
    np.testing.assert_array_equal(same_turn(angle, none), angle)
    some = np.where(np.arange(5) < 2, nothing, angle)
    np.testing.assert_allclose(same_turn(angle + 4.0 * np.pi, some), angle, rtol=0.0, atol=1e-14)
