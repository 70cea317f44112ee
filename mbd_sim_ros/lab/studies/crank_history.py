"""Runs of the slider-crank with their history: energy, step and penalties over time, and the outcome."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbd_sim_ros.lab.studies import crank
from solver.errors import StepError
from solver.simulation import Simulation

START = np.pi / 4  # crank angle at the start in the published chapter [rad]


@dataclass(frozen=True, kw_only=True)
class CrankRun:
    """One run and its outcome."""

    label: str
    outcome: str  # 'ok', 'wrong branch', or 'failed'
    until: float  # time that the run reached [s]
    energy: np.ndarray  # (n, 2) time [s], mechanical energy [J]
    steps: np.ndarray  # (n, 2) time [s], step from then on [s]
    penalties: np.ndarray  # (n, 3) time [s], row, penalty from then on
    rows: tuple[str, ...]  # names of constraint rows
    h: float  # step at the start [s]
    penalty: float  # penalty at the start
    iterations: float  # iterations per step of the grid
    energy_error: float  # largest error of the energy balance [J]
    position_error: float  # error of the position of the slider at the end [m], NaN if the end was not reached

    @property
    def smallest_step(self) -> float:
        """Smallest step taken or tried [s]."""
        return float(self.steps[:, 1].min())

    @property
    def largest_penalty(self) -> float:
        """Largest penalty of any constraint."""
        return max(self.penalty, float(self.penalties[:, 2].max(initial=0.0)))

    @property
    def kept_step(self) -> bool:
        """True if the run reached the end on its branch and never reduced its step."""
        return self.outcome == 'ok' and self.smallest_step >= 0.999 * self.h

    def figures(self) -> dict[str, Any]:
        """The row of the run in a table."""
        return {
            'run': self.label,
            'outcome': self.outcome,
            'until [s]': self.until,
            'smallest step [ms]': self.smallest_step * 1e3,
            'largest penalty': self.largest_penalty,
            'iterations': self.iterations,
            'energy error [J]': self.energy_error,
            'slider error [m]': self.position_error,
        }


def record(label: str, h: float, duration: float, settings: dict[str, Any]) -> CrankRun:
    """Run the slider-crank from START, with steps h [s] and these settings, for a duration [s].

    After every step of the grid the energy is noted, and the run ends if it has left its branch.
    """
    simulation = Simulation(crank.scene_at(START, h, settings))
    start = simulation.snapshot().joint_position
    steps = round(duration / h)
    energy = np.full((steps + 1, 2), np.nan)
    energy[0] = 0.0, simulation.last_step.account.energy[0]
    outcome = 'ok'
    try:
        for k in range(1, steps + 1):
            snapshot = simulation.advance()
            energy[k] = simulation.t_ns * 1e-9, simulation.last_step.account.energy[0]
            turn = snapshot.joint_position - start
            if not abs(2 * turn[0] + turn[1]) < crank.ON_BRANCH:
                outcome = 'wrong branch'
                break
    except StepError:
        outcome = 'failed'
    audit, until = simulation.totals(), simulation.t_ns * 1e-9
    error = np.nan
    if outcome == 'ok':
        angle = crank.exact_angles(np.array([START]), crank.slider_mass(), np.array([duration]))[0, 0]
        error = float(abs(snapshot.pose[3, 0] - 2 * np.cos(angle)))
    events = simulation.events
    rows = simulation.model.row_names
    changed = [(event.t, event.new) for event in events if event.kind == 'step']
    raised = [(event.t, rows.index(event.name), event.new) for event in events if event.kind == 'penalty']
    last = changed[-1][1] if changed else h
    return CrankRun(
        label=label,
        outcome=outcome,
        until=until,
        energy=energy[np.isfinite(energy[:, 0])],
        steps=np.array([(0.0, h), *changed, (until, last)]),
        penalties=np.array(raised, float).reshape(-1, 3),
        rows=tuple(rows),
        h=h,
        penalty=simulation.scene.integrator.penalty,
        iterations=audit['iterations'] / max(1, simulation.k),
        energy_error=audit['energy_error_max'],
        position_error=error,
    )
