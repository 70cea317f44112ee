"""Envelope of a run: the range in which its level of detail, and the certificate of its plan (solver.levels.auto),
hold: quantities of interest within their ranges, and frequencies below their limit.

The snapshots that are handed out are looked at, so a node that shows every tenth step is watched at every tenth; who
advances a run by himself asks every() how often that has to be, and no verdict depends on what else he shows or
records. The frequency is that of the travel of every wheel and of the steering wheel, in windows of WINDOW: root mean
square of the rate over that of the departure from the mean, over 2 pi. On waves of the road it is speed over
wavelength.

Whatever the level, a vehicle touches the road with nothing but its tires. One that leans over by LEANING lies on its
side or its roof soon, on parts that fall through the road. And the data of a tire end with the load FZMAX, where its
friction, stiffness and moments are held: what is more for an instant (an edge, a landing) is passed over, what a tire
carries in the mean of a WINDOW is not. States that no vehicle can be in are told with the time at which they began
(solver.analysis.impossible).
"""

from __future__ import annotations

import copy
import math
import threading
from typing import NamedTuple

import numpy as np

from solver.analysis.impossible import Impossible
from solver.checks.check import Measured
from solver.checks.level import ENVELOPE
from solver.checks.vehicle import LEANING, ROLLOVER, TIRE_LOAD
from solver.elements.tire_pacejka import TIRE_COLUMNS
from solver.findings import Finding, Limit
from solver.output.snapshot import Channels, Snapshot, layout_of, new_numbers
from solver.quantities import Quantity, names, quantity
from solver.simulation import Simulation
from solver.vehicle.size import Size, size_of
from solver.vehicle.trailer import TRAILER

ROWS = 64  # snapshots that are looked at together
# of the range: what a run may leave it by, since maneuvers between those that were tried may; of a narrow one, of
# `least`
BEYOND = 0.02
WINDOW = 1.0  # s
# s: between two looks at what has a range, and at no more than how a vehicle leans and what its tires carry
APART, SLOWLY = 5e-3, 0.02
# m, rad: root mean square of a departure that is too small to have a frequency
STILL = {'travel_': 5e-4, 'steering_wheel': 0.005}
FREQUENCY = 'frequency'


class _Worst(NamedTuple):
    """Worst departure: distance beyond a limit [parts of the range], name, value, and time [s]."""

    beyond: float = 0.0
    name: str = ''
    value: float = 0.0
    time: float = 0.0


class _Range:
    """Follows the quantities of one name, of all wheels."""

    def __init__(self, limit: Limit, channels: Channels, size: Size) -> None:
        self.limit, self._worst = limit, {1.0: _Worst(), -1.0: _Worst()}  # beyond the upper end, and the lower one
        curves = [
            quantity(name, channels, size) for name in names(channels) if name.partition('.')[0] == limit.quantity
        ]
        plain = [one for one in curves if len(one.places) == 1]  # numbers as they are shown, of all wheels at once
        self._plain = np.array([place for one in plain for place in one.places], int)
        self._others = [one for one in curves if len(one.places) > 1]
        self._least = max((one.least for one in curves), default=0.0)

    def fold(self, rows: np.ndarray, times: np.ndarray) -> None:
        if len(self._plain):
            self._look(rows[:, self._plain], times)
        for one in self._others:
            self._look(one.of(rows[:, one.places]), times)

    def _look(self, values: np.ndarray, times: np.ndarray) -> None:
        low, high = self.limit.low, self.limit.high
        assert low is not None
        assert high is not None
        name = self.limit.quantity.replace('_', ' ')
        for side, beyond in ((1.0, values - high), (-1.0, low - values)):
            beyond = beyond / max(high - low, self._least)
            for curve, k in enumerate(np.argmax(beyond, axis=0).tolist()):
                if beyond[k, curve] > self._worst[side].beyond:
                    found = _Worst(float(beyond[k, curve]), name, float(values[k, curve]), float(times[k]))
                    self._worst = self._worst | {side: found}  # a copy of this keeps its own

    @property
    def worst(self) -> tuple[_Worst, ...]:
        """The worst beyond either end. A certificate that covers one end says nothing of the other
        (solver.analysis.certificate_coverage)."""
        return tuple(self._worst.values())

    def end(self) -> None:
        pass


class _Swing(NamedTuple):
    """A motion that has a frequency."""

    name: str
    still: float
    position: Quantity
    rate: Quantity


class _Frequency:
    """Follows how fast wheels and steering wheel swing."""

    def __init__(self, limit: Limit, channels: Channels, size: Size) -> None:
        self.limit, self._worst, self._window = limit, _Worst(), WINDOW * size.time
        still_ones = {**STILL, 'travel_': STILL['travel_'] * size.length}
        self._swings = [
            _Swing(
                joint.replace('_', ' '),
                still,
                *(quantity(f'joint_states/{joint}/{of}', channels) for of in ('position', 'velocity')),
            )
            for joint in channels.joints
            for begin, still in still_ones.items()
            if joint.startswith(begin)
        ]
        self._positions = np.array([place for swing in self._swings for place in swing.position.places], int)
        self._rates = np.array([place for swing in self._swings for place in swing.rate.places], int)
        # of departures from the first sample, their squares, the squares of the rates
        self._sums = np.zeros((len(self._swings), 3))
        self._first: np.ndarray | None = None
        self._n, self._begin, self._time = 0, 0.0, 0.0

    def fold(self, rows: np.ndarray, times: np.ndarray) -> None:
        x, v = np.ascontiguousarray(rows[:, self._positions].T), np.ascontiguousarray(rows[:, self._rates].T)
        if self._first is None:
            self._first, self._begin = x[:, 0], float(times[0])
        x = x - self._first[:, None]
        self._sums = self._sums + np.stack([x.sum(axis=1), (x * x).sum(axis=1), (v * v).sum(axis=1)], axis=1)
        self._n, self._time = self._n + len(rows), float(times[-1])
        if self._time - self._begin >= self._window:
            self._close()

    def end(self) -> None:
        if self._first is not None and self._time - self._begin >= 0.5 * self._window:
            self._close()

    def _close(self) -> None:
        high = self.limit.high
        assert high is not None
        for swing, (x, xx, vv) in zip(self._swings, (self._sums / self._n).tolist(), strict=True):
            departure = math.sqrt(max(xx - x * x, 0.0))
            if departure < swing.still:
                continue
            value = math.sqrt(vv) / (2.0 * math.pi * departure)
            if value / high - 1.0 > self._worst.beyond:
                self._worst = _Worst(value / high - 1.0, f'frequency of {swing.name}', value, self._time)
        self._sums = np.zeros_like(self._sums)
        self._first, self._n = None, 0

    @property
    def worst(self) -> tuple[_Worst, ...]:
        return (self._worst,)


class _Lean:
    """Follows by how much a body leans over, from every snapshot: the cosine of the angle between its z axis and the
    road's normal."""

    def __init__(self, simulation: Simulation, body: str) -> None:
        self.name, self.normal = body, simulation.model.spec.road.normal
        begin = layout_of(simulation.channels)['pose'][0].start + 7 * simulation.channels.bodies.index(body) + 3
        self.place = slice(begin, begin + 4)
        self.least, self.time = 1.0, 0.0

    def fold(self, rows: np.ndarray, times: np.ndarray) -> None:
        x, y, z, w = rows[:, self.place].T
        a, b, c = self.normal
        cosine = 2.0 * (a * (x * z + w * y) + b * (y * z - w * x)) + c * (1.0 - 2.0 * (x * x + y * y))
        k = int(np.argmin(np.where(cosine < self.least, cosine, self.least)))
        if cosine[k] < self.least:
            self.least, self.time = float(cosine[k]), float(times[k])

    def finding(self) -> Finding | None:
        angle = math.acos(max(-1.0, self.least))
        if angle <= LEANING:
            return None
        return ROLLOVER.finding(Measured(value=angle, time=self.time, where=self.name))


class _Carried:
    """Follows what tires carry whose data have an end, from every snapshot."""

    def __init__(self, simulation: Simulation, ends: dict[str, float]) -> None:
        wheels = simulation.channels.wheels
        place, shape = layout_of(simulation.channels)['tire']
        self.names, self.ends = list(ends), np.array(list(ends.values()))
        self.places = (
            place.start + shape[1] * np.array([wheels.index(name) for name in ends]) + TIRE_COLUMNS.index('fz')
        )
        self._sum, self._n, self._begin, self._time = np.zeros(len(ends)), 0, 0.0, 0.0
        self.worst = (0.0, 0, 0.0, 0.0)  # of the end of the data; which tire, its load [N], until when [s]

    def fold(self, rows: np.ndarray, times: np.ndarray) -> None:
        loads = rows[:, self.places]
        while len(loads):
            if self._n == 0:
                self._begin = float(times[0])
            full = np.flatnonzero(times - self._begin >= WINDOW)
            n = int(full[0]) + 1 if len(full) else len(loads)
            # one behind the other, as they came: however many are looked at together
            self._sum = np.add.accumulate(np.concatenate([self._sum[None], loads[:n]]))[-1]
            self._n, self._time = self._n + n, float(times[n - 1])
            if len(full):
                self._close()
            loads, times = loads[n:], times[n:]

    def end(self) -> None:
        if self._n and self._time - self._begin >= 0.5 * WINDOW:
            self._close()

    def _close(self) -> None:
        loads = self._sum / self._n
        k = int(np.argmax(loads / self.ends))
        if loads[k] / self.ends[k] > self.worst[0]:
            self.worst = (float(loads[k] / self.ends[k]), k, float(loads[k]), self._time)
        self._sum, self._n = np.zeros(len(self.names)), 0

    def finding(self) -> Finding | None:
        part, k, load, time = self.worst
        if part <= 1.0:
            return None
        return TIRE_LOAD.finding(Measured(value=load, limit=float(self.ends[k]), time=time, where=self.names[k]))


class Envelope:
    """Follows the snapshots of a simulation: look() at each; findings() from any thread.

    Without level and certificate it follows whether a vehicle rolls over and what its tires carry, and of a mechanism
    nothing.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._lock = threading.Lock()
        self._size = _size(simulation)
        self.restart()

    def restart(self) -> None:
        """Forget what was: the run begins anew."""
        simulation = self._simulation
        level = getattr(simulation, 'level', None)
        watched: list[_Range | _Frequency] = []
        size = self._size
        for limit in level.validity if level is not None else ():
            if limit.low is not None and limit.high is not None:
                watched.append(_Range(limit, simulation.channels, size))
            elif limit.quantity == FREQUENCY and limit.high is not None and FREQUENCY not in simulation.reached:
                watched.append(_Frequency(limit, simulation.channels, size))
        with self._lock:
            self._watched = watched
            self.rows = np.zeros((ROWS, len(new_numbers(layout_of(simulation.channels)))))
            self._times, self._count = np.zeros(ROWS), 0
            self.leans = [_Lean(simulation, body) for body in _upright(simulation)]
            self.carried = [_Carried(simulation, ends)] if (ends := _ends_of_data(simulation)) else []
            self.impossible = [one] if self.leans and (one := Impossible(simulation)) else []
            self._follows = bool(self._watched or self.leans or self.carried)

    @property
    def watches(self) -> bool:
        """True where a level or a certificate has ranges that can be left."""
        return bool(self._watched)

    def every(self, h_ns: int) -> int:
        """Steps of h_ns [ns] between two snapshots to look at; 0: there is nothing to see."""
        if not self._follows:
            return 0
        return max(1, round(1e9 * self._size.time * (APART if self._watched else SLOWLY) / h_ns))

    def look(self, snapshot: Snapshot) -> None:
        """Note a snapshot."""
        if self._follows:
            self.look_at(np.array([snapshot.t_ns]), snapshot.numbers[None])

    def look_at(self, t_ns: np.ndarray, rows: np.ndarray) -> None:
        """Note the numbers (n, m) of the snapshots at n instants [ns]: as look() at each."""
        if not self._follows:
            return
        with self._lock:
            while len(rows):
                n = min(ROWS - self._count, len(rows))
                here = slice(self._count, self._count + n)
                self.rows[here], self._times[here] = rows[:n], t_ns[:n] * 1e-9
                self._count, rows, t_ns = self._count + n, rows[n:], t_ns[n:]
                if self._count == ROWS:  # together, for that takes less of a step than each when it comes
                    for one in (*self._watched, *self.impossible, *self.leans, *self.carried):
                        one.fold(self.rows, self._times)
                    self._count = 0

    def findings(self, *, ended: bool = True) -> list[Finding]:
        """Findings on quantities that left their range so far, at their worst. It changes nothing: what a run is told
        does not depend on when somebody asked.

        ended: nothing more is to come, so windows that are not full are judged as well.
        """
        with self._lock:
            present, states = [copy.copy(watched) for watched in self._watched], [*map(copy.copy, self.impossible)]
            leans, loads = [*map(copy.copy, self.leans)], [*map(copy.copy, self.carried)]
            rows, times = self.rows[: self._count].copy(), self._times[: self._count].copy()
        for one in (*present, *states, *leans, *loads) if len(rows) else ():
            one.fold(rows, times)
        found = [finding for state in states for finding in state.findings()]
        found += [rolled for lean in leans if (rolled := lean.finding())]
        for carried in loads:
            if ended:
                carried.end()
            found += [more for more in [carried.finding()] if more]
        for watched in present:
            if ended:
                watched.end()
            found += [_left(watched.limit, worst) for worst in watched.worst if worst.beyond > BEYOND]
        return found


def _left(limit: Limit, worst: _Worst) -> Finding:
    """Finding on a quantity that left its range."""
    assert limit.high is not None
    _, name, value, time = worst
    side = limit.high if limit.low is None or value > limit.high else limit.low
    unit = '' if limit.unit == '1' else f' {limit.unit}'
    valid = f'up to {limit.high:.3g}{unit}' if limit.low is None else f'from {limit.low:.3g} to {limit.high:.3g}{unit}'
    return ENVELOPE.finding(
        Measured(
            value=value, limit=side, time=time, where=limit.quantity, unit=unit.strip(),
            reason=f'the run leaves its envelope: {name} is valid '
                f'{valid}', remedy=f'The limits: {limit.why}. {ENVELOPE.remedy}',
        )
    )  # fmt: skip


def _size(simulation: Simulation) -> Size:
    """Size of a vehicle; that of a passenger car for other models."""
    model = getattr(simulation, 'model', None)
    return Size() if model is None else size_of(model.spec)


def _upright(simulation: Simulation) -> list[str]:
    """Bodies of a vehicle that ought to stay above its wheels: its chassis, and that of its trailer."""
    model = getattr(simulation, 'model', None)
    if model is None or not model.spec.tires or model.spec.chassis is None:
        return []
    return [body for body in (model.spec.chassis, TRAILER) if body in simulation.channels.bodies]


def _ends_of_data(simulation: Simulation) -> dict[str, float]:
    """Largest load [N] that the data of tires cover, of those whose data say so."""
    model = getattr(simulation, 'model', None)
    tires = () if model is None or not simulation.of_bodies else model.spec.tires
    ends = {tire.name: float(tire.data.values.get('FZMAX', 0.0)) for tire in tires}
    return {name: end for name, end in ends.items() if end > 0.0 and name in simulation.channels.wheels}
