"""3x3 matrices as three rows, each one SIMD vector: for the products that fill the 6x6 blocks of tangents.

A row holds three numbers. A row of float64 is a vector of four lanes, the last zero; a row of anything else (complex
numbers of a complex-step derivative, or without compilation) is a tuple of three, with the same meaning. Matrices that
multiply from the left are the 9-tuples of solver.compiled.vec.
"""

from __future__ import annotations

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic, models, overload, register_model

from solver.compiled.by_reference import FieldType
from solver.compiled.kernel import kernel

LANES = 4
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


def _lanes(numbers):
    return ir.Constant(ir.VectorType(_LANE, len(numbers)), numbers)


def _splat(builder, scalar):
    undefined = ir.Constant(_VECTOR, ir.Undefined)
    return builder.shuffle_vector(
        builder.insert_element(undefined, scalar, ir.Constant(_LANE, 0)), undefined, _lanes([0] * LANES)
    )


def _multiply_add(builder, factor, x, y):
    fma = cgutils.get_or_insert_function(
        builder.module, ir.FunctionType(_VECTOR, [_VECTOR] * 3), f'llvm.fma.v{LANES}f64'
    )
    return builder.call(fma, [_splat(builder, factor), x, y])


@intrinsic
def _pack(typing_context, a, b, c):
    def generate(context, builder, signature, args):
        out = ir.Constant(_VECTOR, None)
        for k, number in enumerate(args):
            out = builder.insert_element(out, number, ir.Constant(_LANE, k))
        return out

    return ROW(*(types.float64,) * 3), generate


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
def _difference(typing_context, x, y):
    return ROW(ROW, ROW), lambda context, builder, signature, args: builder.fsub(*args)


@intrinsic
def _scaled(typing_context, a, x):
    return ROW(types.float64, ROW), lambda context, builder, signature, args: builder.fmul(
        _splat(builder, args[0]), args[1]
    )


@intrinsic
def _plus_times(typing_context, x, a, y):
    return ROW(ROW, types.float64, ROW), lambda context, builder, signature, args: _multiply_add(
        builder, args[1], args[2], args[0]
    )


@intrinsic
def _unpack(typing_context, x):
    def generate(context, builder, signature, args):
        numbers = [builder.extract_element(args[0], ir.Constant(_LANE, k)) for k in range(3)]
        return context.make_tuple(builder, signature.return_type, numbers)

    return types.UniTuple(types.float64, 3)(ROW), generate


def _lane(k):
    """Intrinsic: the row of the numbers k of three rows."""

    @intrinsic
    def take(typing_context, x, y, z):
        def generate(context, builder, signature, args):
            out = ir.Constant(_VECTOR, None)
            for place, given in enumerate(args):
                number = builder.extract_element(given, ir.Constant(_LANE, k))
                out = builder.insert_element(out, number, ir.Constant(_LANE, place))
            return out

        return ROW(ROW, ROW, ROW), generate

    return take


_first, _second, _third = _lane(0), _lane(1), _lane(2)


def _accumulation(operation):
    """Intrinsic: blocks[s, r] += or -= (x, y) for blocks (n, 6, 6)."""

    @intrinsic
    def accumulate(typing_context, blocks, s, r, x, y):
        def generate(context, builder, signature, args):
            blocks_, s_, r_, x_, y_ = args
            word = ir.IntType(64)
            offset = builder.add(builder.mul(s_, ir.Constant(word, 36)), builder.mul(r_, ir.Constant(word, 6)))
            data = context.make_array(signature.args[0])(context, builder, blocks_).data
            place = builder.bitcast(builder.gep(data, [offset]), ir.PointerType(_SIX))
            six = builder.shuffle_vector(x_, y_, _lanes([0, 1, 2, 4, 5, 6]))
            builder.store(getattr(builder, operation)(builder.load(place, align=8), six), place, align=8)
            return context.get_dummy_value()

        return types.none(blocks, types.int64, types.int64, ROW, ROW), generate

    return accumulate


_accumulate = _accumulation('fadd')
_reduce = _accumulation('fsub')


def row(a, b, c):
    """The row (a, b, c)."""
    return (a, b, c)


def row_like(number, a, b, c):
    """The row (a, b, c) of real numbers, to be combined with such a number as the given one."""
    zero = 0.0 * number
    return (a + zero, b + zero, c + zero)


def combine2(a, x, b, y):
    """a x + b y for numbers a, b and rows x, y."""
    return (a * x[0] + b * y[0], a * x[1] + b * y[1], a * x[2] + b * y[2])


def combine3(a, x, b, y, c, z):
    """a x + b y + c z for numbers a, b, c and rows x, y, z."""
    return (a * x[0] + b * y[0] + c * z[0], a * x[1] + b * y[1] + c * z[1], a * x[2] + b * y[2] + c * z[2])


def plus(x, y):
    """x + y for rows."""
    return (x[0] + y[0], x[1] + y[1], x[2] + y[2])


def less(x, y):
    """x - y for rows."""
    return (x[0] - y[0], x[1] - y[1], x[2] - y[2])


def times(a, x):
    """a x for a number and a row."""
    return (a * x[0], a * x[1], a * x[2])


def plus_times(x, a, y):
    """x + a y for a number a and rows x, y."""
    return (x[0] + a * y[0], x[1] + a * y[1], x[2] + a * y[2])


def numbers(x):
    """The three numbers of a row."""
    return x


def first(x, y, z):
    """The row of the first numbers of three rows."""
    return (x[0], y[0], z[0])


def second(x, y, z):
    """The row of the second numbers of three rows."""
    return (x[1], y[1], z[1])


def third(x, y, z):
    """The row of the third numbers of three rows."""
    return (x[2], y[2], z[2])


def add_to(blocks, s, r, x, y):
    """blocks[s, r] += (x, y) for blocks (n, 6, 6) and rows x, y."""
    for k in range(3):
        blocks[s, r, k] += x[k]
        blocks[s, r, 3 + k] += y[k]


def take_from(blocks, s, r, x, y):
    """blocks[s, r] -= (x, y) for blocks (n, 6, 6) and rows x, y."""
    for k in range(3):
        blocks[s, r, k] -= x[k]
        blocks[s, r, 3 + k] -= y[k]


def _of_others(*kinds) -> bool:
    """True for numbers, and rows of them, whose products solver.compiled.lanes.rows emits."""
    return any(isinstance(kind[0] if isinstance(kind, types.BaseTuple) else kind, FieldType) for kind in kinds)


@overload(row)
def _row(a, b, c):
    if _of_others(a, b, c):
        return None
    return (lambda a, b, c: _pack(a, b, c)) if a is types.float64 else row  # noqa: PLW0108


@overload(row_like)
def _row_like(number, a, b, c):
    if _of_others(number):
        return None
    return (lambda number, a, b, c: _pack(a, b, c)) if number is types.float64 else row_like


@overload(combine2)
def _combine2_rows(a, x, b, y):
    if _of_others(x):
        return None
    return (lambda a, x, b, y: _combine2(a, x, b, y)) if x is ROW else combine2  # noqa: PLW0108


@overload(combine3)
def _combine3_rows(a, x, b, y, c, z):
    if _of_others(x):
        return None
    return (lambda a, x, b, y, c, z: _combine3(a, x, b, y, c, z)) if x is ROW else combine3  # noqa: PLW0108


@overload(plus)
def _plus_rows(x, y):
    return (lambda x, y: _sum(x, y)) if x is ROW else plus  # noqa: PLW0108


@overload(less)
def _less_rows(x, y):
    return (lambda x, y: _difference(x, y)) if x is ROW else less  # noqa: PLW0108


@overload(times)
def _times_row(a, x):
    return (lambda a, x: _scaled(a, x)) if x is ROW else times  # noqa: PLW0108


@overload(plus_times)
def _plus_times_row(x, a, y):
    if _of_others(x):
        return None
    return (lambda x, a, y: _plus_times(x, a, y)) if x is ROW else plus_times  # noqa: PLW0108


@overload(numbers)
def _numbers_of_row(x):
    return (lambda x: _unpack(x)) if x is ROW else numbers  # noqa: PLW0108


@overload(first)
def _first_of_rows(x, y, z):
    return (lambda x, y, z: _first(x, y, z)) if x is ROW else first  # noqa: PLW0108


@overload(second)
def _second_of_rows(x, y, z):
    return (lambda x, y, z: _second(x, y, z)) if x is ROW else second  # noqa: PLW0108


@overload(third)
def _third_of_rows(x, y, z):
    return (lambda x, y, z: _third(x, y, z)) if x is ROW else third  # noqa: PLW0108


@overload(add_to)
def _add_rows_to(blocks, s, r, x, y):
    return (lambda blocks, s, r, x, y: _accumulate(blocks, s, r, x, y)) if x is ROW else add_to  # noqa: PLW0108


@overload(take_from)
def _take_rows_from(blocks, s, r, x, y):
    return (lambda blocks, s, r, x, y: _reduce(blocks, s, r, x, y)) if x is ROW else take_from  # noqa: PLW0108


@kernel(inline=True)
def rows(m):
    """The rows of a 3x3 matrix (9-tuple)."""
    return row(m[0], m[1], m[2]), row(m[3], m[4], m[5]), row(m[6], m[7], m[8])


@kernel(inline=True)
def mul_rows(m, x):
    """m x for a 3x3 matrix (9-tuple) and rows."""
    return (
        combine3(m[0], x[0], m[1], x[1], m[2], x[2]),
        combine3(m[3], x[0], m[4], x[1], m[5], x[2]),
        combine3(m[6], x[0], m[7], x[1], m[8], x[2]),
    )


@kernel(inline=True)
def cross_rows(a, x):
    """skew(a) x for a vector and rows."""
    return combine2(a[1], x[2], -a[2], x[1]), combine2(a[2], x[0], -a[0], x[2]), combine2(a[0], x[1], -a[1], x[0])


@kernel(inline=True)
def add_rows(x, y):
    """x + y."""
    return plus(x[0], y[0]), plus(x[1], y[1]), plus(x[2], y[2])


@kernel(inline=True)
def sub_rows(x, y):
    """x - y."""
    return less(x[0], y[0]), less(x[1], y[1]), less(x[2], y[2])


@kernel(inline=True)
def scale_rows(a, x):
    """a x."""
    return times(a, x[0]), times(a, x[1]), times(a, x[2])


@kernel(inline=True)
def transpose_rows(x):
    """The transposed matrix."""
    return first(x[0], x[1], x[2]), second(x[0], x[1], x[2]), third(x[0], x[1], x[2])


@kernel(inline=True)
def add_block(blocks, s, r, x, y):
    """blocks[s, r : r + 3] += [x, y] for blocks (n, 6, 6) and 3x3 matrices x, y as rows."""
    add_to(blocks, s, r, x[0], y[0])
    add_to(blocks, s, r + 1, x[1], y[1])
    add_to(blocks, s, r + 2, x[2], y[2])


@kernel(inline=True)
def sub_block(blocks, s, r, x, y):
    """blocks[s, r : r + 3] -= [x, y] for blocks (n, 6, 6) and 3x3 matrices x, y as rows."""
    take_from(blocks, s, r, x[0], y[0])
    take_from(blocks, s, r + 1, x[1], y[1])
    take_from(blocks, s, r + 2, x[2], y[2])
