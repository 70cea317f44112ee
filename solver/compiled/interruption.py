"""Signals and the compiler: what interrupts numba waits until it is between two of its passes.

An exception that a signal handler raises anywhere in numba may meet a destructor or a callback from LLVM, where Python
prints it and goes on: the signal is lost, minutes of compiling are not. So whoever watches the signals leaves the
exception here (`note`), and it is raised by the next `check`, which solver.compiled.kernel makes before every kernel
and every pass. A run that is held by somebody who looks for signals himself is only asked to come back between two
steps (`request`).
"""

from __future__ import annotations

import threading

_pending: BaseException | None = None
_requested = False
_depth = 0  # of the main thread in the compiler


def note(exception: BaseException) -> None:
    """Have the next check raise this exception; from any thread."""
    global _pending
    _pending = exception


def request() -> None:
    """Ask whoever takes many steps in a call to return; from any thread."""
    global _requested
    _requested = True


def requested() -> bool:
    """True where somebody asked since the last forget()."""
    return _requested


def pending() -> bool:
    """True where there was an interruption since the last forget()."""
    return _pending is not None


def forget() -> None:
    """Forget an interruption: the interrupted command has ended, another one may begin."""
    global _pending, _requested
    _pending, _requested = None, False


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
