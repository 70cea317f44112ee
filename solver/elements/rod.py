"""Rod: a massless link between a bushing at a point P of body i and a ball joint at a point Q of body j.

The rod pulls along the line from P to Q, by a law of its extension (the stiffness of its mountings). The bushing at P
also resists the swing of the rod out of its design direction. With d = p_PQ seen from marker i, s = |d|, n = d/s and
the design direction along z of marker i:

    E(d)       = U(s - length) + (swing_y n_x^2 + swing_x n_y^2)/2          stored energy; U: integral of the law
    force on j = -dE/dd - damping n (n . d') - across (d' - n (n . d'))

The second term of E is a torsional spring for small angles of swing: n_x and n_y are the sines of these angles. The
reaction on i acts at Q, not at P, so that it contains the moment of the bushing on i. E depends on d alone: the rod
spins freely about its own line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.rows import add_rows, cross_rows, mul_rows, rows, sub_rows
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
from solver.dimensions import Damping, Length, TurnStiffness
from solver.elements.instant import sums
from solver.elements.kind import ForceKind
from solver.elements.laws import Law, evaluate_law
from solver.elements.marker import Context, Marker, Spec, compile_pairs
from solver.elements.relative import add_by_place, add_by_rate, by_place, by_rate, relative_motion
from solver.validate import finite, vector

OUTPUTS = {'energy': 'J', 'dissipation': 'W', 'length': 'm', 'rate': 'm/s', 'force': 'N'}


@dataclass(frozen=True, kw_only=True)
class RodSpec(Spec):
    """Massless link from the origin of marker i to that of marker j; see the module for the force.

    length: free length [m]. law: force [N] over extension [m], tension positive. damping: along the rod [N s/m]. swing:
    stiffness against swing about x and about y of marker i [N m/rad]; z of marker i is the design direction of the rod.
    across: damping of motion across the rod [N s/m].
    """

    i: Marker
    j: Marker
    length: Length
    law: Law
    damping: Damping = 0.0
    swing: tuple[TurnStiffness, TurnStiffness] = (0.0, 0.0)
    across: Damping = 0.0

    def __post_init__(self) -> None:
        self.set('length', finite(self.where, 'length', self.length, low=0.0, strict=True))
        for field in ('damping', 'across'):
            self.set(field, finite(self.where, field, getattr(self, field), low=0.0))
        self.set('swing', vector(self.where, 'swing', self.swing, 2))


class RodTable(NamedTuple):
    """Compiled data of n rods; matrices are along the axes of body i."""

    body: np.ndarray  # (n, 2) indices of the bodies i and j
    r_i: np.ndarray  # (n, 3) P from the centre of mass of i, in B_i [m]
    r_j: np.ndarray  # (n, 3) Q from the centre of mass of j, in B_j [m]
    law: np.ndarray  # (n,) index of the law
    length: np.ndarray  # (n,) free length [m]
    damping: np.ndarray  # (n,) [N s/m]
    across: np.ndarray  # (n,) [N s/m]
    S: np.ndarray  # (n, 3, 3) the energy of the swing is n . S n / 2 [N m/rad]
    slot: np.ndarray  # (n, 4) matrix blocks ii, ij, ji, jj


def compile_rods(specs: Sequence[RodSpec], context: Context) -> RodTable:
    """Resolve names and laws into a table."""
    pairs = compile_pairs(specs, context)
    about = np.array([s.swing for s in specs], float).reshape(len(specs), 2)
    x, y = pairs.F[:, :, 0], pairs.F[:, :, 1]
    return RodTable(
        body=pairs.body,
        r_i=pairs.r_i,
        r_j=pairs.r_j,
        law=np.array([context.law(s.law) for s in specs], np.int64),
        length=np.array([s.length for s in specs], float),
        damping=np.array([s.damping for s in specs], float),
        across=np.array([s.across for s in specs], float),
        S=about[:, 1, None, None] * x[:, :, None] * x[:, None, :]
        + about[:, 0, None, None] * y[:, :, None] * y[:, None, :],
        slot=pairs.slot,
    )


@kernel(inline=True)
def _add_stiffness(table, n, at, force, C, D, Kq):
    """Accumulate the tangents of the forces with respect to position and rotation. All moments are those of the force
    at Q."""
    c = by_place(at, force, C, D)
    back = transpose(at.S)
    p_i = sub_rows(cross_rows(force, rows(transpose(at.R))), cross_rows(at.e, c.p))
    a_i = sub_rows(rows(cross_m(force, skew(at.e))), cross_rows(at.e, c.a))
    b_i = add_rows(cross_rows(force, cross_rows(at.rho, rows(at.S))), cross_rows(at.e, c.b))
    p_j, a_j, b_j = (
        mul_rows(back, cross_rows(at.rho, c.p)),
        mul_rows(back, cross_rows(at.rho, c.a_seen)),
        mul_rows(back, cross_rows(at.rho, c.b_seen)),
    )
    add_by_place(table.slot, n, at, c, (p_i, a_i, b_i), (p_j, a_j, b_j), Kq)


@kernel(inline=True)
def _add_damping(table, n, at, C, Kv):
    """Accumulate the tangents of the forces with respect to velocity."""
    c = by_rate(at, C)
    back = transpose(at.S)
    on_i = (cross_rows(at.e, c.p), cross_rows(at.e, c.a), cross_rows(at.e, c.b))
    on_j = (
        mul_rows(back, cross_rows(at.rho, c.p)),
        mul_rows(back, cross_rows(at.rho, c.a)),
        mul_rows(back, cross_rows(at.rho, c.b)),
    )
    add_by_rate(table.slot, n, at, c, on_i, on_j, Kv)


@kernel(borrow=True)
def rod_forces(table, now, effects, out):
    """Accumulate forces and tangents of all rods (contract: solver/elements/__init__.py).

    Everything is computed along the axes of B_i (solver.elements.relative).
    """
    f, Kq, Kv = sums(effects)
    kin = now.kin
    for n in range(table.length.shape[0]):
        i = table.body[n, 0]
        j = table.body[n, 1]
        at = relative_motion(table, n, kin)
        d = sub(at.e, load3(table.r_i, n))
        s = np.sqrt(dot(d, d))
        t = 1.0 / s
        along = scale(t, d)
        rate = dot(along, at.d_dot)
        slide = sub(at.d_dot, scale(rate, along))
        tension, stiffness, energy = evaluate_law(now.laws, table.law[n], s - table.length[n])
        swing = load33(table.S, n)
        q = mv(swing, along)
        nq = dot(along, q)
        bend = sub(q, scale(nq, along))  # s times the force of the swing
        c = table.damping[n]
        k = table.across[n]
        force = scale(-1.0, add(add(scale(tension + c * rate, along), scale(t, bend)), scale(k, slide)))
        F_W = mv(at.R, force)
        add3(f, j, 0, F_W)
        add3(f, i, 0, scale(-1.0, F_W))
        add3(f, j, 3, tmv(at.S, cross(at.rho, force)))
        add3(f, i, 3, scale(-1.0, cross(at.e, force)))
        if now.tangents:
            # -d(force)/dd at constant d_dot; the second derivative of the swing's energy is t^2 (S - 2 (n bend^T + bend
            # n^T) - n.S n)
            nn = outer(along, along)
            plain = t * (tension + (c - k) * rate)
            D = madd(mscale(stiffness - plain, nn), mscale(t * t, swing))
            D = msub(D, mscale(2.0 * t * t, madd(outer(along, bend), outer(bend, along))))
            D = madd(D, mscale((c - k) * t, outer(along, slide)))
            p = plain - t * t * nq
            D = (D[0] + p, D[1], D[2], D[3], D[4] + p, D[5], D[6], D[7], D[8] + p)
            C = mscale(c - k, nn)
            C = (C[0] + k, C[1], C[2], C[3], C[4] + k, C[5], C[6], C[7], C[8] + k)
            D = msub(m_cross(C, at.w_i), D)
            _add_stiffness(table, n, at, force, C, D, Kq)
            _add_damping(table, n, at, C, Kv)
        out[n, 0] = energy + 0.5 * nq
        out[n, 1] = c * rate * rate + k * dot(slide, slide)
        out[n, 2] = s
        out[n, 3] = rate
        out[n, 4] = tension + c * rate


RODS = ForceKind(name='rods', spec=RodSpec, compile=compile_rods, kernel=rod_forces, outputs=OUTPUTS)
