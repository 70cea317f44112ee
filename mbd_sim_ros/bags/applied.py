"""Data in a recording with which its run can be repeated: the inputs of every step, and the state at the beginning.

The topic `cmd_applied` holds the inputs of the step that led to a recorded instant. Between two recorded instants there
may be several steps (record.every > 1, or a disk that is too slow). Then a message of the topic `inputs_applied` at the
later instant holds the inputs of all these steps: a Float64MultiArray with one row per step, of `step` and the inputs.
Their names are the label of its second dimension.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mbd_sim_ros.messages.cdr import template
from mbd_sim_ros.messages.topics import ARRAY

if TYPE_CHECKING:
    from solver.simulation import Simulation


class Applied:
    """Gathers the inputs of the steps after step `first`, until the next recorded instant. names: of the inputs."""

    def __init__(self, names: Sequence[str], first: int) -> None:
        self._first = first
        self._label = ','.join(('step', *names))
        self._width = 1 + len(names)
        self._rows: list[tuple[int, np.ndarray]] = []
        self._count = 0
        self._templates: dict[int, tuple[bytes, int]] = {}

    def add(self, last: int, rows: np.ndarray) -> None:
        """Add the inputs (n, nu) of the n steps up to step `last`."""
        if last > self._first:
            self._rows.append((last, rows))
            self._count += len(rows)

    def message(self) -> bytes | None:
        """Encoded message of all rows since taken(); None for one step or none, when cmd_applied holds the inputs."""
        count = self._count
        if count < 2:
            return None
        if count not in self._templates:
            dimensions = [
                {'label': 'step', 'size': count, 'stride': count * self._width},
                {'label': self._label, 'size': self._width, 'stride': self._width},
            ]
            made = template(ARRAY, {'layout': {'dim': dimensions}, 'data': np.zeros(count * self._width)})
            self._templates[count] = made.data, made.places['data'].offset
        data, offset = self._templates[count]
        table = np.empty((count, self._width))
        at = 0
        for last, rows in self._rows:
            table[at : at + len(rows), 0] = np.arange(last - len(rows) + 1, last + 1)
            table[at : at + len(rows), 1:] = rows
            at += len(rows)
        return data[:offset] + table.tobytes()

    def taken(self) -> None:
        """Forget all rows: they are in the recording."""
        self._rows.clear()
        self._count = 0


def begin_of(simulation: Simulation) -> dict[str, str]:
    """Entries of the description of a recording that begins now: step number, and the state unless it is the scene's
    start."""
    begin = {'start_step': str(simulation.k)}
    if simulation.k or getattr(simulation, 'displaced', False):
        begin['start_state'] = base64.b64encode(simulation.save()).decode()
    return begin
