"""The cheapest way to simulate a scene that keeps what it requires, found by measuring, and checked where it was not chosen.

Errors of different origin cancel on one maneuver and not on the next. So an error is bounded by the sum of its parts (solver.trade.errors)
and of the band of the converged full vehicle.

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
import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

from solver.analysis.departures import Departure
from solver.checks.registry import BY_NAME
from solver.errors import MbdError, SpecError, StepError
from solver.findings import Finding
from solver.levels import LEVELS, derive
from solver.levels.auto import key
from solver.quantities import names as names_of
from solver.quantities import published
from solver.scene import SUBSYSTEMS, Scene
from solver.trade import cost, reference
from solver.trade.activity import Influence, influences
from solver.trade.bench import FULL, Bench, cost_of, findings_of, own_of, run_of, second_of, truth_of
from solver.trade.errors import requirements
from solver.trade.judging import MARGIN, Check, Verdict, bands_of, check_whole, judge, largest, limits_of, model_error
from solver.trade.kept_runs import KeptRuns
from solver.trade.runs import Going, Stopped, all_of, clock
from solver.trade.setting import ITERATIONS, RHOS, Setting, baseline, grid
from solver.trade.variations import AS_GIVEN, CORNERS, Variation, effective, inside

LONGEST = 170.0  # s that a plan may take
CHECK_SHARE = 0.45  # of that which is kept for checking
LEAST_CHECK_SHARE = 0.15  # the same as long as no setting has been found
UNSEEN = 24
CLEAR_BAND = 0.1  # of the limit that the band of the reference may take before its steps are refined
STEPS = (0.02, 0.01, 0.008, 0.005, 0.004, 0.003, 0.002, 0.001, 0.0005, 0.00025, 0.000125, 0.0000625)
STEP_SETS = tuple(tuple(h / 2**k for h in reference.STEPS) for k in range(4))  # s, of the reference
SAME = 1.05  # settings whose costs are nearer than this are equally cheap, and the more accurate one is taken
SAVES = 0.97  # of the cost: what a subsystem must bring it below to be worth its error
EXAMPLE = '{yaw_rate: {rms: 2 %}}'
WATCHED = ('lateral_acceleration', 'longitudinal_acceleration', 'longitudinal_velocity')
WATCHED_WHEELS = ('slip_angle', 'slip', 'wheel_load')


class Search:
    """The search for one scene, in at most `longest` seconds.

    progress(text, done): is told what is going on. keep_in: a directory in which whole runs are kept, and found again; none
    keeps nothing. bench: what was measured so far.
    """

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
        required = requirements(scene)
        if not required:
            raise SpecError(f'scene {scene.name!r}: no accuracy is required, so there is nothing to plan; add e.g. require: {EXAMPLE}')
        self.workers, self.longest, self._progress, self.unseen = workers, longest, progress, unseen
        self.begin, self.until = clock(), longest
        self.candidate_levels = ('full', *levels)
        channels = published(scene.model)
        known = names_of(channels)
        wheels = [f'{n}.{w}' for n in WATCHED_WHEELS for w in channels.wheels]
        loads = [n for n in wheels if n.startswith('wheel_load')]
        self.names = list(dict.fromkeys(r.quantity for r in required))
        self.watched = [n for n in (*WATCHED, *wheels) if n in known]
        self.shown = [*dict.fromkeys([*self.names, *(n for n in ('yaw_rate', 'sideslip_velocity', 'roll') if n in known), *loads])]
        everything = tuple(dict.fromkeys([*self.shown, *self.watched]))
        self.scene = dataclasses.replace(scene, fidelity='full', switches={}, resolved='')
        self.kept = KeptRuns(keep_in, key(scene) if keep_in else '', everything)
        self.bench = Bench(
            self.scene, everything, STEP_SETS[0], required, self.different((AS_GIVEN, *CORNERS)), stop=self.late, kept=self.kept
        )
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

    @property
    def took(self) -> float:
        """Seconds since the beginning."""
        return clock() - self.begin

    def late(self) -> bool:
        """True when the time is over that runs may take."""
        return self.took > self.until

    def say(self, text: str) -> None:
        """Tell what is being done, and the share of the time that is gone."""
        self._progress(text, min(1.0, self.took / self.longest))

    def different(self, variations: Iterable[Variation]) -> tuple[Variation, ...]:
        """Those that lead to different maneuvers."""
        return tuple(dict.fromkeys(effective(self.scene, v) for v in variations))

    def points(self, count: int) -> list[Variation]:
        """Up to so many maneuvers inside the ranges that had no part in the choice; none of a scene in which nothing can be varied."""
        seen = self.bench.seen
        return [v for v in self.different(inside(k) for k in range(count + len(seen))) if v not in seen][:count]

    # -- the phases ----------------------------------------------------------------------------------------------------

    def find_reference(self) -> bool:
        """Choose steps fine enough for the limits; False where the band stays too wide for one of them, or a second formulation does not
        confirm it. Raises StepError."""
        for steps in STEP_SETS:
            bench = self.bench = dataclasses.replace(self.bench, steps=steps)
            self.say(f'reference with {", ".join(f"{1e3 * h:g}" for h in steps)} ms')
            all_of(lambda h: self.look_at(AS_GIVEN, Setting(h=h)), steps, self.workers)
            try:
                limits = limits_of(bench, AS_GIVEN)
            except StepError:  # a step that a run does not survive: there may be shorter ones
                if steps == STEP_SETS[-1]:
                    raise
                continue
            bands = bands_of(bench, AS_GIVEN)
            worst, share = largest({r: bands[r] / limits[r] for r in limits})
            if share <= CLEAR_BAND and not self.unresolved(AS_GIVEN):
                break
        if not share <= 1.0 - MARGIN:
            self.notes.append(f'{worst}: the reference itself is uncertain by {share:.2g} of the limit, with {1e3 * bench.steps[-1]:g} ms')
            return False
        self.say('second formulation of the reference, and references of the corners')
        finest = share > CLEAR_BAND  # else its coarser pair confirms as much

        def confirm() -> None:
            self.second = second_of(bench, finest=finest)

        corners = [v for v in bench.seen if v != AS_GIVEN]
        work: list[Callable[[], None]] = [confirm]
        work += [partial(self.look_at, v, reference.with_step(FULL, h)) for h in bench.steps[::-1] for v in corners]
        all_of(lambda make: make(), work, self.workers)
        worst, share = largest({r: r.error(self.second[r.quantity]) / limits[r] for r in limits})
        if not share <= 1.0 - MARGIN:
            self.notes.append(f'{worst}: the reference is not confirmed, a second formulation departs from it by {share:.2g} of the limit')
            return False
        for v in corners:
            try:
                truth_of(bench, v)
            except MbdError as error:
                self.bench = dataclasses.replace(self.bench, seen=tuple(one for one in self.bench.seen if one != v))
                self.notes.append(f'the corner {v} of the variations is left out: {error}')
        for v in self.bench.seen:
            self.coarse |= {finding.quantity: finding for finding in self.unresolved(v) if finding.quantity not in self.coarse}
        return True

    def look_at(self, v: Variation, setting: Setting) -> None:
        """Make a run of the reference, the finest one with what would make it suspect."""
        (findings_of if setting.h == self.bench.steps[-1] else run_of)(self.bench, v, setting)

    def unresolved(self, v: Variation) -> list[Finding]:
        """Findings of the finest run of the reference that it does not resolve: steps that all damp a vibration away agree on
        a motion without it."""
        found = findings_of(self.bench, v, Setting(h=self.bench.steps[-1]))
        return [f for f in found if BY_NAME[f.quantity].unresolved and not f.required]

    def find_levels(self) -> list[Setting]:
        """The levels that the vehicle has; self.levels says why it has not the others."""
        found = [FULL]
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
        """True where the model error of a level alone is too large; it is looked at once."""
        if level not in self.levels:
            self.say(f'model error of {level}')
            self.levels[level] = self._out(Setting(level=level))  # type: ignore[arg-type]
        return bool(self.levels[level])

    def _out(self, base: Setting) -> str:
        """Why a model cannot keep the limits whatever its step, or ''."""
        if base.model == FULL.model:
            return ''
        try:
            derive(base.of(self.scene))
        except MbdError as error:
            return str(error)
        bench = self.bench
        for v in bench.seen:
            try:
                all_of(lambda h: run_of(bench, v, reference.with_step(base, h)), bench.steps[1:], self.workers)  # noqa: B023
                limits, errors = limits_of(bench, v), model_error(bench, v, base)
            except Stopped:
                raise
            except MbdError as error:
                return str(error)
            worst, share = largest({r: errors[r] / limits[r] for r in limits})
            if not share <= 1.0:
                if math.isinf(share):
                    there = worst.quantity in own_of(bench, v, base).curves
                    return f'{worst}: it changes in another way than in the full vehicle' if there else f'{worst.quantity} is not modelled'
                return f'{worst}: its model error alone is {share:.2g} of the limit on {v}'
        return ''

    def candidates(self, models: Sequence[Setting]) -> list[Setting]:
        """All settings of these models, cheapest first.

        Their steps go down to half the finest one of the reference: a run is judged by the limit of those, with its band, which lies far
        below all limits also where the error of the finest does not. A level with a step of its own makes no iterations and knows no
        damping: it has one setting a step.
        """
        steps = [h for h in STEPS if h >= 0.49 * self.bench.steps[-1] and h <= 0.25 * self.scene.duration]
        found = []
        for m in models:
            ways = 1 if derive(m.of(self.scene)).engine is not None else None  # how many of each
            found += grid(m, steps, ITERATIONS[:ways], RHOS[:ways])
        return sorted(found, key=lambda s: (cost_of(self.bench, s), -s.h))

    def cheapest(self, models: Sequence[Setting], below: float = math.inf) -> Verdict | None:
        """The cheapest setting that keeps everything, the more accurate of equals; None where there is none."""
        best: Verdict | None = None
        for setting in self.candidates(models):
            if cost_of(self.bench, setting) > (below if best is None else SAME * best.cost):
                break
            if not setting.off and self._is_out(setting.level):
                continue
            self.say(str(setting))
            try:
                verdict = judge(self.bench, setting, self.workers)
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

    def look_at_subsystems(self, base: Setting) -> list[Influence]:
        """The influences of all subsystems at one and the same integration."""
        self.say('activity of the subsystems')
        for one in influences(self.bench, base, self.shown, self.say):
            self.influences.append(one)
        return self.influences

    def eliminate(self, best: Verdict) -> Verdict:
        """Switch subsystems off as long as that is cheaper and keeps everything: one after the other, then by exchanging pairs.

        A level with a step of its own costs the same whatever is off; their influence is then that on the full vehicle.
        """
        if derive(best.setting.of(self.scene)).engine is not None:
            self.look_at_subsystems(Setting(h=self.bench.steps[0], iterations=ITERATIONS[1]))
            return best
        gains = [i for i in self.look_at_subsystems(dataclasses.replace(best.setting, off=())) if not i.failure and i.cost < SAVES]

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
            if cost_of(self.bench, setting, run_of(self.bench, AS_GIVEN, best.setting)) > SAVES * best.cost:
                return best
        except MbdError:
            return best
        self.say(str(setting))
        why = self._out(dataclasses.replace(setting, iterations=None))
        verdict = judge(self.bench, setting, self.workers) if not why else Verdict(setting, math.inf, best.cost, '', why, {})
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
                found += all_of(lambda v: check_whole(self.bench, v, setting), points[k : k + size], self.workers)
            except Stopped:
                break
            if any(not c.passed and not c.unjudged for c in found):
                break
            if self.took + 1.2 * (clock() - begin) > self.until:
                break
        if len(found) < len(points) and all(c.passed for c in found):
            self.notes.append(f'{len(found)} of {len(points)} unseen maneuvers were checked in the time there was (mbd plan --time)')
        without = [c for c in found if c.unjudged]
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
            self.bench = dataclasses.replace(self.bench, seen=(*self.bench.seen, *failed))
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
            of, full = (cost.Cost(each, each) for each in (cost_of(self.bench, one) for one in both))
        return of, full
