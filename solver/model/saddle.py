"""The linear system of every Newton iteration and projection, in either form, on the block pattern of the model.

    [ S   -A_s^T ] [ dw   ]      [ r ]
    [ A_e  1/W   ] [ dlam ]  = - [ g ]

S are 6x6 blocks on the body graph, W the diagonal of penalties. The n x n ("condensed") form eliminates dlam, which is
one augmentation of the augmented Lagrangian [Bayo1988]: (S + A_s^T W A_e) dw = -(r + A_s^T W g), dlam = -W (g + A_e
dw). The block form keeps dlam as unknowns and stays well-conditioned for any W. Both give the same dw and dlam in exact
arithmetic.

The residuals use the exact force directions, A at the stage of the step, but the matrix has A at its end in both
places. Close to a singular position a constraint sees the free direction with opposite signs at the stage and at the
end; the product of the two would make the matrix singular for an unlucky step, or demand forces without bound. With
A_e^T W A_e >= 0 that direction is left to its inertia while the constraint cannot see it. The price, a contraction of
order h omega per iteration instead of quadratic convergence, is small for a step that resolves the rotation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.kernel import invoke, kernel
from solver.compiled.memory import zeros
from solver.compiled.vec import load33
from solver.linear.blocks import (
    WIDTH,
    add_row_products,
    add_weighted_product,
    combined_block,
    rotated_block,
    subtract_weighted_rows,
)
from solver.model.tables import FACTORIZE, SOLVE

CONDENSED, BLOCK = 0, 1


class Saddle(NamedTuple):
    """A factorized system and what is needed to solve with it again."""

    B: np.ndarray  # (n_blocks, 6, WIDTH) factor
    x: np.ndarray  # (nodes, WIDTH) right-hand side and solution
    T: np.ndarray  # (6, WIDTH) scratch
    t: np.ndarray  # (nc + WIDTH,) scratch
    W: np.ndarray  # (nc,) penalties; memory goes on for six more, because six are read for every group
    J_force: np.ndarray  # (entries + 1, 6, 6) force directions
    J_row: np.ndarray  # (entries + 1, 6, WIDTH) constraint rows A_e with respect to dw


def new_saddle(model, form: int) -> Saddle:
    """Allocate for a model and a form."""
    plan = model.tables.block if form == BLOCK else model.tables.condensed
    W = zeros(model.n_rows + 6)
    W[:] = 1.0
    return Saddle(
        B=zeros((int(plan.n_blocks[0]), 6, WIDTH)),
        x=zeros((max(len(plan.node), model.n_bodies + 1), WIDTH)),
        T=zeros((6, WIDTH)),
        t=zeros(model.n_rows + WIDTH),
        W=W[: model.n_rows],
        J_force=zeros((model.n_entries + 1, 6, 6)),
        J_row=zeros((model.n_entries + 1, 6, WIDTH)),
    )


@kernel(borrow=True)
def effective_masses(tables, J, m):
    """m (nc,) = 1 / (a_R M^-1 a_R^T) of every row, from Jacobian blocks J."""
    con = tables.constraints
    for i in range(m.shape[0]):
        m[i] = 0.0
    for g in range(con.row.shape[0] - 1):
        first = con.row[g]
        rows = con.row[g + 1] - first
        for e in range(con.entry[g], con.entry[g + 1]):
            b = con.body[e]
            mass = tables.penalty_inverse_mass[b]
            M = load33(tables.penalty_inverse_inertia, b)  # symmetric
            for r in range(rows):
                x, y, z = J[e, r, 3], J[e, r, 4], J[e, r, 5]
                linear = J[e, r, 0] * J[e, r, 0] + J[e, r, 1] * J[e, r, 1] + J[e, r, 2] * J[e, r, 2]
                angular = x * (M[0] * x + 2.0 * (M[1] * y + M[2] * z)) + (
                    y * (M[4] * y + 2.0 * M[5] * z) + M[8] * z * z
                )
                m[first + r] += mass * linear + angular
    for i in range(m.shape[0]):
        m[i] = 1.0 / m[i] if m[i] > 0.0 else 1.0


@kernel(inner=True)
def rotate_columns(constraints, J, T, out):
    """out = J with the angular columns of every block multiplied by T (nb, 3, 3) of its body."""
    for e in range(1, constraints.body.shape[0]):
        rotated_block(out, e, J, e, T, constraints.body[e], 1.0, J, 0.0)


@kernel(borrow=True)
def assemble_tangent(tables, cm, cq, cv, Kq, Kv, T, B):
    """B = cm M - cq Kq T - cv Kv on the force blocks, zero elsewhere; T (nb, 3, 3) acts on the angular columns of
    Kq."""
    slots = tables.block_row.shape[0]
    for s in range(slots, B.shape[0]):  # fill, and constraint blocks of the block form
        for i in range(6):
            for j in range(WIDTH):
                B[s, i, j] = 0.0
    for s in range(1, tables.damped):
        combined_block(B, s, Kq, s, T, tables.block_col[s], -cq, Kv, -cv)
    for s in range(tables.damped, slots):
        rotated_block(B, s, Kq, s, T, tables.block_col[s], -cq, Kv, 0.0)
    add_mass(tables, cm, B)


@kernel(inner=True)
def add_mass(tables, cm, B):
    """B += cm M."""
    bodies = tables.bodies
    for b in range(bodies.mass.shape[0]):
        s = bodies.slot[b]
        for i in range(3):
            B[s, i, i] += cm * bodies.mass[b]
            for j in range(3):
                B[s, 3 + i, 3 + j] += cm * bodies.inertia[b, i, j]


@kernel(borrow=True)
def factorize_saddle(tables, form, saddle):
    """Complete the assembled tangent in saddle.B with the constraints (saddle.W, J_force, J_row) and factorize. -1 or a
    bad node."""
    con = tables.constraints
    B = saddle.B
    J_force = saddle.J_force
    J_row = saddle.J_row
    for g in range(con.row.shape[0] - 1):
        first = con.row[g]
        rows = con.row[g + 1] - first
        e0 = con.entry[g]
        e1 = con.entry[g + 1]
        if form == CONDENSED:
            p = con.pair[g]
            for a in range(e0, e1):
                for b in range(e0, e1):
                    s = con.slot[p]
                    p += 1
                    # rows that a group lacks are zero in J
                    add_weighted_product(B, s, J_force, a, J_row, b, saddle.W, first)
        else:
            s = con.centre[g]
            for r in range(6):
                B[s, r, r] = 1.0 / saddle.W[first + r] if r < rows else 1.0
            for a in range(e0, e1):
                for r in range(rows):
                    for i in range(6):
                        B[con.up[a], i, r] = -J_force[a, r, i]
                        B[con.down[a], r, i] = J_row[a, r, i]
    saddle.T[0, 0] = -1.0
    if form == CONDENSED:
        invoke(tables.linear[FACTORIZE], (tables.condensed, B, saddle.T))
    else:
        invoke(tables.linear[FACTORIZE], (tables.block, B, saddle.T))
    return int(saddle.T[0, 0])


@kernel(borrow=True)
def solve_saddle(tables, form, saddle, r, g, dw, dlam):
    """Assign dw (nb+1, 6) and dlam (nc,) for the residuals r (nb+1, 6) and g (nc,)."""
    con = tables.constraints
    nb = tables.bodies.mass.shape[0]
    x = saddle.x
    for b in range(nb):
        for i in range(6):
            x[b, i] = -r[b, i]
        x[b, 6] = 0.0  # the padding too: after a failed step it may hold NaN
        x[b, 7] = 0.0
    groups = con.row.shape[0] - 1
    if form == CONDENSED:
        for i in range(saddle.t.shape[0]):
            saddle.t[i] = saddle.W[i] * g[i] if i < g.shape[0] else 0.0
    for k in range(groups):
        first = con.row[k]
        if form == CONDENSED:
            for e in range(con.entry[k], con.entry[k + 1]):
                subtract_weighted_rows(x, con.body[e], saddle.J_force, e, saddle.t, first)
        else:
            rows = con.row[k + 1] - first
            for q in range(WIDTH):
                x[nb + k, q] = -g[first + q] if q < rows else 0.0
    if form == CONDENSED:
        invoke(tables.linear[SOLVE], (tables.condensed, saddle.B, x))
    else:
        invoke(tables.linear[SOLVE], (tables.block, saddle.B, x))
    for b in range(nb):
        for i in range(6):
            dw[b, i] = x[b, i]
    if form == CONDENSED:
        for i in range(g.shape[0]):
            saddle.t[i] = g[i]
        for k in range(groups):
            for e in range(con.entry[k], con.entry[k + 1]):
                add_row_products(saddle.t, con.row[k], saddle.J_row, e, x, con.body[e])
        for i in range(g.shape[0]):
            dlam[i] = -saddle.W[i] * saddle.t[i]
    else:
        for k in range(groups):
            for q in range(con.row[k + 1] - con.row[k]):
                dlam[con.row[k] + q] = x[nb + k, q]
