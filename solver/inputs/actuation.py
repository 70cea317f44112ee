"""Actuation of a vehicle, as data: the commands that it takes, and the actuators between a command and its effect.

Chain turns commands into inputs, step by step: first the dead time (whole steps), then the lag with the rate limit.
Each part is advanced by its closed-form solution, so it depends on nothing but its state and the commands.

A force-like input y follows its command u by a lag of first order with a limit of its rate,

    dy/dt = clip((u - y) / lag, -rate_limit, rate_limit)

with u constant over a step; what acts in the step is y at the instant where the integrator balances forces. A motion
needs an acceleration that belongs to it: a reference r runs after the command at no more than rate_limit, and the angle
x follows it by x'' = w^2 (r - x) - 2 w x' (critically damped). Both are behind a ramp by `lag` seconds (w = 2 / lag).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from solver.dimensions import Time
from solver.errors import SpecError
from solver.inputs.command_filter import follow
from solver.inputs.recorded import ACCELERATION, RATE
from solver.validate import finite

LONGEST_DEAD_TIME = 10.0  # s


@dataclass(frozen=True, kw_only=True)
class Actuator:
    """Actuator between a command and the input that it commands.

    dead_time: nothing happens, rounded to whole steps. lag: time by which the input runs behind a ramp. rate_limit:
    largest rate of the input, in its unit per second (none: without limit); of a motion it needs a lag, or the motion
    would have corners.
    """

    dead_time: Time = 0.0
    lag: Time = 0.0
    rate_limit: float | None = None

    def __post_init__(self) -> None:
        finite('actuator', 'dead_time', self.dead_time, low=0.0, high=LONGEST_DEAD_TIME)
        finite('actuator', 'lag', self.lag, low=0.0)
        if self.rate_limit is not None:
            finite('actuator', 'rate_limit', self.rate_limit, low=0.0, strict=True)


@dataclass(frozen=True, kw_only=True)
class Actuation:
    """Actuation of a vehicle.

    steering: the command that steers: the angle of the steering wheel; the torque at the
    steering wheel, which turns freely then (input steering_torque [N m], positive to the left); or the mean angle of
    the front road wheels [rad], which the measured map of the steering turns into an angle of the steering wheel.
    wheels: drive and brake torque of single wheels beside the sums: inputs drive_torque_<wheel> and
    brake_torque_<wheel> [N m]; the latter is added to the wheel's share of brake_torque, and takes from it where it is
    below zero. actuators: by input, what lies between its command and the input.
    """

    steering: Literal['angle', 'torque', 'road_wheel'] = 'angle'
    wheels: bool = False
    actuators: dict[str, Actuator] = field(default_factory=dict)


class _Force:
    """A force-like input behind its actuator. state: (1,) [unit of the input]."""

    def __init__(self, actuator: Actuator, h: float, stage: float) -> None:
        self.actuator, self.h, self.stage = actuator, h, stage
        self.state = np.zeros(1)

    def start(self, value: float) -> None:
        self.state = np.array([value])

    def advance(self, command: Sequence[float]) -> tuple[float, ...]:
        y, (u,) = float(self.state[0]), command
        self.state = np.array([self._after(y, u, self.h)])
        return (self._after(y, u, self.stage * self.h),)

    def _after(self, y: float, u: float, t: float) -> float:
        """y after t seconds under the command u."""
        lag, limit, gap = self.actuator.lag, self.actuator.rate_limit, u - y
        if limit is not None and abs(gap) > limit * lag:
            run = min(t, (abs(gap) - limit * lag) / limit)
            y += math.copysign(limit * run, gap)
            t, gap = t - run, u - y
        if lag == 0.0:
            return u if limit is None or t > 0.0 else y
        return u - gap * math.exp(-t / lag)


class _Motion:
    """A prescribed motion behind its actuator. state: (3,) reference, value and rate."""

    def __init__(self, actuator: Actuator, h: float) -> None:
        self.actuator, self.h = actuator, h
        self.state = np.zeros(3)

    def start(self, value: float) -> None:
        self.state = np.array([value, value, 0.0])

    def advance(self, command: Sequence[float]) -> tuple[float, ...]:
        if self.actuator.lag == 0.0:
            return tuple(command)
        w, limit = 2.0 / self.actuator.lag, self.actuator.rate_limit
        r, x, v = self.state.tolist()
        slope = (command[0] - r) / self.h
        if limit is not None:
            slope = min(max(slope, -limit), limit)
        x, v = follow(w, x, v, r, slope, self.h)
        r += slope * self.h
        self.state = np.array([r, x, v])
        return x, v, w * w * (r - x) - 2.0 * w * v


class Chain:
    """The actuators of a simulation between its commands and its inputs.

    stage: where in the step the integrator balances forces, as a fraction of h. state: of all of them; assign it to
    restore. Raises SpecError for a rate limit of a motion without lag.
    """

    def __init__(self, actuators: Mapping[str, Actuator], input_names: Sequence[str], h_ns: int, stage: float) -> None:
        h, names = h_ns * 1e-9, list(input_names)
        self._parts: list[tuple[list[int], deque[tuple[float, ...]], _Force | _Motion]] = []
        for name, actuator in actuators.items():
            places = [names.index(name)]
            part: _Force | _Motion = _Force(actuator, h, stage)
            if {name + RATE, name + ACCELERATION} <= set(names):
                if actuator.rate_limit is not None and actuator.lag == 0.0:
                    raise SpecError(
                        f'actuation.actuators.{name}: rate_limit without lag: the motion would have corners; give it a '
                        'lag'
                    )
                places += [names.index(name + RATE), names.index(name + ACCELERATION)]
                part = _Motion(actuator, h)
            steps = round(actuator.dead_time / h)
            self._parts.append((places, deque([(0.0,) * len(places)] * steps, maxlen=steps), part))

    def start(self, inputs: np.ndarray) -> np.ndarray:
        """(nu,) inputs at the start, where every command has been what it is for ever: motions stand still there."""
        inputs = inputs.copy()
        for places, waiting, part in self._parts:
            if isinstance(part, _Motion):
                inputs[places[1:]] = 0.0
            rest = tuple(inputs[places].tolist())
            waiting.extend([rest] * (waiting.maxlen or 0))
            part.start(rest[0])
        return inputs

    def advance(self, commands: np.ndarray) -> np.ndarray:
        """(nu,) inputs of a step for the commands (nu,) of that step; advances the actuators by it."""
        row = commands.copy()
        for places, waiting, part in self._parts:
            command = tuple(commands[places].tolist())
            if waiting.maxlen:
                now, command = command, waiting[0]
                waiting.append(now)
            row[places] = part.advance(command)
        return row

    @property
    def state(self) -> np.ndarray:
        """State of every part, and the commands that wait."""
        return np.concatenate(
            [np.zeros(0), *(x for _, waiting, part in self._parts for x in (part.state, np.ravel(list(waiting))))]
        )

    @state.setter
    def state(self, value: np.ndarray) -> None:
        if value.shape != self.state.shape:
            raise SpecError(
                f'restore: the actuators have {self.state.size} states here, {value.size} are saved: other scene'
            )
        at = 0
        for places, waiting, part in self._parts:
            part.state, at = value[at : at + part.state.size].copy(), at + part.state.size
            count = len(waiting) * len(places)
            waiting.extend(tuple(row) for row in value[at : at + count].reshape(-1, len(places)).tolist())
            at += count
