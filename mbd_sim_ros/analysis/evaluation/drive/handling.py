"""Understeer gradient, ratio and offset of the steering, roll and sideslip gradient: regressions over all quasi-steady
moments of a drive.

A car in steady cornering with the yaw rate r at the speed v has the curvature k = r/v and the lateral acceleration
a = v r. The front wheels are at atan(L k) + K a, with the wheelbase L and the understeer gradient K, and the steering
wheel at the ratio i of that:

    d_H = i L k + i K a + d_0 + T1 k' + T2 a' + T3 k'' + T4 a'' + c a dv/dt + b/v

The coefficients are those of least squares over all moments at which the lateral acceleration and the speed hardly
change. The steering is shifted by the delay of the car and of its sensors, and the derivatives take up what that
leaves, which would bias the others; a dv/dt takes up how driving and braking change the gradient, 1/v an offset of the
yaw rate. With speeds that vary, k and a vary independently, and the drive tells K/L = (i K)/(i L) without wheelbase or
ratio; with L also i and K. Where both L and i are known, K is that of d_H/i - atan(L k) over a, at a constant speed
too, as ISO 4138 defines it [ISO4138].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from mbd_sim_ros.analysis.evaluation.drive.blocks import Estimate, Regression, not_told, stretches
from mbd_sim_ros.analysis.evaluation.drive.moments import Moments

CALM = 0.5  # corner of the low pass of quasi-steady moments [Hz]; ten times as much leaves transients
SUDDEN = 3.0  # change of lateral acceleration [m/s^3] up to which cornering is quasi-steady; 30 is a step of steering
DRIVEN = 2.0  # longitudinal acceleration [m/s^2] up to which it is; 20 is beyond the grip of a road
LEAST_TIME = 5.0  # s of quasi-steady moments at least; ten times as much is not in a drive of minutes
TURNS = 1e-4  # rad of steering that is a change; ten times as much is the play of a steering wheel
CORNERS = 1.0  # m/s^2 which the lateral acceleration reaches in a drive that tells gradients; 10 is the limit of grip
VARIES = 0.1  # part of the mean speed by which it varies in a drive that tells ratio and gradient apart; 1 is a city
# Half interval of K v^2/L, the part of the steering angle that is due to understeer over that of the geometry, up to
# which it is told; ten times as much tells not even its sign.
WIDE = 0.5
CLEAR = 0.002  # rad s^2/m, 1.1 deg/g: half interval of K that is told in any case, half of what cars have
# Part by which the steering angle of tight bends differs from that by the ratio of the middle, from which on the
# steering is taken as curved; ten times as much is a lock.
CURVED = 0.1
# Part of K/L by which a curved steering may change it beside its interval; ten times as much is K itself.
MODEL = 0.1
NO_WHEELBASE = 'give the wheelbase: --set wheelbase=...'
WIDE_RATIO = 0.25  # half interval of the ratio, relative to it, up to which it is told; 2.5 allows either sign
DIFFERS = 0.2  # part of the understeer gradient by which left and right differ at least to be named; 2 hides all
PLACE = 1.0  # m: half interval of the place of a sideslip angle that is told; ten times as much is beyond the car


class Steering(NamedTuple):
    """Steering of a drive. angle: (n,) [rad], of the steering wheel or of the road wheels. road: True for the latter.
    text: what it is."""

    angle: np.ndarray
    road: bool
    text: str
    names: tuple[str, ...]


class Handling(NamedTuple):
    """Figures of quasi-steady moments. used: (n,) mask of these. ratio_length: i L [m]; stability: K/L [s^2/m^2]. left,
    right: K of either side. curved: part by which the steering angle `far` [rad] is larger than by the ratio of the
    middle [-], where it is. a, steer: (n,) lateral acceleration [m/s^2] and steering angle less that of the geometry
    and the offset [rad], to be drawn. seconds: how long they are [s]. unequal: True where the whole interval of the
    difference of both sides is beyond DIFFERS of K."""

    used: np.ndarray
    seconds: float
    ratio_length: Estimate
    stability: Estimate
    understeer: Estimate
    ratio: Estimate
    offset: Estimate
    left: Estimate
    right: Estimate
    difference: Estimate
    a: np.ndarray
    steer: np.ndarray
    curved: Estimate = not_told('the steering is proportional')
    far: float = 0.0
    unequal: bool = False


def steering_of(m: Moments, corner: float) -> Steering | None:
    """The steering of a drive, low-passed; None where the recording has none."""
    if 'steering' in m.s:
        return Steering(m.smooth('steering', corner), False, 'steering wheel', ('steering',))
    both = tuple(name for name in ('road_angle_left', 'road_angle_right') if name in m.s)
    names = ('road_angle',) if 'road_angle' in m.s else both
    if not names:
        return None
    angle = np.mean([m.smooth(name, corner) for name in names], axis=0)
    return Steering(angle, True, 'road wheels', names)


def steady(m: Moments, high: float, *names: str) -> np.ndarray:
    """(n,) mask of the quasi-steady moments with |lateral acceleration| up to `high` [m/s^2]."""
    v, r = m.smooth('speed', CALM), m.smooth('yaw_rate', CALM)
    a = v * r
    calm = (np.abs(m.rate(a)) <= SUDDEN) & (np.abs(m.rate(v)) <= DRIVEN) & (np.abs(a) <= high)
    return m.among('speed', 'yaw_rate', *names) & calm


def reason(m: Moments, used: np.ndarray, *, speeds: bool) -> str:
    """Why the quasi-steady moments tell no gradient, '' where they might. speeds: whether these must vary."""
    seconds = float(used.sum()) / m.s.rate
    if seconds < LEAST_TIME:
        return f'only {seconds:.3g} s of quasi-steady driving, at least {LEAST_TIME:g} s are needed'
    v = m.smooth('speed', CALM)[used]
    reached = float(np.quantile(np.abs(v * m.smooth('yaw_rate', CALM)[used]), 0.99))
    if reached < CORNERS:
        return f'too little lateral acceleration: {reached:.2g} m/s^2 when quasi-steady, {CORNERS:g} are needed'
    if speeds and float(np.std(v) / np.mean(v)) < VARIES:
        return (
            f'the speed is nearly constant ({np.mean(v):.3g} m/s, varying by {100.0 * np.std(v) / np.mean(v):.2g} %): '
            'give wheelbase and ratio, or drive at several speeds'
        )
    return ''


def handling(m: Moments, high: float, ratio: float, wrong: str, late: float = 0.0) -> Handling:
    """The figures of steering. ratio: of the steering [-], NaN if not known. wrong: the reason where a sign or a unit
    forbids figures, '' else. late: the delay of the car behind its steering [s], by which the steering is shifted."""
    steering = steering_of(m, CALM)
    assert steering is not None
    used = steady(m, high, *steering.names)
    L, i = m.wheelbase, 1.0 if steering.road else ratio
    path, pushed, changes = _steady_state(m)
    turned = np.interp(m.s.t - late, m.s.t, steering.angle)
    v, angle, curvature, a = (x[used] for x in (m.smooth('speed', CALM), turned, path, pushed))
    # driving and braking change the gradient: the forces of the tires, and the loads of the axles
    one, others = np.ones(v.size), [*(x[used] for x in changes), a * m.rate(m.smooth('speed', CALM))[used]]
    why = wrong or reason(m, used, speeds=False)
    if not why and not np.ptp(angle) > TURNS and not (L > 0.0 and i > 0.0):
        why = 'the steering never changes'
    constant = reason(m, used, speeds=True)
    if not constant:  # an offset of the yaw rate is one of the steering that falls with the speed
        others.append(1.0 / v - np.mean(1.0 / v))
    geometry = np.arctan(L * curvature) / L if L > 0.0 else curvature
    stretch = stretches(int(used.sum()), m.s.rate)
    usual = float(np.mean(v * v)) if v.size else 1.0
    nothing = not_told(why)
    result = Handling(used, float(used.sum()) / m.s.rate, *(nothing,) * 8, a, np.full(a.size, math.nan))
    if why:
        return result
    free = Regression(np.column_stack([geometry, a, one, *others]), angle, stretch)
    # a ratio of either side, and one that grows with the angle: functions of the steering angle itself
    far, bent = float(np.quantile(np.abs(angle), 0.95)), [np.abs(angle), angle * np.abs(angle)]
    curve = Regression(np.column_stack([geometry, a, one, *others, *bent]), angle, stretch)

    def bend(side: float) -> Estimate:
        """Part by which large angles to one side are larger than by the ratio of the middle."""
        return not_told(constant) if constant else curve.estimate(lambda c: side * c[-2] + far * c[-1])

    known = L > 0.0 and i > 0.0  # NaN is not
    # with a known ratio what is curved is the understeer of the tires
    curved = [one for one in (bend(1.0), bend(-1.0)) if one.outside(-CURVED, CURVED) and not known]
    if curved:
        others += bent
        free = curve
    length = not_told(constant) if constant else _narrow(free.estimate(lambda c: c[0]), 'm', part=WIDE_RATIO)
    stability = not_told(length.why)
    if not length.why:
        stability = _narrow(free.estimate(lambda c: c[1] / c[0]), 's^2/m^2', usual / WIDE)
        # the same with the steering as curved as the drive has it
        stability = _either(stability, curve.theta[1] / curve.theta[0], 's^2/m^2')
        length = _either(length, curve.theta[0], 'm')
    # with the ratio the geometry of the bend is known; without it, it has a coefficient of its own, the first
    first = [] if known else [geometry]
    target = angle / i - np.arctan(L * curvature) if known else angle
    k = len(first)
    whole = Regression(np.column_stack([*first, a, one, *others]), target, stretch)
    sides = Regression(np.column_stack([*first, np.maximum(a, 0.0), np.minimum(a, 0.0), one, *others]), target, stretch)

    def gradient(fit: Regression, of: Callable[[np.ndarray], float]) -> Estimate:
        if not L > 0.0:
            return not_told(NO_WHEELBASE)
        if not known and stability.why:
            return not_told(stability.why)
        found = fit.estimate(lambda c: of(c) * (1.0 if known else L / c[0]))
        return _narrow(found, 'rad s^2/m', min(usual / (L * WIDE), 1.0 / CLEAR))

    rest = target - (whole.theta[k + 1] + np.column_stack(others) @ whole.theta[k + 2 :])
    if not known:
        rest = (rest - whole.theta[0] * geometry) * L / whole.theta[0]
    understeer, difference = gradient(whole, lambda c: c[k]), gradient(sides, lambda c: c[k] - c[k + 1])
    unequal = difference.outside(-DIFFERS * abs(understeer.value), DIFFERS * abs(understeer.value))
    # one gradient for both sides would count half of their difference, times |a|, as an offset
    straight, at = (sides, k + 2) if unequal else (whole, k + 1)
    return result._replace(
        ratio_length=length,
        stability=stability,
        understeer=understeer,
        ratio=length.times(1.0 / L) if L > 0.0 else not_told(NO_WHEELBASE),
        offset=straight.estimate(lambda c: c[at] * (i if known else 1.0)),
        left=gradient(sides, lambda c: c[k]),
        right=gradient(sides, lambda c: c[k + 1]),
        difference=difference,
        steer=rest,
        curved=max(curved, key=lambda one: abs(one.value)) if curved else result.curved,
        far=far,
        unequal=unequal,
    )


def _either(found: Estimate, other: float, unit: str) -> Estimate:
    """The estimate, or that it is another one for a curved steering, beyond its interval and MODEL of it."""
    if not found.told or abs(other - found.value) <= max(found.half, MODEL * abs(found.value)):
        return found
    return not_told(f'it depends on how proportional the steering is: {found.value:.3g} or {other:.3g} {unit}')


def _steady_state(m: Moments) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """(curvature [1/m], lateral acceleration [m/s^2], first and second derivatives of both), (n,) each."""
    v, r = m.smooth('speed', CALM), m.smooth('yaw_rate', CALM)
    both = r / np.maximum(v, 0.5 * m.slowest), v * r
    first = [m.rate(x) for x in both]
    return *both, [*first, *(m.rate(x) for x in first)]


def _narrow(found: Estimate, unit: str, per: float = 0.0, part: float = math.inf) -> Estimate:
    """The estimate, or that its interval is too wide: half of it times `per` is 1 or more, or `part` of its value."""
    if not found.told or (found.half * per < 1.0 and found.half < part * abs(found.value)):
        return found
    return not_told(f'its interval is too wide, {found.low:.2g} to {found.high:.2g} {unit}')


def gradients(m: Moments, high: float) -> dict[str, Estimate]:
    """roll_gradient and sideslip_gradient [rad s^2/m], where the recording has the angles, and sideslip_place [m]: how
    far the point of the measured sideslip angle is ahead of the rear axle."""
    result = {}
    if 'roll' in m.s:
        used = steady(m, high, 'roll')
        why = reason(m, used, speeds=False)
        if why:
            result['roll_gradient'] = not_told(why)
        else:
            name = 'lateral_acceleration' if 'lateral_acceleration' in m.s else ''
            a = m.smooth(name, CALM) if name else m.smooth('speed', CALM) * m.smooth('yaw_rate', CALM)
            columns = np.column_stack([a, np.ones(a.size), m.rate(a), m.rate(m.rate(a))])[used]
            found = Regression(columns, m.smooth('roll', CALM)[used], stretches(int(used.sum()), m.s.rate)).estimate(
                lambda c: c[0]
            )
            result['roll_gradient'] = _narrow(found, 'rad s^2/m', 1.0 / CLEAR)
    if 'sideslip_angle' in m.s:
        used = steady(m, high, 'sideslip_angle')
        why = reason(m, used, speeds=True)
        if why:
            result['sideslip_gradient'] = result['sideslip_place'] = not_told(why)
        else:
            path, pushed, changes = _steady_state(m)
            columns = np.column_stack([path, pushed, np.ones(path.size), *changes])[used]
            fit = Regression(columns, m.smooth('sideslip_angle', CALM)[used], stretches(int(used.sum()), m.s.rate))
            result['sideslip_gradient'] = _narrow(fit.estimate(lambda c: c[1]), 'rad s^2/m', 1.0 / CLEAR)
            result['sideslip_place'] = _narrow(fit.estimate(lambda c: c[0]), 'm', 1.0 / PLACE)
    return result
