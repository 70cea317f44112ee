"""mbd compare: two runs, or a run and a table, side by side."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_sim_ros.commands import Result, declare, table
from solver.errors import BagError

if TYPE_CHECKING:
    from mbd_sim_ros.analysis.compare import Comparison

SHOWN = 12


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers,
        'compare',
        run,
        'compare a run with a reference; exit code 1 when a channel is outside its tolerance',
        'mbd compare bags/coarse bags/fine --rtol 1e-3 --atol 1e-6 --plot out/compare.png\n  mbd compare bags/first bags/again --exact',
    )
    parser.add_argument('run_', metavar='RUN', type=Path, help='bag directory, .mcap file, .csv file or directory of .csv files')
    parser.add_argument('reference', metavar='REFERENCE', type=Path, help='the same; differences are RUN - REFERENCE')
    parser.add_argument(
        '--rtol',
        type=float,
        default=1e-6,
        help='allowed difference relative to the largest value of the channel in REFERENCE (%(default)g)',
    )
    parser.add_argument('--atol', type=float, default=1e-9, help='allowed absolute difference, added to the relative one (%(default)g)')
    parser.add_argument('--exact', action='store_true', help='same instants, same channels, same bits')
    parser.add_argument(
        '--channel', metavar='PATTERN', action='append', default=[], help="compare only channels like 'odom/*' (repeatable)"
    )
    parser.add_argument(
        '--map',
        metavar='THEIRS=OURS',
        action='append',
        default=[],
        help='a channel of REFERENCE and the channel of RUN it belongs to (repeatable)',
    )
    parser.add_argument('--plot', metavar='PNG', type=Path, help='draw the channels that differ most')


def run(args: argparse.Namespace) -> Result:
    """Read both, compare, draw."""
    from mbd_sim_ros.analysis import tables
    from mbd_sim_ros.analysis.compare import compare

    if args.rtol < 0.0 or args.atol < 0.0:
        raise BagError(f'--rtol {args.rtol:g} --atol {args.atol:g}: tolerances must not be negative')
    names = {}
    for pair in args.map:
        theirs, equals, ours = pair.partition('=')
        if not (equals and theirs and ours):
            raise BagError(f'--map {pair!r}: write it as THEIRS=OURS')
        names[theirs] = ours
    a, b = tables.read(args.run_), tables.read(args.reference)
    found = compare(a, b, rtol=args.rtol, atol=args.atol, exact=args.exact, channels=args.channel, names=names)
    if args.plot is not None:
        from mbd_sim_ros.analysis.plots import plot_comparison

        labels = (args.run_.name, args.reference.name if args.reference.name != args.run_.name else f'{args.reference}')
        plot_comparison(found, args.plot, names=labels, kinds=tables.joint_kinds(a) or tables.joint_kinds(b))
    return report(found, plot=args.plot)


def report(found: Comparison, plot: Path | None = None) -> Result:
    """A comparison as a Result: exit code 0 when every channel is within its tolerance."""
    outside = [d for d in found.differences if not d.ok]
    data = {
        'status': 'same' if found.ok else 'different',
        'instants': len(found.time),
        'interpolated': found.interpolated,
        'channels': {
            d.channel: {'max': d.max, 'rms': d.rms, 'time_of_max': d.time, 'scale': d.scale, 'ok': d.ok} for d in found.differences
        },
        'outside': [d.channel for d in outside],
        'left_out': list(found.left_out),
        'plot': None if plot is None else str(plot),
    }
    rows = [('channel', 'max', 'at [s]', 'rms', 'scale', '')]
    for d in found.differences[:SHOWN]:
        rows.append((d.channel, f'{d.max:.3g}', f'{d.time:.6g}', f'{d.rms:.3g}', f'{d.scale:.3g}', '' if d.ok else 'OUTSIDE'))
    lines = [table(rows)]
    if len(found.differences) > SHOWN:
        lines.append(f'... and {len(found.differences) - SHOWN} channels that differ less')
    if found.left_out:
        lines.append(
            f'in one run only: {", ".join(found.left_out[:6])}'
            + (f' and {len(found.left_out) - 6} more' if len(found.left_out) > 6 else '')
        )
    verdict = f'{len(outside)} of {len(found.differences)} channels outside' if outside else f'{len(found.differences)} channels within'
    lines.append(f'{verdict} tolerance at {len(found.time)} instants' + (' (interpolated)' if found.interpolated else ''))
    return Result(data=data, text='\n'.join(lines), code=0 if found.ok else 1)
