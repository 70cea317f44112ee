"""Rows of 3x3 matrices of lanes (solver.compiled.rows): three numbers, with the fused products of rows of float64."""

from __future__ import annotations

from numba.core import types
from numba.extending import intrinsic, overload

from solver.compiled import rows
from solver.compiled.lanes.number import LANE, is_lane, is_number, vector_function

ROW = types.UniTuple(LANE, 3)


@intrinsic
def _fma(typingctx, a, b, c):
    """a b + c, rounded once."""
    return LANE(LANE, LANE, LANE), vector_function('fma', 3)


@intrinsic
def _as_lane(typingctx, x):
    return LANE(LANE), lambda context, builder, sig, args: args[0]


@overload(rows.row)
def _row(a, b, c):
    if any(map(is_lane, (a, b, c))) and all(map(is_number, (a, b, c))):
        return lambda a, b, c: (_as_lane(a), _as_lane(b), _as_lane(c))
    return None


@overload(rows.row_like)
def _row_like(number, a, b, c):
    return (lambda number, a, b, c: (_as_lane(a), _as_lane(b), _as_lane(c))) if is_lane(number) else None


@overload(rows.combine2)
def _combine2(a, x, b, y):
    if x != ROW:
        return None
    return lambda a, x, b, y: (
        _fma(_as_lane(b), y[0], a * x[0]),
        _fma(_as_lane(b), y[1], a * x[1]),
        _fma(_as_lane(b), y[2], a * x[2]),
    )


@overload(rows.combine3)
def _combine3(a, x, b, y, c, z):
    if x != ROW:
        return None

    def combine(a, x, b, y, c, z):
        q, r = _as_lane(b), _as_lane(c)
        return (
            _fma(r, z[0], _fma(q, y[0], a * x[0])),
            _fma(r, z[1], _fma(q, y[1], a * x[1])),
            _fma(r, z[2], _fma(q, y[2], a * x[2])),
        )

    return combine


@overload(rows.plus_times)
def _plus_times(x, a, y):
    if x != ROW:
        return None
    return lambda x, a, y: (
        _fma(_as_lane(a), y[0], x[0]),
        _fma(_as_lane(a), y[1], x[1]),
        _fma(_as_lane(a), y[2], x[2]),
    )
