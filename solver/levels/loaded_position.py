"""Loaded position: travels at which a vehicle stands on its tires, away from its design position."""

from __future__ import annotations

from solver.analysis.figures import standing
from solver.errors import ConsistencyError
from solver.model.spec import ModelSpec
from solver.scene import Scene
from solver.vehicle.hardpoints import SIDES
from solver.vehicle.size import size_of

# m off the design position: nearer to it the figures of the bench, which are those of the design position, hold too
LOADED = 0.03


def loaded_position(spec: ModelSpec) -> dict[str, float]:
    """Travels [m] at which the vehicle stands on its tires, by input of the bench, each the mean of an axle.

    The result is empty for a vehicle that stands nearer than LOADED to its design position, or finds no equilibrium:
    its compliance is that of the design position.
    """
    try:
        simulation = standing(Scene(name='standing', model=spec))
    except ConsistencyError:
        return {}
    place, names = simulation.snapshot().joint_position, simulation.channels.joints
    found: dict[str, float] = {}
    for axle in ('front', 'rear'):
        inputs = [f'travel_{axle}_{side}' for side in SIDES]
        found |= dict.fromkeys(inputs, 0.5 * sum(float(place[names.index(name)]) for name in inputs))
    return found if max(map(abs, found.values())) > LOADED * size_of(spec).length else {}
