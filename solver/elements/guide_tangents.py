"""Tangents of a guide: what its forces change by the motions of chassis, wheels and steering (solver.elements.guide)."""

from __future__ import annotations

from solver.compiled.kernel import kernel
from solver.compiled.rows import add_block, mul_rows, rows, scale_rows, sub_rows, transpose_rows
from solver.compiled.vec import add, cross_m, m_cross, madd, minus, outer, put33, scale, skew, transpose
from solver.elements.coordinate import add_dyad, scale6


@kernel(inner=True)
def add_motions(R_c, left, right, ll, lr, rr, lag, damping, slot, e, Kq, Kv):
    """Add to Kq what the wrenches at both wheels and their reaction change by the motions of wheels and chassis, to Kv lag times that and
    the damping (left, between both, right) of the travels.

    ll, lr, rr: blocks (A, B, C, E) of the motions of the wheels relative to the chassis along its axes, force A dD + B dTheta, moment
    C dD + E dTheta, symmetric as a whole. A variation of the chassis is dD = -dp + [D] dtheta, dTheta = -dtheta of both wheels.
    """
    back, L, R = rows(transpose(R_c)), rows(left.R), rows(right.R)
    L_t, R_t = transpose(left.R), transpose(right.R)
    A, B, C, E = lr
    A_t, B_t, C_t, E_t = transpose(A), transpose(C), transpose(B), transpose(E)
    _add_symmetric(_between(R_c, L_t, back, L, ll[0], ll[1], ll[2], ll[3]), slot[e, 1, 1], slot[e, 1, 1], lag, Kq, Kv)
    _add_symmetric(_between(R_c, R_t, back, R, rr[0], rr[1], rr[2], rr[3]), slot[e, 2, 2], slot[e, 2, 2], lag, Kq, Kv)
    _add_symmetric(_between(R_c, L_t, back, R, A, B, C, E), slot[e, 1, 2], slot[e, 2, 1], lag, Kq, Kv)
    # columns of the chassis, along its axes
    pp_l, mp_l = minus(madd(ll[0], A)), minus(madd(ll[2], C))
    pp_r, mp_r = minus(madd(rr[0], A_t)), minus(madd(rr[2], C_t))
    pt_l = madd(_turned(ll[0], left.D, ll[1]), _turned(A, right.D, B))
    mt_l = madd(_turned(ll[2], left.D, ll[3]), _turned(C, right.D, E))
    pt_r = madd(_turned(rr[0], right.D, rr[1]), _turned(A_t, left.D, B_t))
    mt_r = madd(_turned(rr[2], right.D, rr[3]), _turned(C_t, left.D, E_t))
    _add_symmetric(_by_chassis(R_c, L_t, back, pp_l, pt_l, mp_l, mt_l), slot[e, 1, 0], slot[e, 0, 1], lag, Kq, Kv)
    _add_symmetric(_by_chassis(R_c, R_t, back, pp_r, pt_r, mp_r, mt_r), slot[e, 2, 0], slot[e, 0, 2], lag, Kq, Kv)
    turned = madd(madd(cross_m(left.D, pt_l), cross_m(right.D, pt_r)), madd(mt_l, mt_r))
    p, w = mul_rows(R_c, mul_rows(minus(madd(pp_l, pp_r)), back)), mul_rows(R_c, rows(minus(madd(pt_l, pt_r))))
    _add_symmetric((p, w, transpose_rows(w), rows(minus(turned))), slot[e, 0, 0], slot[e, 0, 0], lag, Kq, Kv)
    _add_travels(R_c, left, right, damping, slot, e, Kv)


@kernel(inline=True)
def _add_symmetric(blocks, s, mirrored, lag, Kq, Kv):
    """Add the matrix of A, B, C, E to block s of Kq, lag times it to Kv; transposed to block mirrored, where that is another one."""
    A, B, C, E = blocks
    add_block(Kq, s, 0, A, B)
    add_block(Kq, s, 3, C, E)
    A_lag, B_lag, C_lag, E_lag = scale_rows(lag, A), scale_rows(lag, B), scale_rows(lag, C), scale_rows(lag, E)
    add_block(Kv, s, 0, A_lag, B_lag)
    add_block(Kv, s, 3, C_lag, E_lag)
    if mirrored != s:
        add_block(Kq, mirrored, 0, transpose_rows(A), transpose_rows(C))
        add_block(Kq, mirrored, 3, transpose_rows(B), transpose_rows(E))
        add_block(Kv, mirrored, 0, transpose_rows(A_lag), transpose_rows(C_lag))
        add_block(Kv, mirrored, 3, transpose_rows(B_lag), transpose_rows(E_lag))


@kernel(inline=True)
def _between(R_c, own, back, other, A, B, C, E):
    """The matrix of A, B, C, E between two wheels, which are given along the axes of the chassis."""
    return (
        mul_rows(R_c, mul_rows(A, back)), mul_rows(R_c, mul_rows(B, other)),
        mul_rows(own, mul_rows(C, back)), mul_rows(own, mul_rows(E, other)),
    )  # fmt: skip


@kernel(inline=True)
def _by_chassis(R_c, own, back, A, B, C, E):
    """The same of a wheel and the chassis."""
    return mul_rows(R_c, mul_rows(A, back)), mul_rows(R_c, rows(B)), mul_rows(own, mul_rows(C, back)), mul_rows(own, rows(E))


@kernel(inline=True)
def _add_travels(R_c, left, right, k, slot, e, K):
    """Add to K the matrix k (left, between both, right) of the travels: of a force k ds along z of the chassis."""
    n = (R_c[2], R_c[5], R_c[8])
    c_l, c_r = (left.D[1], -left.D[0], 0.0 * n[0]), (right.D[1], -right.D[0], 0.0 * n[0])  # D x z
    nn = rows(outer(n, n))
    none = sub_rows(nn, nn)
    on_l, on_r = add(scale(k[0], c_l), scale(k[1], c_r)), add(scale(k[1], c_l), scale(k[2], c_r))
    by_l, by_r, by_both = k[0] + k[1], k[1] + k[2], k[0] + 2.0 * k[1] + k[2]
    between = scale_rows(k[1], nn)
    add_block(K, slot[e, 1, 1], 0, scale_rows(k[0], nn), none)
    add_block(K, slot[e, 2, 2], 0, scale_rows(k[2], nn), none)
    add_block(K, slot[e, 1, 2], 0, between, none)
    add_block(K, slot[e, 2, 1], 0, between, none)
    left_, right_ = scale_rows(-by_l, nn), scale_rows(-by_r, nn)
    turn_l, turn_r, turn = rows(outer(n, on_l)), rows(outer(n, on_r)), rows(outer(n, add(on_l, on_r)))
    add_block(K, slot[e, 1, 0], 0, left_, sub_rows(none, turn_l))
    add_block(K, slot[e, 2, 0], 0, right_, sub_rows(none, turn_r))
    add_block(K, slot[e, 0, 1], 0, left_, none)
    add_block(K, slot[e, 0, 2], 0, right_, none)
    add_block(K, slot[e, 0, 1], 3, sub_rows(none, transpose_rows(turn_l)), none)
    add_block(K, slot[e, 0, 2], 3, sub_rows(none, transpose_rows(turn_r)), none)
    add_block(K, slot[e, 0, 0], 0, scale_rows(by_both, nn), turn)
    add_block(K, slot[e, 0, 0], 3, transpose_rows(turn), rows(madd(outer(c_l, on_l), outer(c_r, on_r))))


@kernel(inline=True)
def add_turning(R_c, wheel, turning, s_w, s_wc, s_cw, s_c, K):
    """Add to K what the wrench at a wheel changes because the axes turn that it is given along (`turning` of turning_axes).

    s_w, s_wc, s_cw, s_c: blocks of wheel, wheel by chassis, chassis by wheel, chassis.
    """
    F, own, G = turning
    R, R_t = rows(wheel.R), transpose(wheel.R)
    force = mul_rows(R_c, rows(F))
    back = transpose_rows(force)
    none = sub_rows(R, R)
    add_block(K, s_w, 3, none, mul_rows(R_t, mul_rows(own, R)))
    add_block(K, s_wc, 0, none, sub_rows(none, force))
    add_block(K, s_wc, 3, none, sub_rows(none, mul_rows(R_t, rows(own))))
    add_block(K, s_cw, 3, sub_rows(none, back), sub_rows(none, mul_rows(G, R)))
    add_block(K, s_c, 0, none, force)
    add_block(K, s_c, 3, back, rows(madd(m_cross(F, wheel.D), G)))


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
def with_travels(blocks, more):
    """The blocks of elastic_blocks with more between the travels."""
    A, B, C, E = blocks
    return (A[0], A[1], A[2], A[3], A[4], A[5], A[6], A[7], A[8] + more), B, C, E


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
    and what it feels of the motions of the wheels; tt, as it is: what it feels of itself.
    """
    turns = (scale(factor, g_i[1]), scale(factor, g_j[1]))
    for b in range(2):
        for a in range(3):
            force, moment = outer(g[a][0], turns[b]), outer(g[a][1], turns[b])
            put33(K, slot[e, a, 3 + b], 0, 3, force)
            put33(K, slot[e, a, 3 + b], 3, 3, moment)
            put33(K, slot[e, 3 + b, a], 3, 0, transpose(force))
            put33(K, slot[e, 3 + b, a], 3, 3, transpose(moment))
    for b, turn in ((0, g_i[1]), (1, g_j[1])):
        felt = scale(tt, turn)
        put33(K, slot[e, 3, 3 + b], 3, 3, outer(g_i[1], felt))
        put33(K, slot[e, 4, 3 + b], 3, 3, outer(g_j[1], felt))


@kernel(inline=True)
def add_dyads(g, slot, e, factor, K):
    """Add factor g g' of gradients on the five bodies."""
    for a in range(5):
        for b in range(5):
            add_dyad(g[a], scale6(factor, g[b]), slot[e, a, b], K)
