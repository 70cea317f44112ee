"""One module per command of `mbd`: add(parsers) declares it, run(args) returns a Result. Heavy imports wait until
run()."""

from __future__ import annotations

from mbd_sim_ros import beginning

beginning.hold('mbd', 'mbd_sim_ros.commands.main', 'mbd_sim_ros.commands.demo')  # before anything that takes time

import argparse
from collections.abc import Callable, Iterable, Sequence
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


def offer(action: argparse.Action, names: Callable[[], Iterable[str]], *, files: bool = False) -> argparse.Action:
    """Names that the Tab key offers for an argument, looked for when it is pressed. files: and, once something is
    typed, paths of files that scenes are made of. Returns the action."""

    def completer(prefix: str, **_: Any) -> list[str]:
        from argcomplete.completers import FilesCompleter

        paths = FilesCompleter(('yaml', 'tir'))(prefix) if files and prefix else ()
        return [*(name for name in names() if name.startswith(prefix)), *paths]

    action.completer = completer  # type: ignore[attr-defined]  # where argcomplete looks
    return action


def names_of(kind: str, ending: str = '') -> Callable[[], Iterable[str]]:
    """The names of a kind of files (solver.files.catalogue.KINDS) with an ending, for offer()."""

    def names() -> Iterable[str]:
        from solver.files.catalogue import files

        return [name + ending for name in files(kind)]

    return names


def evaluations() -> Iterable[str]:
    """The names of the evaluations, for offer()."""
    from mbd_sim_ros.analysis.evaluation.registry import EVALUATIONS

    return [evaluation.name for evaluation in EVALUATIONS]


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

    def __call__(
        self, parser: Any, namespace: argparse.Namespace, value: Any, option_string: str | None = None
    ) -> None:
        from solver.files.overrides import overtaken

        given = [*getattr(namespace, self.dest), value]
        lost = overtaken([one for one in given if not _is_parameter(one)])
        if lost is not None:
            part, whole = (one.partition('=')[0] for one in lost)
            parser.error(
                f'--set {part}: has no effect, because --set {whole} comes later and replaces all of {whole}; give '
                f'--set {whole} first'
            )
        setattr(namespace, self.dest, given)


def _is_parameter(assignment: str) -> bool:
    """True for a number under a key that stands alone: no part of a scene with parts has one, but parameters of
    evaluations do."""
    key, _, value = assignment.partition('=')
    try:
        return '.' not in key and float(value) is not None
    except ValueError:
        return False


def add_settings(parser: argparse.ArgumentParser, help_: str = SET_HELP, *also: str) -> None:
    """The argument --set. also: other names of it."""
    parser.add_argument('--set', *also, metavar='KEY=VALUE', action=Settings, default=[], dest='overrides', help=help_)


def add_scene(parser: argparse.ArgumentParser, help_: str = SCENE_HELP) -> argparse.Action:
    """The arguments SCENE, which is returned, and --set."""
    scene = offer(parser.add_argument('scene', metavar='SCENE', help=help_), names_of('scenes'), files=True)
    add_settings(parser)
    return scene


def table(rows: Sequence[tuple[str, ...]]) -> str:
    """Columns of text, aligned."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return '\n'.join('  '.join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows)
