"""How much of the energy that a run exchanged its account may miss: see solver.analysis.verdict."""

from __future__ import annotations

from solver.output.energy import exchanged, left_open
from solver.simulation import Simulation

SHARE = 0.01  # of the exchanged energy
TRUNCATION = 1.0 / 12.0  # of (turn in a step)^2


def allowed_energy_error(simulation: Simulation) -> float:
    """The default limit of the energy error [J]."""
    account = simulation.last_step.account
    return SHARE * exchanged(account) + TRUNCATION * float(account.turning[0]) + left_open(account, simulation.model.tables.bodies)
