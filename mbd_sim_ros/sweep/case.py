"""One case of a sweep: a run, and the numbers that are kept of it. Runs in any process that has this package."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np

from mbd_sim_ros import interrupts
from mbd_sim_ros.analysis import evaluation
from mbd_sim_ros.analysis.evaluation import judging
from mbd_sim_ros.analysis.vehicle_figures import vehicle_figures
from mbd_sim_ros.bags.reader import WITH_REACTIONS
from mbd_sim_ros.batch import ROWS, record, require_finite_rows, warm_up
from mbd_sim_ros.messages.encode import require_finite
from mbd_sim_ros.sweep.design import ERRORS, UNITS, SweepFigure
from solver import simulation_of
from solver.analysis.certificate_coverage import weighed
from solver.analysis.envelope import Envelope
from solver.analysis.error_bar import NOT_ASKED, Twin
from solver.analysis.reactions import undetermined
from solver.analysis.verdict import ERROR, OK, SUSPECT, report, status_of
from solver.disk import Store, digest, sources
from solver.errors import BagError, MbdError, SpecError, suggestion
from solver.files.overrides import keys_of
from solver.files.scene import load_scene_text
from solver.findings import Finding
from solver.levels.auto import beside_text
from solver.quantities import Quantity, lengths, quantity
from solver.scene import Scene

SAMPLE = 1e-3  # s: figures are of instants at least so far apart
Row = dict[str, Any]


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepCase:
    """One case of a sweep, with all that a process needs to run it. text: the resolved scene. values: of the
    parameters. rows: directory of the rows, where it can be reached ('' elsewhere); bags: of the recordings, or ''.
    twin: whether its numerical error is measured, and whether it decides the status then."""

    number: int
    text: str
    name: str
    values: Mapping[str, float | str]
    figures: Mapping[str, SweepFigure]
    rows: str = ''
    bags: str = ''
    twin: Literal['', 'told', 'decides'] = ''


def row_of(case: SweepCase) -> Row:
    """The row of a case: number, values, status, message, figures (NaN where there is none). It is run unless its row
    is kept already."""
    head: Row = {'case': case.number, **case.values} | ({'bag': ''} if case.bags else {})
    nothing = dict.fromkeys(case.figures, math.nan)
    try:
        scene = load_scene_text(case.text, case.name, overrides_of(case.values))
        beside = beside_text(scene)
    except MbdError as error:
        return {**head, 'status': ERROR, 'message': str(error), **nothing}
    asked = json.dumps({name: dataclasses.asdict(figure) for name, figure in case.figures.items()})
    by: list[str] = [case.twin] if case.twin == 'decides' else []
    by += [sources(Path(evaluation.__file__).parent)] if any(one.figure for one in case.figures.values()) else []
    key = digest(scene.resolved, asked, *by, sources(), *beside).hex()[:24]
    rows, name = Store(Path(case.rows)) if case.rows else None, f'{key}.json'
    # a bag has the number of its case and what it is of in its name: another file of the sweep numbers its cases anew
    if case.bags:
        head['bag'] = f'{case.number:06d}-{key[:8]}'
    bag = Path(case.bags) / head['bag'] if case.bags else None
    if rows is not None and (bag is None or bag.is_dir()) and (content := rows.read(name, key)) is not None:
        kept = json.loads(content)
        if kept.get(ERRORS) or not case.twin or kept['status'] == ERROR:
            return _row(head, kept, case.twin)
    # what was killed is in nobody's way
    made = None if bag is None else bag.with_name(f'{bag.name}.{case.number}-{os.getpid()}.part')
    if made is not None:
        # in a container that is started anew processes get the same numbers again
        shutil.rmtree(made, ignore_errors=True)
        found = _measured(scene, case.figures, made, case.twin)
    elif any(one.figure for one in case.figures.values()):
        with _passing(Path(case.rows) / f'{key}.part' if case.rows else None) as place:
            found = _measured(scene, case.figures, place, case.twin)
    else:
        found = _measured(scene, case.figures, None, case.twin)
    if bag is not None and made is not None and made.is_dir():
        if bag.is_dir():  # it was killed before it kept the row
            shutil.rmtree(made, ignore_errors=True)
        else:
            made.replace(bag)
    if rows is not None:
        rows.write(name, json.dumps(found).encode(), key)
    return _row(head, found, case.twin)


def _row(head: Row, found: Mapping[str, Any], twin: str) -> Row:
    figures = {name: math.nan if value is None else value for name, value in found['figures'].items()}
    beside = {UNITS: found[UNITS]} | ({ERRORS: found[ERRORS]} if twin else {})
    return {**head, 'status': found['status'], 'message': found['message'], **figures, **beside}


@contextmanager
def _passing(place: Path | None) -> Iterator[Path]:
    """A directory for a recording that is removed when its figures are known. place: its name, so that one left by a
    process that was killed is found and replaced; None: a temporary one."""
    if place is None:
        with interrupts.scratch('mbd-case-') as scratch:
            yield scratch / 'run'
        return
    shutil.rmtree(place, ignore_errors=True)
    try:
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _measured(scene: Scene, figures: Mapping[str, SweepFigure], bag: Path | None, asked: str) -> dict[str, Any]:
    """The row of a scene: status, message, figures (None where there is none), units of those of evaluations, errors.
    A figure that cannot be found makes a case suspect, with the reason. bag: for the recording, which figures of
    evaluations need."""
    of_run = {name: figure for name, figure in figures.items() if figure.quantity}
    of_vehicle = {name: figure.info for name, figure in figures.items() if figure.info}
    if of_vehicle.keys() == figures.keys() and bag is None:  # the vehicle alone is asked for, and nothing is run
        found: dict[str, Any] = {'status': OK, 'message': '', 'figures': {}, ERRORS: {}}
    else:
        found = _run(scene, of_run, bag, asked)
    values: dict[str, float | None] = dict.fromkeys(figures) | found['figures']
    units: dict[str, str] = {}
    missing: list[str] = []
    if found['status'] != ERROR:
        known, failed = vehicle_figures(scene, sorted(set(of_vehicle.values()))) if of_vehicle else ({}, {})
        values |= {name: known.get(wanted) for name, wanted in of_vehicle.items()}
        missing += [f'{name}: {failed[wanted]}' for name, wanted in of_vehicle.items() if wanted in failed]
        results: dict[str, judging.Result] = {}
        for name, figure in figures.items():
            if not figure.figure or bag is None:
                continue
            try:
                if figure.evaluation not in results:
                    results[figure.evaluation] = _judged(bag, figure.evaluation)
                values[name], units[name] = _of(results[figure.evaluation], figure.figure)
            except MbdError as error:
                missing.append(f'{name}: {error}')
    told = [found['message'], *missing]
    return {
        'status': SUSPECT if missing and found['status'] == OK else found['status'],
        'message': '; '.join(text for text in told if text),
        'figures': {
            name: None if value is None or not math.isfinite(value) else value for name, value in values.items()
        },
        UNITS: units,
        ERRORS: found[ERRORS] and {**found[ERRORS], 'figures': dict.fromkeys(figures) | found[ERRORS]['figures']},
    }


def _judged(bag: Path, name: str) -> judging.Result:
    """The evaluation of a name, or the one that the maneuver states, of the recording of a case. Raises MbdError."""
    run, held, scene = judging.read(bag)
    if not name and not (scene and scene.maneuver.evaluation):
        raise SpecError(
            'the maneuver of the scene states no evaluation; name it beside the figure, e.g. evaluation: iso7401_step'
        )
    one = judging.meant(scene, name, 'the recording of the case')
    return judging.judge(one, run, 'the recording of the case', {}, held=held, scene=scene)


def _of(result: judging.Result, name: str) -> tuple[float, str]:
    """(value, SI unit) of a figure. Raises SpecError."""
    known = {f.name: f for f in result.figures}
    if name not in known:
        raise SpecError(f'{result.evaluation} has found no figure {name!r}{suggestion(name, known)}')
    return known[name].value, known[name].unit


def overrides_of(values: Mapping[str, float | str]) -> list[str]:
    """The parameters as KEY=VALUE, one before those that change a part of it; numbers keep all their digits, whole ones
    are integers."""
    return [f'{key}={_text(values[key])}' for key in sorted(values, key=lambda key: len(keys_of(key)))]


def _text(value: float | str) -> str:
    if isinstance(value, str):
        return value
    return repr(int(value)) if float(value).is_integer() and abs(value) < 1e15 else repr(float(value))


def _run(scene: Scene, figures: Mapping[str, SweepFigure], bag: Path | None, asked: str = '') -> dict[str, Any]:
    """status, message, figures (None where there is none), errors (of figures, and the sentence on the run). asked:
    SweepCase.twin."""
    found: dict[str, Quantity] = {}
    instants: list[np.ndarray] = []
    values: list[np.ndarray] = []
    places = np.zeros(0, int)  # of a snapshot, which the figures are of
    recorder = messages = None
    status, message, left_open, told = ERROR, '', '', list[Finding]()
    errors: dict[str, Any] = {}
    try:
        simulation = simulation_of(scene)
        found = {name: quantity(figure.quantity, simulation.channels) for name, figure in figures.items()}
        warm_up(simulation)
        sample = max(1, math.ceil(round(SAMPLE / simulation.h, 6)))
        every = scene.record.every if bag is not None else scene.steps + 1
        if bag is not None:
            messages, recorder = record(simulation, bag)
        envelope = Envelope(simulation)
        twin = Twin(simulation, scene.steps) if asked else None
        look = envelope.every(simulation.h_ns) or sample  # as in a run (mbd_sim_ros.batch)
        # figures and verdict are of the same instants whether the case is recorded or not
        seen = simulation.seen(math.gcd(sample, look), ROWS)
        places = np.unique([place for one in found.values() for place in one.places]).astype(int)

        def take(steps: np.ndarray, rows: np.ndarray) -> None:
            """Keep what the figures are of."""
            instants.append(steps * simulation.h_ns * 1e-9)
            values.append(rows[:, places])

        require_finite(simulation.snapshot(), simulation.channels)
        take(np.array([simulation.k]), simulation.snapshot().numbers[None])
        if recorder and messages:
            recorder.record(simulation.t_ns, messages.encode(simulation.snapshot()))
        while simulation.k < scene.steps:
            k = simulation.k
            wanted = scene.steps if twin is None or twin.next is None else twin.next
            snapshot = simulation.advance(min((ROWS - 1) * seen.every, every - k % every, wanted - k), seen=seen)
            require_finite_rows(seen, simulation)
            steps, rows, last = seen.steps, seen.numbers, simulation.k == scene.steps
            if last and (not len(steps) or steps[-1] != simulation.k):
                require_finite(snapshot, simulation.channels)
                steps, rows = np.append(steps, simulation.k), np.concatenate([rows, snapshot.numbers[None]])
            at = steps == scene.steps
            take(steps[(steps % sample == 0) | at], rows[(steps % sample == 0) | at])
            envelope.look_at(steps[(steps % look == 0) | at] * simulation.h_ns, rows[(steps % look == 0) | at])
            if recorder and messages:
                if simulation.applied is not None:
                    recorder.note(simulation.k, simulation.applied)
                if simulation.k % every == 0 or last:
                    recorder.record(snapshot.t_ns, messages.encode(snapshot))
            if twin is not None:
                twin.note(snapshot)
        bar = NOT_ASKED if twin is None else twin.made()
        told = weighed(simulation, envelope, error=bar if asked == 'decides' else NOT_ASKED).suspect
        if twin is not None and bar.measured:
            errors = {'text': bar.text, 'share': bar.worst, 'figures': _errors(figures, found, twin)}
        left_open = undetermined(simulation)
        concerned = any(figure.quantity.startswith(WITH_REACTIONS) for figure in figures.values())
        about = [left_open] if left_open and concerned else []
        status, message = status_of(told), '; '.join([*map(str, told), *about])
    except BagError:
        raise
    except MbdError as error:
        message = str(error)
    finally:
        if recorder is not None:
            open_ = {'reactions_text': left_open} if left_open else {}
            recorder.close({'status': status, 'findings': json.dumps(report(told)), **open_})
    numbers: dict[str, float | None] = dict.fromkeys(figures)
    if status != ERROR:
        kept = {name: one._replace(places=np.searchsorted(places, one.places)) for name, one in found.items()}
        numbers = _figures(figures, kept, np.concatenate(instants), np.concatenate(values))
    return {'status': status, 'message': message, 'figures': numbers, ERRORS: errors}


def _errors(figures: Mapping[str, SweepFigure], found: Mapping[str, Quantity], twin: Twin) -> dict[str, float | None]:
    """Numerical errors of figures, by those of both runs at the instants at which they are compared."""
    time, rows, others, factor = twin.compared()
    own, theirs = (_figures(figures, found, time, some) for some in (rows, others))
    return {
        name: None if own[name] is None or theirs[name] is None else factor * abs(own[name] - theirs[name])  # type: ignore[operator]
        for name in figures
    }


def _figures(
    figures: Mapping[str, SweepFigure], found: Mapping[str, Quantity], time: np.ndarray, rows: np.ndarray
) -> dict[str, float | None]:
    result: dict[str, float | None] = {}
    for name, figure in figures.items():
        of = found[name]
        values = of.of(rows[:, of.places])
        known = np.asarray(~np.isnan(values).any(axis=1))  # next to a singular position a reaction is not determined
        if not known.any() or (figure.take == 'final' and not known[-1]):
            result[name] = None
            continue
        values, at = values[known], time[known]
        size = lengths(values - values[0] if of.from_start else values)
        signed = values[:, 0] if values.shape[1] == 1 else size
        take = figure.take
        if take == 'peak':
            value = size.max()
        elif take == 'rms':
            value = math.sqrt(float(np.mean(size * size)))
        elif take == 'peak_time':
            value = at[int(np.argmax(size))]
        elif take == 'final':
            value = signed[-1]
        else:
            value = signed.min() if take == 'min' else signed.max() if take == 'max' else signed.mean()
        result[name] = float(value) if math.isfinite(value) else None
    return result
