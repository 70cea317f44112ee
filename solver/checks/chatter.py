"""The check of tires that chatter: their horizontal forces turn back every few steps while their loads do not.

Steps and iterations that are too coarse for the slip of a wheel leave so much: with one iteration at 6 to 10 ms forces
of +-17 to +-47 N on a straight road, 0.5 to 0.9 % of the load. Rough roads, cleats, ABS and stops leave less than 0.02
%.
"""

from __future__ import annotations

from collections.abc import Iterator

from solver.checks.check import Check, Evidence, Measured

# of the load of a tire; ten times as much is what friction has beyond which a car slides in a curve
LARGEST_SHAKE = 2e-3


def chatter(e: Evidence) -> Iterator[Measured]:
    """Mean change of a horizontal force of a tire from step to step beyond that of its load, over its load
    (solver.output.shake)."""
    value, time, tire = e.account.shake.tolist()
    if e.model.spec.tires:
        more = 'reduce integrator.h'
        if e.settings.mode == 'fixed':
            more = f'take more integrator.iterations than {e.settings.iterations}, or {more}'
        where = f'tire {e.model.spec.tires[int(tire)].name!r}'
        yield Measured(value=value, time=time, where=where, remedy=f'{more[0].upper()}{more[1:]}')


CHATTER = Check(
    name='chatter',
    unit='of the load',
    limit=LARGEST_SHAKE,
    rule='mean change of a horizontal force of a tire that turns back every few steps (fewer than six a period), '
    'beyond what its load does: roads show in the load, brakes and steering take more steps',
    measure=chatter,
    reason='the forces of {where} chatter from step to step',
    remedy='Take more integrator.iterations, or reduce integrator.h',
    plan='coarse',
    unresolved=True,
)
