"""The compiled right-hand side: kinematics, forces, constraints. One line per element kind, one call per evaluation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.kernel import address_of, invoke, kernel
from solver.compiled.vec import dot
from solver.elements.aero_drag import aero_drag_forces
from solver.elements.applied_force import applied_force_forces
from solver.elements.brake import brake_forces
from solver.elements.bushing import bushing_forces
from solver.elements.contact import add_contact_gradients, evaluate_contacts
from solver.elements.coordinate_force import coordinate_forces
from solver.elements.coupler import add_coupler_hessians, evaluate_couplers
from solver.elements.joint import add_joint_hessians, evaluate_joints
from solver.elements.rigid_body import body_forces
from solver.elements.spring_damper import spring_damper_forces
from solver.elements.tire_pacejka import tire_forces
from solver.linear.blocks import add_scaled_rows
from solver.linear.elimination import factorize, solve
from solver.model.compile import compile_model
from solver.model.spec import ModelSpec
from solver.model.state import new_kinematics
from solver.model.tables import Model


class Outputs(NamedTuple):
    """Output columns of every force element kind, (n, len(OUTPUTS)) each."""

    spring_dampers: np.ndarray
    bushings: np.ndarray
    coordinate_forces: np.ndarray
    brakes: np.ndarray
    applied_forces: np.ndarray
    aero_drags: np.ndarray
    tires: np.ndarray


# Kernels called through their address (solver.compiled.kernel.invoke), by index into tables.calls. 0: the model has no such element.
CALLS = [
    'spring_dampers',
    'bushings',
    'coordinate_forces',
    'brakes',
    'applied_forces',
    'aero_drags',
    'tires',
    'joints',
    'joint_hessians',
    'couplers',
    'coupler_hessians',
    'contacts',
    'contact_gradients',
    'factorize',
    'solve',
]
(
    SPRING_DAMPERS, BUSHINGS, COORDINATE_FORCES, BRAKES, APPLIED_FORCES, AERO_DRAGS, TIRES,
    JOINTS, JOINT_HESSIANS, COUPLERS, COUPLER_HESSIANS, CONTACTS, CONTACT_GRADIENTS, FACTORIZE, SOLVE,
) = range(len(CALLS))  # fmt: skip


def prepare(spec: ModelSpec) -> Model:
    """Compile a ModelSpec and the kernels its elements need. Raises SpecError."""
    model = compile_model(spec)
    bind(model.tables, spec)
    return model


def bind(tables: Ref, spec: ModelSpec) -> None:
    """Compile the kernels that the elements of a model need and write their addresses to tables.calls."""
    kin = Ref(new_kinematics(1))
    row, rows, blocks = np.zeros(1), np.zeros((1, 6)), np.zeros((1, 6, 6))
    plain = (Ref(tables.laws), kin, row, 0.0, row, True, rows, blocks, blocks, row, rows)
    x = Ref(tables.coordinates)
    turning = (x, *plain[:2], row, *plain[2:])
    con = tables.constraints
    joints, contacts, couplers, plan = (Ref(t) for t in (con.joints, con.contacts, con.couplers, tables.condensed))
    kernels = {
        SPRING_DAMPERS: (spring_damper_forces, spec.spring_dampers, (Ref(tables.spring_dampers), *plain)),
        BUSHINGS: (bushing_forces, spec.bushings, (Ref(tables.bushings), *plain)),
        COORDINATE_FORCES: (coordinate_forces, spec.coordinate_forces, (Ref(tables.coordinate_forces), *turning)),
        BRAKES: (brake_forces, spec.brakes, (Ref(tables.brakes), *turning)),
        APPLIED_FORCES: (applied_force_forces, spec.applied_forces, (Ref(tables.applied_forces), *plain)),
        AERO_DRAGS: (aero_drag_forces, spec.aero_drags, (Ref(tables.aero_drags), *plain)),
        TIRES: (tire_forces, spec.tires, (Ref(tables.tires), *plain)),
        JOINTS: (evaluate_joints, spec.joints, (joints, kin, True, row, blocks)),
        JOINT_HESSIANS: (add_joint_hessians, spec.joints, (joints, kin, row, blocks, blocks)),
        COUPLERS: (evaluate_couplers, spec.couplers, (couplers, x, kin, row, row, True, row, blocks)),
        COUPLER_HESSIANS: (add_coupler_hessians, spec.couplers, (couplers, x, kin, row, blocks)),
        CONTACTS: (evaluate_contacts, spec.contacts, (contacts, kin, True, row, blocks)),
        CONTACT_GRADIENTS: (add_contact_gradients, spec.contacts, (contacts, kin, row, blocks)),
        FACTORIZE: (factorize, spec.bodies, (plan, blocks, rows)),
        SOLVE: (solve, spec.bodies, (plan, blocks, rows)),
    }
    for index, (function, present, arguments) in kernels.items():
        tables.calls[index] = address_of(function, *arguments) if present else 0


@kernel(inner=True)
def evaluate_driven_forces(tables, kin, angle, zp, cz, u, tangents, f, Kq, Kv, z, out):
    """Accumulate the forces of the elements that follow inputs, and assign their outputs: the part of evaluate_forces that depends on u."""
    laws = tables.laws
    x = tables.coordinates
    at = tables.calls
    if at[COORDINATE_FORCES] != 0:
        invoke(
            at[COORDINATE_FORCES], (tables.coordinate_forces, x, laws, kin, angle, zp, cz, u, tangents, f, Kq, Kv, z, out.coordinate_forces)
        )
    if at[BRAKES] != 0:
        invoke(at[BRAKES], (tables.brakes, x, laws, kin, angle, zp, cz, u, tangents, f, Kq, Kv, z, out.brakes))
    if at[APPLIED_FORCES] != 0:
        invoke(at[APPLIED_FORCES], (tables.applied_forces, laws, kin, zp, cz, u, tangents, f, Kq, Kv, z, out.applied_forces))


@kernel(borrow=True)
def evaluate_forces(tables, kin, angle, zp, cz, u, tangents, f, Kq, Kv, z, out):
    """Assign f (nb+1, 6) and, when `tangents`, Kq and Kv (ns+1, 6, 6): all forces but those of the constraints.

    Arguments are those of the element contract (docs/elements.md).
    """
    f[:] = 0.0
    if tangents:
        Kq[:] = 0.0
        Kv[:] = 0.0
    laws = tables.laws
    at = tables.calls
    body_forces(tables.bodies, kin, tangents, f, Kv)
    if at[SPRING_DAMPERS] != 0:
        invoke(at[SPRING_DAMPERS], (tables.spring_dampers, laws, kin, zp, cz, u, tangents, f, Kq, Kv, z, out.spring_dampers))
    if at[BUSHINGS] != 0:
        invoke(at[BUSHINGS], (tables.bushings, laws, kin, zp, cz, u, tangents, f, Kq, Kv, z, out.bushings))
    evaluate_driven_forces(tables, kin, angle, zp, cz, u, tangents, f, Kq, Kv, z, out)
    if at[AERO_DRAGS] != 0:
        invoke(at[AERO_DRAGS], (tables.aero_drags, laws, kin, zp, cz, u, tangents, f, Kq, Kv, z, out.aero_drags))
    if at[TIRES] != 0:
        invoke(at[TIRES], (tables.tires, laws, kin, zp, cz, u, tangents, f, Kq, Kv, z, out.tires))


@kernel(borrow=True)
def evaluate_constraints(tables, kin, angle, u, gradients, phi, J):
    """Assign residuals phi (nc,) and, when `gradients`, blocks J (entries + 1, 6, 6) of A. phi is A v where a row is not holonomic."""
    at = tables.calls
    if at[JOINTS] != 0:
        invoke(at[JOINTS], (tables.constraints.joints, kin, gradients, phi, J))
    if at[CONTACTS] != 0:
        invoke(at[CONTACTS], (tables.constraints.contacts, kin, gradients, phi, J))
    if at[COUPLERS] != 0:
        invoke(at[COUPLERS], (tables.constraints.couplers, tables.coordinates, kin, angle, u, gradients, phi, J))


@kernel(borrow=True)
def add_constraint_stiffness(tables, kin, lam, Kq, Kv):
    """Add d(A^T lam)/dq to Kq (Kv is only scratch-compatible: constraints add zeros to it)."""
    at = tables.calls
    if at[JOINT_HESSIANS] != 0:
        invoke(at[JOINT_HESSIANS], (tables.constraints.joints, kin, lam, Kq, Kv))
    if at[CONTACT_GRADIENTS] != 0:
        invoke(at[CONTACT_GRADIENTS], (tables.constraints.contacts, kin, lam, Kq))
    if at[COUPLER_HESSIANS] != 0:
        invoke(at[COUPLER_HESSIANS], (tables.constraints.couplers, tables.coordinates, kin, lam, Kq))


@kernel(borrow=True)
def constraint_input_rates(tables, u, phi_t, phi_tt):
    """Assign phi_t and phi_tt (nc,): explicit time derivatives of the driven rows."""
    c = tables.constraints.couplers
    phi_t[:] = 0.0
    phi_tt[:] = 0.0
    for e in range(c.row.shape[0]):
        if c.input[e, 0] >= 0:
            phi_t[c.row[e]] = -u[c.input[e, 1]]
            phi_tt[c.row[e]] = -u[c.input[e, 2]]


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
