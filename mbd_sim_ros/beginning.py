"""The first thing that a program of ours does: SIGINT and SIGTERM wait until `interrupts.install` can take them.

Its imports take a tenth of a second, several times as long on a busy machine; until then Python answers a signal with
the traceback of whatever it is importing.
"""

from __future__ import annotations

import os.path
import signal
import sys
from itertools import pairwise

SIGNALS = (signal.SIGINT, signal.SIGTERM)

_held = False


def is_program(name: str) -> bool:
    """True where this process was started as the console script `name`."""
    return os.path.basename(sys.argv[0] if sys.argv else '') == name


def hold(*programs: str) -> None:
    """Have signals wait if this process was started as one of these console scripts, or as `python -m` one of these
    modules."""
    global _held
    if any(map(is_program, programs)) or any(
        before == '-m' and after in programs for before, after in pairwise(sys.orig_argv)
    ):
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        _held = True


def let_go() -> None:
    """Have signals come, those that have waited at once."""
    global _held
    if _held:
        _held = False
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)
