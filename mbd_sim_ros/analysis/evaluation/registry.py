"""All evaluations; a new one is a file of its family and a line here."""

from __future__ import annotations

import re

from mbd_sim_ros.analysis.evaluation import (
    braking,
    lane_change,
    on_centre,
    ride,
    sine_with_dwell,
    steady_state,
    transient,
)
from mbd_sim_ros.analysis.evaluation.drive import judging as ordinary
from mbd_sim_ros.analysis.evaluation.kinds import Evaluation
from solver.errors import SpecError, suggestion

EVALUATIONS: tuple[Evaluation, ...] = (
    steady_state.CONSTANT_RADIUS,
    steady_state.CONSTANT_STEERING,
    steady_state.CONSTANT_SPEED,
    transient.STEP,
    transient.FREQUENCY,
    on_centre.WEAVE,
    sine_with_dwell.SINE_WITH_DWELL,
    lane_change.DOUBLE,
    lane_change.AVOIDANCE,
    braking.STOPPING,
    braking.SPLIT_FRICTION,
    ride.RIDE,
    ordinary.DRIVE,
)


def names() -> list[str]:
    """Names of all evaluations, of the norms that several of them belong to, and other names."""
    families = {e.name.partition('_')[0] for e in EVALUATIONS}
    return list(
        dict.fromkeys([*(e.name for e in EVALUATIONS), *sorted(families), *(a for e in EVALUATIONS for a in e.aliases)])
    )


def called(name: str) -> tuple[Evaluation, ...]:
    """One evaluation by its name, or all of a norm ('iso4138'). Raises SpecError with the nearest name."""
    key = re.sub(r'^(iso|fmvss)_', r'\1', re.sub(r'[\s-]+', '_', name.strip().lower()))
    one = [e for e in EVALUATIONS if key in (e.name, *e.aliases)]
    found = one or [e for e in EVALUATIONS if e.name.startswith(f'{key}_')]
    if not found:
        raise SpecError(f'no evaluation {name!r}{suggestion(key, names())}')
    return tuple(found)
