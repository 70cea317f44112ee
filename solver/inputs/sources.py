"""Sources of the inputs of a simulation: a maneuver or a recording, a driver who sees the motion, and the actuators
behind them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from solver.errors import SpecError
from solver.inputs.actuation import Actuation, Chain
from solver.inputs.assistance import Assistance, Assistant, AssistedWheel, Feel
from solver.inputs.controllers import Controlled
from solver.inputs.driver import Sight
from solver.inputs.driving import Driven, driving_of
from solver.inputs.maneuver import DriverSource, Maneuver, source_of
from solver.inputs.recorded import Reach, RecordedSource


class Sources:
    """The inputs of a simulation, step by step.

    stage: where in a step the integrator balances forces. speed: at the start [m/s]. duration: of the simulation [s].
    reaches: what inputs may be. lock: angle of the steering wheel at its end stops [rad]. of_time: what depends on time
    alone. wheels: for an assistance. driver, controllers, assistant, actuators: where there are any; what a recording
    says has acted, so nothing lies behind it. Raises SpecError.
    """

    def __init__(
        self,
        maneuver: Maneuver,
        actuation: Actuation,
        assistance: Assistance,
        names: Sequence[str],
        wheels: Sequence[AssistedWheel],
        h_ns: int,
        stage: float,
        *,
        speed: float,
        duration: float,
        lock: float | None = None,
        reaches: Mapping[str, Reach] | None = None,
        controllers: Sequence[Controlled] = (),
    ) -> None:
        self._maneuver, self._actuation, self._names, self._h_ns, self._stage = maneuver, actuation, names, h_ns, stage
        self._assistance, self.wheels, self._speed = assistance, wheels, speed
        self.of_time = source_of(maneuver, names, h_ns, stage, lock)
        if isinstance(self.of_time, RecordedSource):
            self.of_time.require_within(reaches or {})
        if isinstance(self.of_time, RecordedSource) and round(duration * 1e9 / h_ns) > self.of_time.steps:
            last = self.of_time.steps * h_ns * 1e-9
            raise SpecError(
                f'duration = {duration:g}: {self.of_time.given.where} ends at {last:g} s; set duration to that or less'
            )
        self.driver = DriverSource(maneuver, names, h_ns, stage, speed, lock) if maneuver.closed_loop else None
        if self.driver is not None:
            self.of_time = self.driver.open_loop  # which the driver asks, so it knows up to where a verdict has to look
        self.controllers = () if maneuver.bag else tuple(controllers)
        self.actuators = self.new_actuators() if actuation.actuators and not maneuver.bag else None
        self.assistant = self.new_assistant() if assistance and not maneuver.bag else None
        self._driving = None  # the driver in compiled code, where nothing that only Python knows lies behind him
        behind = bool(self.controllers) or self.actuators is not None or self.assistant is not None
        if self.driver is not None and not behind:
            self._driving = driving_of(maneuver.driver, maneuver.speed, tuple(names), h_ns * 1e-9, self.driver.lock)

    def new_actuators(self) -> Chain:
        """Actuators at rest."""
        return Chain(self._actuation.actuators, self._names, self._h_ns, self._stage)

    def new_assistant(self) -> Assistant:
        """Assistance that has not acted yet."""
        return Assistant(self._assistance, self._names, self.wheels, self._h_ns * 1e-9)

    @property
    def step_by_step(self) -> bool:
        """True where the inputs of a step depend on the steps before it."""
        parts = (self.driver, self.actuators, self.assistant)
        return bool(self.controllers) or any(part is not None for part in parts)

    @property
    def drives(self) -> bool:
        """True where driven() gives the inputs of many steps."""
        return self._driving is not None

    @contextmanager
    def driven(self, k: int, n: int) -> Iterator[tuple[np.ndarray, Driven]]:
        """(inputs (n, nu) of n steps from step k on that depend on time alone, and the driver, who adds his in compiled
        code and advances with them)."""
        assert self.driver is not None
        assert self._driving is not None
        hands = slice(0 if self.driver.driver is not None else 3, 4 if self.driver.speed is not None else 3)
        self._driving.state[hands] = self.driver.state
        try:
            yield self.driver.open_loop.table(k, n), Driven(self._driving, self.driver.wanted(k, n))
        finally:
            self.driver.state = self._driving.state[hands].copy()

    def reset(self) -> np.ndarray:
        """Back to t = 0: (nu,) the inputs there."""
        if self.driver is not None:
            self.driver.reset()
        for controller in self.controllers:
            controller.reset()
        if isinstance(self.of_time, RecordedSource):
            return self.of_time.start
        self.of_time.restart()
        inputs = self.of_time.at_start()
        if self.assistant is not None:
            inputs = self.assistant.start(inputs, self._speed)
        return inputs if self.actuators is None else self.actuators.start(inputs)

    def sample(self, k: int, sight: Callable[[], Sight], feel: Callable[[], Feel]) -> np.ndarray:
        """(nu,) inputs of step k; advances driver, assistance and actuators, so it is called once per step. sight: what
        the driver sees; feel: what the assistance measures."""
        row = self.of_time.sample(k) if self.driver is None else self.driver.sample(k, sight())
        for controller in self.controllers:
            row = controller.act(k, row)
        if self.assistant is not None:
            row = self.assistant.act(row, feel())
        return row if self.actuators is None else self.actuators.advance(row)

    def memory(self) -> dict[str, np.ndarray]:
        """State on which the inputs of the steps to come depend."""
        parts = {'driver': self.driver, 'actuators': self.actuators, 'assistance': self.assistant}
        memory = {name: part.state for name, part in parts.items() if part is not None}
        return memory | {f'controller_{i}': controller.state for i, controller in enumerate(self.controllers)}

    def recall(self, memory: Mapping[str, np.ndarray], inputs: np.ndarray, *, elsewhere: bool = False) -> None:
        """Go on from memory(). Raises SpecError where that is not of these.

        inputs: (nu,) in force. elsewhere: the memory is that of another scene of the same vehicle, whose driver had
        another way and whose actuators may be others: these begin at the inputs, and so does an assistance that was not
        there.
        """
        if elsewhere:
            if self.driver is not None:
                self.driver.start(inputs)
            if self.actuators is not None:
                self.actuators.start(inputs)
            if self.assistant is not None:
                self.assistant.begin(inputs, memory.get('assistance'))
            if self.controllers:
                raise SpecError('restore: the state is that of another scene, and controllers begin at their start')
            return
        parts = (('driver', self.driver, 'has no driver'), ('actuators', self.actuators, 'has no actuators'))
        for name, part, be in (*parts, ('assistance', self.assistant, 'has no assistance')):
            if part is not None:
                if name not in memory:
                    raise SpecError(f'restore: the saved state {be}: it is of another scene')
                if memory[name].dtype != float:
                    raise SpecError(f'restore: {name} are not numbers: the saved state is of another model')
                part.state = memory[name]
        for i, controller in enumerate(self.controllers):
            if f'controller_{i}' not in memory:
                raise SpecError('restore: the saved state has no controllers: it is of another scene')
            controller.state = memory[f'controller_{i}']
