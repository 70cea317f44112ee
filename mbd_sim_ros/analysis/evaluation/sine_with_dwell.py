"""Sine with dwell: electronic stability control by [ESC2007], the test that [ISOValidation2016] (ISO 19365) simulates.

Steering wheel, yaw rate and lateral acceleration pass 12-pole Butterworth filters without phase (10, 6 and 6 Hz) and
lose their means over the second before the steering wheel turns faster than 75 deg/s for 200 ms (its rate is a running
mean over 0.1 s). Then

    beginning of steer (BOS)    the steering wheel reaches 5 deg
    completion of steer (COS)   it is back at zero after the dwell, or where it rests beside, at 0.5 deg
    second peak of yaw rate     the first one after the steering wheel has changed its sign; a car that goes on turning
                                to its first side has none, and is not stable
    stability                   yaw rate 1.00 s and 1.75 s after COS at most 35 % and 20 % of that peak
    responsiveness              lateral displacement 1.07 s after BOS at least 1.83 m (1.52 m above 3500 kg), for
                                amplitudes from 5 A on, by integrating the lateral acceleration twice, from zero at BOS

A is the angle of the steering wheel at 0.3 g and 80 km/h in a slow ramp (13.5 deg/s, straight line, mean of both sides,
to 0.1 deg). Series to both sides begin with 1.5 A and grow by 0.5 A up to 6.5 A or 270 deg, whichever is more, and 300
deg at most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mbd_sim_ros.analysis.evaluation.figures import Chart, Curve, Figure, Result
from mbd_sim_ros.analysis.evaluation.kinds import Drive, Evaluation
from mbd_sim_ros.analysis.evaluation.measures import at, crossing, integral, low_passed
from mbd_sim_ros.analysis.evaluation.signals import GIVEN, Signals
from solver.errors import SpecError
from solver.units import STANDARD_GRAVITY

NORM = 'FMVSS 126, 49 CFR 571.126 [ESC2007]; ISO 19365 [ISOValidation2016]'
FAST, LASTS = math.radians(75.0), 0.2  # rate of the steering wheel [rad/s], for how long [s]
BEGIN = math.radians(5.0)
# rad from zero, and s later: a steering wheel that is not at zero by then rests beside it
RETURNED, SOON = math.radians(0.5), 0.05
AFTER = ((1.0, 0.35), (1.75, 0.20))  # s after COS, ratio allowed
WHEN, NEAR, NEAR_HEAVY, HEAVY = 1.07, 1.83, 1.52, 3500.0  # s after BOS, m, m above kg
FROM = 5.0  # amplitudes over A for which responsiveness is asked for
FIRST, STEP, LAST = 1.5, 0.5, 6.5  # of A
LEAST = 0.9  # of the first amplitude, below which no run of a series lies
FREQUENCY = 0.7  # Hz
LEAST_RATE = 25.0  # Hz: what is recorded more seldom has nothing that a filter of 10 Hz could take
SPEED, SPEED_TO = 80.0 / 3.6, 2.0 / 3.6  # m/s
LEAST_LAST, MOST_LAST = math.radians(270.0), math.radians(300.0)


@dataclass(frozen=True, kw_only=True)
class SineWithDwell:
    """reference: the angle A at the steering wheel [rad]; without it responsiveness is given but not judged. mass: of
    the vehicle, which decides the displacement that is asked for (none: of the scene; where neither is known, a light
    one) [kg]."""

    reference: float | None = None
    mass: float | None = None


def series(reference: float) -> list[float]:
    """The amplitudes [rad] of one side for the angle A [rad]. Raises SpecError for a steering that is too direct for
    them."""
    # that turns faster than FAST for so long
    slowest = FAST / (math.tau * FREQUENCY * math.cos(math.tau * FREQUENCY * LASTS))
    if FIRST * reference < slowest:
        raise SpecError(
            'fmvss126 is no maneuver for so direct a steering: A, its angle at 0.3 g, is '
            f'{math.degrees(reference):.3g} deg, and a sine of {FIRST:g} A does not turn the steering wheel at 75 '
            f'deg/s, by which the norm finds its beginning; that takes A = {math.degrees(slowest / FIRST):.3g} deg'
        )
    last = min(max(LAST * reference, LEAST_LAST), MOST_LAST)
    amplitudes, k = [], 0
    while (FIRST + STEP * k) * reference < last - 1e-9:
        amplitudes.append((FIRST + STEP * k) * reference)
        k += 1
    return [*amplitudes, last]


def judge(s: Signals, p: SineWithDwell) -> Result:
    """The ratios and the displacement of one run. Raises BagError."""
    t = s.t
    apart = s.every('steering', 'yaw_rate', 'lateral_acceleration')
    if apart > 1.0 / LEAST_RATE:
        s.notes.append(
            f'recorded every {apart:.3g} s: the filters of the norm and its instants between samples need '
            f'{LEAST_RATE:g} a second at least'
        )
    wheel = low_passed(s['steering'], s.rate, 10.0)
    width = max(1, round(0.1 * s.rate))
    rate = np.convolve(np.gradient(wheel, t), np.full(width, 1.0 / width), mode='same')
    fast = np.abs(rate) > FAST
    hold = max(1, round(LASTS * s.rate))
    lasting = [
        k
        for k in np.flatnonzero(fast[:-hold] & ~np.concatenate([[False], fast[: -hold - 1]]))
        if fast[k : k + hold].all()
    ]
    if not lasting:
        raise s.refuse(
            f'no sine with dwell in the recording: the steering wheel does not turn faster than 75 deg/s for {LASTS:g} '
            's'
        )
    zeroing = float(t[lasting[0]])
    before = s.between(zeroing - 1.0, zeroing)
    wheel = wheel - wheel[before].mean()
    yaw, acceleration = low_passed(s['yaw_rate'], s.rate, 6.0), low_passed(s['lateral_acceleration'], s.rate, 6.0)
    yaw, acceleration = yaw - yaw[before].mean(), acceleration - acceleration[before].mean()
    side = math.copysign(1.0, wheel[np.argmax(np.abs(wheel) * s.between(zeroing, zeroing + 0.6))])
    wheel, yaw, acceleration = side * wheel, side * yaw, side * acceleration
    bos = crossing(t, wheel, BEGIN, after=_quiet(t, wheel, zeroing))
    reversal = crossing(t, -wheel, 0.0, after=bos + 0.2)
    if math.isnan(reversal):
        raise s.refuse('no sine with dwell in the recording: the steering wheel turns to one side only')
    largest = float(np.max(-wheel[s.between(reversal, reversal + 2.5)]))
    dwells = crossing(t, -wheel, 0.7 * largest, after=reversal)
    back = crossing(t, wheel, -RETURNED, after=dwells)
    cos = crossing(t, wheel, 0.0, after=back)
    if not cos <= back + SOON:
        cos = back  # it rests beside zero
    if math.isnan(cos) or t[-1] < cos + AFTER[-1][0]:
        raise s.refuse(
            f'the recording ends before {AFTER[-1][0]:g} s after the completion of steer; no sine with dwell that can '
            'be judged'
        )
    held = float(np.mean(-wheel[s.between(reversal, cos)] > 0.95 * largest) * (cos - reversal))
    if held < 0.3:
        raise s.refuse(
            f'no sine with dwell in the recording: the steering wheel stays at its second peak for {held:.2g} s '
            'instead of 0.5 s'
        )
    amplitude = float(np.max(np.abs(wheel[s.between(bos, cos)])))
    peak_time, peak_yaw = _second_peak(t, -yaw, s.between(reversal, cos + 0.5))
    answers = peak_yaw > 0.0  # to the second side
    begin = s.between(bos, bos + WHEN + 0.1)
    start = max(int(np.argmax(begin)) - 1, 0)
    tt, aa = (
        np.concatenate([[bos], t[start:][t[start:] > bos]]),
        np.concatenate([[at(t, acceleration, bos)], acceleration[start:][t[start:] > bos]]),
    )
    moved = at(tt, integral(tt, integral(tt, aa)), bos + WHEN)
    mass = p.mass if p.mass is not None else s.vehicle.known('mass')
    needed = NEAR_HEAVY if mass is not None and mass > HEAVY else NEAR
    asked = p.reference is not None and amplitude >= FROM * p.reference - math.radians(0.5)
    speed = at(t, s['speed'], bos)
    figures = [
        Figure(
            'amplitude',
            'amplitude of the steering wheel, first to the ' + ('left' if side > 0.0 else 'right'),
            side * amplitude,
            'rad',
        ),
        Figure('speed', 'speed at the beginning of steer', speed, 'm/s'),
        Figure('peak_yaw_rate', 'second peak of the yaw rate', peak_yaw if answers else math.nan, 'rad/s'),
    ]
    if p.reference is not None:
        figures.insert(1, Figure('over_reference', 'amplitude over A', amplitude / p.reference, '1'))
    for seconds, allowed in AFTER:
        ratio = abs(at(t, yaw, cos + seconds)) / peak_yaw if answers else math.inf
        name = f'yaw_rate_ratio_{seconds * 100:.0f}'
        figures.append(
            Figure(
                name,
                f'yaw rate {seconds:.2f} s after completion of steer over that',
                ratio,
                '1',
                f'<= {allowed:.2f}',
                ratio <= allowed,
            )
        )
    limit = f'>= {needed:g} m' + ('' if asked else f' from {FROM:g} A on')
    figures.append(
        Figure(
            'displacement',
            f'lateral displacement {WHEN:g} s after beginning of steer',
            moved,
            'm',
            limit,
            moved >= needed if asked else None,
        )
    )
    notes = list(s.notes)
    if abs(speed - SPEED) > SPEED_TO:
        notes.append(
            f'steered at {3.6 * speed:.4g} km/h; the norm wants {3.6 * SPEED:g} km/h, to {3.6 * SPEED_TO:g} km/h'
        )
    if not answers:
        notes.append(
            'the yaw rate does not follow the steering wheel to its other side, so it has no second peak: the car '
            'spins, or a sign is wrong'
        )
    if p.reference is not None and amplitude < LEAST * FIRST * p.reference:
        notes.append(
            f'the amplitude is {amplitude / p.reference:.3g} A, and the series of the norm begins with {FIRST:g} A: '
            f'check reference, the angle A in rad, which is {math.degrees(p.reference):.4g} deg here; responsiveness '
            f'is judged from {FROM:g} A on'
        )
    if p.reference is None:
        notes.append(f'responsiveness is not judged: the angle A is not known; give reference=... in rad ({GIVEN})')
    marks = np.array([peak_time, cos + 1.0, cos + 1.75])
    allowed_at = np.array([AFTER[0][1], AFTER[1][1]]) * max(peak_yaw, 0.0)
    seen = side * np.array([at(t, yaw, m) for m in marks])
    shown = s.between(bos - 0.5, cos + 2.2)
    charts = (
        Chart(
            title='steering', x=('time', 's'), y=('steering-wheel angle', 'rad'),
            curves=(Curve('steering wheel', t[shown] - bos, side * wheel[shown]),),
        ),
        Chart(
            title='yaw rate', x=('time', 's'), y=('yaw rate', 'rad/s'),
            curves=(
                Curve('yaw rate', t[shown] - bos, side * yaw[shown]),
                Curve('second peak, 1.00 s and 1.75 s after completion', marks - bos, seen, 'points'),
                *(
                    Curve('allowed' if k == 0 else '', np.array([m - 0.15, m + 0.15]) - bos, np.full(2, sign * limit),
                    'limit')
                    for k, (m, limit, sign) in enumerate((m, x, sign) for m, x in zip(marks[1:],
                    allowed_at) for sign in (-1.0, 1.0))
                ),
            ),
        ),
        Chart(
            title='lateral displacement', x=('time', 's'), y=('lateral displacement', 'm'),
            curves=(
                Curve('displacement', tt[tt <= bos + 1.5] - bos,
                side * integral(tt, integral(tt, aa))[tt <= bos + 1.5]),
                Curve('asked for at 1.07 s', np.array([WHEN]), np.array([side * needed]), 'points'),
            ),
        ),
    )  # fmt: skip
    return Result(
        evaluation='fmvss126',
        title='Sine with dwell',
        norm=NORM,
        figures=tuple(figures),
        charts=charts,
        notes=tuple(notes),
        source=s.place,
    )


def _quiet(t: np.ndarray, wheel: np.ndarray, zeroing: float) -> float:
    """The last instant before the fast turn at which the steering wheel is nearly straight."""
    still = (t <= zeroing) & (np.abs(wheel) < 0.5 * BEGIN)
    return float(t[still][-1]) if still.any() else zeroing


def _second_peak(t: np.ndarray, y: np.ndarray, inside: np.ndarray) -> tuple[float, float]:
    """(time, value) of the first local maximum among the samples inside that is above half of the largest of them."""
    k = np.flatnonzero(inside)
    v = y[k]
    tops = [i for i in range(1, v.size - 1) if v[i] >= v[i - 1] and v[i] > v[i + 1] and v[i] > 0.5 * v.max()]
    i = tops[0] if tops else int(np.argmax(v))
    return float(t[k[i]]), float(v[i])


def together(results: list[Result]) -> tuple[Figure, ...]:
    """Figures of a whole series: the worst of each criterion."""
    figures = [Figure('runs', 'runs', float(len(results)), '1')]
    for seconds, allowed in AFTER:
        name = f'{seconds * 100:.0f}'
        worst = max(r[f'yaw_rate_ratio_{name}'] for r in results)
        text = f'largest yaw rate ratio at {seconds:.2f} s'
        figures.append(Figure(f'worst_ratio_{name}', text, worst, '1', f'<= {allowed:.2f}', worst <= allowed))
    asked = [(f.value, f.ok) for r in results for f in r.figures if f.name == 'displacement' and f.ok is not None]
    if asked:
        text = f'least lateral displacement from {FROM:g} A on'
        limit = next(f.limit for r in results for f in r.figures if f.name == 'displacement' and f.ok is not None)
        figures.append(
            Figure('least_displacement', text, min(d for d, _ in asked), 'm', limit, all(ok for _, ok in asked))
        )
    by_amplitude = sorted(
        (abs(r['amplitude']), all(f.ok for f in r.figures if f.name.startswith('yaw_rate_ratio'))) for r in results
    )
    lost = min((a for a, stable in by_amplitude if not stable), default=math.inf)
    up_to = max((a for a, _ in by_amplitude if a < lost), default=0.0)
    figures.append(Figure('stable_up_to', 'largest amplitude up to which every run is stable', up_to, 'rad'))
    return tuple(figures)


SINE_WITH_DWELL = Evaluation(
    name='fmvss126',
    title='sine with dwell: yaw-rate ratios after completion of steer, lateral displacement',
    norm=NORM,
    needs=('steering', 'speed', 'yaw_rate', 'lateral_acceleration'),
    parameters=SineWithDwell,
    judge=judge,
    drive=Drive(
        maneuver='fmvss126',
        speed=80.0 / 3.6,
        duration=6.2,
        every=5,
        amplitude='maneuver.steering.amplitude',
        reaches=0.3 * STANDARD_GRAVITY,
        series=series,
    ),
    together=together,
    aliases=('iso19365', 'sine_with_dwell'),
)
