"""The level `single_track`."""

from __future__ import annotations

from solver.errors import SceneError
from solver.levels.derived import Derived
from solver.scene import Scene


def derive(scene: Scene) -> Derived:
    """The level `single_track` of a scene. Raises SceneError."""
    raise SceneError(f"scene {scene.name!r}: fidelity = 'single_track': not available yet for this vehicle; use full")
