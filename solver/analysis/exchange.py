"""Energy that a run exchanged, and how much of it its account may miss: see solver.analysis.verdict."""

from __future__ import annotations

from solver.output import energy as account
from solver.simulation import Simulation

SHARE = 0.01  # of the exchanged energy
TRUNCATION = 1.0 / 12.0  # of (turn in a step)^2


def exchanged(simulation: Simulation) -> float:
    """Energy [J] that was exchanged so far."""
    return float(account.exchanged_so_far(simulation.last_step.energy))


def left_open(simulation: Simulation) -> float:
    """Energy [J] that numbers leave open."""
    return float(account.left_open(simulation.last_step.energy, simulation.model.tables.bodies))


def allowed_energy_error(simulation: Simulation) -> float:
    """The default limit of the energy error [J]."""
    turning = float(simulation.last_step.energy[account.TURNING])
    return SHARE * exchanged(simulation) + TRUNCATION * turning + left_open(simulation)
