"""Comparing runs: known differences are found, placed and judged, unknown ones are not invented."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scalars import joined, run, run_of
from scipy.spatial.transform import Rotation

from mbd_sim_ros.analysis.comparison import compare
from mbd_sim_ros.analysis.plots import plot_comparison
from mbd_sim_ros.analysis.tolerances import Tolerance, Tolerances, load_tolerances
from mbd_sim_ros.bags.reader import Run, Series
from solver.errors import BagError, MbdError

MS = 1_000_000
T_975_2 = 0.95 * np.sqrt(2.0 / (4.0 * 0.975 * 0.025))  # Student's t with two degrees of freedom has a closed form


def within(rtol: float = 0.0, atol: float = 0.0, floor: float = 0.0, **more) -> Tolerances:
    return Tolerances(default=Tolerance(rtol=rtol, atol=atol, **more), floor=floor)


def one(found, channel: str):
    return next(d for d in found.differences if d.channel == channel)


def test_largest_and_rms_difference_are_those_of_the_formula() -> None:
    a = run(x=lambda t: np.sin(t) + 0.3 * t, y=lambda t: t)
    b = run(x=np.sin, y=lambda t: t)
    found = compare(a, b, tolerances=within(atol=0.31))
    x = one(found, 'x')
    assert x.max == pytest.approx(0.3, rel=1e-14)
    assert x.time == pytest.approx(1.0, rel=1e-15)
    assert x.rms == pytest.approx(0.3 * np.sqrt(np.mean(np.linspace(0.0, 1.0, 101) ** 2)), rel=1e-14)
    assert x.scale == pytest.approx(np.sin(1.0), rel=1e-14)
    assert x.normalised == pytest.approx(0.3 / np.sin(1.0), rel=1e-14)
    assert x.rms_normalised == pytest.approx(x.rms / np.sin(1.0), rel=1e-14)
    assert found.ok
    assert not found.interpolated
    assert not compare(a, b, tolerances=within(atol=0.29)).ok


def test_peaks_their_difference_and_their_times() -> None:
    """Bells of height 2.1 at 0.4 s and of -2 at 0.55 s: sizes differ by 0.1."""
    a = run(x=lambda t: 2.1 * np.exp(-(((t - 0.4) / 0.05) ** 2)))
    b = run(x=lambda t: -2.0 * np.exp(-(((t - 0.55) / 0.05) ** 2)))
    x = compare(a, b).differences[0]
    assert x.peak == pytest.approx((2.1, -2.0))
    assert x.peak_difference == pytest.approx(0.1)
    assert x.peak_time == pytest.approx((0.4, 0.55))
    late = compare(
        run(x=lambda t: np.exp(-(((t - 0.45) / 0.05) ** 2))), run(x=lambda t: np.exp(-(((t - 0.4) / 0.05) ** 2)))
    ).differences[0]
    assert late.rating is not None
    assert late.rating.shift == pytest.approx(0.05)


@pytest.mark.parametrize(
    ('rtol', 'atol', 'ok'), [(0.0101, 0.0, True), (0.0099, 0.0, False), (0.005, 0.0101, True), (0.005, 0.0099, False)]
)
def test_tolerance_is_absolute_plus_relative_to_the_largest_reference_value(rtol: float, atol: float, ok: bool) -> None:
    b = run(x=lambda t: 2.0 * np.cos(np.pi * t))
    a = run_of({'x': b['x'] + 0.02}, b.time_ns)
    assert compare(a, b, tolerances=within(rtol, atol)).ok is ok


def test_worst_channel_comes_first() -> None:
    b = run(small=lambda t: 1e-3 + t, large=lambda t: 1e3 + t)
    a = run_of({'large': b['large'] + 1e-3, 'small': b['small'] + 1e-4}, b.time_ns)
    assert [d.channel for d in compare(a, b, tolerances=within(1e-3)).differences] == ['small', 'large']


def test_a_channel_that_is_zero_but_for_rounding_does_not_come_first() -> None:
    """fy is 1e-9 N beside an fx of 4000 N: that the two runs disagree on it fully means nothing. The error is in fx."""
    b = run(**{'tire/a/force/fx': lambda t: 4000.0 * np.sin(t), 'tire/a/force/fy': lambda t: 1e-9 * np.sin(40.0 * t)})
    a = run_of({'tire/a/force/fx': 1.001 * b['tire/a/force/fx'], 'tire/a/force/fy': -b['tire/a/force/fy']}, b.time_ns)
    found = compare(a, b, tolerances=Tolerances(default=Tolerance(rtol=1e-4, atol=0.0)))
    assert [d.channel for d in found.differences] == ['tire/a/force/fx', 'tire/a/force/fy']
    assert [d.ok for d in found.differences] == [False, True]
    bare = compare(a, b, tolerances=within(1e-4))
    assert bare.differences[0].channel == 'tire/a/force/fy'  # relative to itself


def test_nothing_is_interpolated_where_the_coarse_instants_exist_in_the_fine_run() -> None:
    coarse, fine = run(n=11, h_ns=100_000_000, x=lambda t: t**3), run(x=lambda t: t**3)
    for a, b in ((coarse, fine), (fine, coarse)):
        found = compare(a, b, tolerances=within())
        assert found.ok
        assert not found.interpolated
        assert found.instants == 11


def test_topics_of_different_rates_are_compared_each_at_its_own() -> None:
    """1 kHz, 100 Hz and 30 Hz in one recording: on one grid two of three would be gaps."""

    def made(factor: float) -> Run:
        return joined(
            run(n=1001, h_ns=MS, fast=np.sin),
            run(n=101, middle=lambda t: factor * np.cos(t)),
            run(n=31, h_ns=33 * MS, slow=np.exp),
        )

    found = compare(made(1.0), made(1.0), tolerances=within())
    assert found.ok
    assert {d.channel: d.instants for d in found.differences} == {'fast': 1001, 'middle': 101, 'slow': 31}
    other = compare(made(1.5), made(1.0), tolerances=within(1e-9))
    assert [d.channel for d in other.differences if not d.ok] == ['middle']
    assert one(other, 'middle').max == pytest.approx(0.5)


def test_a_run_that_ends_early_is_not_the_same() -> None:
    whole, cut = run(n=801, x=np.sin), run(n=501, x=np.sin)
    for a, b in ((whole, cut), (cut, whole)):
        found = compare(a, b)
        assert not found.ok
        assert found.differences[0].overlap == pytest.approx(0.625, abs=0.003)
        assert 'of the time is in both' in found.differences[0].reasons[0]
        assert compare(a, b, overlap=0.6).ok
    assert compare(whole, run(n=800, x=np.sin)).ok  # one sample less


def test_quaternions_are_compared_as_orientations() -> None:
    """About a fixed axis by 0.2 rad more: the angle between the orientations is 0.2 everywhere, whatever the signs and
    rates."""
    axis = np.array([2.0, -1.0, 2.0]) / 3.0

    def turning(n: int, h_ms: int, more: float, start_ms: int = 0) -> Run:
        t = (start_ms + np.arange(n) * h_ms) * MS
        q = (
            Rotation.from_rotvec(np.outer(0.9 * t * 1e-9 + more, axis)).as_quat()
            * np.where(np.arange(n) % 3 == 1, -1.0, 1.0)[:, None]
        )
        return run_of({f'odom/pose/q{c}': q[:, k] for k, c in enumerate('xyzw')}, t)

    for b in (turning(1001, 10, 0.0), turning(300, 33, 0.0, 5)):
        found = compare(turning(1001, 10, 0.2), b, overlap=0.9)
        assert [d.channel for d in found.differences] == ['odom/pose/orientation']
        assert found.differences[0].unit == 'rad'
        assert found.differences[0].max == pytest.approx(0.2, abs=1e-9)
        assert found.differences[0].rms == pytest.approx(0.2, abs=1e-9)
    same = compare(turning(1001, 10, 0.0), turning(300, 33, 0.0, 5), overlap=0.9)
    assert same.differences[0].max < 1e-9


@pytest.mark.parametrize('rate', [10, 25])
def test_who_gives_no_orientation_does_not_agree_with_who_does(rate: int) -> None:
    """Sensors without orientation send zeros, which are no rotation; they agree with zeros only."""
    turned = run(n=101, qx=lambda t: 0.0 * t, qy=lambda t: 0.0 * t, qz=np.sin, qw=np.cos)
    zeros = run(n=1010 // rate, h_ns=rate * MS, **{f'q{c}': lambda t: 0.0 * t for c in 'xyzw'})
    turned, zeros = (run_of({f'imu/{n}': v for n, v in r.columns.items()}, r.time_ns) for r in (turned, zeros))
    assert compare(zeros, turned, overlap=0.5).differences[0].max == np.inf
    assert compare(turned, zeros, overlap=0.5).differences[0].max == np.inf
    assert compare(zeros, zeros).ok


def test_a_quaternion_and_its_negative_are_the_same_orientation_but_not_the_same_bits() -> None:
    b = run_of(
        {
            f'odom/pose/q{c}': v
            for c, v in zip('xyzw', Rotation.random(101, random_state=np.random.default_rng(1)).as_quat().T)
        },
        np.arange(101) * MS,
    )
    flip = np.where(np.arange(101) % 2, -1.0, 1.0)
    a = run_of({c: flip * v for c, v in b.columns.items()}, b.time_ns)
    assert compare(a, b, tolerances=within(atol=1e-15)).ok
    assert not compare(a, b, exact=True).ok


def test_wrapped_headings_are_compared_across_the_jump_and_over_full_turns() -> None:
    """One counts on, the other wraps and is sampled between."""
    a = run(n=1001, **{'ins/yaw': lambda t: 1.1 * t + 0.01})
    t = np.arange(40) * 240 * MS + 7 * MS
    b = run_of({'ins/yaw': np.angle(np.exp(1.1j * (t * 1e-9) + 4j * np.pi))}, t)
    found = compare(a, b, overlap=0.9)
    assert found.differences[0].max == pytest.approx(0.01, abs=1e-9)


def test_a_heading_without_a_unit_from_which_turns_are_taken_is_told() -> None:
    """20 deg beside 10 deg: 10 less 4 pi are left of it, if it is taken for rad."""
    a, b = (run(**{'gps/heading': lambda t, at=at: at + 0.0 * t}) for at in (20.0, 10.0))
    found = compare(a, b)
    assert found.differences[0].max == pytest.approx(4.0 * np.pi - 10.0)
    assert found.notes[0].startswith('gps/heading has no unit and is taken as an angle in rad')
    passing = run(**{'gps/heading': lambda t: (350.0 + 40.0 * t) % 360.0})
    assert len(compare(passing, passing).notes) == 1
    assert compare(b, b).notes == ()
    assert compare(run(**{'gps/heading': lambda t: 1.0 + t}), run(**{'gps/heading': np.sin})).notes == ()


def test_commands_hold_between_their_instants() -> None:
    """Steps given at 10 Hz, recorded at 100 Hz on the other side: between two a ramp would be half a step off."""
    given = run(n=11, h_ns=100 * MS, **{'cmd_applied/steering': lambda t: np.round(10.0 * t)})
    seen = run(n=100, start_ns=5 * MS, **{'cmd_applied/steering': lambda t: np.floor(10.0 * t + 0.05 + 1e-9)})
    assert compare(given, seen, overlap=0.9).differences[0].max <= 1.0
    found = compare(
        run_of({'x/s': given['cmd_applied/steering']}, given.time_ns),
        run_of({'x/s': seen['cmd_applied/steering']}, seen.time_ns),
        overlap=0.9,
        held=frozenset(['x/s']),
    )
    assert found.differences[0].max == one(compare(given, seen, overlap=0.9), 'cmd_applied/steering').max


def test_nan_agrees_with_nan_only() -> None:
    b = run(x=lambda t: np.where(t < 0.5, np.nan, t))
    assert compare(run_of(dict(b.columns), b.time_ns), b).ok
    a = run(x=lambda t: t)
    assert not compare(a, b, tolerances=within(atol=1e9)).ok
    assert not compare(b, a, tolerances=within(atol=1e9)).ok


def test_exact_means_every_bit_every_instant_and_every_channel() -> None:
    b = run(x=np.sin, y=np.cos)
    assert compare(run(x=np.sin, y=np.cos), b, exact=True).ok
    a = run_of({'x': b['x'], 'y': b['y'].copy()}, b.time_ns)
    a['y'][50] = np.nextafter(a['y'][50], 2.0)
    found = compare(a, b, exact=True)
    assert [d.channel for d in found.differences if not d.ok] == ['y']
    assert found.differences[0].max == pytest.approx(np.spacing(b['y'][50]), rel=0.5)
    zero, minus = run(x=lambda t: 0.0 * t), run(x=lambda t: -0.0 * t)
    assert not compare(zero, minus, exact=True).ok
    assert compare(zero, minus, tolerances=within()).ok
    assert not compare(run(n=100, x=np.sin, y=np.cos), b, exact=True).ok
    assert not compare(run_of({'x': b['x']}, b.time_ns), b, exact=True).ok
    with pytest.raises(BagError, match='without --offset and --align'):
        compare(b, b, exact=True, offset=0.1)


def test_exact_finds_one_value_among_millions_and_says_where() -> None:
    """60 s at 1 kHz, 50 channels: 1e-9 in one of 3 million numbers."""
    rng = np.random.default_rng(3)
    t = np.arange(60_001) * MS
    columns = {f'topic/{k}': rng.standard_normal(t.size) for k in range(50)}
    b = Run({'topic': Series(t, columns)})
    a = Run({'topic': Series(t.copy(), {n: v.copy() for n, v in columns.items()})})
    a.series['topic'].columns['topic/31'][41_234] += 1e-9
    found = compare(a, b, exact=True)
    assert [d.channel for d in found.differences if not d.ok] == ['topic/31']
    assert found.differences[0].first == pytest.approx(41.234, abs=1e-12)
    assert found.differences[0].time == pytest.approx(41.234, abs=1e-12)
    assert found.differences[0].max == pytest.approx(1e-9, rel=1e-6)
    assert '1 of 60001 values differ, the first at 41.234 s' in found.differences[0].reasons[0]


def test_channels_are_chosen_by_pattern() -> None:
    a, b = run(**{'odom/x': np.sin, 'odom/y': np.cos}), run(**{'odom/x': np.cos, 'odom/y': np.cos, 'odom/z': np.cos})
    found = compare(a, b, channels=['odom/y'])
    assert [d.channel for d in found.differences] == ['odom/y']
    assert found.ok
    assert found.left_out == ()
    assert compare(a, b, channels=['odom/[yz]']).left_out == ('odom/z',)
    assert compare(a, b).only_in_reference == ('odom/z',)
    with pytest.raises(BagError, match=re.escape("no common channel matches 'odm/*'; did you mean 'odom/")):
        compare(a, b, channels=['odm/*'])
    with pytest.raises(BagError, match='no channel in common'):
        compare(a, run(z=np.sin))


def test_each_channel_has_its_own_tolerance(tmp_path: Path) -> None:
    file = tmp_path / 'limits.yaml'
    file.write_text(
        "tolerances:\n  'imu/*': {rtol: 0.1}\n  '*/speed': {rtol: 0, atol: 0.5, rms: 0.001}\ndefault: {rtol: 0.001}\n"
    )
    limits = load_tolerances(file)
    b = run(**{'imu/wz': np.cos, 'a/speed': lambda t: 20.0 + 0.0 * t, 'z': np.cos})
    a = run_of({'imu/wz': 1.05 * b['imu/wz'], 'a/speed': b['a/speed'] + 0.4, 'z': 1.05 * b['z']}, b.time_ns)
    found = compare(a, b, tolerances=limits)
    assert {d.channel: d.ok for d in found.differences} == {'imu/wz': True, 'a/speed': False, 'z': False}
    assert one(found, 'a/speed').reasons == ('RMS 0.02 of the scale',)


@pytest.mark.parametrize(
    ('limits', 'reason'),
    [
        ({'peak': 0.04}, 'peak differs by 0.05'),
        ({'rating': 0.999}, 'rated 0.9'),
        ({'rms': 0.01}, 'RMS 0.0'),
        ({'shift': 0.01}, None),
        ({'peak': 0.06}, None),
    ],
)
def test_peak_rating_rms_and_shift_can_be_judged(limits: dict, reason: str | None) -> None:
    b = run(n=301, x=lambda t: np.exp(-(((t - 1.0) / 0.2) ** 2)))
    a = run_of({'x': 1.05 * b['x']}, b.time_ns)
    found = compare(a, b, tolerances=within(rtol=1.0, **limits), rated=False).differences[0]
    assert found.ok is (reason is None)
    assert reason is None or reason in found.reasons[0]


@pytest.mark.parametrize(
    ('text', 'says'),
    [
        ("tolerances:\n  'x': {rtol: -1}\n", 'must be >= 0'),
        ("tolerances:\n  'x': {rating: 2}\n", 'must be in [0, 1]'),
        ("tolerances:\n  'x': {tol: 2}\n", 'tol'),
        ("tolerances:\n  'x': 2\n", 'must be a mapping'),
    ],
)
def test_a_wrong_tolerance_file_is_refused(text: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / 'limits.yaml'
    file.write_text(text)
    with pytest.raises(MbdError, match=re.escape(says)) as caught:
        load_tolerances(file)
    assert '\n' not in str(caught.value)


def test_repeats_are_compared_by_their_mean_and_its_confidence_band() -> None:
    """Repeats m - d, m, m + d: mean m, s = d, half width t_{0.975, 2} d / sqrt 3 = 4.302653 d / sqrt 3 = 2.484 d."""

    def shifted(by: float) -> Run:
        return run(x=lambda t: np.sin(3.0 * t) + by)

    repeats = [shifted(by) for by in (-0.1, 0.0, 0.1)]
    inside = compare(shifted(0.2483), *repeats, tolerances=within(1e-9))
    assert inside.ok
    band = inside.differences[0].band
    assert band is not None
    assert band.repeats == 3
    assert band.width == pytest.approx(0.1 * T_975_2 / np.sqrt(3.0), rel=1e-12)
    assert band.inside == 1.0
    assert band.within == 0.0  # beyond the largest of the repeats at every instant
    assert inside.differences[0].max == pytest.approx(0.2483, rel=1e-12)  # from the mean
    outside = compare(shifted(0.25), *repeats, tolerances=within(1e-9))
    assert not outside.ok
    assert outside.differences[0].band.inside == 0.0
    assert 'outside the band' in outside.differences[0].reasons[0]
    assert compare(shifted(0.25), *repeats, tolerances=within(atol=0.002)).ok


def test_repeats_of_which_one_is_apart_for_a_while() -> None:
    """Inside for three quarters of the time: the run leaves mean and band by a step at the end."""
    repeats = [run(x=lambda t, d=d: t + d) for d in (-0.1, 0.0, 0.1)]
    found = compare(run(n=101, x=lambda t: t + np.where(t > 0.755, 0.5, 0.0)), *repeats, tolerances=within(1e-9))
    assert found.differences[0].band.inside == pytest.approx(76 / 101)
    assert found.differences[0].band.within == pytest.approx(76 / 101)


@pytest.mark.parametrize('names', ['p/q{}', 'amcl/pose/orientation/{}', 'tf/transforms[0]/transform/rotation/{}'])
def test_a_quaternion_and_its_negative_are_one_orientation(names: str) -> None:
    """Signs that another program has otherwise: fields of PoseStamped, and of TFMessage, were compared one by one, and
    differed by 2."""
    q = Rotation.from_rotvec(np.outer(np.linspace(2.8, 3.6, 50), [0.0, 0.0, 1.0])).as_quat()
    both = (run_of({names.format(c): v for c, v in zip('xyzw', one.T)}, np.arange(50) * MS) for one in (q, -q))
    found = compare(*both, tolerances=within(atol=1e-12), channels=[names.format('*').rpartition('/')[0] + '*'])
    assert found.ok and [d.channel.rpartition('/')[2] for d in found.differences] == ['orientation']


def test_repeats_of_orientations() -> None:
    def tilted(angle: float) -> Run:
        return run_of(
            {f'p/q{c}': np.full(20, v) for c, v in zip('xyzw', Rotation.from_euler('y', angle).as_quat())},
            np.arange(20) * MS,
        )

    found = compare(tilted(0.05), *(tilted(a) for a in (-0.1, 0.0, 0.1)))
    assert found.differences[0].max == pytest.approx(0.05, abs=1e-12)
    assert found.differences[0].band.width == pytest.approx(0.1 * T_975_2 / np.sqrt(3.0), rel=1e-9)


def test_where_no_repeat_has_a_number_the_run_needs_none_either() -> None:
    """A sensor without orientation, and one that begins late; there is no band, and a run with a number there is
    outside."""
    zeros = run_of({f'imu/q{c}': np.zeros(20) for c in 'xyzw'}, np.arange(20) * MS)
    found = compare(zeros, zeros, zeros, tolerances=within(1e-9))
    assert found.ok
    late = [run_of({'x': np.where(np.arange(20) < 5, np.nan, by)}, np.arange(20) * MS) for by in (-0.1, 0.0, 0.1)]
    found = compare(late[1], *late, tolerances=within(1e-9))
    assert found.ok
    assert found.differences[0].band.width == pytest.approx(0.1 * T_975_2 / np.sqrt(3.0), rel=1e-12)
    assert found.differences[0].band.inside == 1.0
    assert (
        compare(run_of({'x': np.zeros(20)}, np.arange(20) * MS), *late, tolerances=within(1e-9)).differences[0].max
        == np.inf
    )


def test_a_count_of_steps_alone_is_compared_exactly_or_not_at_all() -> None:
    a = run(**{'cmd_applied/step': np.round, 'cmd_applied/steering': np.sin})
    assert [d.channel for d in compare(a, a).differences] == ['cmd_applied/steering']
    assert compare(a, a, exact=True, channels=['cmd_applied/step']).ok
    with pytest.raises(BagError, match=r'cmd_applied/step counts steps, .*; only --exact compares it'):
        compare(a, a, channels=['cmd_applied/step'])


def test_picture_shows_both_runs_and_the_difference(tmp_path: Path) -> None:
    a, b = run(x=np.sin, y=np.cos), run(x=lambda t: np.sin(t) + 0.1, y=np.cos)
    file = tmp_path / 'deep' / 'c.png'
    plot_comparison(compare(a, b), file)
    from matplotlib.image import imread

    pixels = imread(file)[..., :3]
    assert pixels.shape[1] > 1000
    for colour in ((0xD9, 0x5F, 0x02), (0x1B, 0x6C, 0xA8), (0x55, 0x55, 0x55)):  # run, reference, difference
        assert np.sum(np.all(np.abs(pixels - np.array(colour) / 255.0) < 0.02, axis=-1)) > 200
    with pytest.raises(BagError, match='cannot write the picture'):
        plot_comparison(compare(a, b), file / 'x.png')
