"""Ctrl-C while kernels are compiled: one sentence, exit code 130, soon, and a cache that is whole
(solver.compiled.interruption)."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numba
import pytest

from solver.compiled import interruption
from solver.compiled.kernel import kernel
from solver.disk import Store

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason='about compiled code')
SOON = 3.0  # s
COMMANDS = {'compile': ['compile', 'slider_crank'], 'run': ['run', 'slider_crank', '--duration', '0.1', '--no-record']}


def compiling(command: list[str], cache: Path) -> subprocess.Popen[str]:
    """`mbd` in the middle of compiling: it has kept five kernels."""
    environment = {**os.environ, 'MBD_CACHE_DIR': str(cache), 'PYTHONPATH': str(Path(__file__).parents[2])}
    run = [sys.executable, '-m', 'mbd_sim_ros.commands.main', *command]
    process = subprocess.Popen(run, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    end = time.monotonic() + 60.0
    while len(kept(cache)) < 5:
        assert process.poll() is None and time.monotonic() < end
        time.sleep(0.02)
    return process


def kept(cache: Path) -> list[Path]:
    return list(cache.glob('kernels/[!.]*'))


@pytest.mark.realtime
@pytest.mark.parametrize(
    ('command', 'signals'),
    [
        ('compile', [signal.SIGINT]),
        ('run', [signal.SIGINT]),
        ('compile', [signal.SIGTERM]),
        ('compile', [signal.SIGINT, signal.SIGINT]),
    ],
)
def test_a_signal_while_compiling_ends_the_command(command: str, signals: list[signal.Signals], tmp_path: Path) -> None:
    process = compiling(COMMANDS[command], tmp_path)
    begin = time.monotonic()
    for number in signals:
        process.send_signal(number)
        time.sleep(0.1)
    out, err = process.communicate(timeout=60.0)
    assert time.monotonic() - begin < SOON
    assert (process.returncode, out) == (128 + signals[0], '')
    assert re.fullmatch(r'mbd: interrupted while [\w ]+\n', err), err
    assert list(tmp_path.rglob('*.part*')) == []
    for path in kept(tmp_path):
        assert Store(path.parent).read(path.name, bytes.fromhex(path.name.rpartition('-')[2])) is not None


@pytest.fixture(autouse=True)
def forgotten() -> object:
    """No test leaves an interruption to the next."""
    yield interruption.forget()
    interruption.forget()


def test_inside_it_waits_for_the_end_of_the_pass_and_reaches_every_thread() -> None:
    one = kernel(lambda x: x + 1)
    interruption.enter()
    interruption.note(KeyboardInterrupt('later', 2))
    with pytest.raises(KeyboardInterrupt, match='later'):
        one(1)
    caught: list[BaseException] = []

    def compile_another() -> None:
        try:
            kernel(lambda x: x + 2)(1)
        except KeyboardInterrupt as interrupt:
            caught.append(interrupt)

    thread = threading.Thread(target=compile_another)
    thread.start()
    thread.join(60.0)
    assert [error.args for error in caught] == [('later', 2)]
    with pytest.raises(KeyboardInterrupt, match='later'):
        interruption.leave()
    interruption.forget()
    assert one(1) == 2
