"""From a recording to a Result: which evaluation it is for, its signals, the parameters."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.analysis import mapping, runs
from mbd_sim_ros.analysis.evaluation.figures import Result
from mbd_sim_ros.analysis.evaluation.kinds import Evaluation
from mbd_sim_ros.analysis.evaluation.measures import low_passed
from mbd_sim_ros.analysis.evaluation.registry import EVALUATIONS, called, names
from mbd_sim_ros.analysis.evaluation.signals import GIVEN, NEEDED, WAYS, Signals, Vehicle, scene_of, signals
from mbd_sim_ros.analysis.mapping import Axes, ChannelSource
from mbd_sim_ros.analysis.tables import TimeColumn
from mbd_sim_ros.bags.patterns import nearest
from mbd_sim_ros.bags.reader import Run
from solver.dimensions import BOUND_ROUNDING, LOCK
from solver.errors import BagError, SpecError, suggestion
from solver.files.scene import MODEL_KEYS
from solver.scene import Scene
from solver.validate import finite, require

SIGNED = ('middle', 'start')  # parameters that are places
MAY_BE_ZERO = ('low', 'slowest', 'skip', 'begin', 'deviation', 'kx', 'ky', 'kz')
RANGES = (('low', 'high'), ('slowest', 'fastest'))
STANDING = 1.0  # m/s: a car that is never faster drives no maneuver
FITS = (0.5, 2.0)  # lateral acceleration over speed times yaw rate, where units and signs are right
MOVES = 1.0  # m/s^2, the largest of either, from which on that is looked at
# Hz: below it a car follows its steering nearly as in the steady state (the full car to 8 %), at 5 Hz nothing is left
# of that
SLOW = 0.5
OPPOSED = -0.5  # correlation of steering and yaw rate about zero, below which they are to different sides
LARGEST = 1e9  # of a parameter, in SI units


def read(
    place: Path,
    sources: Mapping[str, ChannelSource] | None = None,
    axes: Sequence[Axes] = (),
    time: TimeColumn | None = None,
    databases: Sequence[Path] = (),
    *,
    log_times: bool = False,
) -> tuple[Run, frozenset[str], Scene | None]:
    """(the recording under our names, which channels hold their values, its scene). sources, axes, time: of a mapping.
    databases: of the frames in a CAN log. log_times: as of bags.reader.read. Raises BagError."""
    for ours, source in (sources or {}).items():
        if '/' not in ours and '*' not in ours and ours not in WAYS:
            raise BagError(
                f'mapping {source.channel}={ours}: no evaluation has a signal {ours!r}{suggestion(ours, WAYS)}'
            )
    used = {*NEEDED, *WAYS, *(name for turn in axes for name in turn.channels)}
    for ours, source in (sources or {}).items():
        if '/' in ours and not any(fnmatchcase(name, mapping.literal(ours)) for name in used):
            raise BagError(
                f'mapping {source.channel}={ours}: no evaluation takes the channel '
                f'{ours!r}{nearest(ours, sorted(used))}'
            )
    wanted = [*used, *(mapping.literal(source.channel) for source in (sources or {}).values())]
    beside = [source.channel for source in (sources or {}).values()]
    run = runs.read(place, wanted, beside=beside, time=time, databases=databases, log_times=log_times)
    held: frozenset[str] = frozenset()
    if sources or axes or run.stated:
        own = runs.units(run)
        run, held = mapping.apply(
            run, sources or {}, axes, lambda name: WAYS[name][0] if name in WAYS and name != 'brake' else own(name)
        )
    return run, held, scene_of(run, str(place))[0]


def meant(scene: Scene | None, wanted: str, place: str) -> Evaluation:
    """The evaluation of a name, or that which the maneuver of the scene states. Raises SpecError and BagError."""
    stated = scene.maneuver.evaluation if scene is not None else ''
    if not wanted and not stated:
        raise BagError(
            f'{place} does not say which maneuver of a norm it holds; say it with --as, e.g. --as {EVALUATIONS[3].name}'
        )
    found = called(wanted or stated)
    one = found if len(found) == 1 else tuple(e for e in found if stated and e in called(stated))
    if len(one) != 1:
        raise SpecError(
            f'{wanted or stated}: which of its maneuvers does {place} hold? {", ".join(e.name for e in found)}'
        )
    return one[0]


def judge(
    evaluation: Evaluation,
    run: Run,
    place: str,
    given: Mapping[str, float],
    *,
    held: frozenset[str] = frozenset(),
    scene: Scene | None = None,
    mapped: bool = False,
) -> Result:
    """The figures of a recording. given: parameters, before those that its maneuver states. mapped: whether somebody
    says what its channels are, who may be wrong in a unit or a sign; those of our own recordings are known. Raises
    BagError and SpecError."""
    stated = scene.maneuver.evaluate_with if scene is not None and _states(scene, evaluation) else {}
    parameters = parameters_of(evaluation, {**stated, **given})
    if not run.series:
        known = ', '.join(run.names[:4])
        raise BagError(
            f'{place}: none of the channels that evaluations use is in it (it has {known} ...); name them with --map '
            'or --mapping'
        )
    found = signals(run, place, evaluation.needs, evaluation.also, held=held, vehicle=Vehicle.of(scene))
    if 'speed' in found and not np.abs(found['speed']).max() > STANDING:
        raise found.refuse(f'the car does not move (largest speed {np.abs(found["speed"]).max():.3g} m/s)')
    with np.errstate(over='ignore', invalid='ignore'):  # whatever a recording holds
        result = evaluation.judge(found, parameters)
    bad = next((f for f in result.figures if f.ok and not math.isfinite(f.value)), None)
    assert bad is None, f'{bad} passes without a value'
    ours = not mapped and 'resolved_scene' in run.metadata
    said = _angle(found) if evaluation.judges_sensors else misfit(found)
    notes = (
        *runs.suspicion(run),
        *_unread(run, place, scene),
        *(() if ours else said),
        *result.notes,
    )
    return dataclasses.replace(result, parameters=dataclasses.asdict(parameters), notes=notes)


def _unread(run: Run, place: str, scene: Scene | None) -> tuple[str, ...]:
    """That nothing is known of the vehicle, and of what its maneuver states, where there is a scene that cannot be
    read."""
    why = '' if scene is not None else scene_of(run, place)[1]
    return (
        (
            f'{why}; the parameters of its maneuver, masses and the steering ratio are not known: give what is wanted '
            f'({GIVEN})',
        )
        if why
        else ()
    )


def _states(scene: Scene, evaluation: Evaluation) -> bool:
    """True where the maneuver of a scene is for an evaluation, by any of its names."""
    try:
        return evaluation in called(scene.maneuver.evaluation)
    except SpecError:  # none, or one that is not known here
        return False


def misfit(s: Signals) -> tuple[str, ...]:
    """Sentences on wrong units, signs or axes of a mapping: a car at a steady sideslip angle has a lateral acceleration
    of speed times yaw rate, and as long as it moves slowly about that, by least squares; and it turns to the side to
    which it is steered."""
    return _angle(s) + _side(s) + _acceleration(s)


def _angle(s: Signals) -> tuple[str, ...]:
    largest = float(np.abs(s['steering']).max()) if 'steering' in s else 0.0
    if largest <= LOCK * (1.0 + BOUND_ROUNDING):
        return ()
    return (f'the steering wheel is turned to {largest:.4g} rad, beyond any lock: check its unit',)


def _side(s: Signals) -> tuple[str, ...]:
    # on split friction he steers against what turns the car
    if 'steering' not in s or 'yaw_rate' not in s or 'brake' in s:
        return ()
    # in reverse to the other side
    steered, turned = s['steering'], s['yaw_rate'] * (np.sign(s['speed']) if 'speed' in s else 1.0)
    if not steered @ turned < OPPOSED * np.sqrt((steered @ steered) * (turned @ turned)):
        return ()
    return ('the car turns to the other side than its steering wheel: check the signs of steering and yaw rate',)


def _acceleration(s: Signals) -> tuple[str, ...]:
    if not all(name in s for name in ('speed', 'yaw_rate', 'lateral_acceleration')):
        return ()
    turning, pushed = (low_passed(a, s.rate, SLOW) for a in (s['speed'] * s['yaw_rate'], s['lateral_acceleration']))
    if not turning.any() or max(np.abs(turning).max(), np.abs(pushed).max()) < MOVES:
        return ()
    factor = float(turning @ pushed / (turning @ turning))
    if FITS[0] <= factor <= FITS[1]:
        return ()
    return (
        f'the lateral acceleration is {factor:.3g} times speed times yaw rate, not about 1: check units, signs and '
        'axes of the three',
    )


def parameters_of(evaluation: Evaluation, given: Mapping[str, float]) -> Any:
    """The parameters of an evaluation. Raises SpecError."""
    known = _parameters(evaluation)
    for name in given:
        if name not in known:
            raise SpecError(
                f'{evaluation.name} has no parameter {name!r}{suggestion(name, known)}; it has {", ".join(known)}'
            )
        least = -math.inf if name in SIGNED else 0.0
        value = finite(evaluation.name, name, given[name], low=least, strict=name not in (*SIGNED, *MAY_BE_ZERO))
        require(abs(value) <= LARGEST, evaluation.name, name, value, f'must not be beyond {LARGEST:g}')
    parameters = evaluation.parameters(**given)
    for low, high in RANGES:
        if low in known and high in known:
            begin, end = getattr(parameters, low), getattr(parameters, high)
            require(begin < end, evaluation.name, low, begin, f'must be below {high} = {end:g}')
    return parameters


def assignments(texts: Sequence[str]) -> dict[str, float]:
    """KEY=NUMBER of --set, parameters of an evaluation. Raises SpecError."""
    result = {}
    for text in texts:
        key, equals, value = text.partition('=')
        if '.' in key or '[' in key:
            raise SpecError(f'--set {text}: a recording stays as it is; mbd replay BAG --set {text} simulates it again')
        try:
            if not (key and equals):
                raise ValueError
            result[key.strip()] = float(value)
        except ValueError:
            raise SpecError(f'--set {text!r}: write it as KEY=NUMBER, in SI units') from None
    return result


def divided(texts: Sequence[str], evaluations: Sequence[Evaluation]) -> tuple[list[str], dict[str, float]]:
    """(overrides of the scene, parameters of the evaluations) among KEY=VALUE of --set.

    A key with a number that an evaluation has a parameter for is that parameter; a scene has only mappings under such
    keys. Raises SpecError for a key that neither has.
    """
    known = {name for evaluation in evaluations for name in _parameters(evaluation)}
    scene = [*(f.name for f in dataclasses.fields(Scene)), *MODEL_KEYS]
    overrides, parameters = [], []
    for text in texts:
        key, _, value = (part.strip() for part in text.partition('='))
        if key in known and (key not in scene or _is_number(value)):
            parameters.append(text)
        elif not key.isidentifier() or key.startswith(tuple(scene)):
            overrides.append(text)
        else:
            called_ = ', '.join(evaluation.name for evaluation in evaluations)
            near = suggestion(key, [*known, *scene])
            raise SpecError(f'--set {text}: the scene has no such key, and {called_} no parameter {key!r}{near}')
    return overrides, assignments(parameters)


def _parameters(evaluation: Evaluation) -> list[str]:
    return [f.name for f in dataclasses.fields(evaluation.parameters)]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


__all__ = ['assignments', 'called', 'divided', 'judge', 'meant', 'names', 'parameters_of', 'read']
