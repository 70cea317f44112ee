"""Reactions that a step does not determine: noted in the running account, and marked for what shows them.

At a singular position some multipliers x act on nothing, A^T x = 0, and the motion does not say how large they are.
Next to it they act on little, so an error of the motion makes an error of them that grows as one over the distance:
steps that pass a singular position of bars of 1 kg have multipliers of 1e3 to 1e7 N. The position itself is no sign of
that: where the motion holds the constraints exactly, as that of a slider-crank does, reactions pass it without an
error. Nor is a small singular value: a scissor of eighty bars has one of 3e-5 always. The signs are three, all of them
ratios:

- *rough*: the second difference of multipliers over the last steps is larger than that of an oscillation that steps
  resolve (ROUGH), relative to the largest reaction that was smooth;
- *idle*: as forces, A^T x in the metric of the masses over what the rows of x would do one by one, it does less than a
  part IDLE of what ordinary multipliers do, so it is no load that has changed. Rows that are redundant always have a
  smooth share of it, and are left alone;
- *singular*: A^T x turns within the step by more than it is long (NEAR): the position where it is zero is nearer than
  half a step.

A series of rough steps that has begun so goes on while it is idle, and LINGERS steps more: a second difference spans
three. With rho_inf > 0 an error alternates and dies out by that factor, which is the rest of the series.

Looked at is only what follows a step that needed combined augmentations (solver.step.augmentation), which no step of a
car does, or one in which the largest multiplier grew by 1.4.
"""

from __future__ import annotations

from solver.compiled.kernel import YES, kernel
from solver.model.evaluate import add_constraint_forces, evaluate_constraints
from solver.model.state import fill_kinematics

# Second difference of multipliers in a step, over the largest smooth one: that of fourteen steps a period. An error
# that alternates is a quarter of it. Ten times as much would show errors of half of what is right.
ROUGH = 0.2
# Share of forces that do something, relative to that of ordinary multipliers; with ten times as much a load that
# changes would count as none.
IDLE = 0.25
# Square of a turn of A^T x in a step, over its own: at 4 the singular position is nearer than half a step to one of its
# ends, which it is of one step at least. Measured where nothing is singular: up to 0.5; at passages 6 to 3000.
NEAR = 4.0
LINGERS = 2.0  # steps that a series goes on where it is not idle

SCALE, ORDINARY, SERIES, DOUBT = range(4)  # numbers of Account.doubt
TIME, FIRST, ROW, ROWS = range(4)  # numbers of Account.undetermined


@kernel(inner=True)
def kinetic(tables, p):
    """p^T M^-1 p of forces or momenta p (nb + 1, 6)."""
    total = 0.0
    for b in range(tables.bodies.mass.shape[0]):
        for i in range(3):
            total += tables.penalty_inverse_mass[b] * p[b, i] * p[b, i]
            for j in range(3):
                total += p[b, 3 + i] * tables.penalty_inverse_inertia[b, i, j] * p[b, 3 + j]
    return total


@kernel(inner=True)
def _one_by_one(tables, J, x):
    """Sum of kinetic(A^T x) over the rows of x (nc,) one by one."""
    con = tables.constraints
    total = 0.0
    for g in range(con.row.shape[0] - 1):
        first = con.row[g]
        for e in range(con.entry[g], con.entry[g + 1]):
            b = con.body[e]
            if b == tables.bodies.mass.shape[0]:
                continue
            for r in range(con.row[g + 1] - first):
                own = 0.0
                for i in range(3):
                    own += tables.penalty_inverse_mass[b] * J[e, r, i] * J[e, r, i]
                    for j in range(3):
                        own += J[e, r, 3 + i] * tables.penalty_inverse_inertia[b, i, j] * J[e, r, 3 + j]
                total += own * x[first + r] * x[first + r]
    return total


@kernel(inner=True)
def _share(tables, J, x, f):
    """(kinetic(A^T x), the same over that of the rows of x one by one); A^T x goes to f (nb + 1, 6)."""
    f[:] = 0.0
    add_constraint_forces(tables.constraints, J, x, 1.0, f)
    own, all_ = kinetic(tables, f), _one_by_one(tables, J, x)
    return own, own / all_ if all_ > 0.0 else 1.0


@kernel(inner=True)
def _is_near(tables, s0, u, x, own, work):
    """True where A^T x, in work.f and of size `own`, turns so much since the state s0 that the position where it is
    zero is near."""
    fill_kinematics(s0.q, s0.v, work.kin_stage)
    evaluate_constraints(tables, work.kin_stage, s0.angle, u, YES, work.phi_stage, work.J_before)
    work.r[:] = 0.0
    add_constraint_forces(tables.constraints, work.J_before, x, 1.0, work.r)
    before = kinetic(tables, work.r)
    for b in range(work.r.shape[0] - 1):
        for i in range(6):
            work.r[b, i] -= work.f[b, i]
    return kinetic(tables, work.r) > NEAR * min(own, before)


@kernel(inner=True)
def _roughness(s0, s1, lengths, x):
    """Largest second difference of multipliers, as forces [N]; all of them go to x (nc,)."""
    largest = 0.0
    for i in range(x.shape[0]):
        x[i] = s1.lam[i] - 2.0 * s0.lam[i] + s0.lam_before[i]
        largest = max(largest, abs(x[i]) / lengths[i])
    return largest


@kernel(inner=True)
def _largest(lam, lengths):
    """Largest of multipliers (nc,), as forces [N]."""
    most = 0.0
    for i in range(lam.shape[0]):
        most = max(most, abs(lam[i]) / lengths[i])
    return most


@kernel(borrow=True)
def note_undetermined(tables, h, s0, s1, u, work):
    """Mark the reactions that the step of h [s] from s0 to s1 does not determine, in work.marks, whose last number says
    how many; and note their time, of the account the time until now.

    Work.kin_stage, phi_stage, rate, r and f are scratch here.
    """
    doubt, noted, marks, x = work.account.doubt, work.account.undetermined, work.marks, work.rate
    lengths, n = work.row_length, work.rate.shape[0]
    marks[:] = 0.0
    combined = work.augmentation.known[0] > 0
    if doubt[DOUBT] == 0.0:
        doubt[DOUBT] = 1.0
        doubt[SCALE] = max(_largest(s0.lam, lengths), _largest(s0.lam_before, lengths))
        doubt[SERIES] = doubt[ORDINARY] = 0.0
    limit = ROUGH * doubt[SCALE]
    rough = limit > 0.0 and _roughness(s0, s1, lengths, x) > limit
    if rough:
        if doubt[ORDINARY] == 0.0:
            _, doubt[ORDINARY] = _share(tables, work.J_end, s0.lam, work.f)
        own, share = _share(tables, work.J_end, x, work.f)
        idle = share < IDLE * doubt[ORDINARY]
        if idle and (doubt[SERIES] > 0.0 or _is_near(tables, s0, u, x, own, work)):
            doubt[SERIES] = 1.0 + LINGERS
        else:
            doubt[SERIES] = max(0.0, doubt[SERIES] - 1.0)
    else:
        doubt[SERIES] = doubt[ORDINARY] = 0.0
    if doubt[SERIES] == 0.0:
        doubt[SCALE] = max(doubt[SCALE], _largest(s1.lam, lengths))
        if not (combined or rough):
            doubt[DOUBT] = 0.0
        return
    most = 0.0
    for i in range(n):
        if abs(x[i]) > limit * lengths[i]:
            marks[i] = 1.0
            marks[n] += 1.0
            if abs(x[i]) > most * lengths[i]:
                most = abs(x[i]) / lengths[i]
                if noted[TIME] == 0.0:
                    noted[ROW] = i
    if noted[TIME] == 0.0:
        noted[FIRST] = work.account.time[0]
    noted[TIME] += h
    noted[ROWS] = max(noted[ROWS], marks[n])
