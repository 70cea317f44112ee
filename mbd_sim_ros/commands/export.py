"""mbd export: a recording as CSV or Parquet files."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_sim_ros.commands import Result, add_log_times, declare
from solver.errors import BagError

if TYPE_CHECKING:
    from mbd_sim_ros.bags.reader import Run

SHOWN = 4  # topics that are named


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers,
        'export',
        run,
        'write a recording as CSV or Parquet files, one per topic',
        "mbd export bags/first --csv out/first\n  mbd export bags/first --parquet out/first --channel 'odom/*' "
        "--channel 'tire/*'",
    )
    parser.add_argument('bag', metavar='BAG', type=Path, help='bag directory or .mcap file')
    parser.add_argument('--csv', metavar='DIR', type=Path, help='where to write <topic>.csv')
    parser.add_argument('--parquet', metavar='DIR', type=Path, help='where to write <topic>.parquet (extra `analysis`)')
    parser.add_argument(
        '--channel', metavar='PATTERN', action='append', default=[], help="only channels like 'odom/*' (repeatable)"
    )
    add_log_times(parser)


def run(args: argparse.Namespace) -> Result:
    """Read and write."""
    from mbd_sim_ros import interrupts
    from mbd_sim_ros.analysis import dataframes, runs
    from mbd_sim_ros.bags import reader as bag

    if args.csv is None and args.parquet is None:
        raise BagError('nothing to write: give --csv DIR or --parquet DIR')
    interrupts.now(f'exporting {args.bag}')
    run_ = bag.read(args.bag, args.channel, log_times=args.log_times)
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
        'messages': sum(run_.messages.values()),
        'topics': {
            topic: {
                'messages': one.messages,
                'rows': one.rows,
                'left_out': one.equal,
                'beside': one.beside,
                'clock': one.clock,
            }
            for topic, one in run_.accounts.items()
        },
        'passed_over': run_.passed,
        'not_read': run_.left_out,
        'others': [str(f) for f in others],
        'doubts': list(doubts),
    }
    lines = [*map(str, files), *doubts, *(_not_read(run_, t, why) for t, why in run_.left_out.items()), _balance(run_)]
    if others:
        shown = ', '.join(f.name for f in others[:3]) + (f' and {len(others) - 3} more' if len(others) > 3 else '')
        lines.append(
            f'there before, and not of this export: {shown} in {others[0].parent}; give a new folder where they are of '
            'another run'
        )
    return Result(data=data, text='\n'.join(lines))


def _not_read(run: Run, topic: str, why: str) -> str:
    return f'not read: {topic} ({run.passed.get(topic, 0)} messages): {why}'


def _balance(run: Run) -> str:
    """Account of all messages in the file."""
    count = lambda what: sum(getattr(one, what) for one in run.accounts.values())  # noqa: E731
    parts = [f'{count("rows")} are rows']
    for number, what in ((count('beside'), 'are in the row of another one'), (count('equal'), 'are left out')):
        parts += [f'{number} {what}'] if number else []
    if run.passed:
        shown = [f'{topic} ({number})' for topic, number in run.passed.items()]
        more = f' and {len(shown) - SHOWN} more topics' if len(shown) > SHOWN else ''
        parts.append(f'{sum(run.passed.values())} are in no table: {", ".join(shown[:SHOWN])}{more}')
    return f'of {sum(run.messages.values())} messages ' + ', '.join(parts)


def _others(directory: Path | None, ending: str, files: Sequence[Path]) -> list[Path]:
    """Tables in a directory that were not written now: whoever reads all of them would mix two recordings."""
    return [] if directory is None else sorted(set(directory.glob(f'*{ending}')) - set(files))
