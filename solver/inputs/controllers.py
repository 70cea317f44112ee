"""Controllers of a scene as units of co-simulation (FMI 2.0 and 3.0), each in a process of its own.

A controller sees the motion every `every` seconds and commands inputs of the scene until the next time, one period
later: at t it is given what it measures at t, makes its step to t + every, and what it says then acts from there on, as
in a control unit that takes a period to compute. Its outputs at t = 0 act in the first period. The process that runs
it may crash without harm to the run, which ends with a sentence and a recording that is complete up to there.
"""

from __future__ import annotations

import base64
import json
import select
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from solver.dimensions import Time
from solver.errors import SpecError, StepError
from solver.inputs.command_filter import CommandSource
from solver.inputs.recorded import ACCELERATION, RATE
from solver.validate import finite, require

PATIENCE = 60.0  # s that a unit may take for a step, or to begin; ten times as much lets a run hang for ten minutes
TIMES = 1e-6  # relative error of a number of steps in a period that counts as whole; a ten times larger one hides typos
STEERING = 'steering'
Measure = Callable[[], np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Controller:
    """A controller as a unit of co-simulation.

    fmu: path of the archive. inputs: variable of the unit -> what it measures, a quantity of interest or a recorded
    channel. outputs: variable -> input of the scene that it commands; a steering angle passes the filter of commands.
    parameters: start values of variables of the unit. every: period [s], whole steps; 0 is every step.
    """

    fmu: str
    inputs: dict[str, str] = field(default_factory=dict)
    outputs: dict[str, str] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    every: Time = 0.0

    def __post_init__(self) -> None:
        require(bool(self.outputs), 'controllers', 'outputs', self.outputs, 'a controller commands something: give one')
        finite('controllers', 'every', self.every, low=0.0)
        commanded = [*self.outputs.values()]
        for name in commanded:
            require(commanded.count(name) == 1, 'controllers', 'outputs', self.outputs, f'{name} is commanded twice')


class Controlled:
    """A controller at work; its process begins with the first step. units: of what it measures, and of inputs ('' where
    nobody knows). state: numbers on which the inputs of steps to come depend."""

    def __init__(
        self,
        controller: Controller,
        names: Sequence[str],
        h_ns: int,
        measure: Measure,
        units: Mapping[str, str],
    ) -> None:
        self.controller, self._h, self._measure, self._units = controller, h_ns * 1e-9, measure, units
        self._where = f'controllers: {controller.fmu}'
        steps = controller.every / self._h
        self._period = max(1, round(steps))
        whole = not controller.every or abs(steps - self._period) <= TIMES * self._period
        nearest = (
            f'takes {steps:g} steps of integrator.h = {self._h:g}; the nearest whole one is {self._period * self._h:g}'
        )
        require(whole, self._where, 'every', controller.every, nearest)
        for name in controller.outputs.values():
            require(name in names, self._where, 'outputs', name, 'the scene has no such input')
            parts = [end for end in (RATE, ACCELERATION) if name + end in names]
            imposed = 'is an imposed motion, which a command would make jump; only steering has a filter'
            require(not parts or name == STEERING, self._where, 'outputs', name, imposed)
        self._places = [names.index(name) for name in controller.outputs.values()]
        self._turned = [k for k, name in enumerate(controller.outputs.values()) if name == STEERING]
        self._steering = [names.index(STEERING + end) for end in ('', RATE, ACCELERATION)] if self._turned else []
        self._filter = CommandSource(names, h_ns) if self._turned else None
        self._unit: _Process | None = None
        self.reset()

    def reset(self) -> None:
        """Back to t = 0; the process begins anew with the next step."""
        self.close()
        self._held = np.zeros(len(self._places))
        self._next = np.zeros(len(self._places))
        self._waiting: bytes | None = None  # state of the unit that is restored when its process begins
        if self._filter is not None:
            self._filter.state = np.zeros(3)

    def close(self) -> None:
        """End the process."""
        if self._unit is not None:
            self._unit.close()
        self._unit = None

    def act(self, k: int, row: np.ndarray) -> np.ndarray:
        """The inputs (nu,) of step k with what the controller commands. Raises SpecError where it does not begin, and
        StepError where it ends."""
        if self._unit is None:
            c = self.controller
            self._unit = _Process(self._where)
            names = {'inputs': [*c.inputs], 'outputs': [*c.outputs], 'parameters': c.parameters}
            first = self._unit.ask({'open': c.fmu, 'folder': self._unit.folder.name} | names)
            self._require_units(first)
            if self._waiting is not None:
                self._unit.ask({'restore': base64.b64encode(self._waiting).decode()})
            elif k == 0:
                self._next = np.array(first['values'], float)
            else:
                raise SpecError(f'{self._where}: the run goes on at step {k}, and the unit can only begin at its start')
            self._waiting = None
        if k % self._period == 0:
            self._held = self._next
            measured = self._measure()
            t, length = k * self._h, self._period * self._h
            try:
                answer = self._unit.ask({'step': [t, length], 'inputs': measured.tolist()})
            except SpecError as error:
                raise StepError(f'{error}; the run ends at t = {t:g} s') from None
            self._next = np.array(answer['values'], float)
        if not np.isfinite(self._held).all():
            worst = [*self.controller.outputs][int(np.flatnonzero(~np.isfinite(self._held))[0])]
            raise StepError(f'{self._where}: output {worst!r} is not finite at t = {k * self._h:g} s')
        row = row.copy()
        row[self._places] = self._held
        if self._filter is not None:
            row[self._steering] = self._filter.turn(float(self._held[self._turned[0]]))
        return row

    def _require_units(self, opened: Mapping[str, Any]) -> None:
        """Refuse variables in another unit than what they are connected to."""
        c = self.controller
        for name, other in (*c.inputs.items(), *c.outputs.items()):
            there, here = _plain(opened['units'].get(name) or ''), _plain(self._units.get(other, ''))
            if there and here and there != here:
                text = f'is in {there!r}, and {other} in {here!r}: convert it in the unit of co-simulation'
                raise SpecError(f'{self._where}: variable {name!r} {text}')

    @property
    def state(self) -> np.ndarray:
        """Commands, filter, and the bytes of the state of the unit; assign it to restore."""
        own = np.zeros(3) if self._filter is None else self._filter.state
        inside = self._waiting or b''
        if self._unit is not None:
            inside = base64.b64decode(self._unit.ask({'save': True})['state'])
        return np.concatenate([self._held, self._next, own, np.frombuffer(inside, np.uint8).astype(float)])

    @state.setter
    def state(self, value: np.ndarray) -> None:
        n = len(self._places)
        if value.ndim != 1 or len(value) < 2 * n + 3:
            raise SpecError(f'restore: the saved state has no controller {self.controller.fmu}: other scene')
        self.close()
        self._held, self._next = value[:n].copy(), value[n : 2 * n].copy()
        if self._filter is not None:
            self._filter.state = value[2 * n : 2 * n + 3]
        inside = value[2 * n + 3 :]
        self._waiting = inside.astype(np.uint8).tobytes() if len(inside) else None


def unit_of(name: str) -> str:
    """Unit of an input of a vehicle, '' where it depends on the model."""
    if name.startswith(('drive_torque', 'brake_torque', 'steering_torque')):
        return 'N m'
    return 'rad' if name in (STEERING, 'road_wheel') else ''


def _plain(unit: str) -> str:
    """A unit in one spelling, whatever its tool writes (N.m, Nm and N m; m/s2 and m/s^2); '' for none."""
    text = unit.replace('.', ' ').replace('*', ' ').replace('Nm', 'N m').replace('^', '').strip()
    return '' if text in ('1', '-') else text


class _Process:
    """The process in which a unit runs. where: head of sentences. folder: for what is unpacked; it goes with the
    process, even where that crashed."""

    def __init__(self, where: str) -> None:
        self._where = where
        self.folder = tempfile.TemporaryDirectory(prefix='mbd_controller_', ignore_cleanup_errors=True)
        command = [sys.executable, '-m', 'solver.inputs.fmu_process']
        # A session of its own: Ctrl-C is for the run, which ends the process, and no crash of the unit.
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0, start_new_session=True
        )

    def ask(self, question: Mapping[str, Any]) -> dict[str, Any]:
        """The answer to a question, as JSON. Raises SpecError where there is none, or the unit refuses."""
        process, line = self._process, b''
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(json.dumps(question).encode() + b'\n')
            while not line.endswith(b'\n'):
                if not select.select([process.stdout], [], [], PATIENCE)[0]:
                    raise SpecError(f'{self._where}: no answer for {PATIENCE:g} s: the unit hangs')
                part = process.stdout.read(1 << 20)
                if not part:
                    raise BrokenPipeError
                line += part
        except (BrokenPipeError, ConnectionResetError):
            code = process.wait()
            how = f'signal {-code}' if code < 0 else f'exit code {code}'
            raise SpecError(f'{self._where}: its process ended ({how}): the unit crashed') from None
        answer: dict[str, Any] = json.loads(line)
        if 'error' in answer:
            raise SpecError(f'{self._where}: {answer["error"]}')
        return answer

    def close(self) -> None:
        """End it."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        try:
            self._process.wait(1.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()
        self.folder.cleanup()
