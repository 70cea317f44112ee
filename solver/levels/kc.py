"""The level `kc`."""

from __future__ import annotations

from solver.errors import SceneError
from solver.levels.derived import Derived
from solver.scene import Scene


def derive(scene: Scene) -> Derived:
    """The level `kc` of a scene. Raises SceneError."""
    raise SceneError(f"scene {scene.name!r}: fidelity = 'kc': not available yet for this vehicle; use full")
