"""Joints: up to six constraint rows between marker F on body i and marker G on body j.

A row is a component of p_FG (in the world for joints that close all three, else along the axes of F), a dot product of
an axis of F and an axis of G, the constant-velocity condition, or the distance. A kind of joint is a list of rows
(table in docs/conventions.md). Gradients and second derivatives are exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import kernel, sixes
from solver.compiled.vec import (
    add,
    col,
    cross,
    cross_cross,
    cross_m,
    dot,
    load3,
    load33,
    m_cross,
    minus,
    mscale,
    mv,
    outer,
    put33,
    scale,
    sub,
    tmm,
    tmv,
    transpose,
)
from solver.dimensions import Length
from solver.elements.kind import ConstraintKind
from solver.elements.marker import ConstraintSpec, Context, Marker, compile_pairs, number_pairs
from solver.elements.point_pair import add_point_pair_tangent, point_position
from solver.errors import suggestion
from solver.validate import finite, require

# Codes of rows.
DX, DY, DZ = 0, 1, 2  # component of p_FG along x, y, z of F
AXES = 3  # AXES + 3 a + b: F_a . G_b, the dot product of axis a of F and axis b of G
TWIST = 12  # F_x . G_y - F_y . G_x
DISTANCE = 13  # |p_FG| - length
# Components of p_FG along the axes of W, for joints that close all three: the same constraint as DX, DY, DZ, but linear
# in the positions and without a dependence on the rotation of i, which cuts the energy error of the midpoint rule
# tenfold (measured on the slider-crank, docs/decisions/0002).
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
class JointSpec(ConstraintSpec):
    """A joint between the markers i and j. What it leaves free depends on its kind.

    fixed: nothing, the markers coincide. revolute: j turns about z of i. prismatic: j slides along z of i. cylindrical:
    j turns about z of i and slides along it. spherical: the points coincide. universal: the points coincide, and x of i
    (one pin) stays perpendicular to y of j (the other pin). constant_velocity: the points coincide, and shafts along z
    of i and along z of j turn equally fast. distance: the points keep the distance `length` [m], positive, which only
    this kind has. point_on_line: the point of j lies on the z axis of i. point_on_plane: the point of j lies in the
    plane through i normal to z of i. perpendicular: z of j stays perpendicular to z of i. If one of the two bodies
    spins fast, marker i belongs on the other body: the rows turn with i, and the iteration of a step converges more
    slowly then (docs/decisions/0002).
    """

    kind: str
    i: Marker
    j: Marker
    length: Length | None = None

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
    """Compiled data of nj joints."""

    code: np.ndarray  # (nj, 6) codes of the rows
    rows: np.ndarray  # (nj,) number of rows
    row: np.ndarray  # (nj,) first row in phi
    entry: np.ndarray  # (nj, 2) Jacobian blocks of i and j
    body: np.ndarray  # (nj, 2) indices of i and j
    r_i: np.ndarray  # (nj, 3) marker i from the centre of mass of body i, in body i [m]
    r_j: np.ndarray  # (nj, 3) marker j from the centre of mass of body j, in body j [m]
    F: np.ndarray  # (nj, 3, 3) axes of marker i, in body i
    G: np.ndarray  # (nj, 3, 3) axes of marker j, in body j
    a: np.ndarray  # (nj, 6, 3) axis of F in a row of kind D or AXES, in body i; else zero
    b: np.ndarray  # (nj, 6, 3) axis of G in a row of kind AXES, in body j; else zero
    length: np.ndarray  # (nj,) [m]
    slot: np.ndarray  # (nj, 4) matrix blocks ii, ij, ji, jj


def compile_joints(specs: Sequence[JointSpec], context: Context) -> JointTable:
    """Resolve names into a table."""
    n = len(specs)
    first_row, entries = number_pairs(specs, context)
    table = JointTable(
        code=np.zeros((n, 6), np.int64),
        rows=np.array([len(KINDS[s.kind]) for s in specs], np.int64),
        row=first_row,
        entry=entries,
        length=np.array([s.length or 0.0 for s in specs], float),
        a=np.zeros((n, 6, 3)),
        b=np.zeros((n, 6, 3)),
        **compile_pairs(specs, context)._asdict(),
    )
    for e, spec in enumerate(specs):
        table.code[e, : table.rows[e]] = KINDS[spec.kind]
        for r, code in enumerate(KINDS[spec.kind]):
            if code <= DZ:
                table.a[e, r] = table.F[e][:, code]
            elif code < TWIST:
                table.a[e, r], table.b[e, r] = table.F[e][:, (code - AXES) // 3], table.G[e][:, (code - AXES) % 3]
    return table


@kernel(inner=True)
def _put_rows(J, entry, row, direction, on_i, on_j):
    """Assign the row of both bodies: force along `direction` (in W) on j and its opposite on i, torques in B."""
    for c in range(3):
        J[entry[0], row, c] = -direction[c]
        J[entry[0], row, 3 + c] = on_i[c]
        J[entry[1], row, c] = direction[c]
        J[entry[1], row, 3 + c] = on_j[c]


@kernel(inline=True)
def _put_closed(J, entry, on_i, on_j):
    """Assign the rows of a closed point: p_j - p_i and its derivatives on_i and -on_j with respect to the turns, row by
    row in W."""
    for c in range(3):
        for k in range(3):
            J[entry[0], c, k] = -1.0 if k == c else 0.0
            J[entry[0], c, 3 + k] = on_i[3 * c + k]
            J[entry[1], c, k] = 1.0 if k == c else 0.0
            J[entry[1], c, 3 + k] = -on_j[3 * c + k]


@kernel(borrow=True)
def _evaluate_rows(table, kin, e, first_row, gradients, phi, J):
    """The rows of joint e from `first_row` on, each by its code."""
    J = sixes(J)
    i = table.body[e, 0]
    j = table.body[e, 1]
    entry = (table.entry[e, 0], table.entry[e, 1])
    R_i = load33(kin.R, i)
    R_j = load33(kin.R, j)
    zero = (0.0 * R_i[0], 0.0 * R_i[0], 0.0 * R_i[0])
    for r in range(first_row, table.rows[e]):
        code = table.code[e, r]
        at = table.row[e] + r
        if AXES <= code < TWIST:
            a = mv(R_i, load3(table.a[e], r))
            b = mv(R_j, load3(table.b[e], r))
            phi[at] = dot(a, b)
            if gradients:
                turn = cross(a, b)
                _put_rows(J, entry, r, zero, tmv(R_i, turn), scale(-1.0, tmv(R_j, turn)))
        elif code == TWIST:
            Fl = load33(table.F, e)
            Gl = load33(table.G, e)
            x = mv(R_i, col(Fl, 0))
            y = mv(R_i, col(Fl, 1))
            X = mv(R_j, col(Gl, 0))
            Y = mv(R_j, col(Gl, 1))
            phi[at] = dot(x, Y) - dot(y, X)
            if gradients:
                turn = sub(cross(x, Y), cross(y, X))
                _put_rows(J, entry, r, zero, tmv(R_i, turn), scale(-1.0, tmv(R_j, turn)))
        else:
            r_i = load3(table.r_i, e)
            r_j = load3(table.r_j, e)
            d = sub(point_position(kin, j, r_j), point_position(kin, i, r_i))
            if code <= DZ:
                a = load3(table.a[e], r)
                n = mv(R_i, a)
                phi[at] = dot(n, d)
                if gradients:
                    _put_rows(J, entry, r, n, cross(a, add(tmv(R_i, d), r_i)), cross(r_j, tmv(R_j, n)))
            else:
                length = np.sqrt(dot(d, d))
                phi[at] = length - table.length[e]
                if gradients:
                    n = scale(1.0 / length, d)
                    _put_rows(J, entry, r, n, scale(-1.0, cross(r_i, tmv(R_i, n))), cross(r_j, tmv(R_j, n)))


@kernel(borrow=True)
def evaluate_joints(table, kin, gradients, phi, J):
    """Assign residuals phi (nc,) and, when `gradients`, blocks J (entries + 1, 6, 6): row of the joint x (force in W,
    torque in B)."""
    J = sixes(J)
    for e in range(table.rows.shape[0]):
        closed = 0
        if table.code[e, 0] == PX:  # the first three rows close all of p_FG
            i = table.body[e, 0]
            j = table.body[e, 1]
            first = table.row[e]
            r_i = load3(table.r_i, e)
            r_j = load3(table.r_j, e)
            d = sub(point_position(kin, j, r_j), point_position(kin, i, r_i))
            for c in range(3):
                phi[first + c] = d[c]
            if gradients:
                entry = (table.entry[e, 0], table.entry[e, 1])
                _put_closed(J, entry, m_cross(load33(kin.R, i), r_i), m_cross(load33(kin.R, j), r_j))
            closed = 3
        if closed < table.rows[e]:
            _evaluate_rows(table, kin, e, closed, gradients, phi, J)


@kernel(inner=True)
def _add_axes_hessian(R_i, R_j, a, b, s_ii, s_ij, s_ji, s_jj, Kq):
    """Second derivative of (R_i a) . (R_j b)."""
    AR = cross_m(a, m_cross(tmm(R_i, R_j), b))
    put33(Kq, s_ij, 3, 3, minus(AR))
    put33(Kq, s_ji, 3, 3, minus(transpose(AR)))
    put33(Kq, s_ii, 3, 3, cross_cross(a, tmv(R_i, mv(R_j, b))))
    put33(Kq, s_jj, 3, 3, cross_cross(b, tmv(R_j, mv(R_i, a))))


@kernel(borrow=True)
def _add_rows_hessian(table, kin, e, first_row, lam, Kq, Kv):
    """The geometric stiffness of the rows of joint e from `first_row` on."""
    Kq = sixes(Kq)
    i = table.body[e, 0]
    j = table.body[e, 1]
    s_ii = table.slot[e, 0]
    s_ij = table.slot[e, 1]
    s_ji = table.slot[e, 2]
    s_jj = table.slot[e, 3]
    R_i = load33(kin.R, i)
    R_j = load33(kin.R, j)
    N = (0.0, 0.0, 0.0)
    to_x = (0.0, 0.0, 0.0)
    to_y = (0.0, 0.0, 0.0)
    to_z = (0.0, 0.0, 0.0)
    points = False
    axes = False
    for r in range(first_row, table.rows[e]):
        code = table.code[e, r]
        m = lam[table.row[e] + r]
        if code <= DZ:
            N = add(N, scale(m, load3(table.a[e], r)))
            points = True
        elif code < TWIST:
            # sum over rows m F_a . G_b, gathered by b: one second derivative for all rows that share G_b
            a = scale(m, load3(table.a[e], r))
            axes = True
            if (code - AXES) % 3 == 0:
                to_x = add(to_x, a)
            elif (code - AXES) % 3 == 1:
                to_y = add(to_y, a)
            else:
                to_z = add(to_z, a)
        elif code == TWIST:
            axes = True
            Fl = load33(table.F, e)
            to_y = add(to_y, scale(m, col(Fl, 0)))
            to_x = add(to_x, scale(-m, col(Fl, 1)))
        else:
            r_i = load3(table.r_i, e)
            r_j = load3(table.r_j, e)
            d = sub(point_position(kin, j, r_j), point_position(kin, i, r_i))
            length = np.sqrt(dot(d, d))
            n = scale(1.0 / length, d)
            t = m / length
            D = mscale(-t, outer(n, n))
            D = (D[0] + t, D[1], D[2], D[3], D[4] + t, D[5], D[6], D[7], D[8] + t)
            add_point_pair_tangent(kin, i, j, r_i, r_j, scale(m, n), D, mscale(0.0, D), s_ii, s_ij, s_ji, s_jj, Kq, Kv)
    if axes:
        Gl = load33(table.G, e)
        for b in range(3):
            a = to_x if b == 0 else (to_y if b == 1 else to_z)
            if dot(a, a) > 0.0:
                _add_axes_hessian(R_i, R_j, a, col(Gl, b), s_ii, s_ij, s_ji, s_jj, Kq)
    if points:
        # force R_i N on j at r_j, the opposite on i at the same point: torque N x (R_i^T d + r_i)
        r_i = load3(table.r_i, e)
        r_j = load3(table.r_j, e)
        d = sub(point_position(kin, j, r_j), point_position(kin, i, r_i))
        B = m_cross(R_i, N)
        put33(Kq, s_ji, 0, 3, minus(B))
        put33(Kq, s_ii, 0, 3, B)
        Rji = tmm(R_j, R_i)
        put33(Kq, s_ji, 3, 3, minus(cross_m(r_j, m_cross(Rji, N))))
        put33(Kq, s_jj, 3, 3, cross_cross(r_j, mv(Rji, N)))
        NR = cross_m(N, transpose(R_i))
        put33(Kq, s_ij, 3, 0, NR)
        put33(Kq, s_ij, 3, 3, minus(cross_m(N, m_cross(transpose(Rji), r_j))))
        put33(Kq, s_ii, 3, 0, minus(NR))
        put33(Kq, s_ii, 3, 3, cross_cross(N, add(tmv(R_i, d), r_i)))


@kernel(borrow=True)
def add_joint_hessians(table, kin, lam, Kq, Kv):
    """Add the geometric stiffness d(A^T lam)/dq of all joints to Kq. Kv is scratch with the shape of Kq."""
    Kq = sixes(Kq)
    for e in range(table.rows.shape[0]):
        closed = 0
        if table.code[e, 0] == PX:
            # force P on j at r_j and -P on i at r_i
            first = table.row[e]
            P = (lam[first], lam[first + 1], lam[first + 2])
            put33(Kq, table.slot[e, 3], 3, 3, cross_cross(load3(table.r_j, e), tmv(load33(kin.R, table.body[e, 1]), P)))
            put33(
                Kq,
                table.slot[e, 0],
                3,
                3,
                minus(cross_cross(load3(table.r_i, e), tmv(load33(kin.R, table.body[e, 0]), P))),
            )
            closed = 3
        if closed < table.rows[e]:
            _add_rows_hessian(table, kin, e, closed, lam, Kq, Kv)


JOINTS = ConstraintKind(
    name='joints', spec=JointSpec, compile=compile_joints, residuals=evaluate_joints, hessians=add_joint_hessians
)
