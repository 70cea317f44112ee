"""Tire on the road: Magic Formula forces with first-order relaxation, standstill included.

One body carries the force: the wheel, whose spin axis is y of the marker at the wheel centre. The contact frame C, the
slips and all signs are those of docs/conventions.md; the model is described in docs/tire.md. In short

    deflection -> load Fz -> relaxation lengths -> contact deflections (u, v) -> slips -> magic_formula -> wrench at C

    du/dt = -c Vsx - |V|/sigma_kappa u,     |V| = |(Vx, Vsx/(mu k_x), Vsy/(mu k_y))|,     kappa = (u - tau
                                            Vsx)/sigma_kappa

and the same for v with Vsy and sigma_alpha. c is 1 on the ground and 0 in the air, mu the friction.

The equation is linear in u, so u = zp + cz du/dt has a closed form. At speed the steady state is the slip itself. At
rest nothing decays, and u is a spring without creep. Both directions have the same |V|, so that the slip of a sliding
wheel points against its velocity, in whichever direction it slides. k bounds the slip. At low speed it holds (u, v)
near the deflection of the peak force on this road: a wheel that slides to rest does not store more force than it can
carry.

Internal states: u and v; with turn slip, the twist of the contact patch (R0 times its angle), with an equation of the
same form, driven by R0 times the yaw rate; the give of the tread, by which a wheel stands on its rolling resistance
(solver.elements.tread). If TireSpec.turn_slip is None, the twist has one effect only: it resists turning the wheel on
the spot. Its moment acts below the speed PARKING_ENDS; above that speed the state decays without effect.

The file is long because specification, table and kernel of one element stand together (docs/contributing.md). The parts
of the kernel that can stand alone have their own files: tire_contact, magic_formula, turn_slip, tread.

Source: [Pacejka2012] 2.2 (slip), 4.3.3 (turn slip), 7.2 (relaxation), 8.6 (standstill).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.dual import add_partials, arctan, compose, differentiates, local, sqrt, value
from solver.compiled.kernel import kernel
from solver.compiled.so3 import quaternion_of_matrix
from solver.compiled.vec import add, cross, dot, load3, load33, scale, tmv
from solver.dimensions import Damping, Pressure, Speed, Time
from solver.elements.footprint import footprint
from solver.elements.instant import sums
from solver.elements.kind import ForceKind, Held
from solver.elements.magic_formula import (
    SLOWEST,
    camber_variable,
    load_increment,
    patch_forces,
    relaxation_lengths,
    rolling_resistance,
    slip_stiffness,
)
from solver.elements.marker import Context, Marker, Spec
from solver.elements.road import RoadTable, compile_road, friction_at
from solver.elements.slip_limits import SHORTEST
from solver.elements.smooth import ramp, smooth_sign, smooth_step, smoother_step
from solver.elements.tire_contact import contact_of, motion_of, real_kinematics, seeded_motion_of
from solver.elements.tire_data import PARKING_ENDS, PARKING_FULL, ROW, I, TireData, pack
from solver.elements.tire_limits import check
from solver.elements.tread import give_of, rolling_part
from solver.elements.turn_slip import parking_moment, saturated_moment, spin_slope
from solver.validate import finite, require

TIRE_UNITS = {
    **dict.fromkeys(('fx', 'fy', 'fz'), 'N'),  # force on the wheel at the contact point, contact frame
    **dict.fromkeys(('mx', 'my', 'mz'), 'N m'),  # moment on it
    # slip, slip angle, camber, spin velocity about +y
    **{'kappa': '', 'alpha': 'rad', 'gamma': 'rad', 'spin': 'rad/s'},
    **{'deflection': 'm', 'friction': ''},  # vertical deflection, road friction factor
    **dict.fromkeys(('px', 'py', 'pz'), 'm'),  # contact frame in the world: position
    **dict.fromkeys(('qx', 'qy', 'qz', 'qw'), ''),  # orientation
}
TIRE_COLUMNS = tuple(TIRE_UNITS)
OUTPUTS = {'energy': 'J', 'dissipation': 'W', **TIRE_UNITS}
STATES = 3  # internal states of a tire without twist: u, v, give of the tread; a tire with twist has one more

LOWEST_SPEED = 0.1  # least low_speed of a TireSpec [m/s]
LEAST_LOAD = 1e-9  # load from which there are friction forces, relative to FNOMIN
FULL_CONTACT = 0.02  # load from which the contact point follows the road fully, relative to FNOMIN
AIR_DECAY = 20.0  # rate at which contact deflections vanish in the air [1/s]
# Relaxation length of turn slip, relative to R0: half the length of the contact patch, 53 mm of 313 mm ([Pacejka2012]
# table 9.1).
TWIST_LENGTH = 0.17
SLIP_BOUND = 5.0  # bound k towards which |(kappa, tan alpha)| and R0 |phi_t| saturate smoothly at speed [-]
LOW_SLIP = 2.0  # the same bound at standstill, as a multiple of (peak force / slip stiffness) [-]
# Least friction with which the bounds at standstill are computed: with less, a car that stands with its wheels turned
# finds no equilibrium.
LEAST_GRIP = 0.1
LOW_TWIST = 3.0  # bound of the twist at standstill, as a multiple of (saturated moment / its slope over turn slip) [-]
AT_SPEED = 1.0 / (SLIP_BOUND * SLIP_BOUND)  # 1/k^2 at speed [-]
QUIET_SPEED = 0.01  # speed [m/s] below which |V| becomes V^2/QUIET_SPEED: at rest the contact is a spring without creep


@dataclass(frozen=True, kw_only=True)
class TireSpec(Spec):
    """A tire on a wheel.

    marker: at the wheel centre, y along the spin axis to the left. mirrored: True on the side the data were not
    measured on, so that asymmetries (conicity, ply steer, camber) are mirrored. pressure: inflation pressure [Pa]; None
    takes the data's INFLPRES. damping: vertical damping at nominal load [N s/m], in proportion to the load at other
    loads; None takes VERTICAL_DAMPING. low_speed: speed [m/s] below which standstill damping and the slip bound of
    standstill set in. standstill_damping: time constant tau [s] by which the contact velocity damps the contact spring
    at rest. turn_slip: effects of the turning of the contact patch about the road normal (data of version 6.1). true:
    side force and moments of a curved path too. false: none. None: only the moment that resists turning a wheel on the
    spot, which fades out between 2.5 and 5 m/s, if the data have it.
    """

    counted_as = 'tires'
    marker: Marker
    data: TireData
    mirrored: bool = False
    pressure: Pressure | None = None
    damping: Damping | None = None
    low_speed: Speed = 2.0
    standstill_damping: Time = 0.04
    turn_slip: bool | None = None

    def __post_init__(self) -> None:
        where = self.where
        if self.pressure is not None:
            self.set('pressure', finite(where, 'pressure', self.pressure, low=0.0, strict=True))
            remedy = 'the tire data have no NOMPRES, so pressure has no effect: remove it'
            require(self.data['NOMPRES'] > 0.0, where, 'pressure', self.pressure, remedy)
            check(f'{where}: pressure = {self.pressure:g}', self.data, self.pressure)
        if self.damping is not None:
            self.set('damping', finite(where, 'damping', self.damping, low=0.0))
        self.set('low_speed', finite(where, 'low_speed', self.low_speed, low=LOWEST_SPEED))
        self.set('standstill_damping', finite(where, 'standstill_damping', self.standstill_damping, low=0.0))
        if self.turn_slip:
            self.data.require_turn_slip(where)

    @property
    def parks(self) -> bool:
        """True where only the moment against turning on the spot acts."""
        return self.turn_slip is None and not self.data.lacks_turn_slip()

    @property
    def twists(self) -> bool:
        """True where the twist of the contact patch is an internal state."""
        return bool(self.turn_slip) or self.parks


class TireTable(NamedTuple):
    """Compiled data of n tires, and the road."""

    body: np.ndarray  # (n,) index of the wheel
    r: np.ndarray  # (n, 3) wheel centre from the centre of mass, in B [m]
    axis: np.ndarray  # (n, 3) spin axis in B
    slot: np.ndarray  # (n,) diagonal block of the body in the matrices
    state: np.ndarray  # (n,) index of the internal state u; behind it v, the twist (if any), and the give of the tread
    states: np.ndarray  # (n,) number of internal states
    side: np.ndarray  # (n,) +1, or -1 for a mirrored tire
    c: np.ndarray  # (n, ROW) coefficients, magic_formula.pack
    damping: np.ndarray  # (n,) vertical damping, relative to the nominal load [s/m]
    # (n, 5): low speed [m/s], tau [s]; 1/k^2 at standstill and friction 1: along x, along y, of the twist
    low: np.ndarray
    give: np.ndarray  # (n, 2): travel of the tread [m], its damping [s]
    road: RoadTable


def compile_tires(specs: Sequence[TireSpec], context: Context) -> TireTable:
    """Resolve names, reserve the internal states of each tire, pack coefficients."""
    n = len(specs)
    table = TireTable(
        body=np.zeros(n, np.int64),
        r=np.zeros((n, 3)),
        axis=np.zeros((n, 3)),
        slot=np.zeros(n, np.int64),
        state=np.zeros(n, np.int64),
        states=np.array([STATES + s.twists for s in specs], np.int64),
        side=np.array([-1.0 if s.mirrored else 1.0 for s in specs]),
        c=np.zeros((n, ROW)),
        damping=np.zeros(n),
        low=np.zeros((n, 5)),
        give=np.zeros((n, 2)),
        road=compile_road(context.road, footprint([s.data for s in specs])),
    )
    for e, spec in enumerate(specs):
        placed = context.marker(spec.where, spec.marker)
        table.body[e] = placed.body
        table.r[e] = placed.r
        table.axis[e] = placed.R[:, 1]
        table.slot[e] = context.slot(placed.body, placed.body)
        table.state[e] = context.internal_states(spec.where, int(table.states[e]))
        c = pack(spec.data.values, spec.data.version, spec.pressure, turn_slip=bool(spec.turn_slip), parking=spec.parks)
        table.c[e] = c
        table.damping[e] = (c[I.VERTICAL_DAMPING] if spec.damping is None else spec.damping) / c[I.FNOMIN]
        Kx, Ky = slip_stiffness(c, 0.0, c[I.FNOMIN], 0.0)
        k_x = LOW_SLIP * c[I.PDX1] * c[I.LMUX] * c[I.FNOMIN] / Kx
        k_y = LOW_SLIP * c[I.PDY1] * c[I.LMUY] * c[I.FNOMIN] / Ky
        table.low[e, :4] = spec.low_speed, spec.standstill_damping, 1.0 / (k_x * k_x), 1.0 / (k_y * k_y)
        table.give[e] = give_of(c[I.UNLOADED_RADIUS], c[I.QSY1] * c[I.LMY] * c[I.PRESSURE_MY])
        if spec.twists:
            limit = saturated_moment(c, c[I.PDY1] * c[I.LMUY] * c[I.FNOMIN], c[I.FNOMIN])
            table.low[e, 4] = (spin_slope(c, 0.0, c[I.FNOMIN], 0.0) / (LOW_TWIST * limit)) ** 2
    return table


@kernel(inline=True)
def _contact_state(z, cz, Vs, w, sigma, tau, fade, contact):
    """(deflection at this instant, slip) of one direction; z: the part zp of z = zp + cz zdot; w: square of the speed
    of fading."""
    # |V| as w/sqrt(w + q^2): w at rest, sqrt(w) at speed
    rate = w / (sqrt(w + QUIET_SPEED * QUIET_SPEED) * sigma) + AIR_DECAY * (1.0 - contact)
    drive = contact * Vs
    u = (z - cz * drive) / (1.0 + cz * rate)
    return u, u / sigma if fade.real == 0.0 else (u - tau * fade * drive) / sigma


@kernel(inline=True)
def _twist_state(z, cz, rolling, turning, sigma, slow, low, grip, tau, fade, contact):
    """(twist at this instant, R0 phi_t); rolling: square of the speed; turning: R0 yaw rate [m/s]; low: 1/k^2 on
    friction 1."""
    w = rolling + turning * turning * AT_SPEED
    if slow.real != 0.0:
        w = w + slow * turning * turning * low / (grip * grip)
    return _contact_state(z, cz, -turning, w, sigma, tau, fade, contact)


@kernel(inner=True)
def _parking(c, low, zp, cz, Vx, Vsy, turning, slow, tau, quiet, contact, Fz, mu, grip):
    """(twist at this instant [m], moment against it about the normal [N m]) below PARKING_ENDS; turning: R0 yaw rate
    [m/s].

    The speed over ground takes the place of Vx in the relaxation, and what drives the twist fades with the moment:
    where that ends nothing of the twist is left.
    """
    R0 = c[I.UNLOADED_RADIUS]
    over_ground = Vx * Vx + Vsy * Vsy
    top, full = PARKING_ENDS * PARKING_ENDS * c[I.SMALL], PARKING_FULL * PARKING_FULL * c[I.SMALL]
    fade = smoother_step((top - over_ground) / (top - full))
    sigma = 0.0 * Fz + TWIST_LENGTH * R0
    state, twist = _twist_state(zp, cz, over_ground, fade * turning, sigma, slow, low, grip, tau, quiet, contact)
    if Fz.real <= LEAST_LOAD * c[I.FNOMIN]:
        return state, 0.0 * Fz
    load = local(Fz, 1)
    moment = parking_moment(c, local(twist, 0), load, load_increment(c, load), local(mu, 2))
    return state, fade * compose(moment, twist, Fz, mu, mu)


@kernel(inline=True)
def _plain(a):
    """A vector without its derivatives."""
    return (value(a[0]), value(a[1]), value(a[2]))


@kernel(inline=True)
def _evaluate(table, e, motion, zp, cz):
    """Everything about tire e.

    zp: of (u, v, twist, give). Returns force and moment about the centre of mass on its body (both in W), and without
    derivatives: these states, outputs with the power that the vertical spring gives in the place of dissipation, the
    contact frame (point, e_x, e_y, n).
    """
    c = table.c[e]
    side = table.side[e]
    R0 = c[I.UNLOADED_RADIUS]
    F0 = c[I.FNOMIN]
    at = contact_of(c, table.damping[e], table.road, motion)
    Fz, Vx, Vsy = at.Fz, at.Vx, at.Vsy
    Vsx = Vx - motion.spin * at.rolling_radius
    mu = friction_at(table.road, motion.centre[0], motion.centre[1])
    # the friction of the road
    varies = table.road.patch.shape[0] > 0 or table.road.start.shape[0] > table.road.heights[0]

    # relaxation
    gamma = camber_variable(c, side * at.sin_camber, at.cos_camber)
    camber, load = local(gamma, 2), local(Fz, 3)  # arguments of the law, as kappa (0) and alpha (1) below
    dfz = load_increment(c, load)
    Kxk, Kya = slip_stiffness(c, camber, load, dfz)
    sigma_x, sigma_y = relaxation_lengths(c, camber, load, dfz, Kxk, Kya)
    shortest = SHORTEST * c[I.SMALL]
    sigma_x = compose(shortest + ramp(sigma_x - shortest, 0.5 * shortest), gamma, gamma, gamma, Fz)
    sigma_y = compose(shortest + ramp(sigma_y - shortest, 0.5 * shortest), gamma, gamma, gamma, Fz)
    contact = smooth_step(Fz / (FULL_CONTACT * F0))
    tilted = at.upright.real < 1.0  # what is not so costs a comparison, in place of products of derivatives
    if tilted:
        contact = contact * at.upright
    low_speed = table.low[e, 0]
    slow, quiet = 0.0 * Vx, 0.0 * Vx
    grip = mu if mu.real > LEAST_GRIP else 0.0 * mu + LEAST_GRIP
    w = Vx * Vx + (Vsx * Vsx + Vsy * Vsy) * AT_SPEED
    if Vx.real * Vx.real < low_speed * low_speed:
        slow = ramp(1.0 - Vx * Vx / (low_speed * low_speed), 0.0)
        slow = slow * slow
        w = w + slow * (Vsx * Vsx * table.low[e, 2] + Vsy * Vsy * table.low[e, 3]) / (grip * grip)
        quiet = ramp(1.0 - (Vx * Vx + Vsx * Vsx + Vsy * Vsy) / (low_speed * low_speed), 0.0)
        quiet = quiet * quiet
    tau = table.low[e, 1]
    state_u, kappa = _contact_state(zp[0], cz, Vsx, w, sigma_x, tau, quiet, contact)
    state_v, tan_alpha = _contact_state(zp[1], cz, Vsy, w, sigma_y, tau, quiet, contact)
    state_w, twist = 0.0 * Fz, 0.0 * Fz
    if c[I.TURN_SLIP] > 0.0:
        turning = R0 * (dot(motion.turning, at.n) - motion.spin * at.sin_camber)  # of the heading, about the normal
        sigma = 0.0 * Fz + TWIST_LENGTH * R0
        state_w, twist = _twist_state(
            zp[2], cz, Vx * Vx, turning, sigma, slow, table.low[e, 4], grip, tau, quiet, contact
        )
        twist = side * twist

    state_b, rolling = rolling_part(zp[3], cz, motion.spin * R0, table.give[e, 0], table.give[e, 1])

    # forces on the wheel in the contact frame; the Magic Formula counts alpha the other way, a mirrored tire y the
    # other way
    Fx, Fy, Mx, My, Mz = 0.0 * Fz, 0.0 * Fz, 0.0 * Fz, 0.0 * Fz, 0.0 * Fz
    if Fz.real > LEAST_LOAD * F0:
        forward = smooth_sign(Vx, SLOWEST)
        slip = -side * tan_alpha
        Fx, Fy, Mx, A, B = patch_forces(
            c,
            local(kappa, 0),
            local(slip, 1),
            camber,
            load,
            dfz,
            local(mu, -1),
            Kxk,
            Kya,
            local(twist, -1),
            local(forward, -1),
        )
        Fx, Fy, Mx = (
            compose(Fx, kappa, slip, gamma, Fz),
            compose(Fy, kappa, slip, gamma, Fz),
            compose(Mx, kappa, slip, gamma, Fz),
        )
        A, B = compose(A, kappa, slip, gamma, Fz), compose(B, kappa, slip, gamma, Fz)
        if differentiates(Fz) and (c[I.TURN_SLIP] > 0.0 or varies):  # its other arguments
            camber, load = local(gamma, -1), local(Fz, -1)
            dfz = load_increment(c, load)
            Kxk, Kya = slip_stiffness(c, camber, load, dfz)
            more = patch_forces(
                c,
                local(kappa, -1),
                local(slip, -1),
                camber,
                load,
                dfz,
                local(mu, 0),
                Kxk,
                Kya,
                local(twist, 1),
                local(forward, 2),
            )
            Fx = Fx + compose(more[0] - value(more[0]), mu, twist, forward, mu)
            Fy = Fy + compose(more[1] - value(more[1]), mu, twist, forward, mu)
            Mx = Mx + compose(more[2] - value(more[2]), mu, twist, forward, mu)
            A = A + compose(more[3] - value(more[3]), mu, twist, forward, mu)
            B = B + compose(more[4] - value(more[4]), mu, twist, forward, mu)
        My = rolling_resistance(c, Fx, Fz, gamma, Vx, rolling)
        Fy, Mx, Mz = Fy * side, Mx * side, (forward * A + B) * side
        if tilted:
            Fx, Fy, Mx, My, Mz = Fx * at.upright, Fy * at.upright, Mx * at.upright, My * at.upright, Mz * at.upright
    if c[I.PARKING] > 0.0:
        forwards, sideways = value(Vx), value(Vsy)
        over_ground = forwards * forwards + sideways * sideways
        if over_ground.real < PARKING_ENDS * PARKING_ENDS * c[I.SMALL]:
            turning = R0 * (dot(motion.turning, at.n) - motion.spin * at.sin_camber)
            state_w, moment = _parking(
                c, table.low[e, 4], zp[2], cz, Vx, Vsy, turning, slow, tau, quiet, contact, Fz, mu, grip
            )
            Mz = Mz + moment * at.upright
        else:
            state_w = 0.0 * Fz + zp[2] / (1.0 + cz * (PARKING_ENDS * c[I.SMALL_SPEED] / (TWIST_LENGTH * R0)))

    # wrench on the body: force at the contact point and moment, about the centre of mass
    F = add(scale(Fx, at.e_x), add(scale(Fy, at.e_y), scale(Fz, at.n)))
    M = add(scale(Mx, at.e_x), add(scale(My, at.e_y), scale(Mz, at.n)))
    p, point = motion.com, at.point
    arm = (point[0] - p[0], point[1] - p[1], point[2] - p[2])
    values = (
        at.energy, at.static * value(at.loaded_rate), value(Fx), value(Fy), value(Fz), value(Mx), value(My), value(Mz),
        value(kappa), arctan(value(tan_alpha)), arctan(value(at.sin_camber) / value(at.cos_camber)),
        value(motion.spin), value(at.deflection), value(mu),
    )  # fmt: skip
    states = (value(state_u), value(state_v), value(state_w), state_b)
    return F, add(M, cross(arm, F)), states, values, _plain(point), (_plain(at.e_x), _plain(at.e_y), _plain(at.n))


@kernel(inline=True)
def _store(table, e, R, twist, result, f, z, out):
    """Write the values that _evaluate returned for tire e; R, twist: of its body. Returns the torque on the body, in
    B."""
    i, j = table.body[e], table.state[e]
    F, M, states, values, point, frame = result
    T = tmv(R, M)
    power = 0.0 * values[0]
    for k in range(3):
        f[i, k] += value(F[k])
        f[i, 3 + k] += value(T[k])
        power += value(F[k]) * twist[k] + value(T[k]) * twist[3 + k]
        out[e, 14 + k] = point[k]
    for k in range(len(values)):
        out[e, k] = values[k]
    out[e, 1] = values[1] - power  # dE/dt = -static * loaded_rate
    x, y, n = frame
    C = (x[0].real, y[0].real, n[0].real, x[1].real, y[1].real, n[1].real, x[2].real, y[2].real, n[2].real)
    q = quaternion_of_matrix(C)
    for k in range(4):
        out[e, 17 + k] = q[k]
    z[j] = states[0]
    z[j + 1] = states[1]
    if table.states[e] > STATES:
        z[j + 2] = states[2]
    z[j + table.states[e] - 1] = states[3]
    return T


@kernel(borrow=True)
def tire_forces(table, now, effects, out):
    """Accumulate forces and tangents of all tires (contract: solver/elements/__init__.py)."""
    f, Kq, Kv = sums(effects)
    kin = now.kin
    for e in range(table.body.shape[0]):
        i = table.body[e]
        j = table.state[e]
        r = load3(table.r, e)
        a = load3(table.axis, e)
        last = j + table.states[e] - 1
        if now.tangents:
            R, p, twist = real_kinematics(kin, i)
            states = (now.zp[j].real, now.zp[j + 1].real, now.zp[j + 2].real, now.zp[last].real)
            result = _evaluate(table, e, seeded_motion_of(R, p, twist, r, a), states, now.cz)
            F, T = result[0], _store(table, e, R, twist, result, f, effects.z, out)
            s = table.slot[e]
            for k in range(3):
                add_partials(F[k], Kq, Kv, s, k)
                add_partials(T[k], Kq, Kv, s, 3 + k)
            # the turning of the axes of T: dT = T x dtheta
            Kq[s, 3, 4] -= value(T[2])
            Kq[s, 3, 5] += value(T[1])
            Kq[s, 4, 3] += value(T[2])
            Kq[s, 4, 5] -= value(T[0])
            Kq[s, 5, 3] -= value(T[1])
            Kq[s, 5, 4] += value(T[0])
        else:
            v = kin.v
            motion = (v[i, 0], v[i, 1], v[i, 2], v[i, 3], v[i, 4], v[i, 5])
            zero = 0.0 * motion[0]  # gives the states the number type of the motion
            placed = motion_of(load33(kin.R, i), load3(kin.p, i), motion, r, a)
            states = (now.zp[j] + zero, now.zp[j + 1] + zero, now.zp[j + 2] + zero, now.zp[last] + zero)
            result = _evaluate(table, e, placed, states, now.cz)
            _store(table, e, load33(kin.R, i), motion, result, f, effects.z, out)


def held_tires(table: TireTable, u: np.ndarray) -> Held:
    """Tires as they act in the search for static equilibrium: without the moment that resists turning on the spot, and
    rolling.

    The wheels then stand as those of a car that has rolled there: without twist, and at the same rest for every choice
    of turn_slip. A tread that holds a wheel would leave the car higher or lower, depending on the way that the search
    took. u: inputs (nu,), not changed.
    """
    c = table.c.copy()
    c[:, I.PARKING] = 0.0
    return Held(rolling_tires(table)._replace(c=c), u, {})


def rolling_tires(table: TireTable) -> TireTable:
    """Tires whose wheels roll from the smallest force on: the travel of the tread is infinite."""
    gives = table.give.copy()
    gives[:, 0] = np.inf
    return table._replace(give=gives)


def rolling_radius(c: np.ndarray, load: float, speed: float) -> float:
    """Effective rolling radius [m] of a tire of coefficients c under a vertical load [N], freely rolling at speed [m/s]
    ([B] eq. 7)."""
    R0, F0, q = c[I.UNLOADED_RADIUS], c[I.FNOMIN], load / c[I.FNOMIN]
    growth = R0 * c[I.Q_V1] * (speed / c[I.LONGVL]) ** 2
    c_z = (1.0 + c[I.PFZ1] * c[I.DPI]) * c[I.VERTICAL_STIFFNESS]
    return float(R0 * c[I.Q_RE0] + growth - F0 / c_z * (c[I.DREFF] * math.atan(c[I.BREFF] * q) + c[I.FREFF] * q))


TIRES = ForceKind(
    name='tires',
    spec=TireSpec,
    compile=compile_tires,
    kernel=tire_forces,
    outputs=OUTPUTS,
    wheels=True,
    held=held_tires,
    peak='deflection',
)
