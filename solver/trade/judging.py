"""Settings held against the limits of a scene: on growing parts of its maneuver, on the maneuvers that serve to choose,
and elsewhere."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable
from functools import partial
from typing import NamedTuple

from solver.analysis.certificate_coverage import is_broken
from solver.analysis.departures import Departure
from solver.errors import MbdError
from solver.trade.bench import (
    FULL,
    Bench,
    apart_of,
    converging,
    cost_of,
    errors_of,
    findings_of,
    going_of,
    keep,
    known,
    own_of,
    run_of,
    settled,
    truth_of,
)
from solver.trade.errors import Bound, Requirement
from solver.trade.reference import STEPS, Reference
from solver.trade.runs import Run, Stopped, all_of
from solver.trade.setting import Setting
from solver.trade.variations import AS_GIVEN, Variation

MARGIN = 0.1  # of every limit that the error itself leaves free
# Error of a reference on another maneuver over that on the one of the scene, as shares of the peak: speeds, amplitudes
# and friction are at most a tenth apart. Ten times as much would need references as dear as that of the scene.
ELSEWHERE = 2.0
PARTS = (0.25, 0.5, 1.0)  # of the maneuver, in the race
EVERY_STEP = tuple(4.0 * STEPS[0] / 2**k for k in range(8))  # s, that a reference may have been tried with
NO_TRUTH = 'the reference: '  # how the failure of a check begins where the full vehicle itself cannot be simulated


class Verdict(NamedTuple):
    """A setting that was tried: the largest share of a limit that its bounds use so far, its cost, why it was dropped
    ('': it passes)."""

    setting: Setting
    used: float
    cost: float  # expected CPU seconds per simulated second
    worst: str
    dropped: str
    bounds: dict[str, Bound]  # the worst over maneuvers by requirement
    error: float = 0.0  # largest share of a limit that its errors themselves use, as far as they were looked at
    part: float = 1.0  # of the scene's own maneuver that it was held against
    broken: str = ''  # the finding on its run for which it was dropped although it keeps the limits


class Check(NamedTuple):
    """The error itself on a maneuver that had no part in the choice."""

    variation: Variation
    used: float
    worst: str
    failure: str

    @property
    def passed(self) -> bool:
        return not self.failure and self.used <= 1.0

    @property
    def unjudged(self) -> bool:
        """True where there is nothing to check against, for the full vehicle itself cannot be simulated there."""
        return self.failure.startswith(NO_TRUTH)


def nearest(tried: Iterable[Verdict]) -> Verdict | None:
    """The setting nearest to the limits among those that were tried, None of none. Errors grow, so those count that
    kept the limits longest."""
    finite = (t for t in tried if math.isfinite(t.used))
    return min(finite, key=lambda t: (-t.part, t.used, t.cost), default=None)


def largest(shares: dict[Requirement, float]) -> tuple[Requirement, float]:
    """The requirement whose share of its limit is largest, and that."""
    return max(shares.items(), key=lambda item: item[1])


def bands_of(bench: Bench, v: Variation) -> dict[Requirement, float]:
    """Band of the converged full vehicle, in the unit of the error, as a share of the peak what it is on the maneuver
    of the scene. On others the error counts besides that the reference there (Bench.apart) makes on that one, ELSEWHERE
    times. A delay has nothing to do with how large the peak is."""
    given, peaks = truth_of(bench, AS_GIVEN), truth_of(bench, v).peaks
    parts = [(bench.falls, given.band)]
    if v != AS_GIVEN and bench.apart:
        parts.append((ELSEWHERE, apart_of(bench, bench.apart)))

    def scaled(r: Requirement, d: Departure) -> float:
        return r.error(d) * (1.0 if r.measure == 'delay' else peaks[r.quantity] / given.peaks[r.quantity])

    return {r: sum(factor * scaled(r, errors[r.quantity]) for factor, errors in parts) for r in bench.requirements}


def limits_of(bench: Bench, v: Variation) -> dict[Requirement, float]:
    """The limits on a maneuver, in SI units."""
    peaks = truth_of(bench, v).peaks
    return {r: r.limit(peaks[r.quantity]) for r in bench.requirements}


def bounds_of(bench: Bench, v: Variation, setting: Setting) -> list[Bound]:
    """Bounds of all requirements. Raises StepError and Stopped."""
    errors, bands, limits = errors_of(bench, v, setting), bands_of(bench, v), limits_of(bench, v)
    return [Bound.of(r, errors[r.quantity], bands[r], limits[r]) for r in bench.requirements]


def broken(bench: Bench, v: Variation, setting: Setting) -> str:
    """The finding that forbids to choose the setting whatever its errors are, in words, or ''."""
    return next((finding.text for finding in findings_of(bench, v, setting) if is_broken(finding)), '')


def against(bench: Bench, reference: Reference, found: Run) -> dict[Requirement, float]:
    """The errors of a run that are limited, against a converged solution."""
    errors = reference.errors(found, bench.required)
    return {r: r.error(errors[r.quantity]) for r in bench.requirements}


def model_error(bench: Bench, v: Variation, model: Setting) -> dict[Requirement, float]:
    """The errors of a converged level that are limited. Raises StepError and Stopped."""
    if model.model == FULL.model:
        return dict.fromkeys(bench.requirements, 0.0)
    return against(bench, truth_of(bench, v), own_of(bench, v, model).as_run)


def shares(bench: Bench, v: Variation, errors: dict[Requirement, float]) -> dict[Requirement, float]:
    """Errors on a maneuver, with the band of the reference, as shares of their limits."""
    bands, limits = bands_of(bench, v), limits_of(bench, v)
    return {r: (errors[r] + bands[r]) / limits[r] for r in bench.requirements}


def race(bench: Bench, setting: Setting) -> tuple[str, float, float]:
    """(why a setting is out, '' if it is not; largest share of a limit; part) on growing parts of the scene's own
    maneuver.

    The largest error so far and the integral of its square only grow, so what is too large after a part stays so.
    """
    lost = ('lost', setting)
    found = bench.made.get(lost) or _race(bench, setting)
    if found[0]:
        bench.made[lost] = found
    return found


def _race(bench: Bench, setting: Setting) -> tuple[str, float, float]:
    """As race(). The whole error comes first, which no converged level is needed for: it is no larger than the sum of
    its parts."""
    truth, there = truth_of(bench, AS_GIVEN), known(bench, AS_GIVEN, setting)
    if not there and (why := _step_alone(bench, setting)):
        return why
    going = None if there else going_of(bench, AS_GIVEN, setting, audit=True)
    used = math.inf
    for part in PARTS if going else PARTS[-1:]:
        with bench.ledger.timed():
            found = there or going.to(part * bench.scene.duration)  # type: ignore[union-attr]
        if going:
            bench.ledger.add(runs=int(part == PARTS[0]), steps=going.new_steps())
        if found.failure:
            return found.failure, math.inf, part
        errors = against(bench, truth, found)
        grown = {'max': 1.0, 'rms': math.sqrt(part), 'delay': 1.0}  # what it has reached of the whole by then
        for r in bench.requirements:
            if r.measure == 'delay' and part < 1.0:
                errors[r] = 0.0  # it may shrink again, and may not be there yet: an infinite one is no reason either
        worst, used = largest(shares(bench, AS_GIVEN, {r: grown[r.measure] * errors[r] for r in bench.requirements}))
        if not used <= 1.0:
            return f'{worst}: {used:.2g} of its limit after {part:.0%} of the maneuver', used, part
    if going:
        keep(bench, AS_GIVEN, setting, found, going.findings())
    if setting.off:
        most = max(bounds_of(bench, AS_GIVEN, setting), key=lambda bound: bound.used)
        worst, used = most.requirement, most.used
    else:
        own, model = own_of(bench, AS_GIVEN, setting), model_error(bench, AS_GIVEN, setting)
        errors = against(bench, own, found)
        worst, used = largest(shares(bench, AS_GIVEN, {r: model[r] + errors[r] for r in bench.requirements}))
    if not used <= 1.0:
        return f'{worst}: the errors of model, step and iteration add up to {used:.2g} of its limit', used, 1.0
    return '', used, 1.0


def _step_alone(bench: Bench, setting: Setting) -> tuple[str, float, float] | None:
    """As race() says it of a setting whose step is too long with any number of iterations, as far as that is known."""
    if setting.off or (
        setting.model != FULL.model and ('limit', AS_GIVEN, converging(setting, bench.steps[1:])) not in bench.made
    ):
        return None
    own, model = own_of(bench, AS_GIVEN, setting), model_error(bench, AS_GIVEN, setting)
    for h in sorted(h for h in {*EVERY_STEP, *bench.steps, setting.h} if h <= setting.h):
        exact = known(bench, AS_GIVEN, dataclasses.replace(settled(setting), h=h))
        if exact and not exact.failure:  # the error of a step grows with the step
            step = against(bench, own, exact)
            worst, used = largest(shares(bench, AS_GIVEN, {r: model[r] + step[r] for r in bench.requirements}))
            if not used <= 1.0:
                shorter = '' if h == setting.h else f', with {1e3 * h:g} ms already'
                return f'{worst}: {used:.2g} of its limit with any number of iterations{shorter}', used, 1.0
    return None


def judge(bench: Bench, setting: Setting, workers: int | None = 1) -> Verdict:
    """The verdict on a setting: it has to keep everything on the maneuvers that serve to choose. Raises Stopped."""
    tried = Verdict(setting, math.inf, cost_of(bench, setting), '', '', {})
    try:
        return _judged(bench, tried, workers)
    except Stopped:
        raise
    except MbdError as error:
        return tried._replace(dropped=str(error))


def _judged(bench: Bench, tried: Verdict, workers: int | None) -> Verdict:
    setting = tried.setting
    dropped, used, part = race(bench, setting)
    if dropped:
        return tried._replace(used=used, worst=dropped.partition(':')[0], dropped=dropped, part=part)
    tried = tried._replace(cost=cost_of(bench, setting, known(bench, AS_GIVEN, setting)))
    for v in bench.seen:
        if v != AS_GIVEN:
            work: list[Callable[[], object]] = [partial(findings_of, bench, v, setting)]
            work += [] if setting.off else [partial(run_of, bench, v, settled(setting))]
            all_of(lambda make: make(), work, workers)
        here, bounds = bounds_of(bench, v, setting), dict(tried.bounds)
        for bound in here:
            name = str(bound.requirement)
            if name not in bounds or bound.used > bounds[name].used or math.isnan(bound.used):
                bounds[name] = bound
        worst = max(bounds, key=lambda name: bounds[name].used)
        tried = tried._replace(bounds=bounds, used=bounds[worst].used, worst=worst)
        if not tried.used <= 1.0:
            return tried._replace(dropped=f'{worst}: {tried.used:.2g} of its limit on {v}')
        itself = max(here, key=lambda bound: bound.itself)
        tried = tried._replace(error=max(tried.error, itself.itself))
        if not tried.error <= 1.0 - MARGIN:
            worst = str(itself.requirement)
            why = f'{worst}: the error itself is {tried.error:.2g} of its limit on {v}, which leaves no margin'
            return tried._replace(worst=worst, dropped=why)
        if why := broken(bench, v, setting):
            return tried._replace(worst=str(itself.requirement), dropped=f'{why} ({v})', broken=why)
    return tried


def check(bench: Bench, v: Variation, setting: Setting) -> Check:
    """The error itself, with the band of the reference, on a maneuver. Raises Stopped."""
    try:
        truth, found = truth_of(bench, v), run_of(bench, v, setting)
    except Stopped:
        raise
    except MbdError as error:
        return Check(v, math.inf, '', f'{NO_TRUTH}{error}')
    if found.failure:
        return Check(v, math.inf, '', found.failure)
    worst, used = largest(shares(bench, v, against(bench, truth, found)))
    return Check(v, used, str(worst), '')


def check_whole(bench: Bench, v: Variation, setting: Setting) -> Check:
    """As check(), and whether the run, which serves for both, is sound."""
    why, found = broken(bench, v, setting), check(bench, v, setting)
    return found._replace(failure=why) if why and found.passed else found
