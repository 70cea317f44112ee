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
    from solver.simulation import Simulation

    level, simulate = None, None
    if scene.reduced:
        from solver.levels import derive

        derived = derive(scene)
        scene, level, simulate = derived.scene, derived.report, derived.simulate
    else:
        if scene.require.accuracy:
            from solver.levels.auto import certificate_of, with_certificate
            from solver.levels.derived import LevelReport

            certificate = certificate_of(scene)
            level = None if certificate is None else with_certificate(LevelReport(), certificate)
        if scene.maneuver.by_road_wheel:
            from solver.levels.road_wheel import by_steering_wheel

            scene = by_steering_wheel(scene)
    if simulate is not None:
        simulation = simulate(scene)
    elif scene.integrator.kind in Simulation.KINDS:
        simulation = Simulation(scene)
    else:
        from solver.reference.simulation import ReferenceSimulation

        simulation = ReferenceSimulation(scene)
    simulation.level = level
    return simulation


def __getattr__(name: str) -> Any:
    if name == 'Snapshot':
        from solver.output.snapshot import Snapshot

        return Snapshot
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
