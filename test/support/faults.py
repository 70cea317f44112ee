"""Faults at random but repeatable times, against processes of this package."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from mbd_sim_ros.bags import reader as bag

ROOT = Path(__file__).parents[2]
COUNT = int(os.environ.get('MBD_FAULTS', '0'))  # trials of each test; 0: the few that `make test` makes
SEED = int(os.environ.get('MBD_FAULTS_SEED', '1'))
UNWANTED = re.compile(r'Traceback|Exception ignored|Segmentation|core dumped|Fatal Python|terminate called')


def trials(few: int, usual: int | None = None) -> list[Any]:
    """Numbers of the trials to make; of the few the usual ones (all), the others where long tests run."""
    if COUNT:
        return list(range(COUNT))
    return [
        pytest.param(k, marks=pytest.mark.long if k >= (few if usual is None else usual) else ()) for k in range(few)
    ]


def times(name: str, trial: int) -> np.random.Generator:
    """Random numbers of one trial, the same in every run."""
    return np.random.default_rng([SEED, trial, *name.encode()])


class Ended(NamedTuple):
    """How a process ended."""

    code: int
    seconds: float  # since the (first) signal
    out: str
    err: str

    @property
    def lines(self) -> list[str]:
        """What it said on stderr, without progress bars and log lines of ROS."""
        text = re.sub(r'[^\n]*\r', '', self.err)
        lines = [line.removeprefix('\x1b[K').strip() for line in text.splitlines()]
        return [line for line in lines if line and not line.startswith('[')]


class Victim:
    """A process in a session of its own, its output in files."""

    def __init__(self, directory: Path, command: Sequence[object], **environment: str) -> None:
        directory.mkdir(parents=True, exist_ok=True)
        self.directory = directory
        self._out, self._err = open(directory / 'stdout', 'w+'), open(directory / 'stderr', 'w+')  # noqa: SIM115
        self.process = subprocess.Popen(
            [sys.executable, *map(str, command)],
            cwd=directory,
            env={**os.environ, 'PYTHONPATH': f'{ROOT}:{ROOT / "test" / "support"}', **environment},
            stdout=self._out,
            stderr=self._err,
            start_new_session=True,
        )

    @property
    def pid(self) -> int:
        return self.process.pid

    def said(self) -> str:
        """All it has said so far."""
        return (self.directory / 'stdout').read_text() + (self.directory / 'stderr').read_text()

    def ready(self, text: str = '', seconds: float = 120.0) -> bool:
        """Wait until it has taken the signals over (and said `text`); whether it still runs."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self.process.poll() is not None:
                return False
            status = Path(f'/proc/{self.pid}/status').read_text()
            caught = int(status.partition('SigCgt:')[2].split()[0], 16)
            if caught >> (signal.SIGTERM - 1) & 1 and text in self.said():
                return True
            time.sleep(0.002)
        raise AssertionError(f'not ready: {self.said()}')

    def strike(self, number: int, *, group: bool = False) -> float:
        """Send a signal; the clock reading."""
        clock = time.monotonic()
        with suppress(ProcessLookupError):
            (os.killpg if group else os.kill)(self.pid, number)
        return clock

    def end(self, since: float, seconds: float = 30.0) -> Ended:
        """Wait for the end."""
        try:
            code = self.process.wait(seconds)
        except subprocess.TimeoutExpired:
            self.kill()
            raise AssertionError(f'still there after {seconds:g} s: {self.said()}') from None
        took = time.monotonic() - since
        self._out.close()
        self._err.close()
        return Ended(code, took, (self.directory / 'stdout').read_text(), (self.directory / 'stderr').read_text())

    def kill(self) -> None:
        """End it, whatever it does."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait(10.0)
        self._out.close()
        self._err.close()


def finished(directory: Path, seconds: float = 5.0) -> bag.Run | None:
    """The recording in a directory once its own process has finished it; None when none was begun."""
    end = time.monotonic() + seconds
    while directory.is_dir() and not (directory / 'metadata.yaml').exists():
        assert time.monotonic() < end, f'{directory} was not finished: {sorted(p.name for p in directory.iterdir())}'
        time.sleep(0.02)
    if not directory.is_dir():
        return None
    try:
        return bag.read(directory)
    except bag.BagError as error:
        assert 'holds no messages' in str(error)
        return None


def mbd(*words: object) -> list[object]:
    """The command line of a command."""
    return ['-m', 'mbd_sim_ros.commands.main', *words]


def simulator(script: str, *arguments: object, **parameters: object) -> list[object]:
    """The command line of the node with a stand-in simulation (processes.SCRIPT)."""
    import json

    values = {'scene': 'synthetic', **parameters}
    given = [text for name, value in values.items() for text in ('-p', f'{name}:={json.dumps(value)}')]
    return ['-c', script, *arguments, '--ros-args', *given]
