"""`mbd`: the command line. Exit code 0 only on success; every error is one sentence on stderr, in --json mode an object on stdout."""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import sys
import traceback
from collections.abc import Sequence
from typing import Any, NoReturn

from mbd_sim_ros.commands import bench, compare, compile, export, info, recover, replay, run, study
from solver.compiled import interruption
from solver.errors import MbdError, suggestion

COMMANDS = (info, run, export, compare, replay, recover, study, bench, compile)
USAGE_ERROR, INTERNAL_ERROR, KILLED = 2, 70, 128  # KILLED + signal number, as shells do
SHOW_TRACEBACK = 'MBD_TRACEBACK'


class UsageError(MbdError):
    """The command line is not acceptable."""

    exit_code = USAGE_ERROR


class Parser(argparse.ArgumentParser):
    """Reports errors as one sentence instead of printing the usage."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(f'{self.prog}: {message}; see {self.prog} --help')


def parser() -> Parser:
    """The parser of all commands."""
    top = Parser(
        prog='mbd',
        description='Simulate, record, export and compare multibody scenes.',
        epilog='example:\n  mbd run slider_crank --out bags/first\n\nmbd COMMAND --help explains a command.',
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parsers = top.add_subparsers(metavar='COMMAND', required=True, parser_class=Parser)
    for command in COMMANDS:
        command.add(parsers)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; never raises, apart from --help's SystemExit."""
    last = argv is None  # the process ends with this command
    argv = list(sys.argv[1:] if argv is None else argv)
    as_json = '--json' in argv
    interruption.forget()
    # SIGINT too: a shell starts background jobs with it ignored, and launch tools end those with it
    previous = {number: signal.signal(number, _interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        first = next((a for a in argv if not a.startswith('-')), None)
        names = [c.__name__.rpartition('.')[2] for c in COMMANDS]
        if first is not None and first not in names:
            raise UsageError(f'mbd: no command {first!r}{suggestion(first, names)}')
        args = parser().parse_args(argv)
        result = args.run(args)
        _print(json.dumps(plain(result.data), allow_nan=False) if as_json else result.text)
        return result.code
    except MbdError as error:
        return _fail(str(error), error.exit_code, as_json)
    except KeyboardInterrupt as interrupt:
        sentence, number = interrupt.args or ('interrupted', signal.SIGINT)
        return _fail(sentence, KILLED + number, as_json)
    except BrokenPipeError:  # the reader of our output went away, e.g. `mbd info ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        return _fail(f'{error.filename or "the system"}: {error.strerror or error}', 1, as_json)
    except Exception as error:
        if os.environ.get(SHOW_TRACEBACK):
            traceback.print_exc()
        what = ' '.join(f'{type(error).__name__}: {error}'.split())
        return _fail(f'internal error: {what}; set {SHOW_TRACEBACK}=1 to see where', INTERNAL_ERROR, as_json)
    finally:
        for number, handler in previous.items():
            signal.signal(number, signal.SIG_IGN if last else handler)


def plain(value: Any) -> Any:
    """A value as JSON can hold it: numbers of numpy as numbers, those that are not finite as null."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if hasattr(value, 'item'):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, str | int | float | bool | None) else str(value)


def _interrupt(number: int, _frame: object) -> None:
    if interruption.pending():  # the second signal: whatever still goes on is not waited for
        _end(number)
    interruption.interrupt(KeyboardInterrupt('interrupted', number), lambda: _end(number))


def _end(number: int) -> NoReturn:
    """End the process here and now, whatever its threads are doing."""
    os.write(sys.stderr.fileno(), b'mbd: interrupted\n')
    os._exit(KILLED + number)


def _print(text: str) -> None:
    if text:
        print(text, flush=True)


def _fail(sentence: str, code: int, as_json: bool) -> int:
    if as_json:
        print(json.dumps({'status': 'error', 'error': sentence}), flush=True)
    else:
        print(sentence if sentence.startswith('mbd') else f'mbd: {sentence}', file=sys.stderr, flush=True)
    return code


if __name__ == '__main__':
    sys.exit(main())
