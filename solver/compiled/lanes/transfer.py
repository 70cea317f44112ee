"""Copies between arrays of lanes and those of the single simulations, and within the former, listed once as
addresses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from solver.compiled.kernel import kernel
from solver.compiled.lanes import LANES
from solver.compiled.lanes.arrays import LaneArray
from solver.compiled.memory import zeros

ALONE = 3  # column of the address of the first simulation's array; before it: of lanes, of their copy, and the length
Pair = tuple[LaneArray, list[np.ndarray]]


class Transfer:
    """A list of arrays that are copied together. kept: their copies of lanes, which keep() makes."""

    def __init__(self, pairs: Sequence[Pair]) -> None:
        used = [(lanes, alone) for lanes, alone in pairs if alone[0].size]
        self._arrays = used, [zeros(lanes.numbers.shape) for lanes, _ in used]  # which the addresses are of
        rows = [
            [lanes.numbers.ctypes.data, copy.ctypes.data, alone[0].size, *(a.ctypes.data for a in alone)]
            for (lanes, alone), copy in zip(*self._arrays, strict=True)
        ]
        self.table = np.array(rows, np.int64).reshape(-1, ALONE + LANES)


@intrinsic
def _number(typingctx, address, k):
    """The float64 that is the k-th from an address on."""

    def codegen(context, builder, signature, args):
        first = builder.inttoptr(args[0], ir.PointerType(ir.DoubleType()))
        return builder.load(builder.gep(first, [args[1]]))

    return types.float64(types.int64, types.int64), codegen


@intrinsic
def _set_number(typingctx, address, k, number):
    def codegen(context, builder, signature, args):
        first = builder.inttoptr(args[0], ir.PointerType(ir.DoubleType()))
        builder.store(args[2], builder.gep(first, [args[1]]))
        return context.get_dummy_value()

    return types.none(types.int64, types.int64, types.float64), codegen


@kernel(borrow=True)
def keep(table):
    """Copy all lanes as they are now."""
    for row in range(table.shape[0]):
        for k in range(LANES * table[row, 2]):
            _set_number(table[row, 1], k, _number(table[row, 0], k))


@kernel(borrow=True)
def take_out(table, lane, kept):
    """Copy a lane to its simulation; as it was when keep() was called, where `kept`."""
    for row in range(table.shape[0]):
        source = table[row, 1 if kept else 0]
        for k in range(table[row, 2]):
            _set_number(table[row, ALONE + lane], k, _number(source, LANES * k + lane))


@kernel(borrow=True)
def put_in(table, lane, source):
    """Copy a simulation, that of lane `source`, to a lane."""
    for row in range(table.shape[0]):
        for k in range(table[row, 2]):
            _set_number(table[row, 0], LANES * k + lane, _number(table[row, ALONE + source], k))


@kernel(borrow=True)
def take_out_all(table, lanes):
    """Copy these lanes, bits of which lane 0 is the lowest, to their simulations. Numbers of all lanes lie side by
    side, so that they are read once."""
    for row in range(table.shape[0]):
        for k in range(table[row, 2]):
            for lane in range(LANES):
                if (lanes >> lane) & 1:
                    _set_number(table[row, ALONE + lane], k, _number(table[row, 0], LANES * k + lane))


@kernel(borrow=True)
def take_rows(table, size, at, lanes):
    """Copy the numbers that these simulations show to row `at` of their tables of rows. table (LANES, 2): addresses of
    the numbers and of the first row, each of so many float64."""
    for lane in range(LANES):
        if (lanes >> lane) & 1:
            for i in range(size):
                _set_number(table[lane, 1], at * size + i, _number(table[lane, 0], i))
