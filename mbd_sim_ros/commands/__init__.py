"""One module per command of `mbd`: add(parsers) declares it, run(args) returns a Result. Heavy imports wait until run()."""

from __future__ import annotations

from mbd_sim_ros import beginning

beginning.hold('mbd', 'mbd_sim_ros.commands.main', 'mbd_sim_ros.commands.demo')  # before anything that takes time

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

SCENE_HELP = 'path of a scene file, or a name in config/scenes'
SET_HELP = 'change one value of the scene, checked like the file itself (repeatable), e.g. --set integrator.h=0.002'


@dataclass(frozen=True, kw_only=True)
class Result:
    """Result of a command: the object that --json prints, the text for people, and the exit code (0 only on
    success)."""

    data: dict[str, Any] = field(default_factory=dict)
    text: str = ''
    code: int = 0


def declare(parsers: Any, name: str, run: Any, help_: str, example: str) -> argparse.ArgumentParser:
    """Add a command with its example and --json."""
    parser = parsers.add_parser(
        name,
        help=help_,
        description=help_[0].upper() + help_[1:] + '.',
        epilog=f'example:\n  {example}',
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument('--json', action='store_true', help='print exactly one JSON object on stdout')
    parser.set_defaults(run=run, parser=parser)
    return parser


def add_log_times(parser: Any) -> None:
    """Declare --log-times, of commands that read recordings."""
    parser.add_argument(
        '--log-times',
        action='store_true',
        help='take the time when messages were recorded, not that in their headers or of their publication',
    )


class Settings(argparse.Action):
    """--set KEY=VALUE, repeatable. An override of a part comes after an override of the whole; the other order is
    refused, since the part would be lost."""

    def __call__(self, parser: Any, namespace: argparse.Namespace, value: Any, option_string: str | None = None) -> None:
        from solver.files.overrides import overtaken

        given = [*getattr(namespace, self.dest), value]
        lost = overtaken(given)
        if lost is not None:
            part, whole = (one.partition('=')[0] for one in lost)
            parser.error(
                f'--set {part}: has no effect, because --set {whole} comes later and replaces all of {whole}; give --set {whole} first'
            )
        setattr(namespace, self.dest, given)


def add_settings(parser: argparse.ArgumentParser, help_: str = SET_HELP) -> None:
    """The argument --set."""
    parser.add_argument('--set', metavar='KEY=VALUE', action=Settings, default=[], dest='overrides', help=help_)


def add_scene(parser: argparse.ArgumentParser, help_: str = SCENE_HELP) -> None:
    """The arguments SCENE and --set."""
    parser.add_argument('scene', metavar='SCENE', help=help_)
    add_settings(parser)


def table(rows: Sequence[tuple[str, ...]]) -> str:
    """Columns of text, aligned."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return '\n'.join('  '.join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)
