"""SIGINT and SIGTERM: noted at once by a thread, acted upon between kernels, obeyed in any case.

An exception raised by a signal handler surfaces wherever the main thread happens to be. Inside a callback from compiled code (the compiler
has some) it is lost or ends the process with a segmentation fault, and inside a recording it leaves half a file. So the handler raises
nothing there; the system writes the number of the signal into a pipe, and a thread that reads the pipe

- notes it: whoever has something to finish looks at `received()` or `event` between two kernels and holds the process meanwhile (`held`);
- ends the process with the sentence `interrupted while <doing>` when nobody holds it and it has not ended by itself after GRACE seconds,
  or when the holder has not let go after PATIENCE seconds;
- ends it at once when a second signal comes. Terminals, launch tools and wrappers deliver one Ctrl-C twice; what comes within
  SAME_GESTURE seconds is one.

Whoever is saying the sentence just then (`saying`) may finish it, for GRACE seconds at most.

Ended like this a process runs no more Python: a bag it was recording is finished by the recording process. Exit code: 128 + number.
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

EXIT = 128  # + number of the signal, as shells do
GRACE = 0.4  # s
PATIENCE = 15.0  # s
SAME_GESTURE = 0.25  # s
LOOK = 0.02  # s between looks once a signal came
# Where the main thread only waits for processes and files, an exception is safe and lets `finally` end the children.
WAITS = ('subprocess', 'selectors', 'mbd_sim_ros.lab', 'mbd_sim_ros.commands')

event = threading.Event()  # set by the first signal
doing = ''  # what the sentence says was interrupted
_say: Callable[[str], None] | None = None
_code: int | None = None
_number = 0
_held = 0
_said = threading.Lock()
_quiet = threading.Event()  # but while somebody claims the sentence and says it
_quiet.set()
_watcher: _Watcher | None = None
_scratch: set[Path] = set()
dependents: set[int] = set()  # processes that are killed when this one is ended: they have nothing to finish, and may be deaf to a signal


def received() -> int:
    """Number of the signal that came, or 0."""
    return _number


def now(what: str) -> None:
    """Set the activity that a signal interrupts: the end of the sentence `interrupted while ...`."""
    global doing
    doing = what


def sentence() -> str:
    """Sentence for an interruption of which nothing more is known."""
    return f'interrupted while {doing}' if doing else 'interrupted'


def check() -> None:
    """Raise KeyboardInterrupt(sentence, number) if a signal came. For places between kernels where nothing has to be finished."""
    if _number:
        raise KeyboardInterrupt(sentence(), _number)


def claim() -> bool:
    """True for the caller that shall print the sentence: it is printed once."""
    return _said.acquire(blocking=False)


@contextmanager
def saying() -> Iterator[bool]:
    """Claim the sentence and say it inside, if that is so: until then the process is not ended, GRACE seconds at most."""
    _quiet.clear()
    try:
        yield claim()
    finally:
        _quiet.set()


@contextmanager
def held() -> Iterator[None]:
    """Inside, a signal is only noted: the caller looks for it and ends in order."""
    global _held
    _held += 1
    try:
        yield
    finally:
        _held -= 1


@contextmanager
def scratch(prefix: str) -> Iterator[Path]:
    """A temporary directory that is removed however the process is interrupted."""
    with tempfile.TemporaryDirectory(prefix=prefix) as name:
        _scratch.add(Path(name))
        try:
            yield Path(name)
        finally:
            _scratch.discard(Path(name))


def install(say: Callable[[str], None], code: int | None = None) -> None:
    """Take SIGINT and SIGTERM over for the life of this process (main thread only).

    say: how the sentence reaches the user. code: the exit code after a first signal, instead of that of shells.
    """
    global _watcher, _say, _code
    _say, _code = say, code
    if _watcher is None:
        _watcher = _Watcher()
    let_go()


def leave() -> None:
    """The program has done its work: what is left is the end of the interpreter, which must not be taken for an interruption."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)  # the interpreter takes every other handler back, and then the signal kills


def end(code: int) -> None:
    """End the process without taking the interpreter apart, which takes up to a second once much has been compiled; what was registered
    for the end is done. It comes back where somebody else has to be waited for, or something cannot be written."""
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
    """The same for a block; within the life of `install` it is the whole work of the program, and says how the sentence is said."""
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
    """The thread, its pipe and the handlers it replaced."""

    def __init__(self) -> None:
        self._read, self._write = os.pipe()
        os.set_blocking(self._write, False)
        self._before = {number: signal.signal(number, _handle) for number in SIGNALS}
        self._wakeup = signal.set_wakeup_fd(self._write, warn_on_full_buffer=False)
        self._closed = False
        self._thread = threading.Thread(target=self._run, name='signals', daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Give the signals back."""
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
    global _number
    _number = number
    event.set()
    interruption.request()
    if not _held:
        interruption.note(KeyboardInterrupt(sentence(), number))  # the compiler can be left between two passes


def _handle(number: int, frame: FrameType | None) -> None:
    """The Python side of a signal: raises only in work that has begun, where the main thread waits and nobody holds it."""
    module = frame.f_globals.get('__name__', '') if frame is not None else ''
    if doing and not _held and module.startswith(WAITS):
        raise KeyboardInterrupt(sentence(), number)


def _end(code: int) -> None:
    """End the process from the watching thread."""
    if claim():
        with suppress(OSError, ValueError):  # nobody reads it
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
    """Write a line, past whatever buffers hold; a progress bar on the line is wiped."""
    bar = '\r\033[K' if os.isatty(descriptor) else ''
    os.write(descriptor, f'{bar}{text}\n'.encode())
