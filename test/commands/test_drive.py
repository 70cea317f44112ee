"""mbd drive as a program: what it refuses, how it begins and ends, and what is left of it."""

from __future__ import annotations

import json
import math
import os
import random
import signal
import socket
import subprocess
import sys
import webbrowser
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from threading import Event, Timer
from typing import Any

import pytest
from faults import COUNT, SEED, UNWANTED
from page_client import PageClient, address_in
from processes import Process
from websockets.exceptions import ConnectionClosed

from mbd_sim_ros.bags import reader
from mbd_sim_ros.commands import drive
from mbd_sim_ros.commands.drive import announce
from mbd_sim_ros.commands.main import main
from mbd_sim_ros.drive.server import Server

LIGHT = ['handling_course', '--vehicle', 'light_car', '--no-browser']


@pytest.mark.parametrize(
    ('arguments', 'code', 'sentence'),
    [
        (['slider_crank'], 2, "scene 'slider_crank' has no car to drive"),
        (['torque_free_top'], 2, 'has no car to drive'),
        (['no_such_scene'], 2, 'no_such_scene'),
        (['handling_course', '--vehicle', 'no_such_car'], 2, 'no_such_car'),
        (['handling_course', '--fidelity', 'single_track'], 2, 'no bodies to draw'),
        (['handling_course', '--set', 'integrator={kind: reference_radau}'], 2, 'mbd drive steps with alf or m_alf'),
        (['--ghost', 'no/such/bag'], 5, 'no/such/bag'),
        (['--rate', '0'], 2, '--rate 0: must be between 0.01 and 10'),
        (['--rate', 'nan'], 2, '--rate nan: must be between'),
        (['--steering-rate', '-1'], 2, '--steering-rate -1: must be between 0.1 and 40'),
        (['--return-rate', '1e9'], 2, '--return-rate 1e+09: must be between'),
        (['--duration', '-3'], 2, '--duration -3: must be above 0'),
        (['--port', '70000'], 2, '--port 70000: must be between 0 and 65535'),
        (['--port', 'eighty'], 2, "'eighty' is not a whole number"),
        (['--host', '203.0.113.7'], 1, 'cannot serve on 203.0.113.7, port 0: '),  # nobody's [RFC 5737]
        (['--node', 'x', '--rate', '2'], 2, '--node x: --rate has no effect on a node that runs'),
        (['car_circle', '--node', 'x'], 2, '--node x: SCENE has no effect'),
        (['--node', 'x', '--ghost', 'bag'], 2, '--node x: --ghost has no effect'),
        (['--out', 'a', '--no-record'], 2, 'not allowed with argument'),
    ],
)
def test_what_cannot_be_driven_is_one_sentence(
    arguments: list[str], code: int, sentence: str, capsys: pytest.CaptureFixture[str], tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert main(['drive', '--no-browser', *arguments]) == code
    said = capsys.readouterr().err
    assert sentence in said and said.count('\n') == 1, said
    assert list(tmp_path.iterdir()) == []  # nothing was recorded


def test_a_port_that_is_taken_is_told_before_anything_is_prepared(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(('127.0.0.1', 0)) as taken:
        port = taken.getsockname()[1]
        assert main(['drive', 'no_such_scene', '--port', str(port), '--json']) == 1
    said = json.loads(capsys.readouterr().out)
    assert said['error'].startswith(f'cannot serve on 127.0.0.1, port {port}: ')


@pytest.mark.parametrize('display', ['', ':0'])
def test_a_browser_is_opened_where_there_is_a_display_and_the_address_is_printed_anyway(
    display: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: SimpleQueue[str] = SimpleQueue()
    monkeypatch.setattr(webbrowser, 'open', opened.put)
    monkeypatch.setattr(sys, 'platform', 'linux')
    monkeypatch.setenv('DISPLAY', display)
    monkeypatch.delenv('WAYLAND_DISPLAY', raising=False)
    server = Server()
    announce(server, browser=True)
    announce(server, browser=False)
    server.close()
    if display:
        assert opened.get(timeout=20.0) == server.address
    assert opened.empty()
    said = capsys.readouterr().err
    assert said.count(server.address) == 2 and 'not encrypted' not in said
    everywhere = Server(host='0.0.0.0')
    announce(everywhere, browser=False)
    everywhere.close()
    assert 'the connection is not encrypted' in capsys.readouterr().err


def started(tmp_path: Path, *arguments: str) -> Process:
    return Process(tmp_path, [sys.executable, '-m', 'mbd_sim_ros.commands.main', 'drive', *arguments])


def page_of(process: Process) -> PageClient:
    process.wait_for('Ctrl-C ends', 200.0)
    return PageClient(address_in(process.output))


@pytest.mark.realtime
@pytest.mark.slow
def test_ctrl_c_ends_a_drive_with_a_whole_recording_that_replays(tmp_path: Path) -> None:
    process = started(tmp_path, *LIGHT, '--out', 'run')
    page = page_of(process)
    page.until(lambda one: one.told.get('driving') is True)
    page.hold(number=1, gas=1.0, left=1.0)
    page.until(lambda one: one.head[0] > 0.5 and one.head[3] > 0.5)
    page.say(do='reset')
    page.until(lambda one: one.told.get('run') == 2 and one.head[0] < 0.5)
    page.until(lambda one: one.head[0] > 0.5)
    process.process.send_signal(signal.SIGINT)
    assert process.end() == 0, process.output
    assert 'verdict      ok' in process.output and not UNWANTED.search(process.output), process.output
    for name, end in (('run', 'reset'), ('run-2', 'stopped by SIGINT')):
        run = reader.read(tmp_path / name)
        assert run.metadata['end'] == end and run['cmd_applied/drive_torque'].max() > 100.0
        assert main(['replay', str(tmp_path / name)]) == 0


@pytest.mark.realtime
@pytest.mark.slow
def test_pages_that_come_and_go_while_a_car_is_driven_leave_the_drive_alive(tmp_path: Path) -> None:
    """Closed with and without goodbye, in the middle of a frame, flooding; MBD_FAULTS=200 for as many. Then the car is
    let go, a page drives on, and the recording is whole."""
    process = started(tmp_path, *LIGHT, '--out', 'run', '--json')
    page = page_of(process)
    page.until(lambda one: one.told.get('driving') is True)
    page.hold(gas=1.0)
    page.until(lambda one: one.head[3] > 1.0)
    page.close()
    r, address = random.Random(SEED), address_in(process.output)
    for _ in range(COUNT or 10):
        one = PageClient(address)
        kind = r.randrange(4)
        if kind == 1:
            one.until(lambda one: one.pictures > 2)
        if kind == 2:
            for _ in range(200):  # a flood, half of it nonsense
                one.socket.send(r.choice(['{"gas": 1}', '{', '{"do": "pause"}', '{"do": "resume"}', 'x' * 1000]))
        if kind == 3:
            one.socket.socket.sendall(r.randbytes(100))
        one.close() if r.random() < 0.5 else one.socket.socket.shutdown(socket.SHUT_RDWR)
    page = PageClient(address)
    page.until(lambda one: one.told.get('pages') == 1)
    page.say(do='take')
    page.say(do='resume')
    page.until(lambda one: one.told.get('driving') is True and not one.told['paused'])
    page.until(lambda one: one.head[8] == 0.0)  # whoever went has let go of the gas
    page.hold(brake=1.0)
    page.until(lambda one: one.head[9] == 1.0)
    process.process.send_signal(signal.SIGTERM)
    assert process.end() == 0, process.output
    assert not UNWANTED.search(process.output), process.output
    said: dict[str, Any] = json.loads(process.output[process.output.index('{') :].partition('\n')[0])
    assert said['pages'] >= 2 + (COUNT or 10) and said['recordings'] == ['run']
    assert main(['replay', str(tmp_path / 'run')]) == 0


@pytest.mark.realtime
@pytest.mark.slow
def test_a_drive_of_a_given_length_ends_by_itself_and_its_json_is_one_object(tmp_path: Path) -> None:
    command = [sys.executable, '-m', 'mbd_sim_ros.commands.main', 'drive', *LIGHT]
    done = subprocess.Popen(
        [*command, '--no-record', '--duration', '0.5', '--json'],
        cwd=tmp_path, env={**os.environ, 'PYTHONPATH': str(Path(__file__).parents[2])}, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert done.stderr is not None
    address = ''
    while not address:
        line = done.stderr.readline()
        assert line, done.wait()
        address = address_in(line)
    page = PageClient(address)
    page.until(lambda one: one.told.get('driving') is True)
    page.say(do='resume')
    out, _ = done.communicate(timeout=60.0)
    said = json.loads(out)
    assert done.returncode == 0 and said['status'] == 'ok' and said['simulated_time'] == 0.5 and said['steps'] == 500
    assert said['recordings'] == [] and list(tmp_path.iterdir()) == []


class Standing:
    """A loop of which only matters whether it stands."""

    def __init__(self, paused: bool) -> None:
        self.paused, self.done = paused, Event()


def test_a_drive_of_a_given_length_waits_for_a_while_and_one_without_waits_for_ever(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(drive, 'LOOK', 0.01)
    assert drive.stood(Standing(paused=True), 0.1)
    for paused, patience in ((True, math.inf), (False, 0.1)):
        loop = Standing(paused)
        Timer(0.4, loop.done.set).start()
        assert not drive.stood(loop, patience)


IMPATIENT = """
import sys
from mbd_sim_ros.commands import drive
from mbd_sim_ros.commands.main import main
drive.PATIENCE = 1.5
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.realtime
@pytest.mark.slow
def test_a_drive_of_a_given_length_ends_where_nobody_drives(tmp_path: Path) -> None:
    """No page comes; a page looks and never drives; one drives for longer than anybody waits, pauses and goes."""
    command = [sys.executable, '-c', IMPATIENT, 'drive', *LIGHT, '--duration', '60']
    process = Process(tmp_path, [*command, '--no-record', '--json'])
    process.wait_for('Ctrl-C ends', 200.0)
    assert process.end() == 1
    said = json.loads(process.output[process.output.index('{') :].partition('\n')[0])
    assert said['status'] == 'error' and 'nobody drove for 1.5 s, so the drive ended after 0 s; open' in said['error']
    process = Process(tmp_path, [*command, '--no-record'])
    page = page_of(process)
    with suppress(ConnectionClosed):
        page.until(lambda one: False, 20.0)
    assert process.end() == 1 and 'ended after 0 s; open the address' in process.output
    process = Process(tmp_path, [*command, '--out', 'run'])
    page = page_of(process)
    page.until(lambda one: one.told.get('driving') is True)
    page.hold(gas=1.0)
    page.until(lambda one: one.head[0] > 3.0)
    page.say(do='pause')
    page.until(lambda one: one.told['paused'])
    page.close()
    assert process.end() == 1 and '(recorded in run); open the address' in process.output, process.output
    assert not UNWANTED.search(process.output), process.output
    assert reader.read(tmp_path / 'run').metadata['end'] == 'nobody drove for 1.5 s'
    assert main(['replay', str(tmp_path / 'run')]) == 0
