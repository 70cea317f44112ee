"""Pages and sockets: who is let in, who drives, and what slow, silent, flooding and vanishing pages do: nothing."""

from __future__ import annotations

import contextlib
import json
import random
import re
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from faults import COUNT, SEED
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from mbd_sim_ros.drive.hands import Held
from mbd_sim_ros.drive.server import MOST, WINDOW, Server
from solver.errors import MbdError


class Stub:
    """A desk that notes what pages do."""

    def __init__(self) -> None:
        self.held: list[Held | None] = []
        self.acts: list[tuple[str, int]] = []
        self.road = ''

    def page(self) -> str:
        return '<!doctype html>the page'

    def hold(self, held: Held | None) -> None:
        self.held.append(held)

    def act(self, action: str, value: int) -> None:
        self.acts.append((action, value))

    def status(self) -> dict[str, Any]:
        return {'rate': 1.0}

    def ground(self) -> str:
        return self.road


@pytest.fixture
def desk() -> Stub:
    return Stub()


@pytest.fixture
def server(desk: Stub) -> Iterator[Server]:
    one = Server()
    one.start(desk)
    yield one
    one.close()


def page(server: Server, **changes: Any) -> ClientConnection:
    """A socket as the page opens it."""
    token = changes.pop('token', server.token)
    options = {'origin': f'http://127.0.0.1:{server.port}', 'compression': None, **changes}
    return connect(f'ws://127.0.0.1:{server.port}/socket?token={token}', **options).__enter__()


def told(connection: ClientConnection, **wanted: Any) -> dict[str, Any]:
    """The next account in which these stand."""
    for _ in range(50):
        said = connection.recv(timeout=20.0)
        if isinstance(said, str) and wanted.items() <= (account := json.loads(said)).items():
            return account
    raise AssertionError(f'nobody said {wanted}')


def vanish(connection: ClientConnection) -> None:
    """End a connection without a goodbye."""
    with contextlib.suppress(OSError):
        connection.socket.shutdown(socket.SHUT_RDWR)
    connection.socket.close()


def until(condition: Callable[[], object], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def asked(server: Server, path: str, *lines: str) -> tuple[int, str]:
    """Status and answer to a plain request."""
    host = () if any(line.startswith('Host') for line in lines) else (f'Host: 127.0.0.1:{server.port}',)
    with socket.create_connection(('127.0.0.1', server.port), 5.0) as raw:
        raw.sendall('\r\n'.join([f'GET {path} HTTP/1.1', *host, *lines, '', '']).encode())
        answer = b''
        while data := raw.recv(65536):
            answer += data
    return int(answer.split()[1]), answer.decode()


def test_the_page_is_given_to_whoever_has_the_token_and_says_what_it_may_load(server: Server) -> None:
    status, answer = asked(server, f'/?token={server.token}')
    assert status == 200 and answer.endswith('the page')
    policy = next(line for line in answer.splitlines() if line.startswith('Content-Security-Policy'))
    assert "default-src 'none'" in policy and f"connect-src 'self' ws://127.0.0.1:{server.port};" in policy
    assert 'Referrer-Policy: no-referrer' in answer and 'Cache-Control: no-store' in answer
    assert server.address == f'http://127.0.0.1:{server.port}/?token={server.token}'


@pytest.mark.parametrize(
    ('path', 'lines', 'status', 'sentence'),
    [
        ('/', (), 403, 'the token is missing'),
        ('/?token=', (), 403, 'the token is missing'),
        ('/?token=wrong', (), 403, 'the token is missing'),
        ('/?token=%ff%00', (), 403, 'the token is missing'),
        ('/socket', (), 403, 'the token is missing'),
        ('/elsewhere?token=TOKEN', (), 404, 'no such page'),
        ('/../etc/passwd?token=TOKEN', (), 404, 'no such page'),
        ('/?token=TOKEN', ('Host: evil.example',), 403, 'is not this machine'),
        ('/?token=TOKEN', ('Host: 127.0.0.1.evil.example:80',), 403, 'is not this machine'),
        ('/?token=TOKEN', ('Host: [',), 403, 'is not this machine'),
        ('/?token=TOKEN', ('Host: 127.0.0.1', 'Host: evil.example'), 403, 'is not this machine'),
        ('/?token=TOKEN', ('Host:',), 403, 'is not this machine'),
        ('//[?token=TOKEN', (), 404, 'no such page'),
        ('/socket?token=TOKEN', ('Origin: http://evil.example',), 403, 'is another page'),
        ('/socket?token=TOKEN', ('Origin: null',), 403, 'is another page'),
        ('/socket?token=TOKEN', ('Origin: https://127.0.0.1:PORT',), 403, 'is another page'),
        ('/socket?token=TOKEN', ('Origin: http://127.0.0.1:1',), 403, 'is another page'),
        ('/socket?token=TOKEN', (), 403, 'is another page'),
    ],
)
def test_others_are_refused_in_a_sentence(
    server: Server, desk: Stub, path: str, lines: tuple[str, ...], status: int, sentence: str
) -> None:
    fill = lambda text: text.replace('TOKEN', server.token).replace('PORT', str(server.port))  # noqa: E731
    code, answer = asked(server, fill(path), *map(fill, lines))
    assert code == status and sentence in answer
    assert server.refused == 1 and server.opened == 0 and not desk.held
    assert server.token not in answer


def test_a_socket_with_a_foreign_origin_or_without_token_is_refused(server: Server) -> None:
    for changes in ({'origin': 'http://evil.example'}, {'origin': None}, {'token': ''}, {'token': 'x' * 22}):
        with pytest.raises(InvalidStatus, match='403'):
            page(server, **changes)
    assert server.opened == 0 and server.refused == 4


def test_one_page_drives_another_may_take_the_wheel_and_who_goes_lets_go(server: Server, desk: Stub) -> None:
    first = page(server)
    told(first, driving=True, pages=1)
    second = page(server)
    told(second, driving=False, taken=True, pages=2)
    second.send(json.dumps({'gas': 1}))
    second.send(json.dumps({'do': 'reset'}))
    first.send(json.dumps({'number': 5, 'gas': 0.5}))
    until(lambda: desk.held)
    assert desk.held == [Held(number=5, gas=0.5)] and not desk.acts  # only the one at the wheel counts
    second.send(json.dumps({'do': 'take'}))
    told(second, driving=True)
    told(first, driving=False)
    second.send(json.dumps({'do': 'shift', 'by': -1}))
    second.send(json.dumps({'do': 'pause'}))
    until(lambda: len(desk.acts) == 2)
    assert desk.acts == [('shift', -1), ('pause', 1)]
    second.close()
    until(lambda: desk.held[-1] is None)
    told(first, taken=False)
    first.send(json.dumps({'gas': 1}))
    first.send(json.dumps({'do': 'take'}))
    told(first, driving=True)
    assert desk.held[-1] is None  # what it held before it had the wheel is nothing
    first.send(json.dumps({'do': 'leave'}))
    told(first, driving=False)
    assert desk.held[-1] is None


def test_pages_that_may_only_look_never_drive(desk: Stub) -> None:
    server = Server(look=True)
    server.start(desk)
    with page(server) as one:
        told(one, driving=False, look=True)
        for said in ({'do': 'take'}, {'gas': 1}, {'do': 'reset'}):
            one.send(json.dumps(said))
        told(one, driving=False, taken=False)
    server.close()
    assert not desk.held and not desk.acts


def pictures(connection: ClientConnection, seconds: float, *, answers: bool) -> list[bytes]:
    """The pictures that come in a while, each answered or not."""
    found = []
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0.0:
        try:
            said = connection.recv(timeout=left)
        except TimeoutError:
            break
        if isinstance(said, bytes):
            found.append(said)
            if answers:
                connection.send(json.dumps({'seen': int.from_bytes(said[:8], 'little')}))
    return found


def test_a_page_that_takes_no_pictures_gets_the_newest_when_it_does_and_others_get_all(server: Server) -> None:
    slow, quick = page(server), page(server)
    taken: list[bytes] = []
    reader = threading.Thread(target=lambda: taken.extend(pictures(quick, 3.0, answers=True)))
    reader.start()
    until(lambda: server.pages == 2)
    for k in range(100):
        server.show(struct.pack('<d', k))
        time.sleep(0.01)
    late = pictures(slow, 1.0, answers=False)
    assert len(late) == WINDOW
    slow.send(json.dumps({'seen': int.from_bytes(late[-1][:8], 'little')}))
    newest = pictures(slow, 0.5, answers=False)
    assert [struct.unpack('<d', one[8:])[0] for one in newest] == [99.0]  # not those that waited
    account = told(slow, pages=2)
    first = int.from_bytes(late[0][:8], 'little')  # a busy machine lets some pass before the page is there
    assert account['dropped'] == 100 - WINDOW - first
    reader.join()
    assert len(taken) > 20  # as many as a busy machine lets through
    assert struct.unpack('<d', taken[-1][8:]) == (99.0,)
    numbers = [int.from_bytes(one[:8], 'little') for one in taken]
    assert numbers == sorted(set(numbers))


def test_the_road_around_is_told_once_and_again_when_it_is_another_one(server: Server, desk: Stub) -> None:
    heard: list[str] = []

    def hears(road: str) -> None:
        while road not in heard:
            said = one.recv(timeout=20.0)
            heard.extend([said] if isinstance(said, str) else [])

    with page(server) as one:
        told(one, pages=1)
        for road in ('{"ground": 1}', '{"ground": 2}'):
            desk.road = road
            server.show(b'x')
            hears(road)
            for _ in range(3):
                server.tell()
                heard.append(json.dumps(told(one, pages=1)))
    assert [said for said in heard if 'ground' in said] == ['{"ground": 1}', '{"ground": 2}']


def test_showing_waits_for_no_page(server: Server) -> None:
    """A page that does not read at all: its socket is full, and show() takes microseconds all the same."""
    with page(server, max_queue=1) as one:
        until(lambda: server.pages == 1)
        begin = time.thread_time()
        for _ in range(2000):
            server.show(b'\0' * 4000)
        assert time.thread_time() - begin < 1.0  # 8 MB would not go through a socket that nobody reads
        vanish(one)
    until(lambda: server.pages == 0)


@pytest.mark.parametrize(
    'said',
    [
        '',
        '{',
        '[]',
        '"x"',
        'null',
        '{"gas": "1"}',
        '{"gas": NaN}',
        '{"do": "format"}',
        '{"do": []}',
        '[' * 900,
        b'\xff\0',
    ],
)
def test_what_cannot_be_understood_is_counted(server: Server, desk: Stub, said: str | bytes) -> None:
    with page(server) as one:
        told(one, driving=True)
        one.send(said)
        until(lambda: server.unread == 1)
        one.send(json.dumps({'gas': 1}))
        until(lambda: desk.held)
    assert desk.held[0] == Held(gas=1)


def test_a_message_that_is_too_long_ends_its_page_alone(server: Server) -> None:
    with page(server) as other, page(server) as one:
        one.send('x' * 10_000)
        with pytest.raises(ConnectionClosed):
            while True:
                one.recv(timeout=20.0)
        assert told(other, pages=1)


def test_a_flood_of_messages_is_read_slowly_and_harms_no_other_page(server: Server, desk: Stub) -> None:
    flooding, other = page(server), page(server)
    stop = threading.Event()

    def flood() -> None:
        with pytest.raises((ConnectionClosed, OSError)):
            while not stop.is_set():
                flooding.send('{"gas": 2}')
            raise OSError

    thread = threading.Thread(target=flood, daemon=True)
    thread.start()
    begin, unread = time.monotonic(), server.unread
    for _ in range(4):
        other.send(json.dumps({'do': 'take'}))
        told(other, pages=2)
        server.show(b'')
    assert server.unread - unread < 600.0 * (time.monotonic() - begin) + 100  # one message in 2 ms
    stop.set()
    vanish(flooding)
    told(other, pages=1)


def test_a_page_that_takes_no_pictures_holds_nothing(
    server: Server, desk: Stub, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a page said before it went is read late, and one that does not draw does not see where it drives. Where no
    picture is sent, as while the simulation is being reset, keys count."""
    monkeypatch.setattr('mbd_sim_ros.drive.server.BEHIND', 0.3)

    def says(**more: float) -> int:
        """How often it is heard in half a second."""
        before, end = len(desk.held), time.monotonic() + 0.5
        while time.monotonic() < end:
            one.send(json.dumps({'gas': 1, **more}))
            time.sleep(0.01)
        told(one, driving=True)
        return len(desk.held) - before

    with page(server, max_queue=None) as one:
        told(one, driving=True)
        assert says() > 10
        server.show(b'x')
        time.sleep(0.4)
        assert says() == 0
        assert says(seen=1) > 10


def test_more_pages_than_there_is_room_for_are_refused(server: Server) -> None:
    pages = [page(server) for _ in range(MOST)]
    until(lambda: server.pages == MOST)
    with pytest.raises(InvalidStatus, match='503'):
        page(server)
    for one in pages:
        vanish(one)
    until(lambda: server.pages == 0)
    page(server).close()


def test_pages_that_come_and_go_leave_the_server_alive(server: Server, desk: Stub) -> None:
    """Closed with and without a goodbye, in the middle of the handshake, of a request and of a frame; noise."""
    r = random.Random(SEED)
    for _ in range(COUNT or 10):
        server.show(bytes(r.randrange(5000)))
        kind = r.randrange(6)
        if kind == 0:
            with socket.create_connection(('127.0.0.1', server.port), 5.0) as raw:
                raw.sendall(r.randbytes(r.randrange(1, 3000)))
            continue
        if kind == 1:
            with socket.create_connection(('127.0.0.1', server.port), 5.0) as raw:
                raw.sendall(
                    f'GET /?token={server.token} HTTP/1.1\r\nHost: 127.0.0.1\r\n'.encode()[: r.randrange(1, 80)]
                )
            continue
        one = page(server)
        for _ in range(r.randrange(20)):
            one.send(json.dumps({'number': r.randrange(99), 'gas': r.random(), 'seen': r.randrange(-3, 99)}))
        if kind == 2:
            one.socket.sendall(r.randbytes(200))  # no frame at all
        if kind == 3:
            one.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack('ii', 1, 0))  # reset
        if kind >= 4:
            one.close()
        else:
            vanish(one)
    until(lambda: server.pages == 0)
    assert desk.held and desk.held[-1] is None  # nobody is left at the wheel
    with page(server) as last:
        told(last, driving=True, pages=1)
        server.show(b'alive')
        until(lambda: any(isinstance(said, bytes) and said.endswith(b'alive') for said in [last.recv(timeout=20.0)]))


def test_a_port_that_is_taken_is_one_sentence(server: Server, desk: Stub) -> None:
    with pytest.raises(MbdError) as refused:
        Server(port=server.port)
    assert re.fullmatch(
        rf'cannot serve on 127\.0\.0\.1, port {server.port}: .* already in use; give another --port, or none for '
        'one that is free',
        str(refused.value),
    )
    for host in ('203.0.113.7', 'no.such.invalid', 'no..name', 'a' * 300):  # nobody's [RFC 5737], [RFC 6761]
        with pytest.raises(MbdError, match=rf'cannot serve on {re.escape(host)}, port 0: [^\[]*; give an address of'):
            Server(host=host)


def test_what_is_open_to_others_says_so_and_still_wants_the_token(desk: Stub) -> None:
    server = Server(host='0.0.0.0')
    server.start(desk)
    assert server.open_to_others
    assert asked(server, '/')[0] == 403
    assert asked(server, f'/?token={server.token}', 'Host: somewhere:80')[0] == 200
    assert asked(server, f'/socket?token={server.token}', 'Host: somewhere:80', 'Origin: http://evil.example')[0] == 403
    server.close()
    assert not Server().open_to_others


def test_closing_ends_all_pages(server: Server) -> None:
    one = page(server)
    told(one, pages=1)
    server.close()
    with pytest.raises(ConnectionClosed):
        while True:
            one.recv(timeout=20.0)
    server.show(b'')  # harms nobody
    server.tell()
