"""Nonholonomic contacts: a thin disc that rolls on a plane without slipping, and a knife edge.

Both act at one point C: each row of the constraint is a force in a direction d on body j, and the opposite force on
body i. The row is a v = d . (velocity at C of body j - velocity at C of body i), which has to vanish.

For the disc, C is its lowest point above the plane: p_G - r e, with e = (n - (n . g) g)/s, s = |n - (n . g) g|, n the
normal of the plane and g the axis of the disc. The row along n is the gradient of the height n . p_FG - r s, so it is
holonomic. The other rows have no residual of positions: phi holds their velocity a v.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.vec import (
    col,
    cross,
    dot,
    load3,
    load33,
    madd,
    minus,
    mm,
    mscale,
    mv,
    outer,
    put33,
    scale,
    skew,
    sub,
    tmv,
    transpose,
)
from solver.dimensions import Length
from solver.elements.kind import ConstraintKind
from solver.elements.marker import ConstraintSpec, Context, Marker, compile_pairs, number_pairs
from solver.elements.point_pair import angular_velocity, linear_velocity, point_position
from solver.errors import suggestion
from solver.validate import finite, require

KNIFE_EDGE, ROLLING = 0, 1
# Kind of contact -> its rows: (name, 1 if the row is holonomic).
KINDS: dict[str, tuple[tuple[str, int], ...]] = {
    'knife_edge': (('y', 0),),
    'rolling': (('z', 1), ('x', 0), ('y', 0)),
}


@dataclass(frozen=True, kw_only=True)
class ContactSpec(ConstraintSpec):
    """A contact that constrains velocities, between the plane or ground i and the rolling or sliding body j.

    kind: 'rolling': a thin disc with centre and axis (z) at marker j rolls on the plane through marker i, normal to the
    z axis of i. It does not slip, and does not leave the plane. Rows: z (height above the plane), x and y (slip along
    the axes of marker i). 'knife_edge': the point of marker j does not move over the ground i along the y axis of j
    (the blade lies along x). It is not kept on a plane. The reactions of the rows have no limit: the plane can also
    pull a disc down. radius: of the disc [m], positive, for the kind rolling only.
    """

    kind: Literal['rolling', 'knife_edge']
    i: Marker
    j: Marker
    radius: Length | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            require(False, self.where, 'kind', self.kind, 'unknown kind of contact' + suggestion(str(self.kind), KINDS))
        require(self.i.body != self.j.body, self.where, 'j.body', self.j.body, 'must differ from i.body')
        if self.kind == 'rolling':
            require(
                self.radius is not None,
                self.where,
                'radius',
                None,
                'a rolling contact needs the radius of the disc in m',
            )
            self.set('radius', finite(self.where, 'radius', self.radius, low=0.0, strict=True))
        else:
            require(self.radius is None, self.where, 'radius', self.radius, 'only a rolling contact has a radius')

    def row_names(self) -> list[str]:
        """Names of the constraint rows, '<contact>/<row>'."""
        return [f'{self.name}/{name}' for name, _ in KINDS[self.kind]]

    def holonomic(self) -> list[int]:
        """1 for rows of positions, 0 for rows of velocities."""
        return [flag for _, flag in KINDS[self.kind]]


class ContactTable(NamedTuple):
    """Compiled data of n contacts."""

    code: np.ndarray  # (n,) KNIFE_EDGE or ROLLING
    row: np.ndarray  # (n,) first row in phi
    entry: np.ndarray  # (n, 2) Jacobian blocks of i and j
    body: np.ndarray  # (n, 2) indices of i and j
    r_i: np.ndarray  # (n, 3) marker i from the centre of mass of body i, in body i [m]
    r_j: np.ndarray  # (n, 3) marker j from the centre of mass of body j, in body j [m]
    F: np.ndarray  # (n, 3, 3) axes of marker i, in body i
    G: np.ndarray  # (n, 3, 3) axes of marker j, in body j
    radius: np.ndarray  # (n,) [m]
    slot: np.ndarray  # (n, 4) matrix blocks ii, ij, ji, jj


def compile_contacts(specs: Sequence[ContactSpec], context: Context) -> ContactTable:
    """Resolve names into a table."""
    first_row, entries = number_pairs(specs, context)
    return ContactTable(
        code=np.array([ROLLING if s.kind == 'rolling' else KNIFE_EDGE for s in specs], np.int64),
        row=first_row,
        entry=entries,
        radius=np.array([s.radius or 0.0 for s in specs], float),
        **compile_pairs(specs, context)._asdict(),
    )


@kernel(inline=True)
def _put(gradients, J, table, e, row, R_i, R_j, to_i, to_j, d, kin):
    """Assign a row along d at the point that is to_i and to_j [m, in W] from the centres of mass, when `gradients`;
    returns a v."""
    i = table.body[e, 0]
    j = table.body[e, 1]
    t_i = tmv(R_i, cross(d, to_i))
    t_j = tmv(R_j, cross(to_j, d))
    if gradients:
        for c in range(3):
            J[table.entry[e, 0], row, c] = -d[c]
            J[table.entry[e, 0], row, 3 + c] = t_i[c]
            J[table.entry[e, 1], row, c] = d[c]
            J[table.entry[e, 1], row, 3 + c] = t_j[c]
    slide = dot(d, sub(linear_velocity(kin, j), linear_velocity(kin, i)))
    return slide + dot(t_i, angular_velocity(kin, i)) + dot(t_j, angular_velocity(kin, j))


@kernel(borrow=True)
def evaluate_contacts(table, kin, gradients, phi, J):
    """Assign residuals phi (nc,), of velocity for rows that are not holonomic; when `gradients`, blocks J (entries + 1,
    6, 6) of A."""
    for e in range(table.row.shape[0]):
        i = table.body[e, 0]
        j = table.body[e, 1]
        R_i = load33(kin.R, i)
        R_j = load33(kin.R, j)
        G = load33(table.G, e)
        centre = point_position(kin, j, load3(table.r_j, e))
        row = table.row[e]
        if table.code[e] == KNIFE_EDGE:
            phi[row] = _put(
                gradients,
                J,
                table,
                e,
                0,
                R_i,
                R_j,
                sub(centre, load3(kin.p, i)),
                sub(centre, load3(kin.p, j)),
                mv(R_j, col(G, 1)),
                kin,
            )
        else:
            F = mm(R_i, load33(table.F, e))
            n = col(F, 2)
            g = mv(R_j, col(G, 2))
            u = sub(n, scale(dot(n, g), g))
            s = np.sqrt(dot(u, u))
            C = sub(centre, scale(table.radius[e] / s, u))
            to_i = sub(C, load3(kin.p, i))
            to_j = sub(C, load3(kin.p, j))
            _put(gradients, J, table, e, 0, R_i, R_j, to_i, to_j, n, kin)
            phi[row] = dot(n, sub(centre, point_position(kin, i, load3(table.r_i, e)))) - table.radius[e] * s
            phi[row + 1] = _put(gradients, J, table, e, 1, R_i, R_j, to_i, to_j, col(F, 0), kin)
            phi[row + 2] = _put(gradients, J, table, e, 2, R_i, R_j, to_i, to_j, col(F, 1), kin)


@kernel(borrow=True)
def add_contact_gradients(table, kin, lam, Kq, Kv):
    """Add d(A^T lam)/dq of all contacts to Kq (unsymmetric: A is no gradient); Kv is left alone."""
    for e in range(table.row.shape[0]):
        i = table.body[e, 0]
        j = table.body[e, 1]
        s_ii = table.slot[e, 0]
        s_ij = table.slot[e, 1]
        s_ji = table.slot[e, 2]
        s_jj = table.slot[e, 3]
        R_i = load33(kin.R, i)
        R_j = load33(kin.R, j)
        G = load33(table.G, e)
        r_j = load3(table.r_j, e)
        row = table.row[e]
        zero = mscale(0.0, R_i)
        C = point_position(kin, j, r_j)
        # force P on j at C; their derivatives with respect to the turns of i and j (C follows the translation of j)
        P_i = zero
        P_j = zero
        C_i = zero
        C_j = minus(mm(R_j, skew(r_j)))
        if table.code[e] == KNIFE_EDGE:
            P = scale(lam[row], mv(R_j, col(G, 1)))
            P_j = minus(mm(skew(P), R_j))
        else:
            P = mv(R_i, mv(load33(table.F, e), (lam[row + 1], lam[row + 2], lam[row])))
            P_i = minus(mm(skew(P), R_i))
            n = mv(R_i, mv(load33(table.F, e), (0.0, 0.0, 1.0)))
            g = mv(R_j, col(G, 2))
            c = dot(n, g)
            u = sub(n, scale(c, g))
            s = np.sqrt(dot(u, u))
            up = scale(1.0 / s, u)
            rate = table.radius[e] / s
            C = sub(C, scale(table.radius[e], up))
            # d up = (1 - up up^T)(dn - g (dn . g + n . dg) - c dg)/s, with up . g = 0
            across = madd(_identity(-rate), mscale(rate, outer(up, up)))
            C_i = minus(mm(mm(across, madd(_identity(1.0), minus(outer(g, g)))), mm(skew(n), R_i)))
            C_j = madd(C_j, mm(mm(across, madd(_identity(c), outer(g, n))), mm(skew(g), R_j)))
        on_i = skew(sub(C, load3(kin.p, i)))
        on_j = skew(sub(C, load3(kin.p, j)))
        by = skew(P)
        put33(Kq, s_ji, 0, 3, P_i)
        put33(Kq, s_jj, 0, 3, P_j)
        put33(Kq, s_ii, 0, 3, minus(P_i))
        put33(Kq, s_ij, 0, 3, minus(P_j))
        back_i = transpose(R_i)
        back_j = transpose(R_j)
        torque_i = tmv(R_i, cross(sub(C, load3(kin.p, i)), P))
        torque_j = tmv(R_j, cross(sub(C, load3(kin.p, j)), P))
        put33(Kq, s_ji, 3, 3, mm(back_j, madd(mm(on_j, P_i), minus(mm(by, C_i)))))
        put33(Kq, s_jj, 3, 3, madd(skew(torque_j), mm(back_j, madd(mm(on_j, P_j), minus(mm(by, C_j))))))
        put33(Kq, s_ii, 3, 3, minus(madd(skew(torque_i), mm(back_i, madd(mm(on_i, P_i), minus(mm(by, C_i)))))))
        put33(Kq, s_ij, 3, 3, minus(mm(back_i, madd(mm(on_i, P_j), minus(mm(by, C_j))))))
        turn = mm(back_i, by)
        put33(Kq, s_ij, 3, 0, turn)
        put33(Kq, s_ii, 3, 0, minus(turn))


@kernel(inline=True)
def _identity(m):
    return (m, 0.0, 0.0, 0.0, m, 0.0, 0.0, 0.0, m)


CONTACTS = ConstraintKind(
    name='contacts',
    spec=ContactSpec,
    compile=compile_contacts,
    residuals=evaluate_contacts,
    hessians=add_contact_gradients,
)
