"""Groups of up to LANES engines that step together: the contract of a group, and the loop that all groups have in
common.

A group is a faster way to advance engines, and owns nothing: behind every advance() the state, the account and the
outputs of each are in its own arrays, as if it had stepped alone. Steps are taken in blocks. A lane that left (it asked
for another branch than most, or its numbers are no longer finite) is put back to the beginning of that step, and its
engine takes the rest of the block alone; it may divide that step, or fail, without the others. At the next block it
returns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.lanes import LANES
from solver.compiled.lanes.agreement import Flags
from solver.compiled.lanes.arrays import LaneArray
from solver.compiled.lanes.transfer import Transfer, put_in, take_out
from solver.engine import Moved
from solver.output.seen import Seen
from solver.output.snapshot import NO_STEPS, Counters

# Steps of a block, at most and at least. It is halved where a lane left, since that is alone until the next one, and
# doubled where none did. Ten times as many take ten times the memory for inputs; with a tenth, copies between lanes and
# engines take as long as steps.
BLOCK, SHORTEST = 256, 32
# Lanes that go on together, at least, and steps that all take alone where fewer did: so many blocks at first, twice as
# many after each further attempt. A step of all lanes takes as long as three or four steps alone, whatever they hold.
# With ten times as many blocks cars that corner once stay alone for seconds; with none, each block begins in vain.
TOGETHER, PAUSE, LONGEST = 4, BLOCK, 8 * BLOCK


class Group(Protocol):
    """Engines in lanes. Made of the engines, which are those of one class; raises SpecError where they do not fit
    together.
    """

    engines: Sequence[Any]
    lasts: Sequence[np.ndarray]  # (nu,) of each: the inputs of its last step
    flags: Flags
    block: int  # steps of the next block
    rest: int  # steps that all take alone before it
    pause: int  # steps of the last such rest; 0 where the last block was one of lanes
    inputs: LaneArray  # (BLOCK, nu) of the next steps
    state: Transfer  # everything that a step changes and the future depends on
    shows: int  # evaluations that the outputs of a call count as
    sees: bool  # it fills rows of what is shown

    def load(self) -> None:
        """Load or compile all kernels, by no step."""

    def ready(self, lane: int) -> bool:
        """True where the next step of this lane's engine is like those of the others."""

    def prepare(self, lane: int) -> None:
        """Bring the state of this lane's engine to where it is copied from."""

    def run(self, count: int, audit: bool, final: bool, left: np.ndarray, rows: Rows) -> None:
        """Advance all lanes `count` steps with the rows of `inputs`, or until none is left; left (LANES,)
        becomes the step at which a lane left, and stays -1 of those that did not."""

    def finish(self, lane: int) -> None:
        """Behind the last step in lanes: show what it led to in this lane's engine."""

    def stepped(self, lane: int, steps: int) -> Counters:
        """Behind so many steps in lanes, when their state was copied to this lane's engine: what else they change
        there. Counters of these steps."""


class Rows(NamedTuple):
    """Rows that a block fills (solver.output.seen), behind each step that `every` divides; every = 0: none. first: step
    of the grid that the block begins with. table (LANES, 2): addresses of the numbers shown by each, and of its first
    row."""

    every: int
    first: int
    size: int  # numbers of a row
    table: np.ndarray


NO_ROWS = Rows(0, 0, 0, np.zeros((LANES, 2), np.int64))


@kernel(inner=True)
def disband(flags):
    """Lanes leave behind others where fewer than TOGETHER are still there."""
    there = 0
    for lane in range(LANES):
        there += (flags[0] >> lane) & 1
    if there < TOGETHER:
        flags[1] = flags[1] | flags[0]
        flags[0] = 0


@kernel(borrow=True)
def leave(table, flags, step, left):
    """Note that lanes left in this step, and copy their state at its beginning to their simulations; whether any lane
    is still there."""
    for lane in range(left.shape[0]):
        if (flags[1] >> lane) & 1 and left[lane] < 0:
            left[lane] = step
            take_out(table, lane, True)
    flags[1] = 0
    return flags[0] != 0


def advance_group(
    group: Group,
    ks: Sequence[int],
    inputs: Mapping[int, np.ndarray],
    n: int,
    audit: bool,
    seen: Mapping[int, Seen] | None = None,
) -> dict[int, Moved]:
    """n steps of the engines in these lanes of a group, from step ks[lane] on, with a row of inputs[lane] each; a
    single row holds for all. seen: takes rows of each, of the same `every`, and is empty. Results as of
    Engine.advance() of each."""
    engines, size = group.engines, len(group.engines)
    moved: dict[int, Moved] = {}  # of those that ended
    for lane, given in inputs.items():
        if not np.isfinite(given).all():  # refused before anything is advanced
            moved[lane] = engines[lane].advance(ks[lane], given, n, audit, group.lasts[lane])
        else:
            engines[lane].shown.current()
    done, total = [0] * size, [NO_STEPS] * size
    shown = {lane: engines[lane].shown.numbers.copy() for lane in inputs}
    left = np.empty(LANES, np.int64)
    rows = group.inputs.numbers
    there: set[int] = set()  # lanes that hold the state of their engine
    first, count = 0, 0
    every = next(iter(seen.values())).every if seen else 0
    while (first := first + count) < n:
        count = min(group.rest or group.block, n - first)
        final = first + count == n
        going = [lane for lane in inputs if lane not in moved]
        if not going:
            break
        together = [] if group.rest else [lane for lane in going if group.ready(lane)]
        if every and together:  # whose turns are those of the first one
            together = [lane for lane in together if (ks[lane] - ks[together[0]]) % every == 0]
        left[:] = 0
        if together:
            for lane in range(LANES):
                source = lane if lane in together else together[0]
                if lane not in there:
                    group.prepare(source)
                    put_in(group.state.table, lane, source)
                rows[:count, :, lane] = _rows(inputs[source], first, count)
            group.flags.words[:] = sum(1 << lane for lane in together), 0
            group.flags.bind()
            left[together] = -1
            group.run(count, audit, final, left, _to_fill(engines, ks[together[0]] + first, every, together, seen))
        there.clear()
        stayed_on = int((left[going] < 0).sum())
        group.block = min(BLOCK, 2 * group.block) if stayed_on == len(going) else max(SHORTEST, group.block // 2)
        if group.rest:
            group.rest -= count
        elif stayed_on >= TOGETHER:
            group.pause = 0
        else:
            group.rest = group.pause = min(LONGEST, max(PAUSE, 2 * group.pause))
        for lane in going:
            stayed = count if left[lane] < 0 else int(left[lane])
            if stayed == count:
                take_out(group.state.table, lane, False)
                there.add(lane)
            if seen and stayed:
                k = ks[lane] + done[lane]
                seen[lane].took(k, (k + stayed) // every - k // every)
            if stayed:
                done[lane] += stayed
                total[lane] = total[lane].followed_by(group.stepped(lane, stayed))
            if stayed == count:
                if final:
                    group.finish(lane)
                continue
            rest = np.ascontiguousarray(_rows(inputs[lane], first + stayed, count - stayed))
            own = seen[lane] if seen else None
            part = engines[lane].advance(ks[lane] + done[lane], rest, count - stayed, audit, group.lasts[lane], own)
            done[lane] += part.steps
            counters = part.counters
            looked = audit or final or (every and (ks[lane] + done[lane]) % every == 0)
            if part.steps and not (looked or part.failure):  # outputs that nobody sees
                counters = counters._replace(evaluations=counters.evaluations - group.shows)
            total[lane] = total[lane].followed_by(counters)
            if part.failure or part.steps < count - stayed:  # failed, or somebody asks for an end
                moved[lane] = Moved(done[lane], total[lane], part.failure)
            if part.failure:
                engines[lane].shown.numbers[:] = own.numbers[-1] if own and len(own.steps) else shown[lane]
    return {lane: moved.get(lane) or Moved(done[lane], total[lane]) for lane in inputs}


def _to_fill(engines: Sequence[Any], k: int, every: int, lanes: Sequence[int], seen: Mapping[int, Seen] | None) -> Rows:
    """Rows of a block from step k on."""
    table = np.zeros((LANES, 2), np.int64)
    for lane in lanes if seen else ():
        table[lane] = engines[lane].shown.numbers.ctypes.data, seen[lane].free.ctypes.data  # type: ignore[index]
    return Rows(every, k, len(engines[0].shown.numbers), table)


def _rows(inputs: np.ndarray, first: int, count: int) -> np.ndarray:
    """The rows of so many steps; a single one that holds for all."""
    return inputs if len(inputs) == 1 else inputs[first : first + count]
