"""Faults of recordings that no fit should explain away: told before anything is fitted, one sentence each.

The vehicle as it is given is driven by the recordings. A signal that is turned, late, of another scale, or whose delay
grows, shows in its correlation with the predicted one; all that a vehicle of another size does shows in all signals at
once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbd_sim_ros.fitting.problem import Problem
from mbd_sim_ros.fitting.sensors import DELAY, LOOK
from solver.errors import BagError

LATE = 6.0  # sd of a delay from which it is a fault; with ten times as many 1 s is none
ALIKE = 0.8  # correlation from which a delay is believed; from 0.08 on noise has one
# s by which delays of one recording may differ, of a passenger car; ten times as much hides a clock that drifts
DRIFT = 0.08
AGREE = (
    0.5  # part of a delay by which windows may differ about it; ten times as much takes a wrong car for a late clock
)
# probability of a slope of the delays that scatters from window to window; with ten times as much one good recording in
# a hundred has a clock that drifts
CHANCE = 1e-3
CHANGES = 0.2  # part of its RMS by which a signal must change to be looked at; ten times as much looks at none
OFF = 1.6  # factor of a scale that no car of the class explains; 16 lets degrees pass for percent
# The same of a signal that is a small difference of two terms, of geometry and of the rear tires: a class of tires
# moves it by a factor of two; 40 lets degrees pass for radians
OFF_OF_DIFFERENCE = 4.0
DIFFERENCES = ('sideslip', 'lateral_velocity')
QUICK = ('yaw_rate', 'lateral_acceleration', 'roll_rate', 'sideslip', 'lateral_velocity', 'roll')


class Seen(NamedTuple):
    """A signal in a window beside the predicted one: best delay [s], correlation there, correlation without delay,
    factor."""

    delay: float
    best: float
    now: float
    factor: float
    middle: float
    weight: float


def seen(problem: Problem, t: np.ndarray, y: np.ndarray, s: np.ndarray, window: int) -> Seen:
    """A measured signal y beside a predicted one s at times t."""
    dt = problem.dt
    grid = np.arange(t[0], t[-1], dt)
    a, b = np.interp(grid, t, y), np.interp(grid, t, s)
    most = int(LOOK * problem.car.size.time / dt)
    if grid.size < 3 * most:
        return Seen(0.0, 0.0, 0.0, 1.0, 0.0, 0.0)
    lags = np.arange(-most, most + 1)
    core = b[most : b.size - most]
    found = []
    for lag in lags:
        piece = a[most + lag : a.size - most + lag]
        found.append(_correlation(piece, core))
    c = np.array(found)
    k = int(np.argmax(np.abs(c)))
    shift = 0.0
    if 0 < k < c.size - 1:
        low, mid, high = abs(c[k - 1]), abs(c[k]), abs(c[k + 1])
        bend = low - 2.0 * mid + high
        shift = 0.5 * (low - high) / bend if bend < 0.0 else 0.0
    piece = a[most + lags[k] : a.size - most + lags[k]]
    centred = core - core.mean()
    factor = float((piece - piece.mean()) @ centred / max(float(centred @ centred), 1e-300))
    begin = problem.windows[window].begin
    return Seen(float((lags[k] + shift) * dt), float(c[k]), float(c[most]), factor, begin + float(t.mean()),
                float(centred @ centred))  # fmt: skip


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    x, y = a - a.mean(), b - b.mean()
    return float(x @ y / max(np.sqrt(float(x @ x) * float(y @ y)), 1e-300))


def screen(problem: Problem) -> None:
    """Refuse recordings with a fault. Raises BagError, one sentence."""
    which = [*problem.of('fit'), *problem.of('held_out')]
    x = problem.start
    signals = problem.signals(x, problem.motions(x, which), which)
    time = problem.car.size.time
    found: dict[tuple[str, str], list[Seen]] = {}
    for piece, s in zip(problem.pieces, signals, strict=True):
        if problem.kinds[piece.channel] not in QUICK:
            continue
        one = seen(problem, piece.t, piece.y, s, piece.window)
        # in a steady circle there is nothing to correlate but noise
        moves = np.std(s) > max(CHANGES * float(np.sqrt(np.mean(s * s))), 3.0 * problem.noise[piece.channel].noise)
        if one.weight > 0.0 and moves:
            recording = problem.windows[piece.window].recording
            found.setdefault((recording, piece.channel), []).append(one)
    for recording in problem.data:
        own = {name: some for (r, name), some in found.items() if r == recording}
        if own:
            _look(problem, recording, own, time)


def _look(problem: Problem, recording: str, own: dict[str, list[Seen]], time: float) -> None:
    def mean(some: list[Seen], field: str) -> float:
        weights = np.array([one.weight * one.best**2 for one in some]) + 1e-300
        return float(np.average([getattr(one, field) for one in some], weights=weights))

    turned = [name for name, some in own.items() if mean(some, 'best') < -ALIKE and mean(some, 'now') < 0.0]
    if turned and len(turned) == len(own) and len(own) > 1:
        raise BagError(
            f'recording {recording!r}: all signals have the wrong sign for this steering: give the steering sign: -1 '
            'in the mapping'
        )
    if turned:
        raise BagError(
            f'recording {recording!r}: {turned[0]} has the wrong sign (correlation {mean(own[turned[0]], "now"):.2f} '
            'with the predicted one): give its channel sign: -1 in the mapping'
        )
    clear = {name: [one for one in some if one.best > ALIKE] for name, some in own.items()}
    clear = {name: some for name, some in clear.items() if some}
    steering = next((u for u in problem.unknowns if u.name == 'steering.delay'), None)
    delays = {}
    for name, some in clear.items():
        known = next((u for u in problem.unknowns if u.name == f'{name}.delay'), None)
        centre, sd = (0.0, DELAY * time) if known is None else (known.centre, known.sd)
        allowed = LATE * np.hypot(sd, 0.0 if steering is None else steering.sd) + 2.0 * problem.dt
        delays[name] = (mean(some, 'delay') - centre, allowed)
    for name, some in clear.items():
        if len(some) >= 3:
            from scipy.stats import t as student

            at, late = np.array([one.middle for one in some]), np.array([one.delay for one in some])
            slope, first = np.polyfit(at, late, 1)
            span = float(at[-1] - at[0])
            rest = float(np.sum((late - slope * at - first) ** 2)) / (at.size - 2)
            sure = float(student.ppf(1.0 - 0.5 * CHANCE, at.size - 2)) * (rest / np.sum((at - at.mean()) ** 2)) ** 0.5
            if abs(slope) * span > DRIFT * time and abs(slope) > sure:
                raise BagError(
                    f'recording {recording!r}: the clock of {name} drifts by {1e3 * slope:.2g} ms a second against '
                    f'that of the steering ({abs(slope) * span:.2g} s in all): stamp both by one clock'
                )
    late_all = [
        name for name, (delay, allowed) in delays.items()
        # a clock is late in all windows alike; where a wrong car leads, it leads in some and lags in others
        if abs(delay) > allowed and float(np.std([one.delay for one in clear[name]])) < AGREE * abs(delay)
    ]  # fmt: skip
    if late_all and len(late_all) == len(delays) and len(delays) > 1:
        delay = float(np.median([delays[name][0] for name in late_all]))
        raise BagError(
            f'recording {recording!r}: all signals come {abs(delay):.2f} s {"after" if delay > 0 else "before"} the '
            f'steering that makes them: mend the stamps of the steering, or give drive.delay its value ({-delay:.2f} s)'
        )
    if late_all:
        delay = delays[late_all[0]][0]
        raise BagError(
            f'recording {recording!r}: {late_all[0]} is {abs(delay):.2f} s {"late" if delay > 0 else "early"}, more '
            f'than a usual sensor: correct its stamps, or write delay: {{value: {delay:.2f} s}} under the channel'
        )
    factors = {name: mean(some, 'factor') for name, some in clear.items()}
    most = {name: OFF_OF_DIFFERENCE if name.partition('.')[0] in DIFFERENCES else OFF for name in factors}
    far = {name: f for name, f in factors.items() if not 1.0 / most[name] < f < most[name]}
    if far and len(far) == len(factors) and len(far) > 1:
        raise BagError(
            f'recording {recording!r}: all signals are {float(np.median(list(far.values()))):.2g} times those of the '
            'vehicle: the recording is of another car, or the unit of the steering in the mapping is wrong'
        )
    if far:
        name, factor = next(iter(far.items()))
        raise BagError(
            f'recording {recording!r}: {name} is {factor:.3g} times the predicted one and the other signals are not: '
            'is its unit right?'
        )
    alike = [mean(some, 'best') for some in own.values()]
    if max(alike) < 0.5:
        raise BagError(
            f'recording {recording!r}: no signal goes with the steering (correlation {max(alike):.2f} at most): it is '
            'that of another drive or car, or the columns are not what the mapping says'
        )
