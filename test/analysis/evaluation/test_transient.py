"""ISO 7401: step and frequency responses of second order."""

from __future__ import annotations

import math

import numpy as np
import pytest
from drives import even, made, second_order, stepped
from scipy import signal

from mbd_sim_ros.analysis.evaluation import transient
from mbd_sim_ros.analysis.evaluation.signals import Signals
from solver.errors import BagError


@pytest.mark.parametrize('side', [1.0, -1.0])
def test_step_response_of_second_order(side: float) -> None:
    """Peak at pi/w_d, overshoot exp(-pi D/sqrt(1 - D^2)); the response time solves the closed form; half the step is at
    t = 2 s."""
    r = transient.judge_step(stepped(side), transient.StepSteer())
    assert r['speed'] == pytest.approx(22.0)
    assert r['steering'] == pytest.approx(side * 0.5)
    assert r['steering_rise'] == pytest.approx(0.08, abs=1e-6)
    responses = (
        ('yaw_rate', 0.3, 1.2, 0.6),
        ('lateral_acceleration', 4.0, 0.9, 0.8),
        ('sideslip_angle', -0.02, 1.0, 0.7),
        ('roll', 0.05, 1.1, 0.5),
    )
    for name, gain, f, damping in responses:
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


@pytest.mark.parametrize('rate, told', [(50.0, False), (20.0, True)])
def test_samples_too_far_apart_for_response_times_are_told(rate: float, told: bool) -> None:
    """Of 0.08 s in which the steering wheel turns, one of 20 Hz has less than three; also where another topic is as
    fine as ever."""
    coarse = transient.judge_step(stepped(rate=rate), transient.StepSteer())
    results = [coarse]
    for name in ('yaw_rate', 'roll'):
        fine = stepped()
        fine.spacing[name] = 1.0 / rate
        results.append(transient.judge_step(fine, transient.StepSteer()))
    for result in results:
        assert any('response times are not known better than to 0.025 s' in note for note in result.notes) == told
        assert told or not result.notes


def test_a_response_that_only_grows_has_no_peak() -> None:
    """Two real poles: 0.3 (1 - (b e^-at - a e^-bt)/(b - a)) has no overshoot; where it happens to be largest is no peak
    response time."""
    s = stepped()
    since = np.maximum(s.t - 2.0, 0.0)
    a, b = 4.0, 20.0
    s.values['yaw_rate'] = 0.3 * (1.0 - (b * np.exp(-a * since) - a * np.exp(-b * since)) / (b - a))
    r = transient.judge_step(s, transient.StepSteer())
    assert math.isnan(r['yaw_rate_peak_time'])
    assert math.isnan(r['tb_factor'])
    assert r['yaw_rate_overshoot'] == 0.0
    assert r['yaw_rate_response_time'] == pytest.approx((math.log(10.0) + math.log(b / (b - a))) / a, abs=2e-3)
    assert r['lateral_acceleration_peak_time'] == pytest.approx(math.pi / (2.0 * np.pi * 0.9 * 0.6), abs=1e-3)


@pytest.mark.parametrize('roll', [0.0, 0.02])
def test_what_does_not_answer_has_no_response_time(roll: float) -> None:
    """The roll angle of a level without roll, with rounding in it, and that of a sensor that is stuck."""
    s = stepped()
    s.values['roll'] = roll + 1e-17 * np.sin(np.arange(s.t.size))
    r = transient.judge_step(s, transient.StepSteer())
    assert abs(r['roll_steady']) < 1e-16
    assert all(math.isnan(r[f'roll_{what}']) for what in ('response_time', 'peak_time', 'overshoot'))
    assert r['yaw_rate_response_time'] > 0.0


def test_a_peak_that_is_noise_is_told(rng: np.random.Generator) -> None:
    """A yaw rate that grows to 0.3 rad/s without a peak, by a sensor with noise of 0.003 rad/s: its largest sample is
    anywhere. One that overshoots by 9 % has its peak beside the same noise."""
    for overshoots in (False, True):
        noisy = stepped()
        t = noisy.t
        if not overshoots:
            noisy.values['yaw_rate'] = 0.3 * (1.0 - np.exp(-np.maximum(t - 2.0, 0.0) / 0.15))
        noisy.values['yaw_rate'] += 0.003 * rng.standard_normal(t.size)
        told = [note for note in transient.judge_step(noisy, transient.StepSteer()).notes if 'told from noise' in note]
        assert [note.partition(' is ')[0] for note in told] == [] if overshoots else ['the largest yaw rate']


def test_a_peak_is_that_before_the_steady_values() -> None:
    """A car that goes on turning more, by 5 % a second: its yaw rate is largest in the end, and its peak is where it
    was."""
    s = stepped()
    s.values['yaw_rate'] *= 1.0 + 0.05 * np.clip(s.t - 2.0, 0.0, None)
    r = transient.judge_step(s, transient.StepSteer())
    assert r['yaw_rate_peak_time'] == pytest.approx(math.pi / (2.0 * np.pi * 1.2 * 0.8), abs=0.02)
    assert r['tb_factor'] == pytest.approx(0.02 * r['yaw_rate_peak_time'], rel=2e-3)


def test_a_small_step_of_a_direct_steering_is_one() -> None:
    """3.4 deg at the steering wheel: the same car with a steering ratio eight times as small."""
    found = stepped()
    direct = Signals(
        place='bag', t=found.t, values={**found.values, 'steering': 0.12 * found.values['steering']}, notes=[]
    )
    assert transient.judge_step(direct, transient.StepSteer())['yaw_rate_gain'] == pytest.approx(0.6 / 0.12, rel=1e-3)


def test_what_is_no_step_is_refused() -> None:
    t = even(8.0)
    still = made(t, steering=0.01 * t, speed=20.0, yaw_rate=0.0, lateral_acceleration=0.0)
    with pytest.raises(BagError, match='no step of the steering wheel in the recording'):
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


@pytest.mark.parametrize('kind', ['random', 'sweep', 'short sweep'])
def test_frequency_response_of_second_order(kind: str, rng: np.random.Generator) -> None:
    rate, seconds = 100.0, 62.0 if kind == 'short sweep' else 240.0
    t = even(seconds, rate)
    if kind == 'random':
        x = 0.3 * signal.sosfilt(signal.butter(2, 4.0, fs=rate, output='sos'), rng.standard_normal(t.size))
    elif kind == 'short sweep':  # that of mbd maneuver: a second of rest, a minute, a second of rest
        since = np.clip(t - 1.0, 0.0, 60.0)
        fade = np.clip(since / 0.5, 0.0, 1.0) * np.clip((60.0 - since) / 0.5, 0.0, 1.0)
        x = 0.3 * fade * np.sin(2.0 * np.pi * (0.05 * since + 0.5 * 3.45 / 60.0 * since * since))
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
        table = {
            float(x.name.removeprefix(f'{name}_gain_')[:-2]): x.value
            for x in r.figures
            if x.name.startswith(f'{name}_gain_')
        }
        assert len(table) >= 4
        assert table == pytest.approx({k: abs(H(k)) for k in table}, rel=0.02)
    assert r['speed'] == pytest.approx(22.0)
    assert r['lateral_acceleration_peak_frequency'] == pytest.approx(0.2)  # damped so much that the gain only falls
    assert r['lateral_acceleration_peak_ratio'] == pytest.approx(1.0)
    top = 1.2 * math.sqrt(1.0 - 2.0 * 0.36)
    assert r['yaw_rate_peak_frequency'] == pytest.approx(top, abs=0.11)
    assert r['yaw_rate_peak_ratio'] == pytest.approx(
        1.0 / (2.0 * 0.6 * 0.8) / abs(1.0 / (1.0 - (0.2 / 1.2) ** 2 + 2j * 0.6 * 0.2 / 1.2)), rel=0.01
    )


def test_what_straight_lines_between_samples_take_of_a_gain_is_told(rng: np.random.Generator) -> None:
    """A yaw rate of 10 Hz beside a steering wheel of 100 Hz: sinc(f/10 Hz)^2, 19 % at 2.5 Hz; of 50 Hz 0.8 %, which is
    not told."""
    rate = 100.0
    t = even(240.0, rate)
    x = 0.3 * signal.sosfilt(signal.butter(4, 3.0, fs=rate, output='sos'), rng.standard_normal(t.size))
    y = answered(x, rate, 0.3, 1.2, 0.6)
    found = {}
    for every in (1, 2, 10):
        s = made(t, steering=x, speed=22.0, yaw_rate=np.interp(t, t[::every], y[::every]), lateral_acceleration=y)
        if every > 1:
            s.spacing['yaw_rate'] = every / rate
        found[every] = transient.judge_frequencies(s, transient.FrequencyResponse())
    assert found[10]['yaw_rate_gain_2.5hz'] / found[1]['yaw_rate_gain_2.5hz'] == pytest.approx(
        np.sinc(0.25) ** 2, rel=0.02
    )
    assert found[1].notes == found[2].notes == ()
    assert any(
        'the yaw rate is recorded every 0.1 s' in note and 'take 19 % of its amplitude at 2.5 Hz' in note
        for note in found[10].notes
    )


def test_the_lowest_frequency_is_named_as_it_is(rng: np.random.Generator) -> None:
    """Segments of 2 s have lines from 0.5 Hz on: what is there is no gain at 0.2 Hz."""
    t = even(60.0, 100.0)
    x = 0.3 * rng.standard_normal(t.size)
    s = made(t, steering=x, speed=22.0, yaw_rate=answered(x, 100.0, 0.3, 1.2, 0.6), lateral_acceleration=x)
    texts = {f.name: f.text for f in transient.judge_frequencies(s, transient.FrequencyResponse(segment=2.0)).figures}
    assert texts['yaw_rate_static_gain'] == 'yaw rate per steering-wheel angle at 0.5 Hz'
    assert texts['yaw_rate_peak_ratio'] == 'yaw rate, largest gain over that at 0.5 Hz'
    assert 'yaw_rate_gain_0.5hz' not in texts  # it is that one
    texts = {f.name: f.text for f in transient.judge_frequencies(s, transient.FrequencyResponse()).figures}
    assert texts['yaw_rate_static_gain'] == 'yaw rate per steering-wheel angle at 0.2 Hz'


@pytest.mark.parametrize('rate', [99.96, 100.04])
def test_a_rate_that_is_no_whole_number_keeps_the_ends_of_the_band(rate: float, rng: np.random.Generator) -> None:
    """Lines of segments of 1000 samples are at 0.19992 and 2.499 Hz, or at 0.20008 and 2.501 Hz: the former had no gain
    at 0.2 Hz, to which the bandwidth refers, the latter none at 2.5 Hz."""
    t = even(120.0, rate)
    x = 0.3 * rng.standard_normal(t.size)
    s = made(t, steering=x, speed=22.0, yaw_rate=answered(x, rate, 0.3, 1.2, 0.6), lateral_acceleration=x)
    result = transient.judge_frequencies(s, transient.FrequencyResponse())
    texts = {f.name: f.text for f in result.figures}
    assert texts['yaw_rate_static_gain'] == 'yaw rate per steering-wheel angle at 0.2 Hz'
    assert result['lateral_acceleration_gain_2.5hz'] == pytest.approx(1.0)


def test_noise_lowers_the_coherence_as_it_must(rng: np.random.Generator) -> None:
    """Independent noise of the power of the response: coherence 1/2 at every frequency where both are white."""
    t = even(400.0, 50.0)
    x = 0.3 * rng.standard_normal(t.size)
    y = x + 0.3 * rng.standard_normal(t.size)
    r = transient.judge_frequencies(
        made(t, steering=x, speed=22.0, yaw_rate=y, lateral_acceleration=x), transient.FrequencyResponse()
    )
    assert 0.25 < r['yaw_rate_least_coherence'] < 0.5
    assert r['lateral_acceleration_least_coherence'] == pytest.approx(1.0)
    assert any('coherence' in note for note in r.notes)
    with pytest.raises(BagError, match='does not excite'):
        transient.judge_frequencies(
            made(t, steering=np.sin(2.0 * np.pi * 0.2 * t), speed=20.0, yaw_rate=0.0, lateral_acceleration=0.0),
            transient.FrequencyResponse(),
        )
