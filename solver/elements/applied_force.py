"""Applied force: a given force and torque at a marker, constant or scaled by an input, with or without a reaction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from solver.compiled.kernel import kernel
from solver.compiled.portable import product
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
    minus,
    mm,
    mv,
    put33,
    scale,
    skew,
    sub,
    tmm,
    tmv,
)
from solver.dimensions import Force, Torque
from solver.elements.instant import sums
from solver.elements.kind import ForceKind
from solver.elements.marker import WORLD, Context, Marker, Spec, compile_pairs
from solver.elements.point_pair import angular_velocity, linear_velocity
from solver.validate import require, vector

OUTPUTS = (
    {'energy': 'J', 'dissipation': 'W'}
    | dict.fromkeys(('fx', 'fy', 'fz'), 'N')
    | dict.fromkeys(('mx', 'my', 'mz'), 'N m')
)
WORLD_AXES, BODY_AXES, REACTION_AXES = 0, 1, 2
FRAMES = ('world', 'body', 'reaction')


@dataclass(frozen=True, kw_only=True)
class AppliedForceSpec(Spec):
    """Force [N] and torque [N m] on the body of `marker`, the force at the marker's origin.

    frame: axes in which force and torque are given: 'world', 'body' (the axes of `marker`) or 'reaction' (those of the
    marker `reaction`). reaction: the opposite force and torque act on its body, at the same point of space; its
    position must be left out. input: channel that scales both (None: constant). The outputs fx..mz are along world
    axes. The power of the force is reported as negative dissipation, its energy is zero.
    """

    marker: Marker
    reaction: Marker | None = None
    force: tuple[Force, Force, Force] = (0.0, 0.0, 0.0)
    torque: tuple[Torque, Torque, Torque] = (0.0, 0.0, 0.0)
    frame: Literal['world', 'body', 'reaction'] = 'world'
    input: str | None = None

    def __post_init__(self) -> None:
        self.set('force', vector(self.where, 'force', self.force))
        self.set('torque', vector(self.where, 'torque', self.torque))
        require(self.frame in FRAMES, self.where, 'frame', self.frame, 'must be world, body or reaction')
        require(
            self.frame != 'reaction' or self.reaction is not None,
            self.where,
            'frame',
            self.frame,
            "needs a 'reaction' marker",
        )
        if self.reaction is not None:
            require(
                not any(self.reaction.position),
                self.where,
                'reaction.position',
                self.reaction.position,
                'the reaction acts at the origin of marker; leave it out',
            )

    @property
    def counted_as(self) -> str:  # type: ignore[override]
        """A force without a reaction acts from outside."""
        return 'external_forces' if self.reaction is None else 'force_elements'

    @property
    def i(self) -> Marker:
        """Marker whose body takes the reaction, of the world if there is none."""
        return self.reaction or Marker(body=WORLD)

    @property
    def j(self) -> Marker:
        """Marker where the force acts."""
        return self.marker


class AppliedForceTable(NamedTuple):
    """Columns of all applied forces; body i takes the reaction (the world if there is none), body j the force."""

    body: np.ndarray  # (n, 2)
    r: np.ndarray  # (n, 3) point of action from the centre of mass of j, in B_j [m]
    frame: np.ndarray  # (n,)
    force: np.ndarray  # (n, 3) along W, B_j or B_i
    torque: np.ndarray  # (n, 3)
    input: np.ndarray  # (n,) -1 for none
    slot: np.ndarray  # (n, 4) blocks ii ij ji jj


def compile_applied_forces(specs: Sequence[AppliedForceSpec], context: Context) -> AppliedForceTable:
    """Resolve names into a table."""
    n = len(specs)
    pairs = compile_pairs(specs, context)
    table = AppliedForceTable(
        body=pairs.body,
        r=pairs.r_j,
        frame=np.array([FRAMES.index(s.frame) for s in specs], np.int64),
        force=np.zeros((n, 3)),
        torque=np.zeros((n, 3)),
        input=np.full(n, -1, np.int64),
        slot=pairs.slot,
    )
    for e, spec in enumerate(specs):
        axes = (np.eye(3), pairs.G[e], pairs.F[e])[table.frame[e]]
        table.force[e], table.torque[e] = product(axes, spec.force), product(axes, spec.torque)
        if spec.input is not None:
            table.input[e] = context.input(spec.where, spec.input)
    return table


@kernel(borrow=True)
def applied_force_forces(table, now, effects, out):
    """Accumulate forces and tangents of all applied forces (contract: solver/elements/__init__.py)."""
    f, Kq, _ = sums(effects)
    kin = now.kin
    for e in range(table.body.shape[0]):
        i = table.body[e, 0]
        j = table.body[e, 1]
        R_i = load33(kin.R, i)
        R_j = load33(kin.R, j)
        r = load3(table.r, e)
        amplitude = 1.0
        if table.input[e] >= 0:
            amplitude = now.u[table.input[e]]
        F = scale(amplitude + 0.0 * kin.p[j, 0], load3(table.force, e))
        T = scale(amplitude + 0.0 * kin.p[j, 0], load3(table.torque, e))
        if table.frame[e] == BODY_AXES:
            F = mv(R_j, F)
            T = mv(R_j, T)
        elif table.frame[e] == REACTION_AXES:
            F = mv(R_i, F)
            T = mv(R_i, T)
        arm_j = mv(R_j, r)
        arm_i = add(sub(load3(kin.p, j), load3(kin.p, i)), arm_j)
        moment_i = add(cross(arm_i, F), T)
        F_j = tmv(R_j, F)
        T_j = tmv(R_j, T)
        torque_j = add(cross(r, F_j), T_j)
        torque_i = scale(-1.0, tmv(R_i, moment_i))
        add3(f, j, 0, F)
        add3(f, j, 3, torque_j)
        add3(f, i, 0, scale(-1.0, F))
        add3(f, i, 3, torque_i)
        if now.tangents:
            s_ii = table.slot[e, 0]
            s_ij = table.slot[e, 1]
            s_ji = table.slot[e, 2]
            s_jj = table.slot[e, 3]
            # on i: -R_i^T (arm x F + T); first for a force that keeps its world axes: d arm = dp_j - dp_i - R_j skew(r)
            # dtheta_j
            P = tmm(R_i, skew(F))
            put33(Kq, s_ij, 3, 0, P)
            put33(Kq, s_ij, 3, 3, minus(m_cross(mm(P, R_j), r)))
            put33(Kq, s_ii, 3, 0, minus(P))
            put33(Kq, s_ii, 3, 3, skew(torque_i))
            put33(Kq, s_jj, 3, 3, madd(cross_m(r, skew(F_j)), skew(T_j)))
            # then what turns with a body: dF = A dtheta, dT = B dtheta
            if table.frame[e] != WORLD_AXES:
                if table.frame[e] == BODY_AXES:
                    R = R_j
                    s_i = s_ij
                    s_j = s_jj
                else:
                    R = R_i
                    s_i = s_ii
                    s_j = s_ji
                A = minus(m_cross(R, tmv(R, F)))
                B = minus(m_cross(R, tmv(R, T)))
                put33(Kq, s_j, 0, 3, A)
                put33(Kq, s_i, 0, 3, minus(A))
                put33(Kq, s_j, 3, 3, madd(cross_m(r, tmm(R_j, A)), tmm(R_j, B)))
                put33(Kq, s_i, 3, 3, minus(tmm(R_i, madd(cross_m(arm_i, A), B))))
        out[e, 0] = 0.0
        out[e, 1] = -(
            dot(F, sub(linear_velocity(kin, j), linear_velocity(kin, i)))
            + dot(torque_j, angular_velocity(kin, j))
            + dot(torque_i, angular_velocity(kin, i))
        )
        for k in range(3):
            out[e, 2 + k] = F[k]
            out[e, 5 + k] = T[k]


APPLIED_FORCES = ForceKind(
    name='applied_forces',
    spec=AppliedForceSpec,
    compile=compile_applied_forces,
    kernel=applied_force_forces,
    outputs=OUTPUTS,
    supplies=True,
    active=True,
)
