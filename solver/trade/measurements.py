"""What a search measures with: runs of a scene with its settings, converged references, and bounds of errors, each made once."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from solver.analysis.certificate_coverage import is_broken
from solver.errors import SpecError
from solver.findings import Finding
from solver.levels.auto import key
from solver.quantities import names as names_of
from solver.quantities import published
from solver.scene import Scene
from solver.trade import cost, reference
from solver.trade.kept_runs import KeptRuns
from solver.trade.reference import Reference
from solver.trade.requirements import Bound, Requirement, requirements
from solver.trade.runs import Going, Run, clock, departures, run
from solver.trade.setting import Setting
from solver.trade.variations import AS_GIVEN, CORNERS, Variation, effective, inside, varied

STEP_SETS = tuple(tuple(h / 2**k for h in reference.STEPS) for k in range(4))
ITERATIONS = (1, 2, 3)
EXAMPLE = '{yaw_rate: {rms: 2 %}}'
WATCHED = ('lateral_acceleration', 'longitudinal_acceleration', 'longitudinal_velocity')
WATCHED_WHEELS = ('slip_angle', 'slip', 'wheel_load')


class Measurements:
    """All that is known of a scene's settings. progress(text, done) is told what is going on; runs stop when longest seconds are over.
    keep_in: a directory in which whole runs are kept, and found again; none keeps nothing."""

    def __init__(
        self, scene: Scene, *, workers: int | None, longest: float, progress: Callable[[str, float], None], keep_in: Path | None = None
    ) -> None:
        self.scene = dataclasses.replace(scene, fidelity='full', switches={}, resolved='')
        self.requirements = requirements(scene)
        if not self.requirements:
            raise SpecError(f'scene {scene.name!r}: no accuracy is required, so there is nothing to plan; add e.g. require: {EXAMPLE}')
        self.workers, self.longest, self._progress = workers, longest, progress
        self.begin, self.until = clock(), longest
        channels = published(self.scene.model)
        self.names = list(dict.fromkeys(r.quantity for r in self.requirements))
        known = names_of(channels)
        standard = [n for n in ('yaw_rate', 'sideslip_velocity', 'roll') if n in known]
        wheels = [f'{n}.{w}' for n in WATCHED_WHEELS for w in channels.wheels]
        self.watched = [n for n in (*WATCHED, *wheels) if n in known]
        self.shown = [*dict.fromkeys([*self.names, *standard, *(n for n in wheels if n.startswith('wheel_load'))])]
        self.everything = [*dict.fromkeys([*self.shown, *self.watched])]
        self.steps = STEP_SETS[0]
        self.seen = self.different((AS_GIVEN, *CORNERS))  # maneuvers that serve to choose
        self.kept = KeptRuns(keep_in, key(scene) if keep_in else '', self.everything)
        self._lock = threading.Lock()
        self._scenes: dict[Variation, Scene] = {}
        self._runs: dict[tuple[Variation, Setting], Run] = {}
        self._findings: dict[tuple[Variation, Setting], tuple[Finding, ...]] = {}
        self._references: dict[tuple[Variation, tuple[str, tuple[str, ...]], tuple[float, ...]], Reference] = {}
        self.prices: dict[tuple[str, tuple[str, ...]], cost.PerStep] = {}

    @property
    def took(self) -> float:
        """Seconds since the beginning."""
        return clock() - self.begin

    def say(self, text: str) -> None:
        """What is being done, and the share of the time that is gone."""
        self._progress(text, min(1.0, self.took / self.longest))

    def late(self) -> bool:
        return self.took > self.until

    def maneuver(self, v: Variation) -> Scene:
        """The scene of a variation."""
        with self._lock:
            if v not in self._scenes:
                self._scenes[v] = self.scene if v == AS_GIVEN else varied(self.scene, v)
            return self._scenes[v]

    def different(self, variations: Iterable[Variation]) -> list[Variation]:
        """Those that lead to different maneuvers."""
        return list(dict.fromkeys(effective(self.scene, v) for v in variations))

    def points(self, count: int) -> list[Variation]:
        """Up to so many maneuvers inside the ranges that had no part in the choice; none of a scene in which nothing can be varied."""
        return [v for v in self.different(inside(k) for k in range(count + len(self.seen))) if v not in self.seen][:count]

    def run(self, v: Variation, setting: Setting) -> Run:
        """A whole run, made once."""
        which = (v, setting)
        if which not in self._runs:
            self._runs[which] = self.kept.made(v, setting, lambda: run(self.maneuver(v), setting, self.everything, stop=self.late))
        return self._runs[which]

    def findings(self, v: Variation, setting: Setting) -> tuple[Finding, ...]:
        """What would make this run suspect (solver.analysis.verdict), made once; none of a run that fails."""
        which = (v, setting)
        if which not in self._findings:
            kept = self.kept.get(v, setting, judged=True)
            if not kept:
                going = Going(self.maneuver(v), setting, self.everything, stop=self.late, audit=True)
                kept = going.to(self.scene.duration), going.findings()
                self.kept.put(v, setting, *kept)
            self._runs.setdefault(which, kept[0])
            self._findings[which] = kept[1]
        return self._findings[which]

    def broken(self, v: Variation, setting: Setting) -> str:
        """What forbids to choose the setting whatever its errors are, or ''."""
        return next((finding.text for finding in self.findings(v, setting) if is_broken(finding)), '')

    def limit_of(self, v: Variation, setting: Setting, steps: Sequence[float]) -> Reference:
        """The converged solution of a model on a maneuver, made once. Raises StepError."""
        which = (v, setting.model, tuple(steps))
        if which not in self._references:
            base = Setting(level=setting.level, off=setting.off)
            runs = [self.run(v, reference.with_step(base, h)) for h in steps]
            self._references[which] = reference.of_runs(self.maneuver(v), runs)
        return self._references[which]

    def truth(self, v: Variation) -> Reference:
        """The converged full vehicle: three steps where it serves to choose, two elsewhere."""
        return self.limit_of(v, Setting(), self.steps if v in self.seen else self.steps[1:])

    def uncertainty(self, r: Requirement, peak: float) -> float:
        """Band of the converged full vehicle on a maneuver with this peak, in the unit of the error: the largest share of the peak that it
        has in maneuvers with three steps. A delay has nothing to do with how large the peak is."""
        found = [
            self._references[v, Setting().model, self.steps] for v in self.seen if (v, Setting().model, self.steps) in self._references
        ]
        scaled = (r.error(t.band[r.quantity]) * (1.0 if r.measure == 'delay' else peak / t.peaks[r.quantity]) for t in found)
        return max(scaled, default=0.0)

    def per_step(self, setting: Setting) -> cost.PerStep:
        """Cost of a step of a model, measured once."""
        if setting.model not in self.prices:
            self.prices[setting.model] = cost.per_step(self.scene, Setting(level=setting.level, off=setting.off))
        return self.prices[setting.model]

    def expected(self, setting: Setting, found: Run | None = None) -> float:
        """CPU seconds per simulated second by counters; before a run by what its iterations should take."""
        model = self.per_step(setting)
        evaluations = model.expected(setting.iterations or ITERATIONS[-1]) if found is None else found.counters['evaluations']
        return model.of(setting.h, evaluations)

    # -- bounds --------------------------------------------------------------------------------------------------------

    def limits(self, v: Variation) -> dict[Requirement, float]:
        return {r: r.limit(self.truth(v).peaks[r.quantity]) for r in self.requirements}

    def shares(self, v: Variation, errors: dict[Requirement, float]) -> dict[str, float]:
        """Errors on a maneuver, with the band of the reference, as shares of their limits."""
        truth = self.truth(v)
        band = {r: self.uncertainty(r, truth.peaks[r.quantity]) for r in self.requirements}
        return {str(r): (errors[r] + band[r]) / r.limit(truth.peaks[r.quantity]) for r in self.requirements}

    def part(self, found: Run, than: Reference) -> dict[Requirement, float]:
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
        return self.part(Run(setting, level.time, level.curves, {}, ''), self.truth(v))

    def own_limit(self, v: Variation, setting: Setting) -> Reference:
        return self.truth(v) if setting.model == Setting().model else self.limit_of(v, setting, self.steps[1:])

    def bounds(self, v: Variation, setting: Setting) -> list[Bound]:
        """Bounds of all requirements on a maneuver. Raises StepError."""
        own, truth, limits = self.own_limit(v, setting), self.truth(v), self.limits(v)
        model, found = self.model_error(v, setting), self.run(v, setting)
        if setting.iterations is None:
            step, iteration = self.part(found, own), dict.fromkeys(self.requirements, 0.0)
        else:
            settled = self.run(v, dataclasses.replace(setting, iterations=None))
            step, iteration = self.part(settled, own), self._between(found, settled, truth)
        band = {r: self.uncertainty(r, truth.peaks[r.quantity]) for r in self.requirements}
        return [Bound(r, (model[r], step[r], iteration[r], band[r]), limits[r]) for r in self.requirements]

    def references(self) -> list[Reference]:
        """Those of the converged full vehicle that were made with the steps of the reference."""
        return [r for (_, model, steps), r in self._references.items() if model == Setting().model and steps == self.steps]

    def known(self, v: Variation, setting: Setting) -> Run | None:
        """A whole run that has been made."""
        if (v, setting) not in self._runs and (kept := self.kept.get(v, setting)):
            self._runs[v, setting] = kept[0]
        return self._runs.get((v, setting))

    def keep(self, v: Variation, setting: Setting, found: Run) -> None:
        """Keep a whole run that was made elsewhere."""
        with self._lock:
            self._runs[v, setting] = found
        self.kept.put(v, setting, found)
