"""A unit of co-simulation in FMPy, as the tests of `mbd fmu` drive it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import fmpy
from fmpy.fmi2 import FMU2Slave, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE
from fmpy.fmi3 import FMU3Slave


class Unit:
    """Archive that is unpacked. said: sentences in the log of its instances."""

    def __init__(self, file: Path, version: int) -> None:
        self.file, self.version = file, version
        self.folder = Path(fmpy.extract(str(file)))
        self.description = fmpy.read_model_description(str(file), validate=True, validate_model_structure=True)
        self.reference = {v.name: v.valueReference for v in self.description.modelVariables}
        self.said: list[str] = []

    def instance(self, **other: Any) -> FMU2Slave | FMU3Slave:
        """A new instance in its initial state; other: in place of what the archive says."""
        d = self.description
        kind = FMU2Slave if self.version == 2 else FMU3Slave
        given = {'guid': d.guid, 'unzipDirectory': str(self.folder), 'modelIdentifier': d.coSimulation.modelIdentifier}
        return kind(**(given | other), instanceName='one')

    def instantiate(self, slave: FMU2Slave | FMU3Slave) -> None:
        """Instantiate it, with a log that formats nothing."""
        if self.version == 2:
            callbacks = fmi2CallbackFunctions()
            callbacks.logger = fmi2CallbackLoggerTYPE(
                lambda _, name, status, category, message: self.said.append(message.decode())
            )
            slave.instantiate(callbacks=callbacks)
        else:
            slave.instantiate(logMessage=lambda _, status, category, message: self.said.append(message.decode()))

    def begun(self, slave: FMU2Slave | FMU3Slave | None = None) -> FMU2Slave | FMU3Slave:
        """A new instance behind its initialization. slave: that of FMPy for it, in place of a new one."""
        slave = slave or self.instance()
        self.instantiate(slave)
        if self.version == 2:
            slave.setupExperiment(startTime=0.0)
        slave.enterInitializationMode()
        slave.exitInitializationMode()
        return slave

    def get(self, slave: FMU2Slave | FMU3Slave, names: list[str]) -> list[float]:
        """Values by name."""
        references = [self.reference[name] for name in names]
        return list(slave.getReal(references) if self.version == 2 else slave.getFloat64(references))

    def set(self, slave: FMU2Slave | FMU3Slave, **values: float) -> None:
        """Set inputs or parameters."""
        references = [self.reference[name] for name in values]
        (slave.setReal if self.version == 2 else slave.setFloat64)(references, list(values.values()))
