"""Every figure of an evaluation on signals whose figures are known in closed form."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scalars import write_scalars
from scipy import signal
from scipy.spatial.transform import Rotation

from mbd_sim_ros.analysis.evaluation import braking, judging, lane_change, on_centre, ride, sine_with_dwell, steady_state, transient
from mbd_sim_ros.analysis.evaluation.figures import Result
from mbd_sim_ros.analysis.evaluation.measures import crossing, fundamental, line, low_passed, peak
from mbd_sim_ros.analysis.evaluation.registry import EVALUATIONS, called, names
from mbd_sim_ros.analysis.evaluation.signals import WAYS, Signals, signals
from mbd_sim_ros.bags.reader import Run, Series
from mbd_sim_ros.commands.main import main
from solver.errors import BagError, SpecError
from solver.inputs.driver import DoubleLaneChange

G = 9.80665


def made(t: np.ndarray, **values: np.ndarray | float) -> Signals:
    """Signals from arrays; numbers hold all the time."""
    return Signals(place='bag', t=t, values={k: np.broadcast_to(np.asarray(v, float), t.shape).copy() for k, v in values.items()}, notes=[])


def even(seconds: float, rate: float = 200.0) -> np.ndarray:
    return np.arange(round(seconds * rate) + 1) / rate


# -- measures ---------------------------------------------------------------------------------------------------------------


def test_crossings_and_peaks_lie_between_samples() -> None:
    t = even(2.0, 50.0)
    assert crossing(t, 3.0 * t, 1.0) == pytest.approx(1.0 / 3.0, abs=1e-12)
    assert math.isnan(crossing(t, t, 5.0))
    when, top = peak(t, 2.0 - (t - 0.777) ** 2)  # a parabola is met exactly
    assert (when, top) == pytest.approx((0.777, 2.0), abs=1e-12)
    assert line(t, 3.0 - 2.0 * t) == pytest.approx((-2.0, 3.0))
    c = fundamental(t, 1.5 + 2.0 * np.cos(2.0 * np.pi * t - 0.3), 1.0)
    assert abs(c) == pytest.approx(2.0)
    assert np.angle(c) == pytest.approx(-0.3)


def test_the_low_pass_has_the_gain_of_twelve_poles_and_no_phase() -> None:
    """|H| of two passes of order 6 is 1/(1 + (f/f_c)^12); the bilinear transform bends frequencies by (pi f/rate)^2/3 at most."""
    t = even(20.0, 500.0)
    middle = (t > 8.0) & (t < 12.0)
    for f in (3.0, 6.0, 9.0):
        c = fundamental(t[middle], low_passed(np.cos(2.0 * np.pi * f * t), 500.0, 6.0)[middle], f)
        assert abs(c) == pytest.approx(1.0 / (1.0 + (f / 6.0) ** 12), rel=0.05)
        assert abs(np.angle(c)) < 1e-3


# -- signals ----------------------------------------------------------------------------------------------------------------


def pose(t: np.ndarray, heading: np.ndarray, roll: float, speed: float) -> dict[str, np.ndarray]:
    q = Rotation.from_euler('ZYX', np.column_stack([heading, np.zeros_like(t), np.full_like(t, roll)])).as_quat()
    body = {f'odom/pose/{n}': v for n, v in zip(('x', 'y', 'z'), (speed * t, 0.0 * t, 0.0 * t))}
    body |= {f'odom/pose/q{n}': v for n, v in zip('xyzw', q.T)}
    return body


def test_signals_come_from_topics_of_different_rates_on_uneven_stamps(rng: np.random.Generator) -> None:
    """A body that rolls by 0.05 rad and turns; the specific force holds what gravity adds, the lateral acceleration does not."""
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
    body |= {f'odom/twist/{n}': np.full_like(t1, x) for n, x in zip(('vx', 'vy', 'vz', 'wx', 'wy', 'wz'), (v, 0.0, 0.0, *w))}
    stamps = [EPOCH + np.round(t * 1e9).astype(np.int64) for t in (t1, t2)]
    run = Run(
        {
            'odom': Series(stamps[0], body),
            'imu': Series(stamps[1], {f'imu/{n}': np.full_like(t2, x) for n, x in zip(('ax', 'ay', 'az'), force)}),
            'cmd_applied': Series(
                stamps[1], {'cmd_applied/steering': 0.1 * t2, 'cmd_applied/brake_torque': np.where(t2 < 5.0, 0.0, 100.0)}
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
    with pytest.raises(BagError, match='has no hand torque: the channel steering_torque or joint_states/steering_wheel/effort is needed'):
        signals(run, 'bag', ('steering_torque',))
    del run.series['odom']
    again = signals(run, 'bag', ('lateral_acceleration',))
    assert again['lateral_acceleration'] == pytest.approx(force[1])
    assert 'no orientation' in again.notes[0]


EPOCH = 1_700_000_000 * 10**9


def test_gaps_are_told() -> None:
    t = even(10.0, 100.0)
    keep = (t < 4.0) | (t > 4.5)
    run = Run({'imu': Series(np.round(t[keep] * 1e9).astype(np.int64), {'imu/wz': t[keep]})})
    s = signals(run, 'bag', ('yaw_rate',))
    assert '0.51 s without samples' in s.notes[0] or '0.52 s without samples' in s.notes[0]
    with pytest.raises(BagError, match='ten samples'):
        signals(Run({'imu': Series(np.arange(5), {'imu/wz': np.zeros(5)})}), 'bag', ('yaw_rate',))


# -- ISO 4138 ---------------------------------------------------------------------------------------------------------------

L, RATIO, U, ROLL, SLIP, TORQUE = 2.7, 16.0, 0.003, 0.008, -0.004, 1.2


def circling(method: str, side: float = 1.0) -> Signals:
    """A car whose steady state is exactly linear: d/i = L k + U a, roll, sideslip and torque in proportion to a."""
    t = even(40.0, 100.0)
    if method == 'constant_radius':
        v = 8.0 + 0.3 * t
        k = np.full_like(t, 0.01)
    elif method == 'constant_speed':
        v = np.full_like(t, 22.0)
        k = 0.00025 * t
    else:
        v = 8.0 + 0.3 * t
        k = 0.4 / RATIO / (L + U * v * v)
    a = v * v * k
    return made(
        t, speed=v, yaw_rate=side * k * v, lateral_acceleration=side * a, steering=side * RATIO * (L * k + U * a), roll=side * ROLL * a,
        sideslip_angle=side * (0.01 + SLIP * a), steering_torque=side * (0.5 + TORQUE * a),
    )  # fmt: skip


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
    if method == 'constant_radius':
        assert r['steering_wheel_gradient'] == pytest.approx(RATIO * U, **smoothing)
        assert r['mean'] == pytest.approx(100.0, rel=1e-6)
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


# -- ISO 7401 ---------------------------------------------------------------------------------------------------------------


def second_order(t: np.ndarray, gain: float, f: float, damping: float) -> np.ndarray:
    """Response of gain w^2/(s^2 + 2 D w s + w^2) to a unit step at t = 0."""
    w = 2.0 * np.pi * f
    wd = w * np.sqrt(1.0 - damping**2)
    since = np.maximum(t, 0.0)
    return gain * (1.0 - np.exp(-damping * w * since) * (np.cos(wd * since) + damping * w / wd * np.sin(wd * since)))


def stepped(side: float = 1.0, rate: float = 500.0) -> Signals:
    t = even(7.0, rate)
    since = t - 2.0
    rise = 0.1
    d = side * 0.5 * np.clip(since / rise + 0.5, 0.0, 1.0)
    yaw, lateral = (side * second_order(since, g, f, damping) for g, f, damping in ((0.3, 1.2, 0.6), (4.0, 0.9, 0.8)))
    return made(
        t,
        steering=d + 0.01,
        speed=22.0,
        yaw_rate=yaw,
        lateral_acceleration=lateral,
        sideslip_angle=side * second_order(since, -0.02, 1.0, 0.7),
    )


@pytest.mark.parametrize('side', [1.0, -1.0])
def test_step_response_of_second_order(side: float) -> None:
    """Peak at pi/w_d, overshoot exp(-pi D/sqrt(1 - D^2)); the response time solves the closed form; half the step is at t = 2 s."""
    r = transient.judge_step(stepped(side), transient.StepSteer())
    assert r['speed'] == pytest.approx(22.0)
    assert r['steering'] == pytest.approx(side * 0.5)
    assert r['steering_rise'] == pytest.approx(0.08, abs=1e-6)
    for name, gain, f, damping in (('yaw_rate', 0.3, 1.2, 0.6), ('lateral_acceleration', 4.0, 0.9, 0.8)):
        w, root = 2.0 * np.pi * f, np.sqrt(1.0 - damping**2)
        fine = np.linspace(0.0, 1.0, 200_001)
        ninety = fine[np.argmax(second_order(fine, 1.0, f, damping) >= 0.9)]
        forgotten = 2.0 * math.exp(-damping * w * 2.0)  # of the response, two seconds after the step
        assert r[f'{name}_steady'] == pytest.approx(side * gain, rel=forgotten)
        assert r[f'{name}_response_time'] == pytest.approx(ninety, abs=2e-4)
        assert r[f'{name}_peak_time'] == pytest.approx(math.pi / (w * root), abs=1e-3)
        assert r[f'{name}_overshoot'] == pytest.approx(math.exp(-math.pi * damping / root), abs=2e-3)
    assert r['yaw_rate_gain'] == pytest.approx(0.6, rel=1e-3)
    assert r['lateral_acceleration_gain'] == pytest.approx(8.0, rel=1e-3)
    assert r['tb_factor'] == pytest.approx(0.02 * math.pi / (2.0 * np.pi * 1.2 * 0.8), rel=2e-3)


def test_what_is_no_step_is_refused() -> None:
    t = even(8.0)
    still = made(t, steering=0.01 * t, speed=20.0, yaw_rate=0.0, lateral_acceleration=0.0)
    with pytest.raises(BagError, match='no step of the steering wheel in it'):
        transient.judge_step(still, transient.StepSteer())
    wave = made(t, steering=0.5 * np.sin(2.0 * np.pi * 0.5 * t), speed=20.0, yaw_rate=0.0, lateral_acceleration=0.0)
    with pytest.raises(BagError, match='not held'):
        transient.judge_step(wave, transient.StepSteer())
    short = stepped()
    short = Signals(place='bag', t=short.t[:1700], values={k: v[:1700] for k, v in short.values.items()}, notes=[])
    with pytest.raises(BagError, match=r'ends 1.* s behind the step'):
        transient.judge_step(short, transient.StepSteer())


def answered(x: np.ndarray, rate: float, gain: float, f: float, damping: float) -> np.ndarray:
    w = 2.0 * np.pi * f
    system = signal.cont2discrete(([gain * w * w], [1.0, 2.0 * damping * w, w * w]), 1.0 / rate, 'foh')
    return signal.lfilter(system[0].ravel(), system[1], x)


@pytest.mark.parametrize('kind', ['random', 'sweep'])
def test_frequency_response_of_second_order(kind: str, rng: np.random.Generator) -> None:
    rate, seconds = 100.0, 240.0
    t = even(seconds, rate)
    if kind == 'random':
        x = 0.3 * signal.sosfilt(signal.butter(2, 4.0, fs=rate, output='sos'), rng.standard_normal(t.size))
    else:
        x = 0.3 * np.sin(2.0 * np.pi * (0.05 * t + 0.5 * 3.5 / seconds * t * t))
    yaw, lateral = answered(x, rate, 0.3, 1.2, 0.6), answered(x, rate, 8.0, 0.9, 0.8)
    r = transient.judge_frequencies(
        made(t, steering=x, speed=22.0, yaw_rate=yaw, lateral_acceleration=lateral), transient.FrequencyResponse()
    )
    for name, gain, f, damping in (('yaw_rate', 0.3, 1.2, 0.6), ('lateral_acceleration', 8.0, 0.9, 0.8)):

        def H(at: float, gain: float = gain, f: float = f, damping: float = damping) -> complex:
            return gain / (1.0 - (at / f) ** 2 + 2j * damping * at / f)

        assert r[f'{name}_static_gain'] == pytest.approx(abs(H(0.2)), rel=0.01)
        assert r[f'{name}_gain_1hz'] == pytest.approx(abs(H(1.0)), rel=0.02)  # resolution of 0.1 Hz
        assert r[f'{name}_gain_2hz'] == pytest.approx(abs(H(2.0)), rel=0.02)
        assert r[f'{name}_phase_1hz'] == pytest.approx(np.angle(H(1.0)), abs=0.02)
        assert r[f'{name}_delay_1hz'] == pytest.approx(-np.angle(H(1.0)) / (2.0 * np.pi), abs=4e-3)
        down = next(k for k in np.arange(0.2, 4.0, 1e-3) if abs(H(k)) < abs(H(0.2)) / math.sqrt(2.0))
        assert r[f'{name}_bandwidth'] == pytest.approx(down, rel=0.02)
        assert r[f'{name}_least_coherence'] > 0.98
    top = 1.2 * math.sqrt(1.0 - 2.0 * 0.36)
    assert r['yaw_rate_peak_frequency'] == pytest.approx(top, abs=0.11)
    assert r['yaw_rate_peak_ratio'] == pytest.approx(
        1.0 / (2.0 * 0.6 * 0.8) / abs(1.0 / (1.0 - (0.2 / 1.2) ** 2 + 2j * 0.6 * 0.2 / 1.2)), rel=0.01
    )


def test_noise_lowers_the_coherence_as_it_must(rng: np.random.Generator) -> None:
    """Independent noise of the power of the response: coherence 1/2 at every frequency where both are white."""
    t = even(400.0, 50.0)
    x = 0.3 * rng.standard_normal(t.size)
    y = x + 0.3 * rng.standard_normal(t.size)
    r = transient.judge_frequencies(made(t, steering=x, speed=22.0, yaw_rate=y, lateral_acceleration=x), transient.FrequencyResponse())
    assert 0.25 < r['yaw_rate_least_coherence'] < 0.5
    assert r['lateral_acceleration_least_coherence'] == pytest.approx(1.0)
    assert any('coherence' in note for note in r.notes)
    with pytest.raises(BagError, match='does not excite'):
        transient.judge_frequencies(
            made(t, steering=np.sin(2.0 * np.pi * 0.2 * t), speed=20.0, yaw_rate=0.0, lateral_acceleration=0.0),
            transient.FrequencyResponse(),
        )


# -- ISO 13674 --------------------------------------------------------------------------------------------------------------


def weaving(f: float = 0.2) -> Signals:
    """Ellipses: d = D sin wt, a = A sin(wt - p), r = R sin(wt - q), m = M sin(wt + u); 6.3 periods."""
    t = even(32.0, 100.0) - 0.5
    w = 2.0 * np.pi * f
    return made(
        t, steering=0.3 * np.sin(w * t), speed=27.8, lateral_acceleration=2.0 * np.sin(w * t - 0.2), yaw_rate=0.07 * np.sin(w * t - 0.12),
        steering_torque=3.0 * np.sin(w * t + 0.4),
    )  # fmt: skip


def test_loops_of_weaving() -> None:
    r = on_centre.judge(weaving(), on_centre.Weave())
    near = dict(rel=2e-3)  # straight lines between samples, slopes by differences over 20 ms of 5 s
    assert r['frequency'] == pytest.approx(0.2, rel=1e-6)
    assert r['periods'] == 5.0
    assert r['lateral_acceleration'] == pytest.approx(2.0, **near)
    assert r['steering_sensitivity'] == pytest.approx(2.0 / 0.3 * math.cos(0.2), **near)
    assert r['acceleration_hysteresis'] == pytest.approx(-2.0 * 2.0 * math.sin(0.2), **near)
    assert r['angle_deadband'] == pytest.approx(2.0 * 0.3 * math.sin(0.2), **near)
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
    # a = 1: sin(wt - p) = 1/2 on both ways; dm/da = M cos(x + 0.6)/(A cos x) at x = pi/6 and 5 pi/6, and at -1 likewise: the mean
    ways = [3.0 * math.cos(x + 0.6) / (2.0 * math.cos(x)) for x in (math.pi / 6, 5 * math.pi / 6, -math.pi / 6, 7 * math.pi / 6)]
    assert r['torque_gradient_level'] == pytest.approx(np.mean(ways), **near)


def test_what_does_not_weave_is_refused() -> None:
    with pytest.raises(BagError, match=r'weaving is 0\.1 to 0\.5 Hz'):
        on_centre.judge(weaving(1.0), on_centre.Weave())
    still = weaving()
    still.values['steering'][:] = 0.0
    with pytest.raises(BagError, match='no weaving'):
        on_centre.judge(still, on_centre.Weave())


# -- sine with dwell --------------------------------------------------------------------------------------------------------


def dwelling(
    amplitude: float = 1.5, side: float = 1.0, rate: float = 500.0, ratios: tuple[float, float] = (0.3, 0.1), push: float = 6.0
) -> Signals:
    """0.7 Hz, dwell 0.5 s, from t = 2 s; the yaw rate follows the steering wheel, then falls on straight lines through the wanted ratios;
    the lateral acceleration grows as push * (t - BOS), so that the car is aside by push (1.07 s)^3/6."""
    t = even(8.0, rate)
    f, start = 0.7, 2.0
    peak_at, again = start + 0.75 / f, start + 0.75 / f + 0.5
    cos = again + 0.25 / f
    phase = (
        2.0
        * np.pi
        * f
        * np.where(t < peak_at, np.clip(t - start, 0.0, None), np.where(t < again, 0.75 / f, np.clip(t - 0.5 - start, None, 1.0 / f)))
    )
    d = amplitude * np.sin(phase)
    yaw = 0.6 * np.sin(phase)
    yaw = np.where(
        t < again,
        yaw,
        np.interp(
            t,
            [again, cos + 0.9, cos + 1.1, cos + 1.65, cos + 1.85, 9.0],
            [-0.6, -0.6 * ratios[0], -0.6 * ratios[0], -0.6 * ratios[1], -0.6 * ratios[1], 0.0],
        ),
    )
    bos = start + math.asin(math.radians(5.0) / amplitude) / (2.0 * np.pi * f)
    lateral = push * np.clip(t - bos, 0.0, 1.3)
    return made(t, steering=side * d + 0.003, speed=22.2, yaw_rate=side * yaw - 0.002, lateral_acceleration=side * lateral + 0.05)


@pytest.mark.parametrize('side', [1.0, -1.0])
def test_ratios_and_displacement_of_a_sine_with_dwell(side: float) -> None:
    r = sine_with_dwell.judge(dwelling(side=side), sine_with_dwell.SineWithDwell(reference=0.25, mass=1500.0))
    assert r['amplitude'] == pytest.approx(side * 1.5, rel=2e-3)
    assert r['over_reference'] == pytest.approx(6.0, rel=2e-3)
    assert r['speed'] == pytest.approx(22.2)
    assert r['peak_yaw_rate'] == pytest.approx(0.6, rel=5e-3)
    assert r['yaw_rate_ratio_100'] == pytest.approx(0.3, rel=0.01)  # the 6 Hz filter rounds the corners of the lines
    assert r['yaw_rate_ratio_175'] == pytest.approx(0.1, rel=0.02)
    assert r['displacement'] == pytest.approx(6.0 * 1.07**3 / 6.0, rel=0.01)
    verdicts = {f.name: f.ok for f in r.figures}
    assert verdicts['yaw_rate_ratio_100'] is True
    assert verdicts['displacement'] is False  # 1.23 m
    assert r.passed is False


def test_limits_of_a_sine_with_dwell() -> None:
    def verdicts(s: Signals, **given: float) -> dict[str, bool | None]:
        return {f.name: f.ok for f in sine_with_dwell.judge(s, sine_with_dwell.SineWithDwell(**given)).figures if f.limit}

    near = {'reference': 0.25, 'mass': 1500.0}
    assert all(verdicts(dwelling(push=9.1), **near).values())  # 1.86 m
    assert verdicts(dwelling(push=8.8), **near)['displacement'] is False  # 1.80 m
    assert verdicts(dwelling(push=8.8), reference=0.25, mass=4000.0)['displacement'] is True  # 1.52 m are enough for a heavy one
    assert verdicts(dwelling(push=1.0), reference=0.4)['displacement'] is None  # 3.75 A
    assert verdicts(dwelling(push=1.0))['displacement'] is None  # A is not known
    assert verdicts(dwelling(ratios=(0.37, 0.1)))['yaw_rate_ratio_100'] is False
    assert verdicts(dwelling(ratios=(0.33, 0.22))) == {'yaw_rate_ratio_100': True, 'yaw_rate_ratio_175': False, 'displacement': None}


def test_the_series_of_amplitudes() -> None:
    """From 1.5 A by 0.5 A to the greater of 6.5 A and 270 deg, at most 300 deg."""
    found = np.degrees(sine_with_dwell.series(math.radians(30.0)))
    assert found == pytest.approx([*np.arange(45.0, 270.0, 15.0), 270.0])
    assert np.degrees(sine_with_dwell.series(math.radians(45.0)))[-1] == pytest.approx(292.5)
    last = np.degrees(sine_with_dwell.series(math.radians(50.0)))
    assert last[-1] == pytest.approx(300.0)
    assert np.diff(last).max() == pytest.approx(25.0)


def test_a_series_is_as_good_as_its_worst_run() -> None:
    p = sine_with_dwell.SineWithDwell(reference=0.25)
    runs = [sine_with_dwell.judge(dwelling(a, ratios=(q, 0.1), push=9.5), p) for a, q in ((1.0, 0.1), (1.25, 0.2), (1.5, 0.4))]
    found = {f.name: f for f in sine_with_dwell.together(runs)}
    assert found['worst_ratio_100'].value == pytest.approx(0.4, rel=0.01)
    assert found['worst_ratio_100'].ok is False
    assert found['worst_ratio_175'].ok is True
    assert found['stable_up_to'].value == pytest.approx(1.25, rel=2e-3)
    assert found['least_displacement'].ok is True


def test_what_is_no_sine_with_dwell_is_refused() -> None:
    sine = dwelling()
    sine.values['steering'] = 1.5 * np.sin(2.0 * np.pi * 0.7 * np.clip(sine.t - 2.0, 0.0, 1.0 / 0.7))
    with pytest.raises(BagError, match='stays at its second peak'):
        sine_with_dwell.judge(sine, sine_with_dwell.SineWithDwell())
    with pytest.raises(BagError, match='75 deg/s'):
        sine_with_dwell.judge(weaving(), sine_with_dwell.SineWithDwell())
    sine.values['steering'] = np.interp(sine.t, [2.0, 2.5], [0.0, 1.5])
    with pytest.raises(BagError, match='one side'):
        sine_with_dwell.judge(sine, sine_with_dwell.SineWithDwell())


# -- ISO 3888 ---------------------------------------------------------------------------------------------------------------


def through(standard: str, aside: float = 0.0, width: float = 1.8) -> Signals:
    """A car that follows the middle of the lanes at 20 m/s, its body along the path, shifted by `aside` to the left."""
    path = DoubleLaneChange(standard=standard, width=width, start=30.0)  # type: ignore[arg-type]
    t = even(9.0, 200.0)
    x = 20.0 * t
    y = np.array([path.lateral(v) for v in x])
    return made(t, x=x, y=y + aside, heading=np.arctan(np.gradient(y, x)), speed=20.0 - 0.1 * t, yaw_rate=0.1, lateral_acceleration=1.0)


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
    assert r.passed is True
    shifted = lane_change.judge(through(f'iso_3888_{part}', 0.5), p, f'iso_3888_{part}')
    assert shifted['clearance_1'] == pytest.approx(widest - 0.5, abs=0.02)  # negative: cones are hit
    assert shifted.passed is False


def test_a_cone_that_the_side_hits_behind_the_corners_counts() -> None:
    """Straight through lane 1, turned by 30 deg about the place of its last left cone, which is 0.1 m inside the body."""
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
    with pytest.raises(BagError, match='does not pass the track'):
        lane_change.judge(s, lane_change.LaneChange(width=1.8, start=100.0), 'iso_3888_1')
    with pytest.raises(BagError, match='--set width='):
        lane_change.judge(s, lane_change.LaneChange(start=100.0), 'iso_3888_1')


# -- braking ----------------------------------------------------------------------------------------------------------------


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


def test_braking_that_is_none_is_refused() -> None:
    s = stopping()
    s.values['brake'][:] = 0.0
    with pytest.raises(BagError, match='not applied'):
        braking.judge_stopping(s, braking.Stopping())
    with pytest.raises(BagError, match='does not come to rest'):
        braking.judge_stopping(stopping(b=1.0), braking.Stopping())


# -- ISO 2631 ---------------------------------------------------------------------------------------------------------------

# Weights x 1000 at one-third-octave frequencies as tables of the standard give them.
TABLE = {
    'wk': {
        0.5: 418, 1.0: 482, 2.0: 531, 2.5: 631, 3.15: 804, 4.0: 967, 5.0: 1039, 6.3: 1054, 8.0: 1036, 10.0: 988, 12.5: 902, 16.0: 768,
        20.0: 636, 31.5: 405, 50.0: 246, 80.0: 132,
    },
    'wd': {0.5: 853, 1.0: 1011, 1.25: 1008, 2.0: 890, 2.5: 776, 4.0: 512, 8.0: 253, 16.0: 125, 31.5: 63.2, 80.0: 21.1},
}  # fmt: skip


@pytest.mark.parametrize('key', ['wk', 'wd'])
def test_weightings_are_those_of_the_tables(key: str) -> None:
    """At the nominal one-third-octave frequencies, to the rounding of the table (one entry, 16 Hz, is rounded down there)."""
    f, expected = np.array(list(TABLE[key])), np.array(list(TABLE[key].values()))
    unit = np.where(expected < 100.0, 0.1, 1.0)
    assert np.all(np.abs(1e3 * np.abs(ride.WEIGHTINGS[key].response(f)) - expected) < 0.75 * unit)


@pytest.mark.parametrize(('axis', 'name', 'key'), [('x', 'ax', 'wd'), ('y', 'ay', 'wd'), ('z', 'az', 'wk'), ('z', 'az', 'wb')])
def test_a_sine_has_the_weight_of_its_frequency(axis: str, name: str, key: str) -> None:
    """RMS A |H|/sqrt(2), dose A |H| (3/8 T)^(1/4), crest factor sqrt(2), running RMS the RMS once it has settled."""
    t = even(32.0, 400.0)
    f, A = 5.0, 1.3
    s = made(t, ax=0.0, ay=0.0, az=9.81)
    s.values[name] = s.values[name] + A * np.sin(2.0 * np.pi * f * t)
    r = ride.judge(s, ride.Ride())
    weight = abs(ride.WEIGHTINGS[key].response(np.array([f]))[0])
    assert r[f'{axis}_{key}_rms'] == pytest.approx(A * weight / math.sqrt(2.0), rel=2e-3)
    assert r[f'{axis}_{key}_vdv'] == pytest.approx(A * weight * (0.375 * 30.0) ** 0.25, rel=2e-3)
    if key != 'wb':
        assert r[f'{axis}_{key}_crest'] == pytest.approx(math.sqrt(2.0), rel=0.01)
        assert r[f'{axis}_{key}_mtvv'] == pytest.approx(A * weight / math.sqrt(2.0), rel=0.06)  # ripple of 1/(4 pi f T) of the mean square
        assert r['total'] == pytest.approx(A * weight / math.sqrt(2.0), rel=2e-3)


def test_running_rms_of_a_burst() -> None:
    """y = 1 from t = 0 on: sqrt(1 - exp(-t/T)); off again it fades with exp(-t/2T)."""
    t = even(10.0, 100.0)
    found = ride.running_rms(np.where(t <= 5.0, 1.0, 0.0), 100.0, 1.0)
    on, off = (t > 0.1) & (t <= 5.0), t > 5.1
    assert found[on] == pytest.approx(np.sqrt(1.0 - np.exp(-t[on])), abs=1e-9)
    assert found[off] == pytest.approx(math.sqrt(1.0 - math.exp(-5.0)) * np.exp(-0.5 * (t[off] - 5.0)), rel=5e-3)


def test_a_weighting_is_causal() -> None:
    """Nothing comes before a shock but the ringing of the band limit at half the sampling rate."""
    y = np.zeros(4000)
    y[2000] = 1.0
    found = ride.weighted(y, 400.0, ride.WEIGHTINGS['wk'])
    assert np.abs(found[:1950]).max() < 1e-2 * np.abs(found).max()
    with pytest.raises(BagError, match='nothing shakes'):
        ride.judge(made(even(8.0), ax=0.0, ay=0.0, az=9.81), ride.Ride())


# -- the command ------------------------------------------------------------------------------------------------------------


def recorded(directory: Path, s: Signals, names: dict[str, str]) -> Path:
    """A bag of plain scalars: signal -> name of the channel there."""
    stamps = EPOCH + np.round(s.t * 1e9).astype(np.int64)
    topics: dict[str, dict[str, np.ndarray]] = {}
    for name, channel in names.items():
        topic, _, rest = channel.rpartition('/')
        topics.setdefault(topic, {})[rest] = s[name]
    return write_scalars(directory, {topic: (stamps, columns) for topic, columns in topics.items()})


MAPPING = """
channels:
  yaw_rate: {channel: car/imu/yaw, unit: deg/s}
  lateral_acceleration: {channel: car/imu/lateral, unit: g, sign: -1}
  speed: {channel: car/speed/kmh, unit: km/h}
  steering: {channel: car/wheel/angle, unit: deg}
"""
THEIRS = {'yaw_rate': 'car/imu/yaw', 'lateral_acceleration': 'car/imu/lateral', 'speed': 'car/speed/kmh', 'steering': 'car/wheel/angle'}


@pytest.fixture
def foreign(tmp_path: Path) -> tuple[Path, Path]:
    """A recording of another system with a step steer, and the mapping file for it."""
    s = stepped(rate=100.0)
    units = {'yaw_rate': 180.0 / math.pi, 'lateral_acceleration': -1.0 / G, 'speed': 3.6, 'steering': 180.0 / math.pi}
    s.values = {name: factor * s[name] for name, factor in units.items()}
    (tmp_path / 'car.yaml').write_text(MAPPING)
    return recorded(tmp_path / 'car', s, THEIRS), tmp_path / 'car.yaml'


def test_a_recording_of_others_is_evaluated(foreign: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag, file = foreign
    page = tmp_path / 'page.html'
    assert main(['evaluate', str(bag), '--as', 'iso7401_step', '--mapping', str(file), '--html', str(page), '--json']) == 0
    captured = capsys.readouterr()
    assert captured.err == ''
    data = json.loads(captured.out)
    assert data['passed'] is None
    figures = data['results'][0]['figures']
    assert figures['yaw_rate_peak_time']['value'] == pytest.approx(math.pi / (2.0 * np.pi * 1.2 * 0.8), abs=5e-3)
    assert figures['yaw_rate_peak_time']['unit'] == 's'
    assert figures['lateral_acceleration_gain']['value'] == pytest.approx(8.0, rel=2e-3)
    assert 'http' not in page.read_text(encoding='utf-8')
    assert main(['evaluate', str(bag), '--as', 'iso7401_step', '--mapping', str(file)]) == 0
    assert 'not judged' in capsys.readouterr().out


@pytest.mark.parametrize(
    ('arguments', 'sentence'),
    [
        ([], 'does not say which maneuver of a norm it holds; say it with --as'),
        (['--as', 'iso7401_stepp'], "did you mean 'iso7401_step'"),
        (['--as', 'iso7401_step'], 'none of the channels that evaluations use is in it'),
        (['--as', 'iso7401_step', '--map', 'car/wheel/angle=steering'], 'has no speed along the vehicle: the channel speed or'),
        (['--as', 'iso13674', '--mapping', 'FILE'], 'no weaving in it'),
        (['--as', 'iso7401', '--mapping', 'FILE'], 'hold? iso7401_step, iso7401_frequency'),
        (['--as', 'iso7401_step', '--mapping', 'FILE', '--set', 'settle=1'], "did you mean 'settled'"),
        (['--as', 'iso7401_step', '--mapping', 'FILE', '--set', 'settled'], 'write it as KEY=NUMBER'),
    ],
)
def test_refusals_are_one_sentence(
    foreign: tuple[Path, Path], arguments: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, file = foreign
    assert main(['evaluate', str(bag), *(str(file) if a == 'FILE' else a for a in arguments)]) != 0
    captured = capsys.readouterr()
    assert captured.out == ''
    assert captured.err.count('\n') == 1
    assert sentence in captured.err


def test_strict_fails_where_the_norm_is_not_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keys = {name: name for name in ('steering', 'speed', 'yaw_rate', 'lateral_acceleration')}
    bags = [
        recorded(tmp_path / name, dwelling(ratios=ratios), {k: f'car/{v}' for k, v in keys.items()})
        for name, ratios in (('good', (0.2, 0.1)), ('bad', (0.5, 0.1)))
    ]
    options = ['--as', 'sine_with_dwell', '--map', 'car/*=*']
    assert main(['evaluate', str(bags[0]), *options, '--strict']) == 0
    assert main(['evaluate', str(bags[1]), *options]) == 0
    assert main(['evaluate', str(bags[1]), *options, '--strict']) == 1
    capsys.readouterr()
    assert main(['evaluate', *map(str, bags), *options, '--json']) == 0
    data = json.loads(capsys.readouterr().out)
    assert data['passed'] is False
    assert data['together']['fmvss126']['worst_ratio_100']['value'] == pytest.approx(0.5, rel=0.02)


def test_every_evaluation_is_listed_and_can_be_called(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['evaluate', '--list', '--json']) == 0
    data = json.loads(capsys.readouterr().out)
    assert [e['name'] for e in data['evaluations']] == [e.name for e in EVALUATIONS]
    for e in EVALUATIONS:
        assert called(e.name) == (e,)
        assert set(e.needs + e.also) <= set(WAYS)
        assert judging.parameters_of(e, {})
    assert [e.name for e in called('iso4138')] == ['iso4138_constant_radius', 'iso4138_constant_steering', 'iso4138_constant_speed']
    assert called('ISO-3888-2')[0].name == 'iso3888_2'
    assert 'iso19365' in names()
    with pytest.raises(SpecError, match='iso4138'):
        called('iso4183')


def test_a_figure_without_value_never_passes() -> None:
    assert Result(evaluation='x', title='x', norm='x', figures=()).passed is None
    r = sine_with_dwell.judge(dwelling(), sine_with_dwell.SineWithDwell())
    assert all(math.isfinite(f.value) for f in r.figures if f.ok)
