"""Checks of the step against the motion: steps per oscillation, phase that is lost, turn in a step.

*Resolution.* Of a motion that takes a period in N steps an acceleration changes, over a step and times the step, by (2
pi / N)^2 of the amplitude of its velocity. So it must not change by more than (2 pi / 10)^2 of half the widest range
that a velocity had in the run, which a steady motion in common does not widen: with fewer than ten steps a period,
positions are off by 3 % of what they do. Translation and rotation are looked at apart. A fast vibration of small
amplitude passes, a stiff transient that sets the whole motion going does not. After fewer steps than half such a period
nothing can be said. *Phase.* Of such a motion with the frequency w a step h costs (w h)^3 / 12 of phase. Added up over
all steps, with (w h)^2 as above at the time, that must stay below 0.1 rad; what is really lost is up to twice that, a
fifth of the amplitude. Beyond the limit amplitudes may be right, but not positions at an instant. A motion forgets its
phase with its energy: of the largest kinetic energy so much as is dissipated takes half as much of the phase with it;
and where it swings wider, what it was late by before is so much less of it. Phase is lost in free directions alone:
where constraints and drivers impose a motion, as the beat of a universal joint, they take the error of a step off, and
what they take off is not counted. A vibration with the share r of the range of velocities beside a slower motion has at
most r^2 of its displacements, so its phase counts as that much less. *Order four.* Extrapolation of h and h / 2 loses
(w h)^5 / 320 of phase in a step and adds (w h)^6 / 1152 to the amplitude; its steps of h may be half as many a period
for the same error as that of order two with ten. *Spin.* The axis of a body that spins with s and turns by O is turned
too little by (1/2 + A / C) (s h)^2 / 12 of O, with the moments of inertia C about the spin and A across: by the
expansion of a step of a precessing top. About an axis that stays a step is exact whatever it turns, and an axis that
bearings hold is turned by these. So the turn of free axes that is missed counts, at most as much as the torque that is
too small changes the kinetic energy of the motion, and less what is forgotten; beyond 0.1 rad the run is told with the
turn of that body in a step. *Damping.* All are the midpoint rule's, rho_inf = 1. Numerical damping makes more of the
same step: late_by() times the phase, so that as much accuracy takes more steps a period, by the root of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from solver.checks.check import Check, Evidence, Measured, largest
from solver.compiled.portable import norm
from solver.output.energy import NOISE
from solver.vehicle.size import scale_of

LARGEST_PHASE = 0.1  # rad
FEWEST = 10  # steps a period
FEWEST_OF_FOUR = 5  # the same of order four: a step then loses half as much phase as one of order two with ten
PARTS = ('translation', 'rotation')


def late_by(rho_inf: float) -> float:
    """The phase that a step of the scheme loses, over the (w h)^3 / 12 of the midpoint rule: 1 + 9/2 ((1 - rho_inf) /
    (1 + rho_inf))^2.

    From the principal root exp(i w h (1 - c (w h)^2 + ...)) of the scheme [Chung1993] for an oscillator.
    """
    return 1.0 + 4.5 * ((1.0 - rho_inf) / (1.0 + rho_inf)) ** 2


def _shorter(e: Evidence) -> str:
    remedy = 'reduce integrator.h'
    if e.settings.order == 4:
        remedy += ', or take integrator.order: 2 (extrapolation amplifies vibrations that steps do not resolve)'
    if late_by(e.settings.rho_inf) > 2.0:
        remedy += ', or take a larger integrator.rho_inf (numerical damping delays vibrations)'
    return remedy


def resolution(e: Evidence) -> Iterator[Measured]:
    """Change of an acceleration in a step, times the step, relative to half the widest range of a velocity."""
    if e.account.steps[0] < FEWEST / 2:
        return
    falling, late, shorter = e.h * norm(e.model.tables.bodies.gravity), late_by(e.settings.rho_inf), _shorter(e)
    length, _ = scale_of(e.model.spec)
    fourth = e.settings.order == 4
    fewest = FEWEST_OF_FOUR if fourth else FEWEST
    # accelerations of order four are those of half a step
    limit = (2.0 * math.pi / fewest) ** 2 / (2.0 if fourth else late)
    slowest = max(falling, NOISE * length / e.h)
    for part, kick, swing, least in zip(
        PARTS, e.account.kick, e.account.swing.tolist(), (slowest, slowest / length), strict=True
    ):
        worst = largest(kick, e.body)
        yield Measured(
            value=worst.value / max(swing, least), limit=limit,
            time=worst.time, where=worst.where, of=part,
            reason=f'fewer than {fewest * math.sqrt(late):.0f} steps per oscillation of {worst.where} in {part}',
            remedy=f'{shorter[0].upper()}{shorter[1:]}',
        )  # fmt: skip


RESOLUTION = Check(
    name='resolution',
    rule=f'{(2.0 * math.pi / FEWEST) ** 2:.2g} / c, with c as of `phase`: change of an acceleration in a step, times '
    'the step, relative to half the widest range of a velocity, at least what gravity adds to one in a step: fewer '
    'than ten steps a period, 23 with `rho_inf: 0`; 0.79 with `order: 4`, five steps',
    measure=resolution,
    reason=f'fewer than {FEWEST} steps per oscillation of {{where}} in {{of}}',
    remedy='Reduce integrator.h',
    plan='coarse',
    unresolved=True,
    turned=True,
    seen_by_twin=True,
)


def phase(e: Evidence) -> Iterator[Measured]:
    """Phase that the steps have cost what vibrates [rad]."""
    if e.account.steps[0] < FEWEST / 2:
        return
    late, remedy = late_by(e.settings.rho_inf), f'The step is too long for the fastest oscillation: {_shorter(e)}'
    for part, lost in zip(PARTS, e.account.phase.tolist(), strict=True):
        yield Measured(value=late * lost, of=part, remedy=remedy)


PHASE = Check(
    name='phase',
    unit='rad',
    limit=LARGEST_PHASE,
    rule='sum over the steps of c (omega h)^3 / 12 of what vibrates as wide as velocities range, less what is '
    'forgotten with dissipated energy and what constraints impose; with `order: 4` of (omega h)^5 / 320; '
    'c = 1 + 9/2 ((1 - rho_inf) / (1 + rho_inf))^2, 1.06 by default and 5.5 with `rho_inf: 0`',
    measure=phase,
    reason='vibrations are out of phase in {of}',
    remedy='The step is too long for the fastest oscillation: reduce integrator.h',
    plan='coarse',
    unresolved=True,
    turned=True,
    seen_by_twin=True,
)


def turn_per_step(e: Evidence) -> Iterator[Measured]:
    """The turn in a step [rad] of the body whose axis the steps have turned wrong by most; the limit is the turn that
    would leave all axes wrong by LARGEST_PHASE, with the square of which that goes. None where no axis turns; reference
    integrators choose their own steps."""
    if not e.settings.kind.startswith('reference_'):
        value, time, body = e.account.turn.tolist()
        astray = float(e.account.astray[0])
        if astray > 0.0:
            remedy = f'Axes that turn are wrong by {astray:.2g} rad, {LARGEST_PHASE:g} are allowed: {_shorter(e)}'
            yield Measured(
                value=value,
                limit=value * (LARGEST_PHASE / astray) ** 0.5,
                time=time,
                where=e.body(int(body)),
                remedy=remedy,
            )


TURN_PER_STEP = Check(
    name='turn_per_step',
    unit='rad',
    rule=f'turn of a body in a step that leaves the axes that turn wrong by {LARGEST_PHASE:g} rad in the run, (1/2 + A '
    '/ C) (turn)^2 / 12 of what a free axis turns; none about axes that stay or that bearings hold',
    measure=turn_per_step,
    reason='{where} turns too far in a step about an axis that turns itself',
    remedy='Reduce integrator.h',
    plan='coarse',
    anywhere=True,
    turned=True,
    seen_by_twin=True,
)
