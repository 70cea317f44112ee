"""The process of a controller (solver.inputs.controllers): a unit of co-simulation behind lines of JSON.

`python -m solver.inputs.fmu_process` answers every line on the standard input by one on the standard output: values,
or a sentence under `error`. What the unit itself prints goes to the standard error.
"""

from __future__ import annotations

import base64
import ctypes
import json
import os
import platform
import shutil
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

FLOATS = ('Real', 'Float64', 'Float32')
WHOLE = ('Integer', 'Int8', 'UInt8', 'Int16', 'UInt16', 'Int32', 'UInt32', 'Int64', 'UInt64', 'Enumeration')


class Refused(Exception):
    """Refusal, as a sentence."""


class Unit:
    """An archive that is open, unpacked into `folder`. said: messages of the unit; the last one explains what it
    refuses."""

    def __init__(
        self, path: str, folder: str, inputs: Sequence[str], outputs: Sequence[str], parameters: dict[str, float]
    ) -> None:
        try:
            import fmpy
            from fmpy.simulation import instantiate_fmu
        except ImportError:
            raise Refused('controllers need FMPy: python -m pip install "mbd_sim_ros[fmu]"') from None
        if not Path(path).is_file():
            raise Refused('there is no such file')
        self.said: list[str] = []
        try:
            description = fmpy.read_model_description(path)
            self.folder = fmpy.extract(path, folder)
        except Exception as error:  # whatever a broken archive makes of it
            raise Refused(f'is no unit of FMI that can be read ({_line(error)})') from None
        self.variables = {v.name: v for v in description.modelVariables}
        self.version = 2 if str(description.fmiVersion).startswith('2') else 3
        if description.coSimulation is None:
            raise Refused('is for model exchange alone; export it for co-simulation')
        self._require_binary()
        for names, causality, what in ((inputs, 'input', 'inputs'), (outputs, 'output', 'outputs')):
            for name in names:
                found = self._variable(name)
                if found.causality != causality:
                    raise Refused(f'{what}: variable {name!r} has causality {found.causality!r}, not {causality!r}')
        for name in parameters:
            found = self._variable(name)
            if found.causality not in ('parameter', 'input', 'local') or found.start is None:
                raise Refused(f'parameters: variable {name!r} has causality {found.causality!r} and cannot be set')
        self.inputs = [self.variables[name] for name in inputs]
        self.outputs = [self.variables[name] for name in outputs]
        self.can_save = bool(
            description.coSimulation.canGetAndSetFMUstate and description.coSimulation.canSerializeFMUstate
        )
        try:
            self.fmu: Any = instantiate_fmu(
                self.folder, description, 'CoSimulation', logger=self._logger(), require_functions=False
            )
            if self.version == 2:
                self.fmu.setupExperiment(startTime=0.0)
            self._set([self.variables[name] for name in parameters], [*parameters.values()])
            self.fmu.enterInitializationMode()
            self.fmu.exitInitializationMode()
        except Exception as error:
            raise Refused(self._why('does not begin', error)) from None

    def _require_binary(self) -> None:
        there = sorted(entry.name for entry in (Path(self.folder) / 'binaries').glob('*'))
        wanted = {2: 'linux64', 3: 'x86_64-linux'}[self.version]
        if wanted not in there and platform.system() == 'Linux':
            raise Refused(f'has no binary for this platform ({wanted}), only for {", ".join(there) or "none"}')

    def _variable(self, name: str) -> Any:
        if name not in self.variables:
            from solver.errors import suggestion

            raise Refused(f'has no variable {name!r}{suggestion(name, self.variables)}')
        found = self.variables[name]
        if found.type not in (*FLOATS, *WHOLE, 'Boolean'):
            raise Refused(f'variable {name!r} is of type {found.type}; numbers and Booleans can be connected')
        return found

    def _logger(self) -> Any:
        if self.version == 3:
            return lambda _, status, category, message: self.said.append(_text(message))
        from fmpy.fmi2 import fmi2CallbackLoggerTYPE

        def log(_: Any, instance: Any, status: Any, category: Any, message: Any) -> None:
            self.said.append(_text(message))

        self._kept = fmi2CallbackLoggerTYPE(log)
        return log

    def _why(self, what: str, error: Exception) -> str:
        said = self.said[-1] if self.said else _line(error)
        return f'{what}: {said}'

    def _by_type(self, variables: Sequence[Any], do: str) -> dict[str, Callable]:
        return {v.type: getattr(self.fmu, do + {'Enumeration': 'Integer'}.get(v.type, v.type)) for v in variables}

    def _set(self, variables: Sequence[Any], values: Sequence[float]) -> None:
        calls = self._by_type(variables, 'set')
        for variable, value in zip(variables, values, strict=True):
            if variable.type not in FLOATS:
                value = round(value)
            calls[variable.type]([variable.valueReference], [value])

    def values(self) -> list[float]:
        """Outputs now."""
        calls = self._by_type(self.outputs, 'get')
        return [float(calls[v.type]([v.valueReference])[0]) for v in self.outputs]

    def units(self) -> dict[str, str | None]:
        """Units of the variables that are connected."""
        return {v.name: v.unit or getattr(v.declaredType, 'unit', None) for v in (*self.inputs, *self.outputs)}

    def step(self, t: float, length: float, inputs: Sequence[float]) -> list[float]:
        """Outputs after a step of `length` [s] from t on."""
        try:
            self._set(self.inputs, inputs)
            self.fmu.doStep(currentCommunicationPoint=t, communicationStepSize=length)
            return self.values()
        except Exception as error:
            raise Refused(self._why(f'fails in its step at t = {t:g} s', error)) from None

    def save(self) -> bytes:
        """State, or nothing where the unit cannot save its state."""
        if not self.can_save:
            return b''
        get, put, free = self._state_calls('getFMU', 'serializeFMU', 'freeFMU')
        state = get()
        data = put(state)
        free(state)
        return bytes(data)

    def restore(self, data: bytes) -> None:
        """Go on from save()."""
        if not self.can_save:
            raise Refused('cannot restore its state (canSerializeFMUstate): begin the run at its start')
        take, put, free = self._state_calls(
            'deSerializeFMU' if self.version == 2 else 'deserializeFMU', 'setFMU', 'freeFMU'
        )
        try:
            state = take(data)
            put(state)
            free(state)
        except Exception as error:
            raise Refused(self._why('does not take its state', error)) from None

    def _state_calls(self, *names: str) -> list[Callable]:
        return [getattr(self.fmu, name + ('state' if self.version == 2 else 'State')) for name in names]

    def close(self) -> None:
        """Remove what was unpacked."""
        shutil.rmtree(self.folder, ignore_errors=True)


def _text(message: Any) -> str:
    return message.decode(errors='replace') if isinstance(message, bytes) else str(message)


def _line(error: Exception) -> str:
    return ' '.join(str(error).split())[:300] or type(error).__name__


def main() -> None:
    """Answer lines until there is no more."""
    answers = os.fdopen(os.dup(1), 'w', buffering=1)
    os.dup2(2, 1)
    ctypes.CDLL(None).fflush(None)
    unit: Unit | None = None
    for line in sys.stdin:
        asked = json.loads(line)
        try:
            if 'open' in asked:
                unit = Unit(asked['open'], *(asked[key] for key in ('folder', 'inputs', 'outputs', 'parameters')))
                answer: dict[str, Any] = {'values': unit.values(), 'units': unit.units()}
            else:
                assert unit is not None
                if 'step' in asked:
                    answer = {'values': unit.step(asked['step'][0], asked['step'][1], asked['inputs'])}
                elif 'restore' in asked:
                    unit.restore(base64.b64decode(asked['restore']))
                    answer = {}
                else:
                    answer = {'state': base64.b64encode(unit.save()).decode()}
        except Refused as refused:
            answer = {'error': str(refused)}
        answers.write(json.dumps(answer) + '\n')
    if unit is not None:
        unit.close()


if __name__ == '__main__':
    main()
