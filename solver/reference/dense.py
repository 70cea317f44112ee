"""A compiled model as dense matrices: forces, constraints, accelerations, projections. For references and tests, not
for speed."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from solver.compiled.by_reference import Ref
from solver.model.evaluate import (
    add_constraint_stiffness,
    constraint_input_rates,
    evaluate_constraints,
    evaluate_forces,
)
from solver.model.state import fill_kinematics, new_kinematics, update_angles
from solver.model.tables import Model

RANK_TOLERANCE = 1e-8  # of rows scaled to unit norm in the metric of the masses
CLOSED = 1e-13  # m or rad
DIFFERENCE = 1e-6  # m, rad or their rates
INTERNAL_STEP = 1e-4  # s; the kernels solve z = zp + cz dz/dt, which gives dz/dt for any small cz


class MotionState(NamedTuple):
    """Configuration q (nb + 1, 7), twists v (nb + 1, 6) and internal states z (nz,), laid out as in the state."""

    q: np.ndarray
    v: np.ndarray
    z: np.ndarray


class Rows(NamedTuple):
    """Constraints at an instant: residual (nc,) (A v of rows that are not holonomic), time derivatives (nc,), Jacobian
    (nc, 6 nb)."""

    phi: np.ndarray
    phi_t: np.ndarray
    phi_tt: np.ndarray
    A: np.ndarray


class Equations:
    """Forces and constraints of a compiled model as dense matrices. inputs: t [s] -> (nu,). Not thread-safe: one
    scratch."""

    def __init__(
        self, model: Model, outputs: np.ndarray, inputs: Callable[[float], np.ndarray], angle: np.ndarray
    ) -> None:
        t = model.tables
        self.model, self.tables, self.outputs, self.inputs = model, t, outputs, inputs
        self.n = 6 * model.n_bodies
        self.holonomic = t.constraints.holonomic == 1
        self._sampled = (np.nan, np.zeros(0))
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
            # root root^T = M^-1, floored for massless bodies
            self.root[p, p] = np.sqrt(t.penalty_inverse_mass[b]) * np.eye(3)
            self.root[r, r] = np.linalg.cholesky(t.penalty_inverse_inertia[b])

    def move_to(self, q: np.ndarray, v: np.ndarray) -> None:
        """Place the bodies; all other methods refer to this configuration."""
        fill_kinematics(q, v, self._kin)

    def _inputs(self, t: float) -> np.ndarray:
        """Inputs at t; sampling a maneuver costs more than an evaluation of the forces, and an instant is asked for
        several times."""
        if self._sampled[0] != t:
            self._sampled = (t, self.inputs(t))
        return self._sampled[1]

    def accept(self, motion: MotionState) -> None:
        """Continue rotations from this motion on."""
        self.move_to(motion.q, motion.v)
        update_angles(self._coordinates, self._kin, self.angle)

    def constraints(self, t: float) -> Rows:
        """Rows at the current placement."""
        u = self._inputs(t)
        evaluate_constraints(self.tables, self._kin, self.angle, u, True, self._phi, self._J)
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
            self.tables, self._kin, self.angle, zp, cz, self._inputs(t), tangents, self._f, self._Kq, self._Kv, z,
            self.outputs
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

    def internal_gradients(
        self, t: float, motion: MotionState, zp: np.ndarray, cz: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(df/dzp (6 nb, nz), dz/dzp (nz, nz), dz/dq (nz, 6 nb), dz/dv (nz, 6 nb)) of forces() at zp, cz, by central
        differences: the kernels report what the forces lose by eliminating z, not z itself. Leaves the bodies at the
        motion."""
        nz = len(zp)
        f_z, z_z, z_q, z_v = np.zeros((self.n, nz)), np.zeros((nz, nz)), np.zeros((nz, self.n)), np.zeros((nz, self.n))
        for k, d in enumerate(DIFFERENCE * np.eye(nz)):
            (f1, z1), (f0, z0) = self.forces(t, zp + d, cz), self.forces(t, zp - d, cz)
            f_z[:, k], z_z[:, k] = (f1 - f0) / (2 * DIFFERENCE), (z1 - z0) / (2 * DIFFERENCE)
        for b in self.model.internal_bodies:
            for i, d in enumerate(DIFFERENCE * np.eye(6)):
                for out, q_step, v_step in ((z_q, d, 0.0 * d), (z_v, 0.0 * d, d)):
                    sides = []
                    for s in (1.0, -1.0):
                        q, v = motion.q.copy(), motion.v.copy()
                        q[b : b + 1] = moved(q[b : b + 1], s * q_step[None, :])
                        v[b] += s * v_step
                        self.move_to(q, v)
                        sides.append(self.forces(t, zp, cz)[1])
                    out[:, 6 * b + i] = (sides[0] - sides[1]) / (2 * DIFFERENCE)
        self.move_to(motion.q, motion.v)
        return f_z, z_z, z_q, z_v

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

    def acceleration(self, t: float, motion: MotionState) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(a (6 nb,), lam (nc,), dz/dt): smallest multipliers in the metric of the effective masses where they are not
        unique."""
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

    def project(self, t: float, motion: MotionState) -> MotionState:
        """The nearest motion with phi = 0 and A v + phi_t = 0 (in the metric of the masses)."""
        q, v = motion.q.copy(), motion.v.copy()
        keep = self.holonomic
        for _ in range(10):
            self.move_to(q, v)
            rows = self.constraints(t)
            B, factor = self.scaled(rows.A)
            if np.abs(rows.phi[keep]).max(initial=0.0) < CLOSED:
                break
            dq = self.root @ np.linalg.lstsq(B[keep], -(factor * rows.phi)[keep], rcond=RANK_TOLERANCE)[0]
            q[:-1] = moved(q[:-1], dq.reshape(-1, 6))
        if len(factor):
            open_ = factor * (rows.A @ v[:-1].ravel() + rows.phi_t)
            v[:-1] -= (self.root @ np.linalg.lstsq(B, open_, rcond=RANK_TOLERANCE)[0]).reshape(-1, 6)
        return MotionState(q, v, motion.z)


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
