"""Study of the plans: what `mbd plan` chooses on six scenes with three requirements each, what it takes, held against
maneuvers it has not seen and against the cheapest of the whole grid, which is looked for afterwards."""

from __future__ import annotations

import dataclasses
import math
import os
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from mbd_sim_ros.lab.studies.cells import Cells, number
from mbd_sim_ros.lab.studies.report import Report
from solver.errors import MbdError
from solver.files.scene import load_scene, load_scene_text
from solver.levels import LEVELS
from solver.scene import Scene
from solver.trade import reference
from solver.trade.allowance import LONGEST, TIMES, Allowance
from solver.trade.bench import Bench, cost_of, known, per_step
from solver.trade.certificate import OK, plan
from solver.trade.errors import ORIGINS
from solver.trade.first import RULE, TWIN
from solver.trade.judging import Check, bounds_of, broken, check
from solver.trade.ledger import PURPOSES
from solver.trade.search import UNSEEN, Search
from solver.trade.setting import Setting, baseline
from solver.trade.variations import Variation, effective, inside

SUMMARY = (
    'plans of six scenes with three requirements each: maneuvers they have not seen, cost against the cheapest '
    'of the grid, time'
)
CORES = 2  # that a plan has LONGEST seconds on
LEAST_UNSEEN = 20
DEAREST = 1.5  # of the cheapest of the grid
ALLOWED = 180.0  # s on CORES
SMALL = 1e-3  # s: at most this is a small step

CRUISE = """
vehicle: vehicles/full_car.yaml
start: {kind: equilibrium, speed_kmh: 80}
maneuver: {name: cruise, drive_torque: 170}
integrator: {iterations: 2}
duration: 4
"""
SCENES: dict[str, Callable[[list[str]], Scene]] = {
    'level cruise': lambda more: load_scene_text(CRUISE, 'cruise', more),
    'step steer': lambda more: load_scene('car_step_steer', ['duration=4', *more]),
    'swept steer at the limit': lambda more: load_scene('car_swept_steer', ['duration=6', *more]),
    'double lane change': lambda more: load_scene('car_lane_change', ['duration=6.5', *more]),
    'braking on split friction': lambda more: load_scene(
        'car_split_mu_brake', ['duration=4', 'maneuver.brake_torque.start=0.5', *more]
    ),
    'rough road': lambda more: load_scene('car_rough_road', ['duration=4', *more]),
}
YAW = '{yaw_rate: {rms: 5 %}}'
HANDLING = '{yaw_rate: {rms: 1 %}, sideslip_velocity: {rms: 1 %}, roll: {rms: 2 %}, position: {max: 0.1 m}}'
LOADS = '{wheel_load.front_left: {rms: 1 %}, wheel_load.rear_right: {rms: 1 %}}'
EXACT = '{position: {max: 1.0e-5 m}}'
IMPOSSIBLE = '{position: {max: 1.0e-13 m}}'


class Wish(NamedTuple):
    """A plan to be made."""

    scene: str
    require: str

    def __str__(self) -> str:
        return f'{self.scene}, {self.require}'


WISHES = (
    *(Wish(scene, LOADS) for scene in SCENES),
    *(Wish(scene, YAW) for scene in SCENES if scene not in ('level cruise', 'rough road')),
    Wish('level cruise', '{longitudinal_velocity: {rms: 0.1 %}, position: {max: 0.1 m}}'),
    Wish('rough road', '{roll: {rms: 5 %}, position: {max: 0.1 m}}'),
    Wish('step steer', EXACT),
    Wish('level cruise', '{pitch: {rms: 2 %}, position: {max: 1 mm}}'),
    *(
        Wish(scene, HANDLING)
        for scene in ('swept steer at the limit', 'double lane change', 'braking on split friction')
    ),
    Wish('rough road', '{wheel_load.front_left: {rms: 0.1 %}, wheel_load.rear_right: {rms: 0.1 %}}'),
)
HOP, TURN, TIGHT = Wish('rough road', LOADS), Wish('step steer', YAW), Wish('step steer', EXACT)
NEVER = Wish('step steer', IMPOSSIBLE)


def study(out: Path, *, quick: bool, progress: Callable[[str, float], None]) -> dict:
    """See mbd_sim_ros.lab.studies. Plans are made one after the other, each on all cores that this process may use."""
    # what this process took to be ready every command takes
    cores, startup = len(os.sched_getaffinity(0)), time.process_time()
    wishes = (
        (Wish('level cruise', '{position: {max: 0.5 m}}'),)
        if quick
        else tuple(dict.fromkeys((TURN, HOP, TIGHT, NEVER, *WISHES)))
    )
    rows: dict[Wish, dict[str, Any]] = {}
    cells = Cells(out / 'cells')
    for k, wish in enumerate(wishes):

        def said(text: str, _: float, k: int = k, wish: Wish = wish) -> None:
            progress(f'plan {k + 1} of {len(wishes)}: {wish.scene}: {text}', k / len(wishes))

        rows[wish] = cells.cell(str(wish), lambda wish=wish, said=said: made(wish, cores, quick, said, startup))  # type: ignore[misc]
    report = Report(out, 'Plans')
    report.text(
        'Every plan is made from nothing but its scene and what is required of it, and then held against maneuvers '
        f'that had no part in it, at least {LEAST_UNSEEN} of them, and against the cheapest setting of the grid '
        f'(level, step, iterations, damping) that keeps the same limits on the same maneuvers by the same rule: on '
        'those that served to choose its errors of model, step and iteration do not add up to more than a limit, and '
        'on all its own error is within the limits. Of all that are cheaper every one is tried. Settings that keep '
        'the limits only because these errors cancel no plan may take; the last columns say how much cheaper the '
        'cheapest is where they count too. Costs are CPU seconds per simulated second by counters. A plan knows '
        'nothing of others of its vehicle, and references on maneuvers that it has not seen are made anew from '
        'converged runs, finer than its own. What it took is CPU time, in full runs as a command (start of the '
        'program, of the scene, and all steps as the scene gives them) and in steps of the full run alone; levels '
        f'that are derived once for the vehicle are not part of it. Made on {cores} core{"s" * (cores > 1)}; time is '
        f'given for {CORES}.'
    )
    report.table('plans', [shown(wish, row) for wish, row in rows.items()])
    for wish, row in rows.items():
        if wish == NEVER:
            report.check(
                f'{wish}: plans that say no, and why',
                float(row['status'] == 'no' and bool(row['give'])),
                1.0,
                least=True,
            )
            continue
        if not quick:
            report.check(f'{wish}: unseen maneuvers', row['passed'] + row['failed'], LEAST_UNSEEN, least=True)
        report.check(f'{wish}: unseen maneuvers that it failed on', row['failed'], 0)
        report.check(f'{wish}: cost over that of the cheapest of the grid', number(row['dearer']), DEAREST)
        report.check(f'{wish}: time on {CORES} cores [s]', row['took'] * cores / CORES, ALLOWED)
        report.check(f'{wish}: CPU time over that of the full run', number(row['full_runs']), TIMES)
    if not quick:
        report.check(
            'wheel-hop loads take another level than yaw rate',
            float(rows[HOP]['level'] != rows[TURN]['level']),
            1.0,
            least=True,
        )
        tight = rows[TIGHT]
        full = tight['level'] == 'full' and number(tight['h']) <= SMALL
        report.check('1e-5 m takes the full vehicle and a small step', float(full), 1.0, least=True)
    answers = [
        {'scene': wish.scene, 'required': wish.require, **line} for wish, row in rows.items() for line in row['first']
    ]
    report.text(
        '## First answers',
        'What was answered before the search, and whether level and step were those of the plan in the end.',
    )
    report.table('first answers', answers)
    agreed = {
        basis: [a['agrees'] for a in answers if a['basis'] == basis and a['agrees'] is not None]
        for basis in (RULE, TWIN)
    }
    report.text('; '.join(f'{basis}: {sum(found)} of {len(found)} agreed' for basis, found in agreed.items()) + '.')
    report.text(
        '## What the runs were for',
        'Runs (and starts that were sought) of all these plans together, and their CPU time.',
    )
    report.table('purposes', purposes(list(rows.values())))
    chance = [{'scene': wish.scene, **line} for wish, row in rows.items() for line in row['cancelling']]
    if chance:
        report.text(
            '## Errors that cancel',
            'Settings that are cheaper than the cheapest by the rule and keep the limits all the same, with the '
            'maneuver on which their '
            'errors by origin add up to most, in shares of the limit. The error is that of the setting itself there.',
        )
        report.table('cancelling', chance)
    refused = [f'{wish}: {" ".join(row["give"])}' for wish, row in rows.items() if row['status'] != OK]
    if refused:
        report.text('## No plan', *refused)
    report.write()
    return {'plans': list(rows.values()), 'checks': report.checks}


def shown(wish: Wish, row: dict[str, Any]) -> dict[str, Any]:
    """A line of the table."""
    return {
        'scene': wish.scene, 'required': wish.require, 'plan': row['setting'] or row['status'],
        'unseen passed': row['passed'], 'failed': row['failed'], 'largest share of a limit': row['largest'],
        'cheapest of the grid': row['cheapest'] or '', 'dearer': row['dearer'], 'of the full '
            'vehicle': row['cost_ratio'],
        'CPU [s]': row['cpu'], 'full runs': row['full_runs'], 'steps of the full '
            'run': row['step_runs'], 'runs': row['runs_made'],
        'time [s]': row['took'], 'cheapest where errors may '
            'cancel': row['cheapest_by_chance'], 'dearer than that': row['dearer_by_chance'],
    }  # fmt: skip


def purposes(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Sums of what all plans have spent, by purpose."""
    found = []
    for purpose in PURPOSES:
        spent = [row['runs'][purpose] for row in rows if purpose in row['runs']]
        found.append(
            {
                'purpose': purpose,
                **{what: sum(one[what] for one in spent) for what in ('runs', 'starts', 'steps', 'cpu')},
            }
        )
    return found


def made(wish: Wish, cores: int, quick: bool, progress: Callable[[str, float], None], startup: float) -> dict[str, Any]:
    """A plan, and what became of it. startup: CPU time [s] that a command takes before it begins."""
    scene = SCENES[wish.scene]([*(['duration=1'] if quick else []), f'require={wish.require}'])
    levels = () if quick else tuple(LEVELS)
    search = Search(
        scene, workers=cores, longest=LONGEST * CORES / cores, times=math.inf if quick else TIMES, startup=startup,
        levels=levels,
        unseen=2 if quick else None, progress=progress,
    )  # fmt: skip
    data = plan(search)
    price = data['price']
    steps = search.scene.duration * cost_of(
        search.bench, dataclasses.replace(baseline(search.scene), h=search.scene.integrator.h)
    )
    found: dict[str, Any] = {
        'status': data['status'], 'level': None, 'h': None, 'setting': '', 'passed': 0, 'failed': 0, 'largest': None,
        'cheapest': '',
        'dearer': None, 'cost_ratio': data['cost_ratio'], 'took': data['took'], 'give': data['give'],
        'notes': data['notes'],
        'levels': data['levels'], 'cheapest_by_chance': '', 'dearer_by_chance': None, 'cancelling': [],
        'cpu': price['cpu'], 'full_runs': price['full_runs'], 'step_runs': (price['cpu'] - startup) / steps,
        'runs': price['runs'],
        'runs_made': sum(one['runs'] for one in price['runs'].values()), 'checked': data['unseen']['passed'],
        'first': [{name: one[name] for name in ('setting', 'basis', 'after', 'cost_ratio',
        'agrees')} for one in data['first']],
    }  # fmt: skip
    if search.result is None:
        return found
    best = search.result
    search.allowance = Allowance(math.inf)
    search.bench = converged(search)
    checks = unseen(search, best.setting, 2 if quick else UNSEEN)
    cheaper = cheaper_of_grid(search, best.cost, checks, levels)
    itself = Cheaper(best.setting, best.cost, None)
    by_rule = min((c for c in cheaper if c.cancelling is None), key=lambda c: c.cost, default=itself)
    by_chance = min(cheaper, key=lambda c: c.cost, default=itself)
    return found | {
        'level': best.setting.level,
        'h': best.setting.h,
        'setting': str(best.setting),
        'passed': sum(c.passed for c in checks),
        'failed': sum(not c.passed for c in checks),
        'largest': max((c.used for c in checks), default=None),
        'cheapest': str(by_rule.setting),
        'dearer': best.cost / by_rule.cost,
        'cheapest_by_chance': str(by_chance.setting),
        'dearer_by_chance': best.cost / by_chance.cost,
        'cancelling': [c.cancelling for c in cheaper if c.cancelling is not None and c.cost < by_rule.cost],
    }


def converged(search: Search) -> Bench:
    """A bench that shares nothing with that of a plan but the prices of steps. Its references are the limits of two or
    three steps iterated to tolerance on every maneuver, no coarser than reference.STEPS."""
    bench, prices = search.bench, {key: price for key, price in search.bench.made.items() if key[0] == 'price'}
    steps = min(reference.STEPS, bench.steps, key=lambda steps: steps[-1])
    return Bench(bench.scene, bench.names, steps, bench.requirements, bench.seen, made=prices)


def unseen(search: Search, setting: Setting, count: int) -> list[Check]:
    """Checks against converged references on maneuvers that had no part in the choice, those of the plan first."""
    bench, k = search.bench, 0
    checks: list[Check] = []
    there: set[Variation] = set()
    while len(checks) < count and k < 10 * count:
        v = effective(search.scene, inside(k))
        k += 1
        if v in there or v in bench.seen:
            continue
        there.add(v)
        search.say(f'unseen maneuvers: {len(checks)} of {count}')
        found = check(bench, v, setting)
        if not found.unjudged:
            checks.append(found)
    return checks


class Cheaper(NamedTuple):
    """A setting that keeps the limits. cancelling: where its errors by origin add up to more than a limit; None:
    nowhere."""

    setting: Setting
    cost: float  # CPU seconds per simulated second
    cancelling: dict[str, Any] | None


def cheaper_of_grid(search: Search, cost: float, checks: list[Check], levels: Sequence[str]) -> list[Cheaper]:
    """The settings of the grid below a cost whose errors are within the limits on all these maneuvers, cheapest first,
    up to one that keeps them by the rule of a plan."""
    bench, models = search.bench, [Setting()]
    for level in levels:
        setting = Setting(level=level)  # type: ignore[arg-type]
        try:
            per_step(bench, setting)
        except MbdError:
            continue
        models.append(setting)
    maneuvers = [*bench.seen, *(c.variation for c in checks)]
    found: list[Cheaper] = []
    for setting in search.candidates(models):
        if cost_of(bench, setting) >= cost:
            break
        search.say(f'grid: {setting}')
        if not all(check(bench, v, setting).passed for v in maneuvers):
            continue
        if any(broken(bench, v, setting) for v in bench.seen):
            continue
        exact = cost_of(bench, setting, known(bench, maneuvers[0], setting))
        if exact < cost:
            found.append(Cheaper(setting, exact, cancelling(bench, setting)))
            if found[-1].cancelling is None:
                cost = exact
    return found


def cancelling(bench: Bench, setting: Setting) -> dict[str, Any] | None:
    """Place where the errors of a setting by origin add up to most, on the maneuvers that served to choose; None:
    nowhere above the limit."""
    bounds = [(bound, v) for v in bench.seen for bound in bounds_of(bench, v, setting)]
    worst, v = max(bounds, key=lambda entry: entry[0].used)
    if worst.used <= 1.0:
        return None
    return {
        'setting': str(setting),
        'maneuver': str(v),
        'limit': str(worst.requirement),
        **{origin: part / worst.limit for origin, part in zip(ORIGINS, worst.parts, strict=True)},
        'sum': worst.used,
        'error': worst.error / worst.limit,
    }
