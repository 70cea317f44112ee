"""Tangents of a guide: what its forces change by the motions of chassis, wheels and steering (solver.elements.guide)."""

from __future__ import annotations

from solver.compiled.kernel import kernel
from solver.compiled.rows import add_block, mul_rows, rows
from solver.compiled.vec import add, cross_m, m_cross, madd, minus, mscale, msub, outer, put33, scale, skew, transpose
from solver.elements.coordinate import add_dyad, scale6


@kernel(inner=True)
def add_motions(R_c, left, right, ll, lr, rr, turn_l, turn_r, slot, e, K):
    """Add to K what the wrenches at both wheels and their reaction change by the motions of wheels and chassis.

    ll, lr, rr: blocks (A, B, C, E) of the motions of the wheels relative to the chassis along its axes, force A dD + B dTheta, moment
    C dD + E dTheta, symmetric as a whole. A variation of the chassis is dD = -dp + [D] dtheta, dTheta = -dtheta of both wheels. turn_l,
    turn_r: of turning_axes.
    """
    back, L, R = rows(transpose(R_c)), rows(left.R), rows(right.R)
    L_t, R_t = transpose(left.R), transpose(right.R)
    F_l, own_l, G_l = turn_l
    F_r, own_r, G_r = turn_r
    A, B, C, E = lr
    A_t, B_t, C_t, E_t = transpose(A), transpose(C), transpose(B), transpose(E)
    _between(K, slot[e, 1, 1], R_c, L_t, back, L, ll[0], ll[1], ll[2], madd(ll[3], own_l))
    _between(K, slot[e, 2, 2], R_c, R_t, back, R, rr[0], rr[1], rr[2], madd(rr[3], own_r))
    _between(K, slot[e, 1, 2], R_c, L_t, back, R, A, B, C, E)
    _between(K, slot[e, 2, 1], R_c, R_t, back, L, A_t, B_t, C_t, E_t)
    # columns of the chassis, along its axes
    pp_l, mp_l = minus(madd(ll[0], A)), minus(madd(ll[2], C))
    pp_r, mp_r = minus(madd(rr[0], A_t)), minus(madd(rr[2], C_t))
    pt_l = madd(_turned(ll[0], left.D, ll[1]), _turned(A, right.D, B))
    mt_l = madd(_turned(ll[2], left.D, ll[3]), _turned(C, right.D, E))
    pt_r = madd(_turned(rr[0], right.D, rr[1]), _turned(A_t, left.D, B_t))
    mt_r = madd(_turned(rr[2], right.D, rr[3]), _turned(C_t, left.D, E_t))
    on_l, on_r = msub(pt_l, F_l), msub(pt_r, F_r)
    _by_chassis(K, slot[e, 1, 0], R_c, L_t, back, pp_l, on_l, mp_l, msub(mt_l, own_l))
    _by_chassis(K, slot[e, 2, 0], R_c, R_t, back, pp_r, on_r, mp_r, msub(mt_r, own_r))
    of_l, of_r = msub(transpose(pt_l), minus(F_l)), msub(transpose(pt_r), minus(F_r))
    _on_chassis(K, slot[e, 0, 1], R_c, back, L, transpose(pp_l), transpose(mp_l), of_l, msub(transpose(mt_l), G_l))
    _on_chassis(K, slot[e, 0, 2], R_c, back, R, transpose(pp_r), transpose(mp_r), of_r, msub(transpose(mt_r), G_r))
    turned = madd(madd(cross_m(left.D, pt_l), cross_m(right.D, pt_r)), madd(mt_l, mt_r))
    turning = madd(madd(m_cross(F_l, left.D), m_cross(F_r, right.D)), madd(G_l, G_r))
    p, w = mul_rows(R_c, mul_rows(minus(madd(pp_l, pp_r)), back)), mul_rows(R_c, rows(minus(madd(on_l, on_r))))
    m = mul_rows(minus(madd(of_l, of_r)), back)
    add_block(K, slot[e, 0, 0], 0, p, w)
    add_block(K, slot[e, 0, 0], 3, m, rows(msub(turning, turned)))


@kernel(inline=True)
def _between(K, s, R_c, own, back, other, A, B, C, E):
    """Add the matrix of A, B, C, E between two wheels, given along the axes of the chassis, to block s."""
    add_block(K, s, 0, mul_rows(R_c, mul_rows(A, back)), mul_rows(R_c, mul_rows(B, other)))
    add_block(K, s, 3, mul_rows(own, mul_rows(C, back)), mul_rows(own, mul_rows(E, other)))


@kernel(inline=True)
def _by_chassis(K, s, R_c, own, back, A, B, C, E):
    """The same of a wheel and the chassis."""
    add_block(K, s, 0, mul_rows(R_c, mul_rows(A, back)), mul_rows(R_c, rows(B)))
    add_block(K, s, 3, mul_rows(own, mul_rows(C, back)), mul_rows(own, rows(E)))


@kernel(inline=True)
def _on_chassis(K, s, R_c, back, other, A, B, C, E):
    """The same of the chassis and a wheel."""
    add_block(K, s, 0, mul_rows(R_c, mul_rows(A, back)), mul_rows(R_c, mul_rows(B, other)))
    add_block(K, s, 3, mul_rows(C, back), mul_rows(E, other))


@kernel(inline=True)
def _turned(A, D, B):
    """A skew(D) - B."""
    X = m_cross(A, D)
    return (X[0] - B[0], X[1] - B[1], X[2] - B[2], X[3] - B[3], X[4] - B[4], X[5] - B[5], X[6] - B[6], X[7] - B[7], X[8] - B[8])


@kernel(inner=True)
def elastic_blocks(K, e, i, j, own, other, k_own, k_other, ss):
    """The blocks (A, B, C, E) of add_motions: -K between wheel i and wheel j (0, 1).

    k_own: K times the slopes over the own travel, its rows of the other wheel j; k_other: over the other's travel, rows of the own wheel i;
    ss: between both travels.
    """
    o, c = 4 * i, 4 * j
    zero = 0.0 * ss
    A = (
        zero - K[e, o, c], zero - K[e, o, c + 1], k_other[0],
        zero - K[e, o + 1, c], zero - K[e, o + 1, c + 1], k_other[1],
        k_own[0], k_own[1], ss,
    )  # fmt: skip
    on_psi = (zero - K[e, o, c + 2], zero - K[e, o + 1, c + 2], k_own[2])
    on_gamma = (zero - K[e, o, c + 3], zero - K[e, o + 1, c + 3], k_own[3])
    B = madd(outer(on_psi, other.p), outer(on_gamma, other.g))
    psi_by = (zero - K[e, o + 2, c], zero - K[e, o + 2, c + 1], k_other[2])
    gamma_by = (zero - K[e, o + 3, c], zero - K[e, o + 3, c + 1], k_other[3])
    C = madd(outer(own.p, psi_by), outer(own.g, gamma_by))
    psi = add(scale(-K[e, o + 2, c + 2], other.p), scale(-K[e, o + 2, c + 3], other.g))
    gamma = add(scale(-K[e, o + 3, c + 2], other.p), scale(-K[e, o + 3, c + 3], other.g))
    return A, B, C, madd(outer(own.p, psi), outer(own.g, gamma))


@kernel(inner=True)
def turning_axes(wheel, F, m, psi, gamma, about):
    """What a wrench (F, m) changes because the axes turn that it is given along, F with the chassis, m with the wheel: (skew(F),
    G + skew(m), G), where G is d(moment)/d(rotation) of a wheel whose generalized forces psi, gamma and moment about the spin axis stay.
    """
    a = wheel.a
    k = 1.0 / (a[0] * a[0] + a[1] * a[1])
    q = a[2] * k
    # d p = P da with p = (-q a_x, -q a_y, 1)
    dq = (-2.0 * q * k * a[0], -2.0 * q * k * a[1], k)
    by_axis = (
        about - psi * (q + a[0] * dq[0]), -psi * a[0] * dq[1] + gamma, -psi * a[0] * dq[2],
        -psi * a[1] * dq[0] - gamma, about - psi * (q + a[1] * dq[1]), -psi * a[1] * dq[2],
        0.0 * k, 0.0 * k, about + 0.0 * k,
    )  # fmt: skip
    G = minus(m_cross(by_axis, a))  # da = -[a] dTheta
    return skew(F), madd(G, skew(m)), G


@kernel(inline=True)
def lagging_blocks(blocks, lag, more):
    """lag times the blocks of elastic_blocks, and more between the travels."""
    A, B, C, E = blocks
    A = mscale(lag, A)
    return (A[0], A[1], A[2], A[3], A[4], A[5], A[6], A[7], A[8] + more), mscale(lag, B), mscale(lag, C), mscale(lag, E)


@kernel(inline=True)
def first4(a):
    return (a[0], a[1], a[2], a[3])


@kernel(inline=True)
def last4(a):
    return (a[4], a[5], a[6], a[7])


@kernel(inline=True)
def own_curvature(held, m, torque, first, k):
    """The second derivative k (see _quantity) of a wheel's map, seen by what it carries over."""
    forces = (held[first] * m[0][k] + held[first + 1] * m[1][k]) + (held[first + 2] * m[2][k] + held[first + 3] * m[3][k])
    return forces + torque * m[4][k]


@kernel(inner=True)
def add_steering(g, tt, g_i, g_j, slot, e, factor, K):
    """Add factor times what wrenches change by the steering, g on chassis, left and right per unit of its rotation with gradients g_i, g_j,
    and what it feels of the motions of the wheels; tt: what it feels of itself.
    """
    turns = (scale(factor, g_i[1]), scale(factor, g_j[1]))
    for b in range(2):
        for a in range(3):
            force, moment = outer(g[a][0], turns[b]), outer(g[a][1], turns[b])
            put33(K, slot[e, a, 3 + b], 0, 3, force)
            put33(K, slot[e, a, 3 + b], 3, 3, moment)
            put33(K, slot[e, 3 + b, a], 3, 0, transpose(force))
            put33(K, slot[e, 3 + b, a], 3, 3, transpose(moment))
    put33(K, slot[e, 3, 3], 3, 3, outer(scale(tt, g_i[1]), turns[0]))
    put33(K, slot[e, 3, 4], 3, 3, outer(scale(tt, g_i[1]), turns[1]))
    put33(K, slot[e, 4, 3], 3, 3, outer(scale(tt, g_j[1]), turns[0]))
    put33(K, slot[e, 4, 4], 3, 3, outer(scale(tt, g_j[1]), turns[1]))


@kernel(inline=True)
def add_dyads(g, slot, e, factor, K):
    """Add factor g g' of gradients on the five bodies."""
    for a in range(5):
        for b in range(5):
            add_dyad(g[a], scale6(factor, g[b]), slot[e, a, b], K)
