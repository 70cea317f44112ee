"""mbd sweep: one scene many times with other values; a table, sensitivities and a report."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_sim_ros.commands import Result, alone, declare, table
from solver.errors import BagError, MbdError, SceneError

if TYPE_CHECKING:
    from mbd_sim_ros.sweep.design import Sweep
    from solver.scene import Scene

EXAMPLE = """mbd sweep sweep.yaml --out out/sweep
  mbd sweep sweep.yaml --workers 8 --out out/sweep           (Ctrl-C, and again: goes on where it was)
  mbd sweep sweep.yaml --scheduler tcp://10.0.0.1:8786 --out out/sweep
the file (docs/sweeps.md):
  scene: light_car_step_steer
  set: [duration=4.0]
  parameters:
    vehicle.chassis.mass: {low: 1000, high: 1400}
    integrator.h: {values: [0.001, 0.002]}
  design: {kind: latin_hypercube, samples: 64, seed: 1}
  figures:
    yaw_rate_peak: {quantity: yaw_rate, take: peak}"""


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(parsers, 'sweep', run, 'run a scene many times with other values, on all cores or on a cluster', EXAMPLE)
    parser.add_argument('file', metavar='FILE', type=Path, help='what to vary and what to keep')
    parser.add_argument(
        '--out', metavar='DIR', type=Path, required=True, help='where rows, table, report and bags go; what is there is kept'
    )
    parser.add_argument('--workers', metavar='N', type=int, help='processes of this machine (default: one per core)')
    parser.add_argument('--scheduler', metavar='ADDRESS', help='of a running Dask cluster, instead of processes of this machine')


def run(args: argparse.Namespace) -> Result:
    """Lay out, run, write."""
    from mbd_sim_ros.sweep.case import overrides_of
    from mbd_sim_ros.sweep.design import cases, load_sweep, units_of
    from solver import load_scene
    from solver.files.scene import load_scene_text
    from solver.quantities import published

    if args.workers is not None and args.workers < 1:
        raise BagError(f'--workers {args.workers}: must be at least 1')
    sweep = load_sweep(args.file)
    values = cases(sweep)
    base = load_scene(sweep.scene, sweep.set)
    try:
        first = load_scene_text(base.resolved, base.name, overrides_of(values[0]))  # wrong keys are told before anything runs
    except MbdError as error:
        raise SceneError(f'{args.file}: parameters: {str(error).removeprefix("--set ")}') from None
    units = units_of(sweep, published(first.model))
    with alone(args.out):
        return _swept(args, sweep, values, base, units)


def _swept(args: argparse.Namespace, sweep: Sweep, values: list[dict[str, float | str]], base: Scene, units: dict[str, str]) -> Result:
    """Run what is not there yet, write the table and the report."""
    from tqdm import tqdm

    from mbd_sim_ros import interrupts
    from mbd_sim_ros.sweep.case import Case, Row
    from mbd_sim_ros.sweep.cluster import run_there
    from mbd_sim_ros.sweep.table import sensitivities, write_report, write_table
    from mbd_sim_ros.sweep.workers import run_here

    rows_directory, bags = args.out / 'rows', args.out / 'bags'
    try:
        rows_directory.mkdir(exist_ok=True)
        if sweep.record:
            bags.mkdir(exist_ok=True)
    except OSError as error:
        raise BagError(f'--out {args.out}: {error.strerror}; choose another place') from None
    kept = str(rows_directory.resolve())
    todo = [
        Case(
            number=i,
            text=base.resolved,
            name=base.name,
            values=one,
            figures=sweep.figures,
            rows=kept,
            bags=str(bags.resolve()) if sweep.record else '',
        )
        for i, one in enumerate(values)
    ]
    interrupts.now(f'sweeping {sweep.scene}; what is done is kept in {args.out}, the same command goes on')
    count = args.workers or os.cpu_count() or 1
    coming = run_there(todo, args.scheduler) if args.scheduler else run_here(todo, count)
    rows: list[Row] = []
    for row in tqdm(coming, total=len(todo), unit='case', desc=sweep.scene, disable=True if args.json else None, leave=False):
        rows.append(row)
        interrupts.check()
    rows.sort(key=lambda row: row['case'])
    indices = sensitivities(sweep, rows)
    file = write_table(rows, args.out)
    report = write_report(sweep, rows, indices, units, args.out, f'{sweep.scene}: {len(rows)} cases, {sweep.design.kind}')
    (args.out / 'sweep.json').write_text(json.dumps(dataclasses.asdict(sweep), indent=1), encoding='utf-8')
    counts = {status: sum(row['status'] == status for row in rows) for status in ('ok', 'suspect', 'error')}
    data = {
        'status': 'error' if counts['error'] == len(rows) else 'ok' if counts['ok'] == len(rows) else 'suspect',
        'cases': len(rows),
        **{f'cases_{status}': n for status, n in counts.items()},
        'table': str(file),
        'report': str(report),
        'sensitivities': indices,
    }
    lines = [f'{len(rows)} cases: ' + ', '.join(f'{n} {status}' for status, n in counts.items()), f'{file}', f'{report}']
    for figure, found in indices.items():
        keys = list(next(iter(found.values())))
        lines.append(table([(figure, *keys), *((name, *(f'{one[key]:.4g}' for key in keys)) for name, one in found.items())]))
    return Result(data=data, text='\n'.join(lines), code=0 if counts['error'] < len(rows) else 1)
