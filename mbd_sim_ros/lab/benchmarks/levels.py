"""The levels of detail of a scene side by side: what a step costs, and what the node at work does, as shares of the full vehicle."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from mbd_sim_ros.batch import warm_up
from mbd_sim_ros.lab.benchmarks.machine import on_all_cores
from mbd_sim_ros.lab.benchmarks.overhead import LISTEN
from mbd_sim_ros.lab.benchmarks.start import parameters
from solver import simulation_of
from solver.errors import MbdError
from solver.files.scene import load_scene

LEVELS = ('full', 'condensed', 'kc', 'single_track')
WAYS = {'': False, '_audited': True}  # of advance()
BATCH = 200  # steps per call
FIGURES = {
    **{level: f'advance({BATCH}, audit=False) of {level}, per step [us]: median' for level in LEVELS},
    **{f'{level}_share': f'{level} over full, both of the same moment: median' for level in LEVELS[1:]},
    **{f'{level}_audited': f'the same with the account of energy after every step, of {level}' for level in LEVELS[1:]},
}
NODE_LEVELS = ('full', 'kc')
NODE_FIGURES = {
    **{f'node_{level}': f'CPU time of the node with fidelity: {level} over elapsed time [%]' for level in NODE_LEVELS},
    'node_share': 'kc over full',
}
DOMAIN = '104'  # ROS domain of its own
HEARD = 'odom:nav_msgs/msg/Odometry'
ENDING = 1.0  # s before the end of the node that are not looked at
LOOK = 0.1  # s between two looks at its clock
TICK = os.sysconf('SC_CLK_TCK')


class Levels:
    """Measures one case. Raises SceneError, SpecError or ConsistencyError on construction, StepError from round()."""

    def __init__(self, scene: str, overrides: Sequence[str]) -> None:
        self.simulations = {level: simulation_of(load_scene(scene, [*overrides, f'fidelity={level}'])) for level in LEVELS}
        for simulation in self.simulations.values():
            warm_up(simulation)
            for audit in WAYS.values():
                simulation.advance(1, audit=audit)
        self._times: dict[str, list[list[float]]] = {way: [] for way in WAYS}

    def round(self, steps: int) -> None:
        """The same steps at every level, in turns, call by call."""
        for _ in range(max(1, steps // BATCH)):
            for simulation in self.simulations.values():
                if simulation.k + 2 * BATCH > simulation.scene.steps:
                    simulation.reset()
            for way, audit in WAYS.items():
                row = []
                for simulation in self.simulations.values():
                    driven = simulation.sources.step_by_step  # what a driver takes belongs to the step
                    inputs = None if driven else simulation.source.table(simulation.k, BATCH)
                    begin = time.thread_time()
                    simulation.advance(BATCH, inputs, audit=audit)
                    row.append((time.thread_time() - begin) / BATCH * 1e6)
                self._times[way].append(row)

    def close(self) -> None:
        """Nothing to end."""

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case."""
        plain, audited = (np.array(self._times[way]) for way in WAYS)
        found = dict(zip(LEVELS, np.median(plain, axis=0).tolist(), strict=True))
        for name, times in (('share', plain), ('audited', audited)):
            shares = np.median(times[:, 1:] / times[:, :1], axis=0).tolist()
            found |= {f'{level}_{name}': share for level, share in zip(LEVELS[1:], shares, strict=True)}
        return {'h': self.simulations['full'].h, 'steps': len(plain) * BATCH, 'figures': {name: found[name] for name in FIGURES}}


class NodeLevels:
    """Measures one case: the real node paced in real time at every level for `seconds`, and a subscriber to HEARD in another process.

    publish_every: steps between messages.

    Raises what simulation_of does (ImportError without rclpy), MbdError from round().
    """

    def __init__(self, scene: str, overrides: Sequence[str], seconds: float, *, publish_every: int = 1) -> None:
        import rclpy  # noqa: F401

        for level in NODE_LEVELS:  # fills the cache, so that the node starts at once
            simulation = simulation_of(load_scene(scene, [*overrides, f'fidelity={level}']))
            warm_up(simulation)
        self._scene, self._overrides, self._seconds, self._h = scene, list(overrides), seconds, simulation.h
        self._values = {'duration': float(seconds), 'publish_every': publish_every}
        self._shares: dict[str, float] = {}

    def round(self, _: int) -> None:
        """One run of the node at each level."""
        for level in NODE_LEVELS:
            self._shares[level] = self._node(level)

    def _node(self, level: str) -> float:
        """CPU time over elapsed time of a node at work."""
        given = parameters(self._scene, [*self._overrides, f'fidelity={level}'], **self._values)
        command = [sys.executable, '-m', 'mbd_sim_ros.node.main', '--ros-args', '--log-level', 'warn', *given]
        looks: list[tuple[float, float]] = []
        with on_all_cores(), ExitStack() as running:
            environment = {**os.environ, 'ROS_DOMAIN_ID': DOMAIN}
            reader = subprocess.Popen([sys.executable, '-c', LISTEN, HEARD], env=environment)
            running.callback(reader.wait)
            running.callback(reader.terminate)
            node = subprocess.Popen(command, env=environment)
            running.callback(node.wait)
            running.callback(node.terminate)
            while node.poll() is None:
                looks.append((time.monotonic(), cpu_time(node.pid)))
                time.sleep(LOOK)
        if node.returncode:
            raise MbdError(f'the simulator ended with exit code {node.returncode}')
        last = looks[-1][0] - ENDING
        used = [look for look in looks if last - 0.8 * (self._seconds - ENDING) <= look[0] <= last]
        if len(used) < 2:
            raise MbdError(f'a run of the node of {self._seconds:g} s is too short to be measured; take --duration 10')
        return (used[-1][1] - used[0][1]) / (used[-1][0] - used[0][0])

    def close(self) -> None:
        """Nothing to end."""

    def figures(self) -> dict[str, Any]:
        """The part of the report that belongs to this case."""
        found = {f'node_{level}': 100.0 * share for level, share in self._shares.items()}
        found['node_share'] = self._shares['kc'] / self._shares['full']
        return {'h': self._h, 'steps': round(self._seconds / self._h), 'figures': {name: found[name] for name in NODE_FIGURES}}


def cpu_time(process: int) -> float:
    """CPU time of all threads of a running process [s]."""
    fields = Path(f'/proc/{process}/stat').read_text(encoding='utf-8').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / TICK
