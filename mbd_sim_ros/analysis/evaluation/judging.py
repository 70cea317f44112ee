"""From a recording to a Result: which evaluation it is for, its signals, the parameters."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mbd_sim_ros.analysis import mapping, runs
from mbd_sim_ros.analysis.evaluation.figures import Result
from mbd_sim_ros.analysis.evaluation.kinds import Evaluation
from mbd_sim_ros.analysis.evaluation.registry import EVALUATIONS, called, names
from mbd_sim_ros.analysis.evaluation.signals import NEEDED, WAYS, Vehicle, scene_of, signals
from mbd_sim_ros.analysis.mapping import Axes, Source
from mbd_sim_ros.bags.reader import Run
from solver.errors import BagError, SpecError, suggestion
from solver.scene import Scene
from solver.validate import finite

SIGNED = ('middle', 'start')  # parameters that are places
MAY_BE_ZERO = ('low', 'skip', 'begin', 'deviation', 'kx', 'ky', 'kz')


def read(place: Path, sources: Mapping[str, Source] | None = None, axes: Sequence[Axes] = ()) -> tuple[Run, frozenset[str], Scene | None]:
    """(the recording under our names, which channels hold their values, its scene). sources, axes: of a mapping. Raises BagError."""
    wanted = [] if sources or axes else [*NEEDED, *WAYS]
    run = runs.read(place, wanted)
    held: frozenset[str] = frozenset()
    if sources or axes:
        own = runs.units(run)
        run, held = mapping.apply(run, sources or {}, axes, lambda name: WAYS[name][0] if name in WAYS and name != 'brake' else own(name))
    return run, held, scene_of(run, str(place))


def meant(scene: Scene | None, wanted: str, place: str) -> Evaluation:
    """The evaluation of a name, or that which the maneuver of the scene states. Raises SpecError and BagError."""
    stated = scene.maneuver.evaluation if scene is not None else ''
    if not wanted and not stated:
        raise BagError(f'{place} does not say which maneuver of a norm it holds; say it with --as, e.g. --as {EVALUATIONS[3].name}')
    found = called(wanted or stated)
    one = found if len(found) == 1 else tuple(e for e in found if stated and e in called(stated))
    if len(one) != 1:
        raise SpecError(f'{wanted or stated}: which of its maneuvers does {place} hold? {", ".join(e.name for e in found)}')
    return one[0]


def judge(
    evaluation: Evaluation,
    run: Run,
    place: str,
    given: Mapping[str, float],
    *,
    held: frozenset[str] = frozenset(),
    scene: Scene | None = None,
) -> Result:
    """The figures of a recording. given: parameters, before those that its maneuver states. Raises BagError and SpecError."""
    stated = scene.maneuver.evaluate_with if scene is not None and scene.maneuver.evaluation == evaluation.name else {}
    parameters = parameters_of(evaluation, {**stated, **given})
    if not run.series:
        known = ', '.join(run.names[:4])
        raise BagError(
            f'{place}: none of the channels that evaluations use is in it (it has {known} ...); name them with --map or --mapping'
        )
    found = signals(run, place, evaluation.needs, evaluation.also, held=held, vehicle=Vehicle.of(scene))
    result = evaluation.judge(found, parameters)
    bad = next((f for f in result.figures if f.ok and not math.isfinite(f.value)), None)
    assert bad is None, f'{bad} passes without a value'
    notes = (*suspicion(run), *result.notes)
    return dataclasses.replace(result, parameters=dataclasses.asdict(parameters), notes=notes)


def suspicion(run: Run) -> tuple[str, ...]:
    """What the recorded run says against itself."""
    status = run.metadata.get('status', 'ok')
    if status == 'ok':
        return ()
    texts = [str(finding.get('text', '')) for finding in run.findings]
    return (f'the run is {status}' + (f': {"; ".join(texts)}' if texts else ''),)


def parameters_of(evaluation: Evaluation, given: Mapping[str, float]) -> Any:
    """The parameters of an evaluation. Raises SpecError."""
    known = [f.name for f in dataclasses.fields(evaluation.parameters)]
    for name in given:
        if name not in known:
            raise SpecError(f'{evaluation.name} has no parameter {name!r}{suggestion(name, known)}; it has {", ".join(known)}')
        if name not in SIGNED:
            finite(evaluation.name, name, given[name], low=0.0, strict=name not in MAY_BE_ZERO)
    return evaluation.parameters(**given)


def assignments(texts: Sequence[str]) -> dict[str, float]:
    """KEY=VALUE from the command line. Raises SpecError."""
    result = {}
    for text in texts:
        key, equals, value = text.partition('=')
        try:
            if not (key and equals):
                raise ValueError
            result[key.strip()] = float(value)
        except ValueError:
            raise SpecError(f'--set {text!r}: write it as KEY=NUMBER, in SI units') from None
    return result


__all__ = ['assignments', 'called', 'judge', 'meant', 'names', 'parameters_of', 'read']
