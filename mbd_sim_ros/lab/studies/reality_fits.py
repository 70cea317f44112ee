"""Fits of the study of reality: one model to one part of the recordings of a vehicle, judged window by window on
others."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.fitting.driving import CHUNK
from mbd_sim_ros.fitting.estimation import Fitted, fit
from mbd_sim_ros.fitting.file import Like, load_file
from mbd_sim_ros.fitting.problem import Problem
from mbd_sim_ros.fitting.similar import vehicle_like
from mbd_sim_ros.lab.studies.reality_vehicles import Cut, Real
from mbd_sim_ros.lab.usual_track import UsualTrack, distances
from solver.disk import atomic_write, digest
from solver.errors import MbdError
from solver.vehicle.size import MASS, ORDINARY, WHEELBASE, Size

USUAL = 'seven parameters'  # the single track that is compared with
# What is known of a vehicle before, of both models alike, relative: yaw inertia and height are those of a class, tires
# of one make and age may be half as stiff again as those of another. Ten times as much says nothing.
WIDE, FRICTION = {'sd': '40 %'}, {'sd': '20 %'}
NUMBERS: dict[str, dict[str, Any]] = {
    USUAL: {
        'yaw_inertia': {'sd': 'class'}, 'stiffness_front': WIDE, 'stiffness_rear': WIDE, 'friction_front': FRICTION,
        'friction_rear': FRICTION, 'shape': {'sd': 'class'}, 'relaxation': {'sd': 'class'},
    },
    'simulator': {
        'yaw_inertia': {'sd': 'class'}, 'cornering_stiffness_front': WIDE, 'cornering_stiffness_rear': WIDE,
        'friction_front': FRICTION, 'friction_rear': FRICTION, 'height': {'sd': 'class'},
    },
}  # fmt: skip
UNDERSTEER = 1.2  # friction behind over that in front with which a fit begins; ten times as much never slides
CURVES = 2  # windows of which curves are kept: those with the largest and the median lateral acceleration
# s, of a passenger car: ten of them between two samples that are compared, which see 6 Hz; ten times as much is longer
# than a relaxation of the tires
STEP = 8e-3


def file_of(real: Real, model: str, fitted: Sequence[Cut], held_out: Sequence[Cut], data: Path) -> dict[str, Any]:
    """The file of a fit as data. model: USUAL or a level. mapping: names the file mapping.yaml beside it."""
    recordings = {}
    for use, cuts in (('fit', fitted), ('held_out', held_out)):
        for k, cut in enumerate(cuts):
            file = (data / real.folder / cut.file).resolve()
            one: dict[str, Any] = {'file': str(file), 'use': use, 'start': cut.start}
            recordings[f'{use}_{k + 1}'] = one if cut.end is None else {**one, 'end': cut.end}
    like, usual = like_of(real), usual_car(real)
    if model == USUAL:
        vehicle: dict[str, Any] = {'vehicle': 'usual'}
        ahead, height = usual.front, 0.0
    else:
        vehicle = {'like': {key: value for key, value in vars(like).items() if value not in (None, '')}}
        ahead, height = vehicle_like(like)['front']['wheel']['center'][0], real.height
    # it begins with an understeering car: one that oversteers spins in some windows, and nothing leads out of there
    begin = {'friction_front': real.friction, 'friction_rear': UNDERSTEER * real.friction}
    for axle in ('front', 'rear'):
        begin[f'stiffness_{axle}'] = real.stiffness * usual.value(f'stiffness_{axle}')
        begin[f'cornering_stiffness_{axle}'] = real.stiffness
    numbers = {
        name: {**known, 'value': begin[name]} if name in begin else known
        for name, known in NUMBERS[USUAL if model == USUAL else 'simulator'].items()
    }
    channels = {}
    for name, one in real.channels.items():
        at = real.places.get(name)
        channels[name] = one if at is None else {**one, 'at': [round(ahead - at[0], 6), at[1], height]}
    windows: dict[str, Any] = {'length': real.window, 'run_in': real.run_in}
    return {
        **vehicle, 'level': 'single_track' if model == USUAL else model, 'mapping': 'mapping.yaml',
        'recordings': recordings, 'drive': real.drive, 'channels': channels,
        'parameters': numbers, 'constants': 'exact',
        'step': STEP * size_of(real).time,
        'windows': windows if real.slowest is None else {**windows, 'slowest': real.slowest},
    }  # fmt: skip


def like_of(real: Real) -> Like:
    """The delivered vehicle in the size of a real one."""
    return Like(
        vehicle='vehicles/light_car.yaml', wheelbase=real.wheelbase, mass=real.mass, front_share=real.front_share,
        height=real.height, driven=real.driven,
    )  # fmt: skip


def size_of(real: Real) -> Size:
    """Size of a real vehicle beside a passenger car."""
    ordinary = ORDINARY['length'][0] <= real.wheelbase <= ORDINARY['length'][1]
    return Size() if ordinary else Size(real.wheelbase / WHEELBASE, real.mass / MASS)


def usual_car(real: Real) -> UsualTrack:
    """The single track of seven parameters with mass and axles of a real vehicle."""
    size = size_of(real)
    return UsualTrack(real.mass, *distances(real.wheelbase, real.front_share), STEP * size.time, size)


def identity(real: Real, data: Path, file: Mapping[str, Any]) -> str:
    """Digest of all that a fit depends on beside the program."""
    contents = [(data / real.folder / name).read_bytes() for name in real.files]
    return digest(repr(real.mapping), json.dumps({**file, 'recordings': _places(file)}), *contents).hex()


def _places(file: Mapping[str, Any]) -> dict[str, Any]:
    """Recordings without the directory in which they lie."""
    return {name: {**one, 'file': Path(one['file']).name} for name, one in file['recordings'].items()}


def fitted_to(
    real: Real, model: str, file: Mapping[str, Any], directory: Path, *, curves: bool, say: Callable[[str], None]
) -> dict[str, Any]:
    """A fit, as an object of JSON: parameters, residuals of the windows held out, curves. directory: of its files, and
    of its runs while it goes on. A fit that is refused has the sentence as `refused`."""
    directory.mkdir(parents=True, exist_ok=True)
    for name, content in (('fit.yaml', file), ('mapping.yaml', real.mapping)):
        with atomic_write(directory / name) as part:
            part.write_text(json.dumps(content, indent=1) + '\n', encoding='utf-8')  # JSON is YAML
    try:
        given = load_file(directory / 'fit.yaml')
        problem = Problem(given, directory, car=usual_car(real) if model == USUAL else None)
        return described(fit(problem, directory, say=say), curves=curves)
    except MbdError as error:
        return {'refused': str(error)}


def described(fitted: Fitted, *, curves: bool) -> dict[str, Any]:
    """A fit as an object of JSON. windows: of what is held out: sums of squares of measured signals and residuals.
    curves: times, measured and predicted signals of CURVES windows."""
    problem = fitted.problem
    which = problem.of('held_out')
    pieces = [p for p in problem.pieces if p.window in set(which)]
    made = {
        'error': problem.signals(fitted.x, problem.motions(fitted.x, which), which),
        'before': problem.signals(fitted.before, problem.motions(fitted.before, which), which),
    }
    windows: dict[int, dict[str, Any]] = {}
    for k, p in enumerate(pieces):
        window = problem.windows[p.window]
        row = windows.setdefault(
            p.window, {'recording': window.recording, 'first': window.first, 'last': window.last, 'channels': {}}
        )
        sums = {name: float(np.sum((p.y - signals[k]) ** 2)) for name, signals in made.items()}
        row['channels'][p.channel] = {'n': p.t.size, 'signal': float(np.sum(p.y**2)), **sums}
    found: dict[str, Any] = {
        'parameters': {
            name: {'value': e.value, 'low': e.low, 'high': e.high, 'sd': e.sd, 'unit': e.unit, 'told': e.told}
            for name, e in fitted.parameters.items()
        },
        'nuisances': {e.name: [e.value, e.low, e.high] for e in fitted.estimates if not e.sought},
        'windows': list(windows.values()), 'left_out': list(problem.told), 'step': problem.dt / CHUNK,
    }  # fmt: skip
    if curves:
        shown = _shown(windows)
        found['curves'] = [
            {'window': list(windows).index(p.window), 'channel': p.channel, 't': p.t + problem.windows[p.window].begin,
             'measured': p.y, 'predicted': made['error'][k]}
            for k, p in enumerate(pieces) if p.window in shown
        ]  # fmt: skip
        found['curves'] = [{key: _listed(value) for key, value in one.items()} for one in found['curves']]
    return found


def _listed(value: Any) -> Any:
    return [round(float(x), 6) for x in value] if isinstance(value, np.ndarray) else value


def _shown(windows: Mapping[int, Mapping[str, Any]]) -> list[int]:
    """The windows with the largest and the median lateral acceleration, which no model chooses."""
    size = {
        k: one['channels']['lateral_acceleration']['signal'] / one['channels']['lateral_acceleration']['n']
        for k, one in windows.items() if 'lateral_acceleration' in one['channels']
    }  # fmt: skip
    order = sorted(size, key=lambda k: size[k])
    return [] if not order else list(dict.fromkeys([order[-1], order[len(order) // 2]]))[:CURVES]
