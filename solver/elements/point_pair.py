"""A force between a point P of body i and a point Q of body j, and its tangents: shared by all point-to-point
elements."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.rows import add_block, add_rows, cross_rows, mul_rows, rows, sub_block, sub_rows
from solver.compiled.vec import (
    add3,
    cross,
    cross_cross,
    load3,
    load33,
    m_cross,
    madd,
    mscale,
    outer,
    scale,
    sub,
    tmv,
    transpose,
)


class Kinematics(NamedTuple):
    """Places and motions of the bodies at one instant; the last row is the world at rest.

    R: (nb+1, 3, 3) rotation R_WB. p: (nb+1, 3) centre of mass in W [m]. v: (nb+1, 6) twist (see docs/conventions.md).
    """

    R: np.ndarray
    p: np.ndarray
    v: np.ndarray


@kernel(inline=True)
def linear_velocity(kin, b):
    """Velocity of the centre of mass in W [m/s]."""
    return load3(kin.v, b)


@kernel(inline=True)
def angular_velocity(kin, b):
    """Angular velocity in B [rad/s]."""
    return (kin.v[b, 3], kin.v[b, 4], kin.v[b, 5])


@kernel(inline=True)
def point_position(kin, b, r):
    """Position in W [m] of the point r (from the centre of mass, in B)."""
    R = load33(kin.R, b)
    return (
        kin.p[b, 0] + R[0] * r[0] + R[1] * r[1] + R[2] * r[2],
        kin.p[b, 1] + R[3] * r[0] + R[4] * r[1] + R[5] * r[2],
        kin.p[b, 2] + R[6] * r[0] + R[7] * r[1] + R[8] * r[2],
    )


@kernel(inline=True)
def point_velocity(kin, b, r):
    """Velocity in W [m/s] of the point r (from the centre of mass, in B)."""
    R = load33(kin.R, b)
    c = cross(angular_velocity(kin, b), r)
    return (
        kin.v[b, 0] + R[0] * c[0] + R[1] * c[1] + R[2] * c[2],
        kin.v[b, 1] + R[3] * c[0] + R[4] * c[1] + R[5] * c[2],
        kin.v[b, 2] + R[6] * c[0] + R[7] * c[1] + R[8] * c[2],
    )


@kernel(inline=True)
def add_point_force(kin, b, r, F, f):
    """Add force F (in W) acting at point r of body b to the generalized forces f (nb+1, 6)."""
    add3(f, b, 0, F)
    add3(f, b, 3, cross(r, tmv(load33(kin.R, b), F)))


class Between(NamedTuple):
    """Points P on body i and Q on body j."""

    i: int
    j: int
    r_i: tuple  # from the centre of mass, in B_i [m]
    r_j: tuple
    d: tuple  # from P to Q in W [m]
    v: tuple  # velocity of Q less that of P in W [m/s]


@kernel(inline=True)
def between(table, e, kin):
    """The points of element e of a table with the columns body, r_i and r_j."""
    i = table.body[e, 0]
    j = table.body[e, 1]
    r_i = load3(table.r_i, e)
    r_j = load3(table.r_j, e)
    d = sub(point_position(kin, j, r_j), point_position(kin, i, r_i))
    v = sub(point_velocity(kin, j, r_j), point_velocity(kin, i, r_i))
    return Between(i, j, r_i, r_j, d, v)


@kernel(inline=True)
def add_tension(kin, at, n, force, f):
    """Add a force along the unit vector n from P to Q that pulls them together, and return it as it acts on j."""
    F = scale(-force, n)
    add_point_force(kin, at.j, at.r_j, F, f)
    add_point_force(kin, at.i, at.r_i, scale(force, n), f)
    return F


@kernel(inline=True)
def _add_variations(R_i, R_j, r_i, r_j, D, on_j, on_i, turn_j, turn_i, s_ii, s_ij, s_ji, s_jj, K):
    """Add the variations of a force on j and of its reaction on i, with their torques, to the blocks K; all matrices
    are rows.

    D of the force with the translation of j (its opposite with that of i), on_j with the turn of j, on_i of the
    reaction with the turn of i; turn_j and turn_i of the torques with the turns beyond that.
    """
    back_i = transpose(R_i)
    back_j = transpose(R_j)
    p_j = cross_rows(r_j, mul_rows(back_j, D))
    p_i = cross_rows(r_i, mul_rows(back_i, D))
    add_block(K, s_jj, 0, D, on_j)
    add_block(K, s_jj, 3, p_j, add_rows(cross_rows(r_j, mul_rows(back_j, on_j)), turn_j))
    sub_block(K, s_ij, 0, D, on_j)
    sub_block(K, s_ij, 3, p_i, cross_rows(r_i, mul_rows(back_i, on_j)))
    sub_block(K, s_ji, 0, D, on_i)
    sub_block(K, s_ji, 3, p_j, cross_rows(r_j, mul_rows(back_j, on_i)))
    add_block(K, s_ii, 0, D, on_i)
    add_block(K, s_ii, 3, p_i, sub_rows(cross_rows(r_i, mul_rows(back_i, on_i)), turn_i))


@kernel(inner=True)
def add_point_pair_tangent(kin, i, j, r_i, r_j, F, D, C, s_ii, s_ij, s_ji, s_jj, Kq, Kv):
    """Add the tangents of a force +F on j at r_j and -F on i at r_i (F in W).

    D = dF/d(p_PQ) and C = dF/d(v_PQ), both 3x3 in W. Slots of the world are trash slots and may be written.
    """
    R_i = load33(kin.R, i)
    R_j = load33(kin.R, j)
    # d p_P / d theta_i = -U_i and d v_P / d theta_i = -N_i; the same for Q and j
    U_i = rows(m_cross(R_i, r_i))
    U_j = rows(m_cross(R_j, r_j))
    N_i = rows(m_cross(R_i, cross(angular_velocity(kin, i), r_i)))
    N_j = rows(m_cross(R_j, cross(angular_velocity(kin, j), r_j)))
    none = rows(mscale(0.0, D))
    turn_j = rows(cross_cross(r_j, tmv(R_j, F)))
    turn_i = rows(cross_cross(r_i, tmv(R_i, F)))
    on_j = sub_rows(none, add_rows(mul_rows(D, U_j), mul_rows(C, N_j)))
    on_i = sub_rows(none, add_rows(mul_rows(D, U_i), mul_rows(C, N_i)))
    _add_variations(R_i, R_j, r_i, r_j, rows(D), on_j, on_i, turn_j, turn_i, s_ii, s_ij, s_ji, s_jj, Kq)
    on_j = sub_rows(none, mul_rows(C, U_j))
    on_i = sub_rows(none, mul_rows(C, U_i))
    _add_variations(R_i, R_j, r_i, r_j, rows(C), on_j, on_i, none, none, s_ii, s_ij, s_ji, s_jj, Kv)


@kernel(inline=True)
def add_tension_tangent(kin, at, n, rate, F, stiffness, damping, across, twist, slot, e, Kq, Kv):
    """Add the tangents of add_tension: of its stiffness and damping along n, and of its turn: across = force / length,
    twist = -damping / length where there is a length.

    F = -force n ; dn = (1 - n n^T) dd / length ; drate = n.dw + (w - rate n).dd / length
    """
    nn = outer(n, n)
    D = madd(mscale(-(stiffness - across), nn), mscale(twist, outer(n, sub(at.v, scale(rate, n)))))
    D = (D[0] - across, D[1], D[2], D[3], D[4] - across, D[5], D[6], D[7], D[8] - across)
    C = mscale(-damping, nn)
    add_point_pair_tangent(
        kin, at.i, at.j, at.r_i, at.r_j, F, D, C, slot[e, 0], slot[e, 1], slot[e, 2], slot[e, 3], Kq, Kv
    )
