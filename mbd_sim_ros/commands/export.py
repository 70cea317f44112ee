"""mbd export: a recording as CSV or Parquet files."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mbd_sim_ros.commands import Result, declare
from solver.errors import BagError


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers,
        'export',
        run,
        'write a recording as CSV or Parquet files, one per topic',
        "mbd export bags/first --csv out/first\n  mbd export bags/first --parquet out/first --channel 'odom/*' --channel 'tire/*'",
    )
    parser.add_argument('bag', metavar='BAG', type=Path, help='bag directory or .mcap file')
    parser.add_argument('--csv', metavar='DIR', type=Path, help='where to write <topic>.csv')
    parser.add_argument('--parquet', metavar='DIR', type=Path, help='where to write <topic>.parquet (extra `analysis`)')
    parser.add_argument('--channel', metavar='PATTERN', action='append', default=[], help="only channels like 'odom/*' (repeatable)")


def run(args: argparse.Namespace) -> Result:
    """Read and write."""
    from mbd_sim_ros import interrupts
    from mbd_sim_ros.analysis import dataframes, runs
    from mbd_sim_ros.bags import reader as bag

    if args.csv is None and args.parquet is None:
        raise BagError('nothing to write: give --csv DIR or --parquet DIR')
    interrupts.now(f'exporting {args.bag}')
    run_ = bag.read(args.bag, args.channel)
    runs.must_match(run_, args.channel, args.bag)
    if not run_.series:
        raise BagError(f'{args.bag}: nothing in it can be written as a table')
    files = runs.export(run_, args.csv) if args.csv is not None else []
    files += dataframes.export_parquet(run_, args.parquet) if args.parquet is not None else []
    others = _others(args.csv, '.csv', files) + _others(args.parquet, '.parquet', files)
    doubts = runs.suspicion(run_)
    rows = max(one.time_ns.size for one in run_.series.values())
    data = {
        'status': 'ok',
        'rows': rows,
        'columns': sum(len(one.columns) for one in run_.series.values()),
        'files': [str(f) for f in files],
        'not_read': run_.left_out,
        'others': [str(f) for f in others],
        'doubts': list(doubts),
    }
    lines = [*map(str, files), *doubts, *(f'not read: {t}: {why}' for t, why in run_.left_out.items())]
    if others:
        shown = ', '.join(f.name for f in others[:3]) + (f' and {len(others) - 3} more' if len(others) > 3 else '')
        lines.append(
            f'there before, and not of this export: {shown} in {others[0].parent}; give a new folder where they are of another run'
        )
    return Result(data=data, text='\n'.join(lines))


def _others(directory: Path | None, ending: str, files: Sequence[Path]) -> list[Path]:
    """Tables in a directory that were not written now: whoever reads all of them would mix two recordings."""
    return [] if directory is None else sorted(set(directory.glob(f'*{ending}')) - set(files))
