"""The verdict on a run: 'ok', or 'suspect' with findings that say what is beyond what a sound run of this method shows.

Quantities, limits and reasons stand with the checks (solver.checks, listed in solver.checks.registry). A limit that the
scene itself requires (`require`) replaces the default of that check. Other things that no vehicle can do are seen in
its motion (solver.analysis.envelope). Where a twin has measured the error of the run, the error decides (decided()).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import asdict
from typing import Any

from solver.analysis.error_bar import ErrorBar
from solver.analysis.turned import caused
from solver.checks.account import CONTRADICTION
from solver.checks.check import Evidence
from solver.checks.registry import BY_NAME, CHECKS
from solver.findings import Finding
from solver.simulation import Simulation
from solver.start.reach import beyond_reach

OK, SUSPECT, INTERRUPTED, ERROR = 'ok', 'suspect', 'interrupted', 'error'


def findings(simulation: Simulation, real_time_factor: float | None = None) -> list[Finding]:
    """Everything that makes the run so far suspect, from the running account of steps advanced with audit."""
    evidence, required = evidence_of(simulation, real_time_factor), simulation.scene.require.limits
    found = [finding for check in CHECKS for finding in check.findings(evidence, required)]
    return _explained(simulation, found) if simulation.of_bodies else found


def decided(found: Sequence[Finding], error: ErrorBar) -> tuple[list[Finding], list[Finding]]:
    """(findings that decide, findings that explain), by the error of the run.

    Where a twin has measured the error it decides, and what says that steps, iterations or numbers are too coarse
    explains it: a run is not wrong because it might be. What both runs may have in common (another branch, open joints,
    signals that steps do not see, states that no vehicle can be in, the range of a level), and what a scene requires,
    decides all the same; of joints that contradict each other those that a shorter step does not close. Without a twin
    all findings decide.
    """
    if not error.measured:
        return [*found], []
    closed = {CONTRADICTION.name} if error.closing else set()
    explains = [
        not finding.required and (BY_NAME[finding.quantity].seen_by_twin or finding.quantity in closed)
        for finding in found
    ]
    deciding = [finding for finding, one in zip(found, explains, strict=True) if not one]
    return [*error.findings, *deciding], [finding for finding, one in zip(found, explains, strict=True) if one]


def status_of(suspect: Collection[Finding], *, failed: bool = False, interrupted: bool = False) -> str:
    """The status of a run: the one rule for whoever tells it (run, node, sweep, studies).

    suspect: its findings that no certificate covers. failed: it did not come to its end. interrupted: somebody ended it
    before.
    """
    return ERROR if failed else INTERRUPTED if interrupted else SUSPECT if suspect else OK


def passes(simulation: Simulation, found: Sequence[Finding]) -> bool:
    """True where the scene allows a run with these findings."""
    return all(simulation.scene.require.allow_suspect and not finding.required for finding in found)


def report(found: Sequence[Finding]) -> list[dict[str, Any]]:
    """Findings as objects for JSON."""
    return [asdict(finding) for finding in found]


def evidence_of(simulation: Simulation, real_time_factor: float | None = None) -> Evidence:
    """A run so far, as checks look at it."""
    s, bodies = simulation, simulation.of_bodies
    return Evidence(
        account=s.last_step.account, model=s.model, channels=s.channels, settings=s.scene.integrator,
        h=s.h, k=s.k, time=s.t_ns * 1e-9, duration=s.scene.duration, source=s.source,
        state=s.state if bodies else None, scheme=s.scheme if bodies else None,
        switches=s.switches, watched=s.branches is not None, level=s.level, reached=s.reached,
        real_time_factor=real_time_factor,
    )  # fmt: skip


def _explained(simulation: Simulation, found: list[Finding]) -> list[Finding]:
    """The findings on a model of bodies; what is known to be behind one stands in the place of its remedy."""
    told = []
    for finding in found:
        if finding.quantity == CONTRADICTION.name:
            why = beyond_reach(simulation.model, simulation.state, simulation.snapshot().inputs)
            finding = dataclasses.replace(finding, text=why) if why else finding
        told.append(finding)
    return caused(simulation.model.spec, told)
