"""The intrinsics of solver.linear.blocks for lanes: the same sums in the same order, for all lanes at once.

There a row of a block is a vector; here every number is one, so what was added across a vector (`_sums`) is written out
in the order of that tree, and zeros that the padding of a row added are added here too: they decide about the sign of a
zero.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import cgutils, types

from solver.compiled.lanes import LANES
from solver.compiled.lanes.agreement import spread
from solver.compiled.lanes.number import ALIGN, LANE, VECTOR, WORD

ZERO, ONE = (ir.Constant(VECTOR, [x] * LANES) for x in (0.0, 1.0))
OPERATIONS: dict[str, Callable[..., Any]] = {}


class Emit:
    """Emits code for one call: arrays of lanes by places in the arguments."""

    def __init__(self, context, builder, signature, args) -> None:
        self.context, self.builder, self.kinds, self.args = context, builder, signature.args, args

    def block(self, array: int, slot: int | Any, size: int):
        """Pointer to the numbers of block `slot` (place of an argument, or a value) of so many numbers."""
        value = cgutils.create_struct_proxy(self.kinds[array])(self.context, self.builder, self.args[array])
        first = self.builder.inttoptr(value.data, ir.PointerType(VECTOR))
        slot = self.args[slot] if isinstance(slot, int) else slot
        return self.builder.gep(first, [self.builder.mul(slot, ir.Constant(WORD, size))])

    def load(self, pointer, k):
        return self.builder.load(self._at(pointer, k), align=ALIGN)

    def store(self, value, pointer, k) -> None:
        self.builder.store(value, self._at(pointer, k), align=ALIGN)

    def _at(self, pointer, k):
        return self.builder.gep(pointer, [ir.Constant(WORD, k) if isinstance(k, int) else k])

    def call(self, name: str, *values):
        kind = ir.FunctionType(VECTOR, [VECTOR] * len(values))
        return self.builder.call(
            cgutils.get_or_insert_function(self.builder.module, kind, f'llvm.{name}.v{LANES}f64'), values
        )

    def fma(self, a, b, c):
        return self.call('fma', a, b, c)

    def number(self, place: int):
        """A number among the arguments, as lanes."""
        value = self.args[place]
        return value if self.kinds[place] == LANE else spread(self.builder, value)

    def six(self, products):
        """Sum of six numbers and of two zeros, in the order of solver.linear.blocks._sums."""
        add = self.builder.fadd
        p = products
        return add(add(add(p[0], p[1]), add(p[2], p[3])), add(add(p[4], p[5]), ZERO))


def _operation(result=types.none):
    """Register what emits an operation; numbers are taken as float64 or as lanes, as they come."""

    def register(function):
        def operation(*arguments):
            kinds = [LANE if a == LANE else types.unliteral(a) for a in arguments]
            kinds = [types.int64 if isinstance(k, types.Integer) else k for k in kinds]

            def codegen(context, builder, signature, args):
                found = function(Emit(context, builder, signature, args))
                return context.get_dummy_value() if found is None else found

            return result(*kinds), codegen

        OPERATIONS[function.__name__] = operation
        return function

    return register


WIDTH = 8  # numbers of a row of a block, the last two zero (solver.linear.blocks)


def _product(e: Emit, sign: int) -> None:
    """B[c] -= B[a] B[d], or B[c] = B[a] B[d], where c may be a: row by row."""
    size = 6 * WIDTH
    target, left, right = (e.block(0, k, size) for k in (1, 2, 3))
    with cgutils.for_range(e.builder, ir.Constant(WORD, 6), intp=WORD) as loop:
        row = e.builder.mul(loop.index, ir.Constant(WORD, WIDTH))
        t, p = e.builder.gep(target, [row]), e.builder.gep(left, [row])
        factors = [e.load(p, k) for k in range(6)]
        if sign < 0:
            factors = [e.builder.fneg(f) for f in factors]
        for j in range(6):
            total = e.load(t, j) if sign < 0 else None
            for k in range(6):
                other = e.load(right, WIDTH * k + j)
                total = e.builder.fmul(factors[k], other) if total is None else e.fma(factors[k], other, total)
            e.store(total, t, j)


@_operation()
def subtract_product(e: Emit) -> None:
    _product(e, -1)


@_operation()
def multiply(e: Emit) -> None:
    _product(e, 1)


def _substitution(e: Emit, with_diagonal: bool) -> None:
    """x[p] -= sum over a in first..last of B[slot[a]] x[node[a]], then x[p] = B[d] x[p]."""
    _, _, _, first, last, _, _, _ = e.args
    # every number of B times one of x is a sum of its own, as a lane of a vector is there
    sums = [cgutils.alloca_once_value(e.builder, ZERO) for _ in range(36)]
    for one in sums:
        e.builder.store(ZERO, one)

    def entry(place, at):
        data = e.context.make_array(e.kinds[place])(e.context, e.builder, e.args[place]).data
        return e.builder.load(e.builder.gep(data, [at]))

    with cgutils.for_range_slice(e.builder, first, last, ir.Constant(WORD, 1), WORD) as (a, _):
        block, y = e.block(0, entry(1, a), 6 * WIDTH), e.block(5, entry(2, a), WIDTH)
        numbers = [e.load(y, j) for j in range(6)]
        for i in range(6):
            for j in range(6):
                one = sums[6 * i + j]
                e.builder.store(e.fma(e.load(block, WIDTH * i + j), numbers[j], e.builder.load(one)), one)
    target = e.block(5, 6, WIDTH)
    found = [
        e.builder.fsub(e.load(target, i), e.six([e.builder.load(sums[6 * i + j]) for j in range(6)])) for i in range(6)
    ]
    if with_diagonal:
        block = e.block(0, 7, 6 * WIDTH)
        found = [e.six([e.builder.fmul(e.load(block, WIDTH * i + j), found[j]) for j in range(6)]) for i in range(6)]
    for i in range(6):
        e.store(found[i], target, i)


@_operation()
def forward(e: Emit) -> None:
    _substitution(e, False)


@_operation()
def backward(e: Emit) -> None:
    _substitution(e, True)


@_operation()
def add_weighted_product(e: Emit) -> None:
    """B[s] += sum over the six rows r of W[first + r] X[a, r]^T Y[b, r]."""
    target, left, right, weights = e.block(0, 1, 48), e.block(2, 3, 36), e.block(4, 5, 48), e.block(6, 7, 1)
    with cgutils.for_range(e.builder, ir.Constant(WORD, 6), intp=WORD) as loop:
        row = e.builder.mul(loop.index, ir.Constant(WORD, WIDTH))
        t, x = e.builder.gep(target, [row]), e.builder.gep(left, [loop.index])
        sums = [e.load(t, j) for j in range(6)]
        for r in range(6):
            factor, weight = e.load(x, 6 * r), e.load(weights, r)
            for j in range(6):
                sums[j] = e.fma(factor, e.builder.fmul(weight, e.load(right, WIDTH * r + j)), sums[j])
        for j in range(6):
            e.store(sums[j], t, j)


def _rotated(e: Emit, with_damping: bool) -> None:
    """C[s] = q X[t] with angular columns turned by T[n], + v Y[t]."""
    target, source, turn = e.block(0, 1, 48), e.block(2, 3, 36), e.block(4, 5, 9)
    q, v, damping = e.number(6), e.number(8), e.block(7, 3, 36)
    T = [e.load(turn, k) for k in range(9)]
    with cgutils.for_range(e.builder, ir.Constant(WORD, 6), intp=WORD) as loop:
        out = e.builder.gep(target, [e.builder.mul(loop.index, ir.Constant(WORD, WIDTH))])
        x = e.builder.gep(source, [e.builder.mul(loop.index, ir.Constant(WORD, 6))])
        y = e.builder.gep(damping, [e.builder.mul(loop.index, ir.Constant(WORD, 6))])
        given = [e.load(x, k) for k in range(6)]
        for c in range(6):
            total = given[c] if c < 3 else ZERO
            for j in range(3):
                total = e.fma(given[3 + j], T[3 * j + c - 3] if c >= 3 else ZERO, total)
            total = e.builder.fmul(q, total)
            if with_damping:
                total = e.fma(v, e.load(y, c), total)
            e.store(total, out, c)
        for c in (6, 7):
            e.store(ZERO, out, c)


@_operation()
def rotated_block(e: Emit) -> None:
    _rotated(e, False)


@_operation()
def combined_block(e: Emit) -> None:
    _rotated(e, True)


@_operation()
def add_scaled_rows(e: Emit) -> None:
    """f[b] += sign * sum over r below count of weights[first + r] J[e, r]."""
    target, weights, rows = e.block(0, 1, 6), e.block(3, 4, 1), e.block(6, 7, 36)
    sign, count = e.number(2), e.args[5]
    sums = [cgutils.alloca_once_value(e.builder, ZERO) for _ in range(6)]
    for j in range(6):
        e.builder.store(e.load(target, j), sums[j])
    with cgutils.for_range(e.builder, count, intp=WORD) as loop:
        factor = e.builder.fmul(sign, e.load(weights, loop.index))
        row = e.builder.gep(rows, [e.builder.mul(loop.index, ir.Constant(WORD, 6))])
        for j in range(6):
            e.builder.store(e.fma(factor, e.load(row, j), e.builder.load(sums[j])), sums[j])
    for j in range(6):
        e.store(e.builder.load(sums[j]), target, j)


@_operation()
def subtract_weighted_rows(e: Emit) -> None:
    """x[b] -= sum over the six rows r of t[first + r] J[e, r]."""
    target, rows, weights = e.block(0, 1, WIDTH), e.block(2, 3, 36), e.block(4, 5, 1)
    sums = [e.load(target, j) for j in range(6)]
    for r in range(6):
        weight = e.builder.fneg(e.load(weights, r))
        for j in range(6):
            sums[j] = e.fma(weight, e.load(rows, 6 * r + j), sums[j])
    for j in range(6):
        e.store(sums[j], target, j)


@_operation()
def add_row_products(e: Emit) -> None:
    """t[first + r] += J[e, r] . x[b] for six rows r."""
    target, rows, vector = e.block(0, 1, 1), e.block(2, 3, 48), e.block(4, 5, WIDTH)
    x = [e.load(vector, j) for j in range(6)]
    for r in range(8):
        product = e.six([e.builder.fmul(e.load(rows, WIDTH * r + j), x[j]) for j in range(6)]) if r < 6 else ZERO
        e.store(e.builder.fadd(e.load(target, r), product), target, r)


@_operation(LANE)
def invert(e: Emit):
    """B[s] = its inverse, by Gauss-Jordan elimination; returns the smallest |pivot / diagonal|."""
    block = e.block(0, 1, 48)
    m = [[e.load(block, WIDTH * i + j) for j in range(6)] for i in range(6)]
    diagonal, worst = [m[k][k] for k in range(6)], ONE
    for k in range(6):
        pivot = m[k][k]
        ratio = e.call('fabs', e.builder.fdiv(pivot, diagonal[k]))
        worst = e.builder.select(e.builder.fcmp_unordered('<', ratio, worst), ratio, worst)
        inverse = e.builder.fdiv(ONE, pivot)
        m[k] = [e.builder.fmul(ONE if j == k else m[k][j], inverse) for j in range(6)]
        for i in range(6):
            if i != k:
                factor = e.builder.fneg(m[i][k])
                m[i] = [e.fma(factor, m[k][j], ZERO if j == k else m[i][j]) for j in range(6)]
    for i in range(6):
        for j in range(6):
            e.store(m[i][j], block, WIDTH * i + j)
    return worst
