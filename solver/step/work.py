"""Work arrays of an augmented-Lagrangian step: parameters of the scheme, scratch, status and counters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.compiled.by_reference import Ref
from solver.compiled.kernel import kernel
from solver.compiled.memory import zeros
from solver.elements.point_pair import Kinematics
from solver.elements.registry import FORCES
from solver.model.evaluate import turning_rows
from solver.model.saddle import Saddle
from solver.model.state import new_kinematics
from solver.output.account import Account, new_account
from solver.output.snapshot import Counters, OutputArrays
from solver.step.augmentation import Augmentation, new_augmentation
from solver.step.constraint_coefficients import Formulation, new_formulation
from solver.vehicle.size import scale_of

# status of a step, or of several; INACCURATE: error control gave up, PAUSED: the caller may look around and call again
OK, NOT_CONVERGED, NON_FINITE, SINGULAR, INACCURATE, BAD_INPUT, PAUSED = range(7)


class Scheme(NamedTuple):
    """Scalars of the scheme and the iteration."""

    h: float
    am: float
    af: float
    beta: float
    gamma: float
    am1: float  # of first-order states
    gamma1: float
    # from the stage to the end of the step, in intervals between the last two stages: af while the step is constant
    ahead: float
    penalty: np.ndarray  # (nc,) xi_R, dimensionless
    factor: np.ndarray  # (nc,) multiplies the coefficients m_R (the experiment with m/10, docs/studies.md)
    # 1: h_R = lam_R with unit coefficients (k = 1, m = c = f = 0): W = xi beta h^2 (xi gamma h of a velocity)
    m_alf: int
    weigh: int  # address of solver.step.constraint_coefficients.weigh, 0: W are the isolated effective masses
    coupled: int  # 1: coupled effective masses
    full: int  # 1: with c_R and k_R
    form: int
    fixed: int  # 1: a fixed number of iterations with one factorization
    iterations: int  # their number, or the limit in tolerance mode
    tolerance: float
    combined: int  # 1: combined augmentations where one leaves constraints open
    step: int  # address of solver.step.augmented_lagrangian.perform


def scheme_parameters(h: float, rho_inf: float) -> dict[str, float]:
    """Parameters of the scheme for step h [s] and spectral radius rho_inf in [0, 1] at infinite frequency."""
    am = (2.0 * rho_inf - 1.0) / (rho_inf + 1.0)
    af = rho_inf / (rho_inf + 1.0)
    am1 = 1.0 - 0.5 * (3.0 - rho_inf) / (1.0 + rho_inf)
    return {
        'h': h,
        'am': am,
        'af': af,
        'gamma': 0.5 + af - am,
        'beta': 0.25 * (1.0 + af - am) ** 2,
        'am1': am1,
        'gamma1': 0.5 + (1.0 - am1) - (1.0 - af),
        'ahead': af,
    }


class Work(NamedTuple):
    """Scratch and outputs of a step; nothing in it but the account and its inputs before survives from one step to the
    next."""

    kin_stage: Kinematics  # at the generalized midpoint; the suffix says the instant: stage or end of the step
    kin_end: Kinematics
    T_stage: np.ndarray  # (nb + 1, 3, 3) derivative of the stage rotation with respect to the increment
    T_end: np.ndarray
    f: np.ndarray  # (nb + 1, 6)
    r: np.ndarray
    dw: np.ndarray
    a_best: np.ndarray  # iterate with the smallest increment
    lam_best: np.ndarray
    Kq: np.ndarray  # (ns + 1, 6, 6)
    Kv: np.ndarray
    phi_end: np.ndarray  # (nc,)
    phi_stage: np.ndarray
    g: np.ndarray
    dlam: np.ndarray
    phi_t: np.ndarray
    phi_tt: np.ndarray
    rate: np.ndarray
    J_end: np.ndarray  # (entries + 1, 6, 6) at the end of the step
    J_stage: np.ndarray  # at the stage
    J_before: np.ndarray  # at the start, where somebody asks for it (solver.output.undetermined)
    zp: np.ndarray
    z_stage: np.ndarray
    saddle: Saddle
    outputs: np.ndarray  # those of all force elements (Model.new_outputs)
    v_out: np.ndarray  # (nb + 1, 6) projected twist
    a_out: np.ndarray  # (nb + 1, 6) acceleration at the end of the step
    lam_out: np.ndarray  # (nc,) constraint forces at the end of the step
    # (nc + 1,) 1 for rows whose constraint force the last step with an account does not determine, and their number
    marks: np.ndarray
    account: Account  # the running account
    u_force: np.ndarray  # (nu,) 1 for inputs that forces follow, 0 for prescribed motions
    u_before: np.ndarray  # (nu,) inputs of the step before
    u_end: np.ndarray  # (nu,) inputs at the end of the step
    outputs_end: np.ndarray  # the same, those of elements that follow inputs with u_end
    augmentation: Augmentation  # directions of the factorization
    formulation: Formulation  # coefficients of the constraints
    chassis: int  # body of the inertial unit
    length: float  # of the model [m] (solver.model.scale): a turn by 1 rad counts as much as a displacement by it
    slow: np.ndarray  # (1,) speed [m/s], below which velocities count as so much
    # (nc,) what makes a length [m] of the residual of a row: 1, or the length of the model of one in rad
    row_length: np.ndarray
    arrays: OutputArrays  # what a Snapshot shows
    result: np.ndarray  # (9,) StepResult of the last step, its counters one by one


class LastStep(NamedTuple):
    """Views of what the last step worked with: to be read before the next one, not to be written."""

    phi: np.ndarray  # (nc,) residuals at the end: of positions [m or rad], of velocities where a row is not holonomic
    J: np.ndarray  # (entries + 1, 6, 6) blocks of A at the end (solver.model.tables.ConstraintTable)
    J_stage: np.ndarray  # the same at the stage
    phi_t: np.ndarray  # (nc,) explicit time derivatives of the rows
    lam: np.ndarray  # (nc,) constraint forces at the end of the step
    W: np.ndarray  # (nc,) penalties: xi_R times what it multiplies
    account: Account  # the running account


class StepResult(NamedTuple):
    """Status and counters of one step, or of several; `where` is a body, group or iteration index that belongs to the
    status."""

    status: int
    where: int
    counters: Counters


@kernel(inline=True)
def added(a, b):
    """Counters of steps and of later ones."""
    return Counters(
        a.iterations + b.iterations,
        a.factorizations + b.factorizations,
        a.evaluations + b.evaluations,
        a.stagnated + b.stagnated,
        max(a.residual, b.residual),
        max(a.position_drift, b.position_drift),
        max(a.velocity_drift, b.velocity_drift),
    )


@kernel(inline=True)
def last_result(work):
    """The StepResult of the step that perform() did last."""
    r = work.result
    counters = Counters(int(r[2]), int(r[3]), int(r[4]), int(r[5]), r[6], r[7], r[8])
    return StepResult(int(r[0]), int(r[1]), counters)


def new_work(model, saddle: Saddle, outputs: np.ndarray, arrays: OutputArrays) -> Ref:
    """Allocate the scratch (Work, by reference) of a model; outputs and arrays are the arrays that it fills."""
    nb, nc, ns, ne, nz = model.n_bodies, model.n_rows, model.n_slots, model.n_entries, model.n_internal
    six = lambda: zeros((nb + 1, 6))  # noqa: E731
    row = lambda: zeros(nc)  # noqa: E731
    unit = lambda: new_kinematics(nb).R  # noqa: E731
    used = np.concatenate([model.inputs_of(kind.name) for kind in FORCES])
    forces = np.isin(np.arange(len(model.spec.inputs)), used).astype(float)
    length, slow = scale_of(model.spec)
    row_length = np.where(turning_rows(model), length, 1.0)
    work = Work(
        kin_stage=new_kinematics(nb), kin_end=new_kinematics(nb), T_stage=unit(), T_end=unit(),
        f=six(), r=six(), dw=six(), a_best=six(), lam_best=row(), Kq=zeros((ns + 1, 6, 6)), Kv=zeros((ns + 1, 6, 6)),
        phi_end=row(), phi_stage=row(), g=row(), dlam=row(), phi_t=row(), phi_tt=row(), rate=row(),
        J_end=zeros((ne + 1, 6, 6)), J_stage=zeros((ne + 1, 6, 6)),
        J_before=zeros((ne + 1, 6, 6)), zp=zeros(nz), z_stage=zeros(nz),
        saddle=saddle, outputs=outputs, v_out=six(), a_out=six(), lam_out=row(), marks=zeros(nc + 1),
        account=new_account(nb, model.n_peaks, len(model.spec.tires), flow=arrays.energies.size > 0),
        u_force=forces, u_before=zeros(len(forces)), u_end=zeros(len(forces)), outputs_end=outputs.copy(),
        augmentation=new_augmentation(model, row_length),
        formulation=new_formulation(model),
        chassis=model.body_names.index(model.spec.chassis) if model.spec.chassis else 0, arrays=arrays,
        length=length, slow=np.array([slow]), row_length=row_length,
        result=zeros(2 + len(Counters._fields)),
    )  # fmt: skip
    return Ref(work)
