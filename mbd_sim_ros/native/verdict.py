"""Numbers, places of the account and sentences by which mbd_verdict() judges a run.

verdict.inc reads it and computes again what the measures of these checks compute (solver.checks). Limits, reasons and
remedies that do not depend on the run are taken from the checks themselves: they look at an account in which everything
is beyond its limit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from mbd_sim_ros.native.watch import FOLLOWED
from solver.analysis.verdict import evidence_of
from solver.checks.account import CONTRADICTION, ENERGY_ERROR_MAX, NOT_FINITE, SHARE, TRUNCATION, UNSEEN
from solver.checks.chatter import CHATTER
from solver.checks.check import Check, Evidence, Measured
from solver.checks.inputs import INPUT, RECORDED_INPUTS
from solver.checks.iteration import POSITION_DRIFT_MAX, RESIDUAL_MAX, UNSETTLED, VELOCITY_DRIFT_MAX
from solver.checks.motion import ROTATION
from solver.checks.registry import CHECKS
from solver.checks.resolution import FEWEST, LARGEST_PHASE, PHASE, RESOLUTION, TURN_PER_STEP, late_by
from solver.checks.rounding import DISTANCE, LIGHT_BODY, PENALTY, SPOILT
from solver.checks.vehicle import ROAD_CURVATURE, STEERING_END, TIRE_DEFLECTION
from solver.compiled.portable import norm
from solver.model.scale import RESTING, STEPS
from solver.output.energy import NOISE, ROUNDING, WRITTEN
from solver.simulation import Simulation
from solver.step.iteration import LARGEST_STAGNATION
from solver.vehicle.size import scale_of

# Checks in the order of `enum check` of verdict.inc, which is that of CHECKS; one that looks at translation and
# rotation has two places. Those of FOLLOWED come behind them.
OF_ACCOUNT = (
    NOT_FINITE, ENERGY_ERROR_MAX, RESIDUAL_MAX, UNSETTLED, POSITION_DRIFT_MAX, VELOCITY_DRIFT_MAX, CONTRADICTION,
    RESOLUTION, RESOLUTION, PHASE, PHASE, CHATTER, RECORDED_INPUTS, INPUT, STEERING_END, PENALTY, LIGHT_BODY, DISTANCE,
    UNSEEN, TURN_PER_STEP, ROTATION, ROAD_CURVATURE, TIRE_DEFLECTION,
)  # fmt: skip
JUDGED = (*OF_ACCOUNT, *FOLLOWED)
# Those whose findings follow from the scene alone: they are made when it is written.
OF_MANEUVER = (RECORDED_INPUTS, INPUT, STEERING_END)
OF_SCENE = (*OF_MANEUVER, ROAD_CURVATURE)
# Those whose limit follows from the run, unless the scene requires one.
OF_RUN = (
    ENERGY_ERROR_MAX, POSITION_DRIFT_MAX, VELOCITY_DRIFT_MAX, CONTRADICTION, UNSEEN, TURN_PER_STEP, TIRE_DEFLECTION,
)  # fmt: skip
# Fields of the account, in the order of `enum span` of verdict.inc; PENALTIES to STATE_B follow them.
FIELDS = (
    'worst', 'worst_at', 'gross', 'kinetic', 'potential', 'turning', 'energy', 'work', 'speed', 'residual', 'position',
    'velocity', 'turn', 'steps', 'unsettled', 'swing', 'kick', 'phase', 'wound', 'astray', 'shake', 'contradiction',
    'time', 'peak',
)  # fmt: skip
NOTED = ('residual', 'position', 'velocity', 'turn', 'wound', 'shake', 'contradiction')
PLACE = '@'  # stands in a reason for the place that the account noted


class Texts(Protocol):
    """Texts of a file."""

    def at(self, text: str) -> int:
        """Place of a text."""


class Judged(NamedTuple):
    """Parts of a file. limits: `struct judged`. places: texts of the places that indices stand for. walls: deflections
    [m] at which tires meet their rims."""

    limits: bytes
    places: bytes
    walls: bytes


def unchecked() -> list[str]:
    """Names of the checks of a run that the library does not make."""
    return [check.name for check in CHECKS if check not in JUDGED]


def told_by(simulation: Simulation, checks: Sequence[Check], k: int) -> dict[str, tuple[str, float]]:
    """Name -> (sentences, time [s] of the first one) of the checks that find something in a run up to step k."""
    evidence, required = dataclasses.replace(evidence_of(simulation), k=k), simulation.scene.require.limits
    told: dict[str, tuple[str, float]] = {}
    for check in checks:
        found = list(check.findings(evidence, required))
        if found:
            since = min(finding.time or 0.0 for finding in found)
            told[check.name] = ('. '.join(finding.text for finding in found), since)
    return told


def judged(
    simulation: Simulation,
    texts: Texts,
    place: Callable[[Any], int],
    told: Mapping[str, tuple[str, float]],
    followed: Mapping[Check, Sequence[str]],
) -> Judged:
    """The parts that verdict.inc reads. place: of what is written, in its section. told: by checks of OF_MANEUVER.
    followed: what checks of FOLLOWED look at."""
    bodies, model, h = simulation.bodies, simulation.model, simulation.h
    length, slow = scale_of(model.spec)
    table, settings = model.tables.bodies, simulation.scene.integrator
    weight, falling = length * float(np.add.reduce(table.mass)) * norm(table.gravity), h * norm(table.gravity)
    least, late = max(falling, NOISE * length / h), late_by(settings.rho_inf)
    masses = model.tables.penalty_inverse_mass * np.where(table.mass > 0.0, table.mass, np.inf)
    numbers = [
        LARGEST_STAGNATION, length, slow, RESTING * length / h, length / (STEPS * h), SHARE, TRUNCATION, weight,
        WRITTEN, ROUNDING, late, least, least / length, LARGEST_PHASE, SPOILT, FEWEST / 2,
        float(masses.min(initial=np.inf)),
    ]  # fmt: skip
    states = [state.value.q[:-1] for state in bodies.states]
    arrays = [getattr(bodies.account, name) for name in FIELDS]
    arrays += [bodies.scheme.value.penalty, bodies.work.row_length[: model.n_rows], *states]
    spans = [word for array in arrays for word in ((place(array), array.size) if array.size else (0, 0))]
    own = {**told, **told_by(simulation, (ROAD_CURVATURE,), 0)}
    places: list[int] = []
    entries = [*_entries(simulation, own), *(_entry_of_followed(check, followed.get(check, ())) for check in FOLLOWED)]
    records = b''.join(_record(entry, texts, places) for entry in entries)
    values = [tire.data.values for tire in model.spec.tires] if len(bodies.account.peak) else []
    walls = [value['UNLOADED_RADIUS'] - value.get('RIM_RADIUS', 0.0) for value in values]
    return Judged(
        np.array(numbers, float).tobytes() + np.array(spans, np.int64).tobytes() + records,
        np.array(places, np.int64).tobytes(),
        np.array(walls, float).tobytes(),
    )


class _Entry(NamedTuple):
    """A record of verdict.inc. limit: nan where it follows from the run; of a sentence that is ready, the time [s] from
    which it holds. reason: '' where the check does not look at this model."""

    check: Check
    limit: float = float('nan')
    reason: str = ''
    remedy: str = ''
    required: bool = False
    places: Sequence[str] = ()


def _record(entry: _Entry, texts: Texts, places: list[int]) -> bytes:
    words = [texts.at(text) for text in (entry.check.name, entry.check.unit, entry.reason, entry.remedy)]
    words += [int(entry.required), len(places), len(entry.places)]
    places += [texts.at(name) for name in entry.places]
    return np.array([entry.limit]).tobytes() + np.array(words, np.int64).tobytes()


def _entries(simulation: Simulation, told: Mapping[str, tuple[str, float]]) -> Iterator[_Entry]:
    probe, required, names = _probe(simulation), simulation.scene.require.limits, _names(simulation)
    parts = {check: list(check.measure(probe)) for check in OF_ACCOUNT if check not in OF_SCENE and check.measure}
    for check in OF_ACCOUNT:
        if check in OF_SCENE:
            sentence, since = told.get(check.name, ('', 0.0))
            yield _Entry(check, since, sentence)
        elif not parts[check]:
            yield _Entry(check)
        else:
            yield _entry(check, parts[check].pop(0), required.get(check.require), names.get(check, ()))


def _entry(check: Check, measured: Measured, required: float | None, places: Sequence[str]) -> _Entry:
    own = float('nan') if check in OF_RUN else check.limit if measured.limit is None else measured.limit
    assert own is not None
    reason = check.reason.format(where=PLACE if places else measured.where, of=measured.of)
    if check in (RESOLUTION, LIGHT_BODY) and measured.reason:  # with numbers of the settings alone
        reason = measured.reason.replace(measured.where, PLACE) if places else measured.reason
    assert reason.count(PLACE) == (1 if places and '{where' in check.reason else 0)
    remedy = check.remedy if check is TURN_PER_STEP else measured.remedy or check.remedy
    return _Entry(check, own if required is None else required, reason, remedy, required is not None, places)


def _entry_of_followed(check: Check, names: Sequence[str]) -> _Entry:
    return (
        _Entry(check, float('nan'), check.reason.format(where=PLACE), check.remedy, places=names)
        if names
        else _Entry(check)
    )


def _probe(simulation: Simulation) -> Evidence:
    """A run in which everything is beyond its limit, so that every check that looks at this model measures."""
    evidence = evidence_of(simulation)
    rows = ('position', 'velocity', 'contradiction') if not evidence.model.n_rows else ()
    worst = {name: np.array([1.0, 0.0, 0.0]) for name in NOTED if name not in rows}
    worst |= {'kick': np.array([[1.0, 0.0, 0.0]] * 2), 'steps': np.array([float(FEWEST)])}
    worst |= {'phase': np.ones(2), 'astray': np.ones(2)}
    return dataclasses.replace(evidence, account=evidence.account._replace(**worst))


def _names(simulation: Simulation) -> dict[Check, list[str]]:
    """Names behind the indices that the account notes, as places in sentences."""
    model, tires = simulation.model, [tire.name for tire in simulation.model.spec.tires]
    bodies = [f'body {name!r}' for name in model.body_names]
    rows = [f'constraint {name!r}' for name in model.row_names]
    elements = [name.rpartition('/')[0] for name in simulation.channels.elements]
    return {
        **dict.fromkeys((RESIDUAL_MAX, RESOLUTION, DISTANCE, TURN_PER_STEP), bodies),
        **dict.fromkeys((POSITION_DRIFT_MAX, VELOCITY_DRIFT_MAX, CONTRADICTION, PENALTY), rows),
        CHATTER: [f'tire {name!r}' for name in tires],
        ROTATION: elements,
        TIRE_DEFLECTION: tires,
    }
