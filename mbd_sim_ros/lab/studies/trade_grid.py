"""Every way to simulate one scene: errors by origin, cost, and which of them nothing else beats."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros import interrupts
from solver.analysis.departures import Departure
from solver.disk import Store, digest, plain
from solver.errors import MbdError, SpecError
from solver.levels import LEVELS, derive
from solver.levels.auto import key
from solver.quantities import names as names_of
from solver.quantities import published
from solver.scene import SUBSYSTEMS, Scene
from solver.trade import cost, reference
from solver.trade.reference import Reference
from solver.trade.runs import Run, departures, run
from solver.trade.setting import Setting, baseline

STANDARD = ('yaw_rate', 'sideslip_velocity', 'roll', 'lateral_acceleration', 'longitudinal_velocity', 'position')
STEPS = (0.01, 0.008, 0.005, 0.004, 0.002, 0.001)
QUICK_STEPS = (0.008, 0.004)
ITERATIONS = (1, 2, 3)
RHOS = (0.8, 0.5)
TOLERANCES = (1e-4, 1e-6)
SWITCH_STEP = 0.002  # s, of the runs without a subsystem
FINE = (0.002, 0.001, 0.0005)  # s, of the reference
QUICK_FINE = (0.004, 0.002, 0.001)
ORIGINS = ('model', 'step', 'iteration')
COST_SECONDS, QUICK_COST_SECONDS = 2.0, 0.5  # simulated, of a measurement
AGREE = 0.002  # of the peak: what the two formulations may differ by
Row = dict[str, Any]


class Grid:
    """All runs of a study. Rows of a finished one are kept in `out`/rows, named after everything they depend on."""

    def __init__(self, scene: Scene, out: Path, *, quick: bool, workers: int | None, progress: Callable[[str, float], None]) -> None:
        self.scene = dataclasses.replace(scene, fidelity='full', switches={}, resolved='')
        self.quick, self.workers, self._progress = quick, workers, progress
        channels = published(scene.model)
        known = names_of(channels)
        wanted = [*scene.require.accuracy, *(n for n in STANDARD if n in known)]
        loads = [f'{kind}.{channels.wheels[0]}{end}' for kind, end in (('wheel_load', ''), ('tire_force', '.y'))] if channels.wheels else []
        self.names = list(dict.fromkeys([*wanted, *loads]))
        if not self.names:
            raise SpecError(
                f'scene {scene.name!r}: it has no quantities of interest; name some in require, e.g. joint_states/<joint>/position'
            )
        self.rows: list[Row] = []
        self.levels: dict[str, str] = {}
        self.truth: Reference
        self.second: dict[str, Departure] = {}
        self._kept = Store(out / 'rows')
        self._identity = key(dataclasses.replace(scene, fidelity='full'))
        self._own: dict[tuple[str, tuple[str, ...]], Reference | str] = {}
        self._settled: dict[Setting, Run] = {}

    @property
    def fine(self) -> tuple[float, ...]:
        """Steps of the reference [s]."""
        return QUICK_FINE if self.quick else FINE

    def settings(self) -> list[Setting]:
        """The grid. Raises nothing: a level that a vehicle has not is a row that failed."""
        steps, rhos = (QUICK_STEPS, RHOS[:1]) if self.quick else (STEPS, RHOS)
        levels = ['full', *LEVELS] if self.scene.model.tires else ['full']
        found = [baseline(self.scene)]
        for level in levels:
            why = self._level(level)
            self.levels[level] = why
            if why:
                continue
            base = Setting(level=level)  # type: ignore[arg-type]
            found += [dataclasses.replace(base, h=h, iterations=n, rho_inf=r) for h in steps for n in ITERATIONS for r in rhos]
            tolerances = TOLERANCES[:1] if self.quick else TOLERANCES
            found += [dataclasses.replace(base, h=h, tolerance=tolerance) for h in steps for tolerance in tolerances]
            offs = [(s,) for s in self._switches(base)]
            found += [dataclasses.replace(base, h=SWITCH_STEP, iterations=2, off=off) for off in offs]
        return list(dict.fromkeys(found))

    def _level(self, level: str) -> str:
        try:
            derive(Setting(level=level).of(self.scene))  # type: ignore[arg-type]
        except MbdError as error:
            return str(error)
        return ''

    def _switches(self, base: Setting) -> list[str]:
        if not self.scene.model.tires or (self.quick and base.level != 'full'):
            return []
        found = []
        for subsystem in SUBSYSTEMS:
            try:
                derive(dataclasses.replace(base, off=(subsystem,)).of(self.scene))
            except MbdError:
                continue
            found.append(subsystem)
        return found

    def run(self) -> None:
        """Reference, every row that is not kept, and then their costs one after the other. Raises StepError when the reference fails."""
        self._progress('deriving levels', 0.0)
        settings = self.settings()
        kept = {s: self._read(s) for s in settings}
        self._progress('reference', 0.01)
        self._references(settings, [s for s in settings if kept[s] is None])
        missing = [s for s in settings if kept[s] is None]
        done = 0
        with ThreadPoolExecutor(self.workers or os.cpu_count()) as pool:
            futures = {pool.submit(self.row, s): s for s in missing}
            try:
                for future in as_completed(futures):
                    interrupts.check()
                    setting = futures[future]
                    kept[setting] = future.result()
                    self._write(setting, kept[setting])
                    done += 1
                    self._progress(str(setting), 0.1 + 0.6 * done / len(missing))
            finally:
                for future in futures:
                    future.cancel()
        for k, setting in enumerate(settings):
            row = kept[setting]
            assert row is not None
            if not row['failure'] and 'cost_median' not in row:
                interrupts.check()
                self._progress(f'cost of {setting}', 0.7 + 0.3 * k / len(settings))
                self._measure(setting, row)
                self._write(setting, row)
        self.rows = [{'setting': str(s), **row} for s in settings if (row := kept[s]) is not None]
        mark_front(self.rows)

    def _references(self, settings: Sequence[Setting], missing: Sequence[Setting]) -> None:
        self.truth = reference.converged(self.scene, Setting(), self.names, self.fine)
        self.second = reference.second_formulation(self.scene, self.truth)
        self._own[Setting().model] = self.truth
        for model in dict.fromkeys(s.model for s in settings):
            if model in self._own or not any(s.model == model for s in missing):
                continue
            level, off = model
            try:
                self._own[model] = reference.converged(self.scene, Setting(level=level, off=off), self.names, self.fine[1:])  # type: ignore[arg-type]
            except MbdError as error:
                self._own[model] = str(error)

    def row(self, setting: Setting) -> Row:
        """One run with its errors by quantity and origin."""
        row: Row = dataclasses.asdict(setting) | {'off': ', '.join(setting.off), 'failure': '', 'errors': {}}
        row.pop('other')
        own = self._own[setting.model]
        if isinstance(own, str):
            return row | {'failure': own}
        found = run(self.scene, setting, self.names)
        if found.failure:
            return row | {'failure': found.failure}
        settled = self._settle(setting)
        total, model = self.truth.errors(found), self.truth.errors(Run(setting, own.time, own.curves, {}, ''))
        step = own.errors(settled) if not settled.failure else dict.fromkeys(self.names)
        parts = departures(found, settled.time, settled.curves, self.truth.quantities, self.truth.peaks) if not settled.failure else {}
        for name in self.names:
            if name not in found.curves:
                continue
            of = {'model': model[name], 'step': step[name], 'iteration': parts.get(name)}
            row['errors'][name] = {
                'max': total[name].max,
                'rms': total[name].rms,
                'max_share': total[name].share('max'),
                'rms_share': total[name].share('rms'),
                'delay': total[name].delay,
                **{f'{o}_share': None if (d := of[o]) is None else d.rms / self.truth.peaks[name] for o in ORIGINS},
            }
        return plain(row | {'counters': found.counters})

    def _settle(self, setting: Setting) -> Run:
        """The setting iterated until nothing changes."""
        wanted = dataclasses.replace(setting, iterations=None, tolerance=Setting().tolerance)
        if wanted not in self._settled:
            self._settled[wanted] = run(self.scene, wanted, self.names)
        return self._settled[wanted]

    def _measure(self, setting: Setting, row: Row) -> None:
        try:
            found = cost.measured(self.scene, setting, seconds=QUICK_COST_SECONDS if self.quick else COST_SECONDS, rounds=2)
        except MbdError as error:
            row['failure'] = str(error)
            return
        row |= {'cost_median': found.median, 'cost_p99': found.p99}

    def _name(self, setting: Setting) -> str:
        return f'{digest(self._identity, repr(setting), repr((self.names, self.fine))).hex()}.json'

    def _read(self, setting: Setting) -> Row | None:
        content = self._kept.read(self._name(setting))
        return None if content is None else json.loads(content)

    def _write(self, setting: Setting, row: Row | None) -> None:
        self._kept.write(self._name(setting), json.dumps(plain(row), allow_nan=False).encode())


def judged(row: Row, names: Sequence[str]) -> float:
    """The largest RMS error of a row as a share of the peak, over these quantities; infinite where one is not modelled."""
    errors = [row['errors'].get(name, {}).get('rms_share') for name in names]
    return math.inf if row['failure'] or any(e is None for e in errors) else float(max(errors))


def mark_front(rows: Sequence[Row], names: Sequence[str] | None = None) -> None:
    """Set `front` of the rows that no other one beats in both cost and error (of all quantities that any row has)."""
    everything = list(dict.fromkeys(n for row in rows for n in row['errors'])) if names is None else list(names)
    points = [(row.get('cost_median', math.inf), judged(row, everything)) for row in rows]
    for row, (c, e) in zip(rows, points, strict=True):
        beaten = any((c2 <= c and e2 <= e) and (c2 < c or e2 < e) for c2, e2 in points)
        row['front'] = bool(np.isfinite(c) and np.isfinite(e) and not beaten)
