"""Coverage: findings on a run that the certificate of its plan covers, since they were there too where the plan
measured errors.

A setting that a plan has chosen may turn a wheel by more than a radian in a step, or leave vibrations out of step. In
general that is suspect; of the quantities that a plan certifies it has measured what comes of it, against the converged
full vehicle, on the maneuver of the scene and on others. So the certificate keeps the findings of those runs, and one
of the same kind at the same place and no considerably worse is no reason to suspect a run of this plan. Kinds that can
be covered say that something is coarse or far from where a level is usually good; what says that something is broken
(energy out of nothing, iterations that do not settle, open constraints, another branch, signals that steps do not see)
is never covered, and a plan chooses no setting with it. Nor is what the reference does not resolve itself, against
which nothing of it was measured. A finding that belongs to the scene and not to its setting (a hollow rounder than the
wheels, a bushing that turns by pi, a car that rolls over, an overloaded tire) is neither covered nor a reason to choose
another setting.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from solver.analysis.envelope import Envelope
from solver.analysis.error_bar import NOT_ASKED, ErrorBar
from solver.analysis.verdict import decided, findings
from solver.checks.registry import BY_NAME
from solver.findings import Certified, Finding
from solver.simulation import Simulation

# Part of the value, as much as a plan leaves free of a limit for maneuvers beside those it chose on
# (solver.trade.search); ten times as much would cover what is twice as bad as anything that was measured.
WORSE = 0.1


class Weighed(NamedTuple):
    """suspect: what makes a run suspect. covered: what would, but for the certificate of its plan. explaining: what
    would, had the error not been measured (solver.analysis.verdict)."""

    suspect: list[Finding]
    covered: list[Finding]
    explaining: Sequence[Finding] = ()


def weighed(
    simulation: Simulation,
    envelope: Envelope | None = None,
    real_time_factor: float | None = None,
    *,
    ended: bool = True,
    error: ErrorBar = NOT_ASKED,
) -> Weighed:
    """All findings of the run so far, by whether its error or the certificate of its plan takes their place. ended: see
    Envelope.findings."""
    found, explaining = decided(findings(simulation, real_time_factor), error)
    found += [] if envelope is None else envelope.findings(ended=ended)
    certified = () if simulation.level is None else simulation.level.certified
    covered = [finding for finding in found if any(covers(one, finding) for one in certified)]
    return Weighed([finding for finding in found if finding not in covered], covered, explaining)


def covers(certified: Certified, finding: Finding) -> bool:
    """True where a finding is one that is certified, beyond the same end of a range, and not considerably worse."""
    if not _is_coarse(finding) or kind_of(finding) != kind_of(certified):
        return False
    return side_of(certified) * (finding.value - certified.value) <= WORSE * abs(certified.value)


def kind_of(one: Finding | Certified) -> tuple[str, str, str, float]:
    """Quantity, of, where, and beyond which end of a range: findings alike in these are the same at another size."""
    return one.quantity, one.of, '' if BY_NAME[one.quantity].anywhere else one.where, side_of(one)


def side_of(one: Finding | Certified) -> float:
    """Beyond which end of its range: 1 above the upper, -1 below the lower one. A measurement to the left says nothing
    of the right."""
    return 1.0 if one.value > one.limit else -1.0


def _is_coarse(finding: Finding) -> bool:
    """True where a finding is a matter of step, iterations or level, which a plan may have measured."""
    return BY_NAME[finding.quantity].plan == 'coarse' and not finding.required


def is_of_scene(finding: Finding) -> bool:
    """True where a finding belongs to the scene, whatever its setting."""
    return BY_NAME[finding.quantity].plan == 'scene'


def is_broken(finding: Finding) -> bool:
    """True where a plan must not choose a setting with this finding."""
    return finding.required or BY_NAME[finding.quantity].plan == 'broken'


def certified_of(found: Iterable[Finding]) -> tuple[Certified, ...]:
    """Findings of several runs that a certificate covers, the worst of each kind."""
    worst: dict[tuple[str, str, str, float], Certified] = {}
    for finding in found:
        if not _is_coarse(finding):
            continue
        kind = kind_of(finding)
        quantity, of, where, _ = kind
        one = Certified(
            quantity=quantity, of=of, where=where, value=finding.value, limit=finding.limit, unit=finding.unit
        )
        known = worst.get(kind)
        if known is None or abs(one.value - one.limit) > abs(known.value - known.limit):
            worst[kind] = one
    return tuple(worst.values())
