"""The node at work at the full vehicle and at the level kc: how much of a core it takes, beside what no node can
save."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.batch import warm_up
from mbd_sim_ros.lab.benchmarks.levels import per_step
from mbd_sim_ros.lab.benchmarks.machine import on_all_cores
from mbd_sim_ros.lab.benchmarks.overhead import LISTEN
from mbd_sim_ros.lab.benchmarks.start import parameters
from mbd_sim_ros.node.main import LOOK as SPIN
from mbd_sim_ros.node.main import SWITCH
from solver import simulation_of
from solver.errors import MbdError
from solver.files.scene import load_scene

LEVELS = ('full', 'kc')
MODES = ('ASYNCHRONOUS', 'SYNCHRONOUS')  # of publishing: a thread of the middleware sends, or the one that publishes
FIGURES = {
    **{f'node_{level}': f'CPU time of the node with fidelity: {level} over elapsed time [%]' for level in LEVELS},
    'node_share': 'kc over full',
    **{
        f'bare_{mode.lower()}': f'CPU time of a node that only sleeps and publishes as often, {mode.lower()} [%]'
        for mode in MODES
    },
    **{
        f'steps_{level}': f'CPU time of the steps of {level} alone over the time that they simulate [%]'
        for level in LEVELS
    },
    'least_share': 'kc over full where the cheaper bare node makes these steps: no node with rclpy has less',
}
DOMAIN = '104'  # ROS domain of its own
HEARD = 'odom:nav_msgs/msg/Odometry'
BARE = 'import sys; from mbd_sim_ros.lab.benchmarks.node_levels import bare; bare(*map(float, sys.argv[1:]))'
ENDING = 1.0  # s before the end of the node that are not looked at
LOOK = 0.1  # s between two looks at its clock
CALLS = 20  # of many steps, of which the median counts
TICK = os.sysconf('SC_CLK_TCK')


class NodeLevels:
    """Measures one case: the real node paced in real time at every level for `seconds`, and a subscriber to HEARD in
    another process.

    Beside it what no node can save: the steps, and sleeping and publishing. publish_every: steps between messages.

    Raises what simulation_of does (ImportError without rclpy), MbdError from round().
    """

    def __init__(self, scene: str, overrides: Sequence[str], seconds: float, *, publish_every: int = 1) -> None:
        import rclpy  # noqa: F401

        self._simulations = {
            level: simulation_of(load_scene(scene, [*overrides, f'fidelity={level}'])) for level in LEVELS
        }
        for simulation in self._simulations.values():  # fills the cache too, so that the node starts at once
            warm_up(simulation)
        self._scene, self._overrides, self._seconds, self._h = scene, list(overrides), seconds, simulation.h
        self._every = publish_every
        self._found: dict[str, float] = {}

    def round(self, _: int) -> None:
        """One run of the node at each level, of a bare one in each mode, and some steps."""
        values = {'duration': float(self._seconds), 'publish_every': self._every}
        for level in LEVELS:
            given = parameters(self._scene, [*self._overrides, f'fidelity={level}'], **values)
            self._found[f'node_{level}'] = self._share(
                ['-m', 'mbd_sim_ros.node.main', '--ros-args', '--log-level', 'warn', *given]
            )
        for mode in MODES:
            again = ['-c', BARE, str(self._every * self._h), str(self._seconds)]
            self._found[f'bare_{mode.lower()}'] = self._share(again, RMW_FASTRTPS_PUBLICATION_MODE=mode)
        times = [[per_step(simulation, audit=False) for simulation in self._simulations.values()] for _ in range(CALLS)]
        for level, seconds in zip(LEVELS, np.median(times, axis=0).tolist(), strict=True):
            self._found[f'steps_{level}'] = 100.0 * seconds / self._h

    def _share(self, arguments: Sequence[str], **variables: str) -> float:
        """CPU time over elapsed time [%] of a node at work, a Python process with these arguments."""
        looks: list[tuple[float, float]] = []
        with on_all_cores(), ExitStack() as running:
            environment = {**os.environ, 'ROS_DOMAIN_ID': DOMAIN}
            reader = subprocess.Popen([sys.executable, '-c', LISTEN, HEARD], env=environment)
            running.callback(reader.wait)
            running.callback(reader.terminate)
            node = subprocess.Popen([sys.executable, *arguments], env=environment | variables)
            running.callback(node.wait)
            running.callback(node.terminate)
            while node.poll() is None:
                looks.append((time.monotonic(), cpu_time(node.pid)))
                time.sleep(LOOK)
        if node.returncode:
            raise MbdError(f'the node ended with exit code {node.returncode}')
        last = looks[-1][0] - ENDING
        used = [look for look in looks if last - 0.8 * (self._seconds - ENDING) <= look[0] <= last]
        if len(used) < 2:
            raise MbdError(f'a run of the node of {self._seconds:g} s is too short to be measured; take --duration 10')
        return 100.0 * (used[-1][1] - used[0][1]) / (used[-1][0] - used[0][0])

    def close(self) -> None:
        """Nothing to end."""

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case."""
        found = dict(self._found)
        found['node_share'] = found['node_kc'] / found['node_full']
        cheaper = min(found[f'bare_{mode.lower()}'] for mode in MODES)
        found['least_share'] = (cheaper + found['steps_kc']) / (cheaper + found['steps_full'])
        return {
            'h': self._h,
            'steps': round(self._seconds / self._h),
            'figures': {name: found[name] for name in FIGURES},
        }


def bare(period: float, seconds: float) -> None:
    """Publish the same message of HEARD every `period` [s] for `seconds`, beside an executor like that of the node."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.serialization import serialize_message

    from mbd_sim_ros.node.publish import message_class

    name, _, kind = HEARD.partition(':')
    sys.setswitchinterval(SWITCH)
    rclpy.init(args=[])
    node = rclpy.create_node('mbd_bench_bare', enable_rosout=False)
    publisher = node.create_publisher(message_class(kind), name, 10)
    data = bytes(serialize_message(message_class(kind)()))
    end = time.monotonic() + seconds

    def publish() -> None:
        begin = due = time.perf_counter()
        while due < begin + seconds:
            if (wait := due - time.perf_counter()) > 0.0:
                time.sleep(wait)
            publisher.publish(data)
            due += period

    thread = threading.Thread(target=publish)
    thread.start()
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=SPIN)
    thread.join()
    rclpy.shutdown()


def cpu_time(process: int) -> float:
    """CPU time of all threads of a running process [s]."""
    fields = Path(f'/proc/{process}/stat').read_text(encoding='utf-8').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / TICK
