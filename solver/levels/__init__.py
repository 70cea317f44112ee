"""Levels of detail: less of a vehicle, derived from the whole one by rules, for any vehicle file.

The one door is `derive(scene)`: first the switches take subsystems out of the model (solver.levels.switches), then the
rules of a level reduce what is left, each in its module. The derived scene holds a model as given (`fidelity: full`),
so that everything that simulates, records and analyses treats it like any other; its report says what it left out, and
where it holds.
"""

from __future__ import annotations

import dataclasses
import importlib
from typing import TYPE_CHECKING

from solver.errors import SceneError, SpecError
from solver.findings import LevelReport
from solver.levels.derived import Derived, channels, moved_imu, with_one_iteration
from solver.levels.switches import switched
from solver.scene import Scene
from solver.step.settings import IntegratorSettings

if TYPE_CHECKING:
    from solver.engine import Engine
    from solver.simulation import Simulation

__all__ = ['Derived', 'LevelReport', 'derive', 'simulation_of']

LEVELS = {
    'condensed': 'solver.levels.condensed',
    'kc': 'solver.levels.kc',
    'single_track': 'solver.levels.single_track',
}
"""Level -> the module with its `derive(scene) -> Derived`: from a scene with `fidelity: full` and no switches."""


def integrator_of(fidelity: str, settings: IntegratorSettings) -> IntegratorSettings:
    """The settings with which a level is simulated in place of these: derive() has them in its scene."""
    return with_one_iteration(settings) if fidelity in ('condensed', 'kc') else settings


def derive(scene: Scene) -> Derived:
    """Derived scene that is simulated in place of a scene. Raises SceneError where its vehicle has no such level, or
    the scene asks for what the level lacks."""
    from solver.levels.auto import Certificate, certificate_of, resolved, with_certificate

    certificate: Certificate | None
    if scene.fidelity == 'auto':
        scene, certificate = resolved(scene)
    else:
        certificate = certificate_of(scene)
    # the map is that of the whole vehicle, and a plan is one of the scene as it is written
    if scene.maneuver.by_road_wheel:
        from solver.levels.road_wheel import by_steering_wheel

        scene = by_steering_wheel(scene)
    model, switches = switched(scene.model, scene.switches)
    try:
        given = dataclasses.replace(scene, model=model, fidelity='full', switches={})
        if scene.fidelity == 'full':
            whole = scene if not scene.reduced else given
            derived = Derived(
                scene=whole, level='full', report=LevelReport(), as_given=not scene.reduced and certificate is None
            )
        else:
            derived = importlib.import_module(LEVELS[scene.fidelity]).derive(given)
    except SpecError as error:
        raise SceneError(f'fidelity = {scene.fidelity!r}: {error}') from None
    left = set(channels(derived.scene.model))
    absent = tuple(name for name in channels(scene.model) if name not in left)
    lost = (*derived.report.lost, *moved_imu(scene.model, derived.scene.model))
    report = dataclasses.replace(derived.report, lost=lost, absent=absent, switched=switches)
    if certificate is not None:
        report = with_certificate(report, certificate)
    return dataclasses.replace(derived, report=report)


def simulation_of(scene: Scene) -> Simulation:
    """The simulation of a scene at its start, by its fidelity, its switches and the kind of its integrator.

    Compiles what it needs, which takes a minute the first time (`mbd compile`). Raises SpecError or SceneError for what
    cannot be simulated, and ConsistencyError where no consistent start was found.
    """
    from solver.engine.stepping import KINDS, Stepping
    from solver.simulation import Simulation

    derived = derive(scene)
    make = derived.engine or (Stepping if derived.scene.integrator.kind in KINDS else _following)
    return Simulation(derived.scene, make, level=None if derived.as_given else derived.report)


def _following(scene: Scene) -> Engine:
    """The engine of the reference integrators; scipy's are imported where one is asked for."""
    from solver.reference.engine import Following

    return Following(scene)
