"""Independent solutions of the equations of a mechanism, to two tolerances, and the measure that motions are compared
in.

Measure of a motion: places of the centres of mass [m] and twice the vector and scalar part of the quaternions [rad], of
all bodies.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import qr, solve_triangular
from scipy.spatial.transform import Rotation

from mbd_sim_ros.lab.mechanisms.draft import Circle, Mechanism
from solver.errors import StepError
from solver.reference.dense import CLOSED, RANK_TOLERANCE, Equations, MotionState
from solver.reference.methods import Kkt, Stabilised
from solver.simulation import Simulation
from solver.start.newton import move

FINE = 0.0005  # s, at which second differences are taken
# of its median step: a reference with such a step changed its velocities at once, on the way to another branch
COLLAPSED = 1e-3
STANDS_OUT = 10.0  # a second difference over FINE, beside the median of the NEAR ones before and behind it: the same
NEAR = 10
START_STEPS = 6  # of a reference, which feels its way
TOLERANCES = (1e-10, 1e-7)  # of the two references
# of an explicit reference (what needs more is stiff), and of an implicit one
MOST_EVALUATIONS, MOST_IMPLICIT = 12_000, 20_000


class _Bounded(Equations):
    """Equations that give up after so many evaluations of the forces."""

    most = MOST_IMPLICIT

    def forces(self, t: float, zp: np.ndarray, cz: float, tangents: bool = False) -> tuple[np.ndarray, np.ndarray]:
        if self.evaluations >= self.most:
            raise StepError(f'more than {self.most} evaluations')
        return super().forces(t, zp, cz, tangents)


class _Quick(_Bounded):
    """Equations of models in which every body has a mass, for an explicit method.

    Accelerations and projections are those of free bodies less their part along the constraints, by a decomposition
    with pivots, several times as fast as singular values of the whole system; the multipliers, which nobody asks for,
    are left out. The number of independent rows is counted where the constraints are closed, and the largest one kept:
    the rows that are redundant in linkages like Bennett's are so only there, and stages of the method lie beside. In
    singular positions the motion goes on as it does near them.
    """

    most = MOST_EVALUATIONS

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        for b, mass in enumerate(self.tables.bodies.mass):  # the masses themselves: those of penalties have a floor
            p, r = slice(6 * b, 6 * b + 3), slice(6 * b + 3, 6 * b + 6)
            self.root[p, p] = np.eye(3) / np.sqrt(mass)
            self.root[r, r] = np.linalg.cholesky(np.linalg.inv(self.tables.bodies.inertia[b]))
        self.inverse_root = np.linalg.inv(self.root)
        self.ranks = (0, 0)  # of the rows of positions, and of all
        # independent ones, the same for a whole step: another choice is another motion beside the constraints
        self.rows = np.zeros(0, int)

    def acceleration(self, t: float, motion: MotionState) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        bias = self._bias(t, motion)
        self.move_to(motion.q, motion.v)
        rows = self.constraints(t)
        f, zd = self.internal_rates(t, motion.z)
        x = self.root.T @ f
        if len(bias):
            B, factor = self.scaled(rows.A)
            x = _onto(B[self.rows], -(factor * (bias + rows.phi_tt))[self.rows], x, len(self.rows))
        return self.root @ x, np.zeros(len(bias)), zd

    def project(self, t: float, motion: MotionState) -> MotionState:
        """The nearest motion that satisfies the constraints, in the metric of the masses."""
        q, v, keep = motion.q.copy(), motion.v.copy(), self.holonomic
        if not len(keep):
            return motion
        for _ in range(10):
            self.move_to(q, v)
            rows = self.constraints(t)
            B, factor = self.scaled(rows.A)
            if np.abs(rows.phi[keep]).max(initial=0.0) < CLOSED:
                break
            dq = self.root @ _onto(
                B[keep], -(factor * rows.phi)[keep], np.zeros(self.n), self.ranks[0] or _rank(B[keep])
            )
            move(q, np.vstack([dq.reshape(-1, 6), np.zeros(6)]))
        self.ranks = max(self.ranks[0], _rank(B[keep])), max(self.ranks[1], _rank(B))
        self.rows = qr(B.T, mode='r', pivoting=True)[1][: self.ranks[1]]
        v[:-1] = (
            self.root @ _onto(B, -factor * rows.phi_t, self.inverse_root @ v[:-1].ravel(), self.ranks[1])
        ).reshape(-1, 6)
        return MotionState(q, v, motion.z)

    def _bias(self, t: float, motion: MotionState) -> np.ndarray:
        """(nc,) (dA/dt) v by the fourth-order central difference of A v along the motion with frozen v."""
        d = 1e-3 / max(1.0, np.abs(motion.v).max())
        bias = np.zeros(self.model.n_rows)
        v = motion.v[:-1].ravel()
        for s, weight in ((-2, 1 / 12), (-1, -2 / 3), (1, 2 / 3), (2, -1 / 12)):
            q = motion.q.copy()
            move(q, s * d * motion.v)
            self.move_to(q, motion.v)
            bias += weight / d * (self.constraints(t).A @ v)
        return bias


def _rank(B: np.ndarray) -> int:
    """Number of independent rows."""
    return int((np.abs(np.diag(qr(B.T, mode='r', pivoting=True)[0])) > RANK_TOLERANCE).sum()) if len(B) else 0


def _onto(B: np.ndarray, wanted: np.ndarray, x: np.ndarray, rank: int) -> np.ndarray:
    """The nearest to x (n,) with B x = wanted in as many rows as rank says, the most independent ones."""
    Q, R, pivot = qr(B.T, mode='economic', pivoting=True)
    Q = Q[:, :rank]
    return x + Q @ (solve_triangular(R[:rank, :rank], wanted[pivot[:rank]], trans='T') - Q.T @ x)


def measured(q: np.ndarray) -> np.ndarray:
    """(..., nb, 7) measure of configurations (..., nb + 1, 7), along the first axis with continuous signs of the
    quaternions."""
    y = q[..., :-1, :].copy()
    y[..., 3:] *= 2.0
    for k in range(1, len(y)):
        y[k, :, 3:] *= np.where((y[k, :, 3:] * y[k - 1, :, 3:]).sum(-1) < 0.0, -1.0, 1.0)[:, None]
    return y


def difference(y: np.ndarray, other: np.ndarray) -> float:
    """Largest difference of two measured motions (n, nb, 7), whatever the signs of the quaternions are."""
    place = np.abs(y[..., :3] - other[..., :3]).max(initial=0.0)
    same, opposite = (np.abs(y[..., 3:] - sign * other[..., 3:]).max(-1) for sign in (1.0, -1.0))
    return float(max(place, np.minimum(same, opposite).max(initial=0.0)))


def reference(simulation: Simulation, duration: float, tolerance: float, kind: str) -> tuple[np.ndarray, int, bool]:
    """(measured motion every FINE (n, nb, 7), evaluations, whether no velocity changes at once) from the start of a
    simulation.

    Raises StepError when it does not arrive.
    """
    scene, s = simulation.scene, simulation.state

    def inputs(t: float) -> np.ndarray:
        at = np.array([t])
        return scene.maneuver.inputs(scene.model.inputs, at, at)[0]

    make = _Quick if kind == 'reference_kkt' else _Bounded
    equations = make(simulation.model, simulation.model.new_outputs(), inputs, s.angle)
    motion = equations.project(0.0, MotionState(s.q.copy(), s.v.copy(), s.z.copy()))
    if kind == 'reference_kkt':
        solver: Kkt | Stabilised = Kkt(equations, 0.0, motion, tolerance)
    else:
        solver = Stabilised(equations, 0.0, motion, tolerance, kind)
    found = [motion.q]
    try:
        for k in range(1, round(duration / FINE) + 1):
            found.append(solver.advance(k * FINE).q)
    except (np.linalg.LinAlgError, FloatingPointError, ValueError, RuntimeError) as error:
        # the last one is SuperLU's of a singular factor
        raise StepError(f'{type(error).__name__}: {error}') from None
    steps = np.array(solver.steps[START_STEPS:] if isinstance(solver, Kkt) else [])
    y = measured(np.array(found))
    smooth = not len(steps) or bool(steps.min() >= COLLAPSED * np.median(steps))
    return y, equations.evaluations, smooth and not jumps(y)


def on_circle(simulation: Simulation, circle: Circle, duration: float, tolerance: float) -> tuple[np.ndarray, int]:
    """Like reference(), of parallel cranks in the one coordinate that they have, also where all bars are in line: T^T M
    T theta'' = T^T (f - M T' theta'^2), with T the velocities of all bodies for theta' = 1, and M and the forces f of
    the compiled model."""
    s, scene = simulation.state, simulation.scene
    names = simulation.model.body_names
    n = circle.axis
    start_q = s.q.copy()

    def inputs(t: float) -> np.ndarray:
        at = np.array([t])
        return scene.maneuver.inputs(scene.model.inputs, at, at)[0]

    equations = Equations(simulation.model, simulation.model.new_outputs(), inputs, s.angle)

    def placed(theta: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(q, T (nb, 6), T' (nb, 6) by theta)."""
        turn = Rotation.from_rotvec(theta * n)
        q, T, bent = start_q.copy(), np.zeros((len(names), 6)), np.zeros((len(names), 6))
        for b, name in enumerate(names):
            if name in circle.feet:
                r = turn.apply(start_q[b, :3] - circle.feet[name])
                q[b, :3] = circle.feet[name] + r
                q[b, 3:] = (turn * Rotation.from_quat(start_q[b, 3:])).as_quat()
                T[b, 3:] = Rotation.from_quat(start_q[b, 3:]).inv().apply(n)
            else:
                r = turn.apply(circle.arm)
                q[b, :3] = start_q[b, :3] + r - circle.arm
            T[b, :3] = np.cross(n, r)
            bent[b, :3] = np.cross(n, T[b, :3])
        return q, T, bent

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        q, T, bent = placed(y[0])
        v = np.vstack([T * y[1], np.zeros(6)])
        equations.accept(MotionState(q, v, np.zeros(0)))
        f, _ = equations.forces(t, np.zeros(0), 0.0)
        T_, M = T.ravel(), equations.M
        return np.array([y[1], T_ @ (f - M @ bent.ravel() * y[1] ** 2) / (T_ @ M @ T_)])

    times = np.arange(round(duration / FINE) + 1) * FINE
    found = solve_ivp(
        rate,
        (0.0, duration),
        [0.0, circle.rate],
        'DOP853',
        times,
        rtol=max(tolerance, 3e-14),
        atol=tolerance,
        max_step=0.02,
    )
    return measured(np.array([placed(theta)[0] for theta in found.y[0]])), equations.evaluations


class References(NamedTuple):
    """Motions to both TOLERANCES, none where the integrator stopped; smooth: no velocity of theirs changes at once."""

    kind: str
    motions: list[np.ndarray]
    evaluations: int
    smooth: bool = True


def references(simulation: Simulation, mechanism: Mechanism, duration: float) -> References:
    """Those of the first kind that arrives and is smooth, else of the first that arrives."""
    used = 0
    if mechanism.circle is not None:
        pairs = [on_circle(simulation, mechanism.circle, duration, tolerance) for tolerance in TOLERANCES]
        return References('minimal', [motion for motion, _ in pairs], sum(evaluations for _, evaluations in pairs))
    found: References | None = None
    for kind in ('reference_kkt', 'reference_radau'):
        motions: list[np.ndarray] = []
        all_smooth = True
        try:
            for tolerance in reversed(TOLERANCES):
                motion, evaluations, smooth = reference(simulation, duration, tolerance, kind)
                used += evaluations
                motions.insert(0, motion)
                all_smooth &= smooth
        except StepError:
            continue
        if found is None or all_smooth:
            found = References(kind, motions, used, all_smooth)
        if all_smooth:
            break
    return References('', [], used) if found is None else found._replace(evaluations=used)


def jumps(y: np.ndarray) -> bool:
    """True where a velocity changes at once in a motion (n, nb, 7) every FINE: one or two second differences in line
    that stand out."""
    a = np.abs(np.diff(y, 2, axis=0)).max(axis=(1, 2), initial=0.0)
    for k in np.flatnonzero(a > STANDS_OUT * np.median(a)):
        before, behind = a[max(0, k - 2 - NEAR) : max(0, k - 2)], a[k + 3 : k + 3 + NEAR]
        if len(before) and len(behind) and a[k] > STANDS_OUT * max(np.median(before), np.median(behind)):
            return True
    return False
