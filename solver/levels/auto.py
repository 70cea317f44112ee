"""`fidelity: auto`: the level, switches and integrator that the plan of a scene has chosen."""

from __future__ import annotations

from solver.errors import SceneError
from solver.scene import Scene


def resolved(scene: Scene) -> Scene:
    """The scene as its plan resolves it. Raises SceneError where there is no plan."""
    raise SceneError(f"scene {scene.name!r}: fidelity = 'auto': no plan of this scene is kept; name a level, e.g. 'condensed'")
