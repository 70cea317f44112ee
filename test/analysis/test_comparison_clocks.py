"""Comparing runs of different clocks and lengths: what is added to their stamps, and how much of their time both
have."""

from __future__ import annotations

import numpy as np
import pytest
from scalars import joined, run, run_of

from mbd_sim_ros.analysis.comparison import compare
from mbd_sim_ros.analysis.tolerances import Tolerance, Tolerances
from mbd_sim_ros.bags.reader import Run
from solver.errors import BagError

MS = 1_000_000


def within(rtol: float = 0.0, atol: float = 0.0) -> Tolerances:
    return Tolerances(default=Tolerance(rtol=rtol, atol=atol), floor=0.0)


def test_an_offset_is_added_to_the_stamps_of_the_reference() -> None:
    a = run(n=501, x=lambda t: np.sin(3.0 * t))
    b = run(n=501, x=lambda t: np.sin(3.0 * (t + 0.25)))  # ahead by 0.25 s
    found = compare(a, b, offset=0.25, tolerances=within(atol=1e-12))
    assert found.ok
    assert found.offsets == (0.25,)
    assert found.differences[0].overlap == pytest.approx(0.95, abs=0.004)


def test_recordings_with_the_time_of_day_count_from_their_first_stamp() -> None:
    a = run(x=np.sin)
    b = run(start_ns=1_700_000_000 * 10**9, x=np.sin)
    found = compare(a, b, tolerances=within())
    assert found.ok
    assert found.origins == (0.0, 1_700_000_000.0)
    later = run(start_ns=1_700_009_000 * 10**9, x=np.sin)
    assert compare(a, b, later, tolerances=within()).ok
    assert compare(b, later, tolerances=within()).origins == (1_700_000_000.0, 1_700_009_000.0)
    together = compare(
        b, run(n=51, start_ns=1_700_000_000 * 10**9 + 500 * MS, x=lambda t: np.sin(t + 0.5)), overlap=0.4
    )
    assert together.origins == (0.0, 0.0)  # two recordings of the same drive keep their stamps
    assert together.differences[0].max < 1e-12
    with pytest.raises(BagError, match='do not overlap'):
        compare(a, run(start_ns=60 * 10**9, x=np.sin))


def test_what_one_recording_lost_meanwhile_is_not_compared_and_that_is_told() -> None:
    """From 4 to 6 s the run has no samples, and there the reference is somewhere else: nothing of that is among the
    differences."""
    t = np.arange(1001) * 10 * MS
    inside = (t > 4000 * MS) & (t < 6000 * MS)
    whole = run_of({'x': np.sin(t * 1e-9) + np.where(inside, 5.0, 0.0)}, t)
    lossy = run_of({'x': np.sin(t * 1e-9)[~inside]}, t[~inside])
    for pair in ((lossy, whole), (whole, lossy), (whole, lossy, whole), (whole, lossy, lossy)):
        found = compare(*pair, tolerances=within(1e-9))
        assert found.differences[0].overlap == pytest.approx(0.8, abs=1e-9)
        assert not found.ok
        assert 'only 80 % of the time is in both' in found.differences[0].reasons
        assert compare(*pair, tolerances=within(1e-9), overlap=0.79).ok
    later = run_of({'x': np.sin(t * 1e-9)[~inside][1:]}, t[~inside][1:])
    assert compare(lossy, later, tolerances=within(1e-9)).ok  # neither has anything there
    few = np.delete(np.arange(1001), [300, 301, 600])
    assert compare(
        run_of({'x': np.sin(t * 1e-9)[few]}, t[few]), run_of({'x': np.sin(t * 1e-9)}, t), tolerances=within(1e-9)
    ).ok


def test_a_command_lasts_as_long_as_no_other_comes() -> None:
    """Sent when it changes, and every 10 ms: no time is lost."""
    t = np.arange(1001) * 10 * MS
    steps = run_of({'cmd_applied/steering': [0.0, 1.0, 1.0]}, np.array([0, 400, 1000]) * 10 * MS)
    steady = run_of({'cmd_applied/steering': np.where(t >= 4000 * MS, 1.0, 0.0)}, t)
    assert compare(steps, steady, tolerances=within()).ok


def test_an_offset_that_brings_the_stamps_together_is_added_to_them_as_they_are() -> None:
    """The reference begins 0.25 s into the run, by a clock with the time of day; and a lap that was driven 90 s
    later."""
    epoch = 1_700_000_000 * 10**9
    a = run(n=501, x=lambda t: np.sin(3.0 * t))
    b = run(n=401, start_ns=epoch + 250 * MS, x=lambda t: np.sin(3.0 * (t + 0.25)))
    found = compare(a, b, offset=-1.7e9, tolerances=within(atol=1e-12), overlap=0.5)
    assert found.ok
    assert (found.offsets, found.origins) == ((-1.7e9,), (0.0, 0.0))
    first, later = (run(n=501, start_ns=epoch + start * 10**9, x=np.sin) for start in (0, 90))
    assert compare(first, later, offset=-90.0, tolerances=within(atol=1e-12)).ok
    assert compare(first, later, tolerances=within(atol=1e-12)).origins == (1.7e9, 1.70000009e9)


def test_offset_is_found_for_every_reference() -> None:
    def swept(shift: float, start_ns: int = 0) -> Run:
        return run(
            n=1001,
            start_ns=start_ns,
            **{'imu/wz': lambda t: np.sin((t + shift) ** 2), 'imu/ay': lambda t: np.cos(2.0 * (t + shift))},
        )

    found = compare(
        swept(0.0), swept(0.137, 1_700_000_000 * 10**9), swept(-0.4), align='imu/wz', tolerances=within(atol=0.02)
    )
    assert found.offsets == pytest.approx((0.137, -0.4), abs=1e-3)
    assert all(f.correlation > 0.99 for f in found.found)
    assert next(d for d in found.differences if d.channel == 'imu/ay').max < 0.01
    with pytest.raises(BagError, match='--align imu/wy: no such channel in both'):
        compare(swept(0.0), swept(0.1), align='imu/wy')


def test_a_topic_that_shares_no_time_is_told_and_the_others_are_compared() -> None:
    """One message each, at 0.2 and at 0.5 s: nothing at all was compared."""
    a, b = (joined(run(x=np.sin), run_of({'gear': [3.0]}, np.array([at * MS]))) for at in (200, 500))
    found = compare(a, b)
    assert [d.channel for d in found.differences] == ['x'] and found.differences[0].ok
    assert not found.ok and found.problems[0].startswith(
        'gear: the runs do not overlap in time (0.2 to 0.2 s and 0.5 to 0.5 s)'
    )
    minded = compare(a, b, overlap=0.0)
    assert minded.ok and minded.notes == found.problems
    with pytest.raises(BagError, match='gear: the runs do not overlap in time'):
        compare(a, b, channels=['gear'])
