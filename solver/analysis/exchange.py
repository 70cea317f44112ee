"""Energy that a run exchanged, and how much of it its account may miss: see solver.analysis.verdict."""

from __future__ import annotations

import numpy as np

from solver.compiled.portable import norm
from solver.output import energy as account
from solver.simulation import Simulation

SHARE = 0.01  # of the exchanged energy
TRUNCATION = 1.0 / 12.0  # of (turn in a step)^2
WRITTEN = 1e-6  # relative, and m: what numbers written with finitely many digits leave open
ROUNDING = 1e-12  # of stored energy: what its own numbers leave open, beside prestressed parts at rest where nothing has weight


def exchanged(simulation: Simulation) -> float:
    """Energy [J] that was exchanged so far: supplied and dissipated, and the ranges of kinetic and potential energy."""
    a = simulation.last_step.energy
    kinetic, potential = a[account.KINETIC_HIGH] - a[account.KINETIC_LOW], a[account.POTENTIAL_HIGH] - a[account.POTENTIAL_LOW]
    return float(a[account.GROSS] + kinetic + potential)


def left_open(simulation: Simulation) -> float:
    """Energy [J] that numbers leave open."""
    a, bodies = simulation.last_step.energy, simulation.model.tables.bodies
    weight = float(np.add.reduce(bodies.mass)) * norm(bodies.gravity)
    stored = max(abs(float(a[account.POTENTIAL_LOW])), abs(float(a[account.POTENTIAL_HIGH])))
    return WRITTEN * (weight + float(a[account.KINETIC_HIGH])) + ROUNDING * stored


def allowed_energy_error(simulation: Simulation) -> float:
    """The default limit of the energy error [J]."""
    turning = float(simulation.last_step.energy[account.TURNING])
    return SHARE * exchanged(simulation) + TRUNCATION * turning + left_open(simulation)
