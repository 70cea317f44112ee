"""The bench of a scene: runs, converged references, errors by origin and costs of its settings, each made once.

A `Bench` is a frozen record. Its memory holds all that was measured, and a changed copy (dataclasses.replace) shares
it. The functions are named after what they return, for a maneuver `v` (solver.trade.variations) and a setting. Threads
may call them at the same time.
"""

from __future__ import annotations

import dataclasses
import time
from collections import defaultdict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from functools import partial
from threading import Lock
from typing import Any

from solver import simulation_of
from solver.analysis.departures import Departure
from solver.findings import Finding
from solver.levels import derive, integrator_of
from solver.levels.derived import Derived
from solver.scene import Scene
from solver.simulation import Simulation
from solver.trade import cost, reference
from solver.trade.errors import Error, Requirement, by_origin, without
from solver.trade.kept_runs import NOWHERE, KeptRuns
from solver.trade.ledger import Ledger
from solver.trade.reference import Reference
from solver.trade.runs import Going, Run, Stopped, run
from solver.trade.setting import ITERATIONS, Setting
from solver.trade.variations import AS_GIVEN, Variation, varied

FULL = Setting()
Key = tuple[Hashable, ...]
# CPU time [s] of a derivation that is kept for the next plan: one that is found takes a tenth. With ten times as much
# that of a single track alone would be so.
ONCE = 0.5


@dataclass(frozen=True)
class Bench:
    """A scene on the bench.

    scene: the full vehicle, nothing switched off. names: quantities that runs are seen through. steps: [s] of the
    converged full vehicle, coarsest first. requirements: limits that settings are held against. seen: maneuvers that
    serve to choose. apart: settings of the full vehicle, coarse one first, that serve as reference on other maneuvers
    than that of the scene, as they are or extrapolated (solver.trade.elsewhere); none: the two finest steps do. falls:
    what of the band of the reference counts as its error: bands fall with the steps, and that of the finest limit is
    the next one. stop(ahead): says that runs shall end, by Stopped, or that nothing shall begin that takes `ahead`
    seconds. kept: whole runs on disk. ledger: what was spent. made:
    the memory; locks: one for each entry, so that threads wait for what another one makes.
    """

    scene: Scene
    names: tuple[str, ...]
    steps: tuple[float, ...]
    requirements: tuple[Requirement, ...] = ()
    seen: tuple[Variation, ...] = (AS_GIVEN,)
    apart: tuple[Setting, ...] = ()
    falls: float = 1.0
    stop: Callable[..., bool] | None = None
    kept: KeptRuns = NOWHERE
    ledger: Ledger = field(default_factory=Ledger)
    made: dict[Key, Any] = field(default_factory=dict)
    locks: dict[Key, Lock] = field(default_factory=lambda: defaultdict(Lock))

    @property
    def required(self) -> frozenset[str]:
        """Names of the quantities that are required."""
        return frozenset(r.quantity for r in self.requirements) or frozenset(self.names)


def _once(bench: Bench, make: Callable[[], Any], *key: Hashable) -> Any:
    """The entry of the memory under this key, made now where there is none."""
    with bench.locks[key]:
        if key not in bench.made:
            bench.made[key] = make()
        return bench.made[key]


def scene_of(bench: Bench, v: Variation) -> Scene:
    """The scene with another maneuver."""
    return _once(bench, lambda: bench.scene if v == AS_GIVEN else varied(bench.scene, v), 'scene', v)


def derived(bench: Bench, setting: Setting) -> Derived:
    """The level of a setting. What takes long is kept for the vehicle, and time that is spent once. Raises MbdError."""

    def make() -> Derived:
        begin = time.thread_time()
        with bench.ledger.timed():
            found = derive(Setting(level=setting.level, off=setting.off).of(bench.scene))
        if (took := time.thread_time() - begin) > ONCE:
            bench.ledger.add(once=took)
        return found

    return _once(bench, make, 'derived', setting.model)


def simulation(bench: Bench, v: Variation, setting: Setting) -> Simulation:
    """The simulation of a setting at its start, which is sought once for a model and a maneuver: it does not depend on
    step, iterations and damping. Raises MbdError, and Stopped where the time for a start is not left."""

    def make() -> Simulation:
        ahead = bench.made.get(('start time', setting.model), bench.made.get(('start time', FULL.model), 0.0))
        if bench.stop is not None and bench.stop(ahead):
            raise Stopped
        begin = time.thread_time()
        with bench.ledger.timed(starts=1):
            found = simulation_of(Setting(level=setting.level, off=setting.off).of(scene_of(bench, v)))
        bench.made.setdefault(('start time', setting.model), time.thread_time() - begin)
        return found

    settings = integrator_of(
        setting.level, dataclasses.replace(bench.scene.integrator, **setting.integrator(bench.scene))
    )
    each = {field.name: getattr(settings, field.name) for field in dataclasses.fields(settings)}
    return _once(bench, make, 'start', v, setting.model).twin(bench.scene.duration, **each)


def start_time_of(bench: Bench, setting: Setting) -> float:
    """CPU time [s] that the start of a model takes. Raises MbdError."""
    simulation(bench, AS_GIVEN, setting)
    return bench.made['start time', setting.model]


def forget_starts(bench: Bench, v: Variation) -> None:
    """Forget the simulations at the start of a maneuver, which are larger than its curves."""
    for key in [key for key in tuple(bench.made) if key[:2] == ('start', v)]:
        bench.made.pop(key, None)


def run_of(bench: Bench, v: Variation, setting: Setting) -> Run:
    """A whole run. Raises Stopped."""

    def make() -> Run:
        with bench.ledger.timed():
            found = run(
                scene_of(bench, v), setting, bench.names, stop=bench.stop, make=partial(simulation, bench, v, setting)
            )
        bench.ledger.add(runs=1, steps=int(found.counters.get('steps', 0)))
        bench.kept.put(v, setting, found)
        return found

    return known(bench, v, setting) or _once(bench, make, 'run', v, setting)


def known(bench: Bench, v: Variation, setting: Setting) -> Run | None:
    """A whole run that has been made."""
    if ('run', v, setting) not in bench.made and (there := bench.kept.get(v, setting)):
        bench.made['run', v, setting] = there[0]
    return bench.made.get(('run', v, setting))


def keep(bench: Bench, v: Variation, setting: Setting, found: Run, findings: tuple[Finding, ...]) -> None:
    """Keep a whole run that was made elsewhere, with the findings that would make it suspect."""
    bench.made['run', v, setting] = found
    bench.made['findings', v, setting] = findings
    bench.kept.put(v, setting, found, findings)


def findings_of(bench: Bench, v: Variation, setting: Setting) -> tuple[Finding, ...]:
    """The findings that would make this run suspect (solver.analysis.verdict); none of a run that fails. Raises
    Stopped."""

    def make() -> tuple[Finding, ...]:
        kept = bench.kept.get(v, setting, judged=True)
        if not kept:
            with bench.ledger.timed():
                going = going_of(bench, v, setting, audit=True)
                kept = going.to(bench.scene.duration), going.findings()
            bench.ledger.add(runs=1, steps=int(kept[0].counters.get('steps', 0)))
            bench.kept.put(v, setting, *kept)
        bench.made.setdefault(('run', v, setting), kept[0])
        return kept[1]

    return _once(bench, make, 'findings', v, setting)


def going_of(bench: Bench, v: Variation, setting: Setting, *, audit: bool = False) -> Going:
    """A run that begins. audit: as Going takes it."""
    make = partial(simulation, bench, v, setting)
    return Going(scene_of(bench, v), setting, bench.names, stop=bench.stop, make=make, audit=audit)


def limit_of(bench: Bench, v: Variation, settings: tuple[Setting, ...]) -> Reference:
    """The solution of a model that runs with these settings, coarsest step first, are extrapolated to. Raises StepError
    and Stopped."""

    def make() -> Reference:
        return reference.of_runs(scene_of(bench, v), [run_of(bench, v, one) for one in settings])

    return _once(bench, make, 'limit', v, settings)


def converging(model: Setting, steps: Sequence[float]) -> tuple[Setting, ...]:
    """The settings of a model iterated to tolerance, one a step."""
    base = Setting(level=model.level, off=model.off)
    return tuple(reference.with_step(base, h) for h in steps)


def truth_of(bench: Bench, v: Variation) -> Reference:
    """The converged full vehicle: by all steps on the maneuver of the scene, elsewhere by `apart` or the two finest
    steps. Raises StepError and Stopped."""
    if v == AS_GIVEN:
        return limit_of(bench, v, converging(FULL, bench.steps))
    return limit_of(bench, v, bench.apart or converging(FULL, bench.steps[1:]))


def apart_of(bench: Bench, settings: tuple[Setting, ...]) -> dict[str, Departure]:
    """The errors, on the maneuver of the scene, of what these settings are extrapolated to. Raises StepError and
    Stopped."""
    return _once(
        bench,
        lambda: truth_of(bench, AS_GIVEN).errors(limit_of(bench, AS_GIVEN, settings).as_run, bench.required),
        'apart', settings, bench.steps,
    )  # fmt: skip


def second_of(bench: Bench, steps: Sequence[float] = ()) -> dict[str, Departure]:
    """The distance between the converged full vehicle and the limit of another formulation of it from the same start,
    with these steps; with its two finest where none are given. Raises StepError and Stopped."""
    settings = tuple(reference.second(reference.with_step(FULL, h)) for h in steps or bench.steps[-2:])
    return truth_of(bench, AS_GIVEN).errors(limit_of(bench, AS_GIVEN, settings).as_run)


def own_of(bench: Bench, v: Variation, setting: Setting) -> Reference:
    """The converged level of a setting without what it switches off. Raises StepError and Stopped."""
    return (
        truth_of(bench, v) if setting.model == FULL.model else limit_of(bench, v, converging(setting, bench.steps[1:]))
    )


def settled(setting: Setting) -> Setting:
    """The setting iterated until nothing changes."""
    return dataclasses.replace(setting, iterations=None, tolerance=FULL.tolerance)


def errors_of(bench: Bench, v: Variation, setting: Setting) -> dict[str, Error]:
    """Errors of a setting by quantity and origin. Raises StepError and Stopped.

    Where subsystems are off it is held against the same setting with all of them: what they change there counts to the
    model, and the errors of model, step and iteration of that one to its own. So the model without them need not be
    converged.
    """
    truth, found = truth_of(bench, v), run_of(bench, v, setting)
    if setting.off:
        with_all = dataclasses.replace(setting, off=())
        return without(truth, errors_of(bench, v, with_all), run_of(bench, v, with_all), found)
    own = own_of(bench, v, setting)
    return by_origin(truth, own, run_of(bench, v, settled(setting)), found, bench.required)


def per_step(bench: Bench, setting: Setting) -> cost.PerStep:
    """Cost of a step of a model. Raises MbdError."""
    model = Setting(level=setting.level, off=setting.off)

    def make() -> cost.PerStep:
        with bench.ledger.timed():
            return cost.per_step(bench.scene, model, make=partial(simulation, bench, AS_GIVEN))

    return _once(bench, make, 'price', setting.model)


def cost_of(bench: Bench, setting: Setting, found: Run | None = None) -> float:
    """CPU seconds per simulated second, by the counters of a run; without one by what its iterations should take.
    Raises MbdError."""
    model = per_step(bench, setting)
    evaluations = (
        model.expected(setting.iterations or ITERATIONS[-1]) if found is None else found.counters['evaluations']
    )
    return model.of(setting.h, evaluations)
