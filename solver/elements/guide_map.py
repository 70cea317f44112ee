"""Maps of a guide: cubic B-splines over travel and steering, linear over the travel of the other wheel (solver.elements.guide)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel

QUANTITIES = ('x', 'y', 'psi', 'gamma', 'theta')


class Nodes(NamedTuple):
    """Equidistant nodes of a map along one argument; of a single one the map does not depend on it."""

    first: float
    step: float
    number: int

    @property
    def coefficients(self) -> int:
        """How many B-splines reach into the range of the nodes."""
        return self.number + 2 if self.number > 1 else 1


@kernel(inner=True)
def _place(x, first, step, count):
    """(first B-spline, weights of four, their slopes and second derivatives) at x; beyond the nodes linearly continued."""
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
    """Where a map is evaluated: of travel and steering, the first row, weights, slopes and second derivatives of four B-splines."""

    row: int
    columns: int
    w: tuple
    d: tuple
    dd: tuple
    u: tuple
    du: tuple
    ddu: tuple


@kernel(inline=True)
def _four(shape, row, q, w):
    """Sum of four coefficients in a row with weights."""
    return shape[row, q] * w[0] + shape[row + 1, q] * w[1] + shape[row + 2, q] * w[2] + shape[row + 3, q] * w[3]


@kernel(inner=True)
def _surface(shape, at, q, bent):
    """(value, by s, by sigma, by s s, by s sigma, by sigma sigma) of quantity q; the second derivatives only if bent."""
    zero = 0.0 * at.w[0]
    v, v_s, v_t, v_ss, v_st, v_tt = zero, zero, zero, zero, zero, zero
    for k in range(4):
        row = at.row + k * at.columns
        if at.columns > 1:
            a, b = _four(shape, row, q, at.u), _four(shape, row, q, at.du)
            v_t += at.w[k] * b
            if bent:
                v_st += at.d[k] * b
                v_tt += at.w[k] * _four(shape, row, q, at.ddu)
        else:
            a = shape[row, q] + zero
        v += at.w[k] * a
        v_s += at.d[k] * a
        if bent:
            v_ss += at.dd[k] * a
    return v, v_s, v_t, v_ss, v_st, v_tt


@kernel(inner=True)
def _quantity(table, side, at, q, s, o, bent):
    """(value, by s, by o, by sigma, by s s, by s o, by s sigma, by sigma sigma) of quantity q with the travel o of the other wheel."""
    v, v_s, v_t, v_ss, v_st, v_tt = _surface(table.shape, at, q, bent)
    b0, b1 = table.opposite[side, q, 0], table.opposite[side, q, 1]
    v_o = b0 + b1 * s
    return v + o * v_o, v_s + o * b1, v_o, v_t, v_ss, b1, v_st, v_tt


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
    return (
        _quantity(table, side, at, 0, s, o, bent),
        _quantity(table, side, at, 1, s, o, bent),
        _quantity(table, side, at, 2, s, o, bent),
        _quantity(table, side, at, 3, s, o, bent),
        _quantity(table, side, at, 4, s, o, bent),
    )
