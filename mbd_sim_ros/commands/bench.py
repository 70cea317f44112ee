"""mbd bench: what a step costs on this machine."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any

from mbd_sim_ros.commands import Result, declare

DEFAULT = 'benchmarks.yaml'


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers,
        'bench',
        run,
        'measure what steps cost, their parts, publishing and recording, a start, and the node at work',
        'mbd bench --cases slider_crank,light_car_1ms --quick\n  mbd bench --out docs/performance.md\n'
        '  mbd bench --suite node_at_work.yaml --duration 60',
    )
    parser.add_argument('--cases', metavar='NAMES', default='', help='only these cases, separated by commas')
    parser.add_argument(
        '--suite', metavar='FILE', default=DEFAULT, help='list of cases: a path, or a file in config (%(default)s)'
    )
    parser.add_argument('--duration', metavar='S', type=float, help='simulated seconds of the cases that run the node')
    parser.add_argument('--quick', action='store_true', help='fewer steps: for a first look, not for comparisons')
    parser.add_argument(
        '--strict', action='store_true', help='exit code 1 when a target is missed or a case cannot be measured'
    )
    parser.add_argument(
        '--out',
        metavar='FILE.md',
        type=Path,
        help='also write the tables as Markdown (into the generated part of an existing file)',
    )


def run(args: argparse.Namespace) -> Result:
    """Measure, judge, show."""
    from tqdm import tqdm

    from mbd_sim_ros.lab.benchmarks import suite, verdicts

    if args.out is not None and args.out.is_dir():
        raise IsADirectoryError(21, 'is a directory; --out needs the name of a file', str(args.out))
    cases = suite.load_suite(args.suite, [name.strip() for name in args.cases.split(',') if name.strip()])
    if args.out is not None:
        verdicts.require_place(args.out)
    if args.duration is not None:
        cases = tuple(dataclasses.replace(case, duration=args.duration) for case in cases)
    with tqdm(total=0, bar_format='{desc}', disable=True if args.json else None, leave=False) as line:
        found = suite.run(cases, quick=args.quick, say=line.set_description_str)
    measured = [case for case in found['cases'] if case['status'] == 'ok']
    missed = [f'{case["name"]}/{t["figure"]}' for case in found['cases'] for t in case['targets'] if not t['met']]
    missed += [f'{row["scene"]}/growth' for row in found['growth'] if not row['met']]
    complete = len(measured) == len(cases) and not missed and not any(case.get('left_out') for case in measured)
    failed = not measured or (args.strict and not complete)
    data = {'status': 'failed' if failed else 'ok', 'quick': args.quick, 'missed': missed, **found}
    if args.out is not None and measured:
        suite_name = '' if args.suite == DEFAULT else Path(args.suite).stem
        given = {
            '--suite': suite_name and args.suite,
            '--cases': args.cases,
            '--duration': args.duration and f'{args.duration:g}',
        }
        options = ''.join(
            [' --quick' if args.quick else '', *(f' {name} {value}' for name, value in given.items() if value)]
        )
        where = args.out.name if args.out.is_absolute() else args.out
        verdicts.write(found, args.out, f'mbd bench{options} --out {where}', suite_name)
    return Result(data=data, text=verdicts.text(found), code=1 if failed else 0)
