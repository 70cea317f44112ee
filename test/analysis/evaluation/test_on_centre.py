"""ISO 13674: loops of weaving that are ellipses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from drives import weaving

from mbd_sim_ros.analysis.evaluation import on_centre
from solver.errors import BagError


def test_loops_of_weaving() -> None:
    r = on_centre.judge(weaving(), on_centre.Weave())
    near = dict(rel=2e-3)  # straight lines between samples, slopes by differences over 20 ms of 5 s
    assert r['frequency'] == pytest.approx(0.2, rel=1e-6)
    assert r['periods'] == 5.0
    assert r['lateral_acceleration'] == pytest.approx(2.0, **near)
    assert r['steering_sensitivity'] == pytest.approx(2.0 / 0.3 * math.cos(0.2), **near)
    assert r['acceleration_hysteresis'] == pytest.approx(-2.0 * 2.0 * math.sin(0.2), **near)
    assert r['angle_deadband'] == pytest.approx(2.0 * 0.3 * math.sin(0.2), **near)
    assert r['speed'] == pytest.approx(27.8)
    # |da/dd| = A/D cos(u)/cos(u + p) grows with u = wt - p, which is -30 deg where a = -1; 1.3 samples of 0.7 deg are
    # 0.3 % there
    assert r['least_sensitivity'] == pytest.approx(
        2.0 / 0.3 * math.cos(math.pi / 6) / math.cos(math.pi / 6 - 0.2), rel=4e-3
    )
    assert r['yaw_rate_gain'] == pytest.approx(0.07 / 0.3 * math.cos(0.12), **near)
    assert r['yaw_rate_hysteresis'] == pytest.approx(-2.0 * 0.07 * math.sin(0.12), **near)
    w = 2.0 * math.pi * 0.2
    assert r['yaw_rate_delay'] == pytest.approx(0.12 / w, **near)
    assert r['lateral_acceleration_delay'] == pytest.approx(0.2 / w, **near)
    assert r['torque_stiffness'] == pytest.approx(3.0 / 0.3 * math.cos(0.4), **near)
    assert r['torque_hysteresis'] == pytest.approx(2.0 * 3.0 * math.sin(0.4), **near)
    assert r['torque_gradient_zero'] == pytest.approx(3.0 / 2.0 * math.cos(0.6), **near)
    assert r['torque_at_zero'] == pytest.approx(2.0 * 3.0 * math.sin(0.6), **near)
    assert r['acceleration_at_zero_torque'] == pytest.approx(-2.0 * 2.0 * math.sin(0.6), **near)
    assert r['angle_at_zero_torque'] == pytest.approx(-2.0 * 0.3 * math.sin(0.4), **near)
    # a = 1: sin(wt - p) = 1/2 on both ways; dm/da = M cos(x + 0.6)/(A cos x) at x = pi/6 and 5 pi/6, and at -1
    # likewise: the mean
    ways = [
        3.0 * math.cos(x + 0.6) / (2.0 * math.cos(x))
        for x in (math.pi / 6, 5 * math.pi / 6, -math.pi / 6, 7 * math.pi / 6)
    ]
    assert r['torque_gradient_level'] == pytest.approx(np.mean(ways), **near)


@pytest.mark.filterwarnings('error')
def test_what_is_not_passed_through_has_no_figures() -> None:
    """A lateral acceleration from 2 to 6 m/s^2, of a sensor with an offset, or one that never comes to the level; the
    rest is judged."""
    shifted = weaving()
    shifted.values['lateral_acceleration'] += 4.0
    r = on_centre.judge(shifted, on_centre.Weave())
    assert all(
        math.isnan(r[name])
        for name in ('least_sensitivity', 'angle_deadband', 'torque_gradient_zero', 'torque_gradient_level')
    )
    assert r['yaw_rate_gain'] == pytest.approx(0.07 / 0.3 * math.cos(0.12), rel=2e-3)
    small = weaving()
    small.values['lateral_acceleration'] *= 0.4
    r = on_centre.judge(small, on_centre.Weave())
    assert math.isnan(r['torque_gradient_level'])
    assert math.isnan(r['least_sensitivity'])  # it was next to zero, where the lateral acceleration turns back
    assert [note.partition(':')[0] for note in r.notes] == [
        'the lateral acceleration swings from -0.8 to 0.8 m/s^2, not beyond 1 m/s^2 to both sides'
    ]
    assert on_centre.judge(weaving(), on_centre.Weave()).notes == ()
    assert r['torque_gradient_zero'] == pytest.approx(3.0 / 0.8 * math.cos(0.6), rel=2e-3)
    # between two samples
    assert math.isnan(on_centre.judge(weaving(), on_centre.Weave(level=5e-4))['least_sensitivity'])


def test_what_does_not_weave_is_refused() -> None:
    with pytest.raises(BagError, match=r'weaving is 0\.1 to 0\.5 Hz'):
        on_centre.judge(weaving(1.0), on_centre.Weave())
    still = weaving()
    still.values['steering'][:] = 0.0
    with pytest.raises(BagError, match='no weaving'):
        on_centre.judge(still, on_centre.Weave())
