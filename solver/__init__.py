"""Numerics and models of mbd_sim_ros: no ROS, no messages.

The public door, documented in docs/README.md:

    import solver

    simulation = solver.simulation_of(solver.load_scene('slider_crank'))
    snapshot = simulation.advance(100)

Nothing heavy is imported before the first call.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from solver.engine import Engine
    from solver.output.snapshot import Snapshot
    from solver.scene import Scene
    from solver.simulation import Simulation

# Before anything imports numba: Intel's sin, exp, ... are there on some machines only, and not those of the C library.
os.environ['NUMBA_DISABLE_INTEL_SVML'] = '1'

__all__ = ['Snapshot', 'load_scene', 'simulation_of']


def load_scene(name: str | Path, overrides: Sequence[str] = ()) -> Scene:
    """Load a scene by path or name. overrides: 'a.b.c=value' assignments. Raises SceneError (one sentence: place, value, remedy)."""
    from solver.files import scene

    return scene.load_scene(name, overrides)


def simulation_of(scene: Scene) -> Simulation:
    """The simulation of a scene at its start, by its fidelity, its switches and the kind of its integrator.

    Raises SpecError, SceneError or ConsistencyError.
    """
    from solver.engine.stepping import KINDS, Stepping
    from solver.levels import derive
    from solver.simulation import Simulation

    derived = derive(scene)
    make = derived.engine or (Stepping if derived.scene.integrator.kind in KINDS else _following)
    return Simulation(derived.scene, make, level=None if derived.as_given else derived.report)


def _following(scene: Scene) -> Engine:
    """The engine of the reference integrators; scipy's are imported where one is asked for."""
    from solver.reference.engine import Following

    return Following(scene)


def __getattr__(name: str) -> Any:
    if name == 'Snapshot':
        from solver.output.snapshot import Snapshot

        return Snapshot
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
