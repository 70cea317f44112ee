"""Elementary functions of numbers of lanes: those of the C library for one lane after the other, roots and roundings
for all at once.

The functions of the C library are the ones that single simulations call, so bits are the same. There is no vector
function with these bits; so sin, cos, tan, atan, exp, log and powers cost every lane what they cost a single
simulation."""

from __future__ import annotations

import math
import operator

import numpy as np
from numba.core import types
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, overload

from solver.compiled.kernel import kernel
from solver.compiled.lanes import LANES
from solver.compiled.lanes.number import LANE, LaneType, is_lane, is_number, lane_at, vector_function, with_lane


def _whole(functions, name):
    """Teach numba functions that LLVM knows of vectors, with the bits of the scalar ones."""

    @intrinsic
    def all_lanes(typingctx, x):
        return LANE(LANE), vector_function(name)

    for function in functions:

        @overload(function)
        def _overload(x):
            return (lambda x: all_lanes(x)) if is_lane(x) else None  # noqa: PLW0108


_whole((np.sqrt, math.sqrt), 'sqrt')
_whole((abs, np.abs, math.fabs), 'fabs')
_whole((np.floor,), 'floor')
_whole((np.ceil,), 'ceil')
_whole((np.round, np.rint), 'rint')


def _each(functions):
    """Teach numba functions of the C library, for one lane after the other."""
    scalar = functions[0]

    @kernel(inline=True)
    def each(x):
        y = x
        for k in range(LANES):
            y = with_lane(y, k, scalar(lane_at(x, k)))
        return y

    for function in functions:

        @overload(function)
        def _overload(x):
            return (lambda x: each(x)) if is_lane(x) else None  # noqa: PLW0108


for _functions in (
    (np.sin,), (np.cos,), (np.tan,), (np.arctan,), (np.arcsin,), (np.arccos,), (np.exp,), (np.log,), (np.tanh,),
    (np.sinh,), (np.cosh,), (math.sin,), (math.cos,), (math.tan,), (math.atan,), (math.exp,), (math.log,),
):  # fmt: skip
    _each(_functions)


@intrinsic
def _as_lane(typingctx, x):
    return LANE(LANE), lambda context, builder, sig, args: args[0]


def _each_pair(function):
    """Teach numba a function of the C library of two numbers."""

    @kernel(inline=True)
    def each(x, y):
        z = x
        for k in range(LANES):
            z = with_lane(z, k, function(lane_at(x, k), lane_at(y, k)))
        return z

    @overload(function)
    def _overload(x, y):
        if is_lane(x) and is_lane(y):
            return lambda x, y: each(x, y)  # noqa: PLW0108
        if (is_lane(x) or is_lane(y)) and is_number(x) and is_number(y):
            return lambda x, y: each(_as_lane(x), _as_lane(y))
        return None


for _function in (np.arctan2, math.atan2, np.hypot, math.hypot, operator.mod, operator.floordiv):
    _each_pair(_function)


@kernel(inline=True)
def _powers(x, p):
    y = x
    for k in range(LANES):
        y = with_lane(y, k, lane_at(x, k) ** p)
    return y


@kernel(inline=True)
def _powers_of_lanes(x, p):
    y = p
    for k in range(LANES):
        y = with_lane(y, k, lane_at(x, k) ** lane_at(p, k))
    return y


def _power(x, p):
    """x ** p of lanes, for both overloads below."""


@overload(_power)
def _power_overload(x, p):
    if is_lane(x) and is_lane(p):
        return lambda x, p: _powers_of_lanes(x, p)  # noqa: PLW0108
    if is_lane(x):
        return lambda x, p: _powers(x, p)  # noqa: PLW0108
    return lambda x, p: _powers_of_lanes(_as_lane(x), p)


for _operation in (operator.pow, operator.ipow):

    @overload(_operation)
    def _pow(x, p):
        if (is_lane(x) or is_lane(p)) and is_number(x) and is_number(p) and not isinstance(p, types.IntegerLiteral):
            return lambda x, p: _power(x, p)  # noqa: PLW0108
        return None

    @infer_global(_operation)
    class _WholePower(AbstractTemplate):
        def generic(self, args, kws):
            whole = len(args) == 2 and is_lane(args[0]) and isinstance(args[1], types.IntegerLiteral)
            return signature(LANE, LANE, args[1]) if whole else None

    @lower_builtin(_operation, LaneType, types.IntegerLiteral)
    def _whole_power(context, builder, sig, args):
        """By squares, in the order in which numba does it with float64."""
        left, value = abs(sig.args[1].value), args[0]
        one = context.cast(builder, context.get_constant(types.float64, 1.0), types.float64, LANE)
        found = one
        while left:
            if left & 1:
                found = builder.fmul(found, value)
            left >>= 1
            value = builder.fmul(value, value)
        return builder.fdiv(one, found) if sig.args[1].value < 0 else found
