"""The energy account of a run: what is stored, what was dissipated and supplied, and what is missing."""

from __future__ import annotations

from solver.compiled.kernel import kernel
from solver.model.tables import COUNT, OUTPUT, WIDTH

REFERENCE, POWER, WORK, WORST, ENERGY = range(5)  # entries of the running audit


@kernel(inner=True)
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
    for k in range(tables.forces.shape[0]):
        at = tables.forces[k, OUTPUT]
        for _ in range(tables.forces[k, COUNT]):
            energy += outputs[at]
            dissipation += outputs[at + 1]
            at += tables.forces[k, WIDTH]
    return energy, dissipation


@kernel(borrow=True)
def update_energy(tables, kin, outputs, lam, phi_t, h, audit):
    """Advance the energy balance by a step h [s] (h = 0 starts it): error = E - E_0 + integral of (dissipation - driver power).

    The integral is the trapezoidal rule, second order like the method if the outputs are those of the inputs at the end of the step.
    lam and phi_t give the power of prescribed motions.
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
