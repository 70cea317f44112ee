"""An engine that turns at the level kc: crankshaft and turbine stay, with bearings on the chassis, and so do map,
converter and clutches. The gearbox turns the wheels instead of its output shafts, by the slopes of those shafts over
the spins of the wheels: an open differential is half of each, as in the shafts themselves. Parts between gearbox and
wheels have their inertia at the wheels, and do not wind up. The bench measures the vehicle without all this, its
crankshaft at rest.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import NamedTuple

from solver.elements.clutch import ClutchSpec
from solver.elements.converter import ConverterSpec
from solver.elements.engine_map import EngineSpec
from solver.elements.joint import JointSpec
from solver.elements.rigid_body import RigidBodySpec
from solver.errors import SpecError
from solver.levels.draft import Draft
from solver.model.spec import ModelSpec

KINDS = ('engines', 'converters', 'clutches')
UNMOVED = 1e-4  # slope below which a shaft does not turn with a wheel


class Powered(NamedTuple):
    """Parts of an engine besides the guides; empty for a vehicle without one."""

    bodies: tuple[RigidBodySpec, ...]
    joints: tuple[JointSpec, ...]
    engines: tuple[EngineSpec, ...]
    converters: tuple[ConverterSpec, ...]
    clutches: tuple[ClutchSpec, ...]


def without_engine(spec: ModelSpec) -> ModelSpec:
    """The model without what its engine does."""
    return dataclasses.replace(spec, engines=(), converters=(), clutches=()) if spec.engines or spec.clutches else spec


def powered(spec: ModelSpec, slopes: Mapping[str, Mapping[str, float]]) -> Powered:
    """Engine and gearbox of a vehicle; slopes: `coordinates` of solver.levels.maps.measured(). Raises SpecError for
    what turns no wheel."""
    draft = Draft(spec)
    turned = {name for converter in spec.converters for name in (converter.pump, converter.turbine)}
    turned |= {engine.coordinate for engine in spec.engines} | {clutch.shaft for clutch in spec.clutches}
    bodies, joints = [], []
    for joint in spec.joints:
        if joint.name in turned:
            bodies.append(draft.bodies[joint.j.body])
            joints.append(joint.replace(i=draft.marker(draft.chassis, *draft.placed(joint.i))))
    missing = turned - {joint.name for joint in joints}
    if missing:
        raise SpecError(f'the engine turns {min(missing)!r}, which is no shaft with a bearing; use full')
    clutches = tuple(clutch.replace(outputs=_outputs(clutch, turned, slopes)) for clutch in spec.clutches)
    return Powered(tuple(bodies), tuple(joints), spec.engines, spec.converters, clutches)


def _outputs(
    clutch: ClutchSpec, shafts: set[str], slopes: Mapping[str, Mapping[str, float]]
) -> tuple[tuple[str, float], ...]:
    """(coordinate, share) of what a clutch turns here: shafts of the engine, and wheels."""
    shares: dict[str, float] = {}
    for name, share in clutch.outputs:
        if name not in shafts and name not in slopes:
            raise SpecError(f'{clutch.where}: {name!r} turns with no wheel; use full')
        for coordinate, slope in (
            ((name, 1.0),) if name in shafts else ((f'wheel_{corner}', s) for corner, s in slopes[name].items())
        ):
            shares[coordinate] = shares.get(coordinate, 0.0) + share * slope
    return tuple((name, round(share, 9)) for name, share in shares.items() if abs(share) > UNMOVED)
