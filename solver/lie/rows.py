"""Rows of 6x6 blocks: six numbers that belong to one row, as one SIMD vector.

A 3x6 matrix is a tuple of three rows; products with 3x3 matrices (the 9-tuples of solver.lie.vec) and cross products act on whole
rows. Of float64 a row is a vector of eight lanes, the last two zero; of anything else (complex numbers of a complex-step
derivative, or without compilation) it is a tuple of six, with the same meaning.
"""

from __future__ import annotations

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic, models, overload, register_model

from solver.jit import kernel

LANES = 8
_VECTOR = ir.VectorType(ir.DoubleType(), LANES)
_SIX = ir.VectorType(ir.DoubleType(), 6)
_LANE = ir.IntType(32)


class RowType(types.Type):
    """Compiled type of a row of float64."""

    def __init__(self) -> None:
        super().__init__(name='Row')


ROW = RowType()


@register_model(RowType)
class _RowModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type) -> None:
        super().__init__(dmm, fe_type, _VECTOR)


def _splat(builder, scalar):
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    first = builder.insert_element(undefined, scalar, ir.Constant(_LANE, 0))
    return builder.shuffle_vector(first, undefined, ir.Constant(ir.VectorType(_LANE, LANES), [0] * LANES))


def _multiply_add(builder, factor, x, y):
    fma = cgutils.get_or_insert_function(builder.module, ir.FunctionType(_VECTOR, [_VECTOR] * 3), f'llvm.fma.v{LANES}f64')
    return builder.call(fma, [_splat(builder, factor), x, y])


@intrinsic
def _pack(typing_context, a, b, c, d, e, f):
    def generate(context, builder, signature, args):
        out = ir.Constant(_VECTOR, None)
        for k, number in enumerate(args):
            out = builder.insert_element(out, number, ir.Constant(_LANE, k))
        return out

    return ROW(*(types.float64,) * 6), generate


@intrinsic
def _combine2(typing_context, a, x, b, y):
    def generate(context, builder, signature, args):
        a_, x_, b_, y_ = args
        return _multiply_add(builder, b_, y_, builder.fmul(_splat(builder, a_), x_))

    return ROW(types.float64, ROW, types.float64, ROW), generate


@intrinsic
def _combine3(typing_context, a, x, b, y, c, z):
    def generate(context, builder, signature, args):
        a_, x_, b_, y_, c_, z_ = args
        return _multiply_add(builder, c_, z_, _multiply_add(builder, b_, y_, builder.fmul(_splat(builder, a_), x_)))

    return ROW(types.float64, ROW, types.float64, ROW, types.float64, ROW), generate


@intrinsic
def _sum(typing_context, x, y):
    return ROW(ROW, ROW), lambda context, builder, signature, args: builder.fadd(*args)


@intrinsic
def _accumulate(typing_context, blocks, s, r, sign, x):
    """blocks[s, r] += sign x for blocks (n, 6, 6)."""

    def generate(context, builder, signature, args):
        blocks_, s_, r_, sign_, x_ = args
        word = ir.IntType(64)
        offset = builder.add(builder.mul(s_, ir.Constant(word, 36)), builder.mul(r_, ir.Constant(word, 6)))
        data = context.make_array(signature.args[0])(context, builder, blocks_).data
        place = builder.bitcast(builder.gep(data, [offset]), ir.PointerType(_SIX))
        six = builder.shuffle_vector(x_, ir.Constant(_VECTOR, ir.Undefined), ir.Constant(ir.VectorType(_LANE, 6), list(range(6))))
        undefined = ir.Constant(_SIX, ir.Undefined)
        factor = builder.insert_element(undefined, sign_, ir.Constant(_LANE, 0))
        factor = builder.shuffle_vector(factor, undefined, ir.Constant(ir.VectorType(_LANE, 6), [0] * 6))
        fma = cgutils.get_or_insert_function(builder.module, ir.FunctionType(_SIX, [_SIX] * 3), 'llvm.fma.v6f64')
        builder.store(builder.call(fma, [factor, six, builder.load(place, align=8)]), place, align=8)
        return context.get_dummy_value()

    return types.none(blocks, types.int64, types.int64, types.float64, ROW), generate


def row(a, b):
    """The row of two 3-vectors, one after the other."""
    return (a[0], a[1], a[2], b[0], b[1], b[2])


def combine2(a, x, b, y):
    """a x + b y for numbers a, b and rows x, y."""
    return (a * x[0] + b * y[0], a * x[1] + b * y[1], a * x[2] + b * y[2], a * x[3] + b * y[3], a * x[4] + b * y[4], a * x[5] + b * y[5])


def combine3(a, x, b, y, c, z):
    """a x + b y + c z for numbers a, b, c and rows x, y, z."""
    return plus(combine2(a, x, b, y), combine2(c, z, 0.0, z))


def plus(x, y):
    """x + y for rows."""
    return combine2(1.0, x, 1.0, y)


def add_to(blocks, s, r, sign, x):
    """blocks[s, r] += sign x for blocks (n, 6, 6) and a row x."""
    for k in range(6):
        blocks[s, r, k] += sign * x[k]


@overload(row)
def _row(a, b):
    if a.dtype == types.float64:
        return lambda a, b: _pack(a[0], a[1], a[2], b[0], b[1], b[2])
    return row


@overload(combine2)
def _combine2_rows(a, x, b, y):
    return (lambda a, x, b, y: _combine2(a, x, b, y)) if x is ROW else combine2  # noqa: PLW0108


@overload(combine3)
def _combine3_rows(a, x, b, y, c, z):
    return (lambda a, x, b, y, c, z: _combine3(a, x, b, y, c, z)) if x is ROW else combine3  # noqa: PLW0108


@overload(plus)
def _plus_rows(x, y):
    return (lambda x, y: _sum(x, y)) if x is ROW else plus  # noqa: PLW0108


@overload(add_to)
def _add_row_to(blocks, s, r, sign, x):
    return (lambda blocks, s, r, sign, x: _accumulate(blocks, s, r, sign, x)) if x is ROW else add_to  # noqa: PLW0108


@kernel(inline=True)
def beside(m, n):
    """The rows [m, n] of two 3x3 matrices."""
    return row(m[0:3], n[0:3]), row(m[3:6], n[3:6]), row(m[6:9], n[6:9])


@kernel(inline=True)
def mul_rows(m, x):
    """m x for a 3x3 matrix and three rows."""
    return (
        combine3(m[0], x[0], m[1], x[1], m[2], x[2]),
        combine3(m[3], x[0], m[4], x[1], m[5], x[2]),
        combine3(m[6], x[0], m[7], x[1], m[8], x[2]),
    )


@kernel(inline=True)
def cross_rows(a, x):
    """skew(a) x for a vector and three rows."""
    return combine2(a[1], x[2], -a[2], x[1]), combine2(a[2], x[0], -a[0], x[2]), combine2(a[0], x[1], -a[1], x[0])


@kernel(inline=True)
def add_rows(x, y):
    """x + y for three rows each."""
    return plus(x[0], y[0]), plus(x[1], y[1]), plus(x[2], y[2])


@kernel(inline=True)
def put_rows(blocks, s, r, sign, x):
    """blocks[s, r : r + 3] += sign x for blocks (n, 6, 6) and three rows."""
    add_to(blocks, s, r, sign, x[0])
    add_to(blocks, s, r + 1, sign, x[1])
    add_to(blocks, s, r + 2, sign, x[2])
