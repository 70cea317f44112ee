"""Knowledge of a vehicle that its plans share: costs of a step, what subsystems save, and errors of settings by
maneuver.

It is kept in the store of everything that is kept, under the vehicle and the sources of the program: another vehicle,
or another program, knows nothing of it, so nothing in it is out of date. Costs belong to the processor besides. What
errors were on one maneuver proves nothing for the next: it gives first answers and an order, and decides nothing that
is certified.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from collections.abc import Collection, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from solver.disk import Store, digest, sources
from solver.elements.road import RoadSpec
from solver.inputs.signals import Constant, signal
from solver.scene import Scene
from solver.trade.bench import FULL, Bench, converging, cost_of
from solver.trade.cost import PerStep
from solver.trade.errors import Requirement
from solver.trade.setting import Setting, baseline
from solver.trade.variations import AS_GIVEN

CHOSEN: dict[str, Any] = {
    'kind': 'alf',
    'h': 1e-3,
    'rho_inf': 0.8,
    'mode': 'fixed',
    'iterations': 1,
    'tolerance': 1e-8,
    'order': 2,
}
LEARNED = 12  # runs whose errors a plan leaves, the coarsest
MOST = 400  # entries of errors that are kept, the youngest; ten times as many would take longer to read than they save
Errors = dict[str, dict[str, float]]  # quantity -> max, rms (in its unit) and peak


class Knowledge:
    """Knowledge that plans of the vehicle of a scene have left. directory: None knows nothing and keeps nothing."""

    def __init__(self, directory: Path | None, scene: Scene) -> None:
        self._store = None if directory is None else Store(directory, bounded=True)
        self._name = f'{digest(sources(), *map(repr, _vehicle(scene))).hex()}.json'
        even = '' if not scene.model.road.grids else ', uneven road'
        # what a step costs depends on
        self.machine = f'{processor()}{even}{", a call a step" if scene.maneuver.closed_loop else ""}'
        self._data = self._read()

    def _read(self) -> dict[str, Any]:
        content = None if self._store is None else self._store.read(self._name, self._name)
        return {'plans': 0, 'prices': {}, 'levels': [], 'errors': []} if content is None else json.loads(content)

    @property
    def plans(self) -> int:
        """Plans of this vehicle that have ended and left something here."""
        return self._data['plans']

    @property
    def derived(self) -> frozenset[str]:
        """Levels that have been derived, and are kept."""
        return frozenset(self._data['levels'])

    def prices(self) -> dict[tuple[str, tuple[str, ...]], PerStep]:
        """Model (level, what is off) -> cost of a step of it on this processor."""
        found = self._data['prices'].get(self.machine, {})
        return {_model(name): PerStep(*price) for name, price in found.items()}

    def saved(self, base: Setting, evaluations: float) -> dict[str, float]:
        """Subsystem -> cost of a step of the level of `base` without it, relative to that with it, so far as it is
        known."""
        prices = self.prices()
        whole = prices.get((base.level, ()))
        if whole is None:
            return {}
        alone = {off[0]: price for (level, off), price in prices.items() if level == base.level and len(off) == 1}
        return {name: price.of(1.0, evaluations) / whole.of(1.0, evaluations) for name, price in alone.items()}

    def errors(self, maneuver: str) -> list[tuple[Setting, float, list[Errors]]]:
        """(setting, its cost relative to the full vehicle, its errors on every maneuver), cheapest first: of maneuvers
        of this kind, of all where there is none of it."""
        there = [e for e in self._data['errors'] if e['maneuver'] == maneuver] or self._data['errors']
        found: dict[Setting, tuple[float, list[Errors]]] = {}
        for entry in there:
            setting = Setting(**{**entry['setting'], 'off': tuple(entry['setting']['off']), 'other': ()})
            found.setdefault(setting, (entry['cost'], []))[1].append(entry['errors'])
        return sorted(((s, c, e) for s, (c, e) in found.items()), key=lambda each: each[1])

    def of_kind(self, maneuver: str) -> bool:
        """True where errors on a maneuver of this kind are known."""
        return any(entry['maneuver'] == maneuver for entry in self._data['errors'])

    def learn_from(self, bench: Bench, shown: Collection[str]) -> None:
        """Add what a plan has measured to what is kept by now: costs, levels, and the errors of coarse runs in the
        quantities `shown`. Nothing is kept where nothing can be written."""
        if self._store is None:
            return
        made = tuple(bench.made.items())
        prices: dict[Any, PerStep] = {key[1]: price for key, price in made if key[0] == 'price'}
        runs = [run for key, run in made if key[:2] == ('run', AS_GIVEN) and not run.failure and run.setting.iterations]
        truth = bench.made.get(('limit', AS_GIVEN, converging(FULL, bench.steps)))
        data, kind, full = self._read(), maneuver_of(bench.scene), baseline(bench.scene)
        found = []
        for run in sorted(runs, key=lambda run: -run.setting.h)[:LEARNED]:
            if truth is None or not {run.setting.model, full.model} <= prices.keys():
                continue
            departed = truth.errors(run, [name for name in shown if name in run.curves])
            errors = {name: {'max': d.max, 'rms': d.rms, 'peak': truth.peaks[name]} for name, d in departed.items()}
            if all(math.isfinite(value) for one in errors.values() for value in one.values()):
                cost = cost_of(bench, run.setting, run) / cost_of(bench, full)
                found.append(
                    {'maneuver': kind, 'setting': dataclasses.asdict(run.setting), 'cost': cost, 'errors': errors}
                )
        data['plans'] += 1
        data['levels'] = sorted({*data['levels'], *(run.setting.level for run in runs)})
        data['prices'].setdefault(self.machine, {}).update(
            {_name(model): list(price) for model, price in prices.items()}
        )
        data['errors'] = [*data['errors'], *found][-MOST:]
        self._data = data
        with suppress(OSError):
            self._store.write(self._name, json.dumps(data, allow_nan=False).encode(), self._name)


def keeps(requirements: Iterable[Requirement], seen: Iterable[Errors], share: float) -> bool:
    """True where errors that were seen are within this share of all limits, each on its own maneuver; a delay is never
    known."""
    for errors in seen:
        for r in requirements:
            one = errors.get(r.quantity)
            if one is None or r.measure == 'delay' or one[r.measure] > share * r.limit(one['peak']):
                return False
    return True


def maneuver_of(scene: Scene) -> str:
    """The kind of a maneuver: by what steers, whether it is braked, and whether the road is even. Maneuvers of one kind
    differ in size."""
    maneuver = scene.maneuver
    if maneuver.bag:
        steered = 'recorded'
    elif maneuver.driver is not None:
        steered = f'driver along {type(maneuver.driver.path).__name__}'
    else:
        given = signal(maneuver.road_wheel) if maneuver.by_road_wheel else signal(maneuver.steering)
        steered = 'straight' if given == Constant() else type(given).__name__
    braked = ', braked' if signal(maneuver.brake_torque) != Constant() else ''
    return f'{steered}{braked}{", uneven road" if scene.model.road.grids else ""}'


@functools.cache
def processor() -> str:
    """The processor, to which costs belong."""
    with suppress(OSError):
        for line in Path('/proc/cpuinfo').read_text(encoding='utf-8').splitlines():
            if line.startswith('model name'):
                return line.partition(':')[2].strip()
    return ''


def _vehicle(scene: Scene) -> tuple[Any, ...]:
    """Everything of a scene that is of the vehicle and of the method, not of the maneuver and the road."""
    return dataclasses.replace(scene.model, road=RoadSpec()), dataclasses.replace(scene.integrator, **CHOSEN)


def _name(model: tuple[str, tuple[str, ...]]) -> str:
    return ' without '.join((model[0], *model[1]))


def _model(name: str) -> tuple[str, tuple[str, ...]]:
    level, *off = name.split(' without ')
    return level, tuple(off)
