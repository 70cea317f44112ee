"""Joint coordinates: the scalar displacement along, or rotation about, the z axis of a marker.

Couplers, drivers, torsional springs, drive and brake torques, joint states and anti-roll bars are all written in them.

The rotation is the twist of the swing-twist decomposition of R_FG, so it is defined for any pair of frames, not only
for an exact revolute joint: with quaternion (x, y, z, w) of R_FG, theta = 2 atan2(z, w) and d theta/dt = g . (w_j -
w_i), g = (n_i + n_j)/(1 + n_i . n_j), where n are the z axes of the two markers. It is singular only where the two axes
are opposite. Angles are continued past +-pi from the value of the last step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.so3 import arctan2
from solver.compiled.vec import (
    add,
    add3,
    col,
    cross,
    cross_cross,
    cross_m,
    dot,
    load3,
    load33,
    m_cross,
    madd,
    minus,
    mm,
    mscale,
    mv,
    outer,
    put33,
    put66,
    scale,
    skew,
    sub,
    tmm,
    tmv,
    transpose,
)
from solver.elements.marker import Context, Marker, Spec, compile_pairs
from solver.elements.point_pair import angular_velocity, linear_velocity, point_position, point_velocity
from solver.validate import require

TRANSLATION, ROTATION = 0, 1
TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, kw_only=True)
class CoordinateSpec(Spec):
    """Coordinate of marker j relative to marker i: translation along [m] or rotation about [rad] z of marker i."""

    kind: Literal['translation', 'rotation']
    i: Marker
    j: Marker

    def __post_init__(self) -> None:
        require(
            self.kind in ('translation', 'rotation'), self.where, 'kind', self.kind, 'must be translation or rotation'
        )


class CoordinateTable(NamedTuple):
    """Columns of all joint coordinates."""

    kind: np.ndarray  # (nx,)
    body: np.ndarray  # (nx, 2)
    r_i: np.ndarray  # (nx, 3)
    r_j: np.ndarray  # (nx, 3)
    F: np.ndarray  # (nx, 3, 3) marker axes in body i
    G: np.ndarray  # (nx, 3, 3) marker axes in body j
    slot: np.ndarray  # (nx, 4) blocks ii ij ji jj


def compile_coordinates(specs: Sequence[CoordinateSpec], context: Context) -> CoordinateTable:
    """Resolve names into a table."""
    kind = np.array([ROTATION if s.kind == 'rotation' else TRANSLATION for s in specs], np.int64)
    return CoordinateTable(kind=kind, **compile_pairs(specs, context)._asdict())


@kernel(inline=True)
def _continued(x, before):
    """The angle x, which is known but for whole turns, next to the one before [rad]."""
    return x + TWO_PI * np.round((before - x.real) / TWO_PI)


@kernel(inline=True)
def coordinate_value(table, kin, k, angle):
    """Value of coordinate k; angle (nx,) as for evaluate_coordinate."""
    R_i = load33(kin.R, table.body[k, 0])
    R_j = load33(kin.R, table.body[k, 1])
    F = load33(table.F, k)
    if table.kind[k] == TRANSLATION:
        d = sub(
            point_position(kin, table.body[k, 1], load3(table.r_j, k)),
            point_position(kin, table.body[k, 0], load3(table.r_i, k)),
        )
        return dot(mv(R_i, col(F, 2)), d)
    G = load33(table.G, k)
    x, y = mv(R_i, col(F, 0)), mv(R_i, col(F, 1))
    X, Y = mv(R_j, col(G, 0)), mv(R_j, col(G, 1))
    return _continued(arctan2(dot(y, X) - dot(x, Y), dot(x, X) + dot(y, Y)), angle[k])


@kernel(borrow=True)
def evaluate_coordinate(table, kin, k, angle):
    """Return (x, g_i, g_j): value of coordinate k and its gradients, each a pair (force row in W, torque row in B).

    angle (nx,): reference values for the continuation of rotations (state.angle).
    """
    i = table.body[k, 0]
    j = table.body[k, 1]
    R_i = load33(kin.R, i)
    R_j = load33(kin.R, j)
    x = coordinate_value(table, kin, k, angle)
    n = mv(R_i, col(load33(table.F, k), 2))
    if table.kind[k] == TRANSLATION:
        r_i = load3(table.r_i, k)
        r_j = load3(table.r_j, k)
        D = tmv(R_i, sub(point_position(kin, j, r_j), point_position(kin, i, r_i)))
        g_i = (scale(-1.0, n), cross(tmv(R_i, n), add(D, r_i)))
        g_j = (n, cross(r_j, tmv(R_j, n)))
        return x, g_i, g_j
    m = mv(R_j, col(load33(table.G, k), 2))
    g = scale(1.0 / (1.0 + dot(n, m)), add(n, m))
    zero = scale(0.0, g)
    return x, (zero, scale(-1.0, tmv(R_i, g))), (zero, tmv(R_j, g))


@kernel(borrow=True)
def coordinate_rate(table, kin, k, g_i, g_j):
    """Time derivative of coordinate k from its gradients."""
    i = table.body[k, 0]
    j = table.body[k, 1]
    return (
        dot(g_i[0], linear_velocity(kin, i))
        + dot(g_i[1], angular_velocity(kin, i))
        + dot(g_j[0], linear_velocity(kin, j))
        + dot(g_j[1], angular_velocity(kin, j))
    )


@kernel(inline=True)
def add6(g, h):
    """Sum of two gradients."""
    return add(g[0], h[0]), add(g[1], h[1])


@kernel(inline=True)
def scale6(s, g):
    """Multiple of a gradient."""
    return scale(s, g[0]), scale(s, g[1])


@kernel(inline=True)
def add_gradient(Q, g, b, f):
    """Add the generalized force Q g to body b in f (nb+1, 6)."""
    add3(f, b, 0, scale(Q, g[0]))
    add3(f, b, 3, scale(Q, g[1]))


@kernel(inline=True)
def add_dyad(g, h, slot, K):
    """Add the dyad g h^T of two gradients to a block of K; those of rotations have no force part."""
    if (dot(g[0], g[0]) + dot(h[0], h[0])).real == 0.0:
        put33(K, slot, 3, 3, outer(g[1], h[1]))
    else:
        put66(K, slot, outer(g[0], h[0]), outer(g[0], h[1]), outer(g[1], h[0]), outer(g[1], h[1]))


@kernel(inline=True)
def add_generalized(g, h, n, stiffness, damping, slot, e, Kq, Kv):
    """Add the tangents of a generalized force Q on n gradients g: dQ = -stiffness g - damping h over places, h being
    the gradient of the rate, and -damping g over velocities; slot[e, a, b]: block of row a and column b.
    """
    add_generalized_on(g, g, h, n, stiffness, damping, slot, e, Kq, Kv)


@kernel(inline=True)
def add_generalized_on(rows, g, h, n, stiffness, damping, slot, e, Kq, Kv):
    """The same of a force that acts on the gradients `rows` and changes with those of g and h."""
    for b in range(n):
        if stiffness != 0.0 or damping != 0.0:
            dQ = add6(scale6(-stiffness, g[b]), scale6(-damping, h[b]))
            for a in range(n):
                add_dyad(rows[a], dQ, slot[e, a, b], Kq)
        if damping != 0.0:
            dQ_dv = scale6(-damping, g[b])
            for a in range(n):
                add_dyad(rows[a], dQ_dv, slot[e, a, b], Kv)


@kernel(borrow=True)
def coordinate_rate_gradient(table, kin, k):
    """Return (h_i, h_j): derivative of the rate of coordinate k with respect to the variation, at constant twists;
    pairs as g_i, g_j."""
    i = table.body[k, 0]
    j = table.body[k, 1]
    R_i = load33(kin.R, i)
    R_j = load33(kin.R, j)
    w_i = angular_velocity(kin, i)
    w_j = angular_velocity(kin, j)
    N = col(load33(table.F, k), 2)
    n = mv(R_i, N)
    if table.kind[k] == TRANSLATION:
        # along the axes of B_i: x = N . D and dx/dt = N . (Y - w_i x D) = N . Y + c . D
        r_i = load3(table.r_i, k)
        r_j = load3(table.r_j, k)
        c = cross(w_i, N)
        c_W = mv(R_i, c)
        D = tmv(R_i, sub(point_position(kin, j, r_j), point_position(kin, i, r_i)))
        Y = tmv(R_i, sub(point_velocity(kin, j, r_j), point_velocity(kin, i, r_i)))
        h_i = add(cross(N, add(Y, cross(w_i, r_i))), cross(c, add(D, r_i)))
        h_j = add(cross(cross(w_j, r_j), tmv(R_j, n)), cross(r_j, tmv(R_j, c_W)))
        return (scale(-1.0, c_W), h_i), (c_W, h_j)
    M = col(load33(table.G, k), 2)
    m = mv(R_j, M)
    q = 1.0 / (1.0 + dot(n, m))
    g = scale(q, add(n, m))
    w = sub(mv(R_j, w_j), mv(R_i, w_i))
    # dx/dt = g . w ; dg = q (dn + dm) - q g (m . dn + n . dm)
    gw = dot(g, w)
    h_i = sub(cross(N, tmv(R_i, scale(q, sub(w, scale(gw, m))))), cross(w_i, tmv(R_i, g)))
    h_j = add(cross(M, tmv(R_j, scale(q, sub(w, scale(gw, n))))), cross(w_j, tmv(R_j, g)))
    zero = scale(0.0, g)
    return (zero, h_i), (zero, h_j)


@kernel(borrow=True)
def add_coordinate_hessian(table, kin, k, Q, Kq):
    """Add Q times the derivative of the gradient of coordinate k (with respect to the variation) to the blocks Kq."""
    i = table.body[k, 0]
    j = table.body[k, 1]
    s_ii = table.slot[k, 0]
    s_ij = table.slot[k, 1]
    s_ji = table.slot[k, 2]
    s_jj = table.slot[k, 3]
    R_i = load33(kin.R, i)
    R_j = load33(kin.R, j)
    N = col(load33(table.F, k), 2)
    n = mv(R_i, N)
    if table.kind[k] == TRANSLATION:
        r_i = load3(table.r_i, k)
        r_j = load3(table.r_j, k)
        d = sub(point_position(kin, j, r_j), point_position(kin, i, r_i))
        e = add(tmv(R_i, d), r_i)
        # force on j: Q n, dn = -R_i [N] dtheta_i ; on i: the opposite
        B = mscale(-Q, m_cross(R_i, N))
        put33(Kq, s_ji, 0, 3, B)
        put33(Kq, s_ii, 0, 3, minus(B))
        # torque on j: r_j x R_j^T Q n
        put33(Kq, s_ji, 3, 3, cross_m(r_j, tmm(R_j, B)))
        put33(Kq, s_jj, 3, 3, mscale(Q, cross_cross(r_j, tmv(R_j, n))))
        # torque on i: Q N x (R_i^T d + r_i); d(R_i^T d) = R_i^T (dp_j - U_j dtheta_j - dp_i + U_i dtheta_i) + (R_i^T d)
        # x dtheta_i
        P = mscale(Q, cross_m(N, transpose(R_i)))
        put33(Kq, s_ij, 3, 0, P)
        put33(Kq, s_ij, 3, 3, minus(m_cross(mm(P, R_j), r_j)))
        put33(Kq, s_ii, 3, 0, minus(P))
        put33(Kq, s_ii, 3, 3, mscale(Q, cross_cross(N, e)))
        return
    M = col(load33(table.G, k), 2)
    m = mv(R_j, M)
    q = 1.0 / (1.0 + dot(n, m))
    g = scale(q, add(n, m))
    # dn = -R_i [N] dtheta_i, dm = -R_j [M] dtheta_j ; dg = q (dn + dm) - q g (m . dn + n . dm); along the axes of each
    # body:
    g_i, g_j = tmv(R_i, g), tmv(R_j, g)
    by_i, by_j = cross(N, tmv(R_i, m)), cross(M, tmv(R_j, n))  # m . dn, n . dm
    R_ij = tmm(R_i, R_j)
    Qq = Q * q
    put33(Kq, s_jj, 3, 3, madd(skew(sub(scale(Q, g_j), scale(Qq, M))), outer(scale(-Qq, g_j), by_j)))
    put33(Kq, s_ji, 3, 3, mscale(-Qq, madd(m_cross(transpose(R_ij), N), outer(g_j, by_i))))
    put33(Kq, s_ij, 3, 3, mscale(Qq, madd(m_cross(R_ij, M), outer(g_i, by_j))))
    put33(Kq, s_ii, 3, 3, minus(madd(skew(sub(scale(Q, g_i), scale(Qq, N))), outer(scale(-Qq, g_i), by_i))))
