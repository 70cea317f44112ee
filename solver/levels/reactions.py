"""Reactions of drives of the level kc on carriers of wheels, where their torque acts between these and the wheels, as
that of a motor in the hub or of the differential of a live axle does: the guide turns that back
(solver.elements.guide). Shafts from a differential on the chassis act against that.
"""

from __future__ import annotations

from solver.elements.coordinate_force import CoordinateForceSpec
from solver.model.spec import ModelSpec
from solver.vehicle.hardpoints import SIDES

EFFORT = (
    'efforts of shafts: those of the driven wheels have the drive torque, which the whole vehicle shows at its shafts'
)
LOST = (
    'what the drive torque of the {} axle does to its housing: it acts against the chassis, and loads both wheels alike'
)
ANGLED = (
    'what the drive torque turns steered wheels by through half shafts at an angle: the torque at the steering '
    'wheel is without'
)
KINGPINS = (
    'what the drive torque of the {} axle turns its knuckles by about their kingpins: the torque at the '
    'steering wheel is without'
)


def turned_from_carriers(spec: ModelSpec, axle: str) -> dict[str, str]:
    """Coordinates in which the wheels of an axle turn against what carries them, the housing of a steered live axle
    too: by name the coordinate of the wheel."""
    wheels = {f'wheel_{axle}_{side}': f'wheel_{axle}_{side}' for side in SIDES}
    shafts = {f'shaft_{axle}_{side}': f'wheel_{axle}_{side}' for side in SIDES}
    return wheels | {c.name: shafts[c.name] for c in spec.coordinates if c.name in shafts and c.i.body != spec.chassis}


def on_carriers(spec: ModelSpec, axle: str) -> list[CoordinateForceSpec]:
    """Forces by which an input drives the wheels of an axle from their carriers, over the coordinates of the wheels."""
    turned = turned_from_carriers(spec, axle)
    driving = [
        force
        for force in spec.coordinate_forces
        if force.input is not None and {name for name, _ in force.terms} <= turned.keys()
    ]
    return [force.replace(terms=tuple((turned[name], factor) for name, factor in force.terms)) for force in driving]


def at_wheels(spec: ModelSpec) -> tuple[str, ...]:
    """Sentences on what efforts of wheels have here and not in the whole vehicle, whose drive torque acts on shafts."""
    wheels = {f'wheel_{axle}_{side}' for axle in ('front', 'rear') for side in SIDES}
    shafts = [
        force
        for force in spec.coordinate_forces
        if force.input == 'drive_torque' and not {name for name, _ in force.terms} <= wheels
    ]
    return (EFFORT,) if shafts or spec.engines else ()


def unshown(spec: ModelSpec) -> tuple[str, ...]:
    """Sentences on reactions of the drive pinion in the housing of a live axle behind a gearbox
    (solver.levels.powered), which this level does not show."""
    if not spec.engines:
        return ()
    final_drives = [
        {name for name, _ in force.terms}
        for force in spec.coordinate_forces
        if force.damper is not None and len(force.terms) == 3
    ]
    turned = {axle: turned_from_carriers(spec, axle) for axle in ('front', 'rear')}
    return tuple(
        LOST.format(axle)
        for axle, names in turned.items()
        if any(len(names.keys() & at) == len(SIDES) for at in final_drives)
    )


def without_angles(spec: ModelSpec) -> tuple[str, ...]:
    """Sentences on effects of half shafts on the steering that are lost where wheels turn as with ideal shafts, which
    pass on no more than the angle of their ends."""
    steered = {tire.marker.body for tire in spec.tires if tire.name.startswith('front_')}
    shafts = [
        joint for joint in spec.joints if joint.kind == 'constant_velocity' and {joint.i.body, joint.j.body} & steered
    ]
    return (ANGLED,) if shafts else ()


def without_kingpins(spec: ModelSpec) -> tuple[str, ...]:
    """Sentences on effects of the shafts of steered live axles on the steering that are lost where the torque of a
    drive acts on knuckles instead of the housing."""
    turned = {axle: turned_from_carriers(spec, axle) for axle in ('front', 'rear')}
    return tuple(
        KINGPINS.format(axle) for axle, names in turned.items() if any(name.startswith('shaft_') for name in names)
    )
