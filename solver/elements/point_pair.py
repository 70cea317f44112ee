"""A force between a point P of body i and a point Q of body j, and its tangents: shared by all point-to-point elements."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.jit import kernel
from solver.lie.vec import add3, cross, cross_m, load3, load33, m_cross, madd, minus, mm, put33, skew, tmm, tmv


class Kinematics(NamedTuple):
    """Where the bodies are and how they move, at one instant; the last row is the world at rest.

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


@kernel(inline=True)
def _add_columns(R_i, R_j, r_i, r_j, dF, s_j, s_i, column, K):
    """Add the variation dF of a force on j and its reaction on i, with their torques, to three columns of the blocks."""
    put33(K, s_j, 0, column, dF)
    put33(K, s_j, 3, column, cross_m(r_j, tmm(R_j, dF)))
    put33(K, s_i, 0, column, minus(dF))
    put33(K, s_i, 3, column, minus(cross_m(r_i, tmm(R_i, dF))))


@kernel(inline=True)
def _add_translations(R_i, R_j, r_i, r_j, dF, s_ii, s_ij, s_ji, s_jj, K):
    """The same for the columns of the translations of j and of i, where the variation is dF and its opposite."""
    on_j = cross_m(r_j, tmm(R_j, dF))
    on_i = cross_m(r_i, tmm(R_i, dF))
    put33(K, s_jj, 0, 0, dF)
    put33(K, s_jj, 3, 0, on_j)
    put33(K, s_ij, 0, 0, minus(dF))
    put33(K, s_ij, 3, 0, minus(on_i))
    put33(K, s_ji, 0, 0, minus(dF))
    put33(K, s_ji, 3, 0, minus(on_j))
    put33(K, s_ii, 0, 0, dF)
    put33(K, s_ii, 3, 0, on_i)


@kernel(borrow=True)
def add_point_pair_tangent(kin, i, j, r_i, r_j, F, D, C, s_ii, s_ij, s_ji, s_jj, Kq, Kv):
    """Add the tangents of a force +F on j at r_j and -F on i at r_i (F in W).

    D = dF/d(p_PQ) and C = dF/d(v_PQ), both 3x3 in W. Slots of the world are trash slots and may be written.
    """
    R_i = load33(kin.R, i)
    R_j = load33(kin.R, j)
    # d p_P / d theta_i = -U_i and d v_P / d theta_i = -N_i; the same for Q and j
    U_i = m_cross(R_i, r_i)
    U_j = m_cross(R_j, r_j)
    N_i = m_cross(R_i, cross(angular_velocity(kin, i), r_i))
    N_j = m_cross(R_j, cross(angular_velocity(kin, j), r_j))
    turn_j = cross_m(r_j, skew(tmv(R_j, F)))
    turn_i = cross_m(r_i, skew(tmv(R_i, F)))
    put33(Kq, s_jj, 3, 3, turn_j)
    put33(Kq, s_ii, 3, 3, minus(turn_i))
    _add_translations(R_i, R_j, r_i, r_j, D, s_ii, s_ij, s_ji, s_jj, Kq)
    _add_columns(R_i, R_j, r_i, r_j, minus(madd(mm(D, U_j), mm(C, N_j))), s_jj, s_ij, 3, Kq)
    _add_columns(R_i, R_j, r_i, r_j, madd(mm(D, U_i), mm(C, N_i)), s_ji, s_ii, 3, Kq)
    _add_translations(R_i, R_j, r_i, r_j, C, s_ii, s_ij, s_ji, s_jj, Kv)
    _add_columns(R_i, R_j, r_i, r_j, minus(mm(C, U_j)), s_jj, s_ij, 3, Kv)
    _add_columns(R_i, R_j, r_i, r_j, mm(C, U_i), s_ji, s_ii, 3, Kv)
