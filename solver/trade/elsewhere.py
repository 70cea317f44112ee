"""References on other maneuvers than that of the scene: the cheapest runs of the full vehicle whose error, measured on
the maneuver of the scene, is a small share of every limit.

The converged limit of three steps would be far better than its purpose needs: what is judged there is held against
limits that are twenty times as wide. A reference is one run with two iterations, or a pair that is extrapolated. For a
setting of the full vehicle itself its step is half of that of the setting at most: held against itself it would be
right.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

from solver.checks.registry import BY_NAME
from solver.errors import MbdError
from solver.findings import Finding
from solver.trade.bench import FULL, Bench, apart_of, converging, findings_of
from solver.trade.judging import ELSEWHERE, limits_of
from solver.trade.setting import Setting
from solver.trade.variations import AS_GIVEN, Variation

# Of a limit that the error of a reference elsewhere, times ELSEWHERE, may take. Ten times as much would leave settings
# half of what they are allowed; a tenth would need the converged limit for limits of 1 %.
SMALL = 0.05
SMALL_THERE = 0.1  # the same where a setting is checked only: there its error counts, not a bound of it
ITERATIONS = 2
FINER = 0.5  # step of a reference over that of a setting of the full vehicle that it judges, at most
Apart = tuple[Setting, ...]


def options(steps: Sequence[float]) -> list[Apart]:
    """Runs with each of these steps [s], coarsest first, and pairs of neighbours; the cheapest first."""
    single = [(dataclasses.replace(FULL, h=h, iterations=ITERATIONS),) for h in steps]
    pairs = [(*a, *b) for a, b in itertools.pairwise(single)]
    return sorted((*single, *pairs), key=lambda option: sum(1.0 / one.h for one in option))


def chosen(bench: Bench, setting: Setting, small: float = SMALL) -> Apart:
    """The cheapest reference for maneuvers on which a setting is judged; () is that of the two finest steps, iterated
    to tolerance (Bench.apart). small: share of a limit that its error may take. Raises Stopped."""
    most = FINER * setting.h if setting.model[0] == FULL.level else bench.steps[0]
    return next(
        (option for option in options(bench.steps) if option[-1].h <= most and _is_good(bench, option, small)), ()
    )


def _is_good(bench: Bench, option: Apart, small: float) -> bool:
    """True where its error is small, also, and known at once, that of the same steps iterated to tolerance; and where
    its runs resolve what those of the reference resolve."""
    if not _is_near(bench, converging(FULL, [one.h for one in option]), small):
        return False
    findings = unresolved(bench, AS_GIVEN, option[-1])  # makes the run that the next line needs
    return _is_near(bench, option, small) and {f.quantity for f in findings} <= {
        f.quantity for f in unresolved(bench, AS_GIVEN, Setting(h=bench.steps[-1]))
    }


def _is_near(bench: Bench, option: Apart, small: float) -> bool:
    try:
        errors, limits = apart_of(bench, option), limits_of(bench, AS_GIVEN)
    except MbdError:  # it does not survive the maneuver
        return False
    return all(ELSEWHERE * r.error(errors[r.quantity]) <= small * limits[r] for r in bench.requirements)


def unresolved(bench: Bench, v: Variation, setting: Setting) -> list[Finding]:
    """Findings of a run of the reference that it does not resolve: steps that all damp a vibration away agree on a
    motion without it."""
    return [f for f in findings_of(bench, v, setting) if BY_NAME[f.quantity].unresolved and not f.required]
