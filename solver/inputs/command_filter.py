"""Filter of commands: commands latched at step boundaries become inputs. Angles pass a filter that makes smooth motions
of them, torques hold over the step."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from solver.errors import SpecError
from solver.inputs.recorded import ACCELERATION, RATE

COMMANDS = ('steering', 'drive_torque', 'brake_torque')
# Of the filter of steering commands, where nobody says others.
BANDWIDTH = 5.0  # Hz; a filter ten times as fast passes the steps of a command on as jerks of the wheel
RATE_LIMIT = 20.0  # rad/s of the steering wheel, more than hands reach; ten times as much limits nothing
# by Actuation.steering, what is commanded
STEERING = {'angle': 'steering', 'torque': 'steering_torque', 'road_wheel': 'road_wheel'}
# of an engine with a gearbox: pedals (0 to 1), gear or lever, of a converter
POWERTRAIN = ('accelerator', 'clutch', 'gear', 'lock_up')
BY_WHEEL = ('drive_torque_', 'brake_torque_')  # beginnings of the names of torques of single wheels
_BITS = struct.Struct('3d').pack  # of a motion: 0 and -0 are equal, but not the same


def commands_of(input_names: Sequence[str], steering: str = 'angle') -> tuple[str, ...]:
    """Commands that a vehicle with these inputs takes: its steering, the two sums of torques, pedals and gear, inputs
    of further elements, and the torques of single wheels.

    steering: see Actuation. A motion that is imposed is no command: it would jump.
    """
    powertrain = (name for name in POWERTRAIN if name in input_names)
    wheels = [name for name in input_names if name.startswith(BY_WHEEL)]
    return (STEERING[steering], *COMMANDS[1:], *powertrain, *further(input_names), *wheels)


def further(input_names: Sequence[str]) -> list[str]:
    """Inputs of elements that a scene adds: every input that no topic of a vehicle drives, except imposed motions."""
    vehicle = {*COMMANDS, *STEERING.values(), *POWERTRAIN}
    motions = {
        name.removesuffix(RATE)
        for name in input_names
        if name.endswith(RATE) and name.removesuffix(RATE) in input_names
    }
    parts = {name + suffix for name in motions for suffix in ('', RATE, ACCELERATION)}
    return [name for name in input_names if name not in vehicle | parts and not name.startswith(BY_WHEEL)]


def uncommanded(input_names: Sequence[str], commands: Sequence[str]) -> list[str]:
    """Inputs that no topic drives, such as the drivers of a mechanism. The steering wheel counts as driven: every
    steering command turns it."""
    return [name for name in input_names if name not in (*commands, COMMANDS[0])]


def place_of(name: str, commands: Sequence[str], scene: str) -> int:
    """Place of a command that lockstep waits for; steering is whichever steers. Raises SpecError where the scene has
    not got it."""
    if name != COMMANDS[0] and name not in commands:
        there = ', '.join(commands)
        raise SpecError(f'parameter lockstep_commands: {scene} has no input {name!r}; its commands are {there}')
    return 0 if name == COMMANDS[0] else commands.index(name)


def follow(omega: float, x: float, v: float, r: float, slope: float, t: float) -> tuple[float, float]:
    """(x, x') after t seconds of x'' = omega^2 (r - x) - 2 omega x' behind a reference that starts at r and moves at
    `slope`: exact."""
    lag = 2.0 * slope / omega  # steady distance behind a moving reference
    e = x - (r - lag)
    b = v - slope + omega * e
    decay = math.exp(-omega * t)
    return r - lag + slope * t + (e + b * t) * decay, slope + (b - omega * (e + b * t)) * decay


def filter_state_at(input_names: Sequence[str], inputs: np.ndarray) -> np.ndarray:
    """(3,) state of a CommandSource whose filter is at the angle and rate that inputs (nu,) give the steering wheel."""
    there = dict(zip(input_names, inputs.tolist(), strict=True))
    angle = there.get('steering', 0.0)
    return np.array([angle, angle, there.get('steering' + RATE, 0.0)])


class CommandSource:
    """Turns commands latched at step boundaries into inputs; the steering command passes a filter, torques hold over
    the step.

    Steering: the reference r runs after the command at no more than `rate_limit`; the angle x follows it by x'' = w^2
    (r - x) - 2 w x' (critically damped, w = 2 pi bandwidth). The impulse response w^2 t exp(-w t) is positive with area
    one, so |x'| <= rate_limit too; x'' is continuous, so angle, rate and acceleration belong together. The step is
    advanced by the closed-form solution (r is linear, then constant), so it depends on nothing but the state and the
    command.
    """

    def __init__(
        self,
        input_names: Sequence[str],
        h_ns: int,
        *,
        bandwidth: float = BANDWIDTH,
        rate_limit: float = RATE_LIMIT,
        steering: float = 0.0,
        commands: Sequence[str] = COMMANDS,
        mapped: Callable[[float], float] | None = None,
        others: Mapping[str, float] | None = None,
    ) -> None:
        """bandwidth [Hz], rate_limit [rad/s], steering: initial angle [rad]. commands: what advance() is given
        (commands_of). mapped: turns the command road_wheel into an angle of the steering wheel. others: what inputs are
        held at that nobody commands (default: 0)."""
        if not (bandwidth > 0.0 and rate_limit > 0.0):
            raise SpecError(
                f'steering filter: bandwidth = {bandwidth!r} and rate_limit = {rate_limit!r}: both must be > 0'
            )
        self.names, self.h_ns = tuple(input_names), h_ns
        self.omega, self.rate_limit = 2.0 * math.pi * bandwidth, rate_limit
        self._motion = float(steering), float(steering), 0.0
        self._row: np.ndarray | None = None
        self._mapped = mapped
        given = list(commands)
        self._angle = given[0] != STEERING['torque']
        if self._angle:
            given += ['steering', 'steering' + RATE, 'steering' + ACCELERATION]
        last = {name: i for i, name in enumerate(given)}
        self._count, self._places = (
            len(commands),
            [(i, last[name]) for i, name in enumerate(self.names) if name in last],
        )
        self._held = [(others or {}).get(name, 0.0) for name in self.names]

    @property
    def state(self) -> np.ndarray:
        """(3,) r, x [rad], x' [rad/s]; assign it to restore."""
        return np.array(self._motion)

    @state.setter
    def state(self, value: np.ndarray) -> None:
        r, x, v = value.tolist()
        self._motion, self._row = (r, x, v), None

    @property
    def settled(self) -> np.ndarray | None:
        """(nu,) what advance() gave last, where the same commands give it again for ever, bit for bit; None while the
        steering moves."""
        return self._row

    def advance(self, *commands: float) -> np.ndarray:
        """(nu,) inputs of the next step for the commands that were in force at its beginning: steering [rad or N m],
        torques [N m]."""
        if len(commands) != self._count:
            raise SpecError(f'{len(commands)} commands, {self._count} are known')
        before = self._motion
        if self._angle:
            steering = commands[0]
            commands += self.turn(steering if self._mapped is None else self._mapped(steering))
        values = self._held.copy()
        for place, source in self._places:
            values[place] = commands[source]
        row = np.array(values)
        self._row = row if _BITS(*self._motion) == _BITS(*before) else None
        return row

    def turn(self, steering: float) -> tuple[float, float, float]:
        """Advance the steering alone: its angle, rate and acceleration at the end of the step."""
        h, (r, x, v) = self.h_ns * 1e-9, self._motion
        gap = steering - r
        run = min(abs(gap) / self.rate_limit, h)
        slope = self.rate_limit if gap > 0.0 else -self.rate_limit
        x, v = follow(self.omega, x, v, r, slope, run)
        r = steering if run < h else r + slope * h
        x, v = follow(self.omega, x, v, r, 0.0, h - run)
        self._motion = r, x, v
        return x, v, self.omega * self.omega * (r - x) - 2.0 * self.omega * v
