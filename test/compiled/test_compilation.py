"""Nothing is compiled once a simulation is prepared, and nothing at all in a process that finds a filled cache.

Both need processes of their own: in this one other tests have compiled what they needed.
"""

from __future__ import annotations

import gc
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from solver.compiled.kernel import kernel

SCENE = 'car_swept_steer'
PROGRAM = """
import hashlib, json, sys
from pathlib import Path
import numba
import numpy as np
from numba.core import event
from numba.core.dispatcher import Dispatcher
compiled = event.RecordingListener()
event.register('numba:compile', compiled)
numba.njit(lambda x: x)(1)
seen = len(compiled.buffer)  # of this one: the listener does listen
from mbd_sim_ros.node.latch import Latch
from mbd_sim_ros.node.loop import Loop
from mbd_sim_ros.node.pace import Pace
from mbd_sim_ros.node.main import prepare
from solver.inputs.command_filter import CommandSource

def state():
    specialisations = sum(len(value.overloads) for name, module in sorted(sys.modules.items()) if name.startswith('solver')
                          for value in vars(module).values() if isinstance(value, Dispatcher))
    return len(compiled.buffer) - seen, specialisations

scene, simulation = prepare(sys.argv[1], [])
prepared = state()
simulation.advance(5)
simulation.advance(5, audit=False)
row = simulation.inputs.copy()
row.flags.writeable = False
simulation.advance(2, row)
table = np.repeat(row[None, :], 6, axis=0)
simulation.advance(3, table[::2])
simulation.advance(3, np.asfortranarray(table)[:3])
simulation.advance(1, table[:1].astype(np.float32))
saved = simulation.save()
simulation.advance(7)
simulation.reset()
simulation.restore(saved)
simulation.urdf()
commands = CommandSource(simulation.channels.inputs, simulation.h_ns)
latch = Latch(simulation, Pace(mode='fast'))
loop = Loop(simulation, latch, inputs=lambda values: commands.advance(*values), emit=lambda snapshot: None,
            end_ns=simulation.t_ns + 20 * simulation.h_ns)
latch.command(0, 0.3)
loop.start()
loop.done.wait(60.0)
done = state()
left = Path(sys.argv[2])  # the first process leaves its state, the second continues from it too
if not left.exists():
    left.write_bytes(simulation.save())
simulation.restore(left.read_bytes())
simulation.advance(30)
print(json.dumps({'error': str(loop.error), 'steps': loop.steps, 'seen': seen, 'prepared': prepared, 'done': done,
                  'continued': hashlib.sha256(simulation.save()).hexdigest()}))
"""  # noqa: E501


def test_an_inner_kernel_refuses_python_before_and_after_its_compilation() -> None:
    """numba would jump to address 0."""

    @kernel(inner=True)
    def one_more(x):
        return x + 1

    caller = kernel(lambda x: one_more(x))  # noqa: PLW0108
    with pytest.raises(TypeError, match='one_more is an inner kernel'):
        one_more(1)
    assert caller(1) == 2
    with pytest.raises(TypeError, match='one_more is an inner kernel'):
        one_more(1)


def test_garbage_is_collected_as_before_once_a_kernel_is_compiled() -> None:
    before = gc.get_threshold()
    assert kernel(lambda x: 2 * x)(3) == 6
    assert gc.get_threshold() == before


@pytest.fixture(scope='module')
def processes(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """What two processes report, one after the other, on the same cache."""
    left = tmp_path_factory.mktemp('left') / 'state'
    root = str(Path(__file__).parents[2])
    run = [sys.executable, '-c', PROGRAM, SCENE, str(left)]
    found = [subprocess.run(run, cwd=root, capture_output=True, text=True, check=False) for _ in range(2)]
    for process in found:
        assert process.returncode == 0, process.stderr
    return [json.loads(process.stdout) for process in found]


@pytest.mark.slow
def test_a_prepared_simulation_compiles_nothing_and_needs_no_other_specialisation(
    processes: list[dict[str, Any]],
) -> None:
    for process in processes:
        assert (process['error'], process['steps']) == ('None', 20)
        assert process['seen'] > 0
        assert process['prepared'][1] > 20
        assert process['done'] == process['prepared']


@pytest.mark.slow
def test_a_second_process_compiles_nothing(processes: list[dict[str, Any]]) -> None:
    assert processes[1]['done'][0] == 0


def test_another_process_continues_a_saved_state_bit_for_bit(processes: list[dict[str, Any]]) -> None:
    assert processes[0]['continued'] == processes[1]['continued']
