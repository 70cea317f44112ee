"""The compiled right-hand side: kinematics, forces, constraints. One call per kind of element, in the order of the
registry."""

from __future__ import annotations

import numpy as np

from solver.compiled.by_reference import Ref, matrix_at
from solver.compiled.kernel import address_of, invoke, kernel
from solver.compiled.vec import dot
from solver.elements.instant import Effects, Instant
from solver.elements.registry import CONSTRAINTS, FORCES
from solver.elements.rigid_body import body_forces
from solver.linear.blocks import add_scaled_rows
from solver.linear.elimination import factorize, solve
from solver.model.compile import compile_model
from solver.model.spec import ModelSpec
from solver.model.state import kinematics_of, new_kinematics, placed_configuration
from solver.model.tables import (
    ADDRESS,
    CONSTRAINT_ON_COORDINATES,
    CONSTRAINT_TABLE,
    COUNT,
    DRIVEN,
    FACTORIZE,
    HESSIANS,
    OUTPUT,
    RESIDUALS,
    SOLVE,
    TABLE,
    WIDTH,
    Model,
)
from solver.remembered import of_same


@of_same
def prepare(spec: ModelSpec) -> Model:
    """Compile a ModelSpec and the kernels its elements need; its tables are never written again. Raises SpecError."""
    model = compile_model(spec)
    _bind(model)
    return model


def _bind(model: Model) -> None:
    """Compile the kernels that the elements of a model need and write their addresses to its tables."""
    tables, spec = model.tables, model.spec
    kin, x = Ref(new_kinematics(1)), Ref(tables.coordinates)
    row, rows, blocks = np.zeros(1), np.zeros((1, 6)), np.zeros((1, 6, 6))
    now, effects = Instant(x, Ref(tables.laws), kin, row, row, 0.0, row, True), Effects(rows, blocks, blocks, row)
    for kind, call in zip(FORCES, tables.forces, strict=True):
        if getattr(spec, kind.name):
            call[ADDRESS] = address_of(kind.kernel, model.elements[kind.name], now, effects, rows)
    for constraint, call in zip(CONSTRAINTS, tables.constraint_kinds, strict=True):
        if getattr(spec, constraint.name):
            table = model.elements[constraint.name]
            residuals = (
                (table, x, kin, row, row, True, row, blocks)
                if constraint.on_coordinates
                else (table, kin, True, row, blocks)
            )
            call[RESIDUALS] = address_of(constraint.residuals, *residuals)
            hessians = (table, *((x,) if constraint.on_coordinates else ()), kin, row, blocks, blocks)
            call[HESSIANS] = address_of(constraint.hessians, *hessians)
    plan = Ref(tables.condensed)
    tables.linear[FACTORIZE] = address_of(factorize, plan, blocks, rows)
    tables.linear[SOLVE] = address_of(solve, plan, blocks, rows)


@kernel(inner=True)
def _evaluate_kind(tables, k, now, effects, outputs):
    """Accumulate the forces of the elements of kind k, and assign their outputs."""
    call = tables.forces[k]
    out = matrix_at(outputs, call[OUTPUT], call[COUNT], call[WIDTH])
    invoke(call[ADDRESS], (call[TABLE], now, effects, out))


@kernel(inner=True)
def evaluate_driven_forces(tables, kin, angle, zp, cz, u, tangents, f, Kq, Kv, z, outputs):
    """Accumulate the forces of the kinds that may follow inputs, and assign their outputs: what in evaluate_forces
    depends on u."""
    now = Instant(tables.coordinates, tables.laws, kin, angle, zp, cz, u, tangents)
    effects = Effects(f, Kq, Kv, z)
    for k in range(tables.forces.shape[0]):
        if tables.forces[k, ADDRESS] != 0 and tables.forces[k, DRIVEN] == 1:
            _evaluate_kind(tables, k, now, effects, outputs)


@kernel(borrow=True)
def evaluate_forces(tables, kin, angle, zp, cz, u, tangents, f, Kq, Kv, z, outputs):
    """Assign f (nb+1, 6) and, when `tangents`, Kq and the first tables.damped blocks of Kv (ns+1, 6, 6), which others
    leave at zero: all forces but those of the constraints.

    Arguments are those of solver.elements.instant; outputs are those of all elements (Model.new_outputs).
    """
    f[:] = 0.0
    if tangents:
        Kq[:] = 0.0
        Kv[: tables.damped] = 0.0
    body_forces(tables.bodies, kin, tangents, f, Kv)
    now = Instant(tables.coordinates, tables.laws, kin, angle, zp, cz, u, tangents)
    effects = Effects(f, Kq, Kv, z)
    for k in range(tables.forces.shape[0]):
        if tables.forces[k, ADDRESS] != 0:
            _evaluate_kind(tables, k, now, effects, outputs)


@kernel(borrow=True)
def evaluate_constraints(tables, kin, angle, u, gradients, phi, J):
    """Assign residuals phi (nc,) and, when `gradients`, blocks J (entries + 1, 6, 6) of A. phi is A v where a row is
    not holonomic."""
    for k in range(tables.constraint_kinds.shape[0]):
        call = tables.constraint_kinds[k]
        if call[RESIDUALS] == 0:
            continue
        if call[CONSTRAINT_ON_COORDINATES] == 1:
            invoke(call[RESIDUALS], (call[CONSTRAINT_TABLE], tables.coordinates, kin, angle, u, gradients, phi, J))
        else:
            invoke(call[RESIDUALS], (call[CONSTRAINT_TABLE], kin, gradients, phi, J))


@kernel(borrow=True)
def add_constraint_stiffness(tables, kin, lam, Kq, Kv):
    """Add d(A^T lam)/dq to Kq (Kv is only scratch-compatible: constraints add zeros to it)."""
    for k in range(tables.constraint_kinds.shape[0]):
        call = tables.constraint_kinds[k]
        if call[HESSIANS] == 0:
            continue
        if call[CONSTRAINT_ON_COORDINATES] == 1:
            invoke(call[HESSIANS], (call[CONSTRAINT_TABLE], tables.coordinates, kin, lam, Kq, Kv))
        else:
            invoke(call[HESSIANS], (call[CONSTRAINT_TABLE], kin, lam, Kq, Kv))


@kernel(borrow=True)
def constraint_input_rates(tables, u, phi_t, phi_tt):
    """Assign phi_t and phi_tt (nc,): explicit time derivatives of the driven rows."""
    driven = tables.constraints.driven
    phi_t[:] = 0.0
    phi_tt[:] = 0.0
    for k in range(driven.shape[0]):
        phi_t[driven[k, 0]] = -u[driven[k, 1]]
        phi_tt[driven[k, 0]] = -u[driven[k, 2]]


@kernel(borrow=True)
def add_constraint_forces(constraints, J, lam, sign, f):
    """f += sign * A^T lam."""
    for g in range(constraints.row.shape[0] - 1):
        first = constraints.row[g]
        rows = constraints.row[g + 1] - first
        for e in range(constraints.entry[g], constraints.entry[g + 1]):
            add_scaled_rows(f, constraints.body[e], sign, lam, first, rows, J, e)


@kernel(borrow=True)
def constraint_rates(constraints, J, v, rate):
    """rate (nc,) = A v."""
    for i in range(rate.shape[0]):
        rate[i] = 0.0
    for g in range(constraints.row.shape[0] - 1):
        first = constraints.row[g]
        rows = constraints.row[g + 1] - first
        for e in range(constraints.entry[g], constraints.entry[g + 1]):
            b = constraints.body[e]
            linear = (v[b, 0], v[b, 1], v[b, 2])
            turn = (v[b, 3], v[b, 4], v[b, 5])
            for r in range(rows):
                along = dot((J[e, r, 0], J[e, r, 1], J[e, r, 2]), linear)
                rate[first + r] += along + dot((J[e, r, 3], J[e, r, 4], J[e, r, 5]), turn)


def turning_rows(model: Model) -> np.ndarray:
    """(nc,) True where the residual of a row of constraints is in rad: its gradients, where bodies are placed, move no
    point."""
    nb, con = model.n_bodies, model.tables.constraints
    kin = kinematics_of(placed_configuration(model.spec.bodies), np.zeros((nb + 1, 6)))
    phi, J = np.zeros(model.n_rows), np.zeros((model.n_entries + 1, 6, 6))
    angle, u = np.zeros(len(model.coordinate_names)), np.zeros(len(model.spec.inputs))
    evaluate_constraints(model.tables, kin, angle, u, True, phi, J)
    moves, turns = np.zeros(model.n_rows, bool), np.zeros(model.n_rows, bool)
    for g, first in enumerate(con.row[:-1]):
        rows = int(con.row[g + 1] - first)
        for block in J[con.entry[g] : con.entry[g + 1], :rows]:
            moves[first : first + rows] |= (block[:, :3] != 0.0).any(axis=1)
            turns[first : first + rows] |= (block[:, 3:] != 0.0).any(axis=1)
    return turns & ~moves
