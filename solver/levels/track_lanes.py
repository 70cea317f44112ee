"""Single-track models in lanes (solver.engine.lanes)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

import solver.compiled.lanes.functions  # noqa: F401  (kernels call elementary functions of lanes)
from solver.compiled.by_reference import Ref
from solver.compiled.kernel import kernel
from solver.compiled.lanes import LANES
from solver.compiled.lanes.agreement import Flags
from solver.compiled.lanes.arrays import LaneArray
from solver.compiled.lanes.mirror import Mirror
from solver.compiled.lanes.transfer import Transfer, keep, put_in, take_out
from solver.compiled.memory import zeros
from solver.engine.lanes import BLOCK, NO_ROWS, Rows, disband, leave
from solver.levels.single_track_engine import SingleTrack
from solver.levels.track_step import advance_once, show_end
from solver.levels.track_tables import SingleTrackTables, SingleTrackWork
from solver.output.snapshot import Counters


class Tracks(NamedTuple):
    """All that a single-track model steps with."""

    tables: SingleTrackTables
    work: SingleTrackWork
    y: np.ndarray  # (SIZE,) state
    before: np.ndarray  # (nu,) inputs of the step before


class _Box(NamedTuple):
    """The inputs of a block, (BLOCK, nu)."""

    inputs: LaneArray


@kernel(borrow=True)
def _run(tracks, box, index, count, audit, final, h, parts, kept, flags, left):
    """Advance lanes of single-track models `count` steps, or until none is left (solver.engine.lanes.Group.run)."""
    for k in range(count):
        keep(kept)
        u = box.inputs[k]
        seen = audit or (final and k == count - 1)
        there = advance_once(tracks.tables, tracks.y, tracks.before, u, index, audit, seen, h, parts, tracks.work)
        if not there:
            flags[1] = flags[1] | flags[0]
            flags[0] = 0
        if flags[1] != 0:
            disband(flags)
            if not leave(kept, flags, k, left):
                break


class TrackGroup:
    """See solver.engine.lanes.Group."""

    shows, sees = 0, False

    def __init__(self, engines: Sequence[SingleTrack], lasts: Sequence[np.ndarray]) -> None:
        self.engines, self.lasts, self.flags, self.block = engines, lasts, Flags(), BLOCK
        self.rest = self.pause = 0
        self._mirror = Mirror(
            [Tracks(e.tables.value, e.scratch.value, e.y, u) for e, u in zip(engines, lasts, strict=True)]
        )
        state = ('y', 'before', 'work.account.numbers', 'work.reached', 'work.steered')
        self.state = Transfer(self._mirror.pairs(state))
        self._shown = Transfer(self._mirror.pairs(('work.rates', 'work.told')))
        self._tracks = Ref(self._mirror.value)
        self.inputs = LaneArray(zeros((BLOCK, len(lasts[0]), LANES)))
        self._box = Ref(_Box(self.inputs))

    def load(self) -> None:
        """See Group.load()."""
        put_in(self.state.table, 0, 0)
        take_out(self.state.table, 0, False)
        self.run(0, True, False, np.zeros(LANES, np.int64), NO_ROWS)

    def ready(self, lane: int) -> bool:
        """Always: all steps are like the others."""
        return True

    def prepare(self, lane: int) -> None:
        """Nothing to do: the state stays in its place."""

    def run(self, count: int, audit: bool, final: bool, left: np.ndarray, rows: Rows) -> None:
        """See Group.run()."""
        first = self.engines[0]
        _run(
            self._tracks, self._box, first.index, count, audit, final, first.h, first.parts, self.state.table,
            self.flags.words, left,
        )  # fmt: skip

    def finish(self, lane: int) -> None:
        """See Group.finish()."""
        take_out(self._shown.table, lane, False)
        e = self.engines[lane]
        show_end(e.tables, e.y, self.lasts[lane], e.index, e.scratch, e.frame)

    def stepped(self, lane: int, steps: int) -> Counters:
        """See Group.stepped()."""
        return self.engines[lane].counters_of(steps)
