"""On-centre handling, weave test [ISOWeave2010]: loops of steering-wheel torque, steering-wheel angle, yaw rate and
lateral acceleration.

The steering wheel swings with about 0.2 Hz, the car answers with about 2 m/s^2. All signals are low-passed without
delay. Every loop y over x is read where x passes through a level, once on the way up and once on the way down, in every
whole period; the figures are means:

    gradient at a level     dy/dx there, mean of both ways
    hysteresis, deadband    difference between both ways of x at y = 0 (deadband of x), of y at x = 0 (hysteresis of y)

Delays come from the fundamental of the period: phase difference over angular frequency.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mbd_sim_ros.analysis.evaluation.figures import Chart, Curve, Figure, Result
from mbd_sim_ros.analysis.evaluation.kinds import Drive, Evaluation
from mbd_sim_ros.analysis.evaluation.measures import fundamental, low_passed
from mbd_sim_ros.analysis.evaluation.signals import GIVEN, Signals

NORM = 'ISO 13674-1:2010 [ISOWeave2010]'
LEAST = math.radians(1.0)  # of the steering wheel, from side to side


@dataclass(frozen=True, kw_only=True)
class Weave:
    """skip: periods at the beginning that are not used. level: lateral acceleration of the second gradient of the
    torque [m/s^2]. corner: of the low pass [Hz]. slowest, fastest: frequencies that count as weaving [Hz]."""

    skip: float = 1.0
    level: float = 1.0
    corner: float = 5.0
    slowest: float = 0.1
    fastest: float = 0.5


def passages(t: np.ndarray, x: np.ndarray, level: float) -> tuple[np.ndarray, np.ndarray]:
    """(positions between samples where x rises through the level, where it falls), as fractional indices."""
    above = x >= level
    up, down = np.flatnonzero(~above[:-1] & above[1:]), np.flatnonzero(above[:-1] & ~above[1:])

    def between(k: np.ndarray) -> np.ndarray:
        return k + (level - x[k]) / (x[k + 1] - x[k])

    return between(up), between(down)


def swings(t: np.ndarray, x: np.ndarray, level: float) -> np.ndarray:
    """Fractional indices at which x rises through the level; small wiggles there count once."""
    up, _ = passages(t, x, level)
    least = 0.25 * np.ptp(x)
    return np.array([u for k, u in enumerate(up) if k == 0 or np.ptp(x[int(up[k - 1]) : int(u) + 1]) > least])


def loop(t: np.ndarray, x: np.ndarray, y: np.ndarray, level: float = 0.0) -> tuple[float, float]:
    """(mean gradient dy/dx where x passes through the level, mean of y there on the way up less that on the way
    down)."""
    index = np.arange(t.size)
    slope_x, slope_y = np.gradient(x, t), np.gradient(y, t)
    up, down = passages(t, x, level)
    if not (up.size and down.size):
        return math.nan, math.nan
    both = np.concatenate([up, down])
    slopes = np.interp(both, index, slope_y) / np.interp(both, index, slope_x)
    return float(slopes.mean()), float(np.interp(up, index, y).mean() - np.interp(down, index, y).mean())


def judge(s: Signals, p: Weave) -> Result:
    """Gradients, hystereses, deadbands and delays. Raises BagError."""
    values = {name: low_passed(y, s.rate, p.corner, poles=4) for name, y in s.values.items()}
    t, d = s.t, values['steering']
    up = swings(t, d, float(d.mean()))
    if up.size > 1:  # the mean of whole periods is what it swings about
        zero = float(d[int(up[0]) : int(up[-1])].mean())
        values['steering'] = d = d - zero
        up = swings(t, d, 0.0)
    if up.size - 1 < p.skip + 2 or (np.ptp(d) < LEAST and np.ptp(d) < LEAST * s.vehicle.turned):
        raise s.refuse(
            f'no weaving in the recording: {max(up.size - 1, 0)} whole periods of the steering wheel, {p.skip + 2:g} '
            'are needed'
        )
    period = float(np.median(np.diff(up)) / s.rate)
    frequency = 1.0 / period
    if not p.slowest <= frequency <= p.fastest:
        raise s.refuse(
            f'the steering wheel swings with {frequency:.3g} Hz; weaving is {p.slowest:g} to {p.fastest:g} Hz'
        )
    begin, end = math.ceil(up[int(p.skip)]) - 1, math.floor(up[-1]) + 2
    part = slice(max(begin, 0), end)
    t, values = t[part], {name: y[part] for name, y in values.items()}
    d, a, r = values['steering'], values['lateral_acceleration'], values['yaw_rate']
    phase = {name: fundamental(t, y, frequency) for name, y in values.items() if name != 'speed'}

    def delay(name: str) -> float:
        return -float(np.angle(phase[name] / phase['steering'])) / (2.0 * math.pi * frequency)

    gain, hysteresis = loop(t, d, a)
    yaw_gain, yaw_hysteresis = loop(t, d, r)
    _, deadband = loop(t, a, d)
    near = np.abs(a) <= p.level
    sensitivity = np.abs(
        np.gradient(a, t)[near] / np.where(np.abs(np.gradient(d, t)[near]) > 0.0, np.gradient(d, t)[near], np.nan)
    )
    least = float(np.nanmin(sensitivity)) if np.isfinite(sensitivity).any() else math.nan
    if not (a.min() < -p.level and a.max() > p.level):
        least = math.nan  # where it turns back its slope is zero, and says nothing
        s.notes.append(
            f'the lateral acceleration swings from {a.min():.3g} to {a.max():.3g} m/s^2, not beyond {p.level:g} m/s^2 '
            f'to both sides: the least sensitivity within that has no value; give level=... ({GIVEN})'
        )
    figures = [
        Figure('speed', 'speed, mean', float(values['speed'].mean()), 'm/s'),
        Figure('frequency', 'frequency of the steering wheel', frequency, 'Hz'),
        Figure('periods', 'whole periods used', float(up.size - 1 - int(p.skip)), '1'),
        Figure('lateral_acceleration', 'lateral acceleration, amplitude', abs(phase['lateral_acceleration']), 'm/s^2'),
        Figure(
            'steering_sensitivity', 'steering sensitivity at 0 deg (lateral acceleration per angle)', gain, 'm/s^2/rad'
        ),
        Figure('least_sensitivity', f'least steering sensitivity within {p.level:g} m/s^2', least, 'm/s^2/rad'),
        Figure(
            'acceleration_hysteresis', 'lateral acceleration at 0 deg, way left less way right', hysteresis, 'm/s^2'
        ),
        Figure('angle_deadband', 'steering-wheel angle at 0 m/s^2, way left less way right', deadband, 'rad'),
        Figure('yaw_rate_gain', 'yaw rate per steering-wheel angle at 0 deg', yaw_gain, '1/s'),
        Figure('yaw_rate_hysteresis', 'yaw rate at 0 deg, way left less way right', yaw_hysteresis, 'rad/s'),
        Figure('yaw_rate_delay', 'yaw rate behind the steering wheel', delay('yaw_rate'), 's'),
        Figure(
            'lateral_acceleration_delay',
            'lateral acceleration behind the steering wheel',
            delay('lateral_acceleration'),
            's',
        ),
    ]
    loops = [('steering', 'rad', 'lateral_acceleration', 'm/s^2'), ('steering', 'rad', 'yaw_rate', 'rad/s')]
    if 'steering_torque' in values:
        m = values['steering_torque']
        stiffness, torque_hysteresis = loop(t, d, m)
        at_zero, torque_at_zero = loop(t, a, m)
        both_sides = [k for k in (loop(t, a, m, side * p.level)[0] for side in (1.0, -1.0)) if math.isfinite(k)]
        at_level = float(np.mean(both_sides)) if both_sides else math.nan
        _, acceleration_at_zero = loop(t, m, a)
        _, angle_at_zero = loop(t, m, d)
        figures += [
            Figure('torque_stiffness', 'steering-wheel torque per angle at 0 deg', stiffness, 'N m/rad'),
            Figure(
                'torque_hysteresis', 'steering-wheel torque at 0 deg, way left less way right', torque_hysteresis, 'N m'
            ),
            Figure('torque_gradient_zero', 'steering-wheel torque gradient at 0 m/s^2', at_zero, 'N m s^2/m'),
            Figure(
                'torque_gradient_level', f'steering-wheel torque gradient at {p.level:g} m/s^2', at_level, 'N m s^2/m'
            ),
            Figure(
                'torque_at_zero', 'steering-wheel torque at 0 m/s^2, way left less way right', torque_at_zero, 'N m'
            ),
            Figure(
                'acceleration_at_zero_torque',
                'lateral acceleration at 0 N m, way left less way right',
                acceleration_at_zero,
                'm/s^2',
            ),
            Figure(
                'angle_at_zero_torque', 'steering-wheel angle at 0 N m, way left less way right', angle_at_zero, 'rad'
            ),
        ]
        loops += [
            ('steering', 'rad', 'steering_torque', 'N m'),
            ('lateral_acceleration', 'm/s^2', 'steering_torque', 'N m'),
        ]
    text = {'steering': 'steering-wheel angle', 'steering_torque': 'steering-wheel torque'}
    charts = tuple(
        Chart(
            title=f'{text.get(y, y.replace("_", " "))} over {text.get(x, x.replace("_", " "))}',
            x=(text.get(x, x.replace('_', ' ')), ux),
            y=(text.get(y, y.replace('_', ' ')), uy),
            curves=(Curve('loop', values[x], values[y]),),
        )
        for x, ux, y, uy in loops
    )
    return Result(
        evaluation='iso13674_weave', title='On-centre handling, weave '
            'test', norm=NORM, figures=tuple(figures), charts=charts,
        notes=tuple(s.notes), source=s.place,
    )  # fmt: skip


WEAVE = Evaluation(
    name='iso13674_weave',
    title='on-centre handling: gradients, hystereses and delays of slow weaving',
    norm=NORM,
    needs=('steering', 'speed', 'yaw_rate', 'lateral_acceleration'),
    also=('steering_torque',),
    parameters=Weave,
    judge=judge,
    drive=Drive(
        maneuver='iso13674_weave',
        speed=100.0 / 3.6,
        duration=22.0,
        amplitude='maneuver.steering.amplitude',
        reaches=2.0,
    ),
)
