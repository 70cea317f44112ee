"""The coefficients m_R, c_R, k_R, f_R of the constraint equations, from the masses, tangents and forces that a step
has.

With a direction c_R that moves constraint R alone at unit rate,

    m_R = c_R^T M c_R,   c_RR = -c_R^T (df/dv) c_R,   k_R = -c_R^T (df/dq) c_R,   f_R = c_R^T f

where f are the applied forces (docs/formulation.md). The equations with these coefficients are those of
[Natsiavas2015]; the directions are our choice. A row that is not holonomic has a velocity, (m psidot)' + c psidot = 0,
and no k_R. *Isolated*: a_R c_R = 1 with the smallest m_R, c_R = m_R M^-1 a_R^T and m_R = 1/(a_R M^-1 a_R^T). *Coupled*:
the other constraints hold besides, A c_R = e_R with the smallest m_R, which gives m_R = [(A M^-1 A^T)^+]_RR. It is the
solution of (M + A^T W A) c_R = W_R a_R^T for large penalties W, which takes redundant rows as well: there A c_R is
nearest to e_R, each row measured in units of its isolated mass, so that a rescaled row changes nothing. Massless bodies
count with the floor of the penalties.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.kernel import kernel
from solver.compiled.portable import inverse
from solver.errors import SpecError, suggestion
from solver.model.evaluate import evaluate_constraints, evaluate_forces
from solver.model.saddle import CONDENSED, effective_masses, factorize_saddle, new_saddle, solve_saddle
from solver.model.state import State, kinematics_of

# penalty of coupled directions: off by 2 / (COUPLING s_min) of a regular system, rounding by COUPLING times 1e-16
COUPLING = 1e7


class Formulation(NamedTuple):
    """Scratch and result of constraint_coefficients."""

    mass: np.ndarray  # (nb,) [kg] with the floor of the penalties
    inertia: np.ndarray  # (nb, 3, 3) [kg m^2]
    direction: np.ndarray  # (nb + 1, 6) c_R of one constraint
    zero: np.ndarray  # (nb + 1, 6)
    rate: np.ndarray  # (nc,) -e_R
    unused: np.ndarray  # (nc,)
    values: np.ndarray  # (nc, 4) m_R, c_R, k_R, f_R


class ConstraintCoefficients(NamedTuple):
    """Coefficients of one constraint row, per unit of the row (m or rad): m [kg, kg m^2], c [.../s], k [.../s^2], f [N,
    N m].

    k is zero where the row is not holonomic.
    """

    m: float
    c: float
    k: float
    f: float


def new_formulation(model) -> Formulation:
    """Allocate for a model."""
    nb, nc, t = model.n_bodies, model.n_rows, model.tables
    return Formulation(
        mass=1.0 / t.penalty_inverse_mass,
        inertia=inverse(t.penalty_inverse_inertia),
        direction=np.zeros((nb + 1, 6)),
        zero=np.zeros((nb + 1, 6)),
        rate=np.zeros(nc),
        unused=np.zeros(nc),
        values=np.zeros((nc, 4)),
    )


@kernel(inner=True)
def _factorize_kinetic(tables, form, J, saddle, formulation):
    """Factorize M + A^T W A with W = COUPLING m_R (isolated). Returns -1 or a bad node."""
    for e in range(1, J.shape[0]):
        for r in range(6):
            for i in range(6):
                saddle.J_force[e, r, i] = J[e, r, i]
                saddle.J_row[e, r, i] = J[e, r, i]
    for i in range(saddle.W.shape[0]):
        saddle.W[i] *= COUPLING
    saddle.B[:] = 0.0
    for b in range(formulation.mass.shape[0]):
        s = tables.bodies.slot[b]
        for i in range(3):
            saddle.B[s, i, i] = formulation.mass[b]
            for j in range(3):
                saddle.B[s, 3 + i, 3 + j] = formulation.inertia[b, i, j]
    return factorize_saddle(tables, form, saddle)


@kernel(inner=True)
def _isolated_direction(tables, J, g, r, m, c):
    """c (nb + 1, 6) = m M^-1 a_R^T of row r in group g."""
    con = tables.constraints
    c[:] = 0.0
    for e in range(con.entry[g], con.entry[g + 1]):
        b = con.body[e]
        for i in range(3):
            c[b, i] += m * tables.penalty_inverse_mass[b] * J[e, r, i]
            for j in range(3):
                c[b, 3 + i] += m * tables.penalty_inverse_inertia[b, i, j] * J[e, r, 3 + j]


@kernel(inner=True)
def _kinetic(formulation, c):
    """c^T M c."""
    total = 0.0
    for b in range(formulation.mass.shape[0]):
        for i in range(3):
            total += formulation.mass[b] * c[b, i] * c[b, i]
            for j in range(3):
                total += c[b, 3 + i] * formulation.inertia[b, i, j] * c[b, 3 + j]
    return total


@kernel(inner=True)
def _quadratic(tables, K, c):
    """c^T K c with blocks K (ns + 1, 6, 6)."""
    total = 0.0
    for s in range(1, tables.block_row.shape[0]):
        row, column = tables.block_row[s], tables.block_col[s]
        for i in range(6):
            if c[row, i] != 0.0:
                for j in range(6):
                    total += c[row, i] * K[s, i, j] * c[column, j]
    return total


@kernel(borrow=True)
def constraint_coefficients(tables, form, coupled, full, J, Kq, Kv, f, saddle, formulation):
    """Assign formulation.values from Jacobian blocks J, tangents Kq, Kv and forces f (nb + 1, 6); full = 0: only m_R.

    Overwrites everything in saddle but saddle.W, which are the isolated m_R before and after.
    """
    con = tables.constraints
    c = formulation.direction
    values = formulation.values
    effective_masses(tables, J, saddle.W)
    for i in range(values.shape[0]):
        values[i, 0] = saddle.W[i]
    solvable = coupled == 1 and _factorize_kinetic(tables, form, J, saddle, formulation) < 0
    for g in range(con.row.shape[0] - 1):
        first = con.row[g]
        for r in range(con.row[g + 1] - first):
            i = first + r
            if solvable:
                formulation.rate[i] = -1.0
                solve_saddle(tables, form, saddle, formulation.zero, formulation.rate, c, formulation.unused)
                formulation.rate[i] = 0.0
                values[i, 0] = _kinetic(formulation, c)
            elif full == 1:
                _isolated_direction(tables, J, g, r, values[i, 0], c)
            if full == 1:
                values[i, 1] = -_quadratic(tables, Kv, c)
                values[i, 2] = -_quadratic(tables, Kq, c) if con.holonomic[i] == 1 else 0.0
                values[i, 3] = 0.0
                for b in range(formulation.mass.shape[0]):
                    for k in range(6):
                        values[i, 3] += c[b, k] * f[b, k]
    effective_masses(tables, J, saddle.W)


@kernel(borrow=True)
def weigh(tables, c, work):
    """work.saddle.W = what the penalties of this step multiply: m_R, or with c_R and k_R the mass that the step matrix
    shows.

    (m phidot)' + c phidot + k phi = 0 is, in one step from phi = 0, (m (1 - am) + c s gamma h + k s beta h^2) phi = 0:
    the quadratic form of the step matrix in the direction c_R. The equation of a velocity is (m (1 - am) + c s gamma h)
    psidot = 0, without k. A tangent that makes it smaller than m_R is left out.
    """
    constraint_coefficients(
        tables, c.form, c.coupled, c.full, work.J_stage, work.Kq, work.Kv, work.f, work.saddle, work.formulation
    )  # fmt: skip
    values = work.formulation.values
    scale = (1.0 - c.af) * c.h / (1.0 - c.am)
    for i in range(values.shape[0]):
        m = values[i, 0]
        if c.full == 1:
            m += max(0.0, scale * (c.gamma * values[i, 1] + c.beta * c.h * values[i, 2]))
        work.saddle.W[i] = m


def mass_factors(model, factors: dict[str, float]) -> np.ndarray:
    """(nc,) factors of m_R from a mapping of joints, couplers or single rows to numbers ('' is all). Raises
    SpecError."""
    constraints = model.tables.constraints
    rows = {name: slice(*constraints.row[g : g + 2]) for g, name in enumerate(model.group_names)}
    rows |= {name: slice(k, k + 1) for k, name in enumerate(model.row_names)}
    rows[''] = slice(None)
    found = np.ones(model.n_rows)
    for name, factor in factors.items():
        if name not in rows:
            raise SpecError(
                f'integrator: mass_factor: the model has no constraint {name!r}{suggestion(name, list(rows))}'
            )
        found[rows[name]] = factor
    return found


def coefficients_of(
    model, state: State, u: np.ndarray, outputs, *, coupled: bool = False
) -> dict[str, ConstraintCoefficients]:
    """Scheme of every constraint row by name, at a state and inputs u (nu,); outputs are those of the force
    elements."""
    t = model.tables
    kin = kinematics_of(state.q, state.v)
    phi, J = np.zeros(model.n_rows), np.zeros((model.n_entries + 1, 6, 6))
    f, z = np.zeros((model.n_bodies + 1, 6)), np.zeros(model.n_internal)
    Kq, Kv = (np.zeros((model.n_slots + 1, 6, 6)) for _ in range(2))
    evaluate_constraints(t, kin, state.angle, u, True, phi, J)
    evaluate_forces(t, kin, state.angle, state.z, 0.0, u, True, f, Kq, Kv, z, outputs)
    formulation = new_formulation(model)
    constraint_coefficients(
        t, CONDENSED, int(coupled), 1, J, Kq, Kv, f, Ref(new_saddle(model, CONDENSED)), Ref(formulation)
    )
    return {
        name: ConstraintCoefficients(*(float(x) for x in row))
        for name, row in zip(model.row_names, formulation.values, strict=True)
    }
