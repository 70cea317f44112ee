"""Subsystems of a vehicle by what they do: their activity, the integral of |power| over a maneuver [Louca2010], and their
influence, the errors that leaving one of them out makes.

Activity orders what is tried first and decides nothing: it ignores the quantity that is asked for, and a stiff bushing
with next to no activity may decide compliance steer.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from solver import simulation_of
from solver.errors import MbdError
from solver.levels import derive
from solver.scene import Scene
from solver.trade import cost
from solver.trade.bench import Bench, per_step, run_of, truth_of
from solver.trade.runs import departures
from solver.trade.setting import Setting
from solver.trade.variations import AS_GIVEN

STEP = 2e-3  # s


class Influence(NamedTuple):
    """Leaving one subsystem out: errors as shares of the peak by quantity (RMS), and the cost of a step relative to before."""

    subsystem: str
    activity: float  # J
    errors: dict[str, float]
    cost: float
    failure: str


def of_elements(scene: Scene, until: float) -> dict[str, float]:
    """Element -> integral over time until [s] of |d(stored energy)/dt + dissipation| [J] in the full vehicle. Raises MbdError."""
    simulation = simulation_of(Setting(h=STEP, iterations=2).of(scene))
    names = simulation.channels.elements
    elements = [name.removesuffix('/energy') for name in names if name.endswith('/energy')]
    columns = np.array([[names.index(f'{e}/{what}') for what in ('energy', 'dissipation')] for e in elements], int).reshape(-1, 2)
    rows = [simulation.snapshot().elements[columns]]
    for _ in range(round(until / simulation.h)):
        rows.append(simulation.advance(1, audit=False).elements[columns])
    data = np.array(rows)
    power = np.diff(data[:, :, 0], axis=0) / simulation.h + 0.5 * (data[1:, :, 1] + data[:-1, :, 1])
    return dict(zip(elements, (np.abs(power).sum(axis=0) * simulation.h).tolist(), strict=True))


def of_subsystems(scene: Scene, until: float) -> dict[str, float]:
    """Subsystem that is on -> activity [J] of the elements that its switch removes; those that cannot be off are left out."""
    elements = of_elements(scene, until)
    found = {}
    there = [one.subsystem for one in derive(scene).report.switched if one.on]
    for subsystem in there:
        try:
            absent = derive(Setting(off=(subsystem,)).of(dataclasses.replace(scene, resolved=''))).report.absent
        except MbdError:
            continue
        removed = {name.partition(' ')[2] for name in absent}
        found[subsystem] = sum((one for name, one in elements.items() if name in removed), 0.0)  # in the same order every time
    return found


def influences(bench: Bench, base: Setting, names: Sequence[str], say: Callable[[str], None]) -> Iterator[Influence]:
    """The influence of each subsystem on these quantities, alone, in the setting `base`; the least active first. Raises
    StepError and Stopped."""
    try:
        activity = of_subsystems(bench.scene, bench.scene.duration)
    except MbdError:
        activity = {}
    before, truth = run_of(bench, AS_GIVEN, base), truth_of(bench, AS_GIVEN)
    whole, size = per_step(bench, base), cost.size(bench.scene, base)
    evaluations = before.counters['evaluations']
    for subsystem in sorted(activity, key=lambda s: activity[s]):
        say(f'without {subsystem}')
        setting = dataclasses.replace(base, off=(subsystem,))
        try:
            same = cost.size(bench.scene, setting) == size
            share = 1.0 if same else per_step(bench, setting).of(1.0, evaluations) / whole.of(1.0, evaluations)
        except MbdError as error:
            yield Influence(subsystem, activity[subsystem], {}, 1.0, str(error))
            continue
        found = run_of(bench, AS_GIVEN, setting)
        errors = departures(found, before.time, before.curves, truth.quantities, truth.peaks)
        yield Influence(subsystem, activity[subsystem], {n: errors[n].rms / truth.peaks[n] for n in names}, share, found.failure)
