"""Independent reference solutions of a compiled model: with other equations, other integrators, dense linear algebra.
Slow.

The reference methods use the element kernels of the simulator (forces, constraint residuals and Jacobians), and nothing
of its time integration, multipliers or linear solver. They solve M dv/dt = f + A^T lam, phi = 0 in two formulations.

Kkt: index 1, explicit. The accelerations come from [M -A^T; A 0] by singular values, so that redundant constraints and
massless bodies do no harm. The integrator is the Runge-Kutta method DOP853 [Hairer1993]. Positions and velocities are
projected onto the constraints after every step. Not for stiff models.

Stabilised: [Gear1985], implicit. The multipliers are the derivatives of two unknowns, Lam and Mu [Anantharaman1991].
This makes an implicit system of index 1, for the BDF and Radau methods of scipy_dae and for IDA of SUNDIALS
(scikit-sundae):

    dq/dt = v + M^-1 A^T dMu/dt        M dv/dt = f + A^T dLam/dt        dz/dt = g(z, q, v)        A v + phi_t = 0
                                       phi = 0

The rows of phi and Mu are the holonomic ones only. Of redundant constraints the method keeps a set of independent rows,
and chooses another set when these become dependent. It stops at singular positions.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable

import numpy as np
from scipy.integrate import DOP853
from scipy.linalg import qr
from scipy.sparse import csc_matrix

from solver.errors import SpecError, StepError
from solver.model.tables import Model
from solver.reference.dense import INTERNAL_STEP, RANK_TOLERANCE, Equations, MotionState, quaternion_rate, skew

# Smallest singular value of the rows that are kept, relative to that of another choice, below which the other rows are
# taken.
# Ten times as much would change rows many times a second.
WORN = 0.03
LONGEST_STEP = 0.02  # longest step [s]: at rest a method would grow its step and pass over the inputs that end the rest
LARGE = 200  # number of unknowns from which a sparse or blocked factorization is faster
UNIT_RATE = 10.0  # rate [1/s] with which the norm of a quaternion returns to 1
METHODS = {  # integrator.kind -> (package, class)
    'reference_bdf': ('scipy_dae', 'BDFDAE'),
    'reference_radau': ('scipy_dae', 'RadauDAE'),
    'reference_ida': ('scikit-sundae', 'IDA'),
}


class _Layout:
    """Places of q, v and z in the vector of unknowns y (7 nb + 6 nb + nz,), for nb bodies and nz internal states."""

    def __init__(self, model: Model) -> None:
        self.nb = model.n_bodies
        self.q, self.v = slice(0, 7 * self.nb), slice(7 * self.nb, 13 * self.nb)
        self.z = slice(13 * self.nb, 13 * self.nb + model.n_internal)
        self.end = self.z.stop

    def pack(self, motion: MotionState) -> np.ndarray:
        """The vector y of a motion."""
        return np.concatenate([motion.q[:-1].ravel(), motion.v[:-1].ravel(), motion.z])

    def unpack(self, y: np.ndarray) -> MotionState:
        """The motion in a vector y, its quaternions normalised, with the world as the last body."""
        q = np.vstack([y[self.q].reshape(-1, 7), [0, 0, 0, 0, 0, 0, 1]])
        q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1)[:, None]
        return MotionState(q, np.vstack([y[self.v].reshape(-1, 6), np.zeros(6)]), y[self.z].copy())

    def rate(self, y: np.ndarray, v: np.ndarray) -> np.ndarray:
        """dq/dt (7 nb,) of the twists v (6 nb,), with a term that draws the norms of the quaternions back to 1."""
        q, v = y[self.q].reshape(-1, 7)[:, 3:], v.reshape(-1, 6)
        turn = np.einsum('bij,bj->bi', quaternion_rate(q), v[:, 3:]) + UNIT_RATE * (1.0 - (q * q).sum(1))[:, None] * q
        return np.hstack([v[:, :3], turn]).ravel()


class Kkt:
    """Index 1, explicit, with projection; see the module. advance(t) -> MotionState at t [s].

    steps: steps of the method so far [s]. At a singular position the motion may continue on several branches. This
    method may then change the branch, with the same energy and a jump of the velocities; its steps become tiny at that
    instant.
    """

    def __init__(self, equations: Equations, t: float, motion: MotionState, tolerance: float) -> None:
        self.equations, self.layout = equations, _Layout(equations.model)
        self.factorizations = 0
        self.steps: list[float] = []
        self.t = t
        start = self.layout.pack(motion)
        self.solver = DOP853(
            self._rate, t, start, np.inf, max_step=LONGEST_STEP, rtol=max(tolerance, 3e-14), atol=tolerance
        )
        self.interpolate: Callable[[float], np.ndarray] = lambda _: start

    def _rate(self, t: float, y: np.ndarray) -> np.ndarray:
        self.factorizations += 1
        motion = self.layout.unpack(y)
        if not np.isfinite(y).all():
            return np.full_like(y, np.nan)  # the method then tries a shorter step
        a, _, zd = self.equations.acceleration(t, motion)
        return np.concatenate([self.layout.rate(y, y[self.layout.v]), a, zd])

    def advance(self, t: float) -> MotionState:
        """The motion at t [s], interpolated in the step that goes beyond t."""
        s = self.solver
        while self.t < t:
            with np.errstate(over='ignore', invalid='ignore'):  # trial steps may overflow; the method rejects them
                message = s.step()
            if s.status == 'failed':
                raise StepError(message or 'the step size fell to zero')
            self.steps.append(s.t - self.t)
            self.interpolate = s.dense_output()
            motion = self.equations.project(s.t, self.layout.unpack(s.y))
            self.equations.accept(motion)
            s.y = self.layout.pack(motion)
            s.f = self._rate(s.t, s.y)
            self.t = s.t
        return self.layout.unpack(self.interpolate(t))


class Stabilised:
    """Stabilised index 2 form, implicit; see the module. advance(t) -> MotionState at t [s].

    kind: a key of METHODS. Raises SpecError if its package is missing.
    """

    def __init__(self, equations: Equations, t: float, motion: MotionState, tolerance: float, kind: str) -> None:
        self.equations, self.layout, self.kind, self.tolerance = equations, _Layout(equations.model), kind, tolerance
        package, name = METHODS[kind]
        try:
            module = importlib.import_module('scipy_dae.integrate' if package == 'scipy_dae' else 'sksundae.ida')
        except ImportError:
            raise SpecError(
                f'integrator: kind = {kind!r}: needs the package {package}; install it with pip install '
                "'mbd_sim_ros[references]'"
            ) from None
        self.method = getattr(module, name)
        self.factorizations = 0  # number of LU decompositions; with IDA that of Jacobians, each of which is decomposed
        self._start(t, motion, self._independent_rows(t, motion)[0])
        start = self.layout.pack(motion)
        self.interpolate: Callable[[float], np.ndarray] = lambda _: start

    def _start(self, t: float, motion: MotionState, rows: np.ndarray) -> None:
        """Begin, or begin anew, at a motion, with the constraint rows of these indices."""
        e, nr, end = self.equations, len(rows), self.layout.end
        self.rows = rows
        self.closing = rows[e.holonomic[rows]]  # the holonomic ones, which have a residual of positions
        self.Lam, self.Mu = slice(end, end + nr), slice(end + nr, end + nr + len(self.closing))
        self.size = self.Mu.stop
        a, _, zd = e.acceleration(t, motion)
        e.move_to(motion.q, motion.v)
        f, _ = e.internal_rates(t, motion.z)
        lam = np.linalg.lstsq(e.constraints(t).A[rows].T, e.M @ a - f, rcond=None)[0]
        y = np.concatenate([self.layout.pack(motion), np.zeros(self.size - end)])
        yp = np.concatenate([self.layout.rate(y, y[self.layout.v]), a, zd, lam, np.zeros(len(self.closing))])
        options = {'rtol': self.tolerance, 'atol': self.tolerance, 'max_step': LONGEST_STEP}
        if self.kind == 'reference_ida':
            large = {'linsolver': 'lapackdense'} if self.size > LARGE else {}
            self.solver = self.method(
                self._ida_residual, max_num_steps=1_000_000, jacfn=self._ida_jacobian, **large, **options
            )
            self.solver.init_step(t, y, yp)
        else:
            first = 1e-3 * self.tolerance**0.25
            jac = self._sparse_jacobians if self.size > LARGE else self.jacobians
            self.solver = self.method(self.residual, t, y, yp, np.inf, first_step=first, jac=jac, **options)
        self.t = t

    def _independent_rows(self, t: float, motion: MotionState) -> tuple[np.ndarray, np.ndarray]:
        """(indices of a largest set of independent constraint rows, all rows, scaled)."""
        self.equations.move_to(motion.q, motion.v)
        B, _ = self.equations.scaled(self.equations.constraints(t).A)
        return independent(B, self.equations.holonomic), B

    def _accept(self, t: float, motion: MotionState) -> None:
        """Take the motion after a step. If the rows that are kept have become dependent, begin anew with others."""
        self.equations.accept(motion)
        self.t = t
        if len(self.rows) == self.equations.model.n_rows:
            return
        rows, B = self._independent_rows(t, motion)
        strength = [np.linalg.svd(B[r], compute_uv=False).min(initial=1.0) for r in (self.rows, rows)]
        if len(rows) == len(self.rows) and strength[0] < WORN * strength[1]:
            self._start(t, self.equations.project(t, motion), rows)

    def residual(self, t: float, y: np.ndarray, yp: np.ndarray) -> np.ndarray:
        """Residual F(t, y, dy/dt) of the implicit system (size,)."""
        e, s = self.equations, self.layout
        q, v, z = s.unpack(y)
        e.move_to(q, v)
        rows = e.constraints(t)
        A, closing = rows.A[self.rows], rows.A[self.closing]
        z_stage, cz = z, INTERNAL_STEP
        f, z_stage = e.forces(t, z - cz * yp[s.z], cz)
        out = np.empty(self.size)
        out[s.q] = yp[s.q] - s.rate(y, y[s.v] + e.root @ (e.root.T @ (closing.T @ yp[self.Mu])))
        out[s.v] = e.M @ yp[s.v] - f - A.T @ yp[self.Lam]
        out[s.z] = (z - z_stage) / cz
        out[self.Lam] = A @ y[s.v] + rows.phi_t[self.rows]
        out[self.Mu] = rows.phi[self.closing]
        return out

    def jacobians(self, t: float, y: np.ndarray, yp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(dF/dy, dF/dy') (size, size) each, without the derivative of A^T dMu/dt over y, which is zero on the
        solution."""
        e, s, nb = self.equations, self.layout, self.layout.nb
        q, v, z = s.unpack(y)
        e.move_to(q, v)
        all_rows = e.constraints(t).A
        A, closing = all_rows[self.rows], all_rows[self.closing]
        lam = np.zeros(e.model.n_rows)
        lam[self.rows] = yp[self.Lam]
        cz = INTERNAL_STEP
        zp = z - cz * yp[s.z]
        f_z, z_z, z_q, z_v = e.internal_gradients(t, MotionState(q, v, z), zp, cz)
        e.forces(t, zp, cz, tangents=True)
        Kq, Kv = e.stiffness(lam)
        Av_q = e.rate_gradients(y[s.v])[self.rows]
        Q, w = y[s.q].reshape(-1, 7)[:, 3:], y[s.v].reshape(-1, 6)[:, 3:]
        norm = (Q * Q).sum(1)
        variation = np.zeros((nb, 6, nb, 7))  # d(variation)/d(position, quaternion)
        rate = np.zeros((nb, 7, nb, 6))  # d(dq/dt)/dv
        slope = np.zeros((nb, 7, nb, 7))  # d(dq/dt)/dq
        E = quaternion_rate(Q)
        half = np.zeros((nb, 4, 4))
        half[:, :3, :3], half[:, :3, 3], half[:, 3, :3] = -0.5 * skew(w), 0.5 * w, -0.5 * w
        pull = UNIT_RATE * ((1.0 - norm)[:, None, None] * np.eye(4) - 2.0 * Q[:, :, None] * Q[:, None, :])
        for b in range(nb):
            variation[b, :3, b, :3] = rate[b, :3, b, :3] = np.eye(3)
            variation[b, 3:, b, 3:] = 4.0 * E[b].T / norm[b]
            rate[b, 3:, b, 3:] = E[b]
            slope[b, 3:, b, 3:] = half[b] + pull[b]
        D, H = variation.reshape(6 * nb, 7 * nb), rate.reshape(7 * nb, 6 * nb)
        Jy, Jp = np.zeros((self.size, self.size)), np.zeros((self.size, self.size))
        Jp[s.q, s.q] = np.eye(7 * nb)
        Jp[s.q, self.Mu] = -H @ e.root @ (e.root.T @ closing.T)
        Jp[s.v, s.v] = e.M
        Jp[s.v, self.Lam] = -A.T
        Jy[s.q, s.q] = -slope.reshape(7 * nb, 7 * nb)
        Jy[s.q, s.v] = -H
        Jy[s.v, s.q] = -Kq @ D
        Jy[s.v, s.v] = -Kv
        Jy[s.v, s.z], Jp[s.v, s.z] = -f_z, cz * f_z
        Jy[s.z, s.q], Jy[s.z, s.v] = -z_q @ D / cz, -z_v / cz
        Jy[s.z, s.z], Jp[s.z, s.z] = (np.eye(len(z)) - z_z) / cz, z_z
        Jy[self.Lam, s.q] = Av_q @ D
        Jy[self.Lam, s.v] = A
        Jy[self.Mu, s.q] = closing @ D
        return Jy, Jp

    def _sparse_jacobians(self, t: float, y: np.ndarray, yp: np.ndarray) -> tuple[csc_matrix, csc_matrix]:
        Jy, Jp = self.jacobians(t, y, yp)
        return csc_matrix(Jy), csc_matrix(Jp)

    def _ida_residual(self, t, y, yp, res) -> None:
        res[:] = self.residual(t, y, yp)

    def _ida_jacobian(self, t, y, yp, res, cj, JJ) -> None:
        self.factorizations += 1
        Jy, Jp = self.jacobians(t, y, yp)
        JJ[:, :] = Jy + cj * Jp

    def _step(self, t: float) -> tuple[float, Callable[[float], np.ndarray]]:
        """Make one step of the method towards t [s]; returns (time reached [s], interpolant y(t) over the step)."""
        s = self.solver
        if self.kind == 'reference_ida':
            result = s.step(t, method='onestep', tstop=t)
            if not result.success:
                raise StepError(str(result.message))
            y = np.array(result.y).ravel()
            return float(np.ravel(result.t)[-1]), lambda _: y
        before = s.nlu
        message = s.step()
        self.factorizations += s.nlu - before
        if s.status == 'failed':
            raise StepError(message or 'the step size fell to zero')
        dense = s.dense_output()
        return s.t, lambda at: dense(at)[0]

    def advance(self, t: float) -> MotionState:
        """The motion at t [s], interpolated in the last step."""
        while self.t < t:
            reached, self.interpolate = self._step(t)
            self._accept(reached, self.layout.unpack(self.interpolate(reached)))
        return self.layout.unpack(self.interpolate(t))


def independent(B: np.ndarray, holonomic: np.ndarray) -> np.ndarray:
    """Indices, ascending, of a largest set of independent rows of B, whose rows have length 1.

    Holonomic rows are chosen first, so that all positions are determined. The method is QR with column pivoting of B^T.
    """
    chosen = np.zeros(0, int)
    for group in (np.flatnonzero(holonomic), np.flatnonzero(~holonomic)):
        known = np.linalg.qr(B[chosen].T)[0]
        rest = B[group] - (B[group] @ known) @ known.T
        if len(group):
            R, pivot = qr(rest.T, mode='r', pivoting=True)
            chosen = np.concatenate([chosen, group[pivot[: int((np.abs(np.diag(R)) > RANK_TOLERANCE).sum())]]])
    return np.sort(chosen)
