"""ISO 4138: gradients of a car whose steady state is exactly linear."""

from __future__ import annotations

import math

import numpy as np
import pytest
from drives import RATIO, ROLL, SLIP, TORQUE, L, U, circling

from mbd_sim_ros.analysis.evaluation import steady_state
from solver.errors import BagError


@pytest.mark.parametrize('side', [1.0, -1.0])
@pytest.mark.parametrize('method', ['constant_radius', 'constant_steering', 'constant_speed'])
def test_gradients_of_a_linear_car(method: str, side: float) -> None:
    p = steady_state.SteadyState(wheelbase=L, ratio=RATIO, high=3.0)
    r = steady_state.judge(circling(method, side), p, method)
    smoothing = dict(rel=2e-3)  # the low pass bends the curve a little where it begins
    assert r['understeer_gradient'] == pytest.approx(U, **smoothing)
    assert r['roll_gradient'] == pytest.approx(ROLL, **smoothing)
    assert r['sideslip_gradient'] == pytest.approx(SLIP, **smoothing)
    assert r['steering_torque_gradient'] == pytest.approx(TORQUE, **smoothing)
    assert r['mean'] == pytest.approx(
        {'constant_radius': 100.0, 'constant_steering': 0.4, 'constant_speed': 22.0}[method], rel=1e-6
    )
    assert r['spread'] < 1e-6
    assert r['largest_acceleration'] == pytest.approx(
        circling(method)['lateral_acceleration'].max(), rel=0.01
    )  # the low pass lags at the end
    if method == 'constant_radius':
        assert r['steering_wheel_gradient'] == pytest.approx(RATIO * U, **smoothing)
    if method == 'constant_speed':
        assert r['reference_steer_gradient'] == pytest.approx(L / 22.0**2, **smoothing)
    if method == 'constant_steering':
        assert r['steering_wheel_gradient'] == pytest.approx(0.0, abs=1e-9)
        assert r['reference_steer_gradient'] == pytest.approx(-U, **smoothing)
    assert r.passed is None


def test_noise_does_not_bend_the_gradients(rng: np.random.Generator) -> None:
    s = circling('constant_speed')
    for name, size in (('yaw_rate', 0.014), ('steering', 0.005), ('roll', 0.002)):
        s.values[name] += size * rng.standard_normal(s.t.size)
    r = steady_state.judge(s, steady_state.SteadyState(wheelbase=L, ratio=RATIO), 'constant_speed')
    # after the low pass about 50 independent samples remain, with noise of 0.3 mrad in roll and 0.04 m/s^2: 0.9 % for a
    # standard deviation
    assert r['understeer_gradient'] == pytest.approx(U, rel=0.04)
    assert r['roll_gradient'] == pytest.approx(ROLL, rel=0.04)


# of 0.12 m/s^2 in a second
@pytest.mark.parametrize(('times', 'outcome'), [(1.0, 'steady'), (10.0, 'note'), (40.0, 'refused')])
def test_a_steering_wheel_that_is_turned_fast_is_no_steady_state(times: float, outcome: str) -> None:
    s = circling('constant_speed')
    s.t = s.t / times
    p = steady_state.SteadyState(wheelbase=L, ratio=RATIO)
    if outcome == 'refused':
        with pytest.raises(BagError, match='within 1 s; turn the steering wheel slowly'):
            steady_state.judge(s, p, 'constant_speed')
    else:
        notes = steady_state.judge(s, p, 'constant_speed').notes
        assert any('hardly a steady state' in note for note in notes) == (outcome == 'note')


def test_circles_that_are_none_are_refused() -> None:
    with pytest.raises(BagError, match='not driven with constant speed: it varies by'):
        steady_state.judge(circling('constant_radius'), steady_state.SteadyState(), 'constant_speed')
    slow = circling('constant_radius')
    slow.values['yaw_rate'] *= 0.1
    with pytest.raises(BagError, match='no steady-state circular driving'):
        steady_state.judge(slow, steady_state.SteadyState(), 'constant_radius')
    r = steady_state.judge(circling('constant_radius'), steady_state.SteadyState(), 'constant_radius')
    assert math.isnan(r['understeer_gradient'])  # wheelbase and ratio are not known: a note, no number
    assert any('wheelbase' in note for note in r.notes)
    assert r['roll_gradient'] == pytest.approx(ROLL, rel=2e-3)


@pytest.mark.parametrize('side', [1.0, -1.0])
def test_the_entry_into_a_circle_is_no_part_of_it(side: float) -> None:
    """40 m at 8 m/s: 1.6 m/s^2 in the circle, which the car enters within 2 s and with 15 % too much curvature on the
    way."""
    s = circling('constant_radius', side)
    v = np.clip(8.0 + 0.5 * (s.t - 6.0), 8.0, None)
    k = np.interp(s.t, [1.0, 2.2, 3.0, 3.5], [0.0, 1.15, 1.15, 1.0]) / 40.0
    a, moving = v * v * k, np.interp(s.t, [1.0, 2.0], [0.0, 1.0])
    s.values |= {
        'speed': v,
        'yaw_rate': side * v * k,
        'steering': side * RATIO * (L * k + U * a),
        'roll': side * ROLL * a * moving,
    }
    r = steady_state.judge(s, steady_state.SteadyState(wheelbase=L, ratio=RATIO), 'constant_radius')
    assert r['mean'] == pytest.approx(40.0, rel=3e-3)
    assert r['spread'] < 0.01
    assert r['understeer_gradient'] == pytest.approx(U, rel=0.02)


def test_a_circle_that_begins_too_fast_is_told() -> None:
    s = circling('constant_radius')
    v = 17.0 + 0.1 * s.t
    s.values |= {'speed': v, 'yaw_rate': 0.01 * v}
    with pytest.raises(
        BagError,
        match=r'between 1 and 4 m/s\^2 are not passed through \(largest 4.41 m/s\^2, steady from 2.89 m/s\^2 on\)',
    ):
        steady_state.judge(s, steady_state.SteadyState(), 'constant_radius')
