"""Checks of the iteration of a step, and of what it leaves open in constraints.

A step is accepted when what its iteration leaves is below LARGEST_STAGNATION of the velocity; over a step that is a
distance. Residual, drift of velocities and drift of positions must not show more than that, and all but few steps a
digit less.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from solver.checks.check import Check, Evidence, Measured
from solver.model.evaluate import turning_rows
from solver.model.scale import slow_speed
from solver.output.energy import SETTLED_INCREMENT
from solver.step.iteration import LARGEST_STAGNATION
from solver.vehicle.size import scale_of

DIVIDE = 'let integrator.step_policy divide such steps'
UNSETTLED_SHARE = 0.01  # of the steps: an impact may leave a step a digit less exact, the motion between may not


def _finer(e: Evidence) -> str:
    """Remedy that makes a step settle."""
    more = 'take more integrator.iterations, or integrator.mode: tolerance'
    return f'reduce integrator.h, or {more}' if e.settings.mode == 'fixed' else f'reduce integrator.h, or {DIVIDE}'


def slow_of(e: Evidence) -> tuple[float, float]:
    """(speed [m/s] below which motions of the model count as slow, its length [m]); where nothing weighs, that of the
    run."""
    length, slow = scale_of(e.model.spec)
    moving, spinning = e.account.speed.tolist()
    return slow or slow_speed(length, 0.0, max(moving, length * spinning), 0.0, e.h), length


def _speed(e: Evidence) -> tuple[float, float]:
    """(largest velocity of the run [m/s], turns by the length of the model and at least its slow speed; that length
    [m])."""
    slow, length = slow_of(e)
    moving, spinning = e.account.speed.tolist()
    return max(slow, moving, length * spinning), length


def _drift(e: Evidence, noted: np.ndarray, per: float) -> Measured:
    """Largest violation of a row that the account noted; the limit is LARGEST_STAGNATION of the velocity, times `per`
    [s or 1]."""
    value, time, row = noted.tolist()
    speed, length = _speed(e)
    limit = LARGEST_STAGNATION * speed * per
    if value > min(limit, limit / length) and e.state is not None and turning_rows(e.model)[int(row)]:
        limit /= length
    where = e.row(int(row)) if value > 0.0 and e.model.row_names else ''
    return Measured(value=value, limit=limit, time=time, where=where)


def residual_max(e: Evidence) -> Iterator[Measured]:
    """The largest last increment of an iteration, relative to the velocity, with the body that changed most."""
    value, time, body = e.account.residual.tolist()
    where = e.body(int(body)) if value > 0.0 and e.model.body_names else ''
    finer = _finer(e)
    yield Measured(value=value, time=time, where=where, remedy=f'{finer[0].upper()}{finer[1:]}')


RESIDUAL_MAX = Check(
    name='residual_max',
    limit=LARGEST_STAGNATION,
    rule='last increment of an iteration, relative to the largest velocity: angular ones by the length of the model, '
    'and at least its slow speed (1 m/s of a passenger car)',
    measure=residual_max,
    reason='the iteration of a step did not settle, least in {where}',
    remedy='Reduce integrator.h, or take more integrator.iterations',
    require='residual_max',
    turned=True,
    seen_by_twin=True,
)


def unsettled(e: Evidence) -> Iterator[Measured]:
    """The share of steps whose last increment is above SETTLED_INCREMENT."""
    share = float(e.account.unsettled[0]) / max(float(e.account.steps[0]), 1.0)
    yield Measured(
        value=share, remedy=f'Their last increment is above {SETTLED_INCREMENT:g} of the velocity: {_finer(e)}'
    )


UNSETTLED = Check(
    name='unsettled',
    unit='of the steps',
    limit=UNSETTLED_SHARE,
    rule=f'steps with a last increment above {SETTLED_INCREMENT:g}',
    measure=unsettled,
    reason='the iterations of many steps did not settle',
    remedy='Reduce integrator.h, or take more integrator.iterations',
    turned=True,
    seen_by_twin=True,
)


def position_drift_max(e: Evidence) -> Iterator[Measured]:
    """Largest violation of a constraint [m or rad]."""
    yield _drift(e, e.account.position, e.h)


POSITION_DRIFT_MAX = Check(
    name='position_drift_max',
    unit='m or rad',
    rule=f'{LARGEST_STAGNATION:g} of the largest velocity, at least the slow speed of the model, times the step',
    measure=position_drift_max,
    reason='{where} is open',
    remedy='Reduce integrator.h, raise integrator.penalty, or check whether joints contradict each other',
    require='position_drift_max',
)


def velocity_drift_max(e: Evidence) -> Iterator[Measured]:
    """Largest violation of a constraint by a velocity [m/s or rad/s]."""
    yield _drift(e, e.account.velocity, 1.0)


VELOCITY_DRIFT_MAX = Check(
    name='velocity_drift_max',
    unit='m/s or rad/s',
    rule=f'{LARGEST_STAGNATION:g} of the largest velocity, at least the slow speed of the model',
    measure=velocity_drift_max,
    reason='a velocity violates {where}',
    remedy='Reduce integrator.h or raise integrator.penalty',
    require='velocity_drift_max',
)
