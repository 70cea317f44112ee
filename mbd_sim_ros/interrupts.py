"""SIGINT and SIGTERM: noted at once by a thread, acted upon between kernels, obeyed in any case.

An exception that a signal handler raises appears wherever the main thread happens to be. Inside a callback from
compiled code (the compiler has some) it is lost, or ends the process with a segmentation fault; inside a recording it
leaves half a file. So the handler raises nothing there. Instead the system writes the number of the signal into a pipe,
and a thread, the watcher, reads the pipe.

- The watcher notes the signal. Code that has something to finish holds the process (`held`), and looks at `received()`
or
  `event` between two kernels.
- It ends the process, with the sentence `interrupted while <doing>`, if nobody holds it and it has not ended by itself
after
  GRACE, or if it is still held after PATIENCE.
- It ends the process at once when a second signal comes. Terminals, launch tools and wrappers deliver one Ctrl-C twice,
so
  signals within SAME_GESTURE count as one.

If the main thread is printing the sentence just then (`saying`), the watcher lets it finish, for GRACE at most.

A process that the watcher ends runs no more Python; a bag that it was recording is finished by the recording process.
The exit code is 128 + number of the signal.
"""

from __future__ import annotations

import atexit
import os
import select
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from mbd_sim_ros.beginning import SIGNALS, let_go
from solver.compiled import interruption

EXIT = 128  # exit code minus the number of the signal, as of shells
GRACE = 0.4  # time [s] for a process to end by itself after a signal; ten times as much feels like a hang
PATIENCE = 15.0  # time [s] for a process that is held to finish its work after a signal
# time [s] within which several signals count as one; ten times as much would ignore a second Ctrl-C
SAME_GESTURE = 0.25
LOOK = 0.02  # time [s] between two looks of the watcher after a signal
# Modules in which the main thread only waits for processes and files: there an exception is safe, and `finally` ends
# children.
WAITS = ('subprocess', 'selectors', 'mbd_sim_ros.lab', 'mbd_sim_ros.commands')

event = threading.Event()  # set by the first signal
doing = ''  # activity in the sentence, see now()
command = ''  # of this process, as it was typed, for what it writes
_say: Callable[[str], None] | None = None  # prints the sentence, see install()
_code: int | None = None  # exit code, see install()
_number = 0  # number of the first signal, 0 before it
_held = 0  # number of held() blocks that are open
_said = threading.Lock()  # locked by the thread that prints the sentence, see claim()
_quiet = threading.Event()  # cleared while the main thread prints the sentence, see saying()
_quiet.set()
_watcher: _Watcher | None = None
_scratch: set[Path] = set()  # temporary directories to remove
dependents: set[int] = set()  # child processes to kill at the end: they have nothing to finish, and may ignore a signal


def received() -> int:
    """Number of the signal that has come, 0 before."""
    return _number


def now(what: str) -> None:
    """Set the present activity, e.g. 'recording bags/first', for the sentence `interrupted while ...`."""
    global doing
    doing = what


def sentence() -> str:
    """The sentence about an interruption, with the present activity."""
    return f'interrupted while {doing}' if doing else 'interrupted'


def check() -> None:
    """Raise KeyboardInterrupt(sentence, number) if a signal has come. For places between kernels with nothing to
    finish."""
    if _number:
        raise KeyboardInterrupt(sentence(), _number)


def claim() -> bool:
    """True for the first caller only: that caller prints the sentence, which is printed once."""
    return _said.acquire(blocking=False)


@contextmanager
def saying() -> Iterator[bool]:
    """Block in which the main thread prints the sentence, if the value is True (see claim). The watcher waits for its
    end."""
    _quiet.clear()
    try:
        yield claim()
    finally:
        _quiet.set()


@contextmanager
def held() -> Iterator[None]:
    """Block in which a signal is only noted: the caller looks for it and ends in good order."""
    global _held
    _held += 1
    try:
        yield
    finally:
        _held -= 1


@contextmanager
def scratch(prefix: str) -> Iterator[Path]:
    """A temporary directory that is removed at the end, also if the process is interrupted."""
    with tempfile.TemporaryDirectory(prefix=prefix) as name:
        _scratch.add(Path(name))
        try:
            yield Path(name)
        finally:
            _scratch.discard(Path(name))


def install(say: Callable[[str], None], code: int | None = None) -> None:
    """Handle SIGINT and SIGTERM for the rest of this process; to be called by the main thread.

    say: prints the sentence. code: exit code after a first signal; None: EXIT + number.
    """
    global _watcher, _say, _code
    _say, _code = say, code
    if _watcher is None:
        _watcher = _Watcher()
    let_go()


def leave() -> None:
    """Ignore signals from now on: the work is done, and the end of the interpreter must not count as interrupted."""
    for number in SIGNALS:
        # the interpreter takes every other handler back, and then the signal kills
        signal.signal(number, signal.SIG_IGN)


def end(code: int) -> None:
    """End the process at once, after the functions registered with atexit.

    The regular end of the interpreter takes up to a second once much has been compiled. Returns without ending the
    process if a thread has to be waited for, or if output cannot be written.
    """
    others = (thread for thread in threading.enumerate() if thread is not threading.main_thread())
    if any(not thread.daemon for thread in others):
        return
    atexit._run_exitfuncs()
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except (OSError, ValueError, AttributeError):
        return
    os._exit(code)


@contextmanager
def watched(say: Callable[[str], None]) -> Iterator[None]:
    """Block in which SIGINT and SIGTERM are handled as after install(say).

    After an install() the block is the whole work of the program: `say` prints the sentence in it, and leave() is
    called at its end.
    """
    global _watcher, _say, _number
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    if _watcher is not None:
        before, _say = _say, say
        try:
            yield
        finally:
            _say = before
            leave()
        return
    install(say)
    try:
        yield
    finally:
        assert _watcher is not None
        _watcher.close()
        _watcher, _say, _number = None, None, 0
        interruption.forget()
        event.clear()
        if _said.locked():
            _said.release()


class _Watcher:
    """The thread that watches signals, its pipe, and the handlers that it replaced."""

    def __init__(self) -> None:
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)
        self._before = {number: signal.signal(number, _handle) for number in SIGNALS}
        self._wakeup = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        self._closed = False
        self._thread = threading.Thread(target=self._run, name='signals', daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and restore the handlers that were there before."""
        signal.set_wakeup_fd(self._wakeup)
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._closed = True
        os.write(self._write, b'\0')
        self._thread.join()
        os.close(self._read)
        os.close(self._write)

    def _run(self) -> None:
        first = idle = 0.0
        while True:
            arrived = bool(select.select([self._read], [], [], LOOK if _number else None)[0])
            numbers = [number for number in os.read(self._read, 64) if number in SIGNALS] if arrived else []
            if self._closed:
                return
            clock = time.monotonic()
            if numbers and not _number:
                first = idle = clock
                _note(numbers[0])
            elif numbers and clock - first > SAME_GESTURE:
                _end(EXIT + numbers[0])
            if _held:
                idle = clock
            if _number and (clock - idle > GRACE or clock - first > PATIENCE):
                _end(EXIT + _number if _code is None else _code)


def _note(number: int) -> None:
    """Note the first signal for the main thread and for compiled code."""
    global _number
    _number = number
    event.set()
    interruption.request()
    if not _held:
        interruption.note(KeyboardInterrupt(sentence(), number))  # the compiler raises it between two of its passes


def _handle(number: int, frame: FrameType | None) -> None:
    """Handler of a signal. It raises only where the main thread waits (WAITS), the work has begun, and nobody holds
    it."""
    module = frame.f_globals.get('__name__', '') if frame is not None else ''
    if doing and not _held and module.startswith(WAITS):
        raise KeyboardInterrupt(sentence(), number)


def _end(code: int) -> None:
    """End the process from the watcher: print the sentence, kill the dependents, remove temporary directories."""
    if claim():
        with suppress(OSError, ValueError):  # the terminal or pipe may be closed
            if _say is not None:
                _say(sentence())
    else:
        _quiet.wait(GRACE)
    for process in tuple(dependents):
        with suppress(OSError):
            os.kill(process, signal.SIGKILL)
    for directory in _scratch:
        shutil.rmtree(directory, ignore_errors=True)
    os._exit(code)


def write(descriptor: int, text: str) -> None:
    """Write a line to a file descriptor, without buffers; a progress bar on the line is wiped."""
    bar = '\r\033[K' if os.isatty(descriptor) else ''
    os.write(descriptor, f'{bar}{text}\n'.encode())
