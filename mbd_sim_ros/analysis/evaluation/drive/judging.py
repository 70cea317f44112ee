"""An ordinary drive judged: figures of the car and of its sensors from any recording, each with a 95 % interval, or why
this drive does not tell it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mbd_sim_ros.analysis.evaluation.drive import envelope, handling, response, sensors
from mbd_sim_ros.analysis.evaluation.drive.blocks import Estimate, not_told
from mbd_sim_ros.analysis.evaluation.drive.moments import Moments, moments
from mbd_sim_ros.analysis.evaluation.figures import DEG, Chart, Curve, Figure, Result
from mbd_sim_ros.analysis.evaluation.kinds import Evaluation
from mbd_sim_ros.analysis.evaluation.signals import GIVEN, WHEELS, Signals

NORM = 'definitions of ISO 4138 [ISO4138] and ISO 7401'
POINTS = 1400  # of a cloud that is drawn; ten times as many make a page slow
AGREES = 0.1  # part by which the ratio of the drive may differ from the given one; 1 would take any
ROADS = ('road_angle', 'road_angle_left', 'road_angle_right')


@dataclass(frozen=True, kw_only=True)
class OrdinaryDrive:
    """slowest: speed below which nothing is judged (none: 3 m/s for a wheelbase of 2.7 m, with its root) [m/s]. high:
    largest lateral acceleration of the gradients [m/s^2]. segment: length of the segments of the spectra [s]. wheelbase
    [m], ratio [-]: of the vehicle (none: of the scene in the recording)."""

    slowest: float | None = None
    high: float = 4.0
    segment: float = 5.0
    wheelbase: float | None = None
    ratio: float | None = None


def _figure(name: str, text: str, found: Estimate, unit: str) -> Figure:
    interval = (found.low, found.high) if found.told else None
    return Figure(name, text, found.value if found.told else math.nan, unit, interval=interval, why=found.why)


def judge(s: Signals, p: OrdinaryDrive) -> Result:
    """Everything that a drive tells."""
    wheelbase, ratio = (
        math.nan if one is None else float(one)
        for one in (
            p.wheelbase if p.wheelbase is not None else s.vehicle.known('wheelbase'),
            p.ratio if p.ratio is not None else s.vehicle.known('ratio'),
        )
    )
    m = moments(s, wheelbase=wheelbase, slowest=p.slowest)
    if not m.counted.any():
        raise s.refuse(
            f'no moment of the drive counts: {_left_out(m)}; its speed should be above {m.slowest:.3g} m/s; give '
            f'slowest=... ({GIVEN})'
        )
    figures = [
        Figure(f'time_{name}', TIMES[name].format(m.slowest), seconds, 's') for name, seconds in m.seconds.items()
    ]
    notes = list(s.notes)
    side = sensors.steered(m)
    found = sensors.relations(m)
    said, guilty = sensors.findings(m, [*found, *([side] if side is not None else [])])
    notes += [f'check: {one}' for one in said]
    if m.offset is not None:
        figures.append(Figure('yaw_rate_at_rest', 'yaw rate at rest, taken out', m.offset, 'rad/s'))
    charts: list[Chart] = []
    told = _steering(m, p, ratio, side, guilty)
    figures += told[0]
    charts += told[1]
    notes += told[2]
    figures += _envelope(m, charts)
    figures += _responses(m, p, _wrong(guilty, *STEERED), charts)
    figures += _sensors(found)
    return Result(
        evaluation='drive', title='Ordinary drive', norm=NORM, figures=tuple(figures), charts=tuple(charts),
        notes=tuple(dict.fromkeys(notes)), source=s.place,
    )  # fmt: skip


TIMES = {
    'counted': 'time that counts, faster than {:.3g} m/s',
    'gaps': 'left out: gaps of a sensor',
    'standstill': 'left out: standstill',
    'reversing': 'left out: reversing',
    'slow': 'left out: slower than {:.3g} m/s',
}


STEERED = ('steering', 'yaw_rate', 'speed')


def _wrong(guilty: Mapping[str, str], *names: str) -> str:
    """Why figures of these sensors are not told, '' where they may be."""
    return next((guilty[name] for name in names if name in guilty), '')


def _left_out(m: Moments) -> str:
    return ', '.join(f'{name} {seconds:.3g} s' for name, seconds in m.seconds.items() if name != 'counted')


def _steering(
    m: Moments, p: OrdinaryDrive, ratio: float, side: sensors.Relation | None, guilty: Mapping[str, str]
) -> tuple[list[Figure], list[Chart], list[str]]:
    """Figures, charts and notes of quasi-steady moments and of the steering."""
    figures, charts, notes = [], [], []
    names = {
        'understeer_gradient': ('understeer gradient', 'rad s^2/m'),
        'understeer_gradient_left': ('understeer gradient, turns to the left', 'rad s^2/m'),
        'understeer_gradient_right': ('understeer gradient, turns to the right', 'rad s^2/m'),
        'understeer_difference': ('understeer gradient, left less right', 'rad s^2/m'),
        'stability_factor': ('understeer gradient over wheelbase', 's^2/m^2'),
        'steering_ratio': ('ratio of the steering', '1'),
        'ratio_times_wheelbase': ('ratio of the steering times wheelbase', 'm'),
        'steering_offset': ('steering angle straight ahead', 'rad'),
    }
    steering = handling.steering_of(m, handling.CALM) if 'yaw_rate' in m.s else None
    if steering is None or side is None:
        lacking = 'the recording has no ' + (
            'yaw rate; map it as yaw_rate'
            if 'yaw_rate' not in m.s
            else 'steering; map it as steering, or as road_angle, or as road_angle_left and road_angle_right'
        )
        figures += [_figure(name, text, not_told(lacking), unit) for name, (text, unit) in names.items()]
        figures.append(_figure('yaw_rate_delay', 'delay of the yaw rate behind the steering', not_told(lacking), 's'))
    else:
        h = handling.handling(m, p.high, ratio, _wrong(guilty, *STEERED), side.delay.value if side.delay.told else 0.0)
        expected = 1.0 if steering.road else ratio
        if h.ratio.outside((1.0 - AGREES) * expected, (1.0 + AGREES) * expected):
            notes.append(
                f'check: by the drive the ratio of the {steering.text} is {h.ratio.value:.4g} ({h.ratio.low:.4g} to '
                f'{h.ratio.high:.4g}), not {expected:.4g}: the recording is of another car, or wheelbase, ratio or a '
                'unit is wrong'
            )
            nothing = not_told(f'the drive has another ratio of the steering than {expected:.4g}')
            h = h._replace(understeer=nothing, left=nothing, right=nothing, difference=nothing)
        values = dict(zip(names, (
            h.understeer, h.left, h.right, h.difference, h.stability, h.ratio, h.ratio_length, h.offset,
        )))  # fmt: skip
        if steering.road:
            del values['steering_ratio']
        figures.append(Figure('time_steady', f'quasi-steady, up to {p.high:g} m/s^2', h.seconds, 's'))
        figures += [_figure(name, names[name][0], one, names[name][1]) for name, one in values.items()]
        figures.append(_figure('yaw_rate_delay', 'delay of the yaw rate behind the steering', side.delay, 's'))
        if h.curved.told:
            notes.append(
                f'check: the steering is not proportional: at {DEG * h.far:.3g} deg the {steering.text} has turned '
                f'{100.0 * h.curved.value:.2g} % more than by the ratio of the middle, which is given'
            )
        if h.unequal:
            notes.append('check: the car understeers differently to the left and to the right')
        if np.isfinite(h.steer).any() and h.a.size:
            curves = [Curve('quasi-steady moments', *_cloud(h.a, h.steer), 'cloud')]
            if h.understeer.told:
                ends = np.array([h.a.min(), h.a.max()])
                curves.append(Curve('understeer gradient', ends, h.understeer.value * ends, 'reference'))
                curves += [
                    Curve('' if k else 'its interval', ends, bound * ends, 'other')
                    for k, bound in enumerate((h.understeer.low, h.understeer.high))
                ]
            charts.append(Chart(
                title='steering angle of the road wheels beyond the geometry of the bend',
                x=('lateral acceleration', 'm/s^2'), y=('steering angle', 'rad'), curves=tuple(curves),
            ))  # fmt: skip
    if 'yaw_rate' in m.s:
        for name, one in handling.gradients(m, p.high).items():
            text, unit = GRADIENTS[name]
            wrong = _wrong(guilty, 'speed', 'yaw_rate', 'lateral_acceleration', 'sideslip_angle')
            figures.append(_figure(name, text, not_told(wrong) if wrong else one, unit))
    return figures, charts, notes


GRADIENTS = {
    'roll_gradient': ('roll-angle gradient', 'rad s^2/m'),
    'sideslip_gradient': ('sideslip-angle gradient at constant radius', 'rad s^2/m'),
    'sideslip_place': ('point of the sideslip angle, ahead of the rear axle', 'm'),
}


def _cloud(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Evenly chosen points, as many as are drawn."""
    k = np.unique(np.linspace(0, x.size - 1, min(POINTS, x.size)).astype(int))
    return x[k], y[k]


def _envelope(m: Moments, charts: list[Chart]) -> list[Figure]:
    """Figures of the g-g diagram; its picture is put into charts."""
    g = envelope.envelope(m)
    sides = {'left': 'to the left', 'right': 'to the right', 'drive': 'driving', 'brake': 'braking'}
    texts = {side: f'acceleration {text}, exceeded for 1 % of the time' for side, text in sides.items()}
    if g is None:
        nothing = not_told('the recording has neither lateral acceleration nor yaw rate')
        return [_figure(f'used_{k}', t, nothing, 'm/s^2') for k, t in texts.items()]
    curves = (
        Curve('drive', *_cloud(g.ay, g.ax), 'cloud'),
        Curve('99 % by direction', g.edge[:, 1], g.edge[:, 0], 'reference'),
    )
    charts.append(Chart(
        title='g-g diagram', x=('lateral acceleration, left positive', 'm/s^2'),
        y=('longitudinal acceleration', 'm/s^2'), curves=curves,
    ))  # fmt: skip
    return [_figure(f'used_{k}', t, g.figures[k], 'm/s^2') for k, t in texts.items()]


STYLES = ('run', 'reference', 'third')  # of the curves of each band of speeds
OUTPUTS = {'yaw_rate': ('yaw rate', '1/s'), 'lateral_acceleration': ('lateral acceleration', 'm/s^2/rad')}


def _responses(m: Moments, p: OrdinaryDrive, wrong: str, charts: list[Chart]) -> list[Figure]:
    """Figures of the frequency response; its curves are put into charts."""
    if wrong:
        return [_figure('response', 'frequency response', not_told(wrong), '1')]
    found, why = response.bands(m, p.segment)
    if not found:
        return [_figure('response', 'frequency response', not_told(why), '1')]
    figures = []
    for number, band in enumerate(found, 1):
        figures.append(
            Figure(f'response_speed_{number}', f'frequency response {number}: speed, mean of {band.segments} stretches',
                   band.speed, 'm/s')
        )  # fmt: skip
        for output, lines in band.outputs.items():
            text, unit = OUTPUTS[output]
            for frequency in response.TABLE:
                one = response.at(lines, frequency)
                if one is None:
                    continue
                name = f'{output}_{{}}_{frequency:g}hz_{number}'
                at = f'at {one.frequency:.3g} Hz and {band.speed:.3g} m/s'
                figures.append(_figure(name.format('gain'), f'{text} per steering angle {at}', one.gain, unit))
                if one.gain.told:
                    figures.append(_figure(name.format('phase'), f'{text}, phase {at}', one.phase, 'rad'))
    for output in found[0].outputs:
        text, unit = OUTPUTS[output]
        for what, axis in (('gain', ('gain', unit)), ('phase', ('phase', 'rad'))):
            curves = []
            for band, style in zip(found, STYLES):
                of_each = [(r.frequency, r.gain if what == 'gain' else r.phase) for r in band.outputs[output]]
                told = np.array([(f, one.value, one.low, one.high) for f, one in of_each if one.told])
                if told.size:
                    f, value, low, high = told.T
                    curves.append(Curve(f'{band.speed:.3g} m/s', f, value, style))
                    curves += [Curve('', f, bound, 'other') for bound in (low, high)]
            if curves:
                title = f'{text} per steering angle, {what}'
                charts.append(Chart(title=title, x=('frequency', 'Hz'), y=axis, curves=tuple(curves)))
        coherences = []
        for band, style in zip(found, STYLES):
            f, of = np.array([(one.frequency, one.coherence) for one in band.outputs[output]]).T
            coherences.append(Curve(f'{band.speed:.3g} m/s', f, of, style))
        charts.append(Chart(
            title=f'{text} per steering angle, coherence', x=('frequency', 'Hz'), y=('coherence', '1'),
            curves=tuple(coherences),
        ))  # fmt: skip
    return figures


def _sensors(found: list[sensors.Relation]) -> list[Figure]:
    figures = []
    for one in found:
        if one.factor.why:
            figures.append(_figure(one.name, one.text, not_told(one.factor.why), '1'))
            continue
        if one.name.startswith('track'):
            figures.append(_figure(one.name, f'track, {one.text}', one.factor, 'm'))
            continue
        if one.name.startswith('wheel_rate'):
            name = one.name.replace('rate', 'radius')
            figures.append(_figure(name, f'radius of rolling, {one.text}', inverse(one.factor), 'm'))
        else:
            figures.append(_figure(one.name, f'{one.text}: factor', one.factor, '1'))
        figures += [
            _figure(f'{one.name}_delay', f'{one.text}: delay', one.delay, 's'),
            _figure(f'{one.name}_offset', f'{one.text}: offset', one.offset, one.unit),
        ]
    return figures


def inverse(found: Estimate) -> Estimate:
    """1/figure; its interval is that of a figure away from zero."""
    if not found.told or found.low <= 0.0:
        return not_told(found.why or 'its interval holds zero')
    return Estimate(1.0 / found.value, 1.0 / found.high, 1.0 / found.low)


WHEEL_SPEEDS = tuple(f'wheel_{kind}_{wheel}' for kind in ('rate', 'speed') for wheel in WHEELS)
DRIVE = Evaluation(
    name='drive',
    title='ordinary drive: what it tells of car and sensors, with intervals',
    norm=NORM,
    needs=('speed',),
    also=(
        'steering', *ROADS, 'yaw_rate', 'lateral_acceleration', 'roll', 'sideslip_angle', 'heading', 'x', 'y', 'ax',
        *WHEEL_SPEEDS,
    ),
    parameters=OrdinaryDrive,
    judge=judge,
    judges_sensors=True,
)  # fmt: skip
