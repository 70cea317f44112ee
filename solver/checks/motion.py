"""Checks of what a mechanism does: bushings that turn by pi, branches that change in singular positions."""

from __future__ import annotations

from collections.abc import Iterator

from solver.checks.check import Check, Evidence, Measured
from solver.elements.bushing import BushingSpec

LARGEST_WOUND = 3.0  # rad


def rotation(e: Evidence) -> Iterator[Measured]:
    """The largest turn of a bushing [rad].

    A bushing acts on its rotation vector, which is the short way round: where it turns by pi that jumps, and the torque
    with it, without a trace in the account of energy. It is told from 3 rad on, which no step of less than 0.28 rad
    leaps over, where bushings resist turning.
    """
    if e.state is not None and any(_resists_turning(bushing) for bushing in e.model.spec.bushings):
        angle, time, at = e.account.wound.tolist()
        where = e.channels.elements[int(at)].rpartition('/')[0] if angle > 0.0 else ''
        yield Measured(value=angle, time=time, where=where)


def _resists_turning(bushing: BushingSpec) -> bool:
    """True where a bushing has a torque that depends on the angle by which it is turned."""
    return any((*bushing.stiffness[3:], *bushing.preload[3:])) or any(law is not None for law in bushing.laws[3:])


ROTATION = Check(
    name='rotation',
    unit='rad',
    limit=LARGEST_WOUND,
    rule='turn of a bushing, whose torque jumps to the other side at pi; none where no bushing resists turning',
    measure=rotation,
    reason='bushing {where!r} turns by nearly 180 deg, where its torque jumps to the other sign',
    remedy='Replace it by a joint that turns so far, with a coordinate_force on its angle',
    plan='scene',
)


def branch_switches(e: Evidence) -> Iterator[Measured]:
    """Number of times that the mechanism left a singular position on another branch than it came in on."""
    if not e.switches:
        return
    first = float(e.switches[0].t)
    if e.watched:
        yield Measured(value=len(e.switches), time=first)
    else:
        other = 'a step that failed was divided, and the shorter steps continued on another branch'
        yield Measured(value=len(e.switches), time=first, reason=other)


BRANCH_SWITCHES = Check(
    name='branch_switches',
    limit=0.0,
    rule='where they are looked for (`record.branches`, or a limit that is required), and across steps that failed and '
    'were divided',
    measure=branch_switches,
    reason='the mechanism left a singular position on another branch than it came in on',
    remedy='Reduce integrator.h, or give integrator.rho_inf some damping',
    require='branch_switches_max',
    count=True,
)
