"""One case of a sweep: a run, and the numbers that are kept of it. Runs in any process that has this package."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.batch import record, warm_up
from mbd_sim_ros.messages.encode import require_finite
from mbd_sim_ros.sweep.design import SweepFigure
from solver import simulation_of
from solver.analysis.certificate_coverage import weighed
from solver.analysis.envelope import Envelope
from solver.analysis.verdict import ERROR, report, status_of
from solver.disk import Store, digest, sources
from solver.errors import BagError, MbdError
from solver.files.overrides import keys_of
from solver.files.scene import load_scene_text
from solver.findings import Finding
from solver.levels.auto import beside_text
from solver.quantities import Quantity, lengths, quantity

SAMPLE = 1e-3  # s: figures are of instants at least so far apart
Row = dict[str, Any]


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepCase:
    """One case of a sweep, with all that a process needs to run it. text: the resolved scene. values: of the
    parameters. rows: directory of the rows, where it can be reached ('' elsewhere); bags: of the recordings, or ''."""

    number: int
    text: str
    name: str
    values: Mapping[str, float | str]
    figures: Mapping[str, SweepFigure]
    rows: str = ''
    bags: str = ''


def row_of(case: SweepCase) -> Row:
    """The row of a case: number, values, status, message, figures (NaN where there is none). It is run unless its row is kept already."""
    head: Row = {'case': case.number, **case.values} | ({'bag': ''} if case.bags else {})
    nothing = dict.fromkeys(case.figures, math.nan)
    try:
        scene = load_scene_text(case.text, case.name, overrides_of(case.values))
        beside = beside_text(scene)
    except MbdError as error:
        return {**head, 'status': ERROR, 'message': str(error), **nothing}
    asked = json.dumps({name: dataclasses.asdict(figure) for name, figure in case.figures.items()})
    key = digest(scene.resolved, asked, sources(), *beside).hex()[:24]
    rows, name = Store(Path(case.rows)) if case.rows else None, f'{key}.json'
    if case.bags:  # a bag has the number of its case and what it is of in its name: another file of the sweep numbers its cases anew
        head['bag'] = f'{case.number:06d}-{key[:8]}'
    bag = Path(case.bags) / head['bag'] if case.bags else None
    if rows is not None and (bag is None or bag.is_dir()) and (content := rows.read(name, key)) is not None:
        return _row(head, json.loads(content))
    made = None if bag is None else bag.with_name(f'{bag.name}.{case.number}-{os.getpid()}.part')  # what was killed is in nobody's way
    if made is not None:
        shutil.rmtree(made, ignore_errors=True)  # in a container that is started anew processes get the same numbers again
    found = _run(scene, case.figures, made)
    if bag is not None and made is not None and made.is_dir():
        if bag.is_dir():  # it was killed before it kept the row
            shutil.rmtree(made, ignore_errors=True)
        else:
            made.replace(bag)
    if rows is not None:
        rows.write(name, json.dumps(found).encode(), key)
    return _row(head, found)


def _row(head: Row, found: Mapping[str, Any]) -> Row:
    figures = {name: math.nan if value is None else value for name, value in found['figures'].items()}
    return {**head, 'status': found['status'], 'message': found['message'], **figures}


def overrides_of(values: Mapping[str, float | str]) -> list[str]:
    """The parameters as KEY=VALUE, one before those that change a part of it; numbers keep all their digits, whole ones are integers."""
    return [f'{key}={_text(values[key])}' for key in sorted(values, key=lambda key: len(keys_of(key)))]


def _text(value: float | str) -> str:
    if isinstance(value, str):
        return value
    return repr(int(value)) if float(value).is_integer() and abs(value) < 1e15 else repr(float(value))


def _run(scene: Any, figures: Mapping[str, SweepFigure], bag: Path | None) -> dict[str, Any]:
    """status, message, figures (None where there is none)."""
    found: dict[str, Quantity] = {}
    instants: list[float] = []
    values: list[np.ndarray] = []
    recorder = messages = None
    status, message, told = ERROR, '', list[Finding]()
    try:
        simulation = simulation_of(scene)
        found = {name: quantity(figure.quantity, simulation.channels) for name, figure in figures.items()}
        warm_up(simulation)
        sample = max(1, math.ceil(round(SAMPLE / simulation.h, 6)))
        every = scene.record.every if bag is not None else scene.steps + 1
        if bag is not None:
            messages, recorder = record(simulation, bag)
        envelope = Envelope(simulation)
        look = envelope.every(simulation.h_ns) or sample  # as in a run (mbd_sim_ros.batch)
        while True:  # figures and verdict are of the same instants whether the case is recorded or not
            k, last, snapshot = simulation.k, simulation.k >= scene.steps, simulation.snapshot()
            if k % sample == 0 or last:
                require_finite(snapshot, simulation.channels)
                instants.append(snapshot.t_ns * 1e-9)
                values.append(snapshot.numbers)
            if k and (k % look == 0 or last):
                envelope.look(snapshot)
            if recorder and messages:
                if k and simulation.applied is not None:
                    recorder.note(k, simulation.applied)
                if k % every == 0 or last:
                    recorder.record(snapshot.t_ns, messages.encode(snapshot))
            if last:
                break
            simulation.advance(min(sample - k % sample, look - k % look, every - k % every, scene.steps - k))
        told = weighed(simulation, envelope).suspect
        status, message = status_of(told), '; '.join(map(str, told))
    except BagError:
        raise
    except MbdError as error:
        message = str(error)
    finally:
        if recorder is not None:
            recorder.close({'status': status, 'findings': json.dumps(report(told))})
    numbers = dict.fromkeys(figures) if status == ERROR else _figures(figures, found, np.array(instants), np.array(values))
    return {'status': status, 'message': message, 'figures': numbers}


def _figures(
    figures: Mapping[str, SweepFigure], found: Mapping[str, Quantity], time: np.ndarray, rows: np.ndarray
) -> dict[str, float | None]:
    result: dict[str, float | None] = {}
    for name, figure in figures.items():
        of = found[name]
        values = of.of(rows[:, of.places])
        size = lengths(values - values[0] if of.from_start else values)
        signed = values[:, 0] if values.shape[1] == 1 else size
        take = figure.take
        if take == 'peak':
            value = size.max()
        elif take == 'rms':
            value = math.sqrt(float(np.mean(size * size)))
        elif take == 'peak_time':
            value = time[int(np.argmax(size))]
        elif take == 'final':
            value = signed[-1]
        else:
            value = signed.min() if take == 'min' else signed.max() if take == 'max' else signed.mean()
        result[name] = float(value) if math.isfinite(value) else None
    return result
