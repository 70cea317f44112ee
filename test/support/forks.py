"""Python programs as forks of a process that has imported what all of them do.

A node that starts takes two seconds of a processor for imports and is then tested for one. Forked, it has them done;
everything else is that of a process of its own: environment, directory, session, signals, threads, the end. What a
start itself does is tested with processes that start (test/faults, test_packaging, toy_kernels).

The server has one thread and nothing open but its socket. Each request makes a keeper, which forks the program, tells
its number, waits for it and tells how it ended.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

SUPPORT = Path(__file__).parent
# Not rclpy: its libraries start threads, and a process with threads cannot be forked.
IMPORTED = (
    'solver.simulation',
    'solver.files.scene',
    'solver.levels.road_wheel',
    'mbd_sim_ros.bags.recorder',
    'mbd_sim_ros.node.loop',
)
LARGEST = 1 << 20  # bytes of a request

_server: tuple[subprocess.Popen[bytes], socket.socket] | None = None


class Fork:
    """A program that runs, with what tests use of subprocess.Popen. words: what follows `python`: -m MODULE, -c PROGRAM
    or a file, and arguments; output: a descriptor for all it writes."""

    def __init__(self, words: Sequence[str], *, cwd: Path, env: Mapping[str, str], output: int) -> None:
        self.returncode: int | None = None
        self._words = list(words)
        told, self._told = os.pipe(), b''
        self._end = told[0]
        request = json.dumps({'words': self._words, 'cwd': str(cwd), 'env': dict(env)}).encode()
        assert len(request) < LARGEST
        socket.send_fds(_connected(), [request], [output, told[1]])
        os.close(told[1])
        while b'\n' not in self._told:
            self._read()
        self.pid = int(self._told.split(b'\n')[0])

    def _read(self) -> None:
        part = os.read(self._end, 64)
        assert part, 'the server of forks has ended'
        self._told += part

    def poll(self) -> int | None:
        """How it ended, or None."""
        if self.returncode is None and select.select([self._end], [], [], 0.0)[0]:
            while self._told.count(b'\n') < 2:
                self._read()
            self.returncode = int(self._told.split(b'\n')[1])
            os.close(self._end)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end."""
        end = None if timeout is None else time.monotonic() + timeout
        while self.poll() is None:
            left = None if end is None else end - time.monotonic()
            if left is not None and left <= 0.0:
                assert timeout is not None
                raise subprocess.TimeoutExpired(self._words, timeout)
            select.select([self._end], [], [], left)
        assert self.returncode is not None
        return self.returncode

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)


def _connected() -> socket.socket:
    """The socket of the server, which is started by the first who asks."""
    global _server
    if _server is None:
        mine, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        for option in (socket.SO_SNDBUF, socket.SO_RCVBUF):
            mine.setsockopt(socket.SOL_SOCKET, option, 2 * LARGEST)
        environment = {**os.environ, 'PYTHONPATH': f'{SUPPORT.parents[1]}:{SUPPORT}'}
        command = [sys.executable, str(Path(__file__)), str(its.fileno())]
        _server = subprocess.Popen(command, env=environment, pass_fds=[its.fileno()], stdin=subprocess.DEVNULL), mine
        its.close()
        atexit.register(mine.close)  # which is how it learns that nothing more comes
    return _server[1]


def _serve(requests: socket.socket) -> None:
    for name in IMPORTED:
        importlib.import_module(name)
    assert len(os.listdir('/proc/self/task')) == 1, 'something imported has started a thread'
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # keepers
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal: its end is that of the tests
    while True:
        request, given, _, _ = socket.recv_fds(requests, LARGEST, 2)
        if not request:
            return
        if os.fork() == 0:
            requests.close()
            _keep(json.loads(request), *given)
        for descriptor in given:
            os.close(descriptor)


def _keep(request: dict[str, Any], output: int, told: int) -> None:
    """Run the program in a process of its own and tell its number and its end."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    number = os.fork()
    if number == 0:
        os.close(told)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os._exit(_run(request, output))
    os.close(output)
    os.write(told, f'{number}\n'.encode())
    status = os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])
    with contextlib.suppress(OSError):  # nobody waits for it any more
        os.write(told, f'{status}\n'.encode())
    os._exit(0)


def _run(request: dict[str, Any], output: int) -> int:
    """Be the program; its exit code."""
    os.setsid()
    os.chdir(request['cwd'])
    for descriptor in (1, 2):
        os.dup2(output, descriptor)
    os.close(output)
    os.environ.clear()
    os.environ.update(request['env'])
    time.tzset()
    more = [path for path in os.environ.get('PYTHONPATH', '').split(':') if path and path not in sys.path]
    first, *rest = request['words']
    sys.path[:] = [
        path
        for path in [*more, *sys.path]
        if path != str(SUPPORT) or path in os.environ.get('PYTHONPATH', '').split(':')
    ]
    try:
        _execute(first, rest)
        code = 0
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
        if not isinstance(end.code, int | None):
            print(end.code, file=sys.stderr)
    except BaseException:
        traceback.print_exc()
        code = 1
    threading._shutdown()  # type: ignore[attr-defined]  # waits for threads, as the interpreter does
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    return code & 0xFF


def _execute(first: str, rest: list[str]) -> None:
    import runpy

    if first == '-m':
        sys.argv = rest
        sys.modules.pop(rest[0], None)  # else runpy warns that it is there
        runpy.run_module(rest[0], run_name='__main__', alter_sys=True)
    elif first == '-c':
        sys.argv = ['-c', *rest[1:]]
        exec(compile(rest[0], '<string>', 'exec'), {'__name__': '__main__'})
    else:
        sys.argv = [first, *rest]
        runpy.run_path(first, run_name='__main__')


if __name__ == '__main__':
    _serve(socket.socket(fileno=int(sys.argv[1])))
    os._exit(0)
