"""Joints: up to six constraint rows between marker F on body i and marker G on body j.

Rows are the components of p_FG in the world (where all three vanish) or along the axes of F, dot products of marker axes, the
constant-velocity condition and the distance; kinds are lists of rows (table in docs/conventions.md). Gradients and second
derivatives are exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.elements.marker import Context, Marker, Spec, compile_pairs, finite, require
from solver.elements.point_pair import add_point_pair_tangent, point_position
from solver.errors import suggestion
from solver.jit import kernel, sixes
from solver.lie.vec import add, col, cross, dot, load3, load33, m_cross, mm, mscale, mv, outer, put33, scale, skew, sub, tmv, transpose

DX, DY, DZ = 0, 1, 2  # component of p_FG along an axis of F
AXES = 3  # 3 + 3 a + b: F_a . G_b
TWIST = 12  # F_x . G_y - F_y . G_x
DISTANCE = 13
# Components of p_FG along the axes of W, for joints that close all three: the same constraint as DX, DY, DZ, but linear in the
# positions and without a dependence on the rotation of i, which cuts the energy error of the midpoint rule tenfold (measured
# on the slider-crank, docs/decisions/0002).
PX, PY, PZ = 14, 15, 16
_XY, _XZ, _YZ, _ZZ = AXES + 1, AXES + 2, AXES + 5, AXES + 8

KINDS: dict[str, tuple[int, ...]] = {
    'fixed': (PX, PY, PZ, _XY, _XZ, _YZ),
    'revolute': (PX, PY, PZ, _XZ, _YZ),
    'prismatic': (DX, DY, _XY, _XZ, _YZ),
    'cylindrical': (DX, DY, _XZ, _YZ),
    'universal': (PX, PY, PZ, _XY),
    'constant_velocity': (PX, PY, PZ, TWIST),
    'spherical': (PX, PY, PZ),
    'distance': (DISTANCE,),
    'point_on_line': (DX, DY),
    'point_on_plane': (DZ,),
    'perpendicular': (_ZZ,),
}
ROW_NAMES = {
    PX: 'x',
    PY: 'y',
    PZ: 'z',
    DX: 'x',
    DY: 'y',
    DZ: 'z',
    _XY: 'xy',
    _XZ: 'xz',
    _YZ: 'yz',
    _ZZ: 'zz',
    TWIST: 'twist',
    DISTANCE: 'distance',
}


@dataclass(frozen=True, kw_only=True)
class JointSpec(Spec):
    """A joint between marker i and marker j; where it is closed, the markers stand as `kind` says.

    fixed: they coincide. revolute: j turns about z of i. prismatic: j slides along z of i. cylindrical: both. spherical: the points
    coincide. universal: the points coincide, x of i (one pin) stays perpendicular to y of j (the other). constant_velocity: the points
    coincide, shafts along z of i and of j turn alike. distance: the points keep `length` [m] > 0 (for this kind only).
    point_on_line: the point of j lies on z of i. point_on_plane: it lies in the plane normal to z of i. perpendicular: z of j stays
    perpendicular to z of i.
    """

    kind: str
    i: Marker
    j: Marker
    length: float | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            require(False, self.where, 'kind', self.kind, 'unknown kind of joint' + suggestion(str(self.kind), KINDS))
        require(self.i.body != self.j.body, self.where, 'j.body', self.j.body, 'must differ from i.body')
        if self.kind == 'distance':
            require(self.length is not None, self.where, 'length', None, 'a distance joint needs a length in m')
            self.set('length', finite(self.where, 'length', self.length, low=0.0, strict=True))
        else:
            require(self.length is None, self.where, 'length', self.length, 'only a distance joint has a length')

    def row_names(self) -> list[str]:
        """Names of the constraint rows, '<joint>/<row>'."""
        return [f'{self.name}/{ROW_NAMES[c]}' for c in KINDS[self.kind]]


class JointTable(NamedTuple):
    """Columns of all joints."""

    code: np.ndarray  # (nj, 6)
    rows: np.ndarray  # (nj,) number of rows
    row: np.ndarray  # (nj,) first row in phi
    entry: np.ndarray  # (nj, 2) Jacobian blocks of i and j
    body: np.ndarray  # (nj, 2)
    r_i: np.ndarray  # (nj, 3)
    r_j: np.ndarray  # (nj, 3)
    F: np.ndarray  # (nj, 3, 3) marker axes in body i
    G: np.ndarray  # (nj, 3, 3)
    length: np.ndarray  # (nj,)
    slot: np.ndarray  # (nj, 4) blocks ii ij ji jj


def compile_joints(
    specs: Sequence[JointSpec], context: Context, first_row: Sequence[int], entries: Sequence[tuple[int, int]]
) -> JointTable:
    """Resolve names into a table; rows and Jacobian blocks are numbered by the caller."""
    n = len(specs)
    table = JointTable(
        code=np.zeros((n, 6), np.int64),
        rows=np.array([len(KINDS[s.kind]) for s in specs], np.int64),
        row=np.array(first_row, np.int64),
        entry=np.array(entries, np.int64).reshape(n, 2),
        length=np.array([s.length or 0.0 for s in specs], float),
        **compile_pairs(specs, context)._asdict(),
    )
    for e, spec in enumerate(specs):
        table.code[e, : table.rows[e]] = KINDS[spec.kind]
    return table


@kernel(borrow=True)
def _put_rows(J, entry, row, direction, on_i, on_j):
    """Assign the row of both bodies: force along `direction` (in W) on j and its opposite on i, torques in B."""
    for c in range(3):
        J[entry[0], row, c] = -direction[c]
        J[entry[0], row, 3 + c] = on_i[c]
        J[entry[1], row, c] = direction[c]
        J[entry[1], row, 3 + c] = on_j[c]


@kernel(inline=True)
def _put_closed(J, entry, on_i, on_j):
    """Assign the rows of a closed point: p_j - p_i and its derivatives on_i and -on_j with respect to the turns, row by row in W."""
    for c in range(3):
        for k in range(3):
            J[entry[0], c, k] = -1.0 if k == c else 0.0
            J[entry[0], c, 3 + k] = on_i[3 * c + k]
            J[entry[1], c, k] = 1.0 if k == c else 0.0
            J[entry[1], c, 3 + k] = -on_j[3 * c + k]


@kernel(borrow=True)
def evaluate_joints(table, kin, gradients, phi, J):
    """Assign residuals phi (nc,) and, when `gradients`, blocks J (entries + 1, 6, 6): row of the joint x (force in W, torque in B)."""
    J = sixes(J)
    for e in range(table.rows.shape[0]):
        i = table.body[e, 0]
        j = table.body[e, 1]
        entry = (table.entry[e, 0], table.entry[e, 1])
        first = table.row[e]
        R_i = load33(kin.R, i)
        R_j = load33(kin.R, j)
        Fl = load33(table.F, e)
        Gl = load33(table.G, e)
        r_i = load3(table.r_i, e)
        r_j = load3(table.r_j, e)
        d = sub(point_position(kin, j, r_j), point_position(kin, i, r_i))
        zero = scale(0.0, d)
        closed = table.code[e, 0] == PX  # the first three rows close all of p_FG
        if closed:
            for c in range(3):
                phi[first + c] = d[c]
            if gradients:
                _put_closed(J, entry, m_cross(R_i, r_i), m_cross(R_j, r_j))
        for r in range(3 if closed else 0, table.rows[e]):
            code = table.code[e, r]
            if code <= DZ:
                E = col(Fl, code)
                n = mv(R_i, E)
                phi[first + r] = dot(n, d)
                if gradients:
                    _put_rows(J, entry, r, n, cross(E, add(tmv(R_i, d), r_i)), cross(r_j, tmv(R_j, n)))
            elif code < TWIST:
                a = col(Fl, (code - AXES) // 3)
                b = col(Gl, (code - AXES) % 3)
                aw = mv(R_i, a)
                bw = mv(R_j, b)
                phi[first + r] = dot(aw, bw)
                if gradients:
                    _put_rows(J, entry, r, zero, cross(a, tmv(R_i, bw)), cross(b, tmv(R_j, aw)))
            elif code == TWIST:
                x = col(Fl, 0)
                y = col(Fl, 1)
                X = col(Gl, 0)
                Y = col(Gl, 1)
                xw = mv(R_i, x)
                yw = mv(R_i, y)
                Xw = mv(R_j, X)
                Yw = mv(R_j, Y)
                phi[first + r] = dot(xw, Yw) - dot(yw, Xw)
                if gradients:
                    on_i = sub(cross(x, tmv(R_i, Yw)), cross(y, tmv(R_i, Xw)))
                    on_j = sub(cross(Y, tmv(R_j, xw)), cross(X, tmv(R_j, yw)))
                    _put_rows(J, entry, r, zero, on_i, on_j)
            else:
                length = np.sqrt(dot(d, d))
                phi[first + r] = length - table.length[e]
                if gradients:
                    n = scale(1.0 / length, d)
                    _put_rows(J, entry, r, n, scale(-1.0, cross(r_i, tmv(R_i, n))), cross(r_j, tmv(R_j, n)))


@kernel(borrow=True)
def _add_axes_hessian(R_i, R_j, a, b, s_ii, s_ij, s_ji, s_jj, Kq):
    """Second derivative of (R_i a) . (R_j b)."""
    A = skew(a)
    B = skew(b)
    Rij = mm(transpose(R_i), R_j)
    AR = mm(A, mm(Rij, B))
    put33(Kq, s_ij, 3, 3, mscale(-1.0, AR))
    put33(Kq, s_ji, 3, 3, mscale(-1.0, transpose(AR)))
    put33(Kq, s_ii, 3, 3, mm(A, skew(mv(Rij, b))))
    put33(Kq, s_jj, 3, 3, mm(B, skew(tmv(Rij, a))))


@kernel(borrow=True)
def add_joint_hessians(table, kin, lam, Kq, Kv_trash):
    """Add the geometric stiffness d(A^T lam)/dq of all joints to Kq. Kv_trash is scratch with the shape of Kq."""
    Kq = sixes(Kq)
    for e in range(table.rows.shape[0]):
        i = table.body[e, 0]
        j = table.body[e, 1]
        s_ii = table.slot[e, 0]
        s_ij = table.slot[e, 1]
        s_ji = table.slot[e, 2]
        s_jj = table.slot[e, 3]
        R_i = load33(kin.R, i)
        R_j = load33(kin.R, j)
        Fl = load33(table.F, e)
        Gl = load33(table.G, e)
        r_i = load3(table.r_i, e)
        r_j = load3(table.r_j, e)
        N = (0.0, 0.0, 0.0)
        P = (0.0, 0.0, 0.0)
        to_x = (0.0, 0.0, 0.0)
        to_y = (0.0, 0.0, 0.0)
        to_z = (0.0, 0.0, 0.0)
        points = False
        closed = table.code[e, 0] == PX
        if closed:
            P = (lam[table.row[e]], lam[table.row[e] + 1], lam[table.row[e] + 2])
        for r in range(3 if closed else 0, table.rows[e]):
            code = table.code[e, r]
            m = lam[table.row[e] + r]
            if code <= DZ:
                N = add(N, scale(m, col(Fl, code)))
                points = True
            elif code < TWIST:
                # sum over rows m F_a . G_b, gathered by b: one second derivative for all rows that share G_b
                a = scale(m, col(Fl, (code - AXES) // 3))
                if (code - AXES) % 3 == 0:
                    to_x = add(to_x, a)
                elif (code - AXES) % 3 == 1:
                    to_y = add(to_y, a)
                else:
                    to_z = add(to_z, a)
            elif code == TWIST:
                to_y = add(to_y, scale(m, col(Fl, 0)))
                to_x = add(to_x, scale(-m, col(Fl, 1)))
            else:
                d = sub(point_position(kin, j, r_j), point_position(kin, i, r_i))
                length = np.sqrt(dot(d, d))
                n = scale(1.0 / length, d)
                t = m / length
                D = mscale(-t, outer(n, n))
                D = (D[0] + t, D[1], D[2], D[3], D[4] + t, D[5], D[6], D[7], D[8] + t)
                add_point_pair_tangent(kin, i, j, r_i, r_j, scale(m, n), D, mscale(0.0, D), s_ii, s_ij, s_ji, s_jj, Kq, Kv_trash)
        for b in range(3):
            a = to_x if b == 0 else (to_y if b == 1 else to_z)
            if dot(a, a) > 0.0:
                _add_axes_hessian(R_i, R_j, a, col(Gl, b), s_ii, s_ij, s_ji, s_jj, Kq)
        if closed:
            # force P on j at r_j and -P on i at r_i
            put33(Kq, s_jj, 3, 3, mm(skew(r_j), skew(tmv(R_j, P))))
            put33(Kq, s_ii, 3, 3, mscale(-1.0, mm(skew(r_i), skew(tmv(R_i, P)))))
        if points:
            # force R_i N on j at r_j, the opposite on i at the same point: torque N x (R_i^T d + r_i)
            d = sub(point_position(kin, j, r_j), point_position(kin, i, r_i))
            arm = add(tmv(R_i, d), r_i)
            B = mscale(-1.0, mm(R_i, skew(N)))
            put33(Kq, s_ji, 0, 3, B)
            put33(Kq, s_ii, 0, 3, mscale(-1.0, B))
            Rij = mm(transpose(R_i), R_j)
            S = mm(skew(r_j), transpose(Rij))
            put33(Kq, s_ji, 3, 3, mscale(-1.0, mm(S, skew(N))))
            put33(Kq, s_jj, 3, 3, mm(skew(r_j), skew(tmv(Rij, N))))
            NR = mm(skew(N), transpose(R_i))
            put33(Kq, s_ij, 3, 0, NR)
            put33(Kq, s_ij, 3, 3, mscale(-1.0, mm(skew(N), mm(Rij, skew(r_j)))))
            put33(Kq, s_ii, 3, 0, mscale(-1.0, NR))
            put33(Kq, s_ii, 3, 3, mm(skew(N), skew(arm)))
