"""What drives of the level kc do to the travels of wheels, where their torque acts between a wheel and its carrier, as that of a motor in
the hub does. The carrier turns about the spin axis with the travels, by Theta (solver.elements.guide), so a torque T on the wheel lifts
with -T dTheta/ds. Shafts from a differential on the chassis do not: their torque acts against that.
"""

from __future__ import annotations

from collections.abc import Mapping

from solver.analysis.kinematics_and_compliance import CORNERS
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.model.spec import ModelSpec
from solver.vehicle.hardpoints import SIDES


def reaction(force: CoordinateForceSpec, slopes: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Coordinate -> factor of what a torque on a single wheel does to the travels besides; nothing for others. slopes: by corner those of
    Theta in the design position, over the own travel and over that of the other wheel [rad/m]."""
    corner = next((corner for corner in CORNERS if [name for name, _ in force.terms] == [f'wheel_{corner}']), None)
    if corner is None:
        return {}
    axle, _, side = corner.partition('_')
    other = f'{axle}_{next(name for name in SIDES if name != side)}'
    factor = force.terms[0][1]
    return {f'travel_{moved}': -factor * slope for moved, slope in zip((corner, other), slopes[corner], strict=True)}


def unshown(spec: ModelSpec) -> tuple[str, ...]:
    """What the torque of a differential in the housing of a live axle does that this level does not show."""
    driven = [{name for name, _ in force.terms} for force in spec.coordinate_forces if force.input is not None]
    said = 'what the drive torque of the {} axle does to its housing: it acts against the chassis, and loads both wheels alike'
    return tuple(said.format(axle) for axle in ('front', 'rear') if any({f'wheel_{axle}_{s}' for s in SIDES} <= names for names in driven))
