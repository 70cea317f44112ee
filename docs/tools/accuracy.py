"""Writes docs/accuracy.md from finished studies: `python docs/tools/accuracy.py out/trade`, after `mbd study trade
SCENE`.

Every number and every conclusion of the page is computed from the rows of these studies; pictures are copied with few
colours.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from PIL import Image  # comes with matplotlib

PAGE = Path(__file__).parents[1] / 'accuracy.md'
PICTURES = PAGE.with_name('pictures')
COLOURS = 256  # of a picture: see docs/tools/studies.py
ORIGINS = ('model_share', 'step_share', 'iteration_share')
LEVELS = ('full', 'condensed', 'kc', 'single_track')
Row = dict[str, Any]


def bounded(errors: Row) -> float | None:
    """The bound of an RMS error as a share of the peak: what model, step and iteration add up to, whatever cancels."""
    parts = [errors.get(origin) for origin in ORIGINS]
    return None if any(part is None for part in parts) else float(sum(parts))  # type: ignore[arg-type]


def largest(errors: Row) -> float | None:
    """The largest error."""
    return errors['max']


WANTED: tuple[tuple[str, str, Callable[[dict[str, Any]], float | None], float], ...] = (
    ('yaw rate within 5 %', 'yaw_rate', bounded, 0.05),
    ('yaw rate within 1 %', 'yaw_rate', bounded, 0.01),
    ('yaw rate within 0.1 %', 'yaw_rate', bounded, 0.001),
    ('lateral velocity within 1 %', 'sideslip_velocity', bounded, 0.01),
    ('roll within 1 %', 'roll', bounded, 0.01),
    ('wheel load within 1 %', 'wheel_load.front_left', bounded, 0.01),
    ('wheel load within 0.1 %', 'wheel_load.front_left', bounded, 0.001),
    ('place within 0.1 m', 'position', largest, 0.1),
    ('place within 1 mm', 'position', largest, 0.001),
)


def cheapest(
    rows: Sequence[Row], quantity: str, error: Callable[[dict[str, Any]], float | None], limit: float
) -> Row | None:
    """The cheapest row whose error of a quantity is within the limit."""
    found = []
    for row in rows:
        value = error(row['errors'][quantity]) if quantity in row['errors'] else None
        if not row['failure'] and value is not None and value <= limit and row.get('cost_median'):
            found.append(row)
    return min(found, key=lambda row: row['cost_median'], default=None)


def relative(row: Row, rows: Sequence[Row]) -> float:
    """Cost against the first row, the full vehicle at 1 ms."""
    return float(row['cost_median'] / rows[0]['cost_median'])


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of Markdown."""
    lines = [' | '.join(head), '|'.join('---' for _ in head), *(' | '.join(row) for row in rows)]
    return '\n'.join(f'| {line} |' for line in lines)


def rule(studies: dict[str, list[Row]]) -> str:
    """The cheapest setting for each wish on each scene."""
    rows = []
    for wish, quantity, error, limit in WANTED:
        cells = []
        for found in studies.values():
            best = cheapest(found, quantity, error, limit)
            cells.append('-' if best is None else f'{best["setting"]}: {relative(best, found):.2g}')
        rows.append([wish, *cells])
    return table(['wanted', *(f'`{name}`' for name in studies)], rows)


def thumb(studies: dict[str, list[Row]]) -> list[str]:
    """Sentences that hold on all scenes, each with the numbers it was drawn from."""
    sentences = []
    for wish, quantity, error, limit in WANTED:
        best = {name: cheapest(rows, quantity, error, limit) for name, rows in studies.items()}
        if any(row is None for row in best.values()):
            missing = ', '.join(f'`{name}`' for name, row in best.items() if row is None)
            sentences.append(
                f'- **{wish}**: no setting of the grid reaches it on {missing}; plan a smaller step there.'
            )
            continue
        costs = [relative(row, studies[name]) for name, row in best.items() if row is not None]
        levels = sorted({row['level'] for row in best.values() if row is not None}, key=LEVELS.index)
        steps = [1e3 * row['h'] for row in best.values() if row is not None]
        low, high = min(steps), max(steps)
        step = f'{low:g} ms' if low == high else f'{low:g} to {high:g} ms'
        cheap, dear = (f'{100 * cost:.0f}' if cost >= 0.1 else f'{100 * cost:.2g}' for cost in (min(costs), max(costs)))
        cost = f'{cheap} %' if cheap == dear else f'{cheap} to {dear} %'
        sentences.append(
            f'- **{wish}**: `{"` or `".join(levels)}` at {step}, for {cost} of what the full vehicle costs at 1 ms.'
        )
    return sentences


def bargains(name: str, rows: Sequence[Row]) -> list[str]:
    """The worst settings: those that fail, and that which most others beat in both cost and error."""
    failed = [row for row in rows if row['failure']]
    sentences = [
        f'{len(failed)} of {len(rows)} settings failed.' if failed else f'All {len(rows)} settings reached the end.'
    ]

    def error(row: Row) -> float:
        values = [e['rms_share'] for e in row['errors'].values()]
        return math.inf if not values or any(v is None for v in values) else max(values)

    good = [row for row in rows if not row['failure'] and row.get('cost_median') and math.isfinite(error(row))]
    if len(good) > 1:
        beaten = {
            r['setting']: sum(o['cost_median'] < r['cost_median'] and error(o) < error(r) for o in good) for r in good
        }
        worst = max(beaten, key=lambda s: beaten[s])
        sentences.append(f'The worst bargain is {worst}: {beaten[worst]} settings are both cheaper and more accurate.')
    return sentences


def switched(rows: Sequence[Row]) -> str:
    """Costs and savings of leaving one subsystem out."""
    found = []
    for row in rows:
        if not row['off'] or row['failure'] or not row.get('cost_median'):
            continue
        same = [
            r for r in rows
            if not r['off'] and all(r[key] == row[key] for key in ('level', 'h', 'iterations'))
            and r['rho_inf'] == row['rho_inf'] and r.get('cost_median')
        ]  # fmt: skip
        if not same:
            continue
        shares = {n: e['rms_share'] for n, e in row['errors'].items() if e['rms_share'] is not None}
        if not shares:
            continue
        worst = max(shares, key=lambda n: shares[n])
        saved = 100.0 * (1.0 - row['cost_median'] / same[0]['cost_median'])
        found.append([row['level'], row['off'], f'{saved:.0f} %', worst, f'{100 * shares[worst]:.2g} %'])
    head = ['level', 'without', 'saves', 'largest RMS error', '']
    return table(head, found) if found else ''


def write(directory: Path) -> str:
    """The page from all studies in a directory. Raises SystemExit with a sentence where there are none."""
    files = sorted(directory.glob('*/trade.json'))
    if not files:
        raise SystemExit(f'{directory}: no trade.json below it; run mbd study trade SCENE first')
    found = {file.parent.name: json.loads(file.read_text(encoding='utf-8')) for file in files}
    studies, lengths = ({name: data[key] for name, data in found.items()} for key in ('rows', 'duration'))
    parts = [
        HEAD,
        '## Rule of thumb',
        THUMB,
        '\n'.join(thumb(studies)),
        '### The cheapest setting, scene by scene',
        CHEAPEST,
        rule(studies),
    ]
    parts += [PLAN]
    PICTURES.mkdir(exist_ok=True)
    for name, rows in studies.items():
        parts += [f'## {name}', f'{lengths[name]:g} s of the maneuver. {" ".join(bargains(name, rows))}']
        for picture, caption in (
            ('cost', 'Error against cost, every setting'),
            ('origins', 'Where the errors on the front come from'),
        ):
            source = directory / name / f'{picture}.png'
            if source.exists():
                target = PICTURES / f'trade_{name}_{picture}.png'
                Image.open(source).convert('RGB').quantize(COLOURS).save(target, optimize=True)
                parts.append(f'![{caption}](pictures/{target.name})')
        left_out = switched(rows)
        if left_out:
            parts += ['Leaving out one subsystem:', left_out]
    return '\n\n'.join(parts) + '\n'


HEAD = """# Accuracy: how much of a car a question needs

## What to do

1. **Is this run good enough?** `mbd run SCENE` tells its numerical error by quantity
   ([stability.md](stability.md#error-bar)). It says nothing of the model: `fidelity: full` is the vehicle as it is
   given, and how near that is to a car on a road is another question ([vehicle.md](vehicle.md)).
2. **Many runs, or a loop that has to keep pace?** Say what is needed and let it be found:

       mbd plan car_step_steer --set 'require={yaw_rate: {rms: 2 %}, position: {max: 0.1 m}}'

   A first answer stands there after seconds. It says what it rests on: the rule of thumb below, earlier plans of this
   vehicle, or coarse runs. It is not checked. The plan then measures, at the price of ten full runs at most, and says
   in the end: the setting, its errors by origin, on how many maneuvers that had no part in the choice it was checked,
   what `mbd run` of it shows, and **from how many runs on the plan pays**. For fewer runs take the full vehicle, or
   the first answer with the error that `mbd run` tells of it.
3. **No time?** `mbd plan ... --time 10`, or Ctrl-C: what is known by then is told, marked as what it is. The same
   command goes on from there. A longer `--time` buys more checks: "12 of 12 other maneuvers passed, the worst at 85 %
   of the limit" leaves, statistically, up to 22 % that could fail; 24 leave 12 %, 59 leave 5 %. Fewer than 8 are no
   certificate: where runs are dear a plan ends `incomplete` with what it has measured.
4. **Another scene of the same vehicle?** Plan that one too: a certificate holds for its maneuver and the ranges that
   it names. It goes faster, for prices of steps, derived levels and errors are kept by vehicle.
5. **No plan at all?** The rule of thumb, and `mbd run` for the numerical error.
6. **A smooth motion, and more digits?** `mbd info SCENE` tries order four on the scene and says whether it pays (row
   `order four`). It does on the light car without a driver, with steps of 4 ms; on the car with bushings it does not,
   and neither where a driver or an assistance looks once a step.

What a limit means and how it is written: [scene.md](scene.md#accuracy). How plans are made and what they cost:
decisions [0016](decisions/0016-plans.md) and [0025](decisions/0025-price-of-a-plan.md); eighteen of them:
[studies.md](studies.md#plan-what-mbd-plan-chooses-held-against-what-it-has-not-seen).

## What the maps show

Speed is bought with accuracy: by the level of detail, by subsystems that are switched off, by the step, the
iterations and the damping of the integration. The maps show the price, measured on delivered scenes by `mbd study
trade SCENE`; all of them are written by `python docs/tools/accuracy.py out/trade`, no number by hand.

Every error is one against the converged full vehicle: Richardson's limit of three steps, confirmed by a second
formulation of the same equations. Percentages are root mean squares in % of the peak of the quantity. The full
vehicle is exact here by definition.

In the words of [ISOClasses2022] a level is a *model type*, what it leaves out are its *model characteristics*, and
the tables below are what the standard leaves to the user: the allocation of model types to manoeuvres by
requirements, here measured instead of agreed."""
THUMB = """The cheapest settings that keep each wish on the scenes of this page. What is wished of a root mean square holds for the sum of
the errors of model, step and iteration, so that nothing rests on errors which happen to cancel:"""  # noqa: E501
CHEAPEST = 'Each with its cost, as a share of that of the full vehicle at 1 ms with the iterations of the scene.'
PLAN = """The rules above hold for the scenes and the car they were measured on; `mbd plan` begins with them and says whether
they were right.

A run of a setting that a plan has certified is not `suspect` for what the plan has measured: a wheel that turns by a
radian in a step, a vibration of few steps. It is held to all that the scene requires besides, as that constraints
stay closed to 1e-5 m."""  # noqa: E501

if __name__ == '__main__':
    PAGE.write_text(write(Path(sys.argv[1] if len(sys.argv) > 1 else 'out/trade')), encoding='utf-8')
