"""Power steering at the level kc: torsion bar and motor stay (solver.elements.servo), between steering wheel and a
pinion on the chassis that turns as the one of the vehicle and moves what that one moves. The guide of the axle follows
the pinion; so the bench measures it with the gear held to a steering wheel without universal joints, and how far bar
and motor give way is not in its compliance.

Conserved are the law of the motor, the inertia of what moves with the gear (twice the kinetic energy at a unit rate of
the pinion) and its dampers and dry friction, reduced to the pinion by their levers, the non-uniformity of the universal
joints.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np

from solver.compiled.portable import product
from solver.elements.coordinate_force import CoordinateForceSpec
from solver.elements.coupler import CouplerSpec
from solver.elements.joint import JointSpec
from solver.elements.laws import Law, geared, sum_of
from solver.elements.rigid_body import RigidBodySpec
from solver.elements.servo import ServoSpec
from solver.levels.columns import reduced_columns
from solver.levels.draft import Draft
from solver.levels.map_fits import spring_law
from solver.model.spec import ModelSpec
from solver.vehicle.power_steering import FRICTION


class Assisted(NamedTuple):
    """Parts of a steering besides the maps of its guide. servo: between pinion and steering wheel; body, joint: the
    pinion; gear: laws of the springs and of the dampers at it, for the guide; forces: other forces on it."""

    servo: ServoSpec
    body: RigidBodySpec
    joint: JointSpec
    gear: tuple[Law, Law | None]
    forces: tuple[CoordinateForceSpec, ...]


def gear_held(spec: ModelSpec) -> tuple[ModelSpec, ServoSpec | None]:
    """(the model for the bench, the servo over the gear and the steering wheel): there the gear turns with the steering
    wheel as it does with the pinion. A model without a servo, or with a column that no rule reduces or that turns it
    round, comes back as it is."""
    if len(spec.servos) != 1:
        return spec, None
    draft = Draft(spec)
    reduced_columns(draft)
    (servo,) = draft.sections['servos'].values()
    (pinion, own), (driving, factor) = spec.servos[0].terms[1], servo.terms[1]
    if driving == pinion or factor != own:
        return spec, None
    draft.drop('servos', servo.name)
    draft.put('couplers', CouplerSpec(name=servo.name, terms=servo.terms, offset=0.0))
    return draft.model(), servo


def assisted(spec: ModelSpec, servo: ServoSpec, data: dict[str, Any], turned: float) -> Assisted:
    """The steering of a vehicle whose servo is that of gear_held(); data, turned: `gear`, `steering` of
    solver.levels.maps.measured()."""
    (moved, share), (driving, factor) = servo.terms
    lever = -factor / share  # of the pinion, with which the coordinate that the motor moves goes by so much per turn
    draft = Draft(spec)
    angle = spec.servos[0].terms[1][0]
    bearing: JointSpec = draft.sections['joints'][angle]
    pinion = draft.bodies[bearing.j.body]
    p, R = draft.placed(bearing.i)
    joint = bearing.replace(i=draft.marker(draft.chassis, p, R))
    n = product(draft.frame(pinion.name).R.T, R[:, 2])
    J = pinion.inertia_matrix() + data['inertia'] * np.outer(n, n)
    six = (J[0, 0], J[1, 1], J[2, 2], J[0, 1], J[0, 2], J[1, 2])
    dampers = [(spec.spring_dampers[int(k)].damper, slope) for k, slope in data['lengths'].items()]
    at_gear = [f for f in spec.coordinate_forces if [name for name, _ in f.terms] == [moved]]
    plain = [f for f in at_gear if f.spring is None and f.input is None and f.preload == 0.0]
    dampers += [(f.damper, f.terms[0][1] * lever) for f in plain]
    laws = [geared(law, slope) for law, slope in dampers if law is not None and slope != 0.0]
    damper = sum_of(laws) if laws else None
    forces = [f.replace(terms=((angle, f.terms[0][1] * lever),)) for f in at_gear if f not in plain]
    helped = servo.replace(
        terms=((angle, -factor), (driving, factor)),
        forces=tuple(tuple(force * abs(lever) for force in row) for row in servo.forces),
        limit=servo.limit * abs(lever),
    )
    own = pinion.replace(inertia=tuple(float(x) for x in six))
    return Assisted(helped, own, joint, (steering_springs(data, turned), damper), tuple(forces))


def steering_springs(data: dict[str, Any], turned: float) -> Law:
    """The torque [N m] by which what steering winds up turns it back, the springs of a car that it lifts among it;
    data, turned: `gear`, `steering` of solver.levels.maps.measured()."""
    return spring_law(np.linspace(-turned, turned, len(data['torque'])), np.array(data['torque']))


def unassisted(spec: ModelSpec, dampers: Collection[str | int]) -> tuple[str, ...]:
    """Sentences on a motor in the steering gear behind a column that no rule reduces, and on dampers of a gear without
    a motor. dampers: indices of those that the steering moves."""
    said = 'the motor of {} and friction in the steering: the torque at the steering wheel is the whole one'
    braking = [spec.spring_dampers[int(k)].name for k in dampers] + [
        f.name for f in spec.coordinate_forces if f.name == FRICTION
    ]
    felt = f'{", ".join(braking)}: the torque at the steering wheel is without'
    return (*(said.format(servo.name) for servo in spec.servos), *((felt,) if braking else ()))
