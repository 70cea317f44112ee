"""Bushing: six-component elastic and viscous connection of two markers.

With R_FG the rotation of marker G on body j relative to marker F on body i, theta its rotation vector, d the position
of G and d' its velocity relative to F, and w the angular velocity of G relative to F (all along the axes of F):

    force on j  = -(k(d) + C d')            torque on j = -(Jr^-1(theta) m(theta) + Ct w)

k and m are the derivatives of a separable potential E(d, theta). Because d theta/dt = Jl^-1(theta) w and the transpose
of Jl^-1 is Jr^-1, this torque is the exact gradient: the bushing is conservative for large angles too, up to |theta| =
pi, where the rotation vector jumps. The reaction on i acts at the same point of space, the origin of G.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.portable import product
from solver.compiled.rows import add_rows, cross_rows, mul_rows, rows, sub_rows
from solver.compiled.so3 import inverse_jacobian_coefficients, log
from solver.compiled.vec import (
    add,
    add3,
    cross,
    cross_m,
    dot,
    load3,
    load33,
    m_cross,
    madd,
    mm,
    mscale,
    msub,
    mv,
    outer,
    scale,
    skew,
    sub,
    tmv,
    transpose,
)
from solver.elements.instant import sums
from solver.elements.kind import ForceKind
from solver.elements.laws import Law, evaluate_law
from solver.elements.marker import Context, Marker, Spec, compile_pairs
from solver.elements.relative import Nine, Three, add_by_place, add_by_rate, by_place, by_rate, relative_motion
from solver.validate import finite, require, vector

OUTPUTS = (
    {'energy': 'J', 'dissipation': 'W'}
    | dict.fromkeys(('fx', 'fy', 'fz'), 'N')
    | dict.fromkeys(('mx', 'my', 'mz'), 'N m')
    | dict.fromkeys(('x', 'y', 'z'), 'm')
    | dict.fromkeys(('rx', 'ry', 'rz'), 'rad')
)
Six = tuple[float, float, float, float, float, float]
ZERO: Six = (0.0,) * 6


@dataclass(frozen=True, kw_only=True)
class BushingSpec(Spec):
    """Bushing between two markers; see the module for the force. Axes are those of marker i.

    stiffness (N/m x3, N m/rad x3), damping (N s/m x3, N m s/rad x3), both >= 0; laws: up to six force laws, in N over m
    and N m over rad, that replace the linear stiffness of their axis (None keeps it); preload (N x3, N m x3) is added
    to stiffness * displacement. The outputs fx..mz are the force and torque on j, x..rz the displacement of j, along
    the axes of i.
    """

    counted_as = 'bushings'
    i: Marker
    j: Marker
    stiffness: Six
    damping: Six = ZERO
    laws: tuple[Law | None, ...] = (None,) * 6
    preload: Six = ZERO

    def __post_init__(self) -> None:
        for field in ('stiffness', 'damping'):
            values = vector(self.where, field, getattr(self, field), 6)
            self.set(field, tuple(finite(self.where, f'{field}[{k}]', x, low=0.0) for k, x in enumerate(values)))
        self.set('preload', vector(self.where, 'preload', self.preload, 6))
        require(len(self.laws) == 6, self.where, 'laws', self.laws, 'must have six entries, None for a linear axis')


class BushingTable(NamedTuple):
    """Columns of all bushings. Matrices are along the axes of body i: K = F diag(stiffness) F^T."""

    body: np.ndarray  # (n, 2)
    r_i: np.ndarray  # (n, 3) origin of F from the centre of mass of i, in B_i [m]
    r_j: np.ndarray  # (n, 3) origin of G from the centre of mass of j, in B_j [m]
    F: np.ndarray  # (n, 3, 3) axes of marker F in B_i
    H: np.ndarray  # (n, 3, 3) G F^T: makes R_i^T R_j H the rotation of G relative to F, along the axes of B_i
    K: np.ndarray  # (n, 3, 3) [N/m]
    C: np.ndarray  # (n, 3, 3) [N s/m]
    Kt: np.ndarray  # (n, 3, 3) [N m/rad]
    Ct: np.ndarray  # (n, 3, 3) [N m s/rad]
    preload: np.ndarray  # (n, 6)
    nonlinear: np.ndarray  # (n,) 1 if some axis has a law
    law: np.ndarray  # (n, 6) law of each axis of F, -1 for linear
    stiffness: np.ndarray  # (n, 6) linear stiffness of each axis of F, 0 where there is a law
    slot: np.ndarray  # (n, 4) blocks ii ij ji jj


def compile_bushings(specs: Sequence[BushingSpec], context: Context) -> BushingTable:
    """Resolve names and laws into a table."""
    n = len(specs)
    pairs = compile_pairs(specs, context)
    table = BushingTable(
        body=pairs.body,
        r_i=pairs.r_i,
        r_j=pairs.r_j,
        F=pairs.F,
        H=np.zeros((n, 3, 3)),
        K=np.zeros((n, 3, 3)),
        C=np.zeros((n, 3, 3)),
        Kt=np.zeros((n, 3, 3)),
        Ct=np.zeros((n, 3, 3)),
        preload=np.zeros((n, 6)),
        nonlinear=np.array([any(law is not None for law in s.laws) for s in specs], np.int64),
        law=np.zeros((n, 6), np.int64),
        stiffness=np.zeros((n, 6)),
        slot=pairs.slot,
    )
    for e, (spec, F, G) in enumerate(zip(specs, pairs.F, pairs.G, strict=True)):
        table.H[e] = product(G, F.T)
        table.law[e] = [context.law(law) for law in spec.laws]
        table.stiffness[e] = np.where(table.law[e] < 0, spec.stiffness, 0.0)
        for M, values in (
            (table.K, table.stiffness[e, :3]),
            (table.Kt, table.stiffness[e, 3:]),
            (table.C, spec.damping[:3]),
            (table.Ct, spec.damping[3:]),
        ):
            M[e] = product(F * values, F.T)
        table.preload[e, :3], table.preload[e, 3:] = product(F, spec.preload[:3]), product(F, spec.preload[3:])
    return table


@kernel(inline=True)
def _elastic(table, laws, e, part, x):
    """Return (dE/dx, d2E/dx2, E) of the elastic potential of bushing e for x along B_i; part 0: displacement, 3:
    rotation."""
    if part == 0:
        K = load33(table.K, e)
    else:
        K = load33(table.Kt, e)
    preload = (table.preload[e, part], table.preload[e, part + 1], table.preload[e, part + 2])
    linear = mv(K, x)
    g = add(linear, preload)
    energy = 0.5 * dot(x, linear) + dot(x, preload)
    k = mscale(1.0 + 0.0 * x[0], K)
    if table.nonlinear[e]:
        F = load33(table.F, e)
        y = tmv(F, x)
        for axis in range(3):
            n = (table.F[e, 0, axis], table.F[e, 1, axis], table.F[e, 2, axis])
            value, slope, area = evaluate_law(laws, table.law[e, part + axis], y[axis])
            g = add(g, scale(value, n))
            energy += area
            k = madd(k, mscale(slope, outer(n, n)))
    return g, k, energy


@kernel(inline=True)
def _torque_tangent(x, s, c, e, m, M):
    """Derivative of Jr^-1(x) m with respect to a rotation increment along the axes of F: (d/dx)(Jr^-1 m) Jl^-1.

    s = |x|^2; (c, e): inverse_jacobian_coefficients(s); M = dm/dx.
    """
    xm = dot(x, m)
    # d(x x (x x m)) = xm dx + x m.dx - 2 m x.dx at constant m ; de = 2 e x.dx
    D = msub(outer(x, scale(c, m)), mscale(0.5, skew(m)))
    D = madd(D, outer(sub(scale(2.0 * e * xm, x), scale(2.0 * (c + e * s), m)), x))
    t = c * xm
    D = (D[0] + t, D[1], D[2], D[3], D[4] + t, D[5], D[6], D[7], D[8] + t)
    # + Jr^-1 M
    xM = cross_m(x, M)
    D = madd(madd(D, M), madd(mscale(0.5, xM), mscale(c, cross_m(x, xM))))
    # times Jl^-1 = 1 - skew(x)/2 + c skew(x)^2
    Dx = m_cross(D, x)
    return madd(msub(D, mscale(0.5, Dx)), mscale(c, m_cross(Dx, x)))


class Turned(NamedTuple):
    """Orientation of G to F and its rate, beside the motion of its origin (solver.elements.relative), along the axes of
    B_i."""

    d: Three  # displacement: G from F [m]
    theta: Three  # rotation vector [rad]
    w: Three  # angular velocity relative to i [rad/s]


class Loads(NamedTuple):
    """Force and torque on j along the axes of B_i, and what their tangents need."""

    force: Three  # [N]
    torque: Three  # [N m]
    m: Three  # dE/dtheta [N m]
    K: Nine  # d2E/dd2 [N/m]
    Kt: Nine  # d2E/dtheta2 [N m/rad]
    s2: float  # |theta|^2
    c1: float  # inverse_jacobian_coefficients(s2)
    c2: float
    energy: float  # [J]
    dissipation: float  # [W]


@kernel(inline=True)
def _turned(table, n, at):
    """The Turned of bushing n in the relative motion `at`."""
    return Turned(sub(at.e, load3(table.r_i, n)), log(mm(at.S, load33(table.H, n))), sub(at.s, at.w_i))


@kernel(inline=True)
def _loads(table, laws, n, at, by):
    """The Loads of bushing n in the relative motion `at`, turned `by`."""
    g, K, energy = _elastic(table, laws, n, 0, by.d)
    m, Kt, energy_t = _elastic(table, laws, n, 3, by.theta)
    viscous = mv(load33(table.C, n), at.d_dot)
    viscous_t = mv(load33(table.Ct, n), by.w)
    s2 = dot(by.theta, by.theta)
    c1, c2 = inverse_jacobian_coefficients(s2)
    xm = cross(by.theta, m)
    elastic_t = add(m, add(scale(0.5, xm), scale(c1, cross(by.theta, xm))))
    force = scale(-1.0, add(g, viscous))
    torque = scale(-1.0, add(elastic_t, viscous_t))
    dissipation = dot(at.d_dot, viscous) + dot(by.w, viscous_t)
    return Loads(force, torque, m, K, Kt, s2, c1, c2, energy + energy_t, dissipation)


@kernel(inline=True)
def _add_loads(table, n, at, on, f):
    """Accumulate the forces on both bodies."""
    i = table.body[n, 0]
    j = table.body[n, 1]
    F_W = mv(at.R, on.force)
    add3(f, j, 0, F_W)
    add3(f, i, 0, scale(-1.0, F_W))
    add3(f, j, 3, tmv(at.S, add(cross(at.rho, on.force), on.torque)))
    add3(f, i, 3, sub(scale(-1.0, on.torque), cross(at.e, on.force)))


@kernel(inline=True)
def _show(table, n, by, on, out):
    """Assign the outputs, along the axes of F."""
    F = load33(table.F, n)
    out[n, 0] = on.energy
    out[n, 1] = on.dissipation
    o1 = tmv(F, on.force)
    o2 = tmv(F, on.torque)
    o3 = tmv(F, by.d)
    o4 = tmv(F, by.theta)
    for k in range(3):
        out[n, 2 + k] = o1[k]
        out[n, 5 + k] = o2[k]
        out[n, 8 + k] = o3[k]
        out[n, 11 + k] = o4[k]


@kernel(inline=True)
def _add_stiffness(table, n, at, by, on, Kq):
    """Accumulate the tangents of the forces with respect to position and rotation (columns of
    solver.elements.relative)."""
    C = load33(table.C, n)
    D = msub(m_cross(C, at.w_i), on.K)
    E = msub(m_cross(load33(table.Ct, n), at.s), _torque_tangent(by.theta, on.s2, on.c1, on.c2, on.m, on.Kt))
    c = by_place(at, on.force, C, D)
    back = transpose(at.S)
    R = rows(transpose(at.R))
    S = rows(at.S)
    E_S = mul_rows(E, S)
    p_i = sub_rows(cross_rows(on.force, R), cross_rows(at.e, c.p))
    a_i = sub_rows(rows(madd(cross_m(on.force, skew(at.e)), E)), cross_rows(at.e, c.a))
    b_i = add_rows(add_rows(cross_rows(on.force, cross_rows(at.rho, S)), cross_rows(at.e, c.b)), E_S)
    p_j = mul_rows(back, cross_rows(at.rho, c.p))
    a_j = mul_rows(back, sub_rows(cross_rows(at.rho, c.a_seen), rows(madd(E, skew(on.torque)))))
    b_j = mul_rows(back, add_rows(add_rows(cross_rows(at.rho, c.b_seen), cross_rows(on.torque, S)), E_S))
    add_by_place(table.slot, n, at, c, (p_i, a_i, b_i), (p_j, a_j, b_j), Kq)


@kernel(inline=True)
def _add_damping(table, n, at, Kv):
    """Accumulate the tangents of the forces with respect to velocity."""
    c = by_rate(at, load33(table.C, n))
    Ct = load33(table.Ct, n)
    back = transpose(at.S)
    Ct_S = mul_rows(Ct, rows(at.S))
    Ct_ = rows(mscale(1.0 + 0.0 * at.e[0], Ct))  # of the type of the motion
    p_i = cross_rows(at.e, c.p)
    a_i = sub_rows(cross_rows(at.e, c.a), Ct_)
    b_i = add_rows(cross_rows(at.e, c.b), Ct_S)
    p_j = mul_rows(back, cross_rows(at.rho, c.p))
    a_j = mul_rows(back, sub_rows(cross_rows(at.rho, c.a), Ct_))
    b_j = mul_rows(back, add_rows(cross_rows(at.rho, c.b), Ct_S))
    add_by_rate(table.slot, n, at, c, (p_i, a_i, b_i), (p_j, a_j, b_j), Kv)


@kernel(borrow=True)
def bushing_forces(table, now, effects, out):
    """Accumulate forces and tangents of all bushings (contract: solver/elements/__init__.py).

    Everything is computed along the axes of B_i (solver.elements.relative).
    """
    f, Kq, Kv = sums(effects)
    kin = now.kin
    for n in range(table.body.shape[0]):
        at = relative_motion(table, n, kin)
        by = _turned(table, n, at)
        on = _loads(table, now.laws, n, at, by)
        _add_loads(table, n, at, on, f)
        _show(table, n, by, on, out)
        if now.tangents:
            _add_stiffness(table, n, at, by, on, Kq)
            _add_damping(table, n, at, Kv)


BUSHINGS = ForceKind(
    name='bushings', spec=BushingSpec, compile=compile_bushings, kernel=bushing_forces, outputs=OUTPUTS, rotation='rx'
)
