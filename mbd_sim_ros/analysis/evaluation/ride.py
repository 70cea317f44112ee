"""Ride comfort [ISO2631]: weighted accelerations of the body, running RMS, vibration dose values.

A frequency weighting is the product of a band limitation, a transition from acceleration to velocity, and an upward
step:

    H = s^2/(s^2 + w1 s/Q1 + w1^2) * w2^2/(s^2 + w2 s/Q2 + w2^2) * (1 + s/w3)/(1 + s/(Q4 w4) + (s/w4)^2)
        * (1 + s/(Q5 w5) + (s/w5)^2)/(1 + s/(Q6 w6) + (s/w6)^2) (w5/w6)^2 * K

with Q1 = Q2 = 1/sqrt(2). W_k is for the vertical direction of a seated person, W_d (without the step) for the
horizontal directions, W_b for the vertical direction in trains (ISO 2631-4). A weighting multiplies the spectrum of the
signal, which is exact at every sampling rate. SILENCE is appended to the signal, so that the end of the filter's
response does not wrap around to the beginning.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.analysis.evaluation.figures import Chart, Curve, Figure, Result
from mbd_sim_ros.analysis.evaluation.kinds import Drive, Evaluation, speed_of
from mbd_sim_ros.analysis.evaluation.measures import integral, low_passed
from mbd_sim_ros.analysis.evaluation.signals import Signals
from solver.elements.road import within
from solver.scene import Scene

NORM = 'ISO 2631-1:1997 [ISO2631]'
SILENCE = 10.0  # zeros after the signal [s]; the response of the slowest filter, 0.4 Hz, has died out after 2 s
# (upper end of the total value [m/s^2], likely reaction in public transport), annex C of the norm.
COMFORT: tuple[tuple[float, str], ...] = (
    (0.315, 'not uncomfortable'), (0.63, 'a little '
        'uncomfortable'), (1.0, 'fairly uncomfortable'), (1.6, 'uncomfortable'),
    (2.5, 'very uncomfortable'), (math.inf, 'extremely uncomfortable'),
)  # fmt: skip
CREST = 9.0  # crest factor above which the norm asks for MTVV or vibration dose value beside the RMS
SLOW = 0.5  # frequency [Hz] below which a horizontal acceleration comes from driving, not from vibration
DRIVEN = 1.0  # amplitude [m/s^2] of the acceleration from driving above which a note warns of it
SHORTEST = 220.0  # least length of the rough road [m]
# rough road beyond the last place of base_link [m]: for the front wheels, which are ahead of it, and a margin
AHEAD = 6.0


class Weighting(NamedTuple):
    """A frequency weighting: corner frequencies f [Hz], quality factors q [-], gain [-]. It has no step where f5 is
    0."""

    f1: float
    f2: float
    f3: float
    f4: float
    q4: float
    f5: float = 0.0
    q5: float = 1.0
    f6: float = 0.0
    q6: float = 1.0
    gain: float = 1.0

    def response(self, f: np.ndarray) -> np.ndarray:
        """(n,) complex response at the frequencies f [Hz]."""
        s = 1j * np.asarray(f, float)  # everything is relative to frequencies in Hz
        q = 1.0 / math.sqrt(2.0)
        high = s * s / (s * s + self.f1 / q * s + self.f1**2)
        low = self.f2**2 / (s * s + self.f2 / q * s + self.f2**2)
        transition = (1.0 + s / self.f3) / (1.0 + s / (self.q4 * self.f4) + (s / self.f4) ** 2)
        H = self.gain * high * low * transition
        if self.f5:
            H = (
                H
                * (1.0 + s / (self.q5 * self.f5) + (s / self.f5) ** 2)
                / (1.0 + s / (self.q6 * self.f6) + (s / self.f6) ** 2)
            )
            H = H * (self.f5 / self.f6) ** 2
        return H


WEIGHTINGS = {
    'wk': Weighting(0.4, 100.0, 12.5, 12.5, 0.63, 2.37, 0.91, 3.35, 0.91),
    'wd': Weighting(0.4, 100.0, 2.0, 2.0, 0.63),
    'wb': Weighting(0.4, 100.0, 16.0, 16.0, 0.55, 2.5, 0.9, 4.0, 0.95, 1.024),
}
PLACE = ('x', 'y', 'heading')  # signals that say where the car is on the road
AXES = (('x', 'ax', 'wd'), ('y', 'ay', 'wd'), ('z', 'az', 'wk'))  # (axis, signal, weighting)


@dataclass(frozen=True, kw_only=True)
class Ride:
    """constant: time constant of the running RMS [s]. begin: what is left out at the start [s]. kx, ky, kz: factors of
    the total value."""

    constant: float = 1.0
    begin: float = 2.0
    kx: float = 1.0
    ky: float = 1.0
    kz: float = 1.0


def weighted(y: np.ndarray, rate: float, weighting: Weighting) -> np.ndarray:
    """The signal y (n,), sampled at `rate` [Hz], after the weighting."""
    n = y.size + round(SILENCE * rate)
    return np.fft.irfft(np.fft.rfft(y - y[0], n) * weighting.response(np.fft.rfftfreq(n, 1.0 / rate)), n)[: y.size]


def running_rms(y: np.ndarray, rate: float, constant: float) -> np.ndarray:
    """Running RMS of y (n,) with the time constant T = `constant` [s].

    It is the root of (1/T) integral of y^2(u) exp((u - t)/T) du, exact for y^2 that is linear between samples.
    """
    from scipy import signal

    h = 1.0 / rate
    e = math.exp(-h / constant)
    first, second = 1.0 - constant / h * (1.0 - e), constant / h * (1.0 - e) - e
    square = y * y
    driven = np.concatenate([[0.0], first * square[1:] + second * square[:-1]])
    return np.sqrt(np.maximum(signal.lfilter([1.0], [1.0, -e], driven), 0.0))


def rough(s: Signals, scene: Scene) -> np.ndarray:
    """(n,) True while the car is on the rough part of the road: all wheels that ever come onto a height grid are on
    one."""
    c, d = np.cos(s['heading']), np.sin(s['heading'])
    places = {body.name: body.position for body in scene.model.bodies}
    wheels = []
    for tire in scene.model.tires:
        along, left, _ = places[tire.marker.body]
        x, y = s['x'] + c * along - d * left, s['y'] + d * along + c * left
        on = np.zeros(s.t.size, bool)
        for grid in scene.model.road.grids:
            on |= within(grid, x, y)
        wheels.append(on)
    wheels = [on for on in wheels if on.any()]
    return np.logical_and.reduce(wheels) if wheels else np.zeros(s.t.size, bool)


def judge(s: Signals, p: Ride) -> Result:
    """Ride comfort of a recording. Raises BagError for one that is too short or without vibration."""
    used = s.t >= s.t[0] + p.begin
    if used.sum() < 2 or s.t[-1] - s.t[0] < p.begin + 2.0:
        raise s.refuse(f'it lasts {s.t[-1] - s.t[0]:.3g} s; ride needs {p.begin + 2.0:g} s')
    if max(float(np.std(s[name][used])) for _, name, _ in AXES) < 1e-3:
        raise s.refuse('no vibration in the recording: the accelerations do not change')
    length = float(s.t[used][-1] - s.t[used][0])
    notes = list(s.notes)
    notes.append('accelerations are those of the IMU in the body, not those of a seat')
    rate = 1.0 / s.every(*(name for _, name, _ in AXES))  # of the accelerations; s.rate may be that of a faster topic
    if rate < 250.0:
        notes.append(
            f'recorded at {rate:.4g} Hz: nothing above {0.5 * rate:.4g} Hz is in the figures, the weightings reach to '
            '100 Hz'
        )
    slow = max(0.5 * float(np.ptp(low_passed(s[name], s.rate, SLOW, poles=4)[used])) for name in ('ax', 'ay'))
    if slow > DRIVEN:
        notes.append(
            f'the car accelerates, brakes or turns: its horizontal acceleration below {SLOW:g} Hz has an amplitude of '
            f'{slow:.2g} m/s^2; the figures contain it, although the norm is about vibration'
        )
    scene = s.vehicle.scene
    if scene is not None and scene.model.road.grids and all(name in s for name in PLACE):
        on = rough(s, scene)
        if not on[used].all():
            where = f'only from t = {s.t[on][0]:.3g} to {s.t[on][-1]:.3g} s' if on.any() else 'at no time'
            notes.append(
                f'the wheels are on the rough part of the road {where}, and the figures are of t = {s.t[used][0]:.3g} '
                f'to {s.t[used][-1]:.3g} s: make it longer, or the run shorter'
            )
    figures, charts, total = [], [], 0.0
    t = s.t[used]
    for (axis, name, key), factor in zip((*AXES, ('z', 'az', 'wb')), (p.kx, p.ky, p.kz, 0.0)):
        y = weighted(s[name], s.rate, WEIGHTINGS[key])
        running = running_rms(y, s.rate, p.constant)[used]
        y = y[used]
        rms = math.sqrt(float(integral(t, y * y)[-1]) / length)
        dose = float(integral(t, y**4)[-1]) ** 0.25
        crest = float(np.abs(y).max()) / rms if rms > 0.0 else math.nan
        total += (factor * rms) ** 2
        of = f'{axis}, {key[0].upper()}{key[1]}'
        figures.append(Figure(f'{axis}_{key}_rms', f'{of}: weighted RMS', rms, 'm/s^2'))
        figures.append(Figure(f'{axis}_{key}_vdv', f'{of}: vibration dose value', dose, 'm/s^1.75'))
        if key != 'wb':
            figures.append(
                Figure(f'{axis}_{key}_mtvv', f'{of}: largest running RMS (MTVV)', float(running.max()), 'm/s^2')
            )
            figures.append(Figure(f'{axis}_{key}_crest', f'{of}: crest factor', crest, '1'))
            if crest > CREST:
                notes.append(
                    f'crest factor of {axis} above {CREST:g}: the weighted RMS may understate it; look at MTVV and '
                    'vibration dose value'
                )
            label = (f'weighted acceleration, {axis}', 'm/s^2')
            charts.append(
                Chart(
                    title=f'{of}',
                    x=('time', 's'),
                    y=label,
                    curves=(Curve('weighted', t, y, 'other'), Curve('running RMS', t, running)),
                )
            )
    total = math.sqrt(total)
    figures.insert(0, Figure('total', 'vibration total value of the weighted RMS', total, 'm/s^2'))
    reaction = next(text for limit, text in COMFORT if total < limit)
    notes.append(f'a total value of {total:.3g} m/s^2 is in public transport {reaction} (annex C; its ranges overlap)')
    return Result(
        evaluation='iso2631',
        title='Ride comfort',
        norm=NORM,
        figures=tuple(figures),
        charts=tuple(charts),
        notes=tuple(notes),
        source=s.place,
    )


def road(scene: Scene) -> dict[str, object]:
    """Overrides of a scene that make its rough road as long as the way of the car."""
    return {'road.grids[0].length': max(SHORTEST, 10.0 * math.ceil(0.1 * (speed_of(scene) * scene.duration + AHEAD)))}


RIDE = Evaluation(
    name='iso2631',
    title='ride comfort: weighted accelerations, running RMS, vibration dose values',
    norm=NORM,
    needs=('ax', 'ay', 'az'),
    also=PLACE,
    parameters=Ride,
    judge=judge,
    drive=Drive(maneuver='iso2631', speed=70.0 / 3.6, duration=11.0, every=2, road='class_c', fitted=road),
)
