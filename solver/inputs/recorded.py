"""Inputs taken from a recording: as they were applied, or as somebody else measured them.

The solver depends on nothing that reads recordings: a package that does says so by an entry point of the group READERS.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.compiled.portable import clamped_spline_slopes, piecewise_cubic
from solver.dimensions import BOUND_ROUNDING
from solver.errors import SpecError, suggestion

RATE, ACCELERATION = '_rate', '_acceleration'
BRAKES = 'brake_torque'
READERS = 'solver.recordings'  # group of entry points: (path, map of inputs to BagChannels, log_times) -> Recorded


@dataclass(frozen=True, kw_only=True)
class BagChannel:
    """Place of an input in a recording: `channel` is `<topic>/<field>` as `mbd export` names its columns; the input is
    scale * value + offset, in the unit of the input.
    """

    channel: str
    scale: float = 1.0
    offset: float = 0.0


class Reach(NamedTuple):
    """Range of an input, and the sentences on one that is below `low` or above `high`."""

    low: float
    high: float
    remedy: str

    def beyond(self, values: np.ndarray) -> float | None:
        """The value of an input (n,) that is furthest beyond; None where none is."""
        off = np.maximum(
            self.low - values - BOUND_ROUNDING * abs(self.low), values - self.high - BOUND_ROUNDING * abs(self.high)
        )
        worst = int(np.argmax(off))
        return float(values[worst]) if off[worst] > 0.0 else None


class Track(NamedTuple):
    """Samples of one input."""

    t_ns: np.ndarray  # (n,) ascending
    values: np.ndarray  # (n,)


class Recorded(NamedTuple):
    """Inputs of a recording: rows of every step (h_ns > 0), or samples at instants of their own (h_ns = 0)."""

    where: str  # what error sentences call it
    h_ns: int  # step of the recorded run
    first: int  # step of the first row; it led from first * h to (first + 1) * h
    rows: Mapping[str, np.ndarray]  # input -> (n,) as applied, motions at the end of the step
    start: Mapping[str, float]  # input -> value at the beginning of the first step, where it is known
    tracks: Mapping[str, Track]  # input -> samples, when h_ns is 0
    steps: int = 0  # of the recorded run, which may have no input
    doubts: tuple[str, ...] = ()  # what of the recording was left out, merged or put in order, a sentence each


def recorded(path: str, channels: Mapping[str, BagChannel], log_times: bool = False) -> Recorded:
    """Read the inputs in a recording. log_times: see Maneuver. Raises SpecError where nobody can, and what the reader
    raises."""
    from importlib.metadata import entry_points  # not needed by those without a recording, and slow to import

    for reader in entry_points(group=READERS):
        return reader.load()(path, channels, log_times)
    raise SpecError(
        f'bag = {path}: no package that is installed reads recordings (entry points of {READERS}); install mbd_sim_ros'
    )


def _span(given: Recorded) -> tuple[int, int]:
    """First and last instant of all samples [ns], but single ones, which hold for ever. Raises SpecError where two
    inputs share no time."""
    spans = {name: (int(t[0]), int(t[-1])) for name, (t, _) in given.tracks.items() if len(t) > 1}
    if not spans:
        return 0, 0
    late, early = max(spans, key=lambda name: spans[name][0]), min(spans, key=lambda name: spans[name][1])
    begin, end = spans[late][0], spans[early][1]
    if begin > end:
        raise SpecError(
            f'{given.where}: map: {late} begins at {begin * 1e-9:.6g} s, behind the end of {early} at {end * 1e-9:.6g} '
            's: '
            'their topics have different clocks; take channels that have stamps of the same one, or log_times: true'
        )
    return min(first for first, _ in spans.values()), max(last for _, last in spans.values())


class RecordedSource:
    """Input source of a simulation: the inputs in a recording, which begins at t = 0 here.

    A run with the same step gets the same rows, bit for bit. With another step a motion goes through every recorded
    value, rate and acceleration (quintic between two instants), and a force-like input is the mean of what was held in
    the recorded steps, so its impulse is kept. Samples of others: motions by a cubic spline through them, force-like
    inputs linearly between them at the instant where the integrator balances forces; before the first and behind the
    last the value of that holds, of a single one all the time. Raises SpecError when the model lacks an input that is
    not zero in the recording, for samples without a common time, for those of a rate or an acceleration, which follow
    from the motion, for a torque of the brakes with the wrong sign, and outside of the recording.
    """

    def __init__(self, given: Recorded, input_names: Sequence[str], h_ns: int, stage: float = 1.0) -> None:
        self.given, self.names, self.h_ns, self.stage = given, tuple(input_names), h_ns, stage
        moved = lambda name: name + RATE in self.names and name + ACCELERATION in self.names  # noqa: E731
        self._motions = [name for name in self.names if moved(name)]
        companions = {name + suffix for name in self._motions for suffix in (RATE, ACCELERATION)}
        self._forces = [name for name in self.names if name not in self._motions and name not in companions]
        if given.h_ns:
            self._length_ns = given.h_ns * given.steps
            used = {name: values for name, values in given.rows.items() if np.any(values != 0.0)}
        else:
            begin, end = _span(given)
            self._tracks = {name: Track(track.t_ns - begin, track.values) for name, track in given.tracks.items()}
            self._length_ns = end - begin
            used = {name: track.values for name, track in self._tracks.items()}
            if (torque := used.get(BRAKES)) is not None and np.max(torque) <= 0.0 and np.min(torque) < 0.0:
                remedy = (
                    'nothing is braked, for it is nowhere above 0: a brake torque is positive; give it a scale below 0'
                )
                raise SpecError(f'{given.where}: map: {BRAKES}: {remedy}')
            for name in (name for name in used if name in companions):
                motion = name.removesuffix(RATE).removesuffix(ACCELERATION)
                raise SpecError(
                    f'{given.where}: map: {name}: follows from the motion {motion!r}, which can be mapped; remove this '
                    'one'
                )
            self._splines: dict[str, np.ndarray] = {}  # slopes
        for name in used:
            if name not in self.names:
                raise SpecError(f'{given.where}: the model has no input {name!r}{suggestion(name, self.names)}')
        for name in self._motions if given.h_ns else ():
            if name in given.rows and not {name + RATE, name + ACCELERATION} <= given.rows.keys():
                raise SpecError(
                    f'{given.where}: {name!r} is a motion in this model, but the recording has no rates of it'
                )
        self._same = given.h_ns == h_ns

    def require_within(self, reaches: Mapping[str, Reach]) -> None:
        """Refuse samples of others (not inputs that were applied, which were held within it then) that are beyond what
        inputs may be. Raises SpecError."""
        for name, track in ({} if self.given.h_ns else self._tracks).items():
            reach = reaches.get(name)
            worst = None if reach is None else reach.beyond(track.values)
            if reach is not None and worst is not None:
                raise SpecError(f'{self.given.where}: map: {name} = {worst:g}: {reach.remedy}; give it another scale')

    @property
    def steps(self) -> int:
        """Steps that the recording lasts for."""
        return self._length_ns // self.h_ns

    @property
    def start(self) -> np.ndarray:
        """(nu,) inputs at t = 0."""
        if self.given.h_ns and self.given.start:
            return np.array([self.given.start.get(name, 0.0) for name in self.names])
        zero = np.zeros(1, np.int64)
        return self._sampled(zero, zero, zero)[0]

    def table(self, k0: int, n: int) -> np.ndarray:
        """(n, nu) inputs of steps k0 ... k0 + n - 1."""
        if k0 < 0 or k0 + n > self.steps:
            seconds = self._length_ns * 1e-9
            raise SpecError(
                f'{self.given.where}: steps {k0} to {k0 + n - 1} are beyond its end at {seconds:g} s; set duration to '
                'that'
            )
        if self._same:
            table = np.zeros((n, len(self.names)))
            for i, name in enumerate(self.names):
                table[:, i] = self.given.rows[name][k0 : k0 + n] if name in self.given.rows else 0.0
            return table
        begin = np.arange(k0, k0 + n, dtype=np.int64) * self.h_ns
        return self._sampled(begin, begin + round(self.stage * self.h_ns), begin + self.h_ns)

    def sample(self, k: int) -> np.ndarray:
        """(nu,) inputs of step k."""
        return self.table(k, 1)[0]

    def _sampled(self, begin: np.ndarray, stage: np.ndarray, end: np.ndarray) -> np.ndarray:
        """(n, nu) inputs of steps from begin to end [ns], forces balanced at stage."""
        u = np.zeros((len(begin), len(self.names)))
        for name in self._motions:
            columns = [self.names.index(name + suffix) for suffix in ('', RATE, ACCELERATION)]
            u[:, columns] = self._motion(name, end)
        for name in self._forces:
            u[:, self.names.index(name)] = self._force(name, begin, stage, end)
        return u

    def _motion(self, name: str, t_ns: np.ndarray) -> np.ndarray:
        """(n, 3) value, rate and acceleration of a motion."""
        if not self.given.h_ns:
            return self._spline(name, t_ns)
        rows = self.given.rows
        if name not in rows:
            return np.zeros((len(t_ns), 3))
        h = self.given.h_ns * 1e-9
        nodes = np.column_stack([rows[name + suffix] for suffix in ('', RATE, ACCELERATION)])
        x, v, a = nodes[0]
        first = [self.given.start.get(name + suffix) for suffix in ('', RATE, ACCELERATION)]
        if any(value is None for value in first):  # the recording begins behind it
            first = [x - h * v + 0.5 * h * h * a, v - h * a, a]
        nodes = np.vstack([np.array(first, float), nodes]) * [1.0, h, h * h]
        at = np.minimum(t_ns // self.given.h_ns, len(nodes) - 2)
        s = (t_ns - at * self.given.h_ns) / self.given.h_ns
        (p0, v0, a0), (p1, v1, a1) = nodes[at].T, nodes[at + 1].T
        d, dv, da = p1 - p0 - v0 - 0.5 * a0, v1 - v0 - a0, a1 - a0
        c3, c4, c5 = 10.0 * d - 4.0 * dv + 0.5 * da, -15.0 * d + 7.0 * dv - da, 6.0 * d - 3.0 * dv + 0.5 * da
        value = p0 + s * (v0 + s * (0.5 * a0 + s * (c3 + s * (c4 + s * c5))))
        rate = v0 + s * (a0 + s * (3.0 * c3 + s * (4.0 * c4 + s * 5.0 * c5)))
        acceleration = a0 + s * (6.0 * c3 + s * (12.0 * c4 + s * 20.0 * c5))
        return np.column_stack([value, rate / h, acceleration / (h * h)])

    def _force(self, name: str, begin: np.ndarray, stage: np.ndarray, end: np.ndarray) -> np.ndarray:
        """(n,) values of a force-like input."""
        if not self.given.h_ns:
            if name not in self._tracks:
                return np.zeros(len(begin))
            t, values = self._tracks[name]
            return np.interp(stage.astype(float), t.astype(float), values)
        if name not in self.given.rows:
            return np.zeros(len(begin))
        values, h_ns = self.given.rows[name], self.given.h_ns
        first = np.minimum(begin // h_ns, len(values) - 1)
        last = np.clip((end - 1) // h_ns, first, len(values) - 1)
        impulse = np.concatenate([[0.0], np.cumsum(values * float(h_ns))])
        until = lambda t, row: impulse[row] + values[row] * (t - row * h_ns)  # noqa: E731
        mean = (until(end, last) - until(begin, first)) / np.maximum(end - begin, 1)
        return np.where(first == last, values[first], mean)

    def _spline(self, name: str, t_ns: np.ndarray) -> np.ndarray:
        if name not in self._tracks:
            return np.zeros((len(t_ns), 3))
        t, values = self._tracks[name]
        if len(t) == 1:
            return np.column_stack([np.full(len(t_ns), values[0]), np.zeros((len(t_ns), 2))])
        if name not in self._splines:
            self._splines[name] = clamped_spline_slopes(t * 1e-9, values)
        slopes = self._splines[name]
        inside = (t_ns >= t[0]) & (t_ns < t[-1])
        at = np.clip(t_ns, t[0], t[-1]) * 1e-9
        value, rate, acceleration = piecewise_cubic(t * 1e-9, values, slopes, at)
        return np.column_stack([value, np.where(inside, rate, 0.0), np.where(inside, acceleration, 0.0)])
