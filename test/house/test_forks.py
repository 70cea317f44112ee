"""Forked programs are like started ones (test/support/forks.py)."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from forks import Fork
from processes import ROOT

SHOWN = (
    "import os, sys; print(sys.argv, __name__, os.getcwd(), os.environ['OWN'], os.getsid(0) == os.getpid(), flush=True)"
)


def ended(directory: Path, *words: str, forked: bool) -> tuple[int, str]:
    """(exit code, output) of a Python program."""
    environment = {**os.environ, 'PYTHONPATH': str(ROOT), 'OWN': 'mine'}
    with open(directory / 'said', 'w+') as said:
        if forked:
            code = Fork(words, cwd=directory, env=environment, output=said.fileno()).wait(60.0)
        else:
            command = [sys.executable, *words]
            done = subprocess.run(
                command, cwd=directory, env=environment, stdout=said, stderr=said, start_new_session=True, check=False
            )
            code = done.returncode
        said.seek(0)
        return code, said.read()


@pytest.mark.parametrize(
    'words',
    [
        ('-c', SHOWN, 'a', '-b'),
        ('-c', 'import sys; sys.exit(3)'),
        ('-c', 'import sys; sys.exit("a sentence")'),
        ('-c', 'import atexit; atexit.register(print, "the end"); print("first")'),
        (
            '-c',
            'import threading, time; threading.Thread(target=lambda: (time.sleep(0.1), print("waited for"))).start()',
        ),
        ('-c', 'import os, signal; os.kill(os.getpid(), signal.SIGKILL)'),
        ('-m', 'mbd_sim_ros.commands.main', 'rnu'),
    ],
)
def test_a_fork_says_and_returns_what_a_started_program_does(words: tuple[str, ...], tmp_path: Path) -> None:
    assert ended(tmp_path, *words, forked=True) == ended(tmp_path, *words, forked=False)


def test_a_program_that_fails_shows_its_traceback(tmp_path: Path) -> None:
    code, said = ended(tmp_path, '-c', 'raise ValueError(5)', forked=True)
    assert code == 1
    assert said.startswith('Traceback') and said.endswith('ValueError: 5\n')


def test_signals_reach_a_fork_and_its_end_is_told(tmp_path: Path) -> None:
    with open(tmp_path / 'said', 'w') as said:
        fork = Fork(('-c', 'import time; time.sleep(60)'), cwd=tmp_path, env=dict(os.environ), output=said.fileno())
    assert fork.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        fork.wait(0.05)
    fork.send_signal(signal.SIGTERM)
    assert fork.wait(10.0) == -signal.SIGTERM
    fork.kill()  # too late, and no error
