"""Guide: an axle of two wheels whose places follow smooth maps over travel, travel of the other wheel and steering, and give elastically.

What arms, links, rubbers and rack do to two wheels, as force between them and the chassis; none of these parts is a body. Of each wheel,
relative to the chassis and along its axes:

    x, y    wheel centre from its place in the design position [m]         s = z    travel [m]
    psi     turn of the spin axis about z, arctan(-a_x/a_y) [rad]          gamma    its lift, a_z [-]

The wheel turns about its axis freely. Unloaded it stands at (X, Y, Psi, Gamma)(s, o, sigma), with the travel o of the other wheel and the
rotation sigma that steers; delta (8,) are the departures of both wheels from there. With the energy

    U = 1/2 delta' K delta + spring_l(s_l) + spring_r(s_r) + s_l s_r (c_0 + c_1 (s_l + s_r) + c_2 (s_l^2 + s_r^2) + c_3 s_l s_r)
        + sigma (P_l(s_l) + P_r(s_r)) + gear(sigma)

all forces are its gradient: the map carries a load at the wheel to the travel (its slope X_s is the anti-dive of the wheel centre) and to
the steering (its slope over sigma is what the driver feels). P, a cubic without a constant, is the torque of springs that steering
winds up, and what it shifts of their load; the steering gear has springs and dampers of its own. K lags: it acts on delta + lag
d(delta)/dt. A damper of the length L(s) + c o pulls the travel with the force -F L', and the other wheel of a dependent axle with -F c. It
stands on a mount k, which takes the part w = F/k of its way, an internal state:

    F = law(L' ds/dt + c do/dt - dw/dt),     k = 0: F = law(L' ds/dt + c do/dt)

A brake acts between the wheel and its carrier (the law of solver.elements.brake), whose turn about the spin axis is

    theta = Theta(s, o, sigma) + w' delta

so a braked wheel lifts or lowers the chassis and winds its suspension up. A drive between wheels and what carries them (a motor in the hub,
the differential of a live axle) turns that back alike: of its torque Q on the sum of factors times the turns of the wheels (the input under
the limiter of solver.elements.coordinate_force, which acts on the wheels themselves) the part -factor Q is on theta. Maps are cubic
B-splines, continued linearly, and cubic in o, that of Theta too:

    Q(s, o, sigma) = Q(s, 0, sigma) + o (b_0 + b_1 s + b_2 o + b_3 s^2 + b_4 s o + b_5 o^2 + b_6 sigma)

All is measured on a bench: solver.levels.kc.

Tangents are exact at rest, and over velocities; left out is how rates change with the position, which is of the order of rate times lag,
and what a limiter that fades takes from theta.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel, sixes
from solver.compiled.vec import dot, load33
from solver.dimensions import Point, Stiffness, Time, TurnDamping, TurnStiffness
from solver.elements.brake import HOLD, RELEASED, friction
from solver.elements.coordinate import add_coordinate_hessian, add_gradient, coordinate_rate, evaluate_coordinate
from solver.elements.coordinate_force import limited
from solver.elements.guide_map import BESIDE, COLUMNS, QUANTITIES, Nodes, map_of
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
from solver.elements.guide_wheel import dot8, eight, gradients, load8, over_travels, plus8, times8, wheel_of, wrench
from solver.elements.kind import ForceKind, Held
from solver.elements.laws import Law, evaluate_law
from solver.elements.marker import Context, Marker, Spec, slots
from solver.validate import Vector, finite, require

SIDES = ('left', 'right')
OUTPUTS = {
    'energy': 'J',
    'dissipation': 'W',
    **{f'{name}_{side}': unit for side in SIDES for name, unit in (('steer', 'rad'), ('camber', ''), ('spring_force', 'N'))},
    **{f'{name}_{side}': unit for side in SIDES for name, unit in (('damper_force', 'N'), ('windup', 'rad'), ('brake_torque', 'N m'))},
    'steering_torque': 'N m',
    'gear_torque': 'N m',
}
STATES = 4
DRIVES = 2
SYMMETRIC = 1e-9  # relative: what rounding may leave of the difference of a stiffness and its transpose


@dataclass(frozen=True, kw_only=True)
class GuideSpec(Spec):
    """The guide of an axle; made by the level kc of a vehicle, see the module.

    chassis, left, right: bodies; the reference frames of the wheels are at their centres of mass, which are the wheel centres. centers:
    these in the chassis, in the design position [m]. axes: spin axes in the wheels. travel, steering: nodes (first, step, count) of the
    maps [m], [unit of the coordinate]. shape: coefficients of the maps, over side, travel, steering, quantity (x, y, psi, gamma, theta);
    opposite: b_0 ... b_6 over side, quantity. coordinate: the rotation that steers. stiffness: K (8, 8) over (x, y, psi, gamma) of left
    and right. lag [s]. windup: w over side, (8,). springs: force against travel of either side; coupling: c_0 ... c_3;
    jacking: coefficients of P over side. gear: laws of the torque of springs over the coordinate, of dampers over its rate [N m]. dampers:
    laws of either side;
    ratios: coefficients of the powers of s in L', over side; crossings: c of either side. mounts: their k [N/m], 0 for none; yields: with
    a mount the inverse of the damper's law, rate over force. wheels: coordinates of the turning wheels, to show the brake torque at.
    input: of the brakes; shares of either wheel in it; brake_stiffness [N m/rad], brake_damping [N m s/rad] of a stuck wheel.
    drive: input of what drives the wheels from their carriers [N m]; drives: up to two, (factor of the left wheel, of the right one, gain
    of the input, rate at which it ends [rad/s] or 0).
    """

    chassis: str
    left: str
    right: str
    centers: tuple[Point, Point]
    axes: tuple[Vector, Vector] = ((0.0, 1.0, 0.0), (0.0, 1.0, 0.0))
    travel: tuple[float, float, int]
    steering: tuple[float, float, int] = (0.0, 1.0, 1)
    shape: tuple[float, ...]
    opposite: tuple[float, ...] = (0.0,) * 10 * BESIDE
    coordinate: str | None = None
    stiffness: tuple[float, ...]
    lag: Time = 0.0
    windup: tuple[float, ...] = (0.0,) * 16
    springs: tuple[Law, Law]
    coupling: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    jacking: tuple[float, ...] = (0.0,) * 6
    gear: tuple[Law | None, Law | None] = (None, None)
    dampers: tuple[Law, Law]
    ratios: tuple[float, ...]
    crossings: tuple[float, float] = (0.0, 0.0)
    mounts: tuple[Stiffness, Stiffness] = (0.0, 0.0)
    yields: tuple[Law, Law] | None = None
    wheels: tuple[str, str]
    input: str
    shares: tuple[float, float]
    brake_stiffness: TurnStiffness
    brake_damping: TurnDamping = 0.0
    drive: str | None = None
    drives: tuple[tuple[float, float, float, float], ...] = ()

    def __post_init__(self) -> None:
        where = self.where
        for name, nodes in (('travel', self.travel), ('steering', self.steering)):
            require(nodes[1] > 0.0 and nodes[2] >= 1, where, name, nodes, 'must be (first, step > 0, count >= 1)')
        require(self.travel[2] > 1, where, 'travel', self.travel, 'needs two nodes or more')
        require(self.coordinate is not None or self.steering[2] == 1, where, 'steering', self.steering, 'needs a coordinate')
        require(self.coordinate is not None or not any(self.gear), where, 'gear', self.gear, 'needs a coordinate')
        count = 2 * Nodes(*self.travel).coefficients * Nodes(*self.steering).coefficients * len(QUANTITIES)
        lengths = {'shape': count, 'opposite': 10 * BESIDE, 'stiffness': 64, 'windup': 16, 'jacking': 6, 'ratios': 10}
        for name, length in lengths.items():
            values = getattr(self, name)
            require(len(values) == length, where, name, len(values), f'must be {length} numbers')
            self.set(name, tuple(finite(where, name, v) for v in values))
        K = np.array(self.stiffness).reshape(8, 8)
        apart, largest = float(np.abs(K - K.T).max()), float(np.abs(K).max())
        require(apart <= SYMMETRIC * largest, where, 'stiffness', apart, 'is how far it is from its transpose; it must be symmetric')
        self.set('crossings', tuple(finite(where, 'crossings', c) for c in self.crossings))
        self.set('mounts', tuple(finite(where, 'mounts', k, low=0.0) for k in self.mounts))
        require(self.yields is not None or not any(self.mounts), where, 'yields', self.yields, 'is needed with mounts')
        self.set('lag', finite(where, 'lag', self.lag, low=0.0))
        self.set('brake_stiffness', finite(where, 'brake_stiffness', self.brake_stiffness, low=0.0, strict=True))
        self.set('brake_damping', finite(where, 'brake_damping', self.brake_damping, low=0.0))
        require(len(self.drives) <= DRIVES, where, 'drives', len(self.drives), f'must be {DRIVES} at most')
        require(self.drive is not None or not self.drives, where, 'drive', self.drive, 'is needed with drives')
        self.set('drives', tuple(tuple(finite(where, 'drives', x) for x in one) for one in self.drives))


class GuideTable(NamedTuple):
    """Columns of all guides. Bodies are chassis, left, right, and the two of the steering coordinate (the world without one)."""

    body: np.ndarray  # (n, 5)
    slot: np.ndarray  # (n, 5, 5)
    origin: np.ndarray  # (2 n, 3) wheel centres in the design position from the centre of mass of the chassis, along its axes [m]
    axis: np.ndarray  # (2 n, 3) spin axes in the wheels
    nodes: np.ndarray  # (n, 4) first and step of travel and steering
    number: np.ndarray  # (n, 2) of them
    start: np.ndarray  # (2 n,) first row in shape of either side
    shape: np.ndarray  # (rows, COLUMNS)
    opposite: np.ndarray  # (2 n, 5, 7)
    steering: np.ndarray  # (n,) coordinate, -1 for none
    K: np.ndarray  # (n, 8, 9), its last column empty (solver.compiled.rows)
    lag: np.ndarray  # (n,)
    windup: np.ndarray  # (2 n, 8)
    law: np.ndarray  # (2 n, 3) spring, damper, its inverse
    gear: np.ndarray  # (n, 2) laws of springs and dampers of the steering
    mount: np.ndarray  # (2 n,)
    coupling: np.ndarray  # (n, 4)
    jacking: np.ndarray  # (2 n, 3)
    ratio: np.ndarray  # (2 n, 5)
    crossing: np.ndarray  # (2 n,)
    coordinate: np.ndarray  # (n, 3) that efforts are shown at: the turning wheels, steering
    state: np.ndarray  # (n,) wind-up of the left brake; that of the right one and both mounts follow
    input: np.ndarray  # (n,)
    gain: np.ndarray  # (n, 2)
    stiffness: np.ndarray  # (n,) of a stuck brake
    damping: np.ndarray  # (n,)
    drive: np.ndarray  # (n,) input
    drives: np.ndarray  # (DRIVES n, 4), zeros for those that there are not


def _padded(values: Sequence[float], columns: int, wanted: int) -> np.ndarray:
    """Rows of so many columns as rows of more, zeros in the new ones."""
    return np.pad(np.array(values, float).reshape(-1, columns), ((0, 0), (0, wanted - columns)))


def compile_guides(specs: Sequence[GuideSpec], context: Context) -> GuideTable:
    """Resolve names and laws into a table."""
    n = len(specs)
    rows = [Nodes(*s.travel).coefficients * Nodes(*s.steering).coefficients for s in specs for _ in SIDES]
    table = GuideTable(
        body=np.full((n, 5), context.n_bodies, np.int64),
        slot=np.zeros((n, 5, 5), np.int64),
        origin=np.zeros((2 * n, 3)),
        axis=np.array([a for s in specs for a in s.axes], float).reshape(-1, 3),
        nodes=np.array([[*s.travel[:2], *s.steering[:2]] for s in specs], float).reshape(-1, 4),
        number=np.array([[s.travel[2], s.steering[2]] for s in specs], np.int64).reshape(-1, 2),
        start=np.array([0, *np.cumsum(rows)[:-1]] if rows else [], np.int64),
        shape=_padded([v for s in specs for v in s.shape], len(QUANTITIES), COLUMNS),
        opposite=np.array([s.opposite for s in specs], float).reshape(2 * n, 5, BESIDE),
        steering=np.full(n, -1, np.int64),
        K=_padded([v for s in specs for v in s.stiffness], 8, 9).reshape(-1, 8, 9),
        lag=np.array([s.lag for s in specs], float),
        windup=np.array([s.windup for s in specs], float).reshape(-1, 8),
        law=np.zeros((2 * n, 3), np.int64),
        gear=np.array([[context.law(law) for law in s.gear] for s in specs], np.int64).reshape(-1, 2),
        mount=np.array([k for s in specs for k in s.mounts], float),
        coupling=np.array([s.coupling for s in specs], float).reshape(-1, 4),
        jacking=np.array([s.jacking for s in specs], float).reshape(-1, 3),
        ratio=np.array([s.ratios for s in specs], float).reshape(-1, 5),
        crossing=np.array([c for s in specs for c in s.crossings], float),
        coordinate=np.full((n, 3), -1, np.int64),
        state=np.zeros(n, np.int64),
        input=np.zeros(n, np.int64),
        gain=np.array([s.shares for s in specs], float).reshape(-1, 2),
        stiffness=np.array([s.brake_stiffness for s in specs], float),
        damping=np.array([s.brake_damping for s in specs], float),
        drive=np.zeros(n, np.int64),
        drives=np.array([s.drives[k] if k < len(s.drives) else (0.0,) * 4 for s in specs for k in range(DRIVES)], float).reshape(-1, 4),
    )
    for e, spec in enumerate(specs):
        chassis = context.marker(spec.where, Marker(body=spec.chassis))
        table.body[e, 0] = chassis.body
        for k, name in enumerate((spec.left, spec.right)):
            wheel = context.marker(spec.where, Marker(body=name))
            require(not wheel.r.any(), spec.where, SIDES[k], name, 'must have its centre of mass at its origin')
            table.body[e, 1 + k] = wheel.body
            table.origin[2 * e + k] = chassis.r + spec.centers[k]
            yields = None if spec.yields is None else spec.yields[k]
            table.law[2 * e + k] = context.law(spec.springs[k]), context.law(spec.dampers[k]), context.law(yields)
            table.coordinate[e, k] = context.coordinate(spec.where, spec.wheels[k])
        if spec.coordinate is not None:
            table.steering[e] = context.coordinate(spec.where, spec.coordinate)
            table.coordinate[e, 2] = table.steering[e]
            table.body[e, 3:] = context.coordinate_bodies(int(table.steering[e]))
        table.slot[e] = slots(table.body[e].tolist(), context)
        table.state[e] = context.internal_states(spec.where, STATES)
        table.input[e] = context.input(spec.where, spec.input)
        table.drive[e] = table.input[e] if spec.drive is None else context.input(spec.where, spec.drive)
    return table


@kernel(inner=True)
def _theta_rate(table, side, m, s_rate, o_rate, sigma_rate, delta_rate):
    w = table.windup[side]
    own = ((w[0] * delta_rate[0] + w[1] * delta_rate[1]) + (w[2] * delta_rate[2] + w[3] * delta_rate[3])) + (
        (w[4] * delta_rate[4] + w[5] * delta_rate[5]) + (w[6] * delta_rate[6] + w[7] * delta_rate[7])
    )
    return m[1] * s_rate + m[2] * o_rate + m[3] * sigma_rate + own


@kernel(inner=True)
def _driven(table, row, applied, spin_l, spin_r):
    """Return the torques of a drive on the left and the right wheel at their turns against the chassis."""
    factor_l, factor_r = table.drives[row, 0], table.drives[row, 1]
    Q, _ = limited(table.drives[row, 2] * applied, factor_l * spin_l + factor_r * spin_r, table.drives[row, 3])
    return factor_l * Q, factor_r * Q


@kernel(borrow=True)
def guide_forces(table, coordinates, laws, kin, angle, zp, cz, u, tangents, f, Kq, Kv, z, out):
    """Accumulate forces and tangents of all guides, assign the wind-up of their brakes (contract: solver/elements/__init__.py).

    One element is long because both wheels share everything: departures, brakes, drives, steering.
    """
    f = sixes(f)
    Kq = sixes(Kq)
    Kv = sixes(Kv)
    for e in range(table.state.shape[0]):
        c = table.body[e, 0]
        R_c = load33(kin.R, c)
        lw, rw = wheel_of(table, kin, e, 0), wheel_of(table, kin, e, 1)
        zero = 0.0 * lw.D[0]
        sigma, sigma_rate = zero, zero
        g_i, g_j = ((zero, zero, zero), (zero, zero, zero)), ((zero, zero, zero), (zero, zero, zero))
        if table.steering[e] >= 0:
            sigma, g_i, g_j = evaluate_coordinate(coordinates, kin, table.steering[e], angle)
            sigma_rate = coordinate_rate(coordinates, kin, table.steering[e], g_i, g_j)
        s_l, s_r, v_l, v_r = lw.x[2], rw.x[2], lw.rate[2], rw.rate[2]
        m_l, m_r = map_of(table, e, 0, s_l, s_r, sigma, tangents), map_of(table, e, 1, s_r, s_l, sigma, tangents)

        # departures and their rates
        by_l, by_r = over_travels(m_l, m_r)
        by_t = eight(m_l, m_r, 3)
        at = (lw.x[0], lw.x[1], lw.x[3], lw.x[4], rw.x[0], rw.x[1], rw.x[3], rw.x[4])
        delta = plus8(at, -1.0, eight(m_l, m_r, 0))
        moving = (lw.rate[0], lw.rate[1], lw.rate[3], lw.rate[4], rw.rate[0], rw.rate[1], rw.rate[3], rw.rate[4])
        rate = plus8(plus8(plus8(moving, -v_l, by_l), -v_r, by_r), -sigma_rate, by_t)
        elastic, lagging = times8(table.K, e, delta), times8(table.K, e, rate)
        lag = table.lag[e]
        force = plus8(elastic, lag, lagging)

        # brakes, and drives on carriers
        n = table.state[e]
        k_b = table.stiffness[e]
        applied = max(u[table.input[e]], 0.0)
        spin_l, spin_r = dot(lw.a, lw.turn), dot(rw.a, rw.turn)
        carrier_l = _theta_rate(table, 2 * e, m_l[4], v_l, v_r, sigma_rate, rate)
        carrier_r = _theta_rate(table, 2 * e + 1, m_r[4], v_r, v_l, sigma_rate, rate)
        turn_l, turn_r = spin_l - carrier_l, spin_r - carrier_r
        first_l, first_r = _driven(table, DRIVES * e, u[table.drive[e]], spin_l, spin_r)
        second_l, second_r = _driven(table, DRIVES * e + 1, u[table.drive[e]], spin_l, spin_r)
        drive_l, drive_r = first_l + second_l, first_r + second_r
        z_l, t_l, slope_l, lost_l = friction(zp[n], cz, turn_l, table.gain[e, 0] * applied, k_b, table.damping[e])
        z_r, t_r, slope_r, lost_r = friction(zp[n + 1], cz, turn_r, table.gain[e, 1] * applied, k_b, table.damping[e])
        w_l, w_r = load8(table.windup, 2 * e), load8(table.windup, 2 * e + 1)
        p_l, p_r = t_l - drive_l, t_r - drive_r  # on the carriers
        held = plus8(plus8(force, -p_l, w_l), -p_r, w_r)  # what the map carries over to travels and steering

        # springs and dampers
        spring_l, rise_l, stored_l = evaluate_law(laws, table.law[2 * e, 0], s_l)
        spring_r, rise_r, stored_r = evaluate_law(laws, table.law[2 * e + 1, 0], s_r)
        U, U_l, U_r, U_ll, U_lr, U_rr = coupling(table.coupling[e], s_l, s_r)
        spring_t, rise_t, stored_t = evaluate_law(laws, table.gear[e, 0], sigma)
        damper_t, rise_dt, _ = evaluate_law(laws, table.gear[e, 1], sigma_rate)
        P_l, P_r = cubic(table.jacking[2 * e], s_l), cubic(table.jacking[2 * e + 1], s_r)
        d_l, over_r, d_ls, rise_dl, ratio_l, heat_l, mount_l, y_l = damper_on_travel(table, laws, 2 * e, s_l, v_l, v_r, zp[n + 2], cz)
        d_r, over_l, d_rs, rise_dr, ratio_r, heat_r, mount_r, y_r = damper_on_travel(table, laws, 2 * e + 1, s_r, v_r, v_l, zp[n + 3], cz)
        d_l, d_r = d_l + over_l, d_r + over_r

        # generalized forces, wrenches, bodies
        q_l = dot8(held, by_l) + (p_l * m_l[4][1] + p_r * m_r[4][2]) - spring_l - U_l + d_l - sigma * P_l[1]
        q_r = dot8(held, by_r) + (p_l * m_l[4][2] + p_r * m_r[4][1]) - spring_r - U_r + d_r - sigma * P_r[1]
        q_t = dot8(held, by_t) + (p_l * m_l[4][3] + p_r * m_r[4][3]) - (P_l[0] + P_r[0]) - spring_t - damper_t
        on_l = wrench(lw, -held[0], -held[1], q_l, -held[2], -held[3], -t_l)
        on_r = wrench(rw, -held[4], -held[5], q_r, -held[6], -held[7], -t_r)
        g = gradients(R_c, lw, rw, on_l, on_r, q_t, g_i, g_j)
        for b in range(5):
            add_gradient(1.0 + zero, g[b], table.body[e, b], f)

        if tangents:
            k_l, k_r = times8(table.K, e, by_l), times8(table.K, e, by_r)
            k_t = times8(table.K, e, by_t)
            K, slots = table.K, table.slot
            ll, mix, rr = -dot8(by_l, k_l), -dot8(by_l, k_r), -dot8(by_r, k_r)
            more_l = own_curvature(held, m_l, p_l, 0, 4) + own_curvature(held, m_r, p_r, 4, 8) - rise_l - U_ll + d_ls - sigma * P_l[2]
            more_r = own_curvature(held, m_r, p_r, 4, 4) + own_curvature(held, m_l, p_l, 0, 8) - rise_r - U_rr + d_rs - sigma * P_r[2]
            more = own_curvature(held, m_l, p_l, 0, 5) + own_curvature(held, m_r, p_r, 4, 5) - U_lr
            on_ll = pair_of(K, e, 0, 0, first4(k_l), first4(k_l), ll)
            on_lr = pair_of(K, e, 0, 1, last4(k_l), first4(k_r), mix)
            on_rr = pair_of(K, e, 1, 1, last4(k_r), last4(k_r), rr)
            pairs = with_travels(on_ll, more_l), with_travels(on_lr, more), with_travels(on_rr, more_r)
            c_l, c_r = table.crossing[2 * e], table.crossing[2 * e + 1]
            d_ll, d_rr = -ratio_l * ratio_l * rise_dl - c_r * c_r * rise_dr, -ratio_r * ratio_r * rise_dr - c_l * c_l * rise_dl
            d_lr = -ratio_l * c_l * rise_dl - ratio_r * c_r * rise_dr
            damping = (d_ll - lag * more_l, d_lr - lag * more, d_rr - lag * more_r)
            add_motions(R_c, lw, rw, pairs[0], pairs[1], pairs[2], lag, damping, slots, e, Kq, Kv)
            turn_l = turning_axes(lw, on_l[0], on_l[1], -held[2], -held[3], -t_l)
            turn_r = turning_axes(rw, on_r[0], on_r[1], -held[6], -held[7], -t_r)
            add_turning(R_c, lw, turn_l, slots[e, 1, 1], slots[e, 1, 0], slots[e, 0, 1], slots[e, 0, 0], Kq)
            add_turning(R_c, rw, turn_r, slots[e, 2, 2], slots[e, 2, 0], slots[e, 0, 2], slots[e, 0, 0], Kq)
            if table.steering[e] >= 0:
                lt, rt, tt = -dot8(by_l, k_t), -dot8(by_r, k_t), -dot8(by_t, k_t)
                on_l = wrench(lw, k_t[0], k_t[1], lt, k_t[2], k_t[3], 0.0)
                on_r = wrench(rw, k_t[4], k_t[5], rt, k_t[6], k_t[7], 0.0)
                by_rate = gradients(R_c, lw, rw, on_l, on_r, zero, g_i, g_j)
                add_steering((by_rate[0], by_rate[1], by_rate[2]), lag * tt - rise_dt, g_i, g_j, slots, e, lag, Kv)
                lt = lt + own_curvature(held, m_l, p_l, 0, 6) + own_curvature(held, m_r, p_r, 4, 9) - P_l[1]
                rt = rt + own_curvature(held, m_r, p_r, 4, 6) + own_curvature(held, m_l, p_l, 0, 9) - P_r[1]
                tt = tt + own_curvature(held, m_l, p_l, 0, 7) + own_curvature(held, m_r, p_r, 4, 7) - rise_t
                on_l = wrench(lw, k_t[0], k_t[1], lt, k_t[2], k_t[3], 0.0)
                on_r = wrench(rw, k_t[4], k_t[5], rt, k_t[6], k_t[7], 0.0)
                by_place = gradients(R_c, lw, rw, on_l, on_r, zero, g_i, g_j)
                add_steering((by_place[0], by_place[1], by_place[2]), tt, g_i, g_j, slots, e, 1.0, Kq)
                add_coordinate_hessian(coordinates, kin, table.steering[e], q_t, Kq)
            if slope_l > 0.0:
                own = wrench(lw, -w_l[0], -w_l[1], dot8(w_l, by_l) - m_l[4][1], -w_l[2], -w_l[3], 1.0)
                beside = wrench(rw, -w_l[4], -w_l[5], dot8(w_l, by_r) - m_l[4][2], -w_l[6], -w_l[7], 0.0)
                add_dyads(gradients(R_c, lw, rw, own, beside, dot8(w_l, by_t) - m_l[4][3], g_i, g_j), slots, e, -slope_l, Kv)
            if slope_r > 0.0:
                beside = wrench(lw, -w_r[0], -w_r[1], dot8(w_r, by_l) - m_r[4][2], -w_r[2], -w_r[3], 0.0)
                own = wrench(rw, -w_r[4], -w_r[5], dot8(w_r, by_r) - m_r[4][1], -w_r[6], -w_r[7], 1.0)
                add_dyads(gradients(R_c, lw, rw, beside, own, dot8(w_r, by_t) - m_r[4][3], g_i, g_j), slots, e, -slope_r, Kv)

        z[n], z[n + 1], z[n + 2], z[n + 3] = z_l, z_r, y_l, y_r
        out[e, 0] = 0.5 * dot8(delta, elastic) + stored_l + stored_r + U + 0.5 * k_b * (z_l * z_l + z_r * z_r) + mount_l + mount_r
        out[e, 0] += sigma * (P_l[0] + P_r[0]) + stored_t
        out[e, 1] = lag * dot8(rate, lagging) + heat_l + heat_r + lost_l + lost_r + damper_t * sigma_rate
        out[e, 1] += drive_l * carrier_l + drive_r * carrier_r
        out[e, 2], out[e, 3], out[e, 4] = lw.x[3], lw.x[4], -spring_l - U_l
        out[e, 5], out[e, 6], out[e, 7] = rw.x[3], rw.x[4], -spring_r - U_r
        out[e, 8], out[e, 9], out[e, 10] = d_l, z_l, -t_l
        out[e, 11], out[e, 12], out[e, 13] = d_r, z_r, -t_r
        out[e, 14] = q_t
        out[e, 15] = -spring_t - damper_t


def held_guides(table: GuideTable, u: np.ndarray) -> Held:
    """Brakes hold in the search for static equilibrium, those that are released softly: see solver.elements.brake.held_brakes."""
    capacity = guide_capacities(table, u)
    released = (capacity == 0.0).all(axis=1)
    soft = table._replace(
        stiffness=np.where(released, RELEASED * table.stiffness, table.stiffness), damping=np.where(released, 0.0, table.damping)
    )
    inputs = u.copy()
    inputs[table.input] = HOLD
    limits = capacity / table.stiffness[:, None]
    return Held(soft, inputs, {int(n) + k: float(limits[e, k]) for e, n in enumerate(table.state) for k in range(2)})


def guide_capacities(table: GuideTable, u: np.ndarray) -> np.ndarray:
    """(n, 2) largest torques of the brakes [N m] under the inputs u (nu,)."""
    return np.maximum(table.gain * u[table.input][:, None], 0.0)


GUIDES = ForceKind(
    name='guides',
    spec=GuideSpec,
    compile=compile_guides,
    kernel=guide_forces,
    outputs=OUTPUTS,
    on_coordinates=True,
    effort=('brake_torque_left', 'brake_torque_right', 'gear_torque'),
    held=held_guides,
    capacities=guide_capacities,
)
