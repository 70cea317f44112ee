"""A browser without a screen, where there is one: pages are opened, keys pressed and pictures taken over its pipe."""

from __future__ import annotations

import atexit
import base64
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from queue import Empty, Queue
from typing import Any

import numpy as np

CHROMIUM = shutil.which('chromium') or shutil.which('chromium-browser') or shutil.which('google-chrome')
QUIET = [
    '--headless',
    '--no-sandbox',
    '--disable-gpu',
    '--disable-quic',
    '--no-first-run',
    '--disable-background-networking',
]
# WebGL by the processor; a page wants it in its address, `?webgl`
SOFTWARE_WEBGL = [
    *(option for option in QUIET if option != '--disable-gpu'),
    '--use-angle=swiftshader',
    '--enable-unsafe-swiftshader',
]
# the browser reads from file 3 and writes to file 4
PIPES = """
import os, sys
read, write = (os.dup(int(number)) for number in sys.argv[1:3])
os.dup2(read, 3)
os.dup2(write, 4)
os.set_inheritable(3, True)
os.set_inheritable(4, True)
os.execv(sys.argv[3], sys.argv[3:])
"""
# where Runtime, Log and Network are enabled
TOLD = ('Runtime.consoleAPICalled', 'Runtime.exceptionThrown', 'Log.entryAdded', 'Network.requestWillBeSent')
WITHIN = ('file:', 'data:', 'blob:')  # addresses that leave no page
CODES = {'left': 'ArrowLeft', 'right': 'ArrowRight', 'up': 'ArrowUp', 'down': 'ArrowDown', 'space': 'Space'}


class Browser:
    """A running browser, with the tabs that are opened in it. size: of a window [pixels].

    The DevTools protocol goes over a pair of pipes, JSON with a zero byte behind: no library, and no port.
    """

    def __init__(self, home: Path, size: tuple[int, int] = (1280, 760), options: Sequence[str] = QUIET) -> None:
        to_it, ours = os.pipe()
        theirs, from_it = os.pipe()
        command = [str(CHROMIUM), *options, '--remote-debugging-pipe', f'--user-data-dir={home}']

        command += [f'--window-size={size[0]},{size[1]}', 'about:blank']
        self.process = subprocess.Popen(
            [sys.executable, '-c', PIPES, str(to_it), str(from_it), *command], pass_fds=(to_it, from_it),
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(to_it)
        os.close(from_it)
        self._write, self._read = ours, theirs
        self._number = 0
        self.told: dict[str, list[dict[str, Any]]] = {}  # what pages say on the console, by their sessions
        self._answers: dict[int, Queue[dict[str, Any]]] = {}
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        rest = b''
        while data := os.read(self._read, 1 << 20):
            *whole, rest = (rest + data).split(b'\0')
            for text in whole:
                said = json.loads(text)
                if (box := self._answers.pop(said.get('id', 0), None)) is not None:
                    box.put(said)
                elif said.get('method') in TOLD:
                    self.told.setdefault(said['sessionId'], []).append(said['params'])

    def call(self, method: str, session: str = '', **parameters: Any) -> dict[str, Any]:
        """The result of a method of the protocol. Raises RuntimeError."""
        self._number += 1
        box = self._answers[self._number] = Queue()
        said = {'id': self._number, 'method': method, 'params': parameters} | (
            {'sessionId': session} if session else {}
        )
        os.write(self._write, json.dumps(said).encode() + b'\0')
        try:
            answer = box.get(timeout=60.0)
        except Empty:
            raise RuntimeError(f'{method}: no answer') from None
        if 'error' in answer:
            raise RuntimeError(f'{method}: {answer["error"]}')
        return answer.get('result', {})

    def open(self, address: str) -> Tab:
        """A new tab."""
        target = self.call('Target.createTarget', url='about:blank')['targetId']
        tab = Tab(self, target, self.call('Target.attachToTarget', targetId=target, flatten=True)['sessionId'])
        tab.call('Page.enable')
        tab.call('Page.navigate', url=address)
        return tab

    def close(self) -> None:
        """End the browser."""
        self.process.terminate()
        try:
            self.process.wait(10.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        os.close(self._write)


class Tab:
    """A page in a browser."""

    def __init__(self, browser: Browser, target: str, session: str) -> None:
        self.browser, self.target, self.session = browser, target, session

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """As Browser.call, for this tab."""
        return self.browser.call(method, self.session, **parameters)

    def value(self, script: str) -> Any:
        """The value of an expression in JavaScript. Raises RuntimeError with its error."""
        result = self.call('Runtime.evaluate', expression=script, returnByValue=True, awaitPromise=True)
        if 'exceptionDetails' in result:
            raise RuntimeError(f'{script}: {result["exceptionDetails"]}')
        return result['result'].get('value')

    def wait(self, script: str, seconds: float = 30.0) -> Any:
        """The value of an expression as soon as it is true. Raises TimeoutError."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                if value := self.value(script):
                    return value
            except RuntimeError:  # the page is not there yet
                pass
            time.sleep(0.05)
        raise TimeoutError(f'{script} was not true within {seconds:g} s')

    def press(self, key: str) -> None:
        """Press a key and hold it."""
        self.call('Input.dispatchKeyEvent', type='rawKeyDown', code=CODES.get(key, f'Key{key.upper()}'), key=key)

    def release(self, key: str) -> None:
        """Release a key."""
        self.call('Input.dispatchKeyEvent', type='keyUp', code=CODES.get(key, f'Key{key.upper()}'), key=key)

    def reload(self) -> None:
        """Load the page again."""
        self.call('Page.reload')

    def close(self) -> None:
        """Close the tab."""
        self.browser.call('Target.closeTarget', targetId=self.target)

    def resize(self, width: int, height: int) -> None:
        """Another size of the page [pixels]."""
        self.call('Emulation.setDeviceMetricsOverride', width=width, height=height, deviceScaleFactor=1, mobile=False)

    def picture(self, file: Path) -> None:
        """Write what is seen as PNG."""
        file.write_bytes(base64.b64decode(self.call('Page.captureScreenshot', format='png')['data']))


def data_of(file: Path) -> dict[str, Any]:
    """The data in a page of mbd_sim_ros.analysis.pages."""
    text = re.search(r'<script type="application/json" id="data">(.*?)</script>', file.read_text('utf-8'), re.DOTALL)
    assert text is not None
    return json.loads(text[1])


def blocks_of(data: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    """The blocks of a kind, those in foldable parts too."""
    inside = [inner for block in data['blocks'] for inner in block.get('blocks', [])]
    return [block for block in (*data['blocks'], *inside) if block['kind'] == kind]


def numbers(text: str) -> np.ndarray:
    """Numbers that a page holds in base64."""
    return np.frombuffer(base64.b64decode(text), '<f4')


@cache
def _shared() -> Browser:
    """The browser of all pages that this process opens one after the other."""
    home = tempfile.mkdtemp(prefix='browser-')
    browser = Browser(Path(home))
    atexit.register(shutil.rmtree, home, ignore_errors=True)
    atexit.register(browser.close)
    return browser


def opened(
    file: Path, size: tuple[int, int], probe: str = '{}', picture: Path | None = None, ready: str = 'true'
) -> Any:
    """The value of an expression of JavaScript in a page that a window of this size shows.

    picture: for a screenshot. ready: what is waited for, for a chart is drawn when it comes into view. Fails with what
    the page says on the console: an error, or a request that its policy forbids; and with what it asks the network.
    """
    browser = _shared()
    tab = browser.open('about:blank')
    try:
        tab.call('Runtime.enable')
        tab.call('Log.enable')
        tab.call('Network.enable')
        tab.resize(*size)
        tab.call('Page.navigate', url=file.as_uri())
        tab.wait(f"document.readyState === 'complete' && !!({ready})")
        value = tab.value(f'(async () => ({probe}))()')
        if picture is not None:
            tab.picture(picture)
        told = [
            t for t in browser.told.pop(tab.session, []) if not t.get('request', {}).get('url', '').startswith(WITHIN)
        ]
    finally:
        tab.close()
    assert not told, told
    return value
