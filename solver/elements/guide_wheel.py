"""Both wheels of a guide: where they are and move, what acts on them, and vectors over (x, y, psi, gamma) of left and
right."""

from __future__ import annotations

from typing import NamedTuple

from solver.compiled.dual import arctan
from solver.compiled.kernel import kernel
from solver.compiled.rows import combine3, numbers, plus, plus_times, row_like
from solver.compiled.vec import add, cross, dot, load3, load33, mv, scale, sub, tmm, tmv
from solver.elements.coordinate import scale6


class GuidedWheel(NamedTuple):
    """A wheel relative to the chassis, along the axes of the chassis."""

    R: tuple  # of the wheel in the chassis
    D: tuple  # centre from the centre of mass of the chassis [m]
    a: tuple  # spin axis
    V: tuple  # velocity [m/s]
    turn: tuple  # angular velocity [rad/s]
    x: tuple  # (x, y, s, psi, gamma)
    rate: tuple  # of these
    p: tuple  # d psi / d rotation
    g: tuple  # d gamma / d rotation


@kernel(inner=True)
def wheel_of(table, kin, e, k):
    c, b = table.body[e, 0], table.body[e, 1 + k]
    R_c = load33(kin.R, c)
    R = tmm(R_c, load33(kin.R, b))
    D = tmv(R_c, sub(load3(kin.p, b), load3(kin.p, c)))
    w_c = (kin.v[c, 3], kin.v[c, 4], kin.v[c, 5])
    V = add(tmv(R_c, sub(load3(kin.v, b), load3(kin.v, c))), cross(D, w_c))
    turn = sub(mv(R, (kin.v[b, 3], kin.v[b, 4], kin.v[b, 5])), w_c)
    a = mv(R, load3(table.axis, 2 * e + k))
    d = sub(D, load3(table.origin, 2 * e + k))
    q = a[2] / (a[0] * a[0] + a[1] * a[1])
    p = (-q * a[0], -q * a[1], 1.0 + 0.0 * q)
    g = (a[1], -a[0], 0.0 * q)
    psi = arctan(-a[0] / a[1])
    return GuidedWheel(
        R, D, a, V, turn, (d[0], d[1], d[2], psi, a[2]), (V[0], V[1], V[2], dot(p, turn), dot(g, turn)), p, g
    )


@kernel(inline=True)
def wrench(wheel, x, y, s, psi, gamma, about):
    """(force, moment) at a wheel centre along the axes of the chassis, of generalized forces and a moment about the
    spin axis."""
    return (x, y, s), add(scale(about, wheel.a), add(scale(psi, wheel.p), scale(gamma, wheel.g)))


@kernel(inline=True)
def gradients(R_c, left, right, on_l, on_r, sigma, g_i, g_j):
    """The gradients on (chassis, left, right, steering i and j), as solver.elements.coordinate has them, of wrenches on
    both wheels."""
    F = add(on_l[0], on_r[0])
    m = add(add(cross(left.D, on_l[0]), on_l[1]), add(cross(right.D, on_r[0]), on_r[1]))
    return (
        (scale(-1.0, mv(R_c, F)), scale(-1.0, m)),
        (mv(R_c, on_l[0]), tmv(left.R, on_l[1])),
        (mv(R_c, on_r[0]), tmv(right.R, on_r[1])),
        scale6(sigma, g_i),
        scale6(sigma, g_j),
    )


@kernel(inline=True)
def _column(m, k):
    """Slope k (see _quantity) of x, y, psi, gamma."""
    return (m[0][k], m[1][k], m[2][k], m[3][k])


@kernel(inline=True)
def eight(left, right, k):
    """Slope k (see _quantity) of x, y, psi, gamma of both wheels."""
    return (*_column(left, k), *_column(right, k))


@kernel(inline=True)
def over_travels(left, right):
    """(slopes of the eight over the left travel, over the right travel)."""
    return (*_column(left, 1), *_column(right, 2)), (*_column(left, 2), *_column(right, 1))


@kernel(inline=True)
def dot8(a, b):
    return ((a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3])) + (
        (a[4] * b[4] + a[5] * b[5]) + (a[6] * b[6] + a[7] * b[7])
    )


@kernel(inline=True)
def plus8(a, s, b):
    """a + s b."""
    return (
        a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2], a[3] + s * b[3],
        a[4] + s * b[4], a[5] + s * b[5], a[6] + s * b[6], a[7] + s * b[7],
    )  # fmt: skip


@kernel(inline=True)
def _three8(K, e, q, x):
    """Rows q, q + 1, q + 2 of K x; K is symmetric."""
    a = combine3(x[0], _three(K, e, 0, q, x), x[1], _three(K, e, 1, q, x), x[2], _three(K, e, 2, q, x))
    b = combine3(x[3], _three(K, e, 3, q, x), x[4], _three(K, e, 4, q, x), x[5], _three(K, e, 5, q, x))
    return plus_times(plus_times(plus(a, b), x[6], _three(K, e, 6, q, x)), x[7], _three(K, e, 7, q, x))


@kernel(inline=True)
def _three(K, e, i, q, x):
    return row_like(x[0], K[e, i, q], K[e, i, q + 1], K[e, i, q + 2])


@kernel(inner=True)
def times8(K, e, x):
    """K x of guide e; K has a ninth column, which is empty (solver.compiled.rows)."""
    a, b, c = numbers(_three8(K, e, 0, x)), numbers(_three8(K, e, 3, x)), numbers(_three8(K, e, 6, x))
    return a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1]


@kernel(inline=True)
def load8(a, i):
    return (a[i, 0], a[i, 1], a[i, 2], a[i, 3], a[i, 4], a[i, 5], a[i, 6], a[i, 7])
