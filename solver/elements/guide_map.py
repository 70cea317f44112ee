"""Maps of a guide: cubic B-splines over travel and steering, cubic in the travel of the other wheel
(solver.elements.guide)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.rows import combine3, numbers, plus_times, row_like

QUANTITIES = ('x', 'y', 'psi', 'gamma', 'theta')
BESIDE = 7  # coefficients of what the travel of the other wheel changes
COLUMNS = 6  # of the coefficients: two rows of three (solver.compiled.rows), the last column empty


class Nodes(NamedTuple):
    """Equidistant nodes of a map along one argument; of a single one the map does not depend on it."""

    first: float
    step: float
    number: int

    @property
    def coefficients(self) -> int:
        """Number of B-splines that reach into the range of the nodes."""
        return self.number + 2 if self.number > 1 else 1


@kernel(inner=True)
def _place(x, first, step, count):
    """(first B-spline, weights of four, their slopes and second derivatives) at x; beyond the nodes linearly
    continued."""
    t = (x - first) / step
    i = int(min(max(np.floor(t.real), 0.0), count - 2.0))
    u = t - i
    beyond = 0.0 * u
    if u.real < 0.0:
        beyond, u = u, 0.0 * u
    elif u.real > 1.0:
        beyond, u = u - 1.0, 0.0 * u + 1.0
    r = 1.0 - u
    w = (r * r * r / 6.0, (4.0 - 3.0 * u * u * (2.0 - u)) / 6.0, (4.0 - 3.0 * r * r * (1.0 + u)) / 6.0, u * u * u / 6.0)
    d = (-0.5 * r * r, u * (1.5 * u - 2.0), r * (2.0 - 1.5 * r), 0.5 * u * u)
    k = 1.0 / step
    inside = k * k if beyond.real == 0.0 else 0.0
    w = (w[0] + beyond * d[0], w[1] + beyond * d[1], w[2] + beyond * d[2], w[3] + beyond * d[3])
    dd = (inside * r, inside * (3.0 * u - 2.0), inside * (1.0 - 3.0 * u), inside * u)
    return i, w, (k * d[0], k * d[1], k * d[2], k * d[3]), dd


class Place(NamedTuple):
    """Place where a map is evaluated: for travel and steering, the first row, weights, slopes and second derivatives of
    four B-splines."""

    row: int
    columns: int
    w: tuple
    d: tuple
    dd: tuple
    u: tuple
    du: tuple
    ddu: tuple


class Surface(NamedTuple):
    """Three quantities and their derivatives, as rows of solver.compiled.rows."""

    v: tuple
    s: tuple
    t: tuple  # by sigma
    ss: tuple
    st: tuple
    tt: tuple


@kernel(inline=True)
def _coefficients(shape, at, row, q):
    """Those of three quantities from q on."""
    return row_like(at.w[0], shape[row, q], shape[row, q + 1], shape[row, q + 2])


@kernel(inline=True)
def _four(x, w):
    """Sum of four rows with weights."""
    return plus_times(combine3(w[0], x[0], w[1], x[1], w[2], x[2]), w[3], x[3])


@kernel(inner=True)
def _surface(shape, at, q, bent):
    """The Surface of the quantities q, q + 1, q + 2; second derivatives only if bent."""
    none = row_like(at.w[0], 0.0, 0.0, 0.0)
    v, v_s, v_t, v_ss, v_st, v_tt = none, none, none, none, none, none
    for k in range(4):
        row = at.row + k * at.columns
        if at.columns > 1:
            x = (
                _coefficients(shape, at, row, q), _coefficients(shape, at, row + 1, q),
                _coefficients(shape, at, row + 2, q), _coefficients(shape, at, row + 3, q),
            )  # fmt: skip
            a, b = _four(x, at.u), _four(x, at.du)
            v_t = plus_times(v_t, at.w[k], b)
            if bent:
                v_st = plus_times(v_st, at.d[k], b)
                v_tt = plus_times(v_tt, at.w[k], _four(x, at.ddu))
        else:
            a = _coefficients(shape, at, row, q)
        v = plus_times(v, at.w[k], a)
        v_s = plus_times(v_s, at.d[k], a)
        if bent:
            v_ss = plus_times(v_ss, at.dd[k], a)
    return Surface(v, v_s, v_t, v_ss, v_st, v_tt)


@kernel(inline=True)
def _quantity(table, side, q, s, o, sigma, v, v_s, v_t, v_ss, v_st, v_tt):
    """(value, by s, o, sigma, s s, s o, s sigma, sigma sigma, o o, o sigma) of quantity q with the travel o of the
    other wheel."""
    b = table.opposite
    b1, b2, b3, b4, b5, b6 = b[side, q, 1], b[side, q, 2], b[side, q, 3], b[side, q, 4], b[side, q, 5], b[side, q, 6]
    to_here = b[side, q, 0] + s * (b1 + b3 * s) + o * (b2 + b4 * s + b5 * o) + b6 * sigma
    by_s, by_o = b1 + 2.0 * b3 * s + b4 * o, b2 + b4 * s + 2.0 * b5 * o
    return (
        v + o * to_here, v_s + o * by_s, to_here + o * by_o, v_t + o * b6,
        v_ss + 2.0 * b3 * o, by_s + b4 * o, v_st, v_tt, 2.0 * (by_o + b5 * o), b6,
    )  # fmt: skip


@kernel(inline=True)
def _three(table, side, at, q, s, o, sigma, bent):
    """Quantities q, q + 1, q + 2; the last one of none is not looked at."""
    x = _surface(table.shape, at, q, bent)
    v, v_s, v_t, v_ss, v_st, v_tt = (
        numbers(x.v),
        numbers(x.s),
        numbers(x.t),
        numbers(x.ss),
        numbers(x.st),
        numbers(x.tt),
    )
    last = min(q + 2, len(QUANTITIES) - 1)
    return (
        _quantity(table, side, q, s, o, sigma, v[0], v_s[0], v_t[0], v_ss[0], v_st[0], v_tt[0]),
        _quantity(table, side, q + 1, s, o, sigma, v[1], v_s[1], v_t[1], v_ss[1], v_st[1], v_tt[1]),
        _quantity(table, side, last, s, o, sigma, v[2], v_s[2], v_t[2], v_ss[2], v_st[2], v_tt[2]),
    )


@kernel(inner=True)
def map_of(table, e, k, s, o, sigma, bent):
    """The five quantities of wheel k of guide e; their second derivatives only if bent."""
    side = 2 * e + k
    i, w, d, dd = _place(s, table.nodes[e, 0], table.nodes[e, 1], table.number[e, 0])
    zero = 0.0 * s
    u, du, ddu = (zero, zero, zero, zero), (zero, zero, zero, zero), (zero, zero, zero, zero)
    j, columns = 0, 1
    if table.steering[e] >= 0 and table.number[e, 1] > 1:
        j, u, du, ddu = _place(sigma + zero, table.nodes[e, 2], table.nodes[e, 3], table.number[e, 1])
        columns = table.number[e, 1] + 2
    at = Place(table.start[side] + i * columns + j, columns, w, d, dd, u, du, ddu)
    x, y, psi = _three(table, side, at, 0, s, o, sigma, bent)
    gamma, theta, _ = _three(table, side, at, 3, s, o, sigma, bent)
    return x, y, psi, gamma, theta
