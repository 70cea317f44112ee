"""Runs the cases of the fuzzer in children of this process and judges how they end."""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from fuzz_cases import KINDS, Material
from mutations import numbers_of

from mbd_sim_ros.commands.main import INTERNAL_ERROR, main
from solver.errors import MbdError

SECONDS, MEGABYTES = 10.0, 1024  # that a command may take: CPU time, memory
MOST_WORK = 20_000  # steps times iterations times bodies
WALL = 90.0  # s: what waits for ever, on a machine that is busy otherwise


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """How a case ended. fault: '' or what was wrong. code: of the command."""

    kind: str
    case: int
    code: int
    fault: str
    said: str
    seconds: float
    megabytes: int


def run_case(kind: str, seed: int, case: int, directory: Path, material: Material) -> Verdict:
    """One case in a child of this process; its files stay in `directory`."""
    directory.mkdir(parents=True, exist_ok=True)
    child = os.fork()
    if child == 0:
        _inside(kind, seed, case, directory, material)
    begin = time.monotonic()
    ended, status, used = 0, 0, None
    try:
        while not ended:
            ended, status, used = os.wait4(child, os.WNOHANG)
            if not ended and time.monotonic() - begin > WALL:
                os.kill(child, signal.SIGKILL)
            if not ended:
                time.sleep(0.002)
    except KeyboardInterrupt:
        if not ended:
            os.kill(child, signal.SIGKILL)
            os.wait4(child, 0)
        raise
    assert used is not None
    seconds, megabytes = used.ru_utime + used.ru_stime, used.ru_maxrss // 1024
    code = os.waitstatus_to_exitcode(status)
    said = (directory / 'out').read_text(errors='replace') if (directory / 'out').exists() else ''
    complained = (directory / 'err').read_text(errors='replace') if (directory / 'err').exists() else ''
    held = (directory / 'held').read_text() if (directory / 'held').exists() else 'it did not end'
    fault = _fault(code, said, complained, held, seconds, megabytes)
    return Verdict(
        kind=kind,
        case=case,
        code=code,
        fault=fault,
        said=(said + complained)[-600:],
        seconds=round(seconds, 3),
        megabytes=megabytes,
    )


def _fault(code: int, said: str, complained: str, held: str, seconds: float, megabytes: int) -> str:
    if seconds > SECONDS:
        return f'{seconds:.1f} s of CPU time'
    if code < 0:
        return f'ended by signal {-code}'
    if megabytes > MEGABYTES:
        return f'{megabytes} MB'
    if code == INTERNAL_ERROR or 'internal error' in said:
        return 'internal error'
    if 'Traceback' in complained:
        return 'traceback'
    if held:
        return held
    if said:
        try:
            told = json.loads(said)
        except ValueError:
            return 'not one JSON object'
        if not isinstance(told, dict) or said.count('\n') != 1:
            return 'not one JSON object'
        sentence = told.get('error', '')
        if code and told.get('status') == 'error' and (not sentence or '\n' in sentence or len(sentence) > 1000):
            return 'not one sentence'
    return ''


def _inside(kind: str, seed: int, case: int, directory: Path, material: Material) -> None:
    """What the child does; it does not return."""
    code = 99
    try:
        os.chdir(directory)
        os.setsid()
        for number, name in ((1, 'out'), (2, 'err')):
            os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        sys.stdout, sys.stderr = os.fdopen(1, 'w', closefd=False), os.fdopen(2, 'w', closefd=False)
        sys.__stdout__ = sys.stdout  # type: ignore[misc]
        resource.setrlimit(resource.RLIMIT_CPU, (int(SECONDS) + 2, int(SECONDS) + 3))
        resource.setrlimit(resource.RLIMIT_DATA, (3 << 30, 3 << 30))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 28, 1 << 28))
        arguments, look = KINDS[kind](numbers_of(kind, seed, case), directory, material)
        arguments = _short(arguments)
        (directory / 'arguments').write_text(json.dumps(arguments))
        code = main([*arguments, '--json']) if arguments else 0
        sys.stdout.flush()
        text = (directory / 'out').read_text(errors='replace')
        told = json.loads(text) if text.startswith('{') else {}
        (directory / 'held').write_text(look(code, told) if look is not None else '')
    except SystemExit as end:
        (directory / 'held').write_text('')
        code = int(end.code or 0)
    except BaseException as error:
        import traceback

        (directory / 'held').write_text(f'{type(error).__name__}: {str(error)[:200]}')
        traceback.print_exc()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _short(arguments: list[str]) -> list[str]:
    """A run that is asked for more than MOST_WORK passes over its model is looked at, not run: that takes long by
    right."""
    if arguments[:1] != ['run'] or '--duration' not in arguments:
        return arguments
    from solver.files.scene import find_file, load_scene

    texts = [arguments[k + 1] for k, one in enumerate(arguments[:-1]) if one == '--set']
    try:
        if '--maneuver' in arguments:
            texts.append(f'maneuver={find_file(arguments[arguments.index("--maneuver") + 1], "maneuvers").resolve()}')
        scene = load_scene(arguments[1], [*texts, f'duration={arguments[arguments.index("--duration") + 1]}'])
    except (MbdError, IndexError, OSError):
        return arguments
    s = scene.integrator
    work = scene.steps * (s.iterations if s.mode == 'fixed' else s.max_iterations) * len(scene.model.bodies)
    if work <= MOST_WORK:
        return arguments
    return ['info', arguments[1], '--brief', *(part for text in texts for part in ('--set', text))]
