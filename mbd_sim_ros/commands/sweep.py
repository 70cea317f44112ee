"""mbd sweep: one scene many times with other values; a table, sensitivities and a report."""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from mbd_sim_ros.commands import Result, declare, names_of, offer, table
from solver.disk import alone
from solver.errors import BagError, MbdError, SceneError

if TYPE_CHECKING:
    from mbd_sim_ros.sweep.case import Row, SweepCase
    from mbd_sim_ros.sweep.design import Sweep
    from solver.scene import Scene

    Values = dict[str, float | str]

SAMPLED = 8  # cases of a sweep whose numerical error is measured; ten times as many would be nearly all of a small one
EXAMPLE = """mbd sweep sweep.yaml --out out/sweep
  mbd sweep sweep.yaml --workers 8 --out out/sweep           # Ctrl-C, and again: goes on where it was
  mbd sweep sweep.yaml --scheduler tcp://10.0.0.1:8786 --out out/sweep
the file (docs/sweeps.md):
  scene: light_car_step_steer
  set: [duration=4.0]
  parameters:
    vehicle.chassis.mass: {low: 1000, high: 1400}
    integrator.h: {values: [0.001, 0.002]}
  design: {kind: latin_hypercube, samples: 64, seed: 1}
  figures:
    yaw_rate_peak: {quantity: yaw_rate, take: peak}                          # of the run
    response: {evaluation: iso7401_step, figure: yaw_rate_response_time}     # of an evaluation of its recording
    understeer: {info: understeer_gradient}                                  # of the vehicle, as in mbd info"""


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers, 'sweep', run, 'run a scene many times with other values, on all cores or on a cluster', EXAMPLE
    )
    file = parser.add_argument('file', metavar='FILE', type=Path, help='what to vary and what to keep')
    offer(file, names_of('sweeps'), files=True)
    parser.add_argument(
        '--out',
        metavar='DIR',
        type=Path,
        required=True,
        help='where rows, table, report and bags go; what is there is kept',
    )
    parser.add_argument('--workers', metavar='N', type=int, help='processes of this machine (default: one per core)')
    parser.add_argument(
        '--scheduler', metavar='ADDRESS', help='of a running Dask cluster, instead of processes of this machine'
    )


def run(args: argparse.Namespace) -> Result:
    """Lay out, run, write."""
    from mbd_sim_ros.sweep.design import load_sweep
    from mbd_sim_ros.sweep.workers import Workers

    if args.workers is not None and args.workers < 1:
        raise BagError(f'--workers {args.workers}: must be at least 1')
    sweep = load_sweep(args.file)
    if args.scheduler:
        from mbd_sim_ros.sweep.cluster import run_there

        return _swept(args, sweep, lambda cases: run_there(cases, args.scheduler))
    with Workers(min(args.workers or os.cpu_count() or 1, sweep.fewest)) as workers:
        return _swept(args, sweep, workers.run)


def _swept(args: argparse.Namespace, sweep: Sweep, run_cases: Callable[[Sequence[SweepCase]], Iterator[Row]]) -> Result:
    """Lay out, run what is not there yet, write the table and the report."""
    from mbd_sim_ros.analysis.provenance import facts_of_scene
    from mbd_sim_ros.sweep.case import overrides_of
    from mbd_sim_ros.sweep.design import cases, units_of
    from solver import load_scene
    from solver.files.scene import load_scene_and_units
    from solver.quantities import published

    values = cases(sweep)
    base = load_scene(sweep.scene, sweep.set)
    try:
        # wrong keys are told before anything runs
        first, keys = load_scene_and_units(base.resolved, base.name, overrides_of(values[0]))
    except MbdError as error:
        raise SceneError(f'{args.file}: parameters: {str(error).removeprefix("--set ")}') from None
    if 'real_time_factor_min' in first.require.limits:
        raise SceneError(
            f'{args.file}: require.real_time_factor_min: rows do not depend on the machine, so it is not judged in a '
            'sweep; add require.real_time_factor_min=null to set, and judge it with mbd run'
        )
    units = units_of(sweep, published(first.model), keys)
    with alone(args.out):
        rows = _rows(args, sweep, values, base, run_cases)
        return _written(args, sweep, rows, units, facts_of_scene(base.resolved, base.name))


def _rows(
    args: argparse.Namespace,
    sweep: Sweep,
    values: list[Values],
    base: Scene,
    run_cases: Callable[[Sequence[SweepCase]], Iterator[Row]],
) -> list[Row]:
    """The rows of all cases, in their order."""
    from tqdm import tqdm

    from mbd_sim_ros import interrupts
    from mbd_sim_ros.sweep.case import SweepCase
    from mbd_sim_ros.sweep.table import get_ready

    rows_directory, bags = args.out / 'rows', args.out / 'bags'
    try:
        rows_directory.mkdir(exist_ok=True)
        if sweep.record:
            bags.mkdir(exist_ok=True)
    except OSError as error:
        raise BagError(f'--out {args.out}: {error.strerror}; choose another place') from None
    kept = str(rows_directory.resolve())
    todo = [
        SweepCase(
            number=i,
            text=base.resolved,
            name=base.name,
            values=one,
            figures=sweep.figures,
            rows=kept,
            bags=str(bags.resolve()) if sweep.record else '',
            twin=_twin(sweep, i, len(values)),
        )
        for i, one in enumerate(values)
    ]
    interrupts.now(f'sweeping {sweep.scene}; what is done is kept in {args.out}, the same command goes on')
    rows: list[Row] = []
    coming = run_cases(todo)
    for row in tqdm(
        coming, total=len(todo), unit='case', desc=sweep.scene, disable=True if args.json else None, leave=False
    ):
        if not rows:
            get_ready()  # all others are at work
        rows.append(row)
        interrupts.check()
    return sorted(rows, key=lambda row: row['case'])


def _twin(sweep: Sweep, case: int, count: int) -> Literal['', 'told', 'decides']:
    """Role of the twin of a case of so many: of a sample the first case in every SAMPLED part of the design has one."""
    if sweep.errors == 'all':
        return 'decides'
    parts = min(SAMPLED, count)
    return 'told' if sweep.errors == 'sample' and case in {k * count // parts for k in range(parts)} else ''


def _errors(sweep: Sweep, errors: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Numerical errors of the cases in which they were measured: how many, the sentence on the worst, and the largest
    of every figure."""
    found = [one for one in errors if one]
    of = {name: [one['figures'][name] for one in found if one['figures'][name] is not None] for name in sweep.figures}
    worst = max(found, key=lambda one: one['share'], default={'text': ''})
    return {
        'cases': len(found),
        'worst': worst['text'],
        'figures': {name: max(some) if some else None for name, some in of.items()},
    }


def _told(errors: dict[str, Any], count: int) -> str:
    if not errors['cases']:
        return 'numerical error: not measured'
    largest = ', '.join(f'{name} {value:.2g}' for name, value in errors['figures'].items() if value is not None)
    return (
        f'numerical error, measured in {errors["cases"]} of {count} cases: at most {largest}. The worst: '
        f'{errors["worst"]}'
    )


def _written(
    args: argparse.Namespace, sweep: Sweep, rows: list[Row], units: dict[str, str], facts: Sequence[tuple[str, str]]
) -> Result:
    """The table, the report and what is said of them."""
    from mbd_sim_ros.analysis.pages import write_text
    from mbd_sim_ros.sweep.design import ERRORS, UNITS
    from mbd_sim_ros.sweep.table import known_to, no_indices, sensitivities, write_report, write_table

    errors = [row.pop(ERRORS, {}) for row in rows]
    for row in rows:
        units = row.pop(UNITS, {}) | units  # of figures of evaluations
    empty = [name for name in sweep.figures if not any(math.isfinite(row[name]) for row in rows)]
    indices = sensitivities(sweep, rows)
    file = write_table(rows, args.out)
    title = f'{Path(sweep.scene).stem}: {len(rows)} cases, {sweep.design.kind}'
    report = write_report(sweep, rows, indices, units, args.out, title, facts)
    write_text(args.out / 'sweep.json', json.dumps(dataclasses.asdict(sweep), indent=1))
    counts = {status: sum(row['status'] == status for row in rows) for status in ('ok', 'suspect', 'error')}
    data = {
        'status': 'error' if counts['error'] == len(rows) else 'ok' if counts['ok'] == len(rows) else 'suspect',
        'cases': len(rows),
        **{f'cases_{status}': n for status, n in counts.items()},
        'table': str(file),
        'report': str(report),
        'sensitivities': indices,
        'without_value': empty,
        'errors': _errors(sweep, errors),
    }
    lines = [
        f'{len(rows)} cases: ' + ', '.join(f'{n} {status}' for status, n in counts.items()),
        f'{file}',
        f'{report}',
    ]
    lines.append(_told(data['errors'], len(rows)))
    for figure, found in indices.items():
        keys = list(next(iter(found.values())))
        lines.append(
            table([(figure, *keys), *((name, *(f'{one[key]:.4g}' for key in keys)) for name, one in found.items())])
        )
        lines += [f'{figure}: {doubt}'] if (doubt := known_to(sweep, found)) else []
    lines += [reason for figure in sweep.figures if (reason := no_indices(sweep, rows, figure))]
    lines += [f'no case has a value of {name}: {rows[0]["message"]}' for name in empty]
    return Result(data=data, text='\n'.join(lines), code=1 if counts['error'] == len(rows) or empty else 0)
