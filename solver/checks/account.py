"""Checks of the energy account: energy that is missing, or beyond numbers; joints that hold each other; steps without
an account."""

from __future__ import annotations

import math
from collections.abc import Iterator

from solver.checks.check import Check, Evidence, Measured
from solver.output.energy import WRITTEN, contradicts, exchanged, left_open
from solver.step.failure import MORE_DIGITS
from solver.vehicle.size import scale_of

SHARE = 0.01  # of the exchanged energy
TRUNCATION = 1.0 / 12.0  # of (turn in a step)^2
# Entries of the account whose sums over the steps do not come back from beyond numbers.
ENERGIES = ('energy', 'work', 'gross', 'worst')


def not_finite(e: Evidence) -> Iterator[Measured]:
    """Number of energies of the account that are not finite."""
    numbers = [float(getattr(e.account, name)[0]) for name in ENERGIES]
    numbers += [float(e.account.kinetic[1]), *e.account.potential.tolist()]
    yield Measured(value=sum(not math.isfinite(number) for number in numbers))


NOT_FINITE = Check(
    name='not_finite',
    limit=0.0,
    rule='energies in the account that are too large for numbers: it compares with nothing then; a run of which a '
    'number that is shown is not finite ends with `error`',
    measure=not_finite,
    reason='the energy account overflows',
    remedy='Energies exceed the range of numbers: look for a value of a wrong order of magnitude',
)


def energy_error_max(e: Evidence) -> Iterator[Measured]:
    """The largest error of the balance [J].

    A second-order method that takes a period in twenty steps (omega h = 0.31) misses (omega h)^2/12 = 0.8 % of the
    energy that moves to and fro. So 1 % of what was exchanged may be missing (solver.output.energy), besides (turn in a
    step)^2/12 of the kinetic energy of bodies that turn, in which energy goes from axis to axis unseen by that account,
    and what numbers leave open.
    """
    moved = exchanged(e.account)
    if math.isfinite(moved):  # of what is not, not_finite() tells
        numbers = left_open(e.account, e.model.tables.bodies, scale_of(e.model.spec)[0])
        limit = SHARE * moved + TRUNCATION * float(e.account.turning[0]) + numbers
        reason = f'the energy account misses some of the {moved:.3g} J that were exchanged'
        yield Measured(value=float(e.account.worst[0]), limit=limit, time=float(e.account.worst_at[0]), reason=reason)


ENERGY_ERROR_MAX = Check(
    name='energy_error_max',
    unit='J',
    rule=f'{100.0 * SHARE:g} % of the energy exchanged: ranges of kinetic and of potential energy, and everything '
    'dissipated and supplied (a period in twenty steps misses (omega h)^2/12 = 0.8 %); besides (turn in a step)^2/12 '
    'of the kinetic energy of turning bodies',
    measure=energy_error_max,
    reason='the energy account misses some of the energy that was exchanged',
    remedy='The step is too long for what is stiff or fast: reduce integrator.h, or find what is too stiff or too fast',
    require='energy_error_max',
    unresolved=True,
    seen_by_twin=True,
)


def contradiction(e: Evidence) -> Iterator[Measured]:
    """The largest energy of redundant rows that cannot all be closed [J], by so little that neither their drift nor the
    balance tells it.

    Such rows, as of axes that are parallel to seven digits, hold each other with multipliers that grow from step to
    step: those of a four-bar linkage out by 1e-7 came to 5e5 N and turned it 2 rad too far, with its energy kept. In
    sound runs the work of multipliers that balance each other, in rows that stay open, is below 1e-10 of the exchanged
    energy.
    """
    if e.state is not None and e.model.n_rows:
        value, time, row = e.account.contradiction.tolist()
        _, limit = contradicts(e.account, e.model.tables.bodies, scale_of(e.model.spec)[0])
        yield Measured(value=value, limit=limit, time=time, where=e.row(int(row)))


CONTRADICTION = Check(
    name='contradiction',
    unit='J',
    rule=f'{WRITTEN:g} of what was exchanged, and what numbers leave open: largest energy, of all steps, of redundant '
    'multipliers that balance each other in rows that stay open',
    measure=contradiction,
    reason='redundant joints contradict each other, most at {where}',
    remedy=f'They hold each other with forces that move nothing: {MORE_DIGITS}',
)


def unseen(e: Evidence) -> Iterator[Measured]:
    """Time that the account does not cover [s]: of steps that were advanced without it nothing is known."""
    yield Measured(value=e.time - float(e.account.time[0]), limit=0.5 * e.h)


UNSEEN = Check(
    name='unseen',
    unit='s',
    rule='half a step: time that was advanced without an account',
    measure=unseen,
    reason='steps were advanced without an account',
    remedy='Errors of these steps are unknown: advance with audit=True',
)
