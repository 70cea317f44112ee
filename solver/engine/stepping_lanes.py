"""Bodies in lanes (solver.engine.lanes): steps of the augmented Lagrangian with a constant step.

The account of energy and what is shown are taken by the kernels of a single run, of one simulation after the other:
they note what is largest so far, which happens at other steps in each.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

import solver.compiled.lanes.dual
import solver.compiled.lanes.functions
import solver.compiled.lanes.rows  # noqa: F401  (what kernels call of lanes)
from solver.compiled.by_reference import Ref
from solver.compiled.kernel import address_of, invoke, kernel
from solver.compiled.lanes import LANES
from solver.compiled.lanes.agreement import Flags
from solver.compiled.lanes.arrays import LaneArray, LaneArrayType, lane_zeros
from solver.compiled.lanes.mirror import Mirror
from solver.compiled.lanes.transfer import Transfer, keep, put_in, take_out, take_out_all, take_rows
from solver.compiled.memory import zeros
from solver.elements.instant import Effects, Instant
from solver.elements.registry import CONSTRAINTS, FORCES
from solver.engine.lanes import BLOCK, NO_ROWS, Rows, disband, leave
from solver.engine.stepping import Stepping
from solver.linear.elimination import factorize, solve
from solver.model.state import State, copy_state
from solver.model.tables import (
    ADDRESS,
    CONSTRAINT_TABLE,
    FACTORIZE,
    HESSIANS,
    RESIDUALS,
    SOLVE,
    TABLE,
    Tables,
)
from solver.output.collect import collect
from solver.output.snapshot import Counters
from solver.step.augmented_lagrangian import keep_account, perform
from solver.step.control import WANTED
from solver.step.interval import EASY_ITERATIONS, note_steps
from solver.step.work import OK, Scheme, Work, last_result

SCALARS = ('h', 'am', 'af', 'beta', 'gamma', 'am1', 'gamma1', 'ahead', 'tolerance')  # of a Scheme
# of a Work: what the account and the outputs of a step are made of
LOOKED_AT = (
    *('kin_end.R', 'kin_end.p', 'kin_end.v', 'a_out', 'lam_out', 'phi_end', 'J_end', 'phi_t', 'rate', 'outputs'),
    *('u_before', 'result'),
)
SHOWN = (*LOOKED_AT, 'v_out', 'J_stage', 'phi_tt', 'f', 'z_stage', 'saddle.W')  # and what else is shown of a last step


class Cars(NamedTuple):
    """All that bodies step with."""

    tables: Tables
    scheme: Scheme
    s0: State
    s1: State
    work: Work
    offset: np.ndarray  # (nb + 1, 6) History.offset
    z_rate: np.ndarray  # (nz,) History.z_rate
    sums: np.ndarray  # (7,) Counters of a block
    now: np.ndarray  # (nu,) inputs of the step


class _Box(NamedTuple):
    """The inputs of a block, (BLOCK, nu)."""

    inputs: LaneArray


class _Copies(NamedTuple):
    """Tables of transfers (solver.compiled.lanes.transfer)."""

    kept: np.ndarray  # what a step changes beside the states
    even: np.ndarray  # the state behind an even number of steps, to the place of the first state
    odd: np.ndarray  # the state behind an odd number of steps, to that same place
    second: np.ndarray  # that state to a place of its own
    looked: np.ndarray  # what is looked at
    shown: np.ndarray  # all that is shown


@kernel(inner=True)
def _look(car, h, ahead, old, new, known, audit, shown):
    """Keep the account of one simulation, and show the step of h [s] from the state old to new."""
    w = car.work
    w.augmentation.known[0] = known
    if audit:
        keep_account(car.tables, car.scheme, h, 1, ahead, old, new, car.now, last_result(w).counters, w)
    else:
        w.marks[-1] = 0.0
    if shown:
        frame = w.outputs, w.account, w.arrays
        collect(car.tables, w.chassis, w.kin_end, w.a_out, w.lam_out, w.marks, car.now, new, *frame)


@kernel(borrow=True)
def _run(cars, each, box, step, count, audit, final, copies, every, first, size, rows, flags, left, easy):
    """Advance lanes of bodies `count` steps, or until none is left (solver.engine.lanes.Group.run). each: those of the
    single simulations. every, first, size, rows: solver.engine.lanes.Rows."""
    old, new = cars.s0, cars.s1
    work, sums, taken = cars.work, cars.sums, 0
    for i in range(sums.shape[0]):
        sums[i] = 0.0
    for k in range(count):
        keep(copies.kept)
        u = box.inputs[k]
        last = final and k == count - 1
        turn = every > 0 and (first + k + 1) % every == 0
        invoke(step, (cars.tables, cars.scheme, old, new, u, np.bool_(audit or turn or last), work))
        r = work.result
        if int(r[0]) == OK:
            for i in range(4):
                sums[i] += r[2 + i]
            for i in range(4, 7):
                sums[i] = max(sums[i], r[2 + i])
            easy[k] = 1 if int(r[5]) == 0 and int(r[2]) <= EASY_ITERATIONS else 0
            for b in range(new.v.shape[0]):
                for i in range(6):
                    cars.offset[b, i] = new.v[b, i] - work.v_out[b, i]
            for i in range(new.zd.shape[0]):
                cars.z_rate[i] = (new.zd[i] - old.zd[i]) / cars.scheme.h
        else:
            flags[1] = flags[1] | flags[0]
            flags[0] = 0
        if flags[1] != 0:
            disband(flags)
            for lane in range(left.shape[0]):
                if (flags[1] >> lane) & 1 and left[lane] < 0:
                    take_out(copies.even if k % 2 == 0 else copies.odd, lane, False)
            if not leave(copies.kept, flags, k, left):
                return
        for i in range(u.shape[0]):
            cars.now[i] = u[i]
        if audit or turn or last:
            take_out_all(copies.shown if last else copies.looked, flags[0])
            take_out_all(copies.second if k % 2 == 0 else copies.even, flags[0])
            for lane in range(left.shape[0]):
                if (flags[0] >> lane) & 1:
                    car = each[lane]
                    before, behind = (car.s0, car.s1) if k % 2 == 0 else (car.s1, car.s0)
                    known, shown = work.augmentation.known[0], turn or last
                    _look(car, car.scheme.h, car.scheme.ahead, before, behind, known, audit, shown)
            if turn:
                take_rows(rows, size, taken, flags[0])
                taken += 1
        for i in range(u.shape[0]):
            work.u_before[i] = u[i]
        old, new = new, old


class BodyGroup:
    """See solver.engine.lanes.Group."""

    shows, sees = 1, True

    def __init__(self, engines: Sequence[Stepping], lasts: Sequence[np.ndarray]) -> None:
        self.engines, self.lasts, self.flags, self.block = engines, lasts, Flags(), BLOCK
        self.rest = self.pause = 0
        self._sums = [np.zeros(7) for _ in engines]
        self._first = [engine.shown.states[0] for engine in engines]
        cars = [self._cars(engine, k) for k, engine in enumerate(engines)]
        mirror = Mirror(
            cars,
            [f'scheme.{name}' for name in SCALARS],
            ('tables.forces', 'tables.constraint_kinds', 'tables.linear', 'work'),
        )
        self._kept = [self._bind(mirror.value)]  # what the addresses are of
        tables, self._easy = self._kept[0][-1], np.zeros(BLOCK, np.int64)
        self._cars_of_all = Ref(mirror.value._replace(tables=tables))
        state = lambda s: mirror.pairs([f'{s}.{name}' for name in State._fields])  # noqa: E731
        own = [[getattr(first.value, name) for first in self._padded(self._first)] for name in State._fields]
        even, odd = state('s0'), [(lanes, o) for (lanes, _), o in zip(state('s1'), own, strict=True)]
        rest = mirror.pairs(('work.u_before', 'offset', 'z_rate', 'sums'))
        self.state = Transfer([*even, *rest])
        of_work = lambda names: mirror.pairs(['now', *(f'work.{name}' for name in names)])  # noqa: E731
        copies = (rest, even, odd, state('s1'), of_work(LOOKED_AT), of_work(SHOWN))
        self._transfers = [Transfer(pairs) for pairs in copies]  # which the addresses are of
        self._copies = _Copies(*(transfer.table for transfer in self._transfers))
        self._each = tuple(Ref(car) for car in self._padded(cars))
        self._back = [(mirror.pairs([f's1.{n}'])[0][0].numbers, mirror.pairs([f's0.{n}'])[0][0].numbers)
                      for n in State._fields]  # fmt: skip
        self.inputs = LaneArray(zeros((BLOCK, len(lasts[0]), LANES)))
        self._box = Ref(_Box(self.inputs))
        of_all = self._cars_of_all.value
        row = LaneArray(zeros((len(lasts[0]), LANES)))
        self._refs = tuple(Ref(part) for part in (of_all.tables, of_all.scheme, of_all.s0, of_all.s1, of_all.work))
        t, c, s0, s1, w = self._refs
        self._step = address_of(perform, t, c, s0, s1, row, True, w)

    def _padded(self, values: list) -> list:
        return [*values, *[values[0]] * (LANES - len(values))]

    def _cars(self, engine: Stepping, k: int) -> Cars:
        bodies, a = engine.shown, engine.adaptation
        history = a.values.history if a is not None else None
        nb, nz = bodies.model.n_bodies, bodies.model.n_internal
        return Cars(
            bodies.model.tables.value, bodies.scheme.value, bodies.states[0].value, bodies.states[1].value,
            bodies.work.value, history.offset if history else np.zeros((nb + 1, 6)),
            history.z_rate if history else np.zeros(nz), self._sums[k], np.zeros(len(self.lasts[k])),
        )  # fmt: skip

    def _bind(self, cars: Cars) -> tuple:
        """(what is to be kept alive, ..., the tables with the kernels of lanes)."""
        first = self.engines[0].shown.model
        t = cars.tables
        kin, x, laws = Ref(cars.work.kin_end), Ref(t.coordinates), Ref(t.laws)
        row: Any
        rows: Any
        blocks: Any
        row, rows, blocks = lane_zeros(1), lane_zeros((1, 6)), lane_zeros((1, 6, 6))
        matrix = lane_zeros((1, 1))
        matrix.kind = LaneArrayType(2, (None,))
        now, effects = Instant(x, laws, kin, row, row, 0.0, row, True), Effects(rows, blocks, blocks, row)
        forces, kinds, linear, kept = t.forces.copy(), t.constraint_kinds.copy(), t.linear.copy(), []

        def table(name: str) -> Ref:
            found = Ref(Mirror([e.shown.model.elements[name].value for e in self.engines]).value)
            kept.append(found)
            return found

        for kind, call in zip(FORCES, forces, strict=True):
            if getattr(first.spec, kind.name):
                own = table(kind.name)
                call[ADDRESS], call[TABLE] = address_of(kind.kernel, own, now, effects, matrix), own.pointer
        for one, call in zip(CONSTRAINTS, kinds, strict=True):
            if getattr(first.spec, one.name):
                own = table(one.name)
                on = one.on_coordinates
                residuals = (own, x, kin, row, row, True, row, blocks) if on else (own, kin, True, row, blocks)
                call[RESIDUALS], call[CONSTRAINT_TABLE] = address_of(one.residuals, *residuals), own.pointer
                call[HESSIANS] = address_of(one.hessians, own, *((x,) if on else ()), kin, row, blocks, blocks)
        B, T = lane_zeros((1, 6, 8)), lane_zeros((1, 8))
        plan = Ref(t.condensed)
        linear[FACTORIZE], linear[SOLVE] = address_of(factorize, plan, B, T), address_of(solve, plan, B, T)
        return (*kept, t._replace(forces=forces, constraint_kinds=kinds, linear=linear))

    def load(self) -> None:
        """See Group.load()."""
        put_in(self.state.table, 0, 0)
        take_out(self.state.table, 0, False)
        self.run(0, True, False, np.zeros(LANES, np.int64), NO_ROWS)
        for engine in self.engines[:1]:
            if engine.adaptation is not None:
                note_steps(engine.shown.scheme, engine.adaptation.control, self._easy, 0)

    def ready(self, lane: int) -> bool:
        """True where the next step of this lane's engine is one of the grid."""
        a = self.engines[lane].adaptation
        if a is None:
            return True
        c = a.values
        return bool(c.memory[WANTED] >= c.grid and c.history.size[0] == c.grid and c.progress[0] == 0.0)

    def prepare(self, lane: int) -> None:
        """Bring the state of this lane's engine to where lanes take it from."""
        states = self.engines[lane].shown.states
        if states[0] is not self._first[lane]:
            copy_state(states[0].value, self._first[lane].value)
            states.reverse()

    def run(self, count: int, audit: bool, final: bool, left: np.ndarray, rows: Rows) -> None:
        """See Group.run()."""
        _run(
            self._cars_of_all, self._each, self._box, self._step, count, audit, final, self._copies, *rows,
            self.flags.words, left, self._easy,
        )  # fmt: skip
        if count % 2:
            for source, target in self._back:
                target[...] = source

    def finish(self, lane: int) -> None:
        """See Group.finish()."""
        self.engines[lane].shown.overtaken()

    def stepped(self, lane: int, steps: int) -> Counters:
        """See Group.stepped()."""
        e = self.engines[lane]
        self.lasts[lane][:] = e.shown.work.u_before
        if e.adaptation is not None:
            c = e.adaptation.values
            c.history.size[:] = c.grid, (1.0 - e.shown.scheme.af) * c.grid + e.shown.scheme.af * c.grid
            note_steps(e.shown.scheme, e.adaptation.control, self._easy, steps)
        return Counters.of(self._sums[lane])
