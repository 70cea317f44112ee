"""What is not in order is red, on a terminal only."""

from __future__ import annotations

import io
import os
import pty
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scalars import write_scalars
from terminals import written

from mbd_sim_ros.commands import table
from mbd_sim_ros.commands.colour import PLAIN, RED, is_wanted, painted


@pytest.mark.parametrize(
    ('text', 'red'),
    [
        (table([('verdict', 'suspect'), ('SUSPECT', 'the step is too long')]), ['suspect', 'SUSPECT']),
        (table([('verdict', 'ok'), ('start', 'equilibrium')]), []),
        (table([('verdict', 'okay'), ('plan', 'no')]), ['okay', 'no']),
        (
            'imu/wz  OUTSIDE: differs by 1\n3 of 7 channels outside tolerance at 3 instants',
            ['OUTSIDE', '3 of 7 channels outside tolerance'],
        ),
        ('7 channels within tolerance at 3 instants\n0 of 9 checks not met', []),
        ('the recordings differ: yaw rate 10 %', ['the recordings differ']),
        ('overshoot  0.3  FAIL\n2 of 9 checks not met\nNOT MET', ['FAIL', '2 of 9 checks not met', 'NOT MET']),
        ('topics that differ: imu', ['topics that differ']),
        ('limits of the norm are not kept', ['limits of the norm are not kept']),
        ('the words outside, failed and suspect in a sentence, FAILOVER, and a verdict ok', []),
    ],
)
def test_bad_words_are_red_and_nothing_else(text: str, red: list[str]) -> None:
    made = painted(text)
    assert made.replace(RED, '').replace(PLAIN, '') == text
    found = [part.partition(PLAIN)[0].strip() for part in made.split(RED)[1:]]
    assert found == red


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_only_a_terminal_has_colours(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ('NO_COLOR', 'TERM'):
        monkeypatch.delenv(name, raising=False)
    assert is_wanted(Terminal()) and not is_wanted(io.StringIO())
    monkeypatch.setenv('NO_COLOR', '')  # counts as not set
    assert is_wanted(Terminal())
    monkeypatch.setenv('NO_COLOR', '1')
    assert not is_wanted(Terminal())
    monkeypatch.delenv('NO_COLOR')
    monkeypatch.setenv('TERM', 'dumb')
    assert not is_wanted(Terminal())


def shown(*argv: str, **environment: str) -> bytes:
    """The output of a command on a terminal."""
    ours, theirs = pty.openpty()
    own = {key: value for key, value in os.environ.items() if key != 'NO_COLOR'}
    own |= {'TERM': 'xterm', 'PYTHONPATH': os.pathsep.join(sys.path)}
    subprocess.run(
        [sys.executable, '-m', 'mbd_sim_ros.commands.main', *argv],
        stdin=subprocess.DEVNULL, stdout=theirs, stderr=theirs, env=own | environment, timeout=60, check=False,
    )  # fmt: skip
    os.close(theirs)
    return written(ours)


def test_a_command_on_a_terminal(tmp_path: Path) -> None:
    t = np.arange(11) * 1_000_000
    a, b = (
        str(write_scalars(tmp_path / name, {'imu': (t, {'wz': factor * (1.0 + t * 1e-9)})}))
        for name, factor in (('a', 1.0), ('b', 1.1))
    )
    assert f'{RED}the recordings differ{PLAIN}: yaw rate'.encode() in shown('compare', b, a)
    for text in (shown('compare', b, a, NO_COLOR='1'), shown('compare', b, a, '--json'), shown('compare', a, a)):
        assert b'\x1b' not in text and (b'yaw rate' in text or b'"status"' in text or b'agree' in text)
