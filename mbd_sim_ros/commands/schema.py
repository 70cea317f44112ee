"""mbd schema: JSON Schemas of the files, for editors."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mbd_sim_ros.commands import Result, declare


def add(parsers: Any) -> None:
    """Declare the command."""
    parser = declare(
        parsers,
        'schema',
        run,
        'print the JSON Schema of a kind of file, by which editors complete and check it',
        'mbd schema vehicle\n  mbd schema --out schema',
    )
    parser.add_argument('kind', metavar='KIND', nargs='?', help='scene, vehicle, trailer, mechanism, maneuver or road')
    parser.add_argument('--out', metavar='DIR', type=Path, help='write the schemas of all kinds into this directory')


def run(args: argparse.Namespace) -> Result:
    """Print one, or write all."""
    import json

    from solver.disk import atomic_write
    from solver.errors import BagError, SpecError
    from solver.files.json_schema import KINDS, files, schema_of

    if (args.kind is None) == (args.out is None):
        raise SpecError(f'schema: give a kind of file, one of {", ".join(KINDS)}, or --out DIR for all of them')
    if args.out is None:
        schema = schema_of(args.kind)
        return Result(data={'status': 'ok', 'schema': schema}, text=json.dumps(schema, indent=1))
    written = files()
    try:
        args.out.mkdir(parents=True, exist_ok=True)
        for name, text in written.items():
            with atomic_write(args.out / name) as part:
                part.write_text(text, encoding='utf-8')
    except OSError as error:
        raise BagError(f'--out {args.out}: {error.strerror}; choose another place') from None
    return Result(
        data={'status': 'ok', 'files': [str(args.out / name) for name in written]},
        text=f'{len(written)} files in {args.out}',
    )
