"""Level of detail: a scene with another model, and a report that says what the model leaves out and in which range it
holds."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

from solver.elements.registry import FORCES
from solver.engine import Engine
from solver.findings import LevelReport
from solver.model.compile import joint_coordinates
from solver.model.spec import ModelSpec
from solver.scene import Fidelity, Scene
from solver.step.settings import IntegratorSettings

SEEN = 1e-3  # m: by which an imu may be moved unsaid, 0.02 m/s^2 at 20 rad/s^2
FINE = 2e-3  # s; of longer steps the iterations that are set are made


@dataclass(frozen=True, kw_only=True)
class Derived:
    """A level of a scene. scene: what is simulated: `fidelity: full`, another model, the resolved text of the scene it
    is derived from. as_given: the model is that of the scene as given, and no plan certifies it. engine: makes the
    engine of that scene where the level has a step of its own (None: the kind of the integrator decides).
    """

    scene: Scene
    level: Fidelity
    report: LevelReport
    as_given: bool = False
    engine: Callable[[Scene], Engine] | None = None


def with_one_iteration(settings: IntegratorSettings) -> IntegratorSettings:
    """The settings of a level with next to no loops of joints, of which a second iteration finds next to nothing: steps
    of a fixed number make one up to FINE, and more where it does not contract
    (docs/decisions/0007-iterations-in-an-impact.md); the others hold.
    """
    one = settings.mode == 'fixed' and settings.h <= FINE
    return dataclasses.replace(settings, iterations=1) if one else settings


def moved_imu(whole: ModelSpec, less: ModelSpec) -> tuple[str, ...]:
    """In words, where less of a model shows its accelerations: at the centre of mass of its chassis, which other bodies
    may be part of."""
    one, other = (next(b for b in m.bodies if b.name == m.chassis) if m.chassis else m.bodies[0] for m in (whole, less))
    shift = [b - a for a, b in zip(one.com, other.com, strict=True)]
    if max(map(abs, shift)) < SEEN:
        return ()
    x, y, z = (f'{1e3 * part:.0f}' for part in shift)
    return (
        f'imu and accelerations at the centre of mass of {one.name} alone: they are those of the centre of mass of '
        f'all that is part of it here, ({x}, {y}, {z}) mm from there',
    )


def channels(model: ModelSpec) -> list[str]:
    """Channels that a model publishes, by the names of its parts: 'joint <name>', 'body <name>', 'element <name>' and
    'wheel <name>'."""
    coordinates = [c.name for joint in model.joints for c in joint_coordinates(joint)] + [
        c.name for c in model.coordinates
    ]
    return [
        *(f'joint {name}' for name in coordinates),
        *(f'body {body.name}' for body in model.bodies),
        *(
            f'{"wheel" if kind.wheels else "element"} {spec.name}'
            for kind in FORCES
            for spec in getattr(model, kind.name)
        ),
    ]
