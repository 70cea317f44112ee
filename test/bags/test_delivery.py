"""The pipe between a simulation and the process that writes its recording."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from io import FileIO
from pathlib import Path

from mbd_sim_ros.bags.delivery import BUFFERS, PIECE, deliver, deliver_steps, deliveries, steps_of

ROOT = Path(__file__).parents[2]


def test_the_recording_process_is_there_without_numpy_and_solver() -> None:
    """Who begins a recording waits for it: with them it took half a second of the processor, without a fifth."""
    code = (
        'import sys, mbd_sim_ros.bags.process; print(*(n for n in sys.modules if n.split(".")[0] in ("numpy", '
        '"numba", "solver")))'
    )
    done = subprocess.run([sys.executable, '-c', code], cwd=ROOT, check=True, capture_output=True, text=True)
    assert set(done.stdout.split()) == {'solver', 'solver.disk', 'solver.errors'}


def test_what_is_delivered_comes_out_and_half_a_delivery_does_not() -> None:
    """More messages than one call of the system takes, one longer than a piece and than the pipe holds, an empty one,
    and none."""
    many = [bytes([k % 251]) * (k % 7) for k in range(2 * BUFFERS)]
    steps = [(5, [*many, None]), (7, [None, b'', b'x' * (5 * PIECE)]), (9, [])]
    outlet, inlet = os.pipe()

    def send() -> None:
        deliver(inlet, ['start', {'a': 'b'}])
        deliver_steps(inlet, steps)
        deliver_steps(inlet, [])
        os.write(inlet, b'half')  # of the sizes that begin the next
        os.close(inlet)

    sender = threading.Thread(target=send)
    sender.start()
    with FileIO(outlet) as stream:
        start, *rest = deliveries(stream)
    sender.join()
    assert (start[0], bytes(start[1])) == (['start', {'a': 'b'}], b'')
    given = [(t, [(place, data) for place, data in enumerate(messages) if data is not None]) for t, messages in steps]
    assert [list(steps_of(*one)) for one in rest] == [given, []]
