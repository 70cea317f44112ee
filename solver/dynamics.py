"""The compiled right-hand side: kinematics, forces, constraints. One line per element kind, one call per evaluation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.elements.aero_drag import aero_drag_forces
from solver.elements.applied_force import applied_force_forces
from solver.elements.brake import brake_forces
from solver.elements.bushing import bushing_forces
from solver.elements.coordinate_force import coordinate_forces
from solver.elements.coupler import add_coupler_hessians, evaluate_couplers
from solver.elements.joint import add_joint_hessians, evaluate_joints
from solver.elements.rigid_body import body_forces
from solver.elements.spring_damper import spring_damper_forces
from solver.elements.tire_pacejka import tire_forces
from solver.jit import kernel


class Outputs(NamedTuple):
    """Output columns of every force element kind, (n, len(OUTPUTS)) each."""

    spring_dampers: np.ndarray
    bushings: np.ndarray
    coordinate_forces: np.ndarray
    brakes: np.ndarray
    applied_forces: np.ndarray
    aero_drags: np.ndarray
    tires: np.ndarray


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
    x = tables.coordinates
    body_forces(tables.bodies, kin, tangents, f, Kv)
    spring_damper_forces(tables.spring_dampers, laws, kin, zp, cz, u, tangents, f, Kq, Kv, z, out.spring_dampers)
    bushing_forces(tables.bushings, laws, kin, zp, cz, u, tangents, f, Kq, Kv, z, out.bushings)
    coordinate_forces(tables.coordinate_forces, x, laws, kin, angle, zp, cz, u, tangents, f, Kq, Kv, z, out.coordinate_forces)
    brake_forces(tables.brakes, x, laws, kin, angle, zp, cz, u, tangents, f, Kq, Kv, z, out.brakes)
    applied_force_forces(tables.applied_forces, laws, kin, zp, cz, u, tangents, f, Kq, Kv, z, out.applied_forces)
    aero_drag_forces(tables.aero_drags, laws, kin, zp, cz, u, tangents, f, Kq, Kv, z, out.aero_drags)
    tire_forces(tables.tires, laws, kin, zp, cz, u, tangents, f, Kq, Kv, z, out.tires)


@kernel(borrow=True)
def evaluate_constraints(tables, kin, angle, u, phi, J):
    """Assign residuals phi (nc,) and Jacobian blocks J (entries + 1, 6, 6)."""
    evaluate_joints(tables.constraints.joints, kin, phi, J)
    evaluate_couplers(tables.constraints.couplers, tables.coordinates, kin, angle, u, phi, J)


@kernel(borrow=True)
def add_constraint_stiffness(tables, kin, lam, Kq, Kv):
    """Add d(A^T lam)/dq to Kq (Kv is only scratch-compatible: constraints add zeros to it)."""
    add_joint_hessians(tables.constraints.joints, kin, lam, Kq, Kv)
    add_coupler_hessians(tables.constraints.couplers, tables.coordinates, kin, lam, Kq)


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
            b = constraints.body[e]
            for r in range(rows):
                m = sign * lam[first + r]
                for c in range(6):
                    f[b, c] += m * J[e, r, c]


@kernel(borrow=True)
def constraint_rates(constraints, J, v, rate):
    """rate (nc,) = A v."""
    for g in range(constraints.row.shape[0] - 1):
        first = constraints.row[g]
        rows = constraints.row[g + 1] - first
        for r in range(rows):
            rate[first + r] = 0.0
        for e in range(constraints.entry[g], constraints.entry[g + 1]):
            b = constraints.body[e]
            for r in range(rows):
                s = 0.0
                for c in range(6):
                    s += J[e, r, c] * v[b, c]
                rate[first + r] += s
