"""The cheapest way to simulate a scene that keeps what it requires, found by measuring, and checked where it was not chosen.

Errors of different origin cancel on one maneuver and not on the next. So an error is bounded by the sum of four, each measured:

    model      converged level without its switched-off subsystems, against the converged full vehicle
    step       the setting iterated to tolerance, against the converged level
    iteration  the setting with its iterations, against the same iterated to tolerance
    reference  band of the converged full vehicle

Settings are tried cheapest first, on growing parts of the scene's own maneuver (what an error has reached by then it
does not lose again) and then on the corners of the variations (solver.trade.variations); the first whose bounds keep
the limits, and whose errors themselves leave MARGIN of them free, is the cheapest: it is the error that may be larger
on maneuvers in between. A run of it must not be broken (solver.analysis.certificate_coverage); what is merely coarse is
measured, and goes with the certificate. When it is the turn of a level its model error is looked at first: one that is
too large by itself takes all its settings out. Of its level subsystems are then switched off, those first that save
most for the error they make, singly and by exchanging pairs. What remains is checked by its error itself on variations
that had no part in the choice. n passes without failure bound the rate of failures by 3/n with 95 % confidence
[Hanley1983].
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from pathlib import Path

from solver.analysis.departures import Departure
from solver.checks.registry import BY_NAME
from solver.errors import MbdError, StepError
from solver.findings import Finding
from solver.levels import LEVELS, derive
from solver.scene import SUBSYSTEMS, Scene
from solver.trade import cost, reference
from solver.trade.activity import of_subsystems
from solver.trade.judging import MARGIN, Judge
from solver.trade.measurements import ITERATIONS, STEP_SETS
from solver.trade.runs import Going, Stopped, all_of, clock, departures
from solver.trade.setting import Setting, baseline
from solver.trade.variations import AS_GIVEN, Variation
from solver.trade.verdicts import Check, Influence, Verdict

LONGEST = 170.0  # s that a plan may take
CHECK_SHARE = 0.45  # of that which is kept for checking
LEAST_CHECK_SHARE = 0.15  # the same as long as no setting has been found
UNSEEN = 24
CLEAR_BAND = 0.1  # of the limit that the band of the reference may take before its steps are refined
STEPS = (0.02, 0.01, 0.008, 0.005, 0.004, 0.003, 0.002, 0.001, 0.0005, 0.00025, 0.000125, 0.0000625)
RHOS = (0.8, 0.5)
SAME = 1.05  # settings whose costs are nearer than this are equally cheap, and the more accurate one is taken
SAVES = 0.97  # of the cost: what a subsystem must bring it below to be worth its error


class Search(Judge):
    """The search for one scene, in at most `longest` seconds. keep_in: see Measurements."""

    def __init__(
        self,
        scene: Scene,
        *,
        workers: int | None = None,
        longest: float = LONGEST,
        unseen: int = UNSEEN,
        levels: Sequence[str] = tuple(LEVELS),
        progress: Callable[[str, float], None] = lambda text, done: None,
        keep_in: Path | None = None,
    ) -> None:
        super().__init__(scene, workers=workers, longest=longest, progress=progress, keep_in=keep_in)
        self.unseen = unseen
        self.candidate_levels = ('full', *levels)
        self.notes: list[str] = []
        self.tried: list[Verdict] = []
        self.levels: dict[str, str] = {}  # level that was looked at -> why it is out, '' where it is not
        self.influences: list[Influence] = []
        self.second: dict[str, Departure] = {}
        self.checks: list[Check] = []
        self.result: Verdict | None = None
        self.ended = False  # before the search had come to an end, by time
        self.coarse: dict[str, Finding] = {}  # what the reference does not resolve itself, by the quantity of the finding
        self.unchecked: list[Check] = []  # unseen maneuvers on which the full vehicle itself cannot be simulated

    # -- the phases ----------------------------------------------------------------------------------------------------

    def find_reference(self) -> bool:
        """Choose steps fine enough for the limits; False where the band stays too wide for one of them, or a second formulation does not
        confirm it. Raises StepError."""
        for steps in STEP_SETS:
            self.steps = steps
            self.say(f'reference with {", ".join(f"{1e3 * h:g}" for h in steps)} ms')
            all_of(lambda h: self.look_at(AS_GIVEN, Setting(h=h)), steps, self.workers)
            try:
                limits = self.limits(AS_GIVEN)
            except StepError:  # a step that a run does not survive: there may be shorter ones
                if steps == STEP_SETS[-1]:
                    raise
                continue
            peaks = self.truth(AS_GIVEN).peaks
            shares = {r: self.uncertainty(r, peaks[r.quantity]) / limits[r] for r in self.requirements}
            if max(shares.values()) <= CLEAR_BAND and not self.unresolved(AS_GIVEN):
                break
        worst = max(shares, key=lambda r: shares[r])
        if not shares[worst] <= 1.0 - MARGIN:
            self.notes.append(
                f'{worst}: the reference itself is uncertain by {shares[worst]:.2g} of the limit, with {1e3 * self.steps[-1]:g} ms'
            )
            return False
        self.say('second formulation of the reference, and references of the corners')
        corners = [v for v in self.seen if v != AS_GIVEN]
        clear = shares[worst] <= CLEAR_BAND  # then its coarser pair confirms as much

        def confirm() -> None:
            self.second = reference.second_formulation(self.scene, self.truth(AS_GIVEN), self.late, finest=not clear, kept=self.kept)

        runs = [(v, reference.with_step(Setting(), h)) for h in self.steps[::-1] for v in corners]
        all_of(lambda job: self.look_at(*job) if job else confirm(), [None, *runs], self.workers)
        apart = {r: r.error(self.second[r.quantity]) / limits[r] for r in self.requirements}
        worst = max(apart, key=lambda r: apart[r])
        if not apart[worst] <= 1.0 - MARGIN:
            self.notes.append(
                f'{worst}: the reference is not confirmed, a second formulation departs from it by {apart[worst]:.2g} of the limit'
            )
            return False
        for v in corners:
            try:
                self.truth(v)
            except MbdError as error:
                self.seen.remove(v)
                self.notes.append(f'the corner {v} of the variations is left out: {error}')
        for v in self.seen:
            self.coarse |= {finding.quantity: finding for finding in self.unresolved(v) if finding.quantity not in self.coarse}
        return True

    def look_at(self, v: Variation, setting: Setting) -> None:
        """Make a run of the reference, the finest one with what would make it suspect."""
        if setting.h == self.steps[-1]:
            self.findings(v, setting)
        else:
            self.run(v, setting)

    def unresolved(self, v: Variation) -> list[Finding]:
        """What the finest run of the reference does not resolve: steps that all damp a vibration away agree on a motion without it."""
        return [f for f in self.findings(v, Setting(h=self.steps[-1])) if BY_NAME[f.quantity].unresolved and not f.required]

    def find_levels(self) -> list[Setting]:
        """The levels that the vehicle has; self.levels says why it has not the others."""
        found = [Setting()]
        for level in self.candidate_levels[1:]:
            base = Setting(level=level)  # type: ignore[arg-type]
            try:
                self.say(f'deriving {level}')
                derive(base.of(self.scene))
            except MbdError as error:
                self.levels[level] = str(error)
                continue
            found.append(base)
        return found

    def _is_out(self, level: str) -> bool:
        """Whether the model error of a level alone is too large, looked at once."""
        if level not in self.levels:
            self.say(f'model error of {level}')
            self.levels[level] = self._out(Setting(level=level))  # type: ignore[arg-type]
        return bool(self.levels[level])

    def _out(self, base: Setting) -> str:
        """Why a model cannot keep the limits whatever its step, or ''."""
        if base.model == Setting().model:
            return ''
        try:
            derive(base.of(self.scene))
        except MbdError as error:
            return str(error)
        for v in self.seen:
            try:
                all_of(lambda h: self.run(v, reference.with_step(base, h)), self.steps[1:], self.workers)  # noqa: B023
                limits, errors = self.limits(v), self.model_error(v, base)
            except Stopped:
                raise
            except MbdError as error:
                return str(error)
            shares = {r: errors[r] / limits[r] for r in self.requirements}
            worst = max(shares, key=lambda r: shares[r])
            if not shares[worst] <= 1.0:
                if math.isinf(shares[worst]):
                    there = worst.quantity in self.limit_of(v, base, self.steps[1:]).curves
                    return f'{worst}: it changes in another way than in the full vehicle' if there else f'{worst.quantity} is not modelled'
                return f'{worst}: its model error alone is {shares[worst]:.2g} of the limit on {v}'
        return ''

    def candidates(self, models: Sequence[Setting]) -> list[Setting]:
        """All settings of these models, cheapest first.

        Their steps go down to half the finest one of the reference: a run is judged by the limit of those, with its band, which lies far
        below all limits also where the error of the finest does not. A level with a step of its own makes no iterations and knows no
        damping: it has one setting a step.
        """
        steps = [h for h in STEPS if h >= 0.49 * self.steps[-1] and h <= 0.25 * self.scene.duration]
        found = []
        for m in models:
            own = derive(m.of(self.scene)).engine is not None
            ways = [(ITERATIONS[0], RHOS[0])] if own else itertools.product(ITERATIONS, RHOS)
            found += [dataclasses.replace(m, h=h, iterations=n, rho_inf=rho) for n, rho in ways for h in steps]
        return sorted(found, key=lambda s: (self.expected(s), -s.h))

    def cheapest(self, models: Sequence[Setting], below: float = math.inf) -> Verdict | None:
        """The cheapest setting that keeps everything, the more accurate of equals; None where there is none."""
        best: Verdict | None = None
        for setting in self.candidates(models):
            expected = self.expected(setting)
            if expected > (below if best is None else SAME * best.cost):
                break
            if not setting.off and self._is_out(setting.level):
                continue
            self.say(str(setting))
            try:
                verdict = self.judge(setting)
            except Stopped:
                if best is None:
                    raise
                break
            self.tried.append(verdict)
            if verdict.dropped or verdict.cost > below:
                continue
            self.until = min(self.until, (1.0 - CHECK_SHARE) * self.longest)
            if best is None or verdict.cost * SAME < best.cost or (verdict.cost <= SAME * best.cost and verdict.used < best.used):
                best = verdict
        return best

    def influence(self, base: Setting) -> list[Influence]:
        """What each subsystem does to each quantity when it is left out, alone, at one and the same integration."""
        self.say('activity of the subsystems')
        try:
            activity = of_subsystems(self.scene, self.scene.duration)
        except MbdError:
            activity = {}
        before = self.run(AS_GIVEN, base)
        truth, whole, size = self.truth(AS_GIVEN), self.per_step(base), cost.size(self.scene, base)
        evaluations = before.counters['evaluations']
        order = sorted(activity, key=lambda s: activity[s])
        for subsystem in order:
            self.say(f'without {subsystem}')
            setting = dataclasses.replace(base, off=(subsystem,))
            try:
                same = cost.size(self.scene, setting) == size
                share = 1.0 if same else self.per_step(setting).of(1.0, evaluations) / whole.of(1.0, evaluations)
            except MbdError as error:
                self.influences.append(Influence(subsystem, activity[subsystem], {}, 1.0, str(error)))
                continue
            found = self.run(AS_GIVEN, setting)
            errors = departures(found, before.time, before.curves, truth.quantities, truth.peaks)
            shares = {name: errors[name].rms / truth.peaks[name] for name in self.shown}
            self.influences.append(Influence(subsystem, activity[subsystem], shares, share, found.failure))
        return self.influences

    def eliminate(self, best: Verdict) -> Verdict:
        """Switch subsystems off as long as that is cheaper and keeps everything: one after the other, then by exchanging pairs.

        A level with a step of its own costs the same whatever is off; their influence is then that on the full vehicle.
        """
        if derive(best.setting.of(self.scene)).engine is not None:
            self.influence(Setting(h=self.steps[0], iterations=ITERATIONS[1]))
            return best
        gains = [i for i in self.influence(dataclasses.replace(best.setting, off=())) if not i.failure and i.cost < SAVES]

        def price(i: Influence) -> float:
            """Error per saving; the largest share of a peak among what is required."""
            return max(i.errors[n] for n in self.names) / (1.0 - i.cost)

        for i in sorted(gains, key=price):
            best = self._better(best, tuple(s for s in SUBSYSTEMS if s in (*best.setting.off, i.subsystem)))
        left = [i.subsystem for i in gains if i.subsystem not in best.setting.off]
        for out in best.setting.off:
            for into in left:
                if out in best.setting.off:
                    best = self._better(best, tuple(s for s in SUBSYSTEMS if (s in best.setting.off and s != out) or s == into))
        return best

    def _better(self, best: Verdict, off: tuple[str, ...]) -> Verdict:
        """The setting with these subsystems off if it keeps everything and is cheaper, else the one before."""
        setting = dataclasses.replace(best.setting, off=off)
        try:
            if self.expected(setting, self.run(AS_GIVEN, best.setting)) > SAVES * best.cost:
                return best
        except MbdError:
            return best
        self.say(str(setting))
        why = self._out(dataclasses.replace(setting, iterations=None))
        verdict = self.judge(setting) if not why else Verdict(setting, math.inf, best.cost, '', why, {})
        self.tried.append(verdict)
        return best if verdict.dropped else verdict

    def check_unseen(self, setting: Setting) -> list[Check]:
        """Checks on variations inside the ranges, as many as there is time for; stops at the first failure of the setting."""
        found: list[Check] = []
        size = max(2, self.workers or 2)
        points = self.points(self.unseen)
        for k in range(0, len(points), size):
            begin = clock()
            self.say(f'checking {setting} on unseen maneuvers: {len(found)} of {self.unseen}')
            try:
                found += all_of(lambda v: self.check_whole(setting, v), points[k : k + size], self.workers)
            except Stopped:
                break
            if any(not c.passed and not c.failure.startswith('the reference') for c in found):
                break
            if self.took + 1.2 * (clock() - begin) > self.until:
                break
        if len(found) < len(points) and all(c.passed for c in found):
            self.notes.append(f'{len(found)} of {len(points)} unseen maneuvers were checked in the time there was (mbd plan --time)')
        without = [c for c in found if c.failure.startswith('the reference')]
        self.notes += [f'no check on {c.variation}: {c.failure}' for c in without]
        self.unchecked = without
        return [c for c in found if c not in without]

    def find(self) -> Verdict | None:
        """The whole search. self.checks are those of the result; None where nothing keeps what is required, or time is up."""
        self.say('compiling')
        Going(self.scene, baseline(self.scene), []).to(min(0.01, self.scene.duration))
        self.begin, self.until = clock(), (1.0 - LEAST_CHECK_SHARE) * self.longest  # what is compiled once is not time of the plan
        best: Verdict | None = None
        models: list[Setting] = []
        try:
            if not self.find_reference():
                return None
            models = self.find_levels()
            best = self.cheapest(models)
            if best is not None:
                best = self.eliminate(best)
        except Stopped:
            self.ended = True
            self.notes.append(f'the search was ended after {self.took:.0f} s; what it had found by then is what counts (mbd plan --time)')
        while best is not None:
            self.until = self.longest  # cheapest() leaves it shorter whenever it finds something
            self.checks = self.check_unseen(best.setting)
            bad = [c for c in self.checks if not c.passed]
            failed = [c.variation for c in bad]
            if not bad:
                self.result = best
                return best
            why = f'{bad[0].failure or f"{bad[0].worst}: {bad[0].used:.2g} of its limit"} on a maneuver that was unseen ({failed[0]})'
            self.notes.append(f'{best.setting} failed on {failed[0]}, which has served to choose from then on')
            self.tried = [t if t is not best else t._replace(dropped=why, error=max(t.error, *(c.used for c in bad))) for t in self.tried]
            self.seen += failed
            try:
                self.levels = {level: why for level, why in self.levels.items() if why}  # the others are looked at again
                again = Setting(level=best.setting.level, off=best.setting.off)
                best = self.cheapest([*models, again] if again.off and not self._out(again) else models)
            except Stopped:
                self.ended = True
                self.notes.append('time was up before another setting was found')
                return None
        return None

    def costs(self, setting: Setting) -> tuple[cost.Cost, cost.Cost]:
        """(of the setting, of the full vehicle at 1 ms), measured in turn; by their counters where one of them cannot be run."""
        self.say('measuring costs')
        both = setting, baseline(self.scene)
        try:
            of, full = cost.compared(self.scene, both)
        except MbdError as error:
            self.notes.append(f'costs are those of a step times the number of steps, for a run to time fails: {error}')
            of, full = (cost.Cost(each, each) for each in map(self.expected, both))
        return of, full
