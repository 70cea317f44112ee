"""mbd recover: save what a killed recording holds."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mbd_sim_ros.commands import Result, declare


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers,
        'recover',
        run,
        'copy every complete chunk of a recording that was cut off, damaged or split into several files into a new bag',
        'mbd recover bags/killed bags/saved',
    )
    parser.add_argument(
        'bag', metavar='BAG', type=Path, help='bag directory, also with several files, or .mcap(.part) file'
    )
    parser.add_argument('new', metavar='NEW', type=Path, help='new bag directory')


def run(args: argparse.Namespace) -> Result:
    """Copy."""
    from mbd_sim_ros.bags.recovery import recover

    saved = recover(args.bag, args.new)
    data = {
        'status': 'ok',
        'out': str(saved.directory),
        'messages': saved.messages,
        'start': saved.start_ns * 1e-9,
        'end': saved.end_ns * 1e-9,
        'complete': saved.complete,
        'damage': list(saved.damage),
        'lost': saved.lost,
        'not_copied': saved.left_out,
    }
    whole = (
        'the recording was whole'
        if saved.complete
        else f'the recording was cut off or damaged: {"; ".join(saved.damage)}'
    )
    lines = [f'{saved.messages} messages, {data["start"]:g} to {data["end"]:g} s, saved in {saved.directory} ({whole})']
    lines += [f'not copied: {topic}: {why}' for topic, why in saved.left_out.items()]
    return Result(data=data, text='\n'.join(lines))
