"""A machine without a network: commands do their work, neither they nor their processes ask for a connection or a name,
and the pages that they write load nothing."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

# A sitecustomize, which every Python process of a command imports: it writes what is asked of the network into a file.
LISTENER = """
import os, sys
ASKS = ('socket.connect', 'socket.sendto', 'socket.sendmsg', 'socket.bind')
NAMES = ('socket.getaddrinfo', 'socket.gethostbyname', 'socket.gethostbyaddr', 'socket.getnameinfo', 'webbrowser.open')
def heard(event, given, note=os.environ['ASKED']):
    if event in ASKS and isinstance(given[1], tuple) or event in NAMES:  # the address of a local socket is a text
        with open(note, 'a') as file:
            file.write(f'{sys.argv}: {event} {given[1:] or given}\\n')
sys.addaudithook(heard)
"""
COMMANDS = """
list
info light_car --brief --html info.html
kandc light_car --points 3 --out kandc
run pendulum --duration 0.2 --out bag --html run.html
run pendulum --duration 0.2 --set integrator.h=0.002 --no-error --out other
replay bag
view bag --out view.html
view bag --out view.json
compare bag other --html compare.html
export bag --csv csv
recover bag saved
schema scene
tune light_car chassis.mass=1000:1400 'mass=1400 kg' --out tuned.yaml
maneuver
evaluate --list
sweep sweep.yaml --workers 1 --out sweep
""".strip().splitlines()
SWEEP = """
scene: pendulum
set: [duration=0.1]
errors: none
parameters: {integrator.h: {values: [0.01, 0.005]}}
figures: {fast: {quantity: odom/twist/wz}}
"""
PROGRAM = """
import shlex, sys
from mbd_sim_ros.commands.main import main
for line in sys.argv[1:]:
    code = main(shlex.split(line))
    print(f'{line}: exit {code}')
"""
LOADS = (
    r"""<(?:script|img|iframe|object|embed|source|video|audio|base)\b[^>]*\b(?:src|data|href)\s*=\s*["']?(?!data:)""",
    r"""<link\b""", r"""\burl\(\s*["']?(?:https?:)?//""", r"""@import\b""",
    r"""\b(?:importScripts|sendBeacon|XMLHttpRequest)\b""",
    r"""\bnew (?:WebSocket|EventSource)\b""", r"""\bfetch\(\s*["'`](?:https?:)?//""",
)  # fmt: skip
POLICY = """<meta http-equiv="Content-Security-Policy" content="default-src 'none';"""


def without_network() -> list[str]:
    """The beginning of a command line whose program has no network at all; nothing where that is not allowed."""
    alone = ['unshare', '--map-root-user', '--net']
    there = shutil.which('unshare') and subprocess.run([*alone, 'true'], capture_output=True, check=False)
    return alone if there and there.returncode == 0 else []


def run(folder: Path, program: str, *arguments: str) -> tuple[str, str]:
    """(what a program says, what it and its processes ask of the network)."""
    (folder / 'sitecustomize.py').write_text(LISTENER)
    note = folder / 'asked'
    note.touch()
    path = os.pathsep.join((str(folder), *filter(None, [os.environ.get('PYTHONPATH')]), *sys.path[1:]))
    done = subprocess.run(
        [*without_network(), sys.executable, '-c', program, *arguments], cwd=folder, text=True, check=False,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env={**os.environ, 'PYTHONPATH': path, 'ASKED': str(note)},
        timeout=300.0,
    )  # fmt: skip
    return done.stdout, note.read_text()


@pytest.mark.slow
def test_commands_and_their_pages_need_no_network(tmp_path: Path) -> None:
    (tmp_path / 'sweep.yaml').write_text(SWEEP)
    said, asked = run(tmp_path, PROGRAM, *COMMANDS)
    codes = dict(re.findall(r'^(.*): exit (\d+)$', said, re.MULTILINE))
    differ = 'compare bag other --html compare.html'  # runs of two steps, and exit code 1 says so
    assert codes == {line: '1' if line == differ else '0' for line in COMMANDS}, said
    assert asked == ''
    pages = [*tmp_path.rglob('*.html')]
    assert len(pages) == 6, pages
    for page in pages:
        text = page.read_text('utf-8')
        assert text.count(POLICY) == 1, page
        assert loads(text) == [], page


def loads(text: str) -> list[str]:
    """What in a page would be loaded from elsewhere."""
    return [found[0] for pattern in LOADS for found in re.finditer(pattern, text)]


@pytest.mark.parametrize(
    'text',
    [
        '<script src="https://cdn.example/plot.js">', '<link rel=stylesheet href=x.css>',
        "<img alt='' src='//a.example/p.png'>",
        'a { background: url(https://a.example/x) }', '@import "x.css";',
        'fetch("https://a.example")', 'new WebSocket(a)',
    ],
)  # fmt: skip
def test_loads_are_seen(text: str) -> None:
    assert loads(text)


def test_a_listener_hears_programs_and_their_processes(tmp_path: Path) -> None:
    """A connection, a name, and the name that a process asks for; a socket within the machine is none."""
    program = """
import socket, subprocess, sys
socket.socket().connect_ex(('192.0.2.1', 9)) if sys.argv[1] == 'far' else None
local = socket.socket(socket.AF_UNIX); local.bind('here')
ask = 'import socket; socket.gethostbyname("127.0.0.1")'
exec(ask)
subprocess.run([sys.executable, '-c', ask], check=True)
"""
    _, asked = run(tmp_path, program, 'far' if without_network() else 'near')  # [RFC 5737] nobody's address
    heard = re.findall(r': (socket\.\w+)', asked)
    assert heard == ['socket.connect'] * bool(without_network()) + ['socket.gethostbyname'] * 2
