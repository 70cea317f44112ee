"""Tangents of a guide: what its forces change by the motions of chassis, wheels and steering
(solver.elements.guide)."""

from __future__ import annotations

from typing import NamedTuple

from solver.compiled.kernel import kernel
from solver.compiled.rows import (
    add_block,
    add_rows,
    combine2,
    cross_rows,
    mul_rows,
    row,
    rows,
    scale_rows,
    sub_rows,
    transpose_rows,
)
from solver.compiled.vec import add, cross, m_cross, madd, minus, mv, outer, put33, scale, skew, sub, tmv, transpose
from solver.elements.coordinate import add_dyad, scale6


class Pair(NamedTuple):
    """Changes of the generalized forces of a wheel by the motions of a wheel (itself or the other one) relative to the
    chassis, along the axes of the chassis: the force by the place (A, 3x3) and by psi and gamma (vectors); those of psi
    and gamma by the place (vectors) and by psi and gamma. Since the whole is symmetric, that of the same two the other
    way round is its transpose.
    """

    A: tuple
    psi: tuple
    gamma: tuple
    of_psi: tuple
    of_gamma: tuple
    psi_psi: float
    psi_gamma: float
    gamma_psi: float
    gamma_gamma: float


@kernel(inner=True)
def pair_of(K, e, i, j, k_own, k_other, ss):
    """The Pair of wheel i by wheel j (0, 1): -K between both.

    k_own: K times the slopes over the own travel, its rows of the other wheel j; k_other: over the other's travel, rows
    of the own wheel i; ss: between both travels.
    """
    o, c = 4 * i, 4 * j
    zero = 0.0 * ss
    A = (
        zero - K[e, o, c], zero - K[e, o, c + 1], k_other[0],
        zero - K[e, o + 1, c], zero - K[e, o + 1, c + 1], k_other[1],
        k_own[0], k_own[1], ss,
    )  # fmt: skip
    return Pair(
        A,
        (zero - K[e, o, c + 2], zero - K[e, o + 1, c + 2], k_own[2]),
        (zero - K[e, o, c + 3], zero - K[e, o + 1, c + 3], k_own[3]),
        (zero - K[e, o + 2, c], zero - K[e, o + 2, c + 1], k_other[2]),
        (zero - K[e, o + 3, c], zero - K[e, o + 3, c + 1], k_other[3]),
        zero - K[e, o + 2, c + 2], zero - K[e, o + 2, c + 3], zero - K[e, o + 3, c + 2], zero - K[e, o + 3, c + 3],
    )  # fmt: skip


@kernel(inline=True)
def _other_way(x):
    """The Pair of the other wheel by this one."""
    return Pair(
        transpose(x.A), x.of_psi, x.of_gamma, x.psi, x.gamma, x.psi_psi, x.gamma_psi, x.psi_gamma, x.gamma_gamma
    )


@kernel(inner=True)
def add_motions(R_c, left, right, ll, lr, rr, lag, damping, slot, e, Kq, Kv):
    """Add to Kq what the wrenches at both wheels and their reaction change by the motions of wheels and chassis, to Kv
    lag times that and the damping (left, between both, right) of the travels. ll, lr, rr: Pairs.

    A variation of the chassis is dD = -dp + [D] dtheta, dTheta = -dtheta of both wheels. The moment at a wheel is psi p
    + gamma g, so what has to do with turning is a sum of two dyads; its columns are along the axes of the body that
    turns.
    """
    back = rows(transpose(R_c))
    turn_l, turn_r = (tmv(left.R, left.p), tmv(left.R, left.g)), (tmv(right.R, right.p), tmv(right.R, right.g))
    on_ll = _between(R_c, back, ll, turn_l, turn_l)
    on_rr = _between(R_c, back, rr, turn_r, turn_r)
    on_lr = _between(R_c, back, lr, turn_l, turn_r)
    _add_symmetric(on_ll, slot[e, 1, 1], slot[e, 1, 1], lag, Kq, Kv)
    _add_symmetric(on_rr, slot[e, 2, 2], slot[e, 2, 2], lag, Kq, Kv)
    _add_symmetric(on_lr, slot[e, 1, 2], slot[e, 2, 1], lag, Kq, Kv)
    # of the chassis: by its place, which moves both wheels back, and by its turning
    A_rl, C_rl = transpose_rows(on_lr[0]), transpose_rows(on_lr[1])
    A_l, A_r = add_rows(on_ll[0], on_lr[0]), add_rows(on_rr[0], A_rl)
    C_l, C_r = add_rows(on_ll[2], on_lr[2]), add_rows(on_rr[2], C_rl)
    force_l, psi_l, gamma_l = _by_turning(ll, lr, left, right)
    force_r, psi_r, gamma_r = _by_turning(rr, _other_way(lr), right, left)
    B_l, B_r = mul_rows(R_c, force_l), mul_rows(R_c, force_r)
    by_l = scale_rows(-1.0, A_l), B_l, scale_rows(-1.0, C_l), _dyads(turn_l[0], psi_l, turn_l[1], gamma_l)
    by_r = scale_rows(-1.0, A_r), B_r, scale_rows(-1.0, C_r), _dyads(turn_r[0], psi_r, turn_r[1], gamma_r)
    _add_symmetric(by_l, slot[e, 1, 0], slot[e, 0, 1], lag, Kq, Kv)
    _add_symmetric(by_r, slot[e, 2, 0], slot[e, 0, 2], lag, Kq, Kv)
    w = scale_rows(-1.0, add_rows(B_l, B_r))
    on_l = add_rows(cross_rows(left.D, force_l), _dyads(left.p, psi_l, left.g, gamma_l))
    on_r = add_rows(cross_rows(right.D, force_r), _dyads(right.p, psi_r, right.g, gamma_r))
    itself = add_rows(A_l, A_r), w, transpose_rows(w), scale_rows(-1.0, add_rows(on_l, on_r))
    _add_symmetric(itself, slot[e, 0, 0], slot[e, 0, 0], lag, Kq, Kv)
    _add_travels(R_c, left, right, damping, slot, e, Kv)


@kernel(inline=True)
def _row(a):
    return row(a[0], a[1], a[2])


@kernel(inline=True)
def _dyads(a, x, b, y):
    """The rows of a x' + b y', of vectors."""
    x, y = _row(x), _row(y)
    return combine2(a[0], x, b[0], y), combine2(a[1], x, b[1], y), combine2(a[2], x, b[2], y)


@kernel(inline=True)
def _between(R_c, back, pair, own, other):
    """The blocks (A, B, C, E) of a Pair: force in W, moment in the own wheel, by the place in W and the turning of the
    other wheel. own, other: d psi and d gamma / d rotation along the axes of the wheels."""
    psi = _plus(pair.psi_psi, other[0], pair.psi_gamma, other[1])
    gamma = _plus(pair.gamma_psi, other[0], pair.gamma_gamma, other[1])
    return (
        mul_rows(R_c, mul_rows(pair.A, back)), _dyads(mv(R_c, pair.psi), other[0], mv(R_c, pair.gamma), other[1]),
        _dyads(own[0], mv(R_c, pair.of_psi), own[1], mv(R_c, pair.of_gamma)), _dyads(own[0], psi, own[1], gamma),
    )  # fmt: skip


@kernel(inline=True)
def _by_turning(same, across, own, other):
    """Changes at a wheel by the turning of the chassis, along the axes of the chassis: rows of the force, vectors of
    psi and gamma."""
    moved = add_rows(mul_rows(same.A, rows(skew(own.D))), mul_rows(across.A, rows(skew(other.D))))
    turned = add_rows(_dyads(same.psi, own.p, same.gamma, own.g), _dyads(across.psi, other.p, across.gamma, other.g))
    psi = sub(
        add(cross(same.of_psi, own.D), cross(across.of_psi, other.D)),
        add(
            _plus(same.psi_psi, own.p, same.psi_gamma, own.g), _plus(across.psi_psi, other.p, across.psi_gamma, other.g)
        ),
    )
    gamma = sub(
        add(cross(same.of_gamma, own.D), cross(across.of_gamma, other.D)),
        add(
            _plus(same.gamma_psi, own.p, same.gamma_gamma, own.g),
            _plus(across.gamma_psi, other.p, across.gamma_gamma, other.g),
        ),
    )
    return sub_rows(moved, turned), psi, gamma


@kernel(inline=True)
def _plus(a, x, b, y):
    """a x + b y."""
    return add(scale(a, x), scale(b, y))


@kernel(inline=True)
def _add_symmetric(blocks, s, mirrored, lag, Kq, Kv):
    """Add the matrix of A, B, C, E to block s of Kq, lag times it to Kv; transposed to block mirrored, where that is
    another one."""
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
    """Add to K what the wrench at a wheel changes because the axes turn that it is given along (`turning` of
    turning_axes).

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


@kernel(inner=True)
def turning_axes(wheel, F, m, psi, gamma, about):
    """Changes of a wrench (F, m) by the turning of the axes along which it is given, F with the chassis, m with the
    wheel: (skew(F), G + skew(m), G), where G is d(moment)/d(rotation) of a wheel whose generalized forces psi, gamma
    and moment about the spin axis stay.
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
def with_travels(x, more):
    """A Pair with more between the travels."""
    A = x.A
    A = (A[0], A[1], A[2], A[3], A[4], A[5], A[6], A[7], A[8] + more)
    return Pair(A, x.psi, x.gamma, x.of_psi, x.of_gamma, x.psi_psi, x.psi_gamma, x.gamma_psi, x.gamma_gamma)


@kernel(inline=True)
def first4(a):
    return (a[0], a[1], a[2], a[3])


@kernel(inline=True)
def last4(a):
    return (a[4], a[5], a[6], a[7])


@kernel(inline=True)
def own_curvature(held, m, torque, first, k):
    """The second derivative k (see _quantity) of a wheel's map, seen by what it carries over."""
    forces = (held[first] * m[0][k] + held[first + 1] * m[1][k]) + (
        held[first + 2] * m[2][k] + held[first + 3] * m[3][k]
    )
    return forces + torque * m[4][k]


@kernel(inner=True)
def add_steering(g, tt, g_i, g_j, slot, e, factor, K):
    """Add factor times what wrenches change by the steering, g on chassis, left and right per unit of its rotation with
    gradients g_i, g_j, and what it feels of the motions of the wheels; tt, as it is: what it feels of itself.
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
