"""Whether a run stays where its level of detail holds, and the certificate of its plan (solver.levels.auto): quantities of interest within
their ranges.

What is looked at are the snapshots that are handed out, so a run that shows every tenth step is watched at every tenth.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from solver.analysis.verdict import Finding
from solver.output.snapshot import Snapshot
from solver.quantities import names, quantity
from solver.simulation import Simulation

if TYPE_CHECKING:
    from solver.levels.derived import Limit

ROWS = 64  # snapshots that are looked at together
BEYOND = 0.02  # of the range: what a run may leave it by, since maneuvers between those that were tried may


class _Watched(NamedTuple):
    limit: Limit
    curves: tuple  # the quantities of that name, of all wheels


class Envelope:
    """Follows the snapshots of a simulation: look() at each, findings(). Without a certificate it does nothing."""

    def __init__(self, simulation: Simulation) -> None:
        level = getattr(simulation, 'level', None)
        limits = [limit for limit in (level.validity if level is not None else ()) if limit.low is not None and limit.high is not None]
        known = names(simulation.channels) if limits else []
        self._watched = [
            _Watched(limit, tuple(quantity(name, simulation.channels) for name in known if name.partition('.')[0] == limit.quantity))
            for limit in limits
        ]
        self._rows: list[np.ndarray] = []
        self._times: list[int] = []
        self._worst: dict[str, tuple[float, float, float]] = {}  # quantity -> how far beyond [parts of the range], value, time [s]

    def look(self, snapshot: Snapshot) -> None:
        """Note a snapshot."""
        if not self._watched:
            return
        self._rows.append(snapshot.numbers)
        self._times.append(snapshot.t_ns)
        if len(self._rows) >= ROWS:
            self._fold()

    def findings(self, *, all_of_it: bool = True) -> list[Finding]:
        """What left its range so far, at its worst; without the last few snapshots unless all_of_it (for threads that do not look)."""
        if all_of_it:
            self._fold()
        found = []
        for limit, _ in self._watched:
            beyond, value, time = self._worst.get(limit.quantity, (0.0, 0.0, 0.0))
            if beyond <= BEYOND:
                continue
            assert limit.low is not None
            assert limit.high is not None
            side = limit.high if value > limit.high else limit.low
            name, unit = limit.quantity.replace('_', ' '), limit.unit
            text = (
                f'the run leaves its envelope: {name} is {value:.3g} {unit} at t = {time:.6g} s, valid is {limit.low:.3g} to '
                f'{limit.high:.3g} {unit} ({limit.why}); plan a scene that goes so far, or take fidelity: full'
            )
            found.append(
                Finding(quantity='envelope', value=value, limit=side, unit=unit, time=time, where=limit.quantity, required=False, text=text)
            )
        return found

    def _fold(self) -> None:
        if not self._rows:
            return
        rows = np.array(self._rows)
        for limit, curves in self._watched:
            assert limit.low is not None
            assert limit.high is not None
            for one in curves:
                values = one.of(rows[:, one.places])[:, 0]
                beyond = np.maximum(values - limit.high, limit.low - values) / (limit.high - limit.low)
                k = int(np.argmax(beyond))
                if beyond[k] > self._worst.get(limit.quantity, (0.0,))[0]:
                    self._worst[limit.quantity] = (float(beyond[k]), float(values[k]), self._times[k] * 1e-9)
        self._rows.clear()
        self._times.clear()
