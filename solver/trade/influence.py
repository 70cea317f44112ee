"""Influence of the subsystems of a vehicle: the errors that leaving one of them out makes, and what it saves."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

from solver.errors import MbdError
from solver.levels.derived import channels
from solver.levels.switches import switched
from solver.model.spec import ModelSpec
from solver.trade import cost
from solver.trade.bench import Bench, derived, per_step, run_of, simulation, truth_of
from solver.trade.runs import Stopped, departures
from solver.trade.setting import Setting
from solver.trade.variations import AS_GIVEN


class Influence(NamedTuple):
    """Leaving one subsystem out: errors as shares of the peak by quantity (RMS; none where it was not run, for it saves
    nothing), and the cost of a step relative to before."""

    subsystem: str
    errors: dict[str, float]
    cost: float
    failure: str


def influences(
    bench: Bench,
    base: Setting,
    names: Sequence[str],
    say: Callable[[str], None],
    known: Mapping[str, float],
    saves: float,
) -> Iterator[Influence]:
    """The influence of each subsystem on these quantities, alone, in the setting `base`.

    known: cost of a step by subsystem, relative to before, as it was measured earlier on this vehicle. What takes no
    body, joint or height grid out of the model saves less than the clock sees, and no level is derived without it. Only
    what brings the cost below `saves` is run. Raises StepError and Stopped.
    """
    whole, reduced = bench.scene.model, simulation(bench, AS_GIVEN, base).scene.model
    before, truth = run_of(bench, AS_GIVEN, base), truth_of(bench, AS_GIVEN)
    evaluations = before.counters['evaluations']
    size = cost.size(simulation(bench, AS_GIVEN, base))
    for subsystem in (one.subsystem for one in derived(bench, base).report.switched if one.on):
        if bench.stop is not None and bench.stop():
            raise Stopped
        if subsystem not in known and not _is_there(whole, switched(whole, {subsystem: 'off'})[0], reduced):
            yield Influence(subsystem, {}, 1.0, '')
            continue
        say(f'without {subsystem}')
        setting = dataclasses.replace(base, off=(subsystem,))
        try:
            share = known.get(subsystem, 1.0)
            if (
                subsystem not in known
                and derived(bench, setting)
                and cost.size(simulation(bench, AS_GIVEN, setting)) != size
            ):
                share = per_step(bench, setting).of(1.0, evaluations) / per_step(bench, base).of(1.0, evaluations)
        except MbdError as error:
            yield Influence(subsystem, {}, 1.0, str(error))
            continue
        if share >= saves:
            yield Influence(subsystem, {}, share, '')
            continue
        found = run_of(bench, AS_GIVEN, setting)
        errors = departures(found, before.time, before.curves, truth.quantities, truth.peaks, names)
        yield Influence(subsystem, {n: errors[n].rms / truth.peaks[n] for n in names}, share, found.failure)


def _is_there(whole: ModelSpec, without: ModelSpec, reduced: ModelSpec) -> bool:
    """True where a reduced model still has a body, a joint or a height grid of the subsystem that a vehicle is
    `without`."""
    gone = {name for name in {*channels(whole)} - {*channels(without)} if name.startswith(('body ', 'joint '))}
    return bool(gone & {*channels(reduced)}) or len(without.road.grids) < len(reduced.road.grids)
