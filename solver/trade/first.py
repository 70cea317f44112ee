"""First answers: what a plan would choose by what is known before it has made its runs.

Before any run: the cheapest setting that kept the limits on an earlier maneuver of this vehicle
(solver.trade.knowledge), or the rule of thumb of docs/accuracy.md. After some tenths of a full run: the full vehicle
with two coarse steps, one twice the other, from which its limit and the error of its step are estimated, and coarse
runs of its levels held against that limit. None of these is certified.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from solver.errors import MbdError
from solver.trade import reference
from solver.trade.bench import FULL, Bench, cost_of, derived, known, limit_of, run_of
from solver.trade.errors import Requirement
from solver.trade.judging import largest
from solver.trade.knowledge import Knowledge, keeps, maneuver_of
from solver.trade.setting import ITERATIONS, Setting
from solver.trade.variations import AS_GIVEN

RULE, EARLIER, TWIN = 'rule of thumb', 'earlier plans of this vehicle', 'coarse twin'
# Of a limit that an error may take which is not known on this maneuver, or only estimated. Ten times less would answer
# with the full vehicle wherever limits are tight.
KEPT = 0.8
# s, of the full vehicle: the first pair that survives the maneuver
TWINS = ((8e-3, 4e-3), (4e-3, 2e-3), (2e-3, 1e-3), (5e-4, 2.5e-4))
STEPS = (0.02, 0.01, 0.005)  # s, of the levels
DOWN = (0.02, 0.01, 0.008, 0.005, 0.004, 0.003, 0.002, 0.001, 0.0005, 0.00025, 0.000125)  # s, of the full vehicle


class Answer(NamedTuple):
    """A setting that should do. cost: relative to the full vehicle at 1 ms. basis: RULE, EARLIER or TWIN. why: a
    sentence. after: seconds since the plan began. used: largest share of a limit that its errors are estimated to take,
    not a number where nothing is."""

    setting: Setting
    cost: float
    basis: str
    why: str
    after: float = 0.0
    used: float = math.nan


class Rule(NamedTuple):
    """A wish that docs/accuracy.md has measured, and the dearest of the settings that were the cheapest to keep it
    there."""

    quantity: str  # or its head, of those that there are by wheel
    measure: str
    limit: float  # share of the peak, or in the unit of the quantity
    share: bool
    setting: Setting
    cost: float


# The rule of thumb of docs/accuracy.md: of every line of its table the dearest setting, which does on all scenes. Lines
# with a scene that no setting does for are left out. (test/trade/test_first.py reads the page.)
RULES = (
    Rule('yaw_rate', 'rms', 0.05, True, Setting(level='condensed', h=8e-3, iterations=2), 0.065),
    Rule('yaw_rate', 'rms', 0.01, True, Setting(h=4e-3, iterations=2), 0.25),
    Rule(
        'sideslip_velocity',
        'rms',
        0.01,
        True,
        Setting(level='condensed', off=('subframes',), h=2e-3, iterations=2),
        0.18,
    ),
    Rule('roll', 'rms', 0.01, True, Setting(level='kc', h=5e-3, tolerance=1e-4), 0.057),
    Rule('wheel_load', 'rms', 0.01, True, Setting(level='kc', h=4e-3, iterations=1, rho_inf=0.5), 0.051),
    Rule('wheel_load', 'rms', 0.001, True, Setting(h=2e-3, iterations=1), 0.39),
    Rule('position', 'max', 0.1, False, Setting(h=2e-3, iterations=1), 0.39),
)
OTHERWISE = Setting(h=1e-3, iterations=2)


def before_runs(bench: Bench, knowledge: Knowledge) -> Answer:
    """The answer that needs no run."""
    kind = maneuver_of(bench.scene)
    for setting, cost, seen in knowledge.errors(kind):
        if keeps(bench.requirements, seen, KEPT):
            where = (
                f'on {len(seen)} '
                f'maneuver{"s" * (len(seen) > 1)}{" of this kind" if knowledge.of_kind(kind) else " of other kinds"}'
            )
            return Answer(setting, cost, EARLIER, f'it kept these limits {where}')
    if not bench.scene.model.tires:
        return Answer(OTHERWISE, 1.0, RULE, 'a mechanism has no levels of detail')
    rules = [rule_for(r) for r in bench.requirements]
    if any(rule is None for rule in rules):
        return Answer(OTHERWISE, 1.0, RULE, 'docs/accuracy.md has no line for all that is required')
    setting, cost = max(((rule.setting, rule.cost) for rule in rules if rule is not None), key=lambda each: each[1])
    return Answer(setting, cost, RULE, 'it kept such limits on the five scenes of docs/accuracy.md, with another car')


def rule_for(r: Requirement) -> Rule | None:
    """The loosest line of the rule of thumb that is no looser than what is required."""
    head = r.quantity.partition('.')[0]
    wanted = head, r.measure, r.share
    fitting = [rule for rule in RULES if (rule.quantity, rule.measure, rule.share) == wanted and rule.limit <= r.value]
    return max(fitting, key=lambda rule: rule.limit, default=None)


def by_twin(bench: Bench, levels: Sequence[str], say: Callable[[str], None]) -> Answer | None:
    """The answer of coarse runs, on the maneuver of the scene alone; None where the full vehicle survives no pair of
    them. levels: that are asked, cheapest first. Raises Stopped."""
    pair = _pair(bench, say)
    if pair is None:
        return None
    limit, (_, fine) = limit_of(bench, AS_GIVEN, pair), pair
    limits = {r: r.limit(limit.peaks[r.quantity]) for r in bench.requirements}
    own = limit.errors(run_of(bench, AS_GIVEN, fine), bench.required)
    step = {r: r.error(own[r.quantity]) for r in bench.requirements}
    # of the extrapolated limit: of higher order than the error of the finer run
    uncertain = {r: step[r] / 4.0 for r in limits}
    for level in levels:
        base = Setting(level=level)  # type: ignore[arg-type]
        try:
            say(f'first answer: {level}')
            iterations = ITERATIONS[0] if derived(bench, base).engine is not None else 2
            for h in (h for h in STEPS if h <= 0.25 * bench.scene.duration):
                setting = dataclasses.replace(base, h=h, iterations=iterations)
                errors = limit.errors(run_of(bench, AS_GIVEN, setting), bench.required)
                used = largest({r: (r.error(errors[r.quantity]) + uncertain[r]) / limits[r] for r in limits})[1]
                if used <= KEPT:
                    return Answer(
                        setting,
                        _relative(bench, setting),
                        TWIN,
                        'held against the full vehicle with coarse steps',
                        used=used,
                    )
        except MbdError:
            continue
    power = reference.order(bench.scene)
    used = largest({r: step[r] / limits[r] for r in limits})[1]
    for h in DOWN:
        there = used * (h / fine.h) ** power
        if there <= KEPT and h <= 0.25 * bench.scene.duration:
            setting = dataclasses.replace(FULL, h=h, iterations=2)
            why = f'the error of its step is estimated from {1e3 * fine.h:g} ms and the double'
            return Answer(setting, _relative(bench, setting), TWIN, why, used=there)
    return None


def _pair(bench: Bench, say: Callable[[str], None]) -> tuple[Setting, Setting] | None:
    """Two settings of the full vehicle, the first with twice the step of the second, that survive the maneuver."""
    for h in TWINS:
        if h[0] > 0.25 * bench.scene.duration and h != TWINS[-1]:
            continue
        say(f'first answer: full vehicle with {1e3 * h[0]:g} and {1e3 * h[1]:g} ms')
        coarse, fine = (dataclasses.replace(FULL, h=one, iterations=2) for one in h)
        if not any(run_of(bench, AS_GIVEN, one).failure for one in (coarse, fine)):
            return coarse, fine
    return None


def _relative(bench: Bench, setting: Setting) -> float:
    """Cost over that of the full vehicle at 1 ms."""
    return cost_of(bench, setting, known(bench, AS_GIVEN, setting)) / cost_of(bench, OTHERWISE)
