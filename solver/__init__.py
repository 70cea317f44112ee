"""Numerics and models of mbd_sim_ros: no ROS, no messages.

The public interface, documented in docs/api.md:

    import solver

    simulation = solver.simulation_of(solver.load_scene('slider_crank'))
    snapshot = simulation.advance(100)

Nothing heavy is imported before the first call.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from solver.analysis.modes import matrices_at_rest, modes
    from solver.analysis.reactions import joint_reaction
    from solver.ensemble import Ensemble
    from solver.errors import BagError, ConsistencyError, MbdError, SceneError, SpecError, StepError
    from solver.levels import simulation_of
    from solver.output.snapshot import Channels, Snapshot
    from solver.parallel import advance_all
    from solver.reference.linearization import LinearModel, linear_model
    from solver.scene import Scene
    from solver.simulation import Simulation

# Before anything imports numba: Intel's sin, exp, ... are there on some machines only, and not those of the C library.
os.environ['NUMBA_DISABLE_INTEL_SVML'] = '1'

__all__ = [
    'BagError',
    'Channels',
    'ConsistencyError',
    'Ensemble',
    'LinearModel',
    'MbdError',
    'Scene',
    'SceneError',
    'Simulation',
    'Snapshot',
    'SpecError',
    'StepError',
    'advance_all',
    'joint_reaction',
    'linear_model',
    'load_scene',
    'load_scene_text',
    'matrices_at_rest',
    'modes',
    'simulation_of',
]
_HOMES = {  # public name -> module it is imported from when it is asked for
    **dict.fromkeys(
        ('BagError', 'ConsistencyError', 'MbdError', 'SceneError', 'SpecError', 'StepError'), 'solver.errors'
    ),
    **dict.fromkeys(('Channels', 'Snapshot'), 'solver.output.snapshot'),
    **dict.fromkeys(('matrices_at_rest', 'modes'), 'solver.analysis.modes'),
    'joint_reaction': 'solver.analysis.reactions',
    'Ensemble': 'solver.ensemble',
    **dict.fromkeys(('LinearModel', 'linear_model'), 'solver.reference.linearization'),
    'Scene': 'solver.scene',
    'Simulation': 'solver.simulation',
    'advance_all': 'solver.parallel',
    'simulation_of': 'solver.levels',
}


def load_scene(name: str | Path, overrides: Sequence[str] = ()) -> Scene:
    """Load a scene by path, or by its name in config/scenes.

    overrides: 'a.b.c=value' assignments, as with --set; applied in order before anything is checked. Raises SceneError
    (one sentence: file, line, key, value, remedy).
    """
    from solver.files import scene

    return scene.load_scene(name, overrides)


def load_scene_text(text: str, name: str = 'scene', overrides: Sequence[str] = ()) -> Scene:
    """Load a scene from YAML text, e.g. the one that a recording holds (metadata `resolved_scene`).

    name: what error sentences call the text. overrides: as in load_scene(). Raises SceneError.
    """
    from solver.files import scene

    return scene.load_scene_text(text, name, overrides)


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
