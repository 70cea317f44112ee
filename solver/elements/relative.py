"""A point Q of body j as body i sees it, and the tangents of a force at Q: shared by bushings and rods.

Unless said otherwise, vectors are along the axes of B_i, the frame of body i. The state varies by dp_i, dp_j (places,
along the axes of the world) and dtheta_i, dtheta_j (rotations, along the axes of the own body). Seen from B_i these are

    P = R_i^T (dp_j - dp_i),    a = dtheta_i,    b = R_i^T R_j dtheta_j

and the place of Q relative to B_i varies by P + e x a - rho x b (e, rho: see Relative). A tangent has three 3x3 parts:
p over dp_j (over dp_i it is -p), a over dtheta_i, b over dtheta_j. Each is stored as a tuple of its rows
(solver.compiled.rows).
"""

from __future__ import annotations

from typing import NamedTuple

from solver.compiled.kernel import kernel
from solver.compiled.rows import add_block, add_rows, cross_rows, mul_rows, rows, sub_block, sub_rows
from solver.compiled.vec import add, cross, load3, load33, m_cross, mscale, msub, mv, skew, sub, tmm, tmv, transpose
from solver.elements.point_pair import angular_velocity, linear_velocity

Three = tuple[float, float, float]
Nine = tuple[float, float, float, float, float, float, float, float, float]  # a matrix, row by row


class Relative(NamedTuple):
    """Place and motion of the point Q of body j relative to body i, along the axes of B_i."""

    R: Nine  # R_i, from B_i to the world
    S: Nine  # R_i^T R_j, from B_j to B_i
    rho: Three  # from the centre of mass of j to Q [m]
    e: Three  # from the centre of mass of i to Q [m]
    w_i: Three  # angular velocity of i [rad/s]
    s: Three  # angular velocity of j [rad/s]
    sigma: Three  # s x rho: velocity of Q relative to the centre of mass of j [m/s]
    y: Three  # velocity of Q minus that of the centre of mass of i [m/s]
    d_dot: Three  # velocity of Q relative to B_i, as an observer on body i sees it [m/s]


@kernel(inline=True)
def relative_motion(table, n, kin):
    """The Relative of element n of a table with the columns body and r_j."""
    i = table.body[n, 0]
    j = table.body[n, 1]
    R_i = load33(kin.R, i)
    R_j = load33(kin.R, j)
    w_i = angular_velocity(kin, i)
    S = tmm(R_i, R_j)
    rho = mv(S, load3(table.r_j, n))
    e = add(tmv(R_i, sub(load3(kin.p, j), load3(kin.p, i))), rho)
    s = mv(S, angular_velocity(kin, j))
    sigma = cross(s, rho)
    y = add(tmv(R_i, sub(linear_velocity(kin, j), linear_velocity(kin, i))), sigma)
    return Relative(R_i, S, rho, e, w_i, s, sigma, y, add(y, cross(e, w_i)))


class Columns(NamedTuple):
    """Tangent of a force at Q: its parts p, a, b (see the module), for an observer on body i.

    a_seen: the part a for an observer who does not turn with body i, in the world or on body j. b_seen: the part b for
    an observer on body j. All five are written along the axes of B_i.
    """

    p: tuple
    a: tuple
    b: tuple
    a_seen: tuple
    b_seen: tuple


@kernel(inline=True)
def by_place(at, force, C, D):
    """Tangent over places and rotations of a force that changes by D over the place of Q, and by -C over its
    velocity."""
    S = rows(at.S)
    p = mul_rows(D, rows(transpose(at.R)))
    a = rows(msub(m_cross(D, at.e), m_cross(C, at.y)))
    b = mul_rows(msub(m_cross(C, at.sigma), m_cross(D, at.rho)), S)
    return Columns(p, a, b, sub_rows(a, rows(skew(force))), add_rows(b, cross_rows(force, S)))


@kernel(inline=True)
def by_rate(at, C):
    """Tangent over velocities of the same force, with the opposite sign."""
    p = mul_rows(C, rows(transpose(at.R)))
    a = rows(m_cross(C, at.e))
    b = sub_rows(rows(mscale(0.0, at.S)), mul_rows(C, cross_rows(at.rho, rows(at.S))))
    return Columns(p, a, b, a, b)


@kernel(inline=True)
def add_by_place(slot, n, at, on, on_i, on_j, Kq):
    """Add the tangents over places and rotations of a force at Q to the matrix Kq.

    on: tangent of the force on body j (by_place); body i gets the opposite force. on_i, on_j: tangents (p, a, b) of the
    moments on i and on j, along the axes of that body; b of on_i has the opposite sign.
    """
    s_ii, s_ij, s_ji, s_jj = slot[n, 0], slot[n, 1], slot[n, 2], slot[n, 3]
    zero = rows(mscale(0.0, at.S))
    p_W, a_W, b_W = mul_rows(at.R, on.p), mul_rows(at.R, on.a_seen), mul_rows(at.R, on.b)
    add_block(Kq, s_jj, 0, p_W, b_W)
    add_block(Kq, s_jj, 3, on_j[0], on_j[2])
    sub_block(Kq, s_ji, 0, p_W, sub_rows(zero, a_W))
    sub_block(Kq, s_ji, 3, on_j[0], sub_rows(zero, on_j[1]))
    sub_block(Kq, s_ij, 0, p_W, b_W)
    add_block(Kq, s_ij, 3, on_i[0], sub_rows(zero, on_i[2]))
    add_block(Kq, s_ii, 0, p_W, sub_rows(zero, a_W))
    sub_block(Kq, s_ii, 3, on_i[0], sub_rows(zero, on_i[1]))


@kernel(inline=True)
def add_by_rate(slot, n, at, on, on_i, on_j, Kv):
    """Add the tangents over velocities of a force at Q to the matrix Kv.

    on: negative tangent of the force on body j (by_rate); body i gets the opposite force. on_i: tangent (p, a, b) of
    the moment on i, on_j: negative tangent of the moment on j, along the axes of that body.
    """
    s_ii, s_ij, s_ji, s_jj = slot[n, 0], slot[n, 1], slot[n, 2], slot[n, 3]
    zero = rows(mscale(0.0, at.S))
    p_W, a_W, b_W = mul_rows(at.R, on.p), mul_rows(at.R, on.a), mul_rows(at.R, on.b)
    sub_block(Kv, s_jj, 0, p_W, b_W)
    sub_block(Kv, s_jj, 3, on_j[0], on_j[2])
    add_block(Kv, s_ji, 0, p_W, sub_rows(zero, a_W))
    add_block(Kv, s_ji, 3, on_j[0], sub_rows(zero, on_j[1]))
    add_block(Kv, s_ij, 0, p_W, b_W)
    add_block(Kv, s_ij, 3, on_i[0], on_i[2])
    sub_block(Kv, s_ii, 0, p_W, sub_rows(zero, a_W))
    sub_block(Kv, s_ii, 3, on_i[0], sub_rows(zero, on_i[1]))
