"""A force between a point P of body i and a point Q of body j, and its tangents: shared by all point-to-point elements."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.jit import kernel
from solver.lie.vec import add3, cross, load3, load33, madd, mm, mscale, put33, skew, tmv, transpose


class Kinematics(NamedTuple):
    """Where the bodies are and how they move, at one instant; the last row is the world at rest.

    R: (nb+1, 3, 3) rotation R_WB. p: (nb+1, 3) centre of mass in W [m]. v: (nb+1, 6) twist (see docs/conventions.md).
    """

    R: np.ndarray
    p: np.ndarray
    v: np.ndarray


@kernel
def linear_velocity(kin, b):
    """Velocity of the centre of mass in W [m/s]."""
    return load3(kin.v, b)


@kernel
def angular_velocity(kin, b):
    """Angular velocity in B [rad/s]."""
    return (kin.v[b, 3], kin.v[b, 4], kin.v[b, 5])


@kernel
def point_position(kin, b, r):
    """Position in W [m] of the point r (from the centre of mass, in B)."""
    R = load33(kin.R, b)
    return (
        kin.p[b, 0] + R[0] * r[0] + R[1] * r[1] + R[2] * r[2],
        kin.p[b, 1] + R[3] * r[0] + R[4] * r[1] + R[5] * r[2],
        kin.p[b, 2] + R[6] * r[0] + R[7] * r[1] + R[8] * r[2],
    )


@kernel
def point_velocity(kin, b, r):
    """Velocity in W [m/s] of the point r (from the centre of mass, in B)."""
    R = load33(kin.R, b)
    c = cross(angular_velocity(kin, b), r)
    return (
        kin.v[b, 0] + R[0] * c[0] + R[1] * c[1] + R[2] * c[2],
        kin.v[b, 1] + R[3] * c[0] + R[4] * c[1] + R[5] * c[2],
        kin.v[b, 2] + R[6] * c[0] + R[7] * c[1] + R[8] * c[2],
    )


@kernel
def add_point_force(kin, b, r, F, f):
    """Add force F (in W) acting at point r of body b to the generalized forces f (nb+1, 6)."""
    add3(f, b, 0, F)
    add3(f, b, 3, cross(r, tmv(load33(kin.R, b), F)))


@kernel
def add_point_pair_tangent(kin, i, j, r_i, r_j, F, D, C, s_ii, s_ij, s_ji, s_jj, Kq, Kv):
    """Add the tangents of a force +F on j at r_j and -F on i at r_i (F in W).

    D = dF/d(p_PQ) and C = dF/d(v_PQ), both 3x3 in W. Slots of the world are trash slots and may be written.
    """
    R_i = load33(kin.R, i)
    R_j = load33(kin.R, j)
    U_i = mm(R_i, skew(r_i))  # d p_P / d theta_i = -U_i; torque of a force on i = -U_i^T F
    U_j = mm(R_j, skew(r_j))
    N_i = mm(R_i, skew(cross(angular_velocity(kin, i), r_i)))  # d v_P / d theta_i = -N_i
    N_j = mm(R_j, skew(cross(angular_velocity(kin, j), r_j)))
    # dF with respect to p_j, theta_j, v_j, w_j and the same for i
    CU_j = mscale(-1.0, mm(C, U_j))
    CU_i = mm(C, U_i)
    DU_j = madd(mscale(-1.0, mm(D, U_j)), mscale(-1.0, mm(C, N_j)))
    DU_i = madd(mm(D, U_i), mm(C, N_i))
    Dm = mscale(-1.0, D)
    Cm = mscale(-1.0, C)
    put33(Kq, s_jj, 0, 0, D)
    put33(Kq, s_jj, 0, 3, DU_j)
    put33(Kq, s_ji, 0, 0, Dm)
    put33(Kq, s_ji, 0, 3, DU_i)
    put33(Kv, s_jj, 0, 0, C)
    put33(Kv, s_jj, 0, 3, CU_j)
    put33(Kv, s_ji, 0, 0, Cm)
    put33(Kv, s_ji, 0, 3, CU_i)
    put33(Kq, s_ij, 0, 0, Dm)
    put33(Kq, s_ij, 0, 3, mscale(-1.0, DU_j))
    put33(Kq, s_ii, 0, 0, D)
    put33(Kq, s_ii, 0, 3, mscale(-1.0, DU_i))
    put33(Kv, s_ij, 0, 0, Cm)
    put33(Kv, s_ij, 0, 3, mscale(-1.0, CU_j))
    put33(Kv, s_ii, 0, 0, C)
    put33(Kv, s_ii, 0, 3, mscale(-1.0, CU_i))
    # torques: on j  -U_j^T dF + r_j x ((R_j^T F) x dtheta_j) ; on i  +U_i^T dF - r_i x ((R_i^T F) x dtheta_i)
    V_j = mscale(-1.0, transpose(U_j))
    V_i = transpose(U_i)
    put33(Kq, s_jj, 3, 0, mm(V_j, D))
    put33(Kq, s_jj, 3, 3, madd(mm(V_j, DU_j), mm(skew(r_j), skew(tmv(R_j, F)))))
    put33(Kq, s_ji, 3, 0, mm(V_j, Dm))
    put33(Kq, s_ji, 3, 3, mm(V_j, DU_i))
    put33(Kv, s_jj, 3, 0, mm(V_j, C))
    put33(Kv, s_jj, 3, 3, mm(V_j, CU_j))
    put33(Kv, s_ji, 3, 0, mm(V_j, Cm))
    put33(Kv, s_ji, 3, 3, mm(V_j, CU_i))
    put33(Kq, s_ij, 3, 0, mm(V_i, D))
    put33(Kq, s_ij, 3, 3, mm(V_i, DU_j))
    put33(Kq, s_ii, 3, 0, mm(V_i, Dm))
    put33(Kq, s_ii, 3, 3, madd(mm(V_i, DU_i), mscale(-1.0, mm(skew(r_i), skew(tmv(R_i, F))))))
    put33(Kv, s_ij, 3, 0, mm(V_i, C))
    put33(Kv, s_ij, 3, 3, mm(V_i, CU_j))
    put33(Kv, s_ii, 3, 0, mm(V_i, Cm))
    put33(Kv, s_ii, 3, 3, mm(V_i, CU_i))
