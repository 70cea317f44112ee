"""Speed against accuracy on one scene: every way to simulate it with its errors by origin (solver.trade.bench), its
cost, and whether another one beats it. trade_report.py draws them."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from mbd_sim_ros import interrupts
from mbd_sim_ros.analysis.pages import write_text
from mbd_sim_ros.lab.studies import trade_report
from mbd_sim_ros.lab.studies.report import Report
from solver.disk import Store, digest, plain
from solver.errors import MbdError, SpecError
from solver.levels import LEVELS, derive
from solver.levels.auto import key
from solver.quantities import names as names_of
from solver.quantities import published
from solver.scene import SUBSYSTEMS, Scene
from solver.trade import cost
from solver.trade.bench import Bench, errors_of, own_of, run_of, second_of, truth_of
from solver.trade.errors import ORIGINS
from solver.trade.runs import all_of
from solver.trade.setting import RHOS, Setting, baseline, grid
from solver.trade.variations import AS_GIVEN

SUMMARY = 'speed against accuracy of one SCENE: level, switches, step, iterations, damping, tolerance'
OF_SCENE = True  # study() takes scene and workers
STANDARD = ('yaw_rate', 'sideslip_velocity', 'roll', 'lateral_acceleration', 'longitudinal_velocity', 'position')
STEPS, QUICK_STEPS = (0.01, 0.008, 0.005, 0.004, 0.002, 0.001), (0.008, 0.004)  # s
TOLERANCES = (1e-4, 1e-6)
SWITCH_STEP = 0.002  # s, of the runs without a subsystem
FINE, QUICK_FINE = (0.002, 0.001, 0.0005), (0.004, 0.002, 0.001)  # s, of the reference
COST_SECONDS, QUICK_COST_SECONDS = 2.0, 0.5  # simulated, of a measurement
Row = dict[str, Any]


def study(
    out: Path, *, quick: bool, progress: Callable[[str, float], None], scene: Scene, workers: int | None = None
) -> dict:
    """See mbd_sim_ros.lab.studies. scene: what is simulated, its fidelity, switches and integrator apart. workers: runs
    at a time.

    Finished rows and costs are kept in `out`/rows. Raises StepError when the reference fails.
    """
    full = dataclasses.replace(scene, fidelity='full', switches={}, resolved='')
    bench = Bench(full, quantities_of(scene), QUICK_FINE if quick else FINE)
    store, identity = (
        Store(out / 'rows'),
        (key(dataclasses.replace(scene, fidelity='full')), repr((bench.names, bench.steps))),
    )

    def kept(what: str, setting: Setting, make: Callable[[], Row]) -> Row:
        interrupts.now(
            f'measuring {setting}; finished rows are kept in {store.directory}, and the same command goes on from them'
        )
        interrupts.check()
        return store.made(f'{digest(*identity, what, repr(setting)).hex()}.json', make)

    progress('deriving levels', 0.0)
    levels = {level: missing(full, Setting(level=level)) for level in ('full', *(LEVELS if full.model.tires else ()))}
    settings = settings_of(full, [level for level, why in levels.items() if not why], quick)
    progress('reference', 0.01)
    truth, second = truth_of(bench, AS_GIVEN), second_of(bench)
    rows: dict[Setting, Row] = {}

    def measure(setting: Setting) -> None:
        rows[setting] = kept('errors', setting, lambda: row_of(bench, setting))
        progress(str(setting), 0.1 + 0.6 * len(rows) / len(settings))

    all_of(measure, settings, workers)
    for k, (setting, row) in enumerate((s, rows[s]) for s in settings):
        if not row['failure']:
            progress(f'cost of {setting}', 0.7 + 0.3 * k / len(settings))
            seconds = QUICK_COST_SECONDS if quick else COST_SECONDS
            row |= kept('cost', setting, lambda: cost_of(full, setting, seconds))  # noqa: B023
    shown = [{'setting': str(s), **rows[s]} for s in settings]
    mark_front(shown)
    data = trade_report.write(
        Report(out, f'Speed against accuracy: {scene.title or scene.name}'), full, truth, second, levels, shown
    )
    write_text(out / 'trade.json', json.dumps(plain(data), indent=1, allow_nan=False) + '\n')
    return data


def quantities_of(scene: Scene) -> tuple[str, ...]:
    """Quantities that a scene requires something of, and of a vehicle those that are commonly looked at. Raises
    SpecError where there is none."""
    channels = published(scene.model)
    known = names_of(channels)
    wanted = [*scene.require.accuracy, *(n for n in STANDARD if n in known)]
    loads = (
        [f'{kind}.{channels.wheels[0]}{end}' for kind, end in (('wheel_load', ''), ('tire_force', '.y'))]
        if channels.wheels
        else []
    )
    if not wanted and not loads:
        raise SpecError(
            f'scene {scene.name!r}: it has no quantities of interest; name some in require, e.g. '
            'joint_states/<joint>/position'
        )
    return tuple(dict.fromkeys([*wanted, *loads]))


def missing(scene: Scene, model: Setting) -> str:
    """Why a vehicle has not this level without these subsystems, or ''."""
    try:
        derive(model.of(scene))
    except MbdError as error:
        return str(error)
    return ''


def settings_of(scene: Scene, levels: Iterable[str], quick: bool) -> list[Setting]:
    """Every way that is looked at."""
    found = [baseline(scene)]
    steps = QUICK_STEPS if quick else STEPS
    for level in levels:
        base = Setting(level=level)  # type: ignore[arg-type]
        found += grid(base, steps, rhos=RHOS[:1] if quick else RHOS)
        found += [
            dataclasses.replace(base, h=h, tolerance=tolerance)
            for h in steps
            for tolerance in TOLERANCES[: 1 if quick else None]
        ]
        if scene.model.tires and (level == 'full' or not quick):
            without = [
                dataclasses.replace(base, h=SWITCH_STEP, iterations=2, off=(subsystem,)) for subsystem in SUBSYSTEMS
            ]
            found += [setting for setting in without if not missing(scene, setting)]
    return list(dict.fromkeys(found))


def row_of(bench: Bench, setting: Setting) -> Row:
    """One run with its errors by quantity and origin; those that its level does not model are not there."""
    row: Row = dataclasses.asdict(setting) | {'off': ', '.join(setting.off), 'failure': '', 'errors': {}}
    row.pop('other')
    try:
        own_of(bench, AS_GIVEN, setting)
    except MbdError as failure:
        return plain(row | {'failure': str(failure)})
    found = run_of(bench, AS_GIVEN, setting)
    if found.failure:
        return plain(row | {'failure': found.failure})
    peaks = truth_of(bench, AS_GIVEN).peaks
    for name, of in errors_of(bench, AS_GIVEN, setting).items():
        if name in found.curves:
            whole = of.whole
            row['errors'][name] = {
                'max': whole.max, 'rms': whole.rms, 'max_share': whole.share('max'), 'rms_share': whole.share('rms'),
                'delay': whole.delay,
                **{f'{origin}_share': getattr(of, origin).rms / peaks[name] for origin in ORIGINS[:3]},
            }  # fmt: skip
    return plain(row | {'counters': found.counters})


def cost_of(scene: Scene, setting: Setting, seconds: float) -> Row:
    """The cost of a setting, or why its run to time fails."""
    try:
        found = cost.measured(scene, setting, seconds=seconds, rounds=2)
    except MbdError as error:
        return {'failure': str(error)}
    return {'cost_median': found.median, 'cost_p99': found.p99}


def judged(row: Row, names: Sequence[str]) -> float:
    """The largest RMS error of a row as a share of the peak, over these quantities; infinite where one is not
    modelled."""
    errors = [row['errors'].get(name, {}).get('rms_share') for name in names]
    return math.inf if row['failure'] or any(e is None for e in errors) else float(max(errors))


def mark_front(rows: Sequence[Row]) -> None:
    """Set `front` of the rows that no other one beats in both cost and error (of all quantities that any row has)."""
    names = list(dict.fromkeys(name for row in rows for name in row['errors']))
    points = [(row.get('cost_median', math.inf), judged(row, names)) for row in rows]
    for row, (c, e) in zip(rows, points, strict=True):
        beaten = any((c2 <= c and e2 <= e) and (c2 < c or e2 < e) for c2, e2 in points)
        row['front'] = bool(math.isfinite(c) and math.isfinite(e) and not beaten)
