"""Signals: functions of time with exact first and second derivatives.

A signal gives value, rate and acceleration, the latter two by the chain rule from the same expression (`Jet`), because
a prescribed motion needs all three and they must belong together. Signals are twice continuously differentiable unless
their docstring says otherwise: corners are replaced by the quintic step s(x) = x^3 (10 - 15 x + 6 x^2) or by its
integral.

The file is long because all kinds of signals stand together, each with its derivatives.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from solver.compiled.elementary import cos, sin
from solver.compiled.portable import clamped_spline_slopes, piecewise_cubic
from solver.dimensions import Angle, Frequency, Time
from solver.errors import SpecError


class Jet(NamedTuple):
    """A function of time with its first two derivatives; arrays of one shape."""

    value: np.ndarray
    rate: np.ndarray
    acceleration: np.ndarray

    def __add__(self, other: Jet) -> Jet:  # type: ignore[override]
        return Jet(*(a + b for a, b in zip(self, other, strict=True)))

    def times(self, other: Jet) -> Jet:
        """Product by Leibniz's rule."""
        return Jet(
            self.value * other.value,
            self.rate * other.value + self.value * other.rate,
            self.acceleration * other.value + 2.0 * self.rate * other.rate + self.value * other.acceleration,
        )

    def scaled(self, factor: float) -> Jet:
        """Product with a constant."""
        return Jet(*(factor * a for a in self))

    def shifted(self, offset: float) -> Jet:
        """Sum with a constant."""
        return self._replace(value=self.value + offset)

    def sine(self) -> Jet:
        """sin of the function, by the chain rule."""
        s, c = sin(self.value), cos(self.value)
        return Jet(s, c * self.rate, c * self.acceleration - s * self.rate * self.rate)


def quintic(x):
    """The quintic step of x in [0, 1], a number or an array."""
    return x * x * x * (10.0 + x * (6.0 * x - 15.0))


def smooth_step(t: np.ndarray, start: float, rise: float) -> Jet:
    """0 before start, 1 after start + rise, quintic between: C2."""
    x = np.clip((t - start) / rise, 0.0, 1.0)
    return Jet(
        quintic(x),
        30.0 * x * x * (1.0 - x) * (1.0 - x) / rise,
        60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / (rise * rise),
    )


def smooth_corner(t: np.ndarray, at: float, blend: float) -> Jet:
    """max(0, t - at) with the corner rounded over `blend` seconds centred on it (integral of the quintic step): C3."""
    if blend == 0.0:
        return Jet(np.maximum(t - at, 0.0), np.where(t > at, 1.0, 0.0), np.zeros_like(t))
    x = np.clip((t - at) / blend + 0.5, 0.0, 1.0)
    step = smooth_step(t, at - 0.5 * blend, blend)
    area = blend * x * x * x * x * (2.5 + x * (x - 3.0))
    return Jet(area + np.maximum(t - (at + 0.5 * blend), 0.0), step.value, step.rate)


def smooth_clock(t: np.ndarray, start: float, stop: float, blend: float) -> Jet:
    """Time that runs from 0 at start to stop - start at stop and stands still outside, with rounded corners: C3."""
    return smooth_corner(t, start, blend) + smooth_corner(t, stop, blend).scaled(-1.0)


def _positive(signal: object, *fields: str) -> None:
    for name in fields:
        if not getattr(signal, name) > 0.0:
            raise SpecError(f'{name} = {getattr(signal, name):g}: must be > 0')


def _not_negative(signal: object, *fields: str) -> None:
    for name in fields:
        if not getattr(signal, name) >= 0.0:
            raise SpecError(f'{name} = {getattr(signal, name):g}: must be >= 0')


@dataclass(frozen=True, kw_only=True)
class Constant:
    """The same value at all times. A bare number in a file means this."""

    kind: Literal['constant'] = 'constant'
    value: float = 0.0

    def jet(self, t: np.ndarray) -> Jet:
        """Value, rate and acceleration at the times t [s]."""
        return Jet(np.full_like(t, self.value), np.zeros_like(t), np.zeros_like(t))


@dataclass(frozen=True, kw_only=True)
class Ramp:
    """From `initial`, changing at `slope` per second from `start` on until `final` is reached (never, when left out).

    Both corners are rounded over `blend` seconds; blend 0 gives sharp corners (C0: for force-like inputs only).
    """

    kind: Literal['ramp'] = 'ramp'
    slope: float
    start: Time = 0.0
    initial: float = 0.0
    final: float | None = None
    blend: Time = 0.1

    def __post_init__(self) -> None:
        _not_negative(self, 'blend')
        if self.final is not None and (self.final - self.initial) * self.slope <= 0.0:
            raise SpecError(f'final = {self.final:g}: is never reached from {self.initial:g} with slope {self.slope:g}')
        if self.final is not None and (self.final - self.initial) / self.slope < self.blend:
            raise SpecError(
                f'blend = {self.blend:g}: must not exceed the duration of the ramp '
                f'({(self.final - self.initial) / self.slope:g} s)'
            )

    def jet(self, t: np.ndarray) -> Jet:
        """Value, rate and acceleration at the times t [s]."""
        stop = np.inf if self.final is None else self.start + (self.final - self.initial) / self.slope
        if np.isinf(stop):
            clock = smooth_corner(t, self.start, self.blend)
        else:
            clock = smooth_clock(t, self.start, stop, self.blend)
        return clock.scaled(self.slope).shifted(self.initial)


@dataclass(frozen=True, kw_only=True)
class Step:
    """From `initial` to `value`, beginning at `start`, within `rise` seconds (step steer of ISO 7401)."""

    kind: Literal['step'] = 'step'
    value: float
    initial: float = 0.0
    start: Time = 1.0
    rise: Time = 0.2

    def __post_init__(self) -> None:
        _positive(self, 'rise')

    def jet(self, t: np.ndarray) -> Jet:
        """Value, rate and acceleration at the times t [s]."""
        return smooth_step(t, self.start, self.rise).scaled(self.value - self.initial).shifted(self.initial)


@dataclass(frozen=True, kw_only=True)
class Sine:
    """amplitude sin(2 pi frequency s + phase) + offset, where s is time from `start` on, for `cycles` periods (all
    time, when left out).

    Starting and stopping are rounded over `blend` seconds by letting the phase gather speed.
    """

    kind: Literal['sine'] = 'sine'
    amplitude: float
    frequency: Frequency
    phase: Angle = 0.0
    offset: float = 0.0
    start: Time = 0.0
    cycles: float | None = None
    blend: Time = 0.1

    def __post_init__(self) -> None:
        _positive(self, 'frequency', *(['cycles'] if self.cycles is not None else []))
        _not_negative(self, 'blend')
        if self.cycles is not None and self.cycles / self.frequency < self.blend:
            raise SpecError(
                f'blend = {self.blend:g}: must not exceed the duration of the sine ({self.cycles / self.frequency:g} s)'
            )

    def jet(self, t: np.ndarray) -> Jet:
        """Value, rate and acceleration at the times t [s]."""
        if self.cycles is None:
            clock = smooth_corner(t, self.start, self.blend)
        else:
            clock = smooth_clock(t, self.start, self.start + self.cycles / self.frequency, self.blend)
        wave = clock.scaled(2.0 * np.pi * self.frequency).shifted(self.phase).sine()
        return wave.scaled(self.amplitude).shifted(self.offset)


@dataclass(frozen=True, kw_only=True)
class SineWithDwell:
    """One period of a sine that stands still for `dwell` seconds at its second peak (ISO 19365, FMVSS 126: 0.7 Hz, 0.5
    s).

    The four corners of the phase are rounded over `blend` seconds, centred on the nominal instants.
    """

    kind: Literal['sine_with_dwell'] = 'sine_with_dwell'
    amplitude: float
    frequency: Frequency = 0.7
    dwell: Time = 0.5
    start: Time = 1.0
    blend: Time = 0.1

    def __post_init__(self) -> None:
        _positive(self, 'frequency')
        _not_negative(self, 'dwell', 'blend')
        if self.blend > min(0.25 / self.frequency, self.dwell):
            raise SpecError(
                f'blend = {self.blend:g}: must not exceed the dwell nor a quarter period ({0.25 / self.frequency:g} s)'
            )

    def jet(self, t: np.ndarray) -> Jet:
        """Value, rate and acceleration at the times t [s]."""
        peak = self.start + 0.75 / self.frequency
        again = peak + self.dwell
        clock = smooth_clock(t, self.start, peak, self.blend) + smooth_clock(
            t, again, again + 0.25 / self.frequency, self.blend
        )
        return clock.scaled(2.0 * np.pi * self.frequency).sine().scaled(self.amplitude)


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Swept sine, repeated: each sweep lasts `duration` seconds and runs from `frequency` to `final_frequency`, linear
    in time.

    The amplitude goes linearly from `amplitude` to `final_amplitude` over all sweeps together. Each sweep fades in and
    out over `fade` seconds (default: half a period of its lowest frequency, at most half the sweep); zero before and
    after.
    """

    kind: Literal['sweep'] = 'sweep'
    amplitude: float
    final_amplitude: float | None = None
    frequency: Frequency
    final_frequency: Frequency | None = None
    duration: Time
    repeats: int = 1
    start: Time = 1.0
    fade: Time | None = None

    def __post_init__(self) -> None:
        _positive(
            self,
            'frequency',
            'duration',
            'repeats',
            *(f for f in ('final_frequency', 'fade') if getattr(self, f) is not None),
        )
        if self.fade is not None and self.fade > 0.5 * self.duration:
            raise SpecError(
                f'fade = {self.fade:g}: must not exceed half the duration of a sweep ({0.5 * self.duration:g} s)'
            )

    def jet(self, t: np.ndarray) -> Jet:
        """Value, rate and acceleration at the times t [s]."""
        last = self.frequency if self.final_frequency is None else self.final_frequency
        fade = min(0.5 / min(self.frequency, last), 0.5 * self.duration) if self.fade is None else self.fade
        since = np.clip(t - self.start, 0.0, self.repeats * self.duration)
        index = np.minimum(np.floor(since / self.duration), self.repeats - 1.0)
        s = since - index * self.duration
        one, none = np.ones_like(s), np.zeros_like(s)
        chirp = 2.0 * np.pi * (last - self.frequency) / self.duration
        phase = Jet(
            2.0 * np.pi * self.frequency * s + 0.5 * chirp * s * s,
            2.0 * np.pi * self.frequency + chirp * s,
            chirp * one,
        )
        growth = (
            0.0
            if self.final_amplitude is None
            else (self.final_amplitude - self.amplitude) / (self.repeats * self.duration)
        )
        size = Jet(self.amplitude + growth * since, growth * one, none)
        window = smooth_step(s, 0.0, fade).times(smooth_step(s, self.duration - fade, fade).scaled(-1.0).shifted(1.0))
        return size.times(phase.sine()).times(window)


@dataclass(frozen=True, kw_only=True)
class Table:
    """Through the points [[t, value], ...], t increasing; the end values hold outside.

    cubic: spline with horizontal ends, C2 inside, C1 at the two ends; it swings beyond points that jump (0, 0, 1, 1 at
    0, 1, 1.3, 3 s: from -0.39 to 1.79). linear: C0, for force-like inputs only; it stays between its points.
    """

    kind: Literal['table'] = 'table'
    points: tuple[tuple[float, float], ...]
    interpolation: Literal['cubic', 'linear'] = 'cubic'

    def __post_init__(self) -> None:
        if len(self.points) < 2:
            raise SpecError(f'points: {len(self.points)} given, a table needs at least two [t, value] points')
        for k in range(1, len(self.points)):
            if not self.points[k][0] > self.points[k - 1][0]:
                raise SpecError(f'points[{k}][0] = {self.points[k][0]:g}: must be greater than the time before it')

    def jet(self, t: np.ndarray) -> Jet:
        """Value, rate and acceleration at the times t [s]."""
        x, y, slopes = self._nodes
        inside = (t >= x[0]) & (t < x[-1])
        if self.interpolation == 'linear':
            slope = np.append(np.diff(y) / np.diff(x), 0.0)[np.clip(np.searchsorted(x, t, 'right') - 1, 0, len(x) - 1)]
            return Jet(np.interp(t, x, y), np.where(inside, slope, 0.0), np.zeros_like(t))
        value, rate, acceleration = piecewise_cubic(x, y, slopes, np.clip(t, x[0], x[-1]))
        return Jet(value, np.where(inside, rate, 0.0), np.where(inside, acceleration, 0.0))

    @cached_property
    def _nodes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(times, values, slopes of the spline), (n,) each; the slopes of a long table take as long as many steps."""
        x, y = np.array(self.points).T
        return x, y, clamped_spline_slopes(x, y) if self.interpolation == 'cubic' else np.zeros_like(y)


@dataclass(frozen=True, kw_only=True)
class Sum:
    """The sum of other signals."""

    kind: Literal['sum'] = 'sum'
    terms: tuple[float | Constant | Ramp | Step | Sine | SineWithDwell | Sweep | Table | Sum | Mapped, ...]

    def jet(self, t: np.ndarray) -> Jet:
        """Value, rate and acceleration at the times t [s]."""
        total = Constant().jet(t)
        for term in self.terms:
            total = total + signal(term).jet(t)
        return total


@dataclass(frozen=True, kw_only=True)
class Mapped:
    """Another signal behind a map: the polynomial through the points [[x, y], ...], x increasing; it is as smooth as
    that signal.

    Points that lie closer together towards both ends (like the zeros of a Chebyshev polynomial) keep it from swinging
    between them. A scene that asks it for more than 5 % of their width beyond them is refused.
    """

    kind: Literal['mapped'] = 'mapped'
    of: float | Constant | Ramp | Step | Sine | SineWithDwell | Sweep | Table | Sum | Mapped
    points: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        if not 2 <= len(self.points) <= 64:
            raise SpecError(f'points: {len(self.points)} given, a map needs 2 to 64 [x, y] points')
        for k in range(1, len(self.points)):
            if not self.points[k][0] > self.points[k - 1][0]:
                raise SpecError(f'points[{k}][0] = {self.points[k][0]:g}: must be greater than the x before it')

    def jet(self, t: np.ndarray) -> Jet:
        """Value, rate and acceleration at the times t [s]."""
        return self.of_jet(signal(self.of).jet(t))

    def of_jet(self, x: Jet) -> Jet:
        """The polynomial in Newton's form (divided differences) at x, by Horner's scheme.

        The points are taken in Leja's order, each as far as possible from those before it: without it the differences
        of many points lose their digits (L. Reichel, Newton interpolation at Leja points, BIT 30 (1990) 332).
        """
        nodes, differences = (list(column) for column in zip(*_spread(self.points), strict=True))
        for order in range(1, len(nodes)):
            for k in range(len(nodes) - 1, order - 1, -1):
                differences[k] = (differences[k] - differences[k - 1]) / (nodes[k] - nodes[k - order])
        result = Jet(*(np.zeros_like(x.value) for _ in range(3))).shifted(differences[-1])
        for node, difference in zip(reversed(nodes[:-1]), reversed(differences[:-1]), strict=True):
            result = result.times(x.shifted(-node)).shifted(difference)
        return result


def _spread(points: tuple[tuple[float, float], ...]) -> list[tuple[float, float]]:
    """Points in Leja's order of their x."""
    left = sorted(points, key=lambda p: -abs(p[0]))
    chosen = [left.pop(0)]
    while left:
        far = [math.prod(abs(p[0] - c[0]) for c in chosen) for p in left]
        chosen.append(left.pop(far.index(max(far))))
    return chosen


Signal = Constant | Ramp | Step | Sine | SineWithDwell | Sweep | Table | Sum | Mapped


def signal(value: float | Signal) -> Signal:
    """The signal a number or signal stands for."""
    return Constant(value=float(value)) if isinstance(value, int | float) else value


def maps_in(one: Signal) -> Iterator[Mapped]:
    """The maps that a signal is made of."""
    if isinstance(one, Mapped):
        yield one
    parts = one.terms if isinstance(one, Sum) else (one.of,) if isinstance(one, Mapped) else ()
    for part in parts:
        yield from maps_in(signal(part))
