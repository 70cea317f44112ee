"""Checks of a level of detail: whether a run stays where it holds (solver.levels), and within the certificate of its
plan."""

from __future__ import annotations

from collections.abc import Iterator

from solver.checks.check import Check, Evidence, Measured

REMEDY = 'Take a level with more detail, or fidelity: full'


def validity(e: Evidence) -> Iterator[Measured]:
    """Quantities of the run that its level limits from above; ranges are followed by solver.analysis.envelope."""
    for limit in e.level.validity if e.level is not None else ():
        if limit.quantity in e.reached and limit.low is None and limit.high is not None:
            value, time = e.reached[limit.quantity]
            yield Measured(
                value=value, limit=limit.high, time=time, of=limit.quantity, unit=limit.unit,
                remedy=f'The limit: {limit.why}. {REMEDY}',
            )  # fmt: skip


VALIDITY = Check(
    name='validity',
    rule='what `mbd info` says of the level, from above',
    measure=validity,
    reason='the level of detail is outside its range of {of}',
    remedy=REMEDY,
    plan='coarse',
)
ENVELOPE = Check(
    name='envelope',
    rule='the ranges of a level (`mbd info`), and of the certificate of a plan',
    measure=None,
    reason='the run leaves its envelope',
    remedy='Make a plan of a scene that covers this range, or take fidelity: full',
    plan='coarse',
)
