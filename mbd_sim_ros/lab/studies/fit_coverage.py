"""Coverage of the intervals of a fit: how often they contain the truth, over synthetic drives whose truth is known.

Every drive has another truth, drawn from what the file of the fit says is known, delays and offsets of its sensors,
their noise, a constant that is wrong in the file, and a disturbance that no parameter explains: what a model lacks.
Every second one goes to the limit of its tires. Fitted is the single track of seven parameters (usual_track), of which
hundreds take minutes; the statistics are those of every level.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.fitting.driving import Inputs, Steering
from mbd_sim_ros.fitting.estimation import fit
from mbd_sim_ros.fitting.example import course
from mbd_sim_ros.fitting.file import Channel, Drive, FitFile, Known, Recording, Windows
from mbd_sim_ros.fitting.noise import Noise
from mbd_sim_ros.fitting.problem import Problem
from mbd_sim_ros.fitting.recordings import Data, Track, Window
from mbd_sim_ros.fitting.sensors import KINDS, Sensor
from mbd_sim_ros.lab.studies.report import Report
from mbd_sim_ros.lab.usual_track import UsualTrack, distances
from solver.errors import MbdError, StepError
from solver.vehicle.size import Size

SUMMARY = 'how often the intervals of mbd fit contain the truth'
DRAWS = True
N = 200  # drives: they tell a share of 0.95 to 0.015; ten times as many take hours
H = 0.01  # s: ten steps a sample
SECONDS = 60.0  # s of each of the recordings of a drive; ten times as long narrows intervals to a third
SOUGHT = ('yaw_inertia', 'stiffness_front', 'stiffness_rear', 'friction_front', 'friction_rear')
WRONG = 'mass'  # the constant of which the file says another number than the truth has
WRONG_BY = 0.03  # sd of that, relative; ten times as much is another car
LACK = {'yaw_rate': 0.006, 'lateral_acceleration': 0.15}  # RMS of the disturbance [rad/s], [m/s^2]
LACK_TIME = 0.6  # s, its correlation time; ten times as much is nearly an offset of a window
RATIO = 1.0 / 16.0  # angle of the road wheels over that of the steering wheel
TURNED = 0.035  # rad of the steering wheel, sd of its offset; ten times as much is a fault
# sd of what is known of the numbers, relative; ten times as much has tires without grip
KNOWN = {
    'yaw_inertia': 0.05, 'stiffness_front': 0.1, 'stiffness_rear': 0.1, 'friction_front': 0.1, 'friction_rear': 0.1,
    'shape': 0.1, 'relaxation': 0.1, WRONG: WRONG_BY,
}  # fmt: skip
# of the steering of usual courses: up to 6 m/s^2, and to the limit of the tires; with ten times as much all cars spin
SWINGS = {'below the limit': 0.55, 'at the limit': 0.9}
# of the steering, again and again until the car does not spin, as who drives it would; 0.085 goes nearly straight
EASED = 0.85


def file_of(use: tuple[str, ...]) -> FitFile:
    """The file of the fits."""
    recordings = {name: Recording(file='made', use='held_out' if name == use[-1] else 'fit') for name in use}
    return FitFile(
        vehicle='usual', recordings=recordings,
        drive=Drive(
            steering_wheel='angle', scale=RATIO, speed='speed', offset=Known(sd=TURNED * RATIO), gain=Known(sd='1 %'),
            delay=Known(sd=0.02),
        ),
        channels={'yaw_rate': Channel(channel='r'), 'lateral_acceleration': Channel(channel='ay')},
        parameters={name: Known(sd=f'{100 * KNOWN[name]} %') for name in SOUGHT},
        constants={name: Known(sd=f'{100 * sd} %') for name, sd in KNOWN.items() if name not in SOUGHT},
        windows=Windows(length=8.0, run_in=2.0), step=H,
    )  # fmt: skip


def drives(seed: int, swing: float, *, loud: float = 1.0) -> tuple[Problem, dict[str, float]]:
    """The problem of a synthetic drive, and its truth, of steering and sensors too. swing: of its steering. loud:
    factor of noise and disturbance; at 0 the model explains all."""
    random = np.random.default_rng(seed)
    car = UsualTrack(1500.0, *distances(2.7, 0.54), H, Size())
    file = file_of(('one', 'two', 'held'))
    truth = {name: car.value(name) * (1.0 + sd * random.standard_normal()) for name, sd in KNOWN.items()}
    late, off, gain = (
        {c: sd * random.standard_normal() for c in ('steering', *LACK)} for sd in (0.02, 1.0, 0.01)
    )  # fmt: skip
    found = []
    for k, name in enumerate(('one', 'two', 'held')):
        t, angle, v = course(SECONDS, 1000 * seed + k, ratio=swing).T
        window = Window(name, 'fit', 0.0, 0.0, float(t[-1]))
        while True:
            plain = Data(name, 'fit', {'angle': Track(t, angle), 'speed': Track(t, v)})
            given = Inputs(plain, file.drive, window, car)
            try:
                rows = car.driven(truth, [given], Steering())[0]
                break
            except StepError:
                angle = EASED * angle
        grid = t[::4]
        shown = np.interp(t - late['steering'], t, angle) * (1.0 + gain['steering']) + TURNED * off['steering']
        tracks = {
            'angle': Track(t, shown + loud * 0.002 * random.standard_normal(t.size)),
            'speed': Track(t, v + loud * 0.02 * random.standard_normal(t.size)),
        }
        for channel, column in (('yaw_rate', 'r'), ('lateral_acceleration', 'ay')):
            kind = KINDS[channel]
            sensor = Sensor(
                channel, car.com, car.com, 0.0, late[channel], 1.0 + gain[channel], kind.offset * off[channel]
            )
            disturbed = Noise(kind.noise, LACK[channel], LACK_TIME).factor(grid) @ random.standard_normal(grid.size)
            tracks[column] = Track(grid, sensor.at(rows, given.dt, grid) + loud * disturbed)
        found.append(Data(name, 'held_out' if name == 'held' else 'fit', tracks))
    # the car steers gain (channel(t + delay) + offset)
    truth |= {
        'steering.delay': late['steering'], 'steering.gain': 1.0 / (1.0 + gain['steering']),
        'steering.offset': -TURNED * RATIO * off['steering'],
    }  # fmt: skip
    for c in LACK:
        truth |= {f'{c}.delay': late[c], f'{c}.gain': 1.0 + gain[c], f'{c}.offset': KINDS[c].offset * off[c]}
    return Problem(file, Path(), data=found, car=car), truth


def study(
    out: Path, *, quick: bool, progress: Callable[[str, float], None], n: int | None = None, seed: int | None = None
) -> dict:
    """See mbd_sim_ros.lab.studies."""
    count = n or (2 if quick else N)
    rows: list[dict[str, Any]] = []
    refused: list[str] = []
    for k in range(count):
        progress(f'drive {k + 1} of {count}', k / count)
        of = list(SWINGS)[k % len(SWINGS)]
        problem, truth = drives((seed or 0) * 100_000 + k, SWINGS[of])
        try:
            found = fit(problem)
        except MbdError as error:
            refused.append(f'drive {k}: {error}')
            continue
        most = max(float(np.abs(p.y).max()) for p in problem.pieces if p.channel == 'lateral_acceleration')
        for e in found.estimates:
            if e.name in truth:
                u = next(u for u in problem.unknowns if u.name == e.name)
                rows.append({
                    'drive': k, 'of': of, 'most': most, 'parameter': e.name, 'truth': truth[e.name],
                    'value': e.value, 'low': e.low, 'high': e.high, 'sought': int(e.sought),
                    'inside': int(e.low <= truth[e.name] <= e.high),
                    'off': (e.value - truth[e.name]) / e.sd, 'gained': e.sd / u.sd, 'widened': e.widened,
                })  # fmt: skip
    sought = [row for row in rows if row['sought']]
    table: list[dict[str, Any]] = []
    for name in dict.fromkeys(str(row['parameter']) for row in rows):
        own = [row for row in rows if row['parameter'] == name]
        table.append({
            'parameter': name, 'sought': 'yes' if own[0]['sought'] else 'no',
            'inside [%]': 100.0 * _mean(own, 'inside'),
            'RMS of (value - truth) / sd': float(np.sqrt(np.mean([float(row['off']) ** 2 for row in own]))),
            'median of sd / sd known before': _median(own, 'gained'),
            'median over the interval of the weights': _median(own, 'widened'),
        })  # fmt: skip
    report = Report(out, 'Intervals of mbd fit')
    report.text(
        f'{count} synthetic drives (two of {SECONDS:g} s fitted, one held out), each of another truth; {len(refused)} '
        f'were refused. Delay, gain and offset of steering and both sensors are unknown, {WRONG} is wrong by '
        f'{100 * WRONG_BY:g} % in the file of the fit (standard deviation), and signals are disturbed by what no '
        'parameter explains.'
    )
    limits: list[dict[str, Any]] = [
        {
            'drives': of, 'largest lateral acceleration, median [m/s^2]': _median(own, 'most'), 'cases': len(own),
            'inside [%]': 100.0 * _mean(own, 'inside'),
            'RMS of (value - truth) / sd': float(np.sqrt(np.mean([float(row['off']) ** 2 for row in own]))),
        }
        for of in SWINGS
        if (own := [row for row in sought if row['of'] == of])
    ]  # fmt: skip
    pooled = _mean(sought, 'inside') if sought else float('nan')
    least = min((row['inside [%]'] for row in table if row['sought'] == 'yes'), default=float('nan'))
    report.text(f'95 % intervals contain the truth in {100 * pooled:.1f} % of {len(sought)} cases.')
    if table:
        report.table('coverage', table)
        report.table('limit', limits)
        report.table('cases', rows, shown=False)
    for text in refused[:5]:
        report.text(f'Refused: {text}')
    report.check('inside, all parameters [%]', 100.0 * pooled, 93.0, least=True)
    report.check('inside, all parameters, at most [%]', 100.0 * pooled, 97.0)
    report.check('inside, the worst parameter [%]', least, 88.0, least=True)
    report.check('refused [%]', 100.0 * len(refused) / count, 5.0)
    report.write()
    return {'coverage': pooled, 'parameters': table, 'limits': limits, 'refused': refused, 'checks': report.checks}


def _median(rows: list[dict], key: str) -> float:
    return float(np.median([row[key] for row in rows]))


def _mean(rows: list[dict], key: str) -> float:
    return float(np.mean([row[key] for row in rows]))
