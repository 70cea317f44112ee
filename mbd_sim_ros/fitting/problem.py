"""A fit as a problem of least squares: unknowns with what is known of them, residuals of all windows, their
derivatives."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_sim_ros import interrupts
from mbd_sim_ros.fitting import recordings, sensors
from mbd_sim_ros.fitting.car import Car
from mbd_sim_ros.fitting.driving import Inputs, Steering, drive
from mbd_sim_ros.fitting.file import FitFile, number_of
from mbd_sim_ros.fitting.noise import Noise, whitened
from mbd_sim_ros.fitting.recordings import Data
from mbd_sim_ros.fitting.runs import Driven, Job, Memory, Workers
from mbd_sim_ros.fitting.sensors import KINDS, LOOK, Sensor
from mbd_sim_ros.fitting.unknowns import grown, unknowns_of
from solver.disk import digest, sources
from solver.errors import BagError, MbdError, SpecError
from solver.validate import require

# of a difference, in widths: truncation and rounding are then both 1e-6 of a signal; ten times as much has a truncation
# of a hundred times, with which drives at the limit of the tires seem to tell what they cannot (decision 0034)
STEP = 0.005
# m/s of a passenger car: windows with a lower speed are left out; ten times as much leaves none of a town
SLOWEST = 3.0
LEAST_SECONDS = 20.0  # of windows to be fitted, of a passenger car; ten times as much refuses usual recordings
LACKING = 0.05  # part of a signal that a model lacks, before a fit has shown it; ten times as much would tell nothing
LACKING_TIME = 0.4  # s, its correlation time, of a passenger car; ten times as much takes it for an offset


class Piece(NamedTuple):
    """Samples of a channel in a window: t [s] from its begin, values; variances of the times that each is a mean of."""

    window: int
    channel: str
    t: np.ndarray
    y: np.ndarray
    spread: np.ndarray


class Problem:
    """See the module. windows: all, also those held out. unknowns: in the order of a vector x, in widths from their
    centres. noise: by channel. car: the vehicle of the file, or what moves in its place, as a Car does."""

    def __init__(
        self, file: FitFile, home: Path, *, workers: int = 0, data: Sequence[Data] | None = None, car: Any = None
    ) -> None:
        self.file, self.home = file, home
        self.car: Any = Car(file, home) if car is None else car
        size = self.car.size
        self.kinds = {
            name: sensors.require_kind(name, horizontal=one.horizontal) for name, one in file.channels.items()
        }
        self.data = {one.name: one for one in (self._read() if data is None else data)}
        slowest = SLOWEST * size.speed if file.windows.slowest is None else file.windows.slowest
        self.windows = [
            w for one in self.data.values() for w in recordings.windows(one, file.drive, file.windows, slowest)
        ]
        self.told = [line for one in self.data.values() for line in one.told]
        self.inputs = [Inputs(self.data[w.recording], file.drive, w, self.car) for w in self.windows]
        self.dt = self.inputs[0].dt if self.inputs else 10.0 * self.car.h
        self.unknowns, self._steering, self._sensors = every = unknowns_of(file, self.car, self.kinds)
        self.pieces = self._pieces({name: every.lead(name, LOOK * size.time) for name in file.channels})
        self.names = [u.name for u in self.unknowns]
        self._factors: dict[tuple[int, str], np.ndarray] = {}
        self.reset_noise()
        self._workers = None
        if workers > 1 and file.level != 'single_track':  # whose runs are shorter than their way to a process
            self._workers = Workers(workers, _driver, (file, home, [*self.data.values()]))
        self.undriven: set[int] = set()  # windows that are left out because the vehicle cannot drive them
        self.runs = 0  # simulations of all windows so far
        self.memory: Memory | None = None

    # -- what is given ------------------------------------------------------------------------------------------------

    def _read(self) -> list[Data]:
        file, found = self.file, []
        needed = list(dict.fromkeys((*file.drive.channels, *(c.channel for c in file.channels.values()))))
        for name, one in file.recordings.items():
            place = self.home / one.file if not Path(one.file).is_absolute() else Path(one.file)
            if not place.exists():
                raise BagError(f'recordings.{name}.file = {one.file}: no such file or directory beside the fit')
            names = one.mapping or file.mapping
            file_of_names = self.home / names if names else None
            found.append(recordings.load(name, one, place, file_of_names, needed, self.car.size.time))
        return found

    def require_enough(self) -> None:
        """Refuse a fit without recordings that are held out, or with too little to fit. Raises BagError."""
        if not any(one.use == 'held_out' for one in self.file.recordings.values()):
            raise BagError(
                'recordings: none is held out, so nothing would judge the result; write use: held_out under one that '
                'the fit does not see'
            )
        for use in ('fit', 'held_out'):
            seconds = sum(self.windows[k].last - self.windows[k].first for k in self.of(use))
            least = LEAST_SECONDS * self.car.size.time * (1.0 if use == 'fit' else 0.25)
            if seconds < least:
                what = 'to fit' if use == 'fit' else 'held out'
                raise BagError(
                    f'recordings: {seconds:.3g} s are left {what}, and {least:.3g} s are needed; give longer '
                    'recordings, or shorter windows' + _why(self.told)
                )

    def _pieces(self, lead: Mapping[str, float]) -> list[Piece]:
        """Samples that are compared. lead [s]: by which a sensor may be early. In the last of a window it shows motions
        after its end, which are not driven; beside the motion of the end they would say that it is late."""
        found = []
        for k, window in enumerate(self.windows):
            for name, channel in self.file.channels.items():
                track = self.data[window.recording].tracks[channel.channel]
                keep = (track.t >= window.first) & (track.t <= window.last)
                t, y, spread = _means(track.t[keep] - window.begin, track.y[keep], self.dt)
                inside = t <= self.inputs[k].t[-1] - lead[name]
                if inside.sum() >= 4:
                    found.append(Piece(k, name, t[inside], y[inside], spread[inside]))
        return found

    def _first_noise(self, name: str) -> Noise:
        """Before anything is fitted: noise as given or as the recording has it, and a discrepancy of a few percent."""
        kind, channel = KINDS[self.kinds[name]], self.file.channels[name]
        mine = [p for p in self.pieces if p.channel == name]
        values = np.concatenate([p.y for p in mine]) if mine else np.zeros(1)
        jumps = np.concatenate([np.diff(p.y, 2) for p in mine]) if mine else np.zeros(1)
        seen = float(np.sqrt(np.mean(jumps**2) / 6.0))
        if channel.noise is not None:
            noise = number_of(channel.noise, f'channels.{name}: noise', kind.unit)
            require(noise > 0.0, 'channels', f'{name}.noise', noise, 'must be > 0')
        else:
            noise = max(min(kind.noise * grown(kind.unit, self.car), max(seen, 1e-9)), 1e-9)
        # of a car in a steady circle the model lacks a part of the signal, not of its changes; a speed is followed
        about = float(np.mean(values)) if self.kinds[name] in sensors.AROUND else 0.0
        size = float(np.sqrt(np.mean((values - about) ** 2)))
        return Noise(noise, LACKING * size + 1e-12, LACKING_TIME * self.car.size.time)

    # -- vectors ------------------------------------------------------------------------------------------------------

    @property
    def start(self) -> np.ndarray:
        """The vector of all centres."""
        return np.zeros(len(self.unknowns))

    def values(self, x: np.ndarray) -> dict[str, float]:
        """Values of all unknowns, by name."""
        return {u.name: u.centre + u.width * float(v) for u, v in zip(self.unknowns, x, strict=True)}

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds of a vector."""
        low = np.array([(u.low - u.centre) / u.width for u in self.unknowns])
        high = np.array([(u.high - u.centre) / u.width for u in self.unknowns])
        return low, high

    @property
    def prior(self) -> np.ndarray:
        """(n,) weights of what is known before: widths over sd, squared."""
        return np.array([(u.width / u.sd) ** 2 if math.isfinite(u.sd) else 0.0 for u in self.unknowns])

    def _car_values(self, values: Mapping[str, float]) -> dict[str, float]:
        return {u.part: values[u.name] for u in self.unknowns if u.of == 'vehicle'}

    def linearize(self, x: np.ndarray) -> None:
        """Derive a level that is linear in the numbers at this vector."""
        values = self.values(x)
        widths = {u.part: u.width for u in self.unknowns if u.of == 'vehicle'}
        self.car.linearize(self._car_values(values), widths)
        self.close()

    # -- runs ---------------------------------------------------------------------------------------------------------

    def motions(self, x: np.ndarray, which: Sequence[int]) -> list[np.ndarray]:
        """Motions of windows at a vector. Raises MbdError."""
        found = self.many([x], which)[0]
        if isinstance(found, MbdError):
            raise found
        return found

    def many(self, points: Sequence[np.ndarray], which: Sequence[int]) -> list[list[np.ndarray] | MbdError]:
        """Motions at many vectors, in as many processes as there are; an error where there is none."""
        jobs = [self._job(x, which) for x in points]
        ends = np.cumsum([0] + [self.inputs[k].chunks + 1 for k in which])
        rows: list[Any] = [None if self.memory is None else self.memory.read(job.key) for job in jobs]
        todo = [i for i, one in enumerate(rows) if one is None]
        self.runs += len(todo)
        for i, one in zip(todo, self._driven([jobs[i] for i in todo]), strict=True):
            rows[i] = one
            if self.memory is not None and not isinstance(one, MbdError):
                self.memory.write(jobs[i].key, one)
        return [one if isinstance(one, MbdError) else [one[a:b] for a, b in itertools.pairwise(ends)] for one in rows]

    def _job(self, x: np.ndarray, which: Sequence[int]) -> Job:
        values = self.values(x)
        steering = self._steering | {u.part: values[u.name] for u in self.unknowns if u.of == 'steering'}
        return Job(self._car_values(values), Steering(**steering), tuple(which), self.car.centre)

    def _driven(self, jobs: Sequence[Job]) -> Iterator[Driven]:
        if self._workers is not None and len(jobs) > 1:
            yield from self._workers.drive(jobs)
            return
        for job in jobs:
            interrupts.check()
            yield self.drive(job)

    def close(self) -> None:
        """End the processes."""
        if self._workers is not None:
            self._workers.close()

    def drive(self, job: Job) -> Driven:
        """Motions of the windows of a job, one behind the other, or why there are none."""
        try:
            inputs = [self.inputs[k] for k in job.which]
            if isinstance(self.car, Car):
                simulation = self.car.simulation(job.car)
                return np.concatenate([drive(simulation, one, job.steering) for one in inputs])
            return np.concatenate(self.car.driven(job.car, inputs, job.steering))
        except MbdError as error:
            return error

    def remember(self, directory: Path) -> None:
        """Keep motions in a directory, and take those that are there."""
        parts = [self.car.text, repr(self.file.windows), repr(self.file.drive), repr(self.dt), sources()]
        for one in self.data.values():
            parts.append(one.name)
            parts += [digest(t.t.tobytes(), t.y.tobytes()).hex() for _, t in sorted(one.tracks.items())]
        self.memory = Memory(directory, digest(*parts).hex())

    def signals(self, x: np.ndarray, motions: Sequence[np.ndarray], which: Sequence[int]) -> list[np.ndarray]:
        """Predicted values of the pieces of windows, in their order."""
        values, place = self.values(x), {k: i for i, k in enumerate(which)}
        pieces, found = [p for p in self.pieces if p.window in place], {}
        for name in self.file.channels:
            own = [p for p in pieces if p.channel == name]
            driven = [motions[place[p.window]] for p in own]
            shown = self._made(name, values).shown(driven, self.dt, [p.t for p in own], [p.spread for p in own])
            found[name] = iter(shown)
        return [next(found[p.channel]) for p in pieces]

    def _made(self, name: str, values: Mapping[str, float]) -> Sensor:
        channel = self.file.channels[name]
        found = self._sensors[name] | {u.part: values[u.name] for u in self.unknowns if u.of == name}
        com = self.car.com
        return Sensor(self.kinds[name], channel.at or com, com, channel.yaw, horizontal=channel.horizontal, **found)

    def of(self, use: str) -> list[int]:
        """Windows of a use."""
        return [k for k, w in enumerate(self.windows) if w.use == use and k not in self.undriven]

    def leave_out_undriven(self, x: np.ndarray | None = None) -> bool:
        """Leave out, and name, the windows that the vehicle as it is given cannot drive: it spins there, or a wheel
        does. x: with its steering and sensors; left out: those of the start. True where there is any."""
        x = self.start if x is None else x
        every = [*self.of('fit'), *self.of('held_out')]
        if not every or not isinstance(self.many([x], every)[0], MbdError):
            return False
        for k in every:
            error = self.many([x], [k])[0]
            if isinstance(error, MbdError):
                window = self.windows[k]
                self.undriven.add(k)
                why = str(error).partition(';')[0]
                self.told.append(
                    f'{window.recording}: {window.first:.2f} to {window.last:.2f} s are left out: the vehicle as it is '
                    f'given cannot drive them ({why})'
                )
        if len(self.undriven) == len(self.windows):
            raise BagError(
                'recordings: the vehicle as it is given can drive none of the windows; check what drives it, and the '
                f'units of its channels{_why(self.told)}'
            )
        self.pieces = [p for p in self.pieces if p.window not in self.undriven]
        self._factors = {}  # by place among the pieces
        return True

    def residuals(self, x: np.ndarray, which: Sequence[int], motions: Sequence[np.ndarray] | None = None) -> np.ndarray:
        """Measured less predicted, of all pieces of windows one behind the other. Raises MbdError."""
        motions = self.motions(x, which) if motions is None else motions
        at = set(which)
        pieces = [p for p in self.pieces if p.window in at]
        return np.concatenate(
            [p.y - s for p, s in zip(pieces, self.signals(x, motions, which), strict=True)] or [np.zeros(0)]
        )

    def jacobian(
        self, x: np.ndarray, which: Sequence[int], motions: Sequence[np.ndarray], only: Sequence[int] | None = None,
        step: float = STEP, central: bool = True,
    ) -> np.ndarray:  # fmt: skip
        """(samples, n) derivatives of the predicted values by the vector: central differences, or one-sided ones, of
        runs for those that need them and of the sensors alone for the others. Raises MbdError."""
        columns = range(len(self.unknowns)) if only is None else only
        base = np.concatenate(self.signals(x, motions, which))
        J = np.zeros((base.size, len(self.unknowns)))
        low, high = self.bounds
        asked: list[tuple[int, float]] = []
        for j in columns:
            for sign in (1.0, -1.0):
                moved = x[j] + sign * step
                there = low[j] <= moved <= high[j] and (central or sign > 0.0 or asked[-1][1] == 0.0)
                asked.append((j, sign * step if there else 0.0))
        points = [_moved(x, j, d) for j, d in asked if self.unknowns[j].runs and d]
        found = iter(self.many(points, which))
        sides: dict[int, list[tuple[float, np.ndarray]]] = {j: [] for j in columns}
        failed: dict[int, MbdError] = {}
        for j, d in asked:
            if not d:
                sides[j].append((0.0, base))
            elif self.unknowns[j].runs:
                rows = next(found)
                if isinstance(rows, MbdError):  # no vehicle has this number: the other side serves
                    failed[j] = rows
                    sides[j].append((0.0, base))
                else:
                    sides[j].append((d, np.concatenate(self.signals(_moved(x, j, d), rows, which))))
            else:
                sides[j].append((d, np.concatenate(self.signals(_moved(x, j, d), motions, which))))
        for j in [j for j in failed if not central and sides[j][1][0] == 0.0 and low[j] <= x[j] - step]:
            rows = self.many([_moved(x, j, -step)], which)[0]
            if not isinstance(rows, MbdError):
                sides[j][1] = -step, np.concatenate(self.signals(_moved(x, j, -step), rows, which))
        for j, ((above, a), (below, b)) in sides.items():
            if above == below:
                raise failed.get(j) or SpecError(f'{self.unknowns[j].name}: cannot move between its bounds')
            J[:, j] = (a - b) / (above - below)
        return J

    # -- weights ------------------------------------------------------------------------------------------------------

    def reset_noise(self) -> None:
        """Weight residuals as before any fit."""
        self.set_noise({name: self._first_noise(name) for name in self.file.channels})

    def set_noise(self, noise: Mapping[str, Noise]) -> None:
        """Weight residuals by these from now on."""
        self.noise = dict(noise)
        self._factors = {}

    def white(self, values: np.ndarray, which: Sequence[int]) -> np.ndarray:
        """Residuals, or columns of derivatives, of windows with variance 1."""
        at, begin, parts = set(which), 0, []
        for k, p in enumerate(self.pieces):
            if p.window in at:
                if (k, p.channel) not in self._factors:
                    self._factors[k, p.channel] = self.noise[p.channel].factor(p.t)
                parts.append(whitened(self._factors[k, p.channel], values[begin : begin + p.t.size]))
                begin += p.t.size
        return np.concatenate(parts) if parts else np.zeros(0)

    def split(self, values: np.ndarray, which: Sequence[int]) -> dict[str, list[tuple[np.ndarray, np.ndarray]]]:
        """Values of windows by channel: (times, values) of every piece."""
        at, begin = set(which), 0
        found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {name: [] for name in self.file.channels}
        for p in self.pieces:
            if p.window in at:
                found[p.channel].append((p.t, values[begin : begin + p.t.size]))
                begin += p.t.size
        return found

    def rows_of(self, which: Sequence[int]) -> np.ndarray:
        """(samples,) window of every sample."""
        at = set(which)
        return np.concatenate(
            [np.full(p.t.size, p.window) for p in self.pieces if p.window in at] or [np.zeros(0, int)]
        )


def _driver(file: FitFile, home: Path, data: Sequence[Data]) -> Callable[[Job], Driven]:
    return Problem(file, home, data=data).drive


def _moved(x: np.ndarray, j: int, by: float) -> np.ndarray:
    found = x.copy()
    found[j] += by
    return found


def _means(t: np.ndarray, y: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means over intervals of dt [s] of times and values, and the variance of the times; a signal that is not sampled
    more finely stays."""
    if t.size < 2:
        return t, y, np.zeros(t.size)
    bins = np.floor(t / dt).astype(int)
    first = np.flatnonzero(np.concatenate([[True], np.diff(bins) != 0]))
    count = np.diff(np.concatenate([first, [t.size]]))
    middle = np.add.reduceat(t, first) / count
    spread = np.add.reduceat((t - np.repeat(middle, count)) ** 2, first) / count
    return middle, np.add.reduceat(y, first) / count, spread


def _why(told: Sequence[str]) -> str:
    return f'; left out: {"; ".join(told[:3])}{" and more" if len(told) > 3 else ""}' if told else ''
