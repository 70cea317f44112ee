"""Checks of the inputs: signals that steps do not see, and recorded ones of which something was lost.

A step takes one value of every signal: of one that swings with the steps, or nearly, it makes a constant or a slow
beat, which no motion shows (solver.inputs.unresolved). Recorded inputs must be complete, unmerged and in their order.
"""

from __future__ import annotations

from collections.abc import Iterator

from solver.checks.check import Check, Evidence, Measured
from solver.inputs.maneuver import ManeuverSource
from solver.inputs.recorded import RecordedSource
from solver.inputs.unresolved import LARGEST


def unresolved(e: Evidence) -> Iterator[Measured]:
    """Departure of signals of the maneuver from straight lines between their values at the steps, over their range."""
    found = e.source.unresolved(e.k, e.duration) if isinstance(e.source, ManeuverSource) else {}
    for name, (largest, first) in found.items():
        yield Measured(value=largest, time=first, where=name)


INPUT = Check(
    name='input',
    limit=LARGEST,
    rule='how far a signal of the maneuver departs from straight lines between the steps that sample it, of its '
    'range, in half of ten steps in a row: fewer than about eight steps a period',
    measure=unresolved,
    reason='signal {where!r} of the maneuver swings between the steps that sample it',
    remedy='Reduce integrator.h',
    unresolved=True,
)


def recorded_inputs(e: Evidence) -> Iterator[Measured]:
    """Doubts about recorded inputs."""
    if isinstance(e.source, RecordedSource) and (doubts := e.source.given.doubts):
        yield Measured(value=len(doubts), remedy=f'{e.source.given.where}: {"; ".join(doubts)}')


RECORDED_INPUTS = Check(
    name='recorded_inputs',
    limit=0.0,
    rule='doubts about a recording that drives the run: messages left out, merged or put in another order, or a run '
    'that was suspect',
    measure=recorded_inputs,
    reason='the recorded inputs are incomplete or doubtful',
    remedy='Repair the recording, or take another one',
)
