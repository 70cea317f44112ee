"""Every check there is, one line each, in the order in which findings are told."""

from __future__ import annotations

from typing import Any

from solver.checks.account import CONTRADICTION, ENERGY_ERROR_MAX, NOT_FINITE, UNSEEN
from solver.checks.chatter import CHATTER
from solver.checks.check import Check
from solver.checks.error import NUMERICAL_ERROR
from solver.checks.inputs import INPUT, RECORDED_INPUTS
from solver.checks.iteration import POSITION_DRIFT_MAX, RESIDUAL_MAX, UNSETTLED, VELOCITY_DRIFT_MAX
from solver.checks.level import ENVELOPE, VALIDITY
from solver.checks.motion import BRANCH_SWITCHES, ROTATION
from solver.checks.resolution import PHASE, RESOLUTION, TURN_PER_STEP
from solver.checks.rounding import DISTANCE, LIGHT_BODY, PENALTY
from solver.checks.speed import REAL_TIME_FACTOR_MIN
from solver.checks.vehicle import (
    ARTICULATION,
    CROSSED,
    ROAD_CURVATURE,
    ROLLOVER,
    STEERING_END,
    SUSPENSION,
    TIRE_DEFLECTION,
    TIRE_LOAD,
    UNDER_ROAD,
    WHEEL_AXIS,
)

CHECKS: tuple[Check, ...] = (
    NUMERICAL_ERROR,
    NOT_FINITE,
    ENERGY_ERROR_MAX,
    RESIDUAL_MAX,
    UNSETTLED,
    POSITION_DRIFT_MAX,
    VELOCITY_DRIFT_MAX,
    CONTRADICTION,
    RESOLUTION,
    PHASE,
    CHATTER,
    RECORDED_INPUTS,
    INPUT,
    STEERING_END,
    PENALTY,
    LIGHT_BODY,
    DISTANCE,
    UNSEEN,
    TURN_PER_STEP,
    ROTATION,
    ROAD_CURVATURE,
    TIRE_DEFLECTION,
    BRANCH_SWITCHES,
    REAL_TIME_FACTOR_MIN,
    VALIDITY,
    ARTICULATION,
    UNDER_ROAD,
    SUSPENSION,
    WHEEL_AXIS,
    CROSSED,
    ROLLOVER,
    TIRE_LOAD,
    ENVELOPE,
)


def _limits() -> dict[str, Any]:
    for names in ([check.name for check in CHECKS], [check.require for check in CHECKS if check.require]):
        double = {name for name in names if names.count(name) > 1}
        if double:
            raise TypeError(f'checks: the name {min(double)!r} is used twice')
    return {check.require: check.hint for check in CHECKS if check.require}


BY_NAME = {check.name: check for check in CHECKS}
LIMITS = _limits()  # keys of `require` that are limits of checks, with their types
