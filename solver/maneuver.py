"""Inputs over time: signals, the maneuver that names them, and the sources a simulation samples once per step.

A signal gives value, rate and acceleration, the latter two by the chain rule from the same expression (`Jet`), because a
prescribed motion needs all three and they must belong together. Signals are twice continuously differentiable unless their
docstring says otherwise: corners are replaced by the quintic step s(x) = x^3 (10 - 15 x + 6 x^2) or by its integral.

Inputs come in two families. *Motion* inputs are prescribed motions: they have companions `<name>_rate` and
`<name>_acceleration` and are taken at the end of a step, where the constraints hold. *Force-like* inputs (torques, pressures)
are taken inside the step, at the instant `(k + stage) h` where the integrator balances forces.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from solver.errors import SpecError, suggestion

RATE, ACCELERATION = '_rate', '_acceleration'
Seconds = Annotated[float, 's']


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
        s, c = np.sin(self.value), np.cos(self.value)
        return Jet(s, c * self.rate, c * self.acceleration - s * self.rate * self.rate)


def smooth_step(t: np.ndarray, start: float, rise: float) -> Jet:
    """0 before start, 1 after start + rise, quintic between: C2."""
    x = np.clip((t - start) / rise, 0.0, 1.0)
    return Jet(
        x * x * x * (10.0 + x * (6.0 * x - 15.0)),
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
    start: Seconds = 0.0
    initial: float = 0.0
    final: float | None = None
    blend: Seconds = 0.1

    def __post_init__(self) -> None:
        _not_negative(self, 'blend')
        if self.final is not None and (self.final - self.initial) * self.slope <= 0.0:
            raise SpecError(f'final = {self.final:g}: is never reached from {self.initial:g} with slope {self.slope:g}')
        if self.final is not None and (self.final - self.initial) / self.slope < self.blend:
            raise SpecError(f'blend = {self.blend:g}: must not exceed the duration of the ramp ({(self.final - self.initial) / self.slope:g} s)')

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
    start: Seconds = 1.0
    rise: Seconds = 0.2

    def __post_init__(self) -> None:
        _positive(self, 'rise')

    def jet(self, t: np.ndarray) -> Jet:
        """Value, rate and acceleration at the times t [s]."""
        return smooth_step(t, self.start, self.rise).scaled(self.value - self.initial).shifted(self.initial)


@dataclass(frozen=True, kw_only=True)
class Sine:
    """amplitude sin(2 pi frequency s + phase) + offset, where s is time from `start` on, for `cycles` periods (all time, when left out).

    Starting and stopping are rounded over `blend` seconds by letting the phase gather speed.
    """

    kind: Literal['sine'] = 'sine'
    amplitude: float
    frequency: Annotated[float, 'Hz']
    phase: Annotated[float, 'rad'] = 0.0
    offset: float = 0.0
    start: Seconds = 0.0
    cycles: float | None = None
    blend: Seconds = 0.1

    def __post_init__(self) -> None:
        _positive(self, 'frequency', *(['cycles'] if self.cycles is not None else []))
        _not_negative(self, 'blend')
        if self.cycles is not None and self.cycles / self.frequency < self.blend:
            raise SpecError(f'blend = {self.blend:g}: must not exceed the duration of the sine ({self.cycles / self.frequency:g} s)')

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
    """One period of a sine that stands still for `dwell` seconds at its second peak (ISO 19365, FMVSS 126: 0.7 Hz, 0.5 s).

    The four corners of the phase are rounded over `blend` seconds, centred on the nominal instants.
    """

    kind: Literal['sine_with_dwell'] = 'sine_with_dwell'
    amplitude: float
    frequency: Annotated[float, 'Hz'] = 0.7
    dwell: Seconds = 0.5
    start: Seconds = 1.0
    blend: Seconds = 0.1

    def __post_init__(self) -> None:
        _positive(self, 'frequency')
        _not_negative(self, 'dwell', 'blend')
        if self.blend > min(0.25 / self.frequency, self.dwell):
            raise SpecError(f'blend = {self.blend:g}: must not exceed the dwell nor a quarter period ({0.25 / self.frequency:g} s)')

    def jet(self, t: np.ndarray) -> Jet:
        """Value, rate and acceleration at the times t [s]."""
        peak = self.start + 0.75 / self.frequency
        again = peak + self.dwell
        clock = smooth_clock(t, self.start, peak, self.blend) + smooth_clock(t, again, again + 0.25 / self.frequency, self.blend)
        return clock.scaled(2.0 * np.pi * self.frequency).sine().scaled(self.amplitude)


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """Swept sine, repeated: each sweep lasts `duration` seconds and runs from `frequency` to `final_frequency`, linear in time.

    The amplitude goes linearly from `amplitude` to `final_amplitude` over all sweeps together. Each sweep fades in and out over
    `fade` seconds (default: half a period of its lowest frequency, at most half the sweep); zero before and after.
    """

    kind: Literal['sweep'] = 'sweep'
    amplitude: float
    final_amplitude: float | None = None
    frequency: Annotated[float, 'Hz']
    final_frequency: Annotated[float | None, 'Hz'] = None
    duration: Seconds
    repeats: int = 1
    start: Seconds = 1.0
    fade: Annotated[float | None, 's'] = None

    def __post_init__(self) -> None:
        _positive(self, 'frequency', 'duration', 'repeats', *(f for f in ('final_frequency', 'fade') if getattr(self, f) is not None))
        if self.fade is not None and self.fade > 0.5 * self.duration:
            raise SpecError(f'fade = {self.fade:g}: must not exceed half the duration of a sweep ({0.5 * self.duration:g} s)')

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
        growth = 0.0 if self.final_amplitude is None else (self.final_amplitude - self.amplitude) / (self.repeats * self.duration)
        size = Jet(self.amplitude + growth * since, growth * one, none)
        window = smooth_step(s, 0.0, fade).times(smooth_step(s, self.duration - fade, fade).scaled(-1.0).shifted(1.0))
        return size.times(phase.sine()).times(window)


@dataclass(frozen=True, kw_only=True)
class Table:
    """Through the points [[t, value], ...], t increasing; the end values hold outside.

    cubic: spline with horizontal ends, C2 inside, C1 at the two ends. linear: C0, for force-like inputs only.
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
        x, y = np.array(self.points).T
        inside = (t >= x[0]) & (t < x[-1])
        if self.interpolation == 'linear':
            slope = np.append(np.diff(y) / np.diff(x), 0.0)[np.clip(np.searchsorted(x, t, 'right') - 1, 0, len(x) - 1)]
            return Jet(np.interp(t, x, y), np.where(inside, slope, 0.0), np.zeros_like(t))
        spline = CubicSpline(x, y, bc_type='clamped')
        at = np.clip(t, x[0], x[-1])
        return Jet(spline(at), np.where(inside, spline(at, 1), 0.0), np.where(inside, spline(at, 2), 0.0))


@dataclass(frozen=True, kw_only=True)
class Sum:
    """The sum of other signals."""

    kind: Literal['sum'] = 'sum'
    terms: tuple[float | Constant | Ramp | Step | Sine | SineWithDwell | Sweep | Table | Sum, ...]

    def jet(self, t: np.ndarray) -> Jet:
        """Value, rate and acceleration at the times t [s]."""
        total = Constant().jet(t)
        for term in self.terms:
            total = total + signal(term).jet(t)
        return total


Signal = Constant | Ramp | Step | Sine | SineWithDwell | Sweep | Table | Sum


def signal(value: float | Signal) -> Signal:
    """The signal a number or signal stands for."""
    return Constant(value=float(value)) if isinstance(value, int | float) else value


@dataclass(frozen=True, kw_only=True)
class Maneuver:
    """Named inputs as functions of time.

    steering: angle at the steering wheel [rad], positive to the left. drive_torque: at the differential [N m].
    brake_torque: total of all wheels [N m], >= 0. signals: any other input channel of the model by name.
    """

    name: str = ''
    title: str = ''
    steering: Annotated[float | Signal, 'rad at the wheel'] = 0.0
    drive_torque: Annotated[float | Signal, 'N m'] = 0.0
    brake_torque: Annotated[float | Signal, 'N m'] = 0.0
    signals: dict[str, float | Signal] = field(default_factory=dict)

    @property
    def channels(self) -> dict[str, Signal]:
        """Name -> signal of every channel that is not the constant zero."""
        fixed = {name: getattr(self, name) for name in COMMANDS}
        both = [name for name in self.signals if name in fixed]
        if both:
            raise SpecError(f'maneuver {self.name!r}: {both[0]!r} must be given as a key of the maneuver, not under signals')
        channels = {name: signal(s) for name, s in {**fixed, **self.signals}.items()}
        return {name: s for name, s in channels.items() if s != Constant()}

    def inputs(self, names: Sequence[str], t_force: np.ndarray, t_end: np.ndarray) -> np.ndarray:
        """(n, len(names)) input values: force-like ones at t_force (n,), motions and their derivatives at t_end (n,) [s].

        Inputs the maneuver does not name are zero. Raises SpecError for a channel that is not among the names.
        """
        u = np.zeros((len(t_force), len(names)))
        for name, s in self.channels.items():
            if name not in names:
                raise SpecError(f'maneuver {self.name!r}: the model has no input {name!r}{suggestion(name, base_names(names))}')
            if is_motion(name, names):
                jet = s.jet(t_end)
                for suffix, values in zip(('', RATE, ACCELERATION), jet, strict=True):
                    u[:, names.index(name + suffix)] = values
            else:
                u[:, names.index(name)] = s.jet(t_force).value
        return u

    def commands(self, t: float) -> tuple[float, float, float]:
        """(steering [rad], drive torque [N m], brake torque [N m]) at time t [s], as a driver would command them."""
        at = np.array([t])
        steering, drive, brake = (float(signal(getattr(self, name)).jet(at).value[0]) for name in COMMANDS)
        return steering, drive, brake


COMMANDS = ('steering', 'drive_torque', 'brake_torque')


def is_motion(name: str, names: Sequence[str]) -> bool:
    """Whether an input is a prescribed motion: its rate and acceleration are inputs too."""
    return name + RATE in names and name + ACCELERATION in names


def base_names(names: Sequence[str]) -> list[str]:
    """Input names without the derivative companions of motions."""
    companions = {n + suffix for n in names if is_motion(n, names) for suffix in (RATE, ACCELERATION)}
    return [n for n in names if n not in companions]


class ManeuverSource:
    """Input source of a simulation: the inputs of step k (from k h to (k + 1) h), a pure function of k.

    stage: where in the step the integrator balances forces, as a fraction of h in [0, 1].
    """

    def __init__(self, maneuver: Maneuver, input_names: Sequence[str], h_ns: int, stage: float = 1.0) -> None:
        self.maneuver, self.names, self.h_ns, self.stage = maneuver, tuple(input_names), h_ns, stage
        self.table(0, 1)  # refuses channels the model does not have, before anything runs

    def table(self, k0: int, n: int) -> np.ndarray:
        """(n, nu) inputs of steps k0 ... k0 + n - 1."""
        begin_ns = np.arange(k0, k0 + n, dtype=np.int64) * self.h_ns
        return self.maneuver.inputs(self.names, (begin_ns + self.stage * self.h_ns) * 1e-9, (begin_ns + self.h_ns) * 1e-9)

    def sample(self, k: int) -> np.ndarray:
        """(nu,) inputs of step k."""
        return self.table(k, 1)[0]


class CommandSource:
    """Turns commands latched at step boundaries into inputs; the steering command passes a filter, torques hold over the step.

    Steering: the reference r runs after the command at no more than `rate_limit`; the angle x follows it by
    x'' = w^2 (r - x) - 2 w x' (critically damped, w = 2 pi bandwidth). The impulse response w^2 t exp(-w t) is positive with area
    one, so |x'| <= rate_limit too; x'' is continuous, so angle, rate and acceleration belong together. The step is advanced by
    the closed-form solution (r is linear, then constant), so it depends on nothing but the state and the command.

    state: (3,) r, x [rad], x' [rad/s]; assign it to restore.
    """

    def __init__(
        self,
        input_names: Sequence[str],
        h_ns: int,
        *,
        bandwidth: float = 5.0,
        rate_limit: float = 20.0,
        steering: float = 0.0,
    ) -> None:
        """bandwidth [Hz], rate_limit [rad/s], steering: initial angle [rad]."""
        if not (bandwidth > 0.0 and rate_limit > 0.0):
            raise SpecError(f'steering filter: bandwidth = {bandwidth!r} and rate_limit = {rate_limit!r}: both must be > 0')
        self.names, self.h_ns = tuple(input_names), h_ns
        self.omega, self.rate_limit = 2.0 * np.pi * bandwidth, rate_limit
        self.state = np.array([steering, steering, 0.0])

    def advance(self, steering: float, drive_torque: float, brake_torque: float) -> np.ndarray:
        """(nu,) inputs of the next step for the commands [rad, N m, N m] that were in force at its beginning."""
        h, (r, x, v) = self.h_ns * 1e-9, self.state
        gap = steering - r
        run = min(abs(gap) / self.rate_limit, h)
        slope = self.rate_limit if gap > 0.0 else -self.rate_limit
        x, v = self._follow(x, v, r, slope, run)
        r = steering if run < h else r + slope * h
        x, v = self._follow(x, v, r, 0.0, h - run)
        self.state = np.array([r, x, v])
        acceleration = self.omega * self.omega * (r - x) - 2.0 * self.omega * v
        values = {
            'steering': x,
            'steering' + RATE: v,
            'steering' + ACCELERATION: acceleration,
            'drive_torque': drive_torque,
            'brake_torque': brake_torque,
        }
        return np.array([values.get(name, 0.0) for name in self.names])

    def _follow(self, x: float, v: float, r: float, slope: float, t: float) -> tuple[float, float]:
        """Exact motion over t seconds behind a reference that starts at r and moves at `slope`."""
        w = self.omega
        lag = 2.0 * slope / w  # steady distance behind a moving reference
        e = x - (r - lag)
        b = v - slope + w * e
        decay = np.exp(-w * t)
        return r - lag + slope * t + (e + b * t) * decay, slope + (b - w * (e + b * t)) * decay


class ReplaySource:
    """Inputs as they were applied in a recorded run, bit for bit.

    columns: name -> (n,) values; steps: (n,) index of the step each row was applied in, consecutive.
    """

    def __init__(self, input_names: Sequence[str], columns: Mapping[str, np.ndarray], steps: np.ndarray) -> None:
        missing = [name for name in input_names if name not in columns]
        if missing:
            raise SpecError(f'replay: the recording has no input {missing[0]!r}{suggestion(missing[0], columns)}')
        steps = np.asarray(steps, np.int64)
        if len(steps) and not np.array_equal(steps, np.arange(steps[0], steps[0] + len(steps))):
            hole = int(steps[np.flatnonzero(np.diff(steps) != 1)[0]])
            raise SpecError(f'replay: the recorded inputs are not consecutive after step {hole}')
        self.names, self.first = tuple(input_names), int(steps[0]) if len(steps) else 0
        self.values = np.column_stack([columns[n] for n in input_names]) if input_names else np.zeros((len(steps), 0))

    def table(self, k0: int, n: int) -> np.ndarray:
        """(n, nu) inputs of steps k0 ... k0 + n - 1; SpecError outside the recording."""
        at = k0 - self.first
        if at < 0 or at + n > len(self.values):
            last = self.first + len(self.values) - 1
            raise SpecError(f'replay: steps {k0} to {k0 + n - 1} are not in the recording (steps {self.first} to {last})')
        return np.ascontiguousarray(self.values[at : at + n])

    def sample(self, k: int) -> np.ndarray:
        """(nu,) inputs of step k."""
        return self.table(k, 1)[0]
