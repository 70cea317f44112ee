"""Duration of a start: with an empty cache of compiled kernels, with a full one, and of the node up to its first
message."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_sim_ros.lab.benchmarks.machine import on_all_cores
from solver.errors import MbdError, SpecError
from solver.files.scene import load_scene

WARM = 3  # starts
LIMIT = 60.0  # s for the node to say something
DOMAIN = '102'  # ROS domain of its own
FIGURES = {
    'cold': 'from the start of Python to the end of the first step, nothing compiled yet [s]',
    'cold_cpu': 'CPU time of the same [s]',
    'warm': 'the same in later processes, which find compiled kernels [s]: median',
    'warm_cpu': 'CPU time of the same [s]: median',
    'node': 'from the start of the simulator node to the first joint_states at a reader that was there before [s]: '
    'median',
}
FIRST_STEP = """
import json, resource, sys, time
from solver import load_scene, simulation_of
simulation_of(load_scene(sys.argv[1], json.loads(sys.argv[2]))).advance(1)
children = resource.getrusage(resource.RUSAGE_CHILDREN)
print(time.clock_gettime(time.CLOCK_MONOTONIC), time.process_time() + children.ru_utime + children.ru_stime)
"""
LISTEN = """
import time
import rclpy
from sensor_msgs.msg import JointState
rclpy.init()
node = rclpy.create_node('mbd_bench_reader', enable_rosout=False)
def first(_):
    print(time.clock_gettime(time.CLOCK_MONOTONIC), flush=True)
    raise SystemExit
node.create_subscription(JointState, 'joint_states', first, 10, raw=True)
print('ready', flush=True)
rclpy.spin(node)
"""


class StartUp:
    """Measures one case, in processes of their own that may use every core. Raises SceneError, and SpecError from
    round()."""

    def __init__(self, scene: str, overrides: Sequence[str]) -> None:
        load_scene(scene, overrides)  # raises before anything is started
        self._scene, self._overrides = scene, list(overrides)
        self._values: dict[str, float | None] = {}

    def round(self, _: int) -> None:
        """One start with an empty cache and some with what it left there."""
        with on_all_cores(), tempfile.TemporaryDirectory(prefix='mbd-bench-') as cache:
            environment = {**os.environ, 'MBD_CACHE_DIR': cache, 'ROS_DOMAIN_ID': DOMAIN}
            # with it Python compiles every module in every start, a quarter second
            environment.pop('PYTHONDONTWRITEBYTECODE', None)
            self._values['cold'], self._values['cold_cpu'] = self._first_step(environment)
            warm = np.array([self._first_step(environment) for _ in range(WARM)])
            self._values['warm'], self._values['warm_cpu'] = map(float, np.median(warm, axis=0))
            node = [self._node(environment) for _ in range(WARM)] if _importable('rclpy') else []
            self._values['node'] = float(np.median(node)) if node else None

    def _first_step(self, environment: dict[str, str]) -> tuple[float, float]:
        """(elapsed, CPU) time [s] of a process up to the end of its first step."""
        begin = time.clock_gettime(time.CLOCK_MONOTONIC)
        command = [sys.executable, '-c', FIRST_STEP, self._scene, json.dumps(self._overrides)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SpecError(f'the start failed: {(done.stderr.strip().splitlines() or ["no reason given"])[-1]}')
        end, cpu = map(float, done.stdout.split())
        return end - begin, cpu

    def _node(self, environment: dict[str, str]) -> float:
        """Time [s] to the first message of the node."""
        listener = subprocess.Popen([sys.executable, '-c', LISTEN], env=environment, stdout=subprocess.PIPE, text=True)
        assert listener.stdout is not None
        command = [
            sys.executable,
            '-m',
            'mbd_sim_ros.node.main',
            '--ros-args',
            '--log-level',
            'warn',
            *parameters(self._scene, self._overrides),
        ]
        node = None
        try:
            listener.stdout.readline()
            begin = time.clock_gettime(time.CLOCK_MONOTONIC)
            node = subprocess.Popen(command, env=environment)
            listener.wait(LIMIT)
            return float(listener.stdout.readline()) - begin
        except (subprocess.TimeoutExpired, ValueError):
            raise MbdError(f'the node of {self._scene!r} sent nothing for {LIMIT:g} s') from None
        finally:
            for process in (node, listener):
                if process is not None and process.poll() is None:
                    process.terminate()
                    process.wait()
            listener.stdout.close()

    def close(self) -> None:
        """Nothing to end."""

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case."""
        return {'figures': {name: self._values[name] for name in FIGURES}}


def parameters(scene: str, overrides: Sequence[str], **values: Any) -> list[str]:
    """Arguments behind --ros-args that set parameters of the simulator."""
    given = {'scene': scene, **({'overrides': list(overrides)} if overrides else {}), **values}
    return [text for name, value in given.items() for text in ('-p', f'{name}:={json.dumps(value)}')]


def _importable(name: str) -> bool:
    try:
        __import__(name)
    except ImportError:
        return False
    return True
