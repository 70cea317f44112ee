"""Steady-state circular driving [ISO4138]: gradients over lateral acceleration, by the three open-loop methods.

With the steering wheel at d_H, speed v and yaw rate r, the path has the curvature k = r/v and the lateral acceleration
is a = v r. (What an accelerometer shows besides, v times the rate of the sideslip angle, is no part of a steady state;
in a ramp of the steering wheel of 0.1 rad/s it makes 2 % of the understeer gradient.) Each slope is that of a straight
line of least squares through all samples with `low` <= |a| <= `high`:

    steering-wheel angle gradient  d d_H/d a
    reference steer gradient       d (L k)/d a           the angle that a car without slip would need (Ackermann)
    understeer gradient            (1/i) d d_H/d a - d (L k)/d a
    roll-angle, sideslip-angle, steering-wheel-torque gradients likewise

The formula of the understeer gradient is the same for all methods: at constant radius the second slope is zero, at
constant steering angle the first, and at constant speed the second is L/v^2. L is the wheelbase, i the ratio of the
steering. Signals are low-passed at 1 Hz without delay.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mbd_sim_ros.analysis.evaluation.figures import Chart, Curve, Figure, Result
from mbd_sim_ros.analysis.evaluation.kinds import Drive, Evaluation
from mbd_sim_ros.analysis.evaluation.measures import line, low_passed
from mbd_sim_ros.analysis.evaluation.signals import GIVEN, Signals
from solver.inputs.driver import Circle
from solver.scene import Scene

NORM = 'ISO 4138:2021 [ISO4138]'
SMOOTH = 1.0  # Hz
# part of the range that may be passed in a period of the low pass without a note; all of it is no steady state
SUDDEN = 1.0 / 3.0
# part of its mean that may vary (standard deviation)
STEADY = {'constant_radius': 0.05, 'constant_steering': 0.02, 'constant_speed': 0.05}
NEAR = 0.025  # part of its median by which the curvature may differ where it has settled on a circle
# m/s of the two with a speed that rises; on a circle of so many metres, others with the same acceleration
FINAL, ON = 21.5, 100.0
GROWS, BEGINS, DURATION = 0.5, 4.0, 32.0  # m/s^2 of that, from when on [s], how long it is at least [s]


@dataclass(frozen=True, kw_only=True)
class SteadyState:
    """low, high: lateral accelerations between which the gradients are [m/s^2]. wheelbase [m], ratio [-]: of the
    vehicle (none: of the scene in the recording)."""

    low: float = 1.0
    high: float = 4.0
    wheelbase: float | None = None
    ratio: float | None = None


def settled(curvature: np.ndarray, on: float, rate: float) -> int:
    """Index of the sample from which the curvature is near `on` for as long as the low pass remembers: the entry into a
    circle is over. 0 where it never is."""
    near = np.abs(curvature - on) <= NEAR * abs(on)  # not where it is NaN
    n = max(round(rate / SMOOTH), 1)
    run = np.convolve(near, np.ones(n, int))[n - 1 : near.size]
    begins = np.flatnonzero(run == n)
    return int(begins[0]) if begins.size else 0


def judge(s: Signals, p: SteadyState, method: str) -> Result:
    """The gradients. method: constant_radius, constant_steering or constant_speed. Raises BagError."""
    smooth = {name: low_passed(values, s.rate, SMOOTH, poles=4) for name, values in s.values.items()}
    if not np.abs(smooth['speed']).max() > 1.0:
        raise s.refuse('the car does not move')
    speed = np.where(smooth['speed'] > 1.0, smooth['speed'], np.nan)
    both = smooth['speed'] * smooth['yaw_rate']
    side = math.copysign(1.0, both[np.argmax(np.abs(both))])
    a, curvature = side * both, side * smooth['yaw_rate'] / speed
    reached = int(np.argmax(a))
    used = (a >= p.low) & (a <= p.high) & np.isfinite(curvature) & (np.arange(a.size) <= reached)
    if method == 'constant_radius' and used.any():
        used &= np.arange(a.size) >= settled(curvature, float(np.median(curvature[used])), s.rate)
    span = float(np.ptp(a[used])) if used.any() else 0.0
    if span < 0.5 * (p.high - p.low) or used.sum() < 10:
        passed = f'largest {float(np.max(a)):.3g} m/s^2' + (
            f', steady from {float(a[used].min()):.3g} m/s^2 on' if used.any() else ''
        )
        raise s.refuse(
            f'no steady-state circular driving in the recording: lateral accelerations between {p.low:g} and '
            f'{p.high:g} m/s^2 are not passed through ({passed}); try others, low=... high=... ({GIVEN})'
        )
    constant = {
        'constant_radius': 1.0 / curvature,
        'constant_steering': side * smooth['steering'],
        'constant_speed': speed,
    }[method][used]
    spread = float(np.std(constant) / abs(np.mean(constant)))
    if spread > STEADY[method]:
        what = method.removeprefix('constant_')
        varies = f'it varies by {100.0 * spread:.3g} % (standard deviation), allowed {100.0 * STEADY[method]:g} %'
        raise s.refuse(f'not driven with constant {what}: {varies}')
    # change in the time that the low pass resolves [m/s^2]
    quickest = float(np.abs(np.gradient(a, s.t))[used].max()) / SMOOTH
    if method == 'constant_speed' and quickest > SUDDEN * (p.high - p.low):
        told = f'the lateral acceleration changes by {quickest:.3g} m/s^2 within {1.0 / SMOOTH:g} s'
        if quickest > p.high - p.low:
            raise s.refuse(f'no steady-state circular driving in the recording: {told}; turn the steering wheel slowly')
        s.notes.append(f'hardly a steady state: {told}')
    wheelbase = s.parameter(p.wheelbase, 'wheelbase', 'the understeer gradient needs the wheelbase')
    ratio = s.parameter(p.ratio, 'ratio', 'the understeer gradient needs the ratio of the steering')

    def slope(values: np.ndarray) -> float:
        return line(a[used], values[used])[0]

    wheel, reference = slope(side * smooth['steering']), wheelbase * slope(curvature)
    unit = {'constant_radius': 'm', 'constant_steering': 'rad', 'constant_speed': 'm/s'}[method]
    what = {
        'constant_radius': 'radius of the path',
        'constant_steering': 'angle of the steering wheel',
        'constant_speed': 'speed',
    }[method]
    figures = [
        Figure('understeer_gradient', 'understeer gradient', wheel / ratio - reference, 'rad s^2/m'),
        Figure('steering_wheel_gradient', 'steering-wheel angle gradient', wheel, 'rad s^2/m'),
        Figure('reference_steer_gradient', 'reference steer (Ackermann) gradient', reference, 'rad s^2/m'),
    ]
    charts = []
    for name, key, text in (
        ('roll', 'roll_gradient', 'roll-angle gradient'),
        ('sideslip_angle', 'sideslip_gradient', 'sideslip-angle gradient'),
        ('steering_torque', 'steering_torque_gradient', 'steering-wheel torque gradient'),
    ):
        if name in s:
            unit_of = 'N m s^2/m' if name == 'steering_torque' else 'rad s^2/m'
            figures.append(Figure(key, text, slope(side * smooth[name]), unit_of))
    figures += [
        Figure('mean', f'{what}, mean', float(np.mean(constant)), unit),
        Figure('spread', f'{what}, standard deviation over mean', spread, '1'),
        Figure('largest_acceleration', 'largest lateral acceleration', float(np.max(a)), 'm/s^2'),
    ]
    shown = np.isfinite(curvature) & (np.arange(a.size) <= reached) & (a > 0.3)
    for name, label in (
        ('steering', 'steering-wheel angle'),
        ('roll', 'roll angle'),
        ('sideslip_angle', 'sideslip angle'),
        ('steering_torque', 'steering-wheel torque'),
    ):
        if name in s:
            values = side * smooth[name]
            k, zero = line(a[used], values[used])
            ends = np.array([p.low, p.high])
            charts.append(
                Chart(
                    title=label,
                    x=('lateral acceleration', 'm/s^2'),
                    y=(label, 'N m' if name == 'steering_torque' else 'rad'),
                    curves=(
                        Curve('measured', a[shown], values[shown]),
                        Curve('straight line', ends, zero + k * ends, 'reference'),
                    ),
                )
            )
    return Result(
        evaluation=f'iso4138_{method}', title=f'Steady-state circular driving, {method.replace("_", " ")}', norm=NORM,
        figures=tuple(figures), charts=tuple(charts), notes=tuple(s.notes), source=s.place,
    )  # fmt: skip


def from_the_start(scene: Scene) -> dict[str, object]:
    """The speed rises from that of the start on, on a circle of another radius to the same lateral acceleration."""
    initial, driver = scene.start.speed, scene.maneuver.driver
    circle = driver.path if driver is not None and isinstance(driver.path, Circle) else None
    final = max(FINAL * (math.sqrt(abs(circle.radius) / ON) if circle else 1.0), initial + 1.0)
    duration = max(DURATION, BEGINS + (final - initial) / GROWS + 1.0)
    return {
        'maneuver.speed.target.initial': initial, 'maneuver.speed.target.final': round(final, 2),
        'duration': round(duration, 1),
    }  # fmt: skip


def _evaluation(method: str, drive: Drive) -> Evaluation:
    return Evaluation(
        name=f'iso4138_{method}',
        title=f'steady-state circular driving, {method.replace("_", " ")}',
        norm=NORM,
        needs=('speed', 'yaw_rate', 'steering'),
        also=('roll', 'sideslip_angle', 'steering_torque'),
        parameters=SteadyState,
        judge=lambda s, p: judge(s, p, method),
        drive=drive,
    )


CONSTANT_RADIUS = _evaluation(
    'constant_radius',
    Drive(maneuver='iso4138_constant_radius', speed=8.0, duration=DURATION, driver=True, fitted=from_the_start),
)
CONSTANT_STEERING = _evaluation(
    'constant_steering',
    Drive(
        maneuver='iso4138_constant_steering',
        speed=8.0,
        duration=DURATION,
        amplitude='maneuver.steering.value',
        reaches=0.8,
        fitted=from_the_start,
    ),
)
CONSTANT_SPEED = _evaluation(
    'constant_speed', Drive(maneuver='iso4138_constant_speed', speed=80.0 / 3.6, duration=16.0)
)
