#!/usr/bin/env python3
"""Lateness of steps in real time: the example in C beside the node, on this machine and in turns.

    python docs/tools/lateness.py [--scene car_step_steer] [--seconds 10]

The example (real_time.c) runs before the node and after it. The node publishes everything, records, is commanded 100
times a second and has a subscriber (mbd_sim_ros.lab.benchmarks.endurance, which also measures loops that do nothing and
that count on the same machine). A step is late that ends after the next one was due; the node gives its schedule up
where it is 0.2 s behind (slips), the example never does. On a busy machine the figures are of the others. Needs ROS and
a C compiler.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
from pathlib import Path

from mbd_sim_ros.lab.benchmarks.endurance import Endurance
from mbd_sim_ros.lab.benchmarks.machine import on_all_cores
from mbd_sim_ros.native import library
from mbd_sim_ros.native.kernels import target
from mbd_sim_ros.native.model import native
from solver import load_scene, simulation_of


def example(there: Path, scene: str) -> Path:
    """The example, compiled beside a library and a model of the scene."""
    made = native(simulation_of(load_scene(scene)))
    (there / f'{scene}.mbd').write_bytes(made.content)
    library.build(made.kernels, target('v3'), there / library.NAME)
    library.copy_sources(there)
    command = [library.compiler(), '-O2', 'real_time.c', '-o', 'real_time', '-L.', '-lmbd', '-lm', '-Wl,-rpath,$ORIGIN']
    subprocess.run(command, cwd=there, check=True, timeout=120)
    return there / 'real_time'


def driven(program: Path, scene: str, seconds: float) -> str:
    """Figures of the example, as one line."""
    with on_all_cores():
        done = subprocess.run(
            [str(program), str(program.parent / f'{scene}.mbd'), str(seconds)],
            capture_output=True,
            text=True,
            timeout=10.0 * seconds + 60.0,
            check=True,
        )
    late = re.search(r'late steps.*: (\S+) %', done.stdout)
    begun = re.search(r'late \[us\]: (.*)', done.stdout)
    busy = re.search(r'busy \[us\]: (.*)', done.stdout)
    assert late and begun and busy, done.stdout
    return f'late steps {late[1]} %; begun late by [us]: {begun[1]}; busy [us]: {busy[1]}'


def main() -> None:
    """Measure in turns, and print."""
    parser = argparse.ArgumentParser(description='Lateness of the example in C beside that of the node.')
    parser.add_argument('--scene', default='car_step_steer')
    parser.add_argument('--seconds', type=float, default=10.0, help='of each run')
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        program = example(Path(folder), given.scene)
        node = Endurance(given.scene, [], given.seconds, with_reader=False)
        print('in C, before:', driven(program, given.scene, given.seconds), flush=True)
        node.round(0)
        figures = node.figures()['figures']
        print('in C, after: ', driven(program, given.scene, given.seconds), flush=True)
    shown = ('late', 'slips', 'latency_p50', 'latency_p99', 'idle_before', 'idle_after', 'busy')
    print('the node:    ', '; '.join(f'{name} {figures[name]:.3g}' for name in shown))
    print('late, idle and busy: steps that ended late [%], of the node, of loops that do nothing, of loops that count;')
    print('latency: from a command to the inputs of the step that used it [ms]')


if __name__ == '__main__':
    main()
