"""Data in a recording by which its run can be repeated: the inputs of every step, and the state it begins with.

`cmd_applied` holds the inputs of the step that led to an instant. If steps lie between two instants (record.every > 1,
or steps that a slow disk did not take), a message of topic `inputs_applied` at the later one holds the rows of all
steps since: Float64MultiArray, one row per step, `step` and the inputs (their names are the label of the second
dimension).
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
    """Gathers the inputs of the steps behind step `first` until the next instant that is recorded."""

    def __init__(self, names: Sequence[str], first: int) -> None:
        self._first = first
        self._label = ','.join(('step', *names))
        self._width = 1 + len(names)
        self._rows: list[tuple[int, np.ndarray]] = []
        self._count = 0
        self._templates: dict[int, tuple[bytes, int]] = {}

    def add(self, last: int, rows: np.ndarray) -> None:
        """The inputs (n, nu) of the n steps that led to step `last`."""
        if last > self._first:
            self._rows.append((last, rows))
            self._count += len(rows)

    def message(self) -> bytes | None:
        """The rows since the last that were taken, encoded; None when cmd_applied says all: one step or none."""
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
        """The rows are in the recording."""
        self._rows.clear()
        self._count = 0


def begin_of(simulation: Simulation) -> dict[str, str]:
    """Entries for the description of a recording that begins now, about its beginning."""
    begin = {'start_step': str(simulation.k)}
    if simulation.k or getattr(simulation, 'displaced', False):
        begin['start_state'] = base64.b64encode(simulation.save()).decode()
    return begin
