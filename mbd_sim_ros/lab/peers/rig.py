"""A car-sized model that other programs can do as well: the full car on a rig, in elements that all of them have.

53 bodies, 49 joints, 29 bushings and 9 spring-dampers of the full car stay where they are. Elements that only this
project has are replaced, for every program alike: a tire by a spring in three directions between the ground and its
wheel, off centre by RUNOUT, so that the turning wheels shake the car; laws by their slope at rest (dampers: their mean
rate up to 0.2 m/s); constant-velocity by universal joints; the driver by a fixed steering wheel; rack and pinion by a
spring along the rack; the final drive by a torsion spring between the output shafts and one that holds the pinion.
Brakes, drag and the motor of power steering are left out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from solver.elements.bushing import BushingSpec, Six
from solver.elements.coordinate import CoordinateSpec
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.joint import JointSpec
from solver.elements.laws import Law
from solver.elements.marker import WORLD, Marker
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.servo import ServoSpec
from solver.elements.spring_damper import SpringDamperSpec
from solver.files.scene import load_scene
from solver.model.frames import matrix
from solver.model.spec import ModelSpec
from solver.scene import Scene, StartSettings
from solver.simulation import Simulation

RUNOUT = 0.004  # m
TIRE = (1.5e5, 1.2e5, 2.2e5)  # N/m, along x y z of the ground
SPIN = 60.0  # rad/s, of the wheels: 9.5 Hz, near wheel hop
DAMPER_SPEED = 0.2  # m/s
SIDES = ('left', 'right')
KINDS = {  # of joints: the axes that are constrained, along and about x y z
    'fixed': (1, 1, 1, 1, 1, 1),
    'revolute': (1, 1, 1, 1, 1, 0),
    'prismatic': (1, 1, 0, 1, 1, 1),
    'cylindrical': (1, 1, 0, 1, 1, 0),
    'universal': (1, 1, 1, 0, 0, 1),
    'spherical': (1, 1, 1, 0, 0, 0),
    'point_on_line': (1, 1, 0, 0, 0, 0),
}


def car_on_rig(scene: str, overrides: Sequence[str] = (), *, duration: float) -> Scene:
    """The full car of a scene on the rig: at rest in its springs, its wheels turning."""
    full = load_scene(scene, overrides)
    spec = full.model
    joints = {j.name: _joint(j) for j in spec.joints}
    wheels = [tire.marker.body for tire in spec.tires]
    springs = [_spring_damper(s, spec) for s in spec.spring_dampers]
    bushings = [dataclasses.replace(b, stiffness=_rates(b), laws=(None,) * 6) for b in spec.bushings]
    places = {b.name: b.position for b in spec.bodies}
    bushings += [
        BushingSpec(
            name=f'rig_{wheel}',
            i=Marker(body=WORLD, position=places[wheel]),
            j=Marker(body=wheel, position=(0.0, 0.0, -RUNOUT)),
            stiffness=(*TIRE, 0.0, 0.0, 0.0),
        )
        for wheel in wheels
    ]
    bars = [c for c in spec.coordinates if c.name.startswith('anti_roll_bar')]
    shafts = [joints[f'output_shaft_rear_{side}'].j for side in SIDES]
    final_drive = next(f for f in spec.coordinate_forces if f.name == 'final_drive')
    factors = dict(final_drive.terms)
    axle, pinion = factors[f'output_shaft_rear_{SIDES[0]}/angle'], factors['drive_pinion/angle']
    model = ModelSpec(
        bodies=tuple(_turning(b) if b.name in wheels or '_shaft_rear_' in b.name else b for b in spec.bodies),
        joints=tuple(joints.values()),
        coordinates=(*bars, CoordinateSpec(name='axle', kind='rotation', i=shafts[0], j=shafts[1])),
        spring_dampers=tuple(springs),
        bushings=tuple(bushings),
        coordinate_forces=(
            *(f for f in spec.coordinate_forces if f.name.startswith('anti_roll_bar')),
            _torsion('axle', 'axle', final_drive, axle * axle),
            _torsion('drive_pinion', 'drive_pinion/angle', final_drive, pinion * pinion),
        ),
        chassis=spec.chassis,
        gravity=spec.gravity,
    )
    return Scene(
        name='car_on_rig',
        model=model,
        start=StartSettings(kind='equilibrium', stable=False),  # the heavy side of a wheel may stand above its axle
        integrator=full.integrator,
        duration=duration,
    )


def _turning(body: RigidBodySpec) -> RigidBodySpec:
    """A wheel, or a shaft that turns with one."""
    return dataclasses.replace(body, angular_velocity=(0.0, SPIN, 0.0))


def _joint(joint: JointSpec) -> JointSpec:
    kind = {'constant_velocity': 'universal'}.get(joint.kind, joint.kind)
    return dataclasses.replace(joint, kind='fixed' if joint.name == 'steering_wheel' else kind)


def _rates(bushing: BushingSpec) -> Six:
    """Stiffness of a bushing along and about its axes where it is not deflected [N/m, N m/rad]."""
    at_rest = lambda law: float(np.interp(0.0, law.x, law.slope))  # noqa: E731
    return tuple(k if law is None else at_rest(law) for k, law in zip(bushing.stiffness, bushing.laws, strict=True))  # type: ignore[return-value]


def _spring_damper(element: SpringDamperSpec, spec: ModelSpec) -> SpringDamperSpec:
    """The linear counterpart of a spring-damper; the one at the rack also has the stiffness of rack and pinion. Bump
    stops are left out."""
    spring = element.spring if element.spring is not None and len(element.spring.x) == 1 else None
    damper = element.damper
    if damper is not None and len(damper.x) > 1:
        low, high = np.interp((-DAMPER_SPEED, DAMPER_SPEED), damper.x, damper.y)
        damper = Law.linear(float(high - low) / (2.0 * DAMPER_SPEED))
    if element.name == 'steering_damper':
        assert damper is not None
        gear = next(f for f in (*spec.coordinate_forces, *spec.servos) if f.name == 'rack_and_pinion')
        ratio = dict(gear.terms)['rack'] ** 2
        if isinstance(gear, ServoSpec):
            stiffness, loss = gear.stiffness, gear.damping
        else:
            assert gear.spring is not None and gear.damper is not None
            stiffness, loss = gear.spring.slope[0], gear.damper.slope[0]
        spring = Law.linear(ratio * stiffness)
        damper = Law.linear(damper.slope[0] + ratio * loss)
    return dataclasses.replace(element, spring=spring, damper=damper)


def _torsion(name: str, coordinate: str, like: CoordinateForceSpec, factor: float) -> CoordinateForceSpec:
    """A linear torsion spring and damper with a multiple of the rates of another."""
    assert like.spring is not None and like.damper is not None
    return CoordinateForceSpec(
        name=name,
        terms=((coordinate, 1.0),),
        spring=Law.linear(factor * like.spring.slope[0]),
        damper=Law.linear(factor * like.damper.slope[0]),
    )


def plain(simulation: Simulation) -> dict[str, Any]:
    """The model of a simulation and its present state as numbers: what exudyn_rig wants. Points are taken from the
    centres of mass."""
    spec, state = simulation.model.spec, simulation.state
    index = {b.name: k for k, b in enumerate(spec.bodies)} | {WORLD: -1}
    com = {b.name: np.array(b.com) for b in spec.bodies} | {WORLD: np.zeros(3)}

    def frame(marker: Marker) -> list[Any]:
        return [
            index[marker.body],
            (np.array(marker.position) - com[marker.body]).tolist(),
            matrix(marker.orientation).tolist(),
        ]

    rate = lambda law: 0.0 if law is None else law.slope[0]  # noqa: E731
    coordinates = {c.name: c for c in spec.coordinates} | {
        f'{j.name}/angle': j for j in spec.joints if j.kind == 'cylindrical'
    }
    return {
        'gravity': list(spec.gravity),
        'bodies': [
            {
                'mass': b.mass,
                'inertia': b.inertia_matrix().tolist(),
                'p': state.q[k, :3].tolist(),
                'R': matrix(state.q[k, 3:].tolist()).tolist(),
                'v': state.v[k, :3].tolist(),
                'w': (matrix(state.q[k, 3:].tolist()) @ state.v[k, 3:]).tolist(),
            }
            for k, b in enumerate(spec.bodies)
        ],
        'joints': [[KINDS[j.kind], frame(j.i), frame(j.j)] for j in spec.joints],
        'bushings': [[frame(b.i), frame(b.j), list(b.stiffness), list(b.damping)] for b in spec.bushings],
        'springs': [
            [frame(s.i), frame(s.j), s.free_length, rate(s.spring), rate(s.damper)] for s in spec.spring_dampers
        ],
        'torsions': [
            [frame(c.i), frame(c.j), rate(f.spring), rate(f.damper)]
            for f in spec.coordinate_forces
            for c in [coordinates[f.terms[0][0]]]
        ],
    }
