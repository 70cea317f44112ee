"""A check, small and complete (docs/contributing.md): how far bodies have gone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solver.checks.check import Check, Evidence, Measured
from solver.compiled.portable import norms


def strayed(e: Evidence) -> Iterator[Measured]:
    """The distance of the furthest body from the origin, now [m]. Only a scene knows how far is too far."""
    if e.state is not None:
        distances = norms(e.state.q[:-1, :3])
        body = int(np.argmax(distances))
        yield Measured(value=float(distances[body]), where=e.body(body))


STRAYED = Check(
    name='strayed_max',
    unit='m',
    rule='none; distance of a body from the origin at the end of the run',
    measure=strayed,
    reason='{where} has strayed from the origin',
    remedy='Hold it, or end the run before',
    require='strayed_max',
)
