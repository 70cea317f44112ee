"""The cheapest way to simulate a scene that keeps what it requires, found by measuring, and checked where it was not
chosen.

Errors of different origin cancel on one maneuver and not on the next. So an error is bounded by the sum of its parts
(solver.trade.errors) and of the band of the converged full vehicle.

First answers come before the long runs (solver.trade.first). Then settings are tried cheapest first, on growing parts
of the scene's own maneuver (what an error has reached by then it does not lose again) and then on the corners of the
variations (solver.trade.variations); the first whose bounds keep the limits, and whose errors themselves leave MARGIN
of them free, is the cheapest: it is the error that may be larger on maneuvers in between. A run of it must not be
broken (solver.analysis.certificate_coverage); what is merely coarse is measured, and goes with the certificate. When it
is the turn of a level its model error is looked at first: one that is too large by itself takes all its settings out.
Of its level subsystems are then switched off, those first that save most for the error they make, singly and by
exchanging pairs. What remains is checked by its error itself on variations that had no part in the choice. n passes
without failure bound the rate of failures by 1 - 0.05^(1/n) with 95 % confidence [Hanley1983].

A plan may take TIMES times the CPU time of the full run: the scene as it is given, with all of its vehicle. What its
runs were made for is in its ledger.

The file is long because a plan is one search: all of its steps share the allowance, the ledger and what is known so
far. What can be asked without them has its own file (judging, origins, elsewhere).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import os
import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from solver.analysis.departures import Departure
from solver.errors import MbdError, SpecError, StepError
from solver.findings import Finding
from solver.levels import LEVELS
from solver.quantities import names as names_of
from solver.quantities import published
from solver.scene import SUBSYSTEMS, Scene
from solver.trade import cost, elsewhere, first, ledger, reference
from solver.trade.allowance import LONGEST, Allowance
from solver.trade.bench import (
    FULL,
    Bench,
    apart_of,
    converging,
    cost_of,
    derived,
    findings_of,
    forget_starts,
    known,
    run_of,
    second_of,
    simulation,
    start_time_of,
    truth_of,
)
from solver.trade.errors import Requirement, requirements
from solver.trade.first import Answer
from solver.trade.influence import Influence, influences
from solver.trade.judging import MARGIN, Check, Verdict, bands_of, check_whole, judge, largest, limits_of, model_error
from solver.trade.kept_runs import KeptRuns, runs_of
from solver.trade.knowledge import Knowledge
from solver.trade.ledger import Ledger
from solver.trade.runs import Going, Stopped, all_of, departures
from solver.trade.setting import ITERATIONS, RHOS, Setting, baseline, grid
from solver.trade.variations import AS_GIVEN, CORNERS, Variation, effective, inside

CHECK_SHARE = 0.45  # of that which is kept for checking
CHEAPER_SHARE = 0.2  # the same while subsystems are switched off
END_SHARE = 0.05  # the same for what comes after the checks beside runs of what was found: tables, pages
# Two runs of what was found, as mbd run makes them; the recorded one takes up to half as much again
RUNS = 2.5
LEAST_CHECK_SHARE = 0.15  # the same as long as no setting has been found
UNSEEN = 24  # maneuvers to check on: fewer than 12 % fail
MORE_UNSEEN = 59  # where they cost little: fewer than 5 % fail
LITTLE = 0.5  # of what a plan may take: below that it checks on more
CONFIRMS = 0.2  # of the limit that steps may be off by which the second formulation is made with
CLEAR_BAND = 0.1  # of the limit that the band of the reference may take before its steps are refined
STEPS = (0.02, 0.01, 0.008, 0.005, 0.004, 0.003, 0.002, 0.001, 0.0005, 0.00025, 0.000125, 0.0000625)
COARSEST = 4.0  # the first steps of a reference over those of reference.STEPS: 16, 8 and 4 ms
STEP_SETS = tuple(tuple(COARSEST * h / 2**k for h in reference.STEPS) for k in range(6))  # s, of the reference
FINEST = 0.124  # step of a setting over the finest one of the reference, at least
COARSE = 1.5  # of the limit that the model error of a level may be with one coarse step before it is looked at finely
NOTHING = 1e-3  # of a limit: a band that is smaller is rounding, and no sequence
SAME = 1.05  # settings whose costs are nearer than this are equally cheap, and the more accurate one is taken
SAVES = 0.97  # of the cost: what a subsystem must bring it below to be worth its error
TIMED, TIMED_ROUNDS = 1.0, 2  # simulated seconds over which the speed of what was found is measured, and how often
COMPILED = 5.0  # s of CPU time: what takes longer to be ready was compiled just now
EXAMPLE = '{yaw_rate: {rms: 2 %}}'
WATCHED = ('lateral_acceleration', 'longitudinal_acceleration', 'longitudinal_velocity')
WATCHED_WHEELS = ('slip_angle', 'slip', 'wheel_load')
SHOWN = ('yaw_rate', 'sideslip_velocity', 'roll', 'pitch', 'position')
ASKED_FIRST = ('single_track', 'kc', 'condensed')  # levels that a first answer asks, cheapest first
QUICK = ('kc', 'condensed')  # those that are derived in about a second where they are not kept


def falls(bands: dict[Requirement, float], before: dict[Requirement, float]) -> float:
    """Part of the bands of a reference that counts as its error. A band is how far the limit of the coarser steps was
    off. It falls from one reference to the next, and that of the finest limit is the next of the sequence: it is taken
    to fall half as much at least as it did. bands, before: shares of limits, with these steps and with twice these
    (none: not known)."""
    falling = [band / before[r] for r, band in bands.items() if before.get(r, 0.0) > 0.0 and band > NOTHING]
    return min(1.0, 2.0 * max(falling)) if falling else 1.0


class Search:
    """The search for one scene.

    longest, times, startup, ended(): see Allowance. unseen: maneuvers to check on, None: UNSEEN, and more where they
    cost little. progress(text, done): is told what is going on. answer(): is told first answers. keep_in: a directory
    in which whole runs are kept, and found again; none keeps nothing. knowledge: a directory of what plans of a vehicle
    leave to the next one. bench: what was measured so far.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        workers: int | None = None,
        longest: float = LONGEST,
        times: float = math.inf,
        startup: float = 0.0,
        ended: Callable[[], bool] = lambda: False,
        unseen: int | None = None,
        levels: Sequence[str] = tuple(LEVELS),
        progress: Callable[[str, float], None] = lambda text, done: None,
        answer: Callable[[Answer], None] = lambda answer: None,
        keep_in: Path | None = None,
        knowledge: Path | None = None,
    ) -> None:
        required = requirements(scene)
        if not required:
            raise SpecError(
                f'scene {scene.name!r}: no accuracy is required, so there is nothing to plan; add e.g. require: '
                f'{EXAMPLE}'
            )
        self.ledger = Ledger()
        self.allowance = Allowance(longest, times, startup, ended, lambda: self.ledger.once)
        self.workers, self._progress, self._answer = workers, progress, answer
        self.at_once = workers or os.cpu_count() or 1  # starts may be sought at the same time
        self.unseen, self.most_unseen = unseen or UNSEEN, unseen or MORE_UNSEEN
        self.candidate_levels = ('full', *levels)
        channels = published(scene.model)
        known_names = names_of(channels)
        wheels = [f'{n}.{w}' for n in WATCHED_WHEELS for w in channels.wheels]
        loads = [n for n in wheels if n.startswith('wheel_load')]
        self.names = list(dict.fromkeys(r.quantity for r in required))
        self.watched = [n for n in (*WATCHED, *wheels) if n in known_names]
        self.shown = [*dict.fromkeys([*self.names, *(n for n in SHOWN if n in known_names), *loads])]
        everything = tuple(dict.fromkeys([*self.shown, *self.watched]))
        self.scene = dataclasses.replace(scene, fidelity='full', switches={}, resolved='')
        self.kept = KeptRuns(keep_in, runs_of(self.scene) if keep_in else '', everything)
        self.knowledge = Knowledge(knowledge, self.scene)
        made: dict[tuple[Hashable, ...], Any] = {
            ('price', model): price for model, price in self.knowledge.prices().items()
        }
        self.bench = Bench(
            self.scene, everything, self.step_sets()[0], required, self.different((AS_GIVEN, *CORNERS)),
            stop=lambda ahead=0.0: self.allowance.late(ahead * self.at_once),
            kept=self.kept, ledger=self.ledger, made=made,
        )  # fmt: skip
        self.notes: list[str] = []
        self.answers: list[Answer] = []
        self.tried: list[Verdict] = []
        self.levels: dict[str, str] = {}  # level that was looked at -> why it is out, '' where it is not
        self.influences: list[Influence] = []
        self.second: dict[str, Departure] = {}
        self.checks: list[Check] = []
        self.result: Verdict | None = None
        self.ended = False  # before the search had come to an end, by time
        # what the reference does not resolve itself, by the quantity of the finding
        self.coarse: dict[str, Finding] = {}
        self.unchecked: list[Check] = []  # unseen maneuvers on which the full vehicle itself cannot be simulated

    @property
    def took(self) -> float:
        """Seconds since the beginning."""
        return self.allowance.took

    def say(self, text: str, purpose: str = '') -> None:
        """Tell what is being done, and the share of what it may take that is gone. purpose: of the runs from now on."""
        self.ledger.purpose = purpose or self.ledger.purpose
        self._progress(text, min(1.0, self.allowance.spent))

    def price_full(self) -> None:
        """Find out what the full run takes: its start, and its steps by their counters."""
        base = dataclasses.replace(baseline(self.scene), h=self.scene.integrator.h)
        steps = self.scene.duration * cost_of(self.bench, base)
        self.allowance.full_run = self.allowance.startup + start_time_of(self.bench, FULL) + steps

    def saves(self, setting: Setting) -> float:
        """CPU time [s] by which a run of a setting is cheaper than the full run, with its start."""
        steps = self.scene.duration * cost_of(self.bench, setting, known(self.bench, AS_GIVEN, setting))
        return self.allowance.full_run - self.allowance.startup - start_time_of(self.bench, setting) - steps

    def timing(self, setting: Setting) -> float:
        """CPU time [s] of costs()."""
        each = cost_of(self.bench, setting) + cost_of(self.bench, baseline(self.scene))
        return TIMED_ROUNDS * min(TIMED, self.scene.duration) * each

    def running(self, setting: Setting) -> float:
        """CPU time [s] of two runs of a setting, one of them recorded, that a plan makes at its end."""
        return RUNS * (self.allowance.full_run - self.allowance.startup - self.saves(setting))

    def closing(self, setting: Setting) -> float:
        """Share of the whole that costs() and the last two runs of a setting take."""
        whole = self.allowance.times * self.allowance.full_run
        return min(CHECK_SHARE, (self.timing(setting) + self.running(setting)) / whole)

    def tell(self, answer: Answer | None) -> None:
        """A first answer, told when it is known."""
        if answer is not None:
            self.answers.append(answer._replace(after=self.took))
            self._answer(self.answers[-1])

    def different(self, variations: Iterable[Variation]) -> tuple[Variation, ...]:
        """Those that lead to different maneuvers."""
        return tuple(dict.fromkeys(effective(self.scene, v) for v in variations))

    def points(self, count: int) -> list[Variation]:
        """Up to so many maneuvers inside the ranges that had no part in the choice; none of a scene in which nothing
        can be varied."""
        seen = self.bench.seen
        return [v for v in self.different(inside(k) for k in range(count + len(seen))) if v not in seen][:count]

    def step_sets(self) -> list[tuple[float, ...]]:
        """Steps that a reference may have; the scene has room for some of the coarsest."""
        return [
            steps for steps in STEP_SETS if steps[0] <= 0.05 * self.scene.duration or steps[0] <= reference.STEPS[0]
        ]

    # -- the phases ---------------------------------------------------------------------------------------------------

    def find_first(self) -> None:
        """Answer from a few coarse runs."""
        known_levels = {*QUICK, *self.knowledge.derived} & {*self.candidate_levels} if self.scene.model.tires else set()
        say = partial(self.say, purpose=ledger.FIRST)
        with suppress(MbdError):  # whatever it is, the search finds out and tells
            self.tell(first.by_twin(self.bench, [level for level in ASKED_FIRST if level in known_levels], say))

    def find_reference(self) -> bool:
        """Choose steps fine enough for the limits; False where the band stays too wide for one of them, or a second
        formulation does not confirm it. Raises StepError."""
        before: dict[Requirement, float] = {}
        for steps in self.step_sets():
            bench = self.bench = dataclasses.replace(self.bench, steps=steps)
            self.say(f'reference with {", ".join(f"{1e3 * h:g}" for h in steps)} ms', ledger.REFERENCE)
            all_of(lambda h: self.look_at(AS_GIVEN, Setting(h=h)), steps, self.workers)
            try:
                limits = limits_of(bench, AS_GIVEN)
            except StepError:  # a step that a run does not survive: there may be shorter ones
                if steps == STEP_SETS[-1]:
                    raise
                continue
            whole = {
                r: band / limits[r] for r, band in bands_of(dataclasses.replace(bench, falls=1.0), AS_GIVEN).items()
            }
            bench = self.bench = dataclasses.replace(bench, falls=falls(whole, before))
            before = whole
            worst, share = largest({r: bench.falls * whole[r] for r in limits})
            if share <= CLEAR_BAND and not self.unresolved():
                break
        if not share <= 1.0 - MARGIN:
            self.notes.append(
                f'{worst}: the reference itself is uncertain by {share:.2g} of the limit, with '
                f'{1e3 * bench.steps[-1]:g} ms'
            )
            return False
        self.say('second formulation of the reference', ledger.SECOND)
        self.second = second_of(bench, self.steps_of_second(limits))
        worst, share = largest({r: r.error(self.second[r.quantity]) / limits[r] for r in limits})
        if not share <= 1.0 - MARGIN:
            self.notes.append(
                f'{worst}: the reference is not confirmed, a second formulation departs from it by {share:.2g} of the '
                'limit'
            )
            return False
        self.say('references of the corners', ledger.REFERENCE)
        bench = self.bench = dataclasses.replace(bench, apart=elsewhere.chosen(bench, Setting(level='kc')))
        corners = [v for v in bench.seen if v != AS_GIVEN]
        used = bench.apart or converging(FULL, bench.steps[1:])
        all_of(lambda each: findings_of(bench, *each), [(v, used[-1]) for v in corners], self.workers)
        for v in corners:
            try:
                truth_of(bench, v)
            except MbdError as error:
                self.bench = dataclasses.replace(self.bench, seen=tuple(one for one in self.bench.seen if one != v))
                self.notes.append(f'the corner {v} of the variations is left out: {error}')
        for v in self.bench.seen:
            finest_run = Setting(h=bench.steps[-1]) if v == AS_GIVEN else used[-1]
            for finding in elsewhere.unresolved(bench, v, finest_run):
                self.coarse.setdefault(finding.quantity, finding)
        return True

    def steps_of_second(self, limits: dict[Requirement, float]) -> tuple[float, ...]:
        """The coarsest pair of steps that confirms the reference: with them its own formulation is near to it."""
        steps = sorted({h for steps in self.step_sets() for h in steps if h >= self.bench.steps[-1]}, reverse=True)
        for pair in itertools.pairwise(steps[:-1]):
            both = converging(FULL, pair)
            if all((run := known(self.bench, AS_GIVEN, one)) and not run.failure for one in both):
                errors = apart_of(self.bench, both)
                if all(r.error(errors[r.quantity]) <= CONFIRMS * limits[r] for r in limits):
                    return pair
        return self.bench.steps[-2:]

    def look_at(self, v: Variation, setting: Setting) -> None:
        """Make a run of the reference, the finest one with what would make it suspect."""
        (findings_of if setting.h == self.bench.steps[-1] else run_of)(self.bench, v, setting)

    def unresolved(self) -> list[Finding]:
        """Findings of the finest run of the reference that it does not resolve."""
        return elsewhere.unresolved(self.bench, AS_GIVEN, Setting(h=self.bench.steps[-1]))

    def judged_by(self, setting: Setting, small: float = elsewhere.SMALL) -> Bench:
        """The bench with the references on other maneuvers that are fine enough for a setting. small: see
        elsewhere.chosen()."""
        before, self.ledger.purpose = self.ledger.purpose, ledger.REFERENCE
        try:
            return dataclasses.replace(self.bench, apart=elsewhere.chosen(self.bench, setting, small))
        finally:
            self.ledger.purpose = before

    def find_levels(self) -> list[Setting]:
        """The levels that the vehicle has; self.levels says why it has not the others."""
        found = [FULL]
        for level in self.candidate_levels[1:]:
            base = Setting(level=level)  # type: ignore[arg-type]
            try:
                self.say(f'deriving {level}', ledger.LEVELS)
                derived(self.bench, base)
            except MbdError as error:
                self.levels[level] = str(error)
                continue
            found.append(base)
        return found

    def _is_out(self, level: str) -> bool:
        """True where the model error of a level alone is too large; it is looked at once, with one coarse step."""
        if level not in self.levels:
            self.say(f'model error of {level}', ledger.LEVELS)
            self.levels[level] = self._out(Setting(level=level))  # type: ignore[arg-type]
        return bool(self.levels[level])

    def _out(self, base: Setting) -> str:
        """Why a model cannot keep the limits whatever its step, or '': on the maneuver of the scene, against the full
        vehicle with the same coarse step. Errors of the step are nearly the same in both; what is left of them is far
        below COARSE - 1 of a limit."""
        if base.model == FULL.model:
            return ''
        try:
            derived(self.bench, base)
            h = self.bench.steps[0]
            found, whole = (run_of(self.bench, AS_GIVEN, reference.with_step(one, h)) for one in (base, FULL))
            if found.failure or whole.failure:
                return ''
            truth, limits = truth_of(self.bench, AS_GIVEN), limits_of(self.bench, AS_GIVEN)
        except Stopped:
            raise
        except MbdError as error:
            return str(error)
        errors = departures(found, whole.time, whole.curves, truth.quantities, truth.peaks, self.bench.required)
        worst, share = largest({r: r.error(errors[r.quantity]) / limits[r] for r in limits})
        if math.isinf(share):
            there = worst.quantity in found.curves
            return (
                f'{worst}: it changes in another way than in the full vehicle'
                if there
                else f'{worst.quantity} is not modelled'
            )
        return (
            ''
            if share <= COARSE
            else f'{worst}: its model error alone is {share:.2g} of the limit, with {1e3 * h:g} ms'
        )

    def _look_again(self, level: str) -> None:
        """Take a level out whose converged model error is too large on a maneuver that serves to choose. It is looked
        at when a setting of the level keeps the limits on the maneuver of the scene, if only because its errors
        cancel."""
        base = Setting(level=level)  # type: ignore[arg-type]
        for v in self.bench.seen if level != FULL.level else ():
            try:
                limits, errors = limits_of(self.bench, v), model_error(self.bench, v, base)
            except Stopped:
                raise
            except MbdError as error:
                self.levels[level] = str(error)
                return
            worst, share = largest({r: errors[r] / limits[r] for r in limits})
            if not share <= 1.0:
                self.levels[level] = f'{worst}: its model error alone is {share:.2g} of the limit on {v}'
                return

    def candidates(self, models: Sequence[Setting]) -> list[Setting]:
        """All settings of these models, cheapest first.

        Their steps go down to an eighth of the finest one of the reference: a run is judged by the limit of those, with
        its band, which lies far below all limits also where the error of the finest does not. A level with a step of
        its own makes no iterations and knows no damping: it has one setting a step.
        """
        steps = [h for h in STEPS if h >= FINEST * self.bench.steps[-1] and h <= 0.25 * self.scene.duration]
        found = []
        for m in models:
            ways = 1 if derived(self.bench, m).engine is not None else None  # how many of each
            found += grid(m, steps, ITERATIONS[:ways], RHOS[:ways])
        return sorted(found, key=lambda s: (cost_of(self.bench, s), -s.h))

    def cheapest(self, models: Sequence[Setting], below: float = math.inf) -> Verdict | None:
        """The cheapest setting that keeps everything, the more accurate of equals; None where there is none."""
        best: Verdict | None = None
        looked_at: set[str] = set()
        for setting in self.candidates(models):
            if cost_of(self.bench, setting) > (below if best is None else SAME * best.cost):
                break
            if not setting.off and self._is_out(setting.level):
                continue
            self.say(str(setting), ledger.SEARCH)
            try:
                verdict = judge(self.judged_by(setting), setting, self.workers)
                self.tried.append(verdict)
                if (
                    verdict.dropped
                    and not setting.off
                    and known(self.bench, AS_GIVEN, setting)
                    and setting.level not in looked_at
                ):
                    looked_at.add(setting.level)
                    self._look_again(setting.level)
            except Stopped:
                if best is None:
                    raise
                break
            if verdict.dropped or verdict.cost > below:
                continue
            self.allowance.until = min(self.allowance.until, 1.0 - CHECK_SHARE)
            if (
                best is None
                or verdict.cost * SAME < best.cost
                or (verdict.cost <= SAME * best.cost and verdict.used < best.used)
            ):
                best = verdict
        return best

    def eliminate(self, best: Verdict) -> Verdict:
        """Switch subsystems off as long as that is cheaper and keeps everything: one after the other, then by
        exchanging pairs.

        A level with a step of its own costs the same whatever is off.
        """
        base = dataclasses.replace(best.setting, off=())
        if derived(self.bench, base).engine is not None:
            return best
        self.allowance.until = max(self.allowance.until, 1.0 - CHEAPER_SHARE)  # a cheaper setting is worth some checks
        self.say('what subsystems save', ledger.SUBSYSTEMS)
        saved = self.knowledge.saved(base, run_of(self.bench, AS_GIVEN, base).counters['evaluations'])
        say = partial(self.say, purpose=ledger.SUBSYSTEMS)
        for one in influences(self.bench, base, self.shown, say, saved, SAVES):
            self.influences.append(one)
        gains = [i for i in self.influences if i.errors and not i.failure]

        def price(i: Influence) -> float:
            """Error per saving; the largest share of a peak among what is required."""
            return max(i.errors[n] for n in self.names) / (1.0 - i.cost)

        for i in sorted(gains, key=price):
            best = self._better(best, tuple(s for s in SUBSYSTEMS if s in (*best.setting.off, i.subsystem)))
        left = [i.subsystem for i in gains if i.subsystem not in best.setting.off]
        for out in best.setting.off:
            for into in left:
                if out in best.setting.off:
                    best = self._better(
                        best, tuple(s for s in SUBSYSTEMS if (s in best.setting.off and s != out) or s == into)
                    )
        return best

    def _better(self, best: Verdict, off: tuple[str, ...]) -> Verdict:
        """The setting with these subsystems off if it keeps everything and is cheaper, else the one before."""
        setting = dataclasses.replace(best.setting, off=off)
        try:
            if cost_of(self.bench, setting, run_of(self.bench, AS_GIVEN, best.setting)) > SAVES * best.cost:
                return best
        except MbdError:
            return best
        self.say(str(setting), ledger.SEARCH)
        verdict = judge(self.judged_by(setting), setting, self.workers)
        self.tried.append(verdict)
        return best if verdict.dropped else verdict

    def check_unseen(self, setting: Setting) -> list[Check]:
        """Checks on variations inside the ranges, as many as may be made, and more where they cost little; the first
        failure of the setting ends them."""
        found: list[Check] = []
        bench, size = self.judged_by(setting, elsewhere.SMALL_THERE), max(2, self.workers or 2)
        points = self.points(self.most_unseen)
        wanted = min(self.unseen, len(points))

        def checked(v: Variation) -> Check:
            one = check_whole(bench, v, setting)
            forget_starts(bench, v)
            return one

        for k in range(0, len(points), size):
            before = self.allowance.spent
            if k >= wanted and before > LITTLE:
                break
            self.say(f'checking {setting} on unseen maneuvers: {len(found)} of {max(wanted, k)}', ledger.UNSEEN)
            try:
                found += all_of(checked, points[k : k + size], self.workers)
            except Stopped:
                break
            if any(not c.passed and not c.unjudged for c in found):
                break
            if (now := self.allowance.spent) + 1.2 * (now - before) > self.allowance.until:
                break
        if len(found) < wanted and all(c.passed for c in found):
            self.notes.append(f'{len(found)} of {wanted} unseen maneuvers were checked; {self.allowance.why_ended()}')
        without = [c for c in found if c.unjudged]
        self.notes += [f'no check on {c.variation}: {c.failure}' for c in without]
        self.unchecked = without
        return [c for c in found if c not in without]

    def find(self) -> Verdict | None:
        """The whole search. self.checks are those of the result; None where nothing keeps what is required, or time is
        up."""
        self.tell(first.before_runs(self.bench, self.knowledge))
        self.say('compiling')
        compiled = time.process_time()
        Going(self.scene, baseline(self.scene), []).to(min(0.01, self.scene.duration))
        # what is compiled once is not time of the plan, what is loaded every time is
        if time.process_time() - compiled > COMPILED:
            self.allowance.begin_again()
        best: Verdict | None = None
        models: list[Setting] = []
        try:
            self.say('first answer', ledger.PRICES)
            self.price_full()
            self.allowance.until = 1.0 - LEAST_CHECK_SHARE
            self.find_first()
            if not self.find_reference():
                return None
            models = self.find_levels()
            best = self.cheapest(models)
            if best is not None:
                best = self.eliminate(best)
        except Stopped:
            self.ended = True
            self.notes.append(
                f'the search was ended: {self.allowance.why_ended()}; what it had found by then is what counts'
            )
        while best is not None:
            # cheapest() leaves it shorter whenever it finds something
            self.allowance.until = 1.0 - END_SHARE - self.closing(best.setting)
            self.checks = self.check_unseen(best.setting)
            bad = [c for c in self.checks if not c.passed]
            failed = [c.variation for c in bad]
            if not bad:
                self.result = best
                return best
            why = (
                f'{bad[0].failure or f"{bad[0].worst}: {bad[0].used:.2g} of its limit"} on a maneuver that was '
                f'unseen ({failed[0]})'
            )
            self.notes.append(f'{best.setting} failed on {failed[0]}, which has served to choose from then on')
            self.tried = [
                t if t is not best else t._replace(dropped=why, error=max(t.error, *(c.used for c in bad)))
                for t in self.tried
            ]
            self.bench = dataclasses.replace(self.bench, seen=(*self.bench.seen, *failed))
            try:
                # the others are looked at again
                self.levels = {level: why for level, why in self.levels.items() if why}
                again = Setting(level=best.setting.level, off=best.setting.off)
                best = self.cheapest([*models, again] if again.off else models)
            except Stopped:
                self.ended = True
                self.notes.append('time was up before another setting was found')
                return None
        return None

    def costs(self, setting: Setting) -> tuple[cost.Cost, cost.Cost]:
        """(of the setting, of the full vehicle at 1 ms), measured in turn; by their counters where one of them cannot
        be run, or no time is left."""
        self.say('measuring costs', ledger.PRICES)
        both = setting, baseline(self.scene)
        try:
            if self.allowance.fits(self.timing(setting)):
                with self.ledger.timed():
                    make = partial(simulation, self.bench, AS_GIVEN)
                    of, full = cost.compared(self.scene, both, seconds=TIMED, rounds=TIMED_ROUNDS, make=make)
                return of, full
        except Stopped:
            pass
        except MbdError as error:
            self.notes.append(f'costs are those of a step times the number of steps, for a run to time fails: {error}')
        of, full = (cost.Cost(each, each) for each in (cost_of(self.bench, one) for one in both))
        return of, full

    def learn(self) -> None:
        """Leave to the next plan of this vehicle what this one has measured."""
        self.knowledge.learn_from(self.bench, self.shown)
