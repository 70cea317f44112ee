"""The rows of one joint or contact between two bodies, and the laws they obey, checked without a model or an
integrator."""

from __future__ import annotations

from typing import Any

import numpy as np
from contract import STEP, ContractContext, acting, displaced

from solver.elements.kind import ConstraintKind
from solver.elements.point_pair import Kinematics

BODIES = [('b0', 'b1'), ('world', 'b1'), ('b0', 'world')]
STILL = np.zeros((2, 6))


class Rows:
    """The rows of one constraint between two bodies (index 2: the world) as functions of the kinematics."""

    def __init__(self, kind: ConstraintKind, spec: Any, com=None) -> None:
        context = ContractContext(com=com)
        self.n = len(spec.row_names())
        self.holonomic = np.array(spec.holonomic()) == 1
        self.bodies = [context.body('test', m.body) for m in (spec.i, spec.j)]
        table = kind.compile([spec], context)
        self.residuals, self.hessians = acting(kind.residuals, table), acting(kind.hessians, table)

    def evaluate(self, kin: Kinematics) -> tuple[np.ndarray, np.ndarray]:
        """phi (rows,) and A (rows, 18): columns of b0, b1, world."""
        phi = np.full(self.n, np.nan, kin.p.dtype)
        blocks = np.full((4, 6, 6), np.nan, kin.p.dtype)
        self.residuals(kin, True, phi, blocks)
        A = np.zeros((self.n, 3, 6), kin.p.dtype)
        for b in self.bodies:
            A[:, b] = blocks[b + 1, : self.n]
        return phi, A.reshape(self.n, 18)

    def gradient(self, kin: Kinematics, lam: np.ndarray) -> np.ndarray:
        """d(A^T lam)/dq, (12, 12)."""
        blocks, trash = np.zeros((5, 6, 6)), np.zeros((5, 6, 6))
        self.hessians(kin, lam, blocks, trash)
        return blocks[1:].reshape(2, 2, 6, 6).transpose(0, 2, 1, 3).reshape(12, 12)


def check_derivatives(rows: Rows, kin: Kinematics, lam: np.ndarray) -> None:
    """A = d phi/dq of holonomic rows, d phi/dv of the others, and d(A^T lam)/dq of all.

    They are those of the complex step to rounding, 1e-12 of the largest entry.
    """
    phi, A = rows.evaluate(kin)
    assert np.isfinite(phi).all()
    K = rows.gradient(kin, lam)
    A_exact, K_exact = np.zeros((rows.n, 12)), np.zeros((12, 12))
    for k, e in enumerate(np.eye(12).reshape(12, 2, 6)):
        phi_moved, A_moved = rows.evaluate(displaced(kin, e, STILL))
        phi_pushed, _ = rows.evaluate(displaced(kin, STILL, e))
        A_exact[:, k] = np.where(rows.holonomic, phi_moved.imag, phi_pushed.imag) / STEP
        K_exact[:, k] = (A_moved.T @ lam)[:12].imag / STEP
    np.testing.assert_allclose(A[:, :12], A_exact, rtol=0, atol=1e-12 * max(1.0, np.abs(A_exact).max()))
    np.testing.assert_allclose(K, K_exact, rtol=0, atol=1e-12 * max(1.0, np.abs(K_exact).max()))
    velocity = ~rows.holonomic
    np.testing.assert_allclose(
        phi[velocity], (A @ kin.v.ravel())[velocity], rtol=0, atol=1e-12 * max(1.0, np.abs(A).max())
    )


def check_reactions(rows: Rows, kin: Kinematics, lam: np.ndarray) -> None:
    """The forces A^T lam on both bodies have no resultant and no moment about the origin of the world."""
    f = (rows.evaluate(kin)[1].T @ lam).reshape(3, 6)
    moments = np.cross(kin.p, f[:, :3]) + np.einsum('bij,bj->bi', kin.R, f[:, 3:])
    np.testing.assert_allclose(f[:, :3].sum(0), 0.0, atol=1e-13 * np.abs(f).max())
    np.testing.assert_allclose(moments.sum(0), 0.0, atol=1e-13 * np.abs(f).max() * (1 + np.abs(kin.p).max()))
