"""mbd fit: fit a vehicle to recordings, or say beforehand what these can tell."""

from __future__ import annotations

import argparse
import os
import shutil
from pathlib import Path
from typing import Any

from mbd_sim_ros.commands import Result, declare
from solver.disk import alone
from solver.errors import SpecError

EXAMPLE = """mbd fit fit.yaml --preflight              # what the recordings can tell, which maneuver would tell more
  mbd fit fit.yaml --out out/fit                       # Ctrl-C, and again: goes on where it was
  mbd fit --example tutorial                           # recordings to try it with, made by the program
the file (docs/fitting.md):
  vehicle: vehicles/light_car.yaml
  mapping: car.yaml
  recordings:
    lap_1: {file: lap_1.csv}
    lap_2: {file: lap_2.csv, use: held_out}
  drive: {steering_wheel: cmd_applied/steering, speed: odom/twist/vx}
  channels:
    yaw_rate: {channel: imu/wz}
    lateral_acceleration: {channel: imu/ay}
  parameters:
    mass: {sd: 2 %}
    cornering_stiffness_front: {}"""


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers, 'fit', run, 'fit a vehicle to recordings, with intervals, judged by recordings held out', EXAMPLE
    )
    parser.add_argument('file', metavar='FILE', type=Path, nargs='?', help='what is fitted to what')
    parser.add_argument('--preflight', action='store_true', help='only say what the recordings can tell')
    parser.add_argument('--out', metavar='DIR', type=Path, help='where vehicle, samples, page and numbers go')
    parser.add_argument('--workers', metavar='N', type=int, help='processes of this machine (default: one per core)')
    parser.add_argument('--example', metavar='DIR', type=Path, help='write recordings and a file of a fit to try')


def run(args: argparse.Namespace) -> Result:
    """Look ahead, or fit and write."""
    from mbd_sim_ros import fitting, interrupts

    if args.example is not None:
        from mbd_sim_ros.fitting.example import write_example

        file = write_example(args.example)
        return Result(data={'status': 'ok', 'file': str(file)}, text=f'{file}')
    if args.file is None:
        raise SpecError('mbd fit: the FILE is missing; mbd fit --example DIR writes one to try')
    if args.workers is not None and args.workers < 1:
        raise SpecError(f'--workers {args.workers}: must be at least 1')
    if args.out is None and not args.preflight:
        raise SpecError('mbd fit: --out DIR is missing: where vehicle, samples and page go; or ask for --preflight')
    interrupts.now(f'reading {args.file}')
    problem = fitting.load(args.file, workers=args.workers or os.cpu_count() or 1)
    if args.preflight:
        from mbd_sim_ros.fitting.foresight import report
        from mbd_sim_ros.fitting.results import told_text

        interrupts.now(f'looking at the recordings of {args.file}')
        try:
            told = fitting.preflight(problem)
        finally:
            problem.close()
        return Result(data={'status': 'ok', **report(told)}, text='\n'.join(told_text(told)))
    with alone(args.out):
        return _fitted(args, problem)


def _fitted(args: argparse.Namespace, problem: Any) -> Result:
    from tqdm import tqdm

    from mbd_sim_ros import fitting, interrupts
    from mbd_sim_ros.fitting import results
    from mbd_sim_ros.fitting.estimation import report

    interrupts.now(f'fitting {args.file}; what was run is kept in {args.out}, the same command goes on')
    with tqdm(disable=True if args.json else None, leave=False, bar_format='{desc} [{elapsed}]') as bar:
        found = fitting.fit(problem, args.out, say=bar.set_description)
        bar.set_description('writing')
        files = results.write(found, args.out)
    shutil.rmtree(args.out / 'runs', ignore_errors=True)
    lines = [*results.text(found), *files.values()]
    return Result(data={'status': 'ok', **report(found), 'files': files}, text='\n'.join(lines))
