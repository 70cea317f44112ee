"""Dependence of the constraints of a model on each other: Jacobians as dense matrices, rank, redundant rows, unique
reactions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from solver.elements.registry import CONSTRAINTS, FORCES
from solver.model.tables import Model

RANK_TOLERANCE = 1e-8  # of rows of unit norm in the metric of the masses
# of force elements, of which a model may have none
COUNTS = ('bushings', 'spring_dampers', 'force_elements', 'external_forces', 'tires')
# singular value of rows of unit norm, below which a direction is hardly held; ten times as much is a common linkage
HARDLY = 0.05
LEAST_GRIP = 1e-3  # smallest singular value of such rows, in the columns of one body, that are independent beyond doubt


def dense_jacobian(model: Model, J: np.ndarray, groups: Sequence[int] | None = None) -> np.ndarray:
    """(nc, 6 nb) Jacobian from its blocks J (entries + 1, 6, 6); groups: those of other constraints are left zero."""
    con = model.tables.constraints
    A = np.zeros((model.n_rows, 6 * model.n_bodies))
    for g in range(len(con.row) - 1) if groups is None else groups:
        rows = slice(con.row[g], con.row[g + 1])
        for e in range(con.entry[g], con.entry[g + 1]):
            b = con.body[e]
            A[rows, 6 * b : 6 * b + 6] += J[e, : con.row[g + 1] - con.row[g]]
    return A


def scaled_blocks(model: Model, J: np.ndarray) -> np.ndarray:
    """(entries + 1, 6, 6) blocks of scaled_jacobian()."""
    t = model.tables
    con = t.constraints
    body = con.body[1:]
    group = np.repeat(np.arange(len(con.entry) - 1), np.diff(con.entry))
    B = np.zeros_like(J)
    B[1:, :, :3] = J[1:, :, :3] * np.sqrt(t.penalty_inverse_mass)[body, None, None]
    B[1:, :, 3:] = J[1:, :, 3:] @ np.linalg.cholesky(t.penalty_inverse_inertia)[body]
    squares = np.zeros((len(con.entry) - 1, 6))
    np.add.at(squares, group, (B[1:] ** 2).sum(axis=2))
    B[1:] /= np.maximum(np.sqrt(squares), 1e-300)[group, :, None]
    return B


def scaled_jacobian(model: Model, J: np.ndarray) -> np.ndarray:
    """(nc, 6 nb) Jacobian with columns in the metric of the masses and rows of unit norm, so that metres and radians
    compare."""
    return dense_jacobian(model, scaled_blocks(model, J))


def hardly_held(model: Model, J: np.ndarray) -> str:
    """The row of constraints that has most of what they hardly hold, next to a singular position; or nothing."""
    A = scaled_jacobian(model, J)
    if not model.n_rows or not np.isfinite(A).all():
        return ''
    U, held, _ = np.linalg.svd(A, full_matrices=False)
    weak = (held > RANK_TOLERANCE) & (held < HARDLY)
    return model.row_names[int(np.argmax(np.abs(U[:, np.flatnonzero(weak)[0]])))] if weak.any() else ''


def tied_groups(model: Model, B: np.ndarray) -> list[int]:
    """Constraints (groups of rows) that may depend on each other, found from the scaled blocks B.

    If all rows at a body are independent by its own six columns, A = [[B_b, *], [0, A']] with B_b of full rank: the
    rows are independent of all others and have no share in any n with n A = 0. They are left out, and the bodies at
    their other ends are looked at again. So open chains and trees are taken apart from their ends, and what remains are
    the loops.
    """
    con = model.tables.constraints
    at: list[dict[int, int]] = [{} for _ in range(model.n_bodies)]  # of every body: group -> block
    for g in range(len(con.row) - 1):
        for e in range(con.entry[g], con.entry[g + 1]):
            at[con.body[e]][g] = e
    tied = set(range(len(con.row) - 1))
    waiting = list(range(model.n_bodies))
    while waiting:
        here = at[waiting.pop()]
        rows = sum(con.row[g + 1] - con.row[g] for g in here)
        if not 0 < rows <= 6:
            continue
        own = np.concatenate([B[e, : con.row[g + 1] - con.row[g]] for g, e in here.items()])
        if np.linalg.svd(own, compute_uv=False)[-1] < LEAST_GRIP:
            continue
        for g in list(here):
            tied.discard(g)
            for b in con.body[con.entry[g] : con.entry[g + 1]]:
                del at[b][g]
                waiting.append(int(b))
    return sorted(tied)


class Dependence(NamedTuple):
    """Dependence of the constraint rows on each other in a configuration."""

    rank: int
    position_rank: int  # of the holonomic rows alone
    redundant: np.ndarray  # indices of rows that depend on the others
    unique: np.ndarray  # (nc,) whether the motion determines the reaction of a row


def dependence(model: Model, J: np.ndarray) -> Dependence:
    """Rank, redundant rows and unique reactions at the configuration of the Jacobian blocks J.

    Rank by QR with column pivoting of the transpose: the rows left over depend on those before them. M dv/dt = f + A^T
    lam leaves every n with A^T n = 0 open: the reaction of a row is unique where no such n has a share in it.
    """
    from scipy.linalg import qr  # slow to import, and a run does not need it

    B, con = scaled_blocks(model, J), model.tables.constraints
    groups = tied_groups(model, B)
    tied = np.concatenate([np.zeros(0, int), *(np.arange(con.row[g], con.row[g + 1]) for g in groups)])
    others = np.delete(con.holonomic, tied)
    unique = np.ones(model.n_rows, bool)
    if not len(tied):
        return Dependence(model.n_rows, int(others.sum()), tied, unique)
    A = dense_jacobian(model, B, groups)[tied]
    A = A[:, A.any(axis=0)]
    R, pivot = qr(A.T, mode='r', pivoting=True)
    d = np.abs(np.diag(R))
    rank = int((d > RANK_TOLERANCE * d[0]).sum())
    holonomic = con.holonomic[tied] == 1
    position_rank = rank if holonomic.all() else int(np.linalg.matrix_rank(A[holonomic], RANK_TOLERANCE))
    left, size, _ = np.linalg.svd(A)
    shares = left[:, int((size > RANK_TOLERANCE * size.max()).sum()) :]
    unique[tied] = np.abs(shares).max(axis=1, initial=0.0) < RANK_TOLERANCE
    return Dependence(len(others) + rank, int(others.sum()) + position_rank, np.sort(tied[pivot[rank:]]), unique)


def describe(model: Model, J: np.ndarray) -> dict:
    """Counts of a model at the configuration of J: bodies, joints by kind, elements, degrees of freedom, redundancy.

    dof are freedoms of velocity; where constraints are not holonomic, position_dof are more.
    """
    spec = model.spec
    found = dependence(model, J)
    kinds: dict[str, int] = {}
    for joint in spec.joints:
        kinds[joint.kind] = kinds.get(joint.kind, 0) + 1
    counts = dict.fromkeys(COUNTS, 0)
    for kind in FORCES:
        for element in getattr(spec, kind.name):
            counts[element.counted_as] = counts.get(element.counted_as, 0) + 1
    return {
        'bodies': len(spec.bodies),
        'joints': len(spec.joints),
        'joints_by_kind': kinds,
        **{kind.name: len(getattr(spec, kind.name)) for kind in CONSTRAINTS if kind.name != 'joints'},
        **counts,
        'constraint_rows': model.n_rows,
        'dof': 6 * model.n_bodies - found.rank,
        'position_dof': 6 * model.n_bodies - found.position_rank,
        'redundant_constraints': model.n_rows - found.rank,
        'redundant_rows': [model.row_names[k] for k in found.redundant],
        'reactions_not_unique': [model.row_names[k] for k in np.flatnonzero(~found.unique)],
        'internal_states': model.n_internal,
        'mass': float(sum(b.mass for b in spec.bodies)),
        'inputs': list(spec.inputs),
    }
