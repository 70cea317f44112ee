"""Laws that a run must obey, and what a model consists of: energy, momentum, rank of the constraints."""

from __future__ import annotations

import numpy as np
from scipy.linalg import qr

from solver.jit import kernel
from solver.model.tables import Model

RANK_TOLERANCE = 1e-8  # of rows of unit norm in the metric of the masses
REFERENCE, POWER, WORK, WORST, ENERGY = range(5)  # entries of the running audit


@kernel(borrow=True)
def mechanical_energy(tables, kin, outputs):
    """Return (energy [J]: kinetic + gravity (zero at z = 0) + stored in elements, dissipated power [W])."""
    bodies = tables.bodies
    energy = 0.0
    for b in range(bodies.mass.shape[0]):
        for i in range(3):
            energy += bodies.mass[b] * (0.5 * kin.v[b, i] ** 2 - bodies.gravity[i] * kin.p[b, i])
            for j in range(3):
                energy += 0.5 * kin.v[b, 3 + i] * bodies.inertia[b, i, j] * kin.v[b, 3 + j]
    dissipation = 0.0
    for out in (
        outputs.spring_dampers,
        outputs.bushings,
        outputs.coordinate_forces,
        outputs.brakes,
        outputs.applied_forces,
        outputs.aero_drags,
        outputs.tires,
    ):
        for e in range(out.shape[0]):
            energy += out[e, 0]
            dissipation += out[e, 1]
    return energy, dissipation


@kernel(borrow=True)
def update_audit(tables, kin, outputs, lam, phi_t, h, audit):
    """Advance the energy balance by a step h [s] (h = 0 starts it): error = E - E_0 + integral of (dissipation - driver power).

    The integral is the trapezoidal rule, second order like the method. lam and phi_t give the power of prescribed motions.
    """
    energy, loss = mechanical_energy(tables, kin, outputs)
    for i in range(lam.shape[0]):
        loss += lam[i] * phi_t[i]
    if h == 0.0:
        audit[REFERENCE] = energy
        audit[WORK] = 0.0
        audit[WORST] = 0.0
    else:
        audit[WORK] += 0.5 * h * (loss + audit[POWER])
        error = abs(energy - audit[REFERENCE] + audit[WORK])
        audit[WORST] = max(audit[WORST], error)
    audit[POWER] = loss
    audit[ENERGY] = energy


def dense_jacobian(model: Model, J: np.ndarray) -> np.ndarray:
    """(nc, 6 nb) Jacobian from its blocks J (entries + 1, 6, 6)."""
    con = model.tables.constraints
    A = np.zeros((model.n_rows, 6 * model.n_bodies))
    for g in range(len(con.row) - 1):
        rows = slice(con.row[g], con.row[g + 1])
        for e in range(con.entry[g], con.entry[g + 1]):
            b = con.body[e]
            A[rows, 6 * b : 6 * b + 6] += J[e, : con.row[g + 1] - con.row[g]]
    return A


def scaled_jacobian(model: Model, J: np.ndarray) -> np.ndarray:
    """(nc, 6 nb) Jacobian with columns in the metric of the masses and rows of unit norm, so that metres and radians compare."""
    A = dense_jacobian(model, J)
    t = model.tables
    for b in range(model.n_bodies):
        A[:, 6 * b : 6 * b + 3] *= np.sqrt(t.penalty_inverse_mass[b])
        A[:, 6 * b + 3 : 6 * b + 6] = A[:, 6 * b + 3 : 6 * b + 6] @ np.linalg.cholesky(t.penalty_inverse_inertia[b])
    return A / np.maximum(np.linalg.norm(A, axis=1, keepdims=True), 1e-300)


def constraint_rank(model: Model, J: np.ndarray) -> tuple[int, list[str]]:
    """(rank, names of redundant rows) of the constraints with Jacobian blocks J.

    Rank by QR with column pivoting of the transpose: the rows left over depend on those before them.
    """
    if not model.n_rows:
        return 0, []
    R, pivot = qr(scaled_jacobian(model, J).T, mode='r', pivoting=True)
    d = np.abs(np.diag(R))
    rank = int((d > RANK_TOLERANCE * d[0]).sum())
    return rank, [model.row_names[k] for k in sorted(pivot[rank:])]


def unique_reactions(model: Model, J: np.ndarray) -> np.ndarray:
    """(nc,) whether the reaction of each row is determined by the motion, at the configuration of the Jacobian blocks J.

    M dv/dt = f + A^T lam leaves every n with A^T n = 0 open: the reaction of a row is unique where no such n has a share in it.
    """
    left, size, _ = np.linalg.svd(scaled_jacobian(model, J))
    rank = int((size > RANK_TOLERANCE * size.max(initial=0.0)).sum())
    return np.abs(left[:, rank:]).max(axis=1, initial=0.0) < RANK_TOLERANCE


def describe(model: Model, J: np.ndarray) -> dict:
    """Counts of a model at the configuration of J: bodies, joints by kind, elements, degrees of freedom, redundancy.

    dof are freedoms of velocity; where constraints are not holonomic, position_dof are more.
    """
    spec = model.spec
    rank, redundant = constraint_rank(model, J)
    holonomic = model.tables.constraints.holonomic
    places = rank if holonomic.all() else int(np.linalg.matrix_rank(scaled_jacobian(model, J)[holonomic == 1], RANK_TOLERANCE))
    not_unique = np.flatnonzero(~unique_reactions(model, J))
    kinds: dict[str, int] = {}
    for joint in spec.joints:
        kinds[joint.kind] = kinds.get(joint.kind, 0) + 1
    return {
        'bodies': len(spec.bodies),
        'joints': len(spec.joints),
        'joints_by_kind': kinds,
        'contacts': len(spec.contacts),
        'couplers': len(spec.couplers),
        'bushings': len(spec.bushings),
        'spring_dampers': len(spec.spring_dampers),
        'force_elements': len(spec.coordinate_forces) + len(spec.brakes) + sum(f.reaction is not None for f in spec.applied_forces),
        'external_forces': len(spec.aero_drags) + sum(f.reaction is None for f in spec.applied_forces),
        'tires': len(spec.tires),
        'constraint_rows': model.n_rows,
        'dof': 6 * model.n_bodies - rank,
        'position_dof': 6 * model.n_bodies - places,
        'redundant_constraints': model.n_rows - rank,
        'redundant_rows': redundant,
        'reactions_not_unique': [model.row_names[k] for k in not_unique],
        'internal_states': model.n_internal,
        'mass': float(sum(b.mass for b in spec.bodies)),
        'inputs': list(spec.inputs),
    }
