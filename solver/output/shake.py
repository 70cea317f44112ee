"""Chatter of tires: forces that change from step to step by more than what the load of the tire does, noted in the
running account.

A road, a suspension and a landing show in the load of a tire; brakes, ABS and steering wheels take many steps. A
horizontal force that turns back every few steps while its load does not is none of these: it is what the steps or their
iterations leave. So the change of every force from step to step is followed, and the change of that, by means over
MEMORY steps to which a single event (a brake that grips, an edge of friction) contributes no more than CLIPPED times
the mean. An oscillation of N steps a period has |second difference| / |first| = 2 sin(pi / N): the second is larger
with fewer than six.
"""

from __future__ import annotations

from solver.compiled.kernel import kernel
from solver.elements.registry import FORCES
from solver.elements.tire_pacejka import TIRES
from solver.model.tables import COUNT, OUTPUT, WIDTH
from solver.output.account import TRACE

# steps of the means: two to five periods of what is looked for; ten times as many would miss a second of it
MEMORY = 16.0
CLIPPED = 4.0  # times the mean, most that one step adds to it; ten times as much would take an edge for chatter
LEAST = 1e-4  # of the load: mean changes of forces below it count as that much; ten times as much would be the limit
BY_LOAD = 2.0  # friction of a tire at most: by so much more than its load may its horizontal force change
KIND = FORCES.index(TIRES)
FX, FZ = TIRES.column('fx'), TIRES.column('fz')  # of the outputs: fx, fy, fz in a row
# of TRACE: mean load; fx, fy, fz; their changes; means of fx, fy; and of all three
LOAD, FORCE, CHANGE, FIRST, SECOND = 0, 1, 4, 7, 9
assert TRACE == SECOND + 3


@kernel(inline=True)
def _followed(mean, value, least):
    """The mean of a magnitude, with one more value."""
    return mean + (min(value, CLIPPED * max(mean, least)) - mean) / MEMORY


@kernel(inner=True)
def note_shake(tables, outputs, account):
    """Follow the forces of all tires, and note half the largest mean second difference of a horizontal force, beyond
    what that of the load allows, over the mean load. Of the first steps nothing is noted.
    """
    at, width = tables.forces[KIND, OUTPUT], tables.forces[KIND, WIDTH]
    first, early = account.steps[0] < 2.0, account.steps[0] < 2.0 * MEMORY
    for n in range(tables.forces[KIND, COUNT]):
        trace = account.trace[n]
        load = outputs[at + FZ]
        trace[LOAD] = load if first else trace[LOAD] + (load - trace[LOAD]) / MEMORY
        least = LEAST * trace[LOAD]
        worst = 0.0
        for i in (2, 0, 1):
            force = outputs[at + FX + i]
            change = force - trace[FORCE + i] if not first else 0.0
            second = abs(change - trace[CHANGE + i])
            trace[FORCE + i], trace[CHANGE + i] = force, change
            trace[SECOND + i] = _followed(trace[SECOND + i], second, least)
            if i < 2:
                trace[FIRST + i] = _followed(trace[FIRST + i], abs(change), least)
                if trace[SECOND + i] > trace[FIRST + i]:
                    worst = max(worst, trace[SECOND + i])
        excess = worst - BY_LOAD * trace[SECOND + 2]
        if not early and excess > 2.0 * account.shake[0] * trace[LOAD]:
            account.shake[0], account.shake[1], account.shake[2] = 0.5 * excess / trace[LOAD], account.time[0], n
        at += width
