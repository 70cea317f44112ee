"""mbd list: the names that there are, of scenes, vehicles, maneuvers, ..., each with a line of what it is."""

from __future__ import annotations

import argparse
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_sim_ros.commands import Result, declare, offer, table

if TYPE_CHECKING:
    from solver.files.catalogue import Entry

WIDTH = 120  # characters of a line of what something is; --json has all of it
USES = {  # kind: what its names are for
    'scenes': 'mbd run NAME',
    'vehicles': 'mbd info NAME, mbd run SCENE --vehicle NAME',
    'trailers': 'mbd run SCENE --set trailer=vehicles/trailers/NAME.yaml',
    'maneuvers': 'mbd run SCENE --maneuver NAME; those of norms: mbd maneuver',
    'tires': 'mbd info NAME.tir',
    'roads': 'mbd run SCENE --set road=roads/NAME.yaml',
    'mechanisms': 'mechanism: mechanisms/NAME.yaml in a scene',
    'sweeps': 'mbd sweep NAME --out DIR',
    'studies': 'mbd study NAME',
}


def add(parsers: Any) -> None:
    """Declare the command."""
    what = 'list scenes, vehicles, maneuvers, tires, roads, sweeps and studies, each with a line of what it is'
    parser = declare(parsers, 'list', run, what, 'mbd list scenes\n  mbd list vehicles tires --json')
    parser.description += (  # type: ignore[operator]
        ' Files are those of the current directory (scenes/, vehicles/, ..., also below config/) and those that came '
        'with the program.'
    )
    offer(
        parser.add_argument('kinds', metavar='KIND', nargs='*', help=f'{", ".join(USES)} (default: all)'), lambda: USES
    )


def run(args: argparse.Namespace) -> Result:
    """Look, list."""
    from solver.errors import SpecError, suggestion
    from solver.files.catalogue import entries
    from solver.files.search_path import config_directories

    for kind in args.kinds:
        if kind not in USES:
            raise SpecError(f'mbd list: there is no kind {kind!r}{suggestion(kind, USES)}')
    data: dict[str, Any] = {'status': 'ok', 'directories': [str(directory) for directory in config_directories()]}
    parts = []
    for kind in dict.fromkeys(args.kinds or USES):
        if kind == 'studies':
            found = _studies()
        else:
            found = [
                {'name': e.name, 'text': e.text, 'file': str(e.file), 'include': e.include, 'own': _own(e)}
                for e in entries(kind)
            ]
        data[kind] = found
        rows = [(f'  {one["name"]}', _line(one)) for one in found]
        parts.append(f'{kind}: {USES[kind]}\n' + (table(rows) if rows else '  none'))
    return Result(data=data, text='\n\n'.join(parts))


def _studies() -> list[dict[str, Any]]:
    from mbd_sim_ros.lab.studies import installed, summary

    return [{'name': name, 'text': summary(name)} for name in installed()]


def _own(entry: Entry) -> bool:
    """True of a file of the user: it was found from the current directory, and that is not the one that came with the
    program."""
    from solver.files.search_path import CHECKOUT

    here = (Path.cwd() / entry.include, Path.cwd() / 'config' / entry.include)
    return entry.file in here and not entry.file.is_relative_to(CHECKOUT)


def _line(one: dict[str, Any]) -> str:
    text = textwrap.shorten(one['text'], WIDTH, placeholder=' ...')
    return f'{text} ({Path(one["file"]).relative_to(Path.cwd())})'.lstrip() if one.get('own') else text
