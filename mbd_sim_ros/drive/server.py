"""Pages of this machine: one web page, and a socket for each of those that look.

Nothing that a page does makes the simulation wait. The newest picture replaces the one before; a page that has not
taken WINDOW of them gets none until it has, and how many it missed is counted. A page that says more than it should is
read no faster than one message in READ seconds; what it said is still read when it has gone, and holds nothing. One
page is at the wheel; when it goes, says nothing, or takes no pictures, all is let go.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import json
import logging
import os
import secrets
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from http import HTTPStatus
from typing import Any, Protocol
from urllib.parse import parse_qs

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from mbd_sim_ros.drive.hands import Held, held_of
from solver.errors import MbdError

MOST = 16  # pages at once; ten times as many would take the processor from the simulation
WINDOW = 4  # pictures that a page may owe: at 60 a second their age stays below 70 ms; ten times as many, half a second
BEHIND = 2.0  # s without taking a picture after which a page holds nothing; ten times as long, and the dead drive on
READ = 0.002  # s between two messages of a page, which sends 70 a second; ten times as much makes keys late
LONGEST = 2048  # bytes of a message of a page, which has 200; ten times as many are no harm yet
TOLD = 0.5  # s between two accounts of how it goes; ten times as much, and a page does not know who drives
PATIENCE = 5.0  # s for a page to ask for what it wants, and between signs of life; ten times as much keeps the dead
ELSEWHERE = 'give an address of this machine as --host'
ACTIONS = ('pause', 'resume', 'reset', 'shift')  # of the one at the wheel
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "connect-src 'self' {socket}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class Desk(Protocol):
    """Whatever is driven and looked at. hold(None): nobody is at the wheel. ground: the road around as JSON, the same
    object as before where nothing has changed; '' for a plane."""

    def page(self) -> str: ...
    def hold(self, held: Held | None) -> None: ...
    def act(self, action: str, value: int) -> None: ...
    def status(self) -> dict[str, Any]: ...
    def ground(self) -> str: ...


class _Page:
    """One page that looks. sent: number of the picture that was sent last; owed: of those that it has not taken, and
    when they were sent (time.monotonic())."""

    def __init__(self, connection: ServerConnection) -> None:
        self.connection = connection
        self.wake = asyncio.Event()
        self.sent = self.dropped = 0
        self.owed: deque[tuple[int, float]] = deque()
        self.ground = ''
        self.news = True


class Server:
    """Serves a desk on a thread of its own; the port is taken at once.

    look: pages may only look; asked: they have to ask for the wheel. address: of the page, with its token. Raises
    MbdError where the port cannot be had.
    """

    def __init__(self, *, host: str = '127.0.0.1', port: int = 0, look: bool = False, asked: bool = False) -> None:
        self.look, self._asked = look, asked
        self.desk: Desk
        self.token = secrets.token_urlsafe(16)
        self._socket = _bound(host, port)
        self.port = int(self._socket.getsockname()[1])
        self._loopback = _is_loopback(self._socket.getsockname()[0])
        name = host if self._loopback else socket.gethostname() if _is_any(host) else host
        self._name = f'[{name}]' if ':' in name else name
        self.address = f'http://{self._name}:{self.port}/?token={self.token}'
        self.opened = self.refused = self.dropped = self.unread = 0
        self._pages: dict[ServerConnection, _Page] = {}
        self._wheel: _Page | None = None
        self._picture = (0, b'')  # number and bytes of the newest one
        self._heard = 0.0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ready, self._end = threading.Event(), asyncio.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), name='pages', daemon=True)

    @property
    def open_to_others(self) -> bool:
        """True where other machines reach the page."""
        return not self._loopback

    @property
    def pages(self) -> int:
        """Number of pages that look now."""
        return len(self._pages)

    def start(self, desk: Desk) -> None:
        """Start the thread; returns when pages can come."""
        self.desk = desk
        self._thread.start()
        self._ready.wait()

    def close(self) -> None:
        """Say goodbye to all pages, and end the thread."""
        if self._loop is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._end.set)
            self._thread.join()
        self._socket.close()

    def counts(self) -> dict[str, int]:
        """Numbers of what came and went."""
        return {
            'pages': self.opened, 'refused': self.refused, 'dropped_pictures': self.dropped,
            'unread_messages': self.unread,
        }  # fmt: skip

    def show(self, picture: bytes) -> None:
        """Show a picture, the newest one; from any thread, which waits for nothing."""
        self._picture = (self._picture[0] + 1, picture)
        self._call(self._wake)

    def tell(self) -> None:
        """Tell all pages soon how it goes; from any thread."""
        self._call(self._announce)

    def _call(self, action: Callable[[], None]) -> None:
        with contextlib.suppress(RuntimeError):  # it has ended
            if self._loop is not None:
                self._loop.call_soon_threadsafe(action)

    # -- on the thread of the server ----------------------------------------------------------------------------------

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        quiet = logging.getLogger('mbd_sim_ros.drive')
        quiet.addHandler(logging.NullHandler())
        quiet.propagate = False
        async with serve(
            self._attend, sock=self._socket, process_request=self._answer, compression=None, max_size=LONGEST,
            max_queue=4, open_timeout=PATIENCE, ping_interval=PATIENCE, ping_timeout=PATIENCE, close_timeout=1.0,
            server_header=None, logger=quiet,
        ):  # fmt: skip
            watch = asyncio.create_task(self._tell_regularly())
            self._ready.set()
            await self._end.wait()
            watch.cancel()
        self._loop = None

    def _wake(self) -> None:
        for page in self._pages.values():
            page.wake.set()

    def _announce(self) -> None:
        for page in self._pages.values():
            page.news = True
            page.wake.set()

    async def _tell_regularly(self) -> None:
        while True:
            await asyncio.sleep(TOLD)
            self._announce()

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request: the page, a refusal, or None for a socket."""
        path, _, query = request.path.partition('?')
        host, origin = (', '.join(request.headers.get_all(name)) for name in ('Host', 'Origin'))
        if self._loopback and not _is_loopback(_name_in(host)):
            return self._refuse(HTTPStatus.FORBIDDEN, f'the host {host!r} is not this machine')
        if path not in ('/', '/socket'):
            return self._refuse(HTTPStatus.NOT_FOUND, 'there is no such page')
        given = parse_qs(query).get('token', [''])[0]
        if not secrets.compare_digest(given.encode(), self.token.encode()):
            return self._refuse(
                HTTPStatus.FORBIDDEN, 'the token is missing or another one: open the address that mbd drive printed'
            )
        if path == '/':
            return _response(
                HTTPStatus.OK, self.desk.page(), 'text/html; charset=utf-8', POLICY.format(socket=f'ws://{host}')
            )
        if origin != f'http://{host}':
            return self._refuse(HTTPStatus.FORBIDDEN, f'the origin {origin!r} is another page')
        if len(self._pages) >= MOST:
            return self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, f'{MOST} pages look already: close one')
        return None

    def _refuse(self, status: HTTPStatus, sentence: str) -> Response:
        self.refused += 1
        return _response(status, sentence + '\n', 'text/plain; charset=utf-8')

    async def _attend(self, connection: ServerConnection) -> None:
        page = self._pages[connection] = _Page(connection)
        self.opened += 1
        if self._wheel is None and not self.look and not self._asked:
            self._wheel = page
        self._announce()
        sending = asyncio.create_task(self._send(page))
        try:
            while True:
                self._read(page, await connection.recv())
                await asyncio.sleep(READ)
        except ConnectionClosed:
            pass
        finally:
            sending.cancel()
            del self._pages[connection]
            if self._wheel is page:
                self._leave()
            self._announce()

    def _leave(self) -> None:
        """Nobody is at the wheel."""
        self._wheel = None
        self.desk.hold(None)

    async def _send(self, page: _Page) -> None:
        with contextlib.suppress(ConnectionClosed):
            while True:
                await page.wake.wait()
                page.wake.clear()
                if page.news:
                    page.news = False
                    await page.connection.send(json.dumps(self._account(page)))
                ground = self.desk.ground()
                if ground is not page.ground:
                    page.ground = ground
                    await page.connection.send(ground)
                number, picture = self._picture
                if number > page.sent and len(page.owed) < WINDOW:
                    missed = number - page.sent - 1 if page.sent else 0
                    page.dropped += missed
                    self.dropped += missed
                    page.sent = number
                    page.owed.append((number, time.monotonic()))
                    await page.connection.send(number.to_bytes(8, 'little') + picture)

    def _account(self, page: _Page) -> dict[str, Any]:
        mine = page is self._wheel
        return {
            **self.desk.status(),
            'driving': mine,
            'taken': self._wheel is not None,
            'look': self.look,
            'pages': len(self._pages),
            'dropped': page.dropped,
        }

    def _read(self, page: _Page, text: str | bytes) -> None:
        """Take a message of a page; what cannot be understood is counted."""
        try:
            said = json.loads(text)
            if not isinstance(said, dict):
                raise ValueError('must be an object')
            if isinstance(seen := said.get('seen'), int):
                while page.owed and page.owed[0][0] <= seen:
                    page.owed.popleft()
                page.wake.set()
            action = said.get('do')
            if action == 'take' and not self.look:
                self._wheel = page
                self._announce()
            if page is not self._wheel:
                return
            if action == 'leave':
                self._leave()
                self._announce()
            elif action in ACTIONS:
                self.desk.act(action, 1 if said.get('by', 1) == 1 else -1)
                self._announce()
            elif action is None:
                held = held_of(said)
                if not page.owed or time.monotonic() - page.owed[0][1] < BEHIND:
                    self.desk.hold(held)
            elif action != 'take':
                raise ValueError(f'do = {action!r}')
        except (ValueError, RecursionError):
            self.unread += 1


def _response(status: HTTPStatus, body: str, kind: str, policy: str = "default-src 'none'") -> Response:
    data = body.encode()
    headers = Headers({
        'Content-Type': kind, 'Content-Length': str(len(data)), 'Cache-Control': 'no-store', 'Connection': 'close',
        'Content-Security-Policy': policy, 'Referrer-Policy': 'no-referrer', 'X-Content-Type-Options': 'nosniff',
    })  # fmt: skip
    return Response(status.value, status.phrase, headers, data)


def _bound(host: str, port: int) -> socket.socket:
    """A socket that listens. Raises MbdError."""
    remedy = 'give another --port, or none for one that is free'
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family, backlog=64)
    except socket.gaierror as error:
        why, remedy = str(error.strerror), ELSEWHERE
    except UnicodeError:
        why, remedy = 'this is no name of a machine', ELSEWHERE
    except OverflowError as error:
        why = str(error)
    except OSError as error:
        why = os.strerror(error.errno or 0)
        remedy = ELSEWHERE if error.errno == errno.EADDRNOTAVAIL else remedy
    raise MbdError(f'cannot serve on {host}, port {port}: {why}; {remedy}')


def _is_loopback(host: str) -> bool:
    try:
        return host == 'localhost' or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _name_in(host: str) -> str:
    """The name in the header Host, without a port."""
    return host[1:].partition(']')[0] if host.startswith('[') else host.rpartition(':')[0] or host


def _is_any(host: str) -> bool:
    return host in ('', '0.0.0.0', '::')
