"""Sensors of a drive against each other: factor, delay and offset of every relation that laws of motion state.

    yaw rate         = d(heading)/dt
    speed            = |d(x, y)/dt|
    lateral acceleration = v r + d(v beta)/dt + x dr/dt, with the sideslip angle beta; without it the second part is not
                       known, and at one speed it looks like a delay
    acceleration ax  = dv/dt
    wheel speed      = v, its factor is 1 of speeds and 1/radius of rates

One signal y follows another x as y(t) = g x(t - T) + b: T is found roughly by cross-correlation [Lewis1995], and y,
shifted by it, is regressed on x, dx/dt and 1. A clock that drifts changes T, by the coefficient of (t - mean) dx/dt.
A relation that holds clears its sensors; in one that does not, those not cleared are named.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.analysis.evaluation.drive.blocks import Estimate, Regression, not_told, stretches
from mbd_sim_ros.analysis.evaluation.drive.handling import CALM, VARIES, steering_of
from mbd_sim_ros.analysis.evaluation.drive.moments import ORDINARY, SMOOTH, Moments, held
from mbd_sim_ros.analysis.evaluation.measures import low_passed
from mbd_sim_ros.analysis.evaluation.signals import WHEELS
from solver.units import STANDARD_GRAVITY

LAG = 1.0  # largest delay that is sought [s]; ten times as much matches one bend with the next
TINY = 1e-3  # of the largest product of powers at a lag, below which there is nothing to correlate; 1 leaves one lag
FOLLOWS = 0.5  # correlation from which on one signal follows another; ten times as much does not exist
LEAST_TIME = 5.0  # s of common moments at least; ten times as much is not in a drive of minutes
# Correlation from which on a unit, a shift or a drift is named: noise of 1 - CLEAR^2 of the power makes a factor as
# much smaller; and from which on a sign is.
CLEAR, SIDE = 0.95, 0.7
LONG = 30.0  # s of moments, from which on shifts and drifts are named; ten times as much is not in a lap
FACTOR = 0.15  # of a factor from 1 that a tilt of the body or the slip of a wheel may explain; 1.5 hides a sign
SHIFT = 0.05  # s of a time shift between sensors that is named; ten times as much is never seen on a bus
SLIPPING = 0.3  # s, delay of a wheel speed that slip may look like; ten times as much is a stop from walking pace
CAUSE = 0.5  # s, largest delay of a car after its steering, those with a trailer too; ten times as much has no meaning
OPPOSED = 'the car turns to the other side than it is steered'
GRIP = 8.0  # 1/rad, cornering stiffness over load of soft tires: the lag of ay behind v r is v/(g GRIP) at most
LEAST_GAIN = 0.1  # of 1 + K/L v^2, where an oversteering car is near its critical speed; 1 is a neutral car
LEVER = 3.0  # m that a sensor, or the rear axle, is from the point of the speed; bounds the lead of ay before v r
UNITS = {  # sensor -> other units that it may be in, with the factor of its values then
    'yaw_rate': {'deg/s': 180.0 / math.pi},
    'heading': {'deg': 180.0 / math.pi},
    'lateral_acceleration': {'g': 1.0 / STANDARD_GRAVITY},
    'ax': {'g': 1.0 / STANDARD_GRAVITY},
    'speed': {'km/h': 3.6, 'mph': 2.2369},
    'sideslip_angle': {'deg': 180.0 / math.pi},
    'place': {'mm': 1000.0, 'km': 0.001},
}
WHEEL_UNITS = {'km/h': 3.6, 'mph': 2.2369}
TEXTS = {
    'steering': 'steering', 'speed': 'speed', 'yaw_rate': 'yaw rate', 'lateral_acceleration': 'lateral acceleration',
    'heading': 'heading', 'place': 'place (x, y)', 'ax': 'longitudinal acceleration',
    'sideslip_angle': 'sideslip angle',
}  # fmt: skip


class Fault(NamedTuple):
    """Fault of a relation. kind: 'sign', 'swap' (of left and right), 'unit', 'shift' or 'drift'. detail:
    with numbers."""

    kind: str
    detail: str


class Relation(NamedTuple):
    """One signal after another. name: of its figures. text: of the relation. y, x: the sensors. unit: of the offset.
    fault: what does not hold, None where all does or nothing is told.
    clears: kinds of faults that its sensors do not have where it holds."""

    name: str
    text: str
    y: tuple[str, ...]
    x: tuple[str, ...]
    unit: str
    factor: Estimate
    delay: Estimate
    offset: Estimate
    fault: Fault | None
    clears: tuple[str, ...]

    def holds(self, kind: str) -> bool:
        """True where the relation shows that its sensors have no fault of this kind."""
        near = self.factor.low > 1.0 - 2.0 * FACTOR and self.factor.high < 1.0 + 2.0 * FACTOR
        sure = near if kind == 'unit' else self.factor.low > 0.0
        return self.factor.told and self.fault is None and kind in self.clears and sure


class Following(NamedTuple):
    """One signal behind another: factor, delay [s], offset, drift: change of the delay over the drive [s]. correlation:
    of both, without the delay."""

    factor: Estimate
    delay: Estimate
    offset: Estimate
    drift: Estimate
    correlation: float


def follows(m: Moments, x: np.ndarray, y: np.ndarray, used: np.ndarray, others: Sequence[np.ndarray] = ()) -> Following:
    """y behind x, smooth signals (n,). others: what y holds besides."""
    rate = m.s.rate
    if used.sum() < LEAST_TIME * rate:
        return Following(
            *(not_told(f'only {used.sum() / rate:.3g} s of it, at least {LEAST_TIME:g} s are needed'),) * 4, 0.0
        )
    if not (float(np.std(x[used])) > 0.0 and float(np.std(y[used])) > 0.0):
        return Following(*(not_told('a signal is constant'),) * 4, 0.0)
    lag, correlation = _lag(x, y, used, rate)
    if abs(correlation) < FOLLOWS:
        return Following(
            *(not_told(f'their correlation is {correlation:.2f}, at least {FOLLOWS:g} is needed'),) * 4, 0.0
        )
    k = round(lag * rate)
    n = x.size
    at = np.flatnonzero(used)
    at = at[(at + k >= 0) & (at + k < n)]
    at = at[used[at + k]]
    dx = m.rate(x)
    stretch = stretches(at.size, rate)
    columns = [x[at], dx[at], np.ones(at.size), *(other[at] for other in others)]
    fit = Regression(np.column_stack(columns), y[at + k], stretch)
    late = k / rate
    delay = fit.estimate(lambda c: late - c[1] / c[0])
    middle = m.s.t[at] - np.mean(m.s.t[at])
    length = float(np.ptp(m.s.t[at]))
    drift = not_told(f'less than {LONG:g} s of moments')
    if at.size >= LONG * rate:
        trend = Regression(np.column_stack([*columns, middle * dx[at]]), y[at + k], stretch)
        drift = trend.estimate(lambda c: -length * c[-1] / c[0])
    return Following(fit.estimate(lambda c: c[0]), delay, fit.estimate(lambda c: c[2]), drift, abs(correlation))


def _lag(x: np.ndarray, y: np.ndarray, used: np.ndarray, rate: float) -> tuple[float, float]:
    """(lag of y behind x [s], correlation there, negative for turned signs) of the largest correlation up to LAG, over
    the moments that are used at both instants."""
    from scipy.fft import irfft, next_fast_len, rfft

    most, n = round(LAG * rate), next_fast_len(2 * x.size)
    a, b = (np.where(used, z - np.mean(z[used]), 0.0) for z in (x, y))
    mask = used.astype(float)

    def sums(p: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Sums of p(t) q(t + lag) at the lags from -most to most."""
        products = irfft(np.conj(rfft(p, n)) * rfft(q, n), n)
        return np.concatenate([products[n - most :], products[: most + 1]])

    power = np.sqrt(np.maximum(sums(a * a, mask) * sums(mask, b * b), 0.0))
    enough = power > TINY * power.max()
    correlation = np.where(enough, sums(a, b) / np.where(enough, power, 1.0), 0.0)
    best = int(np.argmax(np.abs(correlation)))
    return (best - most) / rate, float(correlation[best])


def relations(m: Moments) -> list[Relation]:
    """All relations that the signals of a drive allow."""
    s, found = m.s, []
    if 'yaw_rate' in s and 'heading' in s:
        turn = m.rate(low_passed(s['heading'], s.rate, SMOOTH, poles=4))
        found.append(_relation(
            m, 'yaw_rate_of_heading', 'yaw rate over d(heading)/dt', ('yaw_rate',), ('heading',), turn,
            low_passed(s['yaw_rate'], s.rate, SMOOTH, poles=4), 'rad/s',
        ))  # fmt: skip
    if 'x' in s and 'y' in s:
        way = [m.rate(low_passed(s[name], s.rate, SMOOTH, poles=4)) for name in ('x', 'y')]
        found.append(_relation(
            m, 'speed_of_place', 'speed over |d(x, y)/dt|', ('speed',), ('place',), np.hypot(*way),
            m.smooth('speed') / (np.cos(m.smooth('sideslip_angle')) if 'sideslip_angle' in s else 1.0), 'm/s',
        ))  # fmt: skip
    if 'ax' in s:
        found.append(_relation(
            m, 'ax_of_speed', 'longitudinal acceleration over dv/dt', ('ax',), ('speed',), m.rate(m.smooth('speed')),
            m.smooth('ax'), 'm/s^2',
        ))  # fmt: skip
    if 'lateral_acceleration' in s and 'yaw_rate' in s:
        found.append(_lateral(m))
    found += _wheels(m)
    return found


def _relation(
    m: Moments, name: str, text: str, y: tuple[str, ...], x: tuple[str, ...], value: np.ndarray, follower: np.ndarray,
    unit: str, *, others: Sequence[np.ndarray] = (), bounds: tuple[float, float] = (-SHIFT, SHIFT), one: bool = True,
    clears: tuple[str, ...] = ('sign', 'unit', 'shift', 'drift'),
    drifts: bool = True,
) -> Relation:  # fmt: skip
    """One relation, judged. bounds: delays that say nothing [s]. one: True where its factor is 1. drifts: True where a
    delay that changes is that of a clock."""
    sensors = tuple(c for part in (*y, *x) for c in (('x', 'y') if part == 'place' else (part,)))
    used = m.among(*sensors)
    factor, delay, offset, drift, correlation = follows(m, value, follower, used, others)
    clear, is_long = correlation >= CLEAR, used.sum() >= LONG * m.s.rate
    fault = None
    if (clear or (is_long and correlation >= SIDE)) and factor.value < 0.0 and factor.outside(-FACTOR, math.inf):
        fault = Fault('swap' if len(y) == 2 else 'sign', f'{text}: factor {factor.value:.3g}')
    elif clear and one and factor.outside(1.0 - FACTOR, 1.0 + FACTOR):
        fault = Fault('unit', f'{text}: factor {factor.value:.4g}')
    elif clear and is_long:
        fault = _in_time(text, delay, drift if drifts else not_told('slip'), bounds)
    return Relation(name, text, y, x, unit, factor, delay, offset, fault, clears)


def _in_time(text: str, delay: Estimate, drift: Estimate, bounds: tuple[float, float]) -> Fault | None:
    """A clock that drifts, or a shift in time beyond bounds [s]."""
    if drift.outside(-SHIFT, SHIFT):
        return Fault('drift', f'{text}: by {drift.value:.2f} s over the drive, {drift.low:.2f} to {drift.high:.2f} s')
    if delay.outside(*bounds):
        late = 'later' if delay.value > 0.0 else 'earlier'
        return Fault('shift', f'{text}: {abs(delay.value):.2f} s {late}, {delay.low:.2f} to {delay.high:.2f} s')
    return None


def _lateral(m: Moments) -> Relation:
    """Lateral acceleration over v r. The delay of a car without a measured sideslip angle is bounded by what a car may
    do: ay = v r + d(v beta)/dt."""
    v, r, a = m.smooth('speed'), m.smooth('yaw_rate'), m.smooth('lateral_acceleration')
    turning = v * r
    name, text = 'ay_of_yaw_rate', 'lateral acceleration over v r'
    if 'sideslip_angle' in m.s:
        slip = m.rate(v * np.tan(m.smooth('sideslip_angle')))
        return _relation(
            m, name, f'{text} + d(v beta)/dt', ('lateral_acceleration',), ('yaw_rate', 'speed', 'sideslip_angle'),
            turning + slip, a, 'm/s^2', others=[m.rate(r)],
        )  # fmt: skip
    used = m.among('lateral_acceleration', 'yaw_rate', 'speed')
    usual, fast = (float(np.quantile(v[used], part)) if used.any() else 1.0 for part in (0.5, 0.9))
    signals = name, text, ('lateral_acceleration',), ('yaw_rate', 'speed'), turning, a, 'm/s^2'
    scale = m.wheelbase / ORDINARY if m.wheelbase > 0.0 else 1.0
    bounds = -LEVER * scale / max(usual, 1e-9) - SHIFT, fast / (STANDARD_GRAVITY * GRIP) + SHIFT
    found = _relation(m, *signals, bounds=bounds, clears=('sign', 'unit', 'drift'))
    if found.fault is not None or not (used.any() and float(np.std(v[used])) > VARIES * usual):
        return found
    # a car at the sideslip angle beta has d(v beta)/dt = (lr - c v^2) dr/dt, which is no delay where speeds vary
    turn = m.rate(r)
    return _relation(
        m, *signals, others=[turn, v * v * turn], bounds=(-2.0 * SHIFT, 2.0 * SHIFT), clears=('sign', 'unit', 'drift')
    )


def _wheels(m: Moments) -> list[Relation]:
    """Wheel speeds over the speed, and the difference of an axle over the yaw rate, which is its track. Slip in driving
    and in braking, about v dv/dt, and the track in bends are no delay."""
    found = []
    v, dv = m.smooth('speed'), m.rate(m.smooth('speed'))
    others = [v * np.maximum(dv, 0.0), v * np.minimum(dv, 0.0)]
    turning = [m.smooth('yaw_rate')] if 'yaw_rate' in m.s else []
    for kind, unit in (('speed', 'm/s'), ('rate', 'rad/s')):
        names = {wheel: f'wheel_{kind}_{wheel}' for wheel in WHEELS if f'wheel_{kind}_{wheel}' in m.s}
        for name in names.values():
            text = f'{_said(name)} over speed'
            found.append(_relation(
                m, f'{name}_of_speed', text, (name,), ('speed',), v, m.smooth(name), unit, one=kind == 'speed',
                others=[*others, *turning], bounds=(-SLIPPING, SLIPPING), clears=('sign',),
                drifts=False,
            ))  # fmt: skip
        for axle in ('front', 'rear'):
            left, right = names.get(f'{axle}_left'), names.get(f'{axle}_right')
            if not (left and right and turning):
                continue
            used = m.among('speed', left, right)
            turns = [float(np.median(m.smooth(name)[used] / v[used])) if used.any() else 1.0 for name in (left, right)]
            speeds = [m.smooth(name) / (turn or 1.0) for name, turn in zip((left, right), turns)]
            found.append(_relation(
                m, f'track_{axle}_{kind}', f'{axle} wheel speeds, right less left, over yaw rate', (left, right),
                ('yaw_rate',), turning[0], speeds[1] - speeds[0], 'm/s', one=False, bounds=(-SLIPPING, SLIPPING),
                clears=('sign',), drifts=False,
            ))  # fmt: skip
    return found


def _said(name: str) -> str:
    return TEXTS.get(name, name.replace('_', ' '))


def steered(m: Moments) -> Relation | None:
    """The delay of the yaw rate behind the yaw rate that the steering asks for, v d_H: sign and cause."""
    steering = steering_of(m, CALM)
    if steering is None or 'yaw_rate' not in m.s:
        return None
    used = m.among('yaw_rate', 'speed', *steering.names)
    v, r = m.smooth('speed', CALM), m.smooth('yaw_rate', CALM)
    # the gain of the yaw rate over v d_H falls with the speed as 1/(1 + K/L v^2): by least squares over both
    columns = np.column_stack([v * steering.angle, v, r * v * v])[used]
    fit = Regression(columns, r[used], np.zeros(columns.shape[0], int))
    k = 0.0 if fit.dependent else -fit.theta[2]
    asked = v * steering.angle / np.maximum(1.0 + k * v * v, LEAST_GAIN)
    # the second derivative takes up that the lag of a car is no pure delay: the delay is that of slow steering
    factor, delay, offset, drift, correlation = follows(m, asked, r, used, [v, m.rate(m.rate(asked))])
    text = 'yaw rate behind the steering'
    fault = None
    if correlation >= SIDE and factor.high < 0.0:
        fault = Fault('sign', OPPOSED)
    elif correlation >= CLEAR and used.sum() >= LONG * m.s.rate:
        fault = _in_time(text, delay, drift, (-SHIFT, CAUSE))
    return Relation(
        'steered', text, ('yaw_rate',), ('steering',), 'rad/s', factor, delay, offset, fault, ('sign', 'drift')
    )


SAID = {
    'sign': 'the sign of {} is turned',
    'swap': '{} are swapped',
    'unit': '{} is in a wrong unit or scale',
    'shift': '{} is shifted in time',
    'drift': 'the clock of {} drifts',
}


def findings(m: Moments, found: Sequence[Relation]) -> tuple[list[str], dict[str, str]]:
    """(sentences on sensors that do not fit the others, sensor -> why what depends on its sign and unit is not told).

    A relation that holds clears its sensors; of several that fail alike, the sensors that all of them share are named.
    """
    said: list[str] = []
    guilty: dict[str, str] = {}
    for kind, sentence in SAID.items():
        cleared = {c for one in found if one.holds(kind) for c in (*one.y, *one.x)}
        failed = [one for one in found if one.fault is not None and one.fault.kind == kind]
        if kind == 'swap' and 'yaw_rate' in guilty:
            continue  # its sign is turned, not theirs
        groups = [_suspects(one, kind, cleared) for one in failed]
        shared = set(groups[0]).intersection(*groups[1:]) if groups else set()
        together: dict[tuple[str, ...], list[str]] = {}
        for one, group in zip(failed, groups):
            named = tuple(c for c in group if c in shared) or tuple(group)
            assert one.fault is not None
            together.setdefault(named, []).append(one.fault.detail)
            if kind in ('sign', 'unit'):
                unit = _unit(one, named[0]) if kind == 'unit' and len(named) == 1 else ''
                if unit:
                    together[named][-1] += f', as of {unit}'
                guilty |= {c: sentence.format(_either(named)) for c in named}
        said += [
            f'{sentence.format(_either(named, kind))} ({"; ".join(details)})' for named, details in together.items()
        ]
    for name in ('yaw_rate', 'lateral_acceleration', 'speed', 'steering', 'heading', 'ax'):
        if name not in m.s:
            continue
        if not np.ptp(m.s[name]) > 0.0:
            said.append(f'{TEXTS[name]} never changes')
        elif (seconds := held(m.s, name)) > 0.0:
            said.append(
                f'{TEXTS[name]} keeps its values for {seconds:.3g} s each: a slower sensor in the rows of a faster '
                f'one, {0.5 * seconds:.2g} s late on average'
            )
    return said, guilty


def _suspects(one: Relation, kind: str, cleared: set[str]) -> list[str]:
    """The sensors that may be the reason of a fault. A speed has no sign to be wrong and hardly a delay that shows."""
    if kind == 'swap':
        return list(one.y)
    sensors = [c for c in (*one.y, *one.x) if c != 'speed' or kind == 'unit' or len(one.y + one.x) == 2]
    suspects = [c for c in sensors if c not in cleared] or sensors
    if kind == 'unit':
        return [c for c in suspects if _unit(one, c)] or suspects
    return suspects


def _unit(one: Relation, sensor: str) -> str:
    """The unit in which a sensor explains the factor of a relation, '' where none does."""
    ratio = one.factor.value if sensor in one.y else 1.0 / one.factor.value
    units = WHEEL_UNITS if sensor.startswith('wheel_speed') else UNITS.get(sensor, {})
    return next((unit for unit, factor in units.items() if abs(ratio / factor - 1.0) < FACTOR), '')


def _either(names: Sequence[str], kind: str = '') -> str:
    return (' and ' if kind == 'swap' else ' or ').join(_said(name) for name in names)
