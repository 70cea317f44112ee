"""Where a vehicle stands on its tires, off its design position by what it is loaded with."""

from __future__ import annotations

from solver.analysis.figures import standing
from solver.errors import ConsistencyError
from solver.model.spec import ModelSpec
from solver.scene import Scene
from solver.vehicle.hardpoints import SIDES
from solver.vehicle.size import size_of

LOADED = 0.03  # m off the design position, of which the figures of a bench are: beyond, they are not those of the vehicle on the road


def stood(spec: ModelSpec) -> dict[str, float]:
    """By input of the bench the travels [m] at which the vehicle stands on its tires, each the mean of an axle; nothing for one that
    stands nearer than LOADED to its design position, or finds no equilibrium: its compliance is that of the design position."""
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
