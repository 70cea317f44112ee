"""Every kind of element there is, one line each. Forces act and are shown in this order; wheels come last."""

from __future__ import annotations

from solver.elements.adjustable_damper import ADJUSTABLE_DAMPERS
from solver.elements.aero_drag import AERO_DRAGS
from solver.elements.applied_force import APPLIED_FORCES
from solver.elements.brake import BRAKES
from solver.elements.bushing import BUSHINGS
from solver.elements.clutch import CLUTCHES
from solver.elements.contact import CONTACTS
from solver.elements.converter import CONVERTERS
from solver.elements.coordinate_force import COORDINATE_FORCES
from solver.elements.coupler import COUPLERS
from solver.elements.engine_map import ENGINES
from solver.elements.guide import GUIDES
from solver.elements.joint import JOINTS
from solver.elements.kind import ConstraintKind, ForceKind
from solver.elements.rod import RODS
from solver.elements.servo import SERVOS
from solver.elements.spring_damper import SPRING_DAMPERS
from solver.elements.strut import STRUTS
from solver.elements.tire_pacejka import TIRES
from solver.elements.transmission import TRANSMISSIONS

CONSTRAINTS: tuple[ConstraintKind, ...] = (
    JOINTS,
    CONTACTS,
    COUPLERS,
)
FORCES: tuple[ForceKind, ...] = (
    SPRING_DAMPERS,
    BUSHINGS,
    COORDINATE_FORCES,
    ADJUSTABLE_DAMPERS,
    RODS,
    STRUTS,
    TRANSMISSIONS,
    BRAKES,
    SERVOS,
    ENGINES,
    CONVERTERS,
    CLUTCHES,
    GUIDES,
    APPLIED_FORCES,
    AERO_DRAGS,
    TIRES,
)
KINDS: tuple[ConstraintKind | ForceKind, ...] = (*CONSTRAINTS, *FORCES)


def _checked() -> dict[str, ForceKind]:
    names = [kind.name for kind in KINDS]
    double = {name for name in names if names.count(name) > 1}
    if double:
        raise TypeError(f'kinds of elements: the name {min(double)!r} is used twice')
    if [kind.wheels for kind in FORCES] != sorted(kind.wheels for kind in FORCES):
        raise TypeError('kinds of elements: wheels must come last among the forces')
    return {kind.name: kind for kind in FORCES}


FORCE_BY_NAME = _checked()
