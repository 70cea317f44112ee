"""Frequency response of yaw rate and lateral acceleration to the steering, from all stretches of a drive at about one
speed.

The drive is cut into segments that overlap by half, with Hann windows [Welch1967]; segments whose speed stays within a
band count. H = S_xy/S_xx, coherence = |S_xy|^2/(S_xx S_yy). A frequency is told where the coherence is COHERENT or
more, and the interval of gain and phase, by leaving out each segment in turn, is narrow enough.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.analysis.evaluation.drive.blocks import LEAST, Estimate, estimate, not_told
from mbd_sim_ros.analysis.evaluation.drive.handling import steering_of
from mbd_sim_ros.analysis.evaluation.drive.moments import Moments

BAND = 1.15  # largest speed of a band over its middle, and that over its least; ten times as much mixes cars
BANDS = 3  # at most; ten times as many have no segments
COHERENT = 0.7  # least coherence; of 0.07 nothing is left of the response
WIDE = 0.25  # half interval of the gain, relative to it, up to which a frequency is told; 2.5 tells not even its size
CORNER = 1.0  # Hz below which the spectrum of the steering is made flat; ten times as much is beyond the steering
MOST_TIMES = 3  # that filter; ten times as many amplify noise
FINE = 100.0  # samples per second of the spectra at most; ten times as many only cost time
HIGHEST = 5.0  # Hz of the curves; ten times as much is vibration of the body
FIRST = 3  # line of a segment that is given; the window mixes lower ones with those beside them
TABLE = (0.6, 1.0, 2.0, 3.0)  # Hz, lines of segments of 5 s


class Response(NamedTuple):
    """Response of one output at one frequency: gain, phase [rad], and coherence."""

    frequency: float
    gain: Estimate
    phase: Estimate
    coherence: float


class Band(NamedTuple):
    """A band of speeds: mean speed [m/s], how many segments, responses by output."""

    speed: float
    segments: int
    outputs: dict[str, list[Response]]


def bands(m: Moments, length: float) -> tuple[list[Band], str]:
    """(the bands of speed with the most segments of `length` [s], why there is none)."""
    steering = steering_of(m, 0.5 * m.s.rate)
    outputs = [name for name in ('yaw_rate', 'lateral_acceleration') if name in m.s]
    if steering is None or not outputs:
        return [], 'the recording has no steering with yaw rate or lateral acceleration'
    every = max(1, round(m.s.rate / FINE))
    rate = m.s.rate / every
    n = round(length * rate)
    if n < 1 or not _lines(n, rate).size:
        return [], f'stretches of {length:g} s at {m.s.rate:.4g} samples a second hold no frequency that is given'
    used = m.among('speed', *outputs, *steering.names)[::every]
    v = m.smooth('speed')[::every]
    begins = [b for b in range(0, used.size - n + 1, max(n // 2, 1)) if used[b : b + n].all()]
    if len(begins) < LEAST:
        some = f'{len(begins)} stretch{"" if len(begins) == 1 else "es"}'
        return [], f'only {some} of {length:g} s without a gap, standstill or low speed'
    low, high = (np.array([f(v[b : b + n]) for b in begins]) for f in (np.min, np.max))
    middle = np.sqrt(low * high)
    left = high / low <= BAND**2
    found: list[Band] = []
    turned = _coarse(steering.angle, every)
    whiten = _whitening(turned, begins, n, rate)
    turned, raw = whiten(turned), {name: whiten(_coarse(m.s[name], every)) for name in outputs}
    while left.any() and len(found) < BANDS:
        counts = [int(np.sum(left & (low >= c / BAND) & (high <= c * BAND))) for c in middle]
        best = int(np.argmax(np.where(left, counts, 0)))
        chosen = left & (low >= middle[best] / BAND) & (high <= middle[best] * BAND)
        if chosen.sum() < 2 * LEAST:
            break
        left &= ~chosen
        starts = np.array(begins)[chosen]
        speed = float(np.mean([np.mean(v[b : b + n]) for b in starts]))
        responses = {name: _responses(turned, raw[name], starts, n, rate) for name in outputs}
        found.append(Band(speed, int(chosen.sum()), responses))
    if not found:
        return [], (
            f'at no speed are there {2 * LEAST:g} stretches of {length:g} s within {100.0 * (BAND - 1.0):.0f} % of it'
        )
    return found, ''


def _coarse(values: np.ndarray, every: int) -> np.ndarray:
    """Means over `every` samples, as a low pass without delay, at every such sample."""
    if every == 1:
        return values
    from scipy.ndimage import uniform_filter1d

    return uniform_filter1d(values, every, mode='nearest')[::every]


def _whitening(x: np.ndarray, begins: Sequence[int], n: int, rate: float) -> Callable[[np.ndarray], np.ndarray]:
    """The filter that makes the spectrum of the steering about flat below CORNER: a high pass of first order, as often
    as its slope asks for. Steering is slow for the most part, and a window lets the power of slow steering into the
    lines above it. A filter of both x and y leaves H as it is."""
    from scipy import signal

    parts = signal.detrend(np.stack([x[b : b + n] for b in begins]), axis=1) * signal.windows.hann(n, sym=False)
    power, f = np.mean(np.abs(np.fft.rfft(parts, axis=1)) ** 2, axis=0), np.fft.rfftfreq(n, 1.0 / rate)
    band = (f > 0.0) & (f <= CORNER) & (power > 0.0)
    slope = np.polyfit(np.log(f[band]), np.log(power[band]), 1)[0] if band.sum() > 1 else 0.0
    times = int(np.clip(round(0.3 - 0.5 * float(slope)), 0, MOST_TIMES))
    b, a = signal.butter(1, CORNER, 'high', fs=rate)

    def whiten(values: np.ndarray) -> np.ndarray:
        for _ in range(times):
            values = signal.lfilter(b, a, values)
        return values

    return whiten


def _responses(x: np.ndarray, y: np.ndarray, starts: np.ndarray, n: int, rate: float) -> list[Response]:
    from scipy import signal

    window = signal.windows.hann(n, sym=False)
    X, Y = (
        np.fft.rfft(signal.detrend(np.stack([z[b : b + n] for b in starts]), axis=1) * window, axis=1) for z in (x, y)
    )
    f = np.fft.rfftfreq(n, 1.0 / rate)
    result = []
    for k in _lines(n, rate):
        Sxx, Syy, Sxy = (np.abs(X[:, k]) ** 2), (np.abs(Y[:, k]) ** 2), np.conj(X[:, k]) * Y[:, k]
        power = float(Sxx.sum() * Syy.sum())
        coherence = float(abs(Sxy.sum()) ** 2) / power if power > 0.0 else 0.0
        if coherence < COHERENT:
            nothing = not_told(f'coherence {coherence:.2f}, at least {COHERENT:g} is needed')
            result.append(Response(float(f[k]), nothing, nothing, coherence))
            continue
        H = Sxy.sum() / Sxx.sum()
        with np.errstate(invalid='ignore', divide='ignore'):
            without = (Sxy.sum() - Sxy) / (Sxx.sum() - Sxx)
        gain = estimate(float(abs(H)), np.abs(without), Sxx)
        if gain.told and not gain.half < WIDE * gain.value:
            gain = not_told(f'half of its interval is {100.0 * gain.half / gain.value:.3g} % of it, too much')
        turn = np.angle(without / H)
        phase = estimate(0.0, turn, Sxx)
        angle = float(np.angle(H))
        phase = phase._replace(value=angle, low=angle + phase.low, high=angle + phase.high)
        result.append(Response(float(f[k]), gain, not_told(gain.why) if gain.why else phase, coherence))
    return _continuous(result)


def _lines(n: int, rate: float) -> np.ndarray:
    """Lines of the spectra of n samples that are given."""
    f = np.fft.rfftfreq(n, 1.0 / rate)
    return np.flatnonzero((f > (FIRST - 0.5) * rate / n) & (f <= min(HIGHEST, 0.4 * rate)))


def _continuous(responses: list[Response]) -> list[Response]:
    """The same with phases that go on without jumps by full turns from one told frequency to the next."""
    result, before = [], 0.0
    for one in responses:
        if one.phase.told:
            turns = 2.0 * math.pi * round((one.phase.value - before) / (2.0 * math.pi))
            moved = Estimate(one.phase.value - turns, one.phase.low - turns, one.phase.high - turns)
            one, before = one._replace(phase=moved), moved.value
        result.append(one)
    return result


def at(responses: list[Response], frequency: float) -> Response | None:
    """The response at the line nearest to a frequency [Hz], None beyond the lines."""
    if not responses:
        return None
    nearest = min(responses, key=lambda one: abs(one.frequency - frequency))
    step = responses[1].frequency - responses[0].frequency if len(responses) > 1 else math.inf
    return nearest if abs(nearest.frequency - frequency) <= 0.51 * step else None
