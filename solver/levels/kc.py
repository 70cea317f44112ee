"""The level `kc`: a chassis on four wheels that follow maps of kinematics and compliance, measured on the full vehicle.

bodies    the chassis, with all parts that do not move with a wheel; four wheels; the steering wheel; a beam between the
              wheels of an axle that share mass (a live axle, a twist beam)
axles     one guide each (solver.elements.guide) in place of arms, links, bushings, subframes, springs, dampers, bars,
rack
kept      tires, road, drag, steering wheel and its driver; drive torque, between the driven wheels and the chassis (of
a
motor in a hub: and the carrier); power steering, on a pinion (solver.levels.assisted); an engine that turns,
              with clutch and gearbox (solver.levels.powered)

The level conserves: mass, centre of mass and inertia of the vehicle in the design position; static loads, wheel rates,
and the curves of kinematics and compliance; the laws of brakes and dampers; the masses that move with the travel of a
wheel and of both wheels of an axle, and the inertia that turns with a wheel. (These are twice the kinetic energy of the
full model at unit rates, along the tangents of the maps.) It loses the vibration of the parts that the guides replace.

The model has no loop of joints, so that one iteration a step is enough (solver.levels.derived.with_one_iteration).

The file is long because _Reduction puts the parts of one model together, and each of its methods makes one kind of
part. Measuring and fitting the maps is in maps.py and map_fits.py.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from solver.analysis.kinematics_and_compliance import CORNERS, wheel_centers
from solver.compiled.portable import inverse, product
from solver.disk import derived
from solver.elements.coordinate import CoordinateSpec
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.guide import GuideSpec
from solver.elements.guide_map import BESIDE
from solver.elements.laws import Law
from solver.elements.marker import WORLD, Marker
from solver.elements.registry import FORCES
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.road import RoadSpec
from solver.elements.servo import ServoSpec
from solver.errors import SpecError
from solver.findings import LevelReport, Limit
from solver.levels import maps
from solver.levels.assisted import assisted, gear_held, steering_springs, unassisted
from solver.levels.axle_masses import AxleMasses, beam, divided
from solver.levels.carried import apart, carrying
from solver.levels.derived import Derived, with_one_iteration
from solver.levels.flywheels import flywheels, spin_of
from solver.levels.map_fits import inverse_law, spring_law
from solver.levels.powered import KINDS, UNMOVED, powered, without_engine
from solver.levels.reactions import at_wheels, on_carriers, unshown, without_angles, without_kingpins
from solver.model.frames import matrix, quaternion
from solver.model.spec import ModelSpec, used_inputs
from solver.remembered import of_same
from solver.scene import Scene
from solver.vehicle.actuation import TORQUE
from solver.vehicle.hardpoints import SIDES, marker_at
from solver.vehicle.parts import UP, vector_of
from solver.vehicle.size import size_of
from solver.vehicle.trailer import refuse_trailer
from solver.vehicle.transfer import refuse_locked, without_connections

AXLES = ('front', 'rear')
# Frequency [Hz] of wheel travel (speed over wavelength of the road) and steering up to which the level holds, of a
# passenger car.
FASTEST = 10.0
# Damping over stiffness [s] of the compliance of a guide, of a passenger car: that of usual rubber bushings.
LAG = 0.002
CROSSED = 0.05  # travel of a second damper of a wheel, relative to the first one, up to which it is left out
REPLACED = ('spring_dampers', 'bushings', 'brakes', 'servos')  # kinds of forces that the guides replace
MAPS = 'the maps end there, and go on linearly'

LOST = (
    'vibration of engine, subframes, links, rack and driveline (above about 8 Hz)',
    'changes of compliance: it is linear, measured in the design position (where the vehicle stands, if that is over '
    '30 mm away), and the other wheel changes it by a cubic polynomial; on its stops understeer is a few percent off',
    'inertia of links and leaf springs in compliance: what moves with the travel loads it, the rest is in the chassis',
    'different speeds of propeller shaft and gears: their inertia turns with both driven wheels in equal shares',
)
ROLL = Limit(
    quantity='roll',
    unit='rad',
    low=-0.5,
    high=0.5,
    why='a car that rolls over falls on parts that this level does not have',
)
FREQUENCY = Limit(  # of a passenger car
    quantity='frequency',
    unit='Hz',
    high=FASTEST,
    why='engine and subframes do not vibrate; compared up to waves of 2 m at 20 m/s',
)


def derive(scene: Scene) -> Derived:
    """The level `kc` of a scene. Raises SpecError for a vehicle that is not a car with two axles, or has a part it
    cannot model."""
    vehicle, reduction, model = _reduced(scene.model)
    derived = dataclasses.replace(scene, model=model, integrator=with_one_iteration(scene.integrator))
    high = -min(guide.travel[0] for guide in model.guides)
    travel = Limit(quantity='suspension_travel', unit='m', low=-high, high=high, why=MAPS)
    turned = max(-guide.steering[0] for guide in model.guides)
    steering = Limit(quantity='steering_wheel_angle', unit='rad', low=-turned, high=turned, why=MAPS)
    without = unassisted(vehicle, reduction.data['gear']['lengths']) if reduction.assisted is None else ()
    drives = (part for said in (unshown, at_wheels, without_angles, without_kingpins) for part in said(vehicle))
    lost = (*LOST, *without, *drives, *without_connections(vehicle))
    slower = 1.0 / size_of(vehicle).time
    frequency = dataclasses.replace(FREQUENCY, high=FASTEST * slower)
    report = LevelReport(lost=lost, validity=(travel, steering, *_lateral(vehicle), ROLL, frequency))
    return Derived(scene=derived, level='kc', report=report)


def _lateral(spec: ModelSpec) -> tuple[Limit, ...]:
    """(limit of the lateral acceleration), or () for a car without bushings, whose compliance is zero."""
    if not spec.bushings:
        return ()
    return (
        Limit(
            quantity='lateral_acceleration',
            unit='m/s^2',
            low=-9.0,
            high=9.0,
            why='compliance is that of moderate loads',
        ),
    )


def kc_model(spec: ModelSpec) -> ModelSpec:
    """The model of the level `kc` of a vehicle. Raises SpecError as derive() does."""
    return _reduced(spec)[2]


@of_same
def _reduced(spec: ModelSpec) -> tuple[ModelSpec, _Reduction, ModelSpec]:
    """(the vehicle without what it carries, its reduction, the model of the level)."""
    vehicle, more = apart(spec)
    reduction = _reduction(vehicle)
    return vehicle, reduction, carrying(reduction.model(), more, spec)


def _reduction(spec: ModelSpec) -> _Reduction:
    _require_car(spec)
    standing, servo = gear_held(dataclasses.replace(without_engine(spec), road=RoadSpec()))
    return _Reduction(spec, derived('kc', repr(standing), lambda: maps.measured(standing)), servo)


def _require_car(spec: ModelSpec) -> None:
    """Raise SpecError for a vehicle that the level cannot be measured on."""
    refuse_trailer(spec)
    refuse_locked(spec)
    if TORQUE in spec.inputs:
        raise SpecError(
            'actuation.steering is torque, and this level is measured with a held steering wheel; use condensed or full'
        )
    if {tire.name for tire in spec.tires} != set(CORNERS):
        raise SpecError('a car with the wheels front_left, front_right, rear_left and rear_right is needed; use full')
    names = {c.name for c in spec.coordinates} | {joint.name for joint in spec.joints}
    for corner in CORNERS:
        for name in (f'travel_{corner}', f'wheel_{corner}'):
            if name not in names:
                raise SpecError(f'the vehicle has no coordinate {name!r}; use full')


class _Reduction:
    """Makes the model of the level from a vehicle and its measured maps (data)."""

    def __init__(self, spec: ModelSpec, data: dict[str, Any], servo: ServoSpec | None) -> None:
        self.spec, self.data, self.size = spec, data, size_of(spec)
        self.assisted = None if servo is None else assisted(spec, servo, data['gear'], data['steering'])
        self.powered = powered(spec, data['coordinates'])
        self.bodies = {b.name: b for b in spec.bodies}
        self.joints = {j.name: j for j in spec.joints}
        self.chassis = self.bodies[spec.chassis or spec.bodies[0].name]
        self.tires = {tire.name: tire for tire in spec.tires}
        self.centers = wheel_centers(spec)
        for corner, tire in self.tires.items():
            if any(tire.marker.position):
                raise SpecError(f'tire {corner!r}: the marker must be at the origin of its body')

    def model(self) -> ModelSpec:
        """The model of the level."""
        masses = {axle: self._masses(axle) for axle in AXLES}
        each = [mass for axle in AXLES for mass in masses[axle].wheels]
        wheels = {corner: self._wheel(corner, mass) for corner, mass in zip(CORNERS, each, strict=True)}
        hands, joints, couplers = self._steering()
        gear, engine = self.assisted, self.powered
        hands, joints = (*hands, *engine.bodies), (*joints, *engine.joints)
        if gear is not None:
            hands, joints = (*hands, gear.body), (*joints, gear.joint)
        coordinates = [self._spin(c, wheels[c]) for c in CORNERS] + [self._travel(c, wheels[c]) for c in CORNERS]
        turned = [flywheels(self.chassis, c, self.centers[c], wheels[c], self.data[c]) for c in CORNERS]
        added = [part for parts in turned for part in parts]
        beams = [
            beam(
                f'bounce_{axle}',
                masses[axle].shared,
                self.chassis,
                [(wheels[c], self.centers[c]) for c in CORNERS if c.startswith(axle)],
            )
            for axle in AXLES
            if masses[axle].shared
        ]
        bodies = (*wheels.values(), *hands, *(body for body, _, _ in added), *(one.body for one in beams))
        chassis = self._rest(bodies)
        model = ModelSpec(
            bodies=(chassis, *bodies),
            joints=(*joints, *(bearing for _, bearing, _ in added), *(joint for one in beams for joint in one.joints)),
            couplers=(*couplers, *(gear for _, _, gear in added), *(one.coupler for one in beams)),
            coordinates=(*coordinates, *(coordinate for one in beams for coordinate in one.coordinates)),
            guides=tuple(self._guide(axle, wheels, masses[axle].shared, couplers) for axle in AXLES),
            coordinate_forces=(
                *self._drives(),
                *self._held({joint.name for joint in joints}),
                *(gear.forces if gear else ()),
            ),
            servos=() if gear is None else (gear.servo,),
            **{kind: getattr(engine, kind) for kind in KINDS},
            tires=self.spec.tires,
            road=self.spec.road,
            gravity=self.spec.gravity,
            chassis=chassis.name,
            category=self.spec.category,
            lock=self.spec.lock,
            **self._others(),
        )
        names = used_inputs(model)
        return dataclasses.replace(model, inputs=tuple(n for n in self.spec.inputs if n in names))

    def _others(self) -> dict[str, Any]:
        """Forces of all other kinds, which act on the chassis alone. Raises SpecError for one that does not."""
        found: dict[str, Any] = {}
        for kind in FORCES:
            if kind.name in (*REPLACED, *KINDS, 'coordinate_forces', 'tires', 'guides'):
                continue
            for element in getattr(self.spec, kind.name):
                where = [
                    getattr(element, name).body
                    for name in ('marker', 'reaction', 'i', 'j')
                    if getattr(element, name, None) is not None
                ]
                missing = [body for body in where if body not in (self.chassis.name, WORLD)]
                if missing:
                    raise SpecError(
                        f'{element.where}: acts on {missing[0]!r}, which this level does not have; use full'
                    )
            found[kind.name] = getattr(self.spec, kind.name)
        return found

    def _carrier(self, corner: str) -> RigidBodySpec:
        """The body that a wheel turns on."""
        wheel, bearing = self.tires[corner].marker.body, self.joints[f'wheel_{corner}']
        return self.bodies[bearing.i.body if bearing.j.body == wheel else bearing.j.body]

    def _across(self, corner: str) -> float:
        """Inertia [kg m^2] about a diameter of a wheel, the mean of x and z, with its carrier unless that carries both
        wheels."""
        carrier = self._carrier(corner)
        alone = all(self._carrier(other) is not carrier for other in CORNERS if other != corner)
        across = 0.0
        for body in (self.bodies[self.tires[corner].marker.body], *((carrier,) if alone else ())):
            R = matrix(body.orientation)
            d = np.array(body.position) + product(R, body.com) - self.centers[corner]
            J = product(product(R, body.inertia_matrix()), R.T)
            across += 0.5 * (J[0, 0] + J[2, 2]) + body.mass * (d[1] * d[1] + 0.5 * (d[0] * d[0] + d[2] * d[2]))
        return across

    def _masses(self, axle: str) -> AxleMasses:
        """Masses that move with each wheel of an axle, and the mass that both share, in the middle between them."""
        corners = [f'{axle}_{side}' for side in SIDES]
        J = np.array([self._across(corner) for corner in corners])
        own = np.array([self._slopes(corner)[:4] for corner in corners])
        other = np.array(self.data[axle]['opposite']).reshape(2, 5, BESIDE)[:, :4, 0]
        moved = np.array([self.data[corner]['travel'] for corner in corners])
        return divided(J, own, other, moved, self.data[corners[0]]['beside'])

    def _wheel(self, corner: str, mass: float) -> RigidBodySpec:
        """Body at the wheel centre that stands for the wheel, its carrier and all parts that move with them. It turns
        as the wheel."""
        wheel, across = self.bodies[self.tires[corner].marker.body], self._across(corner)
        spin = spin_of(wheel, across, self.data[corner])
        inertia = (across, spin, across, 0.0, 0.0, 0.0)
        return RigidBodySpec(
            name=wheel.name, mass=mass, inertia=inertia, position=wheel.position, orientation=wheel.orientation
        )

    def _slopes(self, corner: str) -> np.ndarray:
        """(5,) slopes of the maps of a wheel over its own travel, in the design position."""
        axle, _, side = corner.partition('_')
        data = self.data[axle]
        columns = maps.MAP_STEERING + 2 if data['steered'] else 1
        shape = np.array(data['shape']).reshape(2, maps.MAP_TRAVEL + 2, columns, 5)[list(SIDES).index(side)]
        along = (
            shape[:, 0]
            if columns == 1
            else np.add.reduce(
                shape[:, columns // 2 - 1 : columns // 2 + 2] * np.array([1.0, 4.0, 1.0])[:, None] / 6.0, axis=1
            )
        )
        i, step = (maps.MAP_TRAVEL + 2) // 2, 2.0 * self.data['travel'] / (maps.MAP_TRAVEL - 1)
        return (along[i + 1] - along[i - 1]) / (2.0 * step)

    def _steering(self) -> tuple[tuple[RigidBodySpec, ...], tuple[Any, ...], tuple[Any, ...]]:
        """((steering wheel,), (its joint,), (the coupler that drives it,)); three empty tuples for a car that is not
        steered."""
        for coupler in self.spec.couplers:
            joint = self.joints.get(coupler.terms[0][0])
            if coupler.input is not None and len(coupler.terms) == 1 and joint is not None:
                if joint.kind != 'revolute' or joint.i.body != self.chassis.name:
                    raise SpecError(f'{joint.where}: the steering wheel must turn on the chassis; use full')
                return (self.bodies[joint.j.body],), (joint,), (coupler,)
        return (), (), ()

    def _rest(self, taken: tuple[RigidBodySpec, ...]) -> RigidBodySpec:
        """The chassis with the mass and inertia of the whole vehicle, less those of the bodies in `taken`."""
        mass, moment, inertia = _sums(self.spec.bodies)
        less = _sums(taken)
        mass, moment, inertia = mass - less[0], moment - less[1], inertia - less[2]
        com = moment / mass
        inertia = inertia - mass * (product(com, com) * np.eye(3) - np.outer(com, com))
        R = matrix(self.chassis.orientation)
        own = product(product(R.T, inertia), R)
        x, y, z = (float(c) for c in product(R.T, com - self.chassis.position))
        six = (own[0, 0], own[1, 1], own[2, 2], own[0, 1], own[0, 2], own[1, 2])
        return self.chassis.replace(mass=float(mass), com=(x, y, z), inertia=tuple(float(c) for c in six))

    def _spin(self, corner: str, wheel: RigidBodySpec) -> CoordinateSpec:
        """Coordinate of the rotation of a wheel, relative to the chassis instead of the carrier."""
        bearing = self.joints[f'wheel_{corner}']
        own, base = (bearing.j, bearing.i) if bearing.j.body == wheel.name else (bearing.i, bearing.j)
        R = product(matrix(self.bodies[base.body].orientation), matrix(base.orientation))
        R_C = matrix(self.chassis.orientation)
        x, y, z = (float(c) for c in product(R_C.T, self.centers[corner] - self.chassis.position))
        on_chassis = Marker(body=self.chassis.name, position=(x, y, z), orientation=quaternion(product(R_C.T, R)))
        i, j = (on_chassis, own) if own is bearing.j else (own, on_chassis)
        return CoordinateSpec(name=bearing.name, kind='rotation', i=i, j=j)

    def _travel(self, corner: str, wheel: RigidBodySpec) -> CoordinateSpec:
        """Coordinate of the travel of a wheel relative to the chassis, upwards."""
        at = tuple(float(c) for c in self.centers[corner])
        return CoordinateSpec(
            name=f'travel_{corner}', kind='translation', i=marker_at(self.chassis, at, UP), j=marker_at(wheel, at, UP)
        )

    def _guide(
        self, axle: str, wheels: dict[str, RigidBodySpec], shared: float, couplers: tuple[Any, ...]
    ) -> GuideSpec:
        """The guide of an axle. shared: mass of both wheels together [kg]. Raises SpecError for brakes or drives it
        cannot have."""
        data = self.data[axle]
        corners = [f'{axle}_{side}' for side in SIDES]
        brakes = {b.coordinate: b for b in self.spec.brakes}
        own = [brakes.get(f'wheel_{c}') for c in corners]
        if (
            None in own
            or own[0].input != own[1].input  # type: ignore[union-attr]
            or own[0].stiffness != own[1].stiffness  # type: ignore[union-attr]
            or own[0].damping != own[1].damping  # type: ignore[union-attr]
        ):
            raise SpecError(f'both wheels of the {axle} axle need equal brakes on one input; use full')
        if any(b.own_input is not None for b in own):  # type: ignore[union-attr]
            raise SpecError(
                'brakes of single wheels are beyond this level; remove actuation.wheels, or use condensed or full'
            )
        C = np.array(data['compliance'])
        fastest = 2.0 * math.pi * maps.STIFFEST / self.size.time
        C += np.diag([1.0 / (x * fastest**2) for c in corners for x in self._inertias(wheels[c])])
        K = inverse(C)
        K = 0.5 * (K + K.T)
        by_brake = np.array(data['by_brake'])
        windup = product(by_brake, K)
        left = np.array(data['winding']) - np.add.reduce(windup * by_brake, axis=1)
        reach = self.data['travel']
        fine = np.linspace(-reach, reach, maps.FORCE_TRAVEL)
        weight = -self.spec.gravity[2]
        springs = [
            spring_law(fine, np.array(data['loads'][k]) - weight * (wheels[c].mass + 0.5 * shared))
            for k, c in enumerate(corners)
        ]
        laws, ratios, crossings, mounts, yields = zip(*(self._damper(data, k) for k in range(2)), strict=True)
        steered = data['steered']
        if steered and not couplers:
            raise SpecError(
                f'the {axle} axle is steered, but no coupler with an input turns a steering wheel; use full'
            )
        travel = (-reach, 2.0 * reach / (maps.MAP_TRAVEL - 1), maps.MAP_TRAVEL)
        turned = self.data['steering']
        steering = (-turned, 2.0 * turned / (maps.MAP_STEERING - 1), maps.MAP_STEERING) if steered else (0.0, 1.0, 1)
        at = [
            vector_of(product(matrix(self.chassis.orientation).T, self.centers[c] - self.chassis.position))
            for c in corners
        ]
        axes = [vector_of(matrix(self.tires[c].marker.orientation)[:, 1]) for c in corners]
        stiffness = own[0].stiffness  # type: ignore[union-attr]
        drives = on_carriers(self.spec, axle)
        if len({drive.input for drive in drives}) > 1:
            raise SpecError(f'wheels of the {axle} axle are driven from their carriers by several inputs; use full')
        gear = self._gear() if steered and axle == AXLES[0] else None
        return GuideSpec(
            name=axle, chassis=self.chassis.name, left=wheels[corners[0]].name, right=wheels[corners[1]].name,
            centers=(at[0], at[1]), axes=(axes[0], axes[1]), travel=travel, steering=steering,
            shape=tuple(data['shape']), opposite=tuple(data['opposite']),
            coordinate=self._turn(axle, couplers) if steered else None,
            stiffness=tuple(K.ravel().tolist()), lag=LAG * self.size.time, windup=tuple(windup.ravel().tolist()),
            springs=(springs[0], springs[1]), coupling=tuple(data['coupling']),
            jacking=tuple(data['jacking']) if gear else (0.0,) * 6, gear=gear or (None, None),
            dampers=laws, ratios=tuple(x for ratio in ratios for x in ratio), crossings=crossings, mounts=mounts,
            yields=yields,
            wheels=(f'wheel_{corners[0]}', f'wheel_{corners[1]}'), input=own[0].input,  # type: ignore[union-attr]
            shares=(own[0].gain, own[1].gain),  # type: ignore[union-attr]
            brake_stiffness=1.0 / (1.0 / stiffness + max(float(left.mean()), 0.0)), brake_damping=own[0].damping,  # type: ignore[union-attr]

            drive=drives[0].input if drives else None,
            drives=tuple((*_factors(d, corners), d.input_gain, d.top_rate or 0.0) for d in drives),
        )  # fmt: skip

    def _turn(self, axle: str, couplers: tuple[Any, ...]) -> str:
        """Joint whose rotation a guide follows: the pinion of power steering on the front axle, else the steering
        wheel."""
        return couplers[0].terms[0][0] if self.assisted is None or axle != AXLES[0] else self.assisted.joint.name

    def _gear(self) -> tuple[Law, Law | None]:
        """(spring, damper) laws of the steering, about the rotation that the front guide follows."""
        return (
            (steering_springs(self.data['gear'], self.data['steering']), None)
            if self.assisted is None
            else self.assisted.gear
        )

    @staticmethod
    def _inertias(wheel: RigidBodySpec) -> tuple[float, float, float, float]:
        """Inertias of a wheel in the four directions of compliance: x, y [kg], steer, camber [kg m^2]."""
        return wheel.mass, wheel.mass, wheel.inertia[2], wheel.inertia[0]

    def _damper(self, data: dict[str, Any], side: int) -> tuple[Law, list[float], float, float, Law]:
        """The damper that moves with a wheel, as a guide takes it.

        (law; coefficients of the motion ratio over the travel; motion ratio of the other wheel's travel; stiffness of
        its mount [N/m], 0 for none; inverse of the law).
        """
        first, other = (self._dampers(data, k) for k in (side, 1 - side))
        nothing = Law.linear(0.0)
        if not first:
            return nothing, [0.0] * maps.POWERS, 0.0, 0.0, nothing
        own, moves = first[0], data['dampers'][side]
        for k in first[1:]:
            share = abs(moves[k][0] / moves[own][0])
            if share > CROSSED and k not in other[:1]:  # on a dependent axle the damper of the other wheel moves too
                raise SpecError(
                    f'{len(first)} dampers move with one wheel, but this level has one damper per wheel '
                    f'(a further one moves by {100 * share:.0f} % of the first); use full'
                )
        law = self.spec.spring_dampers[int(own)].damper
        assert law is not None
        yields = inverse_law(law)
        crossing = float(data['dampers'][1 - side].get(own, (0.0,))[0])
        return law, moves[own], crossing, data['mounts'][int(own)] if yields is not None else 0.0, yields or nothing

    def _dampers(self, data: dict[str, Any], side: int) -> list[Any]:
        """Keys of the dampers that move with a wheel, the one with the largest travel first."""
        moves = data['dampers'][side]
        return sorted(
            (k for k in moves if self.spec.spring_dampers[int(k)].damper is not None), key=lambda k: -abs(moves[k][0])
        )

    def _drives(self) -> tuple[CoordinateForceSpec, ...]:
        """Drive torques and limited-slip forces, between the wheels and the chassis or the carriers. Raises
        SpecError."""
        slopes = self.data['coordinates']
        found = []
        for force in self.spec.coordinate_forces:
            terms: dict[str, float] = {}
            for name, factor in force.terms:
                for corner, slope in slopes.get(name, {}).items():
                    terms[f'wheel_{corner}'] = terms.get(f'wheel_{corner}', 0.0) + factor * slope
            terms = {name: round(factor, 9) for name, factor in terms.items() if abs(factor) > UNMOVED}
            if terms and (force.input is not None or force.damper is not None) and len(terms) <= 3:
                if force.spring is not None:
                    raise SpecError(f'{force.where}: this level has no spring on turning wheels; use full')
                found.append(force.replace(terms=tuple(terms.items())))
            elif force.input is not None:
                raise SpecError(f'{force.where}: its input moves nothing that this level has; use full')
        return tuple(found)

    def _held(self, kept: set[str]) -> tuple[CoordinateForceSpec, ...]:
        """Forces on the coordinates in `kept` alone, which stay as they are: dampers of the steering wheel."""
        return tuple(force for force in self.spec.coordinate_forces if {name for name, _ in force.terms} <= kept)


def _factors(force: CoordinateForceSpec, corners: list[str]) -> tuple[float, float]:
    """Factors of a force on the rotation of the left and of the right wheel, 0 where it does not act."""
    left, right = (dict(force.terms).get(f'wheel_{corner}', 0.0) for corner in corners)
    return left, right


def _sums(bodies: tuple[RigidBodySpec, ...]) -> tuple[float, np.ndarray, np.ndarray]:
    """(mass [kg], first moment [kg m], inertia about the origin of the design frame [kg m^2]) of bodies in the design
    position."""
    mass, moment, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    for body in bodies:
        R = matrix(body.orientation)
        p = np.array(body.position) + product(R, body.com)
        mass += body.mass
        moment = moment + body.mass * p
        own = product(product(R, body.inertia_matrix()), R.T)
        inertia = inertia + own + body.mass * (product(p, p) * np.eye(3) - np.outer(p, p))
    return mass, moment, inertia
