"""Forces of a guide (solver.elements.guide): where both wheels are, what acts on them, and its tangents, phase by
phase.

Both wheels share everything: departures, brakes, drives, steering. Names end in l and r for left and right, and in t
for the steering.
"""

from __future__ import annotations

from typing import NamedTuple

from solver.compiled.kernel import kernel
from solver.compiled.vec import dot, load33
from solver.elements.brake import friction
from solver.elements.coordinate import add_coordinate_hessian, add_gradient, coordinate_rate, evaluate_coordinate
from solver.elements.coordinate_force import limited
from solver.elements.guide_map import map_of
from solver.elements.guide_tangents import (
    add_dyads,
    add_motions,
    add_steering,
    add_turning,
    first4,
    last4,
    own_curvature,
    pair_of,
    turning_axes,
    with_travels,
)
from solver.elements.guide_travel import coupling, cubic, damper_on_travel
from solver.elements.guide_wheel import (
    GuidedWheel,
    dot8,
    eight,
    gradients,
    load8,
    over_travels,
    plus8,
    times8,
    wheel_of,
    wrench,
)
from solver.elements.instant import sums
from solver.elements.laws import evaluate_law

DRIVES = 2  # of a guide at most: one for both wheels (a differential), or one for each


class GuidedAxle(NamedTuple):
    """Both wheels and the steering, in motion."""

    R_c: tuple  # of the chassis
    left: GuidedWheel
    right: GuidedWheel
    s_l: float  # travels [m] and their rates
    s_r: float
    v_l: float
    v_r: float
    sigma: float  # coordinate of the steering, its rate and its gradients on both of its bodies
    sigma_rate: float
    g_i: tuple
    g_j: tuple


class Departed(NamedTuple):
    """Departures of both wheels from their maps."""

    m_l: tuple  # maps (solver.elements.guide_map.map_of)
    m_r: tuple
    by_l: tuple  # slopes of (x, y, psi, gamma) of both wheels over the travels and the steering
    by_r: tuple
    by_t: tuple
    delta: tuple  # departures, their rates, K delta and K delta'
    rate: tuple
    elastic: tuple
    lagging: tuple


class Braked(NamedTuple):
    """Brakes, and drives on carriers."""

    w_l: tuple  # by which departures turn the carriers
    w_r: tuple
    carrier_l: float  # rates of the turns of the carriers [rad/s]
    carrier_r: float
    t_l: float  # torques of the brakes [N m]
    t_r: float
    p_l: float  # torques on the carriers
    p_r: float
    drive_l: float
    drive_r: float
    z_l: float  # wind-ups
    z_r: float
    slope_l: float  # of the torques over the rates
    slope_r: float
    lost_l: float  # [W]
    lost_r: float


class Sprung(NamedTuple):
    """Springs and dampers: forces on the travels and on the steering, with slopes."""

    U: tuple  # of solver.elements.guide_travel.coupling
    P_l: tuple  # of its cubic
    P_r: tuple
    spring_l: float
    spring_r: float
    spring_t: float
    rise_l: float
    rise_r: float
    rise_t: float
    stored_l: float  # [J]
    stored_r: float
    stored_t: float
    damper_l: tuple  # of its damper_on_travel
    damper_r: tuple
    d_l: float  # forces of the dampers on the travels
    d_r: float
    damper_t: float
    rise_dt: float


class Loads(NamedTuple):
    """Generalized forces and wrenches."""

    held: tuple  # what the map carries over to travels and steering
    q_t: float
    on_l: tuple  # wrenches on the wheels
    on_r: tuple


@kernel(inline=True)
def _axle(table, now, e):
    """The GuidedAxle of guide e."""
    coordinates, kin = now.coordinates, now.kin
    R_c = load33(kin.R, table.body[e, 0])
    left, right = wheel_of(table, kin, e, 0), wheel_of(table, kin, e, 1)
    zero = 0.0 * left.D[0]
    sigma, sigma_rate = zero, zero
    g_i, g_j = ((zero, zero, zero), (zero, zero, zero)), ((zero, zero, zero), (zero, zero, zero))
    if table.steering[e] >= 0:
        sigma, g_i, g_j = evaluate_coordinate(coordinates, kin, table.steering[e], now.angle)
        sigma_rate = coordinate_rate(coordinates, kin, table.steering[e], g_i, g_j)
    return GuidedAxle(R_c, left, right, left.x[2], right.x[2], left.rate[2], right.rate[2], sigma, sigma_rate, g_i, g_j)


@kernel(inline=True)
def _departed(table, e, at, tangents):
    """The Departed of guide e."""
    left, right = at.left, at.right
    m_l = map_of(table, e, 0, at.s_l, at.s_r, at.sigma, tangents)
    m_r = map_of(table, e, 1, at.s_r, at.s_l, at.sigma, tangents)
    by_l, by_r = over_travels(m_l, m_r)
    by_t = eight(m_l, m_r, 3)
    there = (left.x[0], left.x[1], left.x[3], left.x[4], right.x[0], right.x[1], right.x[3], right.x[4])
    delta = plus8(there, -1.0, eight(m_l, m_r, 0))
    moving = (
        left.rate[0],
        left.rate[1],
        left.rate[3],
        left.rate[4],
        right.rate[0],
        right.rate[1],
        right.rate[3],
        right.rate[4],
    )
    rate = plus8(plus8(plus8(moving, -at.v_l, by_l), -at.v_r, by_r), -at.sigma_rate, by_t)
    return Departed(m_l, m_r, by_l, by_r, by_t, delta, rate, times8(table.K, e, delta), times8(table.K, e, rate))


@kernel(inner=True)
def _theta_rate(table, side, m, s_rate, o_rate, sigma_rate, delta_rate):
    """Rate of the turn of a carrier about the spin axis [rad/s]."""
    w = table.windup[side]
    own = ((w[0] * delta_rate[0] + w[1] * delta_rate[1]) + (w[2] * delta_rate[2] + w[3] * delta_rate[3])) + (
        (w[4] * delta_rate[4] + w[5] * delta_rate[5]) + (w[6] * delta_rate[6] + w[7] * delta_rate[7])
    )
    return m[1] * s_rate + m[2] * o_rate + m[3] * sigma_rate + own


@kernel(inner=True)
def _driven(table, row, applied, spin_l, spin_r):
    """The torques of a drive on the left and the right wheel at their turns against the chassis."""
    factor_l, factor_r = table.drives[row, 0], table.drives[row, 1]
    Q, _ = limited(table.drives[row, 2] * applied, factor_l * spin_l + factor_r * spin_r, table.drives[row, 3])
    return factor_l * Q, factor_r * Q


@kernel(inline=True)
def _braked(table, now, e, at, off):
    """The Braked of guide e."""
    n, k = table.state[e], table.stiffness[e]
    applied, driving = max(now.u[table.input[e]], 0.0), now.u[table.drive[e]]
    spin_l, spin_r = dot(at.left.a, at.left.turn), dot(at.right.a, at.right.turn)
    carrier_l = _theta_rate(table, 2 * e, off.m_l[4], at.v_l, at.v_r, at.sigma_rate, off.rate)
    carrier_r = _theta_rate(table, 2 * e + 1, off.m_r[4], at.v_r, at.v_l, at.sigma_rate, off.rate)
    turn_l, turn_r = spin_l - carrier_l, spin_r - carrier_r
    first_l, first_r = _driven(table, DRIVES * e, driving, spin_l, spin_r)
    second_l, second_r = _driven(table, DRIVES * e + 1, driving, spin_l, spin_r)
    drive_l, drive_r = first_l + second_l, first_r + second_r
    z_l, t_l, slope_l, lost_l = friction(now.zp[n], now.cz, turn_l, table.gain[e, 0] * applied, k, table.damping[e])
    z_r, t_r, slope_r, lost_r = friction(now.zp[n + 1], now.cz, turn_r, table.gain[e, 1] * applied, k, table.damping[e])
    w_l, w_r = load8(table.windup, 2 * e), load8(table.windup, 2 * e + 1)
    p_l, p_r = t_l - drive_l, t_r - drive_r
    return Braked(
        w_l, w_r, carrier_l, carrier_r, t_l, t_r, p_l, p_r, drive_l, drive_r, z_l, z_r, slope_l, slope_r, lost_l, lost_r
    )  # fmt: skip


@kernel(inline=True)
def _sprung(table, now, e, at):
    """The Sprung of guide e."""
    n, left, right = table.state[e], 2 * e, 2 * e + 1
    spring_l, rise_l, stored_l = evaluate_law(now.laws, table.law[left, 0], at.s_l)
    spring_r, rise_r, stored_r = evaluate_law(now.laws, table.law[right, 0], at.s_r)
    U = coupling(table.coupling[e], at.s_l, at.s_r)
    spring_t, rise_t, stored_t = evaluate_law(now.laws, table.gear[e, 0], at.sigma)
    damper_t, rise_dt, _ = evaluate_law(now.laws, table.gear[e, 1], at.sigma_rate)
    P_l, P_r = cubic(table.jacking[left], at.s_l), cubic(table.jacking[right], at.s_r)
    damper_l = damper_on_travel(table, now.laws, left, at.s_l, at.v_l, at.v_r, now.zp[n + 2], now.cz)
    damper_r = damper_on_travel(table, now.laws, right, at.s_r, at.v_r, at.v_l, now.zp[n + 3], now.cz)
    d_l, d_r = damper_l[0] + damper_r[1], damper_r[0] + damper_l[1]
    return Sprung(
        U, P_l, P_r, spring_l, spring_r, spring_t, rise_l, rise_r, rise_t, stored_l, stored_r, stored_t,
        damper_l, damper_r, d_l, d_r, damper_t, rise_dt,
    )  # fmt: skip


@kernel(inline=True)
def _loads(table, e, at, off, brakes, springs):
    """The Loads of guide e."""
    m_l, m_r, p_l, p_r = off.m_l, off.m_r, brakes.p_l, brakes.p_r
    force = plus8(off.elastic, table.lag[e], off.lagging)
    held = plus8(plus8(force, -p_l, brakes.w_l), -p_r, brakes.w_r)
    by_l, by_r, by_t = off.by_l, off.by_r, off.by_t
    U, P_l, P_r = springs.U, springs.P_l, springs.P_r
    q_l = (
        dot8(held, by_l)
        + (p_l * m_l[4][1] + p_r * m_r[4][2])
        - springs.spring_l
        - U[1]
        + springs.d_l
        - at.sigma * P_l[1]
    )
    q_r = (
        dot8(held, by_r)
        + (p_l * m_l[4][2] + p_r * m_r[4][1])
        - springs.spring_r
        - U[2]
        + springs.d_r
        - at.sigma * P_r[1]
    )
    q_t = (
        dot8(held, by_t) + (p_l * m_l[4][3] + p_r * m_r[4][3]) - (P_l[0] + P_r[0]) - springs.spring_t - springs.damper_t
    )
    on_l = wrench(at.left, -held[0], -held[1], q_l, -held[2], -held[3], -brakes.t_l)
    on_r = wrench(at.right, -held[4], -held[5], q_r, -held[6], -held[7], -brakes.t_r)
    return Loads(held, q_t, on_l, on_r)


@kernel(inline=True)
def _add_loads(table, e, at, loads, f):
    """Accumulate the forces on all five bodies."""
    zero = 0.0 * at.left.D[0]
    g = gradients(at.R_c, at.left, at.right, loads.on_l, loads.on_r, loads.q_t, at.g_i, at.g_j)
    for b in range(5):
        add_gradient(1.0 + zero, g[b], table.body[e, b], f)


@kernel(inline=True)
def _add_motions(table, e, at, off, brakes, springs, loads, Kq, Kv):
    """Accumulate what changes with the motions of the wheels against the chassis, and as the axes of the wrenches
    turn."""
    m_l, m_r, p_l, p_r, held, lag = off.m_l, off.m_r, brakes.p_l, brakes.p_r, loads.held, table.lag[e]
    U, P_l, P_r, damper_l, damper_r = springs.U, springs.P_l, springs.P_r, springs.damper_l, springs.damper_r
    K, slots = table.K, table.slot
    k_l, k_r = times8(K, e, off.by_l), times8(K, e, off.by_r)
    ll, mix, rr = -dot8(off.by_l, k_l), -dot8(off.by_l, k_r), -dot8(off.by_r, k_r)
    curved_l = own_curvature(held, m_l, p_l, 0, 4) + own_curvature(held, m_r, p_r, 4, 8)
    curved_r = own_curvature(held, m_r, p_r, 4, 4) + own_curvature(held, m_l, p_l, 0, 8)
    more_l = curved_l - springs.rise_l - U[3] + damper_l[2] - at.sigma * P_l[2]
    more_r = curved_r - springs.rise_r - U[5] + damper_r[2] - at.sigma * P_r[2]
    more = own_curvature(held, m_l, p_l, 0, 5) + own_curvature(held, m_r, p_r, 4, 5) - U[4]
    on_ll = with_travels(pair_of(K, e, 0, 0, first4(k_l), first4(k_l), ll), more_l)
    on_lr = with_travels(pair_of(K, e, 0, 1, last4(k_l), first4(k_r), mix), more)
    on_rr = with_travels(pair_of(K, e, 1, 1, last4(k_r), last4(k_r), rr), more_r)
    c_l, c_r = table.crossing[2 * e], table.crossing[2 * e + 1]
    rise_l, ratio_l, rise_r, ratio_r = damper_l[3], damper_l[4], damper_r[3], damper_r[4]
    d_ll = -ratio_l * ratio_l * rise_l - c_r * c_r * rise_r
    d_rr = -ratio_r * ratio_r * rise_r - c_l * c_l * rise_l
    d_lr = -ratio_l * c_l * rise_l - ratio_r * c_r * rise_r
    damping = (d_ll - lag * more_l, d_lr - lag * more, d_rr - lag * more_r)
    add_motions(at.R_c, at.left, at.right, on_ll, on_lr, on_rr, lag, damping, slots, e, Kq, Kv)
    turn_l = turning_axes(at.left, loads.on_l[0], loads.on_l[1], -held[2], -held[3], -brakes.t_l)
    turn_r = turning_axes(at.right, loads.on_r[0], loads.on_r[1], -held[6], -held[7], -brakes.t_r)
    add_turning(at.R_c, at.left, turn_l, slots[e, 1, 1], slots[e, 1, 0], slots[e, 0, 1], slots[e, 0, 0], Kq)
    add_turning(at.R_c, at.right, turn_r, slots[e, 2, 2], slots[e, 2, 0], slots[e, 0, 2], slots[e, 0, 0], Kq)


@kernel(inline=True)
def _by_steering(at, k, lt, rt):
    """The gradients of what the steering changes: k, K times its slopes, and lt, rt on the travels."""
    zero = 0.0 * at.left.D[0]
    on_l = wrench(at.left, k[0], k[1], lt, k[2], k[3], 0.0)
    on_r = wrench(at.right, k[4], k[5], rt, k[6], k[7], 0.0)
    g = gradients(at.R_c, at.left, at.right, on_l, on_r, zero, at.g_i, at.g_j)
    return g[0], g[1], g[2]


@kernel(inline=True)
def _add_steering(table, now, e, at, off, brakes, springs, loads, Kq, Kv):
    """Accumulate what changes with the steering, and what it feels of the wheels."""
    m_l, m_r, p_l, p_r, held, lag = off.m_l, off.m_r, brakes.p_l, brakes.p_r, loads.held, table.lag[e]
    k = times8(table.K, e, off.by_t)
    lt, rt, tt = -dot8(off.by_l, k), -dot8(off.by_r, k), -dot8(off.by_t, k)
    g = _by_steering(at, k, lt, rt)
    add_steering(g, lag * tt - springs.rise_dt, at.g_i, at.g_j, table.slot, e, lag, Kv)
    lt = lt + own_curvature(held, m_l, p_l, 0, 6) + own_curvature(held, m_r, p_r, 4, 9) - springs.P_l[1]
    rt = rt + own_curvature(held, m_r, p_r, 4, 6) + own_curvature(held, m_l, p_l, 0, 9) - springs.P_r[1]
    tt = tt + own_curvature(held, m_l, p_l, 0, 7) + own_curvature(held, m_r, p_r, 4, 7) - springs.rise_t
    g = _by_steering(at, k, lt, rt)
    add_steering(g, tt, at.g_i, at.g_j, table.slot, e, 1.0, Kq)
    add_coordinate_hessian(now.coordinates, now.kin, table.steering[e], loads.q_t, Kq)


@kernel(inline=True)
def _add_brakes(table, e, at, off, brakes, Kv):
    """Accumulate what changes with the rates at which stuck brakes are wound up."""
    w_l, w_r, m_l, m_r, slots = brakes.w_l, brakes.w_r, off.m_l, off.m_r, table.slot
    if brakes.slope_l > 0.0:
        own = wrench(at.left, -w_l[0], -w_l[1], dot8(w_l, off.by_l) - m_l[4][1], -w_l[2], -w_l[3], 1.0)
        other = wrench(at.right, -w_l[4], -w_l[5], dot8(w_l, off.by_r) - m_l[4][2], -w_l[6], -w_l[7], 0.0)
        by_t = dot8(w_l, off.by_t) - m_l[4][3]
        add_dyads(gradients(at.R_c, at.left, at.right, own, other, by_t, at.g_i, at.g_j), slots, e, -brakes.slope_l, Kv)
    if brakes.slope_r > 0.0:
        other = wrench(at.left, -w_r[0], -w_r[1], dot8(w_r, off.by_l) - m_r[4][2], -w_r[2], -w_r[3], 0.0)
        own = wrench(at.right, -w_r[4], -w_r[5], dot8(w_r, off.by_r) - m_r[4][1], -w_r[6], -w_r[7], 1.0)
        by_t = dot8(w_r, off.by_t) - m_r[4][3]
        add_dyads(gradients(at.R_c, at.left, at.right, other, own, by_t, at.g_i, at.g_j), slots, e, -brakes.slope_r, Kv)


@kernel(inline=True)
def _show(table, e, at, off, brakes, springs, loads, z, out):
    """Assign internal states and outputs."""
    n, left, right = table.state[e], at.left, at.right
    z_l, z_r, damper_l, damper_r = brakes.z_l, brakes.z_r, springs.damper_l, springs.damper_r
    z[n], z[n + 1], z[n + 2], z[n + 3] = z_l, z_r, damper_l[7], damper_r[7]
    wound = 0.5 * table.stiffness[e] * (z_l * z_l + z_r * z_r)
    stored = 0.5 * dot8(off.delta, off.elastic) + springs.stored_l + springs.stored_r + springs.U[0]
    out[e, 0] = stored + wound + damper_l[6] + damper_r[6]
    out[e, 0] += at.sigma * (springs.P_l[0] + springs.P_r[0]) + springs.stored_t
    lost = table.lag[e] * dot8(off.rate, off.lagging) + damper_l[5] + damper_r[5] + brakes.lost_l + brakes.lost_r
    out[e, 1] = lost + springs.damper_t * at.sigma_rate
    out[e, 1] += brakes.drive_l * brakes.carrier_l + brakes.drive_r * brakes.carrier_r
    out[e, 2], out[e, 3], out[e, 4] = left.x[3], left.x[4], -springs.spring_l - springs.U[1]
    out[e, 5], out[e, 6], out[e, 7] = right.x[3], right.x[4], -springs.spring_r - springs.U[2]
    out[e, 8], out[e, 9], out[e, 10] = springs.d_l, z_l, -brakes.t_l
    out[e, 11], out[e, 12], out[e, 13] = springs.d_r, z_r, -brakes.t_r
    out[e, 14] = loads.q_t
    out[e, 15] = -springs.spring_t - springs.damper_t


@kernel(borrow=True)
def guide_forces(table, now, effects, out):
    """Accumulate forces and tangents of all guides, assign their internal states (contract:
    solver/elements/__init__.py)."""
    f, Kq, Kv = sums(effects)
    for e in range(table.state.shape[0]):
        at = _axle(table, now, e)
        off = _departed(table, e, at, now.tangents)
        brakes = _braked(table, now, e, at, off)
        springs = _sprung(table, now, e, at)
        loads = _loads(table, e, at, off, brakes, springs)
        _add_loads(table, e, at, loads, f)
        if now.tangents:
            _add_motions(table, e, at, off, brakes, springs, loads, Kq, Kv)
            if table.steering[e] >= 0:
                _add_steering(table, now, e, at, off, brakes, springs, loads, Kq, Kv)
            _add_brakes(table, e, at, off, brakes, Kv)
        _show(table, e, at, off, brakes, springs, loads, effects.z, out)
