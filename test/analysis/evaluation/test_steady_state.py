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
    assert r['mean'] == pytest.approx({'constant_radius': 100.0, 'constant_steering': 0.4, 'constant_speed': 22.0}[method], rel=1e-6)
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
    # after the low pass about 50 independent samples remain, with noise of 0.3 mrad in roll and 0.04 m/s^2: 0.9 % for a standard deviation
    assert r['understeer_gradient'] == pytest.approx(U, rel=0.04)
    assert r['roll_gradient'] == pytest.approx(ROLL, rel=0.04)


@pytest.mark.parametrize(('times', 'outcome'), [(1.0, 'steady'), (10.0, 'note'), (40.0, 'refused')])  # of 0.12 m/s^2 in a second
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
