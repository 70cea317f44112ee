"""A page without a browser: its socket, for tests of mbd drive."""

from __future__ import annotations

import json
import re
import struct
import time
from collections.abc import Callable
from typing import Any

from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

HEAD = 12  # numbers before those of bodies and wheels


def address_in(text: str) -> str:
    """The address that the command printed; '' before it has."""
    found = re.search(r'http://\S+', text)
    return found[0] if found else ''


class PageClient:
    """Opens the socket of a page by its address, answers what comes, and keeps what it was told last."""

    def __init__(self, address: str) -> None:
        found = re.fullmatch(r'http://([^/]+)/\?token=(\S+)', address)
        assert found is not None
        host, token = found.groups()
        self.socket: ClientConnection = connect(
            f'ws://{host}/socket?token={token}', origin=Origin(f'http://{host}'), compression=None
        ).__enter__()
        self.told: dict[str, Any] = {}
        self.head: tuple[float, ...] = (0.0,) * HEAD
        self.pictures = 0
        self.held: dict[str, Any] = {}

    def say(self, **message: Any) -> None:
        """Send a message."""
        self.socket.send(json.dumps(message))

    def hold(self, **held: float) -> None:
        """Hold keys from now on; they are said again with every picture."""
        self.held = held
        self.say(**held)

    def until(self, condition: Callable[[PageClient], bool], seconds: float = 60.0) -> None:
        """Take what comes until something is so."""
        end = time.monotonic() + seconds
        while not condition(self):
            assert time.monotonic() < end, (self.told, self.head)
            try:
                message = self.socket.recv(timeout=0.1)
            except TimeoutError:
                self.say(**self.held)  # a sign of life
                continue
            if isinstance(message, str):
                self.told = json.loads(message)
            else:
                self.pictures += 1
                self.head = struct.unpack_from(f'<{HEAD}d', message, 8)
                self.say(seen=int.from_bytes(message[:8], 'little'), **self.held)

    def close(self) -> None:
        """Close the page."""
        self.socket.close()
