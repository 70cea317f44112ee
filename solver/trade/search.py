"""The cheapest way to simulate a scene that keeps what it requires, found by measuring, and checked where it was not chosen.

Errors of different origin cancel on one maneuver and not on the next. So an error is bounded by the sum of four, each measured:

    model      converged level without its switched-off subsystems, against the converged full vehicle
    step       the setting iterated to tolerance, against the converged level
    iteration  the setting with its iterations, against the same iterated to tolerance
    reference  band of the converged full vehicle

Levels whose model error alone is too large go first. Of the rest settings are tried cheapest first, on growing parts of the scene's own
maneuver (what an error has reached by then it does not lose again) and then on the corners of the variations (solver.trade.variations);
the first that stays below the limits with MARGIN to spare is the cheapest. Of its level subsystems are then switched off, those first that
save most for the error they make, singly and by exchanging pairs. What remains is checked by its error itself on variations that had no
part in the choice. n passes without failure bound the rate of failures by 3/n with 95 % confidence [Hanley1983].
"""

from __future__ import annotations

import dataclasses
import math
import threading
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from solver.analysis.departures import Departure
from solver.errors import MbdError, SpecError
from solver.levels import LEVELS, derive
from solver.quantities import names as names_of
from solver.quantities import published
from solver.scene import SUBSYSTEMS, Scene
from solver.trade import cost, reference
from solver.trade.activity import of_subsystems
from solver.trade.reference import Reference
from solver.trade.runs import Going, Run, Stopped, all_of, clock, departures, run
from solver.trade.setting import Setting, baseline
from solver.trade.variations import AS_GIVEN, CORNERS, Variation, inside, varied

MARGIN = 0.1  # of every limit that the bound leaves free
LONGEST = 170.0  # s that a plan may take
CHECK_SHARE = 0.45  # of that which is kept for checking
UNSEEN = 24
CLEAR_BAND = 0.1  # of the limit that the band of the reference may take before its steps are refined
STEP_SETS = tuple(tuple(h / 2**k for h in reference.STEPS) for k in range(4))
STEPS = (0.02, 0.01, 0.008, 0.005, 0.004, 0.003, 0.002, 0.001, 0.0005, 0.00025, 0.000125)
ITERATIONS = (1, 2, 3)
RHOS = (0.8, 0.5)
PARTS = (0.25, 0.5, 1.0)  # of the maneuver, in the race
SAME = 1.05  # settings whose costs are nearer than this are equally cheap, and the more accurate one is taken
SAVES = 0.97  # of the cost: what a subsystem must bring it below to be worth its error
EXAMPLE = '{yaw_rate: {rms: 2 %}}'
ORIGINS = ('model', 'step', 'iteration', 'reference')
WATCHED = ('lateral_acceleration', 'longitudinal_acceleration', 'longitudinal_velocity')
WATCHED_WHEELS = ('slip_angle', 'slip', 'wheel_load')


class Requirement(NamedTuple):
    """One limit of one error."""

    quantity: str
    measure: str  # 'max', 'rms' or 'delay'
    value: float
    share: bool

    def limit(self, peak: float) -> float:
        """In SI units."""
        return self.value * peak if self.share else self.value

    def error(self, d: Departure) -> float:
        """The error that is limited. Curves without a delay of their own have none when they lie close to each other."""
        if self.measure != 'delay':
            return float(getattr(d, self.measure))
        if math.isnan(d.delay):
            return 0.0 if d.rms <= 0.05 * d.peak else math.inf
        return abs(d.delay)

    def __str__(self) -> str:
        return f'{self.quantity} {self.measure}'


def requirements(scene: Scene) -> list[Requirement]:
    """All limits of errors that a scene requires."""
    return [Requirement(name, m, b.value, b.share) for name, a in scene.require.accuracy.items() for m, b in a.bounds.items()]


class Bound(NamedTuple):
    """Errors of one requirement on one maneuver by origin, and the limit there."""

    requirement: Requirement
    parts: tuple[float, float, float, float]  # ORIGINS
    limit: float

    @property
    def used(self) -> float:
        """Share of the limit."""
        return sum(self.parts) / self.limit


class Verdict(NamedTuple):
    """A setting that was tried: its largest share of a limit so far, its cost, and why it was dropped ('' : it passes)."""

    setting: Setting
    used: float
    cost: float  # expected CPU seconds per simulated second
    worst: str
    dropped: str
    bounds: dict[str, Bound]  # the worst over maneuvers by requirement


class Check(NamedTuple):
    """The error itself on a maneuver that had no part in the choice."""

    variation: Variation
    used: float
    worst: str
    failure: str

    @property
    def passed(self) -> bool:
        return not self.failure and self.used <= 1.0


class Influence(NamedTuple):
    """What leaving one subsystem out does: errors as shares of the peak by quantity (RMS), and the cost of a step relative to before."""

    subsystem: str
    activity: float  # J
    errors: dict[str, float]
    cost: float
    failure: str


class Search:
    """The search for one scene. progress(text, done) is told what is going on; left() seconds remain."""

    def __init__(
        self,
        scene: Scene,
        *,
        workers: int | None = None,
        longest: float = LONGEST,
        unseen: int = UNSEEN,
        levels: Sequence[str] = tuple(LEVELS),
        progress: Callable[[str, float], None] = lambda text, done: None,
    ) -> None:
        self.scene = dataclasses.replace(scene, fidelity='full', switches={}, resolved='')
        self.requirements = requirements(scene)
        if not self.requirements:
            raise SpecError(f'scene {scene.name!r}: no accuracy is required, so there is nothing to plan; add e.g. require: {EXAMPLE}')
        self.workers, self.unseen, self._longest, self._progress = workers, unseen, longest, progress
        self._levels = levels  # that may take the place of the full vehicle
        self._begin, self._until = clock(), longest
        self.notes: list[str] = []
        channels = published(self.scene.model)
        self.names = list(dict.fromkeys(r.quantity for r in self.requirements))
        known = names_of(channels)
        standard = [n for n in ('yaw_rate', 'sideslip_velocity', 'roll') if n in known]
        wheels = [f'{n}.{w}' for n in WATCHED_WHEELS for w in channels.wheels]
        self.watched = [n for n in (*WATCHED, *wheels) if n in known]
        self.shown = [*dict.fromkeys([*self.names, *standard, *(n for n in wheels if n.startswith('wheel_load'))])]
        self._all = [*dict.fromkeys([*self.shown, *self.watched])]
        self.steps = STEP_SETS[0]
        self._lock = threading.Lock()
        self._scenes: dict[Variation, Scene] = {}
        self._runs: dict[tuple[Variation, Setting], Run] = {}
        self._references: dict[tuple[Variation, tuple[str, tuple[str, ...]], tuple[float, ...]], Reference] = {}
        self._lost: dict[Setting, tuple[str, float]] = {}
        self._costs: dict[tuple[str, tuple[str, ...]], cost.PerStep] = {}
        self.seen: list[Variation] = [AS_GIVEN, *CORNERS]
        self.tried: list[Verdict] = []
        self.levels: dict[str, str] = {}  # level -> why it is out, '' where it is not
        self.influences: list[Influence] = []
        self.second: dict[str, Departure] = {}
        self.checks: list[Check] = []
        self.result: Verdict | None = None
        self.ended = False  # before the search had come to an end, by time

    # -- what everything is measured with ------------------------------------------------------------------------------

    @property
    def took(self) -> float:
        """Seconds since the beginning."""
        return clock() - self._begin

    def say(self, text: str) -> None:
        """What is being done, and the share of the time that is gone."""
        self._progress(text, min(1.0, self.took / self._longest))

    def _late(self) -> bool:
        return self.took > self._until

    def maneuver(self, v: Variation) -> Scene:
        """The scene of a variation."""
        with self._lock:
            if v not in self._scenes:
                self._scenes[v] = self.scene if v == AS_GIVEN else varied(self.scene, v)
            return self._scenes[v]

    def run(self, v: Variation, setting: Setting) -> Run:
        """A whole run, made once."""
        key = (v, setting)
        if key not in self._runs:
            self._runs[key] = run(self.maneuver(v), setting, self._all, stop=self._late)
        return self._runs[key]

    def limit_of(self, v: Variation, setting: Setting, steps: Sequence[float]) -> Reference:
        """The converged solution of a model on a maneuver, made once. Raises StepError."""
        key = (v, setting.model, tuple(steps))
        if key not in self._references:
            base = Setting(level=setting.level, off=setting.off)
            runs = [self.run(v, reference.with_step(base, h)) for h in steps]
            self._references[key] = reference.of_runs(self.maneuver(v), runs)
        return self._references[key]

    def truth(self, v: Variation) -> Reference:
        """The converged full vehicle: three steps where it serves to choose, two elsewhere."""
        return self.limit_of(v, Setting(), self.steps if v in self.seen else self.steps[1:])

    def uncertainty(self, r: Requirement) -> float:
        """Band of the converged full vehicle as a share of the peak: the worst of the maneuvers with three steps."""
        found = [
            self._references[v, Setting().model, self.steps] for v in self.seen if (v, Setting().model, self.steps) in self._references
        ]
        return max((r.error(t.band[r.quantity]) / t.peaks[r.quantity] for t in found), default=0.0)

    def per_step(self, setting: Setting) -> cost.PerStep:
        """Cost of a step of a model, measured once."""
        if setting.model not in self._costs:
            self._costs[setting.model] = cost.per_step(self.scene, Setting(level=setting.level, off=setting.off))
        return self._costs[setting.model]

    def expected(self, setting: Setting, found: Run | None = None) -> float:
        """CPU seconds per simulated second by counters; before a run by what its iterations should take."""
        model = self.per_step(setting)
        evaluations = model.expected(setting.iterations or ITERATIONS[-1]) if found is None else found.counters['evaluations']
        return model.of(setting.h, evaluations)

    # -- bounds --------------------------------------------------------------------------------------------------------

    def _limits(self, v: Variation) -> dict[Requirement, float]:
        return {r: r.limit(self.truth(v).peaks[r.quantity]) for r in self.requirements}

    def _part(self, found: Run, than: Reference) -> dict[Requirement, float]:
        errors = than.errors(found)
        return {r: r.error(errors[r.quantity]) for r in self.requirements}

    def _between(self, a: Run, b: Run, truth: Reference) -> dict[Requirement, float]:
        errors = departures(a, b.time, b.curves, truth.quantities, truth.peaks)
        return {r: r.error(errors[r.quantity]) for r in self.requirements}

    def model_error(self, v: Variation, setting: Setting) -> dict[Requirement, float]:
        """Of the converged level against the converged full vehicle. Raises StepError."""
        if setting.model == Setting().model:
            return dict.fromkeys(self.requirements, 0.0)
        level = self.limit_of(v, setting, self.steps[1:])
        return self._part(Run(setting, level.time, level.curves, {}, ''), self.truth(v))

    def _own_limit(self, v: Variation, setting: Setting) -> Reference:
        return self.truth(v) if setting.model == Setting().model else self.limit_of(v, setting, self.steps[1:])

    def bounds(self, v: Variation, setting: Setting) -> list[Bound]:
        """Bounds of all requirements on a maneuver. Raises StepError."""
        own, truth, limits = self._own_limit(v, setting), self.truth(v), self._limits(v)
        model, found = self.model_error(v, setting), self.run(v, setting)
        if setting.iterations is None:
            step, iteration = self._part(found, own), dict.fromkeys(self.requirements, 0.0)
        else:
            settled = self.run(v, dataclasses.replace(setting, iterations=None))
            step, iteration = self._part(settled, own), self._between(found, settled, truth)
        band = {r: self.uncertainty(r) * truth.peaks[r.quantity] for r in self.requirements}
        return [Bound(r, (model[r], step[r], iteration[r], band[r]), limits[r]) for r in self.requirements]

    def race(self, setting: Setting) -> tuple[str, float]:
        """(why a setting is out on the scene's own maneuver, '' if it is not; largest share of a limit) on growing parts of it.

        The largest error so far and the integral of its square only grow, so what is too large after a part stays so.
        """
        v = AS_GIVEN
        if setting in self._lost:
            return self._lost[setting]
        own, limits, peaks = self._own_limit(v, setting), self._limits(v), self.truth(v).peaks
        model = self.model_error(v, setting)
        known = self._runs.get((v, setting))
        going = None if known else Going(self.maneuver(v), setting, self._all, stop=self._late)
        used, worst = math.inf, ''
        for part in PARTS if going else PARTS[-1:]:
            found = known or going.to(part * self.scene.duration)  # type: ignore[union-attr]
            if found.failure:
                return self._lost.setdefault(setting, (found.failure, math.inf))
            errors = own.errors(found)
            shares = {}
            for r in self.requirements:
                error = r.error(errors[r.quantity])
                if part < 1.0:
                    error *= {'max': 1.0, 'rms': math.sqrt(part), 'delay': 0.0}[r.measure]
                shares[str(r)] = (model[r] + error) / limits[r] + self.uncertainty(r) * peaks[r.quantity] / limits[r]
            worst, used = max(shares.items(), key=lambda item: item[1])
            if not used <= 1.0 - MARGIN:
                return self._lost.setdefault(setting, (f'{worst}: {used:.2g} of its limit after {part:.0%} of the maneuver', used))
        with self._lock:
            self._runs[v, setting] = found
        return '', used

    def judge(self, setting: Setting) -> Verdict:
        """Whether a setting keeps everything on the maneuvers that serve to choose."""
        expected = self.expected(setting)
        try:
            dropped, used = self.race(setting)
            if dropped:
                return Verdict(setting, used, expected, dropped.partition(':')[0], dropped, {})
            expected = self.expected(setting, self._runs[AS_GIVEN, setting])
            worst: dict[str, Bound] = {}
            for v in self.seen:
                for bound in self.bounds(v, setting):
                    name = str(bound.requirement)
                    if name not in worst or bound.used > worst[name].used or math.isnan(bound.used):
                        worst[name] = bound
                used = max(b.used for b in worst.values())
                if not used <= 1.0 - MARGIN:
                    name = max(worst, key=lambda n: worst[n].used)
                    return Verdict(setting, used, expected, name, f'{name}: {used:.2g} of its limit on {v}', worst)
        except Stopped:
            raise
        except MbdError as error:
            return Verdict(setting, math.inf, expected, '', str(error), {})
        name = max(worst, key=lambda n: worst[n].used)
        return Verdict(setting, used, expected, name, '', worst)

    # -- the phases ----------------------------------------------------------------------------------------------------

    def find_reference(self) -> bool:
        """Choose steps fine enough for the limits; False where the band stays too wide for one of them. Raises StepError."""
        for steps in STEP_SETS:
            self.steps = steps
            self.say(f'reference with {", ".join(f"{1e3 * h:g}" for h in steps)} ms')
            all_of(lambda h: self.run(AS_GIVEN, Setting(h=h)), steps, self.workers)
            limits = self._limits(AS_GIVEN)
            shares = {r: self.uncertainty(r) * self.truth(AS_GIVEN).peaks[r.quantity] / limits[r] for r in self.requirements}
            if max(shares.values()) <= CLEAR_BAND:
                break
        worst = max(shares, key=lambda r: shares[r])
        if not shares[worst] <= 1.0 - MARGIN:
            self.notes.append(
                f'{worst}: the reference itself is uncertain by {shares[worst]:.2g} of the limit, with {1e3 * self.steps[-1]:g} ms'
            )
            return False
        self.say('second formulation of the reference')
        self.second = reference.second_formulation(self.scene, self.truth(AS_GIVEN), self._late)
        self.say('references of the corners')
        corners = [(v, reference.with_step(Setting(), h)) for v in CORNERS for h in self.steps]
        all_of(lambda job: self.run(*job), corners, self.workers)
        for v in CORNERS:
            try:
                self.truth(v)
            except MbdError as error:
                self.seen.remove(v)
                self.notes.append(f'the corner {v} of the variations is left out: {error}')
        return True

    def find_levels(self) -> list[str]:
        """Levels whose model error leaves room; self.levels says why the others are out."""
        self.levels = {'full': ''}
        for level in self._levels:
            self.say(f'model error of {level}')
            base = Setting(level=level)  # type: ignore[arg-type]
            self.levels[level] = self._out(base)
        return [level for level, why in self.levels.items() if not why]

    def _out(self, base: Setting) -> str:
        """Why a model cannot keep the limits whatever its step, or ''."""
        try:
            derive(base.of(self.scene))
        except MbdError as error:
            return str(error)
        for v in self.seen:
            try:
                all_of(lambda h: self.run(v, reference.with_step(base, h)), self.steps[1:], self.workers)  # noqa: B023
                limits, errors = self._limits(v), self.model_error(v, base)
            except Stopped:
                raise
            except MbdError as error:
                return str(error)
            shares = {r: errors[r] / limits[r] for r in self.requirements}
            worst = max(shares, key=lambda r: shares[r])
            if not shares[worst] <= 1.0 - MARGIN:
                if math.isinf(shares[worst]):
                    return f'{worst.quantity} is not modelled'
                return f'{worst}: its model error alone is {shares[worst]:.2g} of the limit on {v}'
        return ''

    def candidates(self, models: Sequence[Setting]) -> list[Setting]:
        """All settings of these models, cheapest first."""
        steps = [h for h in STEPS if h >= 0.99 * self.steps[-1] and h <= 0.25 * self.scene.duration]
        found = [dataclasses.replace(m, h=h, iterations=n, rho_inf=rho) for m in models for h in steps for n in ITERATIONS for rho in RHOS]
        return sorted(found, key=lambda s: (self.expected(s), -s.h))

    def cheapest(self, models: Sequence[Setting], below: float = math.inf) -> Verdict | None:
        """The cheapest setting that keeps everything, the more accurate of equals; None where there is none."""
        best: Verdict | None = None
        for setting in self.candidates(models):
            expected = self.expected(setting)
            if expected > (below if best is None else SAME * best.cost):
                break
            self.say(str(setting))
            verdict = self.judge(setting)
            self.tried.append(verdict)
            if verdict.dropped or verdict.cost > below:
                continue
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
        truth, whole = self.truth(AS_GIVEN), self.per_step(base)
        evaluations = before.counters['evaluations']
        order = sorted(activity, key=lambda s: activity[s])
        for subsystem in order:
            self.say(f'without {subsystem}')
            setting = dataclasses.replace(base, off=(subsystem,))
            try:
                share = self.per_step(setting).of(1.0, evaluations) / whole.of(1.0, evaluations)
            except MbdError as error:
                self.influences.append(Influence(subsystem, activity[subsystem], {}, 1.0, str(error)))
                continue
            found = self.run(AS_GIVEN, setting)
            errors = departures(found, before.time, before.curves, truth.quantities, truth.peaks)
            shares = {name: errors[name].rms / truth.peaks[name] for name in self.shown}
            self.influences.append(Influence(subsystem, activity[subsystem], shares, share, found.failure))
        return self.influences

    def eliminate(self, best: Verdict) -> Verdict:
        """Switch subsystems off as long as that is cheaper and keeps everything: one after the other, then by exchanging pairs."""
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

    def check(self, setting: Setting, v: Variation) -> Check:
        """The error itself, with the band of the reference, on a maneuver."""
        try:
            truth, found = self.truth(v), self.run(v, setting)
        except Stopped:
            raise
        except MbdError as error:
            return Check(v, math.inf, '', f'the reference: {error}')
        if found.failure:
            return Check(v, math.inf, '', found.failure)
        errors, limits = self._part(found, truth), self._limits(v)
        shares = {str(r): errors[r] / limits[r] + self.uncertainty(r) * truth.peaks[r.quantity] / limits[r] for r in self.requirements}
        worst = max(shares, key=lambda n: shares[n])
        return Check(v, shares[worst], worst, '')

    def check_unseen(self, setting: Setting) -> list[Check]:
        """Checks on variations inside the ranges, as many as there is time for; stops at the first failure of the setting."""
        found: list[Check] = []
        size = max(2, self.workers or 2)
        points = [v for v in (inside(k) for k in range(self.unseen + len(self.seen))) if v not in self.seen][: self.unseen]
        for k in range(0, len(points), size):
            begin = clock()
            self.say(f'checking {setting} on unseen maneuvers: {len(found)} of {self.unseen}')
            try:
                found += all_of(lambda v: self.check(setting, v), points[k : k + size], self.workers)
            except Stopped:
                break
            if any(not c.passed and not c.failure.startswith('the reference') for c in found):
                break
            if self.took + 1.2 * (clock() - begin) > self._until:
                break
        without = [c for c in found if c.failure.startswith('the reference')]
        self.notes += [f'no check on {c.variation}: {c.failure}' for c in without]
        return [c for c in found if c not in without]

    def find(self) -> Verdict | None:
        """The whole search. self.checks are those of the result; None where nothing keeps what is required, or time is up."""
        self.say('compiling')
        Going(self.scene, baseline(self.scene), []).to(min(0.01, self.scene.duration))
        self._begin, self._until = clock(), (1.0 - CHECK_SHARE) * self._longest  # what is compiled once is not time of the plan
        best: Verdict | None = None
        try:
            if not self.find_reference():
                return None
            models = [Setting(level=level) for level in self.find_levels()]  # type: ignore[arg-type]
            best = self.cheapest(models)
            if best is not None:
                best = self.eliminate(best)
        except Stopped:
            self.ended = True
            self.notes.append(f'the search was ended after {self.took:.0f} s; what it had found by then is what counts')
        self._until = self._longest
        while best is not None:
            self.checks = self.check_unseen(best.setting)
            failed = [c.variation for c in self.checks if not c.passed]
            if not failed:
                self.result = best
                return best
            self.notes.append(f'{best.setting} failed on {failed[0]}, which has served to choose from then on')
            self.tried = [t if t is not best else t._replace(dropped=f'{self.checks[-1].worst}: unseen {failed[0]}') for t in self.tried]
            self.seen += failed
            try:
                models = [m for m in (Setting(level=level) for level, why in self.levels.items() if not why) if not self._out(m)]  # type: ignore[arg-type]
                again = Setting(level=best.setting.level, off=best.setting.off)
                if again.off and not self._out(again):
                    models.append(again)
                best = self.cheapest(models)
            except Stopped:
                self.ended = True
                self.notes.append('time was up before another setting was found')
                return None
        return None

    def closest(self) -> Verdict | None:
        """Of all settings that were tried the one nearest to the limits."""
        finite = [t for t in self.tried if np.isfinite(t.used)]
        return min(finite, key=lambda t: (t.used, t.cost), default=None)

    def envelope(self) -> dict[str, tuple[float, float]]:
        """Quantity (of all wheels together) -> smallest and largest value in the maneuvers that were passed, full vehicle."""
        found: dict[str, tuple[float, float]] = {}
        for v in [*self.seen, *(c.variation for c in self.checks if c.passed)]:
            try:
                truth = self.truth(v)
            except (MbdError, Stopped):
                continue
            for name in self.watched:
                head = name.partition('.')[0]
                low, high = found.get(head, (math.inf, -math.inf))
                found[head] = (min(low, float(truth.curves[name].min())), max(high, float(truth.curves[name].max())))
        return found

    def costs(self, setting: Setting) -> tuple[cost.Cost, cost.Cost]:
        """(of the setting, of the full vehicle at 1 ms), measured one after the other."""
        self.say('measuring costs')
        return cost.measured(self.scene, setting), cost.measured(self.scene, baseline(self.scene))
