"""Tire against the road: Magic Formula forces with first-order relaxation, standstill included.

One body carries the force: the wheel, whose spin axis is y of the marker at the wheel centre. The contact frame C, the slips
and all signs are those of docs/conventions.md; the model is described in docs/tire.md. In short

    deflection -> load Fz -> relaxation lengths -> contact deflections (u, v) -> slips -> magic_formula -> wrench at C

    du/dt = -c Vsx - r_x u,     r_x = |(Vx, Vsx/k_x)| / sigma_kappa,     kappa = (u - tau Vsx)/sigma_kappa

and the same for v with Vsy. It is linear in u, so u = zp + cz du/dt has a closed form. At speed the steady state is the slip
itself; at rest nothing decays and u is a spring (no creep). k_x bounds the slip, and at low speed it holds u near the deflection
of the peak force, so that a wheel that slides to rest does not store more than the force it can carry.

Sources: [P] Pacejka, Tire and Vehicle Dynamics, 3rd ed. (2012), 2.2 (slip), 7.2 (relaxation), 8.6 (standstill);
[B] Besselink et al. (2010), loaded and effective radius.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np

from solver.elements.magic_formula import (
    DEFAULTS,
    ROW,
    SLOWEST,
    I,
    camber_variable,
    load_increment,
    magic_formula,
    pack,
    ramp,
    relaxation_lengths,
    slip_stiffness,
    smooth_abs,
    smooth_sign,
)
from solver.elements.marker import Context, Marker, Spec, finite, require
from solver.elements.road import RoadSpec, RoadTable, compile_road, friction_at, surface_at
from solver.errors import suggestion
from solver.jit import kernel
from solver.lie.dual import arctan, partial, sqrt, value, variable
from solver.lie.so3 import quaternion_of_matrix
from solver.lie.vec import add, cross, dot, load3, load33, mm, mv, scale, tmv
from solver.snapshot import TIRE_COLUMNS

OUTPUTS = ('energy', 'dissipation', *TIRE_COLUMNS)
STATES = 2

TOUCH = 0.5e-3  # half width of the parabola with which the load begins at touch-down [m]
RIM_TOUCH = 3e-3  # the same for the rim [m]
NEVER_PULL = 0.1  # and with which it ends in fast rebound [-]
FULL_CONTACT = 0.02  # load, relative to FNOMIN, from which the contact point follows the road fully
AIR_DECAY = 20.0  # rate at which contact deflections vanish in the air [1/s]
SHORTEST = 0.03  # lower bound of the relaxation lengths [m]
SLIP_BOUND = 5.0  # |kappa| and |tan alpha| saturate smoothly towards this value at speed [-]
LOW_SLIP = 2.0  # and towards this multiple of (peak force / slip stiffness) at standstill [-]
QUIET_SPEED = 0.01  # speed below which |V| becomes V^2: at rest the contact is a spring without creep [m/s]
FLAT_FROM, FLAT_TO = 0.5, 0.2  # cosine of camber between which the tread leaves the road (60 to 78 degrees): no friction beyond
TINY = 1e-18


@dataclass(frozen=True, kw_only=True)
class TireData:
    """Coefficients of one tire, by their Magic Formula names, SI units, as the file has them (sign and side included).

    version: 52 or 61. values: known coefficients; missing ones take the defaults of magic_formula.DEFAULTS. extra: keys this
    model does not use. side: side of the vehicle or test bench the data belong to. source: where they come from.
    """

    name: str
    version: Literal[52, 61]
    values: Mapping[str, float]
    side: Literal['left', 'right', 'symmetric'] = 'left'
    source: str = ''
    extra: Mapping[str, float | str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        where = f'TireData {self.name!r}'
        require(self.version in (52, 61), where, 'version', self.version, 'must be 52 or 61')
        require(self.side in ('left', 'right', 'symmetric'), where, 'side', self.side, 'must be left, right or symmetric')
        for key in (k for k in self.values if k not in DEFAULTS):
            require(False, where, key, self.values[key], 'is not a coefficient of this model' + suggestion(key, DEFAULTS))
        values = {k: finite(where, k, v) for k, v in self.values.items()}
        for key, default in DEFAULTS.items():
            require(default is not None or key in values, where, key, None, 'is missing and has no default')
        for key in ('FNOMIN', 'UNLOADED_RADIUS', 'VERTICAL_STIFFNESS', 'PCX1', 'PDX1', 'PKX1', 'PCY1', 'PKY2'):
            require(values[key] > 0.0, where, key, values[key], 'must be positive')
        for key in ('VERTICAL_DAMPING', 'NOMPRES', 'INFLPRES', 'FZMAX', 'BOTTOM_STIFF', 'LONGITUDINAL_STIFFNESS', 'LATERAL_STIFFNESS'):
            require(values.get(key, 0.0) >= 0.0, where, key, values.get(key), 'must not be negative')
        axes = 'must be negative: these are ISO-W axes, where Fy is positive for negative alpha'
        require(values['PKY1'] < 0.0, where, 'PKY1', values['PKY1'], axes)
        object.__setattr__(self, 'values', MappingProxyType(values))
        object.__setattr__(self, 'extra', MappingProxyType(dict(self.extra)))
        row = pack(values, self.version)
        for axis, stiffness, table in (('kappa', 'LONGITUDINAL_STIFFNESS', ('PTX1',)), ('alpha', 'LATERAL_STIFFNESS', ('PTY1', 'PTY2'))):
            known = self.version == 61 and values.get(stiffness, 0.0) > 0.0
            known = known or all(values.get(k, 0.0) > 0.0 for k in table)
            require(known, where, ' and '.join(table), None, f'no relaxation length for {axis}: give them, or {stiffness} (6.1)')
        require(row[I.QSY7] > 0.0, where, 'QSY7', row[I.QSY7], 'must be positive')

    def __getitem__(self, key: str) -> float:
        """Value of a coefficient, the default where the data have none."""
        return self.values[key] if key in self.values else DEFAULTS[key]  # type: ignore[return-value]


@dataclass(frozen=True, kw_only=True)
class TireSpec(Spec):
    """A tire on a wheel.

    marker: at the wheel centre, y along the spin axis to the left. mirrored: True on the side the data were not measured on, so
    that asymmetries (conicity, ply steer, camber) are mirrored. pressure: inflation pressure [Pa]; None takes the data's INFLPRES.
    damping: vertical damping at nominal load [N s/m], proportional to load otherwise; None takes VERTICAL_DAMPING.
    low_speed: speed [m/s] below which standstill damping and the low slip bound set in.
    standstill_damping: time constant tau [s] by which the contact velocity damps the contact spring at rest.
    """

    marker: Marker
    data: TireData
    mirrored: bool = False
    pressure: float | None = None
    damping: float | None = None
    low_speed: float = 2.0
    standstill_damping: float = 0.04

    def __post_init__(self) -> None:
        where = self.where
        if self.pressure is not None:
            self.set('pressure', finite(where, 'pressure', self.pressure, low=0.0, strict=True))
            remedy = 'the tire data have no NOMPRES, so pressure has no effect: remove it'
            require(self.data['NOMPRES'] > 0.0, where, 'pressure', self.pressure, remedy)
        if self.damping is not None:
            self.set('damping', finite(where, 'damping', self.damping, low=0.0))
        self.set('low_speed', finite(where, 'low_speed', self.low_speed, low=0.1))
        self.set('standstill_damping', finite(where, 'standstill_damping', self.standstill_damping, low=0.0))


class TireTable(NamedTuple):
    """Columns of all tires and the road they stand on."""

    body: np.ndarray  # (n,)
    r: np.ndarray  # (n, 3) wheel centre from the centre of mass, in B [m]
    axis: np.ndarray  # (n, 3) spin axis in B
    slot: np.ndarray  # (n,) diagonal block
    state: np.ndarray  # (n,) index of u; v follows
    side: np.ndarray  # (n,) +1, or -1 for a mirrored tire
    c: np.ndarray  # (n, ROW) coefficients, magic_formula.pack
    damping: np.ndarray  # (n,) vertical damping over nominal load [s/m]
    low: np.ndarray  # (n, 4): low speed [m/s], tau [s], 1/k_x^2 and 1/k_y^2 at standstill
    road: RoadTable


def compile_tires(specs: Sequence[TireSpec], road: RoadSpec, context: Context) -> TireTable:
    """Resolve names, reserve two internal states per tire, pack coefficients."""
    n = len(specs)
    table = TireTable(
        body=np.zeros(n, np.int64),
        r=np.zeros((n, 3)),
        axis=np.zeros((n, 3)),
        slot=np.zeros(n, np.int64),
        state=np.zeros(n, np.int64),
        side=np.array([-1.0 if s.mirrored else 1.0 for s in specs]),
        c=np.zeros((n, ROW)),
        damping=np.zeros(n),
        low=np.zeros((n, 4)),
        road=compile_road(road),
    )
    for e, spec in enumerate(specs):
        placed = context.marker(spec.where, spec.marker)
        table.body[e] = placed.body
        table.r[e] = placed.r
        table.axis[e] = placed.R[:, 1]
        table.slot[e] = context.slot(placed.body, placed.body)
        table.state[e] = context.internal_states(spec.where, STATES)
        c = pack(spec.data.values, spec.data.version, spec.pressure)
        table.c[e] = c
        table.damping[e] = (c[I.VERTICAL_DAMPING] if spec.damping is None else spec.damping) / c[I.FNOMIN]
        Kx, Ky = slip_stiffness(c, 0.0, c[I.FNOMIN], 0.0)
        k_x = LOW_SLIP * c[I.PDX1] * c[I.LMUX] * c[I.FNOMIN] / Kx
        k_y = LOW_SLIP * c[I.PDY1] * c[I.LMUY] * c[I.FNOMIN] / Ky
        table.low[e] = spec.low_speed, spec.standstill_damping, 1.0 / (k_x * k_x), 1.0 / (k_y * k_y)
    return table


@kernel(borrow=True)
def _vertical_spring(c, rho):
    """(force [N], energy [J]) of the tire spring at deflection rho [m]: [B] (4) with a parabolic beginning, and the rim."""
    e = TOUCH
    R0 = c[I.UNLOADED_RADIUS]
    k1 = (1.0 + c[I.PFZ1] * c[I.DPI]) * c[I.FNOMIN] / R0 * c[I.Q_FZ1]
    k2 = (1.0 + c[I.PFZ1] * c[I.DPI]) * c[I.FNOMIN] / (R0 * R0) * c[I.Q_FZ2]
    x = ramp(rho, e)
    if rho.real < e:  # x = s^2/(4 e), s = rho + e
        s = ramp(rho + e, 0.0)
        energy = s * s * s * (k1 / (12.0 * e) + k2 * s * s / (80.0 * e * e))
    else:
        energy = k1 * (0.5 * rho * rho + e * e / 6.0) + k2 * (rho * rho * rho / 3.0 + e * e * e / 15.0)
    force = x * (k1 + k2 * x)
    if c[I.BOTTOM_STIFF] > 0.0 and c[I.RIM_RADIUS] > 0.0:
        b = RIM_TOUCH
        y = rho - (R0 - c[I.RIM_RADIUS] - c[I.BOTTOM_OFFST])
        force = force + c[I.BOTTOM_STIFF] * ramp(y, b)
        s = ramp(y + b, 0.0)
        rim = s * s * s / (12.0 * b) if y.real < b else 0.5 * y * y + b * b / 6.0
        energy = energy + c[I.BOTTOM_STIFF] * rim
    return force, energy


@kernel(borrow=True)
def _smooth_step(s):
    """0 for s <= 0, 1 for s >= 1, a cubic between."""
    if s.real <= 0.0:
        return 0.0 * s
    if s.real >= 1.0:
        return 0.0 * s + 1.0
    return s * s * (3.0 - 2.0 * s)


@kernel(borrow=True)
def _contact_state(z, cz, Vx, Vs, sigma, bound, low, tau, fade, contact):
    """(deflection at this instant, slip) of one direction; z: the part zp of z = zp + cz zdot."""
    w = Vx * Vx + Vs * Vs * (1.0 / (SLIP_BOUND * SLIP_BOUND) + low * bound)
    # |V| as w/sqrt(w + q^2): w at rest, sqrt(w) at speed
    rate = w / (sqrt(w + QUIET_SPEED * QUIET_SPEED) * sigma) + AIR_DECAY * (1.0 - contact)
    drive = contact * Vs
    u = (z - cz * drive) / (1.0 + cz * rate)
    return u, (u - tau * fade * drive) / sigma


@kernel(borrow=True)
def _evaluate(table, e, p, R, v, w, zu, zv, cz):
    """Everything about tire e, from the placement p, R and twist v (in W), w (in B) of its body.

    Returns generalized force (F in W, torque in B), states (u, v), outputs, and the contact frame (point, e_x, e_y, n).
    """
    c = table.c[e]
    side = table.side[e]
    R0 = c[I.UNLOADED_RADIUS]
    F0 = c[I.FNOMIN]
    r = load3(table.r, e)
    a = load3(table.axis, e)

    # contact frame: n road normal, e_x = s x n heading, e_y = n x e_x
    centre = add(p, mv(R, r))
    s = mv(R, a)
    h, h_x, h_y, h_xx, h_xy, h_yy = surface_at(table.road, centre[0], centre[1])
    slope = sqrt(1.0 + h_x * h_x + h_y * h_y)
    n = (-h_x / slope, -h_y / slope, 1.0 / slope)
    mu = friction_at(table.road, centre[0], centre[1])
    sin_g = dot(s, n)
    x = cross(s, n)
    cos_g = sqrt(dot(x, x) + TINY)
    e_x = scale(1.0 / cos_g, x)
    e_y = cross(n, e_x)
    height = centre[2] - h
    below = n[2] * height  # from the centre to the road's tangent plane
    # loaded radius: along the wheel plane to the road, below = loaded cos(gamma). Towards a wheel that lies flat the cosine is held at
    # half the width over the radius: the sidewall carries it. The contact point follows from the same function (virtual work).
    flat = c[I.HALF_WIDTH] / R0
    support = flat + ramp(cos_g - flat, flat)
    lean = 1.0 / cos_g if cos_g.real > 2.0 * flat else 0.0 * cos_g + 0.5 / flat  # (d support / d cos_g) / cos_g
    loaded = below / support
    reach = loaded * lean
    point = add(centre, add(scale(-reach, cross(x, s)), scale(reach * cos_g * cos_g - below, n)))

    # velocities; w_x is the rate of camber, spin the rotation of the wheel about its axis
    v_c = add(v, mv(R, cross(w, r)))
    w_W = mv(R, w)
    Vx = dot(e_x, v_c)
    w_x = dot(w_W, e_x)
    spin = dot(a, w)
    Vsy = dot(e_y, v_c) + below * w_x
    # rate of the loaded radius with the turning of the normal as the wheel moves over a curved road
    m = (-(h_xx * v_c[0] + h_xy * v_c[1]), -(h_xy * v_c[0] + h_yy * v_c[1]), 0.0 * height)
    n_dot = scale(1.0 / slope, add(m, scale(-dot(m, n), n)))
    sin_rate = cos_g * w_x + dot(n_dot, s)
    loaded_rate = (dot(n, v_c) + n_dot[2] * height + reach * sin_g * sin_rate) / support

    # load
    turn = spin * (R0 / c[I.LONGVL])
    growth = R0 * c[I.Q_V1] * turn * turn
    rho0 = R0 * c[I.Q_RE0] - loaded
    static, energy = _vertical_spring(c, rho0)
    spring = _vertical_spring(c, rho0 + growth)[0]
    upright = _smooth_step((cos_g - FLAT_TO) / (FLAT_FROM - FLAT_TO))
    stiffening = 1.0 + c[I.Q_V2] * smooth_abs(turn, 1e-3)
    Fz = spring * stiffening / support * ramp(1.0 - table.damping[e] * loaded_rate, NEVER_PULL)
    deflection = rho0 + growth

    # slip velocities with the effective rolling radius [B] (7); load without damper, so that it follows the deflection
    q = spring / F0
    c_z = (1.0 + c[I.PFZ1] * c[I.DPI]) * c[I.VERTICAL_STIFFNESS]
    rolling_radius = R0 * c[I.Q_RE0] + growth - F0 / c_z * (c[I.DREFF] * arctan(c[I.BREFF] * q) + c[I.FREFF] * q)
    Vsx = Vx - spin * rolling_radius

    # relaxation
    dfz = load_increment(c, Fz)
    gamma = camber_variable(c, side * sin_g, cos_g)
    Kxk, Kya = slip_stiffness(c, gamma, Fz, dfz)
    sigma_x, sigma_y = relaxation_lengths(c, gamma, Fz, dfz, Kxk, Kya)
    sigma_x = SHORTEST + ramp(sigma_x - SHORTEST, 0.5 * SHORTEST)
    sigma_y = SHORTEST + ramp(sigma_y - SHORTEST, 0.5 * SHORTEST)
    contact = _smooth_step(Fz / (FULL_CONTACT * F0)) * upright
    low_speed = table.low[e, 0]
    slow = ramp(1.0 - Vx * Vx / (low_speed * low_speed), 0.0)
    slow = slow * slow
    quiet = ramp(1.0 - (Vx * Vx + Vsx * Vsx + Vsy * Vsy) / (low_speed * low_speed), 0.0)
    quiet = quiet * quiet
    tau = table.low[e, 1]
    state_u, kappa = _contact_state(zu, cz, Vx, Vsx, sigma_x, slow, table.low[e, 2], tau, quiet, contact)
    state_v, tan_alpha = _contact_state(zv, cz, Vx, Vsy, sigma_y, slow, table.low[e, 3], tau, quiet, contact)

    # forces on the wheel in the contact frame; the Magic Formula counts alpha the other way, a mirrored tire y the other way
    Fx = 0.0 * Fz
    Fy = 0.0 * Fz
    Mx = 0.0 * Fz
    My = 0.0 * Fz
    Mz = 0.0 * Fz
    if Fz.real > 1e-9 * F0:
        forward = smooth_sign(Vx, SLOWEST)
        rolling = smooth_sign(spin * R0, SLOWEST)
        Fx, Fy, Mx, My, Mz = magic_formula(c, kappa, -side * tan_alpha, gamma, Fz, dfz, mu, Vx, Kxk, Kya, forward, rolling)
        Fx = Fx * upright
        Fy = Fy * (side * upright)
        Mx = Mx * (side * upright)
        My = My * upright
        Mz = Mz * (side * upright)

    # wrench on the body: force at the contact point, moment, both about the centre of mass
    F = add(scale(Fx, e_x), add(scale(Fy, e_y), scale(Fz, n)))
    M = add(scale(Mx, e_x), add(scale(My, e_y), scale(Mz, n)))
    arm = (point[0] - p[0], point[1] - p[1], point[2] - p[2])
    T = tmv(R, add(M, cross(arm, F)))
    power = dot(F, v) + dot(T, w)
    dissipation = static * loaded_rate - power  # dE/dt = -static * loaded_rate
    values = (
        energy, dissipation, Fx, Fy, Fz, Mx, My, Mz,
        kappa, arctan(tan_alpha), arctan(sin_g / cos_g), spin, deflection, mu,
    )  # fmt: skip
    return F, T, state_u, state_v, values, point, (e_x, e_y, n)


@kernel(borrow=True)
def _store(e, i, j, result, f, z, out):
    """Write the values that _evaluate returned for tire e on body i with internal states j, j + 1."""
    F, T, state_u, state_v, values, point, frame = result
    for k in range(3):
        f[i, k] += value(F[k])
        f[i, 3 + k] += value(T[k])
        out[e, 14 + k] = value(point[k])
    for k in range(len(values)):
        out[e, k] = value(values[k])
    x, y, n = frame
    C = (x[0].real, y[0].real, n[0].real, x[1].real, y[1].real, n[1].real, x[2].real, y[2].real, n[2].real)
    q = quaternion_of_matrix(C)
    for k in range(4):
        out[e, 17 + k] = q[k]
    z[j] = value(state_u)
    z[j + 1] = value(state_v)


@kernel(borrow=True)
def _seeded(kin, i):
    """(p, R, v, w) of body i as Duals: p + dp, R exp(dtheta) to first order, v + dv, w + dw."""
    v = kin.v
    p = (variable(kin.p[i, 0].real, 0), variable(kin.p[i, 1].real, 1), variable(kin.p[i, 2].real, 2))
    t = (variable(0.0, 3), variable(0.0, 4), variable(0.0, 5))
    V = (variable(v[i, 0].real, 6), variable(v[i, 1].real, 7), variable(v[i, 2].real, 8))
    w = (variable(v[i, 3].real, 9), variable(v[i, 4].real, 10), variable(v[i, 5].real, 11))
    A = load33(kin.R, i)
    R = (A[0].real, A[1].real, A[2].real, A[3].real, A[4].real, A[5].real, A[6].real, A[7].real, A[8].real)
    one = 0.0 * t[0] + 1.0
    return p, mm(R, (one, -t[2], t[1], t[2], one, -t[0], -t[1], t[0], one)), V, w


@kernel(borrow=True)
def tire_forces(table, laws, kin, zp, cz, u, tangents, f, Kq, Kv, z, out):
    """Accumulate forces and tangents of all tires (contract: solver/elements/__init__.py)."""
    for e in range(table.body.shape[0]):
        i = table.body[e]
        j = table.state[e]
        if tangents:
            p, R, v, w = _seeded(kin, i)
            result = _evaluate(table, e, p, R, v, w, zp[j].real, zp[j + 1].real, cz)
            _store(e, i, j, result, f, z, out)
            s = table.slot[e]
            for k in range(3):
                for d in range(6):
                    Kq[s, k, d] += partial(result[0][k], d)
                    Kq[s, 3 + k, d] += partial(result[1][k], d)
                    Kv[s, k, d] += partial(result[0][k], 6 + d)
                    Kv[s, 3 + k, d] += partial(result[1][k], 6 + d)
        else:
            w = (kin.v[i, 3], kin.v[i, 4], kin.v[i, 5])
            zero = 0.0 * w[0]  # gives the states the number type of the motion
            result = _evaluate(table, e, load3(kin.p, i), load33(kin.R, i), load3(kin.v, i), w, zp[j] + zero, zp[j + 1] + zero, cz)
            _store(e, i, j, result, f, z, out)


def rolling_radius(table: TireTable, e: int, load: float, speed: float) -> float:
    """Effective rolling radius [m] of tire e under a vertical load [N], freely rolling at speed [m/s] ([B] eq. 7)."""
    c = table.c[e]
    R0, F0 = c[I.UNLOADED_RADIUS], c[I.FNOMIN]
    growth = R0 * c[I.Q_V1] * (speed / c[I.LONGVL]) ** 2
    c_z = (1.0 + c[I.PFZ1] * c[I.DPI]) * c[I.VERTICAL_STIFFNESS]
    q = load / F0
    return float(R0 * c[I.Q_RE0] + growth - F0 / c_z * (c[I.DREFF] * np.arctan(c[I.BREFF] * q) + c[I.FREFF] * q))
