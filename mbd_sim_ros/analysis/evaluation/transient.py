"""Lateral transient response [ISO7401]: step of the steering wheel, and the frequency response to a random or swept
input.

Step: times count from the instant at which the steering wheel has made half its change. The response time of a signal
is the time to 90 % of its new steady value, the peak response time that to its largest value before the steady values,
the overshoot (largest - steady)/steady; a signal that only grows until then has no peak. The TB factor is the steady
sideslip angle times the peak response time of the yaw rate. Steady values are means from `settled` to `settled +
length` after that instant.

Frequency response of y to the steering wheel x: H = S_xy/S_xx, coherence |S_xy|^2/(S_xx S_yy), from spectra by Welch's
method [Welch1967] with Hann windows that overlap by three quarters. In a sweep every frequency has its time, and a
window that rises there bends the phase one way, one that falls the other; so many windows level that out, if those
before and behind the sweep are there as well: where the steering wheel rests at the beginning or the end, the recording
is continued as it is there by half a segment.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mbd_sim_ros.analysis.evaluation.figures import Chart, Curve, Figure, Result
from mbd_sim_ros.analysis.evaluation.kinds import Drive, Evaluation
from mbd_sim_ros.analysis.evaluation.measures import crossing, line, peak
from mbd_sim_ros.analysis.evaluation.signals import GIVEN, Signals

NORM = 'ISO 7401:2011 [ISO7401]'
FINE = 3.0  # samples of all channels at least while the steering wheel turns from 10 to 90 % of its step
LEAST_STEP = math.radians(2.0)  # at the steering wheel; direct steering, of a racing car, needs 4 to 5 deg for 4 m/s^2
RESPONSES = (('yaw_rate', 'yaw rate', 'rad/s'), ('lateral_acceleration', 'lateral acceleration', 'm/s^2'))
FOLLOWING = (('roll', 'roll angle', 'rad'), ('sideslip_angle', 'sideslip angle', 'rad'))
COHERENT = 0.9
LEAST_LINES = 3  # of a frequency response
NONE = 1e-6  # rad, rad/s, m/s^2: what changes by less does not answer, but for rounding
SCATTERS = 4.0  # standard deviations within which the largest of some hundred samples of noise lies
DAMPED = 0.02  # part of the amplitude that straight lines between samples take, without a note
NEAR = 0.25  # of the distance of two lines, within which one is at a frequency
EXCITED = 1e-3  # part of the largest spectral density of the steering that counts as excitation
# s at an end of a recording, and the part of its range by which a steering wheel at rest may move there
AT_REST, RESTS = 0.5, 0.01


@dataclass(frozen=True, kw_only=True)
class StepSteer:
    """settled, length: time from half the step to the steady values, and over how much of it they are means [s]. rise:
    longest time from 10 to 90 % of a step [s]. before: time before the step over which the initial values are means
    [s]."""

    settled: float = 2.0
    length: float = 1.0
    rise: float = 0.5
    before: float = 0.5


def judge_step(s: Signals, p: StepSteer) -> Result:
    """Response times, peaks, overshoot, gains. Raises BagError."""
    t, d = s.t, s['steering']
    window = max(2, round(p.rise * s.rate))
    moved = np.abs(d[window:] - d[:-window]) if d.size > window else np.zeros(1)
    if moved.max() < LEAST_STEP and moved.max() < LEAST_STEP * s.vehicle.turned:
        raise s.refuse(
            'no step of the steering wheel in the recording: '
            f'the wheel turns by {math.degrees(float(moved.max())):.3g} deg at most within {p.rise:g} s; at '
            f'least {math.degrees(LEAST_STEP):g} deg are expected'
        )
    first = int(np.argmax(moved > 0.95 * moved.max()))
    before = s.between(t[first] - p.before, t[first])
    middle = t[first] + p.rise
    after = s.between(middle + p.settled, middle + p.settled + p.length)
    if not after.any() or t[-1] < middle + p.settled + 0.5 * p.length:
        raise s.refuse(
            f'it ends {t[-1] - middle:.3g} s behind the step; {p.settled + p.length:g} s are needed for the steady '
            'values'
        )
    start, end = float(d[before].mean()), float(d[after].mean())
    side = math.copysign(1.0, end - start)
    change = side * (d - start)
    size = abs(end - start)
    if size < 0.8 * moved.max() or np.ptp(d[s.between(middle, middle + p.settled)]) > 0.1 * size:
        raise s.refuse('the steering wheel is not held behind the step; ISO 7401 wants it held')
    t0 = crossing(t, change, 0.5 * size, after=float(t[first]))
    speed = float(s['speed'][before].mean())
    rise = crossing(t, change, 0.9 * size, after=float(t[first])) - crossing(
        t, change, 0.1 * size, after=float(t[first])
    )
    apart = s.every('steering', *(name for name, _, _ in (*RESPONSES, *FOLLOWING) if name in s))
    if rise < FINE * apart:
        s.notes.append(
            f'recorded every {apart:.3g} s, and the steering wheel turns within {rise:.2g} s: response times are not '
            f'known better than to {0.5 * apart:.2g} s'
        )
    figures = [
        Figure('speed', 'speed before the step', speed, 'm/s'),
        Figure('steering', 'angle of the step at the steering wheel', side * size, 'rad'),
        Figure('steering_rise', 'steering from 10 to 90 %', rise, 's'),
    ]
    charts = [
        Chart(
            title='steering',
            x=('time', 's'),
            y=('steering-wheel angle', 'rad'),
            curves=(Curve('steering wheel', t - t0, d),),
        )
    ]
    steady = s.between(t0 + p.settled, t0 + p.settled + p.length)
    peak_of_yaw_rate = math.nan
    for name, text, unit in (*RESPONSES, *(x for x in FOLLOWING if x[0] in s)):
        y = s[name]
        initial, last = float(y[before].mean()), float(y[steady].mean())
        way = math.copysign(1.0, last - initial)
        response, value = way * (y - initial), abs(last - initial)
        inside = s.between(t0 - 0.5 * p.rise, t0 + p.settled)
        when, largest = peak(t[inside], response[inside])
        overshoot = max(0.0, (largest - value) / value) if value > 0.0 else math.nan
        if np.argmax(response[inside]) == inside.sum() - 1:
            when, overshoot = math.nan, 0.0
        varies = SCATTERS * _scatter(t[steady], y[steady])
        if value >= NONE and not math.isnan(when) and 0.0 <= largest - value < varies:
            s.notes.append(
                f'the largest {text} is {largest - value:.2g} {unit} above its steady value, which varies by '
                f'{varies:.2g} {unit}: it '
                'has no peak that is told from noise, and peak response time and overshoot mean nothing'
            )
        ninety = crossing(t, response, 0.9 * value, after=t0 - p.rise)
        if value < NONE:  # no answer comes at no time
            when = overshoot = ninety = math.nan
        figures += [
            Figure(f'{name}_steady', f'{text}, steady', last - initial, unit),
            Figure(f'{name}_response_time', f'{text}, response time (90 %)', ninety - t0, 's'),
            Figure(f'{name}_peak_time', f'{text}, peak response time', when - t0, 's'),
            Figure(f'{name}_overshoot', f'{text}, overshoot', overshoot, '1'),
        ]
        if name == 'yaw_rate':
            peak_of_yaw_rate = when - t0
            figures.append(
                Figure('yaw_rate_gain', 'yaw rate per steering-wheel angle', (last - initial) / (end - start), '1/s')
            )
        if name == 'lateral_acceleration':
            figures.append(
                Figure(
                    'lateral_acceleration_gain',
                    'lateral acceleration per steering-wheel angle',
                    (last - initial) / (end - start),
                    'm/s^2/rad',
                )
            )
        if name == 'sideslip_angle':
            figures.append(Figure('tb_factor', 'TB factor', abs(last - initial) * peak_of_yaw_rate, 'rad s'))
        levels = [Curve('steady', np.array([0.0, p.settled + p.length]), np.array([last, last]), 'limit')]
        levels.append(
            Curve('90 %', np.array([-p.rise, p.settled]), np.full(2, initial + 0.9 * (last - initial)), 'limit')
        )
        shown = s.between(t0 - 1.0, t0 + p.settled + p.length)
        charts.append(
            Chart(title=text, x=('time', 's'), y=(text, unit), curves=(Curve(text, t[shown] - t0, y[shown]), *levels))
        )
    shown = s.between(t0 - 1.0, t0 + p.settled + p.length)
    charts[0] = Chart(
        title='steering', x=('time', 's'), y=charts[0].y, curves=(Curve('steering wheel', t[shown] - t0, d[shown]),)
    )
    return Result(
        evaluation='iso7401_step',
        title='Step steer',
        norm=NORM,
        figures=tuple(figures),
        charts=tuple(charts),
        notes=tuple(s.notes),
        source=s.place,
    )


def _scatter(t: np.ndarray, y: np.ndarray) -> float:
    """Standard deviation from a straight line through the samples."""
    slope, zero = line(t, y)
    return float(np.std(y - zero - slope * t))


@dataclass(frozen=True, kw_only=True)
class FrequencyResponse:
    """low, high: frequencies between which it is given [Hz]. segment: length of the segments of the spectra [s]."""

    low: float = 0.2
    high: float = 2.5
    segment: float = 10.0


TABLE = (0.2, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0)  # Hz


def judge_frequencies(s: Signals, p: FrequencyResponse) -> Result:
    """Gain, phase and coherence of yaw rate and lateral acceleration. Raises BagError."""
    from scipy import signal

    n = round(p.segment * s.rate)
    lines = int(min(p.high, 0.5 * s.rate) * p.segment + 1e-9) - math.ceil(p.low * p.segment - 1e-9) + 1
    if lines < LEAST_LINES:
        raise s.refuse(
            f'spectra of segments of {p.segment:g} s at {s.rate:.4g} samples a second have {max(lines, 0)} frequencies '
            f'from {p.low:g} to '
            f'{p.high:g} Hz, at least {LEAST_LINES} are needed; give segment=... low=... high=... ({GIVEN})'
        )
    if s.t.size < 2 * n:
        raise s.refuse(
            f'it lasts {s.t[-1] - s.t[0]:.3g} s; spectra of segments of {p.segment:g} s need {2.0 * p.segment:g} s; '
            f'give segment=... ({GIVEN})'
        )
    rest = round(AT_REST * s.rate) + 1
    ends = [
        n // 2 if np.ptp(part) < RESTS * np.ptp(s['steering']) else 0
        for part in (s['steering'][:rest], s['steering'][-rest:])
    ]
    spectra = {'fs': s.rate, 'nperseg': n, 'noverlap': n - n // 4}
    x = np.pad(s['steering'], ends, 'mean', stat_length=rest)
    f, Sxx = signal.welch(x, **spectra)
    near = NEAR / p.segment  # a rate that is no whole number moves the lines a little
    band = (f >= p.low - near) & (f <= p.high + near)
    excited = band & (Sxx > EXCITED * Sxx.max())
    if excited.sum() < 0.7 * band.sum() or (np.ptp(x) < LEAST_STEP and np.ptp(x) < LEAST_STEP * s.vehicle.turned):
        raise s.refuse(
            f'the steering wheel does not excite frequencies from {p.low:g} to {p.high:g} Hz; the recording has no '
            'random or swept input'
        )
    figures = [Figure('speed', 'speed, mean', float(s['speed'].mean()), 'm/s')]
    charts = []
    for name, text in (('steering', 'steering-wheel angle'), *(x[:2] for x in RESPONSES)):
        damped = 1.0 - float(np.sinc(p.high * s.spacing.get(name, 0.0))) ** 2
        if damped > DAMPED:
            s.notes.append(
                f'the {text} is recorded every {s.spacing[name]:.3g} s, the others more often: straight lines between '
                f'its samples take {100.0 * damped:.2g} % of its amplitude at {p.high:g} Hz; record it more often, or '
                f'take a lower high=... ({GIVEN})'
            )
    for name, text, _ in RESPONSES:
        gain_unit = '1/s' if name == 'yaw_rate' else 'm/s^2/rad'
        y = np.pad(s[name], ends, 'mean', stat_length=rest)
        _, Sxy = signal.csd(x, y, **spectra)
        _, Syy = signal.welch(y, **spectra)
        H, coherence = Sxy / Sxx, np.abs(Sxy) ** 2 / (Sxx * Syy)
        g, phase = np.abs(H[excited]), np.unwrap(np.angle(H[excited]))
        phase -= 2.0 * math.pi * round(phase[0] / (2.0 * math.pi))
        at = f[excited]
        top = int(np.argmax(g))
        lowest = p.low if at[0] <= p.low + near else float(at[0])
        static = float(np.interp(lowest, at, g))
        down = crossing(at[top:], -g[top:], -static / math.sqrt(2.0))
        one = float(np.interp(1.0, at, phase)) if at[0] <= 1.0 <= at[-1] else math.nan
        figures += [
            Figure(f'{name}_static_gain', f'{text} per steering-wheel angle at {lowest:g} Hz', static, gain_unit),
            Figure(f'{name}_peak_frequency', f'{text}, frequency of the largest gain', float(at[top]), 'Hz'),
            Figure(
                f'{name}_peak_ratio', f'{text}, largest gain over that at {lowest:g} Hz', float(g[top]) / static, '1'
            ),
            Figure(f'{name}_bandwidth', f'{text}, gain 3 dB down', down, 'Hz'),
            Figure(f'{name}_phase_1hz', f'{text}, phase at 1 Hz', one, 'rad'),
            Figure(f'{name}_delay_1hz', f'{text}, equivalent delay at 1 Hz', -one / (2.0 * math.pi), 's'),
            Figure(f'{name}_least_coherence', f'{text}, least coherence', float(coherence[excited].min()), '1'),
        ]
        figures += [
            Figure(
                f'{name}_gain_{k:g}hz',
                f'{text} per steering-wheel angle at {k:g} Hz',
                float(np.interp(k, at, g)),
                gain_unit,
            )
            for k in TABLE
            if at[0] - near <= k <= at[-1] + near and abs(k - lowest) > 1e-9
        ]
        if coherence[excited].min() < COHERENT:
            s.notes.append(
                f'the coherence of the {text} falls below {COHERENT:g}: the figures there are of noise or of a '
                'response that is not linear'
            )
        hertz = ('frequency', 'Hz')
        charts += [
            Chart(
                title=f'{text}, gain',
                x=hertz,
                y=(f'{text} per steering-wheel angle', gain_unit),
                curves=(Curve('gain', at, g),),
            ),
            Chart(title=f'{text}, phase', x=hertz, y=('phase', 'rad'), curves=(Curve('phase', at, phase),)),
            Chart(
                title=f'{text}, coherence',
                x=hertz,
                y=('coherence', '1'),
                curves=(Curve('coherence', at, coherence[excited]),),
            ),
        ]
    return Result(
        evaluation='iso7401_frequency', title='Frequency '
            'response', norm=NORM, figures=tuple(figures), charts=tuple(charts),
        notes=tuple(s.notes), source=s.place,
    )  # fmt: skip


STEP = Evaluation(
    name='iso7401_step',
    title='step steer: response times, overshoot, TB factor',
    norm=NORM,
    needs=('steering', 'speed', 'yaw_rate', 'lateral_acceleration'),
    also=('roll', 'sideslip_angle'),
    parameters=StepSteer,
    judge=judge_step,
    drive=Drive(
        maneuver='iso7401_step',
        speed=80.0 / 3.6,
        duration=6.5,
        every=5,
        amplitude='maneuver.steering.value',
        reaches=4.0,
    ),
)
FREQUENCY = Evaluation(
    name='iso7401_frequency',
    title='frequency response to a swept or random input: gain, phase, coherence',
    norm=NORM,
    needs=('steering', 'speed', 'yaw_rate', 'lateral_acceleration'),
    parameters=FrequencyResponse,
    judge=judge_frequencies,
    drive=Drive(
        maneuver='iso7401_frequency',
        speed=80.0 / 3.6,
        duration=62.0,
        amplitude='maneuver.steering.amplitude',
        reaches=2.0,
    ),
)
