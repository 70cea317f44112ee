"""Switches: subsystems of a vehicle that are left out of its model, at every level."""

from __future__ import annotations

from collections.abc import Mapping

from solver.errors import SceneError
from solver.levels.derived import Switched
from solver.model.spec import ModelSpec


def switched(model: ModelSpec, switches: Mapping[str, str]) -> tuple[ModelSpec, tuple[Switched, ...]]:
    """(the model without the subsystems that are off, every subsystem and why it is on or off). Raises SceneError."""
    off = [name for name, state in switches.items() if state == 'off']
    if off:
        raise SceneError(f"switches.{off[0]} = 'off': not available yet; remove it")
    return model, ()
