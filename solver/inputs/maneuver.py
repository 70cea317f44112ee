"""Maneuvers and the other sources of inputs that a simulation samples once per step.

Inputs come in two families. *Motion* inputs are prescribed motions: they have companions `<name>_rate` and
`<name>_acceleration` and are taken at the end of a step, where the constraints hold. *Force-like* inputs (torques,
pressures) are taken inside the step, at the instant `(k + stage) h` where the integrator balances forces.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated

import numpy as np

from solver.errors import SpecError, suggestion
from solver.inputs.command_filter import COMMANDS, CommandSource, filter_state_at
from solver.inputs.driver import PreviewDriver, Sight, SpeedControl
from solver.inputs.end_stops import BeyondEnd, hold
from solver.inputs.recorded import ACCELERATION, RATE, BagChannel, RecordedSource, recorded
from solver.inputs.signals import Constant, Signal, signal
from solver.inputs.unresolved import Departure, Unresolved

AHEAD = 100  # steps that are sampled at once: one costs about as much as a hundred


@dataclass(frozen=True, kw_only=True)
class Maneuver:
    """Named inputs as functions of time.

    steering: angle at the steering wheel [rad], positive to the left. drive_torque: at the differential [N m].
    brake_torque: total of all wheels [N m], >= 0. road_wheel: mean angle of the front road wheels [rad] instead of
    `steering`; the map of the steering, measured on the bench, makes it an angle of the steering wheel. signals: any
    other input channel of the model by name. driver: steers instead of the signal `steering`. speed: keeps a speed with
    the drive torque, and the brakes, instead of their signals. bag: a recording (directory or .mcap file) whose inputs
    are applied again instead of all these; map: for recordings of others, which of their channels is which input;
    log_times: take the times when their messages were recorded, not their stamps. evaluation: what `mbd evaluate` makes
    of its recordings (docs/evaluating.md); evaluate_with: parameters.
    """

    name: str = ''
    title: str = ''
    steering: Annotated[float | Signal, 'rad at the wheel'] = 0.0
    drive_torque: Annotated[float | Signal, 'N m'] = 0.0
    brake_torque: Annotated[float | Signal, 'N m'] = 0.0
    road_wheel: Annotated[float | Signal, 'rad of the road wheels'] = 0.0
    signals: dict[str, float | Signal] = field(default_factory=dict)
    driver: PreviewDriver | None = None
    speed: SpeedControl | None = None
    evaluation: str = ''
    evaluate_with: dict[str, float] = field(default_factory=dict)
    bag: str = ''
    map: dict[str, BagChannel] = field(default_factory=dict)
    log_times: bool = False

    def __post_init__(self) -> None:
        if self.bag and (self.closed_loop or self.channels):
            other = next((name for name in ('driver', 'speed') if getattr(self, name) is not None), None) or next(
                iter(self.channels)
            )
            raise SpecError(
                f'bag = {self.bag}: the inputs come from the recording, but {other!r} is given too; remove one of them'
            )
        if self.map and not self.bag:
            raise SpecError(
                'map: says what the channels of a recording are, but the key bag, which names the recording, is missing'
            )
        if self.log_times and not self.map:
            raise SpecError(
                'log_times: is for recordings of others, but the key map, which says what their channels are, is '
                'missing'
            )
        if self.by_road_wheel and (self.driver is not None or signal(self.steering) != Constant()):
            raise SpecError(
                f'maneuver {self.name!r}: road_wheel is given, but something else steers too; remove one of them'
            )
        if self.driver is not None and signal(self.steering) != Constant():
            raise SpecError(f'maneuver {self.name!r}: steering is given, but the driver steers; remove one of them')
        if self.speed is not None and signal(self.drive_torque) != Constant():
            raise SpecError(
                f'maneuver {self.name!r}: drive_torque is given, but the speed is kept by it; remove one of them'
            )
        if self.speed is not None and self.speed.brakes and signal(self.brake_torque) != Constant():
            raise SpecError(
                f'maneuver {self.name!r}: brake_torque is given, but the speed is kept by the brakes too; remove one '
                'of them'
            )

    @property
    def by_road_wheel(self) -> bool:
        """True where it steers by the angle of the road wheels."""
        return signal(self.road_wheel) != Constant()

    @property
    def closed_loop(self) -> bool:
        """True where some inputs depend on the motion."""
        return self.driver is not None or self.speed is not None

    @property
    def channels(self) -> dict[str, Signal]:
        """Name -> signal of every channel that is not the constant zero."""
        fixed = {name: getattr(self, name) for name in COMMANDS}
        both = [name for name in self.signals if name in fixed]
        if both:
            raise SpecError(
                f'maneuver {self.name!r}: {both[0]!r} must be given as a key of the maneuver, not under signals'
            )
        channels = {name: signal(s) for name, s in {**fixed, **self.signals}.items()}
        return {name: s for name, s in channels.items() if s != Constant()}

    def inputs(self, names: Sequence[str], t_force: np.ndarray, t_end: np.ndarray) -> np.ndarray:
        """(n, len(names)) input values: force-like ones at t_force (n,), motions and their derivatives at t_end (n,)
        [s].

        Inputs the maneuver does not name are zero. Raises SpecError for a channel that is not among the names.
        """
        if self.by_road_wheel:
            raise SpecError(f'maneuver {self.name!r}: road_wheel needs the map of a vehicle: use simulation_of(scene)')
        u = np.zeros((len(t_force), len(names)))
        for name, s in self.channels.items():
            if name not in names:
                raise SpecError(
                    f'maneuver {self.name!r}: the model has no input {name!r}{suggestion(name, base_names(names))}'
                )
            if is_motion(name, names):
                jet = s.jet(t_end)
                for suffix, values in zip(('', RATE, ACCELERATION), jet, strict=True):
                    u[:, names.index(name + suffix)] = values
            else:
                u[:, names.index(name)] = s.jet(t_force).value
        return u

    def inputs_at_start(self, names: Sequence[str]) -> np.ndarray:
        """(nu,) inputs at t = 0. Rates and accelerations of motions are those just after: what moves from there on
        moves already."""
        zero = np.zeros(1)
        u, after = self.inputs(names, zero, zero)[0], self.inputs(names, zero, np.nextafter(zero, 1.0))[0]
        jumps = np.abs(after - u) > JUMP
        u[jumps] = after[jumps]
        return u

    def commands(self, t: float) -> tuple[float, float, float]:
        """(steering [rad], drive torque [N m], brake torque [N m]) at time t [s], as a driver would command them.

        Raises SpecError when a preview driver steers: his commands depend on the motion.
        """
        if self.bag:
            raise SpecError(
                f'maneuver {self.name!r}: its inputs are a recording; run it in the simulation (mbd run, '
                'commands:=maneuver)'
            )
        if self.closed_loop:
            raise SpecError(
                f'maneuver {self.name!r}: its driver sees the motion; run it in the simulation (mbd run, '
                'commands:=maneuver)'
            )
        if self.by_road_wheel:
            raise SpecError(
                f'maneuver {self.name!r}: road_wheel needs a map; run it in the simulation (mbd run, '
                'commands:=maneuver)'
            )
        at = np.array([t])
        steering, drive, brake = (float(signal(getattr(self, name)).jet(at).value[0]) for name in COMMANDS)
        return steering, drive, brake

    def further_commands(self, t: float) -> dict[str, float]:
        """Further commands at time t [s]: the signals of other inputs, by name."""
        at = np.array([t])
        return {name: float(signal(s).jet(at).value[0]) for name, s in self.signals.items()}


JUMP = 1e-200  # what a rate or acceleration may change in the shortest time there is without a jump


def is_motion(name: str, names: Sequence[str]) -> bool:
    """True where an input is a prescribed motion: its rate and acceleration are inputs too."""
    return name + RATE in names and name + ACCELERATION in names


def is_motion_part(name: str, names: Sequence[str]) -> bool:
    """True where an input is a prescribed motion, or the rate or acceleration of one."""
    return any(is_motion(name.removesuffix(suffix), names) for suffix in ('', RATE, ACCELERATION))


def base_names(names: Sequence[str]) -> list[str]:
    """Input names without the derivative companions of motions."""
    companions = {n + suffix for n in names if is_motion(n, names) for suffix in (RATE, ACCELERATION)}
    return [n for n in names if n not in companions]


class ManeuverSource:
    """Input source of a simulation: the inputs of step k (from k h to (k + 1) h), a pure function of k.

    stage: where in the step the integrator balances forces, as a fraction of h in [0, 1]. lock: angle of the steering
    wheel [rad] at its end stops, which hold it; None: there are none.
    """

    def __init__(
        self, maneuver: Maneuver, input_names: Sequence[str], h_ns: int, stage: float = 1.0, lock: float | None = None
    ) -> None:
        self.maneuver, self.names, self.h_ns, self.stage, self.lock = maneuver, tuple(input_names), h_ns, stage, lock
        steering = maneuver.channels.get('steering')
        self._beyond = None if lock is None or steering is None else BeyondEnd(steering, lock, h_ns * 1e-9)
        self._asked = 0  # up to which step
        self._unresolved = Unresolved(maneuver.channels, h_ns)
        # refuses channels the model does not have, before anything runs
        self._first, self._ahead = 0, self._sampled(0, AHEAD)

    def table(self, k0: int, n: int) -> np.ndarray:
        """(n, nu) inputs of steps k0 ... k0 + n - 1."""
        self._asked = k0 + n
        if n > AHEAD:
            return self._sampled(k0, n)
        at = k0 - self._first
        if not 0 <= at <= AHEAD - n:
            at, self._first, self._ahead = 0, k0, self._sampled(k0, AHEAD)
        return self._ahead[at : at + n].copy()

    def restart(self) -> None:
        """Nobody has asked yet."""
        self._asked = 0

    def unresolved(self, k: int, duration: float) -> dict[str, Departure]:
        """Signals that swing between steps up to k, of those that it was asked for; see solver.inputs.unresolved."""
        return self._unresolved.look(min(k, self._asked), duration)

    def beyond_end(self, k: int) -> tuple[float, float] | None:
        """(largest angle [rad], first time [s]) that the maneuver asks of the steering wheel beyond its end stops in
        steps up to k, of those that it was asked for."""
        if self._beyond is None:
            return None
        self._beyond.look(min(k, self._asked))
        return (self._beyond.largest, self._beyond.first) if self._beyond.largest else None

    def at_start(self) -> np.ndarray:
        """(nu,) inputs at t = 0; see Maneuver.inputs_at_start."""
        return self._at_start.copy()

    @cached_property
    def _at_start(self) -> np.ndarray:
        u = self.maneuver.inputs_at_start(self.names)
        hold(u[None, :], self.names, self.lock)
        return u

    def _sampled(self, k0: int, n: int) -> np.ndarray:
        begin_ns = np.arange(k0, k0 + n, dtype=np.int64) * self.h_ns
        u = self.maneuver.inputs(self.names, (begin_ns + self.stage * self.h_ns) * 1e-9, (begin_ns + self.h_ns) * 1e-9)
        hold(u, self.names, self.lock)
        return u

    def sample(self, k: int) -> np.ndarray:
        """(nu,) inputs of step k."""
        return self.table(k, 1)[0]


def source_of(
    maneuver: Maneuver, input_names: Sequence[str], h_ns: int, stage: float = 1.0, lock: float | None = None
) -> ManeuverSource | RecordedSource:
    """The source of the inputs that depend on time alone; lock: as of ManeuverSource, a recording has its own. Raises
    SpecError, also for a recording that cannot be used."""
    if maneuver.bag:
        return RecordedSource(recorded(maneuver.bag, maneuver.map, maneuver.log_times), input_names, h_ns, stage)
    return ManeuverSource(maneuver, input_names, h_ns, stage, lock)


class DriverSource:
    """Input source of a simulation with a driver: what he does in step k depends on what he sees at its beginning.

    The steering of a PreviewDriver passes the filter of CommandSource, a SpeedControl gives torques, all else is of the
    maneuver. start: speed of the scene at t = 0 [m/s]. lock: angle of the steering wheel at its end stops [rad],
    further than which nobody turns it. state: (3,) of the hands, then (1,) of the speed control; only of those that
    there are.
    """

    def __init__(
        self,
        maneuver: Maneuver,
        input_names: Sequence[str],
        h_ns: int,
        stage: float = 1.0,
        start: float = 0.0,
        lock: float | None = None,
    ) -> None:
        assert maneuver.closed_loop
        self.driver, self.speed, self.h_ns = maneuver.driver, maneuver.speed, h_ns
        self._lock = np.inf if lock is None else lock
        self.open_loop = ManeuverSource(maneuver, input_names, h_ns, stage, lock)
        needed = ['steering'] * (self.driver is not None) + ['drive_torque'] * (self.speed is not None)
        needed += ['brake_torque'] * (self.speed is not None and self.speed.brakes > 0.0)
        for name in needed:
            if name not in input_names:
                raise SpecError(f'maneuver {maneuver.name!r}: driver: the model has no input {name}')
        self._at = {name: k for k, name in enumerate(input_names)}
        if self.driver is not None:
            self._steering = [self._at[name] for name in ('steering', 'steering' + RATE, 'steering' + ACCELERATION)]
            self._filter = CommandSource(
                input_names, h_ns, bandwidth=self.driver.bandwidth, rate_limit=self.driver.rate_limit
            )
        if self.speed is not None:
            self._target = signal(start if self.speed.target is None else self.speed.target)
            self._first, self._wanted = -1, np.zeros((AHEAD, 2))
        self.reset()

    def reset(self) -> None:
        """Back to t = 0."""
        if self.driver is not None:
            self._filter.state = np.zeros(3)
        self._kept = 0.0 if self.speed is None else self.speed.first

    def start(self, inputs: np.ndarray) -> None:
        """Begin in the middle of a motion, with the hands where inputs (nu,) have the steering wheel."""
        self.reset()
        if self.driver is not None:
            self._filter.state = filter_state_at(self._filter.names, inputs)

    @property
    def state(self) -> np.ndarray:
        """State of the hands and of the speed control; assign it to restore."""
        hands = self._filter.state if self.driver is not None else np.zeros(0)
        return hands if self.speed is None else np.append(hands, self._kept)

    @state.setter
    def state(self, value: np.ndarray) -> None:
        if value.shape != self.state.shape:
            raise SpecError(
                f'restore: the state of the driver has {value.size} numbers, this maneuver needs {self.state.size}: '
                'other scene'
            )
        if self.driver is not None:
            self._filter.state = value[:3].copy()
        if self.speed is not None:
            self._kept = float(value[-1])

    def sample(self, k: int, sight: Sight) -> np.ndarray:
        """(nu,) inputs of step k; advances hands and speed control by a step, so it is called once per step."""
        row = self.open_loop.sample(k)
        if self.driver is not None:
            row[self._steering] = self._filter.turn(min(max(self.driver.steering(sight), -self._lock), self._lock))
        if self.speed is not None:
            wanted, slope = self.wanted(k, 1)[0].tolist()
            h = self.h_ns * 1e-9
            drive, brake, self._kept = self.speed.torques(k * h, wanted, slope, sight.speed, self._kept, h)
            row[self._at['drive_torque']] = drive
            if self.speed.brakes > 0.0:
                row[self._at['brake_torque']] = brake
        return row

    @property
    def lock(self) -> float:
        """Angle of the steering wheel at its end stops [rad]."""
        return float(self._lock)

    def wanted(self, k: int, n: int) -> np.ndarray:
        """(n, 2) speeds [m/s] and slopes [m/s^2] that are wanted at the beginning of n steps from step k on."""
        if self.speed is None or n > AHEAD:
            return self._sampled(k, n)
        if not 0 <= k - self._first <= AHEAD - n or self._first < 0:
            self._first, self._wanted = k, self._sampled(k, AHEAD)
        return self._wanted[k - self._first : k - self._first + n]

    def _sampled(self, k: int, n: int) -> np.ndarray:
        if self.speed is None:
            return np.zeros((n, 2))
        jet = self._target.jet(np.arange(k, k + n) * (self.h_ns * 1e-9))
        return np.column_stack([jet.value, jet.rate])


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
            raise SpecError(
                f'replay: steps {k0} to {k0 + n - 1} are not in the recording (steps {self.first} to {last})'
            )
        return np.ascontiguousarray(self.values[at : at + n])

    def sample(self, k: int) -> np.ndarray:
        """(nu,) inputs of step k."""
        return self.table(k, 1)[0]
