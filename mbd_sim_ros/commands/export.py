"""mbd export: a recording as CSV files."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mbd_sim_ros.commands import Result, declare


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(parsers, 'export', run, 'write a recording as CSV files, one per topic', 'mbd export bags/first --csv out/first')
    parser.add_argument('bag', metavar='BAG', type=Path, help='bag directory or .mcap file')
    parser.add_argument('--csv', metavar='DIR', type=Path, required=True, help='where to write <topic>.csv')


def run(args: argparse.Namespace) -> Result:
    """Read and write."""
    from mbd_sim_ros.analysis import tables
    from mbd_sim_ros.bags import reader as bag

    run_ = bag.read(args.bag)
    files = [str(f) for f in tables.export(run_, args.csv)]
    data = {'status': 'ok', 'rows': len(run_.time_ns), 'columns': len(run_.columns), 'files': files}
    return Result(data=data, text='\n'.join(files))
