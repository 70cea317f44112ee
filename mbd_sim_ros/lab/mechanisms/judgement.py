"""Runs of a mechanism with the default settings at several steps, held against independent solutions of the same equations.

Measure of a motion: places of the centres of mass [m] and twice the vector and scalar part of the quaternions [rad], of all bodies, every
SAMPLE. The error e(h) of a run is its largest difference from the reference; h is the mean of its steps, where some were divided.

What second order predicts: an error in proportion to what a step does not see of the motion, d(h), the largest second difference of the
reference at the distance h, halved. Where a step resolves the motion that is h^2 / 2 times its largest acceleration, so e(h) / d(h) is the
same at all steps; of a vibration that no step resolves it is the amplitude, and the error is no larger either. A run is *right* when

    e(h) <= WORSE * d(h) * median of e / d of the other steps     or     e(h) <= floor

(of other steps that are ok and were not divided; where there are none, the error may be CLOSE what second order predicts from the next
coarser run that came to its end, though that was told, or WORSE * d(h)).
floor: RESOLVED of the size of the motion, or what the reference leaves open. It is *told* when it failed, was refused or is suspect.
Otherwise it is *silently wrong*, unless a second reference, to a tolerance a thousand times coarser, differs from the first by a tenth of
the error or more, or none was found: then nothing resolves the motion, and it is *undecided*.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import qr, solve_triangular
from scipy.spatial.transform import Rotation

from mbd_sim_ros.lab.mechanisms.draft import Circle, Mechanism
from solver.analysis.verdict import findings
from solver.errors import MbdError, StepError
from solver.reference.dense import CLOSED, RANK_TOLERANCE, Equations, Motion
from solver.reference.methods import Kkt, Stabilised
from solver.scene import Scene
from solver.simulation import Simulation
from solver.start.newton import move

STEPS = (0.01, 0.005, 0.002, 0.001, 0.0005)  # s
DURATION = 0.5  # s
SAMPLE = 0.01  # s, a multiple of every step
FINE = 0.0005  # s, at which second differences are taken
START = 1e-6  # s, step for which the start of the references is made: a start fits its velocities to its step, by its square
WORSE = 10.0
UNDIVIDED = 0.9  # of a step: a mean below it belongs to a run whose error is not that of its step
CLOSE = 2.0  # second order and a little more
RESOLVED = 1e-9  # of the size of the motion, at least 1 m or rad: rounding of a step divided by its length squared
COLLAPSED = 1e-3  # of its median step: a reference with such a step changed its velocities at once, on the way to another branch
START_STEPS = 6  # of a reference, which feels its way
TOLERANCES = (1e-10, 1e-7)  # of the two references
MOST_EVALUATIONS, MOST_IMPLICIT = 12_000, 20_000  # of an explicit reference (what needs more is stiff), and of an implicit one
RIGHT, TOLD, WRONG, UNDECIDED = 'right', 'told', 'silently wrong', 'undecided'


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run at one step. status: 'ok', 'suspect', 'error' or 'refused'; text: why. error: e(h), nan when it did not arrive."""

    h: float
    status: str
    text: str
    error: float
    unseen: float  # d(h)
    allowed: float
    judgement: str = ''


@dataclass(frozen=True, kw_only=True)
class Judged:
    """All runs of a mechanism. spread: difference of the two references, nan without a second; reference: which one."""

    name: str
    bodies: int
    rows: int
    reference: str
    spread: float
    evaluations: int
    runs: tuple[Run, ...]

    def report(self) -> dict[str, Any]:
        """As an object for JSON."""
        return asdict(self)

    @property
    def worst(self) -> str:
        """The worst judgement of any run."""
        return max((run.judgement for run in self.runs), key=(RIGHT, TOLD, UNDECIDED, WRONG).index)


class _Bounded(Equations):
    """Equations that give up after so many evaluations of the forces."""

    most = MOST_IMPLICIT

    def forces(self, t: float, zp: np.ndarray, cz: float, tangents: bool = False) -> tuple[np.ndarray, np.ndarray]:
        if self.evaluations >= self.most:
            raise StepError(f'more than {self.most} evaluations')
        return super().forces(t, zp, cz, tangents)


class _Quick(_Bounded):
    """Equations of models in which every body has a mass, for an explicit method.

    Accelerations and projections are those of free bodies less their part along the constraints, by a decomposition with pivots, several
    times as fast as singular values of the whole system; the multipliers, which nobody asks for, are left out. How many rows are
    independent is looked at where the constraints are closed, and the largest number kept: the rows that are redundant in linkages like
    Bennett's are so only there, and stages of the method lie beside. In singular positions the motion goes on as it does near them.
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
        self.rows = np.zeros(0, int)  # independent ones, the same for a whole step: another choice is another motion beside the constraints

    def acceleration(self, t: float, motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        bias = self._bias(t, motion)
        self.move_to(motion.q, motion.v)
        rows = self.constraints(t)
        f, zd = self.internal_rates(t, motion.z)
        x = self.root.T @ f
        if len(bias):
            B, factor = self.scaled(rows.A)
            x = _onto(B[self.rows], -(factor * (bias + rows.phi_tt))[self.rows], x, len(self.rows))
        return self.root @ x, np.zeros(len(bias)), zd

    def project(self, t: float, motion: Motion) -> Motion:
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
            dq = self.root @ _onto(B[keep], -(factor * rows.phi)[keep], np.zeros(self.n), self.ranks[0] or _rank(B[keep]))
            move(q, np.vstack([dq.reshape(-1, 6), np.zeros(6)]))
        self.ranks = max(self.ranks[0], _rank(B[keep])), max(self.ranks[1], _rank(B))
        self.rows = qr(B.T, mode='r', pivoting=True)[1][: self.ranks[1]]
        v[:-1] = (self.root @ _onto(B, -factor * rows.phi_t, self.inverse_root @ v[:-1].ravel(), self.ranks[1])).reshape(-1, 6)
        return Motion(q, v, motion.z)

    def _bias(self, t: float, motion: Motion) -> np.ndarray:
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
    """(..., nb, 7) measure of configurations (..., nb + 1, 7), along the first axis with continuous signs of the quaternions."""
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


def reference(simulation: Simulation, duration: float, tolerance: float, kind: str) -> tuple[np.ndarray, int]:
    """(measured motion every FINE (n, nb, 7), evaluations) from the start of a simulation.

    Raises StepError when it does not arrive, or leaves its branch in a singular position.
    """
    scene, s = simulation.scene, simulation.state

    def inputs(t: float) -> np.ndarray:
        at = np.array([t])
        return scene.maneuver.inputs(scene.model.inputs, at, at)[0]

    make = _Quick if kind == 'reference_kkt' else _Bounded
    equations = make(simulation.model, simulation.model.new_outputs(), inputs, s.angle)
    motion = equations.project(0.0, Motion(s.q.copy(), s.v.copy(), s.z.copy()))
    if kind == 'reference_kkt':
        solver: Kkt | Stabilised = Kkt(equations, 0.0, motion, tolerance)
    else:
        solver = Stabilised(equations, 0.0, motion, tolerance, kind)
    found = [motion.q]
    try:
        for k in range(1, round(duration / FINE) + 1):
            found.append(solver.advance(k * FINE).q)
    except (np.linalg.LinAlgError, FloatingPointError, ValueError, RuntimeError) as error:  # the last one is SuperLU's of a singular factor
        raise StepError(f'{type(error).__name__}: {error}') from None
    steps = np.array(solver.steps[START_STEPS:] if isinstance(solver, Kkt) else [])
    if len(steps) and steps.min() < COLLAPSED * np.median(steps):
        raise StepError('the steps of the reference collapse: it leaves its branch in a singular position')
    return measured(np.array(found)), equations.evaluations


def on_circle(simulation: Simulation, circle: Circle, duration: float, tolerance: float) -> tuple[np.ndarray, int]:
    """Like reference(), of parallel cranks in the one coordinate that they have, also where all bars are in line: T^T M T theta'' =
    T^T (f - M T' theta'^2), with T the velocities of all bodies for theta' = 1, and M and the forces f of the compiled model."""
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
        equations.accept(Motion(q, v, np.zeros(0)))
        f, _ = equations.forces(t, np.zeros(0), 0.0)
        T_, M = T.ravel(), equations.M
        return np.array([y[1], T_ @ (f - M @ bent.ravel() * y[1] ** 2) / (T_ @ M @ T_)])

    times = np.arange(round(duration / FINE) + 1) * FINE
    found = solve_ivp(rate, (0.0, duration), [0.0, circle.rate], 'DOP853', times, rtol=max(tolerance, 3e-14), atol=tolerance, max_step=0.02)
    return measured(np.array([placed(theta)[0] for theta in found.y[0]])), equations.evaluations


def references(simulation: Simulation, mechanism: Mechanism, duration: float) -> tuple[str, list[np.ndarray], int]:
    """(kind, motions to both TOLERANCES, evaluations); fewer than two motions where the integrator stopped."""
    used = 0
    if mechanism.circle is not None:
        pairs = [on_circle(simulation, mechanism.circle, duration, tolerance) for tolerance in TOLERANCES]
        return 'minimal', [motion for motion, _ in pairs], sum(evaluations for _, evaluations in pairs)
    kind = 'reference_kkt'
    found: list[np.ndarray] = []
    for kind in ('reference_kkt', 'reference_radau'):
        found = []
        try:
            for tolerance in reversed(TOLERANCES):
                motion, evaluations = reference(simulation, duration, tolerance, kind)
                used += evaluations
                found.insert(0, motion)
            break
        except StepError:
            continue
    return kind, found, used


def unseen(y: np.ndarray, h: float) -> float:
    """d(h): the largest second difference at the distance h, halved, of a motion (n, nb, 7) every FINE; between multiples of it as h^2."""
    k = max(1, round(h / FINE))
    return float(0.5 * np.abs(y[2 * k :] - 2.0 * y[k:-k] + y[: -2 * k]).max(initial=0.0)) * (h / (k * FINE)) ** 2


def run(scene: Scene, exact: np.ndarray | None, sample: float = SAMPLE) -> tuple[str, str, float, float]:
    """(status, text, e(h), mean step [s]) of a scene; exact: the reference every FINE; sample: when they are compared, a multiple of the
    step [s].
    """
    try:
        simulation = Simulation(scene)
    except MbdError as error:
        return 'refused', str(error), np.nan, scene.integrator.h
    every = round(sample / simulation.h)
    motion = [simulation.state.q.copy()]
    try:
        while simulation.k < scene.steps:
            simulation.advance(every)
            motion.append(simulation.state.q.copy())
    except StepError as error:
        return 'error', str(error), np.nan, simulation.h
    found = findings(simulation)
    error_ = np.nan
    if exact is not None:
        sampled = exact[:: round(sample / FINE)]
        error_ = difference(measured(np.array(motion)), sampled)
    taken = simulation.h * simulation.k / simulation.totals()['substeps']
    return ('suspect' if found else 'ok'), '; '.join(map(str, found)), error_, taken


def judge(mechanism: Mechanism, steps: Sequence[float] = STEPS, duration: float = DURATION, **settings: Any) -> Judged:
    """Run a mechanism at all steps with default settings, but for those that are given, and classify."""
    simulation = Simulation(mechanism.at(duration, h=START))
    kind, motions, evaluations = references(simulation, mechanism, duration)
    exact = motions[0] if len(motions) == len(TOLERANCES) else None
    spread = difference(*motions) if exact is not None else np.nan
    size = 1.0 if exact is None else max(1.0, float(np.abs(exact - exact[0]).max()))
    found = []
    for h in steps:
        found.append((h, *run(mechanism.at(duration, h=h, **settings), exact)))
    runs = compare(found, exact, spread, size)
    model = simulation.model
    return Judged(
        name=mechanism.name, bodies=model.n_bodies, rows=model.n_rows, reference=kind if exact is not None else '',
        spread=spread, evaluations=evaluations, runs=runs,
    )  # fmt: skip


def refused(mechanism: Mechanism, text: str) -> Judged:
    """Of a mechanism that cannot be simulated at all, which says so."""
    runs = tuple(Run(h=h, status='refused', text=text, error=np.nan, unseen=np.nan, allowed=np.nan, judgement=TOLD) for h in STEPS)
    return Judged(name=mechanism.name, bodies=0, rows=0, reference='', spread=np.nan, evaluations=0, runs=runs)


def compare(
    runs: Sequence[tuple[float, str, str, float, float]], exact: np.ndarray | None, spread: float, size: float, known: Sequence[float] = ()
) -> tuple[Run, ...]:
    """classify() of runs (h, status, text, error, mean step)."""
    found = [(h, status, text, error, np.nan if exact is None else unseen(exact, taken)) for h, status, text, error, taken in runs]
    return classify(found, spread, size, known, {h for h, *_, taken in runs if taken < UNDIVIDED * h})


def classify(
    found: Sequence[tuple[float, str, str, float, float]],
    spread: float,
    size: float,
    known: Sequence[float] = (),
    divided: Set[float] = frozenset(),
) -> tuple[Run, ...]:
    """Judge runs (h, status, text, error, d(h)) of one mechanism by each other (module), or by known ratios e / d of others."""
    ratios = {h: error / max(d, 1e-300) for h, _, _, error, d in found if np.isfinite(error)}
    ok = {h for h, status, *_ in found if status == 'ok' and h not in divided}
    floor = RESOLVED * size + (0.0 if np.isnan(spread) else TOLERANCES[0] / TOLERANCES[1] * spread)
    runs = []
    for h, status, text, error, d in found:
        others = known or [ratio for other, ratio in ratios.items() if other in ok - {h}]
        if others:
            allowed = max(floor, WORSE * d * float(np.median(others)))
        else:
            coarser = min((other for other in ratios if other > h), default=None)
            allowed = max(floor, d * max(WORSE, CLOSE * ratios[coarser] if coarser else 0.0))
        if status != 'ok':
            judgement = TOLD
        elif np.isnan(spread):
            judgement = UNDECIDED
        elif error <= allowed:
            judgement = RIGHT
        else:
            judgement = UNDECIDED if spread >= 0.1 * error else WRONG
        runs.append(Run(h=h, status=status, text=text, error=error, unseen=d, allowed=allowed, judgement=judgement))
    return tuple(runs)
