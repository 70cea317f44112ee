"""ISO 3888: distances to the cones."""

from __future__ import annotations

import numpy as np
import pytest
from drives import even, made

from mbd_sim_ros.analysis.evaluation import lane_change
from mbd_sim_ros.analysis.evaluation.figures import Result
from mbd_sim_ros.analysis.evaluation.signals import Signals
from solver.errors import BagError
from solver.inputs.driver import DoubleLaneChange


def through(standard: str, aside: float = 0.0, width: float = 1.8, rate: float = 200.0) -> Signals:
    """A car that follows the middle of the lanes at 20 m/s, its body along the path, shifted by `aside` to the left."""
    path = DoubleLaneChange(standard=standard, width=width, start=30.0)  # type: ignore[arg-type]
    t = even(9.0, rate)
    x = 20.0 * t
    y = np.array([path.lateral(v) for v in x])
    return made(
        t,
        x=x,
        y=y + aside,
        heading=np.arctan(np.gradient(y, x)),
        speed=20.0 - 0.1 * t,
        yaw_rate=0.1,
        lateral_acceleration=1.0,
        steering=-0.7,
        sideslip_angle=0.02,
        roll=-0.03,
    )


@pytest.mark.parametrize('part', ['1', '2'])
def test_clearance_in_the_lanes(part: str) -> None:
    """In the middle of a lane a straight body is (lane - width)/2 away from its cones; aside, less by that."""
    p = lane_change.LaneChange(width=1.8, start=30.0, length=4.0)
    r = lane_change.judge(through(f'iso_3888_{part}'), p, f'iso_3888_{part}')
    gates = DoubleLaneChange(standard=f'iso_3888_{part}', width=1.8, start=30.0).gates  # type: ignore[arg-type]
    assert r['entry_speed'] == pytest.approx(20.0 - 0.1 * 1.5)
    assert r['exit_speed'] == pytest.approx(20.0 - 0.1 * gates[-1].end / 20.0)
    widest = 0.5 * (gates[0].left - gates[0].right - 1.8)
    assert 0.0 < r['clearance_1'] <= widest + 1e-9
    assert r['time'] == pytest.approx((gates[-1].end - gates[0].begin) / 20.0)
    for k, gate in enumerate(gates, 1):  # where the lanes are the car is straight but for their ends
        assert 0.0 < r[f'clearance_{k}'] <= 0.5 * (gate.left - gate.right - 1.8) + 1e-9
    largest = {name: r[f'largest_{name}'] for name in ('acceleration', 'yaw_rate', 'steering', 'sideslip', 'roll')}
    assert largest == pytest.approx(
        {'acceleration': 1.0, 'yaw_rate': 0.1, 'steering': 0.7, 'sideslip': 0.02, 'roll': 0.03}
    )
    assert r.passed is True
    shifted = lane_change.judge(through(f'iso_3888_{part}', 0.5), p, f'iso_3888_{part}')
    assert shifted['clearance_1'] == pytest.approx(widest - 0.5, abs=0.02)  # negative: cones are hit
    assert shifted.passed is False


@pytest.mark.parametrize('part', ['1', '2'])
def test_places_too_far_apart_for_the_distances_are_told(part: str) -> None:
    """0.4 m between two places at 50 Hz: corners pass the ends of the lanes between them. 4 m at 5 Hz: what is told is
    more than what the distances are beside those of 1 kHz, and not ten times that."""
    p = lane_change.LaneChange(width=1.8, start=30.0, length=4.0)
    fine = through(f'iso_3888_{part}', rate=1000.0)

    def judged(every: int) -> Result:
        s = Signals(
            place='',
            t=fine.t[::every],
            values={name: values[::every] for name, values in fine.values.items()},
            notes=[],
        )
        return lane_change.judge(s, p, f'iso_3888_{part}')

    exact, often, seldom = (judged(every) for every in (1, 20, 200))
    assert not exact.notes and not often.notes
    (note,) = seldom.notes
    text, known, _ = note.rsplit(' ', 2)
    assert text == 'places are recorded every 0.2 s: distances to the cones are not known better than to'
    near, beside = (
        max(abs(exact[f'clearance_{k}'] - one[f'clearance_{k}']) for k in (1, 2, 3)) for one in (often, seldom)
    )
    assert near < 1e-3
    assert beside < float(known) < 10.0 * beside


def test_a_cone_that_the_side_hits_behind_the_corners_counts() -> None:
    """Straight through lane 1, turned by 30 deg about the place of its last left cone, which is 0.1 m inside the
    body."""
    gate = DoubleLaneChange(width=1.8, start=0.0).gates[0]
    p = lane_change.LaneChange(width=1.8, start=0.0, length=4.0)
    heading = np.full(3, np.pi / 6.0)
    n = np.array([-np.sin(np.pi / 6.0), np.cos(np.pi / 6.0)])
    centre = np.array([gate.end, gate.left]) - 0.8 * n
    x, y = np.array([[0.0, 5.0, centre[0]], [0.0, 0.0, centre[1]]])
    straight = np.array([0.0, 0.0, np.pi / 6.0])
    found = lane_change.distances(gate, x, y, np.where(np.arange(3) < 2, 0.0, heading), p, 1.8)
    assert found <= -0.1 + 1e-9
    assert straight[2] == heading[2]


def test_who_does_not_pass_the_track_is_refused() -> None:
    s = through('iso_3888_1')
    with pytest.raises(
        BagError, match=r'does not pass the track: .*; it lasts 9 s, a slow car takes longer .*--set duration='
    ):
        lane_change.judge(s, lane_change.LaneChange(width=1.8, start=100.0), 'iso_3888_1')
    with pytest.raises(BagError, match=r'give width=\.\.\. start=\.\.\. \(by --set\)'):
        lane_change.judge(s, lane_change.LaneChange(start=100.0), 'iso_3888_1')
