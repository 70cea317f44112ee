"""Signals and the compiler: what interrupts numba waits until it is between two of its passes.

An exception that a signal handler raises anywhere in numba may meet a destructor or a callback from LLVM, where Python prints it and
goes on: the signal is lost, minutes of compiling are not. So a handler gives its exception to `interrupt`. Outside of the compiler it
is raised at once; inside it waits for the next `check`, which solver.compiled.kernel makes before every kernel and every pass.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

WAIT = 1.0  # s; the longest pass takes two

_pending: BaseException | None = None
_depth = 0  # of the main thread in the compiler: the only thread that runs signal handlers


def interrupt(exception: BaseException, give_up: Callable[[], None] | None = None) -> None:
    """Raise this exception, at once or, inside the compiler, at its next check. For signal handlers.

    give_up: called by another thread when that check has not come within WAIT seconds.
    """
    global _pending
    _pending = exception
    if _depth == 0:
        raise exception
    if give_up is not None:
        timer = threading.Timer(WAIT, lambda: give_up() if _depth else None)
        timer.daemon = True
        timer.start()


def pending() -> bool:
    """Whether there was an interruption since the last forget()."""
    return _pending is not None


def forget() -> None:
    """What was interrupted has ended; another command may begin."""
    global _pending
    _pending = None


def check() -> None:
    """Raise what is pending, in whichever thread compiles: one that goes on compiling would keep the process alive."""
    if _pending is not None:
        raise type(_pending)(*_pending.args)


def enter() -> None:
    """This thread goes into the compiler (or deeper into it)."""
    global _depth
    if threading.current_thread() is threading.main_thread():
        _depth += 1


def leave() -> None:
    """And comes out of it."""
    global _depth
    if threading.current_thread() is threading.main_thread():
        _depth -= 1
        if _depth == 0:
            check()
