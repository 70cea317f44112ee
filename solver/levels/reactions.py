"""What drives of the level kc do to carriers of wheels, where their torque acts between these and the wheels, as that of a motor in the hub
or of the differential of a live axle does: the guide turns that back (solver.elements.guide). Shafts from a differential on the chassis act
against that.
"""

from __future__ import annotations

from solver.elements.coordinate_force import CoordinateForceSpec
from solver.model.spec import ModelSpec
from solver.vehicle.hardpoints import SIDES

LOST = 'what the drive torque of the {} axle does to its housing: it acts against the chassis, and loads both wheels alike'


def on_carriers(spec: ModelSpec, axle: str) -> list[CoordinateForceSpec]:
    """Forces by which an input drives the wheels of an axle from their carriers."""
    wheels = {f'wheel_{axle}_{side}' for side in SIDES}
    return [force for force in spec.coordinate_forces if force.input is not None and {name for name, _ in force.terms} <= wheels]


def unshown(spec: ModelSpec) -> tuple[str, ...]:
    """What the drive pinion in the housing of a live axle does behind a gearbox (solver.levels.powered) that this level does not show."""
    if not spec.engines:
        return ()
    final_drives = [
        {name for name, _ in force.terms} for force in spec.coordinate_forces if force.damper is not None and len(force.terms) == 3
    ]
    return tuple(LOST.format(axle) for axle in ('front', 'rear') if any({f'wheel_{axle}_{s}' for s in SIDES} <= at for at in final_drives))
