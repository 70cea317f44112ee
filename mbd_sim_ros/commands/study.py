"""mbd study: regenerate a study, with its report, pictures and tables."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from mbd_sim_ros.commands import Result, declare, table

BAR = '{percentage:3.0f}% |{bar:30}| {desc}'


class _Listing(argparse.RawDescriptionHelpFormatter):
    """Lists the studies below the help; only then are their modules imported."""

    def format_help(self) -> str:
        from mbd_sim_ros.lab.studies import STUDIES, module

        return f'{super().format_help()}\nstudies:\n' + ''.join(f'  {name:20} {module(name).SUMMARY}\n' for name in STUDIES)


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers,
        'study',
        run,
        'put a question to many runs and write a report with pictures and tables',
        'mbd study slider_crank --out out/slider_crank\n  mbd study penalty_map --quick',
    )
    parser.formatter_class = _Listing
    parser.add_argument('name', metavar='NAME', help='one of the studies below')
    parser.add_argument('--out', metavar='DIR', type=Path, help='directory of the report (default: out/NAME)')
    parser.add_argument('--quick', action='store_true', help='a few runs only: for a first look, not for conclusions')
    parser.add_argument('--strict', action='store_true', help='exit code 1 when a check is not met')


def run(args: argparse.Namespace) -> Result:
    """Run the study, show its checks."""
    from tqdm import tqdm

    from mbd_sim_ros.lab import studies as study

    study.module(args.name)  # a wrong name makes no directory
    out = args.out or Path('out') / args.name
    with tqdm(total=1.0, bar_format=BAR, disable=args.json or not sys.stderr.isatty(), leave=False) as bar:

        def progress(text: str, done: float) -> None:
            bar.set_description_str(text, refresh=False)
            bar.update(min(1.0, done) - bar.n)

        figures = study.run(args.name, out, quick=args.quick, progress=progress)
    missed = [check['name'] for check in figures['checks'] if not check['met']]
    failed = args.strict and bool(missed)
    data = {
        'status': 'failed' if failed else 'ok',
        'study': args.name,
        'quick': args.quick,
        'out': str(out),
        'report': str(out / 'report.md'),
        'missed': missed,
        **figures,
    }
    rows = [(c['name'], f'{c["value"]:.3g}', f'{c["limit"]:.3g}', '' if c['met'] else 'NOT MET') for c in figures['checks']]
    text = [table([('check', 'value', 'limit', ''), *rows]), f'{len(missed)} of {len(rows)} checks not met', f'report: {out / "report.md"}']
    return Result(data=data, text='\n'.join(text if rows else text[-1:]), code=1 if failed else 0)
