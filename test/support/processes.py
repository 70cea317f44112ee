"""Starting ROS nodes as processes."""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from forks import Fork

ROOT = Path(__file__).parents[2]
DOMAIN = str(60 + os.getpid() % 40)  # one per test run, so that two runs on a machine do not hear each other

# The real node with a stand-in for scene and simulation; argv[1]: keyword arguments of the stand-in, argv[2]: seconds
# of preparation, which of the scene `slow` is a minute.
SCRIPT = """
import json, sys, time
import synthetic
from mbd_sim_ros.node import main as node
from solver.errors import SceneError
def prepare(name, overrides):
    print('PREPARING', flush=True)
    time.sleep(60.0 if name == 'slow' else float(sys.argv[2]))
    if name == 'nothing':
        raise SceneError("scene 'nothing': no such file")
    return synthetic.scene(name=name), synthetic.Synthetic(**json.loads(sys.argv[1]))
node.prepare = prepare
sys.exit(node.main(sys.argv[3:]))
"""


class Process:
    """A node process; its output is collected while it runs. command: python and its arguments; path: of further
    packages; forked: not one that starts from nothing, and has the limits of this process."""

    def __init__(
        self, directory: Path, command: list[str], domain: str = DOMAIN, path: str = '', *, forked: bool = True
    ) -> None:
        environment = {
            **os.environ,
            'PYTHONPATH': f'{ROOT}:{Path(__file__).parent}' + (f':{path}' if path else ''),
            'ROS_DOMAIN_ID': domain,
            'ROS_LOG_DIR': str(directory / 'log'),
        }
        said, output = os.pipe()
        self._said = os.fdopen(said)
        self.process: Fork | subprocess.Popen[bytes]
        if forked:
            self.process = Fork(command[1:], cwd=directory, env=environment, output=output)
        else:
            self.process = subprocess.Popen(
                command, cwd=directory, env=environment, stdout=output, stderr=output, start_new_session=True
            )
        os.close(output)
        atexit.register(self.kill)  # where a test fails before it ends the process
        self.output = ''
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        with self._said as lines:
            for line in lines:
                self.output += line

    def wait_for(self, text: str, seconds: float = 30.0) -> None:
        end = time.monotonic() + seconds
        while text not in self.output:
            assert time.monotonic() < end and (self.process.poll() is None or text in self.output), self.output
            time.sleep(0.01)

    def end(self, seconds: float = 30.0) -> int:
        code = self.process.wait(seconds)
        self._reader.join(5.0)
        return code

    def kill(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait(10)


@pytest.fixture
def start(tmp_path):
    """Start a simulator with a stand-in simulation: start(parameters, **stand-in arguments)."""
    pytest.importorskip('rclpy', reason='needs ROS: source Jazzy, or pip install .[ros]')
    started = []

    def start(
        parameters: dict | None = None,
        *,
        preparing: float = 0.0,
        domain: str = DOMAIN,
        path: str = '',
        forked: bool = True,
        **simulation,
    ) -> Process:
        values = {'scene': 'synthetic', **(parameters or {})}
        arguments = [text for name, value in values.items() for text in ('-p', f'{name}:={json.dumps(value)}')]
        command = [sys.executable, '-c', SCRIPT, json.dumps(simulation), str(preparing), '--ros-args', *arguments]
        started.append(Process(tmp_path, command, domain, path, forked=forked))
        return started[-1]

    yield start
    for process in started:
        process.kill()
