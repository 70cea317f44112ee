"""`mbd`: the command line. Exit code 0 only on success; every error is one sentence on stderr, in --json mode an object
on stdout."""

from __future__ import annotations

import os
import sys

from mbd_sim_ros import beginning, interrupts


def _say(text: str) -> None:
    interrupts.write(2, f'mbd: {text}')


def _say_early(text: str) -> None:
    """Before the arguments are read."""
    if '--json' in sys.argv:
        interrupts.write(1, f'{{"status": "error", "error": "{text}"}}')
    else:
        _say(text)


PROGRAM = __name__ == '__main__' or beginning.is_program('mbd')  # the process ends with the command

if PROGRAM:
    interrupts.install(_say_early)
    # What is computed at once is computed in processes. Threads of BLAS, two for a matrix of fifty rows, only wait for
    # each other, and the longer the busier the machine is. numpy reads this when it is imported.
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

import argparse
import json
import re
import shlex
import signal
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from typing import Any, NoReturn

from mbd_sim_ros.commands import (
    bench,
    build,
    compare,
    compile,
    drive,
    evaluate,
    export,
    fit,
    fmu,
    info,
    kandc,
    maneuver,
    plan,
    recover,
    replay,
    run,
    schema,
    study,
    sweep,
    tune,
    view,
)
from mbd_sim_ros.commands import list as listing
from mbd_sim_ros.commands.colour import is_wanted, painted
from solver.disk import plain
from solver.errors import MbdError, missing, refused, suggestion

COMMANDS = (
    listing,
    info,
    kandc,
    run,
    drive,
    plan,
    maneuver,
    tune,
    sweep,
    fit,
    export,
    compare,
    evaluate,
    view,
    replay,
    recover,
    schema,
    study,
    bench,
    compile,
    build,
    fmu,
)
USAGE_ERROR, INTERNAL_ERROR = 2, 70
HELP = ('-h', '--help', '--version')
OUTPUT = 'the output'  # what sentences call it
SHOW_TRACEBACK = 'MBD_TRACEBACK'
SENTENCE_MOST, LEFT_OUT = 1000, ' ... '  # characters, and what stands for those in the middle


class UsageError(MbdError):
    """The command line is not acceptable."""

    exit_code = USAGE_ERROR


class Parser(argparse.ArgumentParser):
    """Reports errors as one sentence instead of printing the usage."""

    def error(self, message: str) -> NoReturn:
        message = re.sub(r"invalid (int|float) value: ('.*')", _not_a_number, message)
        raise UsageError(f'{self.prog}: {message}; see {self.prog} --help')

    def _print_message(self, message: str, file: Any = None) -> None:
        """Print the help. That of the library passes over what cannot be written. Raises OSError."""
        try:
            print(message, end='', file=file, flush=True)
        except OSError as error:
            raise OSError(error.errno, error.strerror, OUTPUT) from None


class _Version(argparse.Action):
    """Looks when it is asked for, for that takes a while."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> NoReturn:
        from mbd_sim_ros.bags.recorder import code_version

        parser._print_message(f'mbd_sim_ros {code_version()}\n', sys.stdout)
        parser.exit()


def _not_a_number(found: re.Match[str]) -> str:
    return f'{found[2]} is not a {"whole " if found[1] == "int" else ""}number; write it in digits and without a unit'


def parser() -> Parser:
    """The parser of all commands."""
    top = Parser(
        prog='mbd',
        description='Simulate, record, export and compare multibody scenes.',
        epilog='example:\n  mbd run slider_crank --out bags/first\n\nmbd COMMAND --help explains a command.',
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    top.add_argument(
        '--version', action=_Version, nargs=0, help='show which version this is, as recordings name it, and exit'
    )
    parsers = top.add_subparsers(metavar='COMMAND', required=True, parser_class=Parser)
    for command in COMMANDS:
        command.add(parsers)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; never raises, apart from --help's SystemExit. A program ends here."""
    if '_ARGCOMPLETE' in os.environ:  # the Tab key in a shell: offers what may stand here, and ends the process
        import argcomplete

        argcomplete.autocomplete(parser(), always_complete_options=False)
    code = _command(argv)
    if PROGRAM:
        interrupts.end(code)
    return code


def _command(argv: Sequence[str] | None) -> int:
    if sys.stdout is None or sys.stderr is None:  # what is opened next would take their place
        _say('the output is closed; give it a place, or /dev/null')
        return 1
    argv = list(sys.argv[1:] if argv is None else argv)
    as_json = '--json' in argv
    interrupts.command = shlex.join(['mbd', *argv])
    with _output(as_json) as out, interrupts.watched(lambda text: _at_the_end(text, out, as_json)):
        try:
            try:
                first = next((a for a in argv if not a.startswith('-')), None)
                names = [c.__name__.rpartition('.')[2] for c in COMMANDS]
                if first is not None and argv[0] != first and argv[0] not in HELP:
                    raise UsageError(f'mbd: {argv[0]} stands before the command; write mbd COMMAND ... {argv[0]}')
                if first is not None and first not in names:
                    raise UsageError(f'mbd: no command {first!r}{suggestion(first, names)}')
                interrupts.now(f'starting mbd {first}' if first else '')
                args, unknown = parser().parse_known_args(argv)
                if unknown:
                    known = dict.fromkeys(re.findall(r'--[\w-]+', args.parser.format_help()))
                    args.parser.error(f'unrecognized argument {unknown[0]}{suggestion(unknown[0], known)}')
                result = args.run(args)
                text = json.dumps(plain(result.data), allow_nan=False) if as_json else result.text
                out.say(painted(text) if not as_json and is_wanted(out.stream) else text)
                return result.code
            except MbdError as error:
                return _fail(out, str(error), error.exit_code, as_json)
            except KeyboardInterrupt as interrupt:
                sentence, number = (
                    interrupt.args if len(interrupt.args) == 2 else (interrupts.sentence(), signal.SIGINT)
                )
                code = interrupts.EXIT + number
                with interrupts.saying() as mine:
                    return _fail(out, sentence, code, as_json) if mine else code
            except BrokenPipeError:  # the reader of our output went away, e.g. `mbd info ... | head`
                out.drop()
                return 1
            except OSError as error:
                code = _fail(out, refused(error), 1, as_json)
                if error.filename == OUTPUT:
                    out.drop()
                return code
            except MemoryError:
                what = f' while {interrupts.doing}' if interrupts.doing else ''
                return _fail(out, f'there is not enough memory{what}; ask for less, or free some', 1, as_json)
            except ImportError as error:
                if not (text := missing(error)):
                    return _internal(out, error, as_json)
                return _fail(out, text, USAGE_ERROR, as_json)
            except Exception as error:
                return _internal(out, error, as_json)
        except OSError as error:  # what says the error cannot be written either
            out.drop()
            if as_json:
                with suppress(OSError):
                    _say(f'{OUTPUT}: {error.strerror or error}')
            return 1


def _internal(out: _Output, error: Exception, as_json: bool) -> int:
    """Say that the program has a defect; in an `except`."""
    if os.environ.get(SHOW_TRACEBACK):
        traceback.print_exc()
    what = ' '.join(f'{type(error).__name__}: {error}'.split())
    return _fail(out, f'internal error: {what}; set {SHOW_TRACEBACK}=1 to see where', INTERNAL_ERROR, as_json)


class _Output:
    """Output of the result: the standard output, while libraries print to the standard error in --json mode."""

    def __init__(self) -> None:
        self.stream = sys.stdout

    def say(self, text: str) -> None:
        """Write the result. Raises OSError."""
        if text:
            encoding = self.stream.encoding or 'utf-8'
            text = text.encode(encoding, 'backslashreplace').decode(encoding)  # names of files may be any bytes
            try:
                print(text, file=self.stream, flush=True)
            except OSError as error:
                raise OSError(error.errno, error.strerror, OUTPUT) from None

    def drop(self) -> None:
        """Have the interpreter not try again to write at its end."""
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.stream.fileno())


@contextmanager
def _output(as_json: bool) -> Iterator[_Output]:
    """In --json mode nothing but the result reaches the standard output, whatever a library prints, in Python or in
    C."""
    out = _Output()
    if not as_json:
        yield out
        return
    captured = sys.stdout is not sys.__stdout__  # by whoever called main()
    try:
        kept = os.dup(1)
    except OSError:  # closed
        yield out
        return
    sys.stdout.flush()
    if not captured:
        out.stream = os.fdopen(os.dup(kept), 'w', encoding='utf-8')
    with suppress(OSError):
        os.dup2(2, 1)
    try:
        with redirect_stdout(sys.stderr):
            yield out
    finally:
        with suppress(OSError, ValueError):
            sys.stdout.flush()
        if not PROGRAM:  # else it stays as it is: libraries print at the very end too
            os.dup2(kept, 1)
        os.close(kept)
        if not captured:
            with suppress(OSError):
                out.stream.close()


def one_sentence(text: str) -> str:
    """A text as one line that fits a screen, whatever was quoted in it."""
    line = ''.join(c if c.isprintable() else c.encode('unicode_escape').decode() for c in text)
    if len(line) <= SENTENCE_MOST:
        return line
    half = (SENTENCE_MOST - len(LEFT_OUT)) // 2
    return line[:half] + LEFT_OUT + line[-half:]


def _fail(out: _Output, sentence: str, code: int, as_json: bool) -> int:
    sentence = one_sentence(sentence)
    if as_json:
        out.say(json.dumps({'status': 'error', 'error': sentence}))
    else:
        print(sentence if sentence.startswith('mbd') else f'mbd: {sentence}', file=sys.stderr, flush=True)
    return code


def _at_the_end(sentence: str, out: _Output, as_json: bool) -> None:
    """Say why the process is ended, past all buffers."""
    if as_json:
        interrupts.write(out.stream.fileno(), json.dumps({'status': 'error', 'error': sentence}))
    else:
        _say(sentence)


if __name__ == '__main__':
    sys.exit(main())
