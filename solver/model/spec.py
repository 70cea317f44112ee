"""ModelSpec: everything a model consists of, as data."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from solver.elements.aero_drag import AeroDragSpec
from solver.elements.applied_force import AppliedForceSpec
from solver.elements.brake import BrakeSpec
from solver.elements.bushing import BushingSpec
from solver.elements.contact import ContactSpec
from solver.elements.coordinate import CoordinateSpec
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.coupler import CouplerSpec
from solver.elements.joint import JointSpec
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.road import RoadSpec
from solver.elements.spring_damper import SpringDamperSpec
from solver.elements.tire_pacejka import TireSpec
from solver.errors import SpecError
from solver.inputs.maneuver import ACCELERATION, RATE
from solver.validate import Vector, vector

FLAT = RoadSpec()


@dataclass(frozen=True, kw_only=True)
class ModelSpec:
    """A mechanism or vehicle on a road. Names are unique within their kind; order is kept everywhere.

    Joints of kind revolute, prismatic and cylindrical define joint coordinates named after them; `coordinates` adds others.
    chassis: the body that odom and imu describe (None: the first body).
    """

    bodies: tuple[RigidBodySpec, ...]
    joints: tuple[JointSpec, ...] = ()
    contacts: tuple[ContactSpec, ...] = ()
    coordinates: tuple[CoordinateSpec, ...] = ()
    couplers: tuple[CouplerSpec, ...] = ()
    spring_dampers: tuple[SpringDamperSpec, ...] = ()
    bushings: tuple[BushingSpec, ...] = ()
    coordinate_forces: tuple[CoordinateForceSpec, ...] = ()
    brakes: tuple[BrakeSpec, ...] = ()
    applied_forces: tuple[AppliedForceSpec, ...] = ()
    aero_drags: tuple[AeroDragSpec, ...] = ()
    tires: tuple[TireSpec, ...] = ()
    road: RoadSpec = FLAT
    gravity: Vector = (0.0, 0.0, -9.81)
    inputs: tuple[str, ...] = ()
    chassis: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, 'gravity', vector('model', 'gravity', self.gravity))
        if not self.bodies:
            raise SpecError('model: bodies is empty: a model needs at least one body')
        for kind in [
            'bodies',
            'joints',
            'contacts',
            'coordinates',
            'couplers',
            'spring_dampers',
            'bushings',
            'coordinate_forces',
            'brakes',
            'applied_forces',
            'aero_drags',
            'tires',
        ]:
            seen: set[str] = set()
            for spec in getattr(self, kind):
                if spec.name in seen:
                    raise SpecError(f'{spec.where}: name = {spec.name!r}: is used twice among the {kind}; rename one')
                seen.add(spec.name)


def used_inputs(model: ModelSpec) -> tuple[str, ...]:
    """Input channels that the elements of a model mention, in order of first mention; drivers with their derivatives."""
    names: dict[str, None] = {}
    for field in dataclasses.fields(model):
        specs = getattr(model, field.name)
        for spec in specs if isinstance(specs, tuple) else ():
            name = getattr(spec, 'input', None)
            if isinstance(name, str):
                names[name] = None
                if isinstance(spec, CouplerSpec):
                    names[name + RATE] = names[name + ACCELERATION] = None
    return tuple(names)
