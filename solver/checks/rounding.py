"""Checks of rounding: penalties that are too large, bodies that are too light beside others, places too far from the
origin.

*Penalty.* It multiplies the rounding of the condensed matrix; the block form does not care (docs/formulation.md,
"Rounding"). It is told where iterations do not settle with one that is too large: of a car 1e7 leave 3e-10 m after 2 s,
and 1e8 1e-3 m. *Light bodies.* Penalties take a body for no lighter than 1e-4 of the mean: of one with less mass m they
add eps penalty 1e-4 mean / m of rounding to its own acceleration. Beside 1 kg a pendulum of 1e-8 kg is right, one of
1e-10 kg was off by 0.03 m and nothing else told it. *Distance.* A place at the distance D is rounded by eps D in every
step, and a velocity of the step by eps D / h: over n steps these walk to sqrt(n) times as much, of which 3e-5 of half
that widest range (at least the slow speed of the model) is left to be. Regular motions hardly feel it; at a singular
position it chooses how a mechanism passes: of twelve slider-cranks with 4e-5 the worst was off by 1.7e-4 m after a
second.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from solver.checks.check import Check, Evidence, Measured
from solver.checks.iteration import slow_of
from solver.model.saddle import CONDENSED
from solver.step.failure import ROUNDING_PENALTY

# Last increment of an iteration, relative to the velocity; three iterations bring it below 1e-6 where nothing spoils
# them.
SPOILT = 1e-4
HIDDEN = 3e-5  # of an acceleration
LARGEST_ROUNDING = 3e-5  # of half the widest range of a velocity


def _condensed(e: Evidence) -> bool:
    """True where the steps solve a condensed matrix with penalties; those of a single track have no matrix."""
    return e.state is not None and e.settings.kind == 'alf' and e.scheme.form == CONDENSED and e.model.n_rows > 0


def penalty(e: Evidence) -> Iterator[Measured]:
    """The largest penalty of a condensed matrix whose iterations do not settle."""
    if e.account.residual[0] > SPOILT and _condensed(e):
        row = int(np.argmax(e.scheme.penalty))
        yield Measured(value=float(e.scheme.penalty[row]), where=e.row(row))


PENALTY = Check(
    name='penalty',
    limit=ROUNDING_PENALTY,
    rule=f'in the form `condensed`, where an iteration left more than {SPOILT:g} of the velocity: larger ones multiply '
    'the rounding of the matrix',
    measure=penalty,
    reason='iterations do not settle because the penalty of {where} multiplies the rounding of the condensed matrix',
    remedy='Reduce integrator.penalty, or take integrator.form: block',
)


def light_body(e: Evidence) -> Iterator[Measured]:
    """Rounding that penalties, which have a floor, add to the acceleration of a body that is light beside the others,
    relative to it."""
    if e.account.steps[0] == 0.0 or not _condensed(e):
        return
    bodies = e.model.tables.bodies
    mass = np.where(bodies.mass > 0.0, bodies.mass, np.inf)  # without any mass nothing is hidden
    hidden = np.finfo(float).eps * float(e.scheme.penalty.max()) / (e.model.tables.penalty_inverse_mass * mass)
    body, given = int(np.argmax(hidden)), e.settings.penalty
    if given > ROUNDING_PENALTY:  # the penalty is to blame, not the body
        below = 10.0 ** math.floor(math.log10(given * HIDDEN / hidden[body])) if hidden[body] > HIDDEN else given
        yield Measured(
            value=float(hidden[body]),
            reason=f'the penalty {given:g} is so large that rounding hides the inertia of bodies',
            remedy=f'Reduce integrator.penalty to {below:.0e} or less, or take integrator.form: block',
        )  # fmt: skip
        return
    enough = f'{mass[body] * hidden[body] / HIDDEN:.2g} kg or more, or none where constraints determine its motion'
    yield Measured(value=float(hidden[body]), where=e.body(body), remedy=f'Give it {enough}')


LIGHT_BODY = Check(
    name='light_body',
    limit=HIDDEN,
    rule='rounding that penalties in the form `condensed` add to the acceleration of a body, lighter than 4e-10 '
    'of the others with the default',
    measure=light_body,
    reason='the penalties are so large that rounding hides the inertia of {where}, which is light beside the others',
    remedy='Reduce integrator.penalty, or give the body more mass, or none where constraints determine its motion',
    seen_by_twin=True,
)


def distance(e: Evidence) -> Iterator[Measured]:
    """Error of a velocity by rounding of the position of the furthest body, in all steps together, over half the widest
    range of the velocity."""
    if e.account.steps[0] == 0.0 or e.state is None:
        return
    far = np.abs(e.state.q[:-1, :3]).max(axis=1)
    body = int(np.argmax(far))
    kick = np.finfo(float).eps * float(far[body]) / e.h
    speed, _ = slow_of(e)
    value = kick * max(float(e.account.steps[0]), 1.0) ** 0.5 / max(speed, float(e.account.swing[0]))
    yield Measured(value=value, where=e.body(body))


DISTANCE = Check(
    name='distance',
    limit=LARGEST_ROUNDING,
    rule='what rounding of places far from the origin makes of half the widest range of a velocity (at least the slow '
    'speed of the model), in all steps together',
    measure=distance,
    reason='{where} is so far from the origin that rounding of its place shows in its velocity',
    remedy='Move the model nearer to the origin, or take a larger integrator.h',
    seen_by_twin=True,
)
