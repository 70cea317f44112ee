"""Commands become the inputs of a step: through the hands on the steering wheel, assistance and actuators, which all
have a memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mbd_sim_ros.node import state_files
from mbd_sim_ros.node.latch import DRIVING, Latch, Latched
from solver.errors import SpecError
from solver.inputs.actuation import Chain
from solver.inputs.assistance import Assistant
from solver.inputs.command_filter import STEERING, CommandSource, further, uncommanded
from solver.inputs.maneuver import base_names
from solver.levels.road_wheel import steering_map, steering_wheel_at
from solver.model.spec import ModelSpec

if TYPE_CHECKING:
    from solver.scene import Scene
    from solver.simulation import Simulation


class Driving:
    """Driver of a simulation over topics. names: of the commands, as they are latched; uncommanded: inputs that no
    topic drives.

    value: gives the parameters of the node. deaf: the maneuver of the scene drives instead, whose parts these then are.
    Raises SpecError.
    """

    def __init__(self, scene: Scene, simulation: Simulation, latch: Latch, value: Callable[[str], Any]) -> None:
        self.simulation, self._scene, self._latch, self._value = simulation, scene, latch, value
        self.deaf = value('commands') != 'topics'
        if scene.controllers and not self.deaf:
            raise SpecError('controllers: they act beside the maneuver of a scene; start with commands:=maneuver')
        self.names = latch.commands
        self.uncommanded = uncommanded(base_names(simulation.channels.inputs), self.names)
        # whose actuators and assistance act, whoever drives; a recording has been through them, and has none
        own = simulation.sources
        self._actuators: Chain | None = own.actuators or (own.new_actuators() if scene.actuation.actuators else None)
        self.assistant: Assistant | None = own.assistant or (own.new_assistant() if scene.assistance else None)
        self._road_map = steering_map(scene.model) if scene.actuation.steering == 'road_wheel' else None
        self._source = self._new_source()
        self._asked: tuple[float, ...] = ()  # commands of the last step
        self._restored: Mapping[str, float] = {}  # commands that held before that which this goes on with

    @property
    def ends(self) -> dict[str, tuple[float, float]]:
        """Least and most that may be commanded of the steering, by the vehicle's end stops and the map of its road
        wheels [rad]."""
        lock = self._scene.model.lock if isinstance(self._scene.model, ModelSpec) else None
        found = {} if lock is None else {STEERING['angle']: (-lock, lock)}
        if self._road_map is not None:
            found[STEERING['road_wheel']] = self._road_map.points[0][0], self._road_map.points[-1][0]
        return found

    def restore(self, path: Path) -> str:
        """Go on from a state file; a warning where the steering will jump, or ''. Raises SpecError."""
        self._restored = state_files.restore(path, self._scene, self.simulation, self._parts())
        return state_files.jump(self.simulation, self._value('steering_rate_limit')) if self.deaf else ''

    def save(self) -> Path:
        """Write the state into a file in the current directory, and return that. Raises SpecError."""
        state_files.hand_over(self.simulation, self._parts(), commanded=not self.deaf)
        return state_files.save(self._scene, self.simulation, self._parts(), self._in_force())

    def begin_anew(self) -> None:
        """The simulation is back at its start: hands, actuators and assistance are too."""
        self._source = self._new_source()

    def go_on(self, *, moving: bool) -> None:
        """Forget what was commanded, before the latch does; moving: a motion that goes on keeps its commands."""
        self._restored = self._in_force() if moving else {}

    def hold(self) -> None:
        """Until a command comes, steering, brakes, clutches, gear and what the scene adds stay where they are; what
        helps the driver works what it has itself.

        Commands of the time when a state was saved hold where it is restored, except those that drive: these hold only
        while they are sent.
        """
        inputs = dict(zip(self.simulation.channels.inputs, self.simulation.snapshot().inputs.tolist()))
        still = ['steering_torque', 'brake_torque', 'gear', *further(self.names)]
        if self._scene.assistance.shift is None:
            still += ['clutch', 'lock_up']
        if not self._scene.assistance.brakes:
            still += [name for name in self.names if name.startswith('brake_torque_')]
        held = {'steering': float(self._source.state[0])} | {name: inputs.get(name, 0.0) for name in still}
        held |= {name: value for name, value in self._restored.items() if not name.startswith(DRIVING)}
        self._latch.newest = Latched.none([held.get(name, 0.0) for name in self.names])

    def inputs(self, values: tuple[float, ...]) -> np.ndarray | None:
        """(nu,) inputs of the next step for the commands in force; None: the maneuver has them."""
        if self.deaf:
            return None
        row = self._source.settled if values is self._asked else None
        if row is None:
            self._asked, row = values, self._source.advance(*values)
        if self.assistant is not None:
            row = self.assistant.act(row, self.simulation.feel())
        return row if self._actuators is None else self._actuators.advance(row)

    def _new_source(self) -> CommandSource:
        channels, inputs = self.simulation.channels, self.simulation.snapshot().inputs
        at_start = dict(zip(channels.inputs, inputs))
        if not self.deaf:  # else the maneuver has begun them
            if self._actuators is not None:
                self._actuators.start(inputs)
            if self.assistant is not None:
                self.assistant.start(inputs, self.simulation.feel().speed)
        return CommandSource(
            channels.inputs,
            self.simulation.h_ns,
            bandwidth=self._value('steering_bandwidth'),
            rate_limit=self._value('steering_rate_limit'),
            steering=float(at_start.get('steering', 0.0)),
            commands=self.names,
            mapped=None if self._road_map is None else self._steering_wheel,
            others={name: float(at_start[name]) for name in self.uncommanded},
        )

    def _steering_wheel(self, road_wheel: float) -> float:
        """Angle of the steering wheel [rad] for an angle of the road wheels [rad]; where it stands, until one is
        commanded."""
        assert self._road_map is not None
        return steering_wheel_at(self._road_map, road_wheel) if self._steered else float(self._source.state[0])

    @property
    def _steered(self) -> bool:
        """True where the steering has been commanded, in this run or in the one that it continues."""
        return self._latch.newest.counts[0] > 0 or self.names[0] in self._restored

    def _in_force(self) -> Mapping[str, float]:
        """Commands by name; without an angle of the road wheels as long as none was commanded, for the steering wheel
        stands still then. None where the maneuver drives: what acts then are its inputs."""
        known = self.names if self._steered or self._road_map is None else self.names[1:]
        known = () if self.deaf else known
        return {name: value for name, value in zip(self.names, self._latch.newest.values, strict=True) if name in known}

    def _parts(self) -> dict[str, state_files.Part]:
        """Parts that have a memory, by their names in state files."""
        parts = {'steering': self._source, 'actuators': self._actuators, 'assistance': self.assistant}
        return {name: part for name, part in parts.items() if part is not None}
