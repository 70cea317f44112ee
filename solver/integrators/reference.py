"""Independent reference solutions of a compiled model: other equations, other integrators, dense linear algebra, slow.

They share the element kernels (forces, constraint residuals and Jacobians) with the step, and nothing of its time integration,
multipliers or linear solver. Two formulations of M dv/dt = f + A^T lam, phi = 0:

Kkt: index 1. Accelerations from [M -A^T; A 0] by singular values, so redundant constraints and massless bodies are harmless, with the
explicit Runge-Kutta method DOP853; positions and velocities are projected after every step. Not for stiff models.

Stabilised: Gear, Gupta, Leimkuhler (1985) with the derivatives of the unknowns Lam and Mu as multipliers (Anantharaman and Hiller
1991), an implicit system of index 1 for the BDF and Radau methods of scipy_dae and for IDA of SUNDIALS (scikit-sundae):

    dq/dt = v + M^-1 A^T dMu/dt        M dv/dt = f + A^T dLam/dt        dz/dt = g(z, q, v)        A v + phi_t = 0        phi = 0

Of redundant constraints it keeps a set of independent rows found at the start; it stops where they become dependent (singular positions).
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.integrate import DOP853
from scipy.linalg import qr

from solver.dynamics import add_constraint_stiffness, constraint_input_rates, evaluate_constraints, evaluate_forces
from solver.errors import SpecError, StepError
from solver.model.state import fill_kinematics, new_kinematics, update_angles
from solver.model.tables import Model
from solver.reference import Ref

RANK_TOLERANCE = 1e-8  # of rows scaled to unit norm in the metric of the masses
CLOSED = 1e-13  # m or rad
INTERNAL_STEP = 1e-4  # s; the kernels solve z = zp + cz dz/dt, which gives dz/dt for any small cz
UNIT_RATE = 10.0  # 1/s, by which the norm of quaternions returns to one
METHODS = {'reference_bdf': ('scipy_dae', 'BDFDAE'), 'reference_radau': ('scipy_dae', 'RadauDAE'), 'reference_ida': ('scikit-sundae', 'IDA')}


class Motion(NamedTuple):
    """Configuration q (nb + 1, 7), twists v (nb + 1, 6) and internal states z (nz,), laid out as in the state."""

    q: np.ndarray
    v: np.ndarray
    z: np.ndarray


class Rows(NamedTuple):
    """Constraints at an instant: residual (nc,), explicit time derivatives (nc,) and Jacobian (nc, 6 nb)."""

    phi: np.ndarray
    phi_t: np.ndarray
    phi_tt: np.ndarray
    A: np.ndarray


class Equations:
    """Forces and constraints of a compiled model as dense matrices. inputs: t [s] -> (nu,). Not thread-safe: one scratch."""

    def __init__(self, model: Model, outputs: Ref, inputs: Callable[[float], np.ndarray], angle: np.ndarray) -> None:
        t = model.tables
        self.model, self.tables, self.outputs, self.inputs = model, t, outputs, inputs
        self.n = 6 * model.n_bodies
        self.angle = angle.copy()  # of the last accepted step: rotations are continued from it
        self.evaluations = 0
        nb, nc, ns = model.n_bodies, model.n_rows, model.n_slots
        self._kin = Ref(new_kinematics(nb))
        self._coordinates = Ref(t.coordinates)
        self._f = np.zeros((nb + 1, 6))
        self._Kq, self._Kv = np.zeros((ns + 1, 6, 6)), np.zeros((ns + 1, 6, 6))
        self._phi, self._phi_t, self._phi_tt = np.zeros(nc), np.zeros(nc), np.zeros(nc)
        self._J = np.zeros((model.n_entries + 1, 6, 6))
        con = t.constraints
        places = [
            (row, con.body[e], e, row - con.row[g])
            for g in range(len(con.row) - 1)
            for e in range(con.entry[g], con.entry[g + 1])
            for row in range(con.row[g], con.row[g + 1])
        ]
        self._places = np.array(places, int).reshape(-1, 4).T
        self.M, self.root = np.zeros((self.n, self.n)), np.zeros((self.n, self.n))
        for b in range(nb):
            p, r = slice(6 * b, 6 * b + 3), slice(6 * b + 3, 6 * b + 6)
            self.M[p, p] = t.bodies.mass[b] * np.eye(3)
            self.M[r, r] = t.bodies.inertia[b]
            self.root[p, p] = np.sqrt(t.penalty_inverse_mass[b]) * np.eye(3)  # root root^T = M^-1, floored for massless bodies
            self.root[r, r] = np.linalg.cholesky(t.penalty_inverse_inertia[b])

    def move_to(self, q: np.ndarray, v: np.ndarray) -> None:
        """Place the bodies; all other methods refer to this configuration."""
        fill_kinematics(q, v, self._kin)

    def accept(self, motion: Motion) -> None:
        """Continue rotations from this motion on."""
        self.move_to(motion.q, motion.v)
        update_angles(self._coordinates, self._kin, self.angle)

    def constraints(self, t: float) -> Rows:
        """Rows at the current placement."""
        u = self.inputs(t)
        evaluate_constraints(self.tables, self._kin, self.angle, u, self._phi, self._J)
        constraint_input_rates(self.tables, u, self._phi_t, self._phi_tt)
        A = np.zeros((self.model.n_rows, self.model.n_bodies, 6))
        row, body, entry, k = self._places
        A[row, body] = self._J[entry, k]
        return Rows(self._phi.copy(), self._phi_t.copy(), self._phi_tt.copy(), A.reshape(-1, self.n))

    def forces(self, t: float, zp: np.ndarray, cz: float, tangents: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """(f (6 nb,), z (nz,)) with z = zp + cz dz/dt; tangents are left for stiffness()."""
        self.evaluations += 1
        z = np.zeros_like(zp)
        evaluate_forces(
            self.tables, self._kin, self.angle, zp, cz, self.inputs(t), tangents, self._f, self._Kq, self._Kv, z, self.outputs
        )  # fmt: skip
        return self._f[:-1].ravel().copy(), z

    def internal_rates(self, t: float, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(f, dz/dt) with the internal states z: zp is sought such that the kernels find z."""
        zp = z.copy()
        for _ in range(8):
            f, found = self.forces(t, zp, INTERNAL_STEP)
            if not len(z) or np.abs(found - z).max() <= 1e-15 * max(1.0, np.abs(z).max()):
                break
            zp += z - found
        return f, (z - zp) / INTERNAL_STEP

    def stiffness(self, lam: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(d(f + A^T lam)/dq, df/dv), (6 nb, 6 nb) each, after forces(tangents=True)."""
        add_constraint_stiffness(self.tables, self._kin, lam, self._Kq, self._Kv)
        return self._dense(self._Kq), self._dense(self._Kv)

    def rate_gradients(self, v: np.ndarray) -> np.ndarray:
        """d(A v)/dq (nc, 6 nb) with v (6 nb,) held: one evaluation of the second derivatives for every row."""
        out = np.zeros((self.model.n_rows, self.n))
        unit = np.zeros(self.model.n_rows)
        for row in range(len(unit)):
            unit[row] = 1.0
            self._Kq[:] = 0.0
            add_constraint_stiffness(self.tables, self._kin, unit, self._Kq, self._Kv)
            out[row] = v @ self._dense(self._Kq)
            unit[row] = 0.0
        return out

    def _dense(self, K: np.ndarray) -> np.ndarray:
        nb = self.model.n_bodies
        out = np.zeros((nb, nb, 6, 6))
        out[self.tables.block_row[1:], self.tables.block_col[1:]] = K[1:]
        return out.transpose(0, 2, 1, 3).reshape(self.n, self.n)

    def scaled(self, A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(rows in the metric of the masses and of unit norm, their factors (nc,))."""
        B = A @ self.root
        factor = 1.0 / np.maximum(np.linalg.norm(B, axis=1), 1e-300)
        return B * factor[:, None], factor

    def acceleration(self, t: float, motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(a (6 nb,), lam (nc,), dz/dt): smallest multipliers in the metric of the effective masses where they are not unique."""
        self.move_to(motion.q, motion.v)
        v = motion.v[:-1].ravel()
        rows = self.constraints(t)
        bias = self.rate_gradients(v) @ v + rows.phi_tt
        f, zd = self.internal_rates(t, motion.z)
        B, factor = self.scaled(rows.A)
        n, nc = self.n, len(factor)
        system = np.block([[self.root.T @ self.M @ self.root, -B.T], [B, np.zeros((nc, nc))]])
        x = np.linalg.lstsq(system, np.concatenate([self.root.T @ f, -factor * bias]), rcond=RANK_TOLERANCE**2)[0]
        return self.root @ x[:n], factor * x[n:], zd

    def project(self, t: float, motion: Motion) -> Motion:
        """The nearest motion with phi = 0 and A v + phi_t = 0 (in the metric of the masses)."""
        q, v = motion.q.copy(), motion.v.copy()
        for _ in range(10):
            self.move_to(q, v)
            rows = self.constraints(t)
            B, factor = self.scaled(rows.A)
            if not len(factor) or np.abs(rows.phi).max() < CLOSED:
                break
            dq = self.root @ np.linalg.lstsq(B, -factor * rows.phi, rcond=RANK_TOLERANCE)[0]
            q[:-1] = moved(q[:-1], dq.reshape(-1, 6))
        if len(factor):
            open_ = factor * (rows.A @ v[:-1].ravel() + rows.phi_t)
            v[:-1] -= (self.root @ np.linalg.lstsq(B, open_, rcond=RANK_TOLERANCE)[0]).reshape(-1, 6)
        return Motion(q, v, motion.z)


def skew(u: np.ndarray) -> np.ndarray:
    """(n, 3, 3) cross product matrices of u (n, 3)."""
    out = np.zeros((len(u), 3, 3))
    out[:, 2, 1], out[:, 0, 2], out[:, 1, 0] = u.T
    return out - out.transpose(0, 2, 1)


def quaternion_rate(q: np.ndarray) -> np.ndarray:
    """(n, 4, 3) E with dQ/dt = E w for quaternions xyzw (n, 4) and angular velocities in the body."""
    top = q[:, 3, None, None] * np.eye(3) + skew(q[:, :3])
    return 0.5 * np.concatenate([top, -q[:, None, :3]], axis=1)


def moved(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
    """q (n, 7) after small variations dq (n, 6): second order in the rotation, normalised."""
    out = q.copy()
    out[:, :3] += dq[:, :3]
    out[:, 3:] += np.einsum('bij,bj->bi', quaternion_rate(q[:, 3:]), dq[:, 3:])
    out[:, 3:] /= np.linalg.norm(out[:, 3:], axis=1)[:, None]
    return out


class _Layout:
    """Where q, v, z stand in the vector of unknowns of nb bodies and nz internal states."""

    def __init__(self, model: Model) -> None:
        self.nb = model.n_bodies
        self.q, self.v = slice(0, 7 * self.nb), slice(7 * self.nb, 13 * self.nb)
        self.z = slice(13 * self.nb, 13 * self.nb + model.n_internal)
        self.end = self.z.stop

    def pack(self, motion: Motion) -> np.ndarray:
        return np.concatenate([motion.q[:-1].ravel(), motion.v[:-1].ravel(), motion.z])

    def unpack(self, y: np.ndarray) -> Motion:
        q = np.vstack([y[self.q].reshape(-1, 7), [0, 0, 0, 0, 0, 0, 1]])
        q[:, 3:] /= np.linalg.norm(q[:, 3:], axis=1)[:, None]
        return Motion(q, np.vstack([y[self.v].reshape(-1, 6), np.zeros(6)]), y[self.z].copy())

    def rate(self, y: np.ndarray, v: np.ndarray) -> np.ndarray:
        """dq/dt (7 nb,) of twists v (6 nb,), with the drift of the quaternions' norm drawn back."""
        q, v = y[self.q].reshape(-1, 7)[:, 3:], v.reshape(-1, 6)
        turn = np.einsum('bij,bj->bi', quaternion_rate(q), v[:, 3:]) + UNIT_RATE * (1.0 - (q * q).sum(1))[:, None] * q
        return np.hstack([v[:, :3], turn]).ravel()


class Kkt:
    """Index 1, explicit, with projection. advance(t) -> Motion at t [s]."""

    def __init__(self, equations: Equations, t: float, motion: Motion, tolerance: float) -> None:
        self.equations, self.layout = equations, _Layout(equations.model)
        self.factorizations = 0
        self.solver = DOP853(self._rate, t, self.layout.pack(motion), np.inf, rtol=max(tolerance, 3e-14), atol=tolerance)
        self.dense: Callable[[float], np.ndarray] | None = None

    def _rate(self, t: float, y: np.ndarray) -> np.ndarray:
        self.factorizations += 1
        motion = self.layout.unpack(y)
        a, _, zd = self.equations.acceleration(t, motion)
        return np.concatenate([self.layout.rate(y, y[self.layout.v]), a, zd])

    def advance(self, t: float) -> Motion:
        """Step over t and interpolate."""
        s = self.solver
        while s.t < t:
            message = s.step()
            if s.status == 'failed':
                raise StepError(message or 'the step size fell to zero')
            self.dense = s.dense_output()
            motion = self.equations.project(s.t, self.layout.unpack(s.y))
            self.equations.accept(motion)
            s.y = self.layout.pack(motion)
            s.f = self._rate(s.t, s.y)
        return self.layout.unpack(s.y if self.dense is None or t == s.t else self.dense(t))


class Stabilised:
    """Stabilised index 2 form, implicit. advance(t) -> Motion at t [s]. kind: a key of METHODS. Raises SpecError without the package."""

    def __init__(self, equations: Equations, t: float, motion: Motion, tolerance: float, kind: str) -> None:
        self.equations, self.layout, self.kind = equations, _Layout(equations.model), kind
        a, _, zd = equations.acceleration(t, motion)
        equations.move_to(motion.q, motion.v)
        rows = equations.constraints(t)
        B, _ = equations.scaled(rows.A)
        self.rows = independent(B)
        nr, end = len(self.rows), self.layout.end
        self.Lam, self.Mu, self.size = slice(end, end + nr), slice(end + nr, end + 2 * nr), end + 2 * nr
        f, _ = equations.internal_rates(t, motion.z)
        lam = np.linalg.lstsq(rows.A[self.rows].T, equations.M @ a - f, rcond=None)[0]
        y = np.concatenate([self.layout.pack(motion), np.zeros(2 * nr)])
        yp = np.concatenate([self.layout.rate(y, y[self.layout.v]), a, zd, lam, np.zeros(nr)])
        package, name = METHODS[kind]
        try:
            module = importlib.import_module('scipy_dae.integrate' if package == 'scipy_dae' else 'sksundae.ida')
        except ImportError:
            raise SpecError(
                f"integrator: kind = {kind!r}: needs the package {package}; install it with pip install 'mbd_sim_ros[references]'"
            ) from None
        options = {'rtol': tolerance, 'atol': tolerance}
        if kind == 'reference_ida':
            jacobian = {'jacfn': self._ida_jacobian} if not equations.model.n_internal else {}
            self.solver = module.IDA(self._ida_residual, max_num_steps=1_000_000, **options, **jacobian)
            self.solver.init_step(t, y, yp)
            self.t = t
        else:
            jac = self.jacobians if not equations.model.n_internal else None
            self.solver = getattr(module, name)(self.residual, t, y, yp, np.inf, first_step=1e-3 * tolerance**0.25, jac=jac, **options)
        self.dense: Callable | None = None
        self.y = y

    @property
    def factorizations(self) -> int:
        """LU decompositions so far (Jacobian evaluations for IDA, each of which is decomposed)."""
        return self._jacobians if self.kind == 'reference_ida' else self.solver.nlu

    _jacobians = 0

    def residual(self, t: float, y: np.ndarray, yp: np.ndarray) -> np.ndarray:
        """F(t, y, dy/dt)."""
        e, s = self.equations, self.layout
        q, v, z = s.unpack(y)
        e.move_to(q, v)
        rows = e.constraints(t)
        A = rows.A[self.rows]
        z_s, cz = z, INTERNAL_STEP
        f, z_s = e.forces(t, z - cz * yp[s.z], cz)
        out = np.empty(self.size)
        out[s.q] = yp[s.q] - s.rate(y, y[s.v] + e.root @ (e.root.T @ (A.T @ yp[self.Mu])))
        out[s.v] = e.M @ yp[s.v] - f - A.T @ yp[self.Lam]
        out[s.z] = (z - z_s) / cz
        out[self.Lam] = A @ y[s.v] + rows.phi_t[self.rows]
        out[self.Mu] = rows.phi[self.rows]
        return out

    def jacobians(self, t: float, y: np.ndarray, yp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(dF/dy, dF/dy'), without the derivative of A^T dMu/dt, which vanishes on the solution. Models without internal states."""
        self._jacobians += 1
        e, s, nb = self.equations, self.layout, self.layout.nb
        q, v, z = s.unpack(y)
        e.move_to(q, v)
        A = e.constraints(t).A[self.rows]
        lam = np.zeros(e.model.n_rows)
        lam[self.rows] = yp[self.Lam]
        e.forces(t, z, 0.0, tangents=True)
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
        Jp[s.q, self.Mu] = -H @ e.root @ (e.root.T @ A.T)
        Jp[s.v, s.v] = e.M
        Jp[s.v, self.Lam] = -A.T
        Jy[s.q, s.q] = -slope.reshape(7 * nb, 7 * nb)
        Jy[s.q, s.v] = -H
        Jy[s.v, s.q] = -Kq @ D
        Jy[s.v, s.v] = -Kv
        Jy[self.Lam, s.q] = Av_q @ D
        Jy[self.Lam, s.v] = A
        Jy[self.Mu, s.q] = A @ D
        return Jy, Jp

    def _ida_residual(self, t, y, yp, res) -> None:
        res[:] = self.residual(t, y, yp)

    def _ida_jacobian(self, t, y, yp, res, cj, JJ) -> None:
        Jy, Jp = self.jacobians(t, y, yp)
        JJ[:, :] = Jy + cj * Jp

    def advance(self, t: float) -> Motion:
        """Step over t and interpolate."""
        if self.kind == 'reference_ida':
            if t > self.t:
                result = self.solver.step(t)
                if not result.success:
                    raise StepError(str(result.message))
                self.t, self.y = t, np.array(result.y).ravel()
            motion = self.layout.unpack(self.y)
            self.equations.accept(motion)
            return motion
        s = self.solver
        while s.t < t:
            message = s.step()
            if s.status == 'failed':
                raise StepError(message or 'the step size fell to zero')
            self.dense = s.dense_output()
            self.equations.accept(self.layout.unpack(s.y))
        return self.layout.unpack(s.y if self.dense is None or t == s.t else self.dense(t)[0])


def independent(B: np.ndarray) -> np.ndarray:
    """Indices, ascending, of a largest set of independent rows of B (unit norms), by QR with column pivoting of the transpose."""
    if not len(B):
        return np.zeros(0, int)
    R, pivot = qr(B.T, mode='r', pivoting=True)
    d = np.abs(np.diag(R))
    return np.sort(pivot[: int((d > RANK_TOLERANCE * d[0]).sum())])
