"""The bench of a scene: runs, converged references, errors by origin and costs of its settings, each made once.

A `Bench` is a frozen record. Its memory holds all that was measured, and a changed copy (dataclasses.replace) shares it.
The functions are named after what they return, for a maneuver `v` (solver.trade.variations) and a setting. Threads may
call them at the same time.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

from solver import simulation_of
from solver.analysis.departures import Departure
from solver.findings import Finding
from solver.scene import Scene
from solver.trade import cost, reference
from solver.trade.errors import Error, Requirement, by_origin
from solver.trade.kept_runs import NOWHERE, KeptRuns
from solver.trade.reference import Reference
from solver.trade.runs import Going, Run, run
from solver.trade.setting import ITERATIONS, Setting
from solver.trade.variations import AS_GIVEN, Variation, varied

FULL = Setting()
Key = tuple[Hashable, ...]


@dataclass(frozen=True)
class Bench:
    """A scene on the bench.

    scene: the full vehicle, nothing switched off. names: quantities that runs are seen through. steps: [s] of the
    converged full vehicle, coarsest first. requirements: limits that settings are held against. seen: maneuvers that serve
    to choose. stop(): says that runs shall end, by Stopped. kept: whole runs on disk. made: the memory; locks: one for
    each entry, so that threads wait for what another one makes.
    """

    scene: Scene
    names: tuple[str, ...]
    steps: tuple[float, ...]
    requirements: tuple[Requirement, ...] = ()
    seen: tuple[Variation, ...] = (AS_GIVEN,)
    stop: Callable[[], bool] | None = None
    kept: KeptRuns = NOWHERE
    made: dict[Key, Any] = field(default_factory=dict)
    locks: dict[Key, Lock] = field(default_factory=lambda: defaultdict(Lock))


def _once(bench: Bench, make: Callable[[], Any], *key: Hashable) -> Any:
    """The entry of the memory under this key, made now where there is none."""
    with bench.locks[key]:
        if key not in bench.made:
            bench.made[key] = make()
    return bench.made[key]


def scene_of(bench: Bench, v: Variation) -> Scene:
    """The scene with another maneuver."""
    return _once(bench, lambda: bench.scene if v == AS_GIVEN else varied(bench.scene, v), 'scene', v)


def run_of(bench: Bench, v: Variation, setting: Setting, start: bytes | None = None) -> Run:
    """A whole run. start: see run(); it belongs to the setting. Raises Stopped."""

    def make() -> Run:
        found = run(scene_of(bench, v), setting, bench.names, stop=bench.stop, start=start)
        bench.kept.put(v, setting, found)
        return found

    return known(bench, v, setting) or _once(bench, make, 'run', v, setting)


def known(bench: Bench, v: Variation, setting: Setting) -> Run | None:
    """A whole run that has been made."""
    if ('run', v, setting) not in bench.made and (there := bench.kept.get(v, setting)):
        bench.made['run', v, setting] = there[0]
    return bench.made.get(('run', v, setting))


def keep(bench: Bench, v: Variation, setting: Setting, found: Run) -> None:
    """Keep a whole run that was made elsewhere."""
    bench.made['run', v, setting] = found
    bench.kept.put(v, setting, found)


def findings_of(bench: Bench, v: Variation, setting: Setting) -> tuple[Finding, ...]:
    """The findings that would make this run suspect (solver.analysis.verdict); none of a run that fails. Raises Stopped."""

    def make() -> tuple[Finding, ...]:
        kept = bench.kept.get(v, setting, judged=True)
        if not kept:
            going = Going(scene_of(bench, v), setting, bench.names, stop=bench.stop, audit=True)
            kept = going.to(bench.scene.duration), going.findings()
            bench.kept.put(v, setting, *kept)
        bench.made.setdefault(('run', v, setting), kept[0])
        return kept[1]

    return _once(bench, make, 'findings', v, setting)


def limit_of(bench: Bench, v: Variation, model: Setting, steps: tuple[float, ...]) -> Reference:
    """The converged solution of the model of a setting, from runs with these steps. Raises StepError and Stopped."""

    def make() -> Reference:
        base = Setting(level=model.level, off=model.off)
        return reference.of_runs(scene_of(bench, v), [run_of(bench, v, reference.with_step(base, h)) for h in steps])

    return _once(bench, make, 'limit', v, model.model, steps)


def truth_of(bench: Bench, v: Variation) -> Reference:
    """The converged full vehicle: by all steps on a maneuver that serves to choose, by the two finest elsewhere. Raises
    StepError and Stopped."""
    return limit_of(bench, v, FULL, bench.steps if v in bench.seen else bench.steps[1:])


def second_of(bench: Bench, *, finest: bool = True) -> dict[str, Departure]:
    """The distance between the converged full vehicle and the limit of another formulation of it from the same start: by
    its two finest steps, or by the two before, which are as far from it as its band says. Raises StepError and Stopped.

    (Where a vehicle settles before t = 0 depends a little on rho_inf. A setting with another one is charged with that,
    the equations are not.)
    """
    truth, steps = truth_of(bench, AS_GIVEN), bench.steps[-2:] if finest else bench.steps[-3:-1]
    start = simulation_of(truth.runs[-1].setting.of(bench.scene)).save()
    settings = [reference.second(reference.with_step(FULL, h)) for h in steps]
    other = reference.of_runs(bench.scene, [run_of(bench, AS_GIVEN, one, start) for one in settings])
    return truth.errors(other.as_run)


def own_of(bench: Bench, v: Variation, setting: Setting) -> Reference:
    """The converged level of a setting without what it switches off. Raises StepError and Stopped."""
    return truth_of(bench, v) if setting.model == FULL.model else limit_of(bench, v, setting, bench.steps[1:])


def settled(setting: Setting) -> Setting:
    """The setting iterated until nothing changes."""
    return dataclasses.replace(setting, iterations=None, tolerance=FULL.tolerance)


def errors_of(bench: Bench, v: Variation, setting: Setting) -> dict[str, Error]:
    """Errors of a setting by quantity and origin. Raises StepError and Stopped."""
    own, truth, found = own_of(bench, v, setting), truth_of(bench, v), run_of(bench, v, setting)
    return by_origin(truth, own, run_of(bench, v, settled(setting)), found)


def truths(bench: Bench) -> list[Reference]:
    """The converged full vehicle on those maneuvers that serve to choose, as far as it was made."""
    keys = (('limit', v, FULL.model, bench.steps) for v in bench.seen)
    return [bench.made[key] for key in keys if key in bench.made]


def per_step(bench: Bench, setting: Setting) -> cost.PerStep:
    """Cost of a step of a model. Raises MbdError."""
    return _once(bench, lambda: cost.per_step(bench.scene, Setting(level=setting.level, off=setting.off)), 'price', setting.model)


def cost_of(bench: Bench, setting: Setting, found: Run | None = None) -> float:
    """CPU seconds per simulated second, by the counters of a run; without one by what its iterations should take. Raises
    MbdError."""
    model = per_step(bench, setting)
    evaluations = model.expected(setting.iterations or ITERATIONS[-1]) if found is None else found.counters['evaluations']
    return model.of(setting.h, evaluations)
