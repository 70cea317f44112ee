"""Guide: an axle of two wheels whose places follow smooth maps over travel, travel of the other wheel and steering, and give elastically.

What arms, links, rubbers and rack do to two wheels, as force between them and the chassis; none of these parts is a body. Of each wheel,
relative to the chassis and along its axes:

    x, y    wheel centre from its place in the design position [m]         s = z    travel [m]
    psi     turn of the spin axis about z, arctan(-a_x/a_y) [rad]          gamma    its lift, a_z [-]

The wheel turns about its axis freely. Unloaded it stands at (X, Y, Psi, Gamma)(s, o, sigma), with the travel o of the other wheel and the
rotation sigma that steers; delta (8,) are the departures of both wheels from there. With the energy

    U = 1/2 delta' K delta + spring_l(s_l) + spring_r(s_r) + s_l s_r (c_0 + c_1 (s_l + s_r) + c_2 (s_l^2 + s_r^2) + c_3 s_l s_r)

all forces are its gradient: the map carries a load at the wheel to the travel (its slope X_s is the anti-dive of the wheel centre) and to
the steering (its slope over sigma is what the driver feels). K lags: it acts on delta + lag d(delta)/dt. A damper of the length L(s)
pulls the travel with the force -F L'. It stands on a mount k, which takes the part w = F/k of its way, an internal state:

    F = law(L' ds/dt - dw/dt),     k = 0: F = law(L' ds/dt)

A brake acts between the wheel and its carrier (the law of solver.elements.brake), whose turn about the spin axis is

    theta = Theta(s, o, sigma) + w' delta

so a braked wheel lifts or lowers the chassis and winds its suspension up. Maps are cubic B-splines (of Theta and of the slopes over o too:
Q(s, o, sigma) = Q(s, 0, sigma) + o (b_0 + b_1 s)), continued linearly. All is measured on a bench: solver.levels.kc.

Tangents are exact at rest, and over velocities; left out is how rates change with the position, which is of the order of rate times lag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.dual import arctan
from solver.compiled.kernel import kernel, sixes
from solver.compiled.rows import add_block, mul_rows, rows
from solver.compiled.vec import (
    add,
    cross,
    cross_m,
    dot,
    load3,
    load33,
    m_cross,
    madd,
    minus,
    mscale,
    msub,
    mv,
    outer,
    put33,
    scale,
    skew,
    sub,
    tmm,
    tmv,
    transpose,
)
from solver.elements.brake import RELEASED, friction
from solver.elements.coordinate import (
    add_coordinate_hessian,
    add_dyad,
    add_gradient,
    coordinate_rate,
    evaluate_coordinate,
    scale6,
)
from solver.elements.kind import ForceKind, Held
from solver.elements.laws import Law, evaluate_law
from solver.elements.marker import Context, Marker, Spec
from solver.validate import Vector, finite, require

SIDES = ('left', 'right')
QUANTITIES = ('x', 'y', 'psi', 'gamma', 'theta')
OUTPUTS = {
    'energy': 'J',
    'dissipation': 'W',
    **{f'{name}_{side}': unit for side in SIDES for name, unit in (('steer', 'rad'), ('camber', ''), ('spring_force', 'N'))},
    **{f'{name}_{side}': unit for side in SIDES for name, unit in (('damper_force', 'N'), ('windup', 'rad'), ('brake_torque', 'N m'))},
    'steering_torque': 'N m',
}
STATES = 4
YIELDING = 1e-4  # N: from a change of the force of a damper on its mount as small as this on, Newton leaves rounding alone
HOLD = 1e9  # input of brakes that hold [N m per unit of gain]


class Nodes(NamedTuple):
    """Equidistant nodes of a map along one argument; of a single one the map does not depend on it."""

    first: float
    step: float
    number: int

    @property
    def coefficients(self) -> int:
        """How many B-splines reach into the range of the nodes."""
        return self.number + 2 if self.number > 1 else 1


@dataclass(frozen=True, kw_only=True)
class GuideSpec(Spec):
    """The guide of an axle; made by the level kc of a vehicle, see the module.

    chassis, left, right: bodies; the reference frames of the wheels are at their centres of mass, which are the wheel centres. centers:
    these in the chassis, in the design position [m]. axes: spin axes in the wheels. travel, steering: nodes (first, step, count) of the
    maps [m], [unit of the coordinate]. shape: coefficients of the maps, over side, travel, steering, quantity (x, y, psi, gamma, theta);
    opposite: b_0, b_1 over side, quantity. coordinate: the rotation that steers. stiffness: K (8, 8) over (x, y, psi, gamma) left, right.
    lag [s]. windup: w over side, (8,). springs: force against travel of either side; coupling: c_0 ... c_3. dampers: laws of either side;
    ratios: coefficients of the powers of s in L', over side. mounts: their k [N/m], 0 for none; yields: with a mount the inverse of the
    damper's law, rate over force. wheels: coordinates of the turning wheels, to show the brake torque at.
    input: of the brakes; shares of either wheel in it; brake_stiffness [N m/rad], brake_damping [N m s/rad] of a stuck wheel.
    """

    chassis: str
    left: str
    right: str
    centers: tuple[Vector, Vector]
    axes: tuple[Vector, Vector] = ((0.0, 1.0, 0.0), (0.0, 1.0, 0.0))
    travel: tuple[float, float, int]
    steering: tuple[float, float, int] = (0.0, 1.0, 1)
    shape: tuple[float, ...]
    opposite: tuple[float, ...] = (0.0,) * 20
    coordinate: str | None = None
    stiffness: tuple[float, ...]
    lag: float = 0.0
    windup: tuple[float, ...] = (0.0,) * 16
    springs: tuple[Law, Law]
    coupling: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    dampers: tuple[Law, Law]
    ratios: tuple[float, ...]
    mounts: tuple[float, float] = (0.0, 0.0)
    yields: tuple[Law, Law] | None = None
    wheels: tuple[str, str]
    input: str
    shares: tuple[float, float]
    brake_stiffness: float
    brake_damping: float = 0.0

    def __post_init__(self) -> None:
        where = self.where
        for name, nodes in (('travel', self.travel), ('steering', self.steering)):
            require(nodes[1] > 0.0 and nodes[2] >= 1, where, name, nodes, 'must be (first, step > 0, count >= 1)')
        require(self.travel[2] > 1, where, 'travel', self.travel, 'needs two nodes or more')
        require(self.coordinate is not None or self.steering[2] == 1, where, 'steering', self.steering, 'needs a coordinate')
        count = 2 * Nodes(*self.travel).coefficients * Nodes(*self.steering).coefficients * len(QUANTITIES)
        for name, length in (('shape', count), ('opposite', 20), ('stiffness', 64), ('windup', 16), ('ratios', 10)):
            values = getattr(self, name)
            require(len(values) == length, where, name, len(values), f'must be {length} numbers')
            self.set(name, tuple(finite(where, name, v) for v in values))
        self.set('mounts', tuple(finite(where, 'mounts', k, low=0.0) for k in self.mounts))
        require(self.yields is not None or not any(self.mounts), where, 'yields', self.yields, 'is needed with mounts')
        self.set('lag', finite(where, 'lag', self.lag, low=0.0))
        self.set('brake_stiffness', finite(where, 'brake_stiffness', self.brake_stiffness, low=0.0, strict=True))
        self.set('brake_damping', finite(where, 'brake_damping', self.brake_damping, low=0.0))


class GuideTable(NamedTuple):
    """Columns of all guides. Bodies are chassis, left, right, and the two of the steering coordinate (the world without one)."""

    body: np.ndarray  # (n, 5)
    slot: np.ndarray  # (n, 5, 5)
    origin: np.ndarray  # (2 n, 3) wheel centres in the design position from the centre of mass of the chassis, along its axes [m]
    axis: np.ndarray  # (2 n, 3) spin axes in the wheels
    nodes: np.ndarray  # (n, 4) first and step of travel and steering
    number: np.ndarray  # (n, 2) of them
    start: np.ndarray  # (2 n,) first row in shape of either side
    shape: np.ndarray  # (rows, 5)
    opposite: np.ndarray  # (2 n, 5, 2)
    steering: np.ndarray  # (n,) coordinate, -1 for none
    K: np.ndarray  # (n, 8, 8)
    lag: np.ndarray  # (n,)
    windup: np.ndarray  # (2 n, 8)
    law: np.ndarray  # (2 n, 3) spring, damper, its inverse
    mount: np.ndarray  # (2 n,)
    coupling: np.ndarray  # (n, 4)
    ratio: np.ndarray  # (2 n, 5)
    coordinate: np.ndarray  # (n, 2) of the turning wheels
    state: np.ndarray  # (n,) wind-up of the left brake; that of the right one and both mounts follow
    input: np.ndarray  # (n,)
    gain: np.ndarray  # (n, 2)
    stiffness: np.ndarray  # (n,) of a stuck brake
    damping: np.ndarray  # (n,)


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
        shape=np.array([v for s in specs for v in s.shape], float).reshape(-1, len(QUANTITIES)),
        opposite=np.array([s.opposite for s in specs], float).reshape(2 * n, 5, 2),
        steering=np.full(n, -1, np.int64),
        K=np.array([s.stiffness for s in specs], float).reshape(-1, 8, 8),
        lag=np.array([s.lag for s in specs], float),
        windup=np.array([s.windup for s in specs], float).reshape(-1, 8),
        law=np.zeros((2 * n, 3), np.int64),
        mount=np.array([k for s in specs for k in s.mounts], float),
        coupling=np.array([s.coupling for s in specs], float).reshape(-1, 4),
        ratio=np.array([s.ratios for s in specs], float).reshape(-1, 5),
        coordinate=np.zeros((n, 2), np.int64),
        state=np.zeros(n, np.int64),
        input=np.zeros(n, np.int64),
        gain=np.array([s.shares for s in specs], float).reshape(-1, 2),
        stiffness=np.array([s.brake_stiffness for s in specs], float),
        damping=np.array([s.brake_damping for s in specs], float),
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
            table.body[e, 3:] = context.coordinate_bodies(int(table.steering[e]))
        table.slot[e] = [[context.slot(a, b) for b in table.body[e].tolist()] for a in table.body[e].tolist()]
        table.state[e] = context.internal_states(spec.where, STATES)
        table.input[e] = context.input(spec.where, spec.input)
    return table


@kernel(inner=True)
def _place(x, first, step, count):
    """(first B-spline, weights of four, their slopes and second derivatives) at x; beyond the nodes linearly continued."""
    t = (x - first) / step
    i = int(min(max(np.floor(t.real), 0.0), count - 2.0))
    u = t - i
    beyond = 0.0 * u
    if u.real < 0.0:
        beyond, u = u, 0.0 * u
    elif u.real > 1.0:
        beyond, u = u - 1.0, 0.0 * u + 1.0
    r = 1.0 - u
    w = (r * r * r / 6.0, (4.0 - 3.0 * u * u * (2.0 - u)) / 6.0, (4.0 - 3.0 * r * r * (1.0 + u)) / 6.0, u * u * u / 6.0)
    d = (-0.5 * r * r, u * (1.5 * u - 2.0), r * (2.0 - 1.5 * r), 0.5 * u * u)
    k = 1.0 / step
    inside = k * k if beyond.real == 0.0 else 0.0
    w = (w[0] + beyond * d[0], w[1] + beyond * d[1], w[2] + beyond * d[2], w[3] + beyond * d[3])
    dd = (inside * r, inside * (3.0 * u - 2.0), inside * (1.0 - 3.0 * u), inside * u)
    return i, w, (k * d[0], k * d[1], k * d[2], k * d[3]), dd


class Place(NamedTuple):
    """Where a map is evaluated: of travel and steering, the first row, weights, slopes and second derivatives of four B-splines."""

    row: int
    columns: int
    w: tuple
    d: tuple
    dd: tuple
    u: tuple
    du: tuple
    ddu: tuple


@kernel(inner=True)
def _surface(shape, at, q):
    """(value, by s, by sigma, by s s, by s sigma, by sigma sigma) of quantity q."""
    zero = 0.0 * at.w[0]
    v, v_s, v_t, v_ss, v_st, v_tt = zero, zero, zero, zero, zero, zero
    for k in range(4):
        row = at.row + k * at.columns
        if at.columns > 1:
            a = shape[row, q] * at.u[0] + shape[row + 1, q] * at.u[1] + shape[row + 2, q] * at.u[2] + shape[row + 3, q] * at.u[3]
            b = shape[row, q] * at.du[0] + shape[row + 1, q] * at.du[1] + shape[row + 2, q] * at.du[2] + shape[row + 3, q] * at.du[3]
            c = shape[row, q] * at.ddu[0] + shape[row + 1, q] * at.ddu[1] + shape[row + 2, q] * at.ddu[2] + shape[row + 3, q] * at.ddu[3]
            v_t += at.w[k] * b
            v_st += at.d[k] * b
            v_tt += at.w[k] * c
        else:
            a = shape[row, q] + zero
        v += at.w[k] * a
        v_s += at.d[k] * a
        v_ss += at.dd[k] * a
    return v, v_s, v_t, v_ss, v_st, v_tt


@kernel(inner=True)
def _quantity(table, side, at, q, s, o):
    """(value, by s, by o, by sigma, by s s, by s o, by s sigma, by sigma sigma) of quantity q with the travel o of the other wheel."""
    v, v_s, v_t, v_ss, v_st, v_tt = _surface(table.shape, at, q)
    b0, b1 = table.opposite[side, q, 0], table.opposite[side, q, 1]
    v_o = b0 + b1 * s
    return v + o * v_o, v_s + o * b1, v_o, v_t, v_ss, b1, v_st, v_tt


@kernel(inner=True)
def _map(table, e, k, s, o, sigma):
    """The five quantities of wheel k of guide e."""
    side = 2 * e + k
    i, w, d, dd = _place(s, table.nodes[e, 0], table.nodes[e, 1], table.number[e, 0])
    zero = 0.0 * s
    u, du, ddu = (zero, zero, zero, zero), (zero, zero, zero, zero), (zero, zero, zero, zero)
    j, columns = 0, 1
    if table.steering[e] >= 0 and table.number[e, 1] > 1:
        j, u, du, ddu = _place(sigma + zero, table.nodes[e, 2], table.nodes[e, 3], table.number[e, 1])
        columns = table.number[e, 1] + 2
    at = Place(table.start[side] + i * columns + j, columns, w, d, dd, u, du, ddu)
    return (
        _quantity(table, side, at, 0, s, o),
        _quantity(table, side, at, 1, s, o),
        _quantity(table, side, at, 2, s, o),
        _quantity(table, side, at, 3, s, o),
        _quantity(table, side, at, 4, s, o),
    )


class Wheel(NamedTuple):
    """A wheel relative to the chassis, along the axes of the chassis."""

    R: tuple  # of the wheel in the chassis
    D: tuple  # centre from the centre of mass of the chassis [m]
    a: tuple  # spin axis
    V: tuple  # velocity [m/s]
    turn: tuple  # angular velocity [rad/s]
    x: tuple  # (x, y, s, psi, gamma)
    rate: tuple  # of these
    p: tuple  # d psi / d rotation
    g: tuple  # d gamma / d rotation


@kernel(inner=True)
def _wheel(table, kin, e, k):
    c, b = table.body[e, 0], table.body[e, 1 + k]
    R_c = load33(kin.R, c)
    R = tmm(R_c, load33(kin.R, b))
    D = tmv(R_c, sub(load3(kin.p, b), load3(kin.p, c)))
    w_c = (kin.v[c, 3], kin.v[c, 4], kin.v[c, 5])
    V = add(tmv(R_c, sub(load3(kin.v, b), load3(kin.v, c))), cross(D, w_c))
    turn = sub(mv(R, (kin.v[b, 3], kin.v[b, 4], kin.v[b, 5])), w_c)
    a = mv(R, load3(table.axis, 2 * e + k))
    d = sub(D, load3(table.origin, 2 * e + k))
    q = a[2] / (a[0] * a[0] + a[1] * a[1])
    p = (-q * a[0], -q * a[1], 1.0 + 0.0 * q)
    g = (a[1], -a[0], 0.0 * q)
    psi = arctan(-a[0] / a[1])
    return Wheel(R, D, a, V, turn, (d[0], d[1], d[2], psi, a[2]), (V[0], V[1], V[2], dot(p, turn), dot(g, turn)), p, g)


@kernel(inline=True)
def _column(m, k):
    """Slope k (see _quantity) of x, y, psi, gamma."""
    return (m[0][k], m[1][k], m[2][k], m[3][k])


@kernel(inline=True)
def _eight(left, right, k):
    """Slope k (see _quantity) of x, y, psi, gamma of both wheels."""
    return (*_column(left, k), *_column(right, k))


@kernel(inline=True)
def _over_travels(left, right):
    """(slopes of the eight over the left travel, over the right travel)."""
    return (*_column(left, 1), *_column(right, 2)), (*_column(left, 2), *_column(right, 1))


@kernel(inline=True)
def _dot8(a, b):
    return ((a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3])) + ((a[4] * b[4] + a[5] * b[5]) + (a[6] * b[6] + a[7] * b[7]))


@kernel(inline=True)
def _plus8(a, s, b):
    """a + s b."""
    return (
        a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2], a[3] + s * b[3],
        a[4] + s * b[4], a[5] + s * b[5], a[6] + s * b[6], a[7] + s * b[7],
    )  # fmt: skip


@kernel(inline=True)
def _row8(K, e, i, x):
    return ((K[e, i, 0] * x[0] + K[e, i, 1] * x[1]) + (K[e, i, 2] * x[2] + K[e, i, 3] * x[3])) + (
        (K[e, i, 4] * x[4] + K[e, i, 5] * x[5]) + (K[e, i, 6] * x[6] + K[e, i, 7] * x[7])
    )


@kernel(inner=True)
def _times8(K, e, x):
    """K x of guide e."""
    return (
        _row8(K, e, 0, x), _row8(K, e, 1, x), _row8(K, e, 2, x), _row8(K, e, 3, x),
        _row8(K, e, 4, x), _row8(K, e, 5, x), _row8(K, e, 6, x), _row8(K, e, 7, x),
    )  # fmt: skip


@kernel(inner=True)
def _coupling(c, s, o):
    """(energy, by s, by o, by s s, by s o, by o o) of the coupling of both travels."""
    sum_, square, prod = s + o, s * s + o * o, s * o
    g = c[0] + c[1] * sum_ + c[2] * square + c[3] * prod
    g_s, g_o = c[1] + 2.0 * c[2] * s + c[3] * o, c[1] + 2.0 * c[2] * o + c[3] * s
    g_2 = 2.0 * c[2]
    return (
        prod * g, o * g + prod * g_s, s * g + prod * g_o,
        2.0 * o * g_s + prod * g_2, g + s * g_s + o * g_o + prod * c[3], 2.0 * s * g_o + prod * g_2,
    )  # fmt: skip


@kernel(inner=True)
def _yielding(laws, k, rate, zp, cz, law):
    """(w, force, its slope over the rate, rate of the damper) on a mount k: w = zp + cz (rate - law(k w)), by Newton's iteration."""
    w = zp + 0.0 * rate
    if cz > 0.0:
        for _ in range(8):
            x, slope, _ = evaluate_law(laws, law, k * w)
            change = (w + cz * (x - rate) - zp) / (1.0 + cz * k * slope)
            w = w - change
            if k * abs(change.real) < YIELDING:
                break
    x, slope, _ = evaluate_law(laws, law, k * w)
    return w, k * w, k * cz / (1.0 + cz * k * slope), x


@kernel(inner=True)
def _damper(table, laws, side, s, rate, zp, cz):
    """(force on the travel, by s, by the rate, dissipation, energy, internal state)."""
    c = table.ratio[side]
    ratio = c[0] + s * (c[1] + s * (c[2] + s * (c[3] + s * c[4])))
    slope = c[1] + s * (2.0 * c[2] + s * (3.0 * c[3] + s * 4.0 * c[4]))
    k = table.mount[side]
    if k > 0.0:
        w, force, rise, own = _yielding(laws, k, ratio * rate, zp, cz, table.law[side, 2])
        heat, stored = force * own, 0.5 * k * w * w
    else:
        force, rise, _ = evaluate_law(laws, table.law[side, 1], ratio * rate)
        w, heat = zp + 0.0 * rate, force * ratio * rate
        stored = 0.0 * heat
    return -ratio * force, -slope * (force + ratio * rate * rise), -ratio * ratio * rise, heat, stored, w


@kernel(inner=True)
def _theta_rate(table, side, m, s_rate, o_rate, sigma_rate, delta_rate):
    w = table.windup[side]
    own = ((w[0] * delta_rate[0] + w[1] * delta_rate[1]) + (w[2] * delta_rate[2] + w[3] * delta_rate[3])) + (
        (w[4] * delta_rate[4] + w[5] * delta_rate[5]) + (w[6] * delta_rate[6] + w[7] * delta_rate[7])
    )
    return m[1] * s_rate + m[2] * o_rate + m[3] * sigma_rate + own


@kernel(inline=True)
def _load8(a, i):
    return (a[i, 0], a[i, 1], a[i, 2], a[i, 3], a[i, 4], a[i, 5], a[i, 6], a[i, 7])


@kernel(inline=True)
def _wrench(wheel, x, y, s, psi, gamma, about):
    """(force, moment) at a wheel centre along the axes of the chassis, of generalized forces and a moment about the spin axis."""
    return (x, y, s), add(scale(about, wheel.a), add(scale(psi, wheel.p), scale(gamma, wheel.g)))


@kernel(inline=True)
def _gradients(R_c, left, right, on_l, on_r, sigma, g_i, g_j):
    """The gradients on (chassis, left, right, steering i and j), as solver.elements.coordinate has them, of wrenches on both wheels."""
    F = add(on_l[0], on_r[0])
    m = add(add(cross(left.D, on_l[0]), on_l[1]), add(cross(right.D, on_r[0]), on_r[1]))
    return (
        (scale(-1.0, mv(R_c, F)), scale(-1.0, m)),
        (mv(R_c, on_l[0]), tmv(left.R, on_l[1])),
        (mv(R_c, on_r[0]), tmv(right.R, on_r[1])),
        scale6(sigma, g_i),
        scale6(sigma, g_j),
    )


@kernel(inner=True)
def _add_motions(R_c, left, right, ll, lr, rr, turn_l, turn_r, slot, e, K):
    """Add to K what the wrenches at both wheels and their reaction change by the motions of wheels and chassis.

    ll, lr, rr: blocks (A, B, C, E) of the motions of the wheels relative to the chassis along its axes, force A dD + B dTheta, moment
    C dD + E dTheta, symmetric as a whole. A variation of the chassis is dD = -dp + [D] dtheta, dTheta = -dtheta of both wheels. turn_l,
    turn_r: of _turning.
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
def _elastic(K, e, i, j, own, other, k_own, k_other, ss):
    """The blocks (A, B, C, E) of _add_motions: -K between wheel i and wheel j (0, 1).

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
def _turning(wheel, F, m, psi, gamma, about):
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
def _lagging(blocks, lag, more):
    """lag times the blocks of _elastic, and more between the travels."""
    A, B, C, E = blocks
    A = mscale(lag, A)
    return (A[0], A[1], A[2], A[3], A[4], A[5], A[6], A[7], A[8] + more), mscale(lag, B), mscale(lag, C), mscale(lag, E)


@kernel(inline=True)
def _first4(a):
    return (a[0], a[1], a[2], a[3])


@kernel(inline=True)
def _last4(a):
    return (a[4], a[5], a[6], a[7])


@kernel(inline=True)
def _own(held, m, torque, first, k):
    """The second derivative k (see _quantity) of a wheel's map, seen by what it carries over."""
    forces = (held[first] * m[0][k] + held[first + 1] * m[1][k]) + (held[first + 2] * m[2][k] + held[first + 3] * m[3][k])
    return forces + torque * m[4][k]


@kernel(inner=True)
def _add_steering(g, tt, g_i, g_j, slot, e, factor, K):
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
def _add_dyads(g, slot, e, factor, K):
    """Add factor g g' of gradients on the five bodies."""
    for a in range(5):
        for b in range(5):
            add_dyad(g[a], scale6(factor, g[b]), slot[e, a, b], K)


@kernel(borrow=True)
def guide_forces(table, coordinates, laws, kin, angle, zp, cz, u, tangents, f, Kq, Kv, z, out):
    """Accumulate forces and tangents of all guides, assign the wind-up of their brakes (contract: solver/elements/__init__.py).

    One element is long because both wheels share everything: departures, brakes, steering.
    """
    f = sixes(f)
    Kq = sixes(Kq)
    Kv = sixes(Kv)
    for e in range(table.state.shape[0]):
        c = table.body[e, 0]
        R_c = load33(kin.R, c)
        lw, rw = _wheel(table, kin, e, 0), _wheel(table, kin, e, 1)
        zero = 0.0 * lw.D[0]
        sigma, sigma_rate = zero, zero
        g_i, g_j = ((zero, zero, zero), (zero, zero, zero)), ((zero, zero, zero), (zero, zero, zero))
        if table.steering[e] >= 0:
            sigma, g_i, g_j = evaluate_coordinate(coordinates, kin, table.steering[e], angle)
            sigma_rate = coordinate_rate(coordinates, kin, table.steering[e], g_i, g_j)
        s_l, s_r, v_l, v_r = lw.x[2], rw.x[2], lw.rate[2], rw.rate[2]
        m_l, m_r = _map(table, e, 0, s_l, s_r, sigma), _map(table, e, 1, s_r, s_l, sigma)

        # departures and their rates
        by_l, by_r = _over_travels(m_l, m_r)
        by_t = _eight(m_l, m_r, 3)
        at = (lw.x[0], lw.x[1], lw.x[3], lw.x[4], rw.x[0], rw.x[1], rw.x[3], rw.x[4])
        delta = _plus8(at, -1.0, _eight(m_l, m_r, 0))
        moving = (lw.rate[0], lw.rate[1], lw.rate[3], lw.rate[4], rw.rate[0], rw.rate[1], rw.rate[3], rw.rate[4])
        rate = _plus8(_plus8(_plus8(moving, -v_l, by_l), -v_r, by_r), -sigma_rate, by_t)
        elastic, lagging = _times8(table.K, e, delta), _times8(table.K, e, rate)
        lag = table.lag[e]
        force = _plus8(elastic, lag, lagging)

        # brakes
        n = table.state[e]
        k_b = table.stiffness[e]
        applied = max(u[table.input[e]], 0.0)
        turn_l = dot(lw.a, lw.turn) - _theta_rate(table, 2 * e, m_l[4], v_l, v_r, sigma_rate, rate)
        turn_r = dot(rw.a, rw.turn) - _theta_rate(table, 2 * e + 1, m_r[4], v_r, v_l, sigma_rate, rate)
        z_l, t_l, slope_l, lost_l = friction(zp[n], cz, turn_l, table.gain[e, 0] * applied, k_b, table.damping[e])
        z_r, t_r, slope_r, lost_r = friction(zp[n + 1], cz, turn_r, table.gain[e, 1] * applied, k_b, table.damping[e])
        w_l, w_r = _load8(table.windup, 2 * e), _load8(table.windup, 2 * e + 1)
        held = _plus8(_plus8(force, -t_l, w_l), -t_r, w_r)  # what the map carries over to travels and steering

        # springs and dampers
        spring_l, rise_l, stored_l = evaluate_law(laws, table.law[2 * e, 0], s_l)
        spring_r, rise_r, stored_r = evaluate_law(laws, table.law[2 * e + 1, 0], s_r)
        U, U_l, U_r, U_ll, U_lr, U_rr = _coupling(table.coupling[e], s_l, s_r)
        d_l, d_ls, d_lv, heat_l, mount_l, y_l = _damper(table, laws, 2 * e, s_l, v_l, zp[n + 2], cz)
        d_r, d_rs, d_rv, heat_r, mount_r, y_r = _damper(table, laws, 2 * e + 1, s_r, v_r, zp[n + 3], cz)

        # generalized forces, wrenches, bodies
        q_l = _dot8(held, by_l) + (t_l * m_l[4][1] + t_r * m_r[4][2]) - spring_l - U_l + d_l
        q_r = _dot8(held, by_r) + (t_l * m_l[4][2] + t_r * m_r[4][1]) - spring_r - U_r + d_r
        q_t = _dot8(held, by_t) + (t_l * m_l[4][3] + t_r * m_r[4][3])
        on_l = _wrench(lw, -held[0], -held[1], q_l, -held[2], -held[3], -t_l)
        on_r = _wrench(rw, -held[4], -held[5], q_r, -held[6], -held[7], -t_r)
        g = _gradients(R_c, lw, rw, on_l, on_r, q_t, g_i, g_j)
        for b in range(5):
            add_gradient(1.0 + zero, g[b], table.body[e, b], f)

        if tangents:
            k_l, k_r = _times8(table.K, e, by_l), _times8(table.K, e, by_r)
            k_t = _times8(table.K, e, by_t)
            K, slots = table.K, table.slot
            ll, mix, rr = -_dot8(by_l, k_l), -_dot8(by_l, k_r), -_dot8(by_r, k_r)
            more_l = _own(held, m_l, t_l, 0, 4) - rise_l - U_ll + d_ls
            more_r = _own(held, m_r, t_r, 4, 4) - rise_r - U_rr + d_rs
            more = _own(held, m_l, t_l, 0, 5) + _own(held, m_r, t_r, 4, 5) - U_lr
            on_ll = _elastic(K, e, 0, 0, lw, lw, _first4(k_l), _first4(k_l), ll)
            on_lr = _elastic(K, e, 0, 1, lw, rw, _last4(k_l), _first4(k_r), mix)
            on_rr = _elastic(K, e, 1, 1, rw, rw, _last4(k_r), _last4(k_r), rr)
            none = mscale(0.0, R_c)
            a, b, c = _lagging(on_ll, lag, d_lv), _lagging(on_lr, lag, 0.0), _lagging(on_rr, lag, d_rv)
            _add_motions(R_c, lw, rw, a, b, c, (none, none, none), (none, none, none), slots, e, Kv)
            turn_l = _turning(lw, on_l[0], on_l[1], -held[2], -held[3], -t_l)
            turn_r = _turning(rw, on_r[0], on_r[1], -held[6], -held[7], -t_r)
            a, b, c = _lagging(on_ll, 1.0, more_l), _lagging(on_lr, 1.0, more), _lagging(on_rr, 1.0, more_r)
            _add_motions(R_c, lw, rw, a, b, c, turn_l, turn_r, slots, e, Kq)
            if table.steering[e] >= 0:
                lt, rt, tt = -_dot8(by_l, k_t), -_dot8(by_r, k_t), -_dot8(by_t, k_t)
                on_l = _wrench(lw, k_t[0], k_t[1], lt, k_t[2], k_t[3], 0.0)
                on_r = _wrench(rw, k_t[4], k_t[5], rt, k_t[6], k_t[7], 0.0)
                by_rate = _gradients(R_c, lw, rw, on_l, on_r, zero, g_i, g_j)
                _add_steering((by_rate[0], by_rate[1], by_rate[2]), tt, g_i, g_j, slots, e, lag, Kv)
                lt, rt = lt + _own(held, m_l, t_l, 0, 6), rt + _own(held, m_r, t_r, 4, 6)
                tt = tt + _own(held, m_l, t_l, 0, 7) + _own(held, m_r, t_r, 4, 7)
                on_l = _wrench(lw, k_t[0], k_t[1], lt, k_t[2], k_t[3], 0.0)
                on_r = _wrench(rw, k_t[4], k_t[5], rt, k_t[6], k_t[7], 0.0)
                by_place = _gradients(R_c, lw, rw, on_l, on_r, zero, g_i, g_j)
                _add_steering((by_place[0], by_place[1], by_place[2]), tt, g_i, g_j, slots, e, 1.0, Kq)
                add_coordinate_hessian(coordinates, kin, table.steering[e], q_t, Kq)
            if slope_l > 0.0:
                own = _wrench(lw, -w_l[0], -w_l[1], _dot8(w_l, by_l) - m_l[4][1], -w_l[2], -w_l[3], 1.0)
                beside = _wrench(rw, -w_l[4], -w_l[5], _dot8(w_l, by_r) - m_l[4][2], -w_l[6], -w_l[7], 0.0)
                _add_dyads(_gradients(R_c, lw, rw, own, beside, _dot8(w_l, by_t) - m_l[4][3], g_i, g_j), slots, e, -slope_l, Kv)
            if slope_r > 0.0:
                beside = _wrench(lw, -w_r[0], -w_r[1], _dot8(w_r, by_l) - m_r[4][2], -w_r[2], -w_r[3], 0.0)
                own = _wrench(rw, -w_r[4], -w_r[5], _dot8(w_r, by_r) - m_r[4][1], -w_r[6], -w_r[7], 1.0)
                _add_dyads(_gradients(R_c, lw, rw, beside, own, _dot8(w_r, by_t) - m_r[4][3], g_i, g_j), slots, e, -slope_r, Kv)

        z[n], z[n + 1], z[n + 2], z[n + 3] = z_l, z_r, y_l, y_r
        out[e, 0] = 0.5 * _dot8(delta, elastic) + stored_l + stored_r + U + 0.5 * k_b * (z_l * z_l + z_r * z_r) + mount_l + mount_r
        out[e, 1] = lag * _dot8(rate, lagging) + heat_l + heat_r + lost_l + lost_r
        out[e, 2], out[e, 3], out[e, 4] = lw.x[3], lw.x[4], -spring_l - U_l
        out[e, 5], out[e, 6], out[e, 7] = rw.x[3], rw.x[4], -spring_r - U_r
        out[e, 8], out[e, 9], out[e, 10] = d_l, z_l, -t_l
        out[e, 11], out[e, 12], out[e, 13] = d_r, z_r, -t_r
        out[e, 14] = q_t


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
    effort=('brake_torque_left', 'brake_torque_right'),
    held=held_guides,
    capacities=guide_capacities,
)
